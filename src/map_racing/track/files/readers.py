"""Raceline files: one reader for the family of layouts in use.

What a column means is looked up in two tables, `ALIASES` for files that name their columns and
`LAYOUTS` for files that do not. Only positions, speeds and widths are taken from a file. Heading,
curvature and arc length follow from the positions; where a file states them they are compared
(:mod:`.checks`), because files of different origin have different headings under one and the same
header line. The outcome is told in `Raceline.findings`. Files are written by :mod:`.writers`.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, Mapping

import numpy as np

from ...angles import wrap
from ...errors import FileFormatError
from ...resources import find_config
from ...tables import is_number, open_text, parse_rows
from ..findings import NOTE, WARNING, Finding
from ..spline import distinct_points
from .checks import raceline_of
from .table import RacelineTable

__all__ = [
    "ALIASES",
    "LAYOUTS",
    "columns_of_waypoints",
    "find_raceline_file",
    "raceline_from_columns",
    "read_raceline_file",
    "split_source",
]

# Names of columns in files and messages, compared in lower case.
ALIASES = {
    "s": ("s_m", "s", "s_racetraj_m"),
    "x": ("x_m", "x"),
    "y": ("y_m", "y"),
    "psi": ("psi_rad", "psi", "yaw", "theta", "heading_rad", "psi_racetraj_rad"),
    "kappa": ("kappa_radpm", "kappa", "curvature", "kappa_racetraj_radpm"),
    "speed": (
        *("vx_mps", "v_mps", "vx", "v", "speed", "speed_mps", "velocity"),
        "vx_racetraj_mps",
    ),
    "ax": ("ax_mps2", "ax", "ax_racetraj_mps2"),
    "d_right": (
        *("d_right_m", "d_right", "w_tr_right_m", "w_right_m", "d_right_iqp", "d_right_sp"),
        "width_right_m",
    ),
    "d_left": (
        *("d_left_m", "d_left", "w_tr_left_m", "w_left_m", "d_left_iqp", "d_left_sp"),
        "width_left_m",
    ),
    "width": ("w_tr_m", "width_m", "width"),
    # A reference line, from which the track lies `alpha` along the normal; it has the widths.
    "x_ref": ("x_ref_m", "x_ref"),
    "y_ref": ("y_ref_m", "y_ref"),
    "x_normal": ("x_normvec_m", "x_normvec"),
    "y_normal": ("y_normvec_m", "y_normvec"),
    "alpha": ("alpha_m", "alpha"),
}
_MEANING = {alias: column for column, aliases in ALIASES.items() for alias in aliases}
_REFERENCE = ("x_ref", "y_ref", "x_normal", "y_normal", "alpha")

# Files without names, by number of columns. What "third" is and which column of five is the height
# is told by the numbers, see `_unnamed`.
LAYOUTS = {
    2: ("x", "y"),
    3: ("x", "y", "third"),
    4: ("x", "y", "d_right", "d_left"),
    5: ("x", "y", "third", "fourth", "fifth"),
    7: ("s", "x", "y", "psi", "kappa", "speed", "ax"),
    8: ("s", "x", "y", "psi", "kappa", "speed", "ax", "z"),
    9: ("s", "x", "y", "psi", "kappa", "speed", "ax", "d_right", "d_left"),
    10: ("s", "x", "y", "psi", "kappa", "speed", "ax", "d_right", "d_left", "z"),
    12: (
        *("x_ref", "y_ref", "d_right", "d_left", "x_normal", "y_normal", "alpha"),
        *("s", "psi", "kappa", "speed", "ax"),
    ),
}

# Where waypoint arrays are found in a race_stack JSON file, unless told.
DEFAULT_KEY = "global_traj_wpnts_iqp"

_SUFFIXES = (".csv", ".json", ".json.gz", ".csv.gz")
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")


def find_raceline_file(source):
    """Path and key of a shipped track or a raceline file, ``NAME`` or ``FILE#KEY``."""
    text, key = split_source(source)
    return find_config("tracks", text, _SUFFIXES), key or None


def columns_of_waypoints(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Columns by the names in `ALIASES` of the fields of ``f110_msgs/Wpnt``."""
    return {_MEANING[field]: column for field, column in fields.items() if field in _MEANING}


def split_source(source):
    """Path of a track, and what in the file is meant, which may follow behind ``#``.

    Parameters
    ----------
    source : str or pathlib.Path

    Returns
    -------
    path, selector : str
        The selector is empty where there is none; names of files may contain ``#``, too.
    """
    path, mark, selector = str(source).rpartition("#")
    if not mark or Path(source).is_file():
        return str(source), ""
    return path, selector


def read_raceline_file(path, key=None):
    """Read what a CSV or JSON file, which may be gzipped, says of a track.

    Parameters
    ----------
    path : str or pathlib.Path
        CSV with comma, semicolon, tab or blanks between columns, with column names in the last
        line before the data (``#`` in front or not) or with one of the `LAYOUTS`; or JSON with
        waypoint arrays as race_stack writes it.
    key : str, optional
        Which waypoint array of a JSON file, ``"global_traj_wpnts_iqp"`` by default; or the names of
        the columns of a CSV file instead of what it says, ``"x,y,speed"``. Names that mean nothing,
        such as ``-``, leave a column out.

    Returns
    -------
    RacelineTable

    Raises
    ------
    FileFormatError
        If the file cannot be read; names line and column.
    """
    path = Path(path)
    with open_text(path) as file:
        text = file.read()
    name = path.name
    for suffix in (".gz", ".csv", ".json", ".txt"):
        name = name[: -len(suffix)] if name.lower().endswith(suffix) else name
    if text.lstrip()[:1] in ("{", "["):
        key = key or DEFAULT_KEY
        table = RacelineTable(_json_columns(text, path, key), layout=f"race_stack JSON, {key}")
    else:
        table = _csv_table(text, path, key)
    return table._replace(name=name, source=str(path))


def raceline_from_columns(columns, *, name="", source=""):
    """Raceline of columns as files and messages have them.

    Parameters
    ----------
    columns : dict of str to array_like
        Columns by their names in `ALIASES`, at least ``x`` and ``y``. ``psi``, ``kappa``, ``s`` and
        ``ax`` are compared with the curve, not used.
    name, source : str, optional
        As of `Raceline`.

    Returns
    -------
    Raceline
        With `findings`.

    Raises
    ------
    RacelineError
        If the points make no closed track.
    """
    columns = {key: np.asarray(column, dtype=float) for key, column in columns.items()}
    return raceline_of(RacelineTable(columns, name=name, source=source))


# -- CSV -------------------------------------------------------------------------------------


def _csv_table(text, path, key=None):
    """Columns of a CSV file, named by `key`, by its header or by its layout."""
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
    lines = [(number, line) for number, line in lines if line.strip("#;, \t")]
    begin = next((k for k, (_, line) in enumerate(lines) if _is_data(line)), None)
    if begin is None:
        raise FileFormatError(f"{path}: expected a raceline, found no line of numbers")
    findings = []
    data = [(number, line) for number, line in lines[begin:] if line[0] != "#"]
    separator = _separator(data[0][1])
    if separator != "," and any("," in line for _, line in data):
        data = [(number, line.replace(",", ".")) for number, line in data]
        findings.append(Finding("decimal-comma", NOTE, "decimal commas: read as points"))
    rows = [[token.strip() for token in line.split(separator)] for _, line in data]
    if all(row[-1] == "" for row in rows):  # a separator ends each line
        rows = [row[:-1] for row in rows]
    width = len(rows[0])
    named = True
    if key is not None:
        names = _given_names(key, width, path)
    else:
        names = _header(lines[:begin], width, path)
        if names is None:
            named, names = False, LAYOUTS.get(width)
    if names is None:
        known = ", ".join(str(count) for count in LAYOUTS)
        raise FileFormatError(
            f"{path}:{data[0][0]}: expected named columns or {known} of them, got {width}"
        )
    numbered = [f"{index} ({name})" for index, name in enumerate(names, 1)]
    values, numbers, _ = parse_rows(path, zip((number for number, _ in data), rows), numbered)
    columns = {name: values[:, k] for k, name in enumerate(names) if name != "-"}
    told = "named in the file" if named else "by their number"
    if key is not None:
        told = "as given"
    if not named:
        columns = _unnamed(columns, findings)
    columns = {name: column for name, column in columns.items() if name in ALIASES}
    layout = f"CSV with columns {' '.join(columns)} ({told})"
    if "alpha" in columns:
        columns = _from_reference(columns)
        findings.append(
            Finding(
                "reference-line",
                NOTE,
                "a reference line with shifts along its normals: walls measured from the track",
            )
        )
    return RacelineTable(
        columns,
        layout=layout,
        lines=np.array(numbers),
        findings=tuple(findings),
    )


def _given_names(key, width, path):
    names = [_MEANING.get(name.strip().lower(), "-") for name in key.split(",")]
    if not _complete(names):
        raise FileFormatError(
            f"{path}: expected JSON with the key {key}, or names of columns with x and y, "
            f"got neither"
        )
    if len(names) != width:
        raise FileFormatError(f"{path}: {len(names)} names given for {width} columns of numbers")
    return _once(names, key.split(","), f"{path}: ")


def _header(lines, width, path):
    """Meanings of the columns from the last line before the data, None if that names none."""
    if not lines:
        return None
    number, line = lines[-1]
    tokens = [token.strip("# \"'").lower() for token in _split(line.strip("# "))]
    if tokens[-1] == "" and len(tokens) == width + 1:
        del tokens[-1]
    names = [_MEANING.get(token, "-") for token in tokens]
    if not _complete(names):
        if line[0] == "#":
            return None
        raise FileFormatError(
            f"{path}:{number}: expected names of columns with x_m and y_m, got {line!r}"
        )
    if len(names) != width:
        raise FileFormatError(
            f"{path}:{number}: {len(names)} names for {width} columns of numbers"
        )
    return _once(names, tokens, f"{path}:{number}: ")


def _complete(names):
    return {"x", "y"} <= set(names) or set(_REFERENCE) <= set(names)


def _once(names, tokens, where):
    twice = [tokens[k] for k, name in enumerate(names) if name in names[:k] and name != "-"]
    if twice:
        raise FileFormatError(f"{where}column {twice[0]} is there twice")
    return names


def _separator(line):
    # Blanks come last: they may stand beside any other. A comma between digits of every column
    # that another mark separates is a decimal comma.
    if ";" in line:
        return ";"
    if "," in line:
        tokens = line.split()
        if len(tokens) > 1 and all(_DECIMAL_COMMA.fullmatch(token) for token in tokens):
            return None
        return ","
    return "\t" if "\t" in line else None


def _split(line):
    return [token.strip() for token in line.split(_separator(line))]


def _is_data(line):
    token = _split(line)[0]
    return is_number(token) or bool(_DECIMAL_COMMA.fullmatch(token))


def _unnamed(columns, findings):
    """Meaning of unnamed columns that can have several, by their numbers."""
    third = columns.pop("third", None)
    if third is None:
        return columns
    if "fifth" in columns:
        # The height stands last, or, as TUM's tools read it, between position and widths.
        fourth, fifth = columns.pop("fourth"), columns.pop("fifth")
        last = not np.any(fifth > 0.0) or np.ptp(fifth) < 1e-9 < np.ptp(third)
        between = not np.any(third > 0.0) or np.any(third < 0.0) or np.ptp(third) < 1e-9
        if between and not last and np.all(fifth >= 0.0):
            columns.update(d_right=fourth, d_left=fifth)
            which = "third"
        else:
            columns.update(d_right=third, d_left=fourth)
            which = "last"
        findings.append(
            Finding("height", NOTE, f"five unnamed columns: the {which} one taken as the height")
        )
        return columns
    if np.any(third < 0.0) or not np.any(third):
        text = "three unnamed columns: the third, partly negative or all 0, taken as the height"
        findings.append(Finding("third-column", NOTE, text))
        return columns
    meaning, why = _third(columns["x"], columns["y"], third)
    columns["speed" if meaning == "speed" else "width"] = third
    findings.append(
        Finding(
            "third-column",
            WARNING,
            f"three unnamed columns: the third taken as {meaning}, as {why}; FILE#x,y,width or "
            "FILE#x,y,speed tells which",
        )
    )
    return columns


def _third(x, y, third):
    """Whether the third of three columns is a speed or a total width, and the evidence.

    Speeds fall where the track bends; widths know little of that. On 14 real racelines and
    centerlines the correlation with the curvature, smoothed over nine points, is -0.73 to -0.91 for
    speeds (but -0.52 on Monza, driven at full speed for most of a lap, and -0.28 on a circle), and
    -0.52 or more for widths.
    """
    third = third[distinct_points(x, y)]
    x, y = (column[distinct_points(x, y)] for column in (x, y))
    if x.size < 9 or np.ptp(third) <= 1e-6 * np.max(third):
        return "total width", "it is the same all along"
    ways = np.stack((np.roll(x, -1) - x, np.roll(y, -1) - y))
    heading = np.arctan2(ways[1], ways[0])
    bend = np.abs(wrap(heading - np.roll(heading, 1))) / np.hypot(ways[0], ways[1])
    bend = np.mean([np.roll(bend, shift) for shift in range(-4, 5)], axis=0)
    if np.ptp(bend) <= 1e-9:
        return "total width", "the track bends evenly, which tells nothing"
    falling = float(np.corrcoef(bend, third)[0, 1])
    most = float(np.mean(third >= np.max(third) * (1.0 - 1e-6)))
    told = f"(correlation {falling:.2f})"
    if falling < -0.6:
        return "speed", f"it falls where the track bends {told}"
    if falling < -0.4 and most > 0.2:
        return "speed", f"it falls where the track bends {told}, from a limit reached often"
    return "total width", f"it does not fall where the track bends {told}"


def _from_reference(columns):
    """Track and walls of a reference line with normals and shifts.

    The distances to the walls are measured along the track's own normals, as those of a raceline
    are, to the polylines at ``ref + n width_right`` and ``ref - n width_left`` (with normals that
    point to the right, which is recomputed, too).
    """
    reference = np.stack((columns.pop("x_ref"), columns.pop("y_ref")), axis=1)
    normal = np.stack((columns.pop("x_normal"), columns.pop("y_normal")), axis=1)
    alpha = columns.pop("alpha")
    track = reference + alpha[:, None] * normal
    columns.update(x=track[:, 0], y=track[:, 1])
    if "d_left" not in columns or "d_right" not in columns:
        return columns
    closed = np.array_equal(reference[0], reference[-1])
    ring = slice(None, -1) if closed else slice(None)
    tangent = _tangents(reference[ring])
    side = float(np.sum(tangent[:, 0] * normal[ring, 1] - tangent[:, 1] * normal[ring, 0]))
    left = normal * (1.0 if side > 0.0 else -1.0)
    shift = alpha if side > 0.0 else -alpha
    own = np.empty_like(left)
    own[ring] = _tangents(track[ring])
    own[-1] = own[0] if closed else own[-1]
    own = np.stack((-own[:, 1], own[:, 0]), axis=1)
    d_left, d_right = columns["d_left"], columns["d_right"]
    wall_left = reference + d_left[:, None] * left
    wall_right = reference - d_right[:, None] * left
    columns["d_left"] = _distance(track, own, wall_left[ring], d_left - shift)
    columns["d_right"] = _distance(track, -own, wall_right[ring], d_right + shift)
    return columns


def _tangents(points):
    way = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    return way / np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-12)[:, None]


def _distance(points, directions, wall, guess):
    """Distance from points in a direction to a closed wall, nearest to a guess.

    Only the stretch of wall up to 12 vertices away is looked at; where no ray meets it the guess
    stays, which is measured along the reference line's normal.
    """
    reach = min(12, len(wall) // 2)
    index = (np.arange(len(points))[:, None] + np.arange(-reach, reach)) % len(wall)
    start = wall[index] - points[:, None]
    way = wall[(index + 1) % len(wall)] - wall[index]
    dx, dy = directions[:, 0:1], directions[:, 1:2]
    area = dx * way[..., 1] - dy * way[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (start[..., 0] * way[..., 1] - start[..., 1] * way[..., 0]) / area
        part = (start[..., 0] * dy - start[..., 1] * dx) / area
        off = np.where((part >= 0.0) & (part <= 1.0), np.abs(distance - guess[:, None]), np.inf)
    best = np.argmin(off, axis=1)
    rows = np.arange(len(points))
    return np.where(np.isfinite(off[rows, best]), distance[rows, best], guess)


# -- JSON ------------------------------------------------------------------------------------


def _json_columns(text, path, key):
    """Columns of one waypoint array of a race_stack JSON file."""
    try:
        content = json.loads(text, parse_int=float)  # too many digits are infinite, no error
    except RecursionError:
        raise FileFormatError(f"{path}: broken JSON: nested too deeply") from None
    except ValueError as error:
        raise FileFormatError(f"{path}: broken JSON: {error}") from None
    arrays = {}
    if isinstance(content, dict):
        for name, value in content.items():
            if isinstance(value, dict) and isinstance(value.get("wpnts"), list):
                arrays[name] = value["wpnts"]
    if key not in arrays:
        there = ", ".join(arrays) or "none"
        raise FileFormatError(f"{path}: expected waypoints under {key}, the file has: {there}")
    columns = {}
    for k, point in enumerate(arrays[key]):
        if not isinstance(point, dict):
            raise FileFormatError(f"{path}: {key}, waypoint {k}: expected named fields")
        for field, value in point.items():
            name = _MEANING.get(field.lower())
            if name is None:
                continue
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise FileFormatError(
                    f"{path}: {key}, waypoint {k}: expected a number as {field}, got {value!r}"
                )
            columns.setdefault(name, []).append(value)
    for name in ("x", "y"):
        if len(columns.get(name, ())) != len(arrays[key]) or not arrays[key]:
            raise FileFormatError(f"{path}: {key}: expected waypoints with x_m and y_m")
    ragged = [name for name, column in columns.items() if len(column) != len(arrays[key])]
    if ragged:
        raise FileFormatError(f"{path}: {key}: only some waypoints have {ragged[0]}")
    return {name: np.array(column, dtype=float) for name, column in columns.items()}
