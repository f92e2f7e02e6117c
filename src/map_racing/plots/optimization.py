"""Figures of optimized lines."""

from __future__ import annotations

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from ..track.raceline import Raceline
from ..track.walls import Walls
from .style import COLORS, WALL, finished, new_figure, size_for

__all__ = ["plot_optimized"]


def plot_optimized(
    line: Raceline, reference: Raceline, walls: Walls, title: str | None = None
) -> Figure:
    """An optimized line colored by speed between the walls; curvature and speed along the lap.

    Parameters
    ----------
    line : Raceline
        With speeds.
    reference : Raceline
        Compared with the line at the same share of the lap; with or without speeds.
    walls : Walls
    title : str, optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    width, height = size_for(line.x, line.y)
    if width < 1.3 * height:
        figure = new_figure(width + 6.0, max(height, 5.5))
        shape, places = (2, 2), [(slice(None), 0), (0, 1), (1, 1)]
        ratios = {"width_ratios": (width, 6.0)}
    else:
        figure = new_figure(width, height + 4.5)
        shape, places = (3, 1), [(0, 0), (1, 0), (2, 0)]
        ratios = {"height_ratios": (height, 2.2, 2.2)}
    layout = figure.add_gridspec(*shape, **ratios)
    track, top, bottom = (figure.add_subplot(layout[place]) for place in places)
    path = _draw_lines(track, line, reference, walls)
    track.set_title(title or line.name or "optimized line")
    figure.colorbar(path, ax=track, label="speed [m/s]", fraction=0.04, pad=0.03)
    _draw_profile(top, line, reference, "kappa", "curvature [1/m]")
    _draw_profile(bottom, line, reference, "speed", "speed [m/s]")
    top.axhline(0.0, color="0.6", lw=0.6)
    top.legend(loc="best", fontsize="small")
    bottom.set_xlabel("share of the lap [%]")
    return finished(figure)


def _draw_lines(track, line, reference, walls):
    """Walls, middle line and the line with its start; returns the line, colored by speed."""
    track.add_collection(LineCollection(walls.segments, colors=WALL, linewidths=1.0, label="walls"))
    every = np.append(reference.s, reference.length)
    middle = reference.sample(every)
    track.plot(middle.x, middle.y, color="0.35", lw=0.9, ls="--", label="middle line")
    points = np.stack((np.append(line.x, line.x[0]), np.append(line.y, line.y[0])), axis=1)
    path = LineCollection(
        np.stack((points[:-1], points[1:]), axis=1), cmap="viridis", linewidths=2.4, zorder=3
    )
    path.set_array(line.speed)
    track.add_collection(path)
    track.plot(*points[0], "o", ms=8, mfc="none", mec=COLORS[1], mew=1.8, zorder=5, label="start")
    head = line.position(0.02 * line.length)
    track.annotate(
        "",
        xy=head,
        xytext=points[0],
        arrowprops={"arrowstyle": "-|>", "color": COLORS[1], "lw": 1.8, "shrinkA": 0},
        zorder=6,
    )
    track.set_aspect("equal")
    track.autoscale_view()
    track.margins(0.04)
    track.set_xlabel("x [m]")
    track.set_ylabel("y [m]")
    track.grid(alpha=0.25)
    track.legend(loc="best", fontsize="small")
    return path


def _draw_profile(axes, line, reference, column, label):
    """A column of both lines over the share of the lap, since they differ in length."""
    for profile_line, name, style in (
        (reference, "middle line", {"color": "0.45", "lw": 1.0, "ls": "--"}),
        (line, "optimized", {"color": COLORS[0], "lw": 1.5}),
    ):
        values = getattr(profile_line, column)
        if values is not None:
            share = 100.0 * profile_line.s / profile_line.length
            axes.plot(share, values, label=name, **style)
    axes.set_xlim(0.0, 100.0)
    axes.set_ylabel(label)
    axes.grid(alpha=0.25)
