"""Transforms in the plane from and to ``/tf`` and ``/tf_static``, in plain Python.

They avoid tf2's buffer, which is compiled for one version of Python only.
"""

from __future__ import annotations

import math
import threading
from typing import Callable

import rospy
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

from ..transforms import TransformTree
from .conversions import frame, heading, stamp_ns, to_time

__all__ = ["TransformBroadcaster", "TransformListener"]

KEPT_NS = 5 * 10**9  # length of a frame's history


class TransformListener:
    """A `map_racing.transforms.TransformTree` fed by ``/tf`` and ``/tf_static``.

    Parameters
    ----------
    on_change : callable, optional
        Called without arguments after each message of ``/tf``.
    """

    def __init__(self, on_change: Callable[[], None] | None = None):
        self._tree, self._on_change = TransformTree(KEPT_NS), on_change
        self._lock = threading.Lock()
        self._subscribers = (
            rospy.Subscriber("/tf_static", TFMessage, self._receive, True, tcp_nodelay=True),
            rospy.Subscriber("/tf", TFMessage, self._receive, False, tcp_nodelay=True),
        )

    def lookup(self, parent: str, child: str, stamp: int | None = None) -> tuple | None:
        """As `map_racing.transforms.TransformTree.lookup`."""
        with self._lock:
            return self._tree.lookup(parent, child, stamp)

    def _receive(self, message, static):
        now = rospy.Time.now().to_nsec()
        with self._lock:
            for transform in message.transforms:
                at, rotation = transform.transform.translation, transform.transform.rotation
                pose = at.x, at.y, heading(rotation)
                parent = frame(transform.header.frame_id)
                stamp = stamp_ns(transform.header, now)
                self._tree.add(parent, frame(transform.child_frame_id), stamp, pose, static)
        if self._on_change is not None and not static:
            self._on_change()


class TransformBroadcaster:
    """Sends transforms in the plane on ``/tf``, or latched on ``/tf_static``."""

    def __init__(self, static: bool = False):
        topic = "/tf_static" if static else "/tf"
        self._publisher = rospy.Publisher(topic, TFMessage, queue_size=10, latch=static)

    def send(self, parent: str, child: str, stamp: int, x: float, y: float, psi: float) -> None:
        """Send the pose of `child` in `parent` [m, m, rad] at a time [ns]."""
        transform = TransformStamped()
        transform.header.stamp = to_time(stamp)
        transform.header.frame_id, transform.child_frame_id = parent, child
        transform.transform.translation.x, transform.transform.translation.y = x, y
        transform.transform.rotation.z = math.sin(0.5 * psi)
        transform.transform.rotation.w = math.cos(0.5 * psi)
        self._publisher.publish(TFMessage([transform]))
