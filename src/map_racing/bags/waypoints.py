"""Waypoints that a bag carries."""

from __future__ import annotations

import struct
from typing import Iterable

import numpy as np

from ..errors import BagError
from ..validation import FARTHEST
from . import messages as msg
from .bag import Bag, Message
from .opening import Source, open_bag, source_name
from .samples import Waypoints

__all__ = ["WaypointCollection", "read_waypoints"]

# The lateral deviation of a raceline from itself is meaningless and may have any value.
_FIELDS = tuple(field for field in msg.WAYPOINT_FIELDS if field != "d_m")


def read_waypoints(source: Source, topic: str | None = None) -> Waypoints:
    """Read the first waypoint array (``f110_msgs/WpntArray``) of a bag, or its longest path.

    Parameters
    ----------
    source : str, pathlib.Path or sequence of them
        See `map_racing.bags.opening.open_bag`.
    topic : str, optional
        By default ``/global_waypoints``, then other topics of waypoint arrays, then of
        ``nav_msgs/Path``; never local waypoints or paths, which cover only a part of the track.

    Returns
    -------
    Waypoints

    Raises
    ------
    BagError
        If the bag has no waypoints, or none on `topic`.
    """
    with open_bag(source) as bag:
        arrays = WaypointCollection(bag, topic)
        first = min(arrays.connections.values(), key=_rank, default=None)
        for message in bag.messages(set(arrays.connections)):
            arrays.extend([message])
            if first in arrays.columns:
                break
        waypoints, notes = arrays.best(), arrays.notes
        paths = {} if waypoints else _read_paths(bag, topic, notes)
    if waypoints:
        return waypoints
    if paths:
        name = min(paths, key=lambda name: (_rank(name), -len(paths[name]["x_m"])))
        return Waypoints(name, "Path", paths[name])
    asked = f" on {topic}" if topic else ""
    why = f": {notes[0]}" if notes else ""
    raise BagError(
        f"{source_name(source)}: no raceline (f110_msgs/WpntArray with waypoints, nav_msgs/Path)"
        f"{asked}{why}"
    )


class WaypointCollection:
    """The first non-empty waypoint array on each topic of a bag, and others that follow it.

    Arrays of unknown versions are decoded by the definition that the bag carries.

    Parameters
    ----------
    bag : Bag
    topic : str, optional
        By default all topics except local waypoints.

    Attributes
    ----------
    connections : dict of int to str
        Topics of waypoint arrays by connection.
    columns : dict of str to dict
        Columns of the first waypoints by topic.
    later : dict of str to list of (int, dict)
        Times of receipt [ns] and columns of different waypoints that came later, by topic.
    frames : dict of str to str
        Frames of these waypoints by topic.
    notes : list of str
        What could not be read.
    """

    def __init__(self, bag: Bag, topic: str | None = None):
        self._bag = bag
        self.connections = _connections(
            bag, topic, lambda connection: connection.type.rpartition("/")[2] == "WpntArray"
        )
        self.columns: dict[str, dict] = {}
        self.later: dict[str, list[tuple[int, dict]]] = {}
        self.frames: dict[str, str] = {}
        self.notes: list[str] = []
        self._bodies: dict[str, bytes] = {}

    def extend(self, messages: Iterable[Message]) -> None:
        """Add messages of the `connections`."""
        for message in messages:
            self._add(message)

    def _add(self, message):
        topic = self.connections[message.connection]
        body = message.data[12:]  # after sequence number and stamp
        if self._bodies.get(topic) == body:
            return
        self._bodies[topic] = body
        connection = self._bag.connections[message.connection]
        try:
            if connection.md5sum == msg.MD5[msg.WAYPOINTS]:
                fields = msg.decode_waypoints(message.data)
            else:
                fields = _decode_by_definition(connection, message.data)
        except Exception as error:
            # rosbags raises many kinds of errors for invalid definitions and messages.
            self._say(f"{topic}: cannot decode {connection.type} ({error})")
            return
        columns = {field: fields[field] for field in _FIELDS if field in fields}
        if any(np.any(~(np.abs(column) < FARTHEST)) for column in columns.values()):
            self._say(f"{topic}: waypoints with impossible values left out")
        elif len(columns.get("x_m", ())) and "y_m" in columns:
            if topic not in self.columns:
                self.columns[topic] = columns
                self.frames[topic] = msg.decode_header(message.data)[1]
            else:
                self.later.setdefault(topic, []).append((message.time_ns, columns))

    def _say(self, note):
        if note not in self.notes:
            self.notes.append(note)

    def best(self) -> Waypoints | None:
        """Waypoints of the preferred topic, or None."""
        topic = min(self.columns, key=_rank, default=None)
        return None if topic is None else Waypoints(topic, "WpntArray", self.columns[topic])


def _connections(bag, topic, accept):
    """Accepted connections by number: on the given topic or, without one, on any not local."""
    wanted = "/" + topic.lstrip("/") if topic else None
    return {
        number: connection.topic
        for number, connection in bag.connections.items()
        if accept(connection)
        and (connection.topic == wanted if wanted else "local" not in connection.topic)
    }


def _rank(topic):
    if topic == "/global_waypoints":
        return (0, topic)
    return (2 if "center" in topic else 1, topic)


def _decode_by_definition(connection, data):
    """Columns of a ``WpntArray`` of an unknown version, by its definition in the bag."""
    # Rarely needed, and slow to import.
    from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

    package, name = connection.type.split("/")
    name = f"{package}/msg/{name}"
    types = get_typestore(Stores.EMPTY)
    idl = "module " in connection.definition
    text = (connection.definition,) if idl else (connection.definition, name)
    types.register((get_types_from_idl if idl else get_types_from_msg)(*text))
    deserialize = types.deserialize_cdr if connection.cdr else types.deserialize_ros1
    waypoints = deserialize(data, name).wpnts
    return {
        field: np.array([float(getattr(waypoint, field)) for waypoint in waypoints])
        for field in _FIELDS
        if waypoints and hasattr(waypoints[0], field)
    }


def _read_paths(bag, topic, notes):
    """The longest path of each topic that has one of at least four poses."""
    lines = _connections(bag, topic, lambda connection: connection.md5sum == msg.MD5[msg.PATH])
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
