"""Messages to the package's types and back; only the subscriber needs a master."""

import io
import math
import time

import genpy
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Pose, TransformStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from map_racing.bags import messages
from map_racing.errors import RacelineError
from map_racing.nodes.conversions import (
    StateReader,
    frame,
    plane_pose,
    set_plane_pose,
    stamp_ns,
    to_time,
)
from map_racing.nodes.waypoints import (
    RacelineSubscriber,
    raceline_from_message,
    waypoint_array_class,
)


@pytest.mark.parametrize("psi", [-3.0, -0.1, 0.0, 2.5])
def test_plane_pose_round_trip(psi):
    pose = Pose()
    set_plane_pose(pose, 1.0, -2.0, psi)
    assert plane_pose(pose) == pytest.approx((1.0, -2.0, psi))


@pytest.mark.parametrize("length", [0.5, 1.05, 2.0, 3.0])
@pytest.mark.parametrize("psi", [-3.0, -0.1, 0.0, 2.5])
def test_quaternions_of_any_length_are_the_same_heading(psi, length):
    pose = Pose()
    set_plane_pose(pose, 1.0, 2.0, psi)
    q = pose.orientation
    q.z, q.w = length * q.z, length * q.w
    assert plane_pose(pose) == pytest.approx((1.0, 2.0, psi))


def test_a_quaternion_that_nobody_filled_in_is_no_heading():
    assert math.isnan(plane_pose(Pose())[2])


@pytest.mark.parametrize("x", [math.nan, math.inf, 1e9, -1e300])
def test_what_is_no_place_on_earth_is_none(x):
    pose = Pose()
    set_plane_pose(pose, x, 1.0, 0.5)
    assert math.isnan(plane_pose(pose)[0]) and math.isnan(plane_pose(pose)[1])
    assert plane_pose(pose)[2] == pytest.approx(0.5)


def test_stamps():
    ns = 1795488573_453447123
    assert stamp_ns(Header(stamp=to_time(ns)), 5) == ns
    assert stamp_ns(Header(), 5) == 5
    assert to_time(ns) == genpy.Time(1795488573, 453447123)


def test_frames_lose_their_slash():
    assert [frame(name) for name in ("/map", "map", "")] == ["map", "map", ""]


def odometry(x, v_x, v_y, r):
    message = Odometry()
    set_plane_pose(message.pose.pose, x, 0.0, 0.0)
    message.twist.twist.linear.x, message.twist.twist.linear.y = v_x, v_y
    message.twist.twist.angular.z = r
    return message


def test_twists_are_taken_as_measured_once_they_are_not_zero():
    reader = StateReader()
    assert reader.odometry(odometry(0.0, 2.0, 0.1, 0.5), 1.0)[4:] == (2.0, 0.1, 0.5)
    assert reader.odometry(odometry(0.0, 0.0, 0.0, 0.0), 1.1)[4:] == (0.0, 0.0, 0.0)


def test_what_no_twist_has_comes_from_the_poses():
    reader = StateReader()
    for k in range(5):
        state = reader.odometry(odometry(0.1 * k, 0.0, 0.0, 0.0), 0.05 * k)
    assert state.v_x == pytest.approx(2.0)
    assert math.isnan(state.v_y)
    assert state.r == 0.0


def test_lateral_velocity_that_is_never_sent_is_unknown():
    state = StateReader().odometry(odometry(0.0, 3.0, 0.0, 1.0), 0.0)
    assert (state.v_x, state.r) == (3.0, 1.0)
    assert math.isnan(state.v_y)


# -- transforms ----------------------------------------------------------------------------------


def test_a_transform_without_rotation_is_no_pose(ros, advertise, start, listen):
    """Zeros that were never filled in are not a heading along x."""
    start("controller", {"raceline": "reference", "pose_source": "tf"})
    publisher, diagnostics = advertise("/tf", TFMessage), listen("/diagnostics", DiagnosticArray)
    transform = TransformStamped(child_frame_id="base_link")
    transform.header.frame_id = "map"

    def refused(message):
        transform.header.stamp = ros.Time.now()
        publisher.publish(TFMessage([transform]))
        return "pose not finite" in message.status[0].message

    diagnostics.wait(refused)


# -- waypoints -----------------------------------------------------------------------------------


class Received:
    """A message as rospy passes it to a subscriber of AnyMsg."""

    def __init__(self, message, kind="f110_msgs/WpntArray", definition=None):
        buffer = io.BytesIO()
        message.serialize(buffer)
        self._buff = buffer.getvalue()
        self._connection_header = {
            "type": kind,
            "md5sum": message._md5sum,
            "message_definition": definition or message._full_text,
        }


def circle(points=40, radius=3.0):
    array, waypoint = waypoint_array_class()
    message = array()
    for k in range(points):
        angle = 2.0 * math.pi * k / points
        x, y = radius * math.cos(angle), radius * math.sin(angle)
        message.wpnts.append(waypoint(id=k, x_m=x, y_m=y, vx_mps=2.5))
    return message


def test_the_generated_class_is_the_published_one():
    array, _ = waypoint_array_class()
    assert array._type == "f110_msgs/WpntArray"
    assert array._md5sum == messages.MD5[messages.WAYPOINTS]


def test_raceline_of_the_known_version():
    raceline = raceline_from_message(Received(circle()), "/global_waypoints")
    assert raceline.length == pytest.approx(6.0 * math.pi, rel=1e-6)
    assert raceline.speed_at(1.0) == 2.5
    assert raceline.d_left is None


def test_raceline_of_another_version_by_its_own_definition():
    from genpy.dynamic import generate_dynamic

    definition = (
        "std_msgs/Header header\nother_msgs/Wpnt[] wpnts\n"
        + f"\n{'=' * 80}\nMSG: std_msgs/Header\n{Header._full_text}"
        + f"\n{'=' * 80}\nMSG: other_msgs/Wpnt\n"
        + "float32 vx_mps\nfloat64 y_m\nfloat64 x_m\nstring note\n"
    )
    kinds = generate_dynamic("other_msgs/WpntArray", definition)
    message = kinds["other_msgs/WpntArray"]()
    for waypoint in circle().wpnts:
        message.wpnts.append(kinds["other_msgs/Wpnt"](2.5, waypoint.y_m, waypoint.x_m, "anything"))
    received = Received(message, "other_msgs/WpntArray", definition)
    raceline = raceline_from_message(received, "/waypoints")
    assert raceline.length == pytest.approx(6.0 * math.pi, rel=1e-6)
    assert raceline.speed_at(1.0) == 2.5


@pytest.mark.parametrize(
    "change, text",
    [
        (lambda m: m.wpnts.clear(), "expected waypoints"),
        (lambda m: m.wpnts.__delitem__(slice(3, None)), "at least 4 distinct points"),
        (lambda m: setattr(m.wpnts[5], "y_m", math.nan), "finite y, got .*, at point 5:"),
        (lambda m: setattr(m.wpnts[5], "vx_mps", -1.0), "a speed >= 0 .*, at point 5:"),
    ],
)
def test_nonsense_is_refused_by_topic_and_point(change, text):
    message = circle()
    change(message)
    with pytest.raises(RacelineError, match=text) as error:
        raceline_from_message(Received(message), "/global_waypoints")
    assert str(error.value).startswith("/global_waypoints: ")


def test_other_types_and_damaged_messages_are_refused():
    with pytest.raises(RacelineError, match="expected f110_msgs/WpntArray, got std_msgs/Header"):
        raceline_from_message(Received(Header(), "std_msgs/Header"), "/global_waypoints")
    received = Received(circle())
    received._buff = received._buff[:100]
    with pytest.raises(RacelineError, match="cannot read f110_msgs/WpntArray"):
        raceline_from_message(received, "/global_waypoints")


def test_the_subscriber_tells_new_from_repeated(ros, advertise):
    lines, errors = [], []
    RacelineSubscriber(lines.append, errors.append)
    publisher = advertise("/global_waypoints", waypoint_array_class()[0])
    other, nonsense = circle(radius=4.0), circle(points=2)
    for k, message in enumerate((circle(), circle(), other, other, nonsense, nonsense, circle())):
        message.header.stamp = to_time(k)
        publisher.publish(message)
    end = time.monotonic() + 10.0
    while len(lines) < 3 and time.monotonic() < end:
        time.sleep(0.02)
    lengths = [round(line.length / (2.0 * math.pi), 3) for line in lines]
    assert lengths == [3.0, 4.0, 3.0]
    assert len(errors) == 1
