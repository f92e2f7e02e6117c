"""The raceline on topics is the raceline of the file."""

import numpy as np
import pytest
import rospy
from nav_msgs.msg import Path
from visualization_msgs.msg import Marker, MarkerArray

from map_racing.bags.messages import MD5, WAYPOINTS
from map_racing.nodes.waypoints import raceline_from_message
from map_racing.track.files.load import load_raceline


def test_waypoints_are_the_raceline_and_come_again(start, listen):
    inbox = listen("/global_waypoints", rospy.AnyMsg)
    start("raceline_publisher", {"raceline": "club", "period": 0.2, "speed_scale": 0.5})
    inbox.wait(lambda _: len(inbox) > 3)
    header = inbox[0]._connection_header
    assert header["type"] == WAYPOINTS and header["md5sum"] == MD5[WAYPOINTS]
    assert header["latching"] == "1"
    sent, club = raceline_from_message(inbox[0], "/global_waypoints"), load_raceline("club")
    assert [finding.code for finding in sent.findings] == ["heading-x"]
    assert sent.length == pytest.approx(club.length, abs=1e-4)
    at = np.linspace(0.0, club.length, 500)
    for name, factor, error in (("x", 1, 1e-4), ("y", 1, 1e-4), ("speed", 0.5, 0.02)):
        expected = factor * getattr(club.sample(at), name)
        assert getattr(sent.sample(at), name) == pytest.approx(expected, abs=error)


def test_sectors(start, listen, tmp_path):
    sectors = tmp_path / "speed_scaling.yaml"
    sectors.write_text(
        "global_limit: 1.0\nn_sectors: 1\nSector0: {start: 0, end: 100, scaling: 0.25}\n"
    )
    inbox = listen("/global_waypoints", rospy.AnyMsg)
    start("raceline_publisher", {"sectors": str(sectors)})
    sent = raceline_from_message(inbox.wait(), "/global_waypoints")
    reference = load_raceline("reference")
    for s, scale in ((3.0, 0.25), (20.0, 1.0)):
        assert sent.speed_at(s) == pytest.approx(scale * reference.speed_at(s), abs=0.02)


def test_path_and_markers_close_and_carry_the_speed(start, listen):
    paths, arrays = listen("/raceline_path", Path), listen("/raceline_markers", MarkerArray)
    start("raceline_publisher")
    path = paths.wait()
    assert path.header.frame_id == "map" and path.poses[0].pose == path.poses[-1].pose
    clear, line, left, right = arrays.wait().markers
    assert clear.action == Marker.DELETEALL
    assert (line.ns, left.ns, right.ns) == ("raceline", "walls", "walls")
    assert len(line.colors) == len(line.points) == len(left.points) == len(path.poses)
    # Yellow where it is fastest, violet where it is slowest.
    reference = load_raceline("reference")
    speeds = [reference.speed_at(reference.project(p.x, p.y).s) for p in line.points]
    assert line.colors[int(np.argmax(speeds))].g > 0.85
    assert line.colors[int(np.argmin(speeds))].g < 0.05
    wall = [reference.project(point.x, point.y).d for point in left.points]
    assert min(wall) > 0.3 and max(reference.project(p.x, p.y).d for p in right.points) < -0.3


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"raceline": "nowhere"}, "nowhere: no such file"),
        ({"speed_scale": -1.0}, "speed_scale: expected a scale from 0 to 2"),
        ({"period": 0.0}, "~period: expected a positive number, got 0.0"),
    ],
)
def test_what_it_refuses_it_says_in_a_line(refused, parameters, words):
    assert words in refused("raceline_publisher", parameters)
