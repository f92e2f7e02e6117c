"""Node ``controller``: poses in, drive commands out, under supervision.

Each pose triggers one control step, in its callback; a watchdog notices a dropout of the poses.
Controller and supervisor are in `map_racing.control`; the node converts messages.
"""

import gc
import sys
import threading
import time

import rospy
from ackermann_msgs.msg import AckermannDriveStamped
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Bool, Header, String
from std_srvs.srv import Trigger, TriggerResponse
from tf2_msgs.msg import TFMessage

from ..bags.topics import SETTINGS_TOPIC
from ..control.controller import Controller
from ..control.decision import Mode
from ..control.parameters import load_controller_parameters, load_safety_limits
from ..control.settings import doubts_of, settings_text
from ..control.speed_sectors import load_speed_sectors
from ..control.steering import build_steering_maps
from ..control.supervised import SupervisedController, build_supervisor
from ..errors import MapRacingError, ParameterError
from ..files import read_yaml_mapping
from ..track.files.load import load_raceline
from ..track.files.waypoints import waypoint_rows
from ..vehicle.lookup import load_table
from ..vehicle.parameters import load_vehicle
from .conversions import StampOrder, StateReader, frame, stamp_ns, to_time
from .diagnosis import Diagnosis
from .node import FirstSender, SteadyClock, get_parameter, overridden, ros_home, run, trace
from .priority import urgent
from .saving import Saver
from .telemetry import Telemetry
from .transforms import TransformListener
from .tuning import TuningServer
from .watchdog import Watchdog
from .waypoints import RacelineSubscriber, waypoint_array_class, waypoint_messages

__all__ = ["ControllerNode", "main"]

SWITCH_S = 0.0005
# Shortest interval between log messages of the same failure [s].
QUIET_S = 1.0
# Stop commands sent when the node ends: several, because the first may be lost in a full queue.
LAST_COMMANDS, LAST_PERIOD_S = 5, 0.02
# Longest wait [s of wall time] for /clock to catch up with a pose that overtook it.
CLOCK_PATIENCE_S = 1.0

POSE_TYPES = {"odom": Odometry, "pose": PoseStamped, "tf": TFMessage}


def _build():
    """Build controller and supervisor from the node's parameters, with names for the settings."""
    source = get_parameter("controller", "map", "shipped name or file")
    car = get_parameter("vehicle", "nuc4", "shipped name or file")
    vehicle = load_vehicle(car)
    for note in vehicle.notes:
        rospy.logwarn("~vehicle: %s", note)
    table = get_parameter("lookup_table", "", "CSV; empty: from the vehicle's tires")
    parameters = overridden(load_controller_parameters(source, vehicle))
    if table and parameters.steering_map == "ackermann":
        raise ParameterError(f"~lookup_table: {source} is pure pursuit and uses none")
    if table and parameters.adaptation:
        raise ParameterError(f"~lookup_table: {source} adapts the vehicle's tires and uses none")
    limits = overridden(load_safety_limits(source, vehicle))
    steering_map, grip = build_steering_maps(parameters, vehicle)
    if table:
        steering_map = grip = load_table(table)
    controller = Controller(parameters, steering_map, vehicle, grip=grip)
    names = {"name": source, "table": table}
    return controller, build_supervisor(controller, limits, grip), names, car


class ControllerNode:
    """Reads its parameters, then drives until the node is shut down."""

    def __init__(self):
        source = get_parameter("raceline", "", "track, file or bag; empty: topic global_waypoints")
        pose_source = get_parameter("pose_source", "odom", "odom, pose or tf")
        if pose_source not in ("odom", "pose", "tf"):
            raise ParameterError(f"~pose_source: expected odom, pose or tf, got {pose_source!r}")
        self._sectors = get_parameter("sectors", "", "speed_scaling.yaml; empty: none")
        if self._sectors:
            read_yaml_mapping(self._sectors)  # further checks need a raceline
        self._frames = (
            frame(get_parameter("map_frame", "map", "frame of poses and raceline")),
            frame(get_parameter("base_frame", "base_link", "frame of the car, pose_source tf")),
        )
        default = str(ros_home() / "map_racing_")
        files = (
            get_parameter("save_to", f"{default}{{steering_map}}.yaml", "controller file of ~save"),
            get_parameter(
                "save_vehicle_to", f"{default}{{vehicle}}_{{time}}.yaml", "learned car of ~save"
            ),
        )
        self._controller, self._supervisor, self._names, vehicle = _build()
        self._lock = threading.RLock()
        self._saver = Saver(self._controller, self._supervisor, self._lock, *files, vehicle)
        self._driver = SupervisedController(
            self._controller, self._supervisor, self._announce, self._restart
        )
        self._start(source, pose_source)

    def _start(self, source, pose_source):
        """Advertise first, then subscribe, because the first pose may already drive the car."""
        self._logged_plan, self._logged_doubts, self._published_speeds = None, [], None
        self._logged_sectors = ""
        self._reader, self._clock = StateReader(), SteadyClock()
        self._ending = self._failing = False
        self._clock_follows = True
        self._last_angle, self._order = 0.0, StampOrder()
        self._message = AckermannDriveStamped()

        self._advertise()
        topic = "/tf" if pose_source == "tf" else rospy.resolve_name(pose_source)
        self._pose_from = "/tf, {} to {}".format(*self._frames) if topic == "/tf" else topic
        pose_type = POSE_TYPES[pose_source]._type
        self._diagnosis = Diagnosis(
            self._controller, self._supervisor, self._lock, self._pose_from, topic, pose_type
        )
        rospy.on_shutdown(self._end)
        if source:
            self._follow(load_raceline(source))
        else:
            self._topic = RacelineSubscriber(self._set_raceline, self._refuse_raceline)
        rospy.Subscriber("stop_driving", Bool, self._on_stop_topic, queue_size=10)
        self._services = [
            rospy.Service("~stop", Trigger, self._on_stop),
            rospy.Service("~resume", Trigger, self._on_resume),
            rospy.Service("~save", Trigger, self._on_save),
            rospy.Service("~reset", Trigger, self._on_reset),
        ]
        self._tuning = TuningServer(
            self._driver,
            self._lock,
            lambda: self._announce(again=False),
            self._names["table"],
        )
        self._subscribe_poses(pose_source)
        self._watchdog = Watchdog(self._lock, self._clock, self._supervisor, self._watch)
        # Exempt present objects from garbage collection, which would delay control steps.
        gc.collect()
        gc.freeze()

    def _advertise(self):
        # With a queue of 1, rospy on a busy computer drops commands, different ones for each
        # subscriber.
        self._drive = rospy.Publisher("drive", AckermannDriveStamped, queue_size=10)
        self._telemetry = Telemetry(self._controller, self._supervisor)
        self._driven = rospy.Publisher(
            "driven_waypoints", waypoint_array_class()[0], queue_size=1, latch=True
        )
        self._settings = rospy.Publisher(SETTINGS_TOPIC, String, queue_size=1, latch=True)

    # -- poses -------------------------------------------------------------------------------

    def _subscribe_poses(self, source):
        self._sender = FirstSender(self._pose_from)
        if source == "tf":
            self._transform_stamp = 0
            self._transforms = TransformListener(self._on_transforms)
            return
        read = self._reader.odometry if source == "odom" else self._reader.pose
        kind, latest = POSE_TYPES[source], {"queue_size": 1, "tcp_nodelay": True}
        rospy.Subscriber(source, kind, self._on_pose, read, **latest)

    def _on_pose(self, message, read):
        if not rospy.rostime.is_wallclock():
            self._await_clock(message.header)
        begin = time.perf_counter()
        with self._lock:
            if self._sender.sent(message):
                self._act(begin, message.header, lambda t: read(message, t))

    def _await_clock(self, header):
        """Wait until /clock reaches a pose that overtook it on another connection."""
        end = time.monotonic() + CLOCK_PATIENCE_S
        while header.stamp > rospy.Time.now():
            # Timestamps in the future delay at most one pose.
            if not self._clock_follows or time.monotonic() > end:
                self._clock_follows = False
                return
            time.sleep(SWITCH_S)
        self._clock_follows = True

    def _on_transforms(self):
        begin = time.perf_counter()
        with self._lock:
            found = self._transforms.lookup(*self._frames)
            if found is None or found[0] == self._transform_stamp:
                return
            self._transform_stamp, *pose = found
            header = Header(stamp=to_time(found[0]), frame_id=self._frames[0])
            self._act(begin, header, lambda t: self._reader.plane(t, *pose))

    def _act(self, begin, header, read):
        """Run a control step on the state that `read` returns; any failure in it stops the car."""
        now = self._clock.now()
        header.frame_id = frame(header.frame_id) or self._frames[0]
        try:
            if header.frame_id == self._frames[0]:
                self._step(begin, now, header, read)
            else:
                self._refuse_frame(now, header)
        except Exception:
            rospy.logerr_throttle(QUIET_S, trace("the control step failed"))
            self._failing = True
            self._supervisor.fail()
            try:
                self._command(header, self._supervisor.decide(now, None))
            except Exception:  # the supervisor fails, too: stop without a ramp
                self._send(header, self._last_angle, 0.0)

    def _step(self, begin, now, header, read):
        stamp = stamp_ns(header, 0)
        state = read(1e-9 * stamp - self._clock.steps if stamp else now)
        result, decision = self._driver.step(now, state, self._failing)
        if self._supervisor.jumped:
            self._reader.reset()
        self._command(header, decision)
        latency = time.perf_counter() - begin
        self._controller.learn()
        self._diagnosis.add(latency, result)
        if result is not None:
            self._telemetry.publish(header, state, result, decision, latency)

    def _refuse_frame(self, now, header):
        rospy.logerr_throttle(
            10.0,
            f"{self._pose_from}: expected poses in the frame {self._frames[0]}, "
            f"got one in {header.frame_id} (~map_frame)",
        )
        self._command(header, self._supervisor.refuse(now))

    def _restart(self):
        """Start over, as the controller does, after time was set back."""
        rospy.loginfo("time was set back: starting over")
        self._reader.reset()
        self._diagnosis.restart()

    def _watch(self, now):
        """Notice a dropout of the poses."""
        header = Header(stamp=rospy.Time.now(), frame_id=self._frames[0])
        try:
            decision = self._supervisor.watch(now)
            if decision is not None:
                self._command(header, decision)
            else:
                self._diagnosis.report()
        except Exception:
            rospy.logerr_throttle(QUIET_S, trace("the watchdog failed"))
            self._send(header, self._last_angle, 0.0)

    # -- commands ----------------------------------------------------------------------------

    def _command(self, header, decision):
        if not self._ending:
            self._send(header, decision.steering_angle, decision.speed)
        self._diagnosis.report()

    def _send(self, header, steering_angle, speed):
        self._last_angle = steering_angle
        # Reuse one message, because creating one takes as long as a control step.
        command = self._message
        command.header = self._order.ordered(header)
        command.drive.steering_angle = steering_angle
        command.drive.speed = speed
        self._drive.publish(command)

    def _end(self):
        """Stop the car before the node ends."""
        with self._lock:
            self._ending = True
            if self._supervisor.mode is Mode.WAITING:
                return
        for _ in range(LAST_COMMANDS):
            header = Header(stamp=rospy.Time.now(), frame_id=self._frames[0])
            self._send(header, self._last_angle, 0.0)
            time.sleep(LAST_PERIOD_S)

    # -- raceline ----------------------------------------------------------------------------

    def _set_raceline(self, raceline):
        try:
            self._follow(raceline)
        except MapRacingError as error:
            self._refuse_raceline(error)

    def _follow(self, raceline):
        sectors = load_speed_sectors(self._sectors, raceline) if self._sectors else None
        # The first search is slow: do it here, not in the first control step.
        raceline.project(0.0, 0.0)
        with self._driver.changing:
            setup = self._controller.prepare(raceline=raceline, sectors=sectors)
            with self._lock:
                driven = self._driver.follow(raceline, sectors, setup)
                self._diagnosis.refused = ""
            text = "raceline of %s: %.2f m"
            if not driven:
                text += ", which runs against the motion of the car: it has to stop first"
            rospy.loginfo(text, raceline.source, raceline.length)
            if driven:
                self._announce()

    def _announce(self, again=True):
        """Publish settings and planned speeds; without `again`, the speeds only if changed.

        Also log speed plan, sectors and doubts that are new.
        """
        controller = self._controller
        raceline, plan = controller.raceline, controller.plan
        if raceline is None:
            return
        if plan is not self._logged_plan:
            self._logged_plan = plan
            text = plan or "the speeds are the raceline's, whatever the grip"
            rospy.loginfo("grip_use %g: %s", controller.parameters.grip_use, text)
        if controller.sectors is not None:
            text = controller.sectors.told(controller.parameters.speed_scale)
            if text != self._logged_sectors:
                rospy.loginfo(text)
            self._logged_sectors = text
        doubts = doubts_of(controller)
        for doubt in doubts:
            if doubt not in self._logged_doubts:
                rospy.logwarn(doubt)
        self._logged_doubts = doubts
        rows = waypoint_rows(raceline, speed=controller.planned_speed)
        message = waypoint_array_class()[0](wpnts=waypoint_messages(rows))
        if again or message.wpnts != self._published_speeds:
            self._published_speeds = message.wpnts
            message.header.stamp = rospy.Time.now()
            message.header.frame_id = self._frames[0]
            self._driven.publish(message)
        settings = settings_text(
            controller,
            sectors=self._sectors,
            limits=self._supervisor.limits,
            **self._names,
        )
        self._settings.publish(settings)

    def _refuse_raceline(self, error):
        with self._lock:
            self._driver.refuse()
            self._diagnosis.refused = str(error)
        rospy.logerr_throttle(QUIET_S, str(error))

    # -- requests ----------------------------------------------------------------------------

    def _on_stop_topic(self, message):
        # Several nodes may watch the car; none may withdraw another's stop.
        sender = message._connection_header["callerid"]
        with self._lock:
            if message.data:
                self._supervisor.request_stop(sender)
                return
            self._supervisor.withdraw(sender)
            others = sorted(self._supervisor.requests)
        if others:
            rospy.logwarn_throttle(
                10.0,
                f"stop_driving: false from {sender}, but {' and '.join(others)} requested the "
                "stop: it stays in force until they send false, or ~resume is called",
            )

    def _on_stop(self, _):
        with self._lock:
            self._supervisor.request_stop("service")
        return TriggerResponse(True, "stopping")

    def _on_resume(self, _):
        with self._lock:
            self._failing = False
            self._supervisor.resume()
        return TriggerResponse(True, "resumed; drives unless another stop reason is active")

    def _on_save(self, _):
        try:
            saved = ", ".join(self._saver.save())
        except (MapRacingError, OSError) as error:
            return TriggerResponse(False, str(error))
        rospy.loginfo("saved to %s", saved)
        return TriggerResponse(True, saved)

    def _on_reset(self, _):
        learned = self._controller.learned
        if learned is None:
            return TriggerResponse(False, "nothing was learned: adaptation is off")
        with self._lock:
            learned.forget()
        rospy.loginfo("adaptation reset to the vehicle file")
        return TriggerResponse(True, "adaptation reset to the vehicle file")


def main():
    """Run the node."""
    # rospy sends in a separate thread, which must not wait 5 ms for the computing one.
    sys.setswitchinterval(SWITCH_S)
    run("controller", urgent(ControllerNode))
