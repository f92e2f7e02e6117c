"""Limits beyond which the car stops."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from ..validation import POSITIVE, check, documented, parameter
from ..vehicle.size import size_of
from .obedience import SETTLING

if TYPE_CHECKING:
    from ..vehicle.parameters import Vehicle

__all__ = ["SafetyLimits"]


@documented
@dataclass(frozen=True)
class SafetyLimits:
    """Limits beyond which the car stops, and parameters of the stop."""

    max_pose_age_s: float = parameter(
        "Largest age of a pose by its timestamp, and longest time without one. A timestamp may be "
        "as far in the future",
        "s",
        low=POSITIVE,
        high=10.0,  # milliseconds would be no limit
        tuning=(0.02, 2.0),
        default=0.2,
    )
    max_jump_m: float = parameter(
        "Largest jump of the position, beyond what the car can have driven",
        "m",
        low=POSITIVE,
        tuning=(0.05, 10.0),
        default=0.5,
    )
    max_turn_rad: float = parameter(
        "Largest jump of the heading, beyond what the car can have turned, and largest angle "
        "between heading and direction of motion",
        "rad",
        low=POSITIVE,
        tuning=(0.05, 3.2),
        default=0.8,
    )
    max_deviation_m: float = parameter(
        "Largest distance from the raceline", "m", low=POSITIVE, tuning=(0.1, 20.0), default=1.5
    )
    max_saturated_s: float = parameter(
        "Longest uninterrupted demand beyond the grip. Simulated races that finish reach 1.3 s",
        "s",
        low=POSITIVE,
        tuning=(0.1, 60.0),
        default=1.5,
    )
    max_overspeed_mps: float = parameter(
        "Largest excess of the measured speed over the command for more than 0.5 s",
        "m/s",
        low=POSITIVE,
        tuning=(0.5, 10.0),
        default=2.0,
    )
    max_blocked_m: float = parameter(
        "Largest distance commanded while the pose stays put. Any car is assumed to reach "
        "1.5 m/s^2",
        "m",
        low=POSITIVE,
        tuning=(0.2, 100.0),
        default=1.0,
    )
    stop_deceleration_mps2: float = parameter(
        "Deceleration of a stop, within the grip left by steering",
        "m/s^2",
        low=POSITIVE,
        tuning=(0.5, 15.0),
        default=4.0,
    )
    recovery_s: float = parameter(
        "Time after a temporary cause has ended until the car drives again",
        "s",
        low=SETTLING,
        tuning=(SETTLING, 10.0),
        default=0.5,
    )
    hold_s: float = parameter(
        "Time for which a stopped car without poses is still sent commands of speed 0",
        "s",
        low=POSITIVE,
        tuning=(0.1, 10.0),
        default=2.0,
    )

    def __post_init__(self):
        check(self)

    def of_size(self, vehicle: Vehicle) -> SafetyLimits:
        """Scale these limits from a 1:10 car to another size, see `size_of`.

        Distances, speeds and the time of saturation scale with the size; decelerations and the
        times of sensors and computers do not. Nothing changes for 1:10 cars.
        """
        length, time = size_of(vehicle)
        return replace(
            self,
            max_jump_m=self.max_jump_m * length,
            max_deviation_m=self.max_deviation_m * length,
            max_blocked_m=self.max_blocked_m * length,
            max_overspeed_mps=self.max_overspeed_mps * time,
            max_saturated_s=self.max_saturated_s * time,
        )
