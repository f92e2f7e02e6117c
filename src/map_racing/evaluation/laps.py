"""Laps: from poses over time to lap times and lateral errors.

A lap runs from one forward crossing of the start line to the next. The line is the normal to the
raceline at ``start_s``; the moment of crossing is interpolated between the two samples around it.
Progress along the track is unwrapped, so a lap is complete only when the car has driven all the way
around: crossing the line back and forth restarts the clock of the lap.

The whole path is reported, stretch by stretch. A stretch counts (``valid``) if it is a complete
lap without a fault; otherwise ``reason`` says why not: *out-lap* (before the first crossing),
*in-lap* (after the last), *gap* (no new pose for too long), *jump* (the pose moved farther than a
car can), *shortcut* (the nearest point of the raceline did), *reverse* (driven backwards), *off
track*, *stood* and *stopped* (harder than brakes can).

Between samples the lateral deviation d is linear in time, and all means are over time, so they do
not depend on the spacing of the samples.
"""

from __future__ import annotations

import math
from array import array
from typing import NamedTuple

import numpy as np

from ..errors import ParameterError
from ..track.raceline import Raceline
from ..track.tracker import RacelineTracker
from ..validation import FARTHEST
from .lap_limits import NO_WALLS, LapLimits
from .results import Lap, LapTrace, RunResult, Summary
from .speed import REPEATED_M, speed_of
from .statistics import mean, mean_abs, mean_rate, percentile_abs, rms
from .stops import stops

__all__ = ["LapEvaluator", "check_options", "passage_times"]

_NAN = math.nan
# Shorter stretches [m], [s] are jitter of a car parked on the line.
_JITTER, _JITTER_TIME = 0.5, 1.0
_MOST_SECTORS = 1000
_WIDEST_CAR = 10.0
_FAULTS = {"gap": "s", "jump": "m", "shortcut": "m", "reverse": "m"}  # with their units
# In a tight bend the nearest point of the raceline may move this far [m] while the car hardly
# moves.
_SHORTCUT = 3.0
# A stretch ends after this many samples (83 minutes at 100 Hz): a car parked overnight during a
# lap, or a track that never closes, would fill the memory.
_MOST_SAMPLES = 500_000


class _Sample(NamedTuple):
    """A pose with its projection on the track, and the command in force."""

    t: float
    x: float
    y: float
    progress: float  # unwrapped distance from the start line [m]
    d: float
    v: float
    speed_command: float
    steering: float


def check_options(start_s: float, car_width: float, sectors: int) -> None:
    """Refuse options of `LapEvaluator` that are impossible on any raceline.

    Raises
    ------
    ParameterError
    """
    if not math.isfinite(start_s):
        raise ParameterError(f"start line: expected a finite arc length [m], got {start_s}")
    if not 0.0 <= car_width <= _WIDEST_CAR:
        raise ParameterError(f"car width: expected 0 to {_WIDEST_CAR:g} m, got {car_width}")
    if not 1 <= sectors <= _MOST_SECTORS:
        raise ParameterError(f"sectors: expected 1 to {_MOST_SECTORS}, got {sectors}")


class LapEvaluator:
    """Laps of a car on a raceline, from samples added one by one or in batches.

    The results do not depend on the batches, to the last bit. Samples are kept only until their lap
    ends, and no lap has more than 500,000.

    Parameters
    ----------
    raceline : Raceline
    start_s : float, optional
        Arc length of the start line [m], at most that of the lap.
    car_width : float, optional
        Width of the car [m].
    sectors : int, optional
        Number of sectors, up to 1000.
    limits : LapLimits, optional
    keep_traces : bool, optional
        Keep the samples of each lap in `Lap.trace`, for plots.

    Raises
    ------
    ParameterError
        If a parameter is impossible.

    Notes
    -----
    A sample takes 5 us. On a track of 30 m with bends down to 0.7 m radius, sampled at 40 Hz at
    7 m/s while the car swings 0.35 m to either side, lap times are exact to 0.2 ms, RMS errors to
    0.2 mm and maxima to 1.1 mm for waypoints up to 1 m apart. If that is coarse for a bend, the
    position of the waypoints matters: on an ellipse of semi-axes 12 m and 2.9 m, whose ends have a
    radius of 0.7 m, points 1 m apart define the curve to 9 mm if one of them is at the apex and to
    49 mm if the apex is halfway between two (0.5 m apart: 5 mm). A lap exactly on the ellipse then
    has an RMS error of 2 to 8 mm (0.5 mm) instead of 0; one that swings 0.1 m to either side is off
    by 0.4 mm (0.02 mm).
    """

    def __init__(
        self,
        raceline: Raceline,
        *,
        start_s: float = 0.0,
        car_width: float = 0.3,
        sectors: int = 3,
        limits: LapLimits | None = None,
        keep_traces: bool = False,
    ):
        check_options(start_s, car_width, sectors)
        self.raceline, self.limits = raceline, (limits or LapLimits()).on(raceline)
        if abs(start_s) > raceline.length + 0.01:  # messages print two decimals
            raise ParameterError(
                f"start line: expected an arc length of at most {raceline.length:.2f} m, the lap, "
                f"got {start_s:g}"
            )
        self._start_s = start_s % raceline.length
        self._car_width, self._sectors = float(car_width), int(sectors)
        self._keep_traces = keep_traces
        self._tracker = RacelineTracker(raceline)
        self._restart()

    def update(self, t, x, y, v=None, speed_command=None, steering=None) -> list[Lap]:
        """Add samples.

        Samples without a finite time or with an absurd position are skipped, and so are samples
        that are not later than the last one; a step back by more than ``max_gap`` (a clock was set,
        a bag is replayed) ends the stretch and begins a new out-lap.

        Parameters
        ----------
        t : float or array_like
            Time [s].
        x, y : float or array_like
            Position [m].
        v : float or array_like, optional
            Speed [m/s].
        speed_command, steering : float or array_like, optional
            Command in force: speed [m/s] and steering angle [rad].

        Returns
        -------
        list of Lap
            The laps and other stretches that ended.
        """
        ended = len(self._laps)
        columns = [_NAN if c is None else c for c in (t, x, y, v, speed_command, steering)]
        columns = [np.asarray(column, dtype=float).ravel() for column in columns]
        with np.errstate(invalid="ignore"):
            columns[1:] = [np.where(np.abs(c) < FARTHEST, c, _NAN) for c in columns[1:]]
        columns = np.broadcast_arrays(*columns)
        for row in zip(*(column.tolist() for column in columns)):
            self._add(*row)
        return self._laps[ended:]

    def finish(self) -> RunResult:
        """End the run; the next sample begins another.

        Returns
        -------
        RunResult
            The unfinished stretch is its in-lap.
        """
        self._close_open("in-lap")
        laps = self._laps
        self._restart()
        return RunResult(laps, Summary.of(laps), self.raceline, self._start_s)

    # -- sample by sample ------------------------------------------------------------------------

    def _restart(self):
        self._laps = []
        self._number = 0
        self._last, self._changed, self._crossed = None, 0.0, 0
        self._begin(None)

    def _begin(self, line):
        """Begin a stretch at crossing number ``line``; None for an out-lap."""
        self._line = line
        self._samples = array("d")
        self._faults = {}
        self._farthest = -math.inf

    def _add(self, t, x, y, v, speed_command, steering):
        if not math.isfinite(t + x + y):
            return
        last, length = self._last, self.raceline.length
        if last is not None and t <= last[0]:
            if t > last[0] - self.limits.max_gap:
                return
            self._close_open("clock set back")
            self._begin(None)
            last = None
        if last is None:
            self._tracker.reset()
            self._changed = t
            place = self._tracker.update(x, y)
            progress, d = (place.s - self._start_s) % length, place.d
        else:
            _, x_0, y_0, progress_0, d_0 = last[:5]
            if abs(x - x_0) <= REPEATED_M and abs(y - y_0) <= REPEATED_M:
                x, y, progress, d = x_0, y_0, progress_0, d_0
            else:
                place = self._tracker.update(x, y)
                d, step = place.d, (place.s - self._start_s) % length - progress_0 % length
                if not -0.4 * length < step < 0.4 * length:
                    step -= length * round(step / length)
                progress = progress_0 + step
        # A _Sample takes five times as long.
        sample = t, x, y, progress, d, v, speed_command, steering
        crossed = math.floor(progress / length)
        if last is not None:
            self._step(last, sample, crossed)
        self._crossed = crossed
        self._last = sample
        self._samples.extend(sample)
        if progress > self._farthest:
            self._farthest = progress
        elif self._farthest - progress > self.limits.max_reverse:
            back = self._farthest - progress
            self._faults["reverse"] = max(back, self._faults.get("reverse", 0.0))
        if len(self._samples) >= _MOST_SAMPLES * len(_Sample._fields):
            self._close_open(f"cut after {_MOST_SAMPLES} samples")
            self._begin(None)
            self._samples.extend(sample)
            self._farthest = progress

    def _step(self, last, sample, crossed):
        """Faults of the step from one sample to the next, and whether it crosses the line."""
        t, limits, changed, faults = sample[0], self.limits, self._changed, {}
        moved = math.hypot(sample[1] - last[1], sample[2] - last[2])
        if moved > 0.0:
            self._changed = t
        if t - changed > limits.max_gap or moved > limits.jump_margin or self._tracker.reacquired:
            last, sample = _Sample._make(last), _Sample._make(sample)
            faults = self._step_faults(last, sample, moved, t - changed)
            self._faults.update(faults)
        if crossed > self._crossed:
            last, sample = _Sample._make(last), _Sample._make(sample)
            # A localization slower than its messages repeats its pose while the car drives on.
            if changed < last.t and not limits.is_gap(t - changed):
                last = last._replace(t=changed)
            self._cross(crossed, last, sample, faults)

    def _step_faults(self, last, sample, moved, since):
        """Faults by kind of a step from one sample to the next that moved the pose [m].

        A localization that is slower than its messages, or hangs, repeats its pose while the car
        drives on: `since` is the time since the pose changed [s].
        """
        limits, faults, gap = self.limits, {}, sample.t - last.t
        if moved > limits.jump_margin:
            gap = since
        if limits.is_gap(gap):
            faults["gap"] = max(gap, self._faults.get("gap", 0.0))
        fastest = 1.5 * min(last.v, sample.v)
        if not fastest > limits.max_speed:  # also if no speed is measured (NaN)
            fastest = limits.max_speed
        if moved > fastest * since + limits.jump_margin:
            faults["jump"] = max(moved, self._faults.get("jump", 0.0))
        elif self._tracker.reacquired and not limits.is_gap(gap):
            along = abs(sample.progress - last.progress)
            if along > 3.0 * moved + _SHORTCUT:
                faults["shortcut"] = max(along, self._faults.get("shortcut", 0.0))
        return faults

    def _cross(self, line, last, sample, faults):
        """The path from ``last`` to ``sample`` crosses the start line forwards."""
        at = line * self.raceline.length
        part = (at - last.progress) / (sample.progress - last.progress)
        crossing = _Sample._make(a + (b - a) * part for a, b in zip(last, sample))
        crossing = crossing._replace(progress=at)
        while len(self._samples) and self._samples[-len(_Sample._fields)] >= crossing.t:
            del self._samples[-len(_Sample._fields) :]
        self._samples.extend(crossing)
        if self._line is None:
            self._close("out-lap", complete=False)
        elif line > self._line:
            self._close("", complete=True)
        elif (
            self._farthest - self._line * self.raceline.length > _JITTER
            or crossing.t - self._samples[0] > _JITTER_TIME
        ):
            self._close("not completed", complete=False)
        self._begin(line)
        self._faults.update(faults)
        self._samples.extend(crossing)
        self._farthest = at

    # -- stretch by stretch ----------------------------------------------------------------------

    def _close_open(self, reason):
        if self._line is None:
            reason = "out-lap" if reason == "in-lap" else f"out-lap; {reason}"
        if len(self._samples) > len(_Sample._fields):
            self._close(reason, complete=False)

    def _close(self, reason, complete):
        rows = np.frombuffer(self._samples, dtype=float).reshape(-1, len(_Sample._fields))
        # A sample exactly on the line is the crossing.
        rows = rows[np.append(True, np.diff(rows[:, 0]) > 0)]
        if len(rows) < 2:
            return
        self._laps.append(self._lap(rows.copy(), reason, complete))
        self._number += 1

    def _lap(self, rows, reason, complete):
        t, x, y, progress, d, v, command, steering = np.ascontiguousarray(rows.T)
        dt = np.diff(t)
        begin = progress[0] if self._line is None else self._line * self.raceline.length
        planned, left, right = self.raceline.speed_and_walls(progress + self._start_s)
        v, reference = speed_of(t, x, y, v), command
        source = "command"
        if np.isnan(command).all():
            reference, source = planned, "raceline" if planned is not None else ""
        speed_error = v - reference if source else np.full(v.size, _NAN)
        magnitude = np.abs(d)
        clearance = _NAN
        if left is not None:
            clearance = float(np.min(np.minimum(left - d, right + d)))
        reasons = self._reasons(reason, clearance, magnitude.max())
        if complete:
            for stop, at in stops(t, x, y, progress, self.limits):
                s = (float(np.interp(at, t, progress)) + self._start_s) % self.raceline.length
                reasons.append(f"{stop} at s = {s:.1f} m")
        duration = float(t[-1] - t[0])
        trace = LapTrace(t, x, y, progress - begin, d, v, command) if self._keep_traces else None
        return Lap(
            lap=self._number,
            lap_time_s=duration if complete else _NAN,
            rms_lateral_error_m=rms(d, dt),
            mean_abs_lateral_error_m=mean_abs(d, dt),
            max_abs_lateral_error_m=float(magnitude.max()),
            valid=complete and not reasons,
            reason="; ".join(reasons),
            mean_lateral_error_m=mean(d, dt),
            p95_abs_lateral_error_m=percentile_abs(d, dt, 0.95),
            min_clearance_m=clearance - 0.5 * self._car_width,
            mean_speed_mps=mean(v, dt),
            max_speed_mps=float(v.max()),
            rms_speed_error_mps=rms(speed_error, dt),
            speed_reference=source,
            mean_steering_rate_radps=mean_rate(steering, dt),
            start_time_s=float(t[0]),
            end_time_s=float(t[-1]),
            sector_times_s=self._sector_times(t, progress - begin, complete),
            trace=trace,
        )

    def _reasons(self, reason, clearance, largest):
        """Why a stretch does not count: ``reason``, faults of its steps, off track."""
        reasons = [reason] if reason else []
        for kind, unit in _FAULTS.items():
            if kind in self._faults:
                reasons.append(f"{kind} of {self._faults[kind]:.2f} {unit}")
        if self.limits.max_deviation is not None:
            outside = largest - self.limits.max_deviation
        else:
            outside = largest - NO_WALLS if math.isnan(clearance) else -clearance
        if outside > 0.0:
            reasons.append(f"off track by {outside:.2f} m")
        return reasons

    def _sector_times(self, t, s, complete):
        """Times between the first crossings of the sectors' ends."""
        if not complete:
            return (_NAN,) * self._sectors
        ends = self.raceline.length * np.arange(1, self._sectors) / self._sectors
        passages = passage_times(t, s, ends)
        return tuple(np.diff(np.concatenate((t[:1], passages, t[-1:]))).tolist())


def passage_times(t: np.ndarray, s: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Times at which a lap first passes places.

    Parameters
    ----------
    t, s : ndarray, shape (n,)
        Times [s] and distances driven [m] of the lap.
    places : ndarray, shape (k,)
        Distances [m], increasing.

    Returns
    -------
    ndarray, shape (k,)
        [s]
    """
    return np.interp(places, np.maximum.accumulate(s), t)
