"""Where closed polylines cross."""

from __future__ import annotations

import numpy as np

from .tree import point_tree

__all__ = ["crossings"]


def crossings(a: np.ndarray, b: np.ndarray | None = None) -> np.ndarray:
    """Find the crossings of two closed polylines, or of one with itself.

    Parameters
    ----------
    a, b : ndarray, shape (n, 2), (m, 2)
        Vertices of closed polylines [m]. Without `b`, crossings of `a` with itself, each once.

    Returns
    -------
    ndarray of int, shape (k, 2)
        Segments of `a` and of `b` that cross, numbered by their first vertices. Segments that share
        a vertex do not count.

    Notes
    -----
    Candidates are segments whose midpoints are closer than the sum of their half lengths, found
    with two trees. Long segments are cut first, because a few would make all pairs candidates.
    """
    number_a, start_a, way_a = _pieces(a)
    if b is None:
        number_b, start_b, way_b = number_a, start_a, way_a
    else:
        number_b, start_b, way_b = _pieces(b)
    reach = 0.5 * (_longest(way_a) + _longest(way_b)) * (1.0 + 1e-9)
    tree = point_tree(start_a + 0.5 * way_a)
    if b is None:
        i, j = tree.query_pairs(reach, output_type="ndarray").T
        apart = np.abs(number_a[i] - number_a[j])
        far = (apart > 1) & (apart < len(a) - 1)
        i, j = i[far], j[far]
    else:
        other = point_tree(start_b + 0.5 * way_b)
        near = tree.sparse_distance_matrix(other, reach, output_type="ndarray")
        i, j = near["i"], near["j"]
    # Segments cross if the ends of each are on different sides of the other.
    between = start_b[j] - start_a[i]
    area = _cross(way_a[i], way_b[j])
    with np.errstate(divide="ignore", invalid="ignore"):
        along_a, along_b = _cross(between, way_b[j]) / area, _cross(between, way_a[i]) / area
        # Tolerance for a polyline that crosses itself exactly at a vertex.
        low, high = (-1e-9, 1.0 + 1e-9) if b is None else (0.0, 1.0)
        cross = (along_a >= low) & (along_a < high) & (along_b >= low) & (along_b < high)
    pairs = np.stack((number_a[i[cross]], number_b[j[cross]]), axis=1)
    if b is None:
        pairs.sort(axis=1)
    # np.unique of numpy 1.17 fails on zero rows
    return np.unique(pairs, axis=0) if len(pairs) else pairs


def _pieces(vertices):
    """Segments cut to at most four times the usual length: numbers, starts and vectors."""
    ways = np.roll(vertices, -1, axis=0) - vertices
    lengths = np.hypot(ways[:, 0], ways[:, 1])
    usual = max(np.median(lengths), lengths.sum() / (4.0 * len(lengths)))
    count = np.maximum(1, np.ceil(lengths / (4.0 * usual))).astype(int)
    number = np.repeat(np.arange(len(vertices)), count)
    part = np.arange(number.size) - np.repeat(np.cumsum(count) - count, count)
    ways = ways[number] / count[number][:, None]
    return number, vertices[number] + part[:, None] * ways, ways


def _longest(ways):
    return float(np.max(np.hypot(ways[:, 0], ways[:, 1])))


def _cross(a, b):
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
