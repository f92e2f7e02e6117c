"""Raceline files in every format that others read.

Heading, curvature, arc length and accelerations are computed from the curve through the points.
"""

from __future__ import annotations

import hashlib
import json
import math
import uuid
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ...angles import wrap
from ...bags.messages import WAYPOINT_FIELDS
from ...errors import RacelineError
from ...files import replacing
from ..raceline import Raceline
from ..speed_profile import accelerations, lap_time
from ..spline import distinct_points
from .table import RacelineTable
from .waypoints import waypoint_array

__all__ = [
    "RacelineColumns",
    "closed_rows",
    "raceline_columns",
    "write_raceline_file",
]


class RacelineColumns(NamedTuple):
    """Columns to write: the points in order, the first not repeated.

    Each has the shape (n,). Lengths are in meters, angles in radians; speeds [m/s] with the
    acceleration [m/s^2] that is constant from each point to the next, and distances to the walls
    [m], are None where unknown.
    """

    name: str
    length: float
    s: np.ndarray
    x: np.ndarray
    y: np.ndarray
    psi: np.ndarray
    kappa: np.ndarray
    speed: np.ndarray | None
    a_x: np.ndarray | None
    d_left: np.ndarray | None
    d_right: np.ndarray | None


def raceline_columns(raceline: Raceline, table: RacelineTable | None = None) -> RacelineColumns:
    """Columns of a raceline to write.

    Parameters
    ----------
    raceline : Raceline
    table : RacelineTable, optional
        The points that it was made of, to be written exactly, instead of the cells of the
        raceline's internal form.

    Returns
    -------
    RacelineColumns
    """
    s = raceline.s if table is None else raceline.s_points
    at = raceline.sample(s)
    x, y, speed, d_left, d_right = at.x, at.y, at.speed, at.d_left, at.d_right
    if table is not None:
        keep = distinct_points(table.columns["x"], table.columns["y"])
        x, y = table.columns["x"][keep], table.columns["y"][keep]
        speed = None if speed is None else table.columns["speed"][keep]
        if d_left is not None:
            d_left, d_right = table.columns["d_left"][keep], table.columns["d_right"][keep]
    a_x = None
    if speed is not None:
        a_x = accelerations(speed, np.diff(np.append(s, raceline.length)))
    return RacelineColumns(
        raceline.name, raceline.length, s, x, y, at.psi, at.kappa, speed, a_x, d_left, d_right
    )


def write_raceline_file(path: str | Path, line: RacelineColumns, form: str) -> None:
    """Write a raceline to a text file.

    Parameters
    ----------
    path : str or pathlib.Path
        Replaced in one step if it exists.
    line : RacelineColumns
    form : str
        One of `FORMATS`, except bag.

    Raises
    ------
    RacelineError, MapRacingError
        As by `map_racing.track.files.load.save_raceline`, which also writes bags.
    """
    text = _WRITERS[form](line, str(path))
    with replacing(path) as file:
        file.write(text)


def closed_rows(line: RacelineColumns) -> np.ndarray:
    """Waypoints as race_stack writes them: the last repeats the first, at the full length.

    Returns
    -------
    ndarray, shape (n + 1,)
        See `map_racing.track.files.waypoints.waypoint_array`.
    """
    rows = waypoint_array(
        line.s.size,
        s_m=line.s,
        x_m=line.x,
        y_m=line.y,
        d_right=line.d_right,
        d_left=line.d_left,
        psi_rad=line.psi,
        kappa_radpm=line.kappa,
        vx_mps=line.speed,
        ax_mps2=line.a_x,
    )
    rows = np.concatenate((rows, rows[:1]))
    rows["s_m"][-1] = line.length
    return rows


# -- CSV -----------------------------------------------------------------------------------------


def _map_racing(line, path):
    columns = [
        ("s_m", line.s),
        ("x_m", line.x),
        ("y_m", line.y),
        ("psi_rad", line.psi),
        ("kappa_radpm", line.kappa),
    ]
    if line.speed is not None:
        columns += [("vx_mps", line.speed), ("ax_mps2", line.a_x)]
    if line.d_left is not None:
        columns += [("d_right_m", line.d_right), ("d_left_m", line.d_left)]
    head = [
        f"closed raceline {line.name}: {line.length:.3f} m".replace("  ", " "),
        "psi_rad from +x, counter-clockwise; kappa_radpm positive in left-hand bends; "
        "d_right_m, d_left_m to the walls",
        "; ".join(name for name, _ in columns),
    ]
    return _csv(head, [column for _, column in columns], ";")


def _tum(line, path):
    return _seven(line, path, "tum", wrap(line.psi - 0.5 * math.pi), "; ")


def _racetracks(line, path):
    return _seven(line, path, "racetracks", np.mod(line.psi, 2.0 * math.pi), ";")


def _seven(line, path, form, psi, separator):
    """The seven columns, closed, below the two lines of the TUM tools for an id and a hash."""
    if line.speed is None:
        raise RacelineError(f"{path}: expected a raceline with speeds for format {form}, got none")
    columns = (line.s, line.x, line.y, psi, line.kappa, line.speed, line.a_x)
    columns = [np.append(column, column[0]) for column in columns]
    columns[0][-1] = line.length
    content = np.stack(columns).tobytes()
    head = [
        str(uuid.uuid5(uuid.NAMESPACE_OID, hashlib.sha1(content).hexdigest())),
        hashlib.sha1(b"").hexdigest(),  # of the file of acceleration limits: there is none
        "s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2",
    ]
    return _csv(head, columns, separator)


def _centerline(line, path):
    if line.d_left is None:
        raise RacelineError(
            f"{path}: expected a raceline with walls for format centerline, got none"
        )
    columns = [line.x, line.y, line.d_right, line.d_left]
    return _csv(["x_m,y_m,w_tr_right_m,w_tr_left_m"], columns, ",")


def _csv(head, columns, separator):
    # Seven decimals are a tenth of a micrometer; "+ 0.0" turns -0.0 into 0.0.
    table = np.round(np.stack(columns, axis=1), 7) + 0.0
    row = separator.join(["%.7f"] * len(columns))
    lines = [f"# {line}" for line in head] + [row % tuple(values) for values in table.tolist()]
    return "\n".join(lines) + "\n"


# -- race_stack ----------------------------------------------------------------------------------


def _race_stack(line, path):
    """All keys that race_stack reads; the shortest path (sp) is the raceline, too."""
    waypoints = _waypoints(line)
    center = line if line.d_left is None else _middle(line)
    speed = line.speed
    time, v_max = 0.0, 0.0
    if speed is not None:
        v_max = float(speed.max())
        ds = np.diff(np.append(line.s, line.length))
        time = lap_time(speed, ds)
        time = time if math.isfinite(time) else 0.0
    info = "; ".join(
        f"{name} estimated lap time: {time:.4f}s; {name} maximum speed: {v_max:.4f}m/s"
        for name in ("IQP", "SP")
    )
    bounds = np.empty((0, 2))
    if line.d_left is not None:
        normal = np.stack((-np.sin(line.psi), np.cos(line.psi)), axis=1)
        xy = np.stack((line.x, line.y), axis=1)
        walls = xy - line.d_right[:, None] * normal, xy + line.d_left[:, None] * normal
        bounds = np.concatenate(walls)
    content = {
        "map_info_str": {"data": info + "; "},
        "est_lap_time": {"data": time},
        "centerline_markers": _spheres(np.stack((center.x, center.y), axis=1), (0.0, 0.0, 1.0)),
        "centerline_waypoints": _waypoints(center),
        "global_traj_markers_iqp": _columns(line, v_max, (1.0, 0.0, 0.0)),
        "global_traj_wpnts_iqp": waypoints,
        "global_traj_markers_sp": _columns(line, v_max, (1.0, 1.0, 0.0)),
        "global_traj_wpnts_sp": waypoints,
        "trackbounds_markers": _spheres(bounds, (0.5, 0.0, 0.5)),
    }
    return json.dumps(content) + "\n"


def _middle(line):
    """Middle line between the walls; the line itself where no curve can be built."""
    offset = 0.5 * (line.d_left - line.d_right)
    half = 0.5 * (line.d_left + line.d_right)
    try:
        center = Raceline(
            line.x - offset * np.sin(line.psi),
            line.y + offset * np.cos(line.psi),
            d_left_m=half,
            d_right_m=half,
        )
    except RacelineError:
        return line
    at = center.sample(center.s_points)
    return RacelineColumns(
        line.name,
        center.length,
        center.s_points,
        at.x,
        at.y,
        at.psi,
        at.kappa,
        speed=None,
        a_x=None,
        d_left=at.d_left,
        d_right=at.d_right,
    )


def _waypoints(line):
    points = [
        dict({"id": number}, **dict(zip(WAYPOINT_FIELDS, row)))
        for number, row in enumerate(closed_rows(line).tolist())
    ]
    return {"header": _header(), "wpnts": points}


def _header():
    return {"seq": 0, "stamp": {"secs": 0, "nsecs": 0}, "frame_id": "map"}


def _spheres(xy, color):
    size = (0.05, 0.05, 0.05)
    return {
        "markers": [
            _marker(number, 2, (x, y, 0.0), size, color)
            for number, (x, y) in enumerate(xy.tolist())
        ]
    }


def _columns(line, v_max, color):
    """Columns as high as the speed, the highest 1 m; spheres where there are no speeds."""
    xy = np.stack((line.x, line.y), axis=1)
    if v_max <= 0.0:
        return _spheres(xy, color)
    heights = (line.speed / v_max).tolist()
    return {
        "markers": [
            _marker(number, 3, (x, y, 0.5 * height), (0.1, 0.1, height), color)
            for number, ((x, y), height) in enumerate(zip(xy.tolist(), heights))
        ]
    }


def _marker(number, kind, position, size, color):
    """A ``visualization_msgs/Marker`` as a dictionary with every field."""
    return {
        "header": _header(),
        "ns": "",
        "id": number,
        "type": kind,
        "action": 0,
        "pose": {
            "position": dict(zip("xyz", position)),
            "orientation": {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0},
        },
        "scale": dict(zip("xyz", size)),
        "color": dict(zip("rgba", (*color, 1.0))),
        "lifetime": {"secs": 0, "nsecs": 0},
        "frame_locked": False,
        "points": [],
        "colors": [],
        "text": "",
        "mesh_resource": "",
        "mesh_use_embedded_materials": False,
    }


_WRITERS = {
    "map_racing": _map_racing,
    "tum": _tum,
    "racetracks": _racetracks,
    "centerline": _centerline,
    "race_stack": _race_stack,
}
