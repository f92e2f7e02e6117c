"""Raceline files: one reader for the family of layouts in use, one layout of our own to write.

What a column means is looked up in two tables, `ALIASES` for files that name their columns and
`LAYOUTS` for files that do not. Only positions, speeds and widths are taken from a file. Heading,
curvature and arc length follow from the positions; where a file states them they are compared,
because files of different origin have different headings under one and the same header line.
The outcome is told in `Raceline.findings`.
"""

import gzip
import json
import math
import zlib
from pathlib import Path

import numpy as np

from ..angles import wrap
from ..errors import FileFormatError
from ..files import replacing
from ..resources import find_config
from .raceline import Raceline, distinct_points

__all__ = [
    "ALIASES",
    "LAYOUTS",
    "load_raceline",
    "raceline_from_columns",
    "read_raceline_file",
    "save_raceline",
]

# Names of columns in files and messages, compared in lower case.
ALIASES = {
    "s": ("s_m", "s"),
    "x": ("x_m", "x"),
    "y": ("y_m", "y"),
    "psi": ("psi_rad", "psi", "yaw", "theta", "heading_rad"),
    "kappa": ("kappa_radpm", "kappa", "curvature"),
    "speed": ("vx_mps", "v_mps", "vx", "v", "speed", "speed_mps", "velocity"),
    "ax": ("ax_mps2", "ax"),
    "d_right": ("d_right_m", "d_right", "w_tr_right_m", "w_right_m", "d_right_iqp", "d_right_sp"),
    "d_left": ("d_left_m", "d_left", "w_tr_left_m", "w_left_m", "d_left_iqp", "d_left_sp"),
    "width": ("w_tr_m", "width_m", "width"),
}
_MEANING = {alias: column for column, aliases in ALIASES.items() for alias in aliases}

# Files without names, by number of columns.
LAYOUTS = {
    2: ("x", "y"),
    3: ("x", "y", "width"),
    4: ("x", "y", "d_right", "d_left"),
    5: ("x", "y", "d_right", "d_left", "z"),
    7: ("s", "x", "y", "psi", "kappa", "speed", "ax"),
    9: ("s", "x", "y", "psi", "kappa", "speed", "ax", "d_right", "d_left"),
}

# Where waypoint arrays are found in a race_stack JSON file, unless told.
DEFAULT_KEY = "global_traj_wpnts_iqp"

_SUFFIXES = (".csv", ".json", ".json.gz", ".csv.gz")


def load_raceline(source, key=None):
    """Raceline of a shipped track or a file.

    Parameters
    ----------
    source : str or pathlib.Path
        Name of a shipped track, or path of a file as of `read_raceline_file`. ``PATH#KEY`` names
        the waypoint array of a JSON file.
    key : str, optional
        The same, given separately.

    Returns
    -------
    Raceline

    Raises
    ------
    ParameterError
        If there is neither such a file nor such a track.
    FileFormatError, RacelineError
        If it is no raceline.
    """
    text = str(source)
    if key is None and "#" in text and not Path(text).is_file():
        text, key = text.rsplit("#", 1)
    return read_raceline_file(find_config("tracks", text, _SUFFIXES), key)


def read_raceline_file(path, key=None):
    """Read a closed course from a CSV or JSON file, which may be gzipped.

    Parameters
    ----------
    path : str or pathlib.Path
        CSV with comma, semicolon, tab or blanks between columns, with column names in the last
        line before the data (``#`` in front or not) or with one of the `LAYOUTS`; or JSON with
        waypoint arrays as race_stack writes it.
    key : str, optional
        Which waypoint array of a JSON file, ``"global_traj_wpnts_iqp"`` by default.

    Returns
    -------
    Raceline
        Its `findings` tell what in the file was recomputed, dropped or guessed.

    Raises
    ------
    FileFormatError
        If the file cannot be read; names line and column.
    RacelineError
        If its points make no closed course.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
        text = (gzip.decompress(data) if data[:2] == b"\x1f\x8b" else data).decode("utf-8-sig")
    except (OSError, EOFError, UnicodeDecodeError, zlib.error) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise FileFormatError(f"{path}: expected a raceline file: {reason}") from None
    name = path.name
    for suffix in (".gz", ".csv", ".json", ".txt"):
        name = name[: -len(suffix)] if name.lower().endswith(suffix) else name
    if text.lstrip()[:1] in ("{", "["):
        columns = _json_columns(text, path, key or DEFAULT_KEY)
    elif key is not None:
        raise FileFormatError(f"{path}: expected JSON with the key {key}, got no JSON")
    else:
        columns = _csv_columns(text, path)
    return raceline_from_columns(columns, name=name, source=str(path))


def raceline_from_columns(columns, *, name="", source=""):
    """Raceline of columns as files and messages have them.

    Parameters
    ----------
    columns : dict of str to array_like
        Columns by their names in `ALIASES`, at least ``x`` and ``y``. ``psi``, ``kappa`` and ``s``
        are compared with the curve, not used.
    name, source : str, optional
        As of `Raceline`.

    Returns
    -------
    Raceline
        With `findings`.

    Raises
    ------
    RacelineError
        If the points make no closed course.
    """
    columns = {key: np.asarray(column, dtype=float) for key, column in columns.items()}
    findings = []
    if "width" in columns:
        columns["d_left"] = columns["d_right"] = 0.5 * columns.pop("width")
        findings.append("one column of width: taken as the total, half to each side")
    # A course without speeds or walls is often written with zeros there.
    for what, keys in (("speed", ("speed",)), ("wall distance", ("d_left", "d_right"))):
        if all(key in columns for key in keys) and not any(np.any(columns[k]) for k in keys):
            for key in keys:
                del columns[key]
            findings.append(f"every {what} is 0: taken as not given")
    raceline = Raceline(
        columns["x"],
        columns["y"],
        vx_mps=columns.get("speed"),
        d_left_m=columns.get("d_left"),
        d_right_m=columns.get("d_right"),
        name=name,
        source=source,
    )
    raceline.findings = tuple(findings + _compare(raceline, columns))
    return raceline


def save_raceline(raceline, path):
    """Write a raceline as CSV, one line for each cell of its internal form.

    The columns are those of `LAYOUTS` with nine columns, named in the header, without speeds or
    walls where the raceline has none. Heading is measured from +x, acceleration is constant from
    each point to the next, the last point does not repeat the first.

    Parameters
    ----------
    raceline : Raceline
    path : str or pathlib.Path
        Replaced in one step if it exists: a reader never meets half a file.
    """
    columns = [
        ("s_m", raceline.s),
        ("x_m", raceline.x),
        ("y_m", raceline.y),
        ("psi_rad", raceline.psi),
        ("kappa_radpm", raceline.kappa),
    ]
    if raceline.speed is not None:
        square = raceline.speed**2
        columns.append(("vx_mps", raceline.speed))
        columns.append(("ax_mps2", (np.roll(square, -1) - square) / (2.0 * raceline.ds)))
    if raceline.d_left is not None:
        columns.append(("d_right_m", raceline.d_right))
        columns.append(("d_left_m", raceline.d_left))
    lines = [
        f"# closed raceline {raceline.name}: {raceline.length:.3f} m".replace("  ", " "),
        "# psi_rad from +x, counter-clockwise; kappa_radpm positive in left-hand bends; "
        "d_right_m, d_left_m to the walls",
        "# " + "; ".join(name for name, _ in columns),
    ]
    # Six decimals are a micrometer; "+ 0.0" turns -0.0 into 0.0.
    table = np.round(np.stack([column for _, column in columns], axis=1), 6) + 0.0
    lines += [";".join(f"{value:.6f}" for value in row) for row in table.tolist()]
    with replacing(path) as file:
        file.write("\n".join(lines) + "\n")


# -- CSV -------------------------------------------------------------------------------------


def _csv_columns(text, path):
    """Columns of a CSV file, named by its header or its layout."""
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
    lines = [(number, line) for number, line in lines if line.strip("#;, \t")]
    begin = next((k for k, (_, line) in enumerate(lines) if _is_data(line)), None)
    if begin is None:
        raise FileFormatError(f"{path}: expected a raceline, found no line of numbers")
    rows = [(number, _split(line)) for number, line in lines[begin:] if line[0] != "#"]
    width = len(rows[0][1])
    names = _header(lines[:begin], width, path)
    if names is None:
        names = LAYOUTS.get(width)
    if names is None:
        known = ", ".join(str(count) for count in LAYOUTS)
        raise FileFormatError(
            f"{path}: line {rows[0][0]}: expected named columns or {known} of them, got {width}"
        )
    values = np.empty((len(rows), width))
    for k, (number, row) in enumerate(rows):
        if len(row) != width:
            raise FileFormatError(
                f"{path}: line {number}: expected {width} columns, got {len(row)}"
            )
        try:
            values[k] = row
        except ValueError:
            index = next(i for i, token in enumerate(row) if not _is_number(token))
            raise FileFormatError(
                f"{path}: line {number}, column {index + 1} ({names[index]}): "
                f"expected a number, got {row[index]!r}"
            ) from None
    used = [k for k, name in enumerate(names) if name in ALIASES]
    bad = np.argwhere(~np.isfinite(values[:, used]))
    if bad.size:
        k, index = int(bad[0][0]), used[int(bad[0][1])]
        raise FileFormatError(
            f"{path}: line {rows[k][0]}, column {index + 1} ({names[index]}): "
            f"expected a finite number, got {rows[k][1][index]}"
        )
    return {names[k]: values[:, k] for k in used}


def _header(lines, width, path):
    """Meanings of the columns from the last line before the data, None if that names none."""
    if not lines:
        return None
    number, line = lines[-1]
    tokens = [token.strip("# \"'").lower() for token in _split(line.strip("# "))]
    names = [_MEANING.get(token, token) for token in tokens]
    if "x" not in names or "y" not in names:
        if line[0] == "#":
            return None
        raise FileFormatError(
            f"{path}: line {number}: expected names of columns with x_m and y_m, got {line!r}"
        )
    if len(names) != width:
        raise FileFormatError(
            f"{path}: line {number}: {len(names)} names for {width} columns of numbers"
        )
    twice = [tokens[k] for k, name in enumerate(names) if name in names[:k] and name in ALIASES]
    if twice:
        raise FileFormatError(f"{path}: line {number}: column {twice[0]} is there twice")
    return names


def _split(line):
    separator = next((mark for mark in ";,\t" if mark in line), None)
    return [token.strip() for token in line.split(separator)]


def _is_data(line):
    return _is_number(_split(line)[0])


def _is_number(token):
    try:
        float(token)
    except ValueError:
        return False
    return True


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
    return columns


# -- what the file says, against its own points ----------------------------------------------


def _compare(raceline, columns):
    """Findings about points, heading, curvature and arc length of a file."""
    findings = []
    keep = distinct_points(columns["x"], columns["y"])
    kept = np.flatnonzero(keep)
    if kept[-1] + 1 < keep.size:
        findings.append("the last point repeats the first: dropped")
    repeated = kept[-1] + 1 - kept.size
    if repeated:
        findings.append(f"{repeated} repeated points dropped")
    x, y = columns["x"][keep], columns["y"][keep]
    spacing = np.hypot(np.roll(x, -1) - x, np.roll(y, -1) - y)
    if spacing[-1] > 3.0 * np.median(spacing):
        findings.append(
            f"the course is closed over a gap of {spacing[-1]:.2f} m, "
            f"{spacing[-1] / np.median(spacing):.0f} times the usual spacing"
        )
    at = raceline.sample(raceline.s_points)
    if "psi" in columns:
        findings.append(_compare_heading(columns["psi"][keep], at.psi))
    if "kappa" in columns:
        kappa = columns["kappa"][keep]
        scale = math.sqrt(np.mean(at.kappa**2))
        if math.sqrt(np.mean((kappa + at.kappa) ** 2)) < 0.5 * scale:
            findings.append("curvature is positive to the right: recomputed, positive to the left")
        elif math.sqrt(np.mean((kappa - at.kappa) ** 2)) > 0.5 * scale:
            findings.append("curvature does not fit the points: recomputed")
    if "s" in columns:
        s = columns["s"][keep]
        error = float(np.max(np.abs(s - s[0] - raceline.s_points)))
        if error > 0.01 * raceline.length:
            findings.append(f"arc length is up to {error:.2f} m off the points': recomputed")
    for side in ("left", "right"):
        if f"d_{side}" in columns and np.any(columns[f"d_{side}"] < 0.0):
            count = int(np.sum(columns[f"d_{side}"] < 0.0))
            findings.append(f"{count} points lie beyond the {side} wall")
    return findings


def _compare_heading(stated, psi):
    """Which direction the file calls zero."""
    offset = wrap(stated - psi)
    for angle, meaning in (
        (0.0, "measured from +x"),
        (-0.5 * math.pi, "measured from +y (north): recomputed from +x"),
        (math.pi, "against the order of the points: recomputed"),
    ):
        if np.median(np.abs(wrap(offset - angle))) < 0.1:
            worst = np.percentile(np.abs(wrap(offset - angle)), 95)
            return f"heading is {meaning}; fits the points within {worst:.3f} rad (95 %)"
    return (
        "heading does not fit the points: recomputed "
        f"(median difference {np.median(np.abs(offset)):.2f} rad)"
    )
