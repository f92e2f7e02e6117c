"""Every code path to a stop in the controller node and the watchdog, call by call.

Here the nodes have neither master nor threads, so that faults can be inserted between any two
calls; the other tests run them as processes.
"""

import threading
import time
from types import SimpleNamespace

import pytest
import rospy
from geometry_msgs.msg import PoseStamped
from harness import HandClock
from nav_msgs.msg import Odometry
from std_msgs.msg import Bool

from map_racing.control.decision import Mode, Reason
from map_racing.errors import RacelineError
from map_racing.nodes import controller, watchdog
from map_racing.nodes.conversions import set_plane_pose
from map_racing.nodes.node import SteadyClock
from map_racing.simulation.driver import reversed_raceline
from map_racing.track.files.load import load_raceline

RACELINE = load_raceline("reference")
SPEED, PERIOD, START = 4.0, 0.03125, HandClock.START


class Spy:
    """Counts calls of a method, and passes them on."""

    def __init__(self, monkeypatch, holder, name):
        self.calls, self._method = [], getattr(holder, name)
        monkeypatch.setattr(holder, name, self)

    def __call__(self, *arguments):
        self.calls.append(arguments)
        return self._method(*arguments)


class Car:
    """The node, and a car on the reference track that feeds it poses."""

    def __init__(self):
        self.node = controller.ControllerNode()
        self.node._clock = self.clock = HandClock()
        self.s = 2.0

    @property
    def sent(self):
        return self.node._drive.sent

    @property
    def last(self):
        """Steering angle and speed of the last command."""
        return self.sent[-1].drive.steering_angle, self.sent[-1].drive.speed

    @property
    def state(self):
        supervisor = self.node._supervisor
        return supervisor.mode, supervisor.reason

    def message(self, **changes):
        point = RACELINE.pose(self.s)
        message = Odometry()
        message.header.stamp = rospy.Time.from_sec(changes.get("stamp", self.clock.time))
        message.header.frame_id = changes.get("frame", "map")
        set_plane_pose(message.pose.pose, point.x + changes.get("dx", 0.0), point.y, point.psi)
        message.twist.twist.linear.x = SPEED
        message.twist.twist.angular.z = SPEED * point.kappa
        message._connection_header = {"callerid": changes.get("sender", "/localization")}
        return message

    def pose(self, **changes):
        """One pose; the car then drives on."""
        count = len(self.sent)
        message = self.message(**changes)
        self.node._on_pose(message, self.node._reader.odometry)
        self.clock.time += PERIOD
        self.s += SPEED * PERIOD
        return self.sent[count:]

    def drive(self, seconds=0.5, **changes):
        for _ in range(round(seconds / PERIOD)):
            (command,) = self.pose(**changes)
        return command


@pytest.fixture
def make(monkeypatch, no_master):
    """``make(pose_source="tf")``: the node with these parameters."""
    monkeypatch.setattr(controller, "TuningServer", lambda *_: None)
    monkeypatch.setattr(controller, "Watchdog", lambda *_: None)
    monkeypatch.setattr(controller, "TransformListener", lambda _: SimpleNamespace())
    for name in ("collect", "freeze"):
        monkeypatch.setattr(controller.gc, name, lambda: None)

    def build(kind=Car, **given):
        no_master.params.update(
            {"~raceline": "reference", **{f"~{k}": v for k, v in given.items()}}
        )
        car = kind()
        car.said = no_master.said
        return car

    return build


@pytest.fixture
def car(make):
    return make()


def test_each_pose_makes_one_command_with_its_header(car, monkeypatch):
    steps = Spy(monkeypatch, car.node._diagnosis, "add")
    reports = Spy(monkeypatch, car.node._diagnosis, "report")
    learns = Spy(monkeypatch, car.node._controller, "learn")
    (command,) = car.pose()
    assert len(reports.calls) == 1
    ((latency, result),) = steps.calls
    assert 0.0 <= latency < 60.0 and result.s > 0.0 and car.node._telemetry._guidance.sent
    assert command.header.stamp.to_sec() == START and command.header.frame_id == "map"
    # First the step itself for pending learning, then the node after sending the command.
    assert len(learns.calls) == 2
    assert car.state == (Mode.DRIVING, Reason.NONE) and command.drive.speed > 1.0


def test_commands_are_stamped_in_order(car, monkeypatch):
    """A stop without poses has a later stamp than the late pose that follows."""
    monkeypatch.setattr(
        rospy.Time, "now", staticmethod(lambda: rospy.Time.from_sec(car.clock.time))
    )
    car.drive()
    car.clock.time += 0.3
    car.node._watch(car.clock.time)
    late = car.clock.time - 0.02
    (command,) = car.pose(stamp=late)
    stamps = [message.header.stamp.to_nsec() for message in car.sent]
    assert stamps == sorted(set(stamps)) and len(stamps) > 10
    assert stamps[-1] == stamps[-2] + 1
    assert command.header.stamp.to_sec() == pytest.approx(late + 0.02)
    # The pose keeps its header, and a clock that was set back is followed.
    assert car.node._telemetry._guidance.sent[-1]["header"].stamp.to_sec() == pytest.approx(late)
    for stamp in (START - 50.0, START - 51.0, START - 51.0):
        (command,) = car.pose(stamp=stamp)
        assert command.header.stamp.to_sec() == stamp


def test_poses_of_a_second_node_make_none(car):
    car.drive()
    assert car.pose(sender="/other") == []


@pytest.mark.parametrize("frame", ["map", "/map", ""])
def test_names_of_the_frame(car, frame):
    (command,) = car.pose(frame=frame)
    assert car.state[0] is Mode.DRIVING and command.header.frame_id == "map"


def test_another_frame_stops(car):
    angle = car.drive().drive.steering_angle
    (command,) = car.pose(frame="odom")
    assert car.state == (Mode.STOPPING, Reason.FRAME)
    assert "/odom: expected poses in the frame map, got one in odom (~map_frame)" in car.said[-2]
    assert command.drive.steering_angle == angle and command.header.frame_id == "odom"


def test_a_stamp_of_zero_is_the_time_of_arrival(car):
    car.pose(stamp=0.0)
    assert car.state[0] is Mode.DRIVING and car.node._supervisor.pose_age == 0.0


def test_steps_of_the_clock_are_taken_from_the_stamps(car):
    car.clock.steps = 3600.0
    car.pose(stamp=car.clock.time + 3600.0 - 0.125)
    assert car.node._supervisor.pose_age == pytest.approx(0.125)


def test_simulated_time_may_arrive_after_the_pose_of_that_time(car, monkeypatch):
    """The pose waits for the clock, but only once if stamps stay in the future."""

    def at(t):
        monkeypatch.setattr(rospy.rostime, "_rostime_current", rospy.Time.from_sec(t))

    waits = []

    def sleep(_):
        waits.append(None)
        at(car.clock.time)

    monkeypatch.setattr(time, "sleep", sleep)
    car.node._clock = SteadyClock()
    at(START)
    car.drive()
    assert car.state == (Mode.DRIVING, Reason.NONE)
    assert car.node._supervisor.pose_age == 0.0 and len(waits) == 15  # all except the first
    monkeypatch.setattr(time, "sleep", waits.append)
    monkeypatch.setattr(controller, "CLOCK_PATIENCE_S", 0.0)
    car.drive(0.25)
    assert car.state == (Mode.STOPPING, Reason.STALE_POSE)
    assert car.node._supervisor.pose_age == -0.25 and len(waits) <= 16


def test_stamps_in_the_future_hold_up_one_pose_until_time_follows_again(car, monkeypatch):
    wall, waits, at = [0.0], [], [START]

    def sleep(seconds):
        waits.append(seconds)
        wall[0] += 0.25

    monkeypatch.setattr(controller.time, "sleep", sleep)
    monkeypatch.setattr(controller.time, "monotonic", lambda: wall[0])
    monkeypatch.setattr(
        rospy.Time, "now", staticmethod(lambda: rospy.Time.from_sec(at[0] + 0.01 * len(waits)))
    )
    car.pose(stamp=START + 50.0)
    assert waits == []  # no waiting in real time
    monkeypatch.setattr(rospy.rostime, "is_wallclock", lambda: False)
    counts = []
    for stamp in (START + 50.0, START + 50.0, START - 1.0, START + 50.0):
        car.pose(stamp=stamp)
        counts.append(len(waits))
    assert counts == [5, 5, 5, 10]


# -- failures ------------------------------------------------------------------------------------


def failing(*_):
    raise ZeroDivisionError


def test_a_failure_of_the_controller_stops_by_a_ramp_until_resumed(car, monkeypatch):
    car.drive()
    angle = car.last[0]
    with monkeypatch.context() as patch:
        patch.setattr(car.node._controller, "step", failing)
        (command,) = car.pose()
    assert car.state == (Mode.STOPPING, Reason.FAILURE)
    assert command.drive.steering_angle == pytest.approx(angle, abs=0.05)
    assert command.drive.speed == SPEED - 4.0 * PERIOD
    assert "the control step failed: ZeroDivisionError" in car.said[-2]
    assert "(test_stop_paths.py:" in car.said[-2] and "in failing)" in car.said[-2]
    # The controller works again, but is not called.
    steps = Spy(monkeypatch, car.node._controller, "step")
    car.drive(3.0)
    assert car.state == (Mode.STOPPED, Reason.FAILURE) and not steps.calls
    answer = car.node._on_resume(None)
    assert answer.success and "resumed" in answer.message
    car.drive()
    assert car.state == (Mode.DRIVING, Reason.NONE) and steps.calls


def test_where_not_even_the_supervisor_works_the_car_stops_at_once(car, monkeypatch):
    car.drive()
    angle = car.last[0]
    monkeypatch.setattr(car.node._supervisor, "decide", failing)
    (command,) = car.pose()
    assert (command.drive.steering_angle, command.drive.speed) == (angle, 0.0)
    assert angle != 0.0 and command.header.stamp.to_sec() == car.clock.time - PERIOD


def test_a_failure_of_the_watch_stops_the_car_at_once(car, monkeypatch):
    car.drive()
    angle = car.last[0]
    monkeypatch.setattr(car.node._supervisor, "watch", failing)
    car.node._watch(car.clock.time)
    assert car.last == (angle, 0.0) and car.sent[-1].header.frame_id == "map"
    assert "the watchdog failed: ZeroDivisionError" in car.said[-1]


# -- the watch -----------------------------------------------------------------------------------


def test_poses_that_stop_coming(car):
    car.drive()
    angle, count = car.last[0], len(car.sent)
    car.node._watch(car.clock.time)
    assert len(car.sent) == count
    car.node._watch(car.clock.time + 0.25)
    assert car.state == (Mode.STOPPING, Reason.STALE_POSE)
    assert car.last[0] == pytest.approx(angle, abs=0.1) and car.last[1] < SPEED
    assert car.sent[-1].header.frame_id == "map" and car.sent[-1].header.stamp.to_sec() > 1e9


def test_the_watch_reports_while_nothing_is_commanded(car, monkeypatch):
    reports = Spy(monkeypatch, car.node._diagnosis, "report")
    car.node._watch(car.clock.time)
    assert len(reports.calls) == 1 and car.sent == []


@pytest.mark.parametrize("by", ["pose", "watch", "pose in another frame"])
def test_a_clock_that_is_set_back_begins_anew(car, monkeypatch, by):
    car.drive()
    spies = [
        Spy(monkeypatch, car.node._controller, "reset"),
        Spy(monkeypatch, car.node._reader, "reset"),
        Spy(monkeypatch, car.node._diagnosis, "restart"),
    ]
    car.drive()
    car.node._watch(car.clock.time)
    assert not any(spy.calls for spy in spies)
    car.clock.time = 50.0
    if by == "watch":
        car.node._watch(50.0)
    else:
        car.pose(frame="map" if by == "pose" else "odom")
    assert all(len(spy.calls) == 1 for spy in spies)
    assert "time was set back: starting over" in car.said


def test_a_clock_that_is_set_back_stops_the_car_where_no_more_poses_come(car, monkeypatch):
    monkeypatch.setattr(controller.time, "sleep", lambda _: None)
    car.drive()
    angle, count = car.last[0], len(car.sent)
    for k in range(100):
        car.node._watch(50.0 + 0.02 * k)
    speeds = [message.drive.speed for message in car.sent[count:]]
    assert speeds[0] == SPEED - 4.0 * 0.05 and speeds[-1] == 0.0
    assert car.state == (Mode.STOPPED, Reason.NO_POSE)
    assert car.last[0] == pytest.approx(angle, abs=0.1)
    # At the end, the node still remembers that it drove.
    count = len(car.sent)
    car.node._end()
    assert [message.drive.speed for message in car.sent[count:]] == [0.0] * 5


def test_a_jump_restarts_the_estimate_of_velocities(car, monkeypatch):
    car.drive()
    resets = Spy(monkeypatch, car.node._reader, "reset")
    car.pose(dx=3.0)
    assert car.state == (Mode.STOPPING, Reason.JUMP) and len(resets.calls) == 1


# -- requests and the end ------------------------------------------------------------------------


def asked(stop, sender="/referee"):
    message = Bool(stop)
    message._connection_header = {"callerid": sender}
    return message


def test_a_node_withdraws_its_own_stop_only(car, caplog):
    """Several nodes may supervise the car, and publish false as long as nothing is wrong."""
    car.drive()
    car.node._on_stop_topic(asked(True, "/obstacles"))
    car.node._on_stop_topic(asked(False, "/referee"))
    car.pose()
    assert car.state == (Mode.STOPPING, Reason.STOP_REQUESTED)
    assert "false from /referee, but /obstacles requested the stop" in caplog.text
    car.node._on_stop_topic(asked(True, "/referee"))
    car.node._on_stop_topic(asked(False, "/obstacles"))
    car.pose()
    assert car.state == (Mode.STOPPING, Reason.STOP_REQUESTED)
    car.node._on_stop_topic(asked(False, "/referee"))
    car.pose()
    assert car.state == (Mode.DRIVING, Reason.NONE)


def test_the_topic_stops_and_lets_drive(car):
    car.drive()
    car.node._on_stop_topic(asked(True))
    car.pose()
    assert car.state == (Mode.STOPPING, Reason.STOP_REQUESTED)
    car.node._on_stop_topic(asked(False))
    car.pose()
    assert car.state == (Mode.DRIVING, Reason.NONE)
    car.node._on_stop_topic(asked(True))
    car.node._on_stop(None)
    car.node._on_stop_topic(asked(False))
    car.pose()
    assert car.state[1] is Reason.STOP_REQUESTED  # still stopped by the service
    car.node._on_resume(None)
    car.pose()
    assert car.state == (Mode.DRIVING, Reason.NONE)


def test_the_service_stops_until_resumed(car):
    car.drive()
    answer = car.node._on_stop(None)
    assert answer.success and answer.message == "stopping"
    car.node._on_stop_topic(asked(False))
    car.drive(2.0)
    assert car.state == (Mode.STOPPED, Reason.STOP_REQUESTED) and car.last[1] == 0.0


def test_the_end_tells_the_car_to_stop_and_nothing_else_afterwards(car, monkeypatch):
    pauses = []
    monkeypatch.setattr(controller.time, "sleep", pauses.append)
    car.drive()
    angle, count = car.last[0], len(car.sent)
    car.node._end()
    last = car.sent[count:]
    assert [(m.drive.steering_angle, m.drive.speed) for m in last] == [(angle, 0.0)] * 5
    assert pauses == [0.02] * 5 and {m.header.frame_id for m in last} == {"map"}
    assert car.pose() == []


def test_a_node_that_never_drove_says_nothing_at_its_end(car):
    car.node._end()
    assert car.sent == []


# -- racelines -----------------------------------------------------------------------------------


def test_a_raceline_that_cannot_be_driven_stops_along_the_old_one(car):
    car.drive()
    old = car.node._controller.raceline
    car.node._refuse_raceline(RacelineError("topic: NaN"))
    car.pose()
    assert car.state == (Mode.STOPPING, Reason.INVALID_RACELINE)
    assert car.node._controller.raceline is old and car.node._diagnosis.refused == "topic: NaN"
    assert "topic: NaN" in car.said[-2]
    car.node._set_raceline(RACELINE)
    assert car.node._diagnosis.refused == "" and car.node._controller.raceline is RACELINE
    car.drive(1.0)
    assert car.state == (Mode.DRIVING, Reason.NONE)


def test_a_raceline_that_the_controller_refuses(car, monkeypatch):
    def refuse(**_):
        raise RacelineError("too short")

    car.drive()
    monkeypatch.setattr(car.node._controller, "prepare", refuse)
    car.node._set_raceline(RACELINE)
    car.pose()
    assert car.state[1] is Reason.INVALID_RACELINE and car.node._diagnosis.refused == "too short"


def test_a_raceline_the_other_way_round_waits_and_is_then_announced(car):
    car.drive()
    count = len(car.node._driven.sent)
    car.node._set_raceline(reversed_raceline(RACELINE))
    assert "has to stop first" in car.said[-1] and len(car.node._driven.sent) == count
    car.pose()
    assert car.state == (Mode.STOPPING, Reason.OPPOSED_RACELINE)
    car.node._set_raceline(RACELINE)
    (line,) = (line for line in car.said[-2:] if line.startswith("raceline of "))
    assert "stand" not in line
    assert len(car.node._driven.sent) == count + 1
    assert car.node._driven.sent[-1].header.frame_id == "map" and car.node._settings.sent


# -- tf ------------------------------------------------------------------------------------------


def test_each_transform_is_one_pose(make):
    car = make(pose_source="tf")
    found = [None]
    car.node._transforms.lookup = lambda *frames: found[-1] if frames == ("map", "base_link") else 0
    point = RACELINE.pose(2.0)
    for stamp, commands in ((None, 0), (0, 0), (100, 1), (100, 1), (101, 2)):
        found.append(stamp if stamp is None else (stamp * 10**9, *point[:2], point.psi))
        car.node._on_transforms()
        assert len(car.sent) == commands
        if commands:
            header = car.sent[-1].header
            assert (header.stamp.to_sec(), header.frame_id) == (stamp, "map")


@pytest.mark.parametrize("source", ["odom", "pose", "tf"])
def test_the_latest_pose_is_the_one_that_is_taken(make, monkeypatch, source):
    """A queue of poses, or a delay to fill packets, would make all poses old."""
    subscribed = {}
    monkeypatch.setattr(
        rospy,
        "Subscriber",
        lambda topic, *how, **options: subscribed.update({topic: (how, options)}),
    )
    node = make(pose_source=source).node
    del subscribed["stop_driving"]
    if source == "tf":
        assert subscribed == {} and node._transforms
        return
    kind = Odometry if source == "odom" else PoseStamped
    read = node._reader.odometry if source == "odom" else node._reader.pose
    latest = {"queue_size": 1, "tcp_nodelay": True}
    assert subscribed == {source: ((kind, node._on_pose, read), latest)}


class PosesOnly(Car):
    """A car whose localization reports no velocity."""

    def pose(self, **changes):
        odometry = self.message(**changes)
        message = PoseStamped(odometry.header, odometry.pose.pose)
        message._connection_header = odometry._connection_header
        self.node._on_pose(message, self.node._reader.pose)
        self.clock.time += PERIOD
        self.s += SPEED * PERIOD
        return self.sent[-1:]


def test_poses_without_velocity(make):
    car = make(PosesOnly, pose_source="pose")
    car.pose()
    assert car.state[0] is Mode.DRIVING


@pytest.mark.parametrize("stamp", [{}, {"stamp": 0.0}], ids=["fresh", "no"])
def test_frozen_poses_without_velocity(make, stamp):
    """With fresh stamps or none, the car ramps down from its last speed."""
    car = make(PosesOnly, pose_source="pose", speed_scale=0.5)
    car.drive(1.0)
    at, ramp = car.s, []
    for _ in range(40):
        car.s = at
        (command,) = car.pose(**stamp)
        if car.state[0] is not Mode.DRIVING:
            assert car.state[1] is Reason.FROZEN_POSE
            ramp.append(command.drive.speed)
    assert car.state[0] is Mode.STOPPED
    begin = SPEED - 4.0 * PERIOD
    expected = [max(begin - 4.0 * PERIOD * k, 0.0) for k in range(len(ramp))]
    assert ramp == pytest.approx(expected, abs=1e-3)


# -- the thread of the watchdog ------------------------------------------------------------------


@pytest.fixture
def guard(monkeypatch):
    """Run the watchdog for some rounds; return the times of its calls and its sleeps."""
    threads = []
    monkeypatch.setattr(threading.Thread, "start", lambda thread: threads.append(thread))

    def run(deadlines, fails=()):
        clock, calls, slept, short = HandClock(), [], [], []
        supervisor = SimpleNamespace(deadline=None)
        lock = threading.RLock()

        def watch(now):
            assert lock._is_owned()
            calls.append(now)
            due = deadlines[len(calls) - 1]
            supervisor.deadline = None if due is None else now + due

        def sleep(seconds):
            assert not lock._is_owned()
            slept.append(seconds)
            clock.time += seconds
            if len(slept) - 1 in fails:
                raise rospy.ROSTimeMovedBackwardsException(-1.0)

        monkeypatch.setattr(watchdog.rospy, "is_shutdown", lambda: len(calls) == len(deadlines))
        monkeypatch.setattr(watchdog.rospy, "sleep", sleep)
        monkeypatch.setattr(watchdog.time, "sleep", short.append)
        watchdog.Watchdog(lock, clock, supervisor, watch)
        assert [thread.daemon for thread in threads] == [True]
        threads[0].run()
        return calls, slept, short

    return run


def test_it_wakes_at_the_deadline_and_often_enough_without_one(guard):
    calls, slept, short = guard([None, 0.05, 0.3, -0.01, 0.0, 0.02])
    assert slept == pytest.approx([0.1, 0.05, 0.1, 0.0, 0.0, 0.02])
    assert calls == pytest.approx([100.0, 100.1, 100.15, 100.25, 100.25, 100.25])
    assert short == []


def test_it_goes_on_where_time_is_set_back(guard):
    calls, slept, short = guard([0.05, 0.05, 0.05], fails=(0,))
    assert len(calls) == 3 and short == [0.001]
