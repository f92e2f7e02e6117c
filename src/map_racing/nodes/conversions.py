"""Messages to and from the core's own types."""

import math

import genpy
import rospy

from ..angles import yaw_from_quaternion
from ..bags.messages import SHORTEST_QUATERNION, UNIT_QUATERNION
from ..control.motion import MotionEstimate
from ..control.state import CarState
from ..validation import FARTHEST

__all__ = [
    *("StateReader", "frame", "heading", "plane_pose", "set_plane_pose", "stamp_ns", "to_time"),
]


def stamp_ns(header, received_ns):
    """Time stamp of a message [ns]; where it has none (0), the time of its arrival.

    Parameters
    ----------
    header : std_msgs/Header
    received_ns : int
        ``rospy.Time.now().to_nsec()`` of its arrival.
    """
    return header.stamp.secs * 1000000000 + header.stamp.nsecs or received_ns


def to_time(ns):
    """ROS time of integer nanoseconds."""
    return genpy.Time(*divmod(ns, 1000000000))


def frame(name):
    """Name of a frame as tf2 knows it: older nodes put a slash in front."""
    return name.lstrip("/")


def heading(q):
    """Heading [rad] of a ``geometry_msgs/Quaternion``.

    One of zeros, as messages hold that nobody filled in, is no heading: NaN.
    """
    length = math.sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w)
    if not length > SHORTEST_QUATERNION:
        return math.nan
    if not UNIT_QUATERNION[0] < length < UNIT_QUATERNION[1]:
        rospy.logwarn_once("quaternions of length %.3f: normalized", length)
    return yaw_from_quaternion(q.x, q.y, q.z, q.w)


def plane_pose(pose):
    """``x, y, psi`` [m, m, rad] of a ``geometry_msgs/Pose``; NaN: no place on earth, no heading."""
    x, y = pose.position.x, pose.position.y
    if not (abs(x) < FARTHEST and abs(y) < FARTHEST):
        x = y = math.nan
    return x, y, heading(pose.orientation)


def set_plane_pose(pose, x, y, psi):
    """Fill a ``geometry_msgs/Pose`` with a position [m] and a heading [rad]."""
    pose.position.x, pose.position.y, pose.position.z = x, y, 0.0
    q = pose.orientation
    q.x, q.y, q.z, q.w = 0.0, 0.0, math.sin(0.5 * psi), math.cos(0.5 * psi)


class StateReader:
    """States of the car from the messages of one topic.

    What the messages leave out is found out from them: a component of the velocity that never was
    anything but 0 is one that nobody measures. ``v_x`` and the yaw rate then come from the poses,
    and ``v_y`` is NaN.
    """

    def __init__(self):
        self._estimate = MotionEstimate()
        self._measured = [False, False, False]

    def reset(self):
        """The car was moved, or time jumped back."""
        self._estimate.reset()

    def odometry(self, message, t):
        """State of a ``nav_msgs/Odometry`` with pose in the map, twist in the body frame.

        Parameters
        ----------
        message : nav_msgs/Odometry
        t : float
            Time of the pose [s].

        Returns
        -------
        CarState
        """
        x, y, psi = plane_pose(message.pose.pose)
        twist = message.twist.twist
        given = (twist.linear.x, twist.linear.y, twist.angular.z)
        measured = self._measured
        for index, value in enumerate(given):
            measured[index] = measured[index] or value != 0.0
        if measured[0] and measured[2]:
            return CarState(t, x, y, psi, given[0], given[1] if measured[1] else math.nan, given[2])
        motion = self._estimate.update(t, x, y, psi)
        return CarState(
            *(t, x, y, psi), *(g if m else e for g, m, e in zip(given, measured, motion))
        )

    def pose(self, message, t):
        """State of a ``geometry_msgs/PoseStamped`` in the map at time `t` [s]."""
        return self.plane(t, *plane_pose(message.pose))

    def plane(self, t, x, y, psi):
        """State of a position [m] and a heading [rad] in the map at time `t` [s]."""
        return CarState(t, x, y, psi, *self._estimate.update(t, x, y, psi))
