"""Every code path to a stop in the steering ramp node, call by call.

Here the node has neither master nor threads; test_steering_ramp.py runs it as a process.
"""

import math
import time

import pytest
import rospy
from harness import HandClock
from nav_msgs.msg import Odometry
from sensor_msgs.msg import Joy
from std_msgs.msg import Bool

from map_racing.control.decision import Mode, Reason
from map_racing.control.parameters import load_controller_parameters
from map_racing.control.safety import LONGEST_STEP
from map_racing.control.steering_ramp import Phase
from map_racing.nodes import steering_ramp
from map_racing.nodes.conversions import set_plane_pose

PERIOD = 0.03125
FAST = {"~settle_s": 0.5, "~acceleration_mps2": 8.0, "~rate_radps": 0.1}


class Hand:
    """The wall clock for the dead-man button."""

    def __init__(self, monkeypatch):
        self.time = 1000.0
        monkeypatch.setattr(steering_ramp.time, "monotonic", lambda: self.time)


class Car:
    """The node, and a car that follows commands instantly, without slip."""

    def __init__(self):
        self.node = steering_ramp.SteeringRampNode()
        self.node._clock = self.clock = HandClock()
        self.x = self.y = self.psi = self.speed = 0.0
        self.angle = 0.0

    @property
    def sent(self):
        return self.node._drive.sent

    @property
    def state(self):
        supervisor = self.node._supervisor
        return supervisor.mode, supervisor.reason

    def message(self, **changes):
        message = Odometry()
        message.header.stamp = rospy.Time.from_sec(changes.get("stamp", self.clock.time))
        message.header.frame_id = changes.get("frame", "odom")
        set_plane_pose(message.pose.pose, self.x + changes.get("dx", 0.0), self.y, self.psi)
        message.twist.twist.linear.x = changes.get("speed", self.speed)
        message.twist.twist.angular.z = changes.get("turns", self.speed * self.angle / 0.3)
        message._connection_header = {"callerid": changes.get("sender", "/localization")}
        return message

    def pose(self, **changes):
        """One pose and the commands for it; the car then drives on."""
        count = len(self.sent)
        self.node._on_odometry(self.message(**changes))
        self.clock.time += PERIOD
        commands = self.sent[count:]
        for command in commands:
            self.angle, self.speed = command.drive.steering_angle, command.drive.speed
        self.psi += PERIOD * self.speed * self.angle / 0.3
        self.x += PERIOD * self.speed * math.cos(self.psi)
        self.y += PERIOD * self.speed * math.sin(self.psi)
        return commands

    def drive(self, seconds=1.5, **changes):
        for _ in range(round(seconds / PERIOD)):
            (command,) = self.pose(**changes)
        return command.drive.steering_angle, command.drive.speed


@pytest.fixture
def hand(monkeypatch):
    return Hand(monkeypatch)


@pytest.fixture
def make(monkeypatch, no_master, hand):
    """``make(dead_man=False)``: the node with these parameters."""
    monkeypatch.setattr(steering_ramp, "Watchdog", lambda *_: None)
    warned = []
    monkeypatch.setattr(
        rospy, "logwarn_throttle", lambda _, text: warned.append(text), raising=False
    )

    def build(**given):
        no_master.params.update({**FAST, **{f"~{name}": value for name, value in given.items()}})
        car = Car()
        car.said, car.warned = no_master.said, warned
        return car

    return build


@pytest.fixture
def car(make):
    """A driving car, with the button held."""
    car = make(dead_man_timeout=1e6)
    car.node._on_enable(Bool(True))
    assert car.drive()[1] == 2.0 and car.state == (Mode.DRIVING, Reason.NONE)
    return car


def assert_ramped(car, reason, **changes):
    """The car ramps down from 2 m/s for this reason, without steering more than before.

    On request it checks for the full braking of ``map`` (`a_brake_max_mps2`).
    """
    hardest = load_controller_parameters("map").a_brake_max_mps2
    hardest = hardest if reason is Reason.STOP_REQUESTED else 4.0
    angle, speeds = car.angle, [2.0]
    while speeds[-1] > 0.0 and len(speeds) < 40:
        (command,) = car.pose(**changes)
        speeds.append(command.drive.speed)
        assert abs(command.drive.steering_angle) <= angle + 0.1 * PERIOD + 1e-9
        assert car.state[1] is reason
    steps = [before - after for before, after in zip(speeds, speeds[1:])]
    assert min(steps[:-1]) >= 4.0 * PERIOD - 1e-9 and max(steps) <= hardest * PERIOD + 1e-9
    assert speeds[-1] == 0.0
    assert car.state[0] is Mode.STOPPED


def test_commands_are_stamped_in_order(car, monkeypatch):
    """A stop without poses has a later stamp than the late pose that follows."""
    monkeypatch.setattr(
        rospy.Time, "now", staticmethod(lambda: rospy.Time.from_sec(car.clock.time))
    )
    car.drive()
    car.clock.time += 0.3
    car.node._watch(car.clock.time)
    car.pose(stamp=car.clock.time - 0.02)
    stamps = [message.header.stamp.to_nsec() for message in car.sent]
    assert stamps == sorted(set(stamps)) and stamps[-1] == stamps[-2] + 1


# -- the button ----------------------------------------------------------------------------------


def joy(*buttons):
    return Joy(buttons=buttons)


def test_without_the_button_nothing_is_driven(make):
    car = make()
    assert car.drive(1.0)[1] == 0.0 and car.state[0] is Mode.WAITING
    assert not any("failed" in said or "without a dead-man" in said for said in car.said)


@pytest.mark.parametrize("held", [joy(0, 0, 0, 0, 0, 1), joy(0, 0, 0, 0, 0, 1, 0)])
def test_the_sixth_button_is_the_one(make, held):
    car = make(dead_man_timeout=1e6)
    car.node._on_joy(held)
    assert car.drive()[1] == 2.0


@pytest.mark.parametrize("other", [joy(), joy(1, 1, 1, 1, 1), joy(1, 1, 1, 1, 1, 0, 1)])
def test_others_are_not_it_nor_is_a_joystick_without_it(car, other):
    car.node._on_joy(other)
    assert_ramped(car, Reason.STOP_REQUESTED)


@pytest.mark.parametrize("other", [joy(0, 0, 0, 0, 0, 2), joy(0, 0, 0, 0, 0, -1)])
def test_half_a_button_is_none(car, other):
    car.node._on_joy(other)
    assert car.pose()[0].drive.speed < 2.0


def test_another_button_by_its_number(make):
    car = make(button=0, dead_man_timeout=1e6)
    car.node._on_joy(joy(1))
    assert car.drive()[1] == 2.0


def test_letting_go_stops_at_the_next_pose_and_holding_goes_on(car):
    car.node._on_enable(Bool(False))
    assert_ramped(car, Reason.STOP_REQUESTED)
    assert car.node._phase is Phase.WAITING
    car.node._on_enable(Bool(True))
    assert car.drive()[1] == 2.0


def test_a_message_holds_the_button_for_half_a_second(make, hand):
    car = make()
    car.node._on_enable(Bool(True))
    hand.time += 0.49
    assert car.drive()[1] == 2.0
    hand.time += 0.01
    assert_ramped(car, Reason.STOP_REQUESTED)


def test_driving_without_a_button_takes_none(make):
    car = make(dead_man=False)
    assert "driving without a dead-man button: only the area and Ctrl-C stop the car" in car.said
    car.node._on_joy(joy())
    assert car.drive()[1] == 2.0


# -- area and maneuver -----------------------------------------------------------------------------


def test_outside_of_the_area_the_car_stops_and_says_where(make):
    car = make(dead_man=False, radius=3.0)
    assert car.drive(1.1)[1] == 2.0 and not car.warned
    while car.pose()[0].drive.speed == 2.0:
        assert math.hypot(car.x, car.y) < 3.2
    assert "is outside of the area" in car.warned[0] and car.node._phase is Phase.OUTSIDE
    assert car.state == (Mode.STOPPING, Reason.STOP_REQUESTED)
    car.drive(1.0)
    assert car.speed == 0.0 and math.hypot(car.x, car.y) < 4.0
    assert "%s outside of the area" in car.said


@pytest.mark.parametrize(("area", "fits"), [({}, False), ({"box": [-30, 30, -30, 30]}, True)])
def test_the_room_that_is_told_is_that_of_the_area(make, area, fits):
    said = make(**area).said
    assert any("the first circle" in text for text in said)
    assert any("The area reaches 8 m" in text for text in said) is not fits


def test_a_box_is_where_it_is(make):
    car = make(dead_man=False, box=[-1.0, 5.0, -1.0, 5.0])
    assert car.drive(0.5)[1] > 0.0
    car = make(dead_man=False, box=[1.0, 5.0, -1.0, 5.0])
    assert car.drive(0.5)[1] == 0.0 and car.node._phase is Phase.OUTSIDE


def test_the_area_is_around_the_first_pose(make):
    car = make(dead_man=False)
    car.x, car.y = 50.0, -20.0
    assert car.drive()[1] == 2.0
    area = car.node._ramp.area
    assert (area.x, area.y, area.radius) == (50.0, -20.0, 8.0)


def test_done_ends_the_node_with_the_number_of_ramps(make, monkeypatch):
    car = make(dead_man=False, sides="left", limit_rad=0.15, radius=100.0)
    ends, rounds = [], iter([True, True, False])
    monkeypatch.setattr(steering_ramp, "sleep", lambda _: next(rounds))
    monkeypatch.setattr(rospy, "signal_shutdown", ends.append)
    car.drive(0.5)
    rounds = iter([True, False])
    car.node.run()
    assert ends == []
    assert car.drive(4.0) == (0.0, 0.0) and car.node._phase is Phase.DONE
    rounds = iter([True, False])
    car.node.run()
    assert ends == ["done"] and "done: %d ramps 1" in car.said
    phases = [Phase.STARTING, Phase.RAMPING, Phase.STOPPING, Phase.DONE]
    texts = [f"%s {phase.value}" for phase in Phase]
    assert [said for said in car.said if said in texts] == [f"%s {p.value}" for p in phases]


def test_a_rear_that_breaks_away_ends_the_ramp(make):
    car = make(dead_man=False, sides="left", radius=100.0)
    car.drive(1.0)
    assert car.node._phase is Phase.RAMPING
    # Twice the settled yaw rate.
    for _ in range(30):
        car.pose(turns=2.0 * car.speed * car.angle / 0.3)
    assert car.node._ramp.completed == 1 and car.angle < 0.2


# -- poses -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"frame": "map"}, Reason.FRAME),
        ({"dx": math.nan}, Reason.INVALID_POSE),
        ({"speed": 1e9}, Reason.INVALID_POSE),
        ({"stamp": 50.0}, Reason.STALE_POSE),
    ],
)
def test_poses_that_the_controller_refuses_stop_this_as_well(car, changes, reason):
    assert_ramped(car, reason, **changes)
    assert f"{Mode.STOPPING.value}: {reason.value}" in "\n".join(
        text.replace("%s: %s ", "").replace(" ", ": ", 1) for text in car.said
    )
    # It stands, and then starts the ramp over.
    car.drive(1.0)
    assert car.drive()[1] == 2.0


def test_a_frame_is_told_with_the_one_expected(car):
    car.pose(frame="map")
    text = "expected poses in the frame odom, got one in map"
    assert any(text in said for said in car.said)


def test_slashes_before_a_frame_are_none(car):
    assert car.drive(0.5, frame="/odom")[1] == 2.0


def test_a_pose_that_cannot_be_trusted_gives_neither_frame_nor_area(make):
    car = make(dead_man=False)
    car.pose(frame="map", stamp=50.0, dx=77.0)
    assert car.node._frame is None and car.node._ramp is None
    car.drive(1.0)
    assert car.node._frame == "odom" and car.node._ramp.area.x == 0.0


def test_a_jump_stops(car):
    assert car.pose(dx=3.0)[0].drive.speed == 2.0 - 4.0 * PERIOD
    assert car.state == (Mode.STOPPING, Reason.JUMP)


def test_poses_of_a_second_node_make_no_command(car):
    assert car.pose(sender="/other") == []


def test_a_stamp_of_zero_is_the_time_of_arrival_and_steps_of_the_clock_do_not_count(car):
    assert car.drive(0.5, stamp=0.0)[1] == 2.0
    car.clock.steps = 3600.0
    for _ in range(10):
        car.pose(stamp=car.clock.time + 3600.0)
    assert car.speed == 2.0 and car.state[0] is Mode.DRIVING


def test_each_command_has_the_header_of_its_pose(car):
    (command,) = car.pose()
    assert command.header.stamp.to_sec() == car.clock.time - PERIOD
    assert command.header.frame_id == "odom"


@pytest.mark.parametrize("by", ["pose", "watch", "pose in another frame"])
def test_time_that_is_set_back_begins_the_ramp_anew(car, by):
    assert car.node._phase is Phase.RAMPING
    car.clock.time -= 50.0
    if by == "watch":
        car.node._watch(car.clock.time)
    elif by != "pose":
        car.pose(frame="map")
        car.clock.time += 1.0
    # An ordinary stop; from standstill, no step back to the former state.
    speeds = [car.speed] + [car.pose()[0].drive.speed for _ in range(20)]
    assert car.node._phase is Phase.STARTING and min(speeds) == 0.0
    hardest = load_controller_parameters("map").a_brake_max_mps2
    steps = [before - after for before, after in zip(speeds, speeds[1:])]
    assert max(steps) <= LONGEST_STEP * hardest + 1e-9
    speeds += [car.pose()[0].drive.speed for _ in range(30)]
    assert speeds[-1] == 2.0
    assert max(after - before for before, after in zip(speeds, speeds[1:])) <= 8.0 * PERIOD + 1e-9


def test_time_that_is_set_back_stops_the_car_where_no_more_poses_come(car, monkeypatch):
    monkeypatch.setattr(time, "sleep", lambda _: None)
    angle, count = car.angle, len(car.sent)
    for k in range(60):
        car.node._watch(50.0 + 0.02 * k)
    commands = [(m.drive.steering_angle, m.drive.speed) for m in car.sent[count:]]
    assert commands[0] == (angle, 2.0 - 4.0 * 0.05) and commands[-1] == (angle, 0.0)
    assert car.state == (Mode.STOPPED, Reason.NO_POSE)
    assert "%s: %s stopping no pose yet" in car.said
    count = len(car.sent)
    car.node._end()
    assert [m.drive.speed for m in car.sent[count:]] == [0.0] * 10


# -- the watch, failures, the end ------------------------------------------------------------------


def test_poses_that_stop_coming(car):
    count, angle, last = len(car.sent), car.angle, car.clock.time - PERIOD
    car.node._watch(last + 0.19)
    assert len(car.sent) == count
    car.node._watch(last + 0.2)
    command = car.sent[-1]
    assert (command.drive.steering_angle, command.drive.speed) == (angle, 2.0 - 4.0 * 0.05)
    assert car.state == (Mode.STOPPING, Reason.STALE_POSE) and command.header.stamp.to_sec() > 1e9
    assert "%s: %s stopping pose too old" in car.said


def failing(*_):
    raise ZeroDivisionError


def test_a_failure_of_the_maneuver_stops_by_a_ramp_for_good(car, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(car.node._ramp, "update", failing)
        (command,) = car.pose()
    assert command.drive.speed == 2.0 - 4.0 * PERIOD
    assert any("the maneuver failed: ZeroDivisionError" in said for said in car.said)
    assert "%s: %s stopping controller failed" in car.said
    assert car.drive(3.0)[1] == 0.0 and car.state[0] is Mode.STOPPED
    assert car.node._supervisor.trouble(car.clock.time) is Reason.FAILURE


def test_a_failure_of_the_watch_stops_at_once(car, monkeypatch):
    angle = car.angle
    monkeypatch.setattr(car.node._supervisor, "watch", failing)
    car.node._watch(car.clock.time)
    command = car.sent[-1]
    assert (command.drive.steering_angle, command.drive.speed) == (angle, 0.0) and angle > 0.0
    assert any("the watchdog failed: ZeroDivisionError" in said for said in car.said)


def test_the_smallest_numbers_that_are_taken(make):
    node = make(radius=0.1, button=0, dead_man_timeout=0.01).node
    assert (node._radius, node._button, node._patience) == (0.1, 0, 0.01)


def test_a_failure_before_the_first_command_leaves_the_wheels_straight(make, monkeypatch):
    car = make()
    monkeypatch.setattr(car.node._supervisor, "decide", failing)
    (command,) = car.pose()
    assert (command.drive.steering_angle, command.drive.speed) == (0.0, 0.0)


def test_time_that_is_set_back_before_there_is_an_area(make):
    car = make()
    car.pose(stamp=50.0)
    car.clock.time -= 50.0
    car.node._watch(car.clock.time)
    assert car.node._ramp is None and "time was set back: starting over" in car.said
    assert not any("failed" in said for said in car.said)


def test_it_stops_at_once_where_not_even_the_supervisor_works(car, monkeypatch):
    angle = car.angle
    monkeypatch.setattr(car.node._ramp, "update", failing)
    monkeypatch.setattr(car.node._supervisor, "decide", failing)
    (command,) = car.pose()
    assert (command.drive.steering_angle, command.drive.speed) == (angle, 0.0) and angle > 0.0


def test_the_end_commands_standstill_and_nothing_after_it(make, monkeypatch):
    ends = []
    monkeypatch.setattr(rospy, "on_shutdown", ends.append)
    waits = []
    monkeypatch.setattr(time, "sleep", waits.append)
    car = make(dead_man=False)
    assert ends == [car.node._end] and car.drive()[1] == 2.0
    count, angle = len(car.sent), car.angle
    car.node._end()
    last = [(m.drive.steering_angle, m.drive.speed) for m in car.sent[count:]]
    assert len(last) == 10 and set(last) == {(angle, 0.0)} and waits == [0.02] * 10
    assert car.pose() == []
    car.node._watch(car.clock.time + 1.0)
    monkeypatch.setattr(car.node._supervisor, "watch", failing)
    car.node._watch(car.clock.time + 1.0)
    assert len(car.sent) == count + 10


def test_a_node_that_never_drove_says_nothing_at_its_end(make):
    car = make()
    car.pose()
    car.sent.clear()
    car.node._end()
    assert car.sent == [] == car.pose()


@pytest.mark.parametrize("dead_man", [True, False])
def test_what_it_listens_to(make, monkeypatch, dead_man):
    heard = {}
    monkeypatch.setattr(
        rospy, "Subscriber", lambda topic, _, to, **how: heard.update({topic: (to, how)})
    )
    node = make(dead_man=dead_man).node
    latest = {"queue_size": 1}
    button = {"joy": (node._on_joy, latest), "enable": (node._on_enable, latest)}
    odometry = {"odom": (node._on_odometry, {**latest, "tcp_nodelay": True})}
    assert heard == {**odometry, **(button if dead_man else {})}


def test_each_reason_is_logged_once_and_what_is_normal_is_not(car):
    car.drive(0.2, frame="map")
    car.node._on_enable(Bool(False))
    car.drive(1.0)
    logged = [said for said in car.said if said.startswith("%s: %s ")]
    assert logged == ["%s: %s stopping pose in another frame"]
