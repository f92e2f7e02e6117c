"""Today's tires and delay as estimated while driving."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["Belief"]


class Belief(NamedTuple):
    """Estimates with intervals; the message ``Belief`` has the same numbers.

    ``low`` and ``high`` are the ends of the 95 % interval.

    Parameters
    ----------
    friction, friction_low, friction_high : float
        Friction coefficient relative to the vehicle file's.
    front_stiffness, front_stiffness_low, front_stiffness_high : float
        Cornering stiffness of the front axle relative to the file's, at equal friction.
    rear_stiffness, rear_stiffness_low, rear_stiffness_high : float
        The same for the rear axle.
    delay, delay_low, delay_high : float
        Age of a pose when it is used, plus dead time and lag of the steering [s].
    grip : float
        Lateral limit that the speeds use, relative to the vehicle file's, in the bends where this
        ratio is lowest.
    """

    friction: float
    friction_low: float
    friction_high: float
    front_stiffness: float
    front_stiffness_low: float
    front_stiffness_high: float
    rear_stiffness: float
    rear_stiffness_low: float
    rear_stiffness_high: float
    delay: float
    delay_low: float
    delay_high: float
    grip: float

    @property
    def factors(self):
        """Factors on friction, front and rear stiffness."""
        return self.friction, self.front_stiffness, self.rear_stiffness
