"""Steering with scaled tires equals a table computed for them."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.errors import ParameterError
from map_racing.vehicle.grids import default_grid
from map_racing.vehicle.parameters import linearized, load_vehicle, scaled_tires
from map_racing.vehicle.steady_state import steady_state_table
from map_racing.vehicle.tire_steering import TireSteering

NUC4 = load_vehicle("nuc4")
V_MAX = 10.0
STEERING = TireSteering(NUC4, V_MAX)
FACTORS = [(1.0, 1.0, 1.0), (0.75, 1.0, 1.0), (1.0, 0.7, 1.0), (1.0, 1.0, 0.6), (1.15, 1.2, 0.8)]


def table_of(vehicle, factors):
    car = scaled_tires(vehicle, *factors)
    return steady_state_table(car, *default_grid(car, v_max=V_MAX))


@pytest.mark.parametrize("factors", FACTORS)
def test_it_is_the_table_of_the_scaled_car(factors):
    table, steering = table_of(NUC4, factors), STEERING.scaled(*factors)
    v = np.linspace(0.3, 12.0, 40)
    limits = table.max_lateral_acceleration(v)
    assert steering.max_lateral_acceleration(v) == pytest.approx(limits, rel=0.025)
    for speed, limit in zip(v.tolist(), limits.tolist()):
        assert steering.limit(speed) == pytest.approx(
            steering.max_lateral_acceleration(speed), rel=1e-9
        )
        for share in (0.05, 0.3, 0.6, 0.8, 0.9, 0.97):
            expected = table.steering(speed, share * limit)[0]
            assert steering.steering(speed, share * limit)[0] == pytest.approx(expected, abs=2e-4)


@pytest.mark.parametrize("factors", FACTORS)
def test_beyond_what_the_data_reached_there_is_no_grip(factors):
    car = dataclasses.replace(NUC4, a_lat_max=5.0)
    table, steering = table_of(car, factors), TireSteering(car, V_MAX).scaled(*factors)
    v = np.linspace(0.3, 12.0, 40)
    limits = table.max_lateral_acceleration(v)
    assert limits.max() == pytest.approx(5.0 * factors[0])
    found = steering.max_lateral_acceleration(v)
    assert np.all(found <= 1.001 * limits)
    assert found[v > 3.0] == pytest.approx(limits[v > 3.0], rel=0.025)
    for share, saturated in ((0.9, False), (1.1, True)):
        found, expected = (each.steering(6.0, share * limits.max()) for each in (steering, table))
        assert found == (pytest.approx(expected[0], abs=2e-3), saturated)


def test_linear_tires_have_the_table_of_linear_tires():
    car = linearized(NUC4)
    table, steering = table_of(car, (0.9, 1.0, 0.9)), TireSteering(car, V_MAX).scaled(0.9, 1.0, 0.9)
    for v in (1.0, 3.0, 6.0):
        for a_lat in (0.1, 2.0, 5.0):
            expected = table.steering(v, a_lat)[0]
            assert steering.steering(v, a_lat)[0] == pytest.approx(expected, abs=1e-3)


@settings(deadline=None)
@given(
    v=st.floats(0.1, 15.0),
    share=st.floats(0.0, 3.0),
    friction=st.floats(0.5, 1.5),
    front=st.floats(0.5, 1.5),
)
def test_odd_and_saturated_exactly_beyond_the_limit(v, share, friction, front):
    steering = STEERING.scaled(friction, front, 1.0)
    demand = share * steering.limit(v)
    angle, saturated = steering.steering(v, demand)
    assert 0.0 <= angle <= NUC4.delta_max
    assert saturated == (share > 1.0 + 1e-6) or abs(share - 1.0) < 1e-5
    assert steering.steering(v, -demand) == (-angle, saturated)


@settings(deadline=None, max_examples=50)
@given(factors=st.tuples(*[st.floats(0.6, 1.4)] * 3))
def test_the_level_is_the_friction_that_has_no_higher_limit(factors):
    """Where the tires limit the turn; in tighter turns it is the lock, which friction hardly
    affects."""
    steering = STEERING.scaled(*factors)
    level = steering.level(4.5)
    assert level <= factors[0] * (1.0 + 1e-9)
    assert level >= steering.level(2.0)
    alike = STEERING.scaled(level, 1.0, 1.0)
    for speed in np.linspace(4.5, V_MAX, 7):
        assert alike.limit(speed) <= 1.03 * steering.limit(speed)


def test_friction_alone_is_the_level():
    for friction in (0.6, 0.9, 1.2):
        assert STEERING.scaled(friction, 1.0, 1.0).level(2.0) == pytest.approx(friction, rel=2e-3)


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_what_is_not_finite_is_refused(value):
    for arguments in ((value, 1.0), (1.0, value)):
        with pytest.raises(ParameterError, match="finite"):
            STEERING.steering(*arguments)


def test_an_oversteering_car_ends_where_it_becomes_unstable():
    car = dataclasses.replace(NUC4, front=NUC4.rear, rear=NUC4.front)
    table, steering = table_of(car, (1.0, 1.0, 1.0)), TireSteering(car, V_MAX)
    for v in (2.0, 3.0):
        limit = table.max_lateral_acceleration(v)
        assert steering.max_lateral_acceleration(v) == pytest.approx(limit, rel=0.05)
        expected = table.steering(v, 0.7 * limit)[0]
        assert steering.steering(v, 0.7 * limit)[0] == pytest.approx(expected, abs=5e-4)
