"""Repair of racelines, where their own numbers show how."""

from __future__ import annotations

import numpy as np

from ...validation import FARTHEST
from ..findings import ERROR, points
from ..loops import LARGEST_GAP, first_loop, overlap, turns_back
from ..spline import distinct_points
from .check_speeds import KMH
from .checks import examine, raceline_of
from .table import RacelineTable

__all__ = ["driven_columns", "repaired", "resampled", "reversed_table"]

# Columns taken from a table; the rest follows from the points.
_DRIVEN = ("x", "y", "speed", "d_left", "d_right", "width")


def driven_columns(table: RacelineTable) -> RacelineTable:
    """Reduce a table to its distinct points and what cannot be recomputed from them.

    These are the columns ``x y`` and, where given and not all 0, ``speed`` and ``d_left d_right``.
    """
    columns = {key: np.asarray(c, float) for key, c in table.columns.items() if key in _DRIVEN}
    if "width" in columns:
        columns["d_left"] = columns["d_right"] = 0.5 * columns.pop("width")
    for keys in (("speed",), ("d_left", "d_right")):
        there = [key for key in keys if key in columns]
        if len(there) < len(keys) or not any(np.any(columns[key]) for key in there):
            for key in there:
                del columns[key]
    keep = distinct_points(columns["x"], columns["y"])
    return _chosen(table._replace(columns=columns), np.flatnonzero(keep))


def repaired(table: RacelineTable) -> tuple[RacelineTable, list[str]]:
    """Repair a table where its own numbers show how.

    Parameters
    ----------
    table : RacelineTable

    Returns
    -------
    table : RacelineTable
        Its points, speeds and walls.
    repairs : list of str
        The repairs made, in order.

    Raises
    ------
    RacelineError
        If what remains is unusable.
    """
    repairs = []
    table = table._replace(findings=())
    codes = _codes(table)
    for repair in (
        _drop_rows,
        _fill,
        _swap_xy,
        _reverse,
        _kmh,
        _stated_only,
        _drop_repeated,
        _first_loop_only,
        _drop_overlap,
        _drop_turning_back,
        _first_loop_only,  # again: points in a wrong order had hidden it
        _drop_overlap,
        _swap_walls,
        _clamp_walls,
        _fill_gap,
    ):
        table, done = repair(table, codes)
        if done:
            repairs.append(done)
            codes = _codes(table)
    raceline_of(table)
    return table, repairs


def reversed_table(table: RacelineTable) -> RacelineTable:
    """Reverse the direction of travel of a table from `driven_columns`, keeping the first point."""
    index = -np.arange(table.columns["x"].size)
    table = _chosen(table, index)
    columns = dict(table.columns)
    if "d_left" in columns:
        columns["d_left"], columns["d_right"] = columns["d_right"], columns["d_left"]
    return table._replace(columns=columns)


def resampled(table: RacelineTable, spacing: float) -> RacelineTable:
    """Sample the curve of a table at equal distances.

    Parameters
    ----------
    table : RacelineTable
        From `driven_columns`.
    spacing : float
        Distance between the points [m], rounded so that they divide the lap evenly.

    Returns
    -------
    RacelineTable
        Without line numbers.

    Raises
    ------
    RacelineError
        If the table has errors.
    """
    raceline = raceline_of(table)
    count = max(4, int(round(raceline.length / spacing)))
    return _sampled(table, raceline, np.arange(count) * (raceline.length / count))


# -- single repairs: each returns the table, and what was done or None --------------------------


def _codes(table):
    return {finding.code for finding in examine(table).findings}


def _chosen(table, rows):
    """Table with some of its rows."""
    return table._replace(
        columns={key: np.asarray(column)[rows] for key, column in table.columns.items()},
        lines=None if table.lines is None else table.lines[rows],
    )


def _kept(table, rows):
    """Table with some of its rows; points that now repeat their neighbor are dropped, too."""
    return driven_columns(_chosen(table, rows))


def _sampled(table, raceline, s):
    at = raceline.sample(s)
    columns = {"x": at.x, "y": at.y, "speed": at.speed, "d_left": at.d_left, "d_right": at.d_right}
    columns = {key: column for key, column in columns.items() if column is not None}
    return RacelineTable(columns, table.name, table.source, table.layout)


def _drop_rows(table, codes):
    """Points without a position."""
    x, y = table.columns["x"], table.columns["y"]
    bad = _impossible(x) | _impossible(y)
    if bad.all():
        raceline_of(table)  # raises the error
    if not bad.any():
        return table, None
    return _chosen(table, np.flatnonzero(~bad)), f"{points(bad.sum())} without position dropped"


def _fill(table, codes):
    """Invalid speeds and widths, from their neighbors."""
    columns, filled = dict(table.columns), []
    for key in ("speed", "d_left", "d_right", "width"):
        column = columns.get(key)
        if column is None:
            continue
        bad = _impossible(column)
        if bad.any() and not bad.all():
            place = np.arange(column.size)
            columns[key] = np.interp(place, place[~bad], column[~bad], period=column.size)
            filled.append(f"{bad.sum()} values of {key}")
    if not filled:
        return table, None
    return table._replace(columns=columns), f"{', '.join(filled)} filled in from their neighbors"


def _impossible(column):
    return ~(np.abs(np.where(np.isfinite(column), column, np.inf)) < FARTHEST)


def _swap_xy(table, codes):
    if "swapped-xy" not in codes:
        return table, None
    columns = dict(table.columns, x=table.columns["y"], y=table.columns["x"])
    return table._replace(columns=columns), "x and y exchanged, as heading and curvature say"


def _reverse(table, codes):
    """Points against the direction of both arc length and heading."""
    if not {"reversed-arc-length", "heading-against"} <= codes:
        return table, None
    rows = np.arange(table.columns["x"].size)[::-1]
    return _chosen(table, rows), "points reordered along arc length and heading"


def _kmh(table, codes):
    if "kmh" not in codes:
        return table, None
    columns = dict(table.columns, speed=table.columns["speed"] / KMH)
    done = "speeds converted from km/h to m/s, as the accelerations say"
    return table._replace(columns=columns), done


def _stated_only(table, codes):
    """Drop what is stated of the curve: it is recomputed from the points."""
    stated = {
        "heading": "heading",
        "curvature": "curvature",
        "arc-length": "arc length",
        "reversed-arc": "arc length",
        "acceleration": "accelerations",
    }
    wrong = {
        what
        for code in codes - {"heading-x", "heading-north"}
        for start, what in stated.items()
        if code.startswith(start)
    }
    columns = {key: column for key, column in table.columns.items() if key in _DRIVEN}
    done = f"{', '.join(sorted(wrong))} recomputed" if wrong else None
    return table._replace(columns=columns), done


def _drop_repeated(table, codes):
    before = table.columns["x"].size
    x, y = table.columns["x"], table.columns["y"]
    keep = distinct_points(x, y)
    closing = before - 1 - int(np.flatnonzero(keep)[-1])
    table = driven_columns(table)
    count = before - closing - table.columns["x"].size
    return table, f"{points(count, 'repeated')} dropped" if count else None


def _first_loop_only(table, codes):
    found = first_loop(table.xy)
    if found is None:
        return table, None
    end, loops = found
    return _kept(table, np.arange(end)), f"only the first of {loops} loops kept"


def _drop_overlap(table, codes):
    count = overlap(table.xy)
    if not count:
        return table, None
    rows = np.arange(table.columns["x"].size - count)
    return _kept(table, rows), f"{points(count, 'last')} dropped that overlapped the start"


def _drop_turning_back(table, codes):
    """Where the way turns back, drop the point that makes the longest detour, one by one."""
    xy = table.xy
    rows = np.arange(len(xy))
    for _ in range(len(xy) // 20):
        back = turns_back(xy[rows])
        if not back.size:
            break
        n = rows.size
        near = np.unique(np.mod(np.concatenate((back - 1, back, back + 1)), n))
        before, here, after = (xy[rows[np.mod(near + step, n)]] for step in (-1, 0, 1))
        detour = _length(here - before) + _length(after - here) - _length(after - before)
        rows = np.delete(rows, near[int(np.argmax(detour))])
        rows = rows[distinct_points(*xy[rows].T)]
    count = len(xy) - rows.size
    if not count or turns_back(xy[rows]).size:
        return table, None
    return _kept(table, rows), f"{points(count)} dropped at which the track turned back"


def _length(ways):
    return np.hypot(ways[:, 0], ways[:, 1])


def _swap_walls(table, codes):
    if "swapped-walls" not in codes:
        return table, None
    columns = dict(table.columns)
    columns["d_left"], columns["d_right"] = columns["d_right"], columns["d_left"]
    return table._replace(columns=columns), "left and right walls exchanged, as their shape says"


def _clamp_walls(table, codes):
    columns, count = dict(table.columns), 0
    for key in ("d_left", "d_right"):
        if key in columns:
            count += int(np.sum(columns[key] < 0.0))
            columns[key] = np.maximum(columns[key], 0.0)
    text = f"{count} negative distances to walls set to 0" if count else None
    return table._replace(columns=columns), text


def _fill_gap(table, codes):
    """Add points along the closed curve where they are missing or uneven."""
    if not {"gap", "spacing"} & codes or examine(table).worst(ERROR):
        return table, None
    line = raceline_of(table)
    steps = np.diff(np.append(line.s_points, line.length))
    usual = float(np.median(steps))
    most = LARGEST_GAP if "spacing" not in codes else 1.5
    count = np.where(steps > most * usual, np.round(steps / usual), 1).astype(int)
    first = np.repeat(line.s_points, count)
    part = np.arange(first.size) - np.repeat(np.cumsum(count) - count, count)
    s = first + part * np.repeat(steps / count, count)
    added = first.size - steps.size
    sampled = _sampled(table, line, s)
    # The given points stay exactly as they are.
    for key, column in sampled.columns.items():
        column[part == 0] = table.columns[key]
    return sampled, f"{points(added)} added along the curve where they were far apart"
