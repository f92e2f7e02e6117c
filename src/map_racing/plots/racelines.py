"""Figures of racelines, their walls and findings."""

from __future__ import annotations

import textwrap

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from ..track.findings import ERROR, WARNING, worst_first
from ..track.raceline import Raceline
from .style import COLORS, RACELINE, legend_above, new_figure, size_for
from .track import draw_distances, draw_walls

__all__ = ["plot_raceline"]

_COLORS = {ERROR: COLORS[1], WARNING: COLORS[4]}
_MOST_LISTED = 14
_BAR, _LIST = 1.1, 4.6  # widths of colorbar and list [in]


def plot_raceline(table, raceline: Raceline | None, findings, title: str | None = None) -> Figure:
    """A track as it was given, with walls, speeds, and numbered marks at its findings.

    Parameters
    ----------
    table : RacelineTable
    raceline : Raceline or None
        Without it only the points are drawn.
    findings : iterable of Finding
        Errors and warnings are marked and listed; notes are only listed.
    title : str, optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    x, y = table.columns["x"], table.columns["y"]
    good = np.isfinite(x) & np.isfinite(y)
    x, y = x[good], y[good]
    width, height = size_for(x, y) if x.size else (6.0, 5.0)
    listed = worst_first(findings)[:_MOST_LISTED]
    # Track, colorbar and list side by side; lengths in inches.
    between = 0.2 if raceline is None or raceline.speed is None else _BAR
    height = max(height + 0.4, 4.5)
    if x.size:  # no wider than the shape of the track
        shape = (np.ptp(x) + 1.0) / (np.ptp(y) + 1.0)
        width = min(width, max(1.1 * shape * (height - 1.35), 3.5) + 0.9)
    total = width + between + _LIST
    figure = new_figure(total, height)
    low, tall = 0.65 / height, 1.0 - 1.35 / height
    axes = figure.add_axes([0.8 / total, low, (width - 0.9) / total, tall])
    bar = [(width + 0.1) / total, low, 0.18 / total, tall]
    if raceline is None:
        axes.plot(x, y, ".-", color=RACELINE, ms=3, lw=0.8, label="points")
        first = {"ms": 9, "mfc": "none", "mec": COLORS[2], "mew": 2, "zorder": 4}
        axes.plot(x[:1], y[:1], "s", label="first point", **first)
    else:
        _draw_line(figure, axes, bar, raceline)
    for number, finding in enumerate(listed, 1):
        _mark(axes, number, finding)
    axes.set_aspect("equal", anchor="E")
    axes.margins(0.08)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.grid(alpha=0.25)
    legend_above(axes, title or table.name or "track")
    _list(figure, listed, (width + between) / total, low + tall)
    return figure


def _draw_line(figure, axes, bar, line):
    draw_walls(axes, line)
    curve = line.sample(np.append(line.s, line.length))
    if curve.speed is None:
        axes.plot(curve.x, curve.y, color=RACELINE, lw=1.4, label="track")
    else:
        points = np.stack((curve.x, curve.y), axis=1)
        pieces = LineCollection(
            np.stack((points[:-1], points[1:]), axis=1), cmap="viridis", linewidths=2.2, zorder=3
        )
        pieces.set_array(0.5 * (curve.speed[1:] + curve.speed[:-1]))
        axes.add_collection(pieces)
        figure.colorbar(pieces, cax=figure.add_axes(bar), label="speed [m/s]")
    draw_distances(axes, line)


def _mark(axes, number, finding):
    """Circles at the places of a warning or error, with its number at the first."""
    color = _COLORS.get(finding.severity)
    places = [p for p in finding.places if np.isfinite(p.x) and np.isfinite(p.y)]
    if color is None or not places:
        return
    x, y = [p.x for p in places], [p.y for p in places]
    axes.plot(x, y, "o", ms=9, mfc="none", mec=color, mew=1.6, zorder=5)
    axes.annotate(
        str(number),
        xy=(places[0].x, places[0].y),
        xytext=(9, 9 + 3 * (number % 4)),
        textcoords="offset points",
        color="white",
        fontsize="small",
        weight="bold",
        bbox={"boxstyle": "circle,pad=0.25", "fc": color, "ec": "none"},
        zorder=6,
    )


def _list(figure, listed, left, top):
    """The findings as text beside the track, with the numbers of their marks."""
    line = 0.16 / figure.get_figheight()
    indent = 0.3 / figure.get_figwidth()
    if not listed:
        figure.text(left, top, "nothing noticed", fontsize=8, va="top")
    for number, finding in enumerate(listed, 1):
        text = textwrap.wrap(f"{finding.severity}: {finding}", 54)
        color = _COLORS.get(finding.severity, "0.6")
        circle = {"boxstyle": "circle,pad=0.2", "fc": color, "ec": "none"}
        figure.text(
            left, top, str(number), fontsize=7, va="top", color="white", weight="bold", bbox=circle
        )
        figure.text(left + indent, top, "\n".join(text), fontsize=8, va="top", linespacing=1.25)
        top -= line * (len(text) + 0.8)
