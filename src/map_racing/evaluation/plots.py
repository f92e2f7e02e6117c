"""Figures of runs and lookup tables.

Every function returns a `matplotlib.figure.Figure` that belongs to no window and no global state;
`save` writes it. The colors can be told apart with any color vision (Okabe-Ito, viridis).
"""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib import cm
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize
from matplotlib.figure import Figure

# matplotlib 3.1 knows the projection "3d" only after this import.
from mpl_toolkits.mplot3d import Axes3D  # noqa: F401

from ..errors import EvaluationError, MapRacingError, ParameterError

__all__ = [
    "plot_boxes",
    "plot_laps",
    "plot_lookup_curves",
    "plot_lookup_surface",
    "plot_path",
    "save",
]

_COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_WALL, _RACELINE = "0.5", "0.1"
# Gray in the middle: the white of the usual diverging maps would hide a path without error.
_DEVIATION = LinearSegmentedColormap.from_list("deviation", ["#D55E00", "0.75", "#0072B2"])


def save(figure, path):
    """Write a figure; the suffix of the path is its format.

    Raises
    ------
    MapRacingError
        If the file cannot be written.
    """
    try:
        figure.savefig(str(path), dpi=130)
    except (OSError, ValueError) as error:
        raise MapRacingError(f"{path}: cannot write the figure: {error}") from None


def plot_path(result, color_by="speed", title=None):
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
    """
    if color_by not in ("speed", "error"):
        raise ParameterError(f"expected color_by speed or error, got {color_by!r}")
    traces = [lap.trace for lap in _traced(result)]
    line = result.raceline
    pieces = [np.stack((t.x[:-1], t.y[:-1], t.x[1:], t.y[1:]), axis=1) for t in traces]
    signals = [t.v if color_by == "speed" else t.d for t in traces]
    values = np.concatenate([0.5 * (signal[1:] + signal[:-1]) for signal in signals])
    if color_by == "speed":
        colors, label = "viridis", "speed [m/s]"
        low, high = float(values.min()), float(values.max())
    else:
        colors, label = _DEVIATION, "lateral deviation, left positive [m]"
        # A single excursion would leave no color for the rest.
        high = float(np.percentile(np.abs(values), 99.5))
        low = -high

    every = np.append(line.s, line.length)
    curve = line.sample(every)
    left, right = curve.d_left, curve.d_right
    figure = _figure(*_size_for(curve.x, curve.y))
    axes = figure.add_subplot(1, 1, 1)
    if left is not None:
        axes.plot(*line.to_cartesian(every, left), color=_WALL, lw=1.0, label="walls")
        axes.plot(*line.to_cartesian(every, -right), color=_WALL, lw=1.0)
    path = LineCollection(
        np.concatenate(pieces).reshape(-1, 2, 2), cmap=colors, linewidths=1.6, zorder=3
    )
    path.set_array(values)
    path.set_clim(low, high if high > low else low + 1.0)
    axes.add_collection(path)
    axes.plot(curve.x, curve.y, color=_RACELINE, lw=0.8, ls="--", label="raceline", zorder=4)
    reach = (0.5, 0.5) if left is None else line.widths_at(result.start_s)
    ends = np.array([reach[0], -reach[1]])
    axes.plot(
        *line.to_cartesian(np.full(2, result.start_s), ends),
        color=_COLORS[1],
        lw=2.5,
        label="start line",
        zorder=5,
    )
    axes.set_aspect("equal")
    axes.margins(0.04)
    axes.autoscale_view()
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_title(title or _name(result))
    axes.grid(alpha=0.25)
    axes.legend(loc="best", fontsize="small")
    figure.colorbar(path, ax=axes, label=label, fraction=0.04, pad=0.03)
    return _finished(figure)


def plot_laps(result, title=None):
    """Lateral deviation and speed of each lap over the distance from the start line.

    Stretches that do not count are left out, unless there is nothing else.

    Parameters
    ----------
    result : RunResult
        With traces.
    title : str, optional

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    EvaluationError
        If the result has no traces.
    """
    laps = _traced(result)
    laps = [lap for lap in laps if lap.valid] or laps
    line = result.raceline
    figure = _figure(9.5, 6.0)
    top = figure.add_subplot(2, 1, 1)
    bottom = figure.add_subplot(2, 1, 2, sharex=top)
    for lap in laps:
        trace = lap.trace
        # With many laps only their bundle matters; the best one stands out.
        style = {"color": _COLORS[5], "lw": 0.9, "alpha": max(0.25, 1.0 / len(laps) ** 0.5)}
        top.plot(trace.s, trace.d, **style)
        bottom.plot(trace.s, trace.v, **style)
    complete = [lap for lap in laps if not math.isnan(lap.lap_time_s)]
    if complete:
        best = min(complete, key=lambda lap: lap.lap_time_s)
        label = f"best lap, {best.lap_time_s:.3f} s"
        top.plot(best.trace.s, best.trace.d, color=_COLORS[0], lw=1.5, label=label)
        bottom.plot(best.trace.s, best.trace.v, color=_COLORS[0], lw=1.5, label=label)
    top.axhline(0.0, color=_RACELINE, lw=0.8)
    if line.speed is not None:
        s = np.linspace(0.0, line.length, 2 * line.n)
        reference = line.sample(s + result.start_s).speed
        bottom.plot(s, reference, color=_COLORS[1], lw=1.2, ls="--", label="raceline")
    top.set_ylabel("lateral deviation,\nleft positive [m]")
    bottom.set_ylabel("speed [m/s]")
    bottom.set_xlabel("distance from the start line [m]")
    bottom.set_xlim(0.0, line.length)
    bottom.set_ylim(bottom=0.0)
    for axes in (top, bottom):
        axes.grid(alpha=0.25)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="best", fontsize="small")
    counted = f"{len(laps)} lap" + ("s" if len(laps) != 1 else "")
    top.set_title(title or f"{_name(result)}: {counted}")
    return _finished(figure)


def plot_boxes(named_results, title=None):
    """Lap times and RMS lateral errors of several runs, side by side.

    Boxes span the quartiles, with the median as line; each valid lap is a dot.

    Parameters
    ----------
    named_results : iterable of (str, RunResult)
    title : str, optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    named = list(named_results)
    figure = _figure(min(4.0 + 1.6 * len(named), 14.0), 4.5)
    columns = (("lap_time_s", "lap time [s]"), ("rms_lateral_error_m", "RMS lateral error [m]"))
    for place, (column, label) in enumerate(columns, 1):
        axes = figure.add_subplot(1, 2, place)
        for position, (_, result) in enumerate(named, 1):
            values = np.array([getattr(lap, column) for lap in result.laps if lap.valid])
            color = _COLORS[(position - 1) % len(_COLORS)]
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
            # Spread sideways so that equal laps do not hide each other.
            shift = np.linspace(-0.12, 0.12, values.size) if values.size > 1 else np.zeros(1)
            axes.plot(position + shift, values, "o", ms=4, color=color, alpha=0.7, zorder=3)
        axes.set_xlim(0.4, len(named) + 0.6)
        axes.set_xticks(range(1, len(named) + 1))
        axes.set_xticklabels([name for name, _ in named], rotation=20, ha="right")
        axes.set_ylabel(label)
        axes.grid(axis="y", alpha=0.25)
    if title:
        figure.suptitle(title)
    return _finished(figure, top=0.94 if title else 1.0)


def plot_lookup_surface(speeds, angles, a_lat, title="Steady-state lateral acceleration"):
    """Lookup table as a surface over speed and steering angle.

    Parameters
    ----------
    speeds : array_like, shape (n_speeds,)
        [m/s]
    angles : array_like, shape (n_angles,)
        [rad]
    a_lat : array_like, shape (n_angles, n_speeds)
        [m/s^2]; NaN where there is no stable steady state.
    title : str, optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    speeds, angles, a_lat = _table(speeds, angles, a_lat)
    figure = _figure(8.5, 6.5)
    axes = figure.add_subplot(1, 1, 1, projection="3d")
    rows, columns = (np.unique(np.linspace(0, n - 1, 80).astype(int)) for n in a_lat.shape)
    v, delta = np.meshgrid(speeds[columns], angles[rows])
    a_lat = a_lat[np.ix_(rows, columns)]
    top = float(np.nanmax(a_lat))
    mappable = cm.ScalarMappable(Normalize(0.0, top), cm.viridis)
    mappable.set_array([])
    # Not every matplotlib leaves out cells without a value by itself: they are made transparent.
    known = np.isfinite(a_lat)
    height = np.where(known, a_lat, 0.0)
    colors = mappable.to_rgba(height)
    corners = known.copy()
    corners[:-1] &= known[1:]
    corners[:, :-1] &= corners[:, 1:]
    colors[~corners] = 0.0
    axes.plot_surface(
        v,
        delta,
        height,
        facecolors=colors,
        rstride=1,
        cstride=1,
        linewidth=0.0,
        shade=False,
    )
    axes.set_xlabel("speed [m/s]", labelpad=8)
    axes.set_ylabel("steering angle [rad]", labelpad=8)
    axes.set_zlabel("lateral acceleration [m/s²]", labelpad=6)
    axes.set_zlim(0.0, top)
    axes.view_init(elev=28.0, azim=-125.0)
    axes.set_title(title)
    figure.colorbar(mappable, ax=axes, shrink=0.65, pad=0.1, label="lateral acceleration [m/s²]")
    figure.subplots_adjust(left=0.07, right=0.96, bottom=0.03, top=0.95)
    return figure


def plot_lookup_curves(speeds, angles, a_lat, count=8, title="Steering for lateral acceleration"):
    """Lookup table as curves: steering angle over lateral acceleration, one per speed.

    Dots mark the largest reachable acceleration; beyond it a curve is dotted.

    Parameters
    ----------
    speeds, angles, a_lat
        As for `plot_lookup_surface`.
    count : int, optional
        Number of speeds, spread over the table.
    title : str, optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    speeds, angles, a_lat = _table(speeds, angles, a_lat)
    figure = _figure(8.5, 5.5)
    axes = figure.add_subplot(1, 1, 1)
    lowest = min(max(1.0, speeds[0]), speeds[-1])
    picked = sorted(
        {int(np.argmin(np.abs(speeds - v))) for v in np.linspace(lowest, speeds[-1], count)}
    )
    colors = cm.viridis(np.linspace(0.0, 0.9, len(picked)))
    for color, j in zip(colors, picked):
        column = a_lat[:, j]
        if np.isnan(column).all():
            continue
        peak = int(np.nanargmax(column))
        axes.plot(column[: peak + 1], angles[: peak + 1], color=color, label=f"{speeds[j]:.1f} m/s")
        axes.plot(column[peak:], angles[peak:], color=color, ls=":")
        axes.plot(column[peak], angles[peak], "o", color=color, ms=5)
    axes.set_xlim(left=0.0)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("lateral acceleration [m/s²]")
    axes.set_ylabel("steering angle [rad]")
    axes.set_title(title)
    axes.grid(alpha=0.25)
    axes.legend(loc="best", fontsize="small", title="speed")
    return _finished(figure)


# -- helpers -------------------------------------------------------------------------------------


def _figure(width, height):
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    return figure


def _finished(figure, top=1.0):
    figure.tight_layout(rect=(0.0, 0.0, 1.0, top))
    return figure


def _size_for(x, y):
    """Figure size [in] of the shape of a course, within what fits a screen."""
    width, height = float(np.ptp(x)) + 1.0, float(np.ptp(y)) + 1.0
    scale = min(9.0 / width, 8.5 / height)
    return max(width * scale, 3.5) + 2.0, max(height * scale, 3.0) + 1.0


def _traced(result):
    laps = [lap for lap in result.laps if lap.trace is not None]
    if not laps:
        raise EvaluationError(f"{_name(result)}: expected a result with traces to plot")
    return laps


def _name(result):
    return Path(result.source).name if result.source else "run"


def _table(speeds, angles, a_lat):
    speeds, angles, a_lat = (np.asarray(values, dtype=float) for values in (speeds, angles, a_lat))
    if a_lat.shape != (angles.size, speeds.size):
        raise ParameterError(
            f"expected a table of {angles.size} angles x {speeds.size} speeds, got {a_lat.shape}"
        )
    return speeds, angles, a_lat
