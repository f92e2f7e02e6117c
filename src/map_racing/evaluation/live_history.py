"""The driving so far, for warnings about the running car."""

from __future__ import annotations

import math
from array import array

import numpy as np

from ..bags.samples import Commands, Recording, in_order
from .doubts import doubts_of
from .results import Lap

__all__ = ["History"]

# Fewest poses and commands kept: 2 minutes at 100 Hz. With twice as many, the warnings take half a
# second, for which a completed lap waits.
_KEPT = 12000
# Most warnings kept about forgotten driving.
_MOST = 20


class History:
    """The latest poses and commands of a run, as a recording.

    Parameters
    ----------
    pose_topic, drive_topic : str
        Names of poses and commands in warnings.
    """

    def __init__(self, pose_topic: str, drive_topic: str):
        self._pose_topic, self._drive_topic = pose_topic, drive_topic
        self.clear()

    def clear(self) -> None:
        """Forget the run."""
        self._poses = tuple(array("d") for _ in range(5))
        self._stamps, self._commands = array("q"), (array("d"), array("d"))
        self._spans = []
        # Warnings about driving that is forgotten by now, and the latest ones.
        self._earlier, self._latest = {}, {}

    def add_pose(self, *pose: float) -> None:
        """Add a pose: time since the first [s], position [m], heading [rad] and speed [m/s]."""
        if len(self._poses[0]) >= 2 * _KEPT and len(self._earlier) < _MOST:
            self._earlier.update(self._latest)
        _append(self._poses, pose)

    def add_command(self, stamp_ns: int, speed: float, steering_angle: float) -> None:
        """Add a command: time stamp [ns], speed [m/s] and steering angle [rad]."""
        _append((self._stamps, *self._commands), (stamp_ns, steering_angle, speed))

    def add_laps(self, laps: list[Lap]) -> None:
        """Add laps that ended; only the first and the last complete one are kept."""
        complete = [lap for lap in laps if not math.isnan(lap.lap_time_s)]
        self._spans += [(lap.start_time_s, lap.end_time_s) for lap in complete]
        del self._spans[1:-1]

    def doubts(self, t0_ns: int) -> list[str]:
        """Warnings about the run so far, see `doubts_of`.

        Parameters
        ----------
        t0_ns : int
            Time stamp of the first pose on the clock of the commands [ns].
        """
        columns = [np.array(column) for column in self._poses]
        if columns[0].size < 2:
            return []
        notes = []
        t, (x, y, psi, v) = in_order(columns[0], columns[1:], notes, self._pose_topic, required=2)
        nothing = np.full(t.size, math.nan)
        stamps = np.array(self._stamps, dtype=np.int64)
        at, commanded = in_order(stamps, [np.array(column) for column in self._commands], [], "")
        commands = Commands((at - t0_ns) * 1e-9, *commanded, self._drive_topic) if at.size else None
        driven = Recording(
            *(t, x, y, psi, v, nothing, nothing), topic=self._pose_topic, commands=commands
        )
        mark = "warning: "
        said = [note[len(mark) :] for note in notes if note.startswith(mark)]
        self._latest = dict.fromkeys([*said, *doubts_of(driven, self._spans)])
        return list({**self._earlier, **self._latest})


def _append(columns, values):
    for column, value in zip(columns, values):
        column.append(value)
        if len(column) > 2 * _KEPT:
            del column[: _KEPT + 1]
