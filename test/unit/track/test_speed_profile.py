"""Speed profiles against closed-form answers and the physics they stand for."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.errors import ParameterError
from map_racing.track.speed_profile import lap_time, speed_profile

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
    assert speed[50] == 2.0
    # At the slow point itself all grip is lateral: the car accelerates from the next one.
    drive = np.minimum(np.sqrt(4.0 + 2.0 * 6.0 * way), 9.0)
    brake = np.minimum(np.sqrt(4.0 + 2.0 * 8.0 * way), 9.0)
    np.testing.assert_allclose(speed[51:111], drive, rtol=1e-12)
    np.testing.assert_allclose(np.roll(speed, 100)[149:89:-1], brake, rtol=1e-12)


@settings(deadline=None, max_examples=100)
@given(st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=60), st.floats(0.02, 0.5))
def test_no_point_leaves_the_friction_ellipse_and_each_reaches_a_limit(kappa, ds):
    kappa = np.array(kappa)
    square = speed_profile(kappa, ds, **LIMITS) ** 2
    a_long = (np.roll(square, -1) - square) / (2.0 * ds)
    use = np.abs(kappa) * square / 10.0
    assert np.all(use <= 1.0 + 1e-12)
    assert np.all(square <= 81.0 + 1e-9)
    left = np.sqrt(np.maximum(1.0 - use**2, 0.0))
    assert np.all(a_long <= 6.0 * left + 1e-6)
    assert np.all(-a_long <= 8.0 * np.roll(left, -1) + 1e-6)
    at_limit = (
        (use >= 1.0 - 1e-9)
        | (square >= 81.0 - 1e-9)
        | (np.roll(a_long, 1) >= 6.0 * np.roll(left, 1) - 1e-6)
        | (-a_long >= 8.0 * np.roll(left, -1) - 1e-6)
    )
    assert np.all(at_limit)


@settings(deadline=None, max_examples=50)
@given(st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=60), st.integers(0, 59))
def test_the_start_line_does_not_matter(kappa, shift):
    speed = speed_profile(np.roll(kappa, shift), 0.1, **LIMITS)
    np.testing.assert_allclose(
        speed, np.roll(speed_profile(kappa, 0.1, **LIMITS), shift), rtol=1e-12
    )


def test_lap_time():
    assert lap_time(np.full(50, 4.0), 0.2) == pytest.approx(2.5, abs=1e-12)
    # 1 to 3 m/s and back at constant acceleration takes the way over the mean speed.
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
