"""The steady-state table compared with integration, closed forms, and published tables."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from map_racing.errors import ParameterError
from map_racing.vehicle.lookup import load_table
from map_racing.vehicle.parameters import linearized, load_vehicle, parameter_hash
from map_racing.vehicle.single_track import GRAVITY, single_track_derivatives
from map_racing.vehicle.steady_state import steady_state_table
from map_racing.vehicle.tires import LinearTire, PacejkaTire

NUC4 = load_vehicle("nuc4")
SIM = load_vehicle("sim")
OVERSTEER = dataclasses.replace(NUC4, name="oversteer", front=NUC4.rear, rear=NUC4.front)
TURNED_DOWN = dataclasses.replace(
    NUC4, name="E>1", front=PacejkaTire(4.5, 1.3, 1.0, 1.56), rear=PacejkaTire(10, 1.5, 1.3, 1.1)
)
CARS = [NUC4, SIM, OVERSTEER, TURNED_DOWN]

SPEEDS = np.array([0.5, 1.0, 2.0, 3.5, 5.0, 7.0, 11.0])
ANGLES = np.linspace(0.0, 0.42, 8)

tires = st.builds(
    PacejkaTire,
    B=st.floats(2.0, 30.0),
    C=st.floats(0.7, 2.4),
    D=st.floats(0.4, 1.5),
    E=st.floats(-2.0, 1.5),
)
cars = st.builds(
    dataclasses.replace,
    st.just(NUC4),
    l_f=st.floats(0.1, 0.2),
    I_z=st.floats(0.02, 0.2),
    mu=st.floats(0.4, 1.2),
    front=tires,
    rear=tires,
)


def simulate_to_steady_state(car, v, delta, duration=20.0):
    """Integrate from straight running; return the final lateral acceleration, NaN if not
    settled."""
    derivatives = single_track_derivatives(car, v_eps=1e-9)

    def right_hand_side(_, state):
        return derivatives(v, state[0], state[1], delta, 0.0)

    solution = solve_ivp(
        right_hand_side, (0.0, duration), (0.0, 0.0), method="LSODA", rtol=1e-10, atol=1e-12
    )
    v_y, r = solution.y[:, -1]
    v_y_dot, r_dot = derivatives(v, v_y, r, delta, 0.0)
    settled = solution.success and max(abs(v_y_dot), abs(v * r_dot)) < 1e-6
    return v * r if settled else float("nan")


def equilibrium(car, v, delta, a_lat):
    """Steady-state v_y with the rear tire on its rising side, and the Jacobian there."""
    v_y = a_lat * car.l_r / v - v * math.tan(car.rear.slip(a_lat / (car.mu * GRAVITY)))
    derivatives, r, h = single_track_derivatives(car, v_eps=1e-9), a_lat / v, 1e-6

    def column(dv_y, dr):
        ahead = derivatives(v, v_y + dv_y, r + dr, delta, 0.0)
        behind = derivatives(v, v_y - dv_y, r - dr, delta, 0.0)
        return (np.array(ahead) - np.array(behind)) / (2.0 * h)

    residual = derivatives(v, v_y, r, delta, 0.0)
    return residual, np.column_stack((column(h, 0.0), column(0.0, h)))


@pytest.mark.once
@pytest.mark.parametrize("car", CARS, ids=lambda car: car.name)
def test_table_equals_the_simulated_limit(car):
    table = steady_state_table(car, SPEEDS, ANGLES)
    for i, j in np.argwhere(np.isfinite(table.a_lat)).tolist():
        simulated = simulate_to_steady_state(car, SPEEDS[j], ANGLES[i])
        assert table.a_lat[i, j] == pytest.approx(simulated, abs=1e-6)


def test_every_cell_of_the_understeering_cars_has_a_steady_state():
    for car in (NUC4, TURNED_DOWN, linearized(NUC4)):
        assert np.all(np.isfinite(steady_state_table(car, SPEEDS, ANGLES).a_lat))


@pytest.mark.once
@settings(deadline=None, max_examples=60)
@given(car=cars)
def test_cells_are_stable_equilibria_of_the_equations(car):
    table = steady_state_table(car, SPEEDS, ANGLES)
    for i, j in np.argwhere(np.isfinite(table.a_lat)).tolist():
        residual, jacobian = equilibrium(car, SPEEDS[j], ANGLES[i], table.a_lat[i, j])
        assert residual == pytest.approx((0.0, 0.0), abs=1e-5)
        # Exactly at the rear tire's peak, its slip is not determined by the force: the slope, and
        # with it the Jacobian, varies with the square root of the missing force.
        if table.a_lat[i, j] < (1.0 - 1e-9) * car.mu * GRAVITY * car.rear.peak:
            assert np.linalg.eigvals(jacobian).real.max() < 1e-4


def test_tires_that_peak_together_end_the_branch_before_their_peak():
    """With a front tire slightly stiffer than the rear one, the last millirad is a saddle."""
    car = dataclasses.replace(
        NUC4,
        front=PacejkaTire(12.0, 2.0, 0.4, 0.0),
        rear=PacejkaTire(11.0, 2.0, 0.4, 0.0),
        **{"l_f": 0.1953125, "mu": 1.1171875, "I_z": 0.0859375},
    )
    angles = np.linspace(0.355, 0.37, 151)
    a_lat = steady_state_table(car, [2.0], angles).a_lat[:, 0]
    last = np.flatnonzero(np.isfinite(a_lat))[-1]
    assert np.isnan(a_lat[last + 1 :]).all()
    assert 0 < last < 150
    for delta, a in zip(angles[: last + 1], a_lat[: last + 1]):
        assert np.linalg.eigvals(equilibrium(car, 2.0, delta, a)[1]).real.max() < 0.0
    assert math.isnan(simulate_to_steady_state(car, 2.0, angles[last + 1], duration=60.0))


def test_tires_that_peak_together_may_swing_just_beyond_their_peak():
    """Not a saddle but a growing oscillation, between the peak and the next point on the branch."""
    car = dataclasses.replace(
        NUC4,
        front=PacejkaTire(21.5, 2.0, 0.59375, 0.0),
        rear=PacejkaTire(22.0, 2.0, 0.59375, 0.0),
        **{"l_f": 0.1015625, "mu": 0.5, "I_z": 0.0625},
    )
    a_lat = steady_state_table(car, SPEEDS, ANGLES).a_lat
    for i, j in np.argwhere(np.isfinite(a_lat)).tolist():
        jacobian = equilibrium(car, SPEEDS[j], ANGLES[i], a_lat[i, j])[1]
        assert np.linalg.eigvals(jacobian).real.max() < 0.0


@pytest.mark.once
@settings(deadline=None, max_examples=60)
@given(car=cars)
def test_a_branch_once_ended_does_not_begin_again(car):
    missing = np.isnan(steady_state_table(car, SPEEDS, ANGLES).a_lat)
    assert np.array_equal(missing, np.logical_or.accumulate(missing, axis=0))


@pytest.mark.once
@settings(deadline=None, max_examples=60)
@given(car=cars)
def test_no_acceleration_beyond_the_weaker_axle(car):
    a_lat = steady_state_table(car, SPEEDS, ANGLES).a_lat
    limit = car.mu * GRAVITY * min(car.front.peak, car.rear.peak)
    assert np.all(a_lat[np.isfinite(a_lat)] <= limit * (1.0 + 1e-12))


def test_linear_tires_follow_the_understeer_gradient():
    # a = v^2 delta / (l_wb + K v^2), K = (1/C_Sf - 1/C_Sr) / (mu g), for small angles
    gradient = (1.0 / 4.718 - 1.0 / 5.4562) / GRAVITY
    a_lat = steady_state_table(SIM, SPEEDS, [1e-5]).a_lat[0]
    np.testing.assert_allclose(
        a_lat, SPEEDS**2 * 1e-5 / (SIM.l_wb + gradient * SPEEDS**2), rtol=1e-8
    )


def test_small_angles_do_not_tell_tire_models_apart():
    pacejka = steady_state_table(NUC4, SPEEDS, [1e-5]).a_lat
    linear = steady_state_table(linearized(NUC4), SPEEDS, [1e-5]).a_lat
    np.testing.assert_allclose(pacejka, linear, rtol=1e-6)


def test_no_tires_no_slip_leaves_the_geometry():
    # very stiff tires: tan(delta) = l_wb a / v^2
    stiff = dataclasses.replace(SIM, front=LinearTire(1e8), rear=LinearTire(1e8))
    a_lat = steady_state_table(stiff, [2.0], ANGLES).a_lat[:, 0]
    np.testing.assert_allclose(a_lat, 4.0 * np.tan(ANGLES) / SIM.l_wb, rtol=1e-6)


def test_an_oversteering_car_has_a_critical_speed():
    # v_crit^2 = -l_wb / K
    car = dataclasses.replace(SIM, front=SIM.rear, rear=SIM.front)
    critical = math.sqrt(SIM.l_wb * GRAVITY / (1.0 / 4.718 - 1.0 / 5.4562))
    a_lat = steady_state_table(car, [0.999 * critical, 1.001 * critical], [0.0, 1e-6]).a_lat
    assert np.all(np.isfinite(a_lat[:, 0]))
    assert np.all(np.isnan(a_lat[:, 1]))


def test_beyond_the_peak_of_the_front_tire_the_car_plows_on():
    column = steady_state_table(NUC4, [7.0], np.linspace(0.0, 0.42, 85)).a_lat[:, 0]
    assert column.max() == pytest.approx(GRAVITY * NUC4.front.peak, abs=1e-3)
    assert np.isfinite(column[-1])
    assert column[-1] < column.max() - 0.1


def test_where_the_rear_lets_go_first_the_column_ends():
    column = steady_state_table(OVERSTEER, [3.5], np.linspace(0.0, 0.42, 85)).a_lat[:, 0]
    assert np.isnan(column[-1])
    assert np.all(np.diff(column[np.isfinite(column)]) > 0.0)
    assert 0.0 < np.nanmax(column) < GRAVITY * OVERSTEER.rear.peak


def test_the_end_of_a_branch_is_found_exactly():
    angles = np.linspace(0.0, 0.42, 4001)
    coarse = steady_state_table(OVERSTEER, [3.5], angles).a_lat[:, 0]
    end = angles[np.isfinite(coarse)][-1]
    fine = np.linspace(end, end + angles[1], 4001)
    column = steady_state_table(OVERSTEER, [3.5], fine).a_lat[:, 0]
    last = fine[np.isfinite(column)][-1]
    # the integration settles just before it, and spins just after
    assert math.isfinite(simulate_to_steady_state(OVERSTEER, 3.5, last - 1e-4, duration=60.0))
    spun = simulate_to_steady_state(OVERSTEER, 3.5, last + 1e-4, duration=60.0)
    assert not abs(spun - np.nanmax(column)) < 0.1


def test_provenance_names_the_car():
    provenance = steady_state_table(NUC4, SPEEDS, ANGLES).provenance
    assert (provenance.vehicle, provenance.tire_model) == ("NUC4", "pacejka")
    assert provenance.parameter_hash == parameter_hash(NUC4)
    assert provenance.l_wb == NUC4.l_wb


@pytest.mark.parametrize(
    ("speeds", "angles", "name"),
    [
        ([0.0, 1.0], [0.1], "speeds"),
        ([2.0, 1.0], [0.1], "speeds"),
        ([1.0, math.inf], [0.1], "speeds"),
        ([1.0], [-0.1, 0.1], "angles"),
        ([1.0], [0.2, 0.1], "angles"),
        ([1.0], [0.1, math.nan], "angles"),
        ([1.0], [2.0], "angles"),
    ],
)
def test_impossible_axes_are_refused(speeds, angles, name):
    with pytest.raises(ParameterError, match=f"^{name}: expected"):
        steady_state_table(NUC4, speeds, angles)


@pytest.mark.once
def test_a_growing_oscillation_is_no_steady_state():
    """A front tire far beyond its peak drives the yaw motion; the equilibrium is not a saddle."""
    car = dataclasses.replace(
        NUC4,
        front=PacejkaTire(11.74, 1.302, 0.8393, 1.441),
        rear=PacejkaTire(5.74, 1.029, 0.8414, -1.545),
        **{"l_f": 0.199, "I_z": 0.0394},
    )
    column = steady_state_table(car, [3.5], [0.32, 0.36, 0.4]).a_lat[:, 0]
    assert column[0] == pytest.approx(simulate_to_steady_state(car, 3.5, 0.32), abs=1e-6)
    assert np.isnan(column[1:]).all()
    assert math.isnan(simulate_to_steady_state(car, 3.5, 0.36, duration=60.0))


def test_what_has_not_settled_is_no_steady_state():
    assert math.isnan(simulate_to_steady_state(NUC4, 7.0, 0.2, duration=0.4))
    settled = simulate_to_steady_state(NUC4, 7.0, 0.2, duration=0.5)
    expected = steady_state_table(NUC4, [7.0], [0.2]).a_lat[0, 0]
    assert settled == pytest.approx(expected, abs=1e-6)


def test_a_car_without_any_steady_state_is_refused_by_name():
    with pytest.raises(ParameterError, match="^oversteer: no table of steady states: a_lat"):
        steady_state_table(OVERSTEER, [11.0], ANGLES)


def test_published_nuc4_table_is_reproduced(shared_data):
    folder = shared_data / "vehicles"
    published = load_table(folder / "NUC4_pacejka_lookup_table.csv")
    car = load_vehicle(folder / "NUC4_pacejka.txt")
    table = steady_state_table(car, published.speeds, published.angles)
    np.testing.assert_allclose(table.a_lat, published.a_lat, rtol=0.0, atol=1e-6)


def test_published_sim_table_is_reproduced_where_it_had_settled(shared_data):
    folder = shared_data / "vehicles"
    published = load_table(folder / "SIM_linear_lookup_table.csv")
    car = load_vehicle(folder / "SIM_linear.txt")
    table = steady_state_table(car, published.speeds, published.angles)
    settled = np.nan_to_num(table.a_lat, nan=np.inf) < 25.0
    assert settled.sum() > 3500
    np.testing.assert_allclose(table.a_lat[settled], published.a_lat[settled], rtol=0.0, atol=1e-5)
