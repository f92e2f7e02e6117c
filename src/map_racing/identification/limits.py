"""What counts as steady cornering."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..errors import ParameterError

__all__ = ["RATE_HZ", "SteadyLimits"]

RATE_HZ = 50.0  # of the clock on which all signals of a drive are put


@dataclass(frozen=True)
class SteadyLimits:
    """What counts as steady; rates are taken from the low-passed signals.

    Parameters
    ----------
    cutoff_hz : float
        Cutoff of the low-pass, where half of the power passes [Hz].
    dv_mps2, dr_radps2, ddelta_radps : float
        Largest rates of speed, yaw rate and steering angle.
    shortest_s : float
        Shortest steady segment [s].
    """

    cutoff_hz: float = 1.0
    dv_mps2: float = 0.35
    dr_radps2: float = 0.35
    ddelta_radps: float = 0.1
    shortest_s: float = 0.6

    def __post_init__(self):
        for name, value in vars(self).items():
            if not 0.0 < value < math.inf:
                raise ParameterError(f"{name}: expected a positive number, got {value!r}")
        if not self.cutoff_hz < 0.4 * RATE_HZ:
            raise ParameterError(
                f"cutoff_hz: expected less than {0.4 * RATE_HZ:g} Hz, got {self.cutoff_hz:g}"
            )
