"""Write a ROS 1 bag."""

from __future__ import annotations

import struct
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Callable

import lz4.frame

from ..errors import BagError
from ..files import unfinished
from . import encoding
from . import messages as msg
from .bag import Bag, Message
from .topics import BELIEF_TOPIC, DIAGNOSTICS_TOPIC, DRIVE_TOPIC, SETTINGS_TOPIC, STATE

__all__ = ["BagWriter", "copy_bag"]


class BagWriter:
    """Write a race as a ROS 1 bag that ``rosbag info`` and ``rosbag play`` accept.

    Use it as a context manager. The bag appears under its name only when it is complete, and
    replaces an existing file; after an exception nothing is left behind.

    All methods take a ``stamp``: seconds as a float, or nanoseconds as an int. It is the header's
    time stamp and, unless ``received`` is given, the time of receipt. In ROS, 0 means an unknown
    time, so clocks must begin later.

    Parameters
    ----------
    path : str or pathlib.Path
    compression : {None, "lz4", "bz2"}, optional

    Raises
    ------
    BagError
        If the file cannot be written, `path` is a directory, a pipe or a device, the compression is
        unknown, or a message cannot be packed.

    Notes
    -----
    Six topics at 40 Hz for 60 s (14,400 messages) take about 0.1 s.
    """

    def __init__(self, path: str | Path, compression: str | None = None):
        self.path = Path(path)
        if compression not in (None, "lz4", "bz2"):
            raise BagError(f"{path}: expected compression lz4 or bz2, got {compression!r}")
        self._compression = compression
        if not self.path.name or self.path.is_dir():
            raise BagError(f"{path}: cannot write the bag: expected a file, got a directory")
        if self.path.exists() and not self.path.is_file():
            raise BagError(f"{path}: cannot write the bag: expected a file, got a pipe or a device")
        self._topics: dict[str, list] = {}

    def __enter__(self):
        # Slow to import, and needed only to write. Imported first, so that an interrupt leaves no
        # file.
        from rosbags.rosbag1 import Writer
        from rosbags.typesys import Stores, get_types_from_msg, get_typestore

        self._types = get_typestore(Stores.ROS1_NOETIC)
        for name, definition in msg.DEFINITIONS.items():
            self._types.register(get_types_from_msg(definition, name))
        with ExitStack() as stack:
            self._writer = Writer(stack.enter_context(unfinished(self.path)))
            if self._compression:
                self._writer.set_compression(Writer.CompressionFormat[self._compression.upper()])
            if self._compression == "lz4":
                self._writer.compressor = _compress_for_ros
            try:
                self._writer.open()
            except OSError as error:
                raise self._failed(error) from None
            stack.callback(self._writer.close)
            self._open = stack.pop_all()
        return self

    def __exit__(self, *raised):
        try:
            self._open.__exit__(*raised)
        except OSError as error:
            raise self._failed(error) from None

    def _failed(self, error):
        return BagError(f"{self.path}: cannot write the bag: {error.strerror or error}")

    def odometry(
        self,
        stamp,
        x,
        y,
        psi,
        v_x,
        v_y,
        yaw_rate,
        *,
        topic="/car_state/odom",
        frame="map",
        child_frame="base_link",
        received=None,
    ):
        """Pose in ``frame`` [m, rad] with velocity in the body frame [m/s, rad/s]."""
        values = (frame, child_frame, x, y, psi, v_x, v_y, yaw_rate)
        self._write(topic, msg.ODOMETRY, stamp, received, encoding.encode_odometry, values)

    def pose(self, stamp, x, y, psi, *, topic="/car_state/pose", frame="map", received=None):
        """Pose in ``frame`` [m, rad]."""
        self._write(topic, msg.POSE, stamp, received, encoding.encode_pose, (frame, x, y, psi))

    def drive(
        self, stamp, steering_angle, speed, *, topic=DRIVE_TOPIC, frame="base_link", received=None
    ):
        """Drive command: steering angle [rad], speed [m/s]."""
        values = (frame, steering_angle, speed, 0.0, 0.0, 0.0)
        self._write(topic, msg.ACKERMANN, stamp, received, encoding.encode_drive, values)

    def belief(self, stamp, values, *, received=None):
        """Estimates of the adaptive controller: `BELIEF_FIELDS` in order."""
        values = ("map", *values)
        self._write(BELIEF_TOPIC, msg.BELIEF, stamp, received, encoding.encode_belief, values)

    def imu(self, stamp, a_x, a_y, yaw_rate, *, received=None):
        """Specific force [m/s^2] and yaw rate [rad/s] in the axes of the car (REP-103)."""
        values = ("base_link", a_x, a_y, 9.81, yaw_rate)
        topic = "/vesc/sensors/imu/raw"
        self._write(topic, msg.IMU, stamp, received, encoding.encode_imu, values)

    def transform(
        self, stamp, x, y, psi, *, parent="map", child="base_link", static=False, received=None
    ):
        """Pose of the frame ``child`` in ``parent`` [m, rad], on ``/tf`` or ``/tf_static``."""
        topic, values = "/tf_static" if static else "/tf", (parent, child, x, y, psi)
        self._write(
            topic, msg.TF, stamp, received, encoding.encode_transform, values, latched=static
        )

    def waypoints(self, stamp, rows, *, topic="/global_waypoints", frame="map", received=None):
        """Raceline as ``f110_msgs/WpntArray``; `rows` are structured by `WAYPOINT_FIELDS`."""
        values, encode = (frame, rows.tolist()), encoding.encode_waypoints
        self._write(topic, msg.WAYPOINTS, stamp, received, encode, values, latched=True)

    def text(self, stamp, text):
        """Settings as ``std_msgs/String``, which has no stamp of its own."""
        encode = encoding.encode_string
        self._write(SETTINGS_TOPIC, msg.STRING, stamp, None, encode, (text,), latched=True)

    def state(self, stamp, text, level):
        """State of the controller as its node words it, with its level in diagnostics."""
        values, encode = (level, f"controller{STATE}", text, ""), encoding.encode_status
        self._write(DIAGNOSTICS_TOPIC, msg.DIAGNOSTICS, stamp, None, encode, values)

    def _write(self, topic, kind, stamp, received, encode, values, latched=False):
        entry = self._topics.get(topic)
        if entry is None:
            entry = self._topics[topic] = [kind, 0, self._connect(topic, kind, latched)]
        if entry[0] != kind:
            raise BagError(f"{self.path}: {topic}: expected {entry[0]}, got {kind}")
        try:
            stamp_ns = _nanoseconds(stamp)
            time_ns = stamp_ns if received is None else _nanoseconds(received)
            data = encode(entry[1], stamp_ns, *values)
            if time_ns <= 0:
                raise ValueError("expected a time after 0")
        except (TypeError, ValueError, OverflowError, struct.error) as error:
            raise BagError(f"{self.path}: {topic}: cannot write the message: {error}") from None
        entry[1] += 1
        try:
            self._writer.write(entry[2], time_ns, data)
        except OSError as error:
            raise self._failed(error) from None

    def _connect(self, topic, kind, latched):
        package, name = kind.split("/")
        name = f"{package}/msg/{name}"
        definition, md5sum = self._types.generate_msgdef(name)
        return self._writer.add_connection(
            topic,
            name,
            msgdef=definition,
            md5sum=md5sum,
            callerid="/map_racing",
            latching=int(latched),
        )


def copy_bag(bag: Bag, output: str | Path, data_of: Callable[[int, Message], bytes]) -> None:
    """Write all messages of a bag into another, uncompressed.

    Parameters
    ----------
    bag : Bag
        Of ROS 1.
    output : str or pathlib.Path
        Replaced if it exists.
    data_of : callable
        Content of a message, from its number within its connection and the message.

    Raises
    ------
    BagError
        If the file cannot be written.
    """
    from rosbags.rosbag1 import Writer

    try:
        with suppress(FileNotFoundError):
            Path(output).unlink()
        with Writer(Path(output)) as writer:
            connections, count = {}, {}
            for message in bag.messages():
                number = message.connection
                about = bag.connections.get(number)
                if about is None:  # lost in a damaged bag
                    continue
                # The writer treats a node that connected twice as one.
                if about not in connections:
                    package, _, name = about.type.partition("/")
                    connections[about] = writer.add_connection(
                        about.topic,
                        f"{package}/msg/{name}",
                        msgdef=about.definition,
                        md5sum=about.md5sum,
                        callerid=about.sender or None,
                        latching=int(about.latching),
                    )
                place = count[number] = count.get(number, -1) + 1
                writer.write(connections[about], message.time_ns, data_of(place, message))
    except OSError as error:
        raise BagError(f"{output}: cannot write the bag: {error.strerror}") from None


def _compress_for_ros(data):
    """Lz4 frame in a form that ROS can read, unlike the default form of rosbags."""
    return lz4.frame.compress(data, block_linked=False, store_size=False, content_checksum=True)


def _nanoseconds(stamp):
    return stamp if isinstance(stamp, int) else int(round(stamp * 1e9))
