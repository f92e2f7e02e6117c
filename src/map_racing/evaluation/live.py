"""Laps while the car drives, from poses and commands as they arrive.

Live, a pose arrives before the command in force at its time, and perhaps before the raceline. Poses
wait for both, so the laps are the same as from a recording, in whatever order and at whatever speed
the messages arrive.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections import deque
from dataclasses import replace
from typing import Callable, NamedTuple, Sequence

import numpy as np

from ..errors import ParameterError
from ..track.findings import raceline_warnings
from ..track.raceline import Raceline
from ..validation import FARTHEST
from .doubts import uncommanded
from .lap_limits import LapLimits
from .laps import LapEvaluator, check_options
from .live_commands import LONGEST_WAIT, CommandClock, Commands
from .live_history import History
from .recordings import same_raceline
from .results import Lap, RunResult

__all__ = ["LiveEvaluation", "LiveLap"]


class LiveLap(NamedTuple):
    """A lap or other stretch that ended.

    ``run`` counts from 1, ``end_ns`` is the time stamp of the end [ns], ``lap`` a
    `map_racing.evaluation.results.Lap`, ``warnings`` the warnings known at its end.
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
    psi: float


class LiveEvaluation:
    """Laps from messages as they arrive.

    A pose is evaluated once the raceline is known, the clocks of poses and commands have been
    compared, and a later command has arrived (so none can be missing) or `patience` has passed. A
    step back in time by more than ``limits.max_gap`` (a bag is replayed, a simulation restarted) or
    another raceline ends the run and begins the next. The last poses of a run wait until the
    commands step back, too, or `patience` has passed.

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
    pose_topic, drive_topic : str, optional
        Names of poses and commands in warnings.

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
        pose_topic: str = "poses",
        drive_topic: str = "drive commands",
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
        self._poses = deque(maxlen=LONGEST_WAIT)
        self._raceline = self._evaluator = None
        self._run = 1
        self._t0_ns = self._last_ns = self._given_up_ns = None
        self._gap_ns = int(round(self._limits.max_gap * 1e9))
        self._commands, self._clock = Commands(self._gap_ns), CommandClock()
        self._believed_ns, self._beliefs = [], []
        self._reported = 0
        self._drive_topic, self._history = drive_topic, History(pose_topic, drive_topic)
        # Warnings of the run by kind, and those derived from its driving; times and commands of the
        # samples of the current lap; times of its first and last samples whose commands came too
        # late.
        self._doubts, self._from_driving = {}, []
        self._driven, self._late = ([], []), []
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
            If the start line is beyond its lap; the previous raceline then stays.
        """
        if self._raceline is not None and same_raceline(self._raceline, raceline):
            return
        evaluator = LapEvaluator(raceline, **self._options)
        if self._raceline is not None:
            self.finish()
        self._evaluator, self._raceline = evaluator, raceline

    def doubt(self, text: str) -> None:
        """Add a warning about the current run, which accompanies its laps."""
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
        psi: float = math.nan,
    ) -> None:
        """Add a pose.

        Parameters
        ----------
        stamp_ns : int
            Time stamp [ns].
        x, y : float
            Position [m]; if it is not finite or absurdly large, the pose is ignored.
        v_x, v_y : float
            Velocity in the body frame [m/s], NaN where unknown.
        received : float
            Time of arrival on any steady clock [s].
        lag_ns : int, optional
            Time of receipt minus stamp [ns].
        psi : float, optional
            Heading [rad].
        """
        self._clock.add_pose(stamp_ns, lag_ns)
        if abs(x) < FARTHEST and abs(y) < FARTHEST:
            # As for a recording; math.hypot differs in the last bit.
            v = float(np.hypot(v_x, 0.0 if math.isnan(v_y) else v_y))
            self._poses.append(_Pose(stamp_ns, x, y, v, received, psi))

    def add_command(
        self, stamp_ns: int, speed: float, steering_angle: float, lag_ns: int = 0
    ) -> None:
        """Add a drive command: stamp [ns], speed [m/s], steering angle [rad], lag as for poses.

        If its lag differs from the poses' by more than latency, and not because of a delay, it was
        stamped by another clock.
        """
        self._clock.add_command(stamp_ns, lag_ns)
        self._commands.add(stamp_ns, (speed, steering_angle))
        self._history.add_command(stamp_ns, speed, steering_angle)
        if self._given_up_ns is not None and self._clock.compared:
            late_ns = self._given_up_ns - stamp_ns - self._clock.offset_ns
            # An even older command begins another run.
            if 0 <= late_ns <= self._gap_ns:
                at = 1e-9 * (self._given_up_ns - self._t0_ns)
                # Laps follow each other without gaps: the first and the last time are enough to
                # tell which laps have any.
                self._late = [min([*self._late, at]), max([*self._late, at])]

    def add_belief(self, stamp_ns: int, values: Sequence[float]) -> None:
        """Add estimates of the adaptive controller: time stamp [ns] and `BELIEF_FIELDS`."""
        stamps = self._believed_ns
        if stamps and stamp_ns < stamps[-1] - self._gap_ns:
            del stamps[:], self._beliefs[:]
        if not stamps or stamp_ns > stamps[-1]:
            stamps.append(stamp_ns)
            self._beliefs.append(values)
        if len(stamps) > 2 * LONGEST_WAIT:
            del stamps[:LONGEST_WAIT], self._beliefs[:LONGEST_WAIT]

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
            over = over and self._commands.complete
            known = self._clock.compared and self._commands.beyond(pose.stamp_ns - behind)
            if not (waited or over or known):
                break
            self._poses.popleft()
            if self._t0_ns is None:
                self._t0_ns = pose.stamp_ns
            self._last_ns = pose.stamp_ns
            if not (over or known):
                self._given_up_ns = pose.stamp_ns
            # The same arithmetic as for a recording.
            t = (pose.stamp_ns - self._t0_ns) * 1e-9
            batch.append((t, *pose[1:4], *self._commands.at(pose.stamp_ns - behind)))
            self._history.add_pose(t, pose.x, pose.y, pose.psi, pose.v)
        self._evaluate(batch)

    def finish(self) -> None:
        """Evaluate the waiting poses and end the run; the next pose begins another.

        Without a raceline they are forgotten.
        """
        self.advance(math.inf)
        self._poses.clear()
        if self._t0_ns is not None:
            self._end_run()
            self._commands.clear()

    def _evaluate(self, batch):
        if batch:
            for values, column in zip(self._driven, (0, 4)):
                values.extend(sample[column] for sample in batch)
            self._report(self._evaluator.update(*zip(*batch)))

    def _warnings(self, laps):
        """Warnings about laps that ended."""
        offset = self.command_offset_s
        if offset:
            self._doubts["clock"] = (
                f"{self._drive_topic}: the stamps are from another clock, {abs(offset):.3f} s "
                f"{'earlier' if offset > 0.0 else 'later'} than the poses': shifted"
            )
        t, command = map(np.array, self._driven)
        missing = uncommanded(t, command, laps) if self._commands.any else []
        if any(lap.start_time_s <= at <= lap.end_time_s for lap in laps for at in self._late):
            missing.append(
                f"drive commands came more than {self._patience:g} s after their poses: "
                "speed error and steering rate are computed without them"
            )
        doubts = (*self._doubts.values(), *self._from_driving)
        return *raceline_warnings(self._raceline), *dict.fromkeys(doubts), *missing

    def _report(self, laps):
        if any(not math.isnan(lap.lap_time_s) for lap in laps):
            self._warn_from_driving(laps)
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
            self._late = [at for at in self._late if at > laps[-1].end_time_s]
        self._reported += len(laps)

    def _warn_from_driving(self, laps):
        """Derive warnings from the driving so far."""
        self._history.add_laps(laps)
        self._from_driving = self._history.doubts(self._t0_ns - self._clock.offset_ns)

    def _end_run(self):
        result = self._evaluator.finish()
        self._warn_from_driving([])
        self._report(result.laps[self._reported :])
        notes = tuple(f"warning: {doubt}" for doubt in self._warnings([]))
        self._on_run(self._run, replace(result, notes=notes))
        self._run += 1
        self._reported = 0
        self._doubts, self._from_driving, self._driven, self._late = {}, [], ([], []), []
        self._history.clear()
        self._t0_ns = self._last_ns = self._given_up_ns = None
