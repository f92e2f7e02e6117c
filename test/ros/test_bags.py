"""The package's bags, read by ROS's own rosbag; test_lap_evaluator plays them."""

import subprocess

import pytest
import rosbag
import yaml

from map_racing.bags.topics import DRIVE_TOPIC
from map_racing.bags.writer import BagWriter
from map_racing.track.files.load import load_raceline
from map_racing.track.files.waypoints import waypoint_rows

T0, COUNT = 1600000000, 3000  # several chunks


@pytest.fixture(params=[None, "lz4", "bz2"])
def bag(request, tmp_path):
    path = tmp_path / "race.bag"
    with BagWriter(path, request.param) as writer:
        writer.waypoints(T0 * 10**9, waypoint_rows(load_raceline("reference")))
        for i in range(COUNT):
            stamp = T0 * 10**9 + i * 25 * 10**6
            writer.odometry(stamp, i, 2.0, 0.1, 3.0, 0.2, 0.4)
            writer.pose(stamp, i, 2.0, 0.1)
            writer.drive(stamp, 0.25, 3.0)
            writer.imu(stamp, 1.0, 2.0, 0.4)
            writer.transform(stamp, i, 2.0, 0.1)
    return path


def test_rosbag_info(bag, request):
    info = yaml.safe_load(subprocess.check_output(["rosbag", "info", "--yaml", str(bag)]))
    assert info["indexed"] and info["start"] == T0
    assert info["compression"] == (request.node.callspec.params["bag"] or "none")
    assert {(topic["topic"], topic["type"], topic["messages"]) for topic in info["topics"]} == {
        ("/car_state/odom", "nav_msgs/Odometry", COUNT),
        ("/car_state/pose", "geometry_msgs/PoseStamped", COUNT),
        ("/global_waypoints", "f110_msgs/WpntArray", 1),
        ("/tf", "tf2_msgs/TFMessage", COUNT),
        ("/vesc/sensors/imu/raw", "sensor_msgs/Imu", COUNT),
        (DRIVE_TOPIC, "ackermann_msgs/AckermannDriveStamped", COUNT),
    }


def test_messages_by_the_rosbag_api(bag):
    with rosbag.Bag(str(bag)) as reader:
        read = {topic: message for topic, message, _ in reader.read_messages()}
    odometry = read["/car_state/odom"]
    assert (odometry.header.frame_id, odometry.child_frame_id) == ("map", "base_link")
    assert (odometry.pose.pose.position.x, odometry.twist.twist.linear.y) == (COUNT - 1, 0.2)
    assert odometry.header.stamp.to_nsec() == T0 * 10**9 + (COUNT - 1) * 25 * 10**6
    assert read[DRIVE_TOPIC].drive.steering_angle == 0.25
    assert read["/vesc/sensors/imu/raw"].angular_velocity.z == 0.4
    (transform,) = read["/tf"].transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base_link")
    assert len(read["/global_waypoints"].wpnts) == 365
    assert read["/global_waypoints"].wpnts[0].vx_mps > 1.0
