"""Doubts about a measured speed: in another unit, for a while, held, or of another moment."""

from __future__ import annotations

import numpy as np

from ..bags.twist import lag_of_speed, when
from .speed import CHORD_S, beyond_for_a_while, chords, fresh

__all__ = ["late_speed", "speed_doubts", "speed_warning"]

# Speed [m/s] of a car that drives; and how far the wheels may be off, typically: noise lengthens
# the motion of the poses a little.
_MOVING, _SLOWEST, _FASTEST = 0.5, 0.88, 1.1
# For a while, over so many chords, it may be off by more where the wheels slip; compared above a
# speed [m/s].
_WHILE, _SLIP, _DRIVES = 12, (0.65, 1.4), 1.0
# Over fewer chords, no slip explains such a ratio.
_SHORT, _NONSENSE = 2, (0.35, 2.5)
# A single speed this much above that of the poses around it, in times and m/s, is none.
_TOP_TIMES, _TOP_MORE = 2.0, 2.0
# If the speed is not late in all of a recording, it may be so in parts of this length [s].
_PART_S = 24.0
# A speed is held if it is the same for longer [s] while that of the poses varies by more [m/s].
_HELD_S, _VARIES = 0.8, 0.5


def speed_doubts(
    topic: str, t: np.ndarray, x: np.ndarray, y: np.ndarray, v: np.ndarray, begin: float, end: float
) -> list[str]:
    """All doubts about a measured speed; none where nothing measured it.

    Parameters
    ----------
    topic : str
        Name of the poses.
    t, x, y, v : ndarray, shape (n,)
        Times [s], positions [m], and measured speeds [m/s].
    begin, end : float
        Only the time between counts for speeds that are wrong for a while [s].
    """
    if not _is_measured(v):
        return []
    found = chords(t, x, y, v)
    doubts = [
        _not_the_motion(topic, *found)
        or _for_a_while(topic, t, v, begin, end, *found)
        or _held(topic, t, v, begin, end, *found[:2]),
        late_speed(topic, t, x, y, v),
    ]
    return [doubt for doubt in doubts if doubt]


def speed_warning(topic: str, t: np.ndarray, x: np.ndarray, y: np.ndarray, v: np.ndarray) -> str:
    """Doubt about a measured speed that is not the motion of the poses, as in km/h; or empty.

    Parameters
    ----------
    topic : str
        Name of the poses.
    t, x, y, v : ndarray, shape (n,)
        Times [s], positions [m], and measured speeds [m/s].
    """
    return _not_the_motion(topic, *chords(t, x, y, v)) if _is_measured(v) else ""


def late_speed(topic: str, t: np.ndarray, x: np.ndarray, y: np.ndarray, v: np.ndarray) -> str:
    """Doubt about a measured speed that is of another moment than its pose; or empty.

    Parameters as of `speed_warning`.
    """
    if not _is_measured(v):
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


def _is_measured(v):
    # Odometry whose velocity nobody fills in has 0 in it.
    return bool(np.isfinite(v).all() and v.any())


def _not_the_motion(topic, at, moved, measured):
    """Doubt about all of the speed, of what `chords` found."""
    moving = (moved > _MOVING) | (measured > _MOVING)
    if np.count_nonzero(moving) < 10:
        return ""
    with np.errstate(divide="ignore"):
        ratio = float(np.median(measured[moving] / moved[moving]))
    if _SLOWEST < ratio < _FASTEST:
        return ""
    hint = ": in km/h?" if abs(ratio / 3.6 - 1.0) < 0.1 else ""
    return f"{topic}: the measured speed is {ratio:.2f} times the motion of the poses{hint}"


def _for_a_while(topic, t, v, begin, end, at, moved, measured):
    """Doubt about a speed that is for a while, or once, not the motion of the poses."""
    within = (at > begin) & (at < end) & (np.maximum(moved, measured) > _DRIVES)
    with np.errstate(divide="ignore"):
        ratio = measured[within] / moved[within]
        found = beyond_for_a_while(at[within], ratio, _WHILE, *_SLIP)
        found = found or beyond_for_a_while(at[within], ratio, _SHORT, *_NONSENSE)
    if found:
        return (
            f"{topic}: from {found[0]:.1f} to {found[1]:.1f} s the measured speed is "
            f"{found[2]:.2f} times the motion of the poses"
        )
    if at.size < _WHILE:
        return ""
    around = np.max([np.roll(moved, k) for k in range(-3, 4)], axis=0)
    around = np.interp(t, at, around)
    near = np.abs(at[np.clip(np.searchsorted(at, t), 0, at.size - 1)] - t) < 2.0 * CHORD_S
    over = np.where((t > begin) & (t < end) & near, v - _TOP_TIMES * around - _TOP_MORE, 0.0)
    k = int(np.argmax(over))
    if over[k] <= 0.0:
        return ""
    return (
        f"{topic}: the measured speed reaches {v[k]:.1f} m/s at {t[k]:.1f} s, where the poses move "
        f"at {around[k]:.1f} m/s"
    )


def _held(topic, t, v, begin, end, at, moved):
    """Doubt about a speed that stays the same while the poses' varies."""
    begins = np.flatnonzero(np.append(True, np.diff(v) != 0.0))
    ends = np.append(begins[1:], v.size) - 1
    long = (t[ends] - t[begins] > _HELD_S) & (t[ends] > begin) & (t[begins] < end)
    for first, last in zip(t[begins[long]], t[ends[long]]):
        meanwhile = moved[(at > first) & (at < last)]
        if meanwhile.size > 2 and np.ptp(np.percentile(meanwhile, (10, 90))) > _VARIES:
            return (
                f"{topic}: from {first:.1f} to {last:.1f} s the measured speed stays the same, "
                "while that of the poses varies"
            )
    return ""
