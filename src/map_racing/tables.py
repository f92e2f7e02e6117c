"""Reading delimited text: recordings, racelines and lookup tables."""

from __future__ import annotations

import codecs
import csv
import gzip
import math
import re
import zlib
from contextlib import contextmanager
from itertools import chain
from pathlib import Path
from typing import Callable, Iterable, Iterator, Mapping, NamedTuple, Sequence, TextIO

import numpy as np

from .errors import FileFormatError
from .files import refuse_special
from .printing import printable
from .units import SI, factor_to_si, is_unit, no_unit, unit_at_end

__all__ = [
    "Columns",
    "column_index",
    "is_number",
    "open_text",
    "parse_rows",
    "read_columns",
    "some_names",
    "units_to_si",
    "without_unit",
]


class Columns(NamedTuple):
    """Columns of a table with named columns.

    Parameters
    ----------
    values : dict of str to ndarray, shape (n,)
        Empty cells are NaN.
    names : dict of str to str
        Name of each column in the file.
    lines : list of int, length n
        Line number of each row.
    notes : list of str
        What was left out.
    units : dict of str to str
        Units of the columns as written in a row of units below the names or in brackets after them;
        columns without are missing. See `units_to_si`.
    words : list of str
        Cells of the requested column of words, one per row; empty if none was requested.
    """

    values: dict
    names: dict
    lines: list
    notes: list
    units: dict
    words: list = []


def read_columns(
    path: str | Path,
    locate: Callable[[list[str]], dict[str, int]],
    unnamed: Mapping[int, Sequence[str]] | None = None,
    word: Callable[[list[str]], int | None] | None = None,
) -> Columns:
    """Read some columns of a CSV file, which may be gzipped.

    Lines that begin with ``#`` are comments. The column names are in the first other line or, if
    that contains numbers, in the last comment before it. A row of units may follow. Cells are
    separated by semicolons, tabs, commas or otherwise blanks; with another separator, a comma is a
    decimal comma. A truncated last line is left out.

    Parameters
    ----------
    path : str or pathlib.Path
    locate : callable
        Given the column names, returns the index of each column to read, by its key in the result.
    unnamed : dict of int to sequence of str, optional
        Column names of a file without names, by the number of columns.
    word : callable, optional
        Given the column names, returns the index of an additional column of words, or None.

    Returns
    -------
    Columns

    Raises
    ------
    FileFormatError
        If the file cannot be read or a cell is not a number; names file, line and column.
    """
    with open_text(path) as file:
        names, rows = _split_header(path, file, unnamed or {})
        where = locate(names)
        units, rows = _split_units(rows, len(names))
        words, index = {}, word(names) if word else None
        if index is not None:
            rows = _collecting(words, index, rows)
        table, lines, notes = parse_rows(path, rows, names, list(where.values()), recorded=True)
    named = {key: names[index] for key, index in where.items()}
    units = units or [_unit_of(name) for name in names]
    stated = {key: units[index] for key, index in where.items() if not no_unit(units[index])}
    said = [words.get(line, "") for line in lines] if words else []
    return Columns(dict(zip(where, table.T)), named, lines, notes, stated, said)


@contextmanager
def open_text(path: str | Path) -> Iterator[TextIO]:
    """Open a text file, which may be gzipped; errors while reading name the file.

    It may be UTF-8, or UTF-16 with a byte order mark, such as "Unicode text" of Windows programs.
    """
    refuse_special(path)
    try:
        with open(path, "rb") as file:
            zipped = file.read(2) == b"\x1f\x8b"
        open_as = gzip.open if zipped else open
        with open_as(str(path), "rb") as file:
            first = file.read(4)
        image, first = first.startswith(_IMAGES), first[:2]
        wide = first in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
        if b"\0" in first:  # UTF-16 without a mark, or not text
            raise FileFormatError(f"{path}: expected UTF-8 text, got zero bytes")
        with open_as(str(path), "rt", encoding="utf-16" if wide else "utf-8-sig") as file:
            yield file
    except (OSError, EOFError, zlib.error) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileFormatError(f"{path}: cannot read: {reason}") from None
    except UnicodeDecodeError:
        hint = " inside gzip (unpack bags first)" if zipped else ' ("CSV UTF-8" in Excel)'
        hint = ", got an image" if image else hint
        raise FileFormatError(f"{path}: expected UTF-8 text{hint}") from None


def _split_header(path, file, unnamed):
    """Column names and numbered rows of cells of an open file."""
    comment = ""
    lines = ((number, line.strip()) for number, line in enumerate(file, 1))
    lines = ((number, line) for number, line in lines if line)
    for first in lines:
        if not first[1].startswith("#"):
            break
        comment = first[1].lstrip("# ")
    else:
        raise FileFormatError(f"{path}: expected rows of numbers, got none")
    delimiter = _delimiter(first[1])
    numeric = is_number(_cells(path, *first, delimiter)[0])
    header = comment if numeric else first[1]
    count = len(_cells(path, *first, delimiter))
    cells = _cells(path, first[0], header, delimiter) if header else []
    names = [printable(name.strip()) for name in cells]
    if numeric and len(names) != count and count in unnamed:
        names = list(unnamed[count])
    if not names:
        raise FileFormatError(f"{path}: expected names of columns above the numbers, got none")
    data = (row for row in lines if not row[1].startswith("#"))
    return names, _rows(path, chain([first], data) if numeric else data, delimiter)


# How images begin: PNG, JPEG, PGM and BMP.
_IMAGES = (b"\x89PNG", b"\xff\xd8\xff", b"P5", b"BM")
_UNIT = re.compile(r"\s*[\[(]([^\])]*)[\])]\s*$")


def without_unit(name: str) -> str:
    """Name of a column without the unit in brackets after it."""
    return _UNIT.sub("", name) or name


def units_to_si(columns: Columns, quantities: Mapping[str, str]) -> dict[str, float]:
    """Factors of columns to SI, from the units in the file; `columns` gets a note for each.

    Parameters
    ----------
    columns : Columns
    quantities : dict of str to str
        Quantity of each column, a key of `map_racing.units.SI`.

    Returns
    -------
    dict of str to float
        Of the columns whose unit is stated, also at the end of the name as in ``speed_kmh``, and
        known.
    """
    factors = {}
    for key, quantity in quantities.items():
        name = columns.names[key]
        unit = columns.units.get(key) or unit_at_end(without_unit(name), quantity)[1]
        factor = factor_to_si(quantity, unit)
        if factor is None:
            columns.notes.append(
                f"warning: column {name}: expected a unit such as {SI[quantity]}, got {unit}: "
                "taken as SI"
            )
        elif unit:
            factors[key] = factor
            if factor != 1.0:
                columns.notes.append(f"column {name}: {unit} converted to {SI[quantity]}")
    return factors


def _unit_of(name):
    """Unit in brackets after a column name; empty if there is none."""
    found = _UNIT.search(name)
    return found.group(1).strip() if found and found.start() else ""


def _split_units(rows, count):
    """Units of the columns in the first row, None if it has none, and the other rows."""
    rows = iter(rows)
    first = next(rows, None)
    if first is None:
        return None, rows
    units = [cell.strip("[](){} ") for cell in first[1]]
    words = not any(is_number(unit) and not no_unit(unit) for unit in units)
    if len(units) == count and words and any(map(is_unit, units)):
        return units, rows
    return None, chain([first], rows)


def _collecting(words, index, rows):
    """Pass rows through, and collect the cells of one column in `words` by line number."""
    for number, cells in rows:
        if index < len(cells):
            words[number] = cells[index].strip().strip('"')
        yield number, cells


def _delimiter(line):
    """Delimiter of a line, ignoring quoted text; None for blanks."""
    bare = re.sub(r'"[^"]*"', "", line)
    return next((mark for mark in ";\t," if mark in bare), None)


def _cells(path, number, line, delimiter):
    """Cells of a line."""
    return next(_rows(path, [(number, line)], delimiter))[1]


def _rows(path, lines, delimiter):
    """Numbered rows of cells; a quoted cell may contain delimiters and even line breaks."""
    if delimiter is None:
        yield from ((number, line.replace(",", ".").split()) for number, line in lines)
        return
    number = 0

    def texts():
        nonlocal number
        for number, line in lines:  # noqa: B007 - read below
            yield line + "\n"

    try:
        for cells in csv.reader(texts(), delimiter=delimiter, skipinitialspace=True):
            if delimiter != "," and any("," in cell for cell in cells):
                cells = [_with_point(cell) for cell in cells]
            yield number, cells
    except csv.Error as error:
        raise FileFormatError(f"{path}:{number}: expected cells of a table: {error}") from None


def _with_point(cell):
    """A number with a decimal point instead of a comma; other text unchanged."""
    number = cell.replace(",", ".", 1)
    return number if is_number(number.strip('" ')) else cell


def column_index(path: str | Path, names: list[str], column: str) -> int:
    """Index of a column; an error lists the names that the file has."""
    if column not in names:
        raise FileFormatError(f"{path}: no column {column!r}; it has {some_names(names)}")
    return names.index(column)


def some_names(names: list[str]) -> str:
    """The first names, for an error message."""
    return ", ".join(names[:16]) + (", ..." if len(names) > 16 else "")


def parse_rows(
    path: str | Path,
    rows: Iterable[tuple[int, list[str]]],
    names: Sequence[str],
    picked: Sequence[int] | None = None,
    recorded: bool = False,
) -> tuple[np.ndarray, list[int], list[str]]:
    """Parse rows of cells into numbers.

    Parameters
    ----------
    path : str or pathlib.Path
        File, for errors.
    rows : iterable of (int, list of str)
        Number of the line and its cells.
    names : sequence of str
        Names of the columns.
    picked : sequence of int, optional
        Indices of the columns to read; all by default.
    recorded : bool, optional
        Whether the table is a recording: cells may be empty (NaN) or quoted, rows may end with
        empty cells, and the last row may be short, because the recorder was stopped while writing.

    Returns
    -------
    table : ndarray, shape (n, columns)
    lines : list of int
        Number of the line of each row.
    notes : list of str
        What was left out.

    Raises
    ------
    FileFormatError
        If a row has too few or too many cells or a cell is not a number.
    """
    picked = range(len(names)) if picked is None else picked
    table, lines, short = [], [], None
    for number, cells in rows:
        if short is not None:
            break
        count = len(names)
        if len(cells) != count and not (recorded and not any(map(str.strip, cells[count:]))):
            short = number, len(cells)
            break
        if len(cells) < count:
            short = number, len(cells)
            continue
        values = []
        for index in picked:
            cell = cells[index]
            try:
                value = math.nan if "_" in cell else float(cell)  # 1_0 is a number in Python only
            except ValueError:
                value = math.nan
            if value != value:
                value = _number(path, number, names[index], cell, recorded)
            values.append(value)
        table.append(values)
        lines.append(number)
    else:
        notes = [f"line {short[0]}, the last, is truncated: left out"] if short else []
        return np.array(table, dtype=float).reshape(len(table), len(picked)), lines, notes
    raise FileFormatError(f"{path}:{short[0]}: expected {len(names)} columns, got {short[1]}")


def _number(path, line, name, cell, recorded):
    """Value of a cell that is not a plain number: quoted, empty or invalid."""
    text = cell.strip()
    if recorded:
        text = text.strip('"').strip()
        if not text:
            return math.nan
    if is_number(text):
        return float(text)
    shown = repr(text if len(text) < 40 else text[:37] + "...")
    raise FileFormatError(f"{path}:{line}: column {name}: expected a number, got {shown}")


def is_number(text: str) -> bool:
    """Whether a text is a number, or ``nan`` or ``inf``."""
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text
