"""Limits beyond which a lap does not count."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..track.raceline import Raceline

__all__ = ["NO_WALLS", "LapLimits"]

NO_WALLS = 2.0
"""Largest deviation [m] if neither walls nor a limit are known."""

# Times are rounded, by loggers often to this [s]: 4 Hz is not beyond 0.25 s.
_ROUNDING = 1e-3


@dataclass(frozen=True)
class LapLimits:
    """Limits beyond which a lap does not count.

    Attributes
    ----------
    max_gap : float
        Longest time between two samples [s]; at 11 m/s the default is 2.75 m.
    max_speed : float
        Fastest motion of the pose [m/s], or 1.5 times the measured speed if that is more; a step
        longer than that by `jump_margin` is a jump.
    jump_margin : float
        Largest correction of the localization that is no jump [m].
    max_reverse : float
        Farthest that the car may roll back along the track [m].
    max_deviation : float, optional
        Largest lateral deviation [m]. By default the center of the car must stay between the walls
        or, where the raceline has none, within 2 m. Walls in a raceline file are often drawn
        tighter than the hall; this overrides them.
    max_stop : float
        Longest time that the car may stand [s].
    max_deceleration : float
        Hardest braking [m/s^2], over 0.1 s; only a wall stops a car faster.
    """

    max_gap: float = 0.25
    max_speed: float = 20.0
    jump_margin: float = 0.3
    max_reverse: float = 0.5
    max_deviation: float | None = None
    max_stop: float = 0.3
    max_deceleration: float = 25.0

    def is_gap(self, time: float | np.ndarray) -> bool | np.ndarray:
        """Whether a time between two samples [s] is longer than `max_gap`, not only by rounding."""
        return time > self.max_gap + _ROUNDING

    def on(self, raceline: Raceline) -> LapLimits:
        """These limits with a `max_speed` of at least 1.5 times the raceline's largest speed."""
        if raceline.speed is None:
            return self
        return replace(self, max_speed=max(self.max_speed, 1.5 * float(np.max(raceline.speed))))
