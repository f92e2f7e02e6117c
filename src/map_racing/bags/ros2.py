"""Bags of ROS 2: sqlite3 and MCAP, split, compressed by file or by message.

Records are read without rosbags: its general reader takes longer than reading, decoding and
evaluating the same run from a ROS 1 bag, and gives up on an unclosed file. From an unclosed or
damaged file every complete message is read, with notes on what is missing.

Formats: https://github.com/ros2/rosbag2, https://mcap.dev/spec
"""

from __future__ import annotations

import re
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Iterator

import numpy as np
import yaml

from ..errors import BagError
from .bag import Bag, Batch, Message, batched, time_span
from .cdr import Layout, connection_of
from .compression import ZSTD_MAGIC, decompress_message, zstd_decompressor
from .storage import MCAP_MAGIC, SQLITE_ERRORS, SQLITE_MAGIC, McapFile, SqliteFile

__all__ = ["MAGIC", "METADATA", "SUFFIXES", "Ros2Bag"]

METADATA = "metadata.yaml"
SUFFIXES = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")

MAGIC = (SQLITE_MAGIC[:8], MCAP_MAGIC)
"""First bytes of the files, to recognize them whatever their name."""

_BLOCK = 1 << 20
_TIMES_END = 1 << 63  # a time that int64 cannot hold is damage [ns]


class Ros2Bag(Bag):
    """A bag of ROS 2 open for reading, with messages in the layout of ROS 1.

    Parameters
    ----------
    path : str or pathlib.Path
        Folder or file.

    Raises
    ------
    BagError
        If files are missing, empty or none of these formats.
    """

    def __init__(self, path: str | Path):
        super().__init__(path)
        self._storages, self._of_storage, self._layouts = [], [], {}
        self._temporary = None
        self._notes: list[str] = []
        # What the last complete pass of `messages` wanted, and how many it found.
        self._found = (), 0
        metadata = self._read_metadata()
        try:
            for file in _storage_files(self.path, metadata):
                self._storages.append(self._open(file))
            self._number_topics()
            self._take_counts(metadata)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Close the files."""
        for storage in self._storages:
            storage.close()
        if self._temporary is not None:
            self._temporary.cleanup()

    def _read_metadata(self):
        """Contents of ``metadata.yaml``, written when the recorder closes the bag; else empty."""
        folder = self.path if self.path.is_dir() else self.path.parent
        path = folder / METADATA
        if not path.is_file():
            if self.path.is_dir():
                self._notes.append("the bag was not closed (no metadata.yaml)")
            return {}
        try:
            # The C loader takes a tenth of the time.
            loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
            content = yaml.load(path.read_text(encoding="utf-8"), loader)
            metadata = dict(content["rosbag2_bagfile_information"])
        except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, ValueError):
            self._notes.append("metadata.yaml is not readable: left out")
            return {}
        if self.path.is_file() and metadata.get("relative_file_paths") != [self.path.name]:
            return {}  # it describes all parts, and this is one of them
        return metadata

    def _open(self, path):
        plain = path  # errors name the file that was given
        try:
            with path.open("rb") as file:
                magic = file.read(len(SQLITE_MAGIC))
                if magic.startswith(ZSTD_MAGIC):
                    file.seek(0)
                    plain, magic = self._unpacked(path, file)
            if magic == SQLITE_MAGIC:
                return SqliteFile(plain)
            if magic.startswith(MCAP_MAGIC):
                return McapFile(plain)
        except OSError as error:
            raise BagError(f"{path}: cannot read the bag: {error.strerror}") from None
        except SQLITE_ERRORS as error:
            raise BagError(f"{path}: cannot read the bag: {error}") from None
        what = "another file" if magic else "an empty file"
        raise BagError(f"{path}: expected a ROS 2 bag (sqlite3 or MCAP), got {what}")

    def _unpacked(self, path, file):
        """A file that was compressed as a whole, and its first bytes."""
        if self._temporary is None:
            self._temporary = TemporaryDirectory(prefix="map_racing_")
        target = Path(self._temporary.name) / path.stem
        decompressor = zstd_decompressor()
        with target.open("wb") as unpacked:
            try:
                for block in iter(lambda: file.read(_BLOCK), b""):
                    unpacked.write(decompressor.decompress(block))
                whole = decompressor.eof
            except OSError:
                raise
            except Exception:  # the library has its own classes
                whole = False
        if not whole:
            self._notes.append(f"{path.name}: cut off or damaged: read as far as it goes")
        with target.open("rb") as unpacked:
            return target, unpacked.read(len(SQLITE_MAGIC))

    def _number_topics(self):
        """Number the topics of all files."""
        numbers = {(c.topic, c.type): number for number, c in self.connections.items()}
        self._of_storage = []
        for storage in self._storages:
            own = {}
            for key, topic in storage.topics.items():
                connection = connection_of(topic.name, topic.type, topic.definition)
                name = connection.topic, connection.type
                number = numbers.setdefault(name, len(numbers))
                own[key] = number
                if number not in self.connections:
                    self.connections[number] = connection
                    if topic.rearrange and not connection.cdr:
                        self._layouts[number] = Layout(connection)
            self._of_storage.append(own)

    def _take_counts(self, metadata):
        """Set message counts and time span, from the metadata or by counting."""
        if any(storage.counts is None for storage in self._storages):
            if self._take_recorded(metadata):
                return
            for storage in self._storages:
                if storage.counts is None:
                    storage.count()
            self._number_topics()
        for own, storage in zip(self._of_storage, self._storages):
            for key, count in storage.counts.items():
                if key in own:
                    self.counts[own[key]] = self.counts.get(own[key], 0) + count
        self.start_ns, self.end_ns = time_span(storage.span for storage in self._storages)

    def _take_recorded(self, metadata):
        try:
            counts = {}
            for entry in metadata["topics_with_message_count"]:
                about = entry["topic_metadata"]
                connection = connection_of(str(about["name"]), str(about["type"]), "")
                counts[connection.topic, connection.type] = int(entry["message_count"])
            start = int(metadata["starting_time"]["nanoseconds_since_epoch"])
            duration = int(metadata["duration"]["nanoseconds"])
            self.counts = {n: counts[c.topic, c.type] for n, c in self.connections.items()}
        except (KeyError, TypeError, ValueError):
            self.counts = {}
            return False
        self.start_ns, self.end_ns = (start, start + duration) if any(counts.values()) else (0, 0)
        return True

    def messages(self, wanted: set[int] | None = None) -> Iterator[Message]:
        """As `Bag.messages`."""
        found = 0
        for own, storage, keys in self._sources(wanted):
            for key, time_ns, data in storage.messages(keys):
                if not 0 <= time_ns < _TIMES_END:
                    continue
                data, layout = _uncompressed(data), self._layouts.get(own[key])
                found += 1
                yield Message(own[key], time_ns, data if layout is None else layout(data))
        self._found = self.connections if wanted is None else wanted, found

    def batches(self, wanted: set[int]) -> Iterator[Batch]:
        """As `Bag.batches`."""
        found = 0
        for own, storage, keys in self._sources(wanted):
            for batch in batched(storage.messages(keys)):
                batch = self._rearranged(batch, own)
                found += len(batch)
                yield batch
        self._found = wanted, found

    def _sources(self, wanted):
        """Files with wanted messages: numbers of the connections by key, file, wanted keys."""
        for own, storage in zip(self._of_storage, self._storages):
            keys = {key for key, number in own.items() if wanted is None or number in wanted}
            if keys:
                yield own, storage, keys

    def _rearranged(self, batch, own):
        """A batch of a file, without compression and in the layout of ROS 1."""
        good = (batch.times >= 0) & (batch.times < _TIMES_END)
        batch = batch if good.all() else batch.only(good)
        groups = []
        for key in np.unique(batch.numbers).tolist():
            where = np.flatnonzero(batch.numbers == key)
            contents, layout = batch.only(where).contents(), self._layouts.get(own[key])
            if not isinstance(contents, np.ndarray) or np.any(contents[:, 0] == ZSTD_MAGIC[0]):
                contents = [_uncompressed(bytes(data)) for data in contents]
            groups.append((own[key], where, contents if layout is None else layout.all(contents)))
        return Batch.of(groups, batch.times.astype(np.int64))

    def notes(self) -> list[str]:
        """What could not be read; empty for an intact bag."""
        notes = list(self._notes)
        damage = [place for storage in self._storages for place in storage.damage]
        if damage:
            where = ", ".join(dict.fromkeys(damage[:3])) + (", ..." if len(damage) > 3 else "")
            notes.append(f"damaged bag: all intact messages read; damage: {where}")
        elif not all(storage.closed for storage in self._storages):
            notes.append("the bag was not closed (no index): all messages until its end read")
        unread = sorted(set().union(*(storage.unread for storage in self._storages)))
        if unread:
            notes.append(
                f"chunks left out, compressed by {', '.join(unread)}: expected bz2, lz4 or zstd"
            )
        wanted, found = self._found
        expected = sum(self.counts.get(number, 0) for number in wanted)
        if found != expected and not damage and not unread:
            notes.append(f"{found} messages read, but the index of the bag lists {expected}")
        return notes


def _uncompressed(data):
    """A message that may be compressed by itself."""
    return decompress_message(data) if data[:4] == ZSTD_MAGIC else data


def _storage_files(path, metadata):
    """Files of a bag in the order of time, from its ``metadata.yaml`` or by their names."""
    if not path.is_dir():
        return [path]
    listed = metadata.get("relative_file_paths")
    if isinstance(listed, list) and listed:
        # Paths were relative to another folder before ROS 2 Foxy.
        files = [path / Path(str(name)).name for name in listed]
        missing = [file.name for file in files if not file.is_file()]
        if missing:
            raise BagError(f"{path}: a part of the bag is missing: {', '.join(missing)}")
        return files
    files = [file for file in path.iterdir() if file.is_file() and file.name.endswith(SUFFIXES)]
    if not files:
        raise BagError(
            f"{path}: expected a ROS 2 bag, got a folder without .db3 or .mcap files; map-racing "
            "season takes folders of bags"
        )
    return sorted(files, key=_natural)


def _natural(path):
    """Key that orders run_2 before run_10."""
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]
