"""Node ``steering_ramp``: the maneuver for tire identification."""

import math
import threading
import time

import rospy
from ackermann_msgs.msg import AckermannDriveStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Header

from ..control.safety import PoseMotion
from ..control.steering_ramp import (
    Box,
    Circle,
    Phase,
    RampParameters,
    SteeringRamp,
    told_room,
)
from ..errors import ParameterError
from ..vehicle.parameters import load_vehicle
from .conversions import plane_pose, stamp_ns
from .node import FirstSender, get_parameter, overridden, run, sleep

__all__ = ["SteeringRampNode", "main"]

MAX_POSE_AGE_S = 0.2
WATCHDOG_S = 0.05
LAST_COMMANDS, LAST_PERIOD_S = 10, 0.02


class SteeringRampNode:
    """Answers each pose with a command, and stops without poses."""

    def __init__(self):
        self._parameters = overridden(RampParameters())
        vehicle = load_vehicle(get_parameter("vehicle", "nuc4", "shipped name or file"))
        self._radius = get_parameter("radius", 8.0, "radius of the area around the first pose [m]")
        box = get_parameter("box", [], "area instead: x_min, x_max, y_min, y_max [m]")
        self._dead_man = get_parameter("dead_man", True, "whether a button must be held")
        self._button = get_parameter("button", 5, "index of that button in the joystick's message")
        self._patience = get_parameter(
            "dead_man_timeout", 0.5, "time for which one message counts as holding it [s]"
        )
        if not 0.0 < self._radius < math.inf:
            raise ParameterError(f"~radius: expected a positive number, got {self._radius}")
        if box and not (len(box) == 4 and all(isinstance(v, (int, float)) for v in box)):
            raise ParameterError(f"~box: expected x_min, x_max, y_min, y_max, got {box}")
        area = Box(*map(float, box)) if box else None
        self._ramp = SteeringRamp(self._parameters, area) if area else None
        room = (area or Circle(0.0, 0.0, self._radius)).room
        text, fits = told_room(self._parameters, vehicle, room)
        (rospy.loginfo if fits else rospy.logwarn)("%s", text)
        if not self._dead_man:
            rospy.logwarn(
                "driving without a dead-man button: only the area and Ctrl-C stop the car"
            )

        self._lock = threading.RLock()
        self._held_until = -math.inf
        self._last_pose = None
        self._angle, self._phase = 0.0, None
        self._ended = False
        self._sender = FirstSender(rospy.resolve_name("odom"))
        self._motion = PoseMotion()
        self._drive = rospy.Publisher("drive", AckermannDriveStamped, queue_size=1)
        rospy.on_shutdown(self._end)
        if self._dead_man:
            rospy.Subscriber("joy", Joy, self._on_joy, queue_size=1)
            rospy.Subscriber("enable", Bool, self._on_enable, queue_size=1)
        rospy.Subscriber("odom", Odometry, self._on_odometry, queue_size=1, tcp_nodelay=True)

    def run(self):
        """Watch the poses until the maneuver is done."""
        while sleep(WATCHDOG_S):
            with self._lock:
                last = self._last_pose
                if last is not None and time.monotonic() - last > MAX_POSE_AGE_S:
                    rospy.logwarn_throttle(1.0, "no poses: standing still")
                    self._send(Header(stamp=rospy.Time.now()), self._angle, 0.0)
            if self._phase is Phase.DONE:
                rospy.loginfo("done: %d ramps", self._ramp.completed)
                rospy.signal_shutdown("done")

    def _on_joy(self, message):
        self._hold(len(message.buttons) > self._button and message.buttons[self._button] == 1)

    def _on_enable(self, message):
        self._hold(message.data)

    def _hold(self, held):
        # By the wall clock, as a hand holds the button.
        self._held_until = time.monotonic() + self._patience if held else -math.inf

    def _on_odometry(self, message):
        x, y, _ = plane_pose(message.pose.pose)
        now = rospy.Time.now().to_nsec()
        stamp = stamp_ns(message.header, now)
        with self._lock:
            if self._ended or not self._sender.sent(message):
                return
            enabled = not self._dead_man or time.monotonic() < self._held_until
            # The car is not where an old pose says.
            if not math.isfinite(x + y):
                rospy.logwarn_throttle(1.0, "pose not finite")
                enabled = False
            elif abs(now - stamp) > MAX_POSE_AGE_S * 1e9:
                rospy.logwarn_throttle(1.0, f"pose too old ({1e-9 * (now - stamp):.2f} s)")
                enabled = False
            else:
                self._last_pose = time.monotonic()
                if self._ramp is None:
                    self._ramp = SteeringRamp(self._parameters, Circle(x, y, self._radius))
            if self._ramp is None:
                self._send(message.header, 0.0, 0.0)
                return
            speed = message.twist.twist.linear.x
            if self._motion.frozen(1e-9 * now, (x, y), speed) > MAX_POSE_AGE_S:
                rospy.logwarn_throttle(1.0, "pose frozen while moving")
                enabled = False
            command = self._ramp.update(1e-9 * stamp, x, y, speed, enabled)
            if command.phase is not self._phase:
                self._phase = command.phase
                rospy.loginfo("%s", command.phase.value)
            if command.phase is Phase.OUTSIDE:
                rospy.logwarn_throttle(
                    5.0,
                    f"({x:.2f}, {y:.2f}) is outside of the area, {self._ramp.area}: drive the car "
                    "back into it, or set a larger ~radius or ~box",
                )
            self._send(message.header, command.steering_angle, command.speed)

    def _send(self, header, steering_angle, speed):
        self._angle = steering_angle
        command = AckermannDriveStamped(header=header)
        command.drive.steering_angle, command.drive.speed = steering_angle, speed
        self._drive.publish(command)

    def _end(self):
        """Stop the car before the node ends."""
        with self._lock:
            self._ended = True
        for _ in range(LAST_COMMANDS):
            self._send(Header(stamp=rospy.Time.now()), self._angle, 0.0)
            time.sleep(LAST_PERIOD_S)


def main():
    """Run the node."""
    run("steering_ramp", SteeringRampNode)
