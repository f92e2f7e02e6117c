"""Read from ROS 1 bags what was driven, further signals, and waypoints.

Waypoint arrays of unknown versions are decoded by the definition that the bag itself carries.
"""

from __future__ import annotations

import struct
from functools import partial

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from ..errors import BagError
from ..validation import FARTHEST
from . import messages as msg
from .records import BagFile
from .samples import Commands, Recording, Waypoints
from .series import Series
from .topics import POSE_DECODERS, choose_source, drive_connections, imu_topic

__all__ = ["read_recording", "read_signals", "read_waypoints"]

# What can be read over time: decoder, and the names of its last columns.
_SIGNALS = {
    msg.MD5[msg.ODOMETRY]: (msg.decode_odometry, ("v_x", "v_y", "yaw_rate")),
    msg.MD5[msg.IMU]: (msg.decode_imu, ("yaw_rate", "a_x", "a_y", "a_z")),
    msg.MD5[msg.ACKERMANN]: (msg.decode_drive, ("steering", "speed")),
    msg.MD5[msg.FLOAT64]: (msg.decode_float64, ("value",)),
}
# The lateral deviation of a raceline from itself says nothing, and may be anything.
_WAYPOINT_FIELDS = tuple(field for field in msg.WAYPOINT_FIELDS if field != "d_m")


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
        source, notes = choose_source(bag, pose_topic)
        drive_topic, drives = drive_connections(bag)
        lines = _waypoint_connections(bag)
        pose = Series(POSE_DECODERS.get(source.md5sum))
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
    return Recording(
        (times - t0_ns) * 1e-9,
        *columns,
        t0_ns=t0_ns,
        source=str(path),
        topic=source.topic,
        type=source.type,
        frame=source.frame,
        commands=commands,
        waypoints=_best(waypoints),
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
            wanted = "/" + topic.lstrip("/") if topic else imu_topic(bag)
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


def read_waypoints(path, topic=None):
    """Waypoints that a bag carries as ``f110_msgs/WpntArray``, or else as ``nav_msgs/Path``.

    It is the first array that has waypoints, or the longest path.

    Parameters
    ----------
    path : str or pathlib.Path
    topic : str, optional
        Without it ``/global_waypoints`` is preferred, then other topics of waypoint arrays, then
        paths; local waypoints and paths, which are only a stretch of the track, are never chosen.

    Returns
    -------
    Waypoints

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
            return _best(waypoints)
        paths = _read_paths(bag, topic, notes)
    if paths:
        name = min(paths, key=lambda name: (_waypoint_rank(name), -len(paths[name]["x_m"])))
        return Waypoints(name, "Path", paths[name])
    asked = f" on {topic}" if topic else ""
    why = f": {notes[0]}" if notes else ""
    raise BagError(
        f"{path}: no raceline (f110_msgs/WpntArray with waypoints, nav_msgs/Path){asked}{why}"
    )


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
    columns = {field: fields[field] for field in _WAYPOINT_FIELDS if field in fields}
    if any(np.any(~(np.abs(column) < FARTHEST)) for column in columns.values()):
        notes.append(f"{topic}: waypoints with impossible values left out")
    elif len(columns.get("x_m", ())) and "y_m" in columns:
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
        for field in _WAYPOINT_FIELDS
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
        if columns["x_m"].size >= 4:
            paths[name] = columns
    return paths


def _best(waypoints):
    """Waypoints of the topic that is preferred, or None."""
    topic = min(waypoints, key=_waypoint_rank, default=None)
    return None if topic is None else Waypoints(topic, "WpntArray", waypoints[topic])
