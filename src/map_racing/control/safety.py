"""Supervision: when the car may drive, and how it stops.

Every pose passes the supervisor on its way to the controller, and every command on its way to the
car. To stop, the speed ramps down. Meanwhile the car steers along the raceline if its pose can be
trusted, and otherwise holds the steering angle, both within the grip that braking leaves at the
measured speed. After a temporary cause (a late pose, a jump, a missing raceline) the car drives
again by itself. After a requested stop, prolonged saturation, overspeed or a failure of the
controller it waits for `Supervisor.resume`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Callable

from .controller import ControlResult, Status
from .decision import Decision, Mode, Reason
from .obedience import MOVING, ROLLING, SETTLING, Course, Obedience, PoseMotion
from .safety_limits import SafetyLimits
from .slowing import Slowing
from .speed_plan import WALKING_PACE
from .state import CarState

if TYPE_CHECKING:
    from ..track.raceline import Raceline

__all__ = ["Supervisor"]

# A car that did not move as commanded, or not along its heading, rests for this long [s] before it
# tries again.
REST = 3.0

# Largest plausible speed [m/s] (or twice the controller's largest, if more) and yaw rate [rad/s].
FASTEST, FASTEST_TURN = 50.0, 100.0

# Speeds below this one are noise at standstill [m/s].
STANDSTILL = 0.3

# Interval between commands while there are no poses [s].
PERIOD = 0.02

# After a gap in the commands the ramp does not catch up at once: its first step and any later one
# cover at most these times [s].
FIRST_STEP, LONGEST_STEP = 0.05, 0.1

# When a stop begins, the car is assumed to have kept accelerating since the last pose as it did
# before (low-passed over RISING [s], at most QUICKEST [m/s^2]), up to the last command.
RISING, QUICKEST = 0.1, 5.0

# A clock that jumps back by more than this [s] was reset: a looping bag or a restarted simulator.
BACKWARDS = 0.5


class Supervisor:
    """State machine between poses, controller and drive.

    For each pose: `observe` it, let the controller step if it is trusted, and `decide` on the
    result. Call `watch` at `deadline` to notice a dropout of the poses. All times [s] are on the
    clock of the pose timestamps.

    Parameters
    ----------
    limits : SafetyLimits
    max_speed : float
        Largest speed ever commanded [m/s].
    slowing : Slowing, optional
        Grip of the car. Without it, stops neither reduce nor slow the steering.

    Attributes
    ----------
    limits : SafetyLimits
    slowing : Slowing or None
        Both may be replaced while driving.
    mode : Mode
    reason : Reason
    jumped : bool
        Whether the last pose is farther from the one before than the car can have moved.
    on_restart : callable
        Called when the clock was set back and the supervisor has reset itself.
    pose_age : float
        Age of the last pose when it arrived [s].
    """

    def __init__(self, limits: SafetyLimits, max_speed: float, slowing: Slowing | None = None):
        self.limits = limits
        self._max_speed, self.slowing = max_speed, slowing
        self._requests = set()
        self._failed = self._lost_grip = self._overspeed = False
        self._raceline_valid, self._opposed = True, False
        self.on_restart: Callable[[], None] = lambda: None
        self.mode = Mode.WAITING
        self._command, self._commanded = (0.0, 0.0), None  # steering angle and speed; when
        self._speed = 0.0
        self._forget()

    def _forget(self):
        if self.mode is not Mode.WAITING:
            # The car still holds the last command, so ramp down as after any gap.
            self.mode, self._commanded = Mode.STOPPING, -math.inf
        self.reason = Reason.NO_POSE
        self.jumped = False
        self.pose_age = math.nan
        self._seen = {}  # when each temporary cause was last seen
        self._pose = None
        self._measured = self._rise = 0.0
        self._now = self._arrival = None
        self._motion, self._course, self._obedience = PoseMotion(), Course(), Obedience()
        self._blocked = self._slows = False
        self._saturated_since = self._stopped_since = None

    # -- requests and events -----------------------------------------------------------------

    def request_stop(self, source: str) -> None:
        """Stop until `resume`, or until `source` withdraws its request."""
        self._requests.add(source)

    def withdraw(self, source: str) -> None:
        """Withdraw the stop that `source` requested."""
        self._requests.discard(source)

    @property
    def requests(self) -> frozenset[str]:
        """Sources whose requests to stop are in force."""
        return frozenset(self._requests)

    def fail(self) -> None:
        """Stop until `resume`, after a failure of the controller."""
        self._failed = True

    def resume(self) -> None:
        """Clear every stop that waits for this, and end the rest of a blocked or misaligned car."""
        self._requests.clear()
        self._failed = self._lost_grip = self._overspeed = False
        for reason in _RESTS:
            self._seen.pop(reason, None)
        self._saturated_since = None

    def raceline_changed(self, valid: bool, opposed: bool = False) -> None:
        """Note whether the latest raceline can be driven, and whether it is `opposed`."""
        self._raceline_valid, self._opposed = valid, opposed

    def opposes(self, raceline: Raceline) -> bool:
        """Whether a raceline runs against the car's motion, so that the car has to stop first."""
        if self.stands or self._pose is None:
            return False
        beside = raceline.project(self._pose.x, self._pose.y)
        along = math.cos(raceline.pose(beside.s).psi - self._pose.psi)
        return (along if self._speed >= 0.0 else -along) < 0.0

    @property
    def stands(self) -> bool:
        """Whether the car stands and is commanded to."""
        return self._command[1] == 0.0 and abs(self._speed) < STANDSTILL

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
        # A NaN fails every comparison.
        finite = math.isfinite(t + x + y + psi)
        fastest = max(FASTEST, 2.0 * self._max_speed)
        if not (finite and abs(v_x) <= fastest and abs(r) <= FASTEST_TURN):
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
        frozen = self._motion.frozen(now, x, y, v_x, self.jumped)
        if frozen > limits.max_pose_age_s:
            self._seen[Reason.FROZEN_POSE] = now
            trusted = False
        if self._course.aside(x, y, psi, v_x, self.jumped) > limits.max_turn_rad:
            self._seen[Reason.HEADING] = now
            trusted = False
        if now - self._seen.get(Reason.JUMP, -math.inf) <= SETTLING:
            trusted = False
        if trusted:
            if not frozen:
                self._measure(now, v_x)
            self._check_obedience(now, state)
        return trusted

    def refuse(self, now: float) -> Decision:
        """Stop for a pose that is not in the raceline's frame.

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
            None if the pose is not trusted or the controller was not run.

        Returns
        -------
        Decision
        """
        angle = self._command[0]
        wanted = None
        if not self._raceline_valid:
            self._seen[Reason.INVALID_RACELINE] = now
        if self._opposed:
            self._seen[Reason.OPPOSED_RACELINE] = now
        if result is not None:
            self._check_result(now, result)
            if result.status not in (Status.INVALID_STATE, Status.NO_RACELINE):
                if math.isfinite(result.steering_angle + result.speed):
                    angle, wanted = result.steering_angle, result.speed
                else:
                    self._failed = True
        else:
            self._saturated_since = None
        self.reason = self._cause(now)
        drives = self.reason is Reason.NONE and wanted is not None
        if drives and self._blocked:
            wanted = min(wanted, WALKING_PACE)
        # On the raceline the plan may brake harder than a stop; the slowdown off course may not.
        follows = wanted is not None and result.status in (Status.OK, Status.SATURATED)
        angle, speed = self._ramped(now, angle, wanted, drives, follows)
        speed = min(max(speed, 0.0), self._max_speed)
        self._command, self._commanded = (angle, speed), now
        return Decision(self.mode, self.reason, angle, speed)

    def watch(self, now: float) -> Decision | None:
        """Notice a dropout of the poses.

        Returns
        -------
        Decision or None
            Command for a car without poses. None while poses arrive, before the car has driven, and
            once it has stood for ``hold_s``.
        """
        self._advance(now)
        if self._arrival is None:
            self._seen[Reason.NO_POSE] = now
        elif now - self._arrival < self.limits.max_pose_age_s:
            return None
        else:
            self._seen[Reason.STALE_POSE] = now
            self.pose_age = now - (self._arrival if self._pose is None else self._pose.t)
        decision = self.decide(now, None)
        if self.mode is Mode.WAITING:
            return None
        if self._stopped_since is not None and now - self._stopped_since > self.limits.hold_s:
            return None
        return decision

    def _advance(self, now):
        if self._now is not None and now < self._now - BACKWARDS:
            self._forget()
            self.on_restart()
        self._now = now

    @property
    def deadline(self) -> float | None:
        """Time at which to call `watch` unless another pose comes [s]; None if never."""
        if self._arrival is not None and self._now - self._arrival < self.limits.max_pose_age_s:
            return self._arrival + self.limits.max_pose_age_s
        return None if self.mode is Mode.WAITING else self._now + PERIOD

    def _measure(self, now, v_x):
        """Record a measured speed and its low-passed rate of increase."""
        elapsed = max(now - self._measured, 1e-3)
        rise = self._rise + min(elapsed / RISING, 1.0) * (
            (v_x - self._speed) / elapsed - self._rise
        )
        self._rise = min(max(rise, 0.0), QUICKEST)
        self._speed, self._measured = v_x, now

    def _is_jump(self, last, state):
        elapsed = max(state.t - last.t, 0.0)
        speed = min(max(abs(last.v_x), self._command[1]), 2.0 * self._max_speed)
        moved = math.hypot(state.x - last.x, state.y - last.y)
        turned = abs(math.remainder(state.psi - last.psi, math.tau))
        return (
            moved > self.limits.max_jump_m + speed * elapsed
            or turned > self.limits.max_turn_rad + abs(last.r) * elapsed
        )

    def _check_result(self, now, result):
        """Note reasons to stop that follow from the controller's result."""
        if result.status is Status.INVALID_STATE:
            self._seen[Reason.INVALID_POSE] = now
        elif result.status is Status.NO_RACELINE:
            self._seen[Reason.NO_RACELINE] = now
        elif not abs(result.d) <= self.limits.max_deviation_m:
            self._seen[Reason.DEVIATION] = now
        if result.status is not Status.SATURATED or self._pose.v_x < MOVING:
            self._saturated_since = None
        elif self._saturated_since is None:
            self._saturated_since = now
        elif now - self._saturated_since > self.limits.max_saturated_s:
            self._lost_grip = True

    def _check_obedience(self, now, pose):
        """Note reasons to stop that follow from how the car answers its commands."""
        obedience, driving = self._obedience, self.mode is Mode.DRIVING
        onwards = pose.v_x >= -ROLLING
        obedience.update(now, pose.x, pose.y, self._command[1] if onwards else 0.0)
        if obedience.blocked(now, self.limits.max_blocked_m, self.limits.max_pose_age_s):
            self._seen[Reason.BLOCKED] = now
            self._blocked = True
        elif obedience.moves:
            self._blocked = False
        excess = pose.v_x - self._command[1] if driving else 0.0
        if obedience.too_fast(now, excess, self.limits.max_overspeed_mps):
            self._overspeed = True
        if self.mode is not Mode.WAITING and obedience.backwards(now, pose.v_x):
            self._seen[Reason.BACKWARDS] = now

    def trouble(self, now: float) -> Reason:
        """Highest-priority present or recent reason to stop, apart from requests."""
        limit = self.limits.recovery_s
        recent = [
            reason
            for reason, seen in self._seen.items()
            if now - seen <= (max(REST, limit) if reason in _RESTS else limit)
        ]
        self._seen = {reason: self._seen[reason] for reason in recent}
        if self._failed:
            return Reason.FAILURE
        if recent:
            return min(recent, key=_ORDER.__getitem__)
        if self._overspeed:
            return Reason.OVERSPEED
        return Reason.GRIP if self._lost_grip else Reason.NONE

    def _cause(self, now):
        return Reason.STOP_REQUESTED if self._requests else self.trouble(now)

    def _ramped(self, now, angle, wanted, drives, follows):
        """Steering angle and speed to command; sets the mode.

        While the car stops, is off course, or is suddenly commanded a much lower speed, braking and
        steering stay within the friction ellipse at the measured speed. This ends when neither is
        limited anymore.
        """
        if self.mode is Mode.WAITING and not drives:
            return angle, 0.0
        last_angle, speed = self._command
        elapsed = 0.0 if self._commanded is None else now - self._commanded
        elapsed = min(max(elapsed, 0.0), LONGEST_STEP)  # a clock may step back a little
        v, deceleration = self._speed, self.limits.stop_deceleration_mps2
        slows = not (drives and follows)
        if self.slowing is not None and not slows:
            slows = v - wanted > self.slowing.sudden
        if not self._slows or (self.mode is Mode.DRIVING and not drives):
            # A car that is still accelerating must not continue up to the last command.
            speed = min(speed, self._speed + self._rise * (now - self._measured))
            elapsed = min(elapsed, FIRST_STEP)
        if self.slowing is not None and self.slowing.always:
            most = self.slowing.largest(v)
            angle = min(max(angle, -most), most)
        asked, slowest = angle, -math.inf
        if self.slowing is not None and (slows or self._slows):
            deceleration = self.slowing.bounded(deceleration)
            angle = self.slowing.steering(v, angle, last_angle, deceleration, elapsed)
            braking = self.slowing.braking(v, angle)
            slowest = speed - elapsed * (braking if follows else min(braking, deceleration))
        if drives:
            self.mode, self._stopped_since = Mode.DRIVING, None
            speed = max(wanted, slowest)
            self._slows = angle != asked or speed != wanted
            return angle, speed
        self._slows = True
        if self.mode is Mode.DRIVING:
            self.mode = Mode.STOPPING
        speed -= deceleration * elapsed
        if follows:
            speed = min(speed, wanted)
        speed = max(speed, slowest)
        if speed > 0.0:
            return angle, speed
        if self.mode is Mode.STOPPING:
            self.mode, self._stopped_since = Mode.STOPPED, now
        return angle, 0.0


_RESTS = (Reason.BLOCKED, Reason.HEADING)
_ORDER = {reason: number for number, reason in enumerate(Reason)}
