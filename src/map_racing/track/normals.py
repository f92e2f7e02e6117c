"""Normals of a line: where they leave it, meet each other, and reach the walls."""

from __future__ import annotations

import numpy as np

from .raceline import CurveSamples, Raceline
from .walls import Walls

__all__ = [
    "MEETING",
    "even_points",
    "offsets_between_walls",
    "offsets_to_meeting",
    "points_and_normals",
]

MEETING = 0.9
"""Normals are cut at this share of the distance to where they meet; beyond it points swap order."""


def points_and_normals(line: Raceline | CurveSamples) -> tuple[np.ndarray, np.ndarray]:
    """Points of a line and the unit vectors to their left.

    Parameters
    ----------
    line : Raceline or CurveSamples

    Returns
    -------
    points, normals : ndarray, shape (n, 2)
        [m] and [-]
    """
    return (
        np.stack((line.x, line.y), axis=1),
        np.stack((-np.sin(line.psi), np.cos(line.psi)), axis=1),
    )


def even_points(line: Raceline, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points at equal arc lengths, and the unit vectors to their left.

    Parameters
    ----------
    line : Raceline
    count : int
        Number of points.

    Returns
    -------
    points, normals : ndarray, shape (count, 2)
        [m] and [-]
    """
    return points_and_normals(line.sample(np.arange(count) * (line.length / count)))


def offsets_to_meeting(points: np.ndarray, normals: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Largest offsets to the left and to the right before neighboring normals meet.

    Parameters
    ----------
    points, normals : ndarray, shape (n, 2)
        Points of a closed line in order [m], and the unit vectors to its left.

    Returns
    -------
    left, right : ndarray, shape (n,)
        [m], positive; infinite where they do not meet.
    """
    after = np.roll(normals, -1, axis=0)
    turn = np.arctan2(
        normals[:, 0] * after[:, 1] - normals[:, 1] * after[:, 0], np.sum(normals * after, axis=1)
    )
    chord = np.hypot(*(np.roll(points, -1, axis=0) - points).T)
    # They meet where the offset is the radius of the turn between the points.
    with np.errstate(divide="ignore"):
        radius = MEETING * chord / np.abs(turn)
    left, right = (np.where(turn * side > 0.0, radius, np.inf) for side in (1.0, -1.0))
    return np.minimum(left, np.roll(left, 1)), np.minimum(right, np.roll(right, 1))


def offsets_between_walls(
    points: np.ndarray, normals: np.ndarray, walls: Walls, clearance: np.ndarray, farthest: float
) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest offset along the normals that keep a clearance from the walls.

    Parameters
    ----------
    points, normals : ndarray, shape (n, 2)
        Points of a closed line in order [m], and the unit vectors to its left.
    walls : Walls
    clearance : ndarray, shape (n,)
        Distance to keep from the walls [m].
    farthest : float
        Largest offset to either side [m].

    Returns
    -------
    low, high : ndarray, shape (n,)
        [m], positive to the left.
    """
    begin = _clear_offset(points, normals, walls, clearance)
    inside = points + begin[:, None] * normals
    high = begin + walls.reach(inside, normals, clearance, farthest)
    low = begin - walls.reach(inside, -normals, clearance, farthest)
    return low, high


def _clear_offset(points, normals, walls, clearance):
    """Offsets that move points away from a wall they are slightly too close to; otherwise 0."""
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
