"""Laps: from poses over time to lap times and lateral errors.

A lap runs from one forward crossing of the start line to the next. The line is the normal to the
raceline at ``start_s``; the moment of crossing is interpolated between the two samples around it.
Progress along the track is unwrapped, so a lap is complete only when the car has come all the way
round: crossing the line back and forth is no lap, it starts the clock of the lap anew.

The whole path is reported, stretch by stretch. A stretch counts (``valid``) if it is a complete
lap without a fault; else ``reason`` says why not: *out-lap* (before the first crossing), *in-lap*
(after the last), *gap* (no sample for too long), *jump* (the pose moved farther than a car can),
*reverse* (driven backwards) and *off track*.

Between samples the lateral deviation d is taken as linear in time, and all means are over time, so
they do not depend on how the samples are spread.
"""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np

from ..errors import EvaluationError, ParameterError
from ..track.raceline import Raceline
from ..track.tracker import RacelineTracker
from ..validation import FARTHEST

__all__ = ["Lap", "LapEvaluator", "LapLimits", "LapTrace", "RunResult", "Summary", "evaluate"]

_NAN = math.nan
# A stretch that is shorter than this [m] and this [s] is a car that stands on the line and wobbles
# across it.
_WOBBLE = 0.5
_WOBBLE_TIME = 1.0
# Largest deviation [m] where neither walls nor a limit are known.
_NO_WALLS = 2.0
# So far beyond the walls [m] a car has not merely cut a corner or met walls drawn too tight.
_ELSEWHERE = 0.5
_MOST_SECTORS = 1000
_WIDEST_CAR = 10.0


@dataclass(frozen=True)
class LapLimits:
    """What a lap must keep to in order to count.

    Attributes
    ----------
    max_gap : float
        Longest time between two samples [s]. At 11 m/s a car drives 2.75 m in the default.
    max_speed : float
        Fastest that a pose may move [m/s]; beyond it, and `jump_margin`, it has jumped.
    jump_margin : float
        Correction of the localization that is not yet a jump [m].
    max_reverse : float
        Farthest that the car may fall back along the track [m].
    max_deviation : float, optional
        Largest lateral deviation [m]. By default the center of the car must stay between the walls
        or, where the raceline has none, within 2 m. Walls in a raceline file are often drawn
        tighter than the hall; this overrides them.
    """

    max_gap: float = 0.25
    max_speed: float = 20.0
    jump_margin: float = 0.3
    max_reverse: float = 0.5
    max_deviation: float | None = None


class LapTrace(NamedTuple):
    """Samples of a lap, with the interpolated crossings as first and last one, for plots.

    Time ``t`` [s] on the recording's clock, position ``x, y`` [m], distance from the start line
    ``s`` along the track [m], deviation ``d`` [m] left positive, speed ``v`` [m/s].
    """

    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    s: np.ndarray
    d: np.ndarray
    v: np.ndarray


@dataclass(frozen=True)
class Lap:
    """One lap, or a stretch that is none. Values that do not exist are NaN.

    Attributes
    ----------
    lap : int
        Number: 0 is the out-lap.
    lap_time_s : float
        NaN for a stretch from line to line that was not completed.
    rms_lateral_error_m, mean_abs_lateral_error_m, max_abs_lateral_error_m : float
        Of the deviation from the raceline.
    valid : bool
        Whether it counts.
    reason : str
        Why not.
    mean_lateral_error_m : float
        Signed, left positive.
    p95_abs_lateral_error_m : float
        Not exceeded during 95 % of the time.
    min_clearance_m : float
        Smallest distance from a side of the car to a wall, negative beyond it.
    mean_speed_mps, max_speed_mps : float
        Of the measured speed, or of the motion of the pose where none was measured.
    rms_speed_error_mps : float
        Speed less `speed_reference`.
    speed_reference : str
        ``"command"`` or, where there is no command, ``"raceline"``; empty without either.
    mean_steering_rate_radps : float
        Mean of the absolute rate of the commanded steering angle. Unlike its RMS it is the same
        whether a command is held over several samples or not.
    start_time_s, end_time_s : float
        On the recording's clock.
    sector_times_s : tuple of float
        Times of the sectors, of equal length from the start line.
    trace : LapTrace, optional
    """

    lap: int
    lap_time_s: float
    rms_lateral_error_m: float
    mean_abs_lateral_error_m: float
    max_abs_lateral_error_m: float
    valid: bool
    reason: str
    mean_lateral_error_m: float
    p95_abs_lateral_error_m: float
    min_clearance_m: float
    mean_speed_mps: float
    max_speed_mps: float
    rms_speed_error_mps: float
    speed_reference: str
    mean_steering_rate_radps: float
    start_time_s: float
    end_time_s: float
    sector_times_s: tuple = ()
    trace: LapTrace | None = None

    def row(self):
        """Columns of a table: names with units to values, sectors as ``sector_1_s`` and so on."""
        row = {field.name: getattr(self, field.name) for field in fields(self)[:-2]}
        row.update((f"sector_{i}_s", time) for i, time in enumerate(self.sector_times_s, 1))
        return row


@dataclass(frozen=True)
class Summary:
    """Statistics over the valid laps of a run: all NaN (N.C., not completed) if there is none.

    Standard deviations are those of a sample (n - 1), NaN for a single lap.
    """

    laps_completed: int
    laps_not_counted: int
    mean_lap_time_s: float
    std_lap_time_s: float
    best_lap_time_s: float
    mean_rms_lateral_error_m: float
    std_rms_lateral_error_m: float
    mean_abs_lateral_error_m: float
    max_abs_lateral_error_m: float
    min_clearance_m: float
    mean_speed_mps: float
    max_speed_mps: float

    @classmethod
    def of(cls, laps):
        """Summary of a list of `Lap`."""
        valid = [lap for lap in laps if lap.valid]

        def over(name, function):
            values = np.array([getattr(lap, name) for lap in valid])
            return float(function(values)) if values.size else _NAN

        def deviation(values):
            return np.std(values, ddof=1) if values.size > 1 else _NAN

        return cls(
            len(valid),
            len(laps) - len(valid),
            over("lap_time_s", np.mean),
            over("lap_time_s", deviation),
            over("lap_time_s", np.min),
            over("rms_lateral_error_m", np.mean),
            over("rms_lateral_error_m", deviation),
            over("mean_abs_lateral_error_m", np.mean),
            over("max_abs_lateral_error_m", np.max),
            over("min_clearance_m", np.min),
            over("mean_speed_mps", np.mean),
            over("max_speed_mps", np.max),
        )


@dataclass(frozen=True)
class RunResult:
    """A run on a raceline.

    Attributes
    ----------
    laps : list of Lap
        All stretches in order, valid or not.
    summary : Summary
    raceline : Raceline
    start_s : float
        Arc length of the start line [m].
    source : str
        File of the recording.
    notes : tuple of str
        Remarks for the reader.
    """

    laps: list
    summary: Summary
    raceline: Raceline
    start_s: float = 0.0
    source: str = ""
    notes: tuple = ()


def check_options(start_s, car_width, sectors):
    """Raise a ParameterError if an option of `LapEvaluator` is impossible on any raceline."""
    if not math.isfinite(start_s):
        raise ParameterError(f"start line: expected a finite arc length [m], got {start_s}")
    if not 0.0 <= car_width <= _WIDEST_CAR:
        raise ParameterError(f"car width: expected 0 to {_WIDEST_CAR:g} m, got {car_width}")
    if not 1 <= sectors <= _MOST_SECTORS:
        raise ParameterError(f"sectors: expected 1 to {_MOST_SECTORS}, got {sectors}")


class LapEvaluator:
    """Laps of a car on a raceline, from one sample at a time or from a million.

    However the samples are cut into calls, the laps are the same to the last bit. Samples are kept
    only until their lap ends.

    Parameters
    ----------
    raceline : Raceline
    start_s : float, optional
        Arc length of the start line [m].
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
    0.2 mm and maxima to 1.1 mm for waypoints up to 1 m apart. Where that is coarse for a bend
    it matters where the waypoints lie: on an ellipse of semi-axes 12 m and 2.9 m, whose ends have a
    radius of 0.7 m, points 1 m apart define the curve to 9 mm if one of them is at the apex and to
    49 mm if the apex is halfway between two (0.5 m apart: 5 mm). A lap exactly on the ellipse then
    has an RMS error of 2 to 8 mm (0.5 mm) instead of 0; one that swings 0.1 m to either side is off
    by 0.4 mm (0.02 mm).
    """

    def __init__(
        self, raceline, *, start_s=0.0, car_width=0.3, sectors=3, limits=None, keep_traces=False
    ):
        check_options(start_s, car_width, sectors)
        self.raceline, self.limits = raceline, limits or LapLimits()
        self._start_s = start_s % raceline.length
        self._car_width, self._sectors = float(car_width), int(sectors)
        self._keep_traces = keep_traces
        self._tracker = RacelineTracker(raceline)
        self._restart()

    def update(self, t, x, y, v=None, speed_command=None, steering=None):
        """Take up samples.

        Samples without a finite time or a position on earth are passed over, as are those that are
        not later than the last; a step back by more than ``max_gap`` (a clock that was set, a bag
        that is played again) ends the stretch and begins a new out-lap.

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
            Laps and other stretches that ended.
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

    def finish(self):
        """End the run. The next sample begins another.

        Returns
        -------
        RunResult
            With the stretch that was under way as in-lap.
        """
        self._close_open("in-lap")
        laps = self._laps
        self._restart()
        return RunResult(laps, Summary.of(laps), self.raceline, self._start_s)

    # -- sample by sample ------------------------------------------------------------------------

    def _restart(self):
        self._laps = []
        self._number = 0
        self._last = None
        self._begin(None)

    def _begin(self, line):
        """Begin a stretch at crossing number ``line``; None for an out-lap."""
        self._line = line
        self._rows = array("d")
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
        place = self._tracker.update(x, y)
        place_s = (place.s - self._start_s) % length
        if last is None:
            progress = place_s
            row = (t, x, y, progress, place.d, v, speed_command, steering)
        else:
            step = place_s - last[3] % length
            step -= length * round(step / length)
            progress = last[3] + step
            row = (t, x, y, progress, place.d, v, speed_command, steering)
            faults = self._step_faults(last, row)
            self._faults.update(faults)
            crossed = math.floor(progress / length)
            if crossed > math.floor(last[3] / length):
                self._cross(crossed, last, row, faults)
        self._last = row
        self._rows.extend(row)
        self._farthest = max(self._farthest, progress)
        if self._farthest - progress > self.limits.max_reverse:
            back = self._farthest - progress
            self._faults["reverse"] = max(back, self._faults.get("reverse", 0.0))

    def _step_faults(self, last, row):
        """What is wrong with the step from one sample to the next."""
        limits, faults = self.limits, {}
        gap = row[0] - last[0]
        if gap > limits.max_gap:
            faults["gap"] = max(gap, self._faults.get("gap", 0.0))
        moved = math.hypot(row[1] - last[1], row[2] - last[2])
        if moved > limits.max_speed * gap + limits.jump_margin or (
            self._tracker.reacquired and gap <= limits.max_gap
        ):
            faults["jump"] = max(moved, self._faults.get("jump", 0.0))
        return faults

    def _cross(self, line, last, row, faults):
        """The path from ``last`` to ``row`` crosses the start line forwards."""
        at = line * self.raceline.length
        part = (at - last[3]) / (row[3] - last[3])
        crossing = tuple(a + (b - a) * part for a, b in zip(last, row))
        crossing = crossing[:3] + (at,) + crossing[4:]
        self._rows.extend(crossing)
        if self._line is None:
            self._close("out-lap", complete=False)
        elif line > self._line:
            self._close("", complete=True)
        elif (
            self._farthest - self._line * self.raceline.length > _WOBBLE
            or crossing[0] - self._rows[0] > _WOBBLE_TIME
        ):
            self._close("not completed", complete=False)
        self._begin(line)
        self._faults.update(faults)
        self._rows.extend(crossing)
        self._farthest = at

    # -- stretch by stretch ----------------------------------------------------------------------

    def _close_open(self, reason):
        if self._line is None:
            reason = "out-lap" if reason == "in-lap" else f"out-lap; {reason}"
        if len(self._rows) > 8:
            self._close(reason, complete=False)

    def _close(self, reason, complete):
        rows = np.frombuffer(self._rows, dtype=float).reshape(-1, 8)
        # A sample on the line itself is its own crossing.
        rows = rows[np.append(True, np.diff(rows[:, 0]) > 0)]
        if len(rows) < 2:
            return
        self._laps.append(self._lap(rows.copy(), reason, complete))
        self._number += 1

    def _lap(self, rows, reason, complete):
        t, x, y, progress, d, v, command, steering = np.ascontiguousarray(rows.T)
        dt = np.diff(t)
        begin = progress[0] if self._line is None else self._line * self.raceline.length
        curve = self.raceline.sample(progress + self._start_s)
        v, reference = _speed(t, x, y, v), command
        source = "command"
        if np.isnan(command).all():
            reference, source = curve.speed, "raceline" if curve.speed is not None else ""
        speed_error = v - reference if source else np.full(v.size, _NAN)
        magnitude = np.abs(d)
        clearance, limit = _NAN, self.limits.max_deviation
        if curve.d_left is not None:
            clearance = float(np.min(np.minimum(curve.d_left - d, curve.d_right + d)))
        if limit is None and curve.d_left is not None:
            outside = -clearance
        else:
            outside = magnitude.max() - (_NO_WALLS if limit is None else limit)
        reasons = [reason] if reason else []
        reasons += [_describe(kind, self._faults[kind]) for kind in _KINDS if kind in self._faults]
        if outside > 0.0:
            reasons.append(f"off track by {outside:.2f} m")
        duration = float(t[-1] - t[0])
        return Lap(
            lap=self._number,
            lap_time_s=duration if complete else _NAN,
            rms_lateral_error_m=_rms(d, dt),
            mean_abs_lateral_error_m=_mean_abs(d, dt),
            max_abs_lateral_error_m=float(magnitude.max()),
            valid=complete and not reasons,
            reason="; ".join(reasons),
            mean_lateral_error_m=_mean(d, dt),
            p95_abs_lateral_error_m=_percentile_abs(d, dt, 0.95),
            min_clearance_m=clearance - 0.5 * self._car_width,
            mean_speed_mps=_mean(v, dt),
            max_speed_mps=float(v.max()),
            rms_speed_error_mps=_rms(speed_error, dt),
            speed_reference=source,
            mean_steering_rate_radps=_variation(steering, dt),
            start_time_s=float(t[0]),
            end_time_s=float(t[-1]),
            sector_times_s=self._sector_times(t, progress - begin, complete),
            trace=LapTrace(t, x, y, progress - begin, d, v) if self._keep_traces else None,
        )

    def _sector_times(self, t, s, complete):
        """Times between the first passages of the sectors' ends."""
        if not complete:
            return (_NAN,) * self._sectors
        ends = self.raceline.length * np.arange(1, self._sectors) / self._sectors
        passages = np.interp(ends, np.maximum.accumulate(s), t)
        return tuple(np.diff(np.concatenate((t[:1], passages, t[-1:]))).tolist())


def evaluate(recording, raceline, *, start_s=0.0, car_width=0.3, sectors=3, limits=None):
    """Laps of a recording.

    Parameters
    ----------
    recording : Recording
        Commands, where it has them, are held until the next one.
    raceline : Raceline
    start_s, car_width, sectors, limits
        See `LapEvaluator`.

    Returns
    -------
    RunResult
        With traces.

    Raises
    ------
    EvaluationError
        If the car drove elsewhere: more than half of the samples are farther off the track than
        walls are ever drawn too tight, or it drove without coming along the raceline.
    """
    evaluator = LapEvaluator(
        raceline,
        start_s=start_s,
        car_width=car_width,
        sectors=sectors,
        limits=limits,
        keep_traces=True,
    )
    speed_command = steering = None
    if recording.commands is not None:
        speed_command = _held(recording.t, recording.commands, recording.commands.speed)
        steering = _held(recording.t, recording.commands, recording.commands.steering_angle)
    # Lateral speed is often not measured; without it the longitudinal speed is the speed.
    v = np.hypot(recording.v_x, np.where(np.isnan(recording.v_y), 0.0, recording.v_y))
    evaluator.update(recording.t, recording.x, recording.y, v, speed_command, steering)
    result = evaluator.finish()
    name = raceline.name or raceline.source or "raceline"
    if not result.laps:
        raise EvaluationError(f"{recording.source}: expected at least two samples")
    s, d = (np.concatenate([lap.trace[i] for lap in result.laps]) for i in (3, 4))
    deviation = np.abs(d)
    allowed = limits.max_deviation if limits else None
    if allowed is None and raceline.d_left is not None:
        curve = raceline.sample(s + start_s)
        allowed = np.where(d > 0.0, curve.d_left, curve.d_right)
    elif allowed is None:
        allowed = _NO_WALLS
    beyond = float(np.median(deviation - allowed))
    progress = sum(float(lap.trace.s[-1] - lap.trace.s[0]) for lap in result.laps)
    driven = _driven(recording.x.tolist(), recording.y.tolist())
    if beyond > _ELSEWHERE:
        raise EvaluationError(
            f"{recording.source}: the car drove elsewhere: half of the time more than "
            f"{np.median(deviation):.1f} m off the raceline {name}"
        )
    followed = result.summary.laps_completed or abs(progress) > 0.5 * driven
    if driven > 0.5 * raceline.length and not followed:
        raise EvaluationError(
            f"{recording.source}: the car drove elsewhere: of {driven:.0f} m it came "
            f"{abs(progress):.0f} m along the raceline {name}"
        )
    notes = list(recording.notes)
    if progress < -0.5 * raceline.length:
        notes.append(f"the car drove against the direction of the raceline {name}")
    return replace(result, source=recording.source, notes=tuple(notes))


def _driven(x, y):
    """Distance driven [m], in steps that noise on a standing car does not make."""
    driven, x0, y0 = 0.0, x[0], y[0]
    for x1, y1 in zip(x, y):
        step = math.hypot(x1 - x0, y1 - y0)
        if step > _WOBBLE:
            driven, x0, y0 = driven + step, x1, y1
    return driven


# -- statistics ----------------------------------------------------------------------------------

_KINDS = ("gap", "jump", "reverse")


def _describe(kind, amount):
    unit = "s" if kind == "gap" else "m"
    return f"{kind} of {amount:.2f} {unit}"


def _speed(t, x, y, v):
    """Measured speed or, where some of it is missing, the speed of the pose."""
    if np.isfinite(v).all():
        return v
    moving = np.hypot(np.diff(x), np.diff(y)) / np.diff(t)
    return 0.5 * (np.append(moving[:1], moving) + np.append(moving, moving[-1:]))


def _mean(values, dt):
    """Mean over time of a piecewise linear signal."""
    return float(np.sum(0.5 * (values[1:] + values[:-1]) * dt) / np.sum(dt))


def _rms(values, dt):
    """Root mean square over time of a piecewise linear signal, over its finite pieces."""
    a, b = values[:-1], values[1:]
    squares = (a * a + a * b + b * b) / 3.0
    known = np.isfinite(squares)
    total = np.sum(dt[known])
    return math.sqrt(np.sum(squares[known] * dt[known]) / total) if total > 0.0 else _NAN


def _mean_abs(values, dt):
    """Mean over time of the magnitude of a piecewise linear signal."""
    a, b = np.abs(values[:-1]), np.abs(values[1:])
    crossing = values[:-1] * values[1:] < 0.0
    sums = np.where(crossing, a + b, 1.0)
    pieces = np.where(crossing, (a * a + b * b) / (2.0 * sums), 0.5 * (a + b))
    return float(np.sum(pieces * dt) / np.sum(dt))


def _percentile_abs(values, dt, fraction):
    """Magnitude of a piecewise linear signal that it does not exceed for a fraction of the time."""
    a, b = np.abs(values[:-1]), np.abs(values[1:])
    # A piece that changes sign falls to 0 and rises again: two pieces.
    split = values[:-1] * values[1:] < 0.0
    part = a[split] / (a[split] + b[split])
    low = np.concatenate((np.where(split, 0.0, np.minimum(a, b)), np.zeros(part.size)))
    high = np.concatenate((np.where(split, a, np.maximum(a, b)), b[split]))
    time = np.concatenate((dt, dt[split] * (1.0 - part)))
    time[: dt.size][split] *= part
    # Each piece spends its time evenly between its ends, so the time spent below a magnitude is
    # piecewise linear in it: its slope changes at the ends.
    high = np.maximum(high, low + 1e-9)
    density = time / (high - low)
    edges = np.concatenate((low, high))
    order = np.argsort(edges, kind="mergesort")
    edges = edges[order]
    slope = np.cumsum(np.concatenate((density, -density))[order])[:-1]
    below = np.append(0.0, np.cumsum(slope * np.diff(edges)))
    return float(np.interp(fraction * np.sum(dt), below, edges))


def _variation(values, dt):
    """Mean over time of the absolute rate of a signal, over its finite pieces."""
    steps = np.abs(np.diff(values))
    known = np.isfinite(steps)
    total = np.sum(dt[known])
    return float(np.sum(steps[known]) / total) if total > 0.0 else _NAN


def _held(t, commands, values):
    """Command in force at each time; NaN before the first."""
    # Index -1, before the first, is the NaN behind the last.
    return np.append(values, _NAN)[np.searchsorted(commands.t, t, side="right") - 1]
