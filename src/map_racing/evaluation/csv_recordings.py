"""Recorded driving from CSV files of any team's logger."""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path

import numpy as np

from ..bags.messages import yaw_and_length
from ..bags.samples import Commands, Recording, in_order, jump_back, usable
from ..bags.series import FrameChoice, followed, quaternion_note
from ..errors import FileFormatError, ParameterError
from ..printing import printable
from ..tables import column_index, read_columns, some_names, units_to_si, without_unit
from ..units import unit_at_end

__all__ = ["parse_columns", "read_csv_recording"]


def _of_pose(name):
    return tuple(f"{prefix}{name}" for prefix in ("pose.pose.", "pose.", ""))


# Usual column names of a CSV file; the first one in the file is used. Those of messages are as in
# `rostopic echo -p`, without its "field.".
_ALIASES = {
    "t": ("t", "time", "t_s", "time_s", "timestamp", "stamp", "header.stamp", "%time"),
    "x": ("x", "x_m", "tx", "pose_x", "pos_x", "position_x", *_of_pose("position.x")),
    "y": ("y", "y_m", "ty", "pose_y", "pos_y", "position_y", *_of_pose("position.y")),
    "psi": ("psi", "psi_rad", "yaw", "yaw_rad", "theta", "heading", "pose_theta"),
    "v_x": (
        *("v_x", "vx", "vx_mps", "linear_vel_x", "speed", "v", "v_mps"),
        "twist.twist.linear.x",
    ),
    "v_y": ("v_y", "vy", "vy_mps", "linear_vel_y", "twist.twist.linear.y"),
    "yaw_rate": (
        *("yaw_rate", "r", "wz", "omega", "angular_vel_z", "yaw_rate_radps"),
        "twist.twist.angular.z",
    ),
    "steering": (
        *("steering", "steering_command", "steering_cmd", "delta", "delta_rad"),
        *("angular_control", "drive.steering_angle", "steering_angle", "steer"),
    ),
    "speed_command": (
        *("speed_command", "speed_cmd", "cmd_speed", "v_command", "v_cmd", "target_speed"),
        *("desired_speed", "translational_control", "drive.speed"),
    ),
}
_QUANTITIES = {
    **{"t": "time", "x": "length", "y": "length", "psi": "angle", "steering": "angle"},
    **{"v_x": "speed", "v_y": "speed", "speed_command": "speed", "yaw_rate": "turn rate"},
}
# Also read if present: the orientation, and the time of receipt of a message.
_QUATERNION = {
    f"q_{axis}": (f"q{axis}", f"q_{axis}", *_of_pose(f"orientation.{axis}")) for axis in "xyzw"
}
# Columns of a trajectory without a header, as the TUM RGB-D benchmark and evo write it.
_UNNAMED = {8: ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")}
_RECEIVED = "%time"
_FRAMES = ("header.frame_id", "frame_id")
# Times under these names are in nanoseconds.
_NANOSECONDS = ("%time", "header.stamp")
_REQUIRED = ("t", "x", "y")
# A larger time [s] is in another unit: nanoseconds since 1970 fill an int64 in the year 2262.
_LATEST = 9.2e9
# Nanoseconds since 1970, from 1973 on.
_SINCE_1970 = 1e17
# Longer typical times between rows [s] are in another unit, or useless.
_SLOWEST = 6.0


def read_csv_recording(path: str | Path, columns: str | dict | None = None) -> Recording:
    """Read the driving recorded in a CSV file.

    The layout is described at `map_racing.tables.read_columns`; files of ``rostopic echo -p`` and
    trajectories of the TUM benchmark (``timestamp tx ty tz qx qy qz qw``, with or without a header)
    are read as they are. Time is in seconds, or in nanoseconds since 1970; rows without time or
    position are left out.

    Parameters
    ----------
    path : str or pathlib.Path
    columns : str or dict, optional
        Columns of the fields, such as ``"t=time,x=pose_x,y=pose_y"``. Fields are ``t x y``
        (required) and ``psi v_x v_y yaw_rate steering speed_command``, in SI units and radians.
        Other fields are looked for under usual names.

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
        known = ", ".join(_ALIASES)
        raise ParameterError(f"columns: unknown field {unknown[0]!r}, expected {known}")
    doubts = []
    table = read_columns(path, partial(_locate, path, columns, doubts), _UNNAMED, _frame_column)
    table.notes.extend(doubts)
    factors = units_to_si(table, {k: v for k, v in _QUANTITIES.items() if k in table.names})
    for name, factor in factors.items():
        table.values[name] = factor * table.values[name]
    _bring_to_seconds(table, "t" in factors)
    frame = _keep_one_frame(table)
    _check_times(path, table)
    _add_heading(table)
    if "psi" in table.names:
        _check_heading(table)
    nan = np.full(len(table.lines), math.nan)
    t, (x, y, psi, v_x, v_y, yaw_rate) = in_order(
        table.values["t"],
        [table.values.get(name, nan) for name in ("x", "y", "psi", "v_x", "v_y", "yaw_rate")],
        table.notes,
        "rows",
        required=2,
    )
    if t.size < 2:
        why = f" ({'; '.join(table.notes)})" if table.notes else ""
        raise FileFormatError(f"{path}: expected at least two rows with time and position{why}")
    start = t[0]
    t = t - start
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
        topic="columns " + " ".join(table.names[name] for name in _REQUIRED),
        type="CSV",
        frame=frame,
        commands=_commands(table, start),
        notes=table.notes,
    )


def _commands(table, start):
    """Commands of all rows that have any, also without a pose, held until the next."""
    names = [name for name in ("steering", "speed_command") if name in table.names]
    if not names:
        return None
    commanded = np.isfinite(table.values["t"])
    commanded &= np.any([np.isfinite(table.values[name]) for name in names], axis=0)
    nan = np.full(np.count_nonzero(commanded), math.nan)
    values = [
        table.values[name][commanded] if name in names else nan
        for name in ("steering", "speed_command")
    ]
    t, values = in_order(table.values["t"][commanded], values, [], "")
    return Commands(t - start, *values, " ".join(table.names[name] for name in names))


def _bring_to_seconds(table, stated):
    """Nanoseconds to seconds, unless the unit is stated; times of receipt where stamps are 0."""
    t, name = table.values["t"], table.names["t"]
    received = table.values.get("received")
    if received is not None and _plain(name) == "header.stamp":
        unstamped = t == 0.0
        if unstamped.any():
            t = np.where(unstamped, received, t)
            table.notes.append(
                f"{np.count_nonzero(unstamped)} of {t.size} stamps are 0: receive time"
            )
    with np.errstate(invalid="ignore"):
        known = np.abs(t[np.isfinite(t)])
        since_1970 = known.size and np.all((known > _SINCE_1970) & (known < 1e9 * _LATEST))
    if since_1970 or (_plain(name) in _NANOSECONDS and not stated):
        table.notes.append(f"column {name}: nanoseconds")
        t = t * 1e-9
    table.values["t"] = t


def _add_heading(table):
    """Headings of a file that has quaternions instead."""
    values = table.values
    if "psi" in values or not all(name in values for name in _QUATERNION):
        return
    q_x, q_y, q_z, q_w = (values[name] for name in _QUATERNION)
    with np.errstate(all="ignore"):
        values["psi"], length = yaw_and_length(q_x, q_y, q_z, q_w)
    quaternion_note(table.notes, "orientation", length)


def _check_heading(table):
    """Bring headings in degrees to radians."""
    x, y, psi = (table.values[name] for name in ("x", "y", "psi"))
    way = np.hypot(np.diff(x), np.diff(y))
    with np.errstate(all="ignore"):
        moving = (way > 0.0) & np.isfinite(way + psi[1:])
        course = np.arctan2(np.diff(y), np.diff(x))[moving]
        off = [np.exp(1j * (angle[1:][moving] - course)) for angle in (psi, np.radians(psi))]
    if not moving.any():
        return
    # The angle between heading and course is constant, whatever the zero of the heading.
    radians, degrees = (abs(np.average(turn, weights=way[moving])) for turn in off)
    if degrees > 0.9 and radians < 0.5:
        table.values["psi"] = np.radians(psi)
        table.notes.append(f"warning: column {table.names['psi']} is in degrees: converted")


def _check_times(path, table):
    """Refuse times in another unit than seconds, and two runs in one file."""
    t = table.values["t"]
    with np.errstate(invalid="ignore"):  # numpy 1.17 warns of NaN
        late = np.flatnonzero(np.isfinite(t) & (np.abs(t) > _LATEST))
    if late.size:
        raise FileFormatError(
            f"{path}:{table.lines[late[0]]}: column {table.names['t']}: expected a time in "
            f"seconds, got {t[late[0]]:g}"
        )
    kept = np.flatnonzero(usable(t, [table.values["x"], table.values["y"]]))
    typical = float(np.median(np.diff(t[kept]))) if kept.size > 1 else 0.0
    if typical > _SLOWEST:
        raise FileFormatError(
            f"{path}: column {table.names['t']}: expected a time in seconds, got one with "
            f"{typical:g} between rows"
        )
    jump = jump_back(t[kept])
    if jump:
        raise FileFormatError(
            f"{path}: time jumps back by {jump[1]:.1f} s at line {table.lines[kept[jump[0]]]}: "
            "two runs in one file?"
        )


def parse_columns(text: str) -> dict[str, str]:
    """Parse the text form of a column map, ``"t=time,x=pose_x"``.

    Parameters
    ----------
    text : str

    Returns
    -------
    dict of str to str

    Raises
    ------
    ParameterError
        If a part is not ``field=column``, or a field is given twice.
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


def _plain(name):
    """Name of a column without case, unit and the prefix of `rostopic echo -p`."""
    name = without_unit(name).lower()
    return name[len("field.") :] if name.startswith("field.") else name


def _frame_column(names):
    """Index of the column with the frame of the poses, None without."""
    plain = [_plain(name) for name in names]
    return next((plain.index(name) for name in _FRAMES if name in plain), None)


def _keep_one_frame(table):
    """The frame of the poses; poses in another frame are dropped, as in a bag."""
    if not any(table.words):
        return ""
    choice, kept, early = FrameChoice(), np.zeros(len(table.words), dtype=bool), {}
    with np.errstate(invalid="ignore"):
        times = np.where(np.abs(table.values["t"]) < _LATEST, table.values["t"], 0.0)
    for row, (word, t) in enumerate(zip(table.words, (1e9 * times).astype(np.int64).tolist())):
        last = choice.frame
        frame = printable(word).lstrip("/") or last or "map"
        if not choice.counts(frame, t):
            early[frame] = early.get(frame, 0) + 1
            continue
        if last not in (None, frame):
            count = np.count_nonzero(kept)
            said = followed(f"{count} rows", last, frame, early.pop(frame, 0))
            table.notes.append(f"warning: {said}")
            kept[:row] = False
        kept[row] = True
    for frame, count in early.items():
        table.notes.append(
            f"warning: {count} rows in another frame, {frame}, left out: only {choice.frame} counts"
        )
    table.values["x"][~kept] = math.nan
    return choice.frame


def _locate(path, columns, doubts, names):
    """Index of the column of each field that the file has."""
    where, missing = {}, []
    plain = [_plain(name) for name in names]
    for name, aliases in {**_ALIASES, **_QUATERNION}.items():
        if name in columns:
            where[name] = column_index(path, names, columns[name])
            continue
        found = next((alias for alias in aliases if alias in plain), None)
        having = plain
        if found is None and name in _QUANTITIES:
            having = [unit_at_end(column, _QUANTITIES[name])[0] for column in plain]
            found = next((alias for alias in aliases if alias in having), None)
            if name == "t" and having.count(found) > 1:  # such as stamp_sec and stamp_nsec
                found = None
        if found is not None:
            where[name] = having.index(found)
            others = [alias for alias in aliases if alias in having and alias != found]
            if name in ("x", "y") and others:
                doubts.append(
                    f"warning: {name} is column {found}; {', '.join(others)} may be the car's, too "
                    f"(--columns {name}={others[0]})"
                )
            if having.count(found) > 1:
                doubts.append(f"warning: several columns are named {found}: the first is taken")
        elif name in _REQUIRED:
            missing.append(name)
    if missing:
        which = "columns are" if len(missing) > 1 else "column is"
        raise FileFormatError(
            f"{path}: which {which} {', '.join(missing)}? It has {some_names(names)}; "
            f"say --columns {','.join(f'{name}=NAME' for name in missing)}"
        )
    if _RECEIVED in plain:
        where["received"] = plain.index(_RECEIVED)
    return where
