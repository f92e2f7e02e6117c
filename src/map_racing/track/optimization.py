"""Minimum-curvature racelines between the walls of a track.

The path is described by offsets ``alpha`` along the normals of a smooth reference line. The offsets
minimize the integral of ``kappa^2`` over the lap, subject to a clearance from the walls
(A. Heilmeier, A. Wischnewski, L. Hermansdorfer, J. Betz, M. Lienkamp, B. Lohmann, *Minimum
curvature trajectory planning and control for an autonomous race car*, Vehicle System Dynamics 58,
2020). Three things differ from the paper:

- Curvature is the turn at each point of the polygon divided by half the length of the adjacent
  sides. Each value depends on three offsets, so the normal equations have five diagonals instead of
  being dense, and time and memory grow linearly with the number of points.
- It is linearized with all its derivatives, including those of the lengths, and a step is shortened
  until the true objective decreases.
- Clearance is the distance to the nearest wall, not the distance along the normal: a wall that juts
  out between two normals counts.
"""

from __future__ import annotations

import math
from typing import Any, Callable, Mapping, NamedTuple

import numpy as np

from ..errors import ParameterError, RacelineError
from .findings import NOTE, WARNING, Finding
from .least_curvature import least_curvature
from .normals import (
    MEETING,
    even_points,
    offsets_between_walls,
    offsets_to_meeting,
    points_and_normals,
)
from .raceline import Raceline
from .speed_profile import raceline_speeds
from .tree import point_tree
from .walls import Walls, clearance_of, smooth_between

__all__ = [
    "OptimizedLine",
    "fastest_line",
    "minimum_curvature",
    "squared_curvature",
    "with_fastest_speeds",
]

# Relative gain below which the passes with new reference lines end, and their largest number.
_PASS_GAIN, _MOST_PASSES = 1e-4, 8
# Tolerance of the clearance [m], also between the points, and the largest number of corrections.
_CLOSE_ENOUGH, _MOST_ROUNDS = 1e-4, 8
# Accept 5 % more squared curvature for any faster lap; more only for a lap 2 % faster.
_RISE, _WORTH = 0.05, 0.02
# Tensions relative to the mean squared curvature, tried until two of them make the lap slower.
_TENSIONS = (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0)

_Progress = Callable[[int], Any]


class OptimizedLine(NamedTuple):
    """Result of `minimum_curvature`.

    Attributes
    ----------
    raceline : Raceline
        The path, with distances to the walls, without speeds.
    reference : Raceline
        Smoothed middle line between the walls, with distances to them, where the search began.
    walls : Walls
        The walls that the path keeps clear of.
    clearance : float
        Least distance from the path to a wall [m].
    tension : float
        Weight of the length in the objective [1/m^2].
    findings : tuple of Finding
        Repairs and cuts made during the search.
    """

    raceline: Raceline
    reference: Raceline
    walls: Walls
    clearance: float
    tension: float
    findings: tuple[Finding, ...]


def squared_curvature(raceline: Raceline, step: float = 0.1) -> float:
    """Integral of the squared curvature over one lap, ``sum(kappa^2) ds``, with even samples.

    Parameters
    ----------
    raceline : Raceline
    step : float, optional
        Distance between the samples [m], rounded to divide the lap.

    Returns
    -------
    float
        [1/m]
    """
    count = max(4, int(round(raceline.length / step)))
    at = raceline.sample(np.arange(count) * (raceline.length / count))
    return float(np.sum(at.kappa**2) * raceline.length / count)


def with_fastest_speeds(line: Raceline, limits: Mapping[str, Any], scale: float = 1.0) -> Raceline:
    """Give a line the fastest speeds within a car's limits, times a scale.

    Parameters
    ----------
    line : Raceline
    limits : mapping
        Keyword arguments of `speed_profile`.
    scale : float, optional

    Returns
    -------
    Raceline

    Raises
    ------
    ParameterError
        If the car cannot steer a bend of the line.
    """
    speed, _ = raceline_speeds(line, **limits)
    return Raceline(
        line.x,
        line.y,
        vx_mps=scale * speed,
        d_left_m=line.d_left,
        d_right_m=line.d_right,
        name=line.name,
    )


def minimum_curvature(
    track: Raceline,
    clearance: float,
    *,
    tension: float = 0.0,
    step: float = 0.1,
    progress: _Progress | None = None,
) -> OptimizedLine:
    """Find the path of least integrated squared curvature around a track.

    Parameters
    ----------
    track : Raceline
        Any line along the track with distances to the walls: a centerline or a raceline.
    clearance : float
        Least distance from the path to the walls [m]: half the car's width plus a margin.
    tension : float, optional
        Weight of the length relative to the squared curvature [1/m^2]: the objective is the
        integral of ``kappa^2 + tension``.
    step : float, optional
        Distance between the points that are moved [m].
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
        If the track has no walls, is not closed, meets itself, or is too narrow; the message says
        where.
    """
    search = _Search(track, clearance, step, progress)
    return search.result(search.best(search.reference, tension), tension)


def fastest_line(
    track: Raceline,
    clearance: float,
    limits: Mapping[str, Any],
    *,
    step: float = 0.1,
    progress: _Progress | None = None,
) -> OptimizedLine:
    """Find the fastest of the paths between least curvature and least length.

    The path of least squared curvature makes detours wherever they reduce the curvature a little.
    Tension shortens it. Of the paths with at most 5 % more squared curvature, the one with the
    shortest lap time is chosen; a path with more must be 2 % faster, like the inside of a ring.

    Parameters
    ----------
    track, clearance, step, progress
        See `minimum_curvature`.
    limits : mapping
        The car's limits: keyword arguments of `speed_profile`.

    Returns
    -------
    OptimizedLine
        Its raceline has speeds.

    Raises
    ------
    ParameterError
        If `clearance` or `step` is not positive and finite.
    RacelineError
        As in `minimum_curvature`; also if the car cannot steer a bend of the path.
    """
    search = _Search(track, clearance, step, progress)
    line = search.best(search.reference, 0.0)
    try:
        _, time = raceline_speeds(line, **limits)
    except ParameterError as error:
        raise RacelineError(f"{search.name}: no line for this car: {error}") from None
    least = squared_curvature(line, step)
    mean = least / line.length
    # `best` is the fastest of all, `close` the fastest with little more than the least curvature.
    best = close = (time, line, 0.0)
    slower = 0
    for weight in _TENSIONS:
        tension = weight * mean
        line = search.best(line, tension)
        try:
            _, time = raceline_speeds(line, **limits)
        except ParameterError:
            break
        # If a little tension changes nothing, more of it may.
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
    findings = ()
    own = search.time_of_track(limits)
    if own < best[0]:
        best = (own, Raceline(track.x, track.y, name=track.name), 0.0)
        text = "no faster line than the given one was found: its path is kept"
        findings = (Finding("kept", WARNING, text),)
    found = search.result(best[1], best[2])
    found = found._replace(findings=found.findings + findings)
    return found._replace(raceline=with_fastest_speeds(found.raceline, limits))


class _Search:
    """Search for lines on one track."""

    def __init__(self, track, clearance, step, progress):
        for key, value in (("clearance", clearance), ("step", step)):
            if not 0.0 < value < math.inf:
                raise ParameterError(f"{key}: expected more than 0 m, got {value}")
        self.name = track.source or track.name or "raceline"
        self.track, self.title = track, track.name
        self.clearance, self.step, self._progress = clearance, step, progress
        _check_closed(track, self.name)
        self.walls = Walls(track)
        _check_single(track, clearance, self.name)
        self.farthest = 2.0 * float(np.max(track.d_left + track.d_right))
        self.reference = self._with_walls(Raceline(*self._middle(track).T))
        self._cut, self._lines = None, 0

    def time_of_track(self, limits):
        """Lap time on the given path [s]; inf if the car cannot drive it or it is too close."""
        if clearance_of(self.track, self.track) < self.clearance - _CLOSE_ENOUGH:
            return math.inf
        try:
            return raceline_speeds(self.track, **limits)[1]
        except ParameterError:
            return math.inf

    def best(self, line, tension):
        """Best line, improved pass by pass along the normals of the last one."""
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
        """Result for a line."""
        findings = list(self.walls.findings)
        if self._cut:
            text = (
                f"{self._cut} normals of the middle line cut before they meet inside bends; "
                "normals of later lines reach farther"
            )
            findings.append(Finding("cut-normals", NOTE, text))
        raceline = self._with_walls(line)
        at = line.sample(np.linspace(0.0, line.length, 4 * line.n, endpoint=False))
        least = float(np.min(self.walls.distance(np.stack((at.x, at.y), axis=1))))
        return OptimizedLine(raceline, self.reference, self.walls, least, tension, tuple(findings))

    def _middle(self, track):
        """Points of a smooth line near the middle between the walls."""
        walls, count = self.walls, max(8, int(round(track.length / self.step)))
        points, normals = even_points(track, count)
        at = track.sample(np.arange(count) * (track.length / count))
        points = points + (0.5 * (at.d_left - at.d_right))[:, None] * normals
        # The wider the track, the stronger the smoothing may be.
        deviation = 0.25 * float(np.median(track.d_left + track.d_right))
        smooth, clear = smooth_between(
            points, track.length, deviation, walls.distance, self.clearance
        )
        if not clear:
            k = int(np.argmin(walls.distance(smooth)))
            raise self._too_narrow(smooth[k], normals[k])
        return smooth

    def _one_pass(self, line, tension):
        """Best line within the normals of another."""
        count = max(8, int(round(line.length / self.step)))
        points, normals = even_points(line, count)
        wanted = np.full(count, self.clearance)
        alpha = np.zeros(count)
        left, right = offsets_to_meeting(points, normals)
        low, high = offsets_between_walls(points, normals, self.walls, wanted, self.farthest)
        cut = int(np.sum((high > left) | (low < -right)))
        low, high = np.maximum(low, -right), np.minimum(high, left)
        if np.any(high < low - 1e-3):
            k = int(np.argmin(high - low))
            raise self._too_narrow(points[k], normals[k])
        # Between two points the line can pass a corner of a wall too closely: then raise the
        # clearance of these points by the missing distance.
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
            low[k], high[k] = offsets_between_walls(
                points[k], normals[k], self.walls, wanted[k], self.farthest
            )
            low, high = np.maximum(low, -right), np.minimum(high, left)
        self._cut = cut if self._cut is None else self._cut
        self._lines += 1
        if self._progress is not None:
            self._progress(self._lines)
        return line

    def _with_walls(self, line):
        """Line with its distances to the walls, or to where its normals meet inside bends."""
        points, normals = points_and_normals(line)
        left, right = (
            self.walls.reach(points, side * normals, 0.0, self.farthest) for side in (1.0, -1.0)
        )
        with np.errstate(divide="ignore"):
            radius = MEETING / np.abs(line.kappa)
        left = np.where(line.kappa > 0.0, np.minimum(left, radius), left)
        right = np.where(line.kappa < 0.0, np.minimum(right, radius), right)
        return Raceline(line.x, line.y, d_left_m=left, d_right_m=right, name=self.title)

    def _too_narrow(self, point, normal):
        wide = sum(
            float(self.walls.reach(point[None], side * normal[None], 0.0, self.farthest)[0])
            for side in (1.0, -1.0)
        )
        return RacelineError(
            f"{self.name}: the track is too narrow at ({point[0]:.2f}, {point[1]:.2f}): expected "
            f"{2.0 * self.clearance:.2f} m for car and margins, got {wide:.2f} m from wall to wall"
        )


# -- the track -----------------------------------------------------------------------------------


def _check_closed(track, name):
    """Reject a track whose ends are much farther apart than its points."""
    spacing = np.diff(np.append(track.s_points, track.length))
    width = float(np.median(track.d_left + track.d_right)) if track.d_left is not None else 0.0
    if spacing[-1] > max(5.0 * spacing[:-1].max(), width):
        raise RacelineError(
            f"{name}: expected a closed track, but the last point is {spacing[-1]:.2f} m from the "
            f"first, and no other two are more than {spacing[:-1].max():.2f} m apart"
        )


def _check_single(track, clearance, name):
    """Reject a track that crosses itself or consists of two laps."""
    spacing = min(track.ds, 0.5 * clearance)
    at = track.sample(np.linspace(0.0, track.length, int(track.length / spacing) + 1)[:-1])
    points = np.stack((at.x, at.y), axis=1)
    pairs = point_tree(points).query_pairs(clearance, output_type="ndarray")
    apart = np.abs(at.s[pairs[:, 0]] - at.s[pairs[:, 1]])
    apart = np.minimum(apart, track.length - apart)
    # In a bend of up to half a turn the arc length is at most pi / 2 times the straight distance.
    twice = pairs[apart > 4.0 * clearance]
    if len(twice):
        i, j = (int(k) for k in min(twice.tolist()))
        raise RacelineError(
            f"{name}: expected one loop, but the track meets itself at "
            f"({at.x[i]:.2f}, {at.y[i]:.2f}): s = {at.s[i]:.2f} m and {at.s[j]:.2f} m"
        )


def _clearance_after(line, walls, count, clearance):
    """Least distance to a wall from each of the points of a line to the next."""
    ends = np.append(line.s_points, line.length)
    if ends.size != count + 1:
        raise RacelineError("expected points at least 0.1 mm apart: take a larger step")
    # Dense enough that a wall corner between two samples is nearer by only a few thousandths.
    parts = max(4, math.ceil(line.length / count / (0.2 * clearance)))
    parts = np.linspace(0.0, 1.0, parts, endpoint=False)
    at = line.sample(ends[:-1, None] + parts * np.diff(ends)[:, None])
    free = walls.distance(np.stack((at.x.ravel(), at.y.ravel()), axis=1))
    return free.reshape(-1, parts.size).min(axis=1)
