"""What every bag offers, whatever its format."""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import Iterator, NamedTuple

__all__ = ["Bag", "Connection", "Message", "time_span"]


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

    @abstractmethod
    def notes(self) -> list[str]:
        """What `messages` could not read; empty for an intact bag."""


def time_span(spans) -> tuple[int, int]:
    """First and last time [ns] of (first, last) pairs, ignoring empty ones; 0 without any."""
    known = [span for span in spans if span[1]]
    return (min(s for s, _ in known), max(e for _, e in known)) if known else (0, 0)
