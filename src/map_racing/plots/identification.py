"""Figures of identified tires: points and curves, coverage, prediction, and drives."""

from __future__ import annotations

from typing import NamedTuple, Sequence

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from .style import COLORS, finished, legend_above, new_figure

__all__ = [
    "AxleFigure",
    "DriveFigure",
    "plot_coverage",
    "plot_drive",
    "plot_prediction",
    "plot_tires",
]


class AxleFigure(NamedTuple):
    """Data of the figure of one axle; slip and force are positive in left turns.

    Parameters
    ----------
    name : str
    slip, force : ndarray, shape (n,)
        Points [rad], [N].
    inlier : ndarray of bool, shape (n,)
    curve, linear : callable
        Force [N] of the identified tires over slip [rad].
    covered : float
        Largest slip in the data [rad].
    load : float
        Static load [N].
    """

    name: str
    slip: np.ndarray
    force: np.ndarray
    inlier: np.ndarray
    curve: object
    linear: object
    covered: float
    load: float


class DriveFigure(NamedTuple):
    """Signals of one drive on one clock [SI], shape (n,), and slices of its steady segments."""

    name: str
    t: np.ndarray
    v: np.ndarray
    delta: np.ndarray
    r: np.ndarray
    a_y: np.ndarray
    segments: list


def plot_tires(axles: Sequence[AxleFigure]) -> Figure:
    """Points, rejected points and fitted curves of each axle at its static load.

    Parameters
    ----------
    axles : sequence of AxleFigure

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = new_figure(5.6 * len(axles), 4.8)
    for number, axle in enumerate(axles):
        axes = figure.add_subplot(1, len(axles), number + 1)
        top = 1.25 * float(np.percentile(np.abs(axle.force[axle.inlier]), 99.0))
        widest = 1.35 * max(axle.covered, 1e-4)
        axes.plot(
            axle.slip[axle.inlier],
            axle.force[axle.inlier],
            ".",
            color=COLORS[0],
            ms=4,
            alpha=0.35,
            mew=0.0,
            label=f"{np.count_nonzero(axle.inlier)} points",
        )
        if not axle.inlier.all():
            rejected = ~axle.inlier
            axes.plot(
                axle.slip[rejected],
                axle.force[rejected],
                "x",
                color=COLORS[4],
                ms=4,
                alpha=0.7,
                label=f"{np.count_nonzero(rejected)} rejected",
            )
        slip = np.linspace(-widest, widest, 401)
        inside = np.where(np.abs(slip) <= axle.covered, axle.curve(slip), np.nan)
        axes.plot(slip, axle.linear(slip), color="0.4", lw=1.2, ls="-.", label="linear tire")
        axes.plot(slip, axle.curve(slip), color=COLORS[1], lw=1.4, ls=":", label="extrapolated")
        axes.plot(slip, inside, color=COLORS[1], lw=2.2, label="Pacejka")
        axes.set_xlim(-widest, widest)
        axes.set_ylim(-top, top)
        axes.axhline(0.0, color="0.8", lw=0.8, zorder=0)
        axes.axvline(0.0, color="0.8", lw=0.8, zorder=0)
        axes.set_xlabel("slip angle [rad], positive in left turns")
        axes.set_ylabel("lateral force [N]")
        axes.grid(alpha=0.25)
        legend_above(axes, f"{axle.name} axle, static load {axle.load:.1f} N", columns=5)
    return finished(figure)


def plot_coverage(v: np.ndarray, delta: np.ndarray, a_y: np.ndarray, largest: float) -> Figure:
    """Coverage of the data: steering angle over speed, and lateral acceleration.

    Parameters
    ----------
    v, delta, a_y : ndarray, shape (n,)
        Points of steady cornering [m/s, rad, m/s^2].
    largest : float
        Largest lateral acceleration held [m/s^2].

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = new_figure(11.0, 4.6)
    axes = figure.add_subplot(1, 2, 1)
    points = axes.scatter(
        v, delta, c=np.abs(a_y), s=9, cmap="viridis", norm=Normalize(0.0, largest), linewidths=0.0
    )
    figure.colorbar(points, ax=axes, label="lateral acceleration [m/s²]")
    axes.axhline(0.0, color="0.8", lw=0.8, zorder=0)
    axes.set_xlim(left=0.0)
    axes.set_xlabel("speed [m/s]")
    axes.set_ylabel("steering angle [rad], left positive")
    axes.set_title("steady cornering")
    axes.grid(alpha=0.25)
    axes = figure.add_subplot(1, 2, 2)
    edges = np.linspace(-1.1 * largest, 1.1 * largest, 45)
    axes.hist(a_y, bins=edges, color=COLORS[0])
    axes.axvline(-largest, color=COLORS[1], lw=1.4, ls="--")
    axes.axvline(largest, color=COLORS[1], lw=1.4, ls="--", label=f"held: {largest:.2f} m/s²")
    axes.set_xlabel("lateral acceleration [m/s²], left positive")
    axes.set_ylabel("points")
    axes.grid(alpha=0.25)
    legend_above(axes, "how near the limit")
    return finished(figure)


def plot_prediction(
    runs: Sequence[str], measured, predicted, title: str = "Predicted by the other runs"
) -> Figure:
    """Predicted against measured yaw rate and lateral acceleration.

    Parameters
    ----------
    runs : sequence of str, length n
        Run of each steady segment.
    measured, predicted : array_like, shape (n, 2)
        Yaw rate [rad/s] and lateral acceleration [m/s^2]; NaN where nothing is predicted.
    title : str, optional

    Returns
    -------
    matplotlib.figure.Figure
    """
    measured, predicted = np.asarray(measured), np.asarray(predicted)
    names = list(dict.fromkeys(runs))
    figure = new_figure(11.0, 5.2)
    for column, quantity in enumerate(("yaw rate [rad/s]", "lateral acceleration [m/s²]")):
        axes = figure.add_subplot(1, 2, column + 1)
        top = 1.12 * float(np.nanmax(np.abs(measured[:, column])))
        line = np.linspace(-top, top, 2)
        axes.fill_between(line, 0.9 * line, 1.1 * line, color="0.92", label="±10 %", zorder=0)
        axes.fill_between(line, 0.95 * line, 1.05 * line, color="0.82", label="±5 %", zorder=1)
        axes.plot(line, line, color="0.4", lw=0.8, zorder=2)
        for number, name in enumerate(names):
            own = np.array([run == name for run in runs])
            axes.plot(
                measured[own, column],
                predicted[own, column],
                marker="osD^vP"[number // len(COLORS) % 6],
                ls="",
                color=COLORS[number % len(COLORS)],
                ms=5,
                alpha=0.85,
                label=name,
                zorder=3,
            )
        axes.set_xlim(-top, top)
        axes.set_ylim(-top, top)
        axes.set_xlabel(f"measured {quantity}")
        axes.set_ylabel(f"predicted {quantity}")
        axes.grid(alpha=0.25)
        handles, labels = axes.get_legend_handles_labels()
    figure.suptitle(title)
    # Runs may be many, with long names: one legend for both, beneath.
    rows = -(-len(labels) // 4)
    height = figure.get_figheight() + 0.2 * rows + 0.1
    figure.set_figheight(height)
    figure.legend(handles, labels, loc="lower center", ncol=4, fontsize="small", frameon=False)
    return finished(figure, top=1.0 - 0.1 / height, bottom=(0.2 * rows + 0.1) / height)


def plot_drive(drive: DriveFigure) -> Figure:
    """Speed, steering, yaw rate and lateral acceleration of a drive; steady segments are shaded."""
    figure = new_figure(10.0, 7.0)
    rows = (
        ("speed [m/s]", drive.v),
        ("steering [rad]", drive.delta),
        ("yaw rate [rad/s]", drive.r),
        ("lat. acceleration [m/s²]", drive.a_y),
    )
    first = None
    for number, (label, values) in enumerate(rows):
        axes = figure.add_subplot(len(rows), 1, number + 1, sharex=first)
        first = first or axes
        for cut in drive.segments:
            axes.axvspan(drive.t[cut][0], drive.t[cut][-1], color=COLORS[5], alpha=0.25, lw=0.0)
        last = number == len(rows) - 1
        # Broad beneath the other line, so that both are visible where they coincide.
        style = {"lw": 2.4, "alpha": 0.6, "label": "measured"} if last else {"lw": 1.3}
        axes.plot(drive.t, values, color=COLORS[0], **style)
        if last:
            style = {"color": COLORS[1], "lw": 0.9, "label": "speed × yaw rate"}
            axes.plot(drive.t, drive.v * drive.r, **style)
            legend_above(axes)
        axes.set_ylabel(label)
        axes.grid(alpha=0.25)
        if not last:
            for text in axes.get_xticklabels():
                text.set_visible(False)
    axes.set_xlabel("time [s]")
    axes.set_xlim(drive.t[0], drive.t[-1])
    figure.suptitle(f"{drive.name}: low-passed signals; shaded: steady cornering that was used")
    return finished(figure, top=0.98)
