"""Warnings about a measured speed: in another unit, wrong for a while, frozen, or late."""

from __future__ import annotations

import numpy as np

from ..bags.twist import lag_of_speed, when
from .speed import CHORD_S, MOVING_MPS, beyond_for_a_while, chords, fresh

__all__ = ["is_measured", "late_speed", "speed_doubts", "speed_warning"]

# Usual limits of measured speed over motion of the poses, which noise lengthens a little.
_SLOWEST, _FASTEST = 0.88, 1.1
# Wider limits where the wheels slip for a while, over this many chords; compared only above this
# speed [m/s].
_WHILE, _SLIP, _DRIVES = 12, (0.65, 1.4), 1.0
# Limits that no slip explains, over this many chords.
_SHORT, _NONSENSE = 2, (0.35, 2.5)
# A single speed that exceeds the poses' speed around it by this factor and this much more [m/s] is
# nonsense.
_TOP_TIMES, _TOP_MORE = 2.0, 2.0
# A speed that is not late in the whole recording may be late in parts of this length [s].
_PART_S = 24.0
# A speed is frozen if it stays the same for longer [s] while the poses' speed varies by more [m/s].
_HELD_S, _VARIES = 0.8, 0.5


def speed_doubts(
    topic: str,
    t: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
    v: np.ndarray,
    found: tuple[np.ndarray, np.ndarray, np.ndarray],
    begin: float,
    end: float,
) -> list[str]:
    """All warnings about a measured speed; none without one.

    Parameters
    ----------
    topic : str
        Name of the poses.
    t, x, y, v : ndarray, shape (n,)
        Times [s], positions [m], and measured speeds [m/s].
    found : tuple
        The `chords` of them.
    begin, end : float
        Speeds that are wrong for a while count only between these times [s].
    """
    if not is_measured(v):
        return []
    doubts = [
        _not_the_motion(topic, *found)
        or _for_a_while(topic, t, v, begin, end, *found)
        or _held(topic, t, v, begin, end, *found[:2]),
        late_speed(topic, t, x, y, v),
    ]
    return [doubt for doubt in doubts if doubt]


def speed_warning(topic: str, t: np.ndarray, x: np.ndarray, y: np.ndarray, v: np.ndarray) -> str:
    """Warning that a measured speed does not match the poses, as in km/h; otherwise empty.

    Parameters as of `speed_doubts`.
    """
    return _not_the_motion(topic, *chords(t, x, y, v)) if is_measured(v) else ""


def late_speed(topic: str, t: np.ndarray, x: np.ndarray, y: np.ndarray, v: np.ndarray) -> str:
    """Warning that a measured speed is late or early for its pose; otherwise empty.

    Parameters as of `speed_doubts`.
    """
    if not is_measured(v):
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
        "places, and speed errors, belong to another moment"
    )


def is_measured(v: np.ndarray) -> bool:
    """Whether speeds [m/s] were measured."""
    # Odometry whose velocity is never filled in contains 0.
    return bool(np.isfinite(v).all() and v.any())


def _not_the_motion(topic, at, moved, measured):
    """Warning about the whole speed, from the results of `chords`."""
    moving = (moved > MOVING_MPS) | (measured > MOVING_MPS)
    if np.count_nonzero(moving) < 10:
        return ""
    with np.errstate(divide="ignore"):
        ratio = float(np.median(measured[moving] / moved[moving]))
    if _SLOWEST < ratio < _FASTEST:
        return ""
    hint = ": in km/h?" if abs(ratio / 3.6 - 1.0) < 0.1 else ""
    return f"{topic}: the measured speed is {ratio:.2f} times the motion of the poses{hint}"


def _for_a_while(topic, t, v, begin, end, at, moved, measured):
    """Warning about a speed that does not match the poses for a while, or once."""
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
    """Warning about a speed that stays the same while the poses' speed varies."""
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
