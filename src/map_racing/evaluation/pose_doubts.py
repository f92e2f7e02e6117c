"""Warnings about poses: going back and forth, jumping sideways, rounded."""

from __future__ import annotations

import numpy as np

from .speed import fresh

__all__ = ["rounded", "set_aside", "to_and_fro"]

# Samples to both sides that give the direction; a step back is longer than this many times the
# usual scatter and than this share of a step; this many of them within this many samples count.
_AROUND, _SCATTER, _BACK, _STEPS, _WITHIN = 6, 8.0, 0.3, 2, 12
# Speed [m/s] of a car that drives.
_DRIVES = 1.0
# A sideways jump counts if it is longer [m], and this many times the usual one; this many steps to
# each side give the direction, if their times are equal within this share.
_ASIDE, _USUAL, _BESIDE, _EVEN = 0.2, 8.0, 3, 0.3
# Coarsest positions [m] that count as exact, and fewest different values.
_COARSE, _FEWEST = 0.02, 20


def to_and_fro(topic: str, t: np.ndarray, x: np.ndarray, y: np.ndarray) -> str:
    """Warning about poses that go back and forth along the path for a while; otherwise empty.

    This happens if all clocks were set back and the messages then sorted by them: poses from before
    and after alternate. A correction of the localization is just one step back.

    Parameters
    ----------
    topic : str
        Name of the poses.
    t, x, y : ndarray, shape (n,)
        Times [s] and positions [m].
    """
    if t.size < 4 * _AROUND:
        return ""
    step = np.stack([np.diff(x), np.diff(y)])[:, _AROUND:-_AROUND]
    way = np.stack([v[2 * _AROUND + 1 :] - v[: -2 * _AROUND - 1] for v in (x, y)])
    length = np.hypot(*way)
    spent = t[2 * _AROUND + 1 :] - t[: -2 * _AROUND - 1]
    drives = length > _DRIVES * spent
    if not drives.any():
        return ""
    along = np.sum(step * way, axis=0) / np.maximum(length, 1e-9)
    expected = length / (2 * _AROUND + 1)
    scatter = float(np.median(np.abs(along - expected)[drives]))
    least = np.maximum(_SCATTER * scatter, _BACK * expected)
    back = np.flatnonzero(drives & (along < -least))
    if back.size < _STEPS:
        return ""
    close = np.flatnonzero(back[_STEPS - 1 :] - back[: 1 - _STEPS] <= _WITHIN)
    if not close.size:
        return ""
    first = int(back[close[0]])
    return (
        f"{topic}: poses go back and forth along the path at {t[first + _AROUND]:.1f} s: was a "
        "clock "
        "set back, and the recording sorted by it? That lap is then too short"
    )


def set_aside(
    topic: str, t: np.ndarray, x: np.ndarray, y: np.ndarray, begin: float, end: float
) -> str:
    """Warning about poses that jump sideways, as a corrected localization does; otherwise empty.

    Parameters
    ----------
    topic : str
        Name of the poses.
    t, x, y : ndarray, shape (n,)
        Times [s] and positions [m].
    begin, end : float
        Only steps between these times count [s].
    """
    kept = fresh(t, x, y)
    steps = np.diff(np.stack([t, x, y])[:, kept])
    if steps.shape[1] < 10 * _BESIDE:
        return ""
    parts = [steps[:, k : steps.shape[1] - 2 * _BESIDE + k] for k in range(2 * _BESIDE + 1)]
    spent = np.stack([part[0] for part in parts])
    own = parts.pop(_BESIDE)
    others = np.mean(parts, axis=0)
    at = t[kept][_BESIDE : _BESIDE + others.shape[1]]
    # If poses are missing or stamps jitter, steps differ anyway.
    even = np.max(np.abs(spent - spent.mean(axis=0)), axis=0) < _EVEN * spent.mean(axis=0)
    drives = np.hypot(*others[1:]) > _DRIVES * others[0]
    counts = even & drives & (at > begin) & (at < end)
    if not counts.any():
        return ""
    beside = np.where(counts, np.hypot(*(own - others)[1:]), 0.0)
    worst = int(np.argmax(beside))
    if beside[worst] <= max(_ASIDE, _USUAL * float(np.median(beside[counts]))):
        return ""
    return (
        f"{topic}: at {at[worst]:.1f} s the poses jump sideways by {beside[worst]:.2f} m, as no "
        "car can: lap time and errors may be off by as much"
    )


def rounded(topic: str, x: np.ndarray, y: np.ndarray) -> str:
    """Warning about rounded positions, as in a table with one decimal; otherwise empty.

    Parameters
    ----------
    topic : str
        Name of the poses.
    x, y : ndarray, shape (n,)
        Positions [m].
    """
    coarse = []
    for values in (x, y):
        different = np.unique(np.round(values, 6))
        if different.size < _FEWEST:
            return ""
        coarse.append(float(np.min(np.diff(different))))
    if min(coarse) < _COARSE:
        return ""
    return f"{topic}: positions are rounded to {min(coarse):.2g} m: errors are no better than that"
