"""Where closed polylines cross."""

from __future__ import annotations

import numpy as np

from .tree import point_tree

__all__ = ["Polyline", "crossings"]


class Polyline:
    """A closed polyline that is searched for crossings, more than once without more work.

    Parameters
    ----------
    vertices : ndarray, shape (n, 2)
        [m]
    """

    def __init__(self, vertices: np.ndarray):
        self.vertices = vertices
        self.number, self.start, self.way = _pieces(vertices)
        self.longest = float(np.max(np.hypot(self.way[:, 0], self.way[:, 1])))
        self.tree = point_tree(self.start + 0.5 * self.way)


def crossings(a: Polyline, b: Polyline | None = None) -> np.ndarray:
    """Find the crossings of two closed polylines, or of one with itself.

    Parameters
    ----------
    a, b : Polyline
        Without `b`, crossings of `a` with itself, each once.

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
    other = b or a
    reach = 0.5 * (a.longest + other.longest) * (1.0 + 1e-9)
    if b is None:
        i, j = a.tree.query_pairs(reach, output_type="ndarray").T
        apart = np.abs(a.number[i] - a.number[j])
        far = (apart > 1) & (apart < len(a.vertices) - 1)
        i, j = i[far], j[far]
    else:
        near = a.tree.sparse_distance_matrix(b.tree, reach, output_type="ndarray")
        i, j = near["i"], near["j"]
    # Segments cross if the ends of each are on different sides of the other.
    way_a, way_b = a.way[i], other.way[j]
    between = other.start[j] - a.start[i]
    area = _cross(way_a, way_b)
    with np.errstate(divide="ignore", invalid="ignore"):
        along_a, along_b = _cross(between, way_b) / area, _cross(between, way_a) / area
        # Tolerance for a polyline that crosses itself exactly at a vertex.
        low, high = (-1e-9, 1.0 + 1e-9) if b is None else (0.0, 1.0)
        cross = (along_a >= low) & (along_a < high) & (along_b >= low) & (along_b < high)
    pairs = np.stack((a.number[i[cross]], other.number[j[cross]]), axis=1)
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


def _cross(a, b):
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
