"""ROS 1 messages of a race, packed by `struct`; planar motion only.

The first parameters are those of the header: sequence number, stamp [ns] and frame.
"""

from __future__ import annotations

import math
import struct

from .messages import BELIEF_FIELDS

__all__ = [
    "encode_belief",
    "encode_drive",
    "encode_imu",
    "encode_odometry",
    "encode_pose",
    "encode_status",
    "encode_string",
    "encode_transform",
    "encode_waypoints",
]

_HEADER = struct.Struct("<IIII")
_U32 = struct.Struct("<I")
_POSE = struct.Struct("<7d")
_ODOMETRY = struct.Struct("<7d288x6d288x")
_IMU = struct.Struct("<4d9d3d9d3d9d")
_DRIVE = struct.Struct("<5f")
_BELIEF = struct.Struct(f"<{len(BELIEF_FIELDS)}d")
_WAYPOINT = struct.Struct("<i10d")
_NO_ORIENTATION = (0.0, 0.0, 0.0, 1.0, -1.0) + (0.0,) * 8
_ZEROS = (0.0,) * 9


def _string(text):
    data = text.encode()
    return _U32.pack(len(data)) + data


def _header(seq, stamp_ns, frame):
    sec, nsec = divmod(stamp_ns, 1000000000)
    data = frame.encode()
    return _HEADER.pack(seq, sec, nsec, len(data)) + data


def _plane_pose(x, y, psi):
    return x, y, 0.0, 0.0, 0.0, math.sin(0.5 * psi), math.cos(0.5 * psi)


def encode_odometry(seq, stamp_ns, frame, child, x, y, psi, v_x, v_y, yaw_rate):
    """``nav_msgs/Odometry`` without covariances."""
    body = _ODOMETRY.pack(*_plane_pose(x, y, psi), v_x, v_y, 0.0, 0.0, 0.0, yaw_rate)
    return _header(seq, stamp_ns, frame) + _string(child) + body


def encode_pose(seq, stamp_ns, frame, x, y, psi):
    """``geometry_msgs/PoseStamped``."""
    return _header(seq, stamp_ns, frame) + _POSE.pack(*_plane_pose(x, y, psi))


def encode_drive(
    seq, stamp_ns, frame, steering_angle, speed, steering_angle_velocity, acceleration, jerk
):
    """``ackermann_msgs/AckermannDriveStamped``."""
    return _header(seq, stamp_ns, frame) + _DRIVE.pack(
        steering_angle, steering_angle_velocity, speed, acceleration, jerk
    )


def encode_belief(seq, stamp_ns, frame, *values):
    """``map_racing/Belief`` of the values `BELIEF_FIELDS`."""
    return _header(seq, stamp_ns, frame) + _BELIEF.pack(*values)


def encode_imu(seq, stamp_ns, frame, a_x, a_y, a_z, yaw_rate):
    """``sensor_msgs/Imu`` without orientation (its first covariance is -1) and covariances."""
    return _header(seq, stamp_ns, frame) + _IMU.pack(
        *_NO_ORIENTATION, 0.0, 0.0, yaw_rate, *_ZEROS, a_x, a_y, a_z, *_ZEROS
    )


def encode_transform(seq, stamp_ns, parent, child, x, y, psi):
    """``tf2_msgs/TFMessage`` with one transform."""
    pose = _POSE.pack(*_plane_pose(x, y, psi))
    return _U32.pack(1) + _header(seq, stamp_ns, parent) + _string(child) + pose


def encode_waypoints(seq, stamp_ns, frame, rows):
    """``f110_msgs/WpntArray``.

    Parameters
    ----------
    rows : iterable of sequences of 10 floats
        `WAYPOINT_FIELDS` of each waypoint.
    """
    waypoints = [_WAYPOINT.pack(number, *row) for number, row in enumerate(rows)]
    return b"".join((_header(seq, stamp_ns, frame), _U32.pack(len(waypoints)), *waypoints))


def encode_status(seq, stamp_ns, level, name, text, hardware):
    """``diagnostic_msgs/DiagnosticArray`` of one status without values."""
    texts = b"".join(map(_string, (name, text, hardware)))
    return _header(seq, stamp_ns, "") + _U32.pack(1) + bytes([level]) + texts + _U32.pack(0)


def encode_string(seq, stamp_ns, text):
    """``std_msgs/String``, which has no header."""
    return _string(text)
