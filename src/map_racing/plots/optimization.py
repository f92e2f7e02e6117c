"""Figures of optimized lines."""

from __future__ import annotations

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from ..track.map_image import MapImage
from ..track.raceline import Raceline
from ..track.walls import Walls
from .style import COLORS, WALL, finished, legend_above, new_figure, size_for
from .track import draw_distances, draw_map

__all__ = ["plot_optimized"]


def plot_optimized(
    line: Raceline,
    reference: Raceline,
    walls: Walls,
    image: MapImage | None = None,
) -> Figure:
    """An optimized line colored by speed between the walls; curvature and speed along the lap.

    Parameters
    ----------
    line : Raceline
        With speeds and distances to the walls.
    reference : Raceline
        Line to compare with; with or without speeds.
    walls : Walls
    image : MapImage, optional
        Map of the walls, drawn in the background.

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
    legend_above(track, line.name or "optimized line")
    if image is not None:
        draw_map(track, image)
    figure.colorbar(path, ax=track, label="speed [m/s]", fraction=0.04, pad=0.03)
    # Project the middle line onto the line: their lengths differ.
    feet = zip(reference.x.tolist(), reference.y.tolist(), reference.psi.tolist())
    beside = np.array([line.project(*place).s for place in feet])
    _draw_profile(top, line, reference, beside, "kappa", "curvature [1/m]")
    _draw_profile(bottom, line, reference, beside, "speed", "speed [m/s]")
    top.axhline(0.0, color="0.6", lw=0.6)
    legend_above(top)
    bottom.set_xlabel("distance along the optimized line [m]")
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
    draw_distances(track, line)
    track.set_aspect("equal")
    track.autoscale_view()
    track.margins(0.08)
    track.set_xlabel("x [m]")
    track.set_ylabel("y [m]")
    track.grid(alpha=0.25)
    return path


def _draw_profile(axes, line, reference, beside, column, label):
    """Draw a column of both lines over the distance along the first."""
    middle, optimized = getattr(reference, column), getattr(line, column)
    if middle is not None:
        order = np.argsort(beside, kind="mergesort")
        style = {"color": "0.45", "lw": 1.0, "ls": "--"}
        axes.plot(beside[order], middle[order], label="middle line", **style)
    axes.plot(line.s, optimized, label="optimized", color=COLORS[0], lw=1.5)
    axes.set_xlim(0.0, line.length)
    axes.set_ylabel(label)
    axes.grid(alpha=0.25)
