"""ROS 1 bags: write one from a race, read the driving back from any.

Only this module imports rosbags. It writes the files, and decodes waypoint arrays of unknown
versions by the definition that the bag itself carries; all else is in :mod:`.bag_records` and
:mod:`.messages`.
"""

from __future__ import annotations

import os
import struct
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import NamedTuple

import lz4.frame
import numpy as np
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ..errors import BagError, RacelineError
from ..track.checks import raceline_of
from ..track.raceline import FARTHEST
from ..track.table import CourseTable
from ..track.waypoints import WAYPOINT_COLUMNS, waypoint_rows
from . import messages as msg
from .bag_records import BagFile
from .bag_series import Series, TransformTree
from .samples import Commands, Recording

__all__ = [
    "BagWriter",
    "DRIVE_TOPIC",
    "read_recording",
    "read_signals",
    "read_waypoint_table",
]

DRIVE_TOPIC = "/vesc/high_level/ackermann_cmd_mux/input/nav_1"
"""Where racing stacks publish the drive command."""

_POSE_DECODERS = {
    msg.MD5[msg.ODOMETRY]: msg.decode_odometry,
    msg.MD5[msg.POSE]: msg.decode_pose,
    msg.MD5[msg.POSE_COVARIANCE]: msg.decode_pose,
}
_KINDS = {md5: rank for rank, md5 in enumerate(_POSE_DECODERS)}
# What else can be read over time: decoder, and the names of its last columns.
_SIGNALS = {
    msg.MD5[msg.ODOMETRY]: (msg.decode_odometry, ("v_x", "v_y", "yaw_rate")),
    msg.MD5[msg.IMU]: (msg.decode_imu, ("yaw_rate", "a_x", "a_y", "a_z")),
    msg.MD5[msg.ACKERMANN]: (msg.decode_drive, ("steering", "speed")),
    msg.MD5[msg.FLOAT64]: (msg.decode_float64, ("value",)),
}
_KNOWN_IMUS = ("/vesc/sensors/imu/raw", "/sensors/imu/raw", "/imu")
_KNOWN_POSES = ("/car_state/odom", "/car_state/pose", "/pf/pose/odom", "/odom")
_KNOWN_DRIVES = (DRIVE_TOPIC, "/drive", "/nav")
_TRUTH = ("ground_truth", "groundtruth", "gt_pose")
# Slower than this [Hz] a pose is a goal, an initial guess or a rare fix, not a car's path.
_SLOWEST_POSE = 5.0


# -- writing -------------------------------------------------------------------------------------


class BagWriter:
    """Write a race as a ROS 1 bag that ``rosbag info`` and ``rosbag play`` accept.

    Use it as a context manager. The bag appears under its name only when it is complete: it is
    written under a temporary name beside it and renamed at the end; after an exception nothing is
    left behind. An existing file of that name is replaced.

    All methods take a ``stamp``: seconds as a float, or nanoseconds as an int. It is the header's
    time stamp and, unless ``received`` gives another, the time at which the message was recorded.
    ROS reads the stamp 0 as "unknown" and has no time 0, so clocks must begin later.

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

    def __init__(self, path, compression=None):
        self.path = Path(path)
        if compression not in (None, "lz4", "bz2"):
            raise BagError(f"{path}: expected compression lz4 or bz2, got {compression!r}")
        self._compression = compression
        if not self.path.name or self.path.is_dir():
            raise BagError(f"{path}: cannot write the bag: expected a file, got a directory")
        if self.path.exists() and not self.path.is_file():
            raise BagError(f"{path}: cannot write the bag: expected a file, got a pipe or a device")
        # A link stays one: what it points to is replaced.
        self._target = Path(os.path.realpath(str(path)))
        self._temporary = self._target.with_name(f".{self._target.name}.{os.getpid()}.part")
        self._topics: dict[str, list] = {}

    def __enter__(self):
        # First what takes long, so that an interrupt meets no file yet.
        self._types = get_typestore(Stores.ROS1_NOETIC)
        for name, definition in msg.DEFINITIONS.items():
            self._types.register(get_types_from_msg(definition, name))
        self._writer = Writer(self._temporary)
        if self._compression:
            self._writer.set_compression(Writer.CompressionFormat[self._compression.upper()])
        if self._compression == "lz4":
            self._writer.compressor = _compress_for_ros
        try:
            self._writer.open()
        except OSError as error:
            raise BagError(f"{self.path}: cannot write the bag: {error.strerror}") from None
        return self

    def __exit__(self, exception_type, exception, traceback):
        try:
            self._writer.close()
            if exception_type is None:
                os.replace(self._temporary, self._target)
        except OSError as error:
            raise BagError(f"{self.path}: cannot write the bag: {error.strerror}") from None
        finally:
            with suppress(OSError):
                self._temporary.unlink()

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
        self._write(
            *(topic, msg.ODOMETRY, stamp, received, msg.encode_odometry),
            *(frame, child_frame, x, y, psi, v_x, v_y, yaw_rate),
        )

    def pose(self, stamp, x, y, psi, *, topic="/car_state/pose", frame="map", received=None):
        """Pose in ``frame`` [m, rad]."""
        self._write(topic, msg.POSE, stamp, received, msg.encode_pose, frame, x, y, psi)

    def drive(
        self,
        stamp,
        steering_angle,
        speed,
        *,
        steering_angle_velocity=0.0,
        acceleration=0.0,
        jerk=0.0,
        topic=DRIVE_TOPIC,
        frame="base_link",
        received=None,
    ):
        """Drive command: steering angle [rad], speed [m/s]."""
        self._write(
            *(topic, msg.ACKERMANN, stamp, received, msg.encode_drive),
            *(frame, steering_angle, speed, steering_angle_velocity, acceleration, jerk),
        )

    def imu(
        self,
        stamp,
        a_x,
        a_y,
        yaw_rate,
        *,
        a_z=9.81,
        topic="/vesc/sensors/imu/raw",
        frame="base_link",
        received=None,
    ):
        """Specific force [m/s^2] and yaw rate [rad/s] in the axes of ``frame`` (REP-103)."""
        self._write(
            *(topic, msg.IMU, stamp, received, msg.encode_imu, frame, a_x, a_y, a_z, yaw_rate)
        )

    def transform(
        self, stamp, x, y, psi, *, parent="map", child="base_link", static=False, received=None
    ):
        """Pose of the frame ``child`` in ``parent`` [m, rad], on ``/tf`` or ``/tf_static``."""
        self._write(
            *("/tf_static" if static else "/tf", msg.TF, stamp, received, msg.encode_transform),
            *(parent, child, x, y, psi),
            latched=static,
        )

    def waypoints(
        self,
        stamp,
        raceline,
        *,
        spacing=0.1,
        topic="/global_waypoints",
        frame="map",
        latched=True,
        received=None,
    ):
        """Raceline as ``f110_msgs/WpntArray``.

        Parameters
        ----------
        stamp : float or int
        raceline : Raceline, or ndarray of shape (n, 10)
            An array holds the waypoints themselves, as of
            `map_racing.track.waypoints.waypoint_rows`.
        spacing : float, optional
            Distance between the waypoints [m] of a Raceline.
        """
        rows = raceline
        if not isinstance(raceline, np.ndarray):
            rows = waypoint_rows(raceline, spacing)
        self._write(
            *(topic, msg.WAYPOINTS, stamp, received, msg.encode_waypoints, frame, rows.tolist()),
            latched=latched,
        )

    def _write(self, topic, kind, stamp, received, encode, *values, latched=False):
        entry = self._topics.get(topic)
        if entry is None:
            entry = self._topics[topic] = [kind, 0, self._connect(topic, kind, latched)]
        if entry[0] != kind:
            raise BagError(f"{self.path}: {topic} carries {entry[0]}, not {kind}")
        try:
            stamp_ns = _nanoseconds(stamp)
            time_ns = stamp_ns if received is None else _nanoseconds(received)
            data = encode(entry[1], stamp_ns, *values)
            if time_ns <= 0:
                raise ValueError("no time at or before 0 can be recorded")
        except (TypeError, ValueError, OverflowError, struct.error) as error:
            raise BagError(f"{self.path}: {topic}: cannot write the message: {error}") from None
        entry[1] += 1
        self._writer.write(entry[2], time_ns, data)

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


def _compress_for_ros(data):
    """Lz4 frame as ROS reads it: it refuses the usual form, which rosbags writes."""
    return lz4.frame.compress(data, block_linked=False, store_size=False, content_checksum=True)


def _nanoseconds(stamp):
    return stamp if isinstance(stamp, int) else int(round(stamp * 1e9))


# -- reading -------------------------------------------------------------------------------------


def read_recording(path, pose_topic=None):
    """Driving recorded in a bag.

    The pose is taken from Odometry, PoseStamped, PoseWithCovarianceStamped or tf; without
    `pose_topic` the best source is chosen and the choice explained in the notes: a pose in ``map``
    before one in another frame, wheel odometry (frame ``odom``) last; Odometry, which has the
    velocity, before poses, and those before tf; ``/car_state/odom`` before other names. Topics of
    ground truth come after all others, as do topics slower than 5 Hz; Frenet coordinates are never
    taken.

    Times are the header's stamps; where the stamp is 0, or all over if the stamps of pose or
    command fall back by 1 s or more (a clock was set back), the times of receipt. A damaged or
    unclosed bag gives what is left of it, and the notes say how much that is.

    Parameters
    ----------
    path : str or pathlib.Path
    pose_topic : str, optional
        Topic of the pose. For tf, ``/tf`` (frame ``base_link``) or ``/tf:FRAME``; the transforms
        are chained in the plane up to ``map``, or to the root of the tree.

    Returns
    -------
    Recording

    Raises
    ------
    BagError
        If the file is no bag, or has no pose, or none on `pose_topic` (the message lists the topics
        that could be taken), or the times of receipt fall back as well: it holds several runs.

    Notes
    -----
    A recording of 63 s with 52,000 messages takes 0.04 s, an hour of odometry at 100 Hz 1.0 s.
    """
    with BagFile(path) as bag:
        source, notes = _choose_source(bag, pose_topic)
        drive_topic, drives = _drive_connections(bag)
        lines = _waypoint_connections(bag)
        pose = Series(_POSE_DECODERS.get(source.md5sum))
        command, waypoints = Series(msg.decode_drive), {}
        for message in bag.messages(source.connections.union(drives, lines)):
            number = message.connection
            if number in source.connections:
                pose.add(message)
            elif number in drives:
                command.add(message)
            else:
                line = bag.connections[number]
                _collect_waypoints(waypoints, lines[number], line, message, notes)
        damage = bag.notes()
        notes += damage
    series = {"required": 2} if source.tree is None else {}
    if source.tree is None:
        jumps, read = pose.jump_back, pose.columns
    else:
        jumps = partial(source.tree.jump_back, source.child)
        read = partial(source.tree.columns, source.child)
    jump = jumps(**series) or command.jump_back()
    if jump:
        again = jumps(received=True, **series) or command.jump_back(received=True)
        if again:
            raise BagError(f"{path}: time jumps back by {again:.1f} s: two runs in one bag?")
        notes.append(f"header stamps jump back by {jump:.1f} s: time of receipt used instead")
    received = jump is not None
    before = len(notes)
    times, columns = read(notes, source.topic, received=received, **series)
    if times.size < 2:
        why = "; ".join([*notes[before:], *damage])
        raise BagError(
            f"{path}: {source.topic}: expected at least two poses, got {times.size}"
            + (f" ({why})" if why else "")
        )
    t0_ns = int(times[0])
    commands = None
    if drives:
        at, (angle, speed) = command.columns(notes, drive_topic, received=received)
        commands = Commands((at - t0_ns) * 1e-9, angle, speed, drive_topic)
    raceline = None
    if waypoints:
        topic = min(waypoints, key=_waypoint_rank)
        try:
            raceline = raceline_of(_course_table(path, topic, waypoints[topic]))
            notes.append("; ".join([f"raceline: {topic}", *map(str, raceline.findings)]))
        except RacelineError as error:
            notes.append(f"raceline left out: {error}")
    return Recording(
        (times - t0_ns) * 1e-9,
        *columns,
        t0_ns=t0_ns,
        source=str(path),
        topic=source.topic,
        type=source.type,
        frame=source.frame,
        commands=commands,
        raceline=raceline,
        receive_time=received,
        notes=notes,
    )


def read_signals(path, recording, topics):
    """Further topics of a bag, on the clock of what was already read from it.

    Parameters
    ----------
    path : str or pathlib.Path
    recording : Recording
        What `read_recording` read from the same bag.
    topics : dict of str to str
        Names to topics of Odometry, Imu, AckermannDriveStamped or Float64. An empty topic under the
        name ``"imu"`` stands for the IMU's, wherever it is.

    Returns
    -------
    dict of str to (ndarray, dict)
        Names to times [s] and columns: ``v_x v_y yaw_rate``, ``yaw_rate a_x a_y a_z``,
        ``steering speed``, or ``value``. A name whose topic is empty and not found is left out.

    Raises
    ------
    BagError
        If a topic is not in the bag, or of another type, or its time falls back.
    """
    found, sources, owners = {}, {}, {}
    with BagFile(path) as bag:
        for name, topic in topics.items():
            wanted = "/" + topic.lstrip("/") if topic else _imu_topic(bag)
            if wanted is None:
                continue
            sources[name] = wanted
            if wanted in found:
                continue
            numbers = {n for n, c in bag.connections.items() if c.topic == wanted}
            kinds = {bag.connections[n].md5sum for n in numbers}
            if len(kinds) != 1 or not kinds <= set(_SIGNALS):
                there = ", ".join(sorted(bag.connections[n].type for n in numbers))
                known = ", ".join(kind for kind, md5 in msg.MD5.items() if md5 in _SIGNALS)
                raise BagError(
                    f"{path}: {wanted}: expected messages of {known}; it has {there or 'none'}"
                )
            decode, columns = _SIGNALS[kinds.pop()]
            found[wanted] = Series(decode), columns
            owners.update(dict.fromkeys(numbers, found[wanted][0]))
        for message in bag.messages(set(owners)):
            owners[message.connection].add(message)
    read = {}
    for topic, (series, columns) in found.items():
        if not series.size:
            raise BagError(f"{path}: {topic}: expected messages, got none")
        received = recording.receive_time
        back = series.jump_back(received=received)
        if back:
            raise BagError(f"{path}: {topic}: time jumps back by {back:.1f} s")
        times, values = series.columns(recording.notes, topic, received=received)
        at = (times - recording.t0_ns) * 1e-9
        read[topic] = at, dict(zip(columns, values[-len(columns) :]))
    return {name: read[topic] for name, topic in sources.items()}


def read_waypoint_table(path, topic=None):
    """Course that a bag carries as ``f110_msgs/WpntArray``, or else as ``nav_msgs/Path``.

    It is the first array that has waypoints, or the longest path.

    Parameters
    ----------
    path : str or pathlib.Path
    topic : str, optional
        Without it ``/global_waypoints`` is preferred, then other topics of waypoint arrays, then
        paths; local waypoints and paths, which are only a stretch of the course, are never chosen.

    Returns
    -------
    CourseTable

    Raises
    ------
    BagError
        If the bag has no waypoints, or none on `topic`.
    """
    notes = []
    with BagFile(path) as bag:
        lines = _waypoint_connections(bag, topic)
        best = min(lines.values(), key=_waypoint_rank, default=None)
        waypoints = {}
        for message in bag.messages(set(lines)):
            number = message.connection
            line = bag.connections[number]
            _collect_waypoints(waypoints, lines[number], line, message, notes)
            if best in waypoints:
                break
        if waypoints:
            name = min(waypoints, key=_waypoint_rank)
            return _course_table(path, name, waypoints[name])
        paths = _read_paths(bag, topic, notes)
    if paths:
        name = min(paths, key=lambda name: (_waypoint_rank(name), -len(paths[name]["x"])))
        return _course_table(path, name, paths[name], "Path")
    asked = f" on {topic}" if topic else ""
    why = f": {notes[0]}" if notes else ""
    raise BagError(
        f"{path}: no raceline (f110_msgs/WpntArray with waypoints, nav_msgs/Path){asked}{why}"
    )


# -- choice of topics ----------------------------------------------------------------------------


class _Source(NamedTuple):
    """A way to learn from a bag where the car was.

    ``rank`` orders sources, the best first: (doubt, frame, kind, name, -count, topic), where doubt
    is 0 for none, 1 if it is chosen only for want of better, 2 if only on demand.
    """

    topic: str
    type: str
    md5sum: str
    frame: str
    rank: tuple
    connections: frozenset = frozenset()
    tree: TransformTree | None = None
    child: str = ""


def _choose_source(bag, pose_topic):
    """The source to take the pose from, and notes that explain the choice."""
    sources = _topic_sources(bag)
    wanted = None if pose_topic is None else _canonical(pose_topic)
    matching = [source for source in sources if source.topic == wanted]
    certain = sources and sources[0].rank[:2] == (0, 0)
    if (wanted and not matching) or not (wanted or certain):
        sources = sorted(sources + _tf_sources(bag), key=lambda source: source.rank)
        matching = [source for source in sources if source.topic == wanted]
    described = ", ".join(source.topic for source in sources[:12])
    if wanted:
        if not matching:
            offers = f"expected one of {described}" if sources else "the bag has no pose at all"
            raise BagError(f"{bag.path}: no pose on {wanted}: {offers}")
        return matching[0], []
    if not sources or sources[0].rank[0] == 2:
        topics = sorted(
            {f"{c.topic} ({c.type})" for n, c in bag.connections.items() if bag.counts.get(n)}
        )
        listed = ", ".join(topics[:12]) + (", ..." if len(topics) > 12 else "")
        what = f"it has {listed}" if topics else "it has no messages"
        what = "; ".join([what, *bag.notes()])
        on_demand = f"; --pose-topic can take {described}" if sources else ""
        raise BagError(f"{bag.path}: no topic with the pose of a car; {what}{on_demand}")
    best = sources[0]
    others = [source.topic for source in sources[1:] if source.rank[0] < 2]
    note = f"pose: {best.topic} ({best.type} in frame {best.frame or '(unnamed)'})"
    return best, [note + (f", preferred to {', '.join(others)}" if others else "")]


def _canonical(topic):
    """Name of a source in the form of `_Source.topic`."""
    topic = "/" + topic.lstrip("/")
    if topic.startswith("/tf:"):
        frame = topic[4:].lstrip("/")
        return "/tf" if frame == "base_link" else f"/tf:{frame}"
    return topic


def _topic_sources(bag):
    """Topics that carry a pose, best first."""
    groups: dict[tuple, list[int]] = {}
    for number, connection in bag.connections.items():
        if bag.counts.get(number) and connection.md5sum in _POSE_DECODERS:
            groups.setdefault((connection.topic, connection.md5sum), []).append(number)
    frames = _first_frames(bag, groups)
    duration = max((bag.end_ns - bag.start_ns) * 1e-9, 1e-9)
    sources = []
    for (topic, md5sum), numbers in groups.items():
        count = sum(bag.counts[number] for number in numbers)
        frame = frames.get((topic, md5sum), "")
        doubt = 2 if "frenet" in topic.lower() else int(count < _SLOWEST_POSE * duration)
        if any(word in topic.lower() for word in _TRUTH):
            doubt = max(doubt, 1)
        rank = (doubt, _frame_rank(frame), _KINDS[md5sum], _name_rank(topic, _KNOWN_POSES))
        kind = bag.connections[numbers[0]].type
        sources.append(
            _Source(topic, kind, md5sum, frame, rank + (-count, topic), frozenset(numbers))
        )
    return sorted(sources, key=lambda source: source.rank)


def _first_frames(bag, groups):
    """Frame of the first message of each group of connections."""
    missing = {number: key for key, numbers in groups.items() for number in numbers}
    frames = {}
    for message in bag.messages(set(missing)) if missing else ():
        key = missing[message.connection]
        if key not in frames:
            with suppress(struct.error):
                frames[key] = msg.decode_header(message.data)[1]
            if len(frames) == len(groups):
                break
    return frames


def _tf_sources(bag):
    """Frames of tf: ``base_link`` is taken to be the car, others only on demand."""
    md5sum = msg.MD5[msg.TF]
    numbers = {number for number, c in bag.connections.items() if c.md5sum == md5sum}
    tree = TransformTree(bag.messages(numbers)) if numbers else None
    sources = []
    for child in tree.edges if tree else ():
        frame = tree.chain(child)[-1]
        base = child.rpartition("/")[2] == "base_link"
        topic = "/tf" if child == "base_link" else f"/tf:{child}"
        rank = (0 if base else 2, _frame_rank(frame), len(_KINDS), int(child != "base_link"))
        sources.append(
            _Source(topic, msg.TF, md5sum, frame, rank + (0, topic), tree=tree, child=child)
        )
    return sources


def _frame_rank(frame):
    return 0 if frame == "map" else 2 if frame.rpartition("/")[2] == "odom" else 1


def _name_rank(topic, known):
    return known.index(topic) if topic in known else len(known)


def _drive_connections(bag):
    """Topic of the drive command and its connections."""
    counts: dict[str, int] = {}
    for number, connection in bag.connections.items():
        if connection.md5sum == msg.MD5[msg.ACKERMANN] and bag.counts.get(number):
            counts[connection.topic] = counts.get(connection.topic, 0) + bag.counts[number]
    if not counts:
        return "", set()
    topic = min(counts, key=lambda name: (_name_rank(name, _KNOWN_DRIVES), -counts[name], name))
    md5sum = msg.MD5[msg.ACKERMANN]
    return topic, {
        number
        for number, connection in bag.connections.items()
        if connection.topic == topic and connection.md5sum == md5sum
    }


def _imu_topic(bag):
    """Topic of the IMU, or None."""
    topics = {
        connection.topic
        for number, connection in bag.connections.items()
        if connection.md5sum == msg.MD5[msg.IMU] and bag.counts.get(number)
    }
    return min(topics, key=lambda name: (_name_rank(name, _KNOWN_IMUS), name), default=None)


# -- waypoints -----------------------------------------------------------------------------------


def _waypoint_connections(bag, topic=None):
    """Topics of waypoint arrays by connection."""
    wanted = "/" + topic.lstrip("/") if topic else None
    return {
        number: connection.topic
        for number, connection in bag.connections.items()
        if connection.type.rpartition("/")[2] == "WpntArray"
        and (connection.topic == wanted if wanted else "local" not in connection.topic)
    }


def _waypoint_rank(topic):
    if topic == "/global_waypoints":
        return (0, topic)
    return (2 if "center" in topic else 1, topic)


def _collect_waypoints(collected, topic, connection, message, notes):
    """Keep the first waypoint array of a topic that is not empty."""
    if topic in collected:
        return
    try:
        if connection.md5sum == msg.MD5[msg.WAYPOINTS]:
            fields = msg.decode_waypoints(message.data)
        else:
            fields = _decode_by_definition(connection, message.data)
    except Exception as error:
        # rosbags raises errors of many kinds for a definition or a message that it cannot digest.
        notes.append(f"{topic}: cannot decode {connection.type} ({error})")
        return
    columns = {
        column: fields[field] for field, column in WAYPOINT_COLUMNS.items() if field in fields
    }
    if any(np.any(~(np.abs(column) < FARTHEST)) for column in columns.values()):
        notes.append(f"{topic}: waypoints with impossible values left out")
    elif len(columns.get("x", ())) and "y" in columns:
        collected[topic] = columns


def _decode_by_definition(connection, data):
    """Columns of a ``WpntArray`` of an unknown version, by the definition that the bag carries."""
    package, name = connection.type.split("/")
    name = f"{package}/msg/{name}"
    types = get_typestore(Stores.EMPTY)
    types.register(get_types_from_msg(connection.definition, name))
    waypoints = types.deserialize_ros1(data, name).wpnts
    return {
        field: np.array([float(getattr(waypoint, field)) for waypoint in waypoints])
        for field in WAYPOINT_COLUMNS
        if waypoints and hasattr(waypoints[0], field)
    }


def _read_paths(bag, topic, notes):
    """The longest path of each topic that has one of at least four poses."""
    wanted = "/" + topic.lstrip("/") if topic else None
    lines = {
        number: connection.topic
        for number, connection in bag.connections.items()
        if connection.md5sum == msg.MD5[msg.PATH]
        and (connection.topic == wanted if wanted else "local" not in connection.topic)
    }
    longest, paths = {}, {}
    for message in bag.messages(set(lines)) if lines else ():
        name = lines[message.connection]
        if len(message.data) > len(longest.get(name, b"")):
            longest[name] = bytes(message.data)
    for name, data in longest.items():
        try:
            columns = msg.decode_path(data)
        except struct.error as error:
            notes.append(f"{name}: cannot decode {msg.PATH} ({error})")
            continue
        if columns["x"].size >= 4:
            paths[name] = columns
    return paths


def _course_table(path, topic, columns, kind="WpntArray"):
    return CourseTable(
        columns, name=Path(path).stem, source=f"{path}: {topic}", layout=f"{kind} on {topic}"
    )
