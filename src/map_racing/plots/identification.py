"""Figures of identified tires: points and curves, coverage, prediction, and drives."""

from __future__ import annotations

from typing import Any, Mapping, Sequence

import numpy as np
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from .style import COLORS, finished, legend_above, new_figure

__all__ = ["plot_coverage", "plot_drive", "plot_prediction", "plot_tires"]


def plot_tires(axles: Mapping[str, Any]) -> Figure:
    """Points, rejected points and fitted curves of each axle at its static load.

    Parameters
    ----------
    axles : dict of str to Axle
        See `map_racing.identification.identify`; left turns are drawn as positive.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = new_figure(5.6 * len(axles), 4.8)
    for number, (name, (points, fit, regression)) in enumerate(axles.items(), 1):
        axes = figure.add_subplot(1, len(axles), number)
        slip, force, load, inlier = -points.slip, points.force, points.load, fit.inlier
        top = 1.25 * float(np.percentile(np.abs(force[inlier]), 99.0))
        widest = 1.35 * max(fit.covered_slip, 1e-4)
        axes.plot(
            slip[inlier],
            force[inlier],
            ".",
            color=COLORS[0],
            ms=4,
            alpha=0.35,
            mew=0.0,
            label=f"{np.count_nonzero(inlier)} points",
        )
        if not inlier.all():
            axes.plot(
                slip[~inlier],
                force[~inlier],
                "x",
                color=COLORS[4],
                ms=4,
                alpha=0.7,
                label=f"{np.count_nonzero(~inlier)} rejected",
            )
        slip = np.linspace(-widest, widest, 401)
        curve, linear = (load * one.tire.normalized_force(slip) for one in (fit, regression))
        inside = np.where(np.abs(slip) <= fit.covered_slip, curve, np.nan)
        axes.plot(slip, linear, color="0.4", lw=1.2, ls="-.", label="linear tire")
        axes.plot(slip, curve, color=COLORS[1], lw=1.4, ls=":", label="extrapolated")
        axes.plot(slip, inside, color=COLORS[1], lw=2.2, label="Pacejka")
        axes.set_xlim(-widest, widest)
        axes.set_ylim(-top, top)
        axes.axhline(0.0, color="0.8", lw=0.8, zorder=0)
        axes.axvline(0.0, color="0.8", lw=0.8, zorder=0)
        axes.set_xlabel("slip angle [rad], positive in left turns")
        axes.set_ylabel("lateral force [N]")
        axes.grid(alpha=0.25)
        legend_above(axes, f"{name} axle, static load {load:.1f} N", columns=5)
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


def plot_prediction(predictions: Sequence[Any], title: str) -> Figure:
    """Predicted against measured yaw rate and lateral acceleration.

    Parameters
    ----------
    predictions : list of Prediction
        See `map_racing.identification.identify`.
    title : str

    Returns
    -------
    matplotlib.figure.Figure
    """
    runs = [p.run for p in predictions]
    measured = np.array([(p.r, p.a_y) for p in predictions])
    predicted = np.array([(p.r_predicted, p.a_y_predicted) for p in predictions])
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
    # There may be many runs with long names: one legend for both, below.
    rows = -(-len(labels) // 4)
    height = figure.get_figheight() + 0.2 * rows + 0.1
    figure.set_figheight(height)
    figure.legend(handles, labels, loc="lower center", ncol=4, fontsize="small", frameon=False)
    return finished(figure, top=1.0 - 0.1 / height, bottom=(0.2 * rows + 0.1) / height)


def plot_drive(drive: Any) -> Figure:
    """Speed, steering, yaw rate and lateral acceleration of a drive; steady segments are shaded.

    Parameters
    ----------
    drive : ProcessedRun
        See `map_racing.identification.cornering`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    figure = new_figure(10.0, 7.0)
    rows = (
        ("speed [m/s]", drive.v_x),
        ("steering [rad]", drive.delta),
        ("yaw rate [rad/s]", drive.r),
        ("lat. acceleration [m/s²]", drive.a_y),
    )
    first = None
    for number, (label, values) in enumerate(rows):
        axes = figure.add_subplot(len(rows), 1, number + 1, sharex=first)
        first = first or axes
        for cut in drive.segments():
            axes.axvspan(drive.t[cut][0], drive.t[cut][-1], color=COLORS[5], alpha=0.25, lw=0.0)
        last = number == len(rows) - 1
        # A broad line below the other, so that both are visible where they coincide.
        style = {"lw": 2.4, "alpha": 0.6, "label": "measured"} if last else {"lw": 1.3}
        axes.plot(drive.t, values, color=COLORS[0], **style)
        if last:
            style = {"color": COLORS[1], "lw": 0.9, "label": "speed × yaw rate"}
            axes.plot(drive.t, drive.v_x * drive.r, **style)
            legend_above(axes)
        axes.set_ylabel(label)
        axes.grid(alpha=0.25)
        if not last:
            for text in axes.get_xticklabels():
                text.set_visible(False)
    axes.set_xlabel("time [s]")
    axes.set_xlim(drive.t[0], drive.t[-1])
    shaded = "shaded: steady cornering that was used"
    figure.suptitle(f"{drive.run.label}: low-passed signals; {shaded}")
    return finished(figure, top=0.98)
