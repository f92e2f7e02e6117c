"""Bags of ROS 2: sqlite3 and MCAP, split, compressed by file or by message.

Records are read without rosbags, whose general reader takes longer than reading, decoding and
evaluating the same run from a bag of ROS 1, and gives up on a file that was not closed. From such a
file, or a damaged one, every complete message is read, with notes on what is missing.

Formats: https://github.com/ros2/rosbag2, https://mcap.dev/spec
"""

from __future__ import annotations

import mmap
import re
import sqlite3
import struct
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Iterator, NamedTuple
from zlib import crc32

import yaml

from ..errors import BagError
from .bag import Bag, Message, time_span
from .cdr import connection_of, layout_of_ros1
from .compression import ZSTD_MAGIC, decompress, decompress_message, zstd_decompressor

__all__ = ["MAGIC", "METADATA", "SUFFIXES", "Ros2Bag", "storage_files"]

METADATA = "metadata.yaml"
SUFFIXES = (".db3", ".mcap", ".db3.zstd", ".mcap.zstd")

_SQLITE_MAGIC = b"SQLite format 3\0"
_MCAP_MAGIC = b"\x89MCAP0\r\n"
MAGIC = (_SQLITE_MAGIC[:8], _MCAP_MAGIC)
"""First bytes of the files, by which they are told without a name."""

_BLOCK = 1 << 20
_U16, _U32 = struct.Struct("<H"), struct.Struct("<I")
_RECORD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<BQHIQQ")
_CHUNK = struct.Struct("<QQQI")
_FOOTER = struct.Struct("<BQQQI")
_CHUNK_INDEX = struct.Struct("<QQQ")
_STATISTICS = struct.Struct("<QHIIIIQQ")
_INDEX_ENTRY = struct.Struct("<QQ")
_CHANNEL_COUNT = struct.Struct("<HQ")
_FOOTER_OP, _SCHEMA_OP, _CHANNEL_OP, _MESSAGE_OP, _CHUNK_OP = range(2, 7)
_INDEX_OP, _CHUNK_INDEX_OP, _STATISTICS_OP, _LAST_OP = 7, 8, 11, 15


class _Topic(NamedTuple):
    """A topic of a file; ``rearrange`` is False where a converter left the messages of ROS 1."""

    name: str
    type: str
    definition: str = ""
    rearrange: bool = True


class _Damage(Exception):
    """A record that is not as it should be."""


class _Sqlite:
    """A file of sqlite3.

    Attributes
    ----------
    topics : dict of int to _Topic
    counts : dict of int to int or None
        Number of messages by topic; None before `count`.
    span : tuple of (int, int)
        First and last time of receipt [ns].
    closed : bool
        Whether the recorder closed the file, as far as it can be known.
    damage : list of str
        Places that cannot be read.
    """

    def __init__(self, path):
        self.counts, self.span, self.damage, self.closed = None, (0, 0), [], True
        uri = path.resolve().as_uri()
        # A recorder that was killed leaves a journal, which can be read only where it can be
        # written; a bag without one may lie where nothing can.
        journal = path.with_name(path.name + "-wal").exists()
        try:
            self._connect(f"{uri}?mode=ro" if journal else f"{uri}?immutable=1")
        except sqlite3.OperationalError:
            if not journal:
                raise
            self._connect(f"{uri}?immutable=1")
            self.closed = False

    def _connect(self, uri):
        self._database = sqlite3.connect(uri, uri=True)
        try:
            self.topics = self._read_topics()
        except BaseException:
            self.close()
            raise

    def close(self):
        self._database.close()

    def _read_topics(self):
        definitions = {}
        with suppress(sqlite3.OperationalError):  # there are none before ROS 2 Iron
            definitions = dict(
                self._database.execute(
                    "SELECT topic_type, encoded_message_definition FROM message_definitions"
                )
            )
        rows = self._database.execute(
            "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
        )
        return {
            number: _Topic(name, kind, definitions.get(kind, "") if form == "cdr" else "")
            for number, name, kind, form in rows
            if form == "cdr"
        }

    def count(self):
        self.counts, spans = {}, []
        with suppress(sqlite3.Error):  # what is damaged is said when the messages are read
            for number, count, first, last in self._database.execute(
                "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages "
                "GROUP BY topic_id"
            ):
                self.counts[number] = count
                spans.append((first, last))
        self.span = time_span(spans)

    def messages(self, wanted):
        marks = ",".join("?" * len(wanted))
        try:
            yield from self._database.execute(
                f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) "
                "ORDER BY id",
                sorted(wanted),
            )
        except sqlite3.Error as error:
            self.damage.append(str(error))


class _Mcap:
    """A file of MCAP, with the attributes of `_Sqlite`."""

    def __init__(self, path):
        self.topics, self.counts, self.span, self.damage = {}, None, (0, 0), []
        self._schemas, self._chunks = {}, []
        self._file = path.open("rb")
        try:
            self._data = mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ)
        except BaseException:
            self._file.close()
            raise
        self._size = len(self._data)
        self.closed = self._data[-len(_MCAP_MAGIC) :] == _MCAP_MAGIC
        with suppress(_Damage, struct.error):
            self._read_summary()

    def close(self):
        self._data.close()
        self._file.close()

    def _read_summary(self):
        """Topics and counts from the end of the file."""
        at = self._size - len(_MCAP_MAGIC) - _FOOTER.size
        op, _, start, _, _ = _FOOTER.unpack_from(self._data, at)
        if not self.closed or op != _FOOTER_OP or not 0 < start < at:
            return
        for op, begin, end in _records(self._data, start, at):
            self._read_topic(self._data, op, begin, end)
            if op == _CHUNK_INDEX_OP:
                self._chunks.append(_CHUNK_INDEX.unpack_from(self._data, begin)[2])
            elif op == _STATISTICS_OP:
                values = _STATISTICS.unpack_from(self._data, begin)
                counts = self._data[begin + _STATISTICS.size + 4 : end]
                self.counts, self.span = dict(_CHANNEL_COUNT.iter_unpack(counts)), values[-2:]
        self._chunks.sort()
        if not self.topics:
            self.counts = None

    def _read_topic(self, data, op, begin, end):
        """Take a schema or a channel."""
        if op == _SCHEMA_OP:
            (number,) = _U16.unpack_from(data, begin)
            (name, encoding, definition), _ = _texts(data, begin + 2, 3)
            self._schemas[number] = name, definition if encoding.startswith("ros") else ""
        elif op == _CHANNEL_OP:
            number, schema = struct.unpack_from("<HH", data, begin)
            (name, encoding), _ = _texts(data, begin + 4, 2)
            kind, definition = self._schemas.get(schema, ("", ""))
            if encoding in ("cdr", "ros1"):
                self.topics[number] = _Topic(name, kind, definition, encoding == "cdr")

    def count(self):
        self.counts, first, last = {}, 0, 0
        for number, time_ns, _ in self.messages(None):
            self.counts[number] = self.counts.get(number, 0) + 1
            first, last = min(first or time_ns, time_ns), max(last, time_ns)
        self.span = first, last

    def messages(self, wanted):
        self.damage = []
        at = len(_MCAP_MAGIC)
        while at < self._size:
            try:
                for op, begin, end in _records(self._data, at, self._size):
                    if op == _CHUNK_OP:
                        yield from self._chunk(begin, end, wanted)
                    elif op == _MESSAGE_OP:
                        yield from self._walk(self._data, at, end, wanted)
                    elif op in (_FOOTER_OP, _LAST_OP):
                        return
                    else:
                        self._read_topic(self._data, op, begin, end)
                    at = end
                return
            except (_Damage, struct.error):
                self.damage.append(f"byte {at}")
            # A chunk that the end of the file cuts off may still hold messages.
            if self._data[at] == _CHUNK_OP and at + _RECORD.size + _CHUNK.size < self._size:
                with suppress(_Damage, struct.error):
                    yield from self._chunk(at + _RECORD.size, self._size, wanted)
            at = next((chunk for chunk in self._chunks if chunk > at), self._size)

    def _chunk(self, begin, end, wanted):
        """Messages of a chunk."""
        _, _, size, crc = _CHUNK.unpack_from(self._data, begin)
        (compression,), at = _texts(self._data, begin + _CHUNK.size, 1)
        contents, sound = decompress(compression, self._data[at + 8 : end])
        sound = sound and len(contents) == size and (not crc or crc32(contents) == crc)
        if not sound:
            self.damage.append(f"byte {begin}")
        index = self._index(end) if sound and wanted is not None else {}
        picked = self._pick(contents, index, wanted) if index else None
        yield from self._walk(contents, 0, len(contents), wanted) if picked is None else picked

    def _pick(self, contents, index, wanted):
        """Wanted messages at the places in the index; None if it is wrong."""
        picked, unpack, head = [], _MESSAGE.unpack_from, _MESSAGE.size
        for at in sorted(place for number in wanted for place in index.get(number, ())):
            if at + head > len(contents):
                return None
            op, length, number, _, time_ns, _ = unpack(contents, at)
            stop = at + _RECORD.size + length
            if op != _MESSAGE_OP or number not in wanted or stop > len(contents):
                return None
            picked.append((number, time_ns, contents[at + head : stop]))
        return picked

    def _index(self, at):
        """Places of the messages of each channel in the chunk before; empty without an index."""
        index = {}
        with suppress(_Damage):  # the end of the file may cut off what follows
            for op, begin, end in _records(self._data, at, self._size):
                if op != _INDEX_OP:
                    break
                (number,) = _U16.unpack_from(self._data, begin)
                entries = _INDEX_ENTRY.iter_unpack(self._data[begin + 6 : end])
                index[number] = [place for _, place in entries]
        return index

    def _walk(self, data, at, end, wanted):
        """Messages among records; schemas and channels are taken."""
        unpack, head = _MESSAGE.unpack_from, _MESSAGE.size
        try:
            for op, begin, stop in _records(data, at, end):
                if op == _MESSAGE_OP:
                    _, _, number, _, time_ns, _ = unpack(data, begin - _RECORD.size)
                    if wanted is None or number in wanted:
                        yield number, time_ns, data[begin - _RECORD.size + head : stop]
                else:
                    self._read_topic(data, op, begin, stop)
        except (_Damage, struct.error):
            self.damage.append(f"a chunk at byte {at}")


def _records(data, at, end):
    """Operation, begin and end of the contents of the records of MCAP."""
    unpack, head = _RECORD.unpack_from, _RECORD.size
    while at < end:
        if at + head > end:
            raise _Damage
        op, length = unpack(data, at)
        begin, at = at + head, at + head + length
        if at > end or not 0 < op <= _LAST_OP:
            raise _Damage
        yield op, begin, at


def _texts(data, at, count):
    """Texts that begin at ``at``, each after its length, and their end."""
    texts = []
    for _ in range(count):
        (length,) = _U32.unpack_from(data, at)
        at += 4
        texts.append(data[at : at + length].decode("utf-8", "replace"))
        at += length
    return texts, at


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
        self._found = None
        metadata = self._read_metadata()
        try:
            for file in storage_files(self.path, metadata):
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
        """What the recorder wrote beside the files when it closed them; empty without."""
        folder = self.path if self.path.is_dir() else self.path.parent
        path = folder / METADATA
        if not path.is_file():
            if self.path.is_dir():
                self._notes.append("the bag was not closed (no metadata.yaml)")
            return {}
        try:
            # The loader of C takes a tenth of the time.
            loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
            content = yaml.load(path.read_text(encoding="utf-8"), loader)
            metadata = dict(content["rosbag2_bagfile_information"])
        except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError, ValueError):
            self._notes.append("metadata.yaml is not readable: left out")
            return {}
        if self.path.is_file() and metadata.get("relative_file_paths") != [self.path.name]:
            return {}  # of all parts, of which this is one
        return metadata

    def _open(self, path):
        try:
            with path.open("rb") as file:
                magic = file.read(len(_SQLITE_MAGIC))
                if magic.startswith(ZSTD_MAGIC):
                    file.seek(0)
                    path, magic = self._unpacked(path, file)
            if magic == _SQLITE_MAGIC:
                return _Sqlite(path)
            if magic.startswith(_MCAP_MAGIC):
                return _Mcap(path)
        except OSError as error:
            raise BagError(f"{path}: cannot read the bag: {error.strerror}") from None
        except sqlite3.Error as error:
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
            except Exception:  # of a class of the library
                whole = False
        if not whole:
            self._notes.append(f"{path.name}: cut off or damaged: read as far as it goes")
        with target.open("rb") as unpacked:
            return target, unpacked.read(len(_SQLITE_MAGIC))

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
                        self._layouts[number] = layout_of_ros1(connection)
            self._of_storage.append(own)

    def _take_counts(self, metadata):
        """Numbers of messages and the time that they span: as the recorder counted, or counted."""
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
        """Complete messages in the order of the files.

        Parameters
        ----------
        wanted : set of int, optional
            Identifiers of the connections to yield; all by default.
        """
        layouts, found = self._layouts, 0
        for own, storage in zip(self._of_storage, self._storages):
            keys = {key for key, number in own.items() if wanted is None or number in wanted}
            for key, time_ns, data in storage.messages(keys) if keys else ():
                if data[:4] == ZSTD_MAGIC:  # compressed message by message
                    data = decompress_message(data)
                number = own[key]
                layout = layouts.get(number)
                found += 1
                yield Message(number, time_ns, data if layout is None else layout(data))
        self._found = {frozenset(wanted or self.connections): found}

    def notes(self) -> list[str]:
        """What could not be read; empty for a sound bag."""
        notes = list(self._notes)
        damage = [place for storage in self._storages for place in storage.damage]
        if damage:
            where = ", ".join(dict.fromkeys(damage[:3])) + (", ..." if len(damage) > 3 else "")
            notes.append(f"damaged bag: all intact messages read; damage: {where}")
        elif not all(storage.closed for storage in self._storages):
            notes.append("the bag was not closed (no index): all messages until its end read")
        for wanted, found in (self._found or {}).items():
            expected = sum(self.counts.get(number, 0) for number in wanted)
            if found != expected and not damage:
                notes.append(f"{found} messages read, but the index of the bag lists {expected}")
        return notes


def storage_files(path: Path, metadata: dict | None = None) -> list[Path]:
    """Files of a bag, in the order of time.

    Parameters
    ----------
    path : pathlib.Path
        Folder or file.
    metadata : dict, optional
        Contents of its ``metadata.yaml``.

    Returns
    -------
    list of pathlib.Path

    Raises
    ------
    BagError
        If there are none, or some are missing.
    """
    if not path.is_dir():
        return [path]
    listed = (metadata or {}).get("relative_file_paths")
    if isinstance(listed, list) and listed:
        # Paths were relative to another folder before ROS 2 Foxy.
        files = [path / Path(str(name)).name for name in listed]
        missing = [file.name for file in files if not file.is_file()]
        if missing:
            raise BagError(f"{path}: a part of the bag is missing: {', '.join(missing)}")
        return files
    files = [file for file in path.iterdir() if file.is_file() and file.name.endswith(SUFFIXES)]
    if not files:
        raise BagError(f"{path}: expected a ROS 2 bag, got a folder without .db3 or .mcap files")
    return sorted(files, key=_natural)


def _natural(path):
    """Key that orders run_2 before run_10."""
    parts = re.split(r"(\d+)", path.name)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]
