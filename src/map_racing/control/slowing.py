"""Keeps braking and steering within the grip while the car is faster than it should be."""

from __future__ import annotations

import math

import numpy as np

from ..vehicle.size import ONE_TENTH, Size

__all__ = ["Slowing"]

# For a 1:10 car: largest steering rate while slowing [rad/s] (following a raceline takes less), and
# gap between measured and commanded speed [m/s] that braking along a raceline does not cause.
STEERING_RATE, SUDDEN = 1.5, 2.0

# Share of the braking limit used at most; the friction ellipse then leaves 60 % of the lateral grip
# for steering.
MOST_BRAKING = 0.8

_BISECTIONS = 16


class Slowing:
    """Friction ellipse of braking and steering at the measured speed.

    The guidance law knows neither that the car is too fast nor that it brakes. Here braking comes
    first, because it shortens whatever may follow, and steering gets the remaining grip.

    Parameters
    ----------
    grip : LookupTable
        Lookup table of the car's own tires.
    a_brake_max : float
        Largest deceleration on a straight [m/s^2], the longitudinal axis of the ellipse.
    delta_max : float
        Steering lock [rad].
    always : bool, optional
        Whether to limit the angle to that of the largest lateral acceleration even while the car is
        not too fast. False for pure pursuit, which knows no tires.
    size : Size, optional
        Size of the car.

    Attributes
    ----------
    grip, always
    sudden : float
        If the command is more than this below the measured speed [m/s], the speed ramps down.
    """

    def __init__(
        self,
        grip,
        a_brake_max: float,
        delta_max: float,
        always: bool = True,
        size: Size = ONE_TENTH,
    ):
        self.grip, self._brake, self.delta_max = grip, a_brake_max, delta_max
        self._rate, self.sudden = STEERING_RATE / size.time, SUDDEN * size.time
        self.always = always
        self._peak = float(np.max(grip.max_lateral_acceleration(np.arange(1.0, 20.0))))

    def bounded(self, deceleration: float) -> float:
        """The deceleration, limited so that grip remains for steering [m/s^2]."""
        return min(deceleration, MOST_BRAKING * self._brake)

    def largest(self, v: float) -> float:
        """Angle [rad] of the largest lateral acceleration at a speed [m/s], within the lock."""
        return min(self.grip.steering(v, self._peak)[0], self.delta_max)

    def steering(
        self, v: float, angle: float, last: float, deceleration: float, elapsed: float
    ) -> float:
        """Limit a steering angle to the grip that a deceleration leaves.

        Parameters
        ----------
        v : float
            Measured speed [m/s].
        angle : float
            Requested angle [rad].
        last : float
            Angle of the last command [rad].
        deceleration : float
            Braking [m/s^2], already `bounded`.
        elapsed : float
            Time since the last command [s].

        Returns
        -------
        float
            [rad]
        """
        share = math.sqrt(1.0 - (deceleration / self._brake) ** 2)
        most = min(self.grip.steering(v, share * self._peak)[0], self.delta_max)
        angle = min(max(angle, -most), most)
        slew = self._rate * elapsed
        angle = min(max(angle, last - slew), last + slew)
        if self.always:  # the slew limit must not keep the angle too large when v jumps up
            most = self.largest(v)
            angle = min(max(angle, -most), most)
        return angle

    def braking(self, v: float, angle: float) -> float:
        """Deceleration that the tires can take at a steering angle [m/s^2]."""
        steering, peak, angle = self.grip.steering, self._peak, abs(angle)
        low, high = 0.0, 1.0
        for _ in range(_BISECTIONS):
            use = 0.5 * (low + high)
            if steering(v, use * peak)[0] < angle:
                low = use
            else:
                high = use
        return self._brake * math.sqrt(1.0 - high * high)
