"""Node ``raceline_publisher``: a raceline from a file, for controllers, planners and RViz."""

import threading

import rospy
from geometry_msgs.msg import Point, PoseStamped
from nav_msgs.msg import Path
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from ..control.speed_sectors import load_speed_sectors
from ..errors import ParameterError
from ..evaluation.recordings import load_course
from ..track.waypoints import scaled_speed, waypoint_rows
from .colors import WALL, gradient
from .conversions import frame, set_plane_pose
from .markers import delete_all
from .node import get_parameter, run
from .waypoints import waypoint_array_class

__all__ = ["RacelinePublisherNode", "main"]


FIELDS = (
    *("s_m", "d_m", "x_m", "y_m", "d_right", "d_left"),
    *("psi_rad", "kappa_radpm", "vx_mps", "ax_mps2"),
)


class RacelinePublisherNode:
    """Publish once, latched; and the waypoints again and again, as the public stacks do."""

    def __init__(self):
        self._raceline = load_course(
            get_parameter("raceline", "reference", "track, raceline file, or bag[#topic]")
        )
        scale = get_parameter("speed_scale", 1.0, "on the raceline's speeds")
        sectors = get_parameter("sectors", "", "speed_scaling.yaml; empty: none")
        spacing = get_parameter("spacing", 0.1, "distance between the waypoints [m]")
        self._period = get_parameter("period", 2.0, "at which waypoints are repeated [s]")
        self._frame = frame(get_parameter("map_frame", "map", "frame of the raceline"))
        for name, value in (("spacing", spacing), ("period", self._period)):
            if not value > 0.0:
                raise ParameterError(f"~{name}: expected more than 0, got {value}")
        speed = scaled_speed(
            self._raceline,
            scale,
            load_speed_sectors(sectors, self._raceline) if sectors else None,
        )
        self._rows = waypoint_rows(self._raceline, spacing, speed).tolist()
        rospy.loginfo(
            "%s: %.2f m, %d waypoints, %.2f to %.2f m/s",
            *(self._raceline.name or self._raceline.source, self._raceline.length),
            *(len(self._rows), min(row[8] for row in self._rows)),
            max(row[8] for row in self._rows),
        )
        self._array, waypoint = waypoint_array_class()
        self._waypoints = [
            waypoint(number, *(row[FIELDS.index(name)] for name in waypoint.__slots__[1:]))
            for number, row in enumerate(self._rows)
        ]
        self._ended = threading.Event()
        rospy.on_shutdown(self._ended.set)

    def run(self):
        """Publish until the node is shut down."""
        waypoints = rospy.Publisher("global_waypoints", self._array, queue_size=2, latch=True)
        path = rospy.Publisher("raceline_path", Path, queue_size=1, latch=True)
        markers = rospy.Publisher("raceline_markers", MarkerArray, queue_size=1, latch=True)
        path.publish(self._path())
        markers.publish(self._markers())
        while True:
            message = self._array(wpnts=self._waypoints)
            message.header.stamp = rospy.Time.now()
            message.header.frame_id = self._frame
            waypoints.publish(message)
            # By the wall clock: when a replay is paused, who joins still gets the raceline.
            if self._ended.wait(self._period):
                return

    def _path(self):
        path = Path()
        path.header.frame_id = self._frame
        for row in [*self._rows, self._rows[0]]:
            pose = PoseStamped()
            pose.header.frame_id = self._frame
            set_plane_pose(pose.pose, row[2], row[3], row[6])
            path.poses.append(pose)
        return path

    def _markers(self):
        """The line colored by speed, from the slowest to the fastest, and the walls."""
        speeds = [row[8] for row in self._rows]
        least = min(speeds)
        span = max(speeds) - least or 1.0
        closed = [*self._rows, self._rows[0]]
        line = self._strip("raceline", 0, 0.06, [Point(row[2], row[3], 0.01) for row in closed])
        line.colors = [gradient((row[8] - least) / span) for row in closed]
        array = delete_all()
        array.markers.append(line)
        if self._raceline.d_left is not None:
            s = [row[0] for row in closed]
            for number, (side, column) in enumerate(((1.0, 5), (-1.0, 4))):
                wall = self._raceline.to_cartesian(s, [side * row[column] for row in closed])
                points = [Point(x, y, 0.0) for x, y in zip(*(axis.tolist() for axis in wall))]
                strip = self._strip("walls", number, 0.04, points)
                strip.color = ColorRGBA(*WALL, 1.0)
                array.markers.append(strip)
        return array

    def _strip(self, namespace, number, width, points):
        marker = Marker(ns=namespace, id=number, type=Marker.LINE_STRIP, points=points)
        marker.header.frame_id = self._frame
        marker.pose.orientation.w = 1.0
        marker.scale.x = width
        # Drawn with the latest transform, whatever its time.
        marker.frame_locked = True
        marker.color.a = 1.0
        return marker


def main():
    """Run the node."""
    run("raceline_publisher", RacelinePublisherNode)
