"""Steady-state estimate of an unmeasured lateral velocity."""

from __future__ import annotations

import math

import numpy as np

from ..vehicle.single_track import GRAVITY
from ..vehicle.tire_steering import MOST_SLIP

__all__ = ["SideslipEstimate"]


class SideslipEstimate:
    """Steady-state lateral velocity of a point of the car from speed and yaw rate.

    The slip angle of the rear axle follows from ``F_yr / F_zr = a / g`` with ``a = v r``. A point
    `ahead` [m] of the rear axle adds ``ahead * r``.
    """

    CELLS = 256

    def __init__(self, vehicle, ahead):
        self._ahead = ahead
        # The linear tire has no peak, but no car of this size corners at 5 g.
        self._a_end = GRAVITY * min(0.999 * vehicle.mu * vehicle.rear.peak, 5.0)
        forces = np.linspace(0.0, self._a_end, self.CELLS + 1) / (GRAVITY * vehicle.mu)
        # The slip of tires without a peak grows without bound.
        slip = np.minimum(vehicle.rear.slip(forces), MOST_SLIP)
        self._tangents = np.tan(slip).tolist()

    def __call__(self, v_x, r):
        a_lat = v_x * r
        cell = min(abs(a_lat) / self._a_end, 1.0) * self.CELLS
        i = min(int(cell), self.CELLS - 1)
        low, high = self._tangents[i], self._tangents[i + 1]
        tangent = math.copysign(low + (high - low) * (cell - i), a_lat)
        return self._ahead * r - abs(v_x) * tangent
