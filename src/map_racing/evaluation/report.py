"""Results of runs as tables: for the terminal, CSV, JSON and pandas."""

from __future__ import annotations

import json
import math
from dataclasses import asdict

import pandas as pd

from ..files import replacing

__all__ = [
    "aligned",
    "lap_table",
    "summary_table",
    "to_frame",
    "to_json",
    "write_csv",
    "write_json",
]

_LAP_COLUMNS = (
    ("lap", "lap", "{:d}"),
    ("lap_time_s", "time [s]", "{:.3f}"),
    ("rms_lateral_error_m", "RMS error [m]", "{:.3f}"),
    ("mean_abs_lateral_error_m", "mean |d| [m]", "{:.3f}"),
    ("mean_lateral_error_m", "mean d [m]", "{:+.3f}"),
    ("p95_abs_lateral_error_m", "95 % [m]", "{:.3f}"),
    ("max_abs_lateral_error_m", "max [m]", "{:.3f}"),
    ("min_clearance_m", "clearance [m]", "{:.2f}"),
    ("mean_speed_mps", "mean v [m/s]", "{:.2f}"),
    ("max_speed_mps", "max v [m/s]", "{:.2f}"),
    ("reason", "not counted because", "{}"),
)


def to_frame(results):
    """Laps of several runs as a table.

    Parameters
    ----------
    results : iterable of RunResult

    Returns
    -------
    pandas.DataFrame
        A row for each stretch, valid or not, with the columns of `Lap.row` after ``bag``.
    """
    rows = [{"bag": result.source, **lap.row()} for result in results for lap in result.laps]
    return pd.DataFrame(rows, columns=list(rows[0]) if rows else ["bag"])


def to_json(results):
    """Results as plain dictionaries and lists, ``{"runs": [{"bag", "laps", "summary"}]}``.

    Values that do not exist (NaN) are None.
    """
    return {
        "runs": [
            {
                "bag": result.source,
                "laps": [_plain(lap.row()) for lap in result.laps],
                "summary": _plain(asdict(result.summary)),
                "notes": list(result.notes),
            }
            for result in results
        ]
    }


def write_csv(path, results):
    """Write the table of all laps; an existing file is replaced in one step.

    Raises
    ------
    MapRacingError
        If the file cannot be written.
    """
    with replacing(path) as file:
        to_frame(results).to_csv(file, index=False)


def write_json(path, results):
    """Write `to_json`; an existing file is replaced in one step.

    Raises
    ------
    MapRacingError
        If the file cannot be written.
    """
    with replacing(path) as file:
        json.dump(to_json(results), file, indent=1, allow_nan=False)
        file.write("\n")


def lap_table(result):
    """Text table of one run for the terminal: every stretch, then the summary.

    Parameters
    ----------
    result : RunResult

    Returns
    -------
    str
    """
    rows = [[title for _, title, _ in _LAP_COLUMNS]]
    for lap in result.laps:
        row = lap.row()
        rows.append([_text(row[name], form) for name, _, form in _LAP_COLUMNS])
    return "\n".join([*aligned(rows, left=len(_LAP_COLUMNS) - 1), "", _sentence(result.summary)])


def summary_table(named_results):
    """Text table that compares runs.

    Parameters
    ----------
    named_results : iterable of (str, RunResult)

    Returns
    -------
    str
    """
    rows = [["run", "laps", "lap time [s]", "best [s]", "RMS error [m]", "max [m]", "max v [m/s]"]]
    for name, result in named_results:
        summary = result.summary
        rows.append(
            [
                name,
                f"{summary.laps_completed}",
                _spread(summary.mean_lap_time_s, summary.std_lap_time_s),
                _text(summary.best_lap_time_s, "{:.3f}", "N.C."),
                _spread(summary.mean_rms_lateral_error_m, summary.std_rms_lateral_error_m),
                _text(summary.max_abs_lateral_error_m, "{:.3f}", "N.C."),
                _text(summary.max_speed_mps, "{:.2f}", "N.C."),
            ]
        )
    return "\n".join(aligned(rows, left=0))


def _sentence(summary):
    counted = f"{summary.laps_completed} laps counted, {summary.laps_not_counted} stretches not"
    if not summary.laps_completed:
        return f"{counted}; lap time N.C. (not completed)"
    time = _spread(summary.mean_lap_time_s, summary.std_lap_time_s)
    error = _spread(summary.mean_rms_lateral_error_m, summary.std_rms_lateral_error_m)
    return (
        f"{counted}; lap time {time} s, best {summary.best_lap_time_s:.3f} s; RMS error {error} m"
    )


def _spread(mean, deviation):
    text = _text(mean, "{:.3f}", "N.C.")
    return text if math.isnan(deviation) else f"{text} +- {deviation:.3f}"


def _text(value, form, missing="-"):
    if isinstance(value, float) and math.isnan(value):
        return missing
    return form.format(value)


def aligned(rows, left=0):
    """Lines of a text table.

    Parameters
    ----------
    rows : list of list of str
        The first has the titles.
    left : int
        Column that is aligned to the left; the others are to the right.

    Yields
    ------
    str
    """
    widths = [max(map(len, column)) for column in zip(*rows)]
    for row in rows:
        cells = (
            cell.ljust(width) if index == left else cell.rjust(width)
            for index, (cell, width) in enumerate(zip(row, widths))
        )
        yield "  ".join(cells).rstrip()


def _plain(row):
    return {
        name: None if isinstance(value, float) and math.isnan(value) else value
        for name, value in row.items()
    }
