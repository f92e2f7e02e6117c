"""Delimited text: columns of numbers under names."""

from __future__ import annotations

import gzip
import math
import zlib
from contextlib import contextmanager
from itertools import chain

import numpy as np

from .errors import FileFormatError
from .files import refuse_special

__all__ = ["column_index", "open_text", "parse_rows", "read_table", "some_names", "split_header"]


def read_table(path, columns):
    """Some columns of a CSV file, row by row as they are.

    The file may be gzipped; lines that begin with ``#`` are comments. The names of the columns
    are in the first other line or, if that holds numbers, in the last comment before it. Cells
    are separated by comma, semicolon or tab.

    Parameters
    ----------
    path : str or pathlib.Path
    columns : iterable of str
        Names of columns.

    Returns
    -------
    table : dict of str to ndarray, shape (n,)
        Empty cells are NaN.
    notes : list of str
        What was left out.

    Raises
    ------
    FileFormatError
        If there is no such column, or a cell is not a number; with file, line and column.
    """
    with open_text(path) as file:
        names, delimiter, rows = split_header(path, file)
        where = {column: column_index(path, names, column) for column in columns}
        table, _, notes = parse_rows(path, rows, delimiter, names, where)
    return dict(zip(where, table.T)), notes


@contextmanager
def open_text(path):
    """Open a text file, also a gzipped one; what goes wrong while it is read names it, too."""
    refuse_special(path)
    try:
        with open(path, "rb") as file:
            zipped = file.read(2) == b"\x1f\x8b"
        open_as = gzip.open if zipped else open
        with open_as(str(path), "rt", encoding="utf-8-sig") as file:
            yield file
    except (OSError, EOFError, zlib.error) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileFormatError(f"{path}: cannot read the recording: {reason}") from None
    except UnicodeDecodeError:
        raise FileFormatError(f"{path}: expected UTF-8 text (CSV) or a ROS 1 bag") from None


def split_header(path, file):
    """Names of the columns, delimiter and numbered rows of an open file."""
    comment = ""
    lines = ((number, line.strip()) for number, line in enumerate(file, 1))
    lines = ((number, line) for number, line in lines if line)
    for first in lines:
        if not first[1].startswith("#"):
            break
        comment = first[1].lstrip("# ")
    else:
        raise FileFormatError(f"{path}: expected rows of numbers, got none")
    delimiter = max(",;\t", key=first[1].count)
    numeric = _is_number(first[1].split(delimiter)[0])
    header = comment if numeric else first[1]
    if not header:
        raise FileFormatError(f"{path}: expected names of columns above the numbers, found none")
    names = [name.strip().strip('"') for name in header.split(delimiter)]
    data = (row for row in lines if not row[1].startswith("#"))
    return names, delimiter, chain([first], data) if numeric else data


def column_index(path, names, column):
    if column not in names:
        raise FileFormatError(f"{path}: no column {column!r}; it has {some_names(names)}")
    return names.index(column)


def some_names(names):
    return ", ".join(names[:16]) + (", ..." if len(names) > 16 else "")


def parse_rows(path, rows, delimiter, names, where):
    """Values of the located columns, shape (rows, fields), numbers of their lines, and notes."""
    table, numbers, notes, short = [], [], [], None
    for number, line in rows:
        if short is not None:
            raise FileFormatError(
                f"{path}:{short[0]}: expected {len(names)} columns, got {short[1]}"
            )
        cells = line.split(delimiter)
        if len(cells) < len(names):
            # Only a last line may be short: the recorder was stopped while writing it.
            short = number, len(cells)
            continue
        values = []
        for index in where.values():
            try:
                values.append(float(cells[index]))
            except ValueError:
                values.append(_number(path, number, names[index], cells[index]))
        table.append(values)
        numbers.append(number)
    if short is not None:
        notes.append(f"line {short[0]}, the last, is cut off: left out")
    return np.array(table, dtype=float).reshape(len(table), len(where)), numbers, notes


def _number(path, line, name, cell):
    """Value of a cell that is not simply a number: quoted, empty or wrong."""
    text = cell.strip().strip('"').strip()
    try:
        return float(text) if text else math.nan
    except ValueError:
        shown = repr(text if len(text) < 40 else text[:37] + "...")
        raise FileFormatError(
            f"{path}:{line}: column {name}: expected a number, got {shown}"
        ) from None


def _is_number(text):
    try:
        float(text)
    except ValueError:
        return False
    return True
