"""The records of a ROS 1 bag (format 2.0), read front to back.

A bag that was cut off, was never closed (``.bag.active``) or has a corrupt chunk still yields every
complete message, with notes on what is missing. The index is only a shortcut: without it, or where
it is wrong, the records are read one after the other.

Format: http://wiki.ros.org/Bags/Format/2.0
"""

from __future__ import annotations

import struct
from enum import IntEnum
from pathlib import Path
from typing import Iterator, NamedTuple

import numpy as np

from ..errors import BagError
from ..printing import printable
from .bag import Bag, Batch, Connection, Message, batched, time_span
from .compression import decompress
from .message_records import (
    CONN_LENGTH,
    HEADER_SIZE,
    LAYOUTS,
    OP_FIELD,
    RECORD_SIZE,
    find_message,
    layout_at,
    read_at_once,
)

__all__ = ["BagFile"]

_MAGIC = b"#ROSBAG V2.0\n"
_MAX_HEADER = 1 << 16
_MAX_OPEN_CHUNK = 1 << 28
_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")
_TIME = struct.Struct("<II")
_COUNT = struct.Struct("<II")  # connection and number of its messages
_INDEX_ENTRY = np.dtype([("sec", "<u4"), ("nsec", "<u4"), ("offset", "<u4")])


class _Op(IntEnum):
    """Type of a record."""

    MESSAGE = 2
    BAG = 3
    INDEX = 4
    CHUNK = 5
    CHUNK_INFO = 6
    CONNECTION = 7


class _Header(dict):
    """Fields of a record header, bytes to bytes, with typed access; None if not as expected."""

    @property
    def op(self) -> _Op | None:
        """Type of the record."""
        value = self.get(b"op", b"")
        try:
            return _Op(value[0]) if len(value) == 1 else None
        except ValueError:
            return None

    def u32(self, name: bytes) -> int | None:
        """A field of 4 bytes."""
        value = self.get(name, b"")
        return _U32.unpack(value)[0] if len(value) == 4 else None

    def u64(self, name: bytes) -> int | None:
        """A field of 8 bytes."""
        value = self.get(name, b"")
        return _U64.unpack(value)[0] if len(value) == 8 else None

    def time_ns(self, name: bytes) -> int | None:
        """A time [ns]."""
        value = self.get(name, b"")
        if len(value) != 8:
            return None
        sec, nsec = _TIME.unpack(value)
        return sec * 1000000000 + nsec

    def text(self, name: bytes) -> str:
        """A text; empty without the field."""
        return self.get(name, b"").decode("utf-8", "replace")

    def name(self, name: bytes) -> str:
        """A text that is a name."""
        return printable(self.text(name))


class _Record(NamedTuple):
    """A record of the file, with the place of its data."""

    op: _Op
    header: _Header
    start: int
    length: int

    @property
    def end(self):
        return self.start + self.length


# Possible offsets of the field op in the record of a chunk: before it are the length of the header
# and none, one or both of the other fields (size 13 bytes, compression 19 or 20).
_OP_OFFSETS = (4, 4 + 13, 4 + 19, 4 + 20, 4 + 32, 4 + 33)


class BagFile(Bag):
    """A bag of ROS 1 open for reading.

    Parameters
    ----------
    path : str or pathlib.Path

    Raises
    ------
    BagError
        If the file is missing, no regular file, empty or no bag of format 2.0.
    """

    def __init__(self, path: str | Path):
        super().__init__(path)
        self._damage = set()
        # Fewest messages found by a complete pass of `messages`; None before the first.
        self._found, self._last = None, (None, None)
        if self.path.exists() and not (self.path.is_file() or self.path.is_dir()):
            # Opening a pipe would wait for a writer.
            raise BagError(f"{path}: expected a bag, got a pipe or a device")
        try:
            self._file = self.path.open("rb")
        except OSError as error:
            raise BagError(f"{path}: cannot open the bag: {error.strerror}") from None
        try:
            self._size = self._file.seek(0, 2)
            self._file.seek(0)
            magic = self._file.read(len(_MAGIC))
            if magic != _MAGIC:
                what = "another file" if magic else "an empty file"
                raise BagError(f"{path}: expected a ROS 1 bag (format 2.0), got {what}")
            self.indexed = self._read_index()
            if not self.indexed:
                self._take_inventory()
        except OSError as error:
            self._file.close()
            raise BagError(f"{path}: cannot read the bag: {error.strerror}") from None
        except BaseException:
            self._file.close()
            raise

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def messages(self, wanted: set[int] | None = None) -> Iterator[Message]:
        """As `Bag.messages`."""
        for part in self._parts(wanted):
            yield from part

    def batches(self, wanted: set[int]) -> Iterator[Batch]:
        """As `Bag.batches`."""
        for part in self._parts(wanted):
            yield from [part] if isinstance(part, Batch) else batched(part)

    def _parts(self, wanted):
        """Yield the messages of each chunk."""
        self._read = 0
        for buffer, position, index in self._chunks():
            picked = self._pick(buffer, index, wanted) if wanted and index else None
            yield self._walk(buffer, position, wanted) if picked is None else picked
        self._found = self._read if self._found is None else min(self._found, self._read)

    def notes(self) -> list[str]:
        """What `messages` could not read; empty for an intact bag."""
        notes = []
        expected = sum(self.counts.values())
        if self._damage:
            read = f"{self._found} of {expected}" if self.indexed else f"{self._found}"
            read = "" if self._found is None else f"{read} messages read; "
            where = ", ".join(str(position) for position in sorted(self._damage)[:3])
            more = ", ..." if len(self._damage) > 3 else ""
            notes.append(f"damaged bag: {read}damage at byte {where}{more} of {self._size}")
        elif self.indexed and self._found not in (None, expected):
            notes.append(f"{self._found} messages read, but the index of the bag lists {expected}")
        elif not self.indexed:
            notes.append(
                f"the bag was not closed (no index): all {self._found} messages "
                f"until its end at byte {self._size} read"
            )
        return notes

    # -- index ---------------------------------------------------------------------------------

    def _read_index(self):
        """Read connections and counts from the end of the bag; False without a complete index."""
        record = self._record_at(len(_MAGIC))
        position = record.header.u64(b"index_pos") if record and record.op is _Op.BAG else None
        if position is None:
            return False
        if not len(_MAGIC) < position < self._size:
            # The index of a bag without messages is empty.
            return position == self._size
        times = []
        while position < self._size:
            record = self._record_at(position)
            if record is None or record.end > self._size:
                return False
            data = self._read_at(record.start, record.length)
            if record.op is _Op.CONNECTION:
                if not self._add_connection(record.header, data, 0, len(data)):
                    return False
            elif record.op is _Op.CHUNK_INFO:
                for at in range(0, record.length - 7, 8):
                    connection, count = _COUNT.unpack_from(data, at)
                    self.counts[connection] = self.counts.get(connection, 0) + count
                first, last = (record.header.time_ns(name) for name in (b"start_time", b"end_time"))
                times.append((first or last, last))
            else:
                return False
            position = record.end
        self.start_ns, self.end_ns = time_span(times)
        return True

    def _take_inventory(self):
        """Collect connections and counts from the messages."""
        self.counts = {}
        times = []
        for message in self.messages():
            self.counts[message.connection] = self.counts.get(message.connection, 0) + 1
            times[1:] = [message.time_ns]
        if times:
            self.start_ns, self.end_ns = times[0], times[-1]

    def _add_connection(self, header, buffer, start, stop):
        number, about = header.u32(b"conn"), _header(buffer, start, stop)
        if about is None or number is None:
            return False
        # The topic in the header is the one after remapping, the one in the data before. Recorders
        # that were given names without a slash write them that way.
        topic = header.name(b"topic") or about.name(b"topic")
        self.connections[number] = Connection(
            topic="/" + topic.lstrip("/"),
            type=about.name(b"type"),
            md5sum=about.text(b"md5sum"),
            definition=about.text(b"message_definition"),
            sender=about.name(b"callerid"),
            latching=about.text(b"latching") == "1",
        )
        return True

    # -- records of the file ---------------------------------------------------------------------

    def _read_at(self, position, length):
        self._file.seek(position)
        return self._file.read(length)

    def _record_at(self, position) -> _Record | None:
        """The record that begins at ``position``; None if implausible."""
        head = self._read_at(position, 4)
        if len(head) < 4:
            return None
        (length,) = _U32.unpack(head)
        if length > _MAX_HEADER:
            return None
        head = self._file.read(length + 4)
        if len(head) < length + 4:
            return None
        header = _header(head, 0, length)
        op = header and header.op
        if not op:
            return None
        return _Record(op, header, position + length + 8, _U32.unpack_from(head, length)[0])

    def _chunks(self):
        """Yield the contents of each chunk, the position of its data in the file, and its index.

        The index is empty if the chunk is damaged.
        """
        position = len(_MAGIC)
        while position < self._size:
            record = self._record_at(position)
            if record is None:
                self._add_damage(position)
                position = self._find_chunk(position + 1)
                continue
            op, header, start, length = record
            end = record.end
            if op is _Op.CHUNK:
                # A recorder fills in the length when it closes the chunk: 0 means open.
                whole = length > 0 and end <= self._size
                length = length if whole else min(self._size - start, _MAX_OPEN_CHUNK)
                compression = header.text(b"compression") or "unknown"
                contents, sound = self._decompressed(compression, start, length)
                index, position = {}, end
                if whole and sound and len(contents) == header.u32(b"size"):
                    if self.indexed:
                        index, position = self._chunk_index(end)
                else:
                    self._add_damage(start)
                yield contents, start, index
                position = position if whole else self._find_chunk(start)
            else:
                if op is _Op.CONNECTION:
                    data = self._read_at(start, length)
                    self._add_connection(header, data, 0, len(data))
                if end > self._size:
                    self._add_damage(position)
                position = end

    def _decompressed(self, compression, start, length):
        """Contents of a chunk, and whether they are sound; the last are kept for another look."""
        if self._last[0] != start:
            self._last = start, decompress(compression, self._read_at(start, length))
        return self._last[1]

    def _chunk_index(self, begin):
        """Offsets of each connection's messages in the chunk that ends there; end of the index."""
        index, position = {}, begin
        record = self._record_at(position)
        while record is not None and record.op is _Op.INDEX:
            data = self._read_at(record.start, record.length)
            number = record.header.u32(b"conn")
            if number is None or len(data) % _INDEX_ENTRY.itemsize or record.end > self._size:
                return {}, begin
            index[number] = np.frombuffer(data, _INDEX_ENTRY)["offset"].astype(np.int64)
            position = record.end
            record = self._record_at(position)
        # The index of another connection may follow an unreadable one.
        return (index, position) if record is not None or position == self._size else ({}, begin)

    def _find_chunk(self, position):
        """Position of the next chunk record from ``position`` on, or the end of the file."""
        mark, block = b"\x04\0\0\0op=\x05", 1 << 20
        while position < self._size:
            data = self._read_at(position, block + len(mark))
            at = data.find(mark)
            while at >= 0:
                for offset in _OP_OFFSETS:
                    candidate = position + at - offset
                    record = self._record_at(candidate) if candidate > 0 else None
                    if record and record.op is _Op.CHUNK and b"compression" in record.header:
                        return candidate
                at = data.find(mark, at + 1)
            position += block
        return self._size

    # -- records of a chunk ----------------------------------------------------------------------

    def _pick(self, buffer, index, wanted):
        """Messages of the wanted connections at the places in the index; None if it is wrong."""
        numbers = [number for number in wanted if number in index]
        picked, sizes = (), [index[number].size for number in numbers]
        if any(sizes):
            places = np.concatenate([index[number] for number in numbers])
            order = np.argsort(places, kind="stable")
            picked = read_at_once(buffer, places[order], np.repeat(numbers, sizes)[order])
            if picked is None:
                return None
        self._read += sum(places.size for places in index.values())
        return picked

    def _walk(self, buffer, position, wanted):
        """Yield the wanted messages in the contents of a chunk, and add its connections."""
        at, end = 0, len(buffer) - RECORD_SIZE
        unpack, op, conn, time, _ = LAYOUTS[0]
        while at <= end:
            values = unpack(buffer, at)
            if values[op] == OP_FIELD and values[conn] == CONN_LENGTH and values[0] == HEADER_SIZE:
                start = at + RECORD_SIZE
                stop = start + values[-1]
                if stop <= len(buffer):
                    self._read += 1
                    number = values[conn + 1]
                    if wanted is None or number in wanted:
                        sec, nsec = _TIME.unpack_from(buffer, at + time)
                        yield Message(number, sec * 1000000000 + nsec, buffer[start:stop])
                    at = stop
                    continue
            layout = layout_at(buffer, at)
            if layout is not None and layout.unpack != unpack:
                unpack, op, conn, time, _ = layout
                continue
            stop = self._other_record(buffer, at)
            if stop is None:
                self._add_damage(position)
                stop = find_message(buffer, at + 1)
            at = stop
        if at != len(buffer):
            self._add_damage(position)

    def _add_damage(self, position):
        self._damage.add(position)

    def _other_record(self, buffer, at):
        """Add a connection record; the position after it, None for another record."""
        (length,) = _U32.unpack_from(buffer, at)
        data = at + length + 8
        if length > _MAX_HEADER or data > len(buffer):
            return None
        header = _header(buffer, at + 4, data - 4)
        stop = data + _U32.unpack_from(buffer, data - 4)[0]
        if header is None or header.op is not _Op.CONNECTION or stop > len(buffer):
            return None
        return stop if self._add_connection(header, buffer, data, stop) else None


def _header(buffer, start, stop):
    """Fields of a header; None if they do not fill it exactly."""
    fields = _Header()
    while start < stop:
        if start + 4 > stop:
            return None
        (length,) = _U32.unpack_from(buffer, start)
        start += 4
        name, equals, value = buffer[start : start + length].partition(b"=")
        start += length
        if start > stop or not equals:
            return None
        fields[name] = value
    return fields
