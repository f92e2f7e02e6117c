"""Transforms in the plane, in plain Python.

tf2's buffer is compiled for one version of Python only.
"""

from __future__ import annotations

import math
import threading
from bisect import bisect_left, bisect_right
from collections import deque
from typing import Callable

import rospy
from geometry_msgs.msg import TransformStamped
from tf2_msgs.msg import TFMessage

from .conversions import frame, heading, stamp_ns, to_time

__all__ = ["TransformBroadcaster", "TransformListener", "TransformTree"]

KEPT_NS = 5 * 10**9  # length of a frame's history
# A transform this much older than the last one was sent after the clock was set back.
BACKWARDS_NS = 5 * 10**8


class _Edge:
    """Poses of a frame in its parent frame over the last seconds; a static one has no time."""

    def __init__(self, parent, static):
        self.parent, self.static = parent, static
        self.times, self.poses = deque(), deque()

    def add(self, stamp, pose):
        if self.static or (self.times and stamp < self.times[-1] - BACKWARDS_NS):
            self.times.clear()
            self.poses.clear()
        index = bisect_right(self.times, stamp)
        self.times.insert(index, stamp)
        self.poses.insert(index, pose)
        while self.times[0] < self.times[-1] - KEPT_NS:
            self.times.popleft()
            self.poses.popleft()

    def at(self, stamp):
        """Pose at a time, interpolated linearly; None outside the history."""
        if self.static:
            return self.poses[-1]
        index = bisect_left(self.times, stamp)
        if index == len(self.times):
            return None
        if self.times[index] == stamp:
            return self.poses[index]
        if index == 0:
            return None
        (x_1, y_1, psi_1), (x_2, y_2, psi_2) = self.poses[index - 1], self.poses[index]
        before, after = self.times[index - 1], self.times[index]
        part = (stamp - before) / (after - before)
        turn = math.remainder(psi_2 - psi_1, math.tau)
        return x_1 + part * (x_2 - x_1), y_1 + part * (y_2 - y_1), psi_1 + part * turn


class TransformTree:
    """Poses of frames in their parent frames over the last seconds, in the plane."""

    def __init__(self):
        self._edges = {}

    def add(self, parent: str, child: str, stamp: int, pose: tuple, static: bool = False) -> None:
        """Add the pose ``(x, y, psi)`` of `child` in `parent` at a time [ns]."""
        edge = self._edges.get(child)
        if edge is None or edge.parent != parent or edge.static != static:
            edge = self._edges[child] = _Edge(parent, static)
        edge.add(stamp, pose)

    def lookup(self, parent: str, child: str, stamp: int | None = None) -> tuple | None:
        """Pose of a frame in one of its ancestors.

        Parameters
        ----------
        parent, child : str
        stamp : int, optional
            Time [ns]; by default the latest at which all transforms in between are known.

        Returns
        -------
        (stamp, x, y, psi) or None
            None if the frames are not connected at that time. If all transforms are static the
            latest time is 0.
        """
        chain = []
        while child != parent:
            edge = self._edges.get(child)
            if edge is None or len(chain) > len(self._edges):
                return None
            chain.append(edge)
            child = edge.parent
        if stamp is None:
            stamp = min((edge.times[-1] for edge in chain if not edge.static), default=0)
        x = y = psi = 0.0
        for edge in chain:
            pose = edge.at(stamp)
            if pose is None:
                return None
            cos, sin = math.cos(pose[2]), math.sin(pose[2])
            x, y = pose[0] + cos * x - sin * y, pose[1] + sin * x + cos * y
            psi += pose[2]
        return stamp, x, y, math.remainder(psi, math.tau)


class TransformListener:
    """A `TransformTree` fed by ``/tf`` and ``/tf_static``.

    Parameters
    ----------
    on_change : callable, optional
        Called without arguments after each message of ``/tf``.
    """

    def __init__(self, on_change: Callable[[], None] | None = None):
        self._tree, self._on_change = TransformTree(), on_change
        self._lock = threading.Lock()
        self._subscribers = (
            rospy.Subscriber("/tf_static", TFMessage, self._receive, True, tcp_nodelay=True),
            rospy.Subscriber("/tf", TFMessage, self._receive, False, tcp_nodelay=True),
        )

    def lookup(self, parent: str, child: str, stamp: int | None = None) -> tuple | None:
        """As `TransformTree.lookup`."""
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
