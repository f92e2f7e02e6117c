"""Settings and states of the controller in a bag."""

import struct

import pytest
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

from map_racing.bags import messages as msg
from map_racing.bags.cdr import Layout, connection_of
from map_racing.bags.reader import read_recording
from map_racing.bags.remarks import read_remarks
from map_racing.bags.writer import BagWriter
from map_racing.control.decision import Decision, Mode, Reason, state_level, state_text
from map_racing.control.state import CarState
from map_racing.simulation.car import Sample
from map_racing.simulation.race import Outcome, RaceLog
from map_racing.simulation.recorded import write_race_bag

TYPES = get_typestore(Stores.ROS1_NOETIC)


def test_md5_sums_are_those_of_the_definitions():
    for kind in (msg.STRING, msg.DIAGNOSTICS):
        package, name = kind.split("/")
        assert TYPES.generate_msgdef(f"{package}/msg/{name}")[1] == msg.MD5[kind]


def test_settings_on_the_clock_of_the_poses(tmp_path):
    path = tmp_path / "run.bag"
    with BagWriter(path) as bag:
        bag.text(99.0, "a: 1")
        bag.text(99.5, "a: 1")
        for i in range(100):
            bag.odometry(100.0 + 0.025 * i, 0.1 * i, 0.0, 0.0, 4.0, 0.0, 0.0)
        bag.text(101.0, "a: 2 für ü")
    remarks = read_remarks(path, read_recording(path))
    assert remarks.settings == [(-1.0, "a: 1"), (pytest.approx(1.0), "a: 2 für ü")]
    assert remarks.states == []


def diagnostics(stamp, *statuses):
    types = TYPES.types
    key = types["diagnostic_msgs/msg/KeyValue"]
    status = types["diagnostic_msgs/msg/DiagnosticStatus"]
    header = types["std_msgs/msg/Header"](0, types["builtin_interfaces/msg/Time"](stamp, 0), "")
    array = types["diagnostic_msgs/msg/DiagnosticArray"](
        header,
        [
            status(2, name, text, hardware, [key("mode", "driving"), key("pose age", "0.1")])
            for name, text, hardware in statuses
        ],
    )
    return TYPES.serialize_ros1(array, "diagnostic_msgs/msg/DiagnosticArray")


@pytest.mark.parametrize(
    ("name", "hardware"), [("controller: state", "NUC4"), ("controller: driving", "map_racing")]
)
def test_states_of_the_controller(tmp_path, name, hardware):
    path = tmp_path / "run.bag"
    with BagWriter(tmp_path / "poses.bag") as bag:
        for i in range(100):
            bag.odometry(100.0 + 0.025 * i, 0.1 * i, 0.0, 0.0, 4.0, 0.0, 0.0)
    recording = read_recording(tmp_path / "poses.bag")
    lidar = ("lidar: state", "dirty", "hokuyo")
    with Writer(path) as writer:
        line = writer.add_connection(
            "/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", typestore=TYPES
        )
        texts = ["driving", "driving", "stopping: stale pose", "stopped: stale pose", "driving"]
        for i, text in enumerate(texts):
            ours = (name, text, hardware)
            data = diagnostics(100 + i, lidar, ours)
            writer.write(line, (100 + i) * 10**9, data)
            writer.write(line, (100 + i) * 10**9 + 1, diagnostics(100 + i, lidar))
        writer.write(line, 106 * 10**9, bytes(data[:-20]))
    assert read_remarks(path, recording).states == [
        (pytest.approx(0.0), "driving"),
        (pytest.approx(2.0), "stopping: stale pose"),
        (pytest.approx(3.0), "stopped: stale pose"),
        (pytest.approx(4.0), "driving"),
    ]


def test_states_of_a_supervised_race(tmp_path, track):
    """The bag has the diagnostics of the controller's node."""
    driving = Decision(Mode.DRIVING, Reason.NONE, 0.0, 3.0)
    stopping = Decision(Mode.STOPPING, Reason.STALE_POSE, 0.0, 1.0)
    line = track.raceline()
    states = [CarState(0.025 * i, 0.1 * i, 0.0, 0.0, 4.0, 0.0, 0.0) for i in range(8)]
    samples = [Sample(s, s, s.t, (0.0, 0.0), 0.0, driving) for s in states]
    commands = [(0.01, driving), (0.06, stopping), (0.08, stopping), (0.15, driving)]
    log = RaceLog(Outcome.COMPLETED, 0, 0.2, samples, commands)
    path = tmp_path / "race.bag"
    write_race_bag(path, log, line)
    states = read_remarks(path, read_recording(path)).states
    assert [text for _, text in states] == ["driving", "stopping: pose too old", "driving"]
    assert [t for t, _ in states] == pytest.approx([0.01, 0.06, 0.15], abs=0.02)


def test_stops_are_those_of_the_race(tmp_path, track):
    """A car that already stands counts as stopped, too; a new reason does not count again."""
    told = [
        (Mode.STOPPED, Reason.STOP_REQUESTED),  # before the recording
        (Mode.DRIVING, Reason.NONE),
        (Mode.STOPPING, Reason.STALE_POSE),
        (Mode.STOPPING, Reason.JUMP),
        (Mode.STOPPED, Reason.JUMP),
        (Mode.DRIVING, Reason.NONE),
        (Mode.STOPPED, Reason.BLOCKED),
        (Mode.WAITING, Reason.NO_POSE),
    ]
    states = [CarState(0.1 * i, 0.4 * i, 0.0, 0.0, 4.0, 0.0, 0.0) for i in range(len(told))]
    samples = [Sample(s, s, s.t, (0.0, 0.0), 0.0, Decision(*told[0], 0.0, 0.0)) for s in states]
    commands = [(0.1 * i, Decision(*each, 0.0, 0.0)) for i, each in enumerate(told)]
    log = RaceLog(Outcome.STALLED, 0, 0.7, samples, commands)
    path = tmp_path / "race.bag"
    write_race_bag(path, log, track.raceline())
    stops = read_remarks(path, read_recording(path)).stops
    assert stops == pytest.approx([0.2, 0.6])
    assert stops == pytest.approx([t for t, _, _ in log.stops()][1:])


def test_levels_of_a_supervised_race(tmp_path, track):
    """As in the node: driving is OK; waiting and requested stops are warnings."""
    told = {
        (Mode.WAITING, Reason.NO_POSE): 1,
        (Mode.DRIVING, Reason.NONE): 0,
        (Mode.STOPPING, Reason.STOP_REQUESTED): 1,
        (Mode.STOPPED, Reason.STOP_REQUESTED): 1,
        (Mode.STOPPING, Reason.FAILURE): 2,
        (Mode.STOPPED, Reason.FAILURE): 2,
    }
    assert [state_level(*each) for each in told] == list(told.values())
    states = [CarState(0.1 * i, 0.4 * i, 0.0, 0.0, 4.0, 0.0, 0.0) for i in range(len(told))]
    commands = [(0.1 * i, Decision(*each, 0.0, 0.0)) for i, each in enumerate(told)]
    samples = [Sample(s, s, s.t, (0.0, 0.0), 0.0, commands[0][1]) for s in states]
    path = tmp_path / "race.bag"
    write_race_bag(path, RaceLog(Outcome.STALLED, 0, 0.5, samples, commands), track.raceline())
    with Reader(path) as bag:
        lines = [line for line in bag.connections if line.topic == "/diagnostics"]
        found = [
            TYPES.deserialize_ros1(data, "diagnostic_msgs/msg/DiagnosticArray").status[0]
            for _, _, data in bag.messages(lines)
        ]
    assert [(status.message, status.level) for status in found] == [
        (state_text(*each), level) for each, level in told.items()
    ]


def test_every_mode_of_the_supervisor_is_a_state(tmp_path):
    texts = [state_text(mode, Reason.GRIP) for mode in Mode]
    with BagWriter(tmp_path / "run.bag") as bag:
        for i in range(100):
            bag.odometry(100.0 + 0.025 * i, 0.1 * i, 0.0, 0.0, 4.0, 0.0, 0.0)
        for i, text in enumerate(texts):
            bag.state(100.5 + i, text, 2)
    found = read_remarks(tmp_path / "run.bag", read_recording(tmp_path / "run.bag")).states
    assert [text for _, text in found] == texts


def test_a_text_that_is_cut_off():
    with pytest.raises(struct.error):
        msg.decode_string(struct.pack("<I", 10) + b"abc")


@pytest.mark.parametrize("name", ["a", "four", "names", "of many lengths"])
def test_texts_of_ros2_in_the_layout_of_ros1(name):
    """Every alignment of the strings."""
    status = TYPES.types["diagnostic_msgs/msg/DiagnosticStatus"]
    key = TYPES.types["diagnostic_msgs/msg/KeyValue"]
    types = get_typestore(Stores.ROS2_HUMBLE)
    stamp = types.types["builtin_interfaces/msg/Time"](7, 8)
    header = types.types["std_msgs/msg/Header"](stamp, name)
    statuses = [status(1, name, "stopped", "map_racing", [key(name, ""), key("", name)])] * 2
    array = types.types["diagnostic_msgs/msg/DiagnosticArray"](header, statuses)
    data = bytes(types.serialize_cdr(array, "diagnostic_msgs/msg/DiagnosticArray"))
    connection = connection_of("/diagnostics", "diagnostic_msgs/msg/DiagnosticArray", "")
    found = msg.decode_diagnostics(Layout(connection)(data))
    assert found == (7 * 10**9 + 8, [(name, "stopped", "map_racing")] * 2)
    text = types.types["std_msgs/msg/String"](name)
    text = bytes(types.serialize_cdr(text, "std_msgs/msg/String"))
    connection = connection_of("settings", "std_msgs/msg/String", "")
    assert msg.decode_string(Layout(connection)(text)) == (name, 4 + len(name))
