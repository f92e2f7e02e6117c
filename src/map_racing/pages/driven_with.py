"""Section of the report on files, notes and settings."""

from __future__ import annotations

from ..evaluation.analysis import RunAnalysis
from .html import heading_of, table

__all__ = ["driven_with"]

# Most notes on a page.
_MOST_NOTES = 60


def driven_with(runs: list[RunAnalysis]) -> str:
    """File, notes and settings of each run; several runs side by side, differences first."""
    parts = ['<section id="driven-with"><h2>Driven with</h2>\n']
    settled = [run for run in runs if run.settings is not None]
    for run in runs:
        parts.append(heading_of(run.name, runs))
        rows = [["file", run.result.source], *_notes(run)]
        if run.settings is None:
            rows.append(["settings", "none in the recording"])
        elif len(settled) == 1:
            rows += _flat(run.settings.values)
        parts.append(table(["what", "value"], rows, "settings"))
    if len(settled) > 1:
        parts.append(_side_by_side(settled))
    return "".join([*parts, "</section>\n"])


def _side_by_side(runs):
    """Settings of several runs, a column for each, differences first."""
    columns = [dict(_flat(run.settings.values)) for run in runs]
    keys = list(dict.fromkeys(key for column in columns for key in column))
    rows = [[key, *(column.get(key, "–") for column in columns)] for key in keys]
    other = [row for row in rows if len(set(row[1:])) > 1]
    same = [row[:2] for row in rows if len(set(row[1:])) == 1]
    parts = ["<h3>What differs</h3>\n", table(["what", *(run.name for run in runs)], other)]
    if not other:
        parts[1] = '<p class="hint">Nothing: all runs have the same settings.</p>\n'
    parts += ["<h3>The same in all</h3>\n", table(["what", "value"], same, "settings")]
    return "".join(parts)


def _notes(run):
    notes = [*run.result.notes, *run.notes]
    return [["note", note] for note in list(dict.fromkeys(notes))[:_MOST_NOTES]]


def _flat(values, before=""):
    """Rows of nested settings."""
    rows = []
    for key, value in values.items():
        if isinstance(value, dict):
            rows += _flat(value, f"{before}{key}: ")
        elif isinstance(value, list) and value and isinstance(value[0], dict):
            for number, part in enumerate(value):
                rows += _flat(part, f"{before}{key} {number}: ")
        else:
            rows.append([f"{before}{key}", _plain(value)])
    return rows


def _plain(value):
    if isinstance(value, list):
        return ", ".join(map(_plain, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
