"""Speed profiles compared with closed-form solutions and physics."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.errors import ParameterError
from map_racing.track.raceline import Raceline
from map_racing.track.speed_profile import lap_time, raceline_speeds, speed_profile
from map_racing.vehicle.grids import default_grid
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.steady_state import steady_state_table

LIMITS = {"a_lat_max": 10.0, "a_drive_max": 6.0, "a_brake_max": 8.0, "v_max": 9.0}


def test_circle_is_driven_at_the_lateral_limit():
    speed = speed_profile(np.full(100, 0.5), 0.1, **LIMITS)
    np.testing.assert_allclose(speed, math.sqrt(10.0 / 0.5), rtol=1e-12)
    np.testing.assert_allclose(speed_profile(np.full(100, -0.5), 0.1, **LIMITS), speed)


def test_straight_is_driven_at_top_speed():
    np.testing.assert_array_equal(speed_profile(np.zeros(10), 1.0, **LIMITS), np.full(10, 9.0))


def test_out_of_and_into_a_slow_point_at_constant_acceleration():
    kappa = np.zeros(400)
    kappa[50] = 10.0 / 2.0**2
    speed = speed_profile(kappa, 0.1, **LIMITS)
    way = 0.1 * np.arange(60)
    # The cells on both sides of the slow point have its curvature, and use all their grip
    # laterally.
    np.testing.assert_allclose(speed[49:52], 2.0, rtol=1e-12)
    drive = np.minimum(np.sqrt(4.0 + 2.0 * 6.0 * way), 9.0)
    brake = np.minimum(np.sqrt(4.0 + 2.0 * 8.0 * way), 9.0)
    np.testing.assert_allclose(speed[51:111], drive, rtol=1e-12)
    np.testing.assert_allclose(np.roll(speed, 100)[149:89:-1], brake, rtol=1e-12)


def power(v):
    return np.minimum(6.0, 30.0 / np.maximum(v, 1e-6))


SPEED_DEPENDENT = {
    "a_lat_max": lambda v: np.minimum(v**2 / 0.45, 10.0 - 0.2 * v),
    "a_drive_max": power,
    "a_brake_max": lambda v: 8.0 - 0.1 * v,
    "v_max": 9.0,
}
BOTH = pytest.mark.parametrize("limits", [LIMITS, SPEED_DEPENDENT], ids=["constant", "of speed"])
CURVATURES = st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=60)


def value(limit, v):
    return limit(v) if callable(limit) else np.full(np.shape(v), limit)


def grip_used(kappa, square, a_long, limits):
    """Share of the friction ellipse in use, at most 1 within the limits."""
    v = np.sqrt(square)
    along = np.where(
        a_long > 0.0,
        a_long / value(limits["a_drive_max"], v),
        -a_long / value(limits["a_brake_max"], v),
    )
    return np.hypot(np.abs(kappa) * square / value(limits["a_lat_max"], v), along)


@pytest.mark.once
@BOTH
@settings(deadline=None, max_examples=60)
@given(CURVATURES, st.floats(0.02, 0.5))
def test_nowhere_are_the_limits_exceeded_not_between_the_points_either(limits, kappa, ds):
    kappa = np.array(kappa)
    square = speed_profile(kappa, ds, **limits) ** 2
    a_long = (np.roll(square, -1) - square) / (2.0 * ds)
    assert np.all(square <= 81.0 * (1.0 + 1e-12))
    for part in np.linspace(0.0, 1.0, 21):
        between = square + part * (np.roll(square, -1) - square)
        bend = kappa + part * (np.roll(kappa, -1) - kappa)
        assert np.all(grip_used(bend, between, a_long, limits) <= 1.0 + 1e-6)


@pytest.mark.once
@BOTH
@settings(deadline=None, max_examples=60)
@given(CURVATURES, st.floats(0.02, 0.5))
def test_no_point_can_be_faster(limits, kappa, ds):
    """Raising any one speed a little breaks the top speed or the bound of a cell beside it."""
    kappa = np.abs(kappa)
    speed = speed_profile(kappa, ds, **limits)
    cell = np.maximum(kappa, np.roll(kappa, -1))

    def broken(k, square):
        """Whether cell k violates its bound: its higher curvature at its higher speed."""
        ends = square[k], square[(k + 1) % square.size]
        a_long = np.array([(ends[1] - ends[0]) / (2.0 * ds)])
        return grip_used(cell[k], np.array([max(ends)]), a_long, limits)[0] > 1.0

    for k in range(speed.size):
        faster = speed.copy()
        faster[k] *= 1.0 + 1e-4
        assert faster[k] > 9.0 or broken(k - 1, faster**2) or broken(k, faster**2)


@pytest.mark.once
@settings(deadline=None, max_examples=30)
@given(CURVATURES, st.lists(st.floats(1.0, 3.0), min_size=60, max_size=60), st.floats(0.02, 0.5))
def test_a_profile_within_lower_limits_is_nowhere_faster(kappa, slower, ds):
    """The profile is the fastest at all points: nothing within the bounds is faster anywhere."""
    kappa = 0.3 * np.abs(kappa)
    below = speed_profile(kappa * np.array(slower[: kappa.size]), ds, **SPEED_DEPENDENT)
    assert np.all(below <= speed_profile(kappa, ds, **SPEED_DEPENDENT) * (1.0 + 1e-9))


def test_shorter_cells_come_to_the_exact_solution():
    """Out of a bend of 1/s curvature: dq/ds = 2 a sqrt(1 - (q kappa / a_lat)^2), integrated."""
    times = []
    for parts in (1, 2, 4, 8, 16):
        s = np.arange(200 * parts) * 0.1 / parts
        kappa = 1.5 * np.exp(-(((s - 10.0) / 1.5) ** 2))
        times.append(lap_time(speed_profile(kappa, 0.1 / parts, **LIMITS), 0.1 / parts))
    steps = -np.diff(times)
    assert np.all(steps > 0.0) and steps[-1] < 1e-3 * times[-1]
    # First order: half the cells' length, half the loss.
    np.testing.assert_allclose(steps[1:] / steps[:-1], 0.5, atol=0.1)


def test_the_table_of_the_car_is_used_to_its_limit_and_not_beyond():
    vehicle = load_vehicle("nuc4")
    table = steady_state_table(vehicle, *default_grid(vehicle))
    for radius in (0.8, 1.0, 2.0, 5.0, 20.0):
        speed = speed_profile(
            np.full(8, 1.0 / radius),
            0.1,
            a_lat_max=table.max_lateral_acceleration,
            a_drive_max=vehicle.a_max,
            a_brake_max=vehicle.a_brake_max,
            v_max=vehicle.v_max,
        )
        v = float(speed[0])
        assert v**2 / radius == pytest.approx(table.max_lateral_acceleration(v), rel=2e-5)
        assert not table.steering(v, v**2 / radius * (1.0 - 1e-9))[1]


def test_a_bend_tighter_than_the_car_can_steer_is_named():
    kappa = np.full(50, 0.1)
    kappa[20] = 2.5
    with pytest.raises(
        ParameterError, match=r"s = 2\.00 m: the car cannot steer a radius of 0\.400 m"
    ):
        speed_profile(kappa, 0.1, **SPEED_DEPENDENT)


def test_tighter_bends_than_a_least_speed_allows_are_driven_at_it():
    kappa = np.full(50, 0.1)
    kappa[20] = 2.5
    speed = speed_profile(kappa, 0.1, **SPEED_DEPENDENT, v_min=1.0)
    assert speed[20] == pytest.approx(1.0, rel=1e-3) and speed.min() == speed[19:22].min()
    kappa[20] = 0.5
    with_least = speed_profile(kappa, 0.1, **SPEED_DEPENDENT, v_min=1.0)
    np.testing.assert_array_equal(with_least, speed_profile(kappa, 0.1, **SPEED_DEPENDENT))


def test_from_rest_in_a_bend_tighter_than_the_least_speed_allows():
    """Up to that speed the lateral share is v^2 / v_min^2: d(v^2)/ds = 2 a sqrt(1 - v^4)."""
    ds = 5e-4
    s, kappa = ds * np.arange(400), np.full(400, 1.2)
    v_max = np.where(s > 0.0, 9.0, 0.0)

    def with_grip(most):
        limits = {"a_lat_max": lambda v: np.minimum(v**2 / 0.7, most), "v_max": v_max}
        return speed_profile(kappa, ds, **{**SPEED_DEPENDENT, **limits}, v_min=1.0)

    less, more = with_grip(0.8), with_grip(1.3)  # only with 0.8 the bend is too tight for 1 m/s
    begin = s < 0.1
    np.testing.assert_allclose(less[begin] ** 2, np.sin(2.0 * 6.0 * s[begin]), atol=5e-3)
    assert np.all(less <= more + 1e-12) and less.max() <= 1.0 < more.max()


@pytest.mark.once
@BOTH
@settings(deadline=None, max_examples=40)
@given(CURVATURES, st.lists(st.floats(0.0, 9.0), min_size=60, max_size=60), st.floats(0.02, 0.5))
def test_top_speeds_of_places(limits, kappa, v_max, ds):
    """Nowhere above them, within the other limits in between, and slower than without."""
    kappa = 0.5 * np.abs(kappa)
    v_max = np.array(v_max[: kappa.size])
    v_max[0] = max(v_max[0], 0.1)
    speed = speed_profile(kappa, ds, **{**limits, "v_max": v_max})
    assert np.all(speed <= v_max * (1.0 + 1e-12))
    a_long = (np.roll(speed, -1) ** 2 - speed**2) / (2.0 * ds)
    assert a_long.max() <= 6.0 * (1.0 + 1e-6) and a_long.min() >= -8.0 * (1.0 + 1e-6)
    free = speed_profile(kappa, ds, **limits)
    assert np.all(speed <= free * (1.0 + 1e-3))
    same = speed_profile(kappa, ds, **{**limits, "v_max": np.full(kappa.size, 9.0)})
    np.testing.assert_array_equal(same, free)


@pytest.mark.parametrize("v_max", [[9.0], [9.0, -1.0, 9.0], [0.0, 0.0, 0.0], [9.0, math.nan, 9.0]])
def test_impossible_top_speeds_are_named(v_max):
    with pytest.raises(ParameterError, match="v_max"):
        speed_profile([0.1, 0.1, 0.1], 0.1, **{**LIMITS, "v_max": v_max})


def test_speed_at_which_the_power_is_used_up():
    drag = {**LIMITS, "a_drive_max": lambda v: np.maximum(6.0 - v, 0.0), "v_max": 9.0}
    kappa = np.zeros(2000)
    kappa[0] = 10.0
    speed = speed_profile(kappa, 0.1, **drag)
    assert speed.max() == pytest.approx(6.0, abs=0.01)


def test_profile_of_a_raceline_hardly_depends_on_its_cells():
    angle = np.linspace(0.0, 2.0 * math.pi, 400, endpoint=False)
    radius = 5.0 + np.cos(3.0 * angle)
    times = []
    for take in (1, 2):
        line = Raceline((radius * np.cos(angle))[::take], (radius * np.sin(angle))[::take])
        speed, time = raceline_speeds(line, **LIMITS)
        assert speed.shape == line.s.shape
        assert lap_time(speed, line.ds) == pytest.approx(time, rel=2e-3)
        times.append(time)
    assert times[1] == pytest.approx(times[0], rel=1e-3)


@pytest.mark.parametrize("bad", [lambda v: -v, lambda v: v * math.nan, lambda v: 3.0])
def test_impossible_limits_of_speed_are_named(bad):
    with pytest.raises(ParameterError, match="a_brake_max"):
        speed_profile([0.1, 0.2], 0.1, **{**LIMITS, "a_brake_max": bad})


@settings(deadline=None, max_examples=50)
@given(st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=60), st.integers(0, 59))
def test_the_start_line_does_not_matter(kappa, shift):
    speed = speed_profile(np.roll(kappa, shift), 0.1, **LIMITS)
    np.testing.assert_allclose(
        speed, np.roll(speed_profile(kappa, 0.1, **LIMITS), shift), rtol=1e-12
    )


def test_lap_time():
    assert lap_time(np.full(50, 4.0), 0.2) == pytest.approx(2.5, abs=1e-12)
    # From 1 to 3 m/s and back at constant acceleration takes distance over mean speed.
    assert lap_time([1.0, 3.0], 5.0) == pytest.approx(5.0, abs=1e-12)
    assert lap_time([0.0, 3.0, 3.0], 5.0) < math.inf
    assert lap_time([0.0, 0.0, 3.0], 5.0) == math.inf


@pytest.mark.parametrize("key", ["a_lat_max", "a_drive_max", "a_brake_max", "v_max"])
@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf])
def test_impossible_limits_are_named(key, bad):
    with pytest.raises(ParameterError, match=f"expected {key} > 0"):
        speed_profile([0.1, 0.2], 0.1, **{**LIMITS, key: bad})


@pytest.mark.parametrize("kappa", [[], [0.1, math.nan], [[0.1]]])
def test_impossible_curvature(kappa):
    with pytest.raises(ParameterError, match="finite curvature"):
        speed_profile(kappa, 0.1, **LIMITS)


def test_a_car_without_drive_at_top_speed_starts_from_rest():
    """The limits of a cell are first read at its top speed, where this drive has no force."""

    def drive(v):
        return np.maximum(5.0 * (1.0 - v / 10.0), 0.0)

    v_max = np.full(50, 10.0)
    v_max[0] = 0.0
    limits = {"a_lat_max": 5.0, "a_drive_max": drive, "a_brake_max": 5.0}
    speed = speed_profile(np.zeros(50), 0.5, v_max=v_max, **limits)
    # Constant acceleration over the cell, with the drive's value at its end: v^2 = 2 ds drive(v).
    assert speed[1] ** 2 == pytest.approx(float(drive(speed[1])), rel=1e-3)
