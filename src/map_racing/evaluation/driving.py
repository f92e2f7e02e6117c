"""How well the drive followed its commands, and the quality of the poses, over a recording."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..bags.samples import Recording
from .lap_limits import LapLimits
from .speed import MOVING_MPS

__all__ = ["PoseTiming", "SpeedTracking", "pose_timing", "speed_tracking"]

# Largest lag tried [s], and step.
_LONGEST_LAG, _LAG_STEP = 0.6, 0.01
# Fewest samples.
_FEWEST = 50
# Speeds that vary less than this [m/s] show no lag.
_VARIED = 0.2


class SpeedTracking(NamedTuple):
    """How well the measured speed follows the commanded one, without standing.

    Attributes
    ----------
    lag_s : float
        Delay of the command that explains the speed best [s]; NaN if the speed hardly varies.
    rms_mps : float
        RMS of speed minus command [m/s].
    rms_lagged_mps : float
        RMS of speed minus the command delayed by the lag [m/s].
    overshoot_mps : float
        Excess over the delayed command that is itself exceeded 1 % of the time [m/s].
    undershoot_mps : float
        The same below it.
    """

    lag_s: float
    rms_mps: float
    rms_lagged_mps: float
    overshoot_mps: float
    undershoot_mps: float


class PoseTiming(NamedTuple):
    """Timing of the poses.

    Attributes
    ----------
    rate_hz : float
        Poses per second, without the gaps.
    longest_gap_s : float
        Longest time between two poses [s].
    gaps : int
        Number of times longer than `LapLimits.max_gap`.
    jumps : int
        Number of steps too long for the fastest car.
    largest_jump_m : float
        The longest of these [m]; 0 without any.
    age_s, oldest_s : float
        Median and 99th percentile of the time from stamp to receipt [s]; NaN if the stamps are from
        another clock or the file lacks either.
    """

    rate_hz: float
    longest_gap_s: float
    gaps: int
    jumps: int
    largest_jump_m: float
    age_s: float
    oldest_s: float


def speed_tracking(recording: Recording) -> SpeedTracking | None:
    """Speed tracking in a recording.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    SpeedTracking or None
        None without commands, without measured speed or with little driving.
    """
    commands, t, v = recording.commands, recording.t, recording.v_x
    if commands is None or not commands.t.size:
        return None
    now = commands.held(t, commands.speed)
    before = commands.held(t - _LONGEST_LAG, commands.speed)
    with np.errstate(invalid="ignore"):  # numpy 1.17 warns of NaN
        driven = np.minimum(np.minimum(np.abs(v), now), before) > MOVING_MPS
    if np.count_nonzero(driven) < _FEWEST:
        return None
    t, v, now = t[driven], v[driven], now[driven]
    lag, lagged = math.nan, now
    if np.ptp(now) > _VARIED:
        lags = np.arange(0.0, _LONGEST_LAG + _LAG_STEP, _LAG_STEP)
        delayed = [commands.held(t - lag, commands.speed) for lag in lags]
        errors = [float(np.mean((v - command) ** 2)) for command in delayed]
        best = int(np.argmin(errors))
        lag, lagged = _vertex(lags, errors, best), delayed[best]
    above = v - lagged
    return SpeedTracking(
        lag,
        math.sqrt(float(np.mean((v - now) ** 2))),
        math.sqrt(float(np.mean(above**2))),
        max(float(np.percentile(above, 99)), 0.0),
        max(float(-np.percentile(above, 1)), 0.0),
    )


def _vertex(x, y, i):
    """Place of the minimum, from a parabola through the lowest value and its neighbors."""
    if not 0 < i < len(x) - 1:
        return float(x[i])
    left, low, right = y[i - 1 : i + 2]
    curve = left - 2.0 * low + right
    return float(x[i] + (0.5 * (left - right) / curve * _LAG_STEP if curve > 0.0 else 0.0))


def pose_timing(recording: Recording, limits: LapLimits | None = None) -> PoseTiming:
    """Rate, gaps, jumps and ages of the poses of a recording.

    Parameters
    ----------
    recording : Recording
    limits : LapLimits, optional

    Returns
    -------
    PoseTiming
    """
    limits = limits or LapLimits()
    between = np.diff(recording.t)
    # Not the median: if times alternate, it is one of the two.
    gaps = limits.is_gap(between)
    usual = between[~gaps]
    moved = np.hypot(np.diff(recording.x), np.diff(recording.y))
    jumped = moved > limits.max_speed * between + limits.jump_margin
    age = oldest = math.nan
    clock = recording.clock
    if clock is not None and not clock.use_receipt and clock.lag.size:
        lag = 1e-9 * clock.lag
        age, oldest = float(np.median(lag)), float(np.percentile(lag, 99))
        # Stamps from another clock do not show the age; nor do stamps that are times of receipt
        # (lag 0).
        if not 0.0 < age < 1.0:
            age = oldest = math.nan
    return PoseTiming(
        float(1.0 / np.mean(usual if usual.size else between)),
        float(between.max()),
        int(np.count_nonzero(gaps)),
        int(np.count_nonzero(jumped)),
        float(moved[jumped].max()) if jumped.any() else 0.0,
        age,
        oldest,
    )
