"""Mend what is wrong in a track where it can be told how it should be."""

import numpy as np

from ...validation import FARTHEST
from ..findings import ERROR, points
from ..raceline import distinct_points
from . import checks
from .checks import examine, first_loop, overlap, raceline_of, turns_back
from .table import RacelineTable

__all__ = ["driven_columns", "repaired", "resampled", "reversed_table"]

# What is taken from a table; the rest follows from the points.
_DRIVEN = ("x", "y", "speed", "d_left", "d_right", "width")


def driven_columns(table):
    """The table with its distinct points and what cannot be recomputed from them.

    Parameters
    ----------
    table : RacelineTable

    Returns
    -------
    RacelineTable
        Columns ``x y`` and, where they are given and not all 0, ``speed`` and ``d_left d_right``.
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


def repaired(table):
    """A track with what was wrong in it mended, as far as its own numbers tell how.

    Parameters
    ----------
    table : RacelineTable

    Returns
    -------
    table : RacelineTable
        Its points, speeds and walls.
    repairs : list of str
        What was done, in order.

    Raises
    ------
    RacelineError
        If something is left that makes the track unusable.
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
        _first_loop_only,  # again: points in a wrong order hide it
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


def reversed_table(table):
    """The track driven the other way round, from the same first point.

    Parameters
    ----------
    table : RacelineTable
        As of `driven_columns`.

    Returns
    -------
    RacelineTable
    """
    index = -np.arange(table.columns["x"].size)
    table = _chosen(table, index)
    columns = dict(table.columns)
    if "d_left" in columns:
        columns["d_left"], columns["d_right"] = columns["d_right"], columns["d_left"]
    return table._replace(columns=columns)


def resampled(table, spacing):
    """The same curve through points at equal distances.

    Parameters
    ----------
    table : RacelineTable
        As of `driven_columns`.
    spacing : float
        Distance between the points [m], rounded so that they divide the lap evenly.

    Returns
    -------
    RacelineTable
        Without lines of a file.

    Raises
    ------
    RacelineError
        If the track cannot be used.
    """
    raceline = raceline_of(table)
    count = max(4, int(round(raceline.length / spacing)))
    return _sampled(table, raceline, np.arange(count) * (raceline.length / count))


# -- single repairs: the table, and what was done ------------------------------------------------


def _codes(table):
    return {finding.code for finding in examine(table).findings}


def _chosen(table, rows):
    """The table with some of its points."""
    return table._replace(
        columns={key: np.asarray(column)[rows] for key, column in table.columns.items()},
        lines=None if table.lines is None else table.lines[rows],
    )


def _kept(table, rows):
    """The table with some of its points, of which two may be one now that none is in between."""
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
        raceline_of(table)  # says what is wrong
    if not bad.any():
        return table, None
    return _chosen(table, np.flatnonzero(~bad)), f"{points(bad.sum())} without position dropped"


def _fill(table, codes):
    """Speeds and widths that are no numbers, from their neighbors."""
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
    """Points against the direction that both arc length and heading give."""
    if not {"reversed-arc-length", "heading-against"} <= codes:
        return table, None
    rows = np.arange(table.columns["x"].size)[::-1]
    return _chosen(table, rows), "points put in the order of arc length and heading"


def _kmh(table, codes):
    if "kmh" not in codes:
        return table, None
    columns = dict(table.columns, speed=table.columns["speed"] / checks.KMH)
    done = "speeds turned from km/h into m/s, as the accelerations say"
    return table._replace(columns=columns), done


def _stated_only(table, codes):
    """What the file says of the curve is recomputed: from here on only the rest counts."""
    told = {
        "heading": "heading",
        "curvature": "curvature",
        "arc-length": "arc length",
        "reversed-arc": "arc length",
        "acceleration": "accelerations",
    }
    wrong = {
        what
        for code in codes - {"heading-x", "heading-north"}
        for start, what in told.items()
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
    found = first_loop(_xy(table))
    if found is None:
        return table, None
    end, loops = found
    return _kept(table, np.arange(end)), f"only the first of {loops} loops kept"


def _drop_overlap(table, codes):
    count = overlap(_xy(table))
    if not count:
        return table, None
    rows = np.arange(table.columns["x"].size - count)
    return _kept(table, rows), f"{points(count, 'last')} dropped that overlapped the start"


def _drop_turning_back(table, codes):
    """Around each place where the way turns back, the point that is the longest detour."""
    xy = _xy(table)
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
    """Points along the closed curve where they are missing or uneven."""
    if not {"gap", "spacing"} & codes or examine(table).worst(ERROR):
        return table, None
    line = raceline_of(table)
    steps = np.diff(np.append(line.s_points, line.length))
    usual = float(np.median(steps))
    most = checks.LARGEST_GAP if "spacing" not in codes else 1.5
    count = np.where(steps > most * usual, np.round(steps / usual), 1).astype(int)
    first = np.repeat(line.s_points, count)
    part = np.arange(first.size) - np.repeat(np.cumsum(count) - count, count)
    s = first + part * np.repeat(steps / count, count)
    added = first.size - steps.size
    sampled = _sampled(table, line, s)
    # The points given stay as they are.
    for key, column in sampled.columns.items():
        column[part == 0] = table.columns[key]
    return sampled, f"{points(added)} added along the curve where they were far apart"


def _xy(table):
    return np.stack((table.columns["x"], table.columns["y"]), axis=1)
