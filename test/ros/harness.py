"""Shared by tests of several nodes: waiting, and a car for the controller to drive."""

import math
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from ackermann_msgs.msg import AckermannDriveStamped
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Odometry
from scipy.stats import theilslopes
from std_srvs.srv import Trigger

from map_racing.control.safety import LONGEST_STEP
from map_racing.nodes.conversions import set_plane_pose
from map_racing.nodes.waypoints import waypoint_array_class
from map_racing.track.files.load import load_raceline

ROOT = Path(__file__).resolve().parents[2]
RATE = 50.0


class HandClock:
    """The clock of a node that runs call by call; a test sets its time."""

    START = 100.0

    def __init__(self):
        self.time, self.steps = self.START, 0.0

    def now(self):
        return self.time


def wait_for(condition, timeout=30.0, what="the condition"):
    """Wait until ``condition()`` is true, and return its value; fail the test after `timeout` [s].

    The timeouts only end a failing test; nothing is measured with them.
    """
    end = time.monotonic() + timeout
    while True:
        value = condition()
        if value:
            return value
        if time.monotonic() > end:
            pytest.fail(f"waited {timeout:g} s in vain for {what() if callable(what) else what}")
        time.sleep(0.02)


class Car:
    """Poses of a car that drives along the reference track, whatever the commands.

    A thread publishes them; `change` alters each message on its way.
    """

    def __init__(self, rospy, publishers, speed=3.0):
        self.raceline = load_raceline("reference")
        self.publishers, self.speed = publishers, speed
        self.now = lambda: rospy.Time.now()
        self.to_time = rospy.Time.from_sec
        self.s, self.d = 2.0, 0.0
        self.change = lambda message: message
        self.silent = False
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def message(self):
        point = self.raceline.pose(self.s)
        odometry = Odometry()
        odometry.header.stamp = self.now()
        odometry.header.frame_id = "map"
        odometry.child_frame_id = "base_link"
        x = point.x - self.d * math.sin(point.psi)
        y = point.y + self.d * math.cos(point.psi)
        set_plane_pose(odometry.pose.pose, x, y, point.psi)
        odometry.twist.twist.linear.x = self.speed
        odometry.twist.twist.angular.z = point.kappa * self.speed
        return odometry

    def _run(self):
        last = time.monotonic()
        while not self._end.wait(1.0 / RATE):
            now = time.monotonic()
            self.s += self.speed * (now - last)
            last = now
            if not self.silent:
                message = self.change(self.message())
                for publish in self.publishers:
                    publish(message)

    def stop(self):
        self._end.set()
        self._thread.join()


class Rig:
    """Controller, car, and all output of the controller."""

    def __init__(self, car, node, listen):
        self.car, self.node = car, node
        self.drive = listen("/drive", AckermannDriveStamped)
        self.diagnostics = listen("/diagnostics", DiagnosticArray)

    def driving(self):
        mark = len(self.drive)
        wait_for(lambda: [m for m in self.drive[mark:] if m.drive.speed > 1.0], what="driving")
        self.wait_mode("driving")

    def more(self, count):
        """Wait for this many more commands; return them."""
        mark = len(self.drive)
        wait_for(lambda: len(self.drive) >= mark + count, what=f"{count} more commands")
        return self.drive[mark:]

    def status(self):
        ours = [a.status[0] for a in list(self.diagnostics) if "controller" in a.status[0].name]
        return {pair.key: pair.value for pair in ours[-1].values} if ours else {}

    def wait_mode(self, mode, reason=""):
        wait_for(
            lambda: (self.status().get("mode"), self.status().get("reason")) == (mode, reason),
            what=lambda: f"{mode}: {reason}, but have {self.status()}",
        )

    def stops(self, reason):
        """Wait for the stop; return the messages of its ramp, and its deceleration [m/s^2]."""
        self.wait_mode("stopped", reason)
        # The diagnosis may overtake the last command.
        wait_for(lambda: self.drive[-1].drive.speed == 0.0, what="the last command")
        messages = list(self.drive)
        end = next(i for i in reversed(range(len(messages))) if messages[i].drive.speed > 0.0)
        begin = end
        while begin > 0 and messages[begin - 1].drive.speed > messages[begin].drive.speed:
            begin -= 1
        # The raceline itself may brake just before, but nowhere asks for less than 2 m/s.
        ramp = [m for m in messages[begin + 1 : end + 1] if m.drive.speed < 2.0]
        assert len(ramp) > 5, [m.drive.speed for m in messages[end - 10 : end + 2]]
        assert messages[end + 1].drive.speed == 0.0
        # After a gap, caused by a busy computer, missed braking is not made up for.
        stamps = [m.header.stamp.to_sec() for m in ramp]
        took = np.cumsum([min(b - a, LONGEST_STEP) for a, b in zip(stamps[:1] + stamps, stamps)])
        # A step that is stamped late does not count either.
        return ramp, -theilslopes([m.drive.speed for m in ramp], took)[0]

    def call(self, ros, service):
        ros.wait_for_service(f"/controller/{service}", 10.0)
        return ros.ServiceProxy(f"/controller/{service}", Trigger)()


def waypoints(raceline, points=200):
    array, waypoint = waypoint_array_class()
    message = array()
    step = raceline.length / points
    for k in range(points):
        point = raceline.pose(k * step)
        message.wpnts.append(
            waypoint(
                id=k,
                s_m=k * step,
                x_m=point.x,
                y_m=point.y,
                psi_rad=point.psi,
                kappa_radpm=point.kappa,
                vx_mps=raceline.speed_at(k * step),
                d_left=1.0,
                d_right=1.0,
            )
        )
    return message
