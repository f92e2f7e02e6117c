"""ROS 2 bags made from ROS 1 bags: by the writer of rosbags, and all variants of MCAP."""

import inspect
import sqlite3
import struct
from pathlib import Path

import yaml
from rosbags import rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from map_racing.bags import messages as msg
from map_racing.bags.opening import open_bag

MCAP_MAGIC = b"\x89MCAP0\r\n"


def ros2_types(definitions=None):
    """ROS 2 message types, including those of racing."""
    types = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in (definitions or msg.DEFINITIONS).items():
        known = get_types_from_msg(text, name)
        types.register({key: value for key, value in known.items() if key not in types.types})
    return types


def messages_of(source, begin=0, end=2**63):
    """Topic, ROS 2 type, time of receipt and CDR data of the messages of a ROS 1 bag."""
    types = ros2_types()
    with open_bag(source) as bag:
        for message in bag.messages():
            if begin <= message.time_ns < end:
                topic, kind = bag.connections[message.connection][:2]
                kind = kind.replace("/", "/msg/")
                data = bytes(types.ros1_to_cdr(bytes(message.data), kind))
                yield topic, kind, message.time_ns, data


def write_sqlite(path, messages, compression=None):
    """A folder as `ros2 bag record` makes it, by the writer of rosbags."""
    types = ros2_types()
    versions = {"version": 8} if "version" in inspect.signature(rosbag2.Writer).parameters else {}
    writer = rosbag2.Writer(path, **versions)
    if compression:
        # rosbags moved them from the class to the package.
        modes = getattr(rosbag2, "CompressionMode", None) or writer.CompressionMode
        formats = getattr(rosbag2, "CompressionFormat", None) or writer.CompressionFormat
        writer.set_compression(modes[compression.upper()], formats.ZSTD)
    with writer:
        topics = {}
        for topic, kind, time_ns, data in messages:
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, kind, typestore=types)
            writer.write(topics[topic], time_ns, data)
    return path


def forget_definitions(path):
    """A bag as before ROS 2 Iron, without the definitions of messages."""
    for file in path.glob("*.db3"):
        database = sqlite3.connect(str(file))
        database.execute("DROP TABLE message_definitions")
        database.execute("DROP TABLE schema")
        database.commit()
        database.close()
    return path


def together(path, parts):
    """One bag from the files of several, as a recorder splits it."""
    path.mkdir()
    metadata = None
    for part in parts:
        own = yaml.safe_load((part / "metadata.yaml").read_text())
        own = own["rosbag2_bagfile_information"]
        for name in own["relative_file_paths"]:
            (part / name).rename(path / name)
        if metadata is None:
            metadata = own
            continue
        metadata["relative_file_paths"] += own["relative_file_paths"]
        end = own["starting_time"]["nanoseconds_since_epoch"] + own["duration"]["nanoseconds"]
        start = metadata["starting_time"]["nanoseconds_since_epoch"]
        metadata["duration"]["nanoseconds"] = end - start
        counts = {
            entry["topic_metadata"]["name"]: entry["message_count"]
            for entry in own["topics_with_message_count"]
        }
        for entry in metadata["topics_with_message_count"]:
            entry["message_count"] += counts.get(entry["topic_metadata"]["name"], 0)
    text = yaml.safe_dump({"rosbag2_bagfile_information": metadata})
    (path / "metadata.yaml").write_text(text)
    return path


def _record(op, contents):
    return struct.pack("<BQ", op, len(contents)) + contents


def _text(value):
    data = value if isinstance(value, bytes) else value.encode()
    return struct.pack("<I", len(data)) + data


def write_mcap(
    path, messages, compress=None, name="", per_chunk=100, summary=True, index=True, types=None
):
    """A file of MCAP; ``per_chunk=0`` writes no chunks. The writer of rosbags cannot write MCAP on
    3.8."""
    types, numbers, heads, counts, times = types or ros2_types(), {}, [], {}, []
    parts, chunk, chunks, entries = [_record(1, _text("ros2") + _text("test"))], [], [], {}
    at = len(MCAP_MAGIC) + len(parts[0])

    def close_chunk():
        nonlocal at
        contents = b"".join(chunk)
        packed = compress(contents) if compress else contents
        body = struct.pack("<QQQI", times[0], times[-1], len(contents), 0) + _text(name)
        record = _record(6, body + struct.pack("<Q", len(packed)) + packed)
        chunks.append(struct.pack("<QQQQ", times[0], times[-1], at, len(record)))
        parts.append(record)
        for number, places in entries.items() if index else ():
            pairs = b"".join(struct.pack("<QQ", time, place) for time, place in places)
            parts.append(_record(7, struct.pack("<H", number) + _text(pairs)))
        at += sum(map(len, parts[-1 - (len(entries) if index else 0) :]))
        chunk.clear()
        entries.clear()

    for topic, kind, time_ns, data in messages:
        if topic not in numbers:
            number = numbers[topic] = len(numbers) + 1
            definition = types.generate_msgdef(kind, ros_version=2)[0]
            schema = struct.pack("<H", number) + _text(kind) + _text("ros2msg") + _text(definition)
            channel = struct.pack("<HH", number, number) + _text(topic) + _text("cdr") + _text("")
            heads.append(_record(3, schema) + _record(4, channel))
            chunk.append(heads[-1])
        number = numbers[topic]
        counts[number] = counts.get(number, 0) + 1
        times.append(time_ns)
        places = entries.setdefault(number, [])
        places.append((time_ns, sum(map(len, chunk))))
        chunk.append(_record(5, struct.pack("<HIQQ", number, 0, time_ns, time_ns) + data))
        if len(chunk) >= per_chunk > 0:
            close_chunk()
    if per_chunk:
        if chunk:
            close_chunk()
    else:
        parts += chunk
        at += sum(map(len, chunk))
    parts.append(_record(15, struct.pack("<I", 0)))
    start = at + len(parts[-1])
    if summary:
        counted = b"".join(struct.pack("<HQ", *item) for item in counts.items())
        totals = struct.pack(
            *("<QHIIIIQQ", sum(counts.values()), len(heads), len(heads), 0, 0, len(chunks)),
            *(times[0], times[-1]),
        )
        empty = _text("") + struct.pack("<Q", 0) + _text(name) + struct.pack("<QQ", 0, 0)
        parts += heads + [_record(8, chunk + empty) for chunk in chunks]
        parts.append(_record(11, totals + _text(counted)))
    parts.append(_record(2, struct.pack("<QQI", start if summary else 0, 0, 0)))
    Path(path).write_bytes(b"".join([MCAP_MAGIC, *parts, MCAP_MAGIC]))
    return path
