"""Fits a tire curve to the points of an axle (`axles`).

Two things differ from the paper (Becker et al., ICRA 2023, section on the identification of the
tires); tests show why:

- Localization errors shift the slip of both axles equally. So the points of the stiffer rear axle
  are moved to its curve, and those of the front axle by the same amount; the difference of both
  slips depends only on yaw rate and steering.
- Slip angles are noisy, too; on a stiff axle the noise exceeds the slip. Least squares on the
  force then gives too soft a curve, with any amount of data. So the residual is the first-order
  distance to the curve in the metric of both noises (Sampson 1982) [N], which equals the paper's
  residual if there is no slip noise.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares

from ..errors import IdentificationError
from ..vehicle.parameters import Tire
from ..vehicle.tires import LinearTire, PacejkaTire
from .axles import AxlePoints
from .robust_fit import CONFIDENCE

__all__ = [
    "AT_PEAK",
    "LinearFit",
    "Parameter",
    "PacejkaFit",
    "beside_rear",
    "fit_linear",
    "fit_pacejka",
    "left_by",
]

# Bounds of B, C, D, E. The paper's limits of C and E keep the curve from turning back to zero.
LOWER = np.array([0.3, 1.0, 0.05, -5.0])
UPPER = np.array([150.0, 1.5, 4.0, 1.1])
# Prior standard deviations of C, ln D and E around their start; worth one measurement.
PRIOR_SPREAD = np.array([0.15, 0.3, 0.5])
# A parameter is determined if the data reduce its spread below this share of the prior's.
UNDETERMINED = 0.5
# The peak is reached if the measured forces extend to AT_PEAK of it, the upper end of its interval
# is at most ABOVE times the largest force,
AT_PEAK, ABOVE = 0.95, 1.1
# and the smallest forces are below this share of the largest, so that they rise to it.
RISEN = 0.75
# A curve that still rises with this share of its first slope is straight: a chord is that slope.
STRAIGHT = 0.8
FEWEST_POINTS = 20
NEAREST_STEPS = 5  # iterations to the nearest point of a curve
FEW_POINTS = 300  # enough for the first fit


class Parameter(NamedTuple):
    """A value with its 95 % confidence interval, and whether the data determine it."""

    value: float
    low: float
    high: float
    determined: bool


@dataclass(frozen=True)
class PacejkaFit:
    """Magic Formula through the points of an axle.

    Parameters
    ----------
    tire : PacejkaTire
        Normalized by the static load, ``mu = 1``.
    inlier : ndarray of bool, shape (n,)
        Points kept by the last step.
    error : ndarray, shape (n,)
        Distance of each point from the curve in the metric of both noises [N].
    residual : ndarray, shape (n,)
        Force of each point minus the curve [N].
    parameters : dict of str to Parameter
        ``B C D E``, ``stiffness_n_per_rad`` and ``peak_n``.
    covered_slip : float
        Largest slip angle of the kept points [rad]: 98th percentile.
    rise : float
        Slope of the curve there relative to zero slip: 0 at the peak, 1 in the linear range.
    reach : float
        Force of the curve there relative to its peak.
    saturated : bool
        Whether the measured forces end at the peak; otherwise it is extrapolated.
    """

    tire: PacejkaTire
    inlier: np.ndarray
    error: np.ndarray
    residual: np.ndarray
    parameters: dict[str, Parameter]
    covered_slip: float
    rise: float
    reach: float
    saturated: bool

    @property
    def rejected_share(self):
        """Share of the points that were rejected."""
        return 1.0 - float(np.mean(self.inlier))

    @property
    def mean_residual_n(self):
        """Mean absolute residual of the kept points [N], the paper's figure."""
        return float(np.mean(np.abs(self.residual[self.inlier])))


@dataclass(frozen=True)
class LinearFit:
    """Linear tire through the points of an axle.

    Parameters
    ----------
    tire : LinearTire
        Normalized by the static load, ``mu = 1``.
    stiffness_n_per_rad : Parameter
    mean_residual_n : float
        Mean absolute error [N].
    """

    tire: LinearTire
    stiffness_n_per_rad: Parameter
    mean_residual_n: float


def beside_rear(front: AxlePoints, rear: AxlePoints, tire: PacejkaTire) -> AxlePoints:
    """Points of the front axle without the sideslip errors that the rear axle reveals.

    Parameters
    ----------
    front, rear : AxlePoints
        Points of the same motions.
    tire : PacejkaTire
        Tire of the rear axle: its points are moved to the nearest point of the curve, and the front
        axle's by the same amount.

    Returns
    -------
    AxlePoints
    """
    theta = tire.B, tire.C, tire.D, tire.E
    move = _to_curve(theta, -rear.slip, rear.force, rear.load, _ratio(rear), NEAREST_STEPS)
    if not np.any(move):
        return front
    return front._replace(slip=front.slip - move, slip_noise=front.difference_noise)


def fit_pacejka(
    points: AxlePoints,
    start: Tire | None = None,
    threshold: float = 10.0,
    oversampling: float = 1.0,
) -> PacejkaFit:
    """Fit the Magic Formula in the paper's steps of fitting and rejecting.

    After a robust first fit, for k = 1, 2, 3, all points with an error below ``threshold / 2^k``
    are kept and fitted by bounded least squares, with C at most 1.5 and E at most 1.1.

    Parameters
    ----------
    points : AxlePoints
    start : PacejkaTire, optional
        C, D and E to keep if the data do not determine them.
    threshold : float
        See above [N].
    oversampling : float
        Points per independent measurement: low-passed neighbors are correlated, and confidence
        intervals must not shrink with the sampling rate.

    Raises
    ------
    IdentificationError
        If there are fewer than 20 points, or fewer than half of them are near any curve.
    """
    slip, force = -points.slip, points.force
    if slip.size < FEWEST_POINTS:
        raise IdentificationError(
            f"expected at least {FEWEST_POINTS} points of steady cornering, got {slip.size}"
        )
    ratio = _ratio(points)
    prior = _prior(start)
    first = _robust(slip, force, points.load, ratio, prior)
    error = _errors(first, slip, force, points.load, ratio)
    inlier = np.ones(slip.size, dtype=bool)
    theta = first
    for k in (1, 2, 3):
        inlier = np.abs(error) < threshold / 2.0**k
        if np.count_nonzero(inlier) < max(FEWEST_POINTS // 2, 0.5 * slip.size):
            raise IdentificationError(
                f"only {np.mean(inlier):.0%} of {slip.size} points lie within "
                f"{threshold / 2.0**k:.2f} N of any tire curve: not the steady cornering of one car"
            )
        kept = slip[inlier], force[inlier], points.load, ratio
        noise = math.sqrt(oversampling * np.mean(error[inlier] ** 2))
        theta, jacobian = _least_squares(theta, *kept, prior, noise)
        error = _errors(theta, slip, force, points.load, ratio)
    noise = math.sqrt(oversampling * np.mean(error[inlier] ** 2))
    covered = _covered(theta, slip[inlier], force[inlier], points.load, ratio)
    tire = PacejkaTire(*theta)
    rise = float(tire.slope(covered)) / tire.stiffness
    reach = float(tire.normalized_force(min(covered, tire.peak_slip))) / tire.peak
    least, largest = (float(f) for f in np.percentile(np.abs(force[inlier]), (2.0, 98.0)))
    rises = least < RISEN * largest
    most = ABOVE * largest if reach >= AT_PEAK and rises else 0.0
    begins = rises or rise > STRAIGHT
    parameters, saturated = _intervals(theta, jacobian, noise, points.load, most, begins)
    residual = force - points.load * tire.normalized_force(slip)
    return PacejkaFit(tire, inlier, error, residual, parameters, covered, rise, reach, saturated)


def left_by(tire: PacejkaTire, points: AxlePoints) -> float:
    """Robust standard deviation of the points from a curve, in the metric of both noises [N]."""
    ratio = _ratio(points)
    theta = (tire.B, tire.C, tire.D, tire.E)
    error = _errors(theta, -points.slip, points.force, points.load, ratio)
    return 1.4826 * float(np.median(np.abs(error)))


def fit_linear(
    points: AxlePoints, inlier: np.ndarray | None = None, oversampling: float = 1.0
) -> LinearFit:
    """Linear tire by regression through the origin.

    Parameters
    ----------
    points : AxlePoints
    inlier : ndarray of bool, shape (n,), optional
        Points to use.
    oversampling : float
        As for `fit_pacejka`.
    """
    keep = slice(None) if inlier is None else inlier
    slip, force = -points.slip[keep], points.force[keep]
    ratio = _ratio(points)

    def residuals(stiffness):
        return (force - stiffness[0] * slip) / math.hypot(1.0, ratio * stiffness[0])

    begin = max(float(force @ slip / max(slip @ slip, 1e-12)), 0.1 * points.load)
    solution = least_squares(residuals, [begin], bounds=([1e-6], [np.inf]), x_scale=[begin])
    stiffness = float(solution.x[0])
    variance = oversampling * float(np.mean(solution.fun**2))
    spread = CONFIDENCE * math.sqrt(variance / max(float(np.sum(solution.jac**2)), 1e-300))
    return LinearFit(
        LinearTire(stiffness / points.load),
        Parameter(stiffness, stiffness - spread, stiffness + spread, spread < 0.5 * stiffness),
        float(np.mean(np.abs(force - stiffness * slip))),
    )


def _ratio(points):
    """Noise of the slip over that of the force [rad/N]."""
    return points.slip_noise / points.force_noise if points.force_noise > 0.0 else 0.0


def _prior(start):
    """Prior means of C, ln D and E."""
    if not isinstance(start, PacejkaTire):
        return np.array([1.3, 0.0, 0.0])
    _, C, D, E = np.clip([start.B, start.C, start.D, start.E], LOWER, UPPER)
    return np.array([C, math.log(D), E])


def _curve(theta, slip):
    """Normalized force and its slope over slip, for any parameters within the bounds."""
    B, C, D, E = theta
    x = B * slip
    y = x - E * (x - np.arctan(x))
    phase = C * np.arctan(y)
    slope = D * np.cos(phase) * C / (1.0 + y * y) * (1.0 - E * x * x / (1.0 + x * x)) * B
    return D * np.sin(phase), slope


def _errors(theta, slip, force, load, ratio):
    """Distance of the points from the curve [N], in the metric of both noises."""
    normalized, slope = _curve(theta, slip)
    return (force - load * normalized) / np.hypot(1.0, ratio * load * slope)


def _covered(theta, slip, force, load, ratio):
    """98th percentile of the slip of the points, each moved to the nearest point of the curve."""
    moved = slip + _to_curve(theta, slip, force, load, ratio)
    return float(np.percentile(np.abs(moved), 98.0))


def _to_curve(theta, slip, force, load, ratio, steps=1):
    """Slip from each point to the nearest point of the curve [rad], by Gauss-Newton steps."""
    move = np.zeros_like(slip)
    for _ in range(steps):
        normalized, slope = _curve(theta, slip + move)
        steep = ratio * load * slope
        missing = ratio * (force - load * normalized)
        move = move + (steep * missing - move) / (1.0 + steep * steep)
    return move


def _robust(slip, force, load, ratio, prior):
    """First fit, robust against up to a quarter of outliers: the best of several starts."""
    scale = max(0.02 * load, 0.1)
    some = slice(None, None, max(slip.size // FEW_POINTS, 1))
    slip, force = slip[some], force[some]
    best = None
    for stiffness in _stiffnesses(slip, force, load):
        for C, D, E in ((1.3, 1.0, 0.0), (1.5, math.exp(prior[1]), 0.9)):
            begin = np.clip([stiffness / (C * D), C, D, E], LOWER * 1.001, UPPER * 0.999)
            begin[3] = min(max(begin[3], LOWER[3]), UPPER[3] * 0.999)
            solution = least_squares(
                _errors,
                begin,
                bounds=(LOWER, UPPER),
                x_scale=(10.0, 0.3, 0.5, 1.0),
                loss="cauchy",
                f_scale=scale,
                args=(slip, force, load, ratio),
                max_nfev=60,
                ftol=1e-6,
            )
            if best is None or solution.cost < best.cost:
                best = solution
    return best.x


def _stiffnesses(slip, force, load):
    """Guesses of the normalized slope at zero, from points with less than half the force."""
    small = (np.abs(force) < 0.5 * np.percentile(np.abs(force), 95)) & (np.abs(slip) > 1e-4)
    chords = force[small] / (load * slip[small]) if small.any() else np.array([10.0])
    middle = float(np.clip(np.median(chords), 1.0, 150.0))
    return (middle, min(3.0 * middle, 150.0))


def _least_squares(begin, slip, force, load, ratio, prior, noise):
    """Parameters within the bounds and the Jacobian of the points' errors there."""

    def residuals(theta):
        stay = noise * (np.array([theta[1], math.log(theta[2]), theta[3]]) - prior) / PRIOR_SPREAD
        return np.append(_errors(theta, slip, force, load, ratio), stay)

    inside = np.clip(begin, LOWER + 1e-6, UPPER - 1e-6)
    solution = least_squares(
        residuals, inside, bounds=(LOWER, UPPER), x_scale=(10.0, 0.3, 0.5, 1.0), max_nfev=200
    )
    return solution.x, solution.jac[: slip.size]


def _intervals(theta, jacobian, noise, load, most, begins):
    """95 % intervals from the covariance, what is determined, and whether the peak was reached.

    A parameter is determined if the data reduce its spread well below the prior's. The peak, and
    the parameters that shape it, also need data that reach it, so that its interval ends below
    `most` [N]. The slope at zero slip, and B, need forces that begin well below the largest
    (`begins`): those at a single slip tell a chord of the curve.
    """
    information = jacobian.T @ jacobian / max(noise, 1e-9) ** 2
    spread = np.array(
        [0.5 * theta[0], PRIOR_SPREAD[0], PRIOR_SPREAD[1] * theta[2], PRIOR_SPREAD[2]]
    )
    precision = np.diag(spread**-2)
    precision[0, 0] *= 1e-4
    covariance = np.linalg.inv(information + precision)
    deviation = np.sqrt(np.diag(covariance))

    def derived(function):
        """Value of a function of the parameters, and its standard deviation."""
        value, gradient = function(theta), np.zeros(4)
        for i, step in enumerate(np.maximum(1e-4 * np.abs(theta), 1e-5)):
            moved = np.array(theta)
            moved[i] += step if theta[i] + step < UPPER[i] else -step
            gradient[i] = (function(moved) - value) / (moved[i] - theta[i])
        return value, math.sqrt(max(float(gradient @ covariance @ gradient), 0.0))

    peak, unsure = derived(lambda p: load * PacejkaTire(*p).peak)
    saturated = peak + CONFIDENCE * unsure <= most
    parameters = {}
    for i, name in enumerate("BCDE"):
        known = deviation[i] < UNDETERMINED * spread[i]
        # A parameter at its bound is not measured.
        known &= LOWER[i] + 1e-3 < theta[i] < UPPER[i] - 1e-3
        known &= begins if name == "B" else saturated
        low, high = theta[i] - CONFIDENCE * deviation[i], theta[i] + CONFIDENCE * deviation[i]
        low, high = max(low, LOWER[i]), min(high, UPPER[i])
        parameters[name] = Parameter(float(theta[i]), float(low), float(high), bool(known))
    for name, (value, deviation), known in (
        ("stiffness_n_per_rad", derived(lambda p: load * p[0] * p[1] * p[2]), begins),
        ("peak_n", (peak, unsure), saturated),
    ):
        known = known and CONFIDENCE * deviation < 0.5 * value
        parameters[name] = Parameter(
            float(value),
            float(max(value - CONFIDENCE * deviation, 0.0)),
            float(value + CONFIDENCE * deviation),
            bool(known),
        )
    return parameters, bool(saturated)
