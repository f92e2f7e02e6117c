"""A finding of the sensor checks."""

from __future__ import annotations

from dataclasses import dataclass, field

from ..vehicle.size import Size

__all__ = ["SensorFinding", "turning_rate"]

TURNING_RADPS = 0.3  # least yaw rate of a 1:10 car that counts as turning


def turning_rate(size: Size) -> float:
    """Least yaw rate that counts as turning for a car of this size [rad/s]."""
    return TURNING_RADPS / size.time


@dataclass(frozen=True)
class SensorFinding:
    """Result of one check.

    Parameters
    ----------
    check : str
        Name of the check.
    text : str
        The measurement, in one line.
    fix : dict
        Changes of the `SensorSetup` that repair a contradiction; empty if there is none.
    critical : bool
        Whether identified tires would be meaningless without the repair.
    """

    check: str
    text: str
    fix: dict = field(default_factory=dict)
    critical: bool = False

    def __post_init__(self):
        plain = {k: v if isinstance(v, str) else float(v) for k, v in self.fix.items()}
        object.__setattr__(self, "fix", plain)
        object.__setattr__(self, "critical", bool(self.critical))

    @property
    def contradiction(self) -> bool:
        """Whether there is something to repair."""
        return bool(self.fix) or self.critical
