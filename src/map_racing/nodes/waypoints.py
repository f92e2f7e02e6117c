"""Racelines as ``f110_msgs/WpntArray``, without needing that package.

A ROS 1 publisher sends the definition of its messages when it connects.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Callable

import rosgraph
import rospy
from genpy.dynamic import generate_dynamic
from std_msgs.msg import Header

from ..bags import messages
from ..errors import MapRacingError, RacelineError
from ..track.files.columns import columns_of_waypoints
from ..track.files.readers import raceline_from_columns
from .node import get_parameter

if TYPE_CHECKING:
    from ..track.raceline import Raceline

__all__ = [
    "RacelineSubscriber",
    "raceline_from_message",
    "waypoint_array_class",
    "waypoint_messages",
]

_LINE = "=" * 80 + "\n"
_classes = {}


def _generated(kind, md5sum, definition):
    """Message class of a definition, cached because each one creates a temporary module."""
    key = kind, md5sum
    if key not in _classes:
        _classes[key] = generate_dynamic(kind, definition)
    return _classes[key]


def waypoint_array_class() -> tuple:
    """Message classes of a raceline.

    Returns
    -------
    array : class
        ``f110_msgs/WpntArray`` with `header` and `wpnts`.
    waypoint : class
        ``f110_msgs/Wpnt``.
    """
    definition = (
        messages.DEFINITIONS["f110_msgs/msg/WpntArray"]
        + f"\n{_LINE}MSG: std_msgs/Header\n{Header._full_text}"
        + f"\n{_LINE}MSG: f110_msgs/Wpnt\n{messages.DEFINITIONS['f110_msgs/msg/Wpnt']}"
    )
    kinds = _generated(messages.WAYPOINTS, messages.MD5[messages.WAYPOINTS], definition)
    return kinds[messages.WAYPOINTS], kinds["f110_msgs/Wpnt"]


def waypoint_messages(rows):
    """Waypoints as messages.

    Parameters
    ----------
    rows : structured array
        From `map_racing.track.files.waypoints.waypoint_rows`.

    Returns
    -------
    list of f110_msgs/Wpnt
    """
    waypoint = waypoint_array_class()[1]
    rows = rows[waypoint.__slots__[1:]].tolist()
    return [waypoint(number, *row) for number, row in enumerate(rows)]


def raceline_from_message(message: rospy.AnyMsg, source: str) -> Raceline:
    """Raceline of a ``WpntArray`` of any version, received as ``rospy.AnyMsg``.

    Parameters
    ----------
    message : rospy.AnyMsg
    source : str
        Topic, for error messages.

    Returns
    -------
    Raceline

    Raises
    ------
    RacelineError
        If it is another message, or its waypoints do not form a closed track.
    """
    connection = message._connection_header
    kind = connection["type"]
    if kind.rpartition("/")[2] != "WpntArray":
        raise RacelineError(f"{source}: expected f110_msgs/WpntArray, got {kind}")
    md5sum = connection["md5sum"]
    try:
        if md5sum == messages.MD5[messages.WAYPOINTS]:
            fields = messages.decode_waypoints(message._buff)
        else:
            array = _generated(kind, md5sum, connection["message_definition"])[kind]()
            array.deserialize(message._buff)
            fields = {
                field: [float(getattr(waypoint, field)) for waypoint in array.wpnts]
                for field in messages.WAYPOINT_FIELDS
                if array.wpnts and hasattr(array.wpnts[0], field)
            }
    except Exception as error:
        # genpy raises errors of any kind if it cannot parse a definition or message.
        raise RacelineError(f"{source}: cannot read {kind}: {error}") from error
    columns = columns_of_waypoints(fields)
    if "x" not in columns or "y" not in columns or not len(columns["x"]):
        raise RacelineError(f"{source}: expected waypoints with x_m and y_m, got none")
    return raceline_from_columns(columns, name=source.rpartition("/")[2], source=source)


def _warn(error):
    rospy.logwarn("%s", error)


class RacelineSubscriber:
    """Receives racelines from the topic ``global_waypoints``; repetitions are ignored.

    Only one node's racelines are used, because those of two nodes would alternate. The parameter
    ``~waypoints_from`` names that node; by default it is the first one, as long as it publishes.

    Parameters
    ----------
    on_raceline : callable
        Called with each new Raceline.
    on_error : callable, optional
        Called with the RacelineError of an invalid message, once per content; logs it by default.
    """

    def __init__(self, on_raceline: Callable, on_error: Callable = _warn):
        self._on_raceline, self._on_error = on_raceline, on_error
        sender = get_parameter("waypoints_from", "", "node to take racelines from; empty: first")
        self._only = rospy.resolve_name(sender) if sender else ""
        self._content = self._sender = None
        self._subscriber = rospy.Subscriber(
            "global_waypoints", rospy.AnyMsg, self._receive, queue_size=100
        )

    def _receive(self, message):
        try:
            body = message._buff[messages.decode_header(message._buff)[2] :]
        except Exception:
            body = message._buff
        content = message._connection_header["md5sum"], body
        if content == self._content or not self._counts(message._connection_header["callerid"]):
            return
        self._content = content
        try:
            raceline = raceline_from_message(message, self._subscriber.resolved_name)
        except MapRacingError as error:
            self._on_error(error)
        else:
            self._on_raceline(raceline)

    def _counts(self, sender):
        """Whether a node's racelines are used."""
        holder = self._only or self._sender
        topic = self._subscriber.resolved_name
        if sender != holder and holder and (self._only or self._publishes(holder)):
            rospy.logerr_throttle(
                10.0,
                f"{topic}: {sender} publishes another raceline than {holder}, which is kept",
            )
            return False
        self._sender = sender
        return True

    def _publishes(self, node):
        try:
            publishing = dict(rosgraph.Master(rospy.get_name()).getSystemState()[0])
        except Exception:  # the master does not answer: nothing changes
            return True
        return node in publishing.get(self._subscriber.resolved_name, ())
