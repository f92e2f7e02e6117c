"""Figures that commands write.

Each function imports what it draws with: matplotlib takes a second, and most calls draw nothing.
"""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ..errors import EvaluationError
from ..files import make_folder

__all__ = [
    "draw_check",
    "draw_comparison",
    "draw_identification",
    "draw_optimized",
    "draw_robustness",
    "draw_runs",
    "draw_scaling",
    "draw_table",
    "draw_trajectories",
    "remove_stale",
]


def draw_runs(folder: str, names: list[str], results: list) -> None:
    """Draw paths, laps and boxes of evaluated runs, and the difference between them.

    Parameters
    ----------
    folder : str
    names : list of str
        Short names of the runs.
    results : list of RunResult
    """
    from ..plots import runs

    titles = [_title(name) for name in names]
    figures = []
    for name, title, result in zip(names, titles, results):
        stem = name.replace("/", "_")
        if any(math.isfinite(lap.lap_time_s) for lap in result.laps):
            figures.append((f"{stem}_laps.png", runs.plot_laps, (result, title)))
        figures.append((f"{stem}_speed.png", runs.plot_path, (result, "speed", title)))
        figures.append((f"{stem}_error.png", runs.plot_path, (result, "error", title)))
    named = list(zip(titles, results))
    figures.append(("boxes.png", runs.plot_boxes, (named,)))
    _save(folder, figures)
    drawn = [file_name for file_name, *_ in figures]
    if sum(result.summary.laps_completed > 0 for result in results) > 1:
        try:
            _save(folder, [("difference.png", runs.plot_differences, (named,))])
            drawn.append("difference.png")
        except EvaluationError as error:  # different tracks cannot be compared
            print(f"no difference.png: {error}")
    for name in names:
        remove_stale(folder, re.escape(f"{name.replace('/', '_')}_laps.png"), drawn)
    remove_stale(folder, r"difference\.png", drawn)


def _title(name):
    """Title of a figure, where text between two dollars would be a formula."""
    short = name if len(name) <= 40 else f"{name[:18]}...{name[-19:]}"
    return short.replace("$", r"\$")


def draw_table(folder: str, table) -> None:
    """Draw a `LookupTable` as surface and curves."""
    _save(folder, _table_figures(table))


def _table_figures(table):
    from ..plots.lookup import plot_lookup_curves, plot_lookup_surface

    grid = table.speeds, table.angles, table.a_lat
    return [
        ("lookup_surface.png", plot_lookup_surface, grid),
        ("lookup_curves.png", plot_lookup_curves, grid),
    ]


def draw_identification(folder: str, found, left_out, table) -> None:
    """Draw identified tires, their data, the predictions, every run and the lookup table.

    Parameters
    ----------
    folder : str
    found : Identification or None
        Without one only the table is drawn.
    left_out : list of Prediction or None
        Runs predicted from the others; None draws the predictions of the fitted data.
    table : LookupTable
        Of the identified vehicle.
    """
    from ..plots import identification as plots

    if found is None:
        _save(folder, _table_figures(table))
        return
    axles = []
    for name, (points, fit, linear) in found.axles.items():
        axles.append(
            plots.AxleFigure(
                name=name,
                slip=-points.slip,
                force=points.force,
                inlier=fit.inlier,
                curve=_force(fit.tire, points.load),
                linear=_force(linear.tire, points.load),
                covered=fit.covered_slip,
                load=points.load,
            )
        )
    v, delta, a_y = (
        np.concatenate([getattr(m, key)[cut][::5] for m in found.motions for cut in m.segments()])
        for key in ("v_x", "delta", "a_y")
    )
    predicted = left_out if left_out is not None else found.predictions()
    title = "each run, from the others" if left_out is not None else "the fitted data"
    prediction = (
        [p.run for p in predicted],
        [(p.r, p.a_y) for p in predicted],
        [(p.r_predicted, p.a_y_predicted) for p in predicted],
        f"Steady cornering, predicted: {title}",
    )
    figures = [
        ("tires.png", plots.plot_tires, (axles,)),
        ("coverage.png", plots.plot_coverage, (v, delta, a_y, found.largest_a_y)),
        ("prediction.png", plots.plot_prediction, prediction),
        *_table_figures(table),
    ]
    for number, m in enumerate(found.motions, 1):
        drive = plots.DriveFigure(m.run.label, m.t, m.v_x, m.delta, m.r, m.a_y, m.segments())
        figures.append((f"run_{number}.png", plots.plot_drive, (drive,)))
    _save(folder, figures)
    remove_stale(folder, r"run_\d+\.png", [file_name for file_name, *_ in figures])


def _force(tire, load):
    return lambda slip: load * tire.normalized_force(slip)


def draw_check(folder: str, key: str, table, raceline, findings) -> Path:
    """Draw a checked raceline and the places of its findings; returns the path of the figure.

    Parameters
    ----------
    folder, key : str
        Folder of the figure, and the key of the source, see `split_source`.
    table : RacelineTable
    raceline : Raceline or None
    findings : sequence of Finding
    """
    from ..plots.racelines import plot_raceline

    name = "_".join(filter(None, (table.name or "track", re.sub(r"\W+", "_", key).strip("_"))))
    return _save(folder, [(f"{name}_check.png", plot_raceline, (table, raceline, findings, name))])


def draw_optimized(folder: str, optimized, middle, walls, image=None) -> Path:
    """Draw an optimized raceline, over its map if there is one; returns the path of the figure."""
    from ..plots.optimization import plot_optimized

    name = f"{optimized.name or 'track'}_optimized.png"
    return _save(folder, [(name, plot_optimized, (optimized, middle, walls, image))])


def draw_scaling(folder: str, laps, ended: dict, labels: list[str], title: str) -> None:
    """Draw the laps of velocity scaling; arguments as in `plot_scaling`."""
    from ..plots.experiments import plot_scaling

    _save(folder, [("velocity_scaling.png", plot_scaling, (laps, ended, labels, title))])


def draw_robustness(folder: str, races, title: str, label: str) -> Path:
    """Draw the races of one controller over tracks and cars; arguments as in `plot_robustness`."""
    from ..plots.experiments import plot_robustness

    return _save(folder, [(f"robustness_{label}.png", plot_robustness, (races, title))])


def draw_trajectories(folder: str, raceline, rows: list, title: str, seed: int) -> Path:
    """Draw the driven paths of one race day; arguments as in `plot_trajectories`."""
    from ..plots.experiments import plot_trajectories

    name = f"trajectories_seed{seed}.png"
    return _save(folder, [(name, plot_trajectories, (raceline, rows, title))])


def draw_comparison(folder: str, comparison, names: tuple[str, str]) -> Path:
    """Draw two result directories side by side; returns the path of the figure."""
    from ..plots.experiments import plot_comparison

    arguments = (comparison.table, comparison.values, names, comparison.kind)
    return _save(folder, [("comparison.png", plot_comparison, arguments)])


def _save(folder, figures):
    """Draw and write figures of (file name, function, arguments); the path of the last."""
    from ..plots.style import own_settings, save

    folder = make_folder(folder)
    for file_name, plot, arguments in tqdm(figures, desc="figures", disable=None, leave=False):
        path = folder / file_name
        with own_settings():
            save(plot(*arguments), path)
    return path


def remove_stale(folder: str | Path, pattern: str, drawn: list[str]) -> None:
    """Remove figures of an earlier call that this one did not draw: they show something else.

    Parameters
    ----------
    folder : str
    pattern : str
        Regular expression of their whole names, in which nobody else's files fit.
    drawn : list of str
        Names of the figures of this call.
    """
    for path in sorted(Path(folder).iterdir()):
        stale = re.fullmatch(pattern, path.name) and path.name not in drawn
        if stale and path.is_file():
            path.unlink()
            print(f"{path}: removed: left over from an earlier call")
