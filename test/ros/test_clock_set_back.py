"""Simulated time set back under the running nodes."""

import threading
import time

import pytest
from ackermann_msgs.msg import AckermannDriveStamped
from harness import HandClock, wait_for
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock


class Simulated:
    """Time on /clock, which runs like the wall clock until it is set."""

    def __init__(self, rospy, publish):
        self._rospy, self._publish = rospy, publish
        self._begin = HandClock.START - time.monotonic()
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def now(self):
        return self._rospy.Time.from_sec(self._begin + time.monotonic())

    def set_back(self, seconds):
        self._begin -= seconds

    def _run(self):
        while not self._end.wait(0.005):
            self._publish(Clock(self.now()))

    def stop(self):
        self._end.set()
        self._thread.join()


@pytest.fixture
def clock(ros, advertise):
    ros.set_param("/use_sim_time", True)
    clock = Simulated(ros, advertise("/clock", Clock, subscribers=0).publish)
    yield clock
    clock.stop()


def assert_stops(commands, mark):
    """From the command after `mark` on, the speed ramps down to 0."""
    commands.wait(lambda _: any(m.drive.speed == 0.0 for m in commands[mark:]))
    speeds = [m.drive.speed for m in commands[mark:]]
    ramp = speeds[: speeds.index(0.0)]
    assert len(ramp) > 5 and ramp == sorted(ramp, reverse=True)


def test_the_controller_begins_anew(rig, clock):
    """As when a bag is played in a loop."""
    rig = rig()
    rig.car.now = clock.now
    rig.driving()
    clock.set_back(50.0)
    rig.car.s += 15.0
    wait_for(lambda: "time was set back" in rig.node.output, what="the new beginning")
    rig.driving()
    # The watchdog has survived.
    rig.car.silent = True
    rig.wait_mode("stopped", "pose too old")


def test_the_controller_stops_where_no_more_poses_come(rig, clock):
    rig = rig()
    rig.car.now = clock.now
    rig.driving()
    rig.car.silent = True
    mark = len(rig.drive)
    clock.set_back(50.0)
    rig.wait_mode("stopped", "no pose yet")
    assert_stops(rig.drive, mark)
    rig.car.silent = False
    rig.driving()


def test_the_steering_ramp_stops_where_no_more_poses_come(start, advertise, listen, clock):
    commands = listen("/drive", AckermannDriveStamped)
    node = start("steering_ramp", {"dead_man": False, "acceleration_mps2": 8.0})
    publish = advertise("/odom", Odometry).publish
    x = 0.0
    while not any(m.drive.speed == 2.0 for m in list(commands)):
        assert x < 50.0
        message = Odometry()
        message.header.stamp, message.header.frame_id = clock.now(), "odom"
        message.pose.pose.position.x, message.pose.pose.orientation.w = x, 1.0
        message.twist.twist.linear.x = 0.0 if x < 0.1 else 2.0
        publish(message)
        time.sleep(0.02)
        x += 0.04
    clock.set_back(50.0)
    commands.wait(lambda _: "stopping: no pose yet" in node.output)
    commands.wait(lambda m: m.drive.speed == 0.0 and m.header.stamp < clock.now())
    assert_stops(commands, max(k for k, m in enumerate(commands) if m.drive.speed == 2.0) + 1)
