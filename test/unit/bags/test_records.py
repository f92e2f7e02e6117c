import bz2
import os
import struct
from itertools import permutations

import lz4.frame
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.rosbag1 import Reader

from map_racing.bags.bag import Message
from map_racing.bags.records import BagFile
from map_racing.errors import BagError


def record(fields, data):
    header = b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name + b"=" + value
        for name, value in fields
    )
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data


def connection(number, topic):
    data = record(
        [(b"topic", topic), (b"type", b"a/B"), (b"md5sum", b"*"), (b"message_definition", b"")], b""
    )[4:-4]
    return record([(b"op", b"\x07"), (b"conn", struct.pack("<I", number)), (b"topic", topic)], data)


def message(number, time_ns, data, order=(b"op", b"conn", b"time")):
    values = {
        b"op": b"\x02",
        b"conn": struct.pack("<I", number),
        b"time": struct.pack("<II", *divmod(time_ns, 10**9)),
    }
    return record([(name, values[name]) for name in order], data)


def chunk(contents, compression=b"none", order=(b"op", b"compression", b"size"), size=None):
    packed = {b"none": bytes, b"lz4": lz4.frame.compress, b"bz2": bz2.compress}[compression]
    values = {
        b"op": b"\x05",
        b"compression": compression,
        b"size": struct.pack("<I", len(contents) if size is None else size),
    }
    return record([(name, values[name]) for name in order], packed(contents))


def bag(*records, index=b""):
    """A bag of chunks, closed with an index or left open."""
    chunks = b"".join(records)

    def head(index_pos):
        fields = [(b"op", b"\x03"), (b"index_pos", struct.pack("<Q", index_pos))]
        return b"#ROSBAG V2.0\n" + record(fields, b" " * 100)

    return head(len(head(0)) + len(chunks) if index else 0) + chunks + index


def chunk_info(number, count, start, end):
    times = [struct.pack("<II", *divmod(time, 10**9)) for time in (start, end)]
    fields = [(b"op", b"\x06"), (b"start_time", times[0]), (b"end_time", times[1])]
    return record(fields, struct.pack("<II", number, count))


def read(path, data):
    path.write_bytes(data)
    with BagFile(path) as file:
        return list(file.messages()), file.notes(), file


@pytest.mark.parametrize("compression", [None, "lz4", "bz2"])
def test_sound_bag_reads_as_rosbags_reads_it(race_bag, compression):
    path = race_bag(compression)
    with BagFile(path) as file:
        found = sorted(file.messages(), key=lambda message: message.time_ns)
        assert file.indexed
        assert file.notes() == []
        with Reader(path) as reader:
            expected = list(reader.messages())
            assert file.start_ns == reader.start_time
            topics = {number: line.topic for number, line in file.connections.items()}
            assert topics == {line.id: line.topic for line in reader.connections}
            assert sum(file.counts.values()) == reader.message_count
    assert len(found) == len(expected)

    def key(item):
        return item[1], item[0], item[2]

    expected = sorted(((c.id, time, bytes(data)) for c, time, data in expected), key=key)
    assert sorted(map(tuple, found), key=key) == expected


def test_only_wanted_connections_are_yielded(race_bag):
    with BagFile(race_bag()) as file:
        wanted = next(n for n, line in file.connections.items() if line.topic == "/tf")
        assert {message.connection for message in file.messages({wanted})} == {wanted}
        assert len(list(file.messages({wanted}))) == file.counts[wanted]


@pytest.mark.parametrize("order", list(permutations((b"op", b"conn", b"time"))))
@pytest.mark.parametrize("compression", [b"none", b"lz4", b"bz2"])
def test_any_order_of_header_fields(tmp_path, order, compression):
    contents = connection(4, b"/a") + message(4, 5, b"x", order) + message(4, 7, b"yz", order)
    found, notes, file = read(tmp_path / "a.bag", bag(chunk(contents, compression)))
    assert found == [Message(4, 5, b"x"), Message(4, 7, b"yz")]
    assert file.connections[4].topic == "/a"
    assert not file.indexed
    assert file.counts == {4: 2}
    assert (file.start_ns, file.end_ns) == (5, 7)
    assert len(notes) == 1
    assert "not closed" in notes[0]
    assert "all 2 messages" in notes[0]


def test_recorders_may_be_mixed_within_a_chunk(tmp_path):
    orders = list(permutations((b"op", b"conn", b"time")))
    contents = b"".join(message(1, i, b"%d" % i, order) for i, order in enumerate(orders))
    found, _, _ = read(tmp_path / "a.bag", bag(chunk(connection(1, b"/a") + contents)))
    assert [message.time_ns for message in found] == list(range(6))


@pytest.fixture(scope="module")
def whole(race_bag):
    """Function from a compression to the bytes and the messages of a bag."""
    contents = {}
    for compression in (None, "lz4", "bz2"):
        with BagFile(race_bag(compression)) as file:
            contents[compression] = race_bag(compression).read_bytes(), list(file.messages())
    return lambda compression: contents[compression]


@pytest.mark.once
@given(st.sampled_from([None, "lz4", "bz2"]), st.floats(0.0, 0.9999))
@settings(deadline=None, max_examples=60, suppress_health_check=list(HealthCheck))
def test_truncated_bag_gives_a_prefix_and_says_so(tmp_path, whole, compression, fraction):
    data, messages = whole(compression)
    cut = 13 + int((len(data) - 13) * fraction)
    found, notes, file = read(tmp_path / "cut.bag", data[:cut])
    # Do not compare the lists directly: their difference would flood the terminal.
    assert all(a == b for a, b in zip(found, messages))
    assert len(found) <= len(messages)
    assert len(notes) == 1
    assert not file.indexed


def test_truncated_uncompressed_bag_keeps_every_complete_message(tmp_path):
    contents = connection(1, b"/a") + b"".join(message(1, i, b"data" * 5) for i in range(10))
    data = bag(chunk(contents))
    size = len(message(1, 0, b"data" * 5))
    for missing in range(1, 3 * size):
        found, notes, _ = read(tmp_path / "cut.bag", data[: len(data) - missing])
        assert len(found) == 10 - -(-missing // size)
        assert f"{len(found)} messages read" in notes[0]


@pytest.mark.parametrize("compression", [b"none", b"lz4", b"bz2"])
def test_chunk_that_its_recorder_left_open(tmp_path, compression):
    """A killed recorder leaves 0 as the length and size of its last chunk."""
    first = connection(1, b"/a") + message(1, 1, b"x")
    last = b"".join(message(1, i, os.urandom(40)) for i in range(2, 30))
    open_chunk = bytearray(chunk(last, compression, size=0))
    at = 4 + struct.unpack_from("<I", open_chunk)[0]
    open_chunk[at : at + 4] = bytes(4)
    found, notes, _ = read(tmp_path / "a.bag.active", bag(chunk(first), bytes(open_chunk)))
    assert [message.time_ns for message in found] == list(range(1, 30))
    assert "29 messages read" in notes[0]


def test_corrupt_message_costs_only_itself(tmp_path):
    lines = [message(1, i, b"payload") for i in range(20)]
    broken = lines[7][:4] + b"\xff" * 8 + lines[7][12:]
    contents = connection(1, b"/a") + b"".join(lines[:7]) + broken + b"".join(lines[8:])
    found, notes, _ = read(tmp_path / "a.bag", bag(chunk(contents)))
    assert [message.time_ns for message in found] == [*range(7), *range(8, 20)]
    assert "19 messages read" in notes[0]


@pytest.mark.parametrize("compression", [b"lz4", b"bz2"])
def test_corrupt_compressed_chunk_costs_only_itself(tmp_path, compression):
    chunks = [
        chunk(
            (connection(1, b"/a") if i == 0 else b"") + message(1, i, os.urandom(300)), compression
        )
        for i in range(3)
    ]
    broken = bytearray(chunks[1])
    broken[70:120] = b"\x55" * 50
    found, notes, _ = read(tmp_path / "a.bag", bag(chunks[0], bytes(broken), chunks[2]))
    assert {0, 2} <= {message.time_ns for message in found}
    assert notes[0].startswith("damaged bag")


@pytest.mark.parametrize("order", list(permutations((b"op", b"compression", b"size"))))
@pytest.mark.parametrize("compression", [b"none", b"lz4", b"bz2"])
def test_reading_resumes_at_the_next_chunk(tmp_path, order, compression):
    first = chunk(connection(1, b"/a") + message(1, 1, b"x"))
    last = chunk(message(1, 3, b"z"), compression, order)
    garbage = b"\xff" * 999
    found, notes, _ = read(tmp_path / "a.bag", bag(first, garbage, last))
    assert [message.time_ns for message in found] == [1, 3]
    assert "damage at byte" in notes[0]


def test_connections_of_a_lost_chunk_come_from_the_index(tmp_path):
    line = connection(1, b"/a")
    lost = bytearray(chunk(line + message(1, 1, os.urandom(300)), b"lz4"))
    lost[80:300] = b"\xff" * 220
    last = chunk(message(1, 5, b"x") + message(1, 6, b"y"), b"lz4")
    index = line + chunk_info(1, 1, 1, 1) + chunk_info(1, 2, 5, 6)
    found, notes, file = read(tmp_path / "a.bag", bag(bytes(lost), last, index=index))
    assert file.indexed
    assert file.counts == {1: 3}
    assert (file.start_ns, file.end_ns) == (1, 6)
    assert file.connections[1].topic == "/a"
    assert [message.time_ns for message in found] == [5, 6]
    assert "2 of 3 messages read" in notes[0]


def chunk_index(number, entries):
    data = b"".join(struct.pack("<III", *divmod(time, 10**9), offset) for time, offset in entries)
    return record(
        [(b"op", b"\x04"), (b"ver", b"\1\0\0\0"), (b"conn", struct.pack("<I", number))], data
    )


@pytest.mark.parametrize("fault", ["none", "offset", "beyond", "other", "missing", "garbage"])
@pytest.mark.parametrize("order", list(permutations((b"op", b"conn", b"time"))))
def test_index_of_a_chunk_is_only_a_short_cut(tmp_path, fault, order):
    line = connection(1, b"/a") + connection(2, b"/b")
    contents, places = line, {1: [], 2: []}
    for time in range(8):
        number = 1 + time % 2
        places[number].append((time, len(contents)))
        contents += message(number, time, b"data", order)
    indices = dict(places)
    if fault == "offset":
        indices[1] = [(time, offset + 1) for time, offset in places[1]]
    elif fault == "beyond":
        indices[1] = [(time, offset + 10**6) for time, offset in places[1]]
    elif fault == "other":
        indices[1] = places[2]
    elif fault == "missing":
        indices[1] = places[1][:-1]
    records = [chunk(contents), *(chunk_index(number, indices[number]) for number in (2, 1))]
    if fault == "garbage":
        records[2] = b"\xff" * len(records[2])
    path = tmp_path / "a.bag"
    path.write_bytes(bag(*records, index=line + chunk_info(1, 4, 0, 6) + chunk_info(2, 4, 1, 7)))
    with BagFile(path) as file:
        found = list(file.messages({1}))
        notes = file.notes()
    assert {message.connection for message in found} == {1}
    if fault == "missing":
        assert [message.time_ns for message in found] == [0, 2, 4]
        assert notes == ["7 messages read, but the index of the bag lists 8"]
    else:
        assert [message.time_ns for message in found] == [0, 2, 4, 6]
        assert notes == [] or fault == "garbage"


@pytest.mark.once
@given(st.data())
@settings(deadline=None, max_examples=60, suppress_health_check=list(HealthCheck))
def test_arbitrary_damage_never_raises_anything_else(tmp_path, whole, data):
    compression = data.draw(st.sampled_from([None, "lz4", "bz2"]))
    contents = bytearray(whole(compression)[0][:60000])
    for _ in range(data.draw(st.integers(1, 30))):
        contents[data.draw(st.integers(13, len(contents) - 1))] = data.draw(st.integers(0, 255))
    read(tmp_path / "a.bag", contents)


def test_what_is_no_bag(tmp_path):
    (tmp_path / "empty.bag").touch()
    (tmp_path / "text.bag").write_text("x,y\n1,2\n")
    (tmp_path / "old.bag").write_bytes(b"#ROSBAG V1.2\n")
    for name, expected in (
        ("missing.bag", "No such file"),
        ("empty.bag", "got an empty file"),
        ("text.bag", "expected a ROS 1 bag"),
        ("old.bag", "expected a ROS 1 bag"),
        (".", "directory"),
    ):
        with pytest.raises(BagError, match=expected) as error:
            BagFile(tmp_path / name)
        assert "\n" not in str(error.value)


def test_real_bags_of_all_compressions_hold_the_same_messages(shared_data):
    folder = shared_data / "bag_fixtures"
    for name in ("example.bag", "example-bz2.bag", "example-lz4.bag"):
        with BagFile(folder / name) as file:
            assert len(list(file.messages())) == 8647
            assert file.notes() == []
    with BagFile(folder / "no-messages.bag") as file:
        assert list(file.messages()) == []
        assert file.notes() == []
