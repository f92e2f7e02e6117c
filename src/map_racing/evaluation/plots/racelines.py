"""Figures of racelines: the line, its walls, and what is wrong with it."""

from __future__ import annotations

import textwrap

import numpy as np
from matplotlib.collections import LineCollection

from ...track.findings import ERROR, WARNING
from .style import COLORS, RACELINE, WALL, new_figure, size_for

__all__ = ["plot_course"]

_COLORS = {ERROR: COLORS[1], WARNING: COLORS[4]}
_MOST_LISTED = 14


def plot_course(table, raceline, findings, title=None):
    """A course as it was given, with walls, speeds, and numbered marks where findings stand.

    Parameters
    ----------
    table : CourseTable
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
    width, height = size_for(x, y)
    listed = _listed(findings)
    figure = new_figure(width + 4.6, max(height, 4.5))
    share = width / (width + 4.6)
    axes = figure.add_axes([0.75 / (width + 4.6), 0.1, share - 1.0 / (width + 4.6), 0.82])
    if raceline is None:
        axes.plot(x, y, ".-", color=RACELINE, ms=3, lw=0.8, label="points")
    else:
        _draw_line(figure, axes, raceline)
    if x.size:
        axes.plot(x[0], y[0], "o", ms=8, mfc="none", mec=COLORS[2], mew=2, label="first point")
    for number, finding in enumerate(listed, 1):
        _mark(axes, number, finding)
    axes.set_aspect("equal")
    axes.margins(0.06)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_title(title or table.name or "course")
    axes.grid(alpha=0.25)
    axes.legend(loc="best", fontsize="small")
    _list(figure, listed, share)
    return figure


def _listed(findings):
    order = {ERROR: 0, WARNING: 1}
    return sorted(findings, key=lambda finding: order.get(finding.severity, 2))[:_MOST_LISTED]


def _draw_line(figure, axes, line):
    s = np.append(line.s, line.length)
    curve = line.sample(s)
    if line.d_left is not None:
        axes.plot(*line.to_cartesian(s, curve.d_left), color=WALL, lw=1.0, label="walls")
        axes.plot(*line.to_cartesian(s, -curve.d_right), color=WALL, lw=1.0)
    if curve.speed is None:
        axes.plot(curve.x, curve.y, color=RACELINE, lw=1.4, label="course")
    else:
        points = np.stack((curve.x, curve.y), axis=1)
        pieces = LineCollection(
            np.stack((points[:-1], points[1:]), axis=1), cmap="viridis", linewidths=2.2, zorder=3
        )
        pieces.set_array(0.5 * (curve.speed[1:] + curve.speed[:-1]))
        axes.add_collection(pieces)
        figure.colorbar(pieces, ax=axes, label="speed [m/s]", fraction=0.04, pad=0.03)
    # The direction of travel, at the start and at three places more.
    for at in np.arange(4) * 0.25 * line.length:
        tail, head = line.position(at), line.position(at + 0.02 * line.length)
        axes.annotate(
            "",
            xy=head,
            xytext=tail,
            arrowprops={"arrowstyle": "-|>", "color": COLORS[2], "lw": 1.6, "shrinkA": 0},
            zorder=4,
        )


def _mark(axes, number, finding):
    """Circles at the places of a finding that is wrong, with its number at the first."""
    color = _COLORS.get(finding.severity)
    places = [p for p in finding.places if np.isfinite(p.x) and np.isfinite(p.y)]
    if color is None or not places:
        return
    axes.plot(
        [p.x for p in places],
        [p.y for p in places],
        "o",
        ms=9,
        mfc="none",
        mec=color,
        mew=1.6,
        zorder=5,
    )
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


def _list(figure, listed, share):
    """The findings as text beside the course."""
    top = 0.92
    step = 0.155 / figure.get_figheight()
    if not listed:
        figure.text(share + 0.01, top, "nothing noticed", fontsize="small", va="top")
    for number, finding in enumerate(listed, 1):
        text = textwrap.wrap(f"{number}  {finding.severity}: {finding}", 52)
        figure.text(
            share + 0.01,
            top,
            "\n".join(text),
            fontsize=8,
            va="top",
            color=_COLORS.get(finding.severity, "0.3"),
            linespacing=1.2,
        )
        top -= step * (len(text) + 0.6)
