"""Bags of any format, and bags that are parts of one run."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path
from typing import Iterator, Sequence, Union

from ..errors import BagError
from .bag import Bag, Message, time_span
from .records import BagFile
from .ros2 import MAGIC, METADATA, SUFFIXES, Ros2Bag

__all__ = ["Source", "is_bag", "open_bag", "source_name"]

Source = Union[str, Path, Sequence[Union[str, Path]]]
"""One bag, or the parts of one run."""

_ROS1 = b"#ROSBAG "
# A longer pause between two parts [ns] is a warning, a longer overlap an error, and so is a pause
# of an hour.
_PAUSE_NS, _OTHER_RUN_NS = 10**9, 3600 * 10**9


def is_bag(path: str | Path) -> bool:
    """Whether a path is a bag, by content or name.

    Parameters
    ----------
    path : str or pathlib.Path
        For ROS 2 also the folder, or its ``metadata.yaml``.

    Returns
    -------
    bool
    """
    path = Path(path)
    if path.is_dir():
        return (path / METADATA).is_file() or any(
            entry.name.endswith(SUFFIXES) for entry in path.iterdir()
        )
    named = path.name == METADATA or path.name.endswith((".bag", ".active", *SUFFIXES))
    return named or _begins_with(path, _ROS1, *MAGIC)


def _begins_with(path, *magic):
    if not path.is_file():  # opening a pipe would wait for a writer
        return False
    try:
        with path.open("rb") as file:
            return file.read(8).startswith(magic)
    except OSError:
        return False


def open_bag(source: Source) -> Bag:
    """Open a bag for reading.

    Parameters
    ----------
    source : str, pathlib.Path or sequence of them
        A ROS 1 bag, or the file or folder of a ROS 2 bag; several are joined in the order of time.

    Returns
    -------
    Bag
        Use it as a context manager.

    Raises
    ------
    BagError
        If a file cannot be read as a bag, or parts are of different runs.
    """
    if not isinstance(source, (str, Path)):
        return _JoinedBag(source) if len(source) > 1 else open_bag(source[0])
    path = Path(source)
    if path.name == METADATA:
        path = path.parent
    named = path.name.endswith(SUFFIXES) and not _begins_with(path, _ROS1)
    ros2 = path.is_dir() or named or _begins_with(path, *MAGIC)
    return Ros2Bag(path) if ros2 else BagFile(source)


def source_name(source: Source) -> str:
    """Name of a bag, or of the parts of a run, in messages and tables."""
    if isinstance(source, (str, Path)):
        return str(source)
    names = [str(path) for path in source]
    return names[0] if len(names) == 1 else f"{names[0]} ... {Path(names[-1]).name}"


class _JoinedBag(Bag):
    """Bags that a recorder split by size or time, as one.

    Parameters
    ----------
    paths : sequence of str or pathlib.Path
    """

    def __init__(self, paths):
        with ExitStack() as stack:
            self._bags = [stack.enter_context(open_bag(path)) for path in paths]
            self._bags.sort(key=lambda bag: bag.start_ns)
            super().__init__(source_name(paths))
            self._check()
            self._close = stack.pop_all()
        self._join()

    def close(self) -> None:
        """Close the files."""
        self._close.close()

    def _check(self):
        self._notes = []
        full = [bag for bag in self._bags if bag.end_ns]
        for before, after in zip(full, full[1:]):
            pause = after.start_ns - before.end_ns
            names = f"{before.path.name} and {after.path.name}"
            if pause < -_PAUSE_NS:
                raise BagError(f"{self.path}: {names} overlap by {-pause * 1e-9:.1f} s: two runs?")
            if pause > _OTHER_RUN_NS:
                raise BagError(f"{self.path}: {names} are {pause * 1e-9:.0f} s apart: two runs?")
            if pause > _PAUSE_NS:
                self._notes.append(f"warning: {pause * 1e-9:.1f} s missing between {names}")

    def _join(self):
        numbers, self._numbers = {}, []
        for bag in self._bags:
            known = sorted(bag.connections.items())
            own = {number: numbers.setdefault(c, len(numbers)) for number, c in known}
            self._numbers.append(own)
            for number, count in bag.counts.items():
                if number in own:
                    self.counts[own[number]] = self.counts.get(own[number], 0) + count
        self.connections = {number: connection for connection, number in numbers.items()}
        self.start_ns, self.end_ns = time_span((bag.start_ns, bag.end_ns) for bag in self._bags)

    def messages(self, wanted: set[int] | None = None) -> Iterator[Message]:
        """Complete messages of one part after the other."""
        for bag, own in zip(self._bags, self._numbers):
            keys = {key for key, number in own.items() if wanted is None or number in wanted}
            for message in bag.messages(keys) if keys else ():
                yield message._replace(connection=own[message.connection])

    def notes(self) -> list[str]:
        """What could not be read, part by part."""
        return self._notes + [
            f"{bag.path.name}: {note}" for bag in self._bags for note in bag.notes()
        ]
