"""Grip of the day from a recording, by replaying it through the filter of the adaptation."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..bags.samples import Recording
from ..control.adaptation import PRIOR, Adaptation
from ..control.belief import Belief
from ..control.state import CarState
from ..vehicle.parameters import Vehicle
from .results import Lap
from .turning import speed_driven, turning_of

__all__ = ["DayGrip", "grip_of_day"]

# This many poses are enough, and take a quarter of a second.
_MOST_POSES = 4000
_DELAY, _SHARE = 0.07, 0.4


class DayGrip(NamedTuple):
    """Lateral limit of a car on a day, relative to its vehicle file's.

    Attributes
    ----------
    level, low, high : float
        The limit, and the ends of its 95 % interval.
    belief : Belief or None
        Friction, stiffness and delay; None if the recording does not determine them: `level` is
        then the prior for any day.
    share : float
        Factors were estimated within ``1 - share`` to ``1 + share``.
    """

    level: float
    low: float
    high: float
    belief: Belief | None
    share: float = _SHARE

    def bounded(self, value: float) -> bool:
        """Whether a factor is at a bound of its range, where it means little."""
        return abs(abs(value - 1.0) - self.share) < 1e-3


def grip_of_day(
    recording: Recording,
    laps: list[Lap],
    vehicle: Vehicle,
    *,
    delay: float = _DELAY,
    share: float = _SHARE,
    behind: float | None = None,
) -> DayGrip:
    """Grip of the day as shown by laps.

    Parameters
    ----------
    recording : Recording
    laps : list of Lap
        Laps to learn from; if there are many, the last ones are used.
    vehicle : Vehicle
    delay, share, behind : float, optional
        As in `map_racing.control.adaptation.Adaptation`.

    Returns
    -------
    DayGrip
        Without commands, speed or yaw rate, the prior for any day.
    """
    learner = Adaptation(vehicle, max(vehicle.v_max, 1.0), delay, share, behind)
    fed = _feed(learner, recording, laps)
    level, belief = learner.level, learner.belief
    if not fed:
        width = np.exp(1.96 * PRIOR[0])
        return DayGrip(1.0, 1.0 / width, width, None, share)
    low, high = (
        level * end / belief.friction for end in (belief.friction_low, belief.friction_high)
    )
    return DayGrip(level, low, high, belief, share)


def _feed(learner, recording, laps):
    """Feed poses and commands to the filter; return whether there were any."""
    t, commands = recording.t, recording.commands
    if commands is None or not laps:
        return False
    rate, _ = turning_of(recording)
    if rate is not recording.yaw_rate or not speed_driven(recording)[1]:
        return False
    chosen = np.zeros(t.size, dtype=bool)
    for lap in reversed(laps):
        if np.count_nonzero(chosen) >= _MOST_POSES:
            break
        chosen |= (t >= lap.start_time_s) & (t <= lap.end_time_s)
    # The command that answers a pose is the one before the next pose.
    following = np.append(t[1:], t[-1] + 0.02) - 1e-6
    angles = commands.held(following, commands.steering_angle)
    chosen &= np.isfinite(angles) & np.isfinite(recording.v_x) & np.isfinite(rate)
    index = np.flatnonzero(chosen)[-_MOST_POSES:]
    states = (t, recording.x, recording.y, recording.psi, recording.v_x, recording.v_y)
    rows = np.column_stack([column[index] for column in (*states, rate, angles)])
    for *state, angle in rows.tolist():
        learner.update(CarState(*state), angle)
    return bool(index.size)
