"""The identification drive on the running nodes: button, area, end."""

import itertools
import math
import signal

import numpy as np
import pytest
from ackermann_msgs.msg import AckermannDriveStamped
from harness import wait_for
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool

FAST = {"rate_radps": 0.1, "settle_s": 0.2, "acceleration_mps2": 8.0, "limit_rad": 0.3}


@pytest.fixture
def field(start, tmp_path):
    """The simulated car on a circle without walls."""
    path = tmp_path / "field.csv"
    angle = np.linspace(0.0, 2.0 * math.pi, 100, endpoint=False)
    rows = [f"{10.0 * math.cos(a)},{10.0 * math.sin(a)},2.0" for a in angle]
    path.write_text("\n".join(["# x_m,y_m,vx_mps", *rows]) + "\n")
    start("simulator", {"raceline": str(path)})


@pytest.fixture
def hold(ros, advertise):
    """Hold the dead-man button, like a joystick with autorepeat, until released."""
    timers = []

    def begin(topic, kind, message):
        publisher = advertise(topic, kind)
        timer = ros.Timer(ros.Duration(0.05), lambda _: publisher.publish(message))
        timers.append(timer)
        return timer

    yield begin
    for timer in timers:
        timer.shutdown()
        timer.join()


def joy(button, count=8):
    return Joy(buttons=[int(index == button) for index in range(count)])


def odometry_at(ros, x, speed=0.0, frame="odom"):
    message = Odometry()
    message.header.stamp, message.header.frame_id = ros.Time.now(), frame
    message.pose.pose.position.x, message.pose.pose.orientation.w = x, 1.0
    message.twist.twist.linear.x = speed
    return message


def test_both_sides_then_the_end(field, start, hold, listen):
    commands = listen("/drive", AckermannDriveStamped)
    node = start("steering_ramp", {**FAST, "radius": 20.0})
    hold("/joy", Joy, joy(5))
    assert node.wait(60.0) == 0 and "done: 2 ramps" in node.output
    assert "[INFO] the first circle" in node.output
    angles = [m.drive.steering_angle for m in commands]
    assert max(angles) == pytest.approx(0.3, abs=1e-6)
    assert min(angles) == pytest.approx(-0.3, abs=1e-6)
    assert max(m.drive.speed for m in commands) == 2.0
    assert [m.drive.speed for m in list(commands)[-5:]] == [0.0] * 5


def test_the_room_is_told_before_the_start(start):
    node = start("steering_ramp", {"speed_mps": 3.0, "sides": "left"})
    wait_for(lambda: "rad and 3 m/s, is 9.6 m wide with the tires of NUC4" in node.output)
    assert "[WARN] the first circle" in node.output and "start at 0.13 rad" in node.output


def test_another_button_does_not_count(field, start, hold, listen):
    commands = listen("/drive", AckermannDriveStamped)
    start("steering_ramp", FAST)
    hold("/joy", Joy, joy(4))
    commands.wait(lambda _: len(commands) > 60)
    assert {m.drive.speed for m in commands} == {0.0}


def test_letting_go_stops_the_car(field, start, hold, listen):
    commands, odometry = listen("/drive", AckermannDriveStamped), listen("/odom", Odometry)
    start("steering_ramp", FAST)
    held = hold("/enable", Bool, Bool(True))
    odometry.wait(lambda m: m.twist.twist.linear.x > 1.7)
    held.shutdown()
    let_go = len(commands)
    commands.wait(lambda m: m in list(commands)[let_go:] and m.drive.speed == 0.0)
    moved = odometry[-1].header.stamp
    odometry.wait(lambda m: m.header.stamp > moved and abs(m.twist.twist.linear.x) < 0.2)


def test_outside_of_the_area_the_car_stops(field, start, hold, listen):
    odometry = listen("/odom", Odometry)
    node = start("steering_ramp", {**FAST, "radius": 1.0})
    hold("/enable", Bool, Bool(True))
    odometry.wait(lambda _: "outside of the area" in node.output, 20.0)
    left = odometry[-1].header.stamp
    odometry.wait(
        lambda m: (m.header.stamp - left).to_sec() > 1.0 and abs(m.twist.twist.linear.x) < 0.2
    )
    first, last = odometry[0].pose.pose.position, odometry[-1].pose.pose.position
    assert 0.9 < math.hypot(last.x - first.x, last.y - first.y) < 2.0


def test_without_a_button_it_warns(field, start, listen):
    commands = listen("/drive", AckermannDriveStamped)
    node = start("steering_ramp", {**FAST, "dead_man": False})
    commands.wait(lambda m: m.drive.speed > 1.0)
    assert "driving without a dead-man button" in node.output
    at = len(commands)
    node.signal(signal.SIGINT)
    assert node.wait() == 0
    assert any(m.drive.speed == 0.0 for m in list(commands)[at:])


@pytest.fixture
def poses(ros, start, advertise, hold):
    """Start the node and send it poses of a car that moves slowly, at 40 Hz.

    ``change(message, k)`` alters the k-th of them.
    """
    timers = []

    def begin(change=lambda message, k: None):
        node = start("steering_ramp", FAST)
        hold("/enable", Bool, Bool(True))
        publisher, count = advertise("/odom", Odometry), itertools.count()

        def send(_):
            k = next(count)
            message = odometry_at(ros, 0.02 * k, 0.05)
            change(message, k)
            publisher.publish(message)

        timers.append(ros.Timer(ros.Duration(0.025), send))
        return node, timers[-1]

    yield begin
    for timer in timers:
        timer.shutdown()
        timer.join()


def test_a_stop_where_poses_stop_coming(poses, listen):
    commands = listen("/drive", AckermannDriveStamped)
    _, sending = poses()
    commands.wait(lambda m: m.drive.speed > 1.0)
    sending.shutdown()
    silent = len(commands)
    commands.wait(lambda m: m in list(commands)[silent:] and m.drive.speed == 0.0)


def test_the_area_is_around_the_first_pose_that_is_one(poses, listen, ros):
    commands = listen("/drive", AckermannDriveStamped)

    def change(message, k):
        if k == 0:
            message.header.stamp -= ros.Duration(100.0)
        at = message.pose.pose.position
        at.x = {0: 90.0, 1: math.nan, 2: 1e300}.get(k, at.x)

    node, _ = poses(change)
    commands.wait(lambda m: m.drive.speed > 1.0)
    assert "Traceback" not in node.output and "outside" not in node.output


def test_a_pose_that_stays_while_the_car_moves_stops_it(poses, listen):
    """Otherwise the car could leave the area unnoticed."""
    commands = listen("/drive", AckermannDriveStamped)
    speed = [0.0]

    def change(message, k):
        message.pose.pose.position.x = 0.0
        message.twist.twist.linear.x = speed[0]

    node, _ = poses(change)
    commands.wait(lambda m: m.drive.speed > 0.5)
    speed[0] = 2.0
    commands.wait(lambda _: "pose frozen while moving" in node.output)
    commands.wait(lambda _: commands[-1].drive.speed == 0.0)


def test_a_frozen_pose_moves_nothing(poses, listen, ros):
    commands = listen("/drive", AckermannDriveStamped)
    frozen = odometry_at(ros, 0.0)
    frozen.header.stamp -= ros.Duration(1.0)

    def change(message, k):
        message.header, message.pose, message.twist = frozen.header, frozen.pose, frozen.twist

    poses(change)
    commands.wait(lambda _: len(commands) > 40)
    assert {m.drive.speed for m in commands} == {0.0}


def another_frame(message):
    message.header.frame_id = "map"


def elsewhere(message):
    message.pose.pose.position.x += 3.0


def absurdly_fast(message):
    message.twist.twist.linear.x = 1e9


def test_poses_are_refused_as_by_the_controller(poses, listen):
    commands = listen("/drive", AckermannDriveStamped)
    faults = [None]

    def change(message, k):
        if faults[-1]:
            faults[-1](message)

    node, _ = poses(change)
    for fault, reason in (
        (another_frame, "pose in another frame"),
        (elsewhere, "pose jumped"),
        (absurdly_fast, "pose not finite or absurd"),
    ):
        mark = len(commands)
        faults.append(None)
        commands.wait(lambda _, mark=mark: any(m.drive.speed > 0.5 for m in commands[mark:]))
        faults.append(fault)
        commands.wait(lambda _, reason=reason: reason in node.output)
    commands.wait(lambda _: commands[-1].drive.speed == 0.0)


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"speed_mps": -1.0}, "speed_mps: expected a positive number, got -1"),
        ({"box": [0, 1, 2]}, "~box: expected x_min"),
        ({"box": [0, 1, 0, "1"]}, "~box: expected x_min"),
        ({"limit_rad": 0.6}, "limit_rad: expected at most what NUC4 can, 0.4189, got 0.6"),
        ({"speed_mps": 50.0}, "speed_mps: expected at most what NUC4 can, 15, got 50"),
        ({"radius": 0.0}, "~radius: expected a positive number, got 0.0"),
        ({"radius": math.inf}, "~radius: expected a positive number, got inf"),
        ({"button": -1}, "~button: expected 0 or more, got -1"),
        ({"dead_man_timeout": 0.0}, "~dead_man_timeout: expected a positive number, got 0.0"),
        ({"dead_man_timeout": math.inf}, "~dead_man_timeout: expected a positive number, got inf"),
    ],
)
def test_what_it_refuses_it_says_in_a_line(refused, parameters, words):
    assert words in refused("steering_ramp", parameters)
