"""Tables of laps for the terminal, CSV and JSON."""

from __future__ import annotations

import csv
import math
from dataclasses import asdict
from pathlib import Path
from typing import Iterable, Iterator, Sequence

from ..files import replacing
from ..printing import amount
from .results import RunResult

__all__ = [
    "aligned",
    "csv_cells",
    "lap_data",
    "lap_table",
    "summary_table",
    "write_csv",
    "write_rows",
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


def _rows(results):
    return [
        {"bag": result.source, **lap.row(), "warnings": "; ".join(result.warnings)}
        for result in results
        for lap in result.laps
    ]


def lap_data(results: Iterable[RunResult]) -> dict:
    """Results as plain dictionaries and lists, ``{"runs": [{"bag", "laps", "summary"}]}``."""
    return {
        "runs": [
            {
                "bag": result.source,
                "laps": [lap.row() for lap in result.laps],
                "summary": asdict(result.summary),
                "notes": list(result.notes),
            }
            for result in results
        ]
    }


def csv_cells(values: Iterable[object]) -> list:
    """Cells of a CSV file, empty for NaN."""
    return ["" if isinstance(value, float) and math.isnan(value) else value for value in values]


def write_csv(path: str | Path, results: Iterable[RunResult]) -> None:
    """Write the table of all laps; an existing file is replaced in one step.

    Raises
    ------
    MapRacingError
        If the file cannot be written.
    """
    rows = _rows(results)
    write_rows(path, list(rows[0]) if rows else ["bag"], rows)


def write_rows(path: str | Path, columns: Sequence[str], rows: Iterable[dict]) -> None:
    """Write rows, which map column names to values; NaN becomes an empty cell.

    Raises
    ------
    MapRacingError
        If the file cannot be written.
    """
    with replacing(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(csv_cells(row[name] for name in columns) for row in rows)


def lap_table(result: RunResult) -> str:
    """Text table of one run: every lap or partial lap, then the summary."""
    rows = [[title for _, title, _ in _LAP_COLUMNS]]
    for lap in result.laps:
        row = lap.row()
        rows.append([_text(row[name], form) for name, _, form in _LAP_COLUMNS])
    return "\n".join([*aligned(rows, left=len(_LAP_COLUMNS) - 1), "", _sentence(result)])


def summary_table(named_results: Iterable[tuple[str, RunResult]]) -> str:
    """Text table that compares runs.

    Parameters
    ----------
    named_results : iterable of (str, RunResult)

    Returns
    -------
    str
    """
    rows = [["run", "laps", "lap time [s]", "best [s]", "RMS error [m]", "max [m]", "max v [m/s]"]]
    said = []
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
        said += [f"{name}: warning: {warning}" for warning in result.warnings]
    return "\n".join([*aligned(rows, left=0), *said])


def _sentence(result):
    summary = result.summary
    counted = f"{amount(summary.laps_completed, 'lap')} counted, "
    counted += f"{amount(summary.laps_not_counted, 'stretch', 'stretches')} not"
    if not summary.laps_completed:
        driven = [lap for lap in result.laps if not math.isnan(lap.lap_time_s)]
        if not driven:
            return f"{counted}; lap time N.C. (not completed)"
        off = sum("off track" in lap.reason for lap in driven)
        why = f", {off} of them off track: --max-deviation sets another limit" if off else ""
        return f"{counted}; {amount(len(driven), 'lap')} driven, but none counts{why}"
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


def aligned(rows: list[list[str]], left: int = 0) -> Iterator[str]:
    """Lines of a text table.

    Parameters
    ----------
    rows : list of list of str
        The titles, then the cells.
    left : int
        Index of the left-aligned column; the others are right-aligned.

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
