"""The walls of a track, and how far a car can move toward them."""

from __future__ import annotations

import math
from typing import Callable

import numpy as np

from ..errors import RacelineError
from .findings import NOTE, WARNING, Finding
from .raceline import Raceline
from .tree import point_tree

__all__ = ["Walls", "clearance_of", "march", "smooth_between"]


class Walls:
    """The two walls of a track as polylines, for measuring distances.

    Parameters
    ----------
    track : Raceline
        Line with distances to the walls.

    Attributes
    ----------
    segments : ndarray, shape (n, 2, 2)
        Start and end of each piece of wall [m].
    findings : tuple of Finding
        Parts of the walls that were left out.

    Raises
    ------
    RacelineError
        If the track has no walls, or a distance to one is not positive.

    Notes
    -----
    Inside a bend tighter than the track is wide, neighboring normals cross before they reach the
    wall, and the wall's points run backwards through the track. Wall points inside the track at
    their own bend are left out, and the gaps closed.
    """

    def __init__(self, track: Raceline):
        name = track.source or track.name or "raceline"
        if track.d_left is None:
            raise RacelineError(f"{name}: expected distances to both walls")
        for side, column in (("left", track.d_left), ("right", track.d_right)):
            if column.min() <= 0.0:
                k = int(np.argmin(column))
                raise RacelineError(
                    f"{name}: s = {track.s[k]:.2f} m: expected a positive distance to the {side} "
                    f"wall, got {column[k]:g} m"
                )
        # Between coarse points the wall follows the bend of the line.
        spacing = min(track.ds, 0.25 * float(np.median(track.d_left + track.d_right)))
        count = int(math.ceil(track.length / spacing - 1e-9))
        at = track.sample(np.arange(count) * (track.length / count))
        normal = np.stack((-np.sin(at.psi), np.cos(at.psi)), axis=1)
        line = np.stack((at.x, at.y), axis=1)
        left = line + at.d_left[:, None] * normal
        right = line - at.d_right[:, None] * normal
        tree = point_tree(line)
        begins, ends, dropped, shared = [], [], [], 0
        for wall, width in ((left, at.d_left), (right, at.d_right)):
            deep, own = self._inside(wall, width, tree, line, normal, at, track.length)
            keep = ~((deep > 0.01 * width) & own)
            dropped.append(int(np.sum(~keep)))
            shared += int(np.sum((deep > 0.1 * width) & ~own))
            begins.append(wall[keep])
            ends.append(np.roll(wall[keep], -1, axis=0))
        self.findings = ()
        if any(dropped):
            text = (
                f"normals cross inside bends tighter than the track is wide: {dropped[0]} points "
                f"of the left wall and {dropped[1]} of the right one left out"
            )
            self.findings = (Finding("crossing-normals", NOTE, text),)
        if shared:
            text = f"{shared} wall points are inside another stretch of the track: they bound both"
            self.findings += (Finding("shared-ground", WARNING, text),)
        self._begin, end = np.concatenate(begins), np.concatenate(ends)
        self._along = end - self._begin
        self.segments = np.stack((self._begin, end), axis=1)
        self._square = np.maximum(np.sum(self._along**2, axis=1), 1e-18)
        self._densify(spacing)

    @staticmethod
    def _inside(wall, width, tree, line, normal, at, length):
        """Depth of wall points inside the track nearest to them, and whether it is their own."""
        distance, foot = tree.query(wall)
        along = np.abs(np.mod(at.s - at.s[foot] + 0.5 * length, length) - 0.5 * length)
        left = np.sum((wall - line[foot]) * normal[foot], axis=1) > 0.0
        there = np.where(left, at.d_left[foot], at.d_right[foot])
        return there - distance, along < 4.0 * width

    def _densify(self, spacing):
        """Index points along all segments, densely enough to find the nearest segment."""
        parts = np.maximum(1, np.ceil(np.sqrt(self._square) / spacing)).astype(int)
        segment = np.repeat(np.arange(parts.size), parts)
        share = (np.arange(segment.size) - np.repeat(np.cumsum(parts) - parts, parts) + 0.5) / (
            parts[segment]
        )
        self._tree = point_tree(self._begin[segment] + share[:, None] * self._along[segment])
        self._segment = segment

    def distance(self, points: np.ndarray) -> np.ndarray:
        """Measure the distance from points to the nearest wall.

        Parameters
        ----------
        points : ndarray, shape (n, 2)
            [m]

        Returns
        -------
        ndarray, shape (n,)
            [m]
        """
        _, near = self._tree.query(points, k=min(3, self._segment.size))
        best = np.full(len(points), np.inf)
        for column in np.reshape(near, (len(points), -1)).T:
            k = self._segment[column]
            apart = points - self._begin[k]
            share = np.clip(np.sum(apart * self._along[k], axis=1) / self._square[k], 0.0, 1.0)
            apart -= share[:, None] * self._along[k]
            best = np.minimum(best, np.hypot(apart[:, 0], apart[:, 1]))
        return best

    def between(self, points: np.ndarray) -> np.ndarray:
        """Whether points lie between the walls.

        A ray from such a point crosses the walls an odd number of times. Unlike the offset from the
        line, this also works in bends tighter than the track is wide.

        Parameters
        ----------
        points : ndarray, shape (n, 2)
            [m]; fastest if neighboring points are close to each other.

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        (x0, y0), (x1, y1) = self.segments[:, 0].T, self.segments[:, 1].T
        low, high = np.minimum(y0, y1), np.maximum(y0, y1)
        result = np.empty(len(points), dtype=bool)
        for start in range(0, len(points), 64):
            x, y = points[start : start + 64].T
            k = np.flatnonzero((high >= y.min()) & (low <= y.max()))
            meets = (y0[k] > y[:, None]) != (y1[k] > y[:, None])
            rise = np.where(y1[k] == y0[k], 1.0, y1[k] - y0[k])
            right = x0[k] + (y[:, None] - y0[k]) / rise * (x1[k] - x0[k]) > x[:, None]
            result[start : start + 64] = np.sum(meets & right, axis=1) % 2 == 1
        return result

    def reach(
        self,
        points: np.ndarray,
        directions: np.ndarray,
        clearance: float | np.ndarray,
        farthest: float,
    ) -> np.ndarray:
        """Measure how far points can move in a direction, keeping a clearance from all walls.

        Parameters
        ----------
        points, directions : ndarray, shape (n, 2)
            Start [m] and unit vectors.
        clearance : float or ndarray, shape (n,)
            [m]
        farthest : float
            Where the search ends [m].

        Returns
        -------
        ndarray, shape (n,)
            [m]; negative by the missing distance if the start itself is too close to a wall.
        """
        return march(self.distance, points, directions, clearance, farthest)


def clearance_of(line: Raceline, track: Raceline) -> float:
    """Least distance from a line to the walls of a track [m]; negative beyond a wall."""
    at = line.sample(np.linspace(0.0, line.length, 4 * line.n, endpoint=False))
    points = np.stack((at.x, at.y), axis=1)
    walls = Walls(track)
    return float(np.min(np.where(walls.between(points), 1.0, -1.0) * walls.distance(points)))


def march(
    distance: Callable[[np.ndarray], np.ndarray],
    points: np.ndarray,
    directions: np.ndarray,
    clearance: float | np.ndarray,
    farthest: float,
) -> np.ndarray:
    """Measure how far points can move in a direction, keeping a clearance from all walls.

    By sphere tracing: each step is as long as the distance to the nearest wall in any direction, so
    that no wall is skipped.

    Parameters
    ----------
    distance : callable
        Distance to the nearest wall [m] of points of shape (n, 2).
    points, directions, clearance, farthest
        See `Walls.reach`.

    Returns
    -------
    ndarray, shape (n,)
        See `Walls.reach`.
    """
    clearance = np.broadcast_to(clearance, len(points))
    # An optimized line runs exactly at the clearance. Start with a short step off the wall, since
    # the first step would be 0.
    away = 1e-3 * farthest
    begin, after = (distance(points + s * directions) - clearance for s in (0.0, away))
    reached = np.where((np.abs(begin) < away) & (after > np.maximum(begin, 0.0)), away, 0.0)
    going = np.arange(len(points))
    for _ in range(100):
        free = distance(points[going] + reached[going, None] * directions[going])
        free = free - clearance[going]
        reached[going] += free
        going = going[(free > 1e-5) & (reached[going] < farthest)]
        if not going.size:
            break
    return np.minimum(reached, farthest)


def smooth_between(
    points: np.ndarray,
    length: float,
    deviation: float,
    distance: Callable[[np.ndarray], np.ndarray],
    clearance: float,
) -> tuple[np.ndarray, bool]:
    """Smooth a closed line by a Gaussian as strongly as the walls allow.

    Parameters
    ----------
    points : ndarray, shape (n, 2)
        Line at equal steps [m].
    length : float
        Length of the line [m].
    deviation : float
        Standard deviation of the Gaussian along the line [m], halved until the line keeps clear.
    distance : callable
        See `march`.
    clearance : float
        Distance to keep from the walls [m].

    Returns
    -------
    smooth : ndarray, shape (n, 2)
    clear : bool
        False if the line does not keep clear even with the least smoothing.
    """
    wave = 2.0 * math.pi * np.fft.fftfreq(len(points), length / len(points))
    spectrum = np.fft.fft(points, axis=0)
    there = distance(points)
    for halved in range(6):
        blur = np.exp(-0.5 * (wave * deviation * 0.5**halved) ** 2)
        smooth = np.fft.ifft(spectrum * blur[:, None], axis=0).real
        # A point that moved less than its distance to the wall is still between the walls.
        moved = np.hypot(*(smooth - points).T)
        if np.all(distance(smooth) >= clearance) and np.all(moved < there):
            return smooth, True
    return smooth, False
