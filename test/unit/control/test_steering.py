"""Steering maps: Ackermann geometry, and what all three maps have in common."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.control.steering import AckermannSteering, build_steering_map
from map_racing.errors import ParameterError
from map_racing.vehicle.lookup import LookupTable
from map_racing.vehicle.parameters import linearized, load_vehicle, parameter_hash

NUC4 = load_vehicle("nuc4")
MAPS = {
    kind: build_steering_map(kind, NUC4, 12.0) for kind in ("ackermann", "linear_table", "table")
}
speeds, accelerations = st.floats(0.0, 20.0), st.floats(-30.0, 30.0)


@pytest.mark.rest_once
@pytest.mark.parametrize("v_max", [1e-3, 1e9])
def test_tables_are_made_for_any_largest_speed(v_max):
    table = build_steering_map("table", NUC4, v_max)
    expected = MAPS["table"].steering(0.8, 0.5)[0]
    assert table.steering(0.8, 0.5)[0] == pytest.approx(expected, abs=1e-4)


def test_ackermann_angle_is_that_of_the_circle_through_both_axles():
    """A wheelbase of 0.3 m on a circle of 1.5 m radius needs atan(0.2)."""
    steering = AckermannSteering(l_wb=0.3, delta_max=0.4)
    for v in (0.5, 3.0, 11.0):
        angle, saturated = steering.steering(v, v * v / 1.5)
        assert angle == pytest.approx(math.atan(0.2), rel=1e-14)
        assert not saturated


@settings(deadline=None)
@given(speed=st.floats(0.1, 15.0), distance=st.floats(0.2, 5.0), eta=st.floats(-1.5, 1.5))
def test_with_the_l1_law_ackermann_is_pure_pursuit(speed, distance, eta):
    """The textbook form delta = atan(2 l_wb sin(eta) / L) knows no speed."""
    steering = AckermannSteering(l_wb=0.3, delta_max=1.5)
    angle, _ = steering.steering(speed, 2.0 * speed**2 / distance * math.sin(eta))
    assert angle == pytest.approx(math.atan(2.0 * 0.3 * math.sin(eta) / distance), abs=1e-12)


def test_ackermann_stops_at_the_lock_and_says_so():
    steering = AckermannSteering(l_wb=0.3, delta_max=0.4)
    limit = 4.0 * math.tan(0.4) / 0.3
    assert steering.steering(2.0, limit * (1.0 - 1e-9))[1] is False
    assert steering.steering(2.0, limit * 1.001) == (0.4, True)
    assert steering.steering(2.0, -1e9) == (-0.4, True)
    assert steering.steering(0.0, 1.0) == (0.4, True)
    assert steering.steering(0.0, 0.0) == (0.0, False)


@pytest.mark.parametrize("kind", sorted(MAPS))
@settings(deadline=None)
@given(v=speeds, a_lat=accelerations, more=st.floats(0.0, 5.0))
def test_each_map_is_odd_monotone_and_within_the_lock(kind, v, a_lat, more):
    steering = MAPS[kind].steering
    angle, saturated = steering(v, a_lat)
    assert steering(v, -a_lat) == (-angle, saturated)
    assert abs(angle) <= NUC4.delta_max * (1.0 + 1e-12)
    assert angle * a_lat >= 0.0
    assert steering(v, a_lat + more)[0] >= angle - 1e-12


@pytest.mark.parametrize("kind", sorted(MAPS))
@pytest.mark.parametrize("v", [0.5, 2.0, 6.0, 12.0])
def test_there_is_no_dead_band_around_straight_ahead(kind, v):
    small, (angle, _) = 1e-6, MAPS[kind].steering(v, 1e-6)
    double, _ = MAPS[kind].steering(v, 2.0 * small)
    assert angle > 0.0 and double == pytest.approx(2.0 * angle, rel=1e-3)


@pytest.mark.parametrize("a_lat", [0.02, 0.2, -0.2])
def test_all_maps_roll_alike_at_walking_speed(a_lat):
    """If tires hardly slip, only geometry matters."""
    angles = [MAPS[kind].steering(0.5, a_lat)[0] for kind in ("ackermann", "table")]
    assert angles[1] == pytest.approx(angles[0], rel=0.05)
    angles = [MAPS[kind].steering(6.0, 0.01 * a_lat)[0] for kind in ("linear_table", "table")]
    assert angles[1] == pytest.approx(angles[0], rel=1e-3)


def test_near_the_limit_the_maps_differ_as_their_tires_do():
    """At 6 m/s and 6 m/s^2 the real tires need more angle than linear ones, and pure geometry."""
    geometric, linear, real = (
        MAPS[kind].steering(6.0, 6.0)[0] for kind in ("ackermann", "linear_table", "table")
    )
    assert geometric < linear < real
    assert MAPS["ackermann"].steering(6.0, 8.0)[1] is False
    assert MAPS["table"].steering(6.0, 8.0)[1] is True


def test_the_tables_belong_to_the_car():
    assert isinstance(MAPS["table"], LookupTable)
    assert MAPS["table"].provenance.parameter_hash == parameter_hash(NUC4)
    assert MAPS["linear_table"].provenance.parameter_hash == parameter_hash(linearized(NUC4))
    assert MAPS["table"].speeds[-1] == 12.0


def test_an_unknown_steering_map_is_refused():
    with pytest.raises(ParameterError, match="steering_map: expected ackermann, .*brush"):
        build_steering_map("brush", NUC4, 12.0)
