"""Checks whether speed and yaw rate in a message belong to the same moment as its pose.

They share one stamp even if they come from different programs: only the motion reveals that one of
them is late.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import uniform_filter1d

from .lags import lag_of_effect

__all__ = ["lag_of_speed", "lag_of_turning", "when"]

# The motion of the poses is measured over this time to both sides [s], in steps of this [s], if the
# poses come at least this often [s].
_REACH, _STEP, _BARE = 0.1, 0.02, 0.25
# Larger speeds and rates come from damaged files [m/s, rad/s].
_FASTEST = 1e3
# Lags up to the first [s] count as none. The smallest lags reported, late and early: filters cause
# smaller ones, and wheels that slip under acceleration seem early.
_NONE, _LATE, _EARLY = 0.02, 0.09, 0.11
# A short lag of slow changes costs little correlation, and here both signals are the same motion.
_BETTER = 0.003
# Largest share of the typical difference, averaged over this many steps, that remains at the lag.
_CLOSER, _SMOOTH = 0.8, 25


def lag_of_speed(
    t: np.ndarray, v: np.ndarray, at: np.ndarray, x: np.ndarray, y: np.ndarray
) -> float | None:
    """Lag of a measured speed behind the speed of the poses, if it is clear.

    Parameters
    ----------
    t, v : ndarray, shape (n,)
        Times [s], increasing, and speeds [m/s].
    at, x, y : ndarray, shape (k,)
        Times [s], increasing, and positions [m] without repetitions while the car drives.

    Returns
    -------
    float or None
        [s]; negative if it is earlier.
    """
    return _lag(t, v, at, [x, y], lambda x, y: np.hypot(x, y))


def lag_of_turning(t: np.ndarray, r: np.ndarray, at: np.ndarray, psi: np.ndarray) -> float | None:
    """Lag of a yaw rate [rad/s] behind the headings [rad], as `lag_of_speed`."""
    return _lag(t, r, at, [np.unwrap(psi)], lambda turned: turned)


def when(lag: float) -> str:
    """A lag of `lag_of_speed` in words."""
    return f"{abs(lag):.2f} s {'after' if lag > 0.0 else 'before'}"


def _lag(t, measured, at, poses, rate):
    if min(t.size, at.size) < 10 or not np.isfinite(measured).all():
        return None
    grid = np.arange(max(t[0], at[0]) + _REACH, min(t[-1], at[-1]) - _REACH, _STEP)
    if grid.size < 2:
        return None
    measured = np.clip(measured, -_FASTEST, _FASTEST)
    ahead, behind = ([np.interp(grid + by, at, p) for p in poses] for by in (_REACH, -_REACH))
    moved = rate(*(a - b for a, b in zip(ahead, behind))) / (2.0 * _REACH)
    next_one = np.clip(np.searchsorted(at, grid), 1, at.size - 1)
    moved[at[next_one] - at[next_one - 1] > _BARE] = math.nan
    moved = np.clip(moved, -_FASTEST, _FASTEST)
    # `lag_of_effect` holds a cause until the next: center each value on its time.
    held = grid - 0.5 * _STEP, np.interp(grid, t, measured)
    lag = lag_of_effect(*held, grid, moved, _NONE, -_NONE, _BETTER)
    if lag is None or -_LATE < lag < _EARLY:
        return None
    # A few outliers correlate with anything.
    known = np.isfinite(moved) & (grid - lag > t[0]) & (grid - lag < t[-1])
    now, then = (
        _typical(np.interp(grid[known] - by, t, measured) - moved[known]) for by in (0.0, lag)
    )
    return -lag if then < _CLOSER * now else None


def _typical(differences):
    differences = uniform_filter1d(differences, _SMOOTH)
    return float(np.median(np.abs(differences - np.median(differences))))
