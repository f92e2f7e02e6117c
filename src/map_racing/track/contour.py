"""The zero contour of a grid of numbers."""

from __future__ import annotations

import numpy as np

__all__ = ["zero_contour"]


def zero_contour(level: np.ndarray) -> np.ndarray:
    """Longest closed curve around the negative values, as columns and rows, shape (n, 2).

    By marching squares: the curve crosses each edge between a negative and a non-negative value
    where the linear interpolation is 0, and has the negative values to its left.
    """
    negative = level < 0.0
    following, place = {}, {}

    def crossing(row, column, vertical):
        key = (row, column, vertical)
        if key not in place:
            a = level[row, column]
            b = level[row + 1, column] if vertical else level[row, column + 1]
            part = a / (a - b)
            place[key] = (column, row + part) if vertical else (column + part, row)
        return key

    low, high = negative[:-1], negative[1:]
    corners = low[:, :-1] + 2 * low[:, 1:] + 4 * high[:, 1:] + 8 * high[:, :-1]
    for row, column in np.argwhere((corners > 0) & (corners < 15)).tolist():
        # Edges counter-clockwise from the lower one; signs[k]: whether edge k starts negative.
        case = int(corners[row, column])
        edges = (
            (row, column, False),
            (row, column + 1, True),
            (row + 1, column, False),
            (row, column, True),
        )
        signs = [bool(case >> k & 1) for k in range(4)]
        # Going around the cell, the curve leaves where the sign changes from negative.
        leaves = [k for k in range(4) if signs[k] and not signs[(k + 1) % 4]]
        enters = [k for k in range(4) if not signs[k] and signs[(k + 1) % 4]]
        for k in leaves:
            # In the ambiguous case each curve cuts off one negative corner.
            end = enters[0] if len(enters) == 1 else (k - 1) % 4
            following[crossing(*edges[k])] = crossing(*edges[end])
    longest = []
    left = set(following)
    while left:
        first = left.pop()
        curve, key = [first], following[first]
        while key != first:
            left.discard(key)
            curve.append(key)
            key = following[key]
        longest = max(longest, curve, key=len)
    return np.array([place[key] for key in longest], dtype=float)
