"""Checks the order of points of a closed line: several loops, overlapping ends, reversals."""

from __future__ import annotations

import math

import numpy as np

from ..angles import wrap

__all__ = ["BACK", "LARGEST_GAP", "first_loop", "overlap", "turns", "turns_back"]

LARGEST_GAP = 3.0  # from the last point to the first, in median distances
BACK = 2.1  # no track turns by this much at one point [rad]


def first_loop(xy: np.ndarray) -> tuple[int, int] | None:
    """Find where the second of several loops begins.

    Several loops are either separate closed stretches, or repeated laps of one track in the same
    direction.

    Parameters
    ----------
    xy : ndarray, shape (n_points, 2)
        Distinct points of a closed track [m].

    Returns
    -------
    end, loops : int or None
        First point of the second loop, and the number of loops, rounded, at least 2. None for a
        single loop.
    """
    if len(xy) < 8:
        return None
    ways = np.roll(xy, -1, axis=0) - xy
    chords = np.hypot(ways[:, 0], ways[:, 1])
    return _separate_loops(xy, chords) or _repeated_laps(xy, ways, chords)


def _separate_loops(xy, chords):
    """End of the first of several closed stretches far apart, and their number."""
    usual = float(np.median(chords))
    ends = np.flatnonzero(chords[:-1] > 10.0 * usual) + 1
    if not ends.size:
        return None
    bounds = [0, *ends.tolist(), len(xy)]
    pieces = [xy[a:b] for a, b in zip(bounds, bounds[1:])]
    closed = (
        len(piece) >= 4 and np.hypot(*(piece[-1] - piece[0])) <= LARGEST_GAP * usual
        for piece in pieces
    )
    return (bounds[1], len(pieces)) if all(closed) else None


def _repeated_laps(xy, ways, chords):
    """End of the first of several laps, and their number.

    Laps are repeated if many points have a much later one beside them that runs the same way. The
    start and end of a single lap and points in a wrong order are excluded.
    """
    n = len(xy)
    back = turns_back(xy)
    if np.any((back > 0) & (back < n - 1)):
        return None
    pick = np.unique(np.linspace(0, n - 1, min(n, 1000)).astype(int))
    test = np.linspace(0, pick.size - 1, min(pick.size, 60)).astype(int)
    s = np.cumsum(chords) - chords
    length, picked = float(chords.sum()), xy[pick]
    units = ways[pick] / chords[pick][:, None]
    wide = min(0.5, 0.05 * float(np.hypot(*np.ptp(xy, axis=0))))
    near = min(max(wide, 2.0 * length / pick.size), 0.04 * length)
    lag = np.abs(s[pick] - s[pick][test][:, None])
    beside = (
        (np.abs(picked[:, 0] - picked[test][:, :1]) < near)
        & (np.abs(picked[:, 1] - picked[test][:, 1:]) < near)
        & (units[test].dot(units.T) > 0.8)
        & (lag > 0.06 * length)
        & (length - lag > 2.0 * near)
    )
    again = beside.any(axis=1)
    if np.mean(again) < 0.15:
        return None
    lap = float(np.median(np.where(beside, lag, np.inf).min(axis=1)[again]))
    # The lap ends where the track comes closest to its start again.
    off = np.abs(s - lap)
    around = np.flatnonzero(off <= max(0.25 * lap, off.min()))
    distance = np.hypot(*(xy[around] - xy[0]).T)
    return int(around[np.argmin(distance)]), max(2, int(round(length / lap)))


def overlap(xy: np.ndarray) -> int:
    """Count the last points that overlap the start of the lap.

    Parameters
    ----------
    xy : ndarray, shape (n, 2)
        Points of a closed line in order [m].

    Returns
    -------
    int
        0 if there are none.
    """
    if len(xy) < 8:
        return 0
    ways = np.roll(xy, -1, axis=0) - xy
    closing = ways[-1]
    size = math.hypot(*closing)
    # With an overlap, the closing chord runs against the first and the last chord.
    if any(closing.dot(way) > -0.5 * (size * math.hypot(*way)) for way in (ways[0], ways[-2])):
        return 0
    usual = float(np.median(np.hypot(ways[:, 0], ways[:, 1])))
    before = (xy[0] - xy[::-1]).dot(-closing / size) > 0.5 * usual
    count = int(np.argmax(before))
    return count if count < len(xy) // 4 else 0


def turns_back(xy: np.ndarray) -> np.ndarray:
    """Indices of the points at which the line turns by more than `BACK`.

    Parameters
    ----------
    xy : ndarray, shape (n, 2)
        Points of a closed line in order [m].

    Returns
    -------
    ndarray of int, shape (k,)
    """
    return np.flatnonzero(np.abs(turns(xy)) > BACK)


def turns(xy: np.ndarray) -> np.ndarray:
    """Turn at each point, from the chord before it to the chord after it.

    Parameters
    ----------
    xy : ndarray, shape (n, 2)
        Points of a closed line in order [m].

    Returns
    -------
    ndarray, shape (n,)
        [rad], positive to the left.
    """
    ways = np.roll(xy, -1, axis=0) - xy
    return wrap(np.diff(np.arctan2(ways[:, 1], ways[:, 0]), prepend=math.atan2(*ways[-1, ::-1])))
