"""L1 guidance: exact on circles, along the velocity vector, defined behind the car."""

import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from map_racing.control.guidance import LookaheadLaw, arc_to, bearing, lateral_acceleration
from map_racing.control.state import CarState

angles = st.floats(-math.pi, math.pi)


def car(psi=0.0, v_x=5.0, v_y=0.0, x=0.0, y=0.0):
    return CarState(0.0, x, y, psi, v_x, v_y, 0.0)


def test_lookahead_distance_is_the_papers_line_within_its_bounds():
    law = LookaheadLaw(m=0.15, q=0.3, minimum=0.6, maximum=2.0)
    assert law.distance(4.0) == 0.15 + 0.3 * 4.0
    assert law.distance(0.0) == law.distance(1.0) == 0.6
    assert law.distance(7.0) == law.distance(100.0) == 2.0


@settings(deadline=None)
@given(
    radius=st.floats(0.5, 50.0),
    share=st.floats(0.01, 1.0),
    speed=st.floats(0.51, 15.0),
    psi=angles,
    drift=st.floats(-1.0, 1.0),
    left=st.booleans(),
)
def test_on_a_circle_it_commands_its_centripetal_acceleration(
    radius, share, speed, psi, drift, left
):
    """From any lookahead distance up to a quarter circle, and with any sideslip.

    Above 0.5 m/s: below, the direction of motion is not trusted.
    """
    side = 1.0 if left else -1.0
    turn = 0.5 * math.pi * share
    chord = 2.0 * radius * math.sin(0.5 * turn)
    course = psi + drift
    x = 3.0 + chord * math.cos(course + side * 0.5 * turn)
    y = -2.0 + chord * math.sin(course + side * 0.5 * turn)
    state = car(psi, speed * math.cos(drift), speed * math.sin(drift), 3.0, -2.0)
    eta = bearing(state, x, y)
    assert eta == pytest.approx(side * 0.5 * turn, abs=1e-9)
    a_lat = lateral_acceleration(speed, math.hypot(x - 3.0, y + 2.0), eta)
    assert a_lat == pytest.approx(side * speed**2 / radius, rel=1e-9)


def test_the_angle_is_from_the_velocity_not_from_the_heading():
    """A car that points at the target but slides to the right of it must turn left."""
    state = car(psi=0.0, v_x=4.0, v_y=-4.0)
    assert bearing(state, 1.0, 0.0) == pytest.approx(0.25 * math.pi)
    assert bearing(state, 1.0, -1.0) == pytest.approx(0.0, abs=1e-15)


@settings(deadline=None)
@given(psi=st.floats(-50.0, 50.0), x=st.floats(-9.0, 9.0), y=st.floats(-9.0, 9.0))
def test_bearing_is_one_turn_at_most_and_points_there(psi, x, y):
    distance = math.hypot(x, y)
    assume(distance > 1e-3)
    eta = bearing(car(psi), x, y)
    assert -math.pi <= eta <= math.pi
    assert distance * math.cos(psi + eta) == pytest.approx(x, abs=1e-9)
    assert distance * math.sin(psi + eta) == pytest.approx(y, abs=1e-9)


@settings(deadline=None)
@given(eta=angles, speed=st.floats(0.1, 15.0), distance=st.floats(0.1, 10.0))
def test_the_law_is_odd_and_bounded(eta, speed, distance):
    a_lat = lateral_acceleration(speed, distance, eta)
    assert abs(a_lat) <= 2.0 * speed * speed / distance * (1.0 + 1e-15)
    if eta:
        assert lateral_acceleration(speed, distance, -eta) == -a_lat
        assert math.copysign(1.0, a_lat) == math.copysign(1.0, eta) or a_lat == 0.0


def test_points_behind_the_car_demand_the_most_to_their_side():
    most = 2.0 * 5.0**2 / 1.5
    for eta in (0.5 * math.pi, 0.75 * math.pi, 3.1, math.pi):
        assert lateral_acceleration(5.0, 1.5, eta) == pytest.approx(most, rel=1e-15)
        assert lateral_acceleration(5.0, 1.5, -eta) == pytest.approx(-most, rel=1e-15)
    # for points to the left, the demand never falls as the point moves backwards
    demands = [lateral_acceleration(5.0, 1.5, 0.01 * k) for k in range(315)]
    assert demands == sorted(demands)


def test_a_standing_car_is_taken_to_move_straight_ahead():
    assert bearing(car(psi=0.3, v_x=0.0), math.cos(0.3), math.sin(0.3)) == pytest.approx(0.0)


@pytest.mark.parametrize("direction", [0.5, 1.5, 2.5, math.pi, -2.0])
def test_noise_about_standstill_is_no_direction(direction):
    """A velocity of 5 cm/s is noise; it must not swing the steering from lock to lock."""
    state = car(v_x=0.05 * math.cos(direction), v_y=0.05 * math.sin(direction))
    assert bearing(state, 1.0, 0.0) == pytest.approx(0.0, abs=0.02)


def test_the_velocity_takes_over_smoothly_from_the_heading():
    drift, previous = 0.4, 0.0
    for k in range(1, 101):
        speed = 0.01 * k
        eta = -bearing(car(v_x=speed * math.cos(drift), v_y=speed * math.sin(drift)), 1.0, 0.0)
        assert previous <= eta + 1e-12 and eta - previous < 0.02
        previous = eta
    assert previous == pytest.approx(drift, abs=1e-12)


@pytest.mark.parametrize("eta", [-1.5, -0.4, -1e-9, 0.0, 1e-5, 0.7, 0.5 * math.pi])
def test_the_arc_is_the_circle_of_the_law(eta):
    """It ends in the point, with v^2 / R = a."""
    state, distance, speed = car(x=2.0, y=-1.0, psi=0.9, v_x=3.0, v_y=0.4), 1.3, math.hypot(3, 0.4)
    course = state.psi + math.atan2(state.v_y, state.v_x)
    x = state.x + distance * math.cos(course + eta)
    y = state.y + distance * math.sin(course + eta)
    points = arc_to(state.x, state.y, x, y, bearing(state, x, y), 101)
    assert points[0] == (state.x, state.y)
    assert points[-1] == pytest.approx((x, y), abs=1e-12)
    curvature = lateral_acceleration(speed, distance, eta) / speed**2
    offsets = [
        (py - state.y) * math.cos(course) - (px - state.x) * math.sin(course) for px, py in points
    ]
    ahead = [
        (px - state.x) * math.cos(course) + (py - state.y) * math.sin(course) for px, py in points
    ]
    # All points are 1/curvature away from the center, which is abreast of the car.
    for a, o in zip(ahead, offsets):
        assert curvature * (a * a + o * o) == pytest.approx(2.0 * o, abs=1e-9)


def test_the_arc_to_a_point_behind_is_a_half_circle_to_its_side():
    points = arc_to(0.0, 0.0, -1.0, 0.2, bearing(car(v_x=2.0), -1.0, 0.2), 51)
    distance = math.hypot(1.0, 0.2)
    assert points[-1] == pytest.approx((0.0, distance), abs=1e-12)
    assert max(p[0] for p in points) == pytest.approx(0.5 * distance, rel=1e-3)
