"""ROS 2 bags, and bags that are parts of one run: the same results as from one ROS 1 bag."""

import inspect
import json
import re
import shutil
import sqlite3

import lz4.frame
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ros2_bags import (
    forget_definitions,
    messages_of,
    ros2_types,
    together,
    write_mcap,
    write_sqlite,
)
from rosbags import rosbag2

from map_racing.bags import compression, encoding
from map_racing.bags import messages as msg
from map_racing.bags.cdr import Layout, connection_of
from map_racing.bags.compression import decompress
from map_racing.bags.opening import is_bag, open_bag
from map_racing.bags.reader import read_recording, read_signals
from map_racing.bags.waypoints import read_waypoints
from map_racing.bags.writer import BagWriter
from map_racing.cli import main
from map_racing.errors import BagError
from map_racing.identification.data import load_run

T0_NS = 1600000000 * 10**9
CUT_NS = T0_NS + 5 * 10**9


@pytest.fixture(scope="module")
def made(race_bag):
    """The messages of a race of two and a half laps, in CDR."""
    return list(messages_of(race_bag()))


def cut(messages):
    return [[m for m in messages if (m[2] < CUT_NS) is before] for before in (True, False)]


def split(folder, messages, write):
    parts = [write(folder / f"run_{i}", part) for i, part in enumerate(cut(messages))]
    return together(folder / "run", parts)


def as_mcap_of_rosbags(path, messages):
    if not hasattr(rosbag2, "StoragePlugin"):  # rosbags for Python 3.8 cannot write it
        return write_mcap(path.with_suffix(".mcap"), messages)
    plain = rosbag2.Writer

    def writer(path, version):
        return plain(path, version=version, storage_plugin=rosbag2.StoragePlugin.MCAP)

    writer.__signature__ = inspect.signature(plain)
    rosbag2.Writer = writer
    try:
        return write_sqlite(path, messages)
    finally:
        rosbag2.Writer = plain


def without_metadata(path):
    (path / "metadata.yaml").unlink()
    return path


KINDS = {
    "sqlite": lambda folder, m: write_sqlite(folder / "run", m),
    "db3 alone": lambda folder, m: next(write_sqlite(folder / "run", m).glob("*.db3")),
    "metadata.yaml": lambda folder, m: write_sqlite(folder / "run", m) / "metadata.yaml",
    "by file": lambda folder, m: write_sqlite(folder / "run", m, "file"),
    "by message": lambda folder, m: write_sqlite(folder / "run", m, "message"),
    "before Iron": lambda folder, m: forget_definitions(write_sqlite(folder / "run", m)),
    "split": lambda folder, m: split(folder, m, write_sqlite),
    "split by file": lambda folder, m: split(folder, m, lambda p, n: write_sqlite(p, n, "file")),
    "mcap": lambda folder, m: as_mcap_of_rosbags(folder / "run", m),
    "mcap alone": lambda folder, m: write_mcap(folder / "run.mcap", m),
    "mcap lz4": lambda folder, m: write_mcap(
        folder / "run.mcap", m, compress=lz4.frame.compress, name="lz4"
    ),
    "mcap without chunks": lambda folder, m: write_mcap(folder / "run.mcap", m, per_chunk=0),
    "mcap without index": lambda folder, m: write_mcap(
        folder / "run.mcap", m, index=False, summary=False
    ),
}


def evaluated(folder, *paths):
    """What `evaluate` writes as JSON, without the names of the files."""
    report = folder / "laps.json"
    assert main(["evaluate", *map(str, paths), "--json", str(report)]) == 0
    runs = json.loads(report.read_text())["runs"]
    for run in runs:
        run["bag"] = ""
    return runs


@pytest.fixture(scope="module")
def expected(race_bag, tmp_path_factory):
    return evaluated(tmp_path_factory.mktemp("expected"), race_bag())


def assert_many_at_once_are_those_one_by_one(path):
    with open_bag(path) as bag:
        messages = list(bag.messages(set(bag.connections)))
        notes = bag.notes()
        batches = list(bag.batches(set(bag.connections)))
        assert [message for batch in batches for message in batch] == messages
        assert bag.notes() == notes


@pytest.mark.parametrize("kind", KINDS)
def test_a_bag_of_ros_2_gives_the_same_laps(kind, made, expected, race_bag, tmp_path):
    path = KINDS[kind](tmp_path, made)
    assert is_bag(path)
    assert_many_at_once_are_those_one_by_one(path)
    assert evaluated(tmp_path, path) == expected
    ours, theirs = read_recording(path), read_recording(race_bag())
    for one, other in zip(
        read_signals(path, ours, {"imu": ""})["imu"][1].values(),
        read_signals(race_bag(), theirs, {"imu": ""})["imu"][1].values(),
    ):
        np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(
        read_recording(path, "/tf").x, read_recording(race_bag(), "/tf").x
    )
    for name, column in read_waypoints(race_bag()).columns.items():
        np.testing.assert_array_equal(read_waypoints(path).columns[name], column)


NAMES = st.text(st.characters(min_codepoint=1, blacklist_categories=["Cs"]), max_size=12)
NUMBERS = st.floats(-1e6, 1e6)
ENCODED = {
    msg.ODOMETRY: lambda name, other, v: encoding.encode_odometry(0, T0_NS, name, other, *v[:6]),
    msg.POSE: lambda name, other, v: encoding.encode_pose(0, T0_NS, name, *v[:3]),
    msg.ACKERMANN: lambda name, other, v: encoding.encode_drive(0, T0_NS, name, *v[:5]),
    msg.IMU: lambda name, other, v: encoding.encode_imu(0, T0_NS, name, *v[:4]),
    msg.TF: lambda name, other, v: encoding.encode_transform(0, T0_NS, name, other, *v[:3]),
    msg.WAYPOINTS: lambda name, other, v: encoding.encode_waypoints(0, T0_NS, name, [v, v[::-1]]),
}
TYPES = ros2_types()


@pytest.mark.parametrize("kind", ENCODED)
@settings(max_examples=30, deadline=None)
@given(name=NAMES, other=NAMES, values=st.lists(NUMBERS, min_size=10, max_size=10))
def test_messages_are_rearranged_as_rosbags_does(kind, name, other, values):
    original = ENCODED[kind](name, other, values)
    name = kind.replace("/", "/msg/")
    rearrange = Layout(connection_of("/t", name, ""))
    data = bytes(TYPES.ros1_to_cdr(original, name))
    assert rearrange(data) == original
    for end in range(0, len(data) - 4, 7):  # damaged messages never raise
        rearrange(data[:end])


@pytest.mark.parametrize("kind", ENCODED)
@settings(max_examples=30, deadline=None)
@given(data=st.data(), name=NAMES, other=NAMES)
def test_many_messages_are_rearranged_as_each_alone(kind, data, name, other):
    original = ENCODED[kind](name, other, [float(i) for i in range(10)])
    kind = kind.replace("/", "/msg/")
    connection = connection_of("/t", kind, "")
    rows = np.tile(np.frombuffer(TYPES.ros1_to_cdr(original, kind), np.uint8), (4, 1))
    rows = rows[:, : data.draw(st.integers(1, rows.shape[1]) | st.just(rows.shape[1]))].copy()
    for row in rows[data.draw(st.integers(0, 3)) :]:
        # Anywhere, or in the lengths of the strings.
        place = st.integers(0, row.size - 1) | st.integers(0, min(row.size - 1, 40))
        row[data.draw(place)] = data.draw(st.integers(0, 255))
    alone = [Layout(connection)(row.tobytes()) for row in rows]
    assert [bytes(row) for row in Layout(connection).all(rows)] == alone
    assert Layout(connection).all([row.tobytes() for row in rows]) == alone


def test_a_damaged_message_costs_no_intact_one():
    original = ENCODED[msg.ODOMETRY]("map", "base_link", [0.0] * 6)
    intact = bytes(TYPES.ros1_to_cdr(original, "nav_msgs/msg/Odometry"))
    child = intact.index(b"base_link") - 4
    damaged = intact[:child] + b"\xff\xff\0\0" + intact[child + 4 :]
    rearrange = Layout(connection_of("/t", "nav_msgs/msg/Odometry", ""))
    assert [rearrange(data) for data in (intact, damaged, intact)] == [original, b"", original]


def test_paths_and_float64(tmp_path):
    make = TYPES.types
    stamp = make["builtin_interfaces/msg/Time"](sec=7, nanosec=8)
    header = make["std_msgs/msg/Header"](stamp=stamp, frame_id="map")
    poses = [
        make["geometry_msgs/msg/PoseStamped"](
            header=make["std_msgs/msg/Header"](stamp=stamp, frame_id="m" * i),
            pose=make["geometry_msgs/msg/Pose"](
                position=make["geometry_msgs/msg/Point"](x=float(i), y=2.0 * i, z=0.0),
                orientation=make["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
            ),
        )
        for i in range(9)
    ]
    path = make["nav_msgs/msg/Path"](header=header, poses=poses)
    data = bytes(TYPES.serialize_cdr(path, "nav_msgs/msg/Path"))
    columns = msg.decode_path(Layout(connection_of("/p", "nav_msgs/msg/Path", ""))(data))
    np.testing.assert_array_equal(columns["x_m"], np.arange(9.0))
    number = make["std_msgs/msg/Float64"](data=0.25)
    data = bytes(TYPES.serialize_cdr(number, "std_msgs/msg/Float64"))
    rearrange = Layout(connection_of("/f", "std_msgs/msg/Float64", ""))
    assert msg.decode_float64([rearrange(data)])[1][0, 0] == 0.25
    assert rearrange(b"\0\0" + data[2:]) == b""  # of the other byte order


def test_waypoints_of_another_version_are_read_by_their_definition(tmp_path):
    definitions = dict(msg.DEFINITIONS)
    definitions["f110_msgs/msg/Wpnt"] = "float64 x_m\nfloat64 y_m\nint8 lane\nfloat64 vx_mps\n"
    types = ros2_types(definitions)
    make = types.types
    stamp = make["builtin_interfaces/msg/Time"](sec=7, nanosec=8)
    waypoints = [
        make["f110_msgs/msg/Wpnt"](x_m=float(i), y_m=-float(i), lane=1, vx_mps=3.0)
        for i in range(5)
    ]
    message = make["f110_msgs/msg/WpntArray"](
        header=make["std_msgs/msg/Header"](stamp=stamp, frame_id="map"), wpnts=waypoints
    )
    kind = "f110_msgs/msg/WpntArray"
    definition = types.generate_msgdef(kind, ros_version=2)[0]
    assert not connection_of("/w", kind, definition).md5sum
    path = write_mcap(
        *(tmp_path / "a.mcap", [("/w", kind, T0_NS, bytes(types.serialize_cdr(message, kind)))]),
        types=types,
    )
    columns = read_waypoints(path).columns
    assert sorted(columns) == ["vx_mps", "x_m", "y_m"]
    np.testing.assert_array_equal(columns["y_m"], -np.arange(5.0))


@pytest.mark.parametrize("share", [0.3, 0.63, 0.97, 0.999])
@pytest.mark.parametrize("packed", [False, True])
def test_a_file_that_was_cut_off_gives_all_complete_messages(made, share, packed, tmp_path):
    options = {"compress": lz4.frame.compress, "name": "lz4"} if packed else {}
    whole = write_mcap(tmp_path / "whole.mcap", made, **options).read_bytes()
    path = tmp_path / "cut.mcap"
    path.write_bytes(whole[: int(share * len(whole))])
    with open_bag(path) as bag:
        messages = list(bag.messages())
        assert sum(bag.counts.values()) == len(messages)
        (note,) = bag.notes()
    assert "damaged bag" in note or "not closed" in note
    assert [m.time_ns for m in messages] == [m[2] for m in made[: len(messages)]]
    # Chunks hold a hundred messages; the first is the largest.
    assert len(messages) >= share * len(made) - 250
    assert read_recording(path).t.size > 0.2 * share * len(messages) - 1


def test_a_file_that_was_cut_off_in_the_index_of_a_chunk_loses_no_messages(made, tmp_path):
    """The index of the requested topic may be beyond the cut."""
    path = write_mcap(tmp_path / "run.mcap", made, per_chunk=2 * len(made), summary=False)
    whole = path.read_bytes()
    # Compare each topic alone in the whole file and in one whose index is cut.
    with open_bag(path) as bag:
        expected = {c.topic: len(list(bag.messages({n}))) for n, c in bag.connections.items()}
    index = whole.index(b"\x07", len(write_mcap(path, made, index=False).read_bytes()) - 100)
    for end in (index + 9, index + 100, (index + len(whole)) // 2, len(whole) - 80):
        path.write_bytes(whole[:end])
        with open_bag(path) as bag:
            found = {c.topic: len(list(bag.messages({n}))) for n, c in bag.connections.items()}
        assert found == expected


def test_transforms_alone_are_no_doubt_about_what_was_read(tmp_path):
    with BagWriter(tmp_path / "run.bag") as bag:
        for i in range(400):
            bag.transform(T0_NS + i * 25000000, 0.1 * i, 0.0, 0.0)
    recording = read_recording(write_sqlite(tmp_path / "run", messages_of(tmp_path / "run.bag")))
    assert recording.topic == "/tf" and not any("warning" in note for note in recording.notes)


@pytest.fixture(scope="module")
def small(made, tmp_path_factory):
    """Contents of small files of both formats."""
    folder = tmp_path_factory.mktemp("small")
    (database,) = write_sqlite(folder / "run", made[:150]).glob("*.db3")
    packed = {"compress": lz4.frame.compress, "name": "lz4"}
    return {
        ".mcap": write_mcap(folder / "a.mcap", made[:150], per_chunk=40, **packed).read_bytes(),
        ".db3": database.read_bytes(),
    }


@pytest.mark.parametrize("kind", [".mcap", ".db3"])
@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_damage_is_never_an_error_of_the_program(kind, small, data, tmp_path):
    contents = bytearray(small[kind])
    for _ in range(data.draw(st.sampled_from([1, 1, 3, 20]))):
        # Beginning and end contain the references to the rest.
        place = st.one_of(
            st.integers(0, len(contents) - 1), st.integers(0, 400), st.integers(-600, -1)
        )
        contents[data.draw(place)] = data.draw(st.integers(0, 255))
    if data.draw(st.integers(0, 4)) == 0:
        del contents[data.draw(st.integers(1, len(contents))) :]
    path = tmp_path / f"damaged{kind}"
    path.write_bytes(bytes(contents))
    for read in (read_recording, read_waypoints, assert_many_at_once_are_those_one_by_one):
        try:
            read(path)
        except BagError as error:
            assert "\n" not in str(error)


def test_chunks_of_an_unknown_compression_are_called_that(race_bag, tmp_path):
    messages = messages_of(race_bag())
    write_mcap(tmp_path / "a.mcap", messages, compress=lambda data: data[::-1], name="xz")
    with pytest.raises(BagError, match="chunks left out, compressed by xz: expected bz2, lz4"):
        read_recording(tmp_path / "a.mcap")


def test_damage_in_the_middle_costs_one_chunk(made, tmp_path):
    path = write_mcap(tmp_path / "a.mcap", made)
    data = bytearray(path.read_bytes())
    at = data.index(b"\x06", len(data) // 2)
    for place in range(at, at + 200):
        data[place] = 0xFF
    path.write_bytes(bytes(data))
    with open_bag(path) as bag:
        count = sum(1 for _ in bag.messages())
        assert len(made) - 310 <= count < len(made)
        assert "damage" in bag.notes()[0]


def test_a_folder_that_was_never_closed(made, expected, tmp_path):
    path = without_metadata(write_sqlite(tmp_path / "run", made))
    (run,) = evaluated(tmp_path, path)
    assert run["laps"] == expected[0]["laps"]
    assert any("not closed" in note for note in run["notes"])


def test_a_journal_that_a_killed_recorder_left_is_read(made, expected, tmp_path):
    (closed,) = write_sqlite(tmp_path / "run", made).glob("*.db3")
    open_ = tmp_path / "open"
    open_.mkdir()
    recording = sqlite3.connect(str(open_ / "open_0.db3"))
    recording.execute("PRAGMA journal_mode = WAL")
    source = sqlite3.connect(str(closed))
    recording.executescript("\n".join(source.iterdump()))
    recording.commit()
    killed = tmp_path / "killed"
    shutil.copytree(str(open_), str(killed))
    (killed / "open_0.db3-shm").unlink()
    assert (killed / "open_0.db3-wal").stat().st_size > 100000
    for database in (recording, source):
        database.close()
    (run,) = evaluated(tmp_path, killed)
    assert run["laps"] == expected[0]["laps"]


def test_what_is_no_bag_of_ros_2(made, tmp_path):
    folder = split(tmp_path, made, write_sqlite)
    (folder / "run_1.db3").unlink()
    with pytest.raises(BagError, match=r"part of the bag is missing: run_1\.db3"):
        open_bag(folder)
    (tmp_path / "text.db3").write_text("hello" * 10)
    with pytest.raises(BagError, match="expected a ROS 2 bag"):
        open_bag(tmp_path / "text.db3")
    (tmp_path / "empty.mcap").touch()
    with pytest.raises(BagError, match="an empty file"):
        open_bag(tmp_path / "empty.mcap")
    (tmp_path / "nothing").mkdir()
    with pytest.raises(BagError, match=r"without \.db3"):
        open_bag(tmp_path / "nothing")
    assert not is_bag(tmp_path / "nothing")
    damaged = folder / "run_0.db3"
    data = bytearray(damaged.read_bytes())
    data[100:] = b"\xff" * len(data[100:])
    damaged.write_bytes(bytes(data))
    with pytest.raises(BagError, match=r"run_0\.db3: cannot read the bag"):
        open_bag(damaged)


def test_zstd_that_is_cut_off_is_decompressed_as_far_as_it_goes(made, tmp_path):
    (path,) = write_sqlite(tmp_path / "run", made, "file").glob("*.zstd")
    data = path.read_bytes()
    contents, sound = decompress("zstd", data)
    assert sound and contents.startswith(b"SQLite")
    part, sound = decompress("zstd", data[: len(data) // 2])
    assert not sound and contents.startswith(part)
    assert decompress("zstd", b"junk") == (b"", False)
    assert decompress("other", b"junk") == (b"", False)


# -- parts of one run --------------------------------------------------------------------------


def write_parts(folder, source, cuts):
    """Bags of ROS 1 with the messages between the cuts, as a recorder splits them."""
    paths = []
    with open_bag(source) as bag:
        messages = list(bag.messages())
        topics = bag.connections
    for number, (begin, end) in enumerate(zip([0, *cuts], [*cuts, 2**63])):
        paths.append(folder / f"run_{number}.bag")
        with BagWriter(paths[-1]) as writer:
            for message in messages:
                if begin <= message.time_ns < end:
                    topic, kind = topics[message.connection][:2]
                    writer._write(topic, kind, T0_NS, message.time_ns, _copied, (message.data,))
    return paths


def _copied(seq, stamp, data):
    return bytes(data)


def test_parts_of_a_run_are_one_run(made, expected, race_bag, tmp_path):
    paths = write_parts(tmp_path, race_bag(), [CUT_NS, CUT_NS + 3 * 10**9])
    for order in (paths, paths[::-1]):
        assert evaluated(tmp_path, "--join", *order) == expected
    parts = [write_sqlite(tmp_path / f"part_{i}", part) for i, part in enumerate(cut(made))]
    assert evaluated(tmp_path, "--join", *parts) == expected
    # Without the option they are separate runs, and the lap across the split is in neither.
    (alone,) = evaluated(tmp_path, paths[0])
    assert alone["summary"]["laps_completed"] == 0


def test_parts_of_different_runs(race_bag, tmp_path, capsys):
    first, second, third = write_parts(tmp_path, race_bag(), [CUT_NS, CUT_NS + 3 * 10**9])
    (run,) = evaluated(tmp_path, "--join", first, third)
    assert any("3.0 s missing between run_0.bag and run_2.bag" in note for note in run["notes"])
    assert main(["evaluate", "--join", str(first), str(race_bag())]) == 1
    assert "overlap by" in capsys.readouterr().err
    later = tmp_path / "later.bag"
    with BagWriter(later) as bag:
        bag.odometry(1e-9 * T0_NS + 7200.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0)
    assert main(["evaluate", "--join", str(first), str(later)]) == 1
    assert "s apart: two runs?" in capsys.readouterr().err
    (tmp_path / "a.csv").write_text("t,x,y\n0,0,0\n1,1,1\n")
    assert main(["evaluate", "--join", str(first), str(tmp_path / "a.csv")]) == 1
    assert "--join: expected bags" in capsys.readouterr().err


def test_identification_reads_them_like_one_bag_of_ros_1(ramps, tmp_path):
    messages = list(messages_of(ramps.path))
    middle = messages[len(messages) // 2][2]
    parts = [
        write_mcap(tmp_path / f"{name}.mcap", [m for m in messages if (m[2] < middle) is first])
        for name, first in (("late", False), ("early", True))
    ]
    for source in (write_mcap(tmp_path / "all.mcap", messages), parts):
        run = load_run(source)
        assert run.signals.keys() == ramps.run.signals.keys()
        for name, (t, values) in ramps.run.signals.items():
            np.testing.assert_array_equal(run.signals[name].t, t)
            np.testing.assert_array_equal(run.signals[name].value, values)


@pytest.mark.parametrize("fast", [True, False])
def test_slow_decompression_of_messages_is_said_once(fast, monkeypatch, caplog):
    monkeypatch.setattr(compression, "_zstd", lambda: (None, bytes.upper, fast))
    compression._message_decompressor.cache_clear()
    try:
        assert [compression.decompress_message(b"a") for _ in range(3)] == [b"A"] * 3
    finally:
        compression._message_decompressor.cache_clear()
    assert caplog.text.count("map_racing[zstd]") == (0 if fast else 1)


@pytest.mark.rest_once
@pytest.mark.parametrize("rate", [10.0, 40.0, 100.0])
@pytest.mark.parametrize("write", [write_sqlite, write_mcap])
def test_commands_of_two_nodes_that_the_bag_does_not_name_are_doubted(tmp_path, write, rate):
    """A joystick commands standstill while a controller drives."""
    with BagWriter(tmp_path / "a.bag") as bag:
        for i in range(800):
            t = 1600000000.0 + 0.025 * i
            bag.odometry(t, 5.0 * t % 100.0, 0.0, 0.0, 5.0, 0.0, 0.0)
            bag.drive(t, 0.3 * np.sin(0.05 * i), 5.0)
        for i in range(int(20.0 * rate)):
            bag.drive(1600000000.003 + i / rate, 0.0, 0.0)
    messages = sorted(messages_of(tmp_path / "a.bag"), key=lambda message: message[2])
    suffix = "" if write is write_sqlite else ".mcap"
    notes = read_recording(write(tmp_path / f"b{suffix}", messages)).notes
    assert [note for note in notes if note.startswith("warning:") and "from two nodes?" in note]


def test_commands_of_one_node_are_not_doubted(made, tmp_path):
    notes = read_recording(write_sqlite(tmp_path / "b", made)).notes
    assert not any("from two nodes?" in note for note in notes)


def test_an_error_in_a_compressed_file_names_the_file_that_was_given(made, tmp_path):
    (path,) = write_sqlite(tmp_path / "run", made, "file").glob("*.zstd")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(BagError, match=re.escape(str(path))):
        open_bag(path)
