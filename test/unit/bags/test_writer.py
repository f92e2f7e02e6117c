"""What `BagWriter` writes, as ROS and `read_recording` read it."""

import math
import os
import struct

import numpy as np
import pytest
from moments import T0, TIMES, write
from rosbags.rosbag1 import Reader
from rosbags.typesys import Stores, get_typestore

from map_racing.bags import messages as msg
from map_racing.bags.reader import read_recording
from map_racing.bags.topics import DRIVE_TOPIC
from map_racing.bags.writer import BagWriter
from map_racing.errors import BagError
from map_racing.evaluation.recordings import recorded_raceline
from map_racing.track.files.load import load_raceline
from map_racing.track.files.waypoints import waypoint_rows


@pytest.mark.parametrize("compression", [None, "lz4", "bz2"])
def test_bag_is_what_ros_expects(race_bag, compression):
    with Reader(race_bag(compression)) as reader:
        lines = {line.topic: line for line in reader.connections}
        count = reader.topics["/car_state/odom"].msgcount
        assert {topic: line.digest for topic, line in lines.items()} == {
            "/car_state/odom": msg.MD5[msg.ODOMETRY],
            "/car_state/pose": msg.MD5[msg.POSE],
            "/global_waypoints": msg.MD5[msg.WAYPOINTS],
            "/tf": msg.MD5[msg.TF],
            "/vesc/sensors/imu/raw": msg.MD5[msg.IMU],
            DRIVE_TOPIC: msg.MD5[msg.ACKERMANN],
        }
        assert all(
            info.msgcount == count for name, info in reader.topics.items() if "way" not in name
        )
        assert lines["/global_waypoints"].ext.latching == 1
        assert lines["/tf"].ext.latching == 0
        assert reader.start_time == int(T0 * 1e9)


def test_lz4_frames_have_the_form_that_ros_reads(race_bag):
    """ROS's own lz4 reader wants independent blocks, a content checksum and no content size."""
    data = race_bag("lz4").read_bytes()
    frame = data.index(struct.pack("<I", 0x184D2204))
    assert data[frame + 4] == 0b01100100


def test_headers_count_up(race_bag):
    types = get_typestore(Stores.ROS1_NOETIC)
    with Reader(race_bag()) as reader:
        lines = [line for line in reader.connections if line.topic == "/car_state/pose"]
        headers = [
            types.deserialize_ros1(data, "geometry_msgs/msg/PoseStamped").header
            for _, _, data in reader.messages(lines)
        ]
    assert [header.seq for header in headers] == list(range(len(headers)))
    assert headers[0].frame_id == "map"


def test_round_trip(race_bag, track):
    recording = read_recording(race_bag())
    t = np.arange(recording.t.size) * 0.025
    x, y, psi = track.place(5.0 * t - 3.0, 0.1)
    # Stamps in float seconds since 1970 are exact to 0.2 us.
    np.testing.assert_allclose(recording.t, t, atol=5e-7)
    np.testing.assert_allclose(recording.x, x, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(recording.y, y, rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(np.cos(recording.psi - psi), 1.0, atol=1e-12)
    assert set(recording.v_x) == {5.0}
    assert set(recording.v_y) == {0.1}
    assert set(recording.yaw_rate) == {0.2}
    assert recording.t0_ns == int(T0 * 1e9)
    assert (recording.topic, recording.type) == ("/car_state/odom", "nav_msgs/Odometry")
    assert recording.frame == "map"
    np.testing.assert_allclose(recording.commands.t, t, atol=5e-7)
    assert set(recording.commands.speed) == {5.0}
    np.testing.assert_allclose(recording.commands.steering_angle, 0.05, rtol=1e-6)
    assert recording.commands.topic == DRIVE_TOPIC


def test_raceline_round_trip(race_bag, track):
    line = recorded_raceline(read_recording(race_bag()))
    assert line.length == pytest.approx(track.length, abs=1e-4)
    x, y, _ = track.place(line.s)
    assert np.hypot(line.x - x, line.y - y).max() < 2e-4
    np.testing.assert_array_equal(line.speed, 5.0)
    np.testing.assert_allclose(line.d_left, 1.0)
    np.testing.assert_allclose(line.d_right, 1.0)
    assert load_raceline(race_bag()).length == line.length


def test_acceleration_between_waypoints_follows_from_their_speeds(tmp_path, track):
    line = track.raceline(walls=1.0)
    speed = 5.0 + np.sin(2.0 * np.pi * line.s / line.length)
    line = type(line)(line.x, line.y, vx_mps=speed)
    with BagWriter(tmp_path / "a.bag") as bag:
        bag.waypoints(T0, waypoint_rows(line, spacing=0.2))
    with Reader(tmp_path / "a.bag") as reader:
        _, _, data = next(reader.messages())
    rows = np.frombuffer(
        bytes(data)[-84 * int(round(line.length / 0.2)) :],
        dtype=[("id", "<i4"), ("values", "<f8", (10,))],
    )["values"]
    s, v, a = rows[:, 0], rows[:, 8], rows[:, 9]
    np.testing.assert_allclose(v[:-1] ** 2 + 2.0 * a[:-1] * np.diff(s), v[1:] ** 2, rtol=1e-12)


def test_integer_stamps_are_nanoseconds_and_receipt_may_differ(tmp_path):
    path = tmp_path / "a.bag"
    with BagWriter(path) as bag:
        for i in range(3):
            bag.pose(10**18 + i, 0.0, 0.0, 0.0, received=2 * 10**18 + i)
    assert read_recording(path).t0_ns == 10**18
    with Reader(path) as reader:
        assert reader.start_time == 2 * 10**18


def test_nothing_is_left_after_an_exception(tmp_path):
    path = tmp_path / "race.bag"
    with pytest.raises(RuntimeError, match="crash"), BagWriter(path) as bag:
        bag.pose(T0, 0.0, 0.0, 0.0)
        raise RuntimeError("crash")
    assert list(tmp_path.iterdir()) == []


def test_an_old_bag_stays_until_the_new_one_is_whole(tmp_path):
    path = tmp_path / "race.bag"
    path.write_bytes(b"old")
    with BagWriter(path) as bag:
        bag.pose(T0, 0.0, 0.0, 0.0)
        bag.pose(T0 + 1.0, 0.0, 0.0, 0.0)
        assert path.read_bytes() == b"old"
    assert read_recording(path).t.size == 2
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("fill", "expected"),
    [
        (lambda bag: bag.pose(0.0, 0.0, 0.0, 0.0), "expected a time after 0"),
        (lambda bag: bag.pose(math.nan, 0.0, 0.0, 0.0), "/car_state/pose"),
        (lambda bag: bag.pose(T0, "a", 0.0, 0.0), "/car_state/pose"),
        (lambda bag: bag.pose(1e12, 0.0, 0.0, 0.0), "/car_state/pose"),
        (
            lambda bag: (bag.pose(T0, 0.0, 0.0, 0.0), bag.drive(T0, 0, 0, topic="/car_state/pose")),
            "expected geometry_msgs/PoseStamped",
        ),
    ],
)
def test_messages_that_cannot_be_written(tmp_path, fill, expected):
    path = tmp_path / "a.bag"
    with pytest.raises(BagError, match=expected), BagWriter(path) as bag:
        fill(bag)
    assert list(tmp_path.iterdir()) == []


def test_places_where_no_bag_can_be(tmp_path):
    with pytest.raises(BagError, match="cannot write"), BagWriter(tmp_path / "no" / "a.bag"):
        pass
    with pytest.raises(BagError, match="expected compression"):
        BagWriter(tmp_path / "a.bag", "zip")
    for path in (".", "", "/", tmp_path, tmp_path / ".."):
        with pytest.raises(BagError, match="expected a file, got a directory"):
            BagWriter(path)
    os.mkfifo(tmp_path / "pipe.bag")
    with pytest.raises(BagError, match="pipe.bag: .*expected a file, got a pipe"):
        BagWriter(tmp_path / "pipe.bag")


def test_a_link_is_written_through(tmp_path):
    (tmp_path / "store").mkdir()
    for name, old in (("a.bag", b"old"), ("new.bag", None)):
        target, link = tmp_path / "store" / name, tmp_path / name
        if old is not None:
            target.write_bytes(old)
        link.symlink_to(target)
        write(link, lambda bag, i, t: bag.pose(t, i, 0, 0))
        assert link.is_symlink()
        assert read_recording(target).t.size == len(TIMES)
    assert sorted(path.name for path in (tmp_path / "store").iterdir()) == ["a.bag", "new.bag"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.bag", "new.bag", "store"]


def test_an_interrupt_at_the_start_leaves_nothing(tmp_path, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("rosbags.typesys.get_typestore", interrupt)
    with pytest.raises(KeyboardInterrupt), BagWriter(tmp_path / "a.bag"):
        pass
    assert list(tmp_path.iterdir()) == []
