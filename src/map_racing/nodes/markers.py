"""Markers for RViz."""

from __future__ import annotations

from typing import TYPE_CHECKING, Iterable

import numpy as np
import rospy
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from .colors import WALL, gradient

if TYPE_CHECKING:
    from ..track.raceline import Raceline

__all__ = [
    "delete_all",
    "lap_text_place",
    "make_marker",
    "points_of",
    "raceline_markers",
    "track_box",
]

# Height of the lap text and width of the raceline, as shares of the larger side of the track.
_TEXT, _LINE = 0.032, 0.003


def make_marker(
    kind: int,
    namespace: str,
    frame: str,
    color: tuple,
    *,
    scale: tuple = (0.0, 0.0, 0.0),
    lifetime: float = 0.0,
) -> Marker:
    """Marker with timestamp 0, so that RViz uses the latest transform.

    Parameters
    ----------
    kind : int
        ``Marker.LINE_STRIP`` and so on.
    namespace, frame : str
    color : tuple of 3 floats
    scale : tuple of 3 floats, optional
        Its meaning depends on the kind [m].
    lifetime : float, optional
        Time after which it disappears unless replaced [s]; 0: never.
    """
    marker = Marker(ns=namespace, type=kind, action=Marker.ADD)
    marker.header.frame_id = frame
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y, marker.scale.z = scale
    marker.color = ColorRGBA(*color, 1.0)
    marker.lifetime = rospy.Duration.from_sec(lifetime)
    return marker


def points_of(xy: Iterable, z: float = 0.0) -> list[Point]:
    """Points of a marker from an iterable of ``x, y`` [m] at height `z` [m]."""
    return [Point(x, y, z) for x, y in xy]


def delete_all() -> MarkerArray:
    """Message that removes all markers of its topic."""
    return MarkerArray([Marker(action=Marker.DELETEALL)])


def track_box(raceline: Raceline) -> tuple[float, float, float, float]:
    """Bounds ``x_min, x_max, y_min, y_max`` [m] of a raceline with its walls."""
    x, y = raceline.x, raceline.y
    if raceline.d_left is not None:
        left = raceline.to_cartesian(raceline.s, raceline.d_left)
        right = raceline.to_cartesian(raceline.s, -raceline.d_right)
        x, y = (np.concatenate(parts) for parts in zip(left, right, (x, y)))
    return float(x.min()), float(x.max()), float(y.min()), float(y.max())


def _side(raceline):
    """Larger side of the track [m]."""
    x_min, x_max, y_min, y_max = track_box(raceline)
    return max(x_max - x_min, y_max - y_min)


def lap_text_place(raceline: Raceline, size: float = 0.0) -> tuple[float, float, float]:
    """Center x, y of the three lines of lap text above the track, and height of a line [m].

    Parameters
    ----------
    raceline : Raceline
    size : float, optional
        Height of a line [m]; 0: fitted to the track.
    """
    x_min, x_max, _, y_max = track_box(raceline)
    size = size or _TEXT * _side(raceline)
    return 0.5 * (x_min + x_max), y_max + 2.0 * size, size


def raceline_markers(raceline: Raceline, rows: np.ndarray, frame: str) -> MarkerArray:
    """A raceline colored by speed, from its slowest to its fastest, and its walls.

    Parameters
    ----------
    raceline : Raceline
    rows : ndarray
        Its waypoints, see `map_racing.track.files.waypoints.waypoint_rows`.
    frame : str

    Returns
    -------
    visualization_msgs/MarkerArray
        It first deletes all earlier markers of the topic.
    """
    closed = {name: [*rows[name].tolist(), float(rows[name][0])] for name in rows.dtype.names}
    least = min(closed["vx_mps"])
    span = max(closed["vx_mps"]) - least or 1.0
    # Wide enough to be visible when the whole track is in view.
    width = max(0.06, _LINE * _side(raceline))
    line = make_marker(Marker.LINE_STRIP, "raceline", frame, WALL, scale=(width, 0.0, 0.0))
    line.points = points_of(zip(closed["x_m"], closed["y_m"]), 0.01)
    line.colors = [gradient((v - least) / span) for v in closed["vx_mps"]]
    array = delete_all()
    array.markers.append(line)
    if raceline.d_left is not None:
        for number, (side, column) in enumerate(((1.0, "d_left"), (-1.0, "d_right"))):
            x, y = raceline.to_cartesian(closed["s_m"], side * np.array(closed[column]))
            size = (width / 1.5, 0.0, 0.0)
            wall = make_marker(Marker.LINE_STRIP, "walls", frame, WALL, scale=size)
            wall.id = number
            wall.points = points_of(zip(x.tolist(), y.tolist()))
            array.markers.append(wall)
    for marker in array.markers:
        # Makes RViz use the latest transform, whatever its time.
        marker.frame_locked = True
    return array
