"""Byte layouts of the ROS 1 messages that carry a race.

The layouts are fixed (a message's md5 sum is a hash of its definition), so each message is packed
or unpacked by one or two `struct` calls: an Odometry is decoded in 0.6 us, against 22 us by a
general deserializer. Only plane motion is kept.
"""

from __future__ import annotations

import math
import struct
from typing import NamedTuple

import numpy as np

from ..angles import yaw_from_quaternion

__all__ = [
    "ACKERMANN",
    "DEFINITIONS",
    "IMU",
    "MD5",
    "ODOMETRY",
    "POSE",
    "POSE_COVARIANCE",
    "TF",
    "WAYPOINTS",
    "Transform",
    "decode_drive",
    "decode_header",
    "decode_odometry",
    "decode_pose",
    "decode_transforms",
    "decode_waypoints",
    "encode_drive",
    "encode_imu",
    "encode_odometry",
    "encode_pose",
    "encode_transform",
    "encode_waypoints",
]

ODOMETRY = "nav_msgs/Odometry"
POSE = "geometry_msgs/PoseStamped"
POSE_COVARIANCE = "geometry_msgs/PoseWithCovarianceStamped"
ACKERMANN = "ackermann_msgs/AckermannDriveStamped"
IMU = "sensor_msgs/Imu"
TF = "tf2_msgs/TFMessage"
WAYPOINTS = "f110_msgs/WpntArray"

MD5 = {
    ODOMETRY: "cd5e73d190d741a2f92e81eda573aca7",
    POSE: "d3812c3cbc69362b77dc0b19b345f8f5",
    POSE_COVARIANCE: "953b798c0f514ff060a53a3498ce6246",
    ACKERMANN: "1fd5d7f58889cefd44d29f6653240d0c",
    IMU: "6a62c6daae103f4ff57a132d6f95cec2",
    TF: "94810edda583a504dfda3829e70d7eec",
    WAYPOINTS: "f862195689eef47cf0c81faffd1f380d",
}

DEFINITIONS = {
    "f110_msgs/msg/Wpnt": (
        "int32 id\nfloat64 s_m\nfloat64 d_m\nfloat64 x_m\nfloat64 y_m\nfloat64 d_right\n"
        "float64 d_left\nfloat64 psi_rad\nfloat64 kappa_radpm\nfloat64 vx_mps\nfloat64 ax_mps2\n"
    ),
    "f110_msgs/msg/WpntArray": "std_msgs/Header header\nf110_msgs/Wpnt[] wpnts\n",
    "ackermann_msgs/msg/AckermannDrive": (
        "float32 steering_angle\nfloat32 steering_angle_velocity\nfloat32 speed\n"
        "float32 acceleration\nfloat32 jerk\n"
    ),
    "ackermann_msgs/msg/AckermannDriveStamped": (
        "std_msgs/Header header\nackermann_msgs/AckermannDrive drive\n"
    ),
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
}
"""Definitions of the message types that are not among ROS's common ones."""

_HEADER = struct.Struct("<IIII")
_U32 = struct.Struct("<I")
_POSE = struct.Struct("<7d")
_PLANE_POSE = struct.Struct("<2d8x4d")
_ODOMETRY = struct.Struct("<2d8x4d288x2d24xd")
_ODOMETRY_OUT = struct.Struct("<7d288x6d288x")
_IMU_OUT = struct.Struct("<4d9d3d9d3d9d")
_DRIVE = struct.Struct("<5f")
_WAYPOINT = struct.Struct("<i10d")
_WAYPOINTS = np.dtype(
    [("id", "<i4")]
    + [
        (name, "<f8")
        for name in (
            *("s_m", "d_m", "x_m", "y_m", "d_right", "d_left"),
            *("psi_rad", "kappa_radpm", "vx_mps", "ax_mps2"),
        )
    ]
)
_NAN = math.nan


class Transform(NamedTuple):
    """A transform of tf in the plane: the pose of ``child`` in ``parent``."""

    stamp_ns: int
    parent: str
    child: str
    x: float
    y: float
    psi: float


def decode_header(data, at=0):
    """Stamp [ns], frame (without its leading slash) and end of the header that begins at ``at``."""
    _, sec, nsec, length = _HEADER.unpack_from(data, at)
    at += 16
    frame = data[at : at + length].decode("utf-8", "replace").lstrip("/")
    return sec * 1000000000 + nsec, frame, at + length


def decode_odometry(data):
    """``(stamp_ns, x, y, psi, v_x, v_y, yaw_rate)`` of a ``nav_msgs/Odometry``."""
    _, sec, nsec, length = _HEADER.unpack_from(data)
    at = 16 + length
    at += 4 + _U32.unpack_from(data, at)[0]
    x, y, q_x, q_y, q_z, q_w, v_x, v_y, yaw_rate = _ODOMETRY.unpack_from(data, at)
    psi = yaw_from_quaternion(q_x, q_y, q_z, q_w)
    return sec * 1000000000 + nsec, x, y, psi, v_x, v_y, yaw_rate


def decode_pose(data):
    """The same of a ``PoseStamped`` or ``PoseWithCovarianceStamped``: velocities are NaN."""
    _, sec, nsec, length = _HEADER.unpack_from(data)
    x, y, q_x, q_y, q_z, q_w = _PLANE_POSE.unpack_from(data, 16 + length)
    psi = yaw_from_quaternion(q_x, q_y, q_z, q_w)
    return sec * 1000000000 + nsec, x, y, psi, _NAN, _NAN, _NAN


def decode_drive(data):
    """``(stamp_ns, steering_angle, speed)`` of an ``AckermannDriveStamped``."""
    _, sec, nsec, length = _HEADER.unpack_from(data)
    steering_angle, _, speed, _, _ = _DRIVE.unpack_from(data, 16 + length)
    return sec * 1000000000 + nsec, steering_angle, speed


def decode_transforms(data):
    """List of the `Transform` in a ``TFMessage``."""
    (count,) = _U32.unpack_from(data)
    at = 4
    transforms = []
    for _ in range(count):
        stamp_ns, parent, at = decode_header(data, at)
        (length,) = _U32.unpack_from(data, at)
        child = data[at + 4 : at + 4 + length].decode("utf-8", "replace").lstrip("/")
        at += 4 + length
        x, y, q_x, q_y, q_z, q_w = _PLANE_POSE.unpack_from(data, at)
        at += _POSE.size
        psi = yaw_from_quaternion(q_x, q_y, q_z, q_w)
        transforms.append(Transform(stamp_ns, parent, child, x, y, psi))
    return transforms


def decode_waypoints(data):
    """Columns of a ``WpntArray``: names of the fields of ``Wpnt`` to arrays."""
    at = decode_header(data)[2]
    (count,) = _U32.unpack_from(data, at)
    if at + 4 + count * _WAYPOINTS.itemsize > len(data):
        raise struct.error("the message is too short for its waypoints")
    table = np.frombuffer(data, _WAYPOINTS, count, at + 4)
    return {name: table[name].astype(float) for name in _WAYPOINTS.names}


def _string(text):
    data = text.encode()
    return _U32.pack(len(data)) + data


def _header(seq, stamp_ns, frame):
    sec, nsec = divmod(stamp_ns, 1000000000)
    data = frame.encode()
    return _HEADER.pack(seq, sec, nsec, len(data)) + data


def encode_odometry(seq, stamp_ns, frame, child, x, y, psi, v_x, v_y, yaw_rate):
    """``nav_msgs/Odometry`` without covariances."""
    return b"".join(
        (
            _header(seq, stamp_ns, frame),
            _string(child),
            _ODOMETRY_OUT.pack(
                *(x, y, 0.0, 0.0, 0.0, math.sin(0.5 * psi), math.cos(0.5 * psi)),
                *(v_x, v_y, 0.0, 0.0, 0.0, yaw_rate),
            ),
        )
    )


def encode_pose(seq, stamp_ns, frame, x, y, psi):
    """``geometry_msgs/PoseStamped``."""
    z, w = math.sin(0.5 * psi), math.cos(0.5 * psi)
    return _header(seq, stamp_ns, frame) + _POSE.pack(x, y, 0.0, 0.0, 0.0, z, w)


def encode_drive(
    seq, stamp_ns, frame, steering_angle, speed, steering_angle_velocity, acceleration, jerk
):
    """``ackermann_msgs/AckermannDriveStamped``."""
    return _header(seq, stamp_ns, frame) + _DRIVE.pack(
        steering_angle, steering_angle_velocity, speed, acceleration, jerk
    )


_NO_ORIENTATION = (0.0, 0.0, 0.0, 1.0, -1.0) + (0.0,) * 8
_ZEROS = (0.0,) * 9


def encode_imu(seq, stamp_ns, frame, a_x, a_y, a_z, yaw_rate):
    """``sensor_msgs/Imu`` without orientation (its first covariance is -1) and covariances."""
    return _header(seq, stamp_ns, frame) + _IMU_OUT.pack(
        *_NO_ORIENTATION, 0.0, 0.0, yaw_rate, *_ZEROS, a_x, a_y, a_z, *_ZEROS
    )


def encode_transform(seq, stamp_ns, parent, child, x, y, psi):
    """``tf2_msgs/TFMessage`` with one transform."""
    z, w = math.sin(0.5 * psi), math.cos(0.5 * psi)
    return b"".join(
        (
            _U32.pack(1),
            _header(seq, stamp_ns, parent),
            _string(child),
            _POSE.pack(x, y, 0.0, 0.0, 0.0, z, w),
        )
    )


def encode_waypoints(seq, stamp_ns, frame, rows):
    """``f110_msgs/WpntArray``.

    Parameters
    ----------
    rows : iterable of sequences of 10 floats
        ``s_m d_m x_m y_m d_right d_left psi_rad kappa_radpm vx_mps ax_mps2`` of each waypoint.
    """
    waypoints = [_WAYPOINT.pack(number, *row) for number, row in enumerate(rows)]
    return b"".join((_header(seq, stamp_ns, frame), _U32.pack(len(waypoints)), *waypoints))
