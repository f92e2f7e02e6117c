"""The visualizer draws the guidance that it receives, and cleans up after itself."""

import itertools
import math
import threading
import time
from operator import attrgetter

import pytest
from harness import wait_for, waypoints
from map_racing.msg import Belief, Guidance
from nav_msgs.msg import Odometry
from visualization_msgs.msg import Marker, MarkerArray

from map_racing.nodes import lookahead_visualizer
from map_racing.nodes.conversions import set_plane_pose, to_time
from map_racing.nodes.lookahead_visualizer import ERROR_COLORS
from map_racing.nodes.waypoints import waypoint_array_class
from map_racing.track.files.load import load_raceline

PARAMETERS = {"rate": 50.0}


def guidance(i, **changes):
    """A car that drives 5 m/s along x, 0.1 m beside its line, at 40 Hz."""
    eta = math.atan2(-0.1, 1.0)
    message = Guidance(
        mode=Guidance.MODE_DRIVING,
        status="ok",
        x=0.125 * i,
        y=0.1,
        v_x=5.0,
        d=0.1,
        lookahead_x=0.125 * i + 1.0,
        lookahead_distance=math.hypot(1.0, 0.1),
        eta=eta,
        a_lat=-4.9,
        a_lat_max=7.0,
        steering_angle=-0.05,
        speed=5.0,
    )
    message.header.stamp = to_time(10**12 + 25 * 10**6 * i)
    message.header.frame_id = "map"
    for name, value in changes.items():
        setattr(message, name, value)
    return message


class Screen(dict):
    """The markers that RViz would show: ``(ns, id)`` to marker."""

    def __init__(self, inbox):
        self.cleared = 0
        for array in list(inbox):
            for marker in array.markers:
                if marker.action == Marker.DELETEALL:
                    self.clear()
                    self.cleared += 1
                elif marker.action == Marker.DELETE:
                    self.pop((marker.ns, marker.id), None)
                else:
                    self[marker.ns, marker.id] = marker

    def __getattr__(self, namespace):
        return self[namespace, 0]


@pytest.fixture
def drawing(start, listen, advertise, ros):
    """Function that publishes messages, waits until all are drawn, and gives the Screen."""
    node = start("lookahead_visualizer", PARAMETERS)
    inbox = listen("/lookahead_markers", MarkerArray)
    point = listen("/lookahead_point", Marker)
    publisher = advertise("/guidance", Guidance)
    while not any(topic == "/lookahead_markers" for topic, _ in ros.get_published_topics()):
        ros.sleep(0.05)
    # Markers are made only for subscribers: wait until the node knows this one.
    probe = guidance(0)
    while not (inbox and point):
        probe.header.stamp += ros.Duration(0.1)
        publisher.publish(probe)
        ros.sleep(0.05)
    ros.sleep(0.2)

    def draw(messages):
        assert node.running, node.output
        for message in messages:
            publisher.publish(message)
            # Slower than the node, which shows the latest message and may skip old ones.
            time.sleep(0.01)
        inbox.wait(lambda _: inbox[-1].markers[0].pose.position.x == message.lookahead_x)
        return Screen(inbox)

    draw.inbox, draw.point = inbox, point
    return draw


def test_all_is_drawn_where_guidance_says(drawing):
    screen = drawing(guidance(i) for i in range(8000, 8040))
    last = guidance(8039)
    assert screen.cleared == 1, "one for what an earlier node left behind"
    shown = {"lookahead", "distance", "arc", "steering", "car", "trail"}
    assert {namespace for namespace, _ in screen} == shown
    assert all(marker.lifetime.to_sec() > 0.0 for marker in screen.values())
    at = screen.lookahead.pose.position
    assert (at.x, at.y) == (last.lookahead_x, 0.0)
    for p in screen.distance.points:
        assert math.hypot(p.x - last.x, p.y - last.y) == pytest.approx(math.hypot(1.0, 0.1))
    arc = screen.arc.points
    assert (arc[0].x, arc[0].y) == (last.x, last.y)
    assert (arc[-1].x, arc[-1].y) == pytest.approx((last.lookahead_x, 0.0), abs=1e-9)
    assert arc[1].y == pytest.approx(last.y, abs=1e-3), "along the velocity at first"
    steering = screen.steering
    assert steering.header.frame_id == screen.car.header.frame_id == "base_link"
    assert 2.0 * math.atan2(
        steering.pose.orientation.z, steering.pose.orientation.w
    ) == pytest.approx(-0.05)
    assert drawing.point[-1].type == Marker.SPHERE
    drawing.point.wait(lambda _: drawing.point[-1].pose.position.x == last.lookahead_x)


def test_the_trail_is_colored_by_the_error_and_bounded(drawing):
    screen = drawing(guidance(i, d=0.0 if i < 8550 else 0.5) for i in range(8000, 8600))
    trail = screen.trail
    assert len(trail.points) == len(trail.colors)
    assert 14.0 < trail.points[-1].x - trail.points[0].x <= 15.0
    colors = [(color.r, color.g, color.b) for color in trail.colors]
    assert colors[0] == pytest.approx(ERROR_COLORS[0])
    assert colors[-1] == pytest.approx(ERROR_COLORS[1])


def test_more_than_the_grip_is_said_and_taken_back(drawing):
    screen = drawing([guidance(8000, saturated=True, a_lat=-9.12)])
    assert screen.label.text == "9.1 of 7.0 m/s2"
    color = screen.arc.color
    screen = drawing([guidance(8001)])
    assert ("label", 0) not in screen
    assert screen.arc.color != color
    screen = drawing([guidance(8002, mode=Guidance.MODE_STOPPING, reason="pose too old")])
    assert screen.label.text == "stopping: pose too old"


def test_the_grip_that_is_believed_is_written_as_long_as_it_is_told(drawing, advertise):
    publisher, steps = advertise("/map_racing/belief", Belief), itertools.count(0, 2)
    belief = Belief(grip=0.93, friction=0.97, friction_low=0.944, friction_high=1.0)
    belief.header.stamp = guidance(8000).header.stamp
    publisher.publish(belief)
    wait_for(lambda: ("label", 0) in drawing([guidance(8000 + next(steps))]), what="the label")
    assert drawing([guidance(8018)]).label.text == "grip 0.93, friction 0.94 to 1.00"
    screen = drawing([guidance(8019, saturated=True, a_lat=-9.12)])
    assert screen.label.text == "9.1 of 7.0 m/s2\ngrip 0.93, friction 0.94 to 1.00"
    assert ("label", 0) not in drawing([guidance(8040)])


def test_what_is_not_finite_is_not_drawn(drawing):
    screen = drawing(
        [guidance(8000), guidance(8001, steering_angle=math.inf), guidance(8002, lookahead_y=1.0)]
    )
    assert screen.lookahead.pose.position.y == 1.0


def test_a_jump_back_in_time_clears_the_screen(drawing):
    drawing(guidance(i) for i in range(8000, 8100))
    count = len(drawing.inbox)
    drawing(guidance(i) for i in range(4000, 4020))
    assert drawing.inbox[count].markers[0].action == Marker.DELETEALL
    trail = Screen(drawing.inbox).trail
    assert max(p.x for p in trail.points) <= 0.125 * 4020


def test_a_car_put_elsewhere_leaves_no_line_across_the_map(drawing):
    screen = drawing(
        [
            *(guidance(i) for i in range(8000, 8040)),
            *(guidance(i, y=9.0) for i in range(8040, 8080)),
        ]
    )
    assert {p.y for p in screen.trail.points} == {9.0}


def test_a_replay_without_guidance_shows_car_and_trail(start, listen, advertise):
    """0.2 m to the left of a line."""
    node = start("lookahead_visualizer", {**PARAMETERS, "trail_error": 0.4})
    inbox = listen("/lookahead_markers", MarkerArray)
    raceline = load_raceline("reference")
    advertise("/global_waypoints", waypoint_array_class()[0], latch=True).publish(
        waypoints(raceline)
    )
    publisher = advertise("/odom", Odometry)
    message = Odometry()
    message.header.frame_id = "/map"
    for x in (math.nan, 1e300):
        set_plane_pose(message.pose.pose, x, 0.0, 0.0)
        publisher.publish(message)
    for k in range(200):
        point = raceline.pose(0.05 * k)
        x, y = point.x - 0.2 * math.sin(point.psi), point.y + 0.2 * math.cos(point.psi)
        set_plane_pose(message.pose.pose, x, y, point.psi)
        message.header.stamp = to_time(10**12 + 10**7 * k)
        publisher.publish(message)
        time.sleep(0.01)
    inbox.wait(lambda m: any(marker.ns == "trail" for marker in m.markers))
    screen = Screen(inbox)
    assert {namespace for namespace, _ in screen} == {"car", "trail"}
    assert screen.trail.header.frame_id == "map"
    assert "Traceback" not in node.output
    middle = [0.5 * (a + b) for a, b in zip(*ERROR_COLORS)]
    color = screen.trail.colors[-1]
    assert (color.r, color.g, color.b) == pytest.approx(middle, abs=0.01)


def test_the_raceline_of_whoever_publishes_it_is_drawn(start, listen):
    start("lookahead_visualizer")
    start("raceline_publisher", {"raceline": "reference"})
    drawn = listen("/course_markers", MarkerArray).wait().markers
    expected = listen("/raceline_markers", MarkerArray).wait().markers
    assert drawn[0].action == Marker.DELETEALL
    assert [(m.ns, m.id) for m in drawn[1:]] == [("raceline", 0), ("walls", 0), ("walls", 1)]
    for one, other in zip(drawn[1:], expected[1:]):
        assert len(one.points) == len(other.points)
        for p, q in zip(one.points, other.points):
            # The curve through the published points differs slightly from the file's.
            assert math.hypot(p.x - q.x, p.y - q.y) < (1e-3 if one.ns == "raceline" else 5e-3)


@pytest.mark.parametrize("first", ["global_waypoints", "driven_waypoints"])
def test_the_raceline_has_the_colors_of_the_speeds_that_are_driven(start, listen, advertise, first):
    raceline = load_raceline("reference")
    start("lookahead_visualizer")
    drawn = listen("/course_markers", MarkerArray)
    array = waypoint_array_class()[0]
    topics = {
        name: advertise(f"/{name}", array) for name in ("global_waypoints", "driven_waypoints")
    }
    driven = waypoints(raceline)
    for waypoint in driven.wpnts:
        waypoint.vx_mps = 2.0 if waypoint.s_m < 0.5 * raceline.length else 6.0
    messages = {"global_waypoints": waypoints(raceline), "driven_waypoints": driven}
    topics[first].publish(messages.pop(first))
    time.sleep(0.5)
    for name, message in messages.items():
        topics[name].publish(message)

    def colors():
        line = next(m for m in drawn[-1].markers if m.ns == "raceline")
        return {(round(c.r, 2), round(c.g, 2), round(c.b, 2)) for c in line.colors}

    # Two speeds, and interpolated ones where they change.
    wait_for(lambda: drawn and len(colors()) <= 8, what="the colors of two speeds")
    # Speeds of another track do not apply to this one.
    topics["driven_waypoints"].publish(array(wpnts=driven.wpnts[:100]))
    wait_for(lambda: len(colors()) > 20, what="the colors of the raceline's own speeds")


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"vehicle": "tank"}, "tank: no such file"),
        ({"rate": 0.0}, "~rate: expected a positive number"),
        ({"trail_length": -1.0}, "~trail_length: expected 0 to 1000 m"),
    ],
)
def test_what_cannot_be_is_one_line(parameters, text, refused):
    assert text in refused("lookahead_visualizer", parameters)


def test_slashes_before_frames_are_none(no_master):
    """RViz knows no frames with a leading slash."""
    no_master.params.update({"~map_frame": "/map", "~base_frame": "/car/base_link"})
    node = lookahead_visualizer.LookaheadVisualizer()
    node._draw_raceline(load_raceline("reference"))
    (course,) = node._course.sent
    assert {marker.header.frame_id for marker in course.markers[1:]} == {"map"}
    assert node._drawn_car().header.frame_id == "car/base_link"


def test_guidance_and_poses_that_come_at_once(no_master, monkeypatch):
    """Each topic has a thread of its own: a pose may come while the trail is being drawn."""
    no_master.params["~rate"] = 1000.0
    node = lookahead_visualizer.LookaheadVisualizer()
    node._draw_raceline(load_raceline("reference"))
    raceline, color, threads = load_raceline("reference"), lookahead_visualizer.error_color, []

    def receive(i):
        point, message = raceline.pose(0.1 * i), Odometry()
        message.header.stamp = to_time(10**12 + 10**9 * i)
        set_plane_pose(message.pose.pose, point.x, point.y, point.psi)
        node._receive_pose(message, attrgetter("pose.pose"))

    def interrupted(fraction):
        if not threads:
            threads.append(threading.Thread(target=receive, args=(20,)))
            threads[0].start()
            threads[0].join(0.2)
        return color(fraction)

    monkeypatch.setattr(lookahead_visualizer, "error_color", interrupted)
    for i in range(10):
        receive(i)
    threads[0].join()
    trails = [m for array in node._markers.sent for m in array.markers if m.ns == "trail"]
    assert len(trails) >= 9
    assert all(len(trail.points) == len(trail.colors) for trail in trails)
