"""Projection of a moving car onto a raceline, at a cost independent of the track's length."""

from __future__ import annotations

import math

from .curve import Projection
from .raceline import Raceline

__all__ = ["RacelineTracker"]

# Longest plausible movement from one update to the next [m].
FARTHEST_STEP = 3.0


class RacelineTracker:
    """Continuous projection of a moving car onto a raceline.

    Each update searches around the place predicted from the last projection, so the car stays on
    its own branch where the track crosses itself or runs back alongside. The whole track is
    searched only on the first update or if the local result is not plausible: after a jump of the
    pose, when the projection moved much farther than the pose, or when the car is too far from the
    curve.

    Parameters
    ----------
    raceline : Raceline

    Attributes
    ----------
    max_deviation : float
        Largest plausible distance from the curve [m]: 0.5 m beyond the farther wall or, without
        walls, 2 m.
    reacquired : bool
        Whether the last update searched the whole track and found the car elsewhere than expected;
        true on the first update.
    lost : bool
        Whether the car was farther from the curve than `max_deviation` at the last update.
    """

    def __init__(self, raceline: Raceline):
        self.raceline, self.max_deviation = raceline, 2.0
        if raceline.d_left is not None:
            self.max_deviation = 0.5 + float(max(raceline.d_left.max(), raceline.d_right.max()))
        self.reset()

    def reset(self) -> None:
        """Forget the last position: the next update searches the whole track."""
        self._last = None
        self._x = self._y = 0.0
        self.lost = self.reacquired = False

    def update(self, x: float, y: float, psi: float | None = None) -> Projection:
        """Project the car's next position.

        Parameters
        ----------
        x, y, psi
            As for `Raceline.project`. A search of the whole track prefers a branch within 90
            degrees of the heading, if one is close enough.

        Returns
        -------
        Projection

        Raises
        ------
        ParameterError
            If the position is not finite. The tracker keeps its last position.
        """
        last = self._last
        if last is not None:
            dx, dy = x - self._x, y - self._y
            moved = math.sqrt(dx * dx + dy * dy)
            if moved <= FARTHEST_STEP:
                guess = last.s + dx * math.cos(last.psi) + dy * math.sin(last.psi)
                # Inside a bend the projection moves faster than the car.
                found = self.raceline.project_near(x, y, guess, 3.0 * moved + 0.5)
                if found is not None and -self.max_deviation <= found.d <= self.max_deviation:
                    self._last, self._x, self._y = found, x, y
                    self.lost = self.reacquired = False
                    return found
        found = self.raceline.project(x, y, psi)
        if psi is not None and abs(found.d) > self.max_deviation:
            found = self.raceline.project(x, y)
        self.reacquired = last is None or self._elsewhere(found, x, y)
        self.lost = abs(found.d) > self.max_deviation
        self._last, self._x, self._y = found, x, y
        return found

    def _elsewhere(self, found, x, y):
        """Whether the projection moved farther along the track than the pose can have moved."""
        moved = math.hypot(x - self._x, y - self._y)
        half = 0.5 * self.raceline.length
        along = (found.s - self._last.s + half) % self.raceline.length - half
        return moved > FARTHEST_STEP or abs(along) > 3.0 * moved + 0.5
