"""Types of the ROS 1 messages of a race, and decoders of the parts that are used.

The layouts are fixed (a message's md5 sum is a hash of its definition), so messages are unpacked by
numpy, many at once: an Odometry takes 0.5 us instead of 22 us with a general deserializer. Only
planar motion is read.
"""

from __future__ import annotations

import math
import struct
from typing import List, NamedTuple, Tuple, Union

import numpy as np

from ..angles import yaw_from_quaternion
from ..printing import printable

__all__ = [
    "ACKERMANN",
    "BELIEF",
    "BELIEF_FIELDS",
    "DEFINITIONS",
    "DIAGNOSTICS",
    "FLOAT64",
    "IMU",
    "MD5",
    "ODOMETRY",
    "ODOMETRY_SIZE",
    "PATH",
    "POSE",
    "POSE_COVARIANCE",
    "SHORTEST_QUATERNION",
    "STRING",
    "TF",
    "UNIT_QUATERNION",
    "WAYPOINTS",
    "WAYPOINT_FIELDS",
    "Transform",
    "decode_diagnostics",
    "decode_belief",
    "decode_drive",
    "decode_float64",
    "decode_frame",
    "decode_frames",
    "decode_header",
    "decode_imu",
    "decode_odometry",
    "decode_path",
    "decode_pose",
    "decode_string",
    "decode_transforms",
    "decode_waypoints",
    "yaw_and_length",
]

ODOMETRY = "nav_msgs/Odometry"
POSE = "geometry_msgs/PoseStamped"
POSE_COVARIANCE = "geometry_msgs/PoseWithCovarianceStamped"
ACKERMANN = "ackermann_msgs/AckermannDriveStamped"
BELIEF = "map_racing/Belief"
IMU = "sensor_msgs/Imu"
PATH = "nav_msgs/Path"
FLOAT64 = "std_msgs/Float64"
STRING = "std_msgs/String"
DIAGNOSTICS = "diagnostic_msgs/DiagnosticArray"
TF = "tf2_msgs/TFMessage"
WAYPOINTS = "f110_msgs/WpntArray"
# Fields of map_racing/Belief after its header: each value with the ends of its interval.
BELIEF_FIELDS = (
    *("friction", "friction_low", "friction_high"),
    *("front_stiffness", "front_stiffness_low", "front_stiffness_high"),
    *("rear_stiffness", "rear_stiffness_low", "rear_stiffness_high"),
    *("delay", "delay_low", "delay_high", "grip"),
)
# Fields of f110_msgs/Wpnt after its id.
WAYPOINT_FIELDS = (
    "s_m",
    "d_m",
    "x_m",
    "y_m",
    "d_right",
    "d_left",
    "psi_rad",
    "kappa_radpm",
    "vx_mps",
    "ax_mps2",
)

MD5 = {
    ODOMETRY: "cd5e73d190d741a2f92e81eda573aca7",
    POSE: "d3812c3cbc69362b77dc0b19b345f8f5",
    POSE_COVARIANCE: "953b798c0f514ff060a53a3498ce6246",
    BELIEF: "4105f78e1f50b177aaa2054a5ec7cdc0",
    ACKERMANN: "1fd5d7f58889cefd44d29f6653240d0c",
    IMU: "6a62c6daae103f4ff57a132d6f95cec2",
    PATH: "6227e2b7e9cce15051f669a5e197bbf7",
    FLOAT64: "fdb28210bfa9d7c91146260178d9a584",
    STRING: "992ce8a1687cec8c8bd883ec73ca41d1",
    DIAGNOSTICS: "60810da900de1dd6ddd437c3503511da",
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
    "map_racing/msg/Belief": "std_msgs/Header header\n"
    + "".join(f"float64 {name}\n" for name in BELIEF_FIELDS),
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
}
"""Definitions of message types that are not part of ROS."""

_HEADER = struct.Struct("<IIII")
_U32 = struct.Struct("<I")
_F64 = struct.Struct("<d")
_POSE = struct.Struct("<7d")
_PLANE_POSE = struct.Struct("<2d8x4d")
_IMU_SIZE, _DRIVE_SIZE, _BELIEF_SIZE = 37 * 8, 5 * 4, 8 * len(BELIEF_FIELDS)
_BELIEF_LAYOUT = {name: ("<f8", 8 * i) for i, name in enumerate(BELIEF_FIELDS)}
_WAYPOINTS = np.dtype([("id", "<i4")] + [(name, "<f8") for name in WAYPOINT_FIELDS])
# Offsets from the beginning of the body, after the header and the child frame.
_POSE_FIELDS = {
    name: ("<f8", offset)
    for name, offset in (("x", 0), ("y", 8), ("qx", 24), ("qy", 32), ("qz", 40), ("qw", 48))
}
_TWIST = 56 + 288
_ODOMETRY_FIELDS = {
    **_POSE_FIELDS,
    "v_x": ("<f8", _TWIST),
    "v_y": ("<f8", _TWIST + 8),
    "yaw_rate": ("<f8", _TWIST + 40),
}
ODOMETRY_SIZE = _TWIST + 48 + 288
"""Bytes of an Odometry after its frames."""
_DRIVE_FIELDS = {"steering_angle": ("<f4", 0), "speed": ("<f4", 8)}
# Orientation, angular velocity and linear acceleration are each followed by a covariance.
_RATES, _ACCELERATIONS = 13 * 8, 25 * 8
_IMU_FIELDS = {
    "yaw_rate": ("<f8", _RATES + 16),
    **{name: ("<f8", _ACCELERATIONS + 8 * i) for i, name in enumerate(("a_x", "a_y", "a_z"))},
}
_NAN = math.nan


SHORTEST_QUATERNION = 0.1
"""A shorter quaternion is no orientation: zeros that were never filled in."""
UNIT_QUATERNION = 0.99, 1.01
"""Lengths of a quaternion that rounding explains."""

# Messages, one by one, or as rows if all have the same size.
Encoded = Union[List[bytes], np.ndarray]
# Stamps [ns], values and which messages are good, see `decode_odometry`.
Decoded = Tuple[np.ndarray, np.ndarray, np.ndarray]


class Transform(NamedTuple):
    """A transform of tf in the plane: the pose of ``child`` in ``parent``.

    ``length`` is the length of the quaternion; if it is 0, ``psi`` is NaN.
    """

    stamp_ns: int
    parent: str
    child: str
    x: float
    y: float
    psi: float
    length: float = 1.0


def decode_frame(data: bytes) -> str:
    """Name of a frame, without a leading slash."""
    return printable(data.decode("utf-8", "replace")).lstrip("/")


def decode_header(data: bytes, at: int = 0) -> tuple[int, str, int]:
    """Stamp [ns], frame (without a leading slash) and end of the header that begins at ``at``."""
    _, sec, nsec, length = _HEADER.unpack_from(data, at)
    at += 16
    frame = decode_frame(data[at : at + length])
    return sec * 1000000000 + nsec, frame, at + length


def decode_frames(data: bytes, has_child: bool) -> tuple[str, str]:
    """Frame of a message with a header, and its ``child_frame_id``, empty if it has none."""
    _, frame, at = decode_header(data)
    if not has_child:
        return frame, ""
    (length,) = _U32.unpack_from(data, at)
    child = decode_frame(data[at + 4 : at + 4 + length])
    return frame, child


def decode_odometry(batch: Encoded) -> Decoded:
    """Decode ``nav_msgs/Odometry``.

    Parameters
    ----------
    batch : list of bytes, length n, or ndarray of uint8, shape (n, size)

    Returns
    -------
    stamps : ndarray of int64, shape (n,)
        Stamps [ns].
    values : ndarray, shape (n, 7)
        ``x y psi q v_x v_y yaw_rate`` [m, m, rad, 1, m/s, m/s, rad/s]; ``q`` is the length of the
        quaternion; if it is 0, the heading is NaN.
    good : ndarray of bool, shape (n,)
        False for messages that do not have the layout of their type.
    """
    return _decode(batch, ODOMETRY_SIZE, _ODOMETRY_FIELDS, has_child=True)


def decode_pose(batch: Encoded) -> Decoded:
    """Decode ``PoseStamped`` or ``PoseWithCovarianceStamped`` like odometry; velocities are NaN."""
    return _decode(batch, _POSE.size, _POSE_FIELDS)


def decode_drive(batch: Encoded) -> Decoded:
    """Decode ``AckermannDriveStamped``, with values ``steering_angle speed`` [rad, m/s]."""
    return _table(batch, _DRIVE_SIZE, _DRIVE_FIELDS)


def decode_belief(batch: Encoded) -> Decoded:
    """Decode ``map_racing/Belief``, with the values `BELIEF_FIELDS`."""
    return _table(batch, _BELIEF_SIZE, _BELIEF_LAYOUT)


def decode_imu(batch: Encoded) -> Decoded:
    """Decode ``Imu``, with values ``yaw_rate a_x a_y a_z`` [rad/s, m/s^2] in its own axes."""
    return _table(batch, _IMU_SIZE, _IMU_FIELDS)


def decode_float64(batch: Encoded) -> Decoded:
    """Decode ``Float64``, one value each; it has no stamp, so all stamps are 0."""
    good = np.array([len(data) == 8 for data in batch], dtype=bool)
    values = np.array([_F64.unpack(data)[0] if len(data) == 8 else _NAN for data in batch])
    return np.zeros(len(batch), dtype=np.int64), values.reshape(-1, 1), good


def decode_string(data: bytes, at: int = 0) -> tuple[str, int]:
    """Text of a ``String``, or of a field of another message at ``at``, and its end.

    Raises
    ------
    struct.error
        If the message is cut off.
    """
    (length,) = _U32.unpack_from(data, at)
    end = at + 4 + length
    if end > len(data):
        raise struct.error("a text is longer than its message")
    return data[at + 4 : end].decode("utf-8", "replace"), end


def decode_diagnostics(data: bytes) -> tuple[int, list[tuple[str, str, str]]]:
    """Stamp [ns] of a ``DiagnosticArray``, and name, message and hardware of each status.

    Raises
    ------
    struct.error
        If the message is cut off.
    """
    stamp_ns, _, at = decode_header(data)
    (count,) = _U32.unpack_from(data, at)
    at += 4
    statuses = []
    for _ in range(count):
        at += 1  # the level
        texts = []
        for _ in range(3):
            text, at = decode_string(data, at)
            texts.append(text)
        (pairs,) = _U32.unpack_from(data, at)
        at += 4
        for _ in range(2 * pairs):
            _, at = decode_string(data, at)
        statuses.append(tuple(texts))
    return stamp_ns, statuses


def _decode(batch, body, fields, has_child=False):
    stamps, columns, good = _table(batch, body, fields, has_child)
    x, y, q_x, q_y, q_z, q_w, *twist = columns.T
    # Damaged messages can contain any number.
    with np.errstate(all="ignore"):
        psi, length = yaw_and_length(q_x, q_y, q_z, q_w)
    twist = twist or [np.full(x.size, _NAN)] * 3
    return stamps, np.stack([x, y, psi, length, *twist], axis=1), good


def yaw_and_length(q_x, q_y, q_z, q_w):
    """Yaw and length of quaternions.

    Parameters
    ----------
    q_x, q_y, q_z, q_w : float or ndarray
        All of one shape.

    Returns
    -------
    yaw, length : ndarray
        Yaw [rad], NaN where the length is 0, and length [-].
    """
    psi = np.arctan2(2.0 * (q_w * q_z + q_x * q_y), q_w * q_w + q_x * q_x - q_y * q_y - q_z * q_z)
    length = np.sqrt(q_x * q_x + q_y * q_y + q_z * q_z + q_w * q_w)
    return np.where(length > SHORTEST_QUATERNION, psi, _NAN), length


def _table(batch, body, fields, has_child=False):
    """Decode messages with a header, an optional ``child_frame_id``, and the body.

    Messages of the same length with frames of the same length have the same layout, so they are
    decoded at once; in practice these are all messages of a topic.
    """
    if isinstance(batch, np.ndarray) and np.any(batch[:, 12:16] != batch[0, 12:16]):
        batch = [row.tobytes() for row in batch]
    if isinstance(batch, np.ndarray):
        # A slice takes half the time of a list of all indices.
        alike = {(batch.shape[1], batch[0, 12:16].tobytes()): slice(None)}
    else:
        alike = {}
        for index, data in enumerate(batch):
            alike.setdefault((len(data), data[12:16]), []).append(index)
    stamps = np.zeros(len(batch), dtype=np.int64)
    columns = np.full((len(batch), len(fields)), _NAN)
    good = np.zeros(len(batch), dtype=bool)
    for (size, frame), where in alike.items():
        at = 16 + int.from_bytes(frame, "little")
        start = size - body if has_child else at
        if size < 16 or start < at + 4 * has_child or start + body > size:
            continue
        layout = {"sec": ("<u4", 4), "nsec": ("<u4", 8)}
        layout.update((name, (kind, start + offset)) for name, (kind, offset) in fields.items())
        if has_child:
            layout["child"] = ("<u4", at)
        formats, offsets = zip(*layout.values())
        kind = np.dtype(
            {"names": list(layout), "formats": formats, "offsets": offsets, "itemsize": size}
        )
        if isinstance(batch, np.ndarray):
            table = batch.view(kind)[:, 0]
        else:
            table = np.frombuffer(b"".join([batch[index] for index in where]), kind)
        stamps[where] = table["sec"].astype(np.int64) * 1000000000 + table["nsec"]
        for column, name in enumerate(fields):
            columns[where, column] = table[name]
        good[where] = table["child"] == start - at - 4 if has_child else True
    return stamps, columns, good


def decode_transforms(data: bytes) -> list[Transform]:
    """Decode a ``TFMessage``."""
    (count,) = _U32.unpack_from(data)
    at = 4
    transforms = []
    for _ in range(count):
        stamp_ns, parent, at = decode_header(data, at)
        (length,) = _U32.unpack_from(data, at)
        child = decode_frame(data[at + 4 : at + 4 + length])
        at += 4 + length
        x, y, q_x, q_y, q_z, q_w = _PLANE_POSE.unpack_from(data, at)
        at += _POSE.size
        length = math.sqrt(q_x * q_x + q_y * q_y + q_z * q_z + q_w * q_w)
        known = length > SHORTEST_QUATERNION
        psi = yaw_from_quaternion(q_x, q_y, q_z, q_w) if known else _NAN
        transforms.append(Transform(stamp_ns, parent, child, x, y, psi, length))
    return transforms


def decode_waypoints(data: bytes) -> dict[str, np.ndarray]:
    """Decode a ``WpntArray`` to columns, named after the fields of ``Wpnt``.

    Parameters
    ----------
    data : bytes
        The message.

    Returns
    -------
    dict of str to ndarray, shape (n,)
        [SI], by name.

    Raises
    ------
    struct.error
        If the message is too short.
    """
    at = decode_header(data)[2]
    (count,) = _U32.unpack_from(data, at)
    if at + 4 + count * _WAYPOINTS.itemsize > len(data):
        raise struct.error("the message is too short for its waypoints")
    table = np.frombuffer(data, _WAYPOINTS, count, at + 4)
    return {name: table[name].astype(float) for name in _WAYPOINTS.names}


def decode_path(data: bytes) -> dict[str, np.ndarray]:
    """Decode a ``nav_msgs/Path`` to columns ``x_m y_m psi_rad``; no headings if all are 0.

    Parameters
    ----------
    data : bytes
        The message.

    Returns
    -------
    dict of str to ndarray, shape (n,)
        Positions [m] and headings [rad], by name.

    Raises
    ------
    struct.error
        If the message is too short.
    """
    at = decode_header(data)[2]
    (count,) = _U32.unpack_from(data, at)
    at += 4
    if count > (len(data) - at) // (16 + _POSE.size):
        raise struct.error("the message is too short for its poses")
    poses = np.empty((count, 6))
    for row in range(count):
        (length,) = _U32.unpack_from(data, at + 12)
        at += 16 + length
        poses[row] = _PLANE_POSE.unpack_from(data, at)
        at += _POSE.size
    x, y, q_x, q_y, q_z, q_w = poses.T
    columns = {"x_m": x, "y_m": y}
    # Planners often leave all orientations at their defaults: 0 0 0 1, or 0 0 0 0.
    psi = yaw_and_length(q_x, q_y, q_z, q_w)[0]
    if np.any(q_z) and np.isfinite(psi).all():
        columns["psi_rad"] = psi
    return columns
