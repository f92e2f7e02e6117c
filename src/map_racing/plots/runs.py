"""Figures of evaluated runs: driven paths, laps over the distance, boxes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from ..errors import EvaluationError, ParameterError
from ..printing import amount
from .style import COLORS, DEVIATION, RACELINE, finished, legend_above, new_figure, size_for
from .track import draw_track

__all__ = ["plot_boxes", "plot_differences", "plot_laps", "plot_path"]


def plot_path(result, color_by: str = "speed", title: str | None = None) -> Figure:
    """Driven path over the raceline and its walls.

    Parameters
    ----------
    result : RunResult
        With traces.
    color_by : {"speed", "error"}, optional
        Color of the path: speed [m/s], or lateral deviation [m].
    title : str, optional

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    EvaluationError
        If the result has no traces.
    ParameterError
        If `color_by` is neither.
    """
    if color_by not in ("speed", "error"):
        raise ParameterError(f"color_by: expected speed or error, got {color_by!r}")
    traces = [lap.trace for lap in _traced(result)]
    line = result.raceline
    pieces = [np.stack((t.x[:-1], t.y[:-1], t.x[1:], t.y[1:]), axis=1) for t in traces]
    signals = [t.v if color_by == "speed" else t.d for t in traces]
    values = np.concatenate([0.5 * (signal[1:] + signal[:-1]) for signal in signals])
    if color_by == "speed":
        colors, label = "viridis", "speed [m/s]"
        low, high = float(values.min()), float(values.max())
    else:
        colors, label = DEVIATION, "lateral deviation, left positive [m]"
        # A single excursion would use up the color range.
        high = float(np.percentile(np.abs(values), 99.5))
        low = -high

    figure = new_figure(*size_for(line.x, line.y))
    axes = figure.add_subplot(1, 1, 1)
    draw_track(axes, line, result.start_s)
    path = LineCollection(
        np.concatenate(pieces).reshape(-1, 2, 2), cmap=colors, linewidths=2.2, zorder=3
    )
    path.set_array(values)
    path.set_clim(low, high if high > low else low + 1.0)
    axes.add_collection(path)
    axes.autoscale_view()
    legend_above(axes, title or _name(result))
    figure.colorbar(path, ax=axes, label=label, fraction=0.04, pad=0.03)
    return finished(figure)


def plot_laps(result, title: str | None = None) -> Figure:
    """Lateral deviation and speed of each lap over the distance from the start line.

    The speed is shown with the commanded speed of the best lap or, if no commands were recorded,
    the raceline's. Stretches that do not count are drawn only if no lap counts.

    Parameters
    ----------
    result, title
        As for `plot_path`.
    """
    laps = _traced(result)
    laps = [lap for lap in laps if lap.valid] or laps
    line = result.raceline
    figure = new_figure(9.5, 6.5)
    top = figure.add_subplot(2, 1, 1)
    bottom = figure.add_subplot(2, 1, 2, sharex=top)
    complete = [lap for lap in laps if not math.isnan(lap.lap_time_s)]
    best = min(complete, key=lambda lap: lap.lap_time_s) if complete else None
    label = "other laps" if best else "driven"
    for lap in laps:
        if lap is not best:
            # Many laps form a band; highlight the best one.
            style = {"color": COLORS[5], "lw": 0.9, "alpha": max(0.25, 1.0 / len(laps) ** 0.5)}
            _draw_lap(top, bottom, lap.trace, label=label, **style)
            label = None
    shown = best or laps[0]
    if best:
        label = f"best lap, {best.lap_time_s:.3f} s"
        _draw_lap(top, bottom, best.trace, label=label, color=COLORS[0], lw=1.5)
    reference = {"color": COLORS[1], "lw": 1.2, "ls": "--"}
    commanded = bool(np.isfinite(shown.trace.command).any())
    if commanded and result.commands_followed:
        bottom.plot(shown.trace.s, shown.trace.command, label="commanded in it", **reference)
    elif line.speed is not None:
        s = np.linspace(0.0, line.length, 2 * line.n)
        why = "the car does not follow the commands" if commanded else "no commands recorded"
        label = f"raceline, unscaled ({why})"
        bottom.plot(s, line.sample(s + result.start_s).speed, label=label, **reference)
    top.axhline(0.0, color=RACELINE, lw=0.8)
    top.set_ylabel("lateral deviation,\nleft positive [m]")
    bottom.set_ylabel("speed [m/s]")
    bottom.set_xlabel("distance from the start line [m]")
    bottom.set_xlim(0.0, line.length)
    for axes in (top, bottom):
        axes.grid(alpha=0.25)
    legend_above(top, title or f"{_name(result)}: {amount(len(laps), 'lap')}")
    legend_above(bottom)
    return finished(figure)


def _draw_lap(top, bottom, trace, **style):
    """Deviation and speed of a lap."""
    top.plot(trace.s, trace.d, **style)
    bottom.plot(trace.s, trace.v, **style)


def plot_boxes(named_results, title: str | None = None) -> Figure:
    """Lap times and RMS lateral errors of several runs, side by side.

    Boxes span the quartiles with a line at the median; each valid lap is a dot.

    Parameters
    ----------
    named_results : iterable of (str, RunResult)
    title : str, optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    named = list(named_results)
    figure = new_figure(min(4.0 + 1.6 * len(named), 14.0), 4.5)
    columns = (("lap_time_s", "lap time [s]"), ("rms_lateral_error_m", "RMS lateral error [m]"))
    for place, (column, label) in enumerate(columns, 1):
        axes = figure.add_subplot(1, 2, place)
        for position, (_, result) in enumerate(named, 1):
            values = np.array([getattr(lap, column) for lap in result.laps if lap.valid])
            color = COLORS[(position - 1) % len(COLORS)]
            if not values.size:
                axes.text(position, 0.5, "N.C.", ha="center", transform=axes.get_xaxis_transform())
                continue
            axes.boxplot(
                values,
                positions=[position],
                widths=0.5,
                showfliers=False,
                medianprops={"color": "k", "lw": 1.5},
                boxprops={"color": color, "lw": 1.5},
                whiskerprops={"color": color},
                capprops={"color": color},
            )
            # Spread sideways, so that equal laps do not hide each other.
            shift = np.linspace(-0.12, 0.12, values.size) if values.size > 1 else np.zeros(1)
            axes.plot(position + shift, values, "o", ms=4, color=color, alpha=0.7, zorder=3)
        axes.set_xlim(0.4, len(named) + 0.6)
        axes.set_xticks(range(1, len(named) + 1))
        axes.set_xticklabels([name for name, _ in named], rotation=20, ha="right")
        axes.set_ylabel(label)
        axes.grid(axis="y", alpha=0.25)
    if title:
        figure.suptitle(title)
    return finished(figure, top=0.94 if title else 1.0)


def plot_differences(named_results) -> Figure:
    """Runs over the distance: lateral deviation, difference of errors, difference of time.

    The upper plot has the mean deviation of each run and the band of its valid laps. The others
    compare each further run with the first: the RMS of the deviation of its laps at a place, and
    the time from the start line to there, on average over its laps. Above zero a run is worse;
    where the time difference rises, it is slower.

    Parameters
    ----------
    named_results : iterable of (str, RunResult)
        At least two, with traces, on the same raceline from the same start line.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    EvaluationError
        If there are fewer than two with valid laps, or their racelines or start lines differ.
    """
    named = [(name, result, _over_distance(result)) for name, result in named_results]
    named = [entry for entry in named if entry[2] is not None]
    if len(named) < 2:
        raise EvaluationError("expected at least two runs with valid laps to compare over distance")
    first_name, first, reference = named[0]
    for name, result, _ in named[1:]:
        if not _same_raceline(first, result):
            raise EvaluationError(f"{name}: expected the raceline and start line of {first_name}")
    figure = new_figure(10.0, 9.0)
    top, middle, bottom = (figure.add_subplot(3, 1, 1 + row) for row in range(3))
    s = reference.s
    for place, (name, _, run) in enumerate(named):
        color = COLORS[place % len(COLORS)]
        low, high = run.deviation.min(axis=0), run.deviation.max(axis=0)
        top.fill_between(s, low, high, color=color, alpha=0.2)
        rms = math.sqrt(float(np.mean(run.error**2)))
        laps = amount(len(run.deviation), "lap")
        label = f"{name}: {laps}, RMS over distance {rms:.3f} m"
        top.plot(s, run.deviation.mean(axis=0), color=color, lw=1.3, label=label)
        if not place:
            continue
        error, time = run.error - reference.error, run.time - reference.time
        middle.plot(s, error, color=color, lw=1.3, label=f"{name} − {first_name}")
        label = f"{name} − {first_name}: {time[-1]:+.3f} s per lap"
        bottom.plot(s, time, color=color, lw=1.3, label=label)
        if len(named) == 2:
            middle.fill_between(s, 0.0, error, color=color, alpha=0.2)
            bottom.fill_between(s, 0.0, time, color=color, alpha=0.2)
    for axes in (top, middle, bottom):
        axes.axhline(0.0, color=RACELINE, lw=0.8)
        axes.grid(alpha=0.25)
        axes.set_xlim(0.0, first.raceline.length)
    heading = "Deviation over the distance, differences of error and time"
    for axes, text in ((top, heading), (middle, ""), (bottom, "")):
        legend_above(axes, text, columns=2)
    top.set_ylabel("lateral deviation,\nleft positive [m]")
    middle.set_ylabel("difference of\nRMS error [m]")
    bottom.set_ylabel("cumulative difference\nof time [s]")
    bottom.set_xlabel("distance from the start line [m]")
    return finished(figure)


class _OverDistance(NamedTuple):
    """Distances [m], deviation of each valid lap there, its RMS, and mean time to there [s]."""

    s: np.ndarray
    deviation: np.ndarray
    error: np.ndarray
    time: np.ndarray


def _over_distance(result):
    """The valid laps of a run over distance; None without any."""
    laps = [lap.trace for lap in result.laps if lap.valid and lap.trace is not None]
    if not laps:
        return None
    s = np.linspace(0.0, result.raceline.length, 2 * result.raceline.n)
    driven = [np.maximum.accumulate(trace.s) for trace in laps]
    deviation = np.array([np.interp(s, at, trace.d) for at, trace in zip(driven, laps)])
    time = np.array([np.interp(s, at, trace.t - trace.t[0]) for at, trace in zip(driven, laps)])
    return _OverDistance(s, deviation, np.sqrt(np.mean(deviation**2, axis=0)), time.mean(axis=0))


def _same_raceline(a, b):
    """Whether two results have the same raceline, to a centimeter, from the same start line."""
    one, other = a.raceline, b.raceline
    if abs(one.length - other.length) > 0.01 or abs(a.start_s - b.start_s) > 1e-6:
        return False
    s = np.linspace(0.0, one.length, 200)
    (x1, y1), (x2, y2) = (line.to_cartesian(s, np.zeros_like(s)) for line in (one, other))
    return float(np.max(np.hypot(x1 - x2, y1 - y2))) < 0.01


def _traced(result):
    laps = [lap for lap in result.laps if lap.trace is not None]
    if not laps:
        raise EvaluationError(f"{_name(result)}: expected a result with traces to plot")
    return laps


def _name(result):
    return Path(result.source).name if result.source else "run"
