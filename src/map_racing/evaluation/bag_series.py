"""Messages of a bag decoded into columns over time."""

from __future__ import annotations

import math
import struct
from array import array
from contextlib import suppress

import numpy as np

from ..angles import wrap
from .messages import decode_transforms
from .samples import in_order

__all__ = ["Series", "TransformTree"]

_BATCH = 2048


class Series:
    """Messages of one topic, decoded in batches, so that an hour at 100 Hz takes 23 MB.

    Parameters
    ----------
    decode : callable
        A decoder of `map_racing.evaluation.messages`.
    """

    def __init__(self, decode):
        self._decode = decode
        self._data, self._received = [], []
        self._stamps, self._values = [], []
        self._unstamped = self._broken = 0

    def add(self, message):
        """Take up a message."""
        self._data.append(message.data)
        self._received.append(message.time_ns)
        if len(self._data) == _BATCH:
            self._flush()

    def _flush(self):
        stamps, values, good = self._decode(self._data)
        unstamped = stamps == 0
        stamps = np.where(unstamped, np.array(self._received, dtype=np.int64), stamps)
        self._unstamped += np.count_nonzero(unstamped & good)
        self._broken += np.count_nonzero(~good)
        self._stamps.append(stamps[good])
        self._values.append(values[good])
        self._data, self._received = [], []

    def columns(self, notes, topic, required=0):
        """Samples in strict order of time.

        Parameters
        ----------
        notes : list of str
            Gets a line for each kind of repair.
        topic : str
            What to call the samples in the notes.
        required : int, optional
            So many first columns are coordinates, see `in_order`.

        Returns
        -------
        times : ndarray of int64
            Header stamps or, where they are 0, times of receipt [ns].
        columns : list of ndarray
        """
        self._flush()
        times, values = np.concatenate(self._stamps), np.concatenate(self._values)
        if self._broken:
            notes.append(f"{topic}: {self._broken} messages that are not of their type left out")
        if self._unstamped:
            notes.append(f"{topic}: {self._unstamped} of {times.size} stamps are 0: receive time")
        columns = [np.ascontiguousarray(column) for column in values.T]
        return in_order(times, columns, notes, topic, required)


class _Edge:
    """Poses of a frame in its parent frame over time."""

    def __init__(self, parent):
        self.parent = parent
        self.times, self.values = array("q"), array("d")

    def columns(self):
        times = np.array(self.times, dtype=np.int64)
        return in_order(times, list(np.array(self.values).reshape(-1, 3).T), [], "")


class TransformTree:
    """Transforms of tf in the plane.

    Parameters
    ----------
    messages : iterable of Message
        Those of ``/tf`` and ``/tf_static``.

    Attributes
    ----------
    edges : dict of str to object
        The frames that have a parent.
    """

    def __init__(self, messages):
        self.edges = {}
        for message in messages:
            with suppress(struct.error):
                for transform in decode_transforms(message.data):
                    edge = self.edges.get(transform.child)
                    if edge is None or edge.parent != transform.parent:
                        edge = self.edges[transform.child] = _Edge(transform.parent)
                    edge.times.append(transform.stamp_ns or message.time_ns)
                    edge.values.extend(transform[3:])

    def chain(self, child):
        """Frames from ``child`` up to ``map``, or to the root of the tree."""
        frames = [child]
        while frames[-1] != "map" and frames[-1] in self.edges:
            parent = self.edges[frames[-1]].parent
            if parent in frames:
                break
            frames.append(parent)
        return frames

    def columns(self, child, notes, topic):
        """Poses of ``child`` in the last frame of its chain, as `Series.columns` of poses.

        Their times are those of the edge that is sent most often; the others are interpolated.
        """
        edges = [self.edges[frame] for frame in self.chain(child)[:-1]]
        times = max(edges, key=lambda edge: len(edge.times)).columns()[0]
        x, y, psi = np.zeros((3, times.size))
        for edge in edges:
            own, columns = edge.columns()
            columns[2] = np.unwrap(columns[2])
            # Differences of nanoseconds fit into a float; nanoseconds since 1970 do not.
            since, known = (times - times[0]) * 1e-9, (own - times[0]) * 1e-9
            e_x, e_y, e_psi = (np.interp(since, known, column) for column in columns)
            cos, sin = np.cos(e_psi), np.sin(e_psi)
            x, y, psi = e_x + cos * x - sin * y, e_y + sin * x + cos * y, psi + e_psi
        nan = np.full(times.size, math.nan)
        return in_order(times, [x, y, wrap(psi), nan, nan, nan], notes, topic, required=2)
