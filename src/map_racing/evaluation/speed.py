"""Speed of a car from its poses, if it was not measured."""

from __future__ import annotations

import numpy as np

__all__ = [
    "CHORD_S",
    "MOVING_MPS",
    "REPEATED_M",
    "beyond_for_a_while",
    "chords",
    "fresh",
    "speed_of",
]

REPEATED_M = 1e-5
"""A pose within this distance [m] of the previous one, in x and y, repeats it except for
rounding."""

CHORD_S = 0.25
"""Usual length of a chord [s]."""

MOVING_MPS = 0.5
"""Below this speed a car starts, stops or stands."""

# Fewest chords, and longest time without new poses within a chord [s].
_FEWEST, _BARE = 40, 0.25
# A pose that repeats for longer than this [s] comes from a standing car.
_REPEATED = 0.25
# Times between samples vary if their typical deviation exceeds this share; differences then span
# this many samples to both sides.
_VARIED, _REACH = 0.15, 4
# Noise of the first share of a step lengthens the path by 0.1 %, and of the second share of a chord
# raises the top speed by 2 %; chords beyond this length [s] would cut corners.
_NOISY, _LITTLE, _LONGEST_CHORD = 0.012, 0.005, 0.2
# A car that moved farther [m] was not standing.
_MOVED = 1.0


def speed_of(t: np.ndarray, x: np.ndarray, y: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Measured speed or, where some of it is missing, the speed of the pose.

    Parameters
    ----------
    t, x, y, v : ndarray, shape (n,)
        Times [s], positions [m], and the speed measured [m/s], NaN where it is not known.

    Returns
    -------
    ndarray, shape (n,)
    """
    # Odometry whose velocity is never filled in contains 0.
    if np.isfinite(v).all() and (v.any() or np.hypot(np.ptp(x), np.ptp(y)) < _MOVED):
        return v
    # Repeated poses of a driving car, and stamps in bunches, would give arbitrary speeds: use only
    # the other samples.
    kept = fresh(t, x, y)
    kept = kept[_apart(t[kept])]
    speed = _differences(t[kept], x[kept], y[kept])
    return speed if kept.size == t.size else np.interp(t, t[kept], speed)


def chords(
    t: np.ndarray, x: np.ndarray, y: np.ndarray, v: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mean speeds over chords: pieces of time long enough that noise of the poses matters little.

    Parameters
    ----------
    t, x, y : ndarray, shape (n,)
        Times [s] and positions [m].
    v : ndarray, shape (n,), optional
        Measured speeds [m/s].

    Returns
    -------
    at, moved, measured : ndarray, shape (k,)
        Middles of the chords [s], straight-line speed of the poses, and mean measured speed [m/s].
    """
    usual = float(np.median(np.diff(t))) if t.size > 1 else CHORD_S
    # Times in another unit are too close together, or too far apart.
    chord = max(min(CHORD_S, (t[-1] - t[0]) / _FEWEST), 2.0 * usual)
    grid = np.arange(t[0], t[-1], chord)
    if grid.size < 2:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    moved = np.hypot(*(np.diff(np.interp(grid, t, values)) for values in (x, y))) / chord
    measured = np.zeros(moved.size)
    if v is not None:
        way = np.append(0.0, np.cumsum(0.5 * (v[1:] + v[:-1]) * np.diff(t)))
        measured = np.diff(np.interp(grid, t, way)) / chord
    new = t[fresh(t, x, y)]
    after = np.clip(np.searchsorted(new, grid), 1, new.size - 1)
    bare = new[after] - new[after - 1] > max(_BARE, 3.0 * usual)
    known = ~(bare[1:] | bare[:-1])
    return (grid[:-1] + 0.5 * chord)[known], moved[known], measured[known]


def beyond_for_a_while(
    at: np.ndarray, ratio: np.ndarray, size: int, low: float, high: float
) -> tuple[float, float, float] | None:
    """Time span in which a ratio is mostly outside of limits.

    Parameters
    ----------
    at, ratio : ndarray, shape (k,)
        Times [s] and ratios of `chords`.
    size : int
        Number of chords that count together.
    low, high : float
        Limits.

    Returns
    -------
    (begin, end, ratio) or None
        First and last time [s], and the median ratio.
    """
    bad = np.zeros(at.size, dtype=bool)
    for first in (0, size // 2):
        count = (at.size - first) // size
        part = slice(first, first + count * size)
        middle = np.median(ratio[part].reshape(count, size), axis=1) if count else np.zeros(0)
        # Missing chords would make the span longer.
        together = np.ptp(at[part].reshape(count, size), axis=1) < 1.5 * size * CHORD_S
        bad[part] |= np.repeat(~((middle > low) & (middle < high)) & together, size)
    bad &= ~((ratio > low) & (ratio < high))
    if not bad.any():
        return None
    return float(at[bad][0]), float(at[bad][-1]), float(np.median(ratio[bad]))


def _differences(t, x, y):
    """Distance per time from the previous sample to the next.

    Its mean over time is then the total distance per time. If the times between samples vary, as
    with stamps given on receipt, differences span more samples. If the poses are noisy, which would
    lengthen the path, the path is replaced by chords.
    """
    steps = np.diff(t)
    usual = float(np.median(steps))
    varied = float(np.median(np.abs(steps - usual))) > _VARIED * usual
    reach = _REACH if varied else 1
    way = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y))))
    index = np.arange(t.size)
    noisy = _noisy_reach(x, y, usual)
    if noisy:
        chord = np.maximum(noisy, 2 * reach)
        ends = np.arange(0, t.size, chord)
        ends = np.append(ends[:-1], t.size - 1) if ends.size > 1 else np.array([0, t.size - 1])
        line = np.hypot(np.diff(x[ends]), np.diff(y[ends]))
        way, reach = np.interp(t, t[ends], np.append(0.0, np.cumsum(line))), chord
    before, behind = np.maximum(index - reach, 0), np.minimum(index + reach, t.size - 1)
    return (way[behind] - way[before]) / (t[behind] - t[before])


def _noisy_reach(x, y, usual):
    """Samples per chord for which noise no longer lengthens the path; 0 without noise."""
    if x.size < 40:
        return 0
    # Third differences remove most of the driving and multiply noise by the square root of 20; the
    # median of their length is 5.3 times the standard deviation in each direction.
    noise = float(np.median(np.hypot(np.diff(x, 3), np.diff(y, 3)))) / 5.3
    step = float(np.median(np.hypot(np.diff(x), np.diff(y))))
    if step <= 0.0 or noise < _NOISY * step:
        return 0
    most = max(int(_LONGEST_CHORD / usual), 1)
    return min(int(np.ceil(noise / (_LITTLE * step))), most) if most > 1 else 0


def fresh(t: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Indices of samples whose pose is new, or has not changed for long.

    Parameters
    ----------
    t, x, y : ndarray, shape (n,)
        Times [s] and positions [m].
    """
    moved = np.append(True, (np.abs(np.diff(x)) > REPEATED_M) | (np.abs(np.diff(y)) > REPEATED_M))
    if moved.all():
        return np.arange(t.size)
    kept = [0]
    for index, (time, new) in enumerate(zip(t.tolist(), moved.tolist())):
        if new and index or time - t[kept[-1]] > _REPEATED:
            kept.append(index)
    return np.array(kept) if len(kept) > 1 else np.array([0, t.size - 1])


def _apart(t):
    """Indices of samples at the usual spacing; all if only the ends (crossings) are closer."""
    steps = np.diff(t[1:-1])
    bunched = 0.05 * float(np.mean(np.diff(t)))
    apart = steps[steps >= bunched]
    if apart.size in (0, steps.size):
        return np.arange(t.size)
    least = 0.9 * float(np.median(apart))
    kept = [1]
    for index, time in enumerate(t[:-1].tolist()):
        if time - t[kept[-1]] >= least:
            kept.append(index)
    if len(kept) < 2:
        return np.arange(t.size)
    # A crossing may cut a bunch, whose other part is then missing.
    return np.array(kept if len(kept) < 4 else kept[1:-1])
