"""How closed points run: several loops, an end that overlaps the start, turns back."""

from __future__ import annotations

import math

import numpy as np

from ..angles import wrap

__all__ = ["BACK", "LARGEST_GAP", "first_loop", "overlap", "turns", "turns_back"]

LARGEST_GAP = 3.0  # from the last point to the first, in median distances
BACK = 2.1  # turn that no track makes at one point [rad]


def first_loop(xy: np.ndarray) -> tuple[int, int] | None:
    """Find where the second of several loops begins.

    Several loops are separate stretches that are closed each, or a track that repeats its own way
    in the same direction.

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
    """Stretches far apart from each other, each of which is closed."""
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
    """Several laps: many points have another one beside them that runs the same way, much later.

    The start and the end of a single lap lie beside each other, too, and so do points in a wrong
    order; neither counts.
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
    """Count the last points that lie past the first one, where the lap is already complete.

    Parameters
    ----------
    xy : ndarray, shape (n, 2)
        Points of a closed line in order [m].

    Returns
    -------
    int
        0 if none do.
    """
    if len(xy) < 8:
        return 0
    ways = np.roll(xy, -1, axis=0) - xy
    closing = ways[-1]
    size = math.hypot(*closing)
    # The closing chord runs against the first and the last one.
    if any(closing.dot(way) > -0.5 * (size * math.hypot(*way)) for way in (ways[0], ways[-2])):
        return 0
    usual = float(np.median(np.hypot(ways[:, 0], ways[:, 1])))
    before = (xy[0] - xy[::-1]).dot(-closing / size) > 0.5 * usual
    count = int(np.argmax(before))
    return count if count < len(xy) // 4 else 0


def turns_back(xy: np.ndarray) -> np.ndarray:
    """Indices of the points at which the way turns by more than `BACK`.

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
    """Turn at each point from the chord before to the chord after.

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
