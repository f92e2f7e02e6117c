"""Stamps of other clocks, and stamps that are worse than the times of receipt."""

import math

import numpy as np
import pytest

from map_racing.bags import encoding
from map_racing.bags import messages as msg
from map_racing.bags.bag import Connection, Message, batched
from map_racing.bags.lags import lag_of_effect
from map_racing.bags.reader import read_recording, read_signals
from map_racing.bags.series import Series, commands_of_two
from map_racing.bags.topics import DRIVE_TOPIC
from map_racing.bags.writer import BagWriter
from map_racing.errors import BagError
from map_racing.evaluation.doubts import doubts_of
from map_racing.evaluation.pose_doubts import to_and_fro

T0 = 1600000000.0
COUNT = 200


def write(path, offset=0.0, topic=None, stamp=lambda i, t: t, received=lambda i, t: t + 0.001):
    """Pose, command and IMU at 40 Hz; the stamps of one topic are late by `offset`."""

    def shifted(name, i, t):
        return stamp(i, t) + (offset if name == topic else 0.0)

    with BagWriter(path) as bag:
        for i in range(COUNT):
            t = T0 + 0.025 * i
            at = received(i, t)
            bag.odometry(shifted("pose", i, t), i, 0.0, 0.0, 1.0, 0.0, 0.0, received=at)
            bag.drive(shifted("drive", i, t), 0.001 * i, float(i), received=at)
            bag.imu(shifted("imu", i, t), float(i), 0.0, 0.0, received=at)
    return path


@pytest.mark.parametrize("topic", ["drive", "imu", "pose"])
@pytest.mark.parametrize("offset", [-3e7, -1.0, -0.3, 0.3, 1.0, 3e7, 0.1])
def test_topics_of_another_clock_are_brought_to_the_pose(tmp_path, topic, offset):
    path = write(tmp_path / "a.bag", offset, topic)
    recording = read_recording(path)
    signals = read_signals(path, recording, {"imu": ""})["imu"]
    np.testing.assert_allclose(recording.t, 0.025 * np.arange(COUNT), atol=1e-6)
    np.testing.assert_allclose(recording.commands.t, recording.t, atol=1e-6)
    np.testing.assert_allclose(signals[0], recording.t, atol=1e-6)
    said = [note for note in recording.notes if note.startswith("warning: ")]
    named = {"drive": DRIVE_TOPIC, "imu": "/vesc/sensors/imu/raw"}
    assert len(said) == (2 if topic == "pose" else 1)
    assert all("from another clock" in note for note in said)
    assert topic == "pose" or named[topic] in said[0]


def test_commands_are_not_received_long_after_they_are_sent(tmp_path):
    """A localization may take a tenth of a second; a node that sends commands does not."""
    recording = read_recording(write(tmp_path / "a.bag", -0.1, "drive"))
    np.testing.assert_allclose(recording.commands.t, recording.t, atol=1e-6)
    assert recording.commands.shifted
    assert any("0.100 s earlier than the poses'" in note for note in recording.notes)
    recording = read_recording(write(tmp_path / "b.bag", -0.03, "drive"))
    assert not recording.commands.shifted


@pytest.mark.parametrize("gone", [False, True])
def test_commands_of_two_nodes(gone):
    """Commands of the first node count, of another one only once the first is gone."""
    connections = {n: Connection(DRIVE_TOPIC, msg.ACKERMANN, "", "", f"/{n}") for n in (0, 1)}
    series, sent = Series(msg.decode_drive, connections=connections), []
    for i in range(COUNT):
        if not (gone and i >= 40):
            data = encoding.encode_drive(i, 10**10 + 10**8 * i, "", 0.0, 4.0, 0.0, 0.0, 0.0)
            sent.append(Message(0, 10**10 + 10**8 * i, data))
        data = encoding.encode_drive(i, 10**10 + 10**8 * i + 1, "", 0.0, 0.0, 0.0, 0.0, 0.0)
        sent.append(Message(1, 10**10 + 10**8 * i + 1, data))
    for batch in batched(iter(sent)):
        series.extend(batch)
    notes = []
    _, (_, speed) = series.columns(notes, DRIVE_TOPIC)
    assert np.count_nonzero(speed == 4.0) == (40 if gone else COUNT)
    left_out = COUNT - np.count_nonzero(speed == 0.0)
    assert f"{left_out} messages of a second sender, /1, left out: only the first, /0" in notes[0]
    took_over = f"warning: {DRIVE_TOPIC}: /0 fell silent, and /1 took its place"
    assert notes[1:] == ([took_over] if gone else [])


def drives(count=1000):
    """Commands of one node, on noisy poses: angles jitter, speeds do not."""
    rng = np.random.default_rng(2)
    t = 0.02 * np.arange(count)
    return 0.2 * np.sin(t) + 0.03 * rng.normal(size=count), 5.0 + np.sin(0.7 * t)


def test_commands_of_one_node_that_trembles_are_not_doubted():
    angle, speed = drives()
    trembling = angle + np.where(np.arange(1000) % 17 < 2, 0.06 * (-1.0) ** np.arange(1000), 0.0)
    for one in (angle, trembling, 0.0 * angle):
        assert commands_of_two("/drive", one, speed) == ""
        assert commands_of_two("/drive", one, np.round(speed)) == ""


@pytest.mark.parametrize(
    ("every", "other", "said"),
    [
        (50, (0.0, 0.0), "20 of the commands"),  # braking once a second
        (3, (0.2, 0.2), "% of the commands"),  # a second node with almost the same commands
        (2, (-0.3, -4.0), "% of the commands"),
        (5, (0.3, 0.0), "of the commands"),  # only the angles differ
    ],
)
def test_commands_of_two_nodes_that_nothing_names(every, other, said):
    angle, speed = drives()
    turn, faster = other
    theirs = np.arange(1000) % every == 1
    stops = other == (0.0, 0.0)
    angle = np.where(theirs, 0.0 if stops else angle + turn, angle)
    speed = np.where(theirs, 0.0 if stops else speed + faster, speed)
    doubt = commands_of_two("/drive", angle, speed)
    assert said in doubt and "differ from those before and after" in doubt


def test_stamps_in_bunches_and_even_receipts(tmp_path):
    path = write(
        tmp_path / "a.bag",
        stamp=lambda i, t: T0 + 0.1 * (i // 4) + 1e-5 * (i % 4),
    )
    recording = read_recording(path)
    assert any("too coarse" in note for note in recording.notes)
    np.testing.assert_allclose(recording.t, 0.025 * np.arange(COUNT), atol=1e-6)


@pytest.mark.parametrize("latency", [0.0, 0.06, 0.14])
def test_latency_is_no_other_clock(tmp_path, latency):
    """A localization that takes long stamps its poses with the time of the scan."""
    path = write(tmp_path / "a.bag", -latency, "pose")
    recording = read_recording(path)
    assert not any(note.startswith("warning") for note in recording.notes)
    np.testing.assert_allclose(recording.commands.t, 0.025 * np.arange(COUNT) + latency, atol=1e-6)


def test_a_bag_played_slowly_and_recorded_again_keeps_its_stamps(tmp_path):
    path = write(tmp_path / "a.bag", received=lambda i, t: T0 + 1e6 + 5.0 * (t - T0))
    recording = read_recording(path)
    assert not any(note.startswith("warning") for note in recording.notes)
    np.testing.assert_array_equal(recording.commands.t, recording.t)
    assert (
        "/car_state/odom: its stamps advance by 0.200 s per second of receipt: lap times follow "
        "the stamps"
    ) in recording.notes


def test_messages_that_overtake_each_other_keep_their_stamps(tmp_path):
    """Pairs in the wrong order, as from a node with several threads."""
    order = np.arange(COUNT) ^ 1
    with BagWriter(tmp_path / "a.bag") as bag:
        for i, k in enumerate(order.tolist()):
            stamp, received = (T0 + 0.025 * j for j in (k, i))
            bag.odometry(stamp, 0.1 * k, 0.0, 0.0, 4.0, 0.0, 0.0, received=received + 0.03)
    recording = read_recording(tmp_path / "a.bag")
    np.testing.assert_allclose(recording.t, 0.025 * np.arange(COUNT), atol=1e-6)
    np.testing.assert_allclose(recording.x, 0.1 * np.arange(COUNT), atol=1e-9)


def test_commands_whose_clock_was_set_meanwhile(tmp_path):
    """Their stamps are first 3 s early, then right for more than half of the time."""

    def stamp(i, t):
        return t - (3.0 if i < 80 else 0.0)

    with BagWriter(tmp_path / "a.bag") as bag:
        for i in range(COUNT):
            t = T0 + 0.025 * i
            bag.odometry(t, i, 0.0, 0.0, 1.0, 0.0, 0.0, received=t + 0.001)
            bag.drive(stamp(i, t), 0.001 * i, float(i), received=t + 0.001)
    recording = read_recording(tmp_path / "a.bag")
    (said,) = [note for note in recording.notes if note.startswith("warning")]
    assert "from another clock than the poses' for a part of the time" in said
    np.testing.assert_allclose(recording.commands.t, recording.t, atol=2e-3)


def test_commands_that_no_receipt_brings_to_the_poses_are_named(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        for i in range(COUNT):
            t = T0 + 0.025 * i
            bag.odometry(t, i, 0.0, 0.0, 1.0, 0.0, 0.0)
            bag.drive(t - 100.0, 0.0, 1.0)
    recording = read_recording(tmp_path / "a.bag")
    assert f"warning: {DRIVE_TOPIC}: all {COUNT} commands are before the poses" in recording.notes


@pytest.mark.parametrize(
    ("stamp", "said"),
    [
        (lambda i, t: math.floor(t), "too coarse"),
        (lambda i, t: t + (30.0 if i >= 100 else 0.0), "jump ahead by 30.0 s"),
        (lambda i, t: t - (0.5 if i >= 100 else 0.0), "jump back by 0.5 s"),
        (lambda i, t: t - (5.0 if i >= 100 else 0.0), "jump back by 5.0 s"),
    ],
)
def test_stamps_that_are_worse_than_the_times_of_receipt(tmp_path, stamp, said):
    path = write(tmp_path / "a.bag", stamp=stamp)
    recording = read_recording(path)
    (note,) = [note for note in recording.notes if "time of receipt used" in note]
    assert said in note
    np.testing.assert_allclose(recording.t, 0.025 * np.arange(COUNT), atol=1e-6)
    np.testing.assert_array_equal(recording.commands.t, recording.t)
    signals = read_signals(path, recording, {"imu": ""})
    np.testing.assert_array_equal(signals["imu"][0], recording.t)


@pytest.mark.parametrize(
    "received",
    [
        lambda i, t: max(t, T0 + 4.0) if i > 80 else t,  # the recorder stalled
        lambda i, t: t + (30.0 if i >= 100 else 0.0),  # the bag was paused while played
        lambda i, t: t + 0.002 * (i % 7),
    ],
)
def test_good_stamps_are_kept_whatever_the_receipts_are(tmp_path, received):
    path = write(tmp_path / "a.bag", received=received)
    recording = read_recording(path)
    assert not any("receipt" in note for note in recording.notes)
    np.testing.assert_allclose(recording.t, 0.025 * np.arange(COUNT), atol=1e-6)
    np.testing.assert_array_equal(recording.commands.t, recording.t)


# -- which pose ----------------------------------------------------------------------------------


def test_a_source_that_stands_still_is_not_preferred(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        for i in range(COUNT):
            t = T0 + 0.025 * i
            bag.odometry(t, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, topic="/car_state/odom")
            bag.odometry(t, i, 0.0, 0.0, 1.0, 0.0, 0.0, topic="/pf/pose/odom")
    recording = read_recording(tmp_path / "a.bag")
    assert recording.topic == "/pf/pose/odom"
    assert "warning: /car_state/odom stands still while /pf/pose/odom moves" in recording.notes
    assert read_recording(tmp_path / "a.bag", "/car_state/odom").topic == "/car_state/odom"


def test_a_source_that_stands_still_gives_way_to_tf(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        for i in range(COUNT):
            t = T0 + 0.025 * i
            bag.odometry(t, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, topic="/car_state/odom")
            bag.transform(t, i, 0.0, 0.0)
    assert read_recording(tmp_path / "a.bag").topic == "/tf"


@pytest.mark.parametrize("static_mount_last", [False, True])
@pytest.mark.parametrize("tf_odometry", [False, True])
def test_odometry_is_placed_by_a_particle_filter(tmp_path, static_mount_last, tf_odometry):
    """It sends map to laser; the laser is 0.3 m ahead; the car drives along y in the map."""
    with BagWriter(tmp_path / "a.bag") as bag:
        for i in range(COUNT):
            t = T0 + 0.025 * i
            if i == (COUNT - 1 if static_mount_last else 0):
                bag.transform(t, 0.3, 0.0, 0.0, parent="base_link", child="laser", static=True)
            if i % 4 == 0:
                bag.transform(t, 5.0, 0.1 * i + 0.3, 0.5 * math.pi, child="laser")
            bag.odometry(t, 0.1 * i, 0.0, 0.0, 4.0, 0.0, 0.0, topic="/odom", frame="odom")
            if tf_odometry:
                bag.transform(t, 0.1 * i, 0.0, 0.0, parent="odom", child="base_link")
    recording = read_recording(tmp_path / "a.bag", "/odom")
    assert recording.frame == "map"
    assert recording.t.size == COUNT - 3
    np.testing.assert_allclose(recording.x, 5.0, atol=1e-9)
    np.testing.assert_allclose(recording.y, 0.1 * np.arange(COUNT - 3), atol=1e-6)
    np.testing.assert_array_equal(recording.v_x, 4.0)
    placed = read_recording(tmp_path / "a.bag")
    np.testing.assert_allclose(placed.x, 5.0, atol=1e-9)


def test_links_of_another_timescale(tmp_path):
    """Simulated time in one link, 2020 in the other."""
    with BagWriter(tmp_path / "a.bag") as bag:
        for i in range(COUNT):
            t = T0 + 0.025 * i
            if i % 4 == 0:
                bag.transform(t - T0 + 1.0, 0.0, 0.1 * i, 0.0, child="odom", received=t)
            bag.transform(t, 1.0, 0.0, 0.0, parent="odom", child="base_link", received=t)
    recording = read_recording(tmp_path / "a.bag")
    assert recording.t.size == COUNT - 3
    np.testing.assert_allclose(recording.y, 0.1 * np.arange(COUNT - 3), atol=1e-6)
    assert any("the stamps are from another clock" in note for note in recording.notes)


def test_a_localization_and_a_static_transform(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        for i in range(COUNT):
            t = T0 + 0.025 * i
            if i == 0:
                bag.transform(t, 0.0, 0.0, 0.0, child="odom", static=True)
            bag.transform(t, 0.0, 2.0, 0.0, child="odom")
            bag.transform(t, i, 0.0, 0.0, parent="odom", child="base_link")
    recording = read_recording(tmp_path / "a.bag")
    np.testing.assert_array_equal(recording.y, 2.0)
    assert any("sent by a localization, which counts" in note for note in recording.notes)


def test_a_single_transform_holds_only_at_its_time(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        for i in range(COUNT):
            t = T0 + 0.025 * i
            if i == 0:
                bag.transform(t, 0.0, 0.0, 0.0, child="odom")
            bag.transform(t, i, 0.0, 0.0, parent="odom", child="base_link")
    with pytest.raises(
        BagError, match=r"at least two poses, got 1 .*map to odom ends 5.0 s before"
    ):
        read_recording(tmp_path / "a.bag")


def turning(t):
    """Steering that never repeats."""
    return 0.1 * sum(np.sin(math.sqrt(k) * t + k) for k in (1, 3, 5, 7, 11, 13, 17))


@pytest.mark.parametrize("shift", [-8.0, -2.0, -0.7, -0.4, 0.0, 0.1, 0.3, 1.0, 9.0])
@pytest.mark.parametrize("noise", [0.0, 0.05])
def test_an_effect_before_its_cause_or_long_after_it_is_told(shift, noise):
    """The car turns 0.1 s after its commands, whose times are `shift` late."""
    at, t = np.arange(0.0, 40.0, 0.025), np.arange(0.0, 40.0, 0.02)
    effect = 3.0 * turning(at - 0.1) + np.random.default_rng(1).normal(0.0, 3.0 * noise, at.size)
    effect[100:120] = math.nan
    lag = lag_of_effect(t + shift, turning(t), at, effect)
    if -0.4 <= shift <= 0.1:
        assert lag is None
    else:
        assert lag == pytest.approx(0.1 - shift, abs=0.03)


def test_nothing_is_said_of_commands_that_explain_nothing_or_repeat():
    at = np.arange(0.0, 40.0, 0.02)
    for cause, effect in (
        (turning(at), np.random.default_rng(2).normal(size=at.size)),
        (0.0 * at, turning(at)),
        # With a period of one second, the lag is ambiguous by whole periods.
        (np.sin(2.0 * np.pi * at), np.sin(2.0 * np.pi * (at - 0.1))),
        # A wrong sign is another fault.
        (turning(at), -turning(at - 0.1)),
    ):
        assert lag_of_effect(at, cause, at, effect) is None
    assert lag_of_effect(at[:1], at[:1], at, at) is None
    assert lag_of_effect(at, at, at[:20], at[:20]) is None


def test_a_lag_of_steady_waves_is_told_by_the_side_to_which_the_car_turns():
    """A lag of half a period, where waves look inverted, is ruled out: the car always turns
    left."""
    at = np.arange(0.0, 40.0, 0.02)
    steering = 0.05 + 0.01 * np.sin(2.4 * at)
    for shift, told in ((0.0, None), (1.0, -1.0), (-1.0, 1.0)):
        lag = lag_of_effect(at + shift, steering, at, 3.0 * steering)
        assert lag == (told if told is None else pytest.approx(told, abs=0.03))
    # Commands that come once a second look like those of the next second.
    assert lag_of_effect(at[::50] + 1.0, steering[::50], at, 3.0 * steering) is None


def drive_with_clocks(path, recorder, car, merged):
    """Drive a circle of 6 m at 4.8 m/s for 30 s; clocks are functions of time."""
    events = []
    for i in range(1500):
        t = 0.02 * i
        events.append((recorder(t + 0.004), t, car(t)))
    events.sort(key=lambda event: event[0] if merged else event[1])
    with BagWriter(path) as bag:
        for received, t, stamp in events:
            x, y = 6.0 * math.cos(0.8 * t), 6.0 * math.sin(0.8 * t)
            psi = 0.8 * t + 0.5 * math.pi
            bag.odometry(T0 + stamp, x, y, psi, 4.8, 0, 0.8, received=T0 + received)
    return read_recording(path)


def set_back(by):
    return lambda t: t if t < 16.0 else t - by


@pytest.mark.parametrize("by", [0.05, 1.5, 3.0])
@pytest.mark.parametrize("merged", [False, True])
def test_receipts_that_were_set_back_while_the_stamps_go_on(tmp_path, by, merged):
    recording = drive_with_clocks(tmp_path / "run.bag", set_back(by), lambda t: t, merged)
    np.testing.assert_allclose(recording.t, 0.02 * np.arange(1500), atol=1e-6)
    assert np.max(np.hypot(np.diff(recording.x), np.diff(recording.y))) < 0.1
    said = any("but the path is continuous in their order" in note for note in recording.notes)
    assert said == (merged and by >= 1.0)


@pytest.mark.parametrize(
    ("by", "said"),
    [(0.07, "back and forth"), (0.4, "poses share the stamp of another up to 1.9 m")],
)
def test_both_clocks_set_back_and_the_recording_sorted_by_them(tmp_path, by, said):
    recording = drive_with_clocks(tmp_path / "run.bag", set_back(by), set_back(by), True)
    doubts = [*recording.notes, *doubts_of(recording, [(0.0, 30.0)])]
    assert any(said in doubt for doubt in doubts)


def test_the_way_of_a_car_that_is_corrected_is_not_to_and_fro():
    rng, t = np.random.default_rng(1), 0.02 * np.arange(1500)
    for noise in (0.0, 0.01, 0.05):
        x, y = (6.0 * f(0.8 * t) + noise * rng.normal(size=t.size) for f in (np.cos, np.sin))
        assert to_and_fro("", t, x, y) == ""
        x[700:] -= 0.3 * np.gradient(x)[700] / 0.096
        y[700:] -= 0.3 * np.gradient(y)[700] / 0.096
        assert to_and_fro("", t, x, y) == ""
        assert to_and_fro("", t, 0.01 * x, 0.01 * y) == ""
