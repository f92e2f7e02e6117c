"""The controller: from the state of the car to steering angle and speed.

One guidance law, one controller, three steering maps (see :mod:`map_racing.control.steering`).
"""

import math
from enum import Enum
from typing import NamedTuple

import numpy as np

from ..validation import FARTHEST
from .adaptation import Adaptation
from .guidance import bearing, lateral_acceleration, missing_curvature
from .setup import Setup
from .sideslip import SideslipEstimate
from .speed_plan import WALKING_PACE, requested_speed
from .state import CarState, predicted
from .steering import build_steering_maps

__all__ = [
    "ControlResult",
    "Controller",
    "Status",
    "build_controller",
]

# The law uses at least this speed [m/s]; at standstill the map from acceleration to angle would be
# 0/0. The circle does not depend on the speed, so a standing car already points its wheels.
LOWEST_LAW_SPEED = 0.5

# Longest time over which the steering may slew in one step [s]: after a gap the angle that the
# servo has reached is unknown.
LONGEST_SLEW_TIME = 0.1

# A car farther from the path than the lookahead distance has no lookahead point; a distance of
# sqrt(2) times the lateral error makes it approach the path at 45 degrees.
APPROACH_FACTOR = math.sqrt(2.0)


class Status(Enum):
    """Outcome of a control step."""

    OK = "ok"
    SATURATED = "saturated"  # the demand exceeds what the steering map can give
    OFF_COURSE = "off course"  # too far from the path, or pointing away from it: walking pace
    INVALID_STATE = "invalid state"  # NaN, infinite or absurd: commands a stop
    NO_RACELINE = "no raceline"  # commands a stop


# Looking up members of an enumeration is slow before Python 3.12.
_OK, _SATURATED, _OFF_COURSE = Status.OK, Status.SATURATED, Status.OFF_COURSE


class ControlResult(NamedTuple):
    """Command of one control step, with the intermediate results that led to it.

    Parameters
    ----------
    steering_angle : float
        Commanded steering angle, positive to the left [rad].
    speed : float
        Commanded speed [m/s].
    status : Status
    state : CarState
        State that guidance starts from: measured, or predicted over the delay.
    s, d : float
        Arc length of its projection onto the raceline and lateral error, left positive [m].
    lookahead_x, lookahead_y : float
        Lookahead point in the map frame [m].
    lookahead_distance : float
        Its distance [m].
    eta : float
        Angle from the velocity vector, or from the heading (see ``eta_from``), to the lookahead
        point [rad].
    a_lat : float
        Lateral acceleration requested from the steering map, feedforward included [m/s^2].
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
_new = tuple.__new__
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
        With None every step commands a stop until `change` provides one.
    sectors : SpeedSectors or None
        Speed scales by sector.
    grip : object with ``max_lateral_acceleration(v)``, optional
        Grip for the speeds within ``grip_use``: the lookup table of the car's own tires, whatever
        the steering map is. By default the steering map.

    Raises
    ------
    ParameterError
        If the raceline has no speeds and ``grip_use`` is 0.
    """

    def __init__(self, parameters, steering_map, vehicle, raceline=None, sectors=None, grip=None):
        self.vehicle = vehicle
        ahead = vehicle.l_r if parameters.reference_point == "center_of_gravity" else 0.0
        self._estimate_v_y = SideslipEstimate(vehicle, ahead)
        self._behind = vehicle.l_r - ahead
        self._learned = self._setup = self._guard = self._adaptation = self._untaught = None
        setup = Setup(parameters, steering_map, grip, raceline, sectors, vehicle.v_max)
        self.apply(self._completed(setup))
        self.reset()

    # -- settings --------------------------------------------------------------------------------

    def prepare(self, **changes):
        """Prepare a change; it takes effect when it is applied.

        A new speed plan takes milliseconds. A thread that must not delay the control steps prepares
        it meanwhile and applies it between two of them.

        Parameters
        ----------
        **changes
            New ``parameters``, ``steering_map``, ``grip``, ``raceline`` or ``sectors``.

        Returns
        -------
        object
            For `apply`. Applying it reverts any other change made in between.

        Raises
        ------
        ParameterError
            If the raceline would have no speeds and ``grip_use`` is 0.
        """
        return self._completed(self._setup._replace(**changes))

    def apply(self, setup):
        """Drive with what `prepare` returned from the next step on.

        A new raceline restarts tracking; the steering continues from its present angle.
        """
        self.learn()
        if setup.guard is not None and self._guard is not None:
            setup.guard.resume(self._guard)
        self._setup, self._adaptation = setup, setup.adaptation
        self._lookahead = setup.parameters.lookahead(self.vehicle).distance
        self._parameters, self._steering_map = setup.parameters, setup.steering_map
        self._sectors, self._plan, self._guard = setup.sectors, setup.plan, setup.guard
        self._raceline, self._tracker = setup.raceline, setup.tracker
        self._speed_at = self._requested_speed_at if setup.plan is None else setup.plan.speed_at
        self._delay = setup.parameters.delay_s
        if self._learned is not None:
            self._learned.expect_delay(setup.parameters.delay_s)
        if self._adaptation is not None:
            if setup.plan is not None:
                self._adaptation.slowest = setup.plan.slowest
            self._follow_belief()

    def _completed(self, setup):
        """A setup with adaptation, tracker and speed plan."""
        adaptation = self._adaptation_of(setup.parameters)
        return setup._replace(adaptation=adaptation).with_plan(self._setup)

    def _adaptation_of(self, parameters):
        """The `Adaptation`, which survives being switched off; None while it is off."""
        if not parameters.adaptation:
            return None
        if self._learned is None:
            v_max = min(max(parameters.v_max_mps, 1.0), 100.0)
            self._learned = Adaptation(
                self.vehicle,
                v_max,
                parameters.delay_s,
                parameters.adaptation_share,
                self._behind,
            )
        return self._learned

    def _follow_belief(self):
        """Take tires, grip and delay from the adaptation."""
        adaptation = self._adaptation
        self._delay = adaptation.delay
        if self._parameters.steering_map == "table":
            self._steering_map = adaptation.steering
        if self._plan is not None:
            self._plan.grips = adaptation.grips
            self._guard.levels = adaptation.steering.levels

    def change(self, **changes):
        """Prepare and apply `changes` at once."""
        self.apply(self.prepare(**changes))

    @property
    def raceline(self):
        """The raceline, or None."""
        return self._raceline

    @property
    def parameters(self):
        """The controller's parameters."""
        return self._parameters

    @property
    def steering_map(self):
        """The steering map as given; with adaptation the car drives with the learned table."""
        return self._setup.steering_map

    @property
    def adaptation(self):
        """The `Adaptation` that learns the tires while driving; None while it is off.

        It includes the last step only after `learn`.
        """
        return self._adaptation

    @property
    def learned(self):
        """The `Adaptation`, even while it is off; None if it never was on."""
        return self._learned

    def max_lateral_acceleration(self, v):
        """Largest lateral acceleration of the steering map in use.

        Parameters
        ----------
        v : float or ndarray
            Speed [m/s].

        Returns
        -------
        float or ndarray
            [m/s^2], in the shape of `v`.
        """
        return self._steering_map.max_lateral_acceleration(v)

    @property
    def sectors(self):
        """Speed scales by sector, or None."""
        return self._sectors

    @property
    def plan(self):
        """The `SpeedPlan` in use; None without raceline or with a ``grip_use`` of 0."""
        return self._plan

    def planned_speed(self, s):
        """Planned speed along the raceline, before the grip guard and the supervisor.

        Parameters
        ----------
        s : ndarray
            Arc lengths on the raceline, which must be set [m].

        Returns
        -------
        ndarray
            [m/s]
        """
        if self._plan is None:
            return requested_speed(self._raceline, self._parameters, self._sectors)(s)
        return np.array([self._plan.speed_at(at) for at in np.asarray(s).tolist()])

    def reset(self):
        """Forget the past, after the car was moved or time jumped back."""
        self.learn()
        if self._tracker is not None:
            self._tracker.reset()
        self._last_t = None
        self._last_angle = 0.0
        if self._guard is not None:
            self._guard.reset()
        if self._adaptation is not None:
            self._adaptation.restart()

    def sent(self, steering_angle):
        """Note the angle [rad] actually sent to the car, in place of the last step's."""
        if self._untaught is not None:
            self._untaught = self._untaught[0], steering_angle

    def learn(self):
        """Learn from the last step, if adaptation is on and that has not been done.

        It takes 0.05 ms, or 0.15 ms if the steering map changes, so call it once the command is
        sent; otherwise the next step does it first.
        """
        if self._untaught is None:
            return
        untaught, self._untaught = self._untaught, None
        self._adaptation.update(*untaught)
        self._follow_belief()

    def step(self, state):
        """Compute one command.

        Parameters
        ----------
        state : CarState
            Measured state of the reference point; ``v_y`` is NaN if it is not measured.

        Returns
        -------
        ControlResult
            Speed 0 and the last steering angle if the state is not finite or is absurd, or there is
            no raceline.
        """
        self.learn()
        parameters = self._parameters
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
        measured = state
        if v_y != v_y:
            state = CarState(t, x, y, psi, v_x, self._estimate_v_y(v_x, r), r)
        if self._delay:
            state = predicted(state, self._delay)

        _, x, y, psi, _, _, _ = state
        s, d, path_psi, path_kappa = self._tracker.update(x, y, psi)
        speed = self._speed_at(s + parameters.speed_lookahead_s * v_x)
        law_speed = v_x if parameters.speed_source == "measured" else speed
        if law_speed < 0.0:
            law_speed = -law_speed
        if law_speed < LOWEST_LAW_SPEED:
            law_speed = LOWEST_LAW_SPEED

        wanted = self._lookahead(law_speed)
        approach = APPROACH_FACTOR * (d if d > 0.0 else -d)
        if wanted < approach:
            wanted = approach
        if parameters.lookahead_from == "car":
            _, point_x, point_y, distance = raceline.point_ahead(x, y, s, wanted)
        else:
            beside_x, beside_y = raceline.position(s)
            _, point_x, point_y, _ = raceline.point_ahead(beside_x, beside_y, s, wanted)
            distance = math.hypot(point_x - x, point_y - y)
        directed = state if parameters.eta_from == "velocity" else state._replace(v_y=0.0)
        eta = bearing(directed, point_x, point_y)
        a_lat = lateral_acceleration(law_speed, distance if distance > 1e-3 else 1e-3, eta)
        if parameters.curvature_feedforward:
            lacking = missing_curvature(x, y, d, path_psi, path_kappa, point_x, point_y)
            a_lat += parameters.curvature_feedforward * law_speed * law_speed * lacking
        table_speed = law_speed
        if law_speed > parameters.table_v_max_mps and parameters.steering_map != "ackermann":
            table_speed = parameters.table_v_max_mps
        angle, saturated = self._steering_map.steering(table_speed, a_lat)
        if parameters.yaw_rate_gain_s:
            angle += parameters.yaw_rate_gain_s * (a_lat / law_speed - state.r)
        angle = self._limited(angle, t)
        if self._guard is not None:
            speed = self._guard.limited(t, v_x, a_lat / (law_speed * law_speed), speed)
        if self._adaptation is not None:
            self._untaught = measured, angle
        status = _SATURATED if saturated else _OK
        if self._tracker.lost or not -_RIGHT_ANGLE <= eta <= _RIGHT_ANGLE:
            status = _OFF_COURSE
            if speed > WALKING_PACE:
                speed = WALKING_PACE
        # Same as ControlResult(...), in half the time.
        values = angle, speed, status, state, s, d, point_x, point_y, distance, eta, a_lat
        return _new(ControlResult, values)

    def lateral_error(self, state, result):
        """Lateral error of the measured state; `result.d` is the error of the predicted one.

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

    def _requested_speed_at(self, s):
        parameters = self._parameters
        speed = self._raceline.speed_at(s) * parameters.speed_scale
        if self._sectors is not None:
            speed *= self._sectors.scale_at(s)
        return speed if speed < parameters.v_max_mps else parameters.v_max_mps

    def _limited(self, angle, t):
        """Limit the steering angle to the lock and to the rate of the servo."""
        # Comparisons, because min and max take three times as long: 5 % of a whole step.
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
    steering_map, grip = build_steering_maps(parameters, vehicle)
    return Controller(parameters, steering_map, vehicle, raceline, sectors, grip)
