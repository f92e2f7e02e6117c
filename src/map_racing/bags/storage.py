"""Files that hold the messages of ROS 2: sqlite3 and MCAP.

From an unclosed or damaged file, every complete message is read.

Formats: https://github.com/ros2/rosbag2, https://mcap.dev/spec
"""

from __future__ import annotations

import mmap
import sqlite3
import struct
from contextlib import suppress
from typing import NamedTuple
from zlib import crc32

from .bag import time_span
from .compression import COMPRESSIONS, decompress

__all__ = ["MCAP_MAGIC", "SQLITE_ERRORS", "SQLITE_MAGIC", "McapFile", "SqliteFile", "Topic"]

SQLITE_MAGIC = b"SQLite format 3\0"
MCAP_MAGIC = b"\x89MCAP0\r\n"
"""First bytes of the files."""

SQLITE_ERRORS = (sqlite3.Error, UnicodeDecodeError)
"""Exceptions of sqlite3, which also fails to decode its own error texts."""

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


class Topic(NamedTuple):
    """A topic of a file; ``rearrange`` is False if its messages are in the ROS 1 layout."""

    name: str
    type: str
    definition: str = ""
    rearrange: bool = True


class _Damage(Exception):
    """A record that is not as it should be."""


class SqliteFile:
    """A file of sqlite3.

    Attributes
    ----------
    topics : dict of int to Topic
    counts : dict of int to int or None
        Number of messages by topic; None before `count`.
    span : tuple of (int, int)
        First and last time of receipt [ns].
    closed : bool
        Whether the recorder closed the file, as far as this is known.
    damage : list of str
        Places that cannot be read.
    unread : set of str
        Compressions of chunks that are left out.
    """

    def __init__(self, path):
        self.counts, self.span, self.damage, self.closed = None, (0, 0), [], True
        self.unread = set()
        uri = path.resolve().as_uri()
        # A killed recorder leaves a journal, which sqlite can read only if it may write to it; a
        # bag without one may be on read-only media.
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
        self._database.text_factory = lambda text: text.decode("utf-8", "replace")
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
            number: Topic(name, kind, definitions.get(kind, ""))
            for number, name, kind, form in rows
            if form == "cdr"
        }

    def count(self):
        self.counts, spans = {}, []
        with suppress(*SQLITE_ERRORS):  # damage is noted when the messages are read
            for number, count, first, last in self._database.execute(
                "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages "
                "WHERE typeof(timestamp) = 'integer' GROUP BY topic_id"
            ):
                self.counts[number] = count
                spans.append((first, last))
        self.span = time_span(spans)

    def messages(self, wanted):
        marks = ",".join("?" * len(wanted))
        try:
            yield from self._database.execute(
                f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) "
                "AND typeof(timestamp) = 'integer' AND typeof(data) = 'blob' ORDER BY id",
                sorted(wanted),
            )
        except SQLITE_ERRORS as error:
            self.damage.append(str(error))


class McapFile:
    """A file of MCAP, with the attributes of `SqliteFile`."""

    def __init__(self, path):
        self.topics, self.counts, self.span = {}, None, (0, 0)
        self.damage, self.unread = [], set()
        self._schemas, self._chunks = {}, []
        self._file = path.open("rb")
        try:
            self._data = mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_READ)
        except BaseException:
            self._file.close()
            raise
        self._size = len(self._data)
        self.closed = self._data[-len(MCAP_MAGIC) :] == MCAP_MAGIC
        with suppress(_Damage, struct.error):
            self._read_summary()

    def close(self):
        self._data.close()
        self._file.close()

    def _read_summary(self):
        """Topics and counts from the end of the file."""
        at = self._size - len(MCAP_MAGIC) - _FOOTER.size
        op, _, start, _, _ = _FOOTER.unpack_from(self._data, at)
        if not self.closed or op != _FOOTER_OP or not 0 < start < at:
            return
        for op, begin, end in _records(self._data, start, at):
            self._read_topic(self._data, op, begin)
            if op == _CHUNK_INDEX_OP:
                self._chunks.append(_CHUNK_INDEX.unpack_from(self._data, begin)[2])
            elif op == _STATISTICS_OP:
                values = _STATISTICS.unpack_from(self._data, begin)
                counts = self._data[begin + _STATISTICS.size + 4 : end]
                self.counts, self.span = dict(_CHANNEL_COUNT.iter_unpack(counts)), values[-2:]
        self._chunks.sort()
        if not self.topics:
            self.counts = None

    def _read_topic(self, data, op, begin):
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
                self.topics[number] = Topic(name, kind, definition, encoding == "cdr")

    def count(self):
        self.counts, first, last = {}, 0, 0
        for number, time_ns, _ in self.messages(None):
            self.counts[number] = self.counts.get(number, 0) + 1
            first, last = min(first or time_ns, time_ns), max(last, time_ns)
        self.span = first, last

    def messages(self, wanted):
        self.damage = []
        at = len(MCAP_MAGIC)
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
                        self._read_topic(self._data, op, begin)
                    at = end
                return
            except (_Damage, struct.error):
                self.damage.append(f"byte {at}")
            # A chunk truncated by the end of the file may still hold messages.
            if self._data[at] == _CHUNK_OP and at + _RECORD.size + _CHUNK.size < self._size:
                with suppress(_Damage, struct.error):
                    yield from self._chunk(at + _RECORD.size, self._size, wanted)
            at = next((chunk for chunk in self._chunks if chunk > at), self._size)

    def _chunk(self, begin, end, wanted):
        """Messages of a chunk."""
        _, _, size, crc = _CHUNK.unpack_from(self._data, begin)
        (compression,), at = _texts(self._data, begin + _CHUNK.size, 1)
        if compression not in COMPRESSIONS and compression.isidentifier():  # else damaged
            self.unread.add(compression)
            return
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
        """Places of the messages of each channel in the preceding chunk; empty unless complete."""
        index = {}
        try:
            for op, begin, end in _records(self._data, at, self._size):
                if op != _INDEX_OP:
                    break
                (number,) = _U16.unpack_from(self._data, begin)
                entries = _INDEX_ENTRY.iter_unpack(self._data[begin + 6 : end])
                index[number] = [place for _, place in entries]
        except (_Damage, struct.error):  # such as the end of a file that was cut off
            return {}
        return index

    def _walk(self, data, at, end, wanted):
        """Yield messages among records, and store schemas and channels."""
        unpack, head = _MESSAGE.unpack_from, _MESSAGE.size
        try:
            for op, begin, stop in _records(data, at, end):
                if op == _MESSAGE_OP:
                    _, _, number, _, time_ns, _ = unpack(data, begin - _RECORD.size)
                    if wanted is None or number in wanted:
                        yield number, time_ns, data[begin - _RECORD.size + head : stop]
                else:
                    self._read_topic(data, op, begin)
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
