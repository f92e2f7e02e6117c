"""Files of tracks, in each format that others read.

Heading, curvature, arc length and accelerations are those of the curve through the points written.
"""

import hashlib
import json
import math
import uuid
from typing import NamedTuple, Optional

import numpy as np

from ...angles import wrap
from ...errors import RacelineError
from ...files import replacing
from ..raceline import Raceline, distinct_points
from ..speed_profile import accelerations, lap_time

__all__ = [
    "RacelineColumns",
    "closed_rows",
    "raceline_columns",
    "write_raceline_file",
]


class RacelineColumns(NamedTuple):
    """What is written of a track: its points in order, the first not repeated.

    Lengths are in meters, angles in radians; speeds [m/s] with the acceleration [m/s^2] that is
    constant from each point to the next, and distances to the walls [m], are None where unknown.
    """

    name: str
    length: float
    s: np.ndarray
    x: np.ndarray
    y: np.ndarray
    psi: np.ndarray
    kappa: np.ndarray
    speed: Optional[np.ndarray]
    a_x: Optional[np.ndarray]
    d_left: Optional[np.ndarray]
    d_right: Optional[np.ndarray]


def raceline_columns(raceline, table=None):
    """Columns of a raceline.

    Parameters
    ----------
    raceline : Raceline
    table : RacelineTable, optional
        The points that it was made of: then those are written, exactly, instead of the cells of
        the raceline's internal form.

    Returns
    -------
    RacelineColumns
    """
    s = raceline.s if table is None else raceline.s_points
    at = raceline.sample(s)
    x, y, speed, d_left, d_right = at.x, at.y, at.speed, at.d_left, at.d_right
    if table is not None:
        keep = distinct_points(table.columns["x"], table.columns["y"])
        x, y, speed, d_left, d_right = (
            table.columns[key][keep] if own is not None else None
            for key, own in (
                *(("x", x), ("y", y), ("speed", speed)),
                *(("d_left", d_left), ("d_right", d_right)),
            )
        )
    a_x = None
    if speed is not None:
        a_x = accelerations(speed, np.diff(np.append(s, raceline.length)))
    return RacelineColumns(
        raceline.name, raceline.length, s, x, y, at.psi, at.kappa, speed, a_x, d_left, d_right
    )


def write_raceline_file(path, track, form):
    """Write a track to a text file.

    Parameters
    ----------
    path : str or pathlib.Path
        Replaced in one step if it exists.
    track : RacelineColumns
    form : str
        One of `FORMATS`, except bag, which `map_racing.track.files.load.save_raceline` writes.

    Raises
    ------
    RacelineError
        If the track lacks what the format needs.
    MapRacingError
        If the file cannot be written.
    """
    text = _WRITERS[form](track, str(path))
    with replacing(path) as file:
        file.write(text)


def closed_rows(track):
    """Waypoints as race_stack has them: the last repeats the first, at the whole length.

    Parameters
    ----------
    track : RacelineColumns
        Speeds and widths that it lacks are written as 0.

    Returns
    -------
    ndarray, shape (n + 1, 10)
        ``s_m d_m x_m y_m d_right d_left psi_rad kappa_radpm vx_mps ax_mps2``.
    """
    zeros = np.zeros(track.s.size)
    columns = (
        *(track.s, zeros, track.x, track.y, track.d_right, track.d_left),
        *(track.psi, track.kappa, track.speed, track.a_x),
    )
    rows = np.stack([zeros if column is None else column for column in columns], axis=1)
    rows = np.concatenate((rows, rows[:1]))
    rows[-1, 0] = track.length
    return rows


# -- CSV -----------------------------------------------------------------------------------------


def _map_racing(track, path):
    columns = [
        ("s_m", track.s),
        ("x_m", track.x),
        ("y_m", track.y),
        ("psi_rad", track.psi),
        ("kappa_radpm", track.kappa),
    ]
    if track.speed is not None:
        columns += [("vx_mps", track.speed), ("ax_mps2", track.a_x)]
    if track.d_left is not None:
        columns += [("d_right_m", track.d_right), ("d_left_m", track.d_left)]
    head = [
        f"closed raceline {track.name}: {track.length:.3f} m".replace("  ", " "),
        "psi_rad from +x, counter-clockwise; kappa_radpm positive in left-hand bends; "
        "d_right_m, d_left_m to the walls",
        "; ".join(name for name, _ in columns),
    ]
    return _csv(head, [column for _, column in columns], ";")


def _tum(track, path):
    return _seven(track, path, "tum", wrap(track.psi - 0.5 * math.pi), "; ")


def _racetracks(track, path):
    return _seven(track, path, "racetracks", np.mod(track.psi, 2.0 * math.pi), ";")


def _seven(track, path, form, psi, separator):
    """The seven columns, closed, below two lines where the TUM tools have an id and a hash."""
    if track.speed is None:
        raise RacelineError(
            f"{path}: expected a track with speeds: format {form} has a column of them"
        )
    columns = (track.s, track.x, track.y, psi, track.kappa, track.speed, track.a_x)
    columns = [np.append(column, column[0]) for column in columns]
    columns[0][-1] = track.length
    content = np.stack(columns).tobytes()
    head = [
        str(uuid.uuid5(uuid.NAMESPACE_OID, hashlib.sha1(content).hexdigest())),
        hashlib.sha1(b"").hexdigest(),  # of the acceleration limits, of which no file is known here
        "s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2",
    ]
    return _csv(head, columns, separator)


def _centerline(track, path):
    if track.d_left is None:
        raise RacelineError(
            f"{path}: expected a track with walls: format centerline has their distances"
        )
    columns = [track.x, track.y, track.d_right, track.d_left]
    return _csv(["x_m,y_m,w_tr_right_m,w_tr_left_m"], columns, ",")


def _csv(head, columns, separator):
    # Seven decimals are a tenth of a micrometer; "+ 0.0" turns -0.0 into 0.0.
    table = np.round(np.stack(columns, axis=1), 7) + 0.0
    row = separator.join(["%.7f"] * len(columns))
    lines = [f"# {line}" for line in head] + [row % tuple(values) for values in table.tolist()]
    return "\n".join(lines) + "\n"


# -- race_stack ----------------------------------------------------------------------------------


_FIELDS = ("s_m", "d_m", "x_m", "y_m", "d_right", "d_left")
_FIELDS += ("psi_rad", "kappa_radpm", "vx_mps", "ax_mps2")


def _race_stack(track, path):
    """All keys that race_stack reads, whose line of shortest path is the raceline here, too."""
    line = _waypoints(track)
    center = track if track.d_left is None else _middle(track)
    speed = track.speed
    time, v_max = 0.0, 0.0
    if speed is not None:
        v_max = float(speed.max())
        ds = np.diff(np.append(track.s, track.length))
        time = lap_time(speed, ds)
        time = time if math.isfinite(time) else 0.0
    told = "; ".join(
        f"{name} estimated lap time: {time:.4f}s; {name} maximum speed: {v_max:.4f}m/s"
        for name in ("IQP", "SP")
    )
    bounds = np.empty((0, 2))
    if track.d_left is not None:
        normal = np.stack((-np.sin(track.psi), np.cos(track.psi)), axis=1)
        xy = np.stack((track.x, track.y), axis=1)
        walls = xy - track.d_right[:, None] * normal, xy + track.d_left[:, None] * normal
        bounds = np.concatenate(walls)
    content = {
        "map_info_str": {"data": told + "; "},
        "est_lap_time": {"data": time},
        "centerline_markers": _spheres(np.stack((center.x, center.y), axis=1), (0.0, 0.0, 1.0)),
        "centerline_waypoints": _waypoints(center),
        "global_traj_markers_iqp": _columns(track, v_max, (1.0, 0.0, 0.0)),
        "global_traj_wpnts_iqp": line,
        "global_traj_markers_sp": _columns(track, v_max, (1.0, 1.0, 0.0)),
        "global_traj_wpnts_sp": line,
        "trackbounds_markers": _spheres(bounds, (0.5, 0.0, 0.5)),
    }
    return json.dumps(content) + "\n"


def _middle(track):
    """The line in the middle between the walls, at its own points; the track where that fails."""
    offset = 0.5 * (track.d_left - track.d_right)
    half = 0.5 * (track.d_left + track.d_right)
    try:
        line = Raceline(
            track.x - offset * np.sin(track.psi),
            track.y + offset * np.cos(track.psi),
            d_left_m=half,
            d_right_m=half,
        )
    except RacelineError:
        return track
    at = line.sample(line.s_points)
    return RacelineColumns(
        *(track.name, line.length, line.s_points, at.x, at.y, at.psi, at.kappa),
        *(None, None, at.d_left, at.d_right),
    )


def _waypoints(track):
    points = [
        dict({"id": number}, **dict(zip(_FIELDS, row)))
        for number, row in enumerate(closed_rows(track).tolist())
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


def _columns(track, v_max, color):
    """Columns as high as the speed, the highest 1 m; spheres where there are no speeds."""
    xy = np.stack((track.x, track.y), axis=1)
    if v_max <= 0.0:
        return _spheres(xy, color)
    heights = (track.speed / v_max).tolist()
    return {
        "markers": [
            _marker(number, 3, (x, y, 0.5 * height), (0.1, 0.1, height), color)
            for number, ((x, y), height) in enumerate(zip(xy.tolist(), heights))
        ]
    }


def _marker(number, kind, position, size, color):
    """A ``visualization_msgs/Marker`` with every field, as dictionaries of messages have them."""
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
