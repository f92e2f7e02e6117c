"""Conversion between messages and the types of the packages without ROS."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import genpy
import rospy

from ..angles import yaw_from_quaternion
from ..bags.messages import SHORTEST_QUATERNION, UNIT_QUATERNION
from ..control.motion import MotionEstimate
from ..control.state import CarState
from ..printing import printable
from ..validation import FARTHEST

if TYPE_CHECKING:
    from geometry_msgs.msg import Pose, PoseStamped, Quaternion
    from nav_msgs.msg import Odometry
    from std_msgs.msg import Header

__all__ = [
    "StampOrder",
    "StateReader",
    "frame",
    "heading",
    "plane_pose",
    "set_plane_pose",
    "stamp_ns",
    "to_time",
]

# A timestamp earlier than the last command's by more than this [s] means that the clock was set.
LONGEST_OVERTAKEN_S = 1.0


def stamp_ns(header: Header, received_ns: int) -> int:
    """Timestamp of a message [ns]; its receipt time if it has none (0).

    Parameters
    ----------
    header : std_msgs/Header
    received_ns : int
        Receipt time, ``rospy.Time.now().to_nsec()``.
    """
    return header.stamp.secs * 1000000000 + header.stamp.nsecs or received_ns


def to_time(ns: int) -> genpy.Time:
    """ROS time of integer nanoseconds."""
    return genpy.Time(*divmod(ns, 1000000000))


def frame(name: str) -> str:
    """Name of a frame in tf2, without the leading slash of older nodes."""
    return printable(name).lstrip("/")


def heading(q: Quaternion) -> float:
    """Heading [rad] of a quaternion; NaN if it was left at zeros."""
    length = math.sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w)
    if not length > SHORTEST_QUATERNION:
        return math.nan
    if not UNIT_QUATERNION[0] < length < UNIT_QUATERNION[1]:
        rospy.logwarn_once("quaternions of length %.3f: normalized", length)
    return yaw_from_quaternion(q.x, q.y, q.z, q.w)


def plane_pose(pose: Pose) -> tuple:
    """``x, y, psi`` [m, m, rad] of a pose; implausible values are NaN."""
    x, y = pose.position.x, pose.position.y
    if not (abs(x) < FARTHEST and abs(y) < FARTHEST):
        x = y = math.nan
    return x, y, heading(pose.orientation)


def set_plane_pose(pose: Pose, x: float, y: float, psi: float) -> None:
    """Set position [m] and heading [rad] of a pose."""
    pose.position.x, pose.position.y, pose.position.z = x, y, 0.0
    q = pose.orientation
    q.x, q.y, q.z, q.w = 0.0, 0.0, math.sin(0.5 * psi), math.cos(0.5 * psi)


class StampOrder:
    """Keeps the timestamps of commands in the order in which they are sent.

    A stop without poses is stamped when it is sent, so a late pose may follow with an earlier
    timestamp. Without order, timestamps would not show which command is in force.
    """

    def __init__(self):
        self._last = genpy.Time()

    def ordered(self, header: Header) -> Header:
        """The header for the next command, restamped if it is earlier than the last one."""
        stamp, last = header.stamp, self._last
        if stamp < last and (last - stamp).to_sec() < LONGEST_OVERTAKEN_S:
            stamp = last + genpy.Duration(0, 1)
            header = type(header)(stamp=stamp, frame_id=header.frame_id)
        self._last = stamp
        return header


class StateReader:
    """Makes states of the car from the messages of one topic.

    A velocity component that has always been 0 counts as not measured: ``v_x`` and the yaw rate are
    then estimated from the poses, and ``v_y`` is NaN.
    """

    def __init__(self):
        self._estimate = MotionEstimate()
        self._measured = [False, False, False]

    def reset(self):
        """Forget the past, after the car was moved or time jumped back."""
        self._estimate.reset()

    def odometry(self, message: Odometry, t: float) -> CarState:
        """State at time `t` [s] of an odometry with pose in the map and twist in the body frame."""
        x, y, psi = plane_pose(message.pose.pose)
        twist = message.twist.twist
        given = (twist.linear.x, twist.linear.y, twist.angular.z)
        measured = self._measured
        for index, value in enumerate(given):
            measured[index] = measured[index] or value != 0.0
        if measured[0] and measured[2]:
            return CarState(t, x, y, psi, given[0], given[1] if measured[1] else math.nan, given[2])
        motion = self._estimate.update(t, x, y, psi)
        v_x, v_y, r = (g if m else e for g, m, e in zip(given, measured, motion))
        return CarState(t, x, y, psi, v_x, v_y, r)

    def pose(self, message: PoseStamped, t: float) -> CarState:
        """State at time `t` [s] of a pose in the map."""
        return self.plane(t, *plane_pose(message.pose))

    def plane(self, t: float, x: float, y: float, psi: float) -> CarState:
        """State at time `t` [s] of a position [m] and a heading [rad] in the map."""
        return CarState(t, x, y, psi, *self._estimate.update(t, x, y, psi))
