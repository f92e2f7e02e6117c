"""Whether the car does what it is told, and its pose what the car does."""

from __future__ import annotations

import math

__all__ = ["MOVING", "ROLLING", "SETTLING", "Course", "Obedience", "PoseMotion"]

# Above this speed [m/s] grip, not the steering lock, limits the turn, and the pose must change.
MOVING = 1.0

# Pose-derived velocities are contaminated for this long after a jump [s].
SETTLING = 0.15

# A pose moves if it gets farther than this share of the distance driven ...
SHARE = 0.1
# ... and than a localization that stands still jitters [m].
JITTER = 0.003
# A velocity that ended with the poses counts for this long [s].
MEMORY = 3.0
# No more than this distance is held against a pose [m]: a car that is carried away moves again.
MOST_DRIVEN = 1.0

# The way between positions so far apart [m] has a direction.
APART = 0.5

# The command is followed where the car gets this share of the way that it should ...
FOLLOWED = 0.2
# ... and farther than noise [m].
NOISE = 0.05
# Any car reaches this acceleration [m/s^2].
GENTLE = 1.5
# Where a speed differs from the command for longer than this [s], the car does not obey.
PATIENCE = 0.5
# Noise at standstill is no rolling [m/s].
ROLLING = 0.5


class PoseMotion:
    """Detects a frozen pose: the car moves while its pose stays, but for jitter.

    The car moves if its velocity says so, or if it did when the pose last moved, as a pose-derived
    velocity ends with the poses; that counts for 3 s. A single jump, as when somebody corrects the
    localization of a parked car, is no motion.
    """

    def __init__(self):
        self._x = self._y = math.nan
        self._now = self._changed = self._moving_since = None
        self._driven = self._speed = 0.0

    def frozen(self, now: float, x: float, y: float, v_x: float, jumped: bool = False) -> float:
        """Time for which the car has been moving with the same position [s].

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
    """Compares the heading of the poses with the way that their positions take."""

    def __init__(self):
        self._last = self._angles = None

    def aside(self, x: float, y: float, psi: float, v_x: float, jumped: bool = False) -> float:
        """Angle [rad] between both; 0 below 1 m/s, where it is noise.

        Of the last two half meters the smaller one: a small correction of the position is in one.

        Parameters
        ----------
        x, y : float
            Position [m].
        psi : float
            Heading [rad].
        v_x : float
            Speed [m/s]; negative where the car rolls backwards.
        jumped : bool, optional
            Whether the pose jumped: then the way begins anew.
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
        Distance that the car should have driven while its pose stayed [m]: by the speed that it
        had when the pose last moved, from there on with an acceleration of 1.5 m/s^2 up to the
        command.
    moves : bool
        Whether the last pose is elsewhere than some before.
    """

    def __init__(self):
        self._now = self._fast_since = self._back_since = None
        self.restart()

    def restart(self):
        """Begin anew, as where the car is not told to drive."""
        self._x = self._y = self._since = math.nan
        self._expected = self.undriven = 0.0
        self.moves = False

    def update(self, now: float, x: float, y: float, command: float) -> None:
        """Take a position [m] at a time [s] under a commanded speed [m/s]."""
        last, self._now = self._now, now
        if command <= 0.0:
            self.restart()
            return
        if last is not None:
            elapsed = now - last
            self._expected = min(self._expected + GENTLE * elapsed, command)
            self.undriven += self._expected * elapsed
        moved = math.hypot(x - self._x, y - self._y)
        # The first one has moved by NaN.
        if not moved <= max(FOLLOWED * self.undriven, NOISE):
            self.moves = moved == moved
            if now > self._since:
                self._expected = moved / (now - self._since)
            self._x, self._y, self._since = x, y, now
            self.undriven = 0.0

    def blocked(self, now: float, distance: float, patience: float) -> bool:
        """Whether the pose stays for a distance [m] that should be driven, and a time [s]."""
        return self.undriven >= distance and now - self._since > patience

    def too_fast(self, now: float, excess: float, limit: float) -> bool:
        """Whether the speed has been above the command by more than `limit` [m/s] for long."""
        self._fast_since = _since(self._fast_since, now, excess > limit)
        return self._fast_since is not None and now - self._fast_since > PATIENCE

    def backwards(self, now: float, v_x: float) -> bool:
        """Whether the car has been rolling backwards for long."""
        self._back_since = _since(self._back_since, now, v_x < -ROLLING)
        return self._back_since is not None and now - self._back_since > PATIENCE


def _since(since, now, holds):
    """When something began to hold; None if it does not."""
    return (now if since is None else since) if holds else None
