"""Markers for RViz: what all of them have alike."""

import rospy
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from .colors import WALL, gradient

__all__ = ["delete_all", "make_marker", "points_of", "raceline_markers"]


def make_marker(kind, namespace, frame, color, *, scale=(0.0, 0.0, 0.0), lifetime=0.0):
    """Marker of one namespace, with the stamp 0: RViz takes the latest transform.

    Parameters
    ----------
    kind : int
        ``Marker.LINE_STRIP`` and so on.
    namespace, frame : str
    color : tuple of 3 floats
    scale : tuple of 3 floats, optional
        Meaning and unit [m] depend on the kind.
    lifetime : float, optional
        After so many seconds without another one it disappears; 0: never.
    """
    marker = Marker(ns=namespace, type=kind, action=Marker.ADD)
    marker.header.frame_id = frame
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y, marker.scale.z = scale
    marker.color = ColorRGBA(*color, 1.0)
    marker.lifetime = rospy.Duration.from_sec(lifetime)
    return marker


def points_of(xy, z=0.0):
    """Points of a marker from an iterable of ``x, y`` [m] at height `z` [m]."""
    return [Point(x, y, z) for x, y in xy]


def delete_all():
    """Message that removes all markers of its topic."""
    return MarkerArray([Marker(action=Marker.DELETEALL)])


def raceline_markers(raceline, rows, frame):
    """A raceline colored by speed, from its slowest to its fastest, and its walls.

    Parameters
    ----------
    raceline : Raceline
    rows : list of list of float
        Its waypoints, as of `map_racing.track.files.waypoints.waypoint_rows`.
    frame : str

    Returns
    -------
    visualization_msgs/MarkerArray
        All former markers of the topic are deleted first.
    """
    speeds = [row[8] for row in rows]
    least = min(speeds)
    span = max(speeds) - least or 1.0
    closed = [*rows, rows[0]]
    line = make_marker(Marker.LINE_STRIP, "raceline", frame, WALL, scale=(0.06, 0.0, 0.0))
    line.points = points_of(((row[2], row[3]) for row in closed), 0.01)
    line.colors = [gradient((row[8] - least) / span) for row in closed]
    array = delete_all()
    array.markers.append(line)
    if raceline.d_left is not None:
        s = [row[0] for row in closed]
        for number, (side, column) in enumerate(((1.0, 5), (-1.0, 4))):
            x, y = raceline.to_cartesian(s, [side * row[column] for row in closed])
            wall = make_marker(Marker.LINE_STRIP, "walls", frame, WALL, scale=(0.04, 0.0, 0.0))
            wall.id = number
            wall.points = points_of(zip(x.tolist(), y.tolist()))
            array.markers.append(wall)
    for marker in array.markers:
        # Drawn with the latest transform, whatever its time.
        marker.frame_locked = True
    return array
