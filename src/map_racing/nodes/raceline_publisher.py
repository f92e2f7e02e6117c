"""Node ``raceline_publisher``: a raceline from a file, for controllers, planners and RViz."""

import rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Path
from visualization_msgs.msg import MarkerArray

from ..control.speed_plan import scaled_speed
from ..control.speed_sectors import load_speed_sectors
from ..errors import ParameterError
from ..track.files.load import load_raceline
from ..track.files.waypoints import waypoint_rows
from ..track.findings import raceline_warnings
from .conversions import frame, set_plane_pose
from .markers import raceline_markers
from .node import get_parameter, run, sleep
from .waypoints import waypoint_array_class, waypoint_messages

__all__ = ["RacelinePublisherNode", "main"]


class RacelinePublisherNode:
    """Publishes latched messages, and repeats the waypoints as the public stacks do."""

    def __init__(self):
        self._raceline = load_raceline(
            get_parameter("raceline", "reference", "track, raceline file, or bag[#topic]")
        )
        scale = get_parameter("speed_scale", 1.0, "scale of the raceline's speeds")
        sectors = get_parameter("sectors", "", "speed_scaling.yaml; empty: none")
        spacing = get_parameter("spacing", 0.1, "distance between waypoints [m]")
        self._period = get_parameter("period", 2.0, "time between repetitions [s]")
        self._frame = frame(get_parameter("map_frame", "map", "frame of the raceline"))
        for name, value in (("spacing", spacing), ("period", self._period)):
            if not value > 0.0:
                raise ParameterError(f"~{name}: expected a positive number, got {value}")
        sectors = load_speed_sectors(sectors, self._raceline) if sectors else None
        for doubt in [*raceline_warnings(self._raceline), *(sectors.doubts if sectors else ())]:
            rospy.logwarn(doubt)
        if sectors:
            rospy.loginfo(sectors.told(scale))
        speed = scaled_speed(self._raceline, scale, sectors)
        self._rows = waypoint_rows(self._raceline, spacing, speed)
        rospy.loginfo(
            "%s: %.2f m, %d waypoints, %.2f to %.2f m/s",
            self._raceline.name or self._raceline.source,
            self._raceline.length,
            self._rows.size,
            self._rows["vx_mps"].min(),
            self._rows["vx_mps"].max(),
        )
        self._array = waypoint_array_class()[0]
        self._waypoints = waypoint_messages(self._rows)

    def run(self):
        """Publish until the node is shut down."""
        waypoints = rospy.Publisher("global_waypoints", self._array, queue_size=2, latch=True)
        path = rospy.Publisher("raceline_path", Path, queue_size=1, latch=True)
        markers = rospy.Publisher("raceline_markers", MarkerArray, queue_size=1, latch=True)
        path.publish(self._path())
        markers.publish(raceline_markers(self._raceline, self._rows, self._frame))
        while True:
            message = self._array(wpnts=self._waypoints)
            message.header.stamp = rospy.Time.now()
            message.header.frame_id = self._frame
            waypoints.publish(message)
            # Wall clock, so that the raceline is repeated even while a replay is paused.
            if not sleep(self._period):
                return

    def _path(self):
        path = Path()
        path.header.frame_id = self._frame
        poses = self._rows[["x_m", "y_m", "psi_rad"]].tolist()
        for x, y, psi in [*poses, poses[0]]:
            pose = PoseStamped()
            pose.header.frame_id = self._frame
            set_plane_pose(pose.pose, x, y, psi)
            path.poses.append(pose)
        return path


def main():
    """Run the node."""
    run("raceline_publisher", RacelinePublisherNode)
