"""What all nodes have in common."""

import sys

import pytest
import rosgraph
from harness import wait_for
from nav_msgs.msg import Odometry

from map_racing.nodes.node import why_silent

NODES = (
    "controller",
    "lap_evaluator",
    "lookahead_visualizer",
    "raceline_publisher",
    "steering_ramp",
)


@pytest.fixture
def simulated_time(ros):
    ros.set_param("/use_sim_time", True)
    yield
    ros.delete_param("/use_sim_time")


def test_simulated_time_that_does_not_run_is_named(simulated_time, start):
    """A simulation may leave it on the parameter server; then everything waits."""
    # Separate interpreters, in which each node must make all its imports.
    nodes = {name: start(name, python=sys.executable) for name in NODES}
    text = "/use_sim_time is true, but there is no time on /clock (nobody publishes it)"
    for name, node in nodes.items():
        wait_for(lambda: text in node.output, 30.0, name)  # noqa: B023


@pytest.fixture
def publish(ros):
    """``publish("/odom", "nav_msgs/Odometry")`` registers another node's topic with the master."""
    uri, topics = "http://localhost:1/", []
    master = rosgraph.Master("/localization")

    def register(topic, kind):
        topics.append(topic)
        master.registerPublisher(topic, kind, uri)

    yield register
    for topic in topics:
        master.unregisterPublisher(topic, uri)


def test_where_there_are_poses_is_told_if_they_do_not_come(publish, advertise):
    """As for the topics of a bag during evaluation."""
    assert why_silent("/odom", "nav_msgs/Odometry") == "nobody publishes it"
    advertise("/driven_poses", Odometry, subscribers=0)
    assert why_silent("/odom", "nav_msgs/Odometry") == "nobody publishes it", "its own are none"
    for name in ("/pf/pose/odom", "/car_state/odom"):
        publish(name, "nav_msgs/Odometry")
    publish("/car_state/pose", "geometry_msgs/PoseStamped")
    found = (
        "/car_state/odom (nav_msgs/Odometry), /car_state/pose (geometry_msgs/PoseStamped), "
        "/pf/pose/odom (nav_msgs/Odometry)"
    )
    for kind in ("nav_msgs/Odometry", "geometry_msgs/PoseStamped"):
        assert why_silent("/odom", kind) == f"nobody publishes it; there is {found}"
    assert why_silent("/clock", "rosgraph_msgs/Clock") == "nobody publishes it"
    silent = why_silent("/pf/pose/odom", "nav_msgs/Odometry")
    assert silent.endswith("it, but no message has arrived")
    odom = "/car_state/odom (nav_msgs/Odometry), "
    wrong = why_silent("/car_state/odom", "geometry_msgs/PoseStamped")
    assert wrong.startswith("/localization publishes nav_msgs/Odometry there")
    assert wrong.endswith(f"; there is {found.replace(odom, '')}")
    for k in range(12):
        publish(f"/p{k:02d}", "nav_msgs/Odometry")
    last = ", /p09 (nav_msgs/Odometry), ..."
    assert why_silent("/odom", "nav_msgs/Odometry").endswith(last)
