"""Figures that commands write.

Drawing modules are imported when needed: matplotlib takes a second, and most calls draw nothing.
"""

from __future__ import annotations

import math
import re
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from ..errors import EvaluationError
from ..files import make_folder

__all__ = ["draw", "draw_check", "draw_identification", "draw_runs", "draw_table", "remove_stale"]


def draw_runs(folder: str, names: list[str], results: list) -> None:
    """Draw paths, laps and boxes of evaluated runs, and the difference between them.

    Parameters
    ----------
    folder : str
    names : list of str
        Short names of the runs.
    results : list of RunResult
    """
    titles = [_title(name) for name in names]
    figures = []
    for name, title, result in zip(names, titles, results):
        stem = name.replace("/", "_")
        if any(math.isfinite(lap.lap_time_s) for lap in result.laps):
            figures.append((f"{stem}_laps.png", "runs.plot_laps", (result, title)))
        figures.append((f"{stem}_speed.png", "runs.plot_path", (result, "speed", title)))
        figures.append((f"{stem}_error.png", "runs.plot_path", (result, "error", title)))
    named = list(zip(titles, results))
    figures.append(("boxes.png", "runs.plot_boxes", (named,)))
    _save(folder, figures)
    drawn = [file_name for file_name, *_ in figures]
    if sum(result.summary.laps_completed > 0 for result in results) > 1:
        try:
            _save(folder, [("difference.png", "runs.plot_differences", (named,))])
            drawn.append("difference.png")
        except EvaluationError as error:  # different tracks cannot be compared
            print(f"no difference.png: {error}")
    for name in names:
        remove_stale(folder, re.escape(f"{name.replace('/', '_')}_laps.png"), drawn)
    remove_stale(folder, r"difference\.png", drawn)


def _title(name):
    """Title of a figure, with dollar signs escaped: text between two of them would be a formula."""
    short = name if len(name) <= 40 else f"{name[:18]}...{name[-19:]}"
    return short.replace("$", r"\$")


def draw_table(folder: str, table) -> None:
    """Draw a `LookupTable` as surface and curves."""
    _save(folder, _table_figures(table))


def _table_figures(table):
    return [
        ("lookup_surface.png", "lookup.plot_lookup_surface", (table,)),
        ("lookup_curves.png", "lookup.plot_lookup_curves", (table,)),
    ]


def draw_identification(folder: str, found, left_out, table) -> None:
    """Draw identified tires, their data, the predictions, every run and the lookup table.

    Parameters
    ----------
    folder : str
    found : Identification or None
        If None, only the table is drawn.
    left_out : list of Prediction or None
        Runs predicted from the others; None draws the predictions of the fitted data.
    table : LookupTable
        Of the identified vehicle.
    """
    if found is None:
        _save(folder, _table_figures(table))
        return
    v, delta, a_y = (
        np.concatenate([getattr(m, key)[cut][::5] for m in found.motions for cut in m.segments()])
        for key in ("v_x", "delta", "a_y")
    )
    predicted = left_out if left_out is not None else found.predictions()
    title = "each run, from the others" if left_out is not None else "the fitted data"
    prediction = predicted, f"Steady cornering, predicted: {title}"
    figures = [
        ("tires.png", "identification.plot_tires", (found.axles,)),
        ("coverage.png", "identification.plot_coverage", (v, delta, a_y, found.largest_a_y)),
        ("prediction.png", "identification.plot_prediction", prediction),
        *_table_figures(table),
    ]
    for number, motion in enumerate(found.motions, 1):
        figures.append((f"run_{number}.png", "identification.plot_drive", (motion,)))
    _save(folder, figures)
    remove_stale(folder, r"run_\d+\.png", [file_name for file_name, *_ in figures])


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
    name = "_".join(filter(None, (table.name or "track", re.sub(r"\W+", "_", key).strip("_"))))
    arguments = table, raceline, findings, name
    return draw(folder, f"{name}_check.png", "racelines.plot_raceline", *arguments)


def draw(folder: str | Path, file_name: str, plot: str, *arguments: Any) -> Path:
    """Draw and write a figure; returns its path.

    Parameters
    ----------
    folder : str or pathlib.Path
    file_name : str
    plot : str
        Module and function in `map_racing.plots`, such as ``"experiments.plot_scaling"``.
    *arguments
        Of the function.
    """
    return _save(folder, [(file_name, plot, arguments)])


def _save(folder, figures):
    """Draw and write figures of (file name, function, arguments); the path of the last."""
    from ..plots.style import own_settings, save

    folder = make_folder(folder)
    for file_name, plot, arguments in tqdm(figures, desc="figures", disable=None, leave=False):
        path = folder / file_name
        module, function = plot.split(".")
        with own_settings():
            figure = getattr(import_module(f"..plots.{module}", __package__), function)(*arguments)
            save(figure, path)
    return path


def remove_stale(folder: str | Path, pattern: str, drawn: list[str]) -> None:
    """Remove figures of an earlier call that this call did not draw: they are outdated.

    Parameters
    ----------
    folder : str
    pattern : str
        Regular expression for their full names, which matches no other files.
    drawn : list of str
        Names of the figures of this call.
    """
    for path in sorted(Path(folder).iterdir()):
        stale = re.fullmatch(pattern, path.name) and path.name not in drawn
        if stale and path.is_file():
            path.unlink()
            print(f"{path}: removed: left over from an earlier call")
