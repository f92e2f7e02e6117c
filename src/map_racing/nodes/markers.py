"""Markers for RViz: what all of them have alike."""

import rospy
from geometry_msgs.msg import Point
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

__all__ = ["delete_all", "make_marker", "points_of"]


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
