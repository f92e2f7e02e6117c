"""Offsets of least squared curvature within bounds: Gauss-Newton and an interior-point method."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import LinAlgError, cho_solve_banded, cholesky_banded

__all__ = ["least_curvature"]

# Relative gain below which the Gauss-Newton steps end, and their largest number.
_STEP_GAIN, _MOST_STEPS = 1e-6, 40


class _Model(NamedTuple):
    """The objective around some offsets: value, gradient, and the diagonals (j, j), (j, j + 1) and
    (j, j + 2) around the lap of a convex approximation of half its Hessian."""

    value: float
    gradient: np.ndarray
    main: np.ndarray
    first: np.ndarray
    second: np.ndarray


def least_curvature(
    points: np.ndarray,
    normals: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    alpha: np.ndarray,
    tension: float,
) -> np.ndarray:
    """Find the offsets of least squared curvature and weighted length.

    Parameters
    ----------
    points, normals : ndarray, shape (n, 2)
        Reference line [m] and the unit vectors to its left.
    low, high : ndarray, shape (n,)
        Bounds of the offsets along the normals [m].
    alpha : ndarray, shape (n,)
        Offsets to start from [m].
    tension : float
        Weight of the length relative to the squared curvature [1/m^2].

    Returns
    -------
    ndarray, shape (n,)
        Offsets [m].
    """
    alpha = np.clip(alpha, low, high)
    model = _model(points, normals, alpha, tension)
    for _ in range(_MOST_STEPS):
        step = _bounded_minimum(model, low - alpha, high - alpha)
        share = 1.0
        while share > 1e-3:
            trial = np.clip(alpha + share * step, low, high)
            there = _model(points, normals, trial, tension)
            if there.value < model.value:
                break
            share *= 0.5
        else:
            break
        gain = 1.0 - there.value / model.value
        alpha, model = trial, there
        if gain < _STEP_GAIN:
            break
    return alpha


def _model(points, normals, alpha, tension):
    """Integral of squared curvature plus tension along the polygon of these offsets."""
    path = points + alpha[:, None] * normals
    side = np.roll(path, -1, axis=0) - path
    length = np.hypot(side[:, 0], side[:, 1])
    ahead = np.roll(normals, -1, axis=0)
    # Derivatives of direction and length of each side with respect to the offsets of its ends.
    turn_end = (side[:, 0] * ahead[:, 1] - side[:, 1] * ahead[:, 0]) / length**2
    turn_begin = -(side[:, 0] * normals[:, 1] - side[:, 1] * normals[:, 0]) / length**2
    grow_end = np.sum(side * ahead, axis=1) / length
    grow_begin = -np.sum(side * normals, axis=1) / length

    before = np.roll(side, 1, axis=0)
    angle = np.arctan2(
        before[:, 0] * side[:, 1] - before[:, 1] * side[:, 0], np.sum(before * side, axis=1)
    )
    span = 0.5 * (length + np.roll(length, 1))
    root = np.sqrt(span)
    # Residuals whose squares sum up to the integral, and their derivatives with respect to the
    # offsets before, at and after each point.
    residual = angle / root
    shrink = -0.25 * angle / (span * root)  # derivative with respect to twice the span
    j_before = -np.roll(turn_begin, 1) / root + shrink * np.roll(grow_begin, 1)
    j_at = (turn_begin - np.roll(turn_end, 1)) / root + shrink * (grow_begin + np.roll(grow_end, 1))
    j_after = turn_end / root + shrink * grow_end

    gradient = j_at * residual + np.roll(j_before * residual, -1) + np.roll(j_after * residual, 1)
    main = j_at**2 + np.roll(j_before, -1) ** 2 + np.roll(j_after, 1) ** 2
    first = j_at * j_after + np.roll(j_at * j_before, -1)
    second = np.roll(j_before * j_after, -1)

    # A length grows with the square of the lateral motion of its ends.
    half = 0.5 * tension
    gradient = gradient + half * (grow_begin + np.roll(grow_end, 1))
    across = half * length
    main = main + across * turn_begin**2 + np.roll(across * turn_end**2, 1)
    first = first + across * turn_begin * turn_end
    value = float(residual.dot(residual) + tension * length.sum())
    return _Model(value, gradient, main, first, second)


def _bounded_minimum(model, low, high):
    """Step to the minimum of the model within bounds, by a primal-dual interior-point method.

    Each iteration factors one banded matrix and takes Mehrotra's predictor and corrector steps
    (S. Mehrotra, *On the implementation of a primal-dual interior point method*, SIAM Journal on
    Optimization 2, 1992).
    """
    _, gradient, main, first, second = model
    n = gradient.size
    # Moving the whole line does not change the curvature, so a small term on the diagonal keeps the
    # matrix regular; its effect vanishes with the step.
    main = main + 1e-9 * main.mean()

    # Some room even where the track is only as wide as the car.
    room = np.maximum(high - low, 1e-6)
    x = np.clip(0.0, low + 0.05 * room, low + 0.95 * room)
    scale = float(np.max(np.abs(gradient))) + 1e-12
    push_low, push_high = np.full(n, scale), np.full(n, scale)  # multipliers of the bounds
    system = _Cyclic(n)
    for _ in range(60):
        to_low, to_high = np.maximum(x - low, 1e-14), np.maximum(low + room - x, 1e-14)
        product = main * x + first * np.roll(x, -1) + np.roll(first * x, 1)
        product += second * np.roll(x, -2) + np.roll(second * x, 2)
        dual = product + gradient - push_low + push_high
        gap = float(to_low.dot(push_low) + to_high.dot(push_high)) / (2 * n)
        if gap < 1e-9 * scale and np.max(np.abs(dual)) < 1e-7 * scale:
            break
        try:
            factor = system.factor(main + push_low / to_low + push_high / to_high, first, second)
        except LinAlgError:  # only rounding errors are left to gain
            break
        state = to_low, to_high, push_low, push_high
        direction = partial(_direction, system, factor, dual, state)
        move, move_low, move_high, primal, dually = direction(0.0, 0.0)
        after = float(
            (to_low + primal * move).dot(push_low + dually * move_low)
            + (to_high - primal * move).dot(push_high + dually * move_high)
        ) / (2 * n)
        center = gap * (after / gap) ** 3
        move, move_low, move_high, primal, dually = direction(
            center - move * move_low, center + move * move_high
        )
        x = x + 0.995 * primal * move
        push_low = push_low + 0.995 * dually * move_low
        push_high = push_high + 0.995 * dually * move_high
    return x


def _direction(system, factor, dual, state, target_low, target_high):
    """Newton direction toward target complementarity products, and its feasible step lengths."""
    to_low, to_high, push_low, push_high = state
    wanted_low, wanted_high = target_low - push_low * to_low, target_high - push_high * to_high
    move = system.solve(factor, wanted_low / to_low - wanted_high / to_high - dual)
    move_low = (wanted_low - push_low * move) / to_low
    move_high = (wanted_high + push_high * move) / to_high
    primal = min(_room(to_low, move), _room(to_high, -move))
    dually = min(_room(push_low, move_low), _room(push_high, move_high))
    return move, move_low, move_high, primal, dually


def _room(value, move):
    """Largest share up to 1 of a move that keeps a positive value from changing sign."""
    falling = move < 0.0
    if not falling.any():
        return 1.0
    with np.errstate(over="ignore"):
        return min(1.0, float(np.min(-value[falling] / move[falling])))


class _Cyclic:
    """Symmetric cyclic pentadiagonal matrices, reordered as banded ones.

    The order 0, n - 1, 1, n - 2, ... brings indices at most two apart around the lap to places at
    most four apart.
    """

    def __init__(self, n):
        order = np.empty(n, dtype=int)
        order[0::2] = np.arange((n + 1) // 2)
        order[1::2] = n - 1 - np.arange(n // 2)
        self._order = order
        place = np.empty(n, dtype=int)
        place[order] = np.arange(n)
        self._entries = []
        for shift in range(3):
            row, column = place, np.roll(place, -shift)
            self._entries.append((np.abs(row - column), np.minimum(row, column)))
        self._n = n

    def factor(self, main, first, second):
        """Cholesky factor of the matrix with these diagonals, each of shape (n,)."""
        band = np.zeros((5, self._n))
        for (diagonal, column), values in zip(self._entries, (main, first, second)):
            band[diagonal, column] = values
        return cholesky_banded(band, overwrite_ab=True, lower=True, check_finite=False)

    def solve(self, factor, right_side):
        """Solution for one right-hand side."""
        solution = np.empty(self._n)
        solution[self._order] = cho_solve_banded(
            (factor, True), right_side[self._order], check_finite=False
        )
        return solution
