"""Checks that the car follows its commands and that its pose follows the car."""

from __future__ import annotations

import math

__all__ = ["MOVING", "ROLLING", "SETTLING", "Course", "Obedience", "PoseMotion"]

# Above this speed [m/s] grip, not the steering lock, limits the turn, and the pose must change.
MOVING = 1.0

# Pose-derived velocities are contaminated for this long after a jump [s].
SETTLING = 0.15

# A pose counts as moving if it changes by more than this share of the distance driven ...
SHARE = 0.1
# ... and by more than the jitter of localization at standstill [m].
JITTER = 0.003
# Velocity derived from poses ends when they freeze; its last value still counts for this long [s].
MEMORY = 3.0
# Cap on the distance driven [m], so that a pose which moves again is soon recognized as moving.
MOST_DRIVEN = 1.0

# The direction of motion is taken between positions this far apart [m].
APART = 0.5

# The car follows the command if it covers this share of the distance that it should ...
FOLLOWED = 0.2
# ... and more than noise [m].
NOISE = 0.05
# Any car reaches this acceleration [m/s^2].
GENTLE = 1.5
# A speed may be at odds with the command for this long [s].
PATIENCE = 0.5
# Backward speeds up to this one may be noise at standstill [m/s].
ROLLING = 0.5


class PoseMotion:
    """Detects a frozen pose: the car moves while its pose stays put, apart from jitter.

    The car counts as moving if its velocity says so, or, for 3 s, if the velocity did when the pose
    last changed, because a pose-derived velocity drops to zero with frozen poses. A single jump, as
    when somebody corrects the localization of a parked car, is not motion.
    """

    def __init__(self):
        self._x = self._y = math.nan
        self._now = self._changed = self._moving_since = None
        self._driven = self._speed = 0.0

    def frozen(self, now: float, x: float, y: float, v_x: float, jumped: bool = False) -> float:
        """Time for which the car has been moving while its position stayed the same [s].

        Parameters
        ----------
        now : float
            Time [s].
        x, y : float
            Position [m].
        v_x : float
            Speed [m/s].
        jumped : bool, optional
            Whether the pose jumped.
        """
        speed = abs(v_x)
        fast = speed >= MOVING
        if self._now is not None:
            self._driven += max(speed, self._speed) * (now - self._now)
        self._now = now
        least = max(SHARE * min(self._driven, MOST_DRIVEN), JITTER)
        # Also true for the first one, as NaN fails every comparison.
        if not abs(x - self._x) + abs(y - self._y) <= least:
            if jumped or not fast:
                self._moving_since = None
            elif self._moving_since is None:
                self._moving_since = now
            since = self._moving_since
            self._speed = speed if since is not None and now - since > SETTLING else 0.0
            self._x, self._y = x, y
            self._changed, self._driven = now, 0.0
        elif not (fast or (self._speed and now - self._changed < MEMORY)):
            self._changed, self._driven, self._speed = now, 0.0, 0.0
        return now - self._changed


class Course:
    """Compares the heading of the poses with the direction in which their positions move."""

    def __init__(self):
        self._last = self._angles = None

    def aside(self, x: float, y: float, psi: float, v_x: float, jumped: bool = False) -> float:
        """Angle [rad] between heading and motion; 0 below 1 m/s, where it is noise.

        It is the smaller angle of the last two half-meter stretches, because a small correction of
        the position spoils only one of them.

        Parameters
        ----------
        x, y : float
            Position [m].
        psi : float
            Heading [rad].
        v_x : float
            Speed [m/s]; negative where the car rolls backwards.
        jumped : bool, optional
            Whether the pose jumped, which restarts the comparison.
        """
        if self._last is None or jumped or abs(v_x) < MOVING:
            self._last, self._angles = (x, y, psi), (0.0, 0.0)
            return 0.0
        x_0, y_0, psi_0 = self._last
        if math.hypot(x - x_0, y - y_0) >= APART:
            heading = psi_0 + 0.5 * math.remainder(psi - psi_0, math.tau)
            way = math.atan2(y - y_0, x - x_0) + (math.pi if v_x < 0.0 else 0.0)
            self._angles = self._angles[1], abs(math.remainder(way - heading, math.tau))
            self._last = x, y, psi
        return min(self._angles)


class Obedience:
    """Compares the motion of the car with the command, from pose to pose.

    Attributes
    ----------
    undriven : float
        Distance that the car should have driven while its pose stayed put [m], if it accelerated by
        1.5 m/s^2 up to the command, starting from its speed when the pose last moved.
    moves : bool
        Whether the pose has moved under the present command.
    """

    def __init__(self):
        self._now = self._fast_since = self._back_since = None
        self.restart()

    def restart(self):
        """Start over, as when the commanded speed is zero."""
        self._x = self._y = self._since = math.nan
        self._expected = self.undriven = 0.0
        self.moves = False

    def update(self, now: float, x: float, y: float, command: float) -> None:
        """Process a position [m] at a time [s] under a commanded speed [m/s]."""
        last, self._now = self._now, now
        if command <= 0.0:
            self.restart()
            return
        if last is not None:
            elapsed = now - last
            self._expected = min(self._expected + GENTLE * elapsed, command)
            self.undriven += self._expected * elapsed
        moved = math.hypot(x - self._x, y - self._y)
        # The distance is NaN for the first position.
        if not moved <= max(FOLLOWED * self.undriven, NOISE):
            self.moves = moved == moved
            if now > self._since:
                self._expected = moved / (now - self._since)
            self._x, self._y, self._since = x, y, now
            self.undriven = 0.0

    def blocked(self, now: float, distance: float, patience: float) -> bool:
        """Whether the pose stayed put for `distance` [m] due by command and `patience` [s]."""
        return self.undriven >= distance and now - self._since > patience

    def too_fast(self, now: float, excess: float, limit: float) -> bool:
        """Whether the speed has exceeded the command by more than `limit` [m/s] for 0.5 s."""
        self._fast_since = _since(self._fast_since, now, excess > limit)
        return self._fast_since is not None and now - self._fast_since > PATIENCE

    def backwards(self, now: float, v_x: float) -> bool:
        """Whether the car has been rolling backwards for more than 0.5 s."""
        self._back_since = _since(self._back_since, now, v_x < -ROLLING)
        return self._back_since is not None and now - self._back_since > PATIENCE


def _since(since, now, holds):
    """Time since which a condition holds; None if it does not."""
    return (now if since is None else since) if holds else None
