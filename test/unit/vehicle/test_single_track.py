"""Right-hand side of the single-track model: the paper's equations, symmetry, standstill."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.vehicle.parameters import linearized, load_vehicle
from map_racing.vehicle.single_track import (
    GRAVITY,
    V_EPS,
    axle_loads,
    fastest_mode,
    single_track_derivatives,
    slip_angles,
)

NUC4 = load_vehicle("nuc4")
# a higher center of gravity and a friction other than 1, so that neither goes unnoticed
SIM = dataclasses.replace(load_vehicle("sim"), h_cg=0.074, mu=1.05)
CARS = [NUC4, SIM, linearized(NUC4)]

states = st.tuples(
    st.floats(2.0, 15.0), st.floats(-1.0, 1.0), st.floats(-3.0, 3.0), st.floats(-0.42, 0.42)
)


def printed_equations(car, v_x, v_y, r, delta, a_long):
    """The equations as the paper prints them."""
    alpha_f = math.atan((v_y + r * car.l_f) / v_x) - delta
    alpha_r = math.atan((v_y - r * car.l_r) / v_x)
    wheelbase = car.l_f + car.l_r
    F_zf = (car.m * GRAVITY * car.l_r - car.m * a_long * car.h_cg) / wheelbase
    F_zr = (car.m * GRAVITY * car.l_f + car.m * a_long * car.h_cg) / wheelbase
    F_yf = -car.mu * F_zf * float(car.front.normalized_force(alpha_f))
    F_yr = -car.mu * F_zr * float(car.rear.normalized_force(alpha_r))
    return (F_yr + F_yf) / car.m - v_x * r, (car.l_f * F_yf - car.l_r * F_yr) / car.I_z


def drive(car, v_x, a_long, steer, duration, step=0.002, v_y=0.0, r=0.0):
    """Integrate with RK4 at constant a_long; return the history of (v_x, v_y, r)."""
    derivatives = single_track_derivatives(car)
    history = []
    for k in range(int(round(duration / step))):
        delta = steer(k * step)
        v_mid, v_end = v_x + 0.5 * step * a_long, v_x + step * a_long
        k1 = derivatives(v_x, v_y, r, delta, a_long)
        k2 = derivatives(v_mid, v_y + 0.5 * step * k1[0], r + 0.5 * step * k1[1], delta, a_long)
        k3 = derivatives(v_mid, v_y + 0.5 * step * k2[0], r + 0.5 * step * k2[1], delta, a_long)
        k4 = derivatives(v_end, v_y + step * k3[0], r + step * k3[1], delta, a_long)
        v_y += step / 6.0 * (k1[0] + 2.0 * k2[0] + 2.0 * k3[0] + k4[0])
        r += step / 6.0 * (k1[1] + 2.0 * k2[1] + 2.0 * k3[1] + k4[1])
        v_x = v_end
        history.append((v_x, v_y, r))
    return np.array(history)


@given(a_long=st.floats(-8.0, 8.0))
def test_axle_loads_carry_the_weight_and_balance_the_inertia(a_long):
    F_zf, F_zr = axle_loads(SIM, a_long)
    assert F_zf + F_zr == pytest.approx(SIM.m * GRAVITY, rel=1e-14)
    moment = F_zr * SIM.l_r - F_zf * SIM.l_f
    assert moment == pytest.approx(SIM.m * a_long * SIM.h_cg, abs=1e-12)


@pytest.mark.parametrize("car", CARS, ids=lambda car: car.name)
@settings(deadline=None)
@given(state=states, a_long=st.floats(-8.0, 8.0))
def test_closure_equals_the_printed_equations_at_speed(car, state, a_long):
    derivatives = single_track_derivatives(car)
    expected = printed_equations(car, *state, a_long)
    assert derivatives(*state, a_long) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@given(state=states)
def test_slip_angles_are_those_of_the_paper_at_speed(state):
    v_x, v_y, r, delta = state
    alpha_f, alpha_r = slip_angles(NUC4, *state)
    assert alpha_f == pytest.approx(math.atan((v_y + r * NUC4.l_f) / v_x) - delta, abs=1e-14)
    assert alpha_r == pytest.approx(math.atan((v_y - r * NUC4.l_r) / v_x), abs=1e-14)


@pytest.mark.parametrize("v_x", [-3.0, -0.2, 0.0, 0.3, V_EPS, 5.0])
def test_closure_uses_slip_angles_at_every_speed(v_x):
    v_y, r, delta, a_long = 0.2, -1.1, 0.3, 2.0
    alpha_f, alpha_r = slip_angles(NUC4, v_x, v_y, r, delta)
    F_zf, F_zr = axle_loads(NUC4, a_long)
    F_yf = -NUC4.mu * F_zf * NUC4.front.normalized_force(alpha_f)
    F_yr = -NUC4.mu * F_zr * NUC4.rear.normalized_force(alpha_r)
    expected = (
        (F_yf + F_yr) / NUC4.m - v_x * r,
        (NUC4.l_f * F_yf - NUC4.l_r * F_yr) / NUC4.I_z,
    )
    assert single_track_derivatives(NUC4)(v_x, v_y, r, delta, a_long) == pytest.approx(expected)


@given(state=states)
def test_left_and_right_are_mirror_images(state):
    v_x, v_y, r, delta = state
    derivatives = single_track_derivatives(NUC4)
    v_y_dot, r_dot = derivatives(v_x, v_y, r, delta, 1.0)
    assert derivatives(v_x, -v_y, -r, -delta, 1.0) == (-v_y_dot, -r_dot)


def test_steering_left_turns_left_with_negative_slip():
    assert single_track_derivatives(NUC4)(5.0, 0.0, 0.0, 0.1, 0.0) > (0.0, 0.0)
    assert slip_angles(NUC4, 5.0, 0.0, 0.0, 0.1)[0] == pytest.approx(-0.1, abs=1e-15)


@pytest.mark.parametrize("car", CARS, ids=lambda car: car.name)
def test_a_parked_car_stays_with_its_wheels_turned(car):
    assert single_track_derivatives(car)(0.0, 0.0, 0.0, 0.4, 0.0) == (0.0, 0.0)


@pytest.mark.parametrize("car", CARS, ids=lambda car: car.name)
def test_pulling_away_with_steering_converges_at_two_milliseconds(car):
    coarse = drive(car, 0.0, 3.0, lambda t: 0.3, 2.0)
    fine = drive(car, 0.0, 3.0, lambda t: 0.3, 2.0, step=0.00025)[7::8]
    assert np.abs(coarse - fine).max() < 1e-3
    assert np.all(coarse[1:, 2] > 0.0)


@pytest.mark.parametrize("car", CARS, ids=lambda car: car.name)
@pytest.mark.parametrize("v_x", [-0.5, -0.05, 0.05, 0.3, 0.6])
def test_slow_driving_settles_on_the_circle_of_the_wheels(car, v_x):
    history = drive(car, v_x, 0.0, lambda t: 0.3, 1.5, v_y=0.05, r=0.5)
    assert np.ptp(history[-50:, 2]) < 1e-9
    # the tires need some slip even here: at most 3 % of the yaw rate
    assert history[-1, 2] == pytest.approx(v_x * math.tan(0.3) / car.l_wb, rel=0.03)


def test_the_fastest_mode_is_stable_at_two_milliseconds_with_a_margin():
    derivatives, h = single_track_derivatives(linearized(NUC4)), 1e-6
    columns = [derivatives(V_EPS, h, 0.0, 0.0, 0.0), derivatives(V_EPS, 0.0, h, 0.0, 0.0)]
    fastest = np.linalg.eigvals(np.array(columns).T / h).real.min()
    assert fastest == pytest.approx(-fastest_mode(NUC4) / V_EPS, rel=1e-2)
    assert fastest_mode(NUC4) == pytest.approx(741.0, abs=0.5)
    # RK4 is stable to -2.785
    assert 0.002 * fastest > -2.785 / 1.35


@pytest.mark.parametrize("car", CARS, ids=lambda car: car.name)
def test_reversing_follows_the_steering_without_swapping_ends(car):
    history = drive(car, 0.0, -1.0, lambda t: 0.1 * math.sin(3.0 * t), 4.0)
    steering = 0.1 * np.sin(0.006 * np.arange(len(history)))
    circle = history[:, 0] * np.tan(steering) / car.l_wb
    assert history[-1, 0] == pytest.approx(-4.0)
    assert np.abs(history[:, 2] - circle).max() < 0.5
    assert np.abs(history[:, 1]).max() < 0.5
