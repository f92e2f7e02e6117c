"""Steering maps: the steering angle for a lateral acceleration.

The only difference between pure pursuit and MAP. Each map has
``steering(v, a_lat) -> (delta, saturated)``: the angle [rad] at which the car turns with `a_lat`
[m/s^2] at speed `v` [m/s], and whether that exceeds what the car can reach, in which case `delta`
is the angle of the tightest turn.

:class:`map_racing.vehicle.lookup.LookupTable` is such a map; this module has the kinematic one.
"""

from __future__ import annotations

import math

__all__ = ["AckermannSteering"]


class AckermannSteering:
    """Kinematic steering ``delta = atan(l_wb a_lat / v^2)``: pure pursuit.

    It ignores the tires: its only limit is the steering lock.

    Parameters
    ----------
    l_wb : float
        Wheelbase [m].
    delta_max : float
        Steering lock [rad].
    """

    def __init__(self, l_wb: float, delta_max: float):
        self.l_wb = l_wb
        self.delta_max = delta_max

    def steering(self, v: float, a_lat: float) -> tuple:
        """Steering angle [rad] for speed [m/s] and lateral acceleration [m/s^2], and saturation."""
        delta = math.atan2(self.l_wb * a_lat, v * v) if a_lat else 0.0
        if abs(delta) > self.delta_max:
            return math.copysign(self.delta_max, delta), True
        return delta, False

    def max_lateral_acceleration(self, v: float) -> float:
        """Lateral acceleration at full lock [m/s^2] at a speed [m/s], from kinematics alone."""
        return v * v * math.tan(self.delta_max) / self.l_wb
