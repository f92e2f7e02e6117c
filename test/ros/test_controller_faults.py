"""The running controller with faulty neighbors."""

import itertools
import math
import os
import signal
import socket
import sys

import pytest
from dynamic_reconfigure.client import Client
from geometry_msgs.msg import PoseStamped
from harness import ROOT, Car, Rig, wait_for, waypoints
from map_racing.msg import Guidance
from nav_msgs.msg import Odometry

from map_racing.nodes.waypoints import waypoint_array_class
from map_racing.track.files.load import load_raceline


def assert_sane(rig, v_max=12.0):
    """All commands and log lines so far are sane."""
    for message in list(rig.drive):
        speed, angle = message.drive.speed, message.drive.steering_angle
        assert 0.0 <= speed <= v_max * (1.0 + 1e-6), speed
        assert abs(angle) < 0.5, angle
    assert "Traceback" not in rig.node.output and "bad callback" not in rig.node.output


@pytest.fixture
def poses_only(ros, start, advertise, listen):
    """Controller and car with PoseStamped, which has no velocity."""
    cars = []

    def make(params=None):
        given = {"raceline": "reference", "pose_source": "pose", "max_pose_age_s": 0.8}
        node = start("controller", {**given, **(params or {})})
        publisher = advertise("/pose", PoseStamped)
        car = Car(ros, [lambda m: publisher.publish(PoseStamped(m.header, m.pose.pose))])
        cars.append(car)
        return Rig(car, node, listen)

    yield make
    for car in cars:
        car.stop()


def test_frozen_poses_without_velocity(poses_only):
    """First with fresh stamps, then with none."""
    rig = poses_only()
    rig.driving()
    for stamped in (True, False):
        rig.more(40)
        at = rig.car.message().pose

        def freeze(message, at=at, stamped=stamped):
            message.pose = at
            if not stamped:
                message.header.stamp = type(message.header.stamp)()
            return message

        rig.car.change = freeze
        # The ramp itself is tested call by call: on a busy computer, delayed poses leave gaps in
        # it.
        rig.wait_mode("stopped", "pose frozen while moving")
        rig.car.change = lambda message: message
        rig.driving()


def test_poses_of_two_nodes(rig, start):
    """With a second localization elsewhere, the car follows the first, and the log names both."""
    rig = rig()
    rig.driving()
    start("simulator", {"start_s": 20.0})
    text = "/odom: /simulator publishes it, too; only /test"
    wait_for(lambda: text in rig.node.output, what="the error")
    rig.more(100)
    rig.wait_mode("driving")
    assert_sane(rig)


def test_quaternions_of_any_length(rig, listen):
    """Some stacks fill in only w, or round: the heading is the same, and the log reports it."""
    rig = rig()
    lengths = itertools.cycle((0.5, 1.05, 2.0, 3.0))

    def scaled(message):
        length, q = next(lengths), message.pose.pose.orientation
        q.z, q.w = length * q.z, length * q.w
        return message

    rig.car.change = scaled
    guidance = listen("/guidance", Guidance)
    rig.driving()
    wait_for(lambda: len(guidance) > 100)
    raceline = rig.car.raceline
    for message in list(guidance):
        # The state is predicted over the delay, so it is at another place on the line.
        along = raceline.pose(message.s).psi
        assert abs(math.remainder(message.psi - along, math.tau)) < 0.1
    assert "quaternions of length" in rig.node.output
    rig.wait_mode("driving")


def test_a_raceline_the_other_way_round_waits_for_the_car_to_stand(rig, advertise):
    rig = rig({"raceline": None})
    raceline = load_raceline("reference")
    publisher = advertise("/global_waypoints", waypoint_array_class()[0])
    message = waypoints(raceline)
    publisher.publish(message)
    rig.driving()
    turned = waypoints(raceline)
    turned.wpnts = turned.wpnts[::-1]
    publisher.publish(turned)
    rig.wait_mode("stopped", "raceline against the motion")
    assert "runs against the motion of the car: it has to stop first" in rig.node.output
    # With the original raceline again, it drives on.
    publisher.publish(message)
    rig.driving()
    assert_sane(rig)


def test_a_burst_of_poses(rig):
    rig = rig()
    rig.driving()
    rig.car.silent = True
    (publish,) = rig.car.publishers
    messages = []
    for _ in range(1000):
        message = rig.car.message()
        message.header.stamp -= type(message.header.stamp - message.header.stamp).from_sec(30.0)
        messages.append(message)
    for message in messages:
        publish(message)
    rig.car.silent = False
    rig.driving()
    assert_sane(rig)


def test_poses_out_of_order(rig):
    rig = rig()
    rig.driving()
    held = []

    def shuffle(message):
        held.append(message)
        return held.pop(0) if len(held) > 1 and len(held) % 2 else held.pop()

    rig.car.change = shuffle
    rig.more(50)
    assert_sane(rig)


def test_nonsense_by_live_tuning(rig):
    rig = rig({"v_max_mps": 3.0})
    rig.driving()
    client = Client("/controller/tuning", timeout=10.0)
    names = [d["name"] for d in client.get_parameter_descriptions() if d["type"] == "double"]
    for name in names:
        client.update_configuration({name: math.nan})
    for value in (math.inf, -math.inf):
        client.update_configuration(dict.fromkeys(names, value))
    held = client.get_configuration(timeout=5.0)
    assert all(math.isfinite(held[name]) for name in names), held
    client.update_configuration({"steering_map": "magic"})
    rig.more(50)
    assert_sane(rig, 3.0)


def test_absurd_speeds_of_a_raceline(rig, advertise):
    """Large speeds are limited; values that are no speeds stop the car."""
    rig = rig({"raceline": None, "v_max_mps": 2.5})
    message = waypoints(load_raceline("reference"))
    publisher = advertise("/global_waypoints", waypoint_array_class()[0])
    for speed, mode in ((1e7, ("driving",)), (1e9, ("stopped", "raceline not drivable"))):
        for waypoint in message.wpnts:
            waypoint.vx_mps = speed
        publisher.publish(message)
        rig.wait_mode(*mode)
    assert max(m.drive.speed for m in rig.drive) == 2.5
    assert_sane(rig, 2.5)


def test_a_huge_raceline_while_driving(rig, advertise):
    rig = rig({"raceline": None})
    raceline = load_raceline("reference")
    publisher = advertise("/global_waypoints", waypoint_array_class()[0])
    publisher.publish(waypoints(raceline))
    huge = waypoints(raceline, points=20000)  # before driving: this process is the car, too
    rig.driving()
    mark = len(rig.drive)
    publisher.publish(huge)
    wait_for(lambda: rig.node.output.count("raceline of /global_waypoints") == 2)
    wait_for(lambda: len(rig.drive) > mark + 100)
    assert min(m.drive.speed for m in rig.drive[mark:]) > 1.0
    rig.wait_mode("driving")


def test_another_frame(rig):
    """Wheel odometry instead of the pose in the map; a nasty frame name does no harm."""
    rig = rig()

    def in_odom(message):
        message.header.frame_id = "odom\x1b[2J\n[INFO] driving"
        return message

    rig.driving()
    rig.car.change = in_odom
    rig.wait_mode("stopped", "pose in another frame")
    text = r"/odom: expected poses in the frame map, got one in odom\x1b[2J\n[INFO] driving (~map_f"
    assert text in rig.node.output and "\x1b[2J" not in rig.node.output
    rig.car.change = lambda message: message
    rig.driving()


def test_a_topic_of_another_type(start, advertise, listen):
    node = start("controller", {"raceline": "reference"})
    publisher = advertise("/odom", PoseStamped, subscribers=0)
    publisher.publish(PoseStamped())
    text = "publishes geometry_msgs/PoseStamped there, expected nav_msgs/Odometry)"
    wait_for(lambda: text in node.output, what="the line in the log")


def test_absurd_twists(rig):
    rig = rig()
    rig.driving()
    values = [1e7, -1e7, 1e200, -1e200, math.inf, math.nan]
    state = [0]

    def absurd(message):
        state[0] += 1
        value = values[state[0] // 5 % len(values)]
        message.twist.twist.linear.x = value
        message.twist.twist.linear.y = -value
        message.twist.twist.angular.z = value
        return message

    rig.car.change = absurd
    wait_for(lambda: state[0] > 60)
    assert_sane(rig)
    rig.car.change = lambda message: message
    rig.driving()


CLOCK = """
import os, sys, time
real, file = time.time, sys.argv[1]
def stepped():
    try:
        with open(file) as f:
            return real() + float(f.read() or 0.0)
    except FileNotFoundError:
        return real()
time.time = stepped
from map_racing.nodes import controller
controller.main()
"""


@pytest.mark.parametrize("step", [3600.0, -2.0])
def test_the_wall_clock_is_set(ros, processes, advertise, listen, tmp_path, step):
    """The clock of all nodes jumps; the car must not stop abruptly."""
    ros.set_param("/controller/raceline", "reference")
    ros.set_param("/controller/max_pose_age_s", 0.8)
    file = tmp_path / "step"
    node = processes([sys.executable, "-c", CLOCK, file, "__name:=controller"])
    publisher = advertise("/odom", Odometry)
    car = Car(ros, [publisher.publish])
    rig = Rig(car, node, listen)
    now = car.now
    try:
        rig.driving()
        temporary = tmp_path / "new"
        temporary.write_text(str(step))
        temporary.rename(file)
        car.now = lambda: now() + ros.Duration.from_sec(step)
        rig.more(50)
        rig.driving()
        # A stop begins at the measured speed if the command was higher.
        speeds = [min(m.drive.speed, car.speed) for m in rig.drive]
        begin = next(k for k, v in enumerate(speeds) if v > 1.0)
        falls = [a - b for a, b in zip(speeds[begin:], speeds[begin + 1 :])]
        assert max(falls) < 0.5, (max(falls), node.output)
        assert_sane(rig)
    finally:
        car.stop()


def test_an_interrupt_while_it_asks_the_master(processes, roscore):
    """Ctrl-C in the first second, which is spent on requests to the master."""
    code = """
import os, signal, threading, xmlrpc.client
request, count = xmlrpc.client.Transport.single_request, [0]
def interrupted(*arguments, **options):
    if threading.current_thread() is threading.main_thread():
        count[0] += 1
        if count[0] == 20:
            os.kill(os.getpid(), signal.SIGINT)
    return request(*arguments, **options)
xmlrpc.client.Transport.single_request = interrupted
from map_racing.nodes import controller
controller.main()
"""
    node = processes([sys.executable, "-c", code, "__name:=controller"])
    assert node.wait() == 0
    assert "Traceback" not in node.output


def test_without_a_master_it_says_so_and_can_be_interrupted(processes, roscore):
    environment = {**os.environ, "ROS_MASTER_URI": "http://127.0.0.1:9"}
    node = processes([sys.executable, ROOT / "scripts/controller"], environment)
    wait_for(lambda: "no ROS master at http://127.0.0.1:9" in node.output)
    node.signal(signal.SIGINT)
    assert node.wait() == 130
    assert "Traceback" not in node.output


def test_an_interrupt_while_it_looks_for_a_master(processes, roscore):
    """rosgraph treats any exception, even KeyboardInterrupt, as a master that does not answer."""
    code = """
import os, signal, rosgraph
def interrupted(self):
    os.kill(os.getpid(), signal.SIGINT)
    raise ConnectionRefusedError
rosgraph.Master.getPid = interrupted
from map_racing.nodes import controller
controller.main()
"""
    node = processes([sys.executable, "-c", code])
    assert node.wait() == 130
    assert "Traceback" not in node.output


def test_the_master_goes_and_comes_again(roscore, processes, tmp_path):
    """Existing connections stay: the car drives on, and the log says what no longer works."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    uri = f"http://127.0.0.1:{port}"
    environment = {**os.environ, "ROS_MASTER_URI": uri, "ROS_LOG_DIR": str(tmp_path)}

    def master():
        core = processes(["roscore", "-p", port], environment)
        wait_for(lambda: "/rosout" in core.output, 30.0, "roscore")
        return core

    core = master()
    processes([sys.executable, ROOT / "scripts/simulator"], environment)
    code = """
from map_racing.nodes import controller, node
node.MASTER_PERIOD_S = 0.5
controller.main()
"""
    node = processes([sys.executable, "-c", code, "_raceline:=reference"], environment)
    wait_for(lambda: "[INFO] driving" in node.output, 30.0)
    core.stop()
    wait_for(lambda: f"the ROS master at {uri} does not answer" in node.output, 30.0)
    master()
    wait_for(lambda: "restarted and does not know this node" in node.output, 30.0)
    assert "stop" not in node.output.rpartition("[INFO] driving")[2]
    node.signal(signal.SIGINT)
    assert node.wait() == 0
    assert "Traceback" not in node.output
