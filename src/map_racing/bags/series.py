"""Messages of a bag decoded into columns over time."""

from __future__ import annotations

import math
import struct
from array import array
from typing import Callable, Iterable, NamedTuple

import numpy as np

from ..angles import wrap
from .messages import decode_transforms
from .records import Message
from .samples import in_order, jump_back, usable

__all__ = ["FramePoses", "Series", "RecordedTransforms"]

_BATCH = 2048


class Series:
    """Messages of one topic, decoded in batches, so that an hour at 100 Hz takes 26 MB.

    Parameters
    ----------
    decode : callable
        A decoder of `map_racing.bags.messages`.
    coordinates : int, optional
        The first columns that are required coordinates, see `in_order`.
    """

    def __init__(self, decode: Callable, coordinates: int = 0):
        self._decode, self._coordinates = decode, coordinates
        self._data, self._received = [], []
        self._stamps, self._times, self._values = [], [], []
        self._unstamped = self._broken = 0

    def add(self, message: Message) -> None:
        """Add a message."""
        self._data.append(message.data)
        self._received.append(message.time_ns)
        if len(self._data) == _BATCH:
            self._flush()

    def _flush(self):
        stamps, values, good = self._decode(self._data)
        unstamped = stamps == 0
        received = np.array(self._received, dtype=np.int64)
        stamps = np.where(unstamped, received, stamps)
        self._unstamped += np.count_nonzero(unstamped & good)
        self._broken += np.count_nonzero(~good)
        self._stamps.append(stamps[good])
        self._times.append(received[good])
        self._values.append(values[good])
        self._data, self._received = [], []

    @property
    def size(self) -> int:
        """Number of messages."""
        return len(self._data) + sum(times.size for times in self._times)

    def jump_back(self, received: bool = False) -> float | None:
        """How far the stamps or times of receipt fall back [s]; None if they do not.

        Samples that `columns` leaves out do not count.
        """
        self._flush()
        times, values = self._samples(received)
        found = jump_back(times[usable(times, values.T[: self._coordinates])], 10**9)
        return found and found[1]

    def _samples(self, received):
        times = np.concatenate(self._times if received else self._stamps)
        return times, np.concatenate(self._values)

    def columns(
        self, notes: list[str], topic: str, received: bool = False
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """Samples in strict order of time.

        Parameters
        ----------
        notes : list of str
            Gets a line for each kind of repair.
        topic : str
            Name of the samples in the notes.
        received : bool, optional
            Take the times of receipt instead of the stamps.

        Returns
        -------
        times : ndarray of int64
            Header stamps or, where they are 0, times of receipt [ns].
        columns : list of ndarray
        """
        self._flush()
        times, values = self._samples(received)
        if self._broken:
            notes.append(f"{topic}: {self._broken} messages that are not of their type left out")
        if self._unstamped and not received:
            notes.append(f"{topic}: {self._unstamped} of {times.size} stamps are 0: receive time")
        columns = [np.ascontiguousarray(column) for column in values.T]
        return in_order(times, columns, notes, topic, self._coordinates)


class _RecordedEdge:
    """Poses of a frame in its parent frame over time."""

    def __init__(self, parent):
        self.parent = parent
        self.stamps, self.times, self.values = array("q"), array("q"), array("d")

    def _samples(self, received):
        times = np.array(self.times if received else self.stamps, dtype=np.int64)
        return times, list(np.array(self.values).reshape(-1, 3).T)

    def jump_back(self, received):
        times, columns = self._samples(received)
        keep = usable(times, columns)
        if all(np.ptp(column[keep]) == 0.0 for column in columns if keep.any()):
            # A constant transform holds at any time; static ones are sent at random times.
            return None
        found = jump_back(times[keep], 10**9)
        return found and found[1]

    def columns(self, notes, what, received):
        times, columns = self._samples(received)
        return in_order(times, columns, notes, what, required=3)


class RecordedTransforms:
    """Transforms of tf in the plane.

    Parameters
    ----------
    messages : iterable of Message
        From ``/tf`` and ``/tf_static``.

    Attributes
    ----------
    edges : dict of str to object
        Frames that have a parent.
    """

    def __init__(self, messages: Iterable[Message]):
        self.edges = {}
        self._broken = 0
        for message in messages:
            try:
                for transform in decode_transforms(message.data):
                    edge = self.edges.get(transform.child)
                    if edge is None or edge.parent != transform.parent:
                        edge = self.edges[transform.child] = _RecordedEdge(transform.parent)
                    edge.stamps.append(transform.stamp_ns or message.time_ns)
                    edge.times.append(message.time_ns)
                    edge.values.extend(transform[3:])
            except struct.error:
                self._broken += 1

    def chain(self, child: str) -> list[str]:
        """Frames from ``child`` up to ``map``, or to the root of the tree."""
        frames = [child]
        while frames[-1] != "map" and frames[-1] in self.edges:
            parent = self.edges[frames[-1]].parent
            if parent in frames:
                break
            frames.append(parent)
        return frames

    def jump_back(self, child: str, received: bool = False) -> float | None:
        """How far the times of the chain of ``child`` fall back [s]; None if they do not."""
        jumps = (self.edges[frame].jump_back(received) for frame in self.chain(child)[:-1])
        return next((jump for jump in jumps if jump), None)

    def columns(
        self, child: str, notes: list[str], topic: str, received: bool = False
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """Poses of ``child`` in the last frame of its chain, as from `Series.columns`.

        They have the times of the edge that is sent most often; the others are interpolated.
        """
        if self._broken:
            notes.append(f"{topic}: {self._broken} messages that are not of their type left out")
        edges = [
            self.edges[frame].columns(
                notes, f"{topic}: {self.edges[frame].parent} to {frame}", received
            )
            for frame in self.chain(child)[:-1]
        ]
        nan = np.full(0, math.nan)
        if not all(own.size for own, _ in edges):
            return np.zeros(0, dtype=np.int64), [nan] * 6
        times = max((own for own, _ in edges), key=len)
        x, y, psi = np.zeros((3, times.size))
        for own, columns in edges:
            columns[2] = np.unwrap(columns[2])
            # Differences of nanoseconds fit into a float; nanoseconds since 1970 do not.
            since, known = (times - times[0]) * 1e-9, (own - times[0]) * 1e-9
            e_x, e_y, e_psi = (np.interp(since, known, column) for column in columns)
            cos, sin = np.cos(e_psi), np.sin(e_psi)
            x, y, psi = e_x + cos * x - sin * y, e_y + sin * x + cos * y, psi + e_psi
        nan = np.full(times.size, math.nan)
        return in_order(times, [x, y, wrap(psi), nan, nan, nan], notes, topic, required=2)


class FramePoses(NamedTuple):
    """Poses of a frame of a tree, with the methods of a `Series` of poses."""

    tree: RecordedTransforms
    child: str

    def jump_back(self, received: bool = False) -> float | None:
        """How far the times fall back [s]; None if they do not."""
        return self.tree.jump_back(self.child, received)

    def columns(
        self, notes: list[str], topic: str, received: bool = False
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """Poses in strict order of time."""
        return self.tree.columns(self.child, notes, topic, received)
