"""Lateral tire force against slip angle: Pacejka's Magic Formula and its linearization.

Sign convention, everywhere in the package: the slip angle ``alpha`` is the direction in which the
contact patch moves, seen from the wheel, positive to the left (`single_track.slip_angles`). The
curves below are odd and rise through zero; the force on the car points *against* the slip::

    F_y = -mu F_z normalized_force(alpha)

so that in a left turn both slip angles are negative and both forces positive.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Callable

import numpy as np

from ..validation import finite, positive

__all__ = ["LinearTire", "PacejkaTire"]


@dataclass(frozen=True)
class PacejkaTire:
    """Magic Formula ``D sin(C atan(B a - E (B a - atan(B a))))``, normalized by ``mu F_z``.

    Parameters
    ----------
    B, C, D : float
        Stiffness, shape and peak factor [-], positive.
    E : float
        Curvature factor [-]. Beyond 1 the curve turns down at ``B a = 1 / sqrt(E - 1)``.

    Raises
    ------
    ParameterError
        If a coefficient is not a number up to 1e9, or not positive.
    """

    B: float
    C: float
    D: float
    E: float

    model = "pacejka"

    def __post_init__(self):
        _check(self)

    @property
    def stiffness(self) -> float:
        """Slope at zero slip, ``B C D`` [1/rad]."""
        return self.B * self.C * self.D

    @property
    def peak(self) -> float:
        """Largest normalized force [-]; where the curve has no peak, the limit it rises to."""
        return self.D * math.sin(min(self._largest_phase, 0.5 * math.pi))

    @property
    def peak_slip(self) -> float:
        """Slip angle of the largest force [rad]; inf where the curve has no peak."""
        if self._largest_phase <= 0.5 * math.pi:
            return self._turning_point / self.B
        return float(self._unbend(math.tan(0.5 * math.pi / self.C))) / self.B

    def normalized_force(self, alpha: float | np.ndarray) -> np.ndarray:
        """Force ``-F_y / (mu F_z)`` at slip angles.

        Parameters
        ----------
        alpha : float or ndarray
            Slip angle [rad], of any shape.

        Returns
        -------
        ndarray
            [-], in the shape of `alpha`.
        """
        x = self.B * np.asarray(alpha, dtype=float)
        return self.D * np.sin(self.C * np.arctan(x - self.E * (x - np.arctan(x))))

    def slope(self, alpha: float | np.ndarray) -> np.ndarray:
        """Derivative of `normalized_force`.

        Parameters
        ----------
        alpha : float or ndarray
            Slip angle [rad], of any shape.

        Returns
        -------
        ndarray
            [1/rad], in the shape of `alpha`.
        """
        x = self.B * np.asarray(alpha, dtype=float)
        y = x - self.E * (x - np.arctan(x))
        return self.stiffness * np.cos(self.C * np.arctan(y)) * self._bend(x) / (1.0 + y * y)

    def slip(self, force: float | np.ndarray) -> np.ndarray:
        """Slip angle [rad] on the rising side of the curve, the inverse of `normalized_force`.

        NaN where the tire cannot give that force.

        Parameters
        ----------
        force : float or ndarray
            Normalized force [-], of any shape.

        Returns
        -------
        ndarray
            [rad], in the shape of `force`.
        """
        sine = np.asarray(force, dtype=float) / self.D
        with np.errstate(invalid="ignore"):
            phase = np.arcsin(np.where(np.abs(sine) <= 1.0, sine, np.nan)) / self.C
            phase = np.where(np.abs(phase) * self.C <= self._largest_phase, phase, np.nan)
        return self._unbend(np.tan(phase)) / self.B

    def scalar(self) -> Callable[[float], float]:
        """`normalized_force` for one float as a plain function, for the loops of the plant."""
        B, C, D, E = self.B, self.C, self.D, self.E
        atan, sin = math.atan, math.sin

        def force(alpha):
            x = B * alpha
            return D * sin(C * atan(x - E * (x - atan(x))))

        return force

    def scalar_with_slope(self) -> Callable[[float], tuple[float, float]]:
        """As `scalar`, with the derivative [1/rad] as a second result."""
        B, C, D, E = self.B, self.C, self.D, self.E
        stiffness = self.stiffness
        atan, sin, cos = math.atan, math.sin, math.cos

        def force_and_slope(alpha):
            x = B * alpha
            square = x * x
            y = x - E * (x - atan(x))
            phase = C * atan(y)
            bend = (1.0 + (1.0 - E) * square) / (1.0 + square)
            return D * sin(phase), stiffness * cos(phase) * bend / (1.0 + y * y)

        return force_and_slope

    @property
    def _turning_point(self):
        """Where ``x - E (x - atan x)`` with ``x = B a`` stops rising: inf unless E > 1."""
        return 1.0 / math.sqrt(self.E - 1.0) if self.E > 1.0 else math.inf

    @property
    def _largest_phase(self):
        """Largest argument of the sine [rad], on the way to the turning point."""
        if self.E < 1.0:
            return 0.5 * math.pi * self.C
        x = self._turning_point
        y = math.atan(x) + (x - math.atan(x)) * (1.0 - self.E) if self.E > 1.0 else 0.5 * math.pi
        return self.C * math.atan(y)

    def _bend(self, x):
        """Derivative of ``x - E (x - atan x)``, without cancellation as E approaches 1."""
        return (1.0 + (1.0 - self.E) * (x * x)) / (1.0 + x * x)

    def _unbend(self, y):
        """Solve ``x - E (x - atan x) = y`` for x up to the turning point.

        Newton's method from ``x = y`` cannot diverge, because it approaches the root from one side:
        for E > 0 from below on a concave function, for E < 0 from above on a convex one (for x > 0;
        the function is odd).
        """
        y = np.asarray(y, dtype=float)
        x = y
        for _ in range(60):
            step = (x - self.E * (x - np.arctan(x)) - y) / self._bend(x)
            x = x - step
            with np.errstate(invalid="ignore"):
                if not np.any(np.abs(step) > 1e-9 * (1.0 + np.abs(x))):
                    break
        return x


@dataclass(frozen=True)
class LinearTire:
    """Force proportional to slip, ``C_S a``, normalized by ``mu F_z``.

    Parameters
    ----------
    C_S : float
        Cornering stiffness normalized by the vertical load [1/rad], positive.

    Raises
    ------
    ParameterError
        If it is not a positive number up to 1e9.
    """

    C_S: float

    model = "linear"

    def __post_init__(self):
        _check(self)

    @property
    def stiffness(self) -> float:
        """Slope, ``C_S`` [1/rad]."""
        return self.C_S

    @property
    def peak(self) -> float:
        """Largest normalized force: inf, a linear tire does not saturate."""
        return math.inf

    @property
    def peak_slip(self) -> float:
        """Slip angle of the largest force: inf."""
        return math.inf

    def normalized_force(self, alpha: float | np.ndarray) -> np.ndarray:
        """Force ``-F_y / (mu F_z)`` [-] at slip angles [rad], of their shape."""
        return self.C_S * np.asarray(alpha, dtype=float)

    def slope(self, alpha: float | np.ndarray) -> np.ndarray:
        """Derivative of `normalized_force` [1/rad] at slip angles [rad], of their shape."""
        return np.full_like(np.asarray(alpha, dtype=float), self.C_S)

    def slip(self, force: float | np.ndarray) -> np.ndarray:
        """Slip angles [rad] of normalized forces [-], of their shape; see `PacejkaTire.slip`."""
        return np.asarray(force, dtype=float) / self.C_S

    def scalar(self) -> Callable[[float], float]:
        """`normalized_force` for one float as a plain function, for the loops of the plant."""
        C_S = self.C_S

        def force(alpha):
            return C_S * alpha

        return force

    def scalar_with_slope(self) -> Callable[[float], tuple[float, float]]:
        """As `scalar`, with the derivative [1/rad] as a second result."""
        C_S = self.C_S
        return lambda alpha: (C_S * alpha, C_S)


def _check(tire):
    """Check the coefficients and store them as floats."""
    for field in fields(tire):
        check = finite if field.name == "E" else positive
        object.__setattr__(tire, field.name, check(field.name, getattr(tire, field.name)))
