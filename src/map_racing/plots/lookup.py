"""Figures of lookup tables."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib import cm
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

# matplotlib 3.1 knows the projection "3d" only after this import.
from mpl_toolkits.mplot3d import Axes3D  # noqa: F401

from .style import finished, new_figure

__all__ = ["plot_lookup_curves", "plot_lookup_surface"]


def plot_lookup_surface(table: Any) -> Figure:
    """Lookup table as a surface over speed and steering angle.

    Parameters
    ----------
    table : LookupTable
        See `map_racing.vehicle.lookup`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    speeds, angles, a_lat = table.speeds, table.angles, table.a_lat
    figure = new_figure(8.5, 6.5)
    axes = figure.add_subplot(1, 1, 1, projection="3d")
    rows, columns = (np.unique(np.linspace(0, n - 1, 80).astype(int)) for n in a_lat.shape)
    v, delta = np.meshgrid(speeds[columns], angles[rows])
    a_lat = a_lat[np.ix_(rows, columns)]
    top = float(np.nanmax(a_lat))
    mappable = cm.ScalarMappable(Normalize(0.0, top), cm.viridis)
    mappable.set_array([])
    # Old versions of matplotlib also draw cells without a value: make them transparent.
    known = np.isfinite(a_lat)
    height = np.where(known, a_lat, 0.0)
    colors = mappable.to_rgba(height)
    corners = known.copy()
    corners[:-1] &= known[1:]
    corners[:, :-1] &= corners[:, 1:]
    colors[~corners] = 0.0
    axes.plot_surface(
        v, delta, height, facecolors=colors, rstride=1, cstride=1, linewidth=0.0, shade=False
    )
    axes.set_xlabel("speed [m/s]", labelpad=8)
    axes.set_ylabel("steering angle [rad]", labelpad=8)
    axes.set_zlabel("lateral acceleration [m/s²]", labelpad=6)
    axes.set_zlim(0.0, top)
    axes.view_init(elev=28.0, azim=-125.0)
    axes.set_title("Steady-state lateral acceleration")
    figure.colorbar(mappable, ax=axes, shrink=0.65, pad=0.1, label="lateral acceleration [m/s²]")
    figure.subplots_adjust(left=0.07, right=0.96, bottom=0.03, top=0.95)
    return figure


def plot_lookup_curves(table: Any) -> Figure:
    """Lookup table as curves: steering angle over lateral acceleration, one per speed.

    Dots mark the largest reachable acceleration, beyond which a curve is dotted.

    Parameters
    ----------
    table : LookupTable

    Returns
    -------
    matplotlib.figure.Figure
    """
    speeds, angles, a_lat = table.speeds, table.angles, table.a_lat
    figure = new_figure(8.5, 5.5)
    axes = figure.add_subplot(1, 1, 1)
    lowest = min(max(1.0, speeds[0]), speeds[-1])
    picked = sorted(
        {int(np.argmin(np.abs(speeds - v))) for v in np.linspace(lowest, speeds[-1], 8)}
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
    axes.set_title("Steering for lateral acceleration")
    axes.grid(alpha=0.25)
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small", frameon=False)
    return finished(figure)
