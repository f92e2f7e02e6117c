"""Checks of the distances to the walls."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import uniform_filter1d

from ..crossings import Polyline, crossings
from ..findings import NOTE, WARNING, points
from ..loops import turns
from ..tree import point_tree
from .draft import MOST_PLACES, Draft

__all__ = ["check_distances", "check_polygons"]

# A file may also hold points on the walls. If the stated walls are farther than the first distance
# [m] from these, as given and exchanged, the points are of other walls. The sides are exchanged if
# the stated walls are farther than the second, and many times as far as the exchanged ones. Three
# real files have 0.02 to 0.06 m, and 0.25 to 1.7 m if the sides are exchanged.
_ELSEWHERE, _APART, _MANY = 0.15, 0.08, 3.0
# A line jitters if it turns by this factor more than after smoothing over this share of the track's
# width; real racelines and centerlines turn by up to 1.09 times as much.
_JITTERS, _SMOOTHED = 1.2, 0.25
# A single distance is mistyped if it is off by this share of the track's width.
_SINGLE = 0.4
_FOLD = math.pi  # a wall folds over at most half a turn around a bend, in widths


def check_distances(draft: Draft) -> None:
    """Check that the points lie between the walls."""
    columns = draft.columns
    if "d_left" not in columns:
        return
    for side in ("left", "right"):
        beyond = np.flatnonzero(columns[f"d_{side}"] < 0.0)
        if beyond.size:
            text = f"{points(beyond.size)} beyond the {side} wall"
            draft.add("beyond-wall", WARNING, text, beyond)
        if not np.any(columns[f"d_{side}"]):
            text = f"every distance to the {side} wall is 0: not given?"
            draft.add("wall-zero", WARNING, text)
        else:
            _check_single(draft, side)
    closed = np.flatnonzero(columns["d_left"] + columns["d_right"] <= 0.0)
    if closed.size:
        text = f"the walls leave no width at {points(closed.size)}"
        draft.add("no-width", WARNING, text, closed)


def _check_single(draft, side):
    """Single distances far from those at the points before and after, which agree."""
    columns = draft.columns
    d = columns[f"d_{side}"]
    before, after = np.roll(d, 1), np.roll(d, -1)
    off = np.abs(d - 0.5 * (before + after))
    usual = float(np.median(columns["d_left"] + columns["d_right"]))
    found = np.flatnonzero((off > _SINGLE * usual) & (np.abs(before - after) < 0.2 * off))
    if found.size:
        k = found[np.argmax(off[found])]
        text = (
            f"the distance to the {side} wall is {d[k]:.2f} m between {before[k]:.2f} and "
            f"{after[k]:.2f} m: mistyped? At {points(found.size)}"
        )
        draft.add("wall-single", WARNING, text, found)


def check_polygons(draft: Draft) -> None:
    """Check the walls as curves: swapped sides, folds and crossings."""
    line = draft.raceline
    if line.d_left is None:
        return
    # No point of a closed curve is farther inside than in a circle.
    inner = float(np.median(line.d_left if np.sum(line.kappa) > 0.0 else line.d_right))
    if inner > line.length / (2.0 * math.pi):
        text = f"the inner wall is {inner:.0f} m away, beyond the other side of the track: in m?"
        draft.add("walls-far", WARNING, text)
    why = "their shape or the line's place in the bends"
    swapped = _fits_exchanged(line, draft.table.bounds)
    if swapped:
        why = "the walls that the file shows besides"
    elif swapped is None:
        swapped = not _jitters(line) and _swapped(line)
    if swapped:
        text = f"left and right wall look swapped, by {why}"
        draft.add("swapped-walls", WARNING, text)
        return
    _folds(draft)
    left, right = Polyline(_wall(line, line.d_left)), Polyline(_wall(line, -line.d_right))
    widest = float(max(line.d_left.max(), line.d_right.max()))
    usual = float(np.median(line.d_left + line.d_right))
    own = Polyline(np.stack((line.x, line.y), axis=1))
    for name, a, b in (
        ("left wall crosses the track", own, left),
        ("right wall crosses the track", own, right),
        ("walls cross each other", left, right),
        ("left wall crosses itself", left, None),
        ("right wall crosses itself", right, None),
    ):
        pairs = crossings(a, b)
        # A wall meets the track at its own place where the distance is 0, and itself where it
        # folds inside a bend: both are other findings.
        apart = np.mod(pairs[:, 0] - pairs[:, 1], line.n)
        local = 2.0 if b is not None else _FOLD * max(widest, 0.0) / line.ds
        pairs = pairs[np.minimum(apart, line.n - apart) > local]
        pairs = pairs[~_at_crossings(own, pairs[:, 0], usual)]
        if len(pairs):
            times = "once" if len(pairs) == 1 else f"{len(pairs)} times"
            at = draft.points_near(pairs[:MOST_PLACES, 0])
            draft.add("walls-cross", WARNING, f"the {name} {times}", at)


def _at_crossings(own, at, width):
    """Whether places lie where the track crosses itself, and so the walls cross it, too."""
    found = np.zeros(len(at), dtype=bool)
    if not len(at):
        return found
    vertices = own.vertices
    ways = np.roll(vertices, -1, axis=0) - vertices
    for i, j in crossings(own):
        area = ways[i, 0] * ways[j, 1] - ways[i, 1] * ways[j, 0]
        across = abs(area) / (np.hypot(*ways[i]) * np.hypot(*ways[j]))
        found |= np.hypot(*(vertices[at] - vertices[i]).T) < 1.5 * width / max(across, 0.2)
    return found


def _folds(draft):
    """Bends inside which the wall lies beyond the center of curvature."""
    line = draft.raceline
    for side, d in (("left", line.d_left), ("right", -line.d_right)):
        folded = np.flatnonzero(line.kappa * d >= 1.0)
        if folded.size:
            worst = folded[np.argmax((line.kappa * d)[folded])]
            text = (
                f"the {side} wall lies beyond the center of a bend over "
                f"{folded.size * line.ds:.2f} m, so its position there is unknown, farthest"
            )
            draft.add("wall-folds", NOTE, text, draft.points_near([worst]))


def _wall(line, d):
    return np.stack(line.to_cartesian(line.s, d), axis=1)


def _fits_exchanged(line, bounds):
    """Whether the distances fit the points on the walls in the file only if they are exchanged.

    None if they fit in neither way, or the file has no such points.
    """

    def off(left, right):
        walls = np.concatenate((_wall(line, left), _wall(line, -right)))
        return min(float(np.median(point_tree(points).query(walls)[0])) for points in bounds)

    if not bounds:
        return None
    stated, exchanged = off(line.d_left, line.d_right), off(line.d_right, line.d_left)
    if min(stated, exchanged) > _ELSEWHERE:
        return None
    return stated > max(_APART, _MANY * exchanged)


def _jitters(line):
    """Whether the points jitter, as rounded ones do.

    Then their normals swing, and far walls with them more than near ones: the shape of the walls
    tells nothing.
    """
    own = np.stack((line.x, line.y), axis=1)
    window = max(1, int(_SMOOTHED * float(np.median(line.d_left + line.d_right)) / line.ds))
    smooth = uniform_filter1d(own, window, axis=0, mode="wrap")
    return bool(np.abs(turns(own)).sum() > _JITTERS * np.abs(turns(smooth)).sum())


def _swapped(line):
    """Whether the distances to the left and the right wall are exchanged.

    Real walls are smooth. On seven real racelines, two shipped ones and four centerlines the walls'
    total turning is 0.33 to 1.05 times that with the sides exchanged; racing lines also touch the
    inner wall in bends, so left minus right correlates with the curvature by -0.99 to 0.35, and by
    up to 0.74 where a car ran wide in all bends. Of those and 200 generated tracks, exchanged, all
    are found but seven centerlines, of which four have constant distances, which tell nothing.
    """

    def turning(left, right):
        walls = _wall(line, left), _wall(line, -right)
        return sum(float(np.abs(turns(wall)).sum()) for wall in walls)

    ratio = turning(line.d_left, line.d_right) / turning(line.d_right, line.d_left)
    difference = line.d_left - line.d_right
    if min(np.std(difference), np.std(line.kappa)) < 1e-9:
        return ratio > 1.25
    hugging = np.corrcoef(line.kappa, difference)[0, 1]
    return (
        ratio > 1.25
        or (ratio > 1.1 and hugging > 0.5)
        or (ratio > 0.85 and hugging > 0.9 and _keeps_outside(line, difference))
    )


def _keeps_outside(line, difference):
    """Whether the line keeps to the outside of the bends of the track.

    The bends of the line itself do not count: a line that weaves turns back where it is far out.
    """
    if np.std(difference) < 0.01 * np.mean(line.d_left + line.d_right):
        return False
    middle = _wall(line, 0.5 * difference)
    way = np.hypot(*np.diff(middle, axis=0, append=middle[:1]).T)
    bends = turns(middle) / np.maximum(way, 1e-9)
    if np.std(bends) < 0.2 * np.mean(np.abs(bends)):
        return False
    return bool(np.corrcoef(bends, difference)[0, 1] > 0.7)
