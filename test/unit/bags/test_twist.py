"""Speeds and yaw rates that lag or lead the poses in the same messages."""

import math

import numpy as np
import pytest

from map_racing.bags.twist import lag_of_speed, lag_of_turning, when

T = np.arange(0.0, 30.0, 0.02)


def way(t):
    """A car that drives 2.5 to 5.5 m/s."""
    return 4.0 * t - 1.2 / 1.3 * np.cos(1.3 * t) - 0.3 / 3.1 * np.cos(3.1 * t)


def speed(t):
    return 4.0 + 1.2 * np.sin(1.3 * t) + 0.3 * np.sin(3.1 * t)


def turned(t):
    return 0.7 * way(t) / 4.0 + 0.4 * np.sin(0.9 * t)


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("lag", [0.1, 0.14, 0.3, 1.0, 3.0, -0.14, -0.5])
def test_lags(lag, noise):
    rng = np.random.default_rng(1)
    x, y, v = (noise * rng.normal(size=T.size) for _ in range(3))
    found = lag_of_speed(T, speed(T - lag) + 2.0 * v, T, way(T) + x, y)
    assert found == pytest.approx(lag, abs=0.021)
    rate = np.gradient(turned(T - lag), T)
    found = lag_of_turning(T, rate + v, T, np.angle(np.exp(1j * (turned(T) + 0.2 * x))))
    assert found == pytest.approx(lag, abs=0.021)


@pytest.mark.parametrize("noise", [0.0, 0.02])
@pytest.mark.parametrize("lag", [0.0, 0.04, -0.06])
def test_what_filters_and_wheels_do_is_no_lag(lag, noise):
    rng = np.random.default_rng(1)
    x, y, v = (noise * rng.normal(size=T.size) for _ in range(3))
    assert lag_of_speed(T, speed(T - lag) + 2.0 * v, T, way(T) + x, y) is None
    # Wheels that slip by 10 % while the car accelerates by 5 m/s^2.
    slip = 1.0 + 0.02 * np.gradient(speed(T), T)
    assert lag_of_speed(T, slip * speed(T), T, way(T), y) is None


def test_nothing_is_said_of_what_does_not_tell():
    still = 0.0 * T
    rng = np.random.default_rng(1)
    assert lag_of_speed(T, 4.0 + 0.1 * rng.normal(size=T.size), T, 4.0 * T, still) is None
    assert lag_of_speed(T, still, T, still, still) is None
    assert lag_of_speed(T[:5], still[:5], T[:5], still[:5], still[:5]) is None
    assert lag_of_speed(T, np.full(T.size, math.nan), T, way(T), still) is None
    # Half of the poses are missing, at other times than the speeds.
    kept = np.flatnonzero((T % 4.0 < 2.0) | (T > 20.0))
    assert lag_of_speed(T, speed(T), T[kept] + 0.001, way(T[kept] + 0.001), still[kept]) is None


def test_words():
    assert when(0.3) == "0.30 s after" and when(-0.14) == "0.14 s before"
