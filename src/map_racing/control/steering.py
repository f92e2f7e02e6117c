"""Steering maps: from a wanted lateral acceleration to the steering angle.

All that tells pure pursuit from MAP. Each map has ``steering(v, a_lat) -> (delta, saturated)``:
the angle [rad] that makes the car turn with `a_lat` [m/s^2] at speed `v` [m/s], and whether the car
cannot turn that hard, in which case `delta` is the angle of the hardest turn that it can.

The tables of :class:`map_racing.vehicle.lookup.LookupTable` are such maps; this module has the
geometric one.
"""

import math

__all__ = ["AckermannSteering"]


class AckermannSteering:
    """Kinematic steering ``delta = atan(l_wb a_lat / v^2)``: pure pursuit.

    It knows no tires: its only limit is the steering lock.

    Parameters
    ----------
    l_wb : float
        Wheelbase [m].
    delta_max : float
        Steering lock [rad].
    """

    def __init__(self, l_wb, delta_max):
        self.l_wb = l_wb
        self.delta_max = delta_max

    def steering(self, v, a_lat):
        """Steering angle [rad] for speed [m/s] and lateral acceleration [m/s^2], and saturation."""
        delta = math.atan2(self.l_wb * a_lat, v * v) if a_lat else 0.0
        if abs(delta) > self.delta_max:
            return math.copysign(self.delta_max, delta), True
        return delta, False

    def max_lateral_acceleration(self, v):
        """Lateral acceleration at full lock [m/s^2] at a speed [m/s], by geometry alone."""
        return v * v * math.tan(self.delta_max) / self.l_wb
