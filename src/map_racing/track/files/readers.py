"""Raceline files: one reader for all layouts in use.

Only positions, speeds and widths are taken from a file. Heading, curvature and arc length follow
from the positions; where a file states them they are compared (:mod:`.checks`), because files of
different origin have different headings under the same header line. The outcome is in
`Raceline.findings`. Files are written by :mod:`.writers`.
"""

from __future__ import annotations

import csv
import json
import re
from contextlib import suppress
from pathlib import Path
from typing import Any, Mapping, NamedTuple

import numpy as np

from ...errors import FileFormatError
from ...resources import find_config
from ...tables import is_number, open_text, parse_rows
from ..findings import NOTE, WARNING, Finding
from ..raceline import Raceline
from .checks import raceline_of
from .columns import ALIASES, REFERENCE, Meaning, from_reference_line, may_be_unit, meaning_of
from .table import RacelineTable, without_signs
from .unnamed import LAYOUTS, name_by_numbers

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
    if not mark or Path(source).exists():
        return str(source), ""
    return path, selector


def read_raceline_file(path: str | Path, key: str | None = None) -> RacelineTable:
    """Read what a CSV or JSON file states, which may be gzipped.

    Parameters
    ----------
    path : str or pathlib.Path
        CSV with comma, semicolon, tab or spaces between columns, with column names in the last
        line before the data (after ``#`` or not) or told apart by their numbers; or JSON with
        waypoint arrays as race_stack writes it. Names are those of `ALIASES`,
        with or without units.
    key : str, optional
        Waypoint array of a JSON file, by default ``"global_traj_wpnts_iqp"``; or the names of the
        columns of a CSV file, overriding its header, ``"x,y,speed"``; ``-`` leaves a column out.

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
        content = _json_content(text, path)
        columns, findings = _json_columns(content, path, key)
        layout = f"race_stack JSON, {key}"
        bounds = _json_bounds(content, key)
        table = RacelineTable(columns, layout=layout, findings=tuple(findings), bounds=bounds)
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

    Raises
    ------
    RacelineError
        If the points do not form a closed track.
    """
    columns = {key: np.asarray(column, dtype=float) for key, column in columns.items()}
    return raceline_of(without_signs(RacelineTable(columns, name=name, source=source)))


# -- CSV -------------------------------------------------------------------------------------


def _csv_table(text, path, key=None):
    """Columns of a CSV file, named by `key`, by its header or by its layout."""
    lines = [(number, line.strip()) for number, line in enumerate(text.splitlines(), 1)]
    lines = [(number, line) for number, line in lines if line.strip("#;, \t")]
    begin = next((k for k, (_, line) in enumerate(lines) if _is_data(line)), None)
    if begin is None:
        got = "no line of numbers"
        if any(line.startswith("image:") for _, line in lines):
            got = "a map; map-racing raceline optimize makes a raceline in it"
        raise FileFormatError(f"{path}: expected a raceline, got {got}")
    findings = []
    data = [(number, line) for number, line in lines[begin:] if line[0] != "#"]
    separator = _separator(data[0][1])
    if separator != "," and any("," in line for _, line in data):
        data = [(number, line.replace(",", ".")) for number, line in data]
        findings.append(Finding("decimal-comma", NOTE, "decimal commas: read as points"))
    rows = [_split(line, separator) for _, line in data]
    if all(row[-1] == "" for row in rows):  # a separator ends each line
        rows = [row[:-1] for row in rows]
    width = len(rows[0])
    header = _header(lines[:begin], width, path) if key is None else _given(key, width, path)
    values, numbers = _values([number for number, _ in data], rows, header, path)
    if header is not None:
        how = "as given" if key is not None else "named in the file"
        if key is None:
            findings += _without_name(header.names, rows)
        columns = _named_columns(header, values.T, findings)
    elif width < 2:
        raise FileFormatError(f"{path}:{numbers[0]}: expected two columns or more, got 1")
    else:
        how = "by their numbers"
        names, guesses = name_by_numbers(values, f"{path}:{numbers[0]}")
        findings += guesses
        columns = {name: values[:, k] for k, name in enumerate(names) if name != "-"}
    layout = f"CSV with columns {' '.join(columns)} ({how})"
    if "alpha" in columns:
        with np.errstate(all="ignore"):  # what is not finite is found when it is checked
            columns = from_reference_line(columns)
        text = "a reference line with shifts along its normals: walls measured from the track"
        findings.append(Finding("reference-line", NOTE, text))
    return RacelineTable(columns, layout=layout, lines=np.array(numbers), findings=tuple(findings))


def _values(numbers, rows, header, path):
    """Numbers of the cells, NaN in columns that are not used, and the line of each row."""
    width = len(rows[0])
    shown = header.names if header is not None else [""] * width
    numbered = [f"{k} ({name})" if name else str(k) for k, name in enumerate(shown, 1)]
    # Columns that are not used may hold anything.
    picked = [k for k in range(width) if header is None or header.meanings[k].column not in "-?"]
    parsed, kept, _ = parse_rows(path, zip(numbers, rows), numbered, picked)
    values = np.full((len(kept), width), np.nan)
    values[:, picked] = parsed
    return values, kept


def _without_name(names, rows):
    """Warning about columns with an empty name, unless they are empty or only count up the rows."""
    listed = []
    for k in (k for k, name in enumerate(names) if not name):
        cells = [row[k] for row in rows if k < len(row) and row[k]]
        numbers = [float(cell) for cell in cells if re.fullmatch(r"\d{1,9}(\.\d*)?", cell)]
        if cells and (len(numbers) < len(cells) or not np.all(np.diff(numbers) > 0.0)):
            listed.append(str(k + 1))
    text = f"columns without a name are not used: {', '.join(listed)}"
    return [Finding("unknown-columns", WARNING, text)] if listed else []


class _Header(NamedTuple):
    """Names of the columns as written, what they mean, and where they stand."""

    names: list
    meanings: list
    where: str


def _given(key, width, path):
    """Names given after ``FILE#``."""
    names = key.split(",")
    header = _Header(names, [_skipped(name) or meaning_of(name) for name in names], f"{path}: ")
    if not _complete(header.meanings):
        raise FileFormatError(f"{path}: expected JSON with the key {key}, or columns with x and y")
    if len(names) != width:
        raise FileFormatError(f"{path}: expected {width} names of columns, got {len(names)}")
    return header


def _skipped(name):
    return Meaning("-") if name.strip() in ("-", "_", "") else None


def _header(lines, width, path):
    """Names of the columns in the lines before the data, None if there are none.

    They are in the last of these lines that names as many columns, x and y among them; a line of
    units may follow.
    """
    units = [""] * width
    cells = [_tokens(line, width) for _, line in lines]
    last = len(lines) - 1
    for k in range(last, -1, -1):
        if len(cells[k]) == width and _complete(list(map(meaning_of, cells[k]))):
            last = k
            break
    below = cells[last + 1] if last + 1 < len(lines) else cells[-1] if len(lines) > 1 else []
    if len(below) == width and all(map(may_be_unit, below)) and any(map(_says_unit, below)):
        units = below
        last -= last + 1 == len(lines)
    if not lines:
        return None
    number, line = lines[last]
    names = cells[last]
    where = f"{path}:{number}: "
    meanings = [meaning_of(name, unit) for name, unit in zip(names, units + [""] * len(names))]
    if not _complete(meanings):
        one_word_each = all(re.fullmatch(r"[^\W\d]\S*(\s*[\[(].*[\])])?", name) for name in names)
        if line[0] == "#" and not (len(names) == width and one_word_each):
            return None  # a remark
        raise FileFormatError(
            f"{where}expected names of columns with x_m and y_m, got {line!r}: FILE#x,y,... names "
            "them otherwise"
        )
    if len(names) != width:
        raise FileFormatError(f"{where}expected {width} names of columns, got {len(names)}")
    return _Header(names, meanings, where)


def _tokens(line, width):
    """Cells of a line of names or units, in any separator."""
    line = line.strip("# ")
    # A unit in brackets belongs to the name before it, whatever it holds.
    line = re.sub(r"\s*[\[(][^\])]*[\])]", lambda unit: re.sub(r"[\s,;]", "", unit.group()), line)
    tokens = [token.strip("# \"'") for token in _split(line)]
    if tokens and tokens[-1] == "" and len(tokens) == width + 1:
        del tokens[-1]
    return tokens


def _says_unit(token):
    return token.strip("[](){} ") not in ("", "-", "1")


def _complete(meanings):
    columns = {meaning.column for meaning in meanings}
    return any(set(pair) <= columns for pair in (("x", "y"), ("x_ref", "y_ref"), REFERENCE))


def _named_columns(header, values, findings):
    """Columns in SI units by their names in `ALIASES`; findings on names and units."""
    names, meanings = header.names, list(header.meanings)
    columns = {meaning.column for meaning in meanings}
    if not set(REFERENCE) <= columns:
        # A reference to be driven, not one with normals and shifts.
        plain = {"x_ref": "x", "y_ref": "y"} if not {"x", "y"} <= columns else {}
        meanings = [
            meaning._replace(
                column=plain.get(meaning.column, "?")
                if meaning.column in REFERENCE
                else meaning.column
            )
            for meaning in meanings
        ]
    taken, unused = {}, []
    for k in sorted(range(len(names)), key=lambda k: meanings[k].rank):
        column = meanings[k].column
        if column == "-":
            continue
        if column in taken and meanings[k].rank == meanings[taken[column]].rank:
            one, other = (meanings[j].factor * values[j] for j in (k, taken[column]))
            if meanings[k].unit != meanings[taken[column]].unit and np.allclose(one, other, 0.01):
                continue  # the same in another unit
            raise FileFormatError(f"{header.where}expected each column once, got {names[k]} twice")
        if column == "?" or column in taken:
            unused.append(k)
        else:
            taken[column] = k
    result = {}
    for k, meaning in enumerate(meanings):
        if taken.get(meaning.column) != k:
            continue
        result[meaning.column] = meaning.factor * values[k] if meaning.unit else values[k]
        if meaning.expected_unit:
            expected, unit = meaning.expected_unit, meaning.unit
            text = f"column {names[k]}: expected a unit such as {expected}, got {unit}: taken as SI"
            findings.append(Finding("unknown-unit", WARNING, text))
        elif meaning.unit:
            text = f"column {names[k]} converted from {meaning.unit} to SI"
            findings.append(Finding("units", NOTE, text))
    if "half_width" in result:
        half = result.pop("half_width")
        if not {"d_left", "d_right", "width"} & set(result):
            result["width"] = 2.0 * half
    if unused:
        listed = ", ".join(names[k] for k in sorted(unused))
        text = f"columns not understood and not used: {listed}"
        findings.append(Finding("unknown-columns", WARNING, text))
    return result


def _separator(line):
    # Spaces come last, as they may surround any other separator. A comma between the digits of
    # every column separated otherwise is a decimal comma.
    line = re.sub(r'"[^"]*"', "", line)
    if ";" in line:
        return ";"
    if "," in line:
        tokens = line.split()
        if len(tokens) > 1 and all(_DECIMAL_COMMA.fullmatch(token) for token in tokens):
            return None
        return ","
    return "\t" if "\t" in line else None


def _split(line, separator=""):
    """Cells of a line, quoted ones as one; its own separator by default."""
    separator = _separator(line) if separator == "" else separator
    if '"' in line:
        blanks = separator or " "
        # Bytes that no text holds make an error in old versions, an overlong cell in all.
        with suppress(csv.Error):
            row = next(csv.reader([line], delimiter=blanks, skipinitialspace=True))
            return [token.strip() for token in row]
    return [token.strip() for token in line.split(separator)]


def _is_data(line):
    tokens = _split(line)
    numeric = [is_number(token) or bool(_DECIMAL_COMMA.fullmatch(token)) for token in tokens]
    return numeric[0] or (line[0] != "#" and sum(numeric) >= 2)


# -- JSON ------------------------------------------------------------------------------------


def _json_content(text, path):
    try:
        return json.loads(text, parse_int=float)  # huge integers become inf instead of an error
    except RecursionError:
        raise FileFormatError(f"{path}: invalid JSON: nested too deeply") from None
    except ValueError as error:
        raise FileFormatError(f"{path}: invalid JSON: {error}") from None


def _json_bounds(content, key):
    """Points of the walls that the file shows as markers, or else as those of its other lines."""
    with suppress(LookupError, TypeError, ValueError, AttributeError):
        markers = content["trackbounds_markers"]["markers"]
        places = (marker["pose"]["position"] for marker in markers)
        points = np.array([(place["x"], place["y"]) for place in places], dtype=float)
        if len(points) and np.isfinite(points).all():
            return (points,)
    others = content.items() if isinstance(content, dict) else ()
    for name, value in others:
        with suppress(LookupError, TypeError, ValueError, AttributeError):
            rows = value["wpnts"] if name != key else ()
            names = ("x_m", "y_m", "d_left", "d_right")
            x, y, left, right = np.array([[row[n] for n in names] for row in rows], dtype=float).T
            if np.isfinite(x + y + left + right).all() and np.any(left + right):
                # Of these the walls may be exchanged as well.
                return (_walls(x, y, left, right), _walls(x, y, right, left))
    return ()


def _walls(x, y, left, right):
    """Points on both walls of a closed line of points."""
    way = np.stack([np.roll(v, -1) - np.roll(v, 1) for v in (x, y)], axis=1)
    way /= np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-9)[:, None]
    normal, points = np.stack((-way[:, 1], way[:, 0]), axis=1), np.stack((x, y), axis=1)
    return np.concatenate((points + left[:, None] * normal, points - right[:, None] * normal))


def _json_columns(content, path, key):
    """Columns of one waypoint array of a race_stack JSON file."""
    arrays = {}
    if isinstance(content, dict):
        for name, value in content.items():
            if isinstance(value, dict) and isinstance(value.get("wpnts"), list):
                arrays[name] = value["wpnts"]
    if key not in arrays:
        there = ", ".join(arrays) or "none"
        raise FileFormatError(f"{path}: expected waypoints under {key}, got {there}")
    fields = {}
    for k, point in enumerate(arrays[key]):
        if not isinstance(point, dict):
            raise FileFormatError(f"{path}: {key}, waypoint {k}: expected named fields")
        for field, value in point.items():
            if meaning_of(field).column in ("-", "?"):
                fields.setdefault(field, [])
                continue
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                raise FileFormatError(
                    f"{path}: {key}, waypoint {k}: expected a number as {field}, got {value!r}"
                )
            fields.setdefault(field, []).append(value)
    meanings = [meaning_of(field) for field in fields]
    if not _complete(meanings):
        raise FileFormatError(f"{path}: {key}: expected waypoints with x_m and y_m")
    ragged = [
        field
        for (field, column), meaning in zip(fields.items(), meanings)
        if len(column) != len(arrays[key]) and meaning.column not in ("-", "?")
    ]
    if ragged:
        raise FileFormatError(
            f"{path}: {key}: expected {ragged[0]} of all waypoints, got only some"
        )
    findings = []
    header = _Header(list(fields), meanings, f"{path}: {key}: ")
    values = [np.array(column, dtype=float) for column in fields.values()]
    return _named_columns(header, values, findings), findings
