"""Search trees of points along curves."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

__all__ = ["point_tree"]


def point_tree(points: np.ndarray) -> cKDTree:
    """Build the tree of points that lie along curves.

    Parameters
    ----------
    points : ndarray, shape (n, 2)

    Returns
    -------
    scipy.spatial.cKDTree
        Split at the middle of boxes. The default split at the median takes time of order n^2 with
        SciPy 1.3 for points in order along a curve: 27 s for a circle of 25 km in cells of 0.1 m.
    """
    return cKDTree(points, balanced_tree=False)
