"""Steady-state steering for tires that change while driving, without computing a table."""

from __future__ import annotations

import copy
import math
from bisect import bisect_right

import numpy as np

from ..errors import ParameterError
from .single_track import GRAVITY

__all__ = ["TireSteering"]

# Nodes along the slip of the front axle, and the largest slip of tires without a peak [rad].
NODES, MOST_SLIP = 257, 1.0
# Lowest speed and spacing at which the limit is computed [m/s]; in between, its reciprocal is
# interpolated linearly in 1/v^2.
SLOWEST, STEP = 0.5, 0.75
_ROUNDING = 1.0 + 1e-9


class TireSteering:
    """Steady-state steering with factors on friction and cornering stiffness.

    The equations are those of `steady_state`: at the share ``x = a / (mu g)`` the axles need the
    slips ``s_f(x)`` and ``s_r(x)``, and::

        delta = s_f + atan(l_wb a / v^2 - tan(s_r))

    A factor on friction scales ``a = mu g x``; a factor on stiffness divides the slip. So two
    curves, inverted once, serve all tires of the same shape: a change takes 0.1 ms, a new table
    20 ms. With factors of 1 it agrees with the table of the vehicle to within the table's
    interpolation error.

    Parameters
    ----------
    vehicle : Vehicle
    v_max : float
        Largest speed at which the limit is computed [m/s]; above it the limit is constant.

    Attributes
    ----------
    factors : tuple of float
        Factors on friction, front stiffness and rear stiffness.
    speeds, levels : list of float
        Speeds [m/s] between which `at` interpolates, and the `level` of each.

    Raises
    ------
    ParameterError
        If the vehicle has no stable steady state.
    """

    def __init__(self, vehicle, v_max):
        self.l_wb, self.delta_max = vehicle.l_wb, vehicle.delta_max
        self._per_x = vehicle.mu * GRAVITY
        # NaN if the tires do not reach a_lat_max.
        reached = vehicle.front.slip(vehicle.a_lat_max / self._per_x)
        most = np.nanmin([vehicle.front.peak_slip, MOST_SLIP, reached])
        slip = np.linspace(0.0, most, NODES)
        x = vehicle.front.normalized_force(slip)
        rear = vehicle.rear.slip(x)
        good = np.logical_and.accumulate(np.isfinite(rear) & np.r_[True, np.diff(x) > 0.0])
        good[np.count_nonzero(good) - 1] &= np.count_nonzero(good) % 2 == 1
        self._x, self._front, self._rear = x[good], slip[good], rear[good]
        self._nodes = self._x.tolist(), self._front.tolist(), self._rear.tolist()
        count = max(int(math.ceil((v_max - SLOWEST) / STEP)), 1) + 1
        self._v = np.linspace(SLOWEST, max(v_max, SLOWEST + STEP), count)
        self._w = (1.0 / self._v**2).tolist()
        self.speeds = self._v.tolist()
        self._per_mps = 1.0 / (self.speeds[1] - SLOWEST)
        self._nominal = None
        self._scale(1.0, 1.0, 1.0)
        self._nominal = copy.copy(self)
        if not np.all(self._limits > 0.0):
            raise ParameterError(f"{vehicle.name}: expected a car with a stable steady state")

    def scaled(self, friction, front_stiffness, rear_stiffness):
        """The same car with other factors, relative to the vehicle file.

        Parameters
        ----------
        friction, front_stiffness, rear_stiffness : float
            Positive.

        Returns
        -------
        TireSteering
        """
        other = copy.copy(self)
        other._scale(friction, front_stiffness, rear_stiffness)
        return other

    def _scale(self, friction, front, rear):
        self.factors = friction, front, rear
        self._full = self._per_x * friction
        self._inverse_front, self._inverse_rear = 1.0 / front, 1.0 / rear
        # Every other node; their number is odd, so the peak is included.
        a = self._full * self._x[::2]
        tangent = np.tan(np.minimum(self._rear[::2] / rear, 1.5))
        delta = self._front[::2] / front + np.arctan(
            self.l_wb * a * np.array(self._w)[:, None] - tangent
        )
        # The stable branch ends where more angle would turn the car less, or at the lock.
        rising = np.diff(delta, axis=1) > 0.0
        inside = np.logical_and.accumulate(rising & (delta[:, 1:] <= self.delta_max), axis=1)
        last = inside.sum(axis=1)
        following = np.minimum(last + 1, a.size - 1)
        rows = np.arange(last.size)
        low, high = delta[rows, last], delta[rows, following]
        beyond = (high > self.delta_max) & (following > last)
        part = np.where(beyond, (self.delta_max - low) / np.where(beyond, high - low, 1.0), 0.0)
        limits = a[last] + part * (a[following] - a[last])
        # At speeds where even straight running is unstable, use the last stable limit.
        stable = np.maximum.accumulate(np.where(limits > 0.0, rows, 0))
        self._limits = limits[stable]
        self._inverse_limits = (1.0 / np.maximum(self._limits, 1e-6)).tolist()
        # With the file's stiffness the limit would scale from the file's at v / sqrt(friction).
        nominal = self._nominal or self
        alike = friction * nominal.max_lateral_acceleration(self._v / math.sqrt(friction))
        ratio = (self._limits / alike)[::-1]
        self.levels = (friction * np.minimum.accumulate(ratio)[::-1]).tolist()

    def steering(self, v: float, a_lat: float) -> tuple[float, bool]:
        """Steering angle [rad] for speed [m/s] and lateral acceleration [m/s^2], and saturation.

        As `LookupTable.steering`; one call takes 1.3 us on CPython 3.11.
        """
        demand = a_lat if a_lat >= 0.0 else -a_lat
        speed = v if v >= 0.0 else -v
        if not (demand < math.inf and speed < math.inf):
            raise ParameterError(f"steering(v={v}, a_lat={a_lat}): expected finite arguments")
        if not demand:
            return 0.0, False
        if speed < 1e-3:
            return (self.delta_max if a_lat > 0.0 else -self.delta_max), True
        w = 1.0 / (speed * speed)
        limit = self.limit(speed)
        saturated = demand > limit * _ROUNDING
        if saturated:
            demand = limit
        xs, fronts, rears = self._nodes
        x = demand / self._full
        i = bisect_right(xs, x) - 1
        if i >= len(xs) - 1:
            i = len(xs) - 2
        part = (x - xs[i]) / (xs[i + 1] - xs[i])
        front = fronts[i] + part * (fronts[i + 1] - fronts[i])
        rear = rears[i] + part * (rears[i + 1] - rears[i])
        delta = front * self._inverse_front + math.atan(
            self.l_wb * demand * w - math.tan(rear * self._inverse_rear)
        )
        if delta > self.delta_max:
            delta = self.delta_max
        return (delta if a_lat >= 0.0 else -delta), saturated

    def level(self, v: float) -> float:
        """Least grip at `v` [m/s] and above, as a factor on the vehicle file's friction.

        It is the factor on friction, times the lowest ratio of the limit to the one with the file's
        stiffness.
        """
        return self.least(v, self.levels)

    def least(self, v: float, levels: list[float]) -> float:
        """The least of the levels at `v` [m/s] and above."""
        return min(levels[max(bisect_right(self.speeds, v) - 1, 0) :])

    def at(self, v: float, levels: list[float]) -> float:
        """Level at a non-negative speed [m/s], interpolated."""
        place = (v - SLOWEST) * self._per_mps
        if place <= 0.0:
            return levels[0]
        k = int(place)
        if k >= len(levels) - 1:
            return levels[-1]
        return levels[k] + (place - k) * (levels[k + 1] - levels[k])

    def limit(self, v: float) -> float:
        """`max_lateral_acceleration` for one non-negative speed, but faster."""
        k = bisect_right(self.speeds, v)
        inverse, ws = self._inverse_limits, self._w
        if k == 0:
            return v * v * ws[0] / inverse[0]
        if k == len(inverse):
            return 1.0 / inverse[-1]
        first = ws[k - 1]
        part = (first - 1.0 / (v * v)) / (first - ws[k])
        return 1.0 / (inverse[k - 1] + part * (inverse[k] - inverse[k - 1]))

    def max_lateral_acceleration(self, v: float | np.ndarray) -> float | np.ndarray:
        """Largest lateral acceleration that `steering` reaches [m/s^2].

        As `map_racing.vehicle.lookup.LookupTable.max_lateral_acceleration`.
        """
        speed = np.abs(np.asarray(v, dtype=float))
        w = 1.0 / np.maximum(speed, SLOWEST) ** 2
        limit = 1.0 / np.interp(-w, -np.asarray(self._w), self._inverse_limits)
        limit = limit * np.minimum(speed / SLOWEST, 1.0) ** 2
        return limit if np.ndim(v) else float(limit)
