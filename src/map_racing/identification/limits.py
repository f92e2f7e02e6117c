"""Limits of steady cornering, and other constants of the identification that have options."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import ParameterError
from ..validation import POSITIVE, check, documented, parameter

__all__ = ["RATE_HZ", "REPLAY_WINDOW_S", "SteadyLimits"]

REPLAY_WINDOW_S = 2.0  # in which a car is driven by the commands alone
RATE_HZ = 50.0  # of the common clock of a drive's signals


@documented
@dataclass(frozen=True)
class SteadyLimits:
    """Limits of steady driving; rates are taken from the low-passed signals."""

    cutoff_hz: float = parameter(
        "Cutoff of the low-pass, where half of the power passes", "Hz", low=POSITIVE, default=1.0
    )
    dv_mps2: float = parameter("Largest rate of speed", "m/s^2", low=POSITIVE, default=0.35)
    dr_radps2: float = parameter("Largest rate of yaw rate", "rad/s^2", low=POSITIVE, default=0.35)
    ddelta_radps: float = parameter(
        "Largest rate of steering angle", "rad/s", low=POSITIVE, default=0.1
    )
    shortest_s: float = parameter("Shortest steady segment", "s", low=POSITIVE, default=0.6)

    def __post_init__(self):
        check(self)
        if not self.cutoff_hz < 0.4 * RATE_HZ:
            raise ParameterError(
                f"cutoff_hz: expected less than {0.4 * RATE_HZ:g} Hz, got {self.cutoff_hz:g}"
            )
