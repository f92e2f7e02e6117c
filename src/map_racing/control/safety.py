"""Supervision: when the car may drive, and how it stops.

Every pose passes the supervisor on its way to the controller, and every command on its way to the
car. To stop, the speed ramps down; meanwhile the car steers along the raceline if its pose can be
trusted, else it keeps the steering angle. After a temporary cause (a late pose, a jump, a missing
raceline) the car drives again by itself. A requested stop, grip exceeded for long and a failure of
the controller wait for `Supervisor.resume`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple

from ..validation import POSITIVE, check, documented, parameter
from .controller import ControlResult, Status
from .state import CarState

__all__ = ["Decision", "Mode", "PoseMotion", "Reason", "SafetyLimits", "Supervisor"]

# Above this speed [m/s] grip, not the steering lock, limits the turn, and the pose must change.
MOVING = 1.0

# Pose-derived velocities are contaminated for this long after a jump [s].
SETTLING = 0.15

# A clock that goes back by more than this [s] was set back: a looping bag, a simulator's reset.
BACKWARDS = 0.5


class Mode(Enum):
    """What the car does."""

    WAITING = "waiting"  # it has not driven yet
    DRIVING = "driving"
    STOPPING = "stopping"  # the commanded speed ramps down
    STOPPED = "stopped"


class Reason(Enum):
    """Why the car may not drive, by descending priority."""

    NONE = ""
    STOP_REQUESTED = "stop requested"
    FAILURE = "controller failed"
    NO_POSE = "no pose yet"
    FRAME = "pose in another frame"
    INVALID_POSE = "pose not finite"
    STALE_POSE = "pose too old"
    FROZEN_POSE = "pose frozen while moving"
    JUMP = "pose jumped"
    INVALID_RACELINE = "raceline not drivable"
    NO_RACELINE = "no raceline"
    DEVIATION = "too far from the raceline"
    GRIP = "grip exceeded for long"


@documented
@dataclass(frozen=True)
class SafetyLimits:
    """Limits beyond which the car stops, and how it does."""

    max_pose_age_s: float = parameter(
        "Largest age of a pose by its stamp, and longest time without one. A stamp may be as far "
        "in the future",
        "s",
        low=POSITIVE,
        tuning=(0.02, 2.0),
        default=0.2,
    )
    max_jump_m: float = parameter(
        "Largest jump of the position beyond what the car can have driven",
        "m",
        low=POSITIVE,
        tuning=(0.05, 10.0),
        default=0.5,
    )
    max_turn_rad: float = parameter(
        "Largest jump of the heading beyond what the car can have turned",
        "rad",
        low=POSITIVE,
        tuning=(0.05, 3.2),
        default=0.8,
    )
    max_deviation_m: float = parameter(
        "Largest distance from the raceline", "m", low=POSITIVE, tuning=(0.1, 20.0), default=1.5
    )
    max_saturated_s: float = parameter(
        "Longest uninterrupted demand beyond the grip. It lasts up to 1.3 s in simulated races "
        "that are finished",
        "s",
        low=POSITIVE,
        tuning=(0.1, 60.0),
        default=1.5,
    )
    stop_deceleration_mps2: float = parameter(
        "Deceleration of a stop", "m/s^2", low=POSITIVE, tuning=(0.5, 15.0), default=4.0
    )
    recovery_s: float = parameter(
        "Time from the end of a temporary cause until the car drives again",
        "s",
        low=SETTLING,
        tuning=(SETTLING, 10.0),
        default=0.5,
    )
    hold_s: float = parameter(
        "Time for which a stopped car without poses is still commanded to stand",
        "s",
        low=POSITIVE,
        tuning=(0.1, 10.0),
        default=2.0,
    )

    def __post_init__(self):
        check(self)


class PoseMotion:
    """Detects a frozen pose: the car moves while its pose stays the same.

    The car moves if its velocity says so, or if it did when the pose last changed, as a
    pose-derived velocity ends with the poses. A single jump, as when somebody corrects the
    localization of a parked car, is no motion.
    """

    def __init__(self):
        self._pose = self._changed = self._moving_since = None
        self._moving = False

    def frozen(self, now: float, pose: tuple, v_x: float, jumped: bool = False) -> float:
        """Time for which the car has been moving with the same pose [s].

        Parameters
        ----------
        now : float
            Time [s].
        pose : tuple of float
        v_x : float
            Speed [m/s].
        jumped : bool, optional
            Whether the pose jumped.
        """
        fast = abs(v_x) >= MOVING
        if pose != self._pose:
            if jumped or not fast:
                self._moving_since = None
            elif self._moving_since is None:
                self._moving_since = now
            since = self._moving_since
            self._moving = since is not None and now - since > SETTLING
            self._pose, self._changed = pose, now
        elif not (fast or self._moving):
            self._changed = now
        return now - self._changed


class Decision(NamedTuple):
    """Command to the car, and why."""

    mode: Mode
    reason: Reason
    steering_angle: float
    speed: float


class Supervisor:
    """State machine between poses, controller and drive.

    For each pose: `observe` it, let the controller step if it is trusted, and `decide` on the
    result. A timer calls `watch`, which notices a dropout of the poses. All times [s] are on the
    clock of the poses' stamps.

    Parameters
    ----------
    limits : SafetyLimits
    max_speed : float
        Largest speed ever commanded [m/s].

    Attributes
    ----------
    limits : SafetyLimits
        May be replaced while driving.
    mode : Mode
    reason : Reason
    jumped : bool
        Whether the last pose is farther from the one before than the car can have driven.
    restarted : bool
        Whether the clock was found set back at the last call; the past is forgotten.
    pose_age : float
        Age of the last pose when it was observed [s].
    """

    def __init__(self, limits: SafetyLimits, max_speed: float):
        self.limits = limits
        self._max_speed = max_speed
        self._requests = set()
        self._failed = self._lost_grip = False
        self._raceline_valid = True
        self._forget()

    def _forget(self):
        self.mode, self.reason = Mode.WAITING, Reason.NO_POSE
        self.jumped = self.restarted = False
        self.pose_age = math.nan
        self._seen = {}  # when each temporary cause was last seen
        self._pose = None
        self._speed = 0.0
        self._now = self._arrival = None
        self._motion = PoseMotion()
        self._saturated_since = self._stopped_since = None
        self._command = (0.0, 0.0)  # steering angle, speed
        self._commanded = None

    # -- requests and events -----------------------------------------------------------------

    def request_stop(self, source: str) -> None:
        """Stop until `resume`, or until `source` withdraws its request."""
        self._requests.add(source)

    def withdraw(self, source: str) -> None:
        """Withdraw the stop that `source` requested."""
        self._requests.discard(source)

    def fail(self) -> None:
        """Stop until `resume`, after a failure of the controller."""
        self._failed = True

    def resume(self) -> None:
        """Drive again after a requested stop, grip exceeded for long or a failure."""
        self._requests.clear()
        self._failed = self._lost_grip = False
        self._saturated_since = None

    def raceline_changed(self, valid: bool) -> None:
        """Note whether the latest raceline can be driven."""
        self._raceline_valid = valid

    # -- poses and commands ------------------------------------------------------------------

    def observe(self, now: float, state: CarState) -> bool:
        """Check a pose.

        Parameters
        ----------
        now : float
            Time of its arrival [s].
        state : CarState

        Returns
        -------
        bool
            Whether the controller may use it.
        """
        self._advance(now)
        self.jumped = False
        limits = self.limits
        if self._arrival is not None and now - self._arrival > limits.max_pose_age_s:
            self._seen[Reason.STALE_POSE] = now
        self._arrival = now
        self._seen.pop(Reason.NO_POSE, None)
        self.pose_age = now - state.t
        t, x, y, psi, v_x, _, r = state
        if not math.isfinite(t + x + y + psi + v_x + r):
            self._seen[Reason.INVALID_POSE] = now
            return False
        last = self._pose
        self._pose = state
        trusted = True
        if not abs(self.pose_age) <= limits.max_pose_age_s:
            self._seen[Reason.STALE_POSE] = now
            trusted = False
        if last is not None and self._is_jump(last, state):
            self._seen[Reason.JUMP] = now
            self.jumped = True
        frozen = self._motion.frozen(now, (x, y, psi), v_x, self.jumped)
        if frozen > limits.max_pose_age_s:
            self._seen[Reason.FROZEN_POSE] = now
            trusted = False
        if now - self._seen.get(Reason.JUMP, -math.inf) <= SETTLING:
            trusted = False
        if trusted and not frozen:
            self._speed = v_x
        return trusted

    def refuse(self, now: float) -> Decision:
        """Stop for a pose in another frame than the raceline.

        Returns
        -------
        Decision
        """
        self._advance(now)
        self._arrival = now
        self._seen[Reason.FRAME] = now
        return self.decide(now, None)

    def decide(self, now: float, result: ControlResult | None) -> Decision:
        """Turn the controller's result into a command.

        Parameters
        ----------
        now : float
            Time [s].
        result : ControlResult or None
            None if the pose is not trusted.

        Returns
        -------
        Decision
        """
        angle = self._command[0]
        wanted = None
        if not self._raceline_valid:
            self._seen[Reason.INVALID_RACELINE] = now
        if result is not None:
            self._judge(now, result)
            if result.status not in (Status.INVALID_STATE, Status.NO_RACELINE):
                if math.isfinite(result.steering_angle + result.speed):
                    angle, wanted = result.steering_angle, result.speed
                else:
                    self._failed = True
        else:
            self._saturated_since = None
        self.reason = self._cause(now)
        if self.reason is Reason.NONE and wanted is not None:
            self.mode, self._stopped_since, speed = Mode.DRIVING, None, wanted
        else:
            # The raceline may demand harder braking; walking pace off the track does not.
            follows = result is not None and result.status in (Status.OK, Status.SATURATED)
            speed = self._stop(now, wanted if follows else None)
        speed = min(max(speed, 0.0), self._max_speed)
        self._command, self._commanded = (angle, speed), now
        return Decision(self.mode, self.reason, angle, speed)

    def watch(self, now: float) -> Decision | None:
        """Notice a dropout of the poses.

        Returns
        -------
        Decision or None
            Command for a car without poses. None while poses come, and some time after the car has
            stopped.
        """
        self._advance(now)
        if self._arrival is None:
            self._seen[Reason.NO_POSE] = now
            self.reason = self._cause(now)
            return None
        if now - self._arrival <= self.limits.max_pose_age_s:
            return None
        self._seen[Reason.STALE_POSE] = now
        self.pose_age = now - (self._arrival if self._pose is None else self._pose.t)
        decision = self.decide(now, None)
        if self.mode is Mode.WAITING:
            return None
        if self._stopped_since is not None and now - self._stopped_since > self.limits.hold_s:
            return None
        return decision

    def _advance(self, now):
        self.restarted = self._now is not None and now < self._now - BACKWARDS
        if self.restarted:
            self._forget()
            self.restarted = True
        self._now = now

    def _is_jump(self, last, state):
        elapsed = max(state.t - last.t, 0.0)
        speed = min(max(abs(last.v_x), self._command[1]), 2.0 * self._max_speed)
        moved = math.hypot(state.x - last.x, state.y - last.y)
        turned = abs(math.remainder(state.psi - last.psi, math.tau))
        return (
            moved > self.limits.max_jump_m + speed * elapsed
            or turned > self.limits.max_turn_rad + abs(last.r) * elapsed
        )

    def _judge(self, now, result):
        """Note the causes to stop in the controller's result."""
        if result.status is Status.INVALID_STATE:
            self._seen[Reason.INVALID_POSE] = now
        elif result.status is Status.NO_RACELINE:
            self._seen[Reason.NO_RACELINE] = now
        elif not abs(result.d) <= self.limits.max_deviation_m:
            self._seen[Reason.DEVIATION] = now
        if result.status is not Status.SATURATED or abs(self._pose.v_x) < MOVING:
            self._saturated_since = None
        elif self._saturated_since is None:
            self._saturated_since = now
        elif now - self._saturated_since > self.limits.max_saturated_s:
            self._lost_grip = True

    def _cause(self, now):
        """The first of all present and recent causes."""
        recent = [
            reason for reason, seen in self._seen.items() if now - seen <= self.limits.recovery_s
        ]
        self._seen = {reason: self._seen[reason] for reason in recent}
        if self._requests:
            return Reason.STOP_REQUESTED
        if self._failed:
            return Reason.FAILURE
        if recent:
            return min(recent, key=_ORDER.__getitem__)
        return Reason.GRIP if self._lost_grip else Reason.NONE

    def _stop(self, now, wanted):
        """Speed of a stop; sets its mode."""
        if self.mode is Mode.WAITING:
            return 0.0
        speed = self._command[1]
        if self.mode is Mode.DRIVING:
            # A car that is still accelerating must not continue up to the last command.
            speed = min(speed, max(self._speed, 0.0))
            self.mode = Mode.STOPPING
        speed -= self.limits.stop_deceleration_mps2 * (now - self._commanded)
        if wanted is not None:
            speed = min(speed, wanted)
        if speed > 0.0:
            return speed
        if self.mode is Mode.STOPPING:
            self.mode, self._stopped_since = Mode.STOPPED, now
        return 0.0


_ORDER = {reason: number for number, reason in enumerate(Reason)}
