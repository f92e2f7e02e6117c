"""Figures of experiments: maps of tuning, boxes over speed, trajectories, comparisons."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from matplotlib import cm
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator

from .style import COLORS, finished, legend_above, new_figure
from .track import draw_track

if TYPE_CHECKING:
    import pandas as pd

    from ..track.raceline import Raceline

__all__ = [
    "plot_comparison",
    "plot_robustness",
    "plot_scaling",
    "plot_trajectories",
    "plot_tuning",
]

AXES = {
    "rms_lateral_error_m": "RMS lateral error [m]",
    "median_rms_lateral_error_m": "median RMS lateral error [m]",
    "mean_abs_lateral_error_m": "mean lateral error [m]",
    "max_abs_lateral_error_m": "largest lateral error [m]",
    "lap_time_s": "lap time [s]",
    "median_lap_time_s": "median lap time [s]",
    "mean_lap_time_s": "mean lap time [s]",
    "days_completed": "days completed",
    "m_m": "m, offset of the lookahead [m]",
    "q_s": "q, gain of the lookahead [s]",
    "heading_weight_m": "weight of the direction of motion [m]",
    "steering_rate_weight_ms": "weight of the steering rate [m s]",
}
TUNED = {
    "m_m": "m = {:.3g} m",
    "q_s": "q = {:.3g} s",
    "heading_weight_m": "w_h = {:.3g} m",
    "steering_rate_weight_ms": "w_u = {:.3g} m s",
}
WHOLE = ("days_completed",)  # columns of whole numbers


def plot_tuning(m, q, error, best: tuple[float, float], title: str, names=("m_m", "q_s")) -> Figure:
    """Lateral error over the pairs of parameters driven, (m, q) of the lookahead.

    Parameters
    ----------
    m, q : array_like, shape (n,)
        Offset [m] and gain [s].
    error : array_like, shape (n,)
        [m]; infinite for pairs that were not completed, drawn as crosses.
    best : tuple of float
        The chosen pair, drawn as a star.
    title : str
    names : tuple of str, optional
        Names of the parameters, if not these.

    Returns
    -------
    matplotlib.figure.Figure
    """
    m, q, error = (np.asarray(values, dtype=float) for values in (m, q, error))
    feasible = np.isfinite(error)
    figure = new_figure(8.0, 6.0)
    axes = figure.add_subplot(1, 1, 1)
    low, high = float(error[feasible].min()), float(error[feasible].max())
    norm = LogNorm(low, high if high > low else 2.0 * low)
    if feasible.sum() > 3 and np.ptp(m[feasible]) > 0.0 and np.ptp(q[feasible]) > 0.0:
        levels = np.geomspace(norm.vmin, norm.vmax * (1.0 + 1e-9), 13)
        axes.tricontourf(
            m[feasible],
            q[feasible],
            error[feasible],
            levels=levels,
            norm=norm,
            cmap="viridis_r",
            alpha=0.55,
        )
    dots = axes.scatter(
        m[feasible],
        q[feasible],
        c=error[feasible],
        norm=norm,
        cmap="viridis_r",
        s=26,
        edgecolors="k",
        linewidths=0.4,
        zorder=3,
        label="driven",
    )
    axes.plot(
        m[~feasible], q[~feasible], "x", color=COLORS[1], ms=7, mew=1.8, label="not completed"
    )
    chosen = ", ".join(TUNED[name].format(value) for name, value in zip(names, best))
    label = f"{chosen}: {low:.4f} m"
    axes.plot(*best, "*", color=COLORS[3], mec="k", ms=17, zorder=5, label=label)
    for values, limit in ((m, axes.set_xlim), (q, axes.set_ylim)):
        margin = 0.03 * float(np.ptp(values)) or 0.01
        limit(float(values.min()) - margin, float(values.max()) + margin)
    axes.set_xlabel(AXES[names[0]])
    axes.set_ylabel(AXES[names[1]])
    axes.grid(alpha=0.25)
    legend_above(axes, title)
    bar = figure.colorbar(dots, ax=axes, pad=0.02)
    ticks = _ticks(norm.vmin, norm.vmax)
    bar.ax.minorticks_off()
    bar.set_ticks(ticks)
    bar.set_ticklabels([f"{tick:g}" for tick in ticks])
    bar.set_label("mean of the laps' RMS lateral error [m]")
    return finished(figure)


def _ticks(low, high):
    """Round values within the limits of a logarithmic axis."""
    exponents = range(math.floor(math.log10(low)), math.ceil(math.log10(high)) + 1)
    values = [round(digit * 10.0**e, 9) for e in exponents for digit in (1, 1.5, 2, 3, 5, 7)]
    return [value for value in values if low <= value <= high]


def plot_scaling(laps: pd.DataFrame, ended: dict, labels: list[str], title: str) -> Figure:
    """Boxes of RMS lateral errors and lap times over the scale of the speeds.

    Boxes span the quartiles, whiskers go to minimum and maximum, the line is the median.

    Parameters
    ----------
    laps : pandas.DataFrame
        Laps that count, with ``speed_scale``, ``controller``, ``rms_lateral_error_m`` and
        ``lap_time_s``.
    ended : dict of (float, str) to int
        Number of days on which a scale and controller did not complete the laps (N.C.).
    labels : list of str
        Controllers, in order.
    title : str

    Returns
    -------
    matplotlib.figure.Figure
    """
    scales = sorted(set(laps.speed_scale) | {scale for scale, _ in ended})
    places = {scale: place for place, scale in enumerate(scales)}
    figure = new_figure(max(8.0, 2.5 + 0.75 * len(scales)), 8.5)
    width = 0.8 / len(labels)
    for row, column in enumerate(("rms_lateral_error_m", "lap_time_s"), 1):
        axes = figure.add_subplot(2, 1, row)
        for index, label in enumerate(labels):
            color = COLORS[index % len(COLORS)]
            own = laps[laps.controller == label]
            shift = (index - 0.5 * (len(labels) - 1)) * width
            driven = [scale for scale in scales if (own.speed_scale == scale).any()]
            axes.plot([], [], "s", color=color, label=label)
            if not driven:
                continue
            boxes = axes.boxplot(
                [own[own.speed_scale == scale][column].values for scale in driven],
                positions=[places[scale] + shift for scale in driven],
                widths=0.85 * width,
                whis=[0, 100],
                patch_artist=True,
                medianprops={"color": "k", "lw": 1.4},
                boxprops={"facecolor": color, "edgecolor": color, "alpha": 0.75},
                whiskerprops={"color": color},
                capprops={"color": color},
            )
            for scale, median in zip(driven, boxes["medians"]):
                if (own.speed_scale == scale).sum() == 1:  # the box is only a line
                    median.set(color=color, linewidth=2.5, zorder=2.5)
        for place in range(len(scales) - 1):
            axes.axvline(place + 0.5, color="0.9", lw=0.8, zorder=0)
        if column == "rms_lateral_error_m":
            axes.set_yscale("log")
            axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            axes.yaxis.set_minor_formatter(FuncFormatter(lambda value, _: ""))
            axes.legend(loc="upper left", fontsize="small", ncol=len(labels))
            axes.set_ylim(top=2.0 * axes.get_ylim()[1])  # room for the legend
            axes.set_title(title)
            _mark_ended(axes, ended, labels, places, width)
        axes.set_xlim(-0.6, len(scales) - 0.4)
        axes.set_xticks(range(len(scales)))
        axes.set_xticklabels([f"{100 * scale:g}" for scale in scales])
        axes.set_ylabel(AXES[column])
        axes.grid(axis="y", alpha=0.25)
    axes.set_xlabel("scale of the raceline's speeds [%]; crosses: days not completed (N.C.)")
    return finished(figure)


def _mark_ended(axes, ended, labels, places, width):
    """Crosses below the boxes, with the number of days."""
    across = axes.get_xaxis_transform()
    for (scale, label), days in ended.items():
        if days:
            index = labels.index(label)
            x = places[scale] + (index - 0.5 * (len(labels) - 1)) * width
            color = COLORS[index % len(COLORS)]
            axes.plot(x, 0.035, "x", color=color, ms=5, mew=1.6, transform=across)
            text = {"ha": "center", "va": "bottom", "fontsize": 7, "color": color}
            axes.text(x, 0.055, str(days), transform=across, **text)


def plot_trajectories(raceline: Raceline, rows: list, title: str) -> Figure:
    """Driven paths over the track, a panel for each race; a path ends at the crash.

    Parameters
    ----------
    raceline : Raceline
    rows : list of list of (str, ndarray, bool)
        Panels: a title, the path of shape (n, 2) [m] and whether it ended in a crash.
    title : str

    Returns
    -------
    matplotlib.figure.Figure
    """
    wide, high = float(np.ptp(raceline.x)) + 6.0, float(np.ptp(raceline.y)) + 5.0
    columns = max(map(len, rows))
    # Panels with the aspect ratio of the track [in], with room for ticks and titles.
    panel = min(4.2, 13.5 / columns)
    height, across, between = panel * high / wide, 0.4, 0.6
    edges = {"left": 0.7, "right": 0.15, "bottom": 0.95, "top": 0.7}
    width_in = columns * panel + (columns - 1) * across + edges["left"] + edges["right"]
    height_in = len(rows) * (height + between) - between + edges["bottom"] + edges["top"]
    figure = new_figure(width_in, height_in)
    figure.subplots_adjust(
        left=edges["left"] / width_in,
        right=1.0 - edges["right"] / width_in,
        bottom=edges["bottom"] / height_in,
        top=1.0 - edges["top"] / height_in,
        wspace=across / panel,
        hspace=between / height,
    )
    for i, row in enumerate(rows):
        for j, (name, path, crashed) in enumerate(row):
            axes = figure.add_subplot(len(rows), columns, i * columns + j + 1)
            draw_track(axes, raceline, most_marks=5, room=0.07)
            axes.margins(0.15, 0.17)
            driven = {"color": COLORS[0], "lw": 1.2, "zorder": 3, "label": "driven"}
            axes.plot(path[:, 0], path[:, 1], **driven)
            if crashed and len(path):  # without a path, the race ended before the first pose
                end = {"color": COLORS[1], "ms": 11, "mew": 2.5, "zorder": 6}
                axes.plot(*path[-1], "x", label="crash", **end)
            axes.set_title(name, fontsize="medium")
            axes.label_outer()
    handles = {}
    for axes in figure.axes:
        for handle, name in zip(*axes.get_legend_handles_labels()):
            handles.setdefault(name, handle)
    figure.suptitle(title, y=1.0 - 0.1 / height_in, va="top")
    columns = len(handles)
    figure.legend(
        list(handles.values()), list(handles), loc="lower center", ncol=columns, fontsize="small"
    )
    return figure


def plot_comparison(
    table: pd.DataFrame, values: list[str], names: tuple[str, str], title: str
) -> Figure:
    """Two result directories: values over the scale of the speeds, for each controller.

    Parameters
    ----------
    table : pandas.DataFrame
        With ``speed_scale``, ``controller`` and, for each value, ``VALUE_a`` and ``VALUE_b``.
    values : list of str
    names : tuple of str
        Names of both.
    title : str

    Returns
    -------
    matplotlib.figure.Figure
    """
    labels = list(dict.fromkeys(table.controller))
    figure = new_figure(9.0, 2.5 * len(values) + 1.2)
    for row, value in enumerate(values, 1):
        axes = figure.add_subplot(len(values), 1, row)
        for index, label in enumerate(labels):
            own = table[table.controller == label].sort_values("speed_scale")
            color = cm.tab10(index) if len(labels) > len(COLORS) else COLORS[index]
            for suffix, style in (("a", "o-"), ("b", "s--")):
                axes.plot(
                    100.0 * own.speed_scale,
                    own[f"{value}_{suffix}"],
                    style,
                    color=color,
                    ms=5,
                    mfc=color if suffix == "a" else "w",
                    label=label if suffix == "a" and row == 1 else None,
                )
        if row == 1:
            axes.plot([], [], "o-", color="0.3", label=names[0])
            axes.plot([], [], "s--", color="0.3", mfc="w", label=names[1])
            handles, texts = axes.get_legend_handles_labels()
            axes.set_title(title)
        axes.set_ylabel(AXES.get(value, value))
        if value in WHOLE:
            axes.yaxis.set_major_locator(MaxNLocator(integer=True))
        axes.grid(alpha=0.25)
    axes.set_xlabel("scale of the raceline's speeds [%]")
    figure.tight_layout(rect=(0.0, 0.6 / figure.get_size_inches()[1], 1.0, 1.0))
    figure.legend(handles, texts, loc="lower center", ncol=3, fontsize="small")
    return figure


def plot_robustness(races, title):
    """Error of every race, tracks across and cars down; crosses mark races not completed.

    Parameters
    ----------
    races : pandas.DataFrame
        Of one controller: ``track car outcome rms_lateral_error_m``.
    title : str

    Returns
    -------
    matplotlib.figure.Figure
    """
    tracks, cars = list(dict.fromkeys(races.track)), list(dict.fromkeys(races.car))
    error = np.full((len(cars), len(tracks)), np.nan)
    ended = []
    for row in races.itertuples():
        place = cars.index(row.car), tracks.index(row.track)
        if row.outcome == "completed":
            error[place] = row.rms_lateral_error_m
        else:
            ended.append(place)
    figure = new_figure(max(7.0, 3.0 + 0.36 * len(tracks)), 2.6 + 0.3 * len(cars))
    axes = figure.add_subplot(1, 1, 1)
    shown = axes.imshow(1000.0 * error, cmap="viridis_r", vmin=0.0, aspect="auto")
    for down, across in ended:
        axes.plot(across, down, "x", color=COLORS[1], ms=9, mew=2.2)
    for down, across in np.argwhere(np.isfinite(error)):
        dark = error[down, across] > 0.5 * np.nanmax(error)
        text = f"{1000.0 * error[down, across]:.0f}"
        style = {"ha": "center", "va": "center", "fontsize": "small"}
        axes.text(across, down, text, color="w" if dark else "k", **style)
    axes.set_xticks(range(len(tracks)))
    axes.set_xticklabels(tracks, rotation=60, ha="right", fontsize="small")
    axes.set_yticks(range(len(cars)))
    axes.set_yticklabels(cars, fontsize="small")
    count = len(races) - len(ended)
    axes.set_title(f"{title}\n{count} of {len(races)} races completed (x: not)")
    figure.colorbar(shown, ax=axes, pad=0.02).set_label("RMS lateral error [mm]")
    return finished(figure)
