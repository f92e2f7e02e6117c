"""Model predictive control of the steering: a rival of MAP that knows the same of the car.

In each step a quadratic program chooses the steering rates of the horizon, linearized around the
motion that the last solution predicts (one step of sequential quadratic programming per pose,
"real-time iteration"; Diehl, Bock, Schloeder, SIAM J. Control Optim. 43(5), 2005). The speeds come
from the `SpeedPlan`. States are relative to the raceline::

    d'   = v sin(e) + v_y + a r        lateral error of the reference point, a ahead of the center
    e'   = r - kappa v                 heading error
    v_y' = (F_yf + F_yr) / m - v r     as in `single_track`, tires linearized at their slip angles
    r'   = (l_f F_yf - l_r F_yr) / I_z
    delta' = u                         the input, up to the servo's rate

The kinematic model has ``r = v tan(delta) / l_wb`` and no sideslip at the rear axle. The cost of a
stage is ``d^2 + (w_h d' / v)^2 + (w_u (u - u_r))^2``, all in meters: lateral error, direction of
motion, and steering rate relative to that of a car on the raceline, ``u_r``. The rates are the
program's only variables; OSQP solves it. (With the reference point at the center of gravity, the
kinematic ``d' / v`` uses a linearized tangent, which costs 2 mm of error in a bend of 0.8 m.)
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np
from scipy import sparse

from ..errors import ParameterError
from ..track.tracker import RacelineTracker
from ..vehicle.single_track import V_EPS, axle_loads, single_track_derivatives
from .controller import ControlResult, Status
from .sideslip import SideslipEstimate
from .speed_plan import WALKING_PACE, SpeedPlan, requested_speed
from .state import CarState, moved, predicted
from .steering import build_steering_map

__all__ = ["ModelPredictiveController", "solver_library"]

# Lowest speed of the prediction [m/s]: at standstill steering has no effect.
SLOWEST = 1.0
# Past the peak the tangent stiffness is negative, and the plan would steer the wrong way: the
# stiffness is at least this share of the one at zero slip.
LEAST_STIFFNESS = 0.05
# With less weight on the steering rate [m s] the program is so flat that the solver often does not
# converge, and the car drives worse.
LEAST_RATE_WEIGHT = 0.005
# Interval between poses that a command is held for [s]: initial, shortest and longest.
FIRST_PERIOD, SHORTEST_PERIOD, LONGEST_PERIOD = 0.025, 0.005, 0.05
# Step of the prediction over the delay [s].
PREDICTION_STEP = 0.005
# Largest lateral error [m] and heading error [rad] for which the linear model holds.
FARTHEST_ERROR, LARGEST_TURN = 3.0, 1.2


class ModelPredictiveController:
    """Steers by a quadratic program over the horizon; its speeds are those of the plan.

    It has the part of `controller.Controller`'s interface that races need.

    Parameters
    ----------
    parameters : MpcParameters
    vehicle : Vehicle
        Its model of the car.
    raceline : Raceline
        With speeds, unless ``grip_use`` is more than 0.
    sectors : SpeedSectors, optional

    Attributes
    ----------
    failures : int
        Number of steps whose program was not solved; they followed the last solution.

    Raises
    ------
    ParameterError
        If OSQP is not installed, or the raceline has no speeds and ``grip_use`` is 0.
    """

    def __init__(self, parameters, vehicle, raceline, sectors=None):
        self.parameters, self.vehicle = parameters, vehicle
        self.raceline, self.sectors, self.plan = raceline, sectors, None
        if parameters.grip_use:
            grip = build_steering_map("table", vehicle, parameters.v_max_mps)
            self.plan = SpeedPlan(raceline, parameters, grip, sectors, vehicle.v_max)
        else:
            self._requested = requested_speed(raceline, parameters, sectors)
        self._tracker = RacelineTracker(raceline)
        # Profiles along the raceline, computed once; the stages read them by index.
        count = max(int(math.ceil(raceline.length / 0.02)), 4)
        s = np.arange(count) * raceline.length / count
        self._kappa = raceline.sample(s).kappa
        self._planned = self.planned_speed(s)
        steady = build_steering_map(
            "table" if parameters.model == "single_track" else "ackermann",
            vehicle,
            parameters.v_max_mps,
        )
        self._angles = np.array(
            [
                steady.steering(v, v * v * kappa)[0]
                for v, kappa in zip(self._planned.tolist(), self._kappa.tolist())
            ]
        )
        self._cells = count / raceline.length
        at_center = parameters.reference_point == "center_of_gravity"
        self._ahead = 0.0 if at_center else -vehicle.l_r
        self._estimate_v_y = SideslipEstimate(vehicle, vehicle.l_r if at_center else 0.0)
        kind = _SingleTrack if parameters.model == "single_track" else _Kinematic
        self._model = kind(vehicle, self._ahead)
        self._program = _Program(parameters, vehicle, self._model.size)
        self.failures = 0
        self.reset()

    def planned_speed(self, s):
        """Planned speed along the raceline, before the supervisor.

        Parameters
        ----------
        s : ndarray, shape (n,)
            Arc lengths on the raceline [m].

        Returns
        -------
        ndarray, shape (n,)
            [m/s]
        """
        if self.plan is None:
            return self._requested(s)
        return np.array([self.plan.speed_at(at) for at in np.asarray(s).tolist()])

    def reset(self):
        """Forget the past, after the car was moved or time jumped back."""
        self._tracker.reset()
        self._program.reset()
        self._commands = deque(maxlen=64)  # (time at which it acts, angle)
        self._last_t, self._angle = None, 0.0

    def step(self, state):
        """Compute one command; see `controller.Controller.step`."""
        parameters, vehicle = self.parameters, self.vehicle
        t, x, y, psi, v_x, v_y, r = state
        if not all(map(math.isfinite, (t, x, y, psi, v_x, r))):
            nothing = (math.nan,) * 7
            return ControlResult(self._angle, 0.0, Status.INVALID_STATE, state, *nothing)
        if not math.isfinite(v_y):
            state = state._replace(v_y=self._estimate_v_y(v_x, r))
        state, angle = self._after_delay(state)
        s, d, path_psi, _ = self._tracker.update(state.x, state.y, state.psi)
        turned = math.remainder(state.psi - path_psi, 2.0 * math.pi)
        speed = float(self._read(self._planned, s + parameters.speed_lookahead_s * v_x))
        status = Status.OK
        if self._tracker.lost or abs(d) > FARTHEST_ERROR or abs(turned) > LARGEST_TURN:
            # Beyond the linear model: turn back hard and slowly.
            status, speed = Status.OFF_COURSE, min(speed, WALKING_PACE)
            d = min(max(d, -FARTHEST_ERROR), FARTHEST_ERROR)
            turned = min(max(turned, -LARGEST_TURN), LARGEST_TURN)
        center = moved(state, -self._ahead)
        rate, solved = self._program.solve(
            self._model,
            t,
            self._model.state(d, turned, center, angle),
            *self._stages(s, state.v_x),
        )
        self.failures += not solved
        # The command holds until the next pose, expected after the same interval as this one.
        period = FIRST_PERIOD
        if self._last_t is not None:
            period = min(max(t - self._last_t, SHORTEST_PERIOD), LONGEST_PERIOD)
        self._last_t = t
        limit = vehicle.delta_max
        self._angle = min(max(angle + rate * period, -limit), limit)
        self._commands.append((t + parameters.delay_s, self._angle))
        no_lookahead = (math.nan,) * 4
        a_lat = state.v_x * state.r
        return ControlResult(self._angle, speed, status, state, s, d, *no_lookahead, a_lat)

    def _read(self, profile, s):
        """A profile at arc lengths [m]."""
        return profile[(np.asarray(s) * self._cells).astype(int) % profile.size]

    def _stages(self, s, v):
        """Reference of each stage.

        Speed [m/s], acceleration [m/s^2], curvature [1/m], and rate of the steady-state steering
        angle [rad/s].
        """
        p = self.parameters
        dt, v = p.stage_s, max(v, SLOWEST)
        speeds, places, begins = [], [], []
        planned, cells, count = self._planned, self._cells, self._planned.size
        up, down = p.a_drive_max_mps2 * dt, -p.a_brake_max_mps2 * dt
        for _ in range(p.stages):
            begins.append(s)
            places.append(s + 0.5 * dt * v)
            speeds.append(v)
            s += dt * v
            v += min(max(planned[int(s * cells) % count] - v, down), up)
            if v < SLOWEST:
                v = SLOWEST
        speeds = np.array(speeds)
        accelerations = np.append(np.diff(speeds), 0.0) / dt
        rates = np.diff(self._read(self._angles, [*begins, s])) / dt
        return speeds, accelerations, self._read(self._kappa, places), rates

    def _after_delay(self, state):
        """State when the next command takes effect, and the steering angle at that time."""
        delay, commands = self.parameters.delay_s, self._commands
        last = commands[-1][1] if commands else 0.0
        if not delay:
            return state, last
        if self._model.derivatives is None or state.v_x < 2.0 * V_EPS:
            return predicted(state, delay), last
        center = moved(state, -self._ahead)
        t, x, y, psi, v_x, v_y, r = center
        pending = [(acts, angle) for acts, angle in commands if acts > t]
        before = [angle for acts, angle in commands if acts <= t]
        angle = before[-1] if before else (pending[0][1] if pending else 0.0)
        steps = max(int(round(delay / PREDICTION_STEP)), 1)
        dt = delay / steps
        for _ in range(steps):
            while pending and pending[0][0] <= t + 1e-9:
                angle = pending.pop(0)[1]
            for half in (0.5 * dt, 0.5 * dt):
                v_y_dot, r_dot = self._model.derivatives(v_x, v_y, r, angle, 0.0)
                v_y += half * v_y_dot
                r += half * r_dot
                psi += half * r
                x += half * (v_x * math.cos(psi) - v_y * math.sin(psi))
                y += half * (v_x * math.sin(psi) + v_y * math.cos(psi))
            t += dt
        return moved(CarState(t, x, y, psi, v_x, v_y, r), self._ahead), last


class _SingleTrack:
    """Lateral motion with tires: the state is ``d, e, v_y, r, delta``."""

    size = 5

    def __init__(self, vehicle, ahead):
        self.vehicle, self.ahead = vehicle, ahead
        self.derivatives = single_track_derivatives(vehicle)

    def state(self, d, turned, center, angle):
        return np.array([d, turned, center.v_y, center.r, angle])

    def guess(self, v, kappa):
        """Initial guess of the motion: rolling along the raceline without slip."""
        zeros = np.zeros_like(v)
        r = kappa * v
        angle = self.vehicle.l_wb * kappa
        return np.stack([zeros, zeros, self.vehicle.l_r * r, r, angle], axis=1)

    def linear(self, v, a, kappa, motion):
        """Linearize ``z' = A z + b u + c`` at each stage; also the row that gives ``d' / v``."""
        car, n = self.vehicle, v.size
        v_y, r, delta = motion[:, 2], motion[:, 3], motion[:, 4]
        load_f, load_r = axle_loads(car, a)
        A, c = np.zeros((n, 5, 5)), np.zeros((n, 5))
        slip_f = np.arctan((v_y + car.l_f * r) / v) - delta
        slip_r = np.arctan((v_y - car.l_r * r) / v)
        axles = (
            (car.front, load_f, slip_f, car.l_f, car.l_f, True),
            (car.rear, load_r, slip_r, -car.l_r, -car.l_r, False),
        )
        for tire, load, slip, arm, offset, steered in axles:
            stiffness = np.maximum(tire.slope(slip), LEAST_STIFFNESS * tire.stiffness)
            gain = car.mu * load * stiffness
            force = -car.mu * load * tire.normalized_force(slip) + gain * slip
            for row, inertia in ((2, car.m), (3, car.I_z / arm)):
                A[:, row, 2] -= gain / v / inertia
                A[:, row, 3] -= gain * offset / v / inertia
                if steered:
                    A[:, row, 4] += gain / inertia
                c[:, row] += force / inertia
        A[:, 2, 3] -= v
        A[:, 0, 1], A[:, 0, 2], A[:, 0, 3] = v, 1.0, self.ahead
        A[:, 1, 3] = 1.0
        c[:, 1] = -kappa * v
        return A, c, A[:, 0] / v[:, None]


class _Kinematic:
    """Lateral motion without slip: the state is ``d, e, delta``."""

    size = 3
    derivatives = None

    def __init__(self, vehicle, ahead):
        self.vehicle = vehicle
        self._from_rear = ahead + vehicle.l_r

    def state(self, d, turned, center, angle):
        return np.array([d, turned, angle])

    def guess(self, v, kappa):
        return np.stack([0.0 * v, 0.0 * v, self.vehicle.l_wb * kappa], axis=1)

    def linear(self, v, a, kappa, motion):
        n, l_wb = v.size, self.vehicle.l_wb
        tangent = np.tan(motion[:, 2])
        slope = (1.0 + tangent * tangent) * v / l_wb
        rest = tangent * v / l_wb - slope * motion[:, 2]
        A, c = np.zeros((n, 3, 3)), np.zeros((n, 3))
        A[:, 0, 1], A[:, 0, 2] = v, self._from_rear * slope
        c[:, 0] = self._from_rear * rest
        A[:, 1, 2] = slope
        c[:, 1] = rest - kappa * v
        return A, c, A[:, 0] / v[:, None]


def solver_library():
    """Import OSQP, an optional extra.

    Raises
    ------
    ParameterError
        If it is not installed; the message says how to install it.
    """
    try:
        import osqp
    except ImportError:
        raise ParameterError("law mpc: needs OSQP; pip install 'map_racing[rivals]'") from None
    return osqp


class _Program:
    """The quadratic program of a step, warm-started from the last solution."""

    def __init__(self, parameters, vehicle, size):
        osqp = solver_library()
        self._parameters, self._vehicle, self._size = parameters, vehicle, size
        n = parameters.stages
        self._upper = np.triu_indices(n)
        order = np.lexsort(self._upper)  # column by column, as sparse matrices are stored
        self._upper = self._upper[0][order], self._upper[1][order]
        angles = parameters.stage_s * np.tril(np.ones((n, n)))
        constraints = sparse.csc_matrix(np.vstack([np.eye(n), angles]))
        P = sparse.csc_matrix(np.triu(np.ones((n, n))) + np.eye(n))
        self._solver = osqp.OSQP()
        self._solver.setup(
            P,
            np.zeros(n),
            constraints,
            np.full(2 * n, -1.0),
            np.full(2 * n, 1.0),
            verbose=False,
            max_iter=parameters.iterations,
            eps_abs=1e-4,
            eps_rel=1e-4,
            check_termination=10,
        )
        self.reset()

    def reset(self):
        """Forget the last plan."""
        self._rates, self._motion = np.zeros(self._parameters.stages), None
        self._planned_at = 0.0

    def solve(self, model, t, z0, v, a, kappa, rates):
        """Steering rate [rad/s] at the time `t` [s], and whether the program was solved.

        If not, the rate is the last solution's for this time, or 0 beyond its end.
        """
        p, n = self._parameters, self._parameters.stages
        weight = max(p.steering_rate_weight_ms, LEAST_RATE_WEIGHT) ** 2
        fresh = self._motion is None
        motion = model.guess(v, kappa) if fresh else self._motion
        motion[0] = z0
        for _ in range(3 if fresh else 1):
            A, c, direction = model.linear(v, a, kappa, motion)
            step, inputs, rest = _discrete(A, c, p.stage_s)
            size = self._size
            response, free = np.zeros((n + 1, size, n)), np.empty((n + 1, size))
            free[0] = z0
            for k in range(n):
                response[k + 1] = step[k] @ response[k]
                response[k + 1, :, k] += inputs[k]
                free[k + 1] = step[k] @ free[k] + rest[k]
            # The squares of these rows, taken at the end of each stage, are the cost.
            direction = p.heading_weight_m * np.concatenate([direction[1:], direction[-1:]])
            rows = np.concatenate(
                [response[1:, 0], np.einsum("ki,kij->kj", direction, response[1:])]
            )
            offset = np.concatenate([free[1:, 0], np.einsum("ki,ki->k", direction, free[1:])])
            P = rows.T @ rows
            P[np.arange(n), np.arange(n)] += weight
            fastest, lock = self._vehicle.delta_rate_max, self._vehicle.delta_max
            fastest = np.full(n, fastest)
            self._solver.update(
                Px=P[self._upper],
                q=rows.T @ offset - weight * rates,
                l=np.concatenate([-fastest, np.full(n, -lock - z0[-1])]),
                u=np.concatenate([fastest, np.full(n, lock - z0[-1])]),
            )
            self._solver.warm_start(x=self._rates)
            found = self._solver.solve(raise_error=False)
            solved = found.info.status in ("solved", "solved inaccurate") and bool(
                np.all(np.isfinite(found.x))
            )
            if not solved:
                break
            self._rates, self._planned_at = np.clip(found.x, -fastest, fastest), t
            motion = (response @ self._rates + free)[:-1]
        if not solved:
            self._motion = None
            stage = int((t - self._planned_at) / p.stage_s + 1e-9)
            return (float(self._rates[stage]) if 0 <= stage < n else 0.0), False
        self._motion = motion
        return float(self._rates[0]), True


def _discrete(A, c, dt):
    """Exact discretization ``z+ = step z + inputs u + rest`` of linear stages.

    The input u is the rate of the last state. It takes the exponential of ``[[A, b, c], [0, 0, 0]]
    dt`` by scaling and squaring, for all stages at once; Euler steps, forward or backward, would be
    wrong for tires that settle within milliseconds.
    """
    n, size = c.shape
    M = np.zeros((n, size + 2, size + 2))
    M[:, :size, :size], M[:, :size, -1] = A, c
    M[:, size - 1, size] = 1.0
    M *= dt
    halvings = max(int(math.ceil(math.log2(max(np.abs(M).sum(axis=2).max(), 1e-9)))) + 1, 0)
    M *= 0.5**halvings
    E = np.eye(size + 2) + M @ (
        np.eye(size + 2) + M @ (np.eye(size + 2) + M @ (np.eye(size + 2) + M / 4.0) / 3.0) / 2.0
    )
    for _ in range(halvings):
        E = E @ E
    return E[:, :size, :size], E[:, :size, size], E[:, :size, -1]
