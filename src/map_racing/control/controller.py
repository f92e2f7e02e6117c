"""The controller: from the state of the car to steering angle and speed.

One guidance law, one controller, three steering maps (see :mod:`map_racing.control.steering`).
"""

import math
from enum import Enum
from typing import NamedTuple

import numpy as np

from ..errors import ParameterError
from ..track.tracker import RacelineTracker
from ..validation import FARTHEST
from ..vehicle.lookup import default_grid
from ..vehicle.parameters import linearized
from ..vehicle.single_track import GRAVITY
from ..vehicle.steady_state import steady_state_table
from .guidance import bearing, lateral_acceleration
from .state import CarState, predicted
from .steering import AckermannSteering

__all__ = ["ControlResult", "Controller", "Status", "build_controller", "build_steering_map"]

# The law uses at least this speed [m/s]; at standstill the map from acceleration to angle would be
# 0/0. The circle is the same, and a standing car already points its wheels.
LOWEST_LAW_SPEED = 0.5

# Longest time over which the steering may slew in one step [s]: after a pause the angle that the
# servo has reached is unknown.
LONGEST_SLEW_TIME = 0.1

# Farther from the path than the lookahead distance there is no lookahead point; sqrt(2) of the
# lateral error makes the car approach the path at 45 degrees.
APPROACH_FACTOR = math.sqrt(2.0)

# Speed [m/s] back to a path that is too far away or behind the car: walking pace.
RECOVERY_SPEED = 1.0


class Status(Enum):
    """What the controller made of its input."""

    OK = "ok"
    SATURATED = "saturated"  # the demand exceeds what the steering map can give
    OFF_COURSE = "off course"  # too far from the path, or pointing away from it: walking pace
    INVALID_STATE = "invalid state"  # NaN, infinite or absurd: commands a stop
    NO_RACELINE = "no raceline"  # commands a stop


# Looking up members of an enumeration is slow before Python 3.12.
_OK, _SATURATED, _OFF_COURSE = Status.OK, Status.SATURATED, Status.OFF_COURSE


class ControlResult(NamedTuple):
    """Command of one control step and how it came about.

    Parameters
    ----------
    steering_angle : float
        Commanded steering angle, positive to the left [rad].
    speed : float
        Commanded speed [m/s].
    status : Status
    state : CarState
        State from which guidance starts: measured, or predicted by the delay.
    s, d : float
        Arc length of its projection on the raceline and lateral error, left positive [m].
    lookahead_x, lookahead_y : float
        Lookahead point in the map frame [m].
    lookahead_distance : float
        Its distance [m].
    eta : float
        Angle from the velocity vector to the lookahead point [rad].
    a_lat : float
        Lateral acceleration requested from the steering map [m/s^2].
    """

    steering_angle: float
    speed: float
    status: Status
    state: CarState
    s: float
    d: float
    lookahead_x: float
    lookahead_y: float
    lookahead_distance: float
    eta: float
    a_lat: float


_NAN = math.nan
_RIGHT_ANGLE = 0.5 * math.pi


class Controller:
    """L1 guidance along a raceline with an exchangeable steering map.

    Parameters
    ----------
    parameters : ControllerParameters
    steering_map : object with ``steering(v, a_lat) -> (delta, saturated)``
    vehicle : Vehicle
        Provides steering limits and geometry.
    raceline : Raceline or None
        With None every step commands a stop, until :attr:`raceline` is set.
    sectors : SpeedSectors or None
        Speed scales by sector.

    Raises
    ------
    ParameterError
        If the raceline has no speeds.
    """

    def __init__(self, parameters, steering_map, vehicle, raceline=None, sectors=None):
        self.parameters = parameters
        self.steering_map = steering_map
        self.vehicle = vehicle
        self.sectors = sectors
        self._estimate_v_y = _SideslipEstimate(
            vehicle, vehicle.l_r if parameters.reference_point == "center_of_gravity" else 0.0
        )
        self.raceline = raceline
        self.reset()

    @property
    def raceline(self):
        """The raceline; setting another one restarts tracking, while the steering continues."""
        return self._raceline

    @raceline.setter
    def raceline(self, raceline):
        if raceline is not None and raceline.speed is None:
            raise ParameterError(f"{raceline.source or raceline.name}: the raceline has no speeds")
        self._raceline = raceline
        self._tracker = None if raceline is None else RacelineTracker(raceline)

    def reset(self):
        """Forget the past, after the car was moved or time jumped back."""
        if self._tracker is not None:
            self._tracker.reset()
        self._last_t = None
        self._last_angle = 0.0

    def step(self, state):
        """Compute one command.

        Parameters
        ----------
        state : CarState
            Measured state of the reference point; ``v_y`` is NaN if nothing measures it.

        Returns
        -------
        ControlResult
            Speed 0 and the last steering angle if the state is not finite or absurd, or without a
            raceline.
        """
        parameters = self.parameters
        t, x, y, psi, v_x, v_y, r = state
        # A NaN fails every comparison.
        if not (
            t - t == 0.0
            and -FARTHEST < x < FARTHEST
            and -FARTHEST < y < FARTHEST
            and -FARTHEST < psi < FARTHEST
            and -FARTHEST < v_x < FARTHEST
            and -FARTHEST < r < FARTHEST
            and (v_y != v_y or -FARTHEST < v_y < FARTHEST)
        ):
            return self._stop(state, Status.INVALID_STATE)
        raceline = self._raceline
        if raceline is None:
            return self._stop(state, Status.NO_RACELINE)
        if v_y != v_y:
            state = CarState(t, x, y, psi, v_x, self._estimate_v_y(v_x, r), r)
        if parameters.delay_s:
            state = predicted(state, parameters.delay_s)

        _, x, y, psi, _, _, _ = state
        s, d, _, _ = self._tracker.update(x, y, psi)
        speed = self._speed_command(s + parameters.speed_lookahead_s * v_x)
        law_speed = abs(v_x) if parameters.speed_source == "measured" else speed
        if law_speed < LOWEST_LAW_SPEED:
            law_speed = LOWEST_LAW_SPEED

        wanted = parameters.lookahead.distance(law_speed)
        approach = APPROACH_FACTOR * abs(d)
        if wanted < approach:
            wanted = approach
        _, point_x, point_y, distance = raceline.point_ahead(x, y, s, wanted)
        eta = bearing(state, point_x, point_y)
        a_lat = lateral_acceleration(law_speed, max(distance, 1e-3), eta)
        angle, saturated = self.steering_map.steering(law_speed, a_lat)
        angle = self._limited(angle, t)
        status = _SATURATED if saturated else _OK
        if self._tracker.lost or not -_RIGHT_ANGLE <= eta <= _RIGHT_ANGLE:
            status = _OFF_COURSE
            if speed > RECOVERY_SPEED:
                speed = RECOVERY_SPEED
        return ControlResult(
            angle,
            speed,
            status,
            state,
            s,
            d,
            point_x,
            point_y,
            distance,
            eta,
            a_lat,
        )

    def lateral_error(self, state, result):
        """Lateral error of a measured state; `result` has the one of its prediction.

        Parameters
        ----------
        state : CarState
            The argument of the last step.
        result : ControlResult
            What it returned.

        Returns
        -------
        float
            Left positive [m]; NaN without raceline.
        """
        if result.s != result.s:
            return _NAN
        guess = result.s - state.v_x * self.parameters.delay_s
        found = self._raceline.project_near(state.x, state.y, guess, 1.0)
        return (found or self._raceline.project(state.x, state.y)).d

    def _speed_command(self, s):
        parameters = self.parameters
        speed = self._raceline.speed_at(s) * parameters.speed_scale
        if self.sectors is not None:
            speed *= self.sectors.scale_at(s)
        return speed if speed < parameters.v_max_mps else parameters.v_max_mps

    def _limited(self, angle, t):
        """Limit the steering angle to the lock and to the rate of the servo."""
        # Comparisons: min and max would take three times as long, 5 % of a whole step.
        vehicle, last_t, last_angle = self.vehicle, self._last_t, self._last_angle
        low, high = -vehicle.delta_max, vehicle.delta_max
        if last_t is not None:
            elapsed = t - last_t if t > last_t else 0.0
            if elapsed > LONGEST_SLEW_TIME:
                elapsed = LONGEST_SLEW_TIME
            slew = vehicle.delta_rate_max * elapsed
            if low < last_angle - slew:
                low = last_angle - slew
            if high > last_angle + slew:
                high = last_angle + slew
        angle = low if angle < low else high if angle > high else angle
        self._last_t = t
        self._last_angle = angle
        return angle

    def _stop(self, state, status):
        return ControlResult(
            self._last_angle, 0.0, status, state, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN, _NAN
        )


class _SideslipEstimate:
    """Steady-state lateral velocity of a point of the car from speed and yaw rate.

    The slip angle of the rear axle follows from its share of ``a = v r``; axle loads cancel,
    ``F_yr / F_zr = a / g``. A point `ahead` [m] of the rear axle adds ``ahead * r``.
    """

    CELLS = 256

    def __init__(self, vehicle, ahead):
        self._ahead = ahead
        # The linear tire has no peak; no car of this size corners with 5 g.
        self._a_end = GRAVITY * min(0.999 * vehicle.mu * vehicle.rear.peak, 5.0)
        forces = np.linspace(0.0, self._a_end, self.CELLS + 1) / (GRAVITY * vehicle.mu)
        self._tangents = np.tan(vehicle.rear.slip(forces)).tolist()

    def __call__(self, v_x, r):
        a_lat = v_x * r
        cell = min(abs(a_lat) / self._a_end, 1.0) * self.CELLS
        i = min(int(cell), self.CELLS - 1)
        low, high = self._tangents[i], self._tangents[i + 1]
        tangent = math.copysign(low + (high - low) * (cell - i), a_lat)
        return self._ahead * r - abs(v_x) * tangent


def build_steering_map(kind, vehicle, v_max):
    """Steering map of a vehicle.

    Parameters
    ----------
    kind : {"ackermann", "linear_table", "table"}
        See :class:`~map_racing.control.parameters.ControllerParameters`.
    vehicle : Vehicle
    v_max : float
        Largest speed in the table [m/s]; it extrapolates beyond.

    Returns
    -------
    AckermannSteering or LookupTable
    """
    if kind == "ackermann":
        return AckermannSteering(vehicle.l_wb, vehicle.delta_max)
    if kind == "linear_table":
        vehicle = linearized(vehicle)
    v_max = min(max(v_max, 1.0), 100.0)
    return steady_state_table(vehicle, *default_grid(vehicle, v_max=v_max))


def build_controller(parameters, vehicle, raceline=None, sectors=None):
    """Controller with the steering map named by its parameters.

    Parameters
    ----------
    parameters : ControllerParameters
    vehicle : Vehicle
    raceline : Raceline, optional
    sectors : SpeedSectors, optional

    Returns
    -------
    Controller
    """
    steering_map = build_steering_map(parameters.steering_map, vehicle, parameters.v_max_mps)
    return Controller(parameters, steering_map, vehicle, raceline, sectors)
