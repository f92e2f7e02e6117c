"""Laps while the car drives, from poses and commands as they arrive.

Live, a pose arrives before the command in force at its time, and perhaps before the raceline. Poses
wait for both, so that the laps are the same as from a recording, whatever the order and speed in
which the messages arrive.
"""

from __future__ import annotations

import csv
import io
import math
import os
from bisect import bisect_right
from collections import deque
from dataclasses import fields, replace
from pathlib import Path
from typing import Callable, NamedTuple, Sequence

import numpy as np

from ..bags.clocks import COMMAND_DELAY_NS, LATENCY_NS
from ..bags.samples import COMMAND_HOLD_S
from ..errors import FileFormatError, MapRacingError, ParameterError
from ..track.findings import raceline_warnings
from ..track.raceline import Raceline
from ..validation import FARTHEST
from .doubts import uncommanded
from .laps import LapEvaluator, LapLimits, check_options
from .recordings import same_raceline
from .report import csv_cells
from .results import Lap, RunResult

__all__ = ["LapLog", "LiveEvaluation", "LiveLap"]

# Poses kept while there is no raceline: 30 minutes at 100 Hz.
_LONGEST_WAIT = 180000
# Changes between poses and commands after which their clocks are compared, and that are remembered.
_COMPARED, _REMEMBERED = 25, 500
# Past commands are deleted in groups of this size.
_PASSED = 4096


class LiveLap(NamedTuple):
    """A lap or other stretch that ended.

    ``run`` counts from 1, ``end_ns`` is the time stamp of the end [ns], ``lap`` a
    `map_racing.evaluation.results.Lap`, ``warnings`` what makes it doubtful, as far as it was known
    at its end.
    """

    run: int
    end_ns: int
    lap: Lap
    warnings: tuple = ()


class _Pose(NamedTuple):
    stamp_ns: int
    x: float
    y: float
    v: float
    received: float


class _Commands:
    """Commands in the order of their time stamps, of one run."""

    def __init__(self, gap_ns):
        self._gap_ns = gap_ns
        self.clear()

    def clear(self):
        self._stamps, self._values = [], []
        # Commands after a step back in time that the poses have not made yet.
        self._ahead = []
        # Later commands [ns] belong to the run that ended.
        self._end_ns = math.inf

    def add(self, stamp_ns, value):
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
            if len(self._stamps) > 2 * _LONGEST_WAIT:
                self._forget(_LONGEST_WAIT)

    @property
    def any(self):
        """Whether there are commands at all."""
        return bool(self._stamps)

    def beyond(self, stamp_ns):
        """Whether a later command has arrived."""
        return bool(self._stamps) and self._stamps[-1] > stamp_ns

    def at(self, stamp_ns):
        """Command in force; later calls must not ask for earlier times."""
        index = bisect_right(self._stamps, stamp_ns) - 1
        value = (math.nan, math.nan)
        if index >= 0 and (stamp_ns - self._stamps[index]) * 1e-9 <= COMMAND_HOLD_S:
            value = self._values[index]
        if index > _PASSED:
            self._forget(index)
        return value

    def restart(self, begin_ns, end_ns):
        """Poses stepped back from time ``end_ns`` to ``begin_ns``."""
        ahead = self._ahead
        self.clear()
        for entry in ahead:
            self._insert(*entry)
        if not ahead:
            self._end_ns = (begin_ns + end_ns) // 2

    def _forget(self, count):
        del self._stamps[:count], self._values[:count]


class _CommandClock:
    """How far the clock that stamps the commands is behind the clock of the poses.

    Another clock shows in the lags, the time of receipt minus the stamp. So does a callback that
    comes late: where a bag is played ten times as fast, 50 ms are half a second. But a late topic
    catches up, so that its newest message is then newer than the other topic's. Clocks differ only
    if neither topic ever catches up with the other.
    """

    def __init__(self):
        self._pose = self._command = None
        self._command_is_last = False
        # Stamp of the newest pose minus the newest command's, where one kind follows the other.
        self._ends_of_commands = deque(maxlen=_REMEMBERED)
        self._ends_of_poses = deque(maxlen=_REMEMBERED)
        self._lags = deque(maxlen=_REMEMBERED)
        self._changes = 0
        self.offset_ns = 0

    @property
    def compared(self):
        """Whether the clocks have been compared."""
        return self._changes >= _COMPARED

    def add_pose(self, stamp_ns, lag_ns):
        if self._command_is_last and self._pose is not None:
            (pose_ns, pose_lag), (command_ns, command_lag) = self._pose, self._command
            self._ends_of_commands.append(pose_ns - command_ns)
            self._lags.append(command_lag - pose_lag)
        self._pose, self._command_is_last = (stamp_ns, lag_ns), False

    def add_command(self, stamp_ns, lag_ns):
        if not self._command_is_last and self._ends_of_commands:
            self._ends_of_poses.append(self._pose[0] - self._command[0])
            self._changes += 1
            if self._changes % _COMPARED == 0:
                self._compare()
        self._command, self._command_is_last = (stamp_ns, lag_ns), True

    def _compare(self):
        offset = int(np.median(self._lags))
        # Of equal clocks, the topic that ended is the newer one: zero lies between these two.
        one, other = np.median(self._ends_of_commands), np.median(self._ends_of_poses)
        constant = one * other > 0.0 and min(abs(one), abs(other)) > abs(one - other)
        other = constant and not -LATENCY_NS <= offset <= COMMAND_DELAY_NS
        self.offset_ns = offset if other else 0


class LiveEvaluation:
    """Laps from messages as they arrive.

    A pose is evaluated when the raceline is known, the clocks of poses and commands are compared
    and a later command has arrived, so that none can be missing, or `patience` after its
    arrival. A step back in time by more than ``limits.max_gap`` (a bag is replayed, a simulation
    restarted) or another raceline ends the run and begins the next.

    Parameters
    ----------
    raceline : Raceline, optional
        Without it poses wait for `set_raceline`.
    patience : float, optional
        Longest wait for a command [s].
    on_lap : callable, optional
        Called with the `LiveLap` of each stretch that ended.
    on_run : callable, optional
        Called with the number and the `RunResult` of each run that ended.
    limits : LapLimits, optional
    start_s, car_width, sectors : optional
        See `LapEvaluator`.

    Raises
    ------
    ParameterError
        If a parameter is impossible.
    """

    def __init__(
        self,
        raceline: Raceline | None = None,
        *,
        patience: float = 1.0,
        on_lap: Callable[[LiveLap], object] | None = None,
        on_run: Callable[[int, RunResult], object] | None = None,
        limits: LapLimits | None = None,
        start_s: float = 0.0,
        car_width: float = 0.3,
        sectors: int = 3,
    ):
        if not patience >= 0.0:
            raise ParameterError(f"patience: expected at least 0 s, got {patience}")
        check_options(start_s, car_width, sectors)
        self._limits = limits or LapLimits()
        self._options = {
            "limits": self._limits,
            "start_s": start_s,
            "car_width": car_width,
            "sectors": sectors,
        }
        self._patience = patience
        self._on_lap = on_lap or (lambda lap: None)
        self._on_run = on_run or (lambda number, result: None)
        self._poses = deque(maxlen=_LONGEST_WAIT)
        self._raceline = self._evaluator = None
        self._run = 1
        self._t0_ns = self._last_ns = None
        self._gap_ns = int(round(self._limits.max_gap * 1e9))
        self._commands, self._clock = _Commands(self._gap_ns), _CommandClock()
        self._believed_ns, self._beliefs = [], []
        self._reported = 0
        # Doubts of the run by kind; times of the samples of the present lap, and their commands.
        self._doubts, self._driven = {}, ([], [])
        if raceline is not None:
            self.set_raceline(raceline)

    @property
    def raceline(self) -> Raceline | None:
        """The raceline, None while it is unknown."""
        return self._raceline

    @property
    def deadline(self) -> float | None:
        """Latest time of the next call of `advance`, on the clock of `received`, or None."""
        if self._evaluator is None or not self._poses:
            return None
        return self._poses[0].received + self._patience

    def set_raceline(self, raceline: Raceline) -> None:
        """Evaluate on this raceline from now on; an identical one changes nothing.

        Raises
        ------
        ParameterError
            If the start line is beyond its lap; then the raceline before stays.
        """
        if self._raceline is not None and same_raceline(self._raceline, raceline):
            return
        evaluator = LapEvaluator(raceline, **self._options)
        if self._raceline is not None:
            self.finish()
        self._evaluator, self._raceline = evaluator, raceline

    def doubt(self, text: str) -> None:
        """Say what makes the numbers of the present run doubtful; it stands beside its laps."""
        self._doubts[text] = text

    @property
    def command_offset_s(self) -> float:
        """How far the clock that stamps the commands is behind the poses' [s]; 0: the same."""
        return self._clock.offset_ns * 1e-9

    def add_pose(
        self,
        stamp_ns: int,
        x: float,
        y: float,
        v_x: float,
        v_y: float,
        received: float,
        lag_ns: int = 0,
    ) -> None:
        """Add a pose.

        Parameters
        ----------
        stamp_ns : int
            Time stamp [ns].
        x, y : float
            Position [m]; if it is not finite or not on earth, the pose is ignored.
        v_x, v_y : float
            Velocity in the body frame [m/s], NaN where unknown.
        received : float
            Time of arrival on any steady clock [s].
        lag_ns : int, optional
            Time of receipt minus stamp [ns].
        """
        self._clock.add_pose(stamp_ns, lag_ns)
        if abs(x) < FARTHEST and abs(y) < FARTHEST:
            # As for a recording; math.hypot differs in the last bit.
            v = float(np.hypot(v_x, 0.0 if math.isnan(v_y) else v_y))
            self._poses.append(_Pose(stamp_ns, x, y, v, received))

    def add_command(
        self, stamp_ns: int, speed: float, steering_angle: float, lag_ns: int = 0
    ) -> None:
        """Add a drive command: time stamp [ns], speed [m/s], steering angle [rad], lag as of poses.

        Where its lag is another than the poses' by more than latency, and that is no delay, another
        clock stamped it.
        """
        self._clock.add_command(stamp_ns, lag_ns)
        self._commands.add(stamp_ns, (speed, steering_angle))
        if self._last_ns is not None and self._clock.compared:
            late_ns = self._last_ns - stamp_ns - self._clock.offset_ns
            # A command that is older still begins another run.
            if 0 <= late_ns <= self._gap_ns:
                self._doubts["late"] = (
                    f"drive commands came more than {self._patience:g} s after their poses: "
                    "speed error and steering rate do without them"
                )

    def add_belief(self, stamp_ns: int, values: Sequence[float]) -> None:
        """Add what the controller believes: time stamp [ns] and `BELIEF_FIELDS`."""
        stamps = self._believed_ns
        if stamps and stamp_ns < stamps[-1] - self._gap_ns:
            del stamps[:], self._beliefs[:]
        if not stamps or stamp_ns > stamps[-1]:
            stamps.append(stamp_ns)
            self._beliefs.append(values)
        if len(stamps) > 2 * _LONGEST_WAIT:
            del stamps[:_LONGEST_WAIT], self._beliefs[:_LONGEST_WAIT]

    def advance(self, now: float) -> None:
        """Evaluate the poses that need not wait any longer.

        Parameters
        ----------
        now : float
            Time on the clock of `received` [s].
        """
        if self._evaluator is None:
            return
        batch, behind = [], self._clock.offset_ns
        while self._poses:
            pose = self._poses[0]
            if self._last_ns is not None and pose.stamp_ns < self._last_ns - self._gap_ns:
                self._evaluate(batch)
                batch = []
                last_ns = self._last_ns
                self._end_run()
                self._commands.restart(pose.stamp_ns - behind, last_ns - behind)
            waited = now - pose.received >= self._patience
            over = self._poses[-1].stamp_ns < pose.stamp_ns - self._gap_ns
            known = self._clock.compared and self._commands.beyond(pose.stamp_ns - behind)
            if not (waited or over or known):
                break
            self._poses.popleft()
            if self._t0_ns is None:
                self._t0_ns = pose.stamp_ns
            self._last_ns = pose.stamp_ns
            # The same arithmetic as for a recording.
            t = (pose.stamp_ns - self._t0_ns) * 1e-9
            batch.append((t, *pose[1:4], *self._commands.at(pose.stamp_ns - behind)))
        self._evaluate(batch)

    def finish(self) -> None:
        """Evaluate the waiting poses and end the run; the next pose begins another."""
        self.advance(math.inf)
        if self._t0_ns is not None:
            self._end_run()
            self._commands.clear()

    def _evaluate(self, batch):
        if batch:
            for values, column in zip(self._driven, (0, 4)):
                values.extend(sample[column] for sample in batch)
            self._report(self._evaluator.update(*zip(*batch)))

    def _warnings(self, laps):
        """What makes laps doubtful that ended."""
        offset = self.command_offset_s
        if offset:
            self._doubts["clock"] = (
                f"drive commands: the stamps are from another clock, {abs(offset):.3f} s "
                f"{'earlier' if offset > 0.0 else 'later'} than the poses': shifted"
            )
        t, command = map(np.array, self._driven)
        missing = uncommanded(t, command, laps) if self._commands.any else []
        return *raceline_warnings(self._raceline), *self._doubts.values(), *missing

    def _report(self, laps):
        times = [(stamp - self._t0_ns) * 1e-9 for stamp in self._believed_ns] if laps else []
        for lap in laps:
            end_ns = self._t0_ns + int(round(lap.end_time_s * 1e9))
            believed = lap.believed(times, self._beliefs)
            self._on_lap(LiveLap(self._run, end_ns, believed, self._warnings([lap])))
            passed = bisect_right(self._believed_ns, end_ns) - 1
            if passed > 0:
                del times[:passed], self._believed_ns[:passed], self._beliefs[:passed]
        if laps:
            over = bisect_right(self._driven[0], laps[-1].end_time_s) - 1
            for values in self._driven:
                del values[: max(over, 0)]
        self._reported += len(laps)

    def _end_run(self):
        result = self._evaluator.finish()
        self._report(result.laps[self._reported :])
        notes = tuple(f"warning: {doubt}" for doubt in self._warnings([]))
        self._on_run(self._run, replace(result, notes=notes))
        self._run += 1
        self._reported = 0
        self._doubts, self._driven = {}, ([], [])
        self._t0_ns = self._last_ns = None


class LapLog:
    """CSV file to which laps are appended, each safe on the disk before `add` returns.

    It has the columns of `map_racing.evaluation.report.write_csv`, ``warnings`` included, with the
    number of the run instead of the bag. An existing file is continued; a last line that was cut
    off by a power loss is removed.

    Parameters
    ----------
    path : str or pathlib.Path
    sectors : int
        Number of sectors of the laps.

    Raises
    ------
    FileFormatError
        If the file exists and has other columns.
    MapRacingError
        If it cannot be written.
    """

    def __init__(self, path: str | Path, sectors: int):
        self.path = Path(path)
        names = [field.name for field in fields(Lap)[:-2]]
        self._names = ["run", *names, *(f"sector_{i}_s" for i in range(1, sectors + 1))]
        self._names.append("warnings")
        header = ",".join(self._names)
        try:
            self._file = open(self.path, "a+b")  # noqa: SIM115 - it stays open for the next laps
            self._file.seek(0)
            content = self._file.read()
        except OSError as error:
            raise MapRacingError(f"{path}: cannot write: {error.strerror}") from None
        complete = content[: content.rfind(b"\n") + 1]
        if complete and complete.split(b"\n", 1)[0] != header.encode():
            self._file.close()
            raise FileFormatError(f"{path}: expected a new file or one that begins with {header}")
        if content and not complete and not header.encode().startswith(content):
            self._file.close()
            raise FileFormatError(f"{path}: expected a new file or one of laps")
        self._file.truncate(len(complete))
        if not complete:
            self._append(self._names)

    def add(self, live_lap: LiveLap) -> None:
        """Append a `LiveLap`."""
        row = {"run": live_lap.run, **live_lap.lap.row(), "warnings": "; ".join(live_lap.warnings)}
        self._append(csv_cells(row[name] for name in self._names))

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _append(self, cells):
        text = io.StringIO()
        csv.writer(text, lineterminator="\n").writerow(cells)
        try:
            # A single write, so that a killed process leaves no partial line.
            self._file.write(text.getvalue().encode())
            self._file.flush()
            os.fsync(self._file.fileno())
        except OSError as error:
            raise MapRacingError(f"{self.path}: cannot write: {error.strerror}") from None
