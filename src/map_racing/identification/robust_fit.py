"""Fits a simulated model to measurements: robust, bounded, with priors and realistic intervals.

It uses the Levenberg-Marquardt method with the Huber loss. The model predicts for several sets of
parameters at once, because one pass over time for all of them costs hardly more than one for a
single set. Intervals follow from the disagreement between the windows (a sandwich covariance,
clustered by window), so that persistent errors, such as from a wrong model, widen them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Callable, NamedTuple

import numpy as np

__all__ = ["CONFIDENCE", "Believed", "Fitted", "fit", "own_fits"]

CONFIDENCE = 1.96  # of a normal distribution: 95 %
HUBER = 2.5  # standard deviations beyond which the pull of a residual does not grow
MOST_STEPS = 25
ROUGH, FINE = 1e-3, 1e-6  # relative gain of a step below which the search ends
LEAST_NOISE = 1e-4
OWN_STEPS = 8  # of the weights of linearized fits


class Believed(NamedTuple):
    """Prior of a parameter.

    Parameters
    ----------
    center, spread : float
        Mean and standard deviation; with a spread of inf there is no prior, with 0 the parameter is
        held.
    low, high : float
        Bounds.
    step : float
        Step for finite differences.
    """

    center: float
    spread: float
    low: float
    high: float
    step: float


@dataclass(frozen=True)
class Fitted:
    """Result of a fit.

    Parameters
    ----------
    names : tuple of str
    values : ndarray, shape (p,)
    covariance : ndarray, shape (p, p)
    noise : dict of str to float
        Standard deviation of the residuals of each quantity.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray
    noise: dict[str, float]

    def __getitem__(self, name: str) -> float:
        """Value of a parameter."""
        return float(self.values[self.names.index(name)])

    def deviation(self, gradient: dict[str, float]) -> float:
        """Standard deviation of a function of the parameters with this gradient."""
        row = np.array([gradient.get(name, 0.0) for name in self.names])
        return float(np.sqrt(max(row @ self.covariance @ row, 0.0)))


def fit(
    predict: Callable[[np.ndarray], dict[str, np.ndarray]],
    observed: dict[str, tuple],
    believed: dict[str, Believed],
    starts: list[dict[str, float]],
    noise: dict[str, float],
) -> Fitted:
    """Fit a model to measurements.

    Parameters
    ----------
    predict : callable
        ``predict(lanes)`` returns, for sets of parameters of shape (k, p), each quantity at its
        measurements, shape (k, n).
    observed : dict of str to tuple
        For each quantity a tuple that begins with the windows of the measurements and ends with
        their values.
    believed : dict of str to Believed
        Priors in the order of the parameters.
    starts : list of dict
        Changes of the centers to start from; the best result is used.
    noise : dict of str to float
        First guess of the noise of each quantity.

    Returns
    -------
    Fitted
    """
    problem = _Problem(predict, observed, believed)
    noise = {name: noise[name] for name in observed}
    best = None
    starts = [
        {name: value for name, value in start.items() if believed[name].spread > 0.0}
        for start in starts
    ]
    for start in [start for i, start in enumerate(starts) if start not in starts[:i]]:
        begin = problem.center.copy()
        for name, value in start.items():
            begin[problem.names.index(name)] = value
        solved = problem.minimize(begin, problem.errors(begin), noise, ROUGH)
        if best is None or solved[2] < best[2]:
            best = solved
    theta, errors, _ = best
    for _ in range(2):
        noise = problem.noise_of(errors)
        theta, errors, _ = problem.minimize(theta, errors, noise, FINE)
    return problem.result(theta, errors, noise)


def own_fits(
    predict: Callable[[np.ndarray], dict[str, np.ndarray]],
    observed: dict[str, tuple],
    believed: dict[str, Believed],
    fitted: Fitted,
    name: str,
    parts: list[np.ndarray],
) -> list[tuple[float, float]]:
    """What a fit leaves of one quantity in parts of the windows, and what fits of their own would.

    Own fits are linearized: that tells whether they differ, at the cost of one step of a fit.

    Parameters
    ----------
    predict, observed, believed
        As of `fit`.
    fitted : Fitted
        To all windows.
    name : str
        Of the quantity.
    parts : list of ndarray of bool
        Windows of each part.

    Returns
    -------
    list of tuple of float
        Of each part the standard deviations, without outliers.
    """
    problem = _Problem(predict, observed, believed)
    theta = fitted.values
    residual, jacobian = problem.linearized(theta, problem.errors(theta), fitted.noise)
    kind = np.concatenate([np.full(rows[0].size, key == name) for key, rows in observed.items()])
    left = []
    for part in parts:
        rows = part[problem.window]
        own = _linear_fit(problem, theta, residual[rows], jacobian[rows])
        both = residual[rows], residual[rows] + jacobian[rows] @ own
        left.append(
            tuple(
                1.4826 * fitted.noise[name] * float(np.median(np.abs(values[kind[rows]])))
                for values in both
            )
        )
    return left


def _linear_fit(problem, theta, residual, jacobian):
    """Changes of the free parameters that fit linearized residuals."""
    low, high = ((bound - theta)[problem.free] for bound in (problem.low, problem.high))
    change = np.zeros(problem.free.size)
    moved = theta.copy()
    for _ in range(OWN_STEPS):
        moved[problem.free] = theta[problem.free] + change
        hessian, gradient = problem.normal(moved, residual + jacobian @ change, jacobian)
        hessian += np.diag(1e-9 * np.diag(hessian) + 1e-12)  # as none may show in a part
        change = np.clip(change - np.linalg.solve(hessian, gradient), low, high)
    return change


class _Problem:
    """Residuals of a model, their derivatives and their minimum."""

    def __init__(self, predict, observed, believed):
        self.predict, self.observed, self.names = predict, observed, tuple(believed)
        self.center, self.spread, self.low, self.high, self.step = np.array(
            list(believed.values())
        ).T
        self.free = np.flatnonzero(self.spread > 0.0)
        self.precision = self.spread[self.free] ** -2.0
        self.window = np.concatenate([columns[0] for columns in observed.values()])
        self.measured = {name: columns[-1] for name, columns in observed.items()}

    def errors(self, theta):
        """Predicted minus measured, by quantity: at `theta`, then with each parameter stepped."""
        free = self.free
        lanes = np.repeat(theta[None], free.size + 1, axis=0)
        lanes[np.arange(1, free.size + 1), free] += self.steps(theta)
        found = self.predict(lanes)
        return {name: found[name] - values for name, values in self.measured.items()}

    def steps(self, theta):
        """Steps of the free parameters for the Jacobian, within the bounds."""
        return np.where(theta + self.step > self.high, -self.step, self.step)[self.free]

    def linearized(self, theta, errors, noise):
        """Residuals in standard deviations, and their Jacobian."""
        rows = np.concatenate([errors[name] / noise[name] for name in errors], axis=1)
        return rows[0], ((rows[1:] - rows[0]) / self.steps(theta)[:, None]).T

    def cost(self, theta, residual):
        size = np.abs(residual)
        rows = np.where(size < HUBER, 0.5 * size * size, HUBER * (size - 0.5 * HUBER))
        away = (theta - self.center)[self.free]
        return float(np.sum(rows) + 0.5 * np.sum(self.precision * away * away))

    def normal(self, theta, residual, jacobian):
        """Hessian and gradient, priors included."""
        weight = np.minimum(1.0, HUBER / np.maximum(np.abs(residual), 1e-12))
        weighted = jacobian * weight[:, None]
        hessian = weighted.T @ jacobian + np.diag(self.precision)
        away = (theta - self.center)[self.free]
        gradient = weighted.T @ residual + self.precision * away
        return hessian, gradient

    def minimize(self, theta, errors, noise, tolerance):
        """The minimum near `theta`, whose errors are given; its errors and cost."""
        low, high = self.low[self.free], self.high[self.free]
        residual, jacobian = self.linearized(theta, errors, noise)
        cost, damping = self.cost(theta, residual), 1e-3
        for _ in range(MOST_STEPS):
            hessian, gradient = self.normal(theta, residual, jacobian)
            at = theta[self.free]
            held = ((at <= low) & (gradient > 0.0)) | ((at >= high) & (gradient < 0.0))
            loose = np.flatnonzero(~held)
            system = hessian[np.ix_(loose, loose)]
            system = system + np.diag(damping * np.diag(system) + 1e-12)
            tried = theta.copy()
            tried[self.free[loose]] -= np.linalg.solve(system, gradient[loose])
            tried = np.clip(tried, self.low, self.high)
            found = self.errors(tried)
            there, slope = self.linearized(tried, found, noise)
            reached = self.cost(tried, there)
            if reached < cost:
                small = cost - reached < tolerance * cost
                theta, errors, residual, jacobian, cost = tried, found, there, slope, reached
                damping = max(0.1 * damping, 1e-6)
                if small:
                    break
            else:
                damping *= 10.0
                if damping > 1e3:
                    break
        return theta, errors, cost

    def noise_of(self, errors):
        """Standard deviations of the errors, from their medians."""
        return {
            name: max(1.4826 * float(np.median(np.abs(values))), LEAST_NOISE)
            for name, (values, *_) in errors.items()
        }

    def result(self, theta, errors, noise):
        """The fit at the minimum."""
        residual, jacobian = self.linearized(theta, errors, noise)
        hessian, _ = self.normal(theta, residual, jacobian)
        weight = np.minimum(1.0, HUBER / np.maximum(np.abs(residual), 1e-12))
        windows = int(np.max(self.window)) + 1
        scores = np.zeros((windows, self.free.size))
        np.add.at(scores, self.window, jacobian * (weight * residual)[:, None])
        few = windows / max(windows - 1, 1)
        inverse = np.linalg.pinv(hessian)
        spread = inverse @ (few * scores.T @ scores + np.diag(self.precision)) @ inverse
        covariance = np.zeros((theta.size, theta.size))
        covariance[np.ix_(self.free, self.free)] = spread
        return Fitted(self.names, theta, covariance, noise)
