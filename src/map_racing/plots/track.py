"""Tracks to scale: walls, raceline, start line, direction and distances."""

from __future__ import annotations

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.transforms import Affine2D

from ..track.map_image import MapImage
from ..track.raceline import Raceline
from .style import RACELINE, WALL

__all__ = ["draw_distances", "draw_map", "draw_track", "draw_walls"]

START = "k"
_NOT_FREE = 0.82  # gray for walls and unknown cells of a map
_MOST_CELLS = 2000  # of a map in each direction; more cannot be seen


def draw_track(
    axes: Axes, line: Raceline, start_s: float = 0.0, most_marks: int = 12, room: float = 0.03
) -> None:
    """Walls, raceline, start line, direction and distances, to scale.

    Paths with a ``zorder`` of 3 or more are drawn over the raceline.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    line : Raceline
    start_s : float, optional
        Arc length of the start line [m].
    most_marks : int, optional
        Largest number of marks of the distance.
    room : float, optional
        Distance of texts and arrows from the track, as a share of its size; larger for a small
        panel.
    """
    draw_walls(axes, line)
    every = line.sample(np.append(line.s, line.length))
    axes.plot(every.x, every.y, color=RACELINE, lw=0.8, ls="--", label="raceline", zorder=2)
    draw_distances(axes, line, start_s, most_marks, room)


def draw_walls(axes: Axes, line: Raceline) -> None:
    """Both walls, if the raceline has them, to scale."""
    s = np.append(line.s, line.length)
    if line.d_left is not None:
        curve = line.sample(s)
        axes.plot(*line.to_cartesian(s, curve.d_left), color=WALL, lw=1.0, label="walls")
        axes.plot(*line.to_cartesian(s, -curve.d_right), color=WALL, lw=1.0)
    axes.set_aspect("equal")
    axes.margins(0.08)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.grid(alpha=0.25)


def draw_distances(
    axes: Axes, line: Raceline, start_s: float = 0.0, most_marks: int = 12, room: float = 0.03
) -> None:
    """Start line and, outside the track, distances from it and arrows in driving direction.

    Parameters
    ----------
    axes, line, start_s, most_marks, room
        See `draw_track`.
    """
    size = max(float(np.ptp(line.x)), float(np.ptp(line.y)))
    left, right = (0.02 * size,) * 2 if line.d_left is None else line.widths_at(start_s)
    ends = line.to_cartesian(np.full(2, start_s), np.array([left, -right]))
    axes.plot(*ends, color=START, lw=2.5, solid_capstyle="butt", label="start line", zorder=5)

    # Outside is to the right if the lap is driven counter-clockwise.
    side = -1.0 if float(np.sum(line.kappa)) > 0.0 else 1.0
    step = _round_step(line.length / most_marks)
    marks = np.arange(0.0, line.length - 0.2 * step, step)
    for distance in marks:
        x, y = _outward(line, start_s + distance, side, 0.012 * size)
        axes.plot(x, y, color=START, lw=1.0, zorder=4)
        x, y = _outward(line, start_s + distance, side, (room + 0.005) * size)
        text = {"ha": "center", "va": "center", "fontsize": "x-small", "color": "0.25"}
        axes.text(x[1], y[1], f"{distance:g} m", clip_on=True, zorder=4, **text)
    for distance in marks[:: max(1, math.ceil(marks.size / 4))] + 0.5 * step:
        x, y = _outward(line, start_s + distance, side, room * size)
        psi, reach = line.pose(start_s + distance).psi, 0.025 * size
        along = reach * math.cos(psi), reach * math.sin(psi)
        axes.annotate(
            "",
            xy=(x[1] + along[0], y[1] + along[1]),
            xytext=(x[1] - along[0], y[1] - along[1]),
            arrowprops={"arrowstyle": "-|>", "color": START, "lw": 1.2, "shrinkA": 0, "shrinkB": 0},
            zorder=4,
        )


def _round_step(least):
    """The smallest 1, 2 or 5 times a power of ten that is at least a value."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(power * digit for digit in (1.0, 2.0, 5.0, 10.0) if power * digit >= least)


def _outward(line, s, side, beyond):
    """Points at a distance [m] outward from the wall of a side, or from the raceline."""
    wall = 0.0 if line.d_left is None else line.widths_at(s)[0 if side > 0.0 else 1]
    return line.to_cartesian(np.full(2, s), side * np.array([wall, wall + beyond]))


def draw_map(axes: Axes, image: MapImage) -> None:
    """Draw a map in the background, without changing the limits of the axes.

    Parameters
    ----------
    axes : matplotlib.axes.Axes
    image : MapImage
        Cells that are not free are gray.
    """
    limits = axes.get_xlim(), axes.get_ylim()
    axes.set_facecolor(str(_NOT_FREE))  # everything beyond the image is unknown
    corners = image.to_cells([(x, y) for x in limits[0] for y in limits[1]])
    rows, columns = image.free.shape
    left, low = (max(0, int(math.floor(value)) - 1) for value in corners.min(axis=0))
    right, high = (int(math.ceil(value)) + 2 for value in corners.max(axis=0))
    right, high = min(right, columns), min(high, rows)
    if right > left and high > low:
        stride = max(1, -(-max(right - left, high - low) // _MOST_CELLS))
        shown = image.free[low:high:stride, left:right:stride]
        cell = image.resolution
        x0, y0, yaw = image.origin
        width, height = (stride * cell * count for count in shown.shape[::-1])
        axes.imshow(
            np.where(shown, 1.0, _NOT_FREE),
            cmap="gray",
            vmin=0.0,
            vmax=1.0,
            origin="lower",
            interpolation="nearest",
            extent=(left * cell, left * cell + width, low * cell, low * cell + height),
            transform=Affine2D().rotate(yaw).translate(x0, y0) + axes.transData,
            zorder=0,
        )
    axes.set_xlim(*limits[0])
    axes.set_ylim(*limits[1])
    axes.set_aspect("equal")
