"""Raceline files: one reader for all layouts in use.

Only positions, speeds and widths are taken from a file. Heading, curvature and arc length follow
from the positions; where a file states them they are compared (:mod:`.checks`), because files of
different origin have different headings under the same header line. The outcome is in
`Raceline.findings`. Files are written by :mod:`.writers`.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any, Mapping

import numpy as np

from ...errors import FileFormatError
from ...resources import find_config
from ...tables import is_number, open_text, parse_rows
from ..findings import NOTE, Finding
from ..raceline import Raceline
from .checks import raceline_of
from .columns import (
    ALIASES,
    LAYOUTS,
    MEANING,
    REFERENCE,
    from_reference_line,
    name_by_numbers,
)
from .table import RacelineTable

__all__ = [
    "ALIASES",
    "LAYOUTS",
    "find_raceline_file",
    "raceline_from_columns",
    "read_raceline_file",
    "split_source",
]

# Waypoint array of a race_stack JSON file by default.
DEFAULT_KEY = "global_traj_wpnts_iqp"

_SUFFIXES = (".csv", ".json", ".json.gz", ".csv.gz")
_DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")


def find_raceline_file(source: str | Path) -> tuple[Path, str | None]:
    """Path and key of a shipped track or a raceline file, ``NAME`` or ``FILE#KEY``."""
    text, key = split_source(source)
    return find_config("tracks", text, _SUFFIXES), key or None


def split_source(source: str | Path) -> tuple[str, str]:
    """Split a source into the path and the selector within the file, ``PATH#SELECTOR``.

    Parameters
    ----------
    source : str or pathlib.Path

    Returns
    -------
    path, selector : str
        The selector is empty if there is none. Existing files may have ``#`` in their names.
    """
    path, mark, selector = str(source).rpartition("#")
    if not mark or Path(source).is_file():
        return str(source), ""
    return path, selector


def read_raceline_file(path: str | Path, key: str | None = None) -> RacelineTable:
    """Read what a CSV or JSON file states, which may be gzipped.

    Parameters
    ----------
    path : str or pathlib.Path
        CSV with comma, semicolon, tab or spaces between columns, with column names in the last
        line before the data (after ``#`` or not) or with one of the `LAYOUTS`; or JSON with
        waypoint arrays as race_stack writes it.
    key : str, optional
        Waypoint array of a JSON file, by default ``"global_traj_wpnts_iqp"``; or the names of the
        columns of a CSV file, overriding its header, ``"x,y,speed"``. Unknown names such as ``-``
        leave a column out.

    Returns
    -------
    RacelineTable

    Raises
    ------
    FileFormatError
        If the file cannot be read; the message names line and column.
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


def raceline_from_columns(
    columns: Mapping[str, Any], *, name: str = "", source: str = ""
) -> Raceline:
    """Raceline of the columns of a file or a message.

    Parameters
    ----------
    columns : dict of str to array_like
        Columns by their names in `ALIASES`, at least ``x`` and ``y``. ``psi``, ``kappa``, ``s`` and
        ``ax`` are compared with the curve, not used.
    name, source : str, optional
        See `Raceline`.

    Returns
    -------
    Raceline
        With `findings`.

    Raises
    ------
    RacelineError
        If the points do not form a closed track.
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
        raise FileFormatError(f"{path}: expected a raceline, got no line of numbers")
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
    how = "as given" if key is not None else "named in the file" if named else "by their number"
    if not named:
        columns = name_by_numbers(columns, findings)
    columns = {name: column for name, column in columns.items() if name in ALIASES}
    layout = f"CSV with columns {' '.join(columns)} ({how})"
    if "alpha" in columns:
        columns = from_reference_line(columns)
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
    names = [MEANING.get(name.strip().lower(), "-") for name in key.split(",")]
    if not _complete(names):
        raise FileFormatError(f"{path}: expected JSON with the key {key}, or columns with x and y")
    if len(names) != width:
        raise FileFormatError(f"{path}: expected {width} names of columns, got {len(names)}")
    return _once(names, key.split(","), f"{path}: ")


def _header(lines, width, path):
    """Meaning of the columns by the last line before the data, None if it has no names."""
    if not lines:
        return None
    number, line = lines[-1]
    tokens = [token.strip("# \"'").lower() for token in _split(line.strip("# "))]
    if tokens[-1] == "" and len(tokens) == width + 1:
        del tokens[-1]
    names = [MEANING.get(token, "-") for token in tokens]
    if not _complete(names):
        if line[0] == "#":
            return None
        raise FileFormatError(
            f"{path}:{number}: expected names of columns with x_m and y_m, got {line!r}"
        )
    if len(names) != width:
        raise FileFormatError(
            f"{path}:{number}: expected {width} names of columns, got {len(names)}"
        )
    return _once(names, tokens, f"{path}:{number}: ")


def _complete(names):
    return {"x", "y"} <= set(names) or set(REFERENCE) <= set(names)


def _once(names, tokens, where):
    twice = [tokens[k] for k, name in enumerate(names) if name in names[:k] and name != "-"]
    if twice:
        raise FileFormatError(f"{where}expected each column once, got {twice[0]} twice")
    return names


def _separator(line):
    # Spaces come last, as they may surround any other separator. A comma between the digits of
    # every column separated otherwise is a decimal comma.
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


# -- JSON ------------------------------------------------------------------------------------


def _json_columns(text, path, key):
    """Columns of one waypoint array of a race_stack JSON file."""
    try:
        content = json.loads(text, parse_int=float)  # huge integers become inf instead of an error
    except RecursionError:
        raise FileFormatError(f"{path}: invalid JSON: nested too deeply") from None
    except ValueError as error:
        raise FileFormatError(f"{path}: invalid JSON: {error}") from None
    arrays = {}
    if isinstance(content, dict):
        for name, value in content.items():
            if isinstance(value, dict) and isinstance(value.get("wpnts"), list):
                arrays[name] = value["wpnts"]
    if key not in arrays:
        there = ", ".join(arrays) or "none"
        raise FileFormatError(f"{path}: expected waypoints under {key}, got {there}")
    columns = {}
    for k, point in enumerate(arrays[key]):
        if not isinstance(point, dict):
            raise FileFormatError(f"{path}: {key}, waypoint {k}: expected named fields")
        for field, value in point.items():
            name = MEANING.get(field.lower())
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
        raise FileFormatError(
            f"{path}: {key}: expected {ragged[0]} of all waypoints, got only some"
        )
    return {name: np.array(column, dtype=float) for name, column in columns.items()}
