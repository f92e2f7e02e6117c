"""Files of courses, in each format that others read.

Heading, curvature, arc length and accelerations are those of the curve through the points written.
"""

import hashlib
import json
import math
import uuid
from pathlib import Path
from typing import NamedTuple, Optional

import numpy as np

from ...angles import wrap
from ...errors import ParameterError, RacelineError
from ...files import replacing
from ..raceline import Raceline, distinct_points
from ..speed_profile import accelerations, lap_time

__all__ = [
    "FORMATS",
    "CourseColumns",
    "choose_format",
    "closed_rows",
    "course_columns",
    "save_raceline",
    "write_course_file",
]

FORMATS = {
    "map_racing": "CSV with all columns, walls included; heading from +x",
    "tum": 'raceline of the TUM tools: 7 columns, "; ", heading from north, last point = first',
    "racetracks": "raceline of f1tenth_racetracks: 7 columns, ';', heading from +x in [0, 2 pi)",
    "centerline": "centerline of the TUM tools and f1tenth_racetracks: x, y and the widths, ','",
    "race_stack": "global_waypoints.json of race_stack",
    "bag": "ROS 1 bag with f110_msgs/WpntArray on /global_waypoints",
}
_OF_SUFFIX = {".json": ("race_stack",), ".bag": ("bag",)}
_CSV = ("map_racing", "tum", "racetracks", "centerline")


class CourseColumns(NamedTuple):
    """What is written of a course: its points in order, the first not repeated.

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


def course_columns(raceline, table=None):
    """Columns of a raceline.

    Parameters
    ----------
    raceline : Raceline
    table : CourseTable, optional
        The points that it was made of: then those are written, exactly, instead of the cells of
        the raceline's internal form.

    Returns
    -------
    CourseColumns
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
    return CourseColumns(
        raceline.name, raceline.length, s, x, y, at.psi, at.kappa, speed, a_x, d_left, d_right
    )


def choose_format(path, wanted=None):
    """Format of a file to write, by its suffix or as wanted.

    Parameters
    ----------
    path : str or pathlib.Path
    wanted : str, optional
        One of `FORMATS`.

    Returns
    -------
    str

    Raises
    ------
    ParameterError
        If several formats have that suffix, or none, or another than the one wanted.
    """
    suffix = Path(path).suffix.lower()
    possible = _OF_SUFFIX.get(suffix, _CSV)
    if wanted is None:
        if len(possible) == 1:
            return possible[0]
        if suffix == ".csv":
            raise ParameterError(
                f"{path}: several formats are CSV: say --format {', '.join(possible)}"
            )
        raise ParameterError(f"{path}: expected a file named .csv, .json or .bag, or --format")
    if wanted not in FORMATS:
        raise ParameterError(f"format {wanted}: expected one of {', '.join(FORMATS)}")
    if wanted not in possible:
        right = next((name for name, formats in _OF_SUFFIX.items() if wanted in formats), ".csv")
        raise ParameterError(f"{path}: a file of format {wanted} is named {right}")
    return wanted


def save_raceline(raceline, path):
    """Write a raceline as CSV, one line for each cell of its internal form.

    The columns are the nine of `LAYOUTS` in :mod:`.formats`, named in the header, without speeds or
    walls where the raceline has none. Heading is measured from +x, acceleration is constant from
    each point to the next, the last point does not repeat the first.

    Parameters
    ----------
    raceline : Raceline
    path : str or pathlib.Path
        Replaced in one step if it exists: a reader never meets half a file.
    """
    write_course_file(path, course_columns(raceline), "map_racing")


def write_course_file(path, course, form):
    """Write a course to a text file.

    Parameters
    ----------
    path : str or pathlib.Path
        Replaced in one step if it exists.
    course : CourseColumns
    form : str
        One of `FORMATS`, but no bag, which `map_racing.evaluation.recordings.save_course` writes.

    Raises
    ------
    RacelineError
        If the course lacks what the format needs.
    MapRacingError
        If the file cannot be written.
    """
    text = _WRITERS[form](course, str(path))
    with replacing(path) as file:
        file.write(text)


def closed_rows(course):
    """Waypoints as race_stack has them: the last repeats the first, at the whole length.

    Parameters
    ----------
    course : CourseColumns
        Speeds and widths that it lacks are written as 0.

    Returns
    -------
    ndarray, shape (n + 1, 10)
        ``s_m d_m x_m y_m d_right d_left psi_rad kappa_radpm vx_mps ax_mps2``.
    """
    zeros = np.zeros(course.s.size)
    columns = (
        *(course.s, zeros, course.x, course.y, course.d_right, course.d_left),
        *(course.psi, course.kappa, course.speed, course.a_x),
    )
    rows = np.stack([zeros if column is None else column for column in columns], axis=1)
    rows = np.concatenate((rows, rows[:1]))
    rows[-1, 0] = course.length
    return rows


# -- CSV -----------------------------------------------------------------------------------------


def _map_racing(course, path):
    columns = [
        ("s_m", course.s),
        ("x_m", course.x),
        ("y_m", course.y),
        ("psi_rad", course.psi),
        ("kappa_radpm", course.kappa),
    ]
    if course.speed is not None:
        columns += [("vx_mps", course.speed), ("ax_mps2", course.a_x)]
    if course.d_left is not None:
        columns += [("d_right_m", course.d_right), ("d_left_m", course.d_left)]
    head = [
        f"closed raceline {course.name}: {course.length:.3f} m".replace("  ", " "),
        "psi_rad from +x, counter-clockwise; kappa_radpm positive in left-hand bends; "
        "d_right_m, d_left_m to the walls",
        "; ".join(name for name, _ in columns),
    ]
    return _csv(head, [column for _, column in columns], ";")


def _tum(course, path):
    return _seven(course, path, "tum", wrap(course.psi - 0.5 * math.pi), "; ")


def _racetracks(course, path):
    return _seven(course, path, "racetracks", np.mod(course.psi, 2.0 * math.pi), ";")


def _seven(course, path, form, psi, separator):
    """The seven columns, closed, below two lines where the TUM tools have an id and a hash."""
    if course.speed is None:
        raise RacelineError(
            f"{path}: expected a course with speeds: format {form} has a column of them"
        )
    columns = (course.s, course.x, course.y, psi, course.kappa, course.speed, course.a_x)
    columns = [np.append(column, column[0]) for column in columns]
    columns[0][-1] = course.length
    content = np.stack(columns).tobytes()
    head = [
        str(uuid.uuid5(uuid.NAMESPACE_OID, hashlib.sha1(content).hexdigest())),
        hashlib.sha1(b"").hexdigest(),  # of the acceleration limits, of which no file is known here
        "s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2",
    ]
    return _csv(head, columns, separator)


def _centerline(course, path):
    if course.d_left is None:
        raise RacelineError(
            f"{path}: expected a course with walls: format centerline has their distances"
        )
    columns = [course.x, course.y, course.d_right, course.d_left]
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


def _race_stack(course, path):
    """All keys that race_stack reads, whose line of shortest path is the raceline here, too."""
    line = _waypoints(course)
    center = course if course.d_left is None else _middle(course)
    speed = course.speed
    time, v_max = 0.0, 0.0
    if speed is not None:
        v_max = float(speed.max())
        ds = np.diff(np.append(course.s, course.length))
        time = lap_time(speed, ds)
        time = time if math.isfinite(time) else 0.0
    told = "; ".join(
        f"{name} estimated lap time: {time:.4f}s; {name} maximum speed: {v_max:.4f}m/s"
        for name in ("IQP", "SP")
    )
    bounds = np.empty((0, 2))
    if course.d_left is not None:
        normal = np.stack((-np.sin(course.psi), np.cos(course.psi)), axis=1)
        xy = np.stack((course.x, course.y), axis=1)
        walls = xy - course.d_right[:, None] * normal, xy + course.d_left[:, None] * normal
        bounds = np.concatenate(walls)
    content = {
        "map_info_str": {"data": told + "; "},
        "est_lap_time": {"data": time},
        "centerline_markers": _spheres(np.stack((center.x, center.y), axis=1), (0.0, 0.0, 1.0)),
        "centerline_waypoints": _waypoints(center),
        "global_traj_markers_iqp": _columns(course, v_max, (1.0, 0.0, 0.0)),
        "global_traj_wpnts_iqp": line,
        "global_traj_markers_sp": _columns(course, v_max, (1.0, 1.0, 0.0)),
        "global_traj_wpnts_sp": line,
        "trackbounds_markers": _spheres(bounds, (0.5, 0.0, 0.5)),
    }
    return json.dumps(content) + "\n"


def _middle(course):
    """The line in the middle between the walls, at its own points; the course where that fails."""
    offset = 0.5 * (course.d_left - course.d_right)
    half = 0.5 * (course.d_left + course.d_right)
    try:
        line = Raceline(
            course.x - offset * np.sin(course.psi),
            course.y + offset * np.cos(course.psi),
            d_left_m=half,
            d_right_m=half,
        )
    except RacelineError:
        return course
    at = line.sample(line.s_points)
    return CourseColumns(
        *(course.name, line.length, line.s_points, at.x, at.y, at.psi, at.kappa),
        *(None, None, at.d_left, at.d_right),
    )


def _waypoints(course):
    points = [
        dict({"id": number}, **dict(zip(_FIELDS, row)))
        for number, row in enumerate(closed_rows(course).tolist())
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


def _columns(course, v_max, color):
    """Columns as high as the speed, the highest 1 m; spheres where there are no speeds."""
    xy = np.stack((course.x, course.y), axis=1)
    if v_max <= 0.0:
        return _spheres(xy, color)
    heights = (course.speed / v_max).tolist()
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
