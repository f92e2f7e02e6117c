"""Recorded driving and courses from whatever file holds them."""

from __future__ import annotations

import gzip
import math
import zlib
from contextlib import contextmanager
from itertools import chain
from pathlib import Path

import numpy as np

from ..errors import FileFormatError, ParameterError
from ..track.checks import raceline_of
from ..track.formats import find_course_file, read_course_file, split_source
from ..track.writers import choose_format, closed_rows, write_course_file
from .bags import BagWriter, read_recording, read_waypoint_table
from .samples import Commands, Recording, in_order, jump_back, usable

__all__ = [
    "Commands",
    "Recording",
    "is_bag",
    "load_course",
    "load_recording",
    "parse_columns",
    "read_course",
    "read_csv_recording",
    "read_table",
    "save_course",
]

# Names under which columns of a CSV file are known; the first that the file has is taken.
_ALIASES = {
    "t": ("t", "time", "t_s", "time_s", "timestamp", "stamp"),
    "x": ("x", "x_m", "pose_x", "pos_x", "position_x"),
    "y": ("y", "y_m", "pose_y", "pos_y", "position_y"),
    "psi": ("psi", "psi_rad", "yaw", "yaw_rad", "theta", "heading", "pose_theta"),
    "v_x": ("v_x", "vx", "vx_mps", "linear_vel_x", "speed", "v", "v_mps"),
    "v_y": ("v_y", "vy", "vy_mps", "linear_vel_y"),
    "yaw_rate": ("yaw_rate", "r", "wz", "omega", "angular_vel_z", "yaw_rate_radps"),
    "steering": ("steering", "steering_command", "delta", "delta_rad", "angular_control"),
    "speed_command": ("speed_command", "v_command", "translational_control"),
}
_REQUIRED = ("t", "x", "y")
# Beyond this [s] a time is in another unit: nanoseconds since 1970 fill an int64 in the year 2262.
_LATEST = 9.2e9


def load_recording(source, pose_topic=None, columns=None):
    """Driving from a bag or a CSV file.

    Parameters
    ----------
    source : str or pathlib.Path
        A ROS 1 bag, or a CSV file (also ``.gz``).
    pose_topic : str, optional
        Topic of the pose in a bag, see `map_racing.evaluation.bags.read_recording`.
    columns : str or dict, optional
        Names of the columns of a CSV file, see `read_csv_recording`.

    Returns
    -------
    Recording

    Raises
    ------
    BagError, FileFormatError, ParameterError
        If the file cannot be read as what it is.
    """
    _refuse_special(source)
    if not _is_csv(source):
        if columns:
            raise ParameterError(f"{source}: a bag has no columns; they are for CSV files")
        return read_recording(source, pose_topic)
    if pose_topic is not None:
        raise ParameterError(f"{source}: a CSV file has no topic {pose_topic}")
    return read_csv_recording(source, columns)


def load_course(source):
    """Raceline from wherever it is: what every command and node reads one with.

    Parameters
    ----------
    source : str or pathlib.Path
        See `read_course`.

    Returns
    -------
    Raceline
        With what was noticed as `findings`.

    Raises
    ------
    BagError, FileFormatError, ParameterError
        If it cannot be read.
    RacelineError
        If something is wrong with it beyond use.
    """
    return raceline_of(read_course(source))


def read_course(source):
    """What a file says of a course, wherever it is, before anything of it is believed.

    Parameters
    ----------
    source : str or pathlib.Path
        Name of a shipped track, a raceline file (see `map_racing.track.formats`), or a bag with
        ``f110_msgs/WpntArray`` or ``nav_msgs/Path``. ``FILE#KEY`` names the topic of a bag, the
        waypoint array of a JSON file, or the columns of a CSV file, as ``line.csv#x,y,speed``.

    Returns
    -------
    CourseTable

    Raises
    ------
    BagError, FileFormatError, ParameterError
        If it cannot be read.
    """
    path, topic = split_source(source)
    _refuse_special(path)
    if is_bag(path):
        return read_waypoint_table(path, topic or None)
    return read_course_file(*find_course_file(source))


def save_course(path, course, form=None):
    """Write a course in any of the `map_racing.track.writers.FORMATS`.

    Parameters
    ----------
    path : str or pathlib.Path
        Replaced in one step if it exists.
    course : CourseColumns
        Of `map_racing.track.writers.course_columns`.
    form : str, optional
        Needed where the suffix of the path does not tell it.

    Returns
    -------
    str
        The format.

    Raises
    ------
    ParameterError
        If the format is unknown or does not go with the suffix.
    RacelineError
        If the course lacks what the format needs.
    MapRacingError
        If the file cannot be written.
    """
    form = choose_format(path, form)
    if form == "bag":
        with BagWriter(path) as bag:
            # ROS has no time 0; 1 s after it is as good as any, and always the same.
            bag.waypoints(1.0, closed_rows(course))
    else:
        write_course_file(path, course, form)
    return form


def read_csv_recording(path, columns=None):
    """Driving from a CSV file.

    The file may be gzipped; lines that begin with ``#`` are comments. The names of the columns
    stand in the first other line or, if that holds numbers, in the last comment before it. Cells
    are separated by comma, semicolon or tab. Time is in seconds; rows without time or position
    are left out, and so is a last line that was cut off.

    Parameters
    ----------
    path : str or pathlib.Path
    columns : str or dict, optional
        Which column holds what, such as ``"t=time,x=pose_x,y=pose_y"``. Fields are ``t x y``
        (required) and ``psi v_x v_y yaw_rate steering speed_command``, in SI units and radians.
        What is not given is looked for under usual names.

    Returns
    -------
    Recording

    Raises
    ------
    FileFormatError
        With file, line and column, if there is no such column or a cell is not a number, or if
        time falls back by 1 s or more (two runs in one file).
    ParameterError
        If `columns` names an unknown field.
    """
    columns = parse_columns(columns) if isinstance(columns, str) else dict(columns or {})
    unknown = sorted(set(columns) - set(_ALIASES))
    if unknown:
        raise ParameterError(f"columns: unknown field {unknown[0]!r}, expected {_fields()}")
    with _open_text(path) as file:
        names, delimiter, rows = _split_header(path, file)
        where = _locate(path, names, columns)
        table, numbers, notes = _parse_rows(path, rows, delimiter, names, where)
    values = dict(zip(where, table.T))
    nan = np.full(len(table), math.nan)
    kept = np.flatnonzero(usable(values["t"], [values["x"], values["y"]]))
    jump = jump_back(values["t"][kept])
    if jump:
        raise FileFormatError(
            f"{path}: time jumps back by {jump[1]:.1f} s at line {numbers[kept[jump[0]]]}: "
            "two runs in one file?"
        )
    t, (x, y, *rest) = in_order(
        values["t"],
        [values.get(name, nan) for name in _ALIASES if name != "t"],
        notes,
        "rows",
        required=2,
    )
    if t.size < 2:
        why = f" ({'; '.join(notes)})" if notes else ""
        raise FileFormatError(f"{path}: expected at least two rows with time and position{why}")
    psi, v_x, v_y, yaw_rate, steering, speed = rest
    start = t[0]
    t = t - start
    given = [names[where[name]] for name in ("steering", "speed_command") if name in where]
    commands = Commands(t, steering, speed, " ".join(given)) if given else None
    return Recording(
        t,
        x,
        y,
        psi,
        v_x,
        v_y,
        yaw_rate,
        t0_ns=int(round(start * 1e9)),
        source=str(path),
        topic=" ".join(names[where[name]] for name in _REQUIRED),
        type="CSV",
        commands=commands,
        notes=notes,
    )


def read_table(path, columns):
    """Some columns of a CSV file, laid out as `read_csv_recording` says, row by row as they are.

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
    with _open_text(path) as file:
        names, delimiter, rows = _split_header(path, file)
        where = {column: _index(path, names, column) for column in columns}
        table, _, notes = _parse_rows(path, rows, delimiter, names, where, seconds=False)
    return dict(zip(where, table.T)), notes


def parse_columns(text):
    """Column map from its text form ``"t=time,x=pose_x"``.

    Parameters
    ----------
    text : str

    Returns
    -------
    dict of str to str

    Raises
    ------
    ParameterError
        If a part is not of the form ``field=column``, or a field is given twice.
    """
    columns = {}
    for part in text.split(","):
        name, equals, column = (piece.strip() for piece in part.partition("="))
        if not (name and equals and column):
            raise ParameterError(f"columns: expected field=column, got {part!r}")
        if name in columns:
            raise ParameterError(f"columns: field {name!r} is given twice")
        columns[name] = column
    return columns


def _fields():
    return ", ".join(_ALIASES)


def _refuse_special(path):
    """Refuse pipes and devices, since reading one may never end, and no name at all."""
    if not str(path):
        raise FileFormatError("'': expected the name of a file")
    path = Path(path)
    if path.exists() and not (path.is_file() or path.is_dir()):
        raise FileFormatError(f"{path}: expected a file, got a pipe or a device")


def is_bag(path):
    """Whether a path means a bag: by its content or, for want of a file, by its name.

    Parameters
    ----------
    path : str or pathlib.Path

    Returns
    -------
    bool
    """
    try:
        with open(path, "rb") as file:
            return file.read(8) == b"#ROSBAG " or Path(path).suffix in (".bag", ".active")
    except OSError:
        return Path(path).suffix in (".bag", ".active")


def _is_csv(path):
    names = Path(path).name.lower()
    return not is_bag(path) and names.endswith((".csv", ".txt", ".tsv", ".gz"))


@contextmanager
def _open_text(path):
    """Open a text file, also a gzipped one; what goes wrong while it is read names it, too."""
    _refuse_special(path)
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


def _split_header(path, file):
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


def _locate(path, names, columns):
    """Index of the column of each field that the file has."""
    where = {}
    lowered = [name.lower() for name in names]
    for name, aliases in _ALIASES.items():
        if name in columns:
            where[name] = _index(path, names, columns[name])
            continue
        found = next((alias for alias in aliases if alias in lowered), None)
        if found is not None:
            where[name] = lowered.index(found)
        elif name in _REQUIRED:
            raise FileFormatError(
                f"{path}: which column is {name}? It has {_some(names)}; say --columns {name}=NAME"
            )
    return where


def _index(path, names, column):
    if column not in names:
        raise FileFormatError(f"{path}: no column {column!r}; it has {_some(names)}")
    return names.index(column)


def _some(names):
    return ", ".join(names[:16]) + (", ..." if len(names) > 16 else "")


def _parse_rows(path, rows, delimiter, names, where, seconds=True):
    """Values of the located columns, shape (rows, fields), numbers of their lines, and notes.

    With `seconds`, the field ``t`` must be a time in seconds.
    """
    table, numbers, notes, short = [], [], [], None
    fields = list(where)
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
        time = values[fields.index("t")] if seconds else math.nan
        if math.isfinite(time) and abs(time) > _LATEST:
            raise FileFormatError(
                f"{path}:{number}: column {names[where['t']]}: expected a time in seconds, "
                f"got {time:g}"
            )
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
