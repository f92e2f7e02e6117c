"""Commands that arrive while the car drives, and their clock."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque

import numpy as np

from ..bags.clocks import COMMAND_DELAY_NS, LATENCY_NS
from ..bags.samples import COMMAND_HOLD_S

__all__ = ["LONGEST_WAIT", "CommandClock", "Commands"]

LONGEST_WAIT = 180000
"""Poses kept while there is no raceline: 30 minutes at 100 Hz."""

# Clocks are compared after this many changes between poses and commands, of which this many are
# kept.
_COMPARED, _REMEMBERED = 25, 500
# Past commands are deleted in groups of this size.
_PASSED = 4096


class Commands:
    """Commands in the order of their time stamps, of one run.

    Parameters
    ----------
    gap_ns : int
        A larger step back in time begins another run.
    """

    def __init__(self, gap_ns: int):
        self._gap_ns = gap_ns
        self.clear()

    def clear(self) -> None:
        """Forget all."""
        self._stamps, self._values = [], []
        # Commands after a step back in time that the poses have not made yet.
        self._ahead = []
        # Later commands [ns] belong to the run that ended.
        self._end_ns = math.inf

    def add(self, stamp_ns: int, value: tuple[float, float]) -> None:
        """Add a command: steering angle [rad] and speed [m/s]."""
        if stamp_ns > self._end_ns:
            return
        self._end_ns = math.inf
        if self._stamps and stamp_ns < self._stamps[-1] - self._gap_ns:
            self._ahead.append((stamp_ns, value))
            return
        self._insert(stamp_ns, value)
        # Time continues as before: the step back was a stray message or two.
        for entry in self._ahead:
            self._insert(*entry)
        self._ahead = []

    def _insert(self, stamp_ns, value):
        at = bisect_right(self._stamps, stamp_ns)
        if at == 0 or self._stamps[at - 1] != stamp_ns:
            self._stamps.insert(at, stamp_ns)
            self._values.insert(at, value)
            if len(self._stamps) > 2 * LONGEST_WAIT:
                self._forget(LONGEST_WAIT)

    @property
    def any(self) -> bool:
        """Whether there are commands at all."""
        return bool(self._stamps)

    @property
    def complete(self) -> bool:
        """Whether no more commands of this run are to come: their time stepped back, too."""
        return bool(self._ahead) or not self.any

    def beyond(self, stamp_ns: int) -> bool:
        """Whether a later command has arrived."""
        return bool(self._stamps) and self._stamps[-1] > stamp_ns

    def at(self, stamp_ns: int) -> tuple[float, float]:
        """Command in force, NaN without one; times of successive calls must not decrease."""
        index = bisect_right(self._stamps, stamp_ns) - 1
        value = (math.nan, math.nan)
        if index >= 0 and (stamp_ns - self._stamps[index]) * 1e-9 <= COMMAND_HOLD_S:
            value = self._values[index]
        if index > _PASSED:
            self._forget(index)
        return value

    def restart(self, begin_ns: int, end_ns: int) -> None:
        """Poses stepped back from time ``end_ns`` to ``begin_ns``."""
        ahead = self._ahead
        self.clear()
        for entry in ahead:
            self._insert(*entry)
        if not ahead:
            self._end_ns = (begin_ns + end_ns) // 2

    def _forget(self, count):
        del self._stamps[:count], self._values[:count]


class CommandClock:
    """Offset of the clock of the commands behind the clock of the poses.

    Another clock shows in the lags, the time of receipt minus the stamp. But so does a late
    callback: if a bag is played ten times as fast, 50 ms are half a second. A topic that is only
    late catches up: its newest message is then newer than the other topic's. So the clocks differ
    only if neither topic ever catches up with the other.

    Attributes
    ----------
    offset_ns : int
        0 if the clocks do not differ.
    """

    def __init__(self):
        self._pose = self._command = None
        self._command_is_last = False
        # Newest pose stamp minus newest command stamp, at each change from one kind to the other.
        self._ends_of_commands = deque(maxlen=_REMEMBERED)
        self._ends_of_poses = deque(maxlen=_REMEMBERED)
        self._lags = deque(maxlen=_REMEMBERED)
        self._changes = 0
        self.offset_ns = 0

    @property
    def compared(self) -> bool:
        """Whether the clocks have been compared."""
        return self._changes >= _COMPARED

    def add_pose(self, stamp_ns: int, lag_ns: int) -> None:
        """Take stamp and lag of a pose."""
        if self._command_is_last and self._pose is not None:
            (pose_ns, pose_lag), (command_ns, command_lag) = self._pose, self._command
            self._ends_of_commands.append(pose_ns - command_ns)
            self._lags.append(command_lag - pose_lag)
        self._pose, self._command_is_last = (stamp_ns, lag_ns), False

    def add_command(self, stamp_ns: int, lag_ns: int) -> None:
        """Take stamp and lag of a command."""
        if not self._command_is_last and self._ends_of_commands:
            self._ends_of_poses.append(self._pose[0] - self._command[0])
            self._changes += 1
            if self._changes % _COMPARED == 0:
                self._compare()
        self._command, self._command_is_last = (stamp_ns, lag_ns), True

    def _compare(self):
        offset = int(np.median(self._lags))
        # With equal clocks, the topic that just sent is the newer one: zero is between these two.
        one, other = np.median(self._ends_of_commands), np.median(self._ends_of_poses)
        constant = one * other > 0.0 and min(abs(one), abs(other)) > abs(one - other)
        other = constant and not -LATENCY_NS <= offset <= COMMAND_DELAY_NS
        self.offset_ns = offset if other else 0
