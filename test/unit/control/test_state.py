"""States in space and time: exact arcs, rigid bodies."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from map_racing.control.state import CarState, moved, predicted

states = st.builds(
    CarState,
    t=st.floats(0.0, 100.0),
    x=st.floats(-20.0, 20.0),
    y=st.floats(-20.0, 20.0),
    psi=st.floats(-7.0, 7.0),
    v_x=st.floats(-2.0, 15.0),
    v_y=st.floats(-3.0, 3.0),
    r=st.floats(-8.0, 8.0),
)
horizons = st.floats(-0.2, 0.5)


@settings(deadline=None, max_examples=30)
@given(state=states, horizon=st.floats(0.001, 0.5))
def test_prediction_equals_integration_at_constant_body_velocity(state, horizon):
    def right_hand_side(_, pose):
        cosine, sine = math.cos(pose[2]), math.sin(pose[2])
        return [
            state.v_x * cosine - state.v_y * sine,
            state.v_x * sine + state.v_y * cosine,
            state.r,
        ]

    solution = solve_ivp(
        right_hand_side, (0.0, horizon), [state.x, state.y, state.psi], rtol=1e-11, atol=1e-12
    )
    ahead = predicted(state, horizon)
    assert [ahead.x, ahead.y, ahead.psi] == pytest.approx(solution.y[:, -1].tolist(), abs=1e-8)
    assert ahead.t == state.t + horizon
    assert ahead[4:] == state[4:]


def test_a_half_circle_ends_on_the_other_side():
    """v = 2 m/s and r = 4 rad/s make a circle of 0.5 m radius."""
    ahead = predicted(CarState(1.0, 3.0, 4.0, 0.0, 2.0, 0.0, 4.0), 0.25 * math.pi)
    assert ahead[:4] == pytest.approx((1.0 + 0.25 * math.pi, 3.0, 5.0, math.pi), abs=1e-12)


@settings(deadline=None)
@given(state=states)
def test_no_horizon_no_change(state):
    assert predicted(state, 0.0) == state


@settings(deadline=None)
@given(state=states, first=horizons, second=horizons)
def test_predictions_add_up(state, first, second):
    together = predicted(state, first + second)
    assert predicted(predicted(state, first), second) == pytest.approx(together, abs=1e-11)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_straight_ahead_joins_the_arcs_without_a_step(sign):
    """Around the yaw rate where the series takes over from the sine."""
    below, above = (
        predicted(CarState(0.0, 0.0, 0.0, 0.7, 10.0, -1.0, sign * r), 1.0)
        for r in (2e-4 * (1.0 - 1e-9), 2e-4 * (1.0 + 1e-9))
    )
    assert below == pytest.approx(above, abs=1e-11)


@settings(deadline=None)
@given(state=states, distance=st.floats(-0.5, 0.5))
def test_moving_there_and_back(state, distance):
    assert moved(moved(state, distance), -distance) == pytest.approx(state, abs=1e-13)


def test_the_center_of_gravity_of_a_turning_car_moves_outward_of_its_rear_axle():
    axle = CarState(0.0, 1.0, 2.0, 0.5 * math.pi, 3.0, 0.0, 2.0)
    assert moved(axle, 0.15) == pytest.approx((0.0, 1.0, 2.15, 0.5 * math.pi, 3.0, 0.3, 2.0))


@settings(deadline=None)
@given(state=states, distance=st.floats(-0.5, 0.5), horizon=horizons)
def test_all_points_of_a_rigid_body_are_predicted_alike(state, distance, horizon):
    there = moved(predicted(state, horizon), distance)
    assert predicted(moved(state, distance), horizon) == pytest.approx(there, abs=1e-11)
