"""Columns of racelines: their names in files and messages, and their meaning without names."""

from __future__ import annotations

from typing import Any, Mapping

import numpy as np

from ...angles import wrap
from ..findings import NOTE, WARNING, Finding
from ..spline import distinct_points

__all__ = [
    "ALIASES",
    "LAYOUTS",
    "MEANING",
    "REFERENCE",
    "columns_of_waypoints",
    "from_reference_line",
    "name_by_numbers",
]

# Names of columns in files and messages, compared in lower case.
ALIASES = {
    "s": ("s_m", "s", "s_racetraj_m"),
    "x": ("x_m", "x"),
    "y": ("y_m", "y"),
    "psi": ("psi_rad", "psi", "yaw", "theta", "heading_rad", "psi_racetraj_rad"),
    "kappa": ("kappa_radpm", "kappa", "curvature", "kappa_racetraj_radpm"),
    "speed": (
        "vx_mps",
        "v_mps",
        "vx",
        "v",
        "speed",
        "speed_mps",
        "velocity",
        "vx_racetraj_mps",
    ),
    "ax": ("ax_mps2", "ax", "ax_racetraj_mps2"),
    "d_right": (
        "d_right_m",
        "d_right",
        "w_tr_right_m",
        "w_right_m",
        "d_right_iqp",
        "d_right_sp",
        "width_right_m",
    ),
    "d_left": (
        "d_left_m",
        "d_left",
        "w_tr_left_m",
        "w_left_m",
        "d_left_iqp",
        "d_left_sp",
        "width_left_m",
    ),
    "width": ("w_tr_m", "width_m", "width"),
    # A reference line with widths; the raceline lies `alpha` along its normals.
    "x_ref": ("x_ref_m", "x_ref"),
    "y_ref": ("y_ref_m", "y_ref"),
    "x_normal": ("x_normvec_m", "x_normvec"),
    "y_normal": ("y_normvec_m", "y_normvec"),
    "alpha": ("alpha_m", "alpha"),
}
MEANING = {alias: column for column, aliases in ALIASES.items() for alias in aliases}
REFERENCE = ("x_ref", "y_ref", "x_normal", "y_normal", "alpha")

# Files without names, by number of columns; see `name_by_numbers` for "third" to "fifth".
LAYOUTS = {
    2: ("x", "y"),
    3: ("x", "y", "third"),
    4: ("x", "y", "d_right", "d_left"),
    5: ("x", "y", "third", "fourth", "fifth"),
    7: ("s", "x", "y", "psi", "kappa", "speed", "ax"),
    8: ("s", "x", "y", "psi", "kappa", "speed", "ax", "z"),
    9: ("s", "x", "y", "psi", "kappa", "speed", "ax", "d_right", "d_left"),
    10: ("s", "x", "y", "psi", "kappa", "speed", "ax", "d_right", "d_left", "z"),
    12: (
        "x_ref",
        "y_ref",
        "d_right",
        "d_left",
        "x_normal",
        "y_normal",
        "alpha",
        "s",
        "psi",
        "kappa",
        "speed",
        "ax",
    ),
}


def columns_of_waypoints(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Columns by the names in `ALIASES` of the fields of ``f110_msgs/Wpnt``."""
    return {MEANING[field]: column for field, column in fields.items() if field in MEANING}


def name_by_numbers(
    columns: dict[str, np.ndarray], findings: list[Finding]
) -> dict[str, np.ndarray]:
    """Name the columns of a file without names whose meaning depends on their numbers."""
    third = columns.pop("third", None)
    if third is None:
        return columns
    if "fifth" in columns:
        # The height is last or, as in the TUM tools, between position and widths.
        fourth, fifth = columns.pop("fourth"), columns.pop("fifth")
        last = not np.any(fifth > 0.0) or np.ptp(fifth) < 1e-9 < np.ptp(third)
        between = not np.any(third > 0.0) or np.any(third < 0.0) or np.ptp(third) < 1e-9
        if between and not last and np.all(fifth >= 0.0):
            columns.update(d_right=fourth, d_left=fifth)
            which = "third"
        else:
            columns.update(d_right=third, d_left=fourth)
            which = "last"
        findings.append(
            Finding("height", NOTE, f"five unnamed columns: the {which} one taken as the height")
        )
        return columns
    if np.any(third < 0.0) or not np.any(third):
        text = "three unnamed columns: the third, partly negative or all 0, taken as the height"
        findings.append(Finding("third-column", NOTE, text))
        return columns
    meaning, why = _third(columns["x"], columns["y"], third)
    columns["speed" if meaning == "speed" else "width"] = third
    findings.append(
        Finding(
            "third-column",
            WARNING,
            f"three unnamed columns: the third taken as {meaning}, as {why}; FILE#x,y,width or "
            "FILE#x,y,speed decides",
        )
    )
    return columns


def _third(x, y, third):
    """Whether the third of three columns is a speed or a total width, and the evidence.

    Speeds are low where the track bends; widths hardly depend on it. On 14 real racelines and
    centerlines the correlation with the curvature, smoothed over nine points, is -0.73 to -0.91 for
    speeds (but -0.52 on Monza, driven at top speed for most of a lap, and -0.28 on a circle), and
    -0.52 or more for widths.
    """
    third = third[distinct_points(x, y)]
    x, y = (column[distinct_points(x, y)] for column in (x, y))
    if x.size < 9 or np.ptp(third) <= 1e-6 * np.max(third):
        return "total width", "it is constant"
    ways = np.stack((np.roll(x, -1) - x, np.roll(y, -1) - y))
    heading = np.arctan2(ways[1], ways[0])
    bend = np.abs(wrap(heading - np.roll(heading, 1))) / np.hypot(ways[0], ways[1])
    bend = np.mean([np.roll(bend, shift) for shift in range(-4, 5)], axis=0)
    if np.ptp(bend) <= 1e-9:
        return "total width", "the curvature is constant, which tells nothing"
    falling = float(np.corrcoef(bend, third)[0, 1])
    most = float(np.mean(third >= np.max(third) * (1.0 - 1e-6)))
    evidence = f"(correlation {falling:.2f})"
    if falling < -0.6:
        return "speed", f"it drops where the track bends {evidence}"
    if falling < -0.4 and most > 0.2:
        return "speed", f"it drops where the track bends {evidence}, from a maximum reached often"
    return "total width", f"it does not drop where the track bends {evidence}"


def from_reference_line(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Points and walls from a reference line with normals and shifts.

    The distances to the walls are measured along the normals of the raceline itself, to the
    polylines at ``ref + n width_right`` and ``ref - n width_left`` for normals to the right; the
    side of the normals is computed, too.
    """
    reference = np.stack((columns.pop("x_ref"), columns.pop("y_ref")), axis=1)
    normal = np.stack((columns.pop("x_normal"), columns.pop("y_normal")), axis=1)
    alpha = columns.pop("alpha")
    track = reference + alpha[:, None] * normal
    columns.update(x=track[:, 0], y=track[:, 1])
    if "d_left" not in columns or "d_right" not in columns:
        return columns
    closed = np.array_equal(reference[0], reference[-1])
    ring = slice(None, -1) if closed else slice(None)
    tangent = _tangents(reference[ring])
    side = float(np.sum(tangent[:, 0] * normal[ring, 1] - tangent[:, 1] * normal[ring, 0]))
    left = normal * (1.0 if side > 0.0 else -1.0)
    shift = alpha if side > 0.0 else -alpha
    own = np.empty_like(left)
    own[ring] = _tangents(track[ring])
    own[-1] = own[0] if closed else own[-1]
    own = np.stack((-own[:, 1], own[:, 0]), axis=1)
    d_left, d_right = columns["d_left"], columns["d_right"]
    wall_left = reference + d_left[:, None] * left
    wall_right = reference - d_right[:, None] * left
    columns["d_left"] = _distance(track, own, wall_left[ring], d_left - shift)
    columns["d_right"] = _distance(track, -own, wall_right[ring], d_right + shift)
    return columns


def _tangents(points):
    way = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    return way / np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-12)[:, None]


def _distance(points, directions, wall, guess):
    """Distance from points in a direction to a closed wall, nearest to a guess.

    Only the wall up to 12 vertices away is searched; where no ray meets it, the guess remains,
    measured along the normal of the reference line.
    """
    reach = min(12, len(wall) // 2)
    index = (np.arange(len(points))[:, None] + np.arange(-reach, reach)) % len(wall)
    start = wall[index] - points[:, None]
    way = wall[(index + 1) % len(wall)] - wall[index]
    dx, dy = directions[:, 0:1], directions[:, 1:2]
    area = dx * way[..., 1] - dy * way[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (start[..., 0] * way[..., 1] - start[..., 1] * way[..., 0]) / area
        part = (start[..., 0] * dy - start[..., 1] * dx) / area
        off = np.where((part >= 0.0) & (part <= 1.0), np.abs(distance - guess[:, None]), np.inf)
    best = np.argmin(off, axis=1)
    rows = np.arange(len(points))
    return np.where(np.isfinite(off[rows, best]), distance[rows, best], guess)
