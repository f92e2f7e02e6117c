"""Closed splines through points, and their resampling at equal arc lengths."""

from __future__ import annotations

import math

import numpy as np
from scipy.interpolate import CubicSpline

__all__ = ["OVERLAP", "closed_spline", "distinct_points", "resample_by_arc_length"]

# Points closer than this are duplicates [m]; the densest real tracks have a spacing of 2 mm.
_SAME_POINT = 1e-4
# Cells of 0.1 m follow any drivable curve. Coarse points get at most 16 cells each, which keeps
# memory linear in the number of points whatever their unit. Dense points get cells of at least 2 cm
# or a thousandth of the lap; finer ones would not fit the processor's cache and would make each
# control step 20 % slower.
_CELL, _CELLS_PER_POINT = 0.1, 16
_FINEST, _FINEST_OF_LAP = 0.02, 0.001

OVERLAP = 50
"""Points by which a closed spline is continued beyond its ends; 2^-50 is the rounding of floats."""

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_NODES, _WEIGHTS = 0.5 * (_NODES + 1.0), 0.5 * _WEIGHTS


def distinct_points(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Mask of the points left after consecutive repetitions are dropped.

    Parameters
    ----------
    x, y : ndarray, shape (n_points,)
        Points of a closed track [m].

    Returns
    -------
    ndarray of bool, shape (n_points,)
        False for a point less than 0.1 mm from the previous one kept, and for points at the end
        that close to the first.
    """
    keep = np.ones(x.size, dtype=bool)
    close = np.hypot(np.diff(x), np.diff(y)) < _SAME_POINT
    last = 0
    if close.any():
        for i in range(1, x.size):
            keep[i] = math.hypot(x[i] - x[last], y[i] - y[last]) >= _SAME_POINT
            last = i if keep[i] else last
    for i in np.flatnonzero(keep)[:0:-1]:
        if math.hypot(x[i] - x[0], y[i] - y[0]) >= _SAME_POINT:
            break
        keep[i] = False
    return keep


def closed_spline(u: np.ndarray, x: np.ndarray, y: np.ndarray) -> CubicSpline:
    """Closed cubic spline through points.

    The points are continued around the lap on both sides by `OVERLAP` points. The influence of the
    end conditions decays at least by half per point, so none of it is left inside. (The periodic
    spline of SciPy 1.3 has a kink at the last point but one if the spacing is uneven.)

    Parameters
    ----------
    u : ndarray, shape (n + 1,)
        Parameter at each point and, last, at the first one again; strictly increasing.
    x, y : ndarray, shape (n,)
        Points [m]; the first is not repeated.

    Returns
    -------
    CubicSpline
        Maps the parameter to positions [m], shape (2,).
    """
    index = np.arange(-OVERLAP, x.size + OVERLAP + 1)
    turn, point = np.divmod(index, x.size)
    return CubicSpline(u[point] + turn * u[-1], np.stack((x[point], y[point]), axis=1))


def resample_by_arc_length(
    x: np.ndarray, y: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Resample the closed spline through points over chord length at equal steps of arc length.

    Parameters
    ----------
    x, y : ndarray, shape (n_points,)
        Points [m]; the first is not repeated.

    Returns
    -------
    s : ndarray, shape (n_points + 1,)
        Arc length at each point and, last, of the whole lap [m].
    x, y : ndarray, shape (n_cells,)
        Positions at the start of each cell [m]; not finite where the curve reverses on the spot.
    """
    chords = np.hypot(np.roll(x, -1) - x, np.roll(y, -1) - y)
    u = np.concatenate(([0.0], np.cumsum(chords)))
    spline = closed_spline(u, x, y)
    velocity = spline.derivative()

    def arc(begin, width):
        # Arc length over [begin, begin + width] by Gauss-Legendre quadrature.
        tangents = velocity(begin[:, None] + width[:, None] * _NODES)
        return width * np.hypot(tangents[..., 0], tangents[..., 1]).dot(_WEIGHTS)

    s = np.concatenate(([0.0], np.cumsum(arc(u[:-1], chords))))
    length, spacing = s[-1], s[-1] / chords.size
    cell = min(spacing, max(_CELL, spacing / _CELLS_PER_POINT))
    cell = max(cell, min(_FINEST, _FINEST_OF_LAP * length))
    n = math.ceil(length / cell - 1e-9)
    targets = np.linspace(0.0, length, n + 1)[:-1]
    segment = np.clip(np.searchsorted(s, targets, side="right") - 1, 0, chords.size - 1)
    begin, wanted = u[segment], targets - s[segment]
    width = wanted * chords[segment] / (s[segment + 1] - s[segment])
    for _ in range(4):
        tangents = velocity(begin + width)
        # Where the curve reverses on the spot its tangent is zero.
        with np.errstate(divide="ignore", invalid="ignore"):
            width -= (arc(begin, width) - wanted) / np.hypot(tangents[:, 0], tangents[:, 1])
    points = spline(begin + width)
    return s, points[:, 0], points[:, 1]
