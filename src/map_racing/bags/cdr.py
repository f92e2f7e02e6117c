"""Messages of ROS 2 in the layout of ROS 1.

ROS 2 serializes by CDR: four bytes name the encoding, numbers are aligned to their size, counted
from there, strings end with a zero byte, and a header has no sequence number. The fields are the
same, so a message is converted by copying a few slices, many messages at once, and all readers of
messages need only one layout.

Encoding: OMG, Data Distribution Service Interoperability Wire Protocol (DDSI-RTPS) 2.2, section 10.
"""

from __future__ import annotations

import re
import struct
from contextlib import suppress

import numpy as np

from ..printing import printable
from . import messages as msg
from .bag import Connection

__all__ = ["Layout", "connection_of"]

_LITTLE_ENDIAN = b"\0\1"
_START = 4  # alignment counts from here, after the encoding
_SEQUENCE = b"\0\0\0\0"
_U32 = struct.Struct("<I")
_POSE_SIZE = 7 * 8
_WAYPOINT_STRIDE = 88  # an int32 and its padding, ten float64
_WAYPOINT_FIELDS = ("id", *msg.WAYPOINT_FIELDS)


def _aligned(at, size):
    return at + (_START - at) % size


def _text(data, at):
    """Length of a string in ROS 1, and the ends of its text and of itself."""
    (length,) = _U32.unpack_from(data, at)
    end = at + 4 + length
    if end > len(data):
        raise struct.error("the message is too short for its strings")
    return _U32.pack(max(length - 1, 0)), end - (length > 0), end


class _Stamped:
    """Rearranges messages with a header, an optional ``child_frame_id``, and numbers.

    Parameters
    ----------
    alignment : int
        Size of the first number.
    child : bool, optional
        Whether there is a ``child_frame_id``.
    size : int, optional
        Size of the numbers; by default the rest of the message.
    """

    def __init__(self, alignment: int, child: bool = False, size: int | None = None):
        self._alignment, self._child, self._size = alignment, child, size
        # String lengths of the last message; in practice the next has the same.
        self._lengths, self._child_at = None, 0

    def __call__(self, data: bytes) -> bytes:
        at = self._child_at
        if (data[12:16], data[at : at + 4]) != self._lengths:
            self._locate(data)
        return b"".join(
            (_SEQUENCE, data[4:12], self._frame, data[self._text], self._name)
            + (data[self._name_text], data[self._numbers])
        )

    def _locate(self, data):
        self._lengths = None  # until all is found in this message, which may be damaged
        self._frame, text, end = _text(data, 12)
        self._text = slice(16, text)
        self._name, self._name_text = b"", slice(0)
        if self._child:
            at = self._child_at = _aligned(end, 4)
            self._name, text, end = _text(data, at)
            self._name_text = slice(at + 4, text)
        start = _aligned(end, self._alignment)
        self._numbers = slice(start, None if self._size is None else start + self._size)
        self._lengths = data[12:16], data[self._child_at : self._child_at + 4]

    def all(self, rows: np.ndarray) -> np.ndarray | None:
        """As the call, for many messages as rows of bytes; None if the lengths of strings vary."""
        first = self(rows[0].tobytes())
        if any(np.any(rows[:, at : at + 4] != rows[0, at : at + 4]) for at in (12, self._child_at)):
            return None
        rearranged = np.empty((len(rows), len(first)), np.uint8)
        rearranged[:] = np.frombuffer(first, np.uint8)
        at = 0
        for before, part in (
            (_SEQUENCE, slice(4, 12)),
            (self._frame, self._text),
            (self._name, self._name_text),
            (b"", self._numbers),
        ):
            columns, at = rows[:, part], at + len(before)
            rearranged[:, at : at + columns.shape[1]] = columns
            at += columns.shape[1]
        return rearranged


def _float64(data):
    return data[4:12]


def _header(data, at):
    """A header that begins at ``at`` in ROS 1, and its end."""
    length, text, end = _text(data, at + 8)
    return _SEQUENCE + data[at : at + 8] + length + data[at + 12 : text], end


def _transforms(data):
    (count,) = _U32.unpack_from(data, _START)
    at, parts = _START + 4, [data[_START : _START + 4]]
    for _ in range(count):
        header, at = _header(data, _aligned(at, 4))
        at = _aligned(at, 4)
        length, text, end = _text(data, at)
        pose = _aligned(end, 8)
        parts += (header, length, data[at + 4 : text], data[pose : pose + _POSE_SIZE])
        at = pose + _POSE_SIZE
    return b"".join(parts)


def _path(data):
    header, at = _header(data, _START)
    at = _aligned(at, 4)
    (count,) = _U32.unpack_from(data, at)
    parts = [header, data[at : at + 4]]
    at += 4
    for _ in range(count):
        header, at = _header(data, _aligned(at, 4))
        pose = _aligned(at, 8)
        parts += (header, data[pose : pose + _POSE_SIZE])
        at = pose + _POSE_SIZE
    return b"".join(parts)


def _waypoints(data):
    header, at = _header(data, _START)
    at = _aligned(at, 4)
    (count,) = _U32.unpack_from(data, at)
    first = _aligned(at + 8, 8)  # the numbers of the first, after its id
    size = _WAYPOINT_STRIDE - 8
    stop = first + (count - 1) * _WAYPOINT_STRIDE + size
    if not count or stop > len(data):
        if count:
            raise struct.error("the message is too short for its waypoints")
        return header + data[at : at + 4]
    rows = np.zeros((count, 4 + size), dtype=np.uint8)
    # The ids just count up; no reader uses them.
    rows[:, :4] = np.arange(count, dtype="<i4").view(np.uint8).reshape(count, 4)
    values = np.frombuffer(data, np.uint8, stop - first, first)
    rows[:, 4:] = np.lib.stride_tricks.as_strided(values, (count, size), (_WAYPOINT_STRIDE, 1))
    return header + data[at : at + 4] + rows.tobytes()


def _string(data):
    length, text, _ = _text(data, _START)
    return length + data[_START + 4 : text]


def _diagnostics(data):
    header, at = _header(data, _START)
    at = _aligned(at, 4)
    (count,) = _U32.unpack_from(data, at)
    parts, at = [header, data[at : at + 4]], at + 4

    def texts(number):
        nonlocal at
        for _ in range(number):
            at = _aligned(at, 4)
            length, text, end = _text(data, at)
            parts.extend((length, data[at + 4 : text]))
            at = end

    for _ in range(count):
        parts.append(data[at : at + 1])  # the level
        at += 1
        texts(3)
        at = _aligned(at, 4)
        (pairs,) = _U32.unpack_from(data, at)
        parts.append(data[at : at + 4])
        at += 4
        texts(2 * pairs)
    return b"".join(parts)


_MAKERS = {
    msg.ODOMETRY: lambda: _Stamped(8, child=True, size=msg.ODOMETRY_SIZE),
    msg.POSE: lambda: _Stamped(8),
    msg.POSE_COVARIANCE: lambda: _Stamped(8),
    msg.IMU: lambda: _Stamped(8),
    msg.ACKERMANN: lambda: _Stamped(4),
    msg.FLOAT64: lambda: _float64,
    msg.TF: lambda: _transforms,
    msg.PATH: lambda: _path,
    msg.WAYPOINTS: lambda: _waypoints,
    msg.STRING: lambda: _string,
    msg.DIAGNOSTICS: lambda: _diagnostics,
}


class Layout:
    """Rearranges the messages of a connection from CDR to the layout of ROS 1.

    Parameters
    ----------
    connection : Connection
        Of a type that this package knows.
    """

    def __init__(self, connection: Connection):
        self._convert = _MAKERS[connection.type]()

    def __call__(self, data: bytes) -> bytes:
        """A message; a damaged one becomes empty, which every decoder rejects."""
        if data[:2] != _LITTLE_ENDIAN:
            return b""
        try:
            return self._convert(data)
        except struct.error:
            return b""

    def all(self, contents: np.ndarray | list[bytes]) -> np.ndarray | list[bytes]:
        """As the call, for `map_racing.bags.bag.Batch.contents`."""
        alike = isinstance(contents, np.ndarray) and isinstance(self._convert, _Stamped)
        if alike and (contents[:, :2] == np.frombuffer(_LITTLE_ENDIAN, np.uint8)).all():
            with suppress(struct.error):
                rows = self._convert.all(contents)
                if rows is not None:
                    return rows
        return [self(bytes(one)) for one in contents]


def connection_of(topic: str, kind: str, definition: str) -> Connection:
    """Connection of a topic of ROS 2.

    Parameters
    ----------
    topic : str
    kind : str
        Type, such as ``nav_msgs/msg/Odometry``.
    definition : str
        Empty if the bag has none, as with sqlite3 before ROS 2 Iron; known types then have their
        usual layout.

    Returns
    -------
    Connection
    """
    topic, kind = printable(topic), printable(kind).replace("/msg/", "/")
    md5sum = msg.MD5.get(kind, "")
    if kind == msg.WAYPOINTS and definition and _fields_of_waypoint(definition) != _WAYPOINT_FIELDS:
        md5sum = ""
    return Connection("/" + topic.lstrip("/"), kind, md5sum, definition, cdr=not md5sum)


def _fields_of_waypoint(definition):
    """Names of the fields of ``Wpnt`` in the definition of an array."""
    parts = re.split(r"^=+\n(?:MSG: *)?", definition, flags=re.MULTILINE)
    for part in parts:
        head, _, body = part.partition("\n")
        if head.strip() in ("f110_msgs/Wpnt", "f110_msgs/msg/Wpnt"):
            lines = (line.partition("#")[0].split() for line in body.splitlines())
            return tuple(words[1] for words in lines if len(words) == 2 and "=" not in words[1])
    return ()
