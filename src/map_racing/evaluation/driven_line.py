"""Laps found in the path itself, without a raceline, and the closed line of one lap.

Teams drive a lap by hand to record waypoints. A lap begins where the path crosses a gate, a
straight line across it, and ends where it crosses it again in the same direction.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d

from ..bags.samples import Recording
from ..errors import EvaluationError, ParameterError
from ..track.files.table import RacelineTable
from ..vehicle.size import ONE_TENTH, Size
from .lap_limits import LapLimits
from .runs import evaluate

__all__ = ["DrivenLap", "driven_laps", "line_of_lap"]

# All distances are for 1:10 cars and grow with the car's size. Steps of the path [m], long enough
# to suppress the noise of a slow or parked car.
_STEP = 0.1
# Half the width of the gate that a lap crosses [m], and number of places where it is tried.
_HALF_GATE, _GATES = 1.0, 200
_SAME_COURSE = 0.7  # cosine of the angle to it
# Laps whose length differs from the usual one by more than this share took another way.
_USUAL_LENGTH = 0.15
_SHORTEST_LAP = 3.0  # [m]
# A lap ends beside its beginning; the gap is closed over this share of the lap to both sides.
_CLOSING = 0.25
# The gap is a mean over this time before and after [s].
_AROUND = 0.25
_GRID = 0.02  # [m]
# Noise lengthens the path from pose to pose. So distances are measured along the smooth line, which
# is then recomputed with them, this many times.
_PASSES = 4
_SPACING, _SMOOTHING = 0.1, 1.5  # [m]


class DrivenLap(NamedTuple):
    """A lap: number from 1, begin and end [s], and why it does not count (empty if it does)."""

    number: int
    begin: float
    end: float
    reason: str = ""


def driven_laps(recording: Recording, raceline=None, size: Size = ONE_TENTH) -> list[DrivenLap]:
    """Complete laps of a recording.

    Parameters
    ----------
    recording : Recording
    raceline : Raceline, optional
        Laps and numbers are the same as from `map_racing.evaluation.runs.evaluate` on it; without
        it, they are found from the path alone.
    size : Size, optional
        Of the car.

    Returns
    -------
    list of DrivenLap
        At least one.

    Raises
    ------
    EvaluationError
        If the path does not close.
    """
    if raceline is not None:
        laps = [
            DrivenLap(lap.lap, lap.start_time_s, lap.end_time_s, lap.reason)
            for lap in evaluate(recording, raceline).laps
            if math.isfinite(lap.lap_time_s)
        ]
        if not laps:
            raise EvaluationError(f"{recording.source}: no complete lap on {raceline.name}")
        return laps
    rows = _moving(recording.x, recording.y, size)
    t, xy = recording.t[rows], np.stack((recording.x[rows], recording.y[rows]), axis=1)
    passages = _best_passages(t, xy, size)
    if passages is None:
        raise EvaluationError(
            f"{recording.source}: no closed lap: no place is passed twice in the same direction "
            f"within {_HALF_GATE * size.length:.3g} m; drive on past the start of the lap"
        )
    times, lengths = passages
    usual = float(np.median(lengths))
    return [
        DrivenLap(number, begin, end, _fault(recording, begin, end, length / usual, size))
        for number, (begin, end, length) in enumerate(zip(times, times[1:], lengths), 1)
    ]


def _moving(x, y, size):
    """Indices of samples, each at least a step apart from the previous one."""
    rows, x0, y0 = [], math.inf, math.inf
    for row, (x1, y1) in enumerate(zip(x.tolist(), y.tolist())):
        if not math.hypot(x1 - x0, y1 - y0) < _STEP * size.length:
            rows.append(row)
            x0, y0 = x1, y1
    return np.array(rows, dtype=int)


def _best_passages(t, xy, size):
    """Crossing times and lap lengths for the gate with the most usual laps."""
    if len(xy) < 8:
        return None
    steps = np.diff(xy, axis=0)
    s = np.append(0.0, np.cumsum(np.hypot(steps[:, 0], steps[:, 1])))
    heading = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
    course = uniform_filter1d(heading, 11, mode="nearest")
    best = None
    for place in np.linspace(0.0, s[-1], _GATES, endpoint=False):
        row = min(int(np.searchsorted(s, place)), len(steps) - 1)
        around = slice(max(row - 5, 0), row + 6)
        times, at = _passages(t, s, xy, course, row, size)
        lengths = np.diff(at)
        if not lengths.size:
            continue
        usual = np.abs(lengths / np.median(lengths) - 1.0) < _USUAL_LENGTH
        score = (int(2 * usual.sum() - usual.size), -float(np.ptp(heading[around])))
        if best is None or score > best[0]:
            best = score, times.tolist(), lengths
    return None if best is None else best[1:]


def _passages(t, s, xy, course, row, size):
    """Times and distances at which the path crosses the gate at a row in its direction."""
    along, across = math.cos(course[row]), math.sin(course[row])
    half = _HALF_GATE * size.length
    dx, dy = (xy - xy[row]).T
    ahead, aside = dx * along + dy * across, dy * along - dx * across
    near = np.hypot(dx, dy) < 2.0 * half
    # Where the track crosses itself, the other branch passes the gate, too.
    same = np.cos(course - course[row]) > _SAME_COURSE
    rows = np.flatnonzero((ahead[:-1] < 0.0) & (ahead[1:] >= 0.0) & near[:-1] & near[1:] & same)
    share = ahead[rows] / (ahead[rows] - ahead[rows + 1])
    inside = np.abs(aside[rows] + share * (aside[rows + 1] - aside[rows])) < half
    rows, share = rows[inside], share[inside]
    at = s[rows] + share * (s[rows + 1] - s[rows])
    kept = [i for i in range(at.size) if i == 0 or at[i] - at[i - 1] > _SHORTEST_LAP * size.length]
    rows, share, at = rows[kept], share[kept], at[kept]
    return t[rows] + share * (t[rows + 1] - t[rows]), at


def _fault(recording, begin, end, relative_length, size):
    """Why a lap cannot serve as a raceline; empty if it can."""
    limits = LapLimits()
    inside = (recording.t >= begin) & (recording.t <= end)
    t = np.concatenate(([begin], recording.t[inside], [end]))
    faults = []
    if limits.is_gap(np.max(np.diff(t))):
        faults.append("gap")
    step = np.hypot(np.diff(recording.x[inside]), np.diff(recording.y[inside]))
    fastest, margin = limits.max_speed * size.time, limits.jump_margin * size.length
    most = fastest * np.diff(recording.t[inside]) + margin
    if np.any(step > most):
        faults.append("jump")
    if abs(relative_length - 1.0) > _USUAL_LENGTH:
        faults.append("another way")
    return ", ".join(faults)


def line_of_lap(
    recording: Recording,
    lap: DrivenLap,
    spacing: float | None = None,
    smoothing: float | None = None,
    size: Size = ONE_TENTH,
) -> RacelineTable:
    """The closed line of a lap, with the speeds driven.

    The gap between end and beginning is closed over a quarter of the lap on both sides. Anything
    shorter than a wavelength along the path counts as noise.

    Parameters
    ----------
    recording : Recording
    lap : DrivenLap
    spacing : float, optional
        Distance between the points [m], rounded so that they divide the lap evenly; 0.1 m for a
        1:10 car.
    smoothing : float, optional
        Wavelength [m] that keeps half its amplitude; longer ones keep more: 99.98 % at 4 times this
        wavelength. 1.5 m for a 1:10 car.
    size : Size, optional
        Of the car.

    Returns
    -------
    RacelineTable
        Columns ``x y speed``.

    Raises
    ------
    ParameterError
        If a distance is impossible.
    EvaluationError
        If the lap has too few samples.
    """
    spacing = _SPACING * size.length if spacing is None else spacing
    smoothing = _SMOOTHING * size.length if smoothing is None else smoothing
    for key, value, most in (("spacing", spacing, 10.0), ("smoothing", smoothing, 100.0)):
        if not 0.001 <= value <= most:
            raise ParameterError(f"{key}: expected 0.001 to {most:g} m, got {value:g}")
    inside = (recording.t > lap.begin) & (recording.t < lap.end)
    t = np.concatenate(([lap.begin], recording.t[inside], [lap.end]))
    x, y = (np.interp(t, recording.t, column) for column in (recording.x, recording.y))
    rows = _moving(x, y, size)
    rows = rows[rows < t.size - 1]
    if rows.size < 8:
        raise EvaluationError(f"{recording.source}: lap {lap.number} has too few poses for a line")
    rows = np.append(rows, t.size - 1)
    z = x[rows] + 1j * y[rows]
    s = np.append(0.0, np.cumsum(np.abs(np.diff(z))))
    gap = _gap(recording, lap, size)
    for _ in range(_PASSES):
        grid, line = _smooth_line(s, z, gap, smoothing, _GRID * size.length)
        path = np.append(0.0, np.cumsum(np.abs(np.diff(np.append(line, line[0])))))
        s, before = np.interp(s, grid, path), s
    times = np.interp(grid, before, t[rows])
    speed = _measured_speed(recording, times[:-1])
    if speed is None:
        speed = np.diff(path) / _smoothed(np.diff(times), grid[-1], smoothing).real
    speed = np.maximum(_smoothed(speed, grid[-1], smoothing).real, 0.1)
    points = max(8, int(round(path[-1] / spacing)))
    at = np.arange(points) * (path[-1] / points)
    columns = {
        "x": np.interp(at, path, np.append(line, line[0]).real),
        "y": np.interp(at, path, np.append(line, line[0]).imag),
        "speed": np.interp(at, path, np.append(speed, speed[0])),
    }
    what = f"lap {lap.number} of {recording.topic}"
    return RacelineTable(columns, source=f"{recording.source}: {what}", layout=what)


def _gap(recording, lap, size):
    """Vector from the beginning of a lap to its end, as a mean of the poses around both."""
    around = np.linspace(-1.0, 1.0, 41) * _AROUND * size.time
    known = (lap.begin + around >= recording.t[0]) & (lap.end + around <= recording.t[-1])
    x, y = (
        np.interp(lap.end + around[known], recording.t, column)
        - np.interp(lap.begin + around[known], recording.t, column)
        for column in (recording.x, recording.y)
    )
    return complex(np.mean(x), np.mean(y))


def _smooth_line(s, z, gap, wavelength, step):
    """Equal steps along a lap and its smooth line there, without the end point."""
    count = max(16, int(round(s[-1] / step)))
    grid = np.arange(count + 1) * (s[-1] / count)
    z = np.interp(grid, s, z.real) + 1j * np.interp(grid, s, z.imag)
    return grid, _smoothed(_closed(z, gap), s[-1], wavelength)


def _closed(values, gap):
    """Values over a lap without the last, with the gap between end and beginning closed."""
    n = values.size - 1
    place = np.arange(n) / n
    nearest = np.minimum(place, 1.0 - place)
    share = np.where(nearest < _CLOSING, 0.5 + 0.5 * np.cos(np.pi * nearest / _CLOSING), 0.0)
    return values[:-1] + np.where(place < 0.5, 0.5, -0.5) * gap * share


def _smoothed(values, length, wavelength):
    """Values over a closed lap, low-passed at a wavelength without phase shift."""
    waves = np.fft.fftfreq(values.size, length / values.size)
    return np.fft.ifft(np.fft.fft(values) / (1.0 + (waves * wavelength) ** 6))


def _measured_speed(recording, t):
    """Speed at given times; None if it was not measured throughout."""
    v = recording.speed
    return np.interp(t, recording.t, v) if np.isfinite(v).all() else None
