"""Minimum-curvature racelines between the walls of a track.

The path is drawn as offsets ``alpha`` along the normals of a smooth reference line, and the offsets
are those of least summed squared curvature, the integral of ``kappa^2`` over the lap, that keep a
clearance from the walls (A. Heilmeier, A. Wischnewski, L. Hermansdorfer, J. Betz, M. Lienkamp,
B. Lohmann, *Minimum curvature trajectory planning and control for an autonomous race car*, Vehicle
System Dynamics 58, 2020). Three things differ from the paper:

- Curvature is that of the polygon through the points, the angle at each over half the length of the
  sides that meet there, so that each value depends on three offsets, and the normal equations have
  five diagonals instead of being dense. Time and memory grow with the number of points.
- It is linearized with all its derivatives, those of the lengths included, and a step is only taken
  as far as the true sum falls.
- Clearance is the distance to the nearest wall, not along the normal: a wall that juts out between
  two normals counts.
"""

import math
from typing import NamedTuple

import numpy as np

from ..errors import ParameterError, RacelineError
from .findings import NOTE, Finding
from .least_curvature import least_curvature
from .raceline import Raceline
from .speed_profile import raceline_speeds
from .tree import point_tree
from .walls import Walls, smooth_between

__all__ = [
    "OptimizedLine",
    "fastest_line",
    "minimum_curvature",
    "squared_curvature",
]

# Normals are cut this share before they meet: points beyond would change their order.
_MEETING = 0.9
# A new reference line is taken while it lowers the sum by more than this.
_PASS_GAIN, _MOST_PASSES = 1e-4, 8
# The clearance is held to this [m], also between the points, in at most so many rounds.
_CLOSE_ENOUGH, _MOST_ROUNDS = 1e-4, 8
# Squared curvature that is given for any gain of time, and the gain of time that is worth more.
_RISE, _WORTH = 0.05, 0.02
# Tensions, relative to the mean squared curvature; tried until two of them make the lap slower.
_TENSIONS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)


class OptimizedLine(NamedTuple):
    """What came out of `minimum_curvature`.

    Attributes
    ----------
    raceline : Raceline
        The path, with distances to the walls, without speeds.
    reference : Raceline
        Smoothed middle between the walls, where the search began, with distances to the walls.
    walls : Walls
        The walls as they were understood.
    clearance : float
        Least distance from the path to a wall [m].
    tension : float
        What a meter of length counted [1/m^2].
    findings : tuple of Finding
        What was repaired or cut on the way.
    """

    raceline: Raceline
    reference: Raceline
    walls: Walls
    clearance: float
    tension: float
    findings: tuple


def squared_curvature(raceline, step=0.1):
    """Integral of the squared curvature over one lap, ``sum(kappa^2) ds``, resampled evenly.

    Parameters
    ----------
    raceline : Raceline
    step : float, optional
        Distance of the samples [m], rounded to divide the lap.

    Returns
    -------
    float
        [1/m]
    """
    count = max(4, int(round(raceline.length / step)))
    at = raceline.sample(np.arange(count) * (raceline.length / count))
    return float(np.sum(at.kappa**2) * raceline.length / count)


def minimum_curvature(track, clearance, *, tension=0.0, step=0.1, progress=None):
    """Path of least summed squared curvature around a track.

    Parameters
    ----------
    track : Raceline
        Any line along the track with distances to the walls: a centerline or a raceline.
    clearance : float
        Least distance from the path to the walls [m]: half the car's width and a margin.
    tension : float, optional
        What a meter of length counts beside the squared curvature [1/m^2]: least is the integral
        of ``kappa^2 + tension``.
    step : float, optional
        Distance of the points that are moved [m].
    progress : callable, optional
        Called after each new line with the number of lines so far.

    Returns
    -------
    OptimizedLine

    Raises
    ------
    ParameterError
        If `clearance` or `step` is not positive and finite, or `tension` is negative.
    RacelineError
        If the track has no walls, is not closed, comes back to itself, or is too narrow; the
        message says where.
    """
    search = _Search(track, clearance, step, progress)
    return search.result(search.best(search.reference, tension), tension)


def fastest_line(track, clearance, limits, *, step=0.1, progress=None):
    """The fastest path that bends little more than the least, or that is much faster.

    The path of least squared curvature takes long ways around where these cost little curvature. A
    tension shortens it; how much is best, the lap time decides among the paths of at most 5 % more
    squared curvature. One with more than that has to be 2 % faster, as the inside of a ring is.

    Parameters
    ----------
    track, clearance, step, progress
        As of `minimum_curvature`.
    limits : dict
        The car's, as of `speed_profile`.

    Returns
    -------
    OptimizedLine
        Its raceline has speeds.

    Raises
    ------
    ParameterError
        If `clearance` or `step` is not positive and finite.
    RacelineError
        As of `minimum_curvature`; also if the car cannot steer the bends of the line.
    """
    search = _Search(track, clearance, step, progress)
    line = search.best(search.reference, 0.0)
    try:
        _, time = raceline_speeds(line, **limits)
    except ParameterError as error:
        raise RacelineError(f"{search.name}: no line for this car: {error}") from None
    least = squared_curvature(line, step)
    mean = least / line.length
    # The fastest of all, and of those that bend little more than the least.
    best = close = (time, line, 0.0)
    slower = 0
    for weight in _TENSIONS:
        tension = weight * mean
        line = search.best(line, tension)
        try:
            _, time = raceline_speeds(line, **limits)
        except ParameterError:
            break
        # Where a little tension changes nothing, more may.
        slower = slower + 1 if time > (1.0 + 1e-4) * best[0] else 0
        best = min(best, (time, line, tension), key=lambda item: item[0])
        if squared_curvature(line, step) <= (1.0 + _RISE) * least:
            close = best
        elif slower:
            break
        if slower == 2:
            break
    if best[0] > (1.0 - _WORTH) * close[0]:
        best = close
    found = search.result(best[1], best[2])
    line = found.raceline
    speed, _ = raceline_speeds(line, **limits)
    line = Raceline(
        *(line.x, line.y),
        vx_mps=speed,
        d_left_m=line.d_left,
        d_right_m=line.d_right,
        name=line.name,
    )
    return found._replace(raceline=line)


class _Search:
    """A track made ready, and the search for lines on it."""

    def __init__(self, track, clearance, step, progress):
        for key, value in (("clearance", clearance), ("step", step)):
            if not 0.0 < value < math.inf:
                raise ParameterError(f"{key}: expected a positive length, got {value}")
        self.name = track.source or track.name or "raceline"
        self.title = track.name
        self.clearance, self.step, self._progress = clearance, step, progress
        _check_closed(track, self.name)
        self.walls = Walls(track)
        _check_single(track, clearance, self.name)
        self.farthest = 2.0 * float(np.max(track.d_left + track.d_right))
        self.reference = self._with_walls(Raceline(*self._middle(track).T))
        self._cut, self._lines = None, 0

    def best(self, line, tension):
        """The best line, each time within reach of the normals of the last one."""
        if not 0.0 <= tension < math.inf:
            raise ParameterError(f"tension: expected 0 or more, got {tension}")
        best = None
        for _ in range(_MOST_PASSES):
            line = self._one_pass(line, tension)
            reached = squared_curvature(line, self.step) + tension * line.length
            done = best is not None and reached > (1.0 - _PASS_GAIN) * best[0]
            if best is None or reached < best[0]:
                best = (reached, line)
            if done:
                break
        return best[1]

    def result(self, line, tension):
        """What is to be known of a line."""
        findings = list(self.walls.findings)
        if self._cut:
            text = (
                f"{self._cut} normals of the middle line cut before they meet inside bends; those "
                "of the lines after it reach farther"
            )
            findings.append(Finding("cut-normals", NOTE, text))
        raceline = self._with_walls(line)
        at = line.sample(np.linspace(0.0, line.length, 4 * line.n, endpoint=False))
        least = float(np.min(self.walls.distance(np.stack((at.x, at.y), axis=1))))
        return OptimizedLine(raceline, self.reference, self.walls, least, tension, tuple(findings))

    def _middle(self, track):
        """Points of a smooth line around the middle between the walls."""
        walls, count = self.walls, max(8, int(round(track.length / self.step)))
        points, normals = _even_points(track, count)
        at = track.sample(np.arange(count) * (track.length / count))
        points = points + (0.5 * (at.d_left - at.d_right))[:, None] * normals
        # The wider the track, the more may be smoothed.
        deviation = 0.25 * float(np.median(track.d_left + track.d_right))
        smooth, clear = smooth_between(
            points, track.length, deviation, walls.distance, self.clearance
        )
        if not clear:
            k = int(np.argmin(walls.distance(smooth)))
            raise self._too_narrow(smooth[k], normals[k])
        return smooth

    def _one_pass(self, line, tension):
        """The best line within reach of the normals of another."""
        count = max(8, int(round(line.length / self.step)))
        points, normals = _even_points(line, count)
        wanted = np.full(count, self.clearance)
        alpha = np.zeros(count)
        left, right = _meeting(points, normals)
        low, high = _reach(points, normals, self.walls, wanted, self.farthest)
        cut = int(np.sum((high > left) | (low < -right)))
        low, high = np.maximum(low, -right), np.minimum(high, left)
        if np.any(high < low - 1e-3):
            k = int(np.argmin(high - low))
            raise self._too_narrow(points[k], normals[k])
        # Between two points the line can pass a corner of a wall too closely; these points then
        # keep away by as much more.
        for _ in range(_MOST_ROUNDS):
            alpha = least_curvature(points, normals, low, np.maximum(low, high), alpha, tension)
            line = Raceline(*(points + alpha[:, None] * normals).T)
            missing = self.clearance - _clearance_after(line, self.walls, count, self.clearance)
            if missing.max() < _CLOSE_ENOUGH:
                break
            missing = np.maximum(missing, 0.0)
            missing = np.maximum(missing, np.roll(missing, 1))
            k = np.flatnonzero(missing)
            wanted[k] += 1.2 * missing[k]
            low[k], high[k] = _reach(points[k], normals[k], self.walls, wanted[k], self.farthest)
            low, high = np.maximum(low, -right), np.minimum(high, left)
        self._cut = cut if self._cut is None else self._cut
        self._lines += 1
        if self._progress is not None:
            self._progress(self._lines)
        return line

    def _with_walls(self, line):
        """A line with its distances to the walls, or to where its normals meet inside bends."""
        points = np.stack((line.x, line.y), axis=1)
        normals = np.stack((-np.sin(line.psi), np.cos(line.psi)), axis=1)
        left, right = (
            self.walls.reach(points, side * normals, 0.0, self.farthest) for side in (1.0, -1.0)
        )
        with np.errstate(divide="ignore"):
            radius = _MEETING / np.abs(line.kappa)
        left = np.where(line.kappa > 0.0, np.minimum(left, radius), left)
        right = np.where(line.kappa < 0.0, np.minimum(right, radius), right)
        return Raceline(line.x, line.y, d_left_m=left, d_right_m=right, name=self.title)

    def _too_narrow(self, point, normal):
        wide = sum(
            float(self.walls.reach(point[None], side * normal[None], 0.0, self.farthest)[0])
            for side in (1.0, -1.0)
        )
        return RacelineError(
            f"{self.name}: the track is too narrow at ({point[0]:.2f}, {point[1]:.2f}): "
            f"{wide:.2f} m from wall to wall, where car and margins need "
            f"{2.0 * self.clearance:.2f} m"
        )


# -- the track --------------------------------------------------------------------------------


def _check_closed(track, name):
    """Refuse a track whose ends are much farther apart than its points."""
    spacing = np.diff(np.append(track.s_points, track.length))
    width = float(np.median(track.d_left + track.d_right)) if track.d_left is not None else 0.0
    if spacing[-1] > max(5.0 * spacing[:-1].max(), width):
        raise RacelineError(
            f"{name}: expected a closed track, but the last point is {spacing[-1]:.2f} m from the "
            f"first, and no other two are more than {spacing[:-1].max():.2f} m apart"
        )


def _check_single(track, clearance, name):
    """Refuse a track that crosses itself or goes round twice."""
    spacing = min(track.ds, 0.5 * clearance)
    at = track.sample(np.linspace(0.0, track.length, int(track.length / spacing) + 1)[:-1])
    points = np.stack((at.x, at.y), axis=1)
    pairs = point_tree(points).query_pairs(clearance, output_type="ndarray")
    apart = np.abs(at.s[pairs[:, 0]] - at.s[pairs[:, 1]])
    apart = np.minimum(apart, track.length - apart)
    # An arc comes back to half its way at a half turn.
    twice = pairs[apart > 4.0 * clearance]
    if len(twice):
        i, j = (int(k) for k in min(twice.tolist()))
        raise RacelineError(
            f"{name}: expected one loop, but the track comes back to itself at "
            f"({at.x[i]:.2f}, {at.y[i]:.2f}): s = {at.s[i]:.2f} m and {at.s[j]:.2f} m"
        )


def _even_points(line, count):
    """Points at equal arc lengths, and the unit vectors to their left."""
    at = line.sample(np.arange(count) * (line.length / count))
    return (
        np.stack((at.x, at.y), axis=1),
        np.stack((-np.sin(at.psi), np.cos(at.psi)), axis=1),
    )


def _clearance_after(line, walls, count, clearance):
    """Least distance to a wall from each of the points of a line to the next."""
    ends = np.append(line.s_points, line.length)
    if ends.size != count + 1:
        raise RacelineError("expected a line whose points are at least 0.1 mm apart: larger step?")
    # So close that a wall's corner can come nearer in between by a few thousandths only.
    parts = max(4, math.ceil(line.length / count / (0.2 * clearance)))
    parts = np.linspace(0.0, 1.0, parts, endpoint=False)
    at = line.sample(ends[:-1, None] + parts * np.diff(ends)[:, None])
    free = walls.distance(np.stack((at.x.ravel(), at.y.ravel()), axis=1))
    return free.reshape(-1, parts.size).min(axis=1)


def _reach(points, normals, walls, clearance, farthest):
    """Least and largest offset along the normals that keep a clearance from the walls."""
    begin = _clear_offset(points, normals, walls, clearance)
    inside = points + begin[:, None] * normals
    high = begin + walls.reach(inside, normals, clearance, farthest)
    low = begin - walls.reach(inside, -normals, clearance, farthest)
    return low, high


def _meeting(points, normals):
    """How far normals reach to the left and to the right before a neighbor crosses them."""
    after = np.roll(normals, -1, axis=0)
    turn = np.arctan2(
        normals[:, 0] * after[:, 1] - normals[:, 1] * after[:, 0], np.sum(normals * after, axis=1)
    )
    chord = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
    # They meet where the offset is the radius of the turn between them.
    with np.errstate(divide="ignore"):
        radius = _MEETING * chord / np.abs(turn)
    left, right = (np.where(turn * side > 0.0, radius, np.inf) for side in (1.0, -1.0))
    return np.minimum(left, np.roll(left, 1)), np.minimum(right, np.roll(right, 1))


def _clear_offset(points, normals, walls, clearance):
    """Offsets that take points which are a little too close to a wall away from it, else 0."""
    offset = np.zeros(len(points))
    free = walls.distance(points)
    missing = np.maximum(clearance - free, 0.0)
    for farther in (1.0, 2.0, 4.0):
        close = np.flatnonzero(free < clearance)
        if not close.size:
            break
        for side in (1.0, -1.0):
            move = side * farther * missing[close]
            there = walls.distance(points[close] + move[:, None] * normals[close])
            better = there > free[close]
            offset[close[better]], free[close[better]] = move[better], there[better]
    return offset
