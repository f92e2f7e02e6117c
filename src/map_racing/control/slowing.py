"""Steering and braking together within the grip, while the car is faster than it should be."""

from __future__ import annotations

import math

import numpy as np

from ..vehicle.size import ONE_TENTH, Size

__all__ = ["Slowing"]

# Of a 1:10 car: largest rate of the steering angle meanwhile [rad/s] (following a raceline takes
# less), and how far a command is below the measured speed [m/s] that is no raceline's braking.
STEERING_RATE, SUDDEN = 1.5, 2.0

# Most of the braking that the tires hold; the rest of the friction ellipse, 60 % of the lateral
# grip, is for steering.
MOST_BRAKING = 0.8

_BISECTIONS = 16


class Slowing:
    """Friction ellipse of braking and steering at the measured speed.

    A law that steers back to the raceline knows neither that the car is faster than it should be
    nor that it brakes. Here braking comes first, as it shortens everything that may follow, and
    steering gets what it leaves.

    Parameters
    ----------
    grip : LookupTable
        Of the car's own tires.
    a_brake_max : float
        Largest deceleration on a straight [m/s^2]: the other axis of the ellipse.
    delta_max : float
        Steering lock [rad].
    always : bool, optional
        Whether no angle is to be beyond the one of the largest lateral acceleration, also while the
        car is not too fast: not for pure pursuit, which knows no tires.
    size : Size, optional
        Of the car.

    Attributes
    ----------
    grip, always
    sudden : float
        A command so far below the measured speed is followed by a ramp [m/s].
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
        """The deceleration, or the most of it that leaves grip for steering [m/s^2]."""
        return min(deceleration, MOST_BRAKING * self._brake)

    def largest(self, v: float) -> float:
        """Angle [rad] of the largest lateral acceleration at a speed [m/s], within the lock."""
        return min(self.grip.steering(v, self._peak)[0], self.delta_max)

    def steering(
        self, v: float, angle: float, last: float, deceleration: float, elapsed: float
    ) -> float:
        """Steering angle beside a deceleration.

        Parameters
        ----------
        v : float
            Measured speed [m/s].
        angle : float
            What is asked for [rad].
        last : float
            Angle of the last command [rad].
        deceleration : float
            Braking, at most the `bounded` one [m/s^2].
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
        if self.always:  # also where the measured speed rises at once
            most = self.largest(v)
            angle = min(max(angle, -most), most)
        return angle

    def braking(self, v: float, angle: float) -> float:
        """Deceleration that the tires hold beside a steering angle [m/s^2]."""
        steering, peak, angle = self.grip.steering, self._peak, abs(angle)
        low, high = 0.0, 1.0
        for _ in range(_BISECTIONS):
            use = 0.5 * (low + high)
            if steering(v, use * peak)[0] < angle:
                low = use
            else:
                high = use
        return self._brake * math.sqrt(1.0 - high * high)
