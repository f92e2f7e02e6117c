"""Doubts about a measured speed that is of another moment than its pose."""

from __future__ import annotations

import numpy as np

from ..bags.twist import lag_of_speed, when
from .speed import chords, fresh

__all__ = ["held_speed", "late_speed"]

# If the speed is not late in all of a recording, it may be so in parts of this length [s].
_PART_S = 24.0
# A speed is held if it is the same for longer [s] while that of the poses varies by more [m/s].
_HELD_S, _VARIES = 0.8, 0.5


def late_speed(topic: str, t: np.ndarray, x: np.ndarray, y: np.ndarray, v: np.ndarray) -> str:
    """Doubt about a measured speed that is of another moment than its pose; or empty.

    Parameters
    ----------
    topic : str
        Name of the poses.
    t, x, y, v : ndarray, shape (n,)
        Times [s], positions [m], and measured speeds [m/s].
    """
    if not (np.isfinite(v).all() and v.any()):
        return ""
    new = fresh(t, x, y)
    lag, of = lag_of_speed(t, v, t[new], x[new], y[new]), ""
    for begin in np.arange(t[0], t[-1] - _PART_S, 0.5 * _PART_S) if lag is None else ():
        part = (t >= begin) & (t < begin + _PART_S)
        known = new[part[new]]
        lag = lag_of_speed(t[part], v[part], t[known], x[known], y[known])
        if lag is not None:
            of = f"from {begin:.0f} to {begin + _PART_S:.0f} s "
            break
    if lag is None:
        return ""
    return (
        f"{topic}: {of}the measured speed comes {when(lag)} the motion of the poses: speeds at "
        "places, and speed errors, are those of another moment"
    )


def held_speed(
    topic: str, t: np.ndarray, x: np.ndarray, y: np.ndarray, v: np.ndarray, begin: float, end: float
) -> str:
    """Doubt about a measured speed that stays the same while the poses' varies; or empty.

    Parameters
    ----------
    topic : str
        Name of the poses.
    t, x, y, v : ndarray, shape (n,)
        Times [s], positions [m], and measured speeds [m/s].
    begin, end : float
        Only the time between counts [s].
    """
    if not (np.isfinite(v).all() and v.any()):
        return ""
    begins = np.flatnonzero(np.append(True, np.diff(v) != 0.0))
    ends = np.append(begins[1:], v.size) - 1
    long = (t[ends] - t[begins] > _HELD_S) & (t[ends] > begin) & (t[begins] < end)
    if not long.any():
        return ""
    at, moved, _ = chords(t, x, y)
    for first, last in zip(t[begins[long]], t[ends[long]]):
        meanwhile = moved[(at > first) & (at < last)]
        if meanwhile.size > 2 and np.ptp(np.percentile(meanwhile, (10, 90))) > _VARIES:
            return (
                f"{topic}: from {first:.1f} to {last:.1f} s the measured speed stays the same, "
                "while that of the poses varies"
            )
    return ""
