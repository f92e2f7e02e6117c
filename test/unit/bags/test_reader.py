"""Recordings read from bags: the choice of the pose, waypoints, clocks and damage."""

import math
import struct

import numpy as np
import pytest
from moments import T0, TIMES, write
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from map_racing.bags import encoding
from map_racing.bags import messages as msg
from map_racing.bags.reader import read_recording
from map_racing.bags.topics import DRIVE_TOPIC
from map_racing.bags.writer import BagWriter
from map_racing.errors import BagError, RacelineError
from map_racing.evaluation.recordings import recorded_raceline
from map_racing.track.files.load import load_raceline
from map_racing.track.files.waypoints import waypoint_rows

# -- choice of the pose --------------------------------------------------------------------------


def odometry(topic, frame="map"):
    return lambda bag, i, t: bag.odometry(t, i, 0, 0, 1, 0, 0, topic=topic, frame=frame)


def pose(topic, frame="map"):
    return lambda bag, i, t: bag.pose(t, i, 0, 0, topic=topic, frame=frame)


def transform(parent="map", child="base_link"):
    return lambda bag, i, t: bag.transform(t, i, 0, 0, parent=parent, child=child)


def once(fill):
    return lambda bag, i, t: fill(bag, i, t) if i == 0 else None


@pytest.mark.parametrize(
    ("sources", "expected"),
    [
        ([odometry("/vesc/odom", "odom"), pose("/car_state/pose")], "/car_state/pose"),
        ([pose("/car_state/pose"), odometry("/b/odom")], "/b/odom"),
        ([odometry("/a/odom"), odometry("/car_state/odom")], "/car_state/odom"),
        ([odometry("/odom"), odometry("/pf/pose/odom")], "/pf/pose/odom"),
        ([odometry("/ground_truth/odom"), odometry("/vesc/odom", "odom")], "/vesc/odom"),
        ([odometry("/ground_truth/odom")], "/ground_truth/odom"),
        ([odometry("/opponent/odom"), odometry("/pf_odom")], "/pf_odom"),
        ([pose("/goal_pose"), odometry("/odom", "odom")], "/odom"),
        ([pose("/lookahead_point"), pose("/slam_pose")], "/slam_pose"),
        ([odometry("/car_state/odom_frenet"), odometry("/vesc/odom", "odom")], "/vesc/odom"),
        ([once(pose("/move_base_simple/goal")), odometry("/odom", "odom")], "/odom"),
        ([odometry("/odom", "odom"), transform()], "/tf"),
        ([odometry("/odom", "/map"), transform()], "/odom"),
        ([odometry("/odom", "odom"), transform("odom", "base_link")], "/odom"),
        ([transform(), transform(child="laser")], "/tf"),
        ([transform(child="ego_racecar/base_link")], "/tf:ego_racecar/base_link"),
    ],
)
@pytest.mark.parametrize("reverse", [False, True])
def test_pose_is_chosen(tmp_path, sources, expected, reverse):
    def fill(bag, i, t):
        for source in reversed(sources) if reverse else sources:
            source(bag, i, t)

    recording = read_recording(write(tmp_path / "a.bag", fill))
    assert recording.topic == expected
    assert recording.notes[0].startswith(f"pose: {expected} (")
    assert recording.t.size == len(TIMES)
    np.testing.assert_array_equal(recording.x, np.arange(len(TIMES)))


def write_raw(path, kind, messages, publishers=1, pause=0.0):
    """A bag of serialized messages of one type on /amcl_pose, from publishers one after another."""
    types = get_typestore(Stores.ROS1_NOETIC)
    name = kind.replace("/", "/msg/")
    definition, md5sum = types.generate_msgdef(name)
    with Writer(path) as writer:
        lines = [
            writer.add_connection(
                *("/amcl_pose", name), msgdef=definition, md5sum=md5sum, callerid=f"/{i}"
            )
            for i in range(publishers)
        ]
        for i, (t, data) in enumerate(zip(TIMES, messages)):
            turn = i * publishers // len(messages)
            writer.write(lines[turn], int((t + turn * pause) * 1e9), data)
    return path


def test_pose_with_covariance_is_a_pose(tmp_path):
    messages = [
        encoding.encode_pose(i, int(t * 1e9), "map", i, 2.0, 0.5) + struct.pack("<36d", *range(36))
        for i, t in enumerate(TIMES)
    ]
    recording = read_recording(write_raw(tmp_path / "a.bag", msg.POSE_COVARIANCE, messages))
    assert (recording.topic, recording.type) == ("/amcl_pose", msg.POSE_COVARIANCE)
    np.testing.assert_array_equal(recording.x, np.arange(len(TIMES)))
    np.testing.assert_allclose(recording.psi, 0.5, atol=1e-12)
    assert np.isnan(recording.v_x).all()


@pytest.mark.parametrize(("pause", "count"), [(2.0, len(TIMES)), (0.0, 17)])
def test_a_second_sender_takes_over_when_the_first_is_gone(tmp_path, pause, count):
    """A restarted node has a new connection; one that sends at the same time is a second sender."""
    messages = [
        encoding.encode_pose(i, int(t * 1e9), "map", i, 2.0, 0.5) for i, t in enumerate(TIMES)
    ]
    path = write_raw(tmp_path / "a.bag", msg.POSE, messages, publishers=3, pause=pause)
    recording = read_recording(path)
    np.testing.assert_array_equal(recording.x, np.arange(count))
    said = any("left out: only the first, /0, counts" in note for note in recording.notes)
    assert said == (count < len(TIMES))


def test_pose_topic_overrides_the_choice(tmp_path):
    def fill(bag, i, t):
        odometry("/car_state/odom")(bag, i, t)
        bag.pose(t, -i, 0, 0, topic="/other")
        bag.transform(t, 0.0, i, 0.0)
        bag.transform(t, 0.0, 10.0, 0.0, parent="base_link", child="laser")

    path = write(tmp_path / "a.bag", fill)
    for topic in ("/other", "other"):
        assert read_recording(path, topic).x[-1] == -(len(TIMES) - 1)
    for topic in ("/tf", "/tf:base_link", "tf:/base_link"):
        assert read_recording(path, topic).y[-1] == len(TIMES) - 1
    assert read_recording(path, "/tf:laser").y[-1] == len(TIMES) + 9
    with pytest.raises(BagError, match=r"no pose on /nothing: expected one of .*/other"):
        read_recording(path, "/nothing")


def test_bag_without_a_pose_says_what_it_has(tmp_path):
    path = write(tmp_path / "a.bag", lambda bag, i, t: bag.imu(t, 0.0, 0.0, 0.0))
    with pytest.raises(BagError, match=r"no topic with the pose .*/vesc/sensors/imu/raw \(sensor"):
        read_recording(path)
    path = write(tmp_path / "b.bag", odometry("/car_state/odom_frenet"))
    with pytest.raises(BagError, match="--pose-topic can take /car_state/odom_frenet"):
        read_recording(path)
    path = write(tmp_path / "c.bag", lambda bag, i, t: None)
    with pytest.raises(BagError, match="has no messages"):
        read_recording(path)
    with pytest.raises(BagError, match="the bag has no pose at all"):
        read_recording(path, "/odom")
    path = write(tmp_path / "d.bag", once(odometry("/odom")))
    with pytest.raises(BagError, match="at least two poses, got 1"):
        read_recording(path)


def test_tf_is_chained_over_static_and_slow_transforms(tmp_path):
    """map -> odom (slow, drifting) -> base (fast) -> base_link (static), composed in the plane."""

    def fill(bag, i, t):
        if i == 0:
            bag.transform(t, 0.3, 0.1, 0.2, parent="base", child="base_link", static=True)
        if i % 7 == 0:
            bag.transform(t, 1.0 + 0.1 * i, 2.0, 0.5, parent="/map", child="odom")
        bag.transform(t, 0.2 * i, 0.0, 0.01 * i, parent="odom", child="base")

    recording = read_recording(write(tmp_path / "a.bag", fill))
    i = np.arange(len(TIMES))
    x, y, psi = 0.2 * i, np.zeros(i.size), 0.01 * i
    x, y = x + 0.3 * np.cos(psi) - 0.1 * np.sin(psi), y + 0.3 * np.sin(psi) + 0.1 * np.cos(psi)
    x, y = np.cos(0.5) * x - np.sin(0.5) * y, np.sin(0.5) * x + np.cos(0.5) * y
    np.testing.assert_allclose(recording.x, 1.0 + 0.1 * np.minimum(i, 49) + x, atol=1e-6)
    np.testing.assert_allclose(recording.y, 2.0 + y, atol=1e-6)
    np.testing.assert_allclose(recording.psi, 0.5 + psi + 0.2, atol=1e-9)
    assert np.isnan(recording.v_x).all()
    assert recording.frame == "map"


def test_headings_of_tf_are_joined_across_the_half_turn(tmp_path):
    """The slow transform turns from 3.0 over pi to -3.08 rad while the fast one goes on."""

    def fill(bag, i, t):
        if i % 10 == 0:
            bag.transform(t, 0.0, 0.0, 3.0 + 0.005 * i, parent="map", child="odom")
        bag.transform(t, 1.0, 0.0, 0.0, parent="odom", child="base_link")

    recording = read_recording(write(tmp_path / "a.bag", fill))
    i = np.arange(41)  # the last slow transform is the 40th: nothing is known after it
    np.testing.assert_allclose(recording.x, np.cos(3.0 + 0.005 * i), atol=1e-6)
    np.testing.assert_allclose(np.cos(recording.psi), np.cos(3.0 + 0.005 * i), atol=1e-6)


def test_a_static_transform_sent_with_an_older_stamp_sets_no_clock_back(tmp_path):
    def fill(bag, i, t):
        if i % 20 == 0:
            stamp = 100.0 - i
            bag.transform(stamp, 0.3, 0.0, 0.0, parent="base", child="base_link", static=True)
        bag.transform(t, i, 0.0, 0.0, parent="map", child="base")

    recording = read_recording(write(tmp_path / "a.bag", fill))
    np.testing.assert_allclose(recording.x, np.arange(len(TIMES)) + 0.3, atol=1e-6)
    assert not any("jump back" in note for note in recording.notes)


# -- samples -------------------------------------------------------------------------------------


def test_stamp_zero_falls_back_to_the_time_of_receipt(tmp_path):
    path = write(tmp_path / "a.bag", lambda bag, i, t: bag.pose(0, i, 0, 0, received=t + 1.0))
    recording = read_recording(path)
    assert recording.t0_ns == int((T0 + 1.0) * 1e9)
    np.testing.assert_allclose(recording.t, np.array(TIMES) - T0, atol=5e-7)
    assert any("50 of 50 stamps are 0" in note for note in recording.notes)


def test_samples_are_put_in_order(tmp_path):
    def fill(bag, i, t):
        swapped = {10: 11, 11: 10}.get(i, i)
        stamp = TIMES[20] if i == 21 else TIMES[swapped]
        bag.pose(stamp, math.nan if i in (30, 31) else swapped, 0.0, 0.0, received=t)

    recording = read_recording(write(tmp_path / "a.bag", fill))
    assert recording.x.tolist() == [i for i in range(50) if i not in (21, 30, 31)]
    text = "; ".join(recording.notes)
    assert "2 of 50 without a finite pose left out" in text
    assert "1 steps back in time: sorted" in text
    assert "1 repeated time stamps left out" in text


def test_drive_command_of_the_car_is_preferred(tmp_path):
    def fill(bag, i, t):
        bag.pose(t, i, 0.0, 0.0)
        bag.drive(t - 1.0, 0.1, 1.0, topic="/drive")
        bag.drive(t, 0.2, 2.0)

    commands = read_recording(write(tmp_path / "a.bag", fill)).commands
    assert commands.topic == DRIVE_TOPIC
    assert set(commands.speed) == {2.0}

    def without(bag, i, t):
        bag.pose(t, i, 0.0, 0.0)
        bag.drive(t - 1.0, 0.1, 1.0, topic="/drive")

    commands = read_recording(write(tmp_path / "b.bag", without)).commands
    assert commands.topic == "/drive"
    assert commands.t[0] == pytest.approx(-1.0)


# -- waypoints -----------------------------------------------------------------------------------


def test_waypoint_topics(tmp_path, track):
    line, other = track.raceline(speed=3.0), track.raceline(speed=4.0)
    path = tmp_path / "a.bag"
    with BagWriter(path) as bag:
        bag.waypoints(T0, waypoint_rows(line), topic="/local_waypoints")
    with pytest.raises(BagError, match="no raceline"):
        load_raceline(path)
    assert load_raceline(f"{path}#local_waypoints").length == pytest.approx(line.length, abs=1e-3)

    with BagWriter(path) as bag:
        bag.waypoints(T0, waypoint_rows(line), topic="/centerline_waypoints")
        bag.waypoints(T0, waypoint_rows(other), topic="/global_waypoints_scaled")
    assert load_raceline(path).speed[0] == 4.0
    with pytest.raises(BagError, match="on /global_waypoints"):
        load_raceline(f"{path}#/global_waypoints")


def test_empty_waypoint_arrays_are_passed_over(tmp_path, track):
    path = tmp_path / "a.bag"
    with BagWriter(path) as bag:
        for i, rows in enumerate(([], [[0.0] * 10])):
            bag._write(
                "/global_waypoints",
                msg.WAYPOINTS,
                T0 + i,
                None,
                encoding.encode_waypoints,
                ("", rows),
            )
            if i == 0:
                bag.waypoints(T0 + 0.5, waypoint_rows(track.raceline()))
    assert load_raceline(path).length == pytest.approx(track.length, abs=1e-3)


def test_unusable_waypoints_do_not_hide_the_driving(tmp_path):
    def fill(bag, i, t):
        bag.pose(t, i, 0.0, 0.0)
        if i == 0:
            rows = [[0.0] * 10, [1.0] * 10]
            values = ("", rows)
            bag._write(
                "/global_waypoints", msg.WAYPOINTS, t, None, encoding.encode_waypoints, values
            )

    recording = read_recording(write(tmp_path / "a.bag", fill))
    with pytest.raises(RacelineError, match="a.bag: /global_waypoints"):
        recorded_raceline(recording)


def test_waypoints_of_another_definition_are_read_by_it(tmp_path):
    """Other versions of the message have different fields in a different order."""
    fields = ("vx_mps", "extra", "d_left", "d_right", "psi_rad", "y_m", "x_m")
    definition = (
        "f110_msgs/Wpnt[] wpnts\n" + "=" * 80 + "\nMSG: f110_msgs/Wpnt\n"
        "float64 vx_mps\nint32 extra\nfloat64 d_left\nfloat64 d_right\nfloat64 psi_rad\n"
        "float64 y_m\nfloat64 x_m\n"
    )
    angle = np.arange(20) * 2.0 * np.pi / 20
    rows = [
        dict(zip(fields, (3.0, 7, 1.0, 2.0, 0.0, 5.0 * math.sin(a), 5.0 * math.cos(a))))
        for a in angle
    ]
    data = struct.pack("<I", len(rows)) + b"".join(
        struct.pack("<di5d", *(row[field] for field in fields)) for row in rows
    )
    with Writer(tmp_path / "a.bag") as writer:
        line = writer.add_connection(
            "/global_waypoints", "f110_msgs/msg/WpntArray", msgdef=definition, md5sum="0" * 32
        )
        writer.write(line, 10**18, data)
    raceline = load_raceline(tmp_path / "a.bag")
    assert raceline.length == pytest.approx(10.0 * math.pi, rel=1e-4)
    assert (raceline.speed[0], raceline.d_left[0], raceline.d_right[0]) == (3.0, 1.0, 2.0)


# -- damage and real recordings --------------------------------------------------------------------


@pytest.mark.parametrize("compression", [None, "lz4"])
def test_damaged_bag_gives_its_first_laps_and_says_so(tmp_path, race_bag, compression):
    data = race_bag(compression).read_bytes()
    path = tmp_path / "cut.bag"
    path.write_bytes(data[: len(data) * 6 // 10])
    whole, part = read_recording(race_bag(compression)), read_recording(path)
    assert 100 < part.t.size < whole.t.size
    np.testing.assert_array_equal(part.x, whole.x[: part.t.size])
    assert any(note.startswith("warning: damaged bag") for note in part.notes)


def test_a_bag_of_ros1_is_one_whatever_its_name(tmp_path, race_bag):
    path = tmp_path / "run.mcap"
    path.write_bytes(race_bag().read_bytes())
    assert read_recording(path).t.size == read_recording(race_bag()).t.size


def test_hangar_recording(shared_data):
    recording = read_recording(shared_data / "recordings" / "hangar_map_12laps.bag")
    assert recording.topic == "/car_state/odom"
    assert recording.frame == "map"
    assert recording.t.size == 6339
    assert recording.t[-1] == pytest.approx(63.38, abs=0.01)
    assert recorded_raceline(recording).length == pytest.approx(21.2, abs=0.1)
    assert recording.commands.t.size == 2535
    pose = read_recording(shared_data / "recordings" / "hangar_map_12laps.bag", "/car_state/pose")
    assert pose.frame == "map"
    assert any("6339 of 6339 stamps are 0" in note for note in pose.notes)
    tf = read_recording(shared_data / "recordings" / "hangar_map_12laps.bag", "/tf")
    for other in (pose, tf):
        np.testing.assert_allclose(other.x, recording.x, atol=1e-9)
        np.testing.assert_allclose(np.cos(other.psi - recording.psi), 1.0, atol=1e-12)


def test_other_real_recordings(shared_data):
    folder = shared_data / "recordings"
    husky = read_recording(folder / "husky_odom_imu.bag")
    assert (husky.topic, husky.frame) == ("/husky_velocity_controller/odom", "odom")
    assert husky.t.size == 3952
    with pytest.raises(BagError, match=r"/sensors/core \(vesc_msgs/VescStateStamped\)"):
        read_recording(folder / "vesc_motor_servo.bag")
    line = load_raceline(folder / "hangar_global_waypoints.bag")
    assert line.length == pytest.approx(21.2, abs=0.1)
    turtle = read_recording(shared_data / "bag_fixtures" / "example-bz2.bag", "/tf:turtle1")
    assert turtle.t.size > 1000


def test_heading_of_waypoints_is_compared_with_their_points(tmp_path, track):
    s = np.arange(0.0, track.length, 0.2)
    x, y, psi = track.place(s)
    rows = np.zeros((s.size, 10))
    rows[:, 2], rows[:, 3], rows[:, 6] = x, y, psi - math.pi / 2
    path = tmp_path / "a.bag"
    with BagWriter(path) as bag:
        bag._write("/w", msg.WAYPOINTS, T0, None, encoding.encode_waypoints, ("", rows.tolist()))
    findings = "; ".join(map(str, load_raceline(path).findings))
    assert "+y (north)" in findings
    assert "every speed is 0" in findings


# -- clocks --------------------------------------------------------------------------------------

HOUR = 3600.0


def two_runs(fill, receipt_restarts=False):
    """After 30 of 50 messages, stamps restart as in the first run; receipts may, too."""

    def stamped(bag, i, t):
        stamp = TIMES[0] + 0.1 * (i % 30)
        fill(bag, i, stamp, stamp if receipt_restarts else HOUR + T0 + 0.1 * i)

    return stamped


def fill_odometry(bag, i, stamp, received):
    bag.odometry(stamp, i, 0.0, 0.0, 1.0, 0.0, 0.0, received=received)
    bag.drive(stamp, 0.001 * i, 1.0, received=received)


def fill_transforms(bag, i, stamp, received):
    if i == 0:
        bag.transform(1.0, 0.0, 0.0, 0.0, parent="base", child="base_link", static=True)
    bag.transform(stamp, i, 0.0, 0.0, parent="map", child="base", received=received)


@pytest.mark.parametrize("fill", [fill_odometry, fill_transforms])
def test_two_runs_whose_stamps_begin_anew_are_not_interleaved(tmp_path, fill):
    recording = read_recording(write(tmp_path / "a.bag", two_runs(fill)))
    np.testing.assert_array_equal(recording.x, np.arange(len(TIMES)))
    np.testing.assert_allclose(recording.t, 0.1 * np.arange(len(TIMES)), atol=5e-7)
    assert "header stamps jump back by 2.9 s: time of receipt used instead" in recording.notes
    if fill is fill_odometry:
        np.testing.assert_array_equal(recording.commands.t, recording.t)
        np.testing.assert_allclose(recording.commands.steering_angle, 0.001 * recording.x)


@pytest.mark.parametrize("fill", [fill_odometry, fill_transforms])
def test_two_runs_that_no_clock_tells_apart_are_refused(tmp_path, fill):
    path = write(tmp_path / "a.bag", two_runs(fill, receipt_restarts=True))
    with pytest.raises(BagError, match=r"a.bag: time jumps back by 2.9 s: two runs in one bag\?"):
        read_recording(path)


def test_commands_whose_clock_is_set_back_bring_the_pose_to_the_time_of_receipt(tmp_path):
    def fill(bag, i, t):
        bag.pose(t, i, 0.0, 0.0, received=t + HOUR)
        bag.drive(t - (5.0 if i > 30 else 0.0), 0.0, 1.0, received=t + HOUR)

    recording = read_recording(write(tmp_path / "a.bag", fill))
    assert recording.t0_ns == int((T0 + HOUR) * 1e9)
    np.testing.assert_array_equal(recording.commands.t, recording.t)
    assert any("jump back by 5.0 s" in note for note in recording.notes)


def test_a_late_message_is_no_jump(tmp_path):
    """Transport may reorder messages by less than a second."""

    def fill(bag, i, t):
        bag.pose(TIMES[0] + 0.1 * (i if i != 20 else 11.5), i, 0.0, 0.0, received=t + HOUR)

    recording = read_recording(write(tmp_path / "a.bag", fill))
    assert recording.t0_ns == int(T0 * 1e9)
    assert recording.x[12] == 20.0
    assert any("1 steps back in time: sorted" in note for note in recording.notes)


@pytest.mark.parametrize(
    ("spans", "told"),
    [
        ({"/amcl": (0, 50), "/slam": (0, 50)}, "2 nodes at once, /amcl, /slam: all of them"),
        ({"/amcl": (0, 25), "/slam": (25, 50)}, None),
        (
            {"/amcl": (0, 50), "/gps": (5, 15), "/slam": (25, 40)},
            "3 nodes at once, /amcl, /gps, /slam: all of them",
        ),
    ],
)
def test_localizations_at_once_on_tf_are_said(tmp_path, spans, told):
    """Only if they send at the same time, not one after the other."""
    types = get_typestore(Stores.ROS1_NOETIC)
    name = "tf2_msgs/msg/TFMessage"
    types.register(get_types_from_msg(msg.DEFINITIONS[name], name))
    definition, md5sum = types.generate_msgdef(name)
    with Writer(tmp_path / "a.bag") as writer:
        lines = [
            writer.add_connection(
                *("/tf", name),
                **{"msgdef": definition, "md5sum": md5sum, "callerid": sender},
            )
            for sender in spans
        ]
        for i, t in enumerate(TIMES):
            for k, (line, (begin, end)) in enumerate(zip(lines, spans.values())):
                if not begin <= i < end:
                    continue
                at = int(t * 1e9) + 10**6 * k
                data = encoding.encode_transform(i, at, "map", "base_link", i + 0.5 * k, 0.0, 0.0)
                writer.write(line, at, data)
    said = [note for note in read_recording(tmp_path / "a.bag").notes if "at once" in note]
    expected = f"warning: /tf: map to base_link: sent by {told}"
    assert [note[: len(expected)] for note in said] == ([expected] if told else [])


# -- damage --------------------------------------------------------------------------------------


def test_damage_is_reported_when_the_pose_comes_from_tf(tmp_path):
    def fill(bag, i, t):
        bag.transform(t, math.nan if i == 40 else i, 0.0, 0.0)
        bag.drive(t, 0.1, 1.0)

    path = write(tmp_path / "a.bag", fill)
    data = bytearray(path.read_bytes())
    at = data.index(struct.pack("<d", 20.0))
    data[at - 300 : at + 300] = bytes(600)
    path.write_bytes(data)
    recording = read_recording(path)
    assert 40 < recording.t.size < 49
    notes = "; ".join(recording.notes)
    assert "damaged bag: " in notes
    assert f"of {2 * len(TIMES)} messages read; damage at byte" in notes
    assert "/tf: map to base_link: 1 of" in notes


def test_messages_of_tf_that_cannot_be_decoded_are_counted(tmp_path):
    path = write(tmp_path / "a.bag", transform())
    data = bytearray(path.read_bytes())
    at = data.index(b"base_link", data.index(struct.pack("<d", 19.0)))
    data[at - 4 : at] = b"\xff\xff\xff\x7f"
    path.write_bytes(data)
    recording = read_recording(path)
    assert recording.t.size == len(TIMES) - 1
    assert "/tf: 1 messages that do not match their type left out" in recording.notes


def test_a_sound_bag_without_a_pose_does_not_look_damaged(tmp_path, shared_data):
    path = write(tmp_path / "a.bag", lambda bag, i, t: bag.imu(t, 0.0, 0.0, 0.0))
    for sound in (path, shared_data / "recordings" / "vesc_motor_servo.bag"):
        with pytest.raises(BagError, match="no topic with the pose") as error:
            read_recording(sound)
        assert "messages read" not in str(error.value)


@pytest.mark.parametrize(
    ("fill", "expected"),
    [
        (lambda bag, i, t: bag.pose(t, math.nan, 0, 0), "50 of 50 without a finite pose left out"),
        (lambda bag, i, t: bag.pose(T0, i, 0, 0), "49 repeated time stamps left out"),
        (lambda bag, i, t: bag.transform(t, 0, math.nan, 0), "50 of 50 without a finite pose"),
    ],
)
def test_too_few_poses_are_explained(tmp_path, fill, expected):
    path = write(tmp_path / "a.bag", fill)
    with pytest.raises(BagError, match=rf"expected at least two poses, got \d \(.*{expected}"):
        read_recording(path)


@pytest.mark.parametrize("x", [0.0, 5.0])
def test_odometry_is_placed_by_a_static_transform_alone(tmp_path, x):
    def fill(bag, i, t):
        if i == 0:
            bag.transform(t, x, 3.0, 0.0, child="odom", static=True)
        bag.odometry(t, i - x, -3.0, 0.0, 1.0, 0.0, 0.0, frame="odom", topic="/odom")

    recording = read_recording(write(tmp_path / "a.bag", fill))
    assert recording.frame == "map"
    np.testing.assert_allclose(recording.x, np.arange(len(TIMES)))
    np.testing.assert_allclose(recording.y, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("frame", "pose_frame", "doubted"),
    [("odom", "map", True), ("map", "map", False), ("", "map", False), ("odom", "odom", False)],
)
def test_waypoints_in_another_frame_than_the_poses_are_doubted(
    tmp_path, track, frame, pose_frame, doubted
):
    rows = waypoint_rows(track.raceline(speed=5.0))

    def fill(bag, i, t):
        if i == 0:
            bag.waypoints(t, rows, frame=frame)
        bag.odometry(t, i, 0.0, 0.0, 1.0, 0.0, 0.0, frame=pose_frame)

    notes = read_recording(write(tmp_path / "a.bag", fill)).notes
    said = [
        note for note in notes if note.startswith("warning: /global_waypoints is in frame odom")
    ]
    assert bool(said) == doubted


# -- frames of poses on one topic ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("frames", "counted", "frame", "said"),
    [
        (["odom", "map"], (2.0, 4.0), "map", "100 messages in frame odom left out"),
        (["odom", "vesc"], (2.0, 4.0), "vesc", "100 messages in frame odom left out"),
        (["map", "odom"], (0.0, 2.0), "map", "100 messages in another frame, odom, left out"),
        (["map", "world"], (0.0, 2.0), "map", "100 messages in another frame, world, left out"),
        (["odom", "map", "odom"], (2.0, 4.0), "map", "100 messages in frame odom left out"),
        (["", "map", "/map"], (0.0, 6.0), "map", ""),
    ],
)
def test_frames_that_follow_each_other_on_a_topic(tmp_path, frames, counted, frame, said):
    """The frame nearest to the map counts once the previous one has been gone for 1 s, as with
    nodes."""
    with BagWriter(tmp_path / "run.bag") as bag:
        for i in range(100 * len(frames)):
            at = T0 + 0.02 * i + (1.1 if i >= 100 and said else 0.0)
            own = frames[i // 100]
            bag.odometry(at, 0.02 * i, 0, 0, 1, 0, 0, topic="/odom", frame=own, received=at)
    recording = read_recording(tmp_path / "run.bag")
    assert recording.frame == frame
    assert recording.x[[0, -1]].tolist() == pytest.approx([counted[0], counted[1] - 0.02])
    warnings = [note for note in recording.notes if note.startswith("warning")]
    assert bool(warnings) == bool(said)
    assert any(said in warning for warning in warnings) or not said


def test_odometry_that_was_localized_later_is_not_placed_twice(tmp_path):
    """A topic in odom, beside its transform to the map, and later in the map itself."""
    with BagWriter(tmp_path / "run.bag") as bag:
        for i in range(300):
            at = T0 + 0.02 * i
            bag.transform(at, 5.0, 0.0, 0.0, child="odom", received=at)
            own = "odom" if i < 100 else "map"
            bag.odometry(at, 0.02 * i, 0, 0, 1, 0, 0, topic="/odom", frame=own, received=at)
    recording = read_recording(tmp_path / "run.bag")
    assert recording.frame == "map" and recording.x[-1] == pytest.approx(5.98)
    # It took a second to notice that odom is gone.
    assert recording.x[0] == pytest.approx(2.98, abs=0.03)
