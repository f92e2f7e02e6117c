import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from map_racing.bags import encoding
from map_racing.bags import messages as msg

STAMP = 1600000000123456789
FINITE = st.floats(-1e6, 1e6)
ANGLE = st.floats(-math.pi, math.pi)


@pytest.fixture(scope="module")
def types():
    store = get_typestore(Stores.ROS1_NOETIC)
    for name, definition in msg.DEFINITIONS.items():
        store.register(get_types_from_msg(definition, name))
    return store


def one(decode, data):
    """``(stamp, value, ...)`` of a single message."""
    stamps, values, good = decode([data])
    assert good.tolist() == [True]
    return (int(stamps[0]), *values[0].tolist())


def ros(name):
    return name.replace("/", "/msg/")


@pytest.mark.parametrize("name", sorted(msg.MD5))
def test_md5_sums_are_those_of_the_definitions(types, name):
    assert types.generate_msgdef(ros(name))[1] == msg.MD5[name]


@given(FINITE, FINITE, ANGLE, FINITE, FINITE, FINITE, st.text(max_size=8))
@settings(deadline=None)
def test_odometry_round_trip(x, y, psi, v_x, v_y, yaw_rate, frame):
    data = encoding.encode_odometry(7, STAMP, frame, "base_link", x, y, psi, v_x, v_y, yaw_rate)
    stamp, x_2, y_2, psi_2, length, *twist = one(msg.decode_odometry, data)
    assert (stamp, x_2, y_2, twist) == (STAMP, x, y, [v_x, v_y, yaw_rate])
    assert length == pytest.approx(1.0)
    assert math.cos(psi_2 - psi) == pytest.approx(1.0, abs=1e-12)


@given(FINITE, FINITE, ANGLE)
@settings(deadline=None)
def test_pose_round_trip(x, y, psi):
    stamp, x_2, y_2, psi_2, _, *twist = one(
        msg.decode_pose, encoding.encode_pose(0, STAMP, "map", x, y, psi)
    )
    assert (stamp, x_2, y_2) == (STAMP, x, y)
    assert math.cos(psi_2 - psi) == pytest.approx(1.0, abs=1e-12)
    assert all(math.isnan(value) for value in twist)


def test_odometry_as_a_general_deserializer_reads_it(types):
    data = encoding.encode_odometry(
        7, STAMP, "map", "base_link", 1.0, 2.0, math.pi / 2, 3.0, 4.0, 5.0
    )
    odometry = types.deserialize_ros1(data, ros(msg.ODOMETRY))
    assert odometry.header.seq == 7
    assert (odometry.header.stamp.sec, odometry.header.stamp.nanosec) == (1600000000, 123456789)
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("map", "base_link")
    pose, twist = odometry.pose.pose, odometry.twist.twist
    assert (pose.position.x, pose.position.y, pose.position.z) == (1.0, 2.0, 0.0)
    assert pose.orientation.z == pytest.approx(math.sqrt(0.5))
    assert pose.orientation.w == pytest.approx(math.sqrt(0.5))
    assert (twist.linear.x, twist.linear.y, twist.angular.z) == (3.0, 4.0, 5.0)


def test_odometry_of_a_general_serializer_is_decoded(types):
    kind = types.types
    header = kind["std_msgs/msg/Header"](
        seq=1, stamp=kind["builtin_interfaces/msg/Time"](sec=5, nanosec=6), frame_id="/map"
    )
    vector = kind["geometry_msgs/msg/Vector3"]
    pose = kind["geometry_msgs/msg/Pose"](
        position=kind["geometry_msgs/msg/Point"](x=1.0, y=2.0, z=3.0),
        orientation=kind["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=1.0, w=0.0),
    )
    twist = kind["geometry_msgs/msg/Twist"](
        linear=vector(x=4.0, y=5.0, z=6.0), angular=vector(x=7.0, y=8.0, z=9.0)
    )
    covariance = np.arange(36.0)
    odometry = kind[ros(msg.ODOMETRY)](
        header=header,
        child_frame_id="base_link",
        pose=kind["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=covariance),
        twist=kind["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=covariance),
    )
    data = bytes(types.serialize_ros1(odometry, ros(msg.ODOMETRY)))
    assert one(msg.decode_odometry, data) == (5000000006, 1.0, 2.0, math.pi, 1.0, 4.0, 5.0, 9.0)
    assert msg.decode_header(data)[:2] == (5000000006, "map")
    stamped = kind[ros(msg.POSE_COVARIANCE)](header=header, pose=odometry.pose)
    data = bytes(types.serialize_ros1(stamped, ros(msg.POSE_COVARIANCE)))
    assert one(msg.decode_pose, data)[:4] == (5000000006, 1.0, 2.0, math.pi)


def test_imu_drive_and_waypoints_as_a_general_deserializer_reads_them(types):
    imu = types.deserialize_ros1(
        encoding.encode_imu(0, STAMP, "imu", 1.0, 2.0, 9.81, 0.5), ros(msg.IMU)
    )
    acceleration = imu.linear_acceleration
    assert (acceleration.x, acceleration.y, acceleration.z) == (1.0, 2.0, 9.81)
    assert imu.angular_velocity.z == 0.5
    assert imu.orientation_covariance[0] == -1.0

    data = encoding.encode_drive(0, STAMP, "base_link", 0.25, 4.0, 1.0, 2.0, 3.0)
    drive = types.deserialize_ros1(data, ros(msg.ACKERMANN)).drive
    assert (drive.steering_angle, drive.steering_angle_velocity, drive.speed) == (0.25, 1.0, 4.0)
    assert (drive.acceleration, drive.jerk) == (2.0, 3.0)
    assert one(msg.decode_drive, data) == (STAMP, 0.25, 4.0)

    rows = [[float(10 * i + j) for j in range(10)] for i in range(3)]
    data = encoding.encode_waypoints(0, STAMP, "map", rows)
    waypoints = types.deserialize_ros1(data, ros(msg.WAYPOINTS)).wpnts
    assert [waypoint.id for waypoint in waypoints] == [0, 1, 2]
    last = waypoints[2]
    assert (last.s_m, last.d_m, last.x_m, last.y_m) == (20.0, 21.0, 22.0, 23.0)
    assert (last.d_right, last.d_left, last.psi_rad) == (24.0, 25.0, 26.0)
    assert (last.kappa_radpm, last.vx_mps, last.ax_mps2) == (27.0, 28.0, 29.0)
    for name, column in msg.decode_waypoints(data).items():
        assert column.tolist() == [getattr(waypoint, name) for waypoint in waypoints]
    with pytest.raises(struct.error):
        msg.decode_waypoints(data[:-1])


def test_transform_round_trip():
    data = encoding.encode_transform(0, STAMP, "/map", "base_link", 1.0, 2.0, 0.5)
    (transform,) = msg.decode_transforms(data)
    assert transform[:5] == (STAMP, "map", "base_link", 1.0, 2.0)
    assert transform.psi == pytest.approx(0.5)


def test_messages_of_different_layouts_keep_their_places():
    frames = ["map", "a", "world", "map", ""] * 3
    children = ["base_link", "b", "bb", "", "base_link"] * 3
    batch = [
        encoding.encode_odometry(
            i, STAMP + i, frame, child, i, 10.0 + i, 0.1 * i, 20.0 + i, 0.0, 0.0
        )
        for i, (frame, child) in enumerate(zip(frames, children))
    ]
    stamps, values, good = msg.decode_odometry(batch)
    assert good.all()
    index = np.arange(len(batch))
    assert (stamps - STAMP).tolist() == index.tolist()
    np.testing.assert_array_equal(values[:, 0], index)
    np.testing.assert_array_equal(values[:, 1], 10.0 + index)
    np.testing.assert_allclose(values[:, 2], 0.1 * index)
    np.testing.assert_array_equal(values[:, 4], 20.0 + index)


@pytest.mark.parametrize("decode", [msg.decode_odometry, msg.decode_pose, msg.decode_drive])
@given(st.lists(st.binary(max_size=900), max_size=5))
@settings(deadline=None)
def test_what_is_not_of_the_type_is_told(decode, batch):
    good_one = {
        msg.decode_odometry: encoding.encode_odometry(
            0, STAMP, "map", "base_link", 1, 2, 0, 3, 0, 0
        ),
        msg.decode_pose: encoding.encode_pose(0, STAMP, "map", 1.0, 2.0, 0.0),
        msg.decode_drive: encoding.encode_drive(0, STAMP, "base_link", 1.0, 2.0, 0.0, 0.0, 0.0),
    }[decode]
    batch = [*batch, good_one[:-1], good_one, good_one[:20], b""]
    stamps, values, good = decode(batch)
    assert good.tolist()[-4:] == [False, True, False, False]
    assert stamps[-3] == STAMP
    assert values[-3, 0] == 1.0
    assert len(values) == len(batch)


@given(FINITE, FINITE, FINITE, FINITE, st.text(max_size=8))
@settings(deadline=None)
def test_imu_round_trip(a_x, a_y, a_z, yaw_rate, frame):
    data = encoding.encode_imu(3, STAMP, frame, a_x, a_y, a_z, yaw_rate)
    assert one(msg.decode_imu, data) == (STAMP, yaw_rate, a_x, a_y, a_z)


def test_float64_has_a_value_and_no_stamp():
    data = [struct.pack("<d", 0.25), b"short", struct.pack("<d", -1.5)]
    stamps, values, good = msg.decode_float64(data)
    assert stamps.tolist() == [0, 0, 0] and good.tolist() == [True, False, True]
    assert values[good].tolist() == [[0.25], [-1.5]]
    assert msg.decode_float64([])[1].shape == (0, 1)


@settings(deadline=None)
@given(ANGLE, st.floats(0.2, 20.0))
def test_the_length_of_a_quaternion_does_not_turn_the_car(psi, length):
    data = bytearray(encoding.encode_pose(0, STAMP, "map", 1.0, 2.0, psi))
    z, w = length * math.sin(0.5 * psi), length * math.cos(0.5 * psi)
    data[-16:] = struct.pack("<2d", z, w)
    _, _, _, found, measured, *_ = one(msg.decode_pose, bytes(data))
    assert math.remainder(found - psi, math.tau) == pytest.approx(0.0, abs=1e-9)
    assert measured == pytest.approx(length)


def test_a_quaternion_of_zeros_is_no_heading():
    data = encoding.encode_pose(0, STAMP, "map", 1.0, 2.0, 0.5)[:-16] + bytes(16)
    assert math.isnan(one(msg.decode_pose, data)[3])
