"""What every bag offers, whatever its format."""

from __future__ import annotations

from abc import ABC, abstractmethod
from itertools import islice
from pathlib import Path
from typing import Iterator, NamedTuple

import numpy as np

__all__ = ["Bag", "Batch", "Connection", "Message", "batched", "time_span"]


class Connection(NamedTuple):
    """A publisher on a topic, with type and definition of its messages.

    The topic begins with a slash; the type is written as in ROS 1, ``nav_msgs/Odometry``. The
    sender is empty if the bag does not name it. ``sum`` is the md5 sum of the ROS 1 message with
    the same layout, or empty. With ``cdr``, messages are serialized as in ROS 2. A latching
    publisher sends its last message to later subscribers.
    """

    topic: str
    type: str
    md5sum: str
    definition: str
    sender: str = ""
    cdr: bool = False
    latching: bool = False


class Message(NamedTuple):
    """A message of a connection, serialized as by ROS 1, received at ``time_ns``."""

    connection: int
    time_ns: int
    data: bytes


class Batch:
    """Messages, many at once; iterating gives them one by one.

    Parameters
    ----------
    buffer : bytes
        Where they are.
    starts, stops : ndarray of int, shape (n,)
        Where each begins and ends.
    numbers, times : ndarray of int, shape (n,)
        Connection, and time of receipt [ns], of each.
    """

    def __init__(self, buffer, starts, stops, numbers, times):
        self._buffer, self._starts, self._stops = buffer, starts, stops
        self.numbers, self.times = numbers, times

    @classmethod
    def of(cls, groups: list[tuple], times: np.ndarray) -> Batch:
        """From the messages of several connections.

        Parameters
        ----------
        groups : list of (int, ndarray of int, ndarray or list of bytes)
            Of each connection its number, the places of its messages in the batch, and the
            messages as in `contents`.
        times : ndarray of int, shape (n,)
        """
        numbers, starts, stops = (np.empty(times.size, dtype=np.int64) for _ in range(3))
        parts, end = [], 0
        for number, where, contents in groups:
            numbers[where] = number
            if isinstance(contents, np.ndarray):
                sizes = np.full(len(contents), contents.shape[1])
                parts.append(contents)
            else:
                sizes = np.fromiter(map(len, contents), np.int64, len(contents))
                parts += contents
            ends = end + np.cumsum(sizes)
            starts[where], stops[where], end = ends - sizes, ends, ends[-1]
        return cls(b"".join(parts), starts, stops, numbers, times)

    def __len__(self):
        return len(self.numbers)

    def __iter__(self):
        numbers, times = self.numbers.tolist(), self.times.tolist()
        return map(Message, numbers, times, self._data())

    def _data(self):
        places = zip(self._starts.tolist(), self._stops.tolist())
        return [self._buffer[start:stop] for start, stop in places]

    def only(self, chosen: np.ndarray) -> Batch:
        """Those of a mask."""
        columns = self._starts, self._stops, self.numbers, self.times
        return Batch(self._buffer, *(column[chosen] for column in columns))

    def contents(self) -> np.ndarray | list[bytes]:
        """The messages: rows of bytes, shape (n, size), if all have one size, which is faster."""
        sizes = self._stops - self._starts
        size = int(sizes[0]) if len(self) else 0
        if not size or np.any(sizes != size):
            return self._data()
        anywhere = len(self._buffer) - size + 1
        places = np.ndarray(anywhere, np.dtype((np.void, size)), self._buffer, strides=1)
        return places[self._starts].view(np.uint8).reshape(-1, size)


def batched(messages: Iterator[Message]) -> Iterator[Batch]:
    """Batches of up to 2048 messages."""
    for batch in iter(lambda: list(islice(messages, 2048)), []):
        numbers, times, data = zip(*batch)
        stops = np.cumsum(np.fromiter(map(len, data), np.int64, len(data)))
        starts = np.append(0, stops[:-1])
        yield Batch(b"".join(data), starts, stops, np.array(numbers), np.array(times))


class Bag(ABC):
    """A bag open for reading; use it as a context manager.

    Attributes
    ----------
    path : pathlib.Path
        File or folder.
    connections : dict of int to Connection
        Connections that the bag declares.
    counts : dict of int to int
        Number of messages of each connection, from the index or, without one, as found.
    start_ns, end_ns : int
        Receive times of the first and last message [ns]; 0 in a bag without messages.
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        self.connections: dict[int, Connection] = {}
        self.counts: dict[int, int] = {}
        self.start_ns = self.end_ns = 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    @abstractmethod
    def close(self) -> None:
        """Close the files."""

    @abstractmethod
    def messages(self, wanted: set[int] | None = None) -> Iterator[Message]:
        """Complete messages in the order of the file.

        Parameters
        ----------
        wanted : set of int, optional
            Identifiers of the connections to yield; all by default.
        """

    def batches(self, wanted: set[int]) -> Iterator[Batch]:
        """As `messages`, many at once, which takes a fraction of the time."""
        return batched(self.messages(wanted))

    @abstractmethod
    def notes(self) -> list[str]:
        """What `messages` could not read; empty for an intact bag."""


def time_span(spans) -> tuple[int, int]:
    """First and last time [ns] of (first, last) pairs, ignoring empty ones; 0 without any."""
    known = [span for span in spans if span[1]]
    return (min(s for s, _ in known), max(e for _, e in known)) if known else (0, 0)
