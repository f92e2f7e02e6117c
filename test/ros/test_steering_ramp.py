"""The identification drive on the running nodes: button, area, end."""

import math
import signal

import numpy as np
import pytest
from ackermann_msgs.msg import AckermannDriveStamped
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
    """Hold the dead-man button, as a joystick with repetition does, until told otherwise."""
    timers = []

    def begin(topic, kind, message):
        publisher = advertise(topic, kind)
        timer = ros.Timer(ros.Duration(0.05), lambda _: publisher.publish(message))
        timers.append(timer)
        return timer

    yield begin
    for timer in timers:
        timer.shutdown()


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
    angles = [m.drive.steering_angle for m in commands]
    assert max(angles) == pytest.approx(0.3, abs=1e-6)
    assert min(angles) == pytest.approx(-0.3, abs=1e-6)
    assert max(m.drive.speed for m in commands) == 2.0
    assert [m.drive.speed for m in list(commands)[-5:]] == [0.0] * 5


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


def test_a_stop_where_poses_stop_coming(start, advertise, hold, listen, ros):
    commands = listen("/drive", AckermannDriveStamped)
    start("steering_ramp", FAST)
    hold("/enable", Bool, Bool(True))
    publisher = advertise("/odom", Odometry)
    rate = ros.Rate(40.0)
    for k in range(60):
        publisher.publish(odometry_at(ros, 0.05 * max(k - 20, 0), 2.0 * (k > 20)))
        rate.sleep()
    assert commands[-1].drive.speed > 1.0
    silent = len(commands)
    commands.wait(lambda m: m in list(commands)[silent:] and m.drive.speed == 0.0)


def test_the_area_is_around_the_first_pose_that_is_one(start, advertise, hold, listen, ros):
    commands = listen("/drive", AckermannDriveStamped)
    node = start("steering_ramp", FAST)
    hold("/enable", Bool, Bool(True))
    publisher = advertise("/odom", Odometry)
    for k in range(60):
        message = odometry_at(ros, {0: 90.0, 1: math.nan, 2: 1e300}.get(k, 0.01 * k))
        if k == 0:
            message.header.stamp -= ros.Duration(100.0)
        publisher.publish(message)
        ros.sleep(0.025)
    assert commands[-1].drive.speed > 1.0
    assert "Traceback" not in node.output and "outside" not in node.output


def test_a_pose_that_stays_while_the_car_moves_stops_it(start, advertise, hold, listen, ros):
    """Else the area would bound nothing."""
    commands = listen("/drive", AckermannDriveStamped)
    node = start("steering_ramp", FAST)
    hold("/enable", Bool, Bool(True))
    publisher = advertise("/odom", Odometry)
    for k in range(100):
        publisher.publish(odometry_at(ros, 0.0, 0.0 if k < 30 else 2.0))
        ros.sleep(0.025)
    assert max(m.drive.speed for m in commands) > 1.0
    commands.wait(lambda _: commands[-1].drive.speed == 0.0)
    assert "pose frozen while moving" in node.output


def test_a_frozen_pose_moves_nothing(start, advertise, hold, listen, ros):
    commands = listen("/drive", AckermannDriveStamped)
    start("steering_ramp", FAST)
    hold("/enable", Bool, Bool(True))
    publisher = advertise("/odom", Odometry)
    message = odometry_at(ros, 0.0)
    message.header.stamp -= ros.Duration(1.0)
    for _ in range(40):
        publisher.publish(message)
        ros.sleep(0.025)
    assert len(commands) > 20 and {m.drive.speed for m in commands} == {0.0}


def another_frame(message):
    message.header.frame_id = "map"


def elsewhere(message):
    message.pose.pose.position.x += 3.0


def absurdly_fast(message):
    message.twist.twist.linear.x = 1e9


def test_poses_are_refused_as_by_the_controller(start, advertise, hold, listen, ros):
    commands = listen("/drive", AckermannDriveStamped)
    node = start("steering_ramp", FAST)
    hold("/enable", Bool, Bool(True))
    publisher = advertise("/odom", Odometry)
    x = 0.0
    for fault in (another_frame, elsewhere, absurdly_fast):
        mark = len(commands)

        def drive(poses, change=lambda message: None):
            nonlocal x
            for _ in range(poses):
                x += 0.02
                message = odometry_at(ros, x, 0.05)
                change(message)
                publisher.publish(message)
                ros.sleep(0.025)

        drive(50)
        assert max(m.drive.speed for m in commands[mark:]) > 0.5, fault
        drive(8, fault)
    commands.wait(lambda _: commands[-1].drive.speed == 0.0)
    for reason in ("pose in another frame", "pose jumped", "pose not finite or absurd"):
        assert reason in node.output


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"speed_mps": -1.0}, "speed_mps: expected a positive number, got -1"),
        ({"box": [0, 1, 2]}, "~box: expected x_min"),
        ({"limit_rad": 0.6}, "limit_rad: expected at most what NUC4 can, 0.4189, got 0.6"),
        ({"speed_mps": 50.0}, "speed_mps: expected at most what NUC4 can, 15, got 50"),
        ({"radius": 0.0}, "~radius: expected a positive number, got 0.0"),
    ],
)
def test_what_it_refuses_it_says_in_a_line(start, parameters, words):
    node = start("steering_ramp", parameters, wait=False)
    assert node.wait() == 1
    assert words in node.output and "Traceback" not in node.output
