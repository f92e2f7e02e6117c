"""Node ``steering_ramp``: the maneuver for tire identification."""

import math
import threading
import time

import rospy
from ackermann_msgs.msg import AckermannDriveStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool, Header

from ..control.controller import ControlResult, Status, build_controller
from ..control.decision import Mode, Reason
from ..control.parameters import load_controller_parameters, load_safety_limits
from ..control.state import CarState
from ..control.steering_ramp import (
    Box,
    Circle,
    Phase,
    RampParameters,
    SteeringRamp,
    told_room,
)
from ..control.supervised import build_supervisor
from ..errors import ParameterError
from ..vehicle.parameters import load_vehicle
from .conversions import StampOrder, frame, plane_pose, stamp_ns
from .node import FirstSender, SteadyClock, get_parameter, overridden, run, sleep, trace
from .priority import urgent
from .watchdog import Watchdog

__all__ = ["SteeringRampNode", "main"]

# Reasons of the supervisor when nothing is wrong.
READY = (Reason.NONE, Reason.STOP_REQUESTED)
LOOK_S = 0.05
QUIET_S = 1.0
LAST_COMMANDS, LAST_PERIOD_S = 10, 0.02


class SteeringRampNode:
    """Answers each pose with a command, under the same supervisor as the controller."""

    def __init__(self):
        vehicle = load_vehicle(get_parameter("vehicle", "nuc4", "its lock, speed and grip"))
        self._parameters = overridden(RampParameters.of(vehicle))
        self._parameters.check_vehicle(vehicle)
        self._read_area(vehicle)
        self._read_dead_man()
        map_controller = load_controller_parameters("map", vehicle).with_(
            v_max_mps=self._parameters.speed_mps
        )
        self._supervisor = build_supervisor(
            build_controller(map_controller, vehicle),
            overridden(load_safety_limits("map", vehicle)),
        )
        self._supervisor.on_restart = self._restart
        self._lock, self._clock = threading.RLock(), SteadyClock()
        self._held_until = -math.inf
        self._frame = self._phase = self._reason = None
        self._angle, self._order = 0.0, StampOrder()
        self._ended = False
        self._sender = FirstSender(rospy.resolve_name("odom"))
        self._drive = rospy.Publisher("drive", AckermannDriveStamped, queue_size=10)
        rospy.on_shutdown(self._end)
        if self._dead_man:
            rospy.Subscriber("joy", Joy, self._on_joy, queue_size=1)
            rospy.Subscriber("enable", Bool, self._on_enable, queue_size=1)
        rospy.Subscriber("odom", Odometry, self._on_odometry, queue_size=1, tcp_nodelay=True)
        self._watchdog = Watchdog(self._lock, self._clock, self._supervisor, self._watch)

    def _read_area(self, vehicle):
        """Read the area, and log whether the maneuver fits into it."""
        self._radius = get_parameter("radius", 8.0, "radius of the area around the first pose [m]")
        box = get_parameter("box", [], "area instead: x_min, x_max, y_min, y_max [m]")
        if not 0.0 < self._radius < math.inf:
            raise ParameterError(f"~radius: expected a positive number, got {self._radius}")
        if box and not (len(box) == 4 and all(isinstance(v, (int, float)) for v in box)):
            raise ParameterError(f"~box: expected x_min, x_max, y_min, y_max, got {box}")
        area = Box(*map(float, box)) if box else None
        self._ramp = SteeringRamp(self._parameters, area) if area else None
        room = (area or Circle(0.0, 0.0, self._radius)).room
        text, fits = told_room(self._parameters, vehicle, room)
        (rospy.loginfo if fits else rospy.logwarn)("%s", text)

    def _read_dead_man(self):
        """Read which button must be held."""
        self._dead_man = get_parameter("dead_man", True, "whether a button must be held")
        self._button = get_parameter("button", 5, "index of that button in the joystick's message")
        self._patience = get_parameter(
            "dead_man_timeout", 0.5, "time for which one message counts as holding it [s]"
        )
        if self._button < 0:
            raise ParameterError(f"~button: expected 0 or more, got {self._button}")
        if not 0.0 < self._patience < math.inf:
            raise ParameterError(
                f"~dead_man_timeout: expected a positive number, got {self._patience}"
            )
        if not self._dead_man:
            rospy.logwarn(
                "driving without a dead-man button: only the area and Ctrl-C stop the car"
            )

    def run(self):
        """Wait until the maneuver is done."""
        while sleep(LOOK_S):
            if self._phase is Phase.DONE:
                rospy.loginfo("done: %d ramps", self._ramp.completed)
                rospy.signal_shutdown("done")

    def _watch(self, now):
        header = Header(stamp=rospy.Time.now())
        try:
            decision = self._supervisor.watch(now)
            if decision is not None:
                self._command(header, decision)
        except Exception:
            rospy.logerr_throttle(QUIET_S, trace("the watchdog failed"))
            self._halt(header)

    def _on_joy(self, message):
        self._hold(len(message.buttons) > self._button and message.buttons[self._button] == 1)

    def _on_enable(self, message):
        self._hold(message.data)

    def _hold(self, held):
        # Wall clock, because a person holds the button.
        self._held_until = time.monotonic() + self._patience if held else -math.inf

    def _on_odometry(self, message):
        with self._lock:
            if not self._sender.sent(message):
                return
            now = self._clock.now()
            try:
                self._command(message.header, self._answer(now, message))
            except Exception:
                rospy.logerr_throttle(QUIET_S, trace("the maneuver failed"))
                self._supervisor.fail()
                try:
                    self._command(message.header, self._supervisor.decide(now, None))
                except Exception:  # the supervisor fails, too: stop without a ramp
                    self._halt(message.header)

    def _answer(self, now, message):
        """The supervisor's decision on a pose."""
        stamp, name = stamp_ns(message.header, 0), frame(message.header.frame_id)
        t = 1e-9 * stamp - self._clock.steps if stamp else now
        if self._frame not in (None, name):
            rospy.logerr_throttle(
                10.0, f"expected poses in the frame {self._frame}, got one in {name}"
            )
            return self._supervisor.refuse(now)
        pose, twist = plane_pose(message.pose.pose), message.twist.twist
        state = CarState(t, *pose, twist.linear.x, twist.linear.y, twist.angular.z)
        trusted = self._supervisor.observe(now, state)
        if trusted and self._frame is None:
            self._frame = name
            if self._ramp is None:
                self._ramp = SteeringRamp(self._parameters, Circle(*pose[:2], self._radius))
        return self._supervisor.decide(now, self._maneuver(now, state) if trusted else None)

    def _restart(self):
        """Restart the ramp after time was set back, as by a restarted simulation."""
        rospy.loginfo("time was set back: starting over")
        if self._ramp is not None:
            self._ramp.interrupt()

    def _maneuver(self, now, state):
        """Request of the maneuver at a trusted pose, in the form of a controller's result."""
        supervisor = self._supervisor
        held = not self._dead_man or time.monotonic() < self._held_until
        enabled = held and supervisor.trouble(now) is Reason.NONE
        command = self._ramp.update(state.t, state.x, state.y, state.v_x, enabled, state.r)
        if command.phase is not self._phase:
            self._phase = command.phase
            rospy.loginfo("%s", command.phase.value)
        if command.phase is Phase.OUTSIDE:
            rospy.logwarn_throttle(
                5.0,
                f"({state.x:.2f}, {state.y:.2f}) is outside of the area, {self._ramp.area}: drive "
                "the car back into it, or set a larger ~radius or ~box",
            )
        # Leave stops to the supervisor, which keeps them within the grip at the measured speed.
        if command.speed > 0.0:
            supervisor.withdraw("maneuver")
        else:
            supervisor.request_stop("maneuver")
        return ControlResult(command.steering_angle, command.speed, Status.OK, state, *(0.0,) * 7)

    def _command(self, header, decision):
        if decision.reason is not self._reason:
            self._reason = decision.reason
            if decision.reason not in READY:
                rospy.logwarn("%s: %s", decision.mode.value, decision.reason.value)
        if not self._ended:
            self._send(header, decision.steering_angle, decision.speed)

    def _halt(self, header):
        """Stop without a ramp if the supervisor fails, unless the node has ended."""
        if not self._ended:
            self._send(header, self._angle, 0.0)

    def _send(self, header, steering_angle, speed):
        self._angle = steering_angle
        command = AckermannDriveStamped(header=self._order.ordered(header))
        command.drive.steering_angle, command.drive.speed = steering_angle, speed
        self._drive.publish(command)

    def _end(self):
        """Stop the car before the node ends."""
        with self._lock:
            self._ended = True
            if self._supervisor.mode is Mode.WAITING:
                return
        for _ in range(LAST_COMMANDS):
            self._send(Header(stamp=rospy.Time.now()), self._angle, 0.0)
            time.sleep(LAST_PERIOD_S)


def main():
    """Run the node."""
    run("steering_ramp", urgent(SteeringRampNode))
