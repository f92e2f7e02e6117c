"""Node ``controller``: poses in, drive commands out, under supervision.

Each pose makes one control step, in the callback that brings it. A timer looks for poses that stop
coming. The controller and its supervisor are the core's; here messages are converted.
"""

import gc
import math
import os
import sys
import threading
import time
from dataclasses import fields, replace
from pathlib import Path

import rospy
from ackermann_msgs.msg import AckermannDriveStamped
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from dynamic_reconfigure.server import Server
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import Bool, Float64, Header
from std_srvs.srv import Trigger, TriggerResponse
from tf2_msgs.msg import TFMessage

from map_racing.cfg import ControllerConfig
from map_racing.msg import Guidance

from ..bags import messages
from ..control.controller import Controller, Status, build_steering_map
from ..control.parameters import (
    STEERING_MAPS,
    ControllerParameters,
    load_controller_parameters,
    load_safety_limits,
    save_controller_parameters,
)
from ..control.safety import Mode, Reason, SafetyLimits, Supervisor
from ..control.speed_sectors import load_speed_sectors
from ..errors import MapRacingError, ParameterError
from ..files import read_yaml_mapping
from ..track.files.load import load_raceline
from ..vehicle.lookup import load_table
from ..vehicle.parameters import load_vehicle
from .conversions import StateReader, frame, stamp_ns, to_time
from .node import FirstSender, SteadyClock, get_parameter, run, why_silent
from .transforms import TransformListener
from .waypoints import RacelineSubscriber

__all__ = ["ControllerNode", "main"]

WATCHDOG_HZ = 20.0
MISSING_S = 2.0
SWITCH_S = 0.0005
# Lines of the log about the same thing are at least this far apart [s].
QUIET_S = 1.0
# Whence the lookahead of the steering maps that the parameters are not for.
FILES = {"table": "map", "linear_table": "map_linear", "ackermann": "pure_pursuit"}
# Commands at the end of the node: several, as the first may meet a full queue.
LAST_COMMANDS, LAST_PERIOD_S = 5, 0.02

UNITS = {"_m": "[m]", "_s": "[s]", "_rad": "[rad]", "_mps": "[m/s]", "_mps2": "[m/s^2]"}


def _overridden(values):
    """A dataclass with those of its values replaced that are private parameters of the node."""
    changes = {}
    for field in fields(values):
        unit = UNITS.get("_" + field.name.rpartition("_")[2], "")
        default = getattr(values, field.name)
        default = float(default) if isinstance(default, int) else default
        changes[field.name] = get_parameter(field.name, default, unit)
    return replace(values, **changes)


class ControllerNode:
    """Reads its parameters, then drives until it is told to end."""

    def __init__(self):
        controller = get_parameter("controller", "map", "shipped name or file")
        vehicle = load_vehicle(get_parameter("vehicle", "nuc4", "shipped name or file"))
        source = get_parameter("raceline", "", "track, file or bag; empty: topic global_waypoints")
        pose_source = get_parameter("pose_source", "odom", "odom, pose or tf")
        table = get_parameter("lookup_table", "", "CSV; empty: of the vehicle's tires")
        self._sectors = get_parameter("sectors", "", "speed_scaling.yaml; empty: none")
        if self._sectors:
            read_yaml_mapping(self._sectors)  # the rest needs a raceline
        self._frames = (
            frame(get_parameter("map_frame", "map", "frame of poses and raceline")),
            frame(get_parameter("base_frame", "base_link", "frame of the car, pose_source tf")),
        )
        ros_home = os.environ.get("ROS_HOME") or Path.home() / ".ros"
        self._save_to = get_parameter(
            "save_to", str(Path(ros_home) / "map_racing_{steering_map}.yaml"), "file of ~save"
        )
        if pose_source not in ("odom", "pose", "tf"):
            raise ParameterError(f"~pose_source: expected odom, pose or tf, got {pose_source!r}")
        parameters = _overridden(load_controller_parameters(controller))
        if table and parameters.steering_map == "ackermann":
            raise ParameterError(f"~lookup_table: {controller} is pure pursuit and uses none")
        limits = replace(load_safety_limits(controller), max_speed_mps=parameters.v_max_mps)
        limits = replace(_overridden(limits), max_speed_mps=parameters.v_max_mps)

        self._vehicle, self._v_max = vehicle, parameters.v_max_mps
        self._maps = {parameters.steering_map: load_table(table)} if table else {}
        self._lookaheads = {
            kind: (stated.m_m, stated.q_s)
            for kind, stated in (
                (kind, load_controller_parameters(FILES[kind])) for kind in STEERING_MAPS
            )
        }
        self._lookaheads[parameters.steering_map] = parameters.m_m, parameters.q_s
        self._controller = Controller(
            parameters, self._steering_map(parameters.steering_map), vehicle
        )
        self._supervisor = Supervisor(limits)
        self._reader = StateReader()
        self._clock = SteadyClock()
        self._lock = threading.RLock()
        self._ending = self._failing = False
        self._refused = ""  # why the latest raceline is none
        self._last_angle = 0.0
        self._message = AckermannDriveStamped()
        self._shown, self._quiet_until = None, {}
        self._tally = _Tally()

        def publisher(topic, kind, size=10, **options):
            return rospy.Publisher(topic, kind, queue_size=size, **options)

        self._drive = publisher("drive", AckermannDriveStamped, 1)
        self._guidance = publisher("guidance", Guidance)
        self._diagnostics = publisher("/diagnostics", DiagnosticArray)
        self._numbers = {
            name: publisher(name, Float64)
            for name in ("lateral_error", "speed_error", "latency", "pose_age")
        }
        rospy.on_shutdown(self._end)
        if source:
            self._follow(load_raceline(source))
        else:
            self._topic = RacelineSubscriber(
                "global_waypoints", self._set_raceline, self._refuse_raceline
            )
        rospy.Subscriber("stop_driving", Bool, self._on_stop_topic, queue_size=10)
        self._services = [
            rospy.Service(f"~{name}", Trigger, handler)
            for name, handler in (
                ("stop", self._on_stop),
                ("resume", self._on_resume),
                ("save", self._on_save),
            )
        ]
        self._tuning = None
        self._tuning = Server(ControllerConfig, self._tune, namespace="tuning")
        self._pose_from = rospy.resolve_name(pose_source)
        self._sender = FirstSender(self._pose_from)
        latest = {"queue_size": 1, "tcp_nodelay": True}
        self._pose_topic = self._pose_from, Odometry._type
        if pose_source == "odom":
            rospy.Subscriber("odom", Odometry, self._on_pose, self._reader.odometry, **latest)
        elif pose_source == "pose":
            self._pose_topic = self._pose_from, PoseStamped._type
            rospy.Subscriber("pose", PoseStamped, self._on_pose, self._reader.pose, **latest)
        else:
            self._pose_from = "/tf, {} to {}".format(*self._frames)
            self._pose_topic = "/tf", TFMessage._type
            self._transform_stamp = 0
            self._transforms = TransformListener(self._on_transforms)
        every = rospy.Duration.from_sec
        self._timers = [
            rospy.Timer(every(1.0 / WATCHDOG_HZ), self._watch, reset=True),
            rospy.Timer(every(1.0), lambda _: self._diagnose(), reset=True),
            rospy.Timer(every(MISSING_S), lambda _: self._tell_what_is_missing(), reset=True),
        ]
        # What there is now stays: the garbage collector need not look through it while driving.
        gc.collect()
        gc.freeze()

    # -- poses -------------------------------------------------------------------------------

    def _on_pose(self, message, read):
        begin = time.perf_counter()
        with self._lock:
            if self._sender.sent(message):
                self._act(begin, message.header, lambda t: read(message, t))

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
        """One control step on the state that `read` returns; whatever fails in it stops the car."""
        now = self._clock.now()
        header.frame_id = frame(header.frame_id) or self._frames[0]
        try:
            if header.frame_id != self._frames[0]:
                rospy.logerr_throttle(
                    10.0,
                    f"{self._pose_from}: expected poses in the frame {self._frames[0]}, "
                    f"got one in {header.frame_id} (~map_frame)",
                )
                self._command(header, self._supervisor.refuse(now))
                return
            stamp = stamp_ns(header, 0)
            state = read(1e-9 * stamp - self._clock.steps if stamp else now)
            trusted = self._supervisor.observe(now, state)
            if self._supervisor.restarted:
                self._restart()
            if self._supervisor.jumped:
                self._reader.reset()
            result = self._controller.step(state) if trusted and not self._failing else None
            decision = self._supervisor.decide(now, result)
            self._command(header, decision)
            latency = time.perf_counter() - begin
            self._tally.add(latency, result)
            self._show(header, state, result, decision, latency)
        except Exception:
            rospy.logerr_throttle(QUIET_S, _trace("the control step failed"))
            self._failing = True
            self._supervisor.fail()
            try:
                self._command(header, self._supervisor.decide(now, None))
            except Exception:  # not even the supervisor works: an unramped stop
                self._send(header, self._last_angle, 0.0)

    def _restart(self):
        """Time was set back: nothing that was known before holds."""
        rospy.loginfo("time was set back: starting anew")
        self._controller.reset()
        self._reader.reset()
        self._tally = _Tally()

    def _watch(self, _):
        """Notice poses that stop coming."""
        with self._lock:
            header = Header(stamp=rospy.Time.now(), frame_id=self._frames[0])
            try:
                decision = self._supervisor.watch(self._clock.now())
                if self._supervisor.restarted:
                    self._restart()
                if decision is not None:
                    self._command(header, decision)
                else:
                    self._report()
            except Exception:
                rospy.logerr_throttle(QUIET_S, _trace("the watchdog failed"))
                self._send(header, self._last_angle, 0.0)

    # -- commands and what is told of them ---------------------------------------------------

    def _command(self, header, decision):
        if not self._ending:
            self._send(header, decision.steering_angle, decision.speed)
        self._report()

    def _send(self, header, steering_angle, speed):
        self._last_angle = steering_angle
        # One message for all commands: making one takes as long as the control step.
        command = self._message
        command.header = header
        command.drive.steering_angle = steering_angle
        command.drive.speed = speed
        self._drive.publish(command)

    def _show(self, header, state, result, decision, latency):
        """Publish what led to the command, as far as anybody listens."""
        if result is None:
            return
        numbers = {
            "lateral_error": lambda: self._controller.lateral_error(state, result),
            "speed_error": lambda: state.v_x - decision.speed,
            "latency": lambda: latency,
            "pose_age": lambda: self._supervisor.pose_age,
        }
        for name, value in numbers.items():
            if self._numbers[name].get_num_connections():
                self._numbers[name].publish(value())
        if not self._guidance.get_num_connections() or result.status in _UNGUIDED:
            return
        guided = result.state
        self._guidance.publish(
            header=header,
            mode=decision.mode.value,
            reason=decision.reason.value,
            status=result.status.value,
            saturated=result.status is Status.SATURATED,
            x=guided.x,
            y=guided.y,
            psi=guided.psi,
            v_x=guided.v_x,
            v_y=guided.v_y,
            s=result.s,
            d=result.d,
            lookahead_x=result.lookahead_x,
            lookahead_y=result.lookahead_y,
            lookahead_distance=result.lookahead_distance,
            eta=result.eta,
            a_lat=result.a_lat,
            a_lat_max=self._controller.steering_map.max_lateral_acceleration(guided.v_x),
            steering_angle=decision.steering_angle,
            speed=decision.speed,
        )

    def _report(self):
        """Log and diagnose a change of mode or reason."""
        supervisor = self._supervisor
        shown = supervisor.mode, supervisor.reason
        if shown == self._shown:
            return
        before, self._shown = self._shown, shown
        mode, reason = shown
        now = time.monotonic()
        # Not each time that a cause comes and goes, and not again when the car has come to stand.
        if now > self._quiet_until.get(reason, 0.0) and (before is None or reason is not before[1]):
            self._quiet_until[reason] = now + QUIET_S
            log = rospy.logwarn if mode in (Mode.STOPPING, Mode.STOPPED) else rospy.loginfo
            age = f" ({supervisor.pose_age:.2f} s)" if reason is Reason.STALE_POSE else ""
            log(_text(mode, reason) + age)
        self._diagnose()

    def _diagnose(self):
        with self._lock:
            supervisor, controller = self._supervisor, self._controller
            mode, reason = supervisor.mode, supervisor.reason
            parameters, raceline = controller.parameters, controller.raceline
            rate, saturated, slowest = self._tally.figures()
            age = supervisor.pose_age
        level = DiagnosticStatus.ERROR
        if mode is Mode.DRIVING:
            level = DiagnosticStatus.OK
        elif mode is Mode.WAITING or reason is Reason.STOP_REQUESTED:
            level = DiagnosticStatus.WARN
        name = rospy.get_name().lstrip("/")
        values = {
            "mode": mode.value,
            "reason": reason.value,
            "waiting for": ", ".join(what for what, _, _ in self._missing()),
            "pose rate [Hz]": f"{rate:.1f}",
            "pose age [s]": f"{age:.3f}",
            "saturated share": f"{saturated:.3f}",
            "longest control step [ms]": f"{1e3 * slowest:.3f}",
            "steering map": parameters.steering_map,
            "speed scale": f"{parameters.speed_scale:g}",
            "raceline": "" if raceline is None else f"{raceline.name} ({raceline.length:.2f} m)",
        }
        status = DiagnosticStatus(
            level=level,
            name=f"{name}: driving",
            hardware_id="map_racing",
            message=_text(mode, reason),
            values=[KeyValue(key, value) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = rospy.Time.now()
        self._diagnostics.publish(array)

    def _missing(self):
        """What a car that waits has not got: in words, with the topic and its type if any."""
        if self._supervisor.mode is not Mode.WAITING:
            return
        if math.isnan(self._supervisor.pose_age) and self._supervisor.reason is not Reason.FRAME:
            yield f"no pose yet on {self._pose_from}", *self._pose_topic
        if self._controller.raceline is None:
            topic = rospy.resolve_name("global_waypoints")
            if self._refused:
                yield self._refused, None, None
            else:
                yield f"no raceline yet on {topic}", topic, messages.WAYPOINTS

    def _tell_what_is_missing(self):
        missing = [
            f"{what} ({why_silent(topic, kind)})" if topic else what
            for what, topic, kind in self._missing()
        ]
        if missing:
            rospy.logwarn_throttle(10.0, "waiting: " + ", ".join(missing))

    def _end(self):
        """Tell the car to stop, for good."""
        with self._lock:
            self._ending = True
            if self._supervisor.mode is Mode.WAITING:
                return
        for _ in range(LAST_COMMANDS):
            self._send(
                Header(stamp=rospy.Time.now(), frame_id=self._frames[0]), self._last_angle, 0.0
            )
            time.sleep(LAST_PERIOD_S)

    # -- raceline ----------------------------------------------------------------------------

    def _set_raceline(self, raceline):
        try:
            self._follow(raceline)
        except MapRacingError as error:
            self._refuse_raceline(error)

    def _follow(self, raceline):
        sectors = load_speed_sectors(self._sectors, raceline) if self._sectors else None
        if raceline.speed is None:
            raise ParameterError(f"{raceline.source}: the raceline has no speeds")
        # What is costly about a first search is done here, not in the first control step.
        raceline.project(0.0, 0.0)
        with self._lock:
            self._controller.sectors = sectors
            self._controller.raceline = raceline
            self._supervisor.raceline_changed(True)
            self._refused = ""
        rospy.loginfo("raceline of %s: %.2f m", raceline.source, raceline.length)

    def _refuse_raceline(self, error):
        with self._lock:
            self._supervisor.raceline_changed(False)
            self._refused = str(error)
        rospy.logerr_throttle(QUIET_S, str(error))

    # -- requests ----------------------------------------------------------------------------

    def _on_stop_topic(self, message):
        with self._lock:
            if message.data:
                self._supervisor.request_stop("topic")
            else:
                self._supervisor.withdraw("topic")

    def _on_stop(self, _):
        with self._lock:
            self._supervisor.request_stop("service")
        return TriggerResponse(True, "stopping")

    def _on_resume(self, _):
        with self._lock:
            self._failing = False
            self._supervisor.resume()
        return TriggerResponse(True, "driving again where nothing else is against it")

    def _on_save(self, _):
        parameters = self._controller.parameters
        name = self._save_to.replace("{steering_map}", parameters.steering_map)
        path = Path(name).expanduser()
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            save_controller_parameters(parameters, path, self._supervisor.limits)
        except (MapRacingError, OSError) as error:
            return TriggerResponse(False, str(error))
        rospy.loginfo("saved to %s", path)
        return TriggerResponse(True, str(path))

    # -- live tuning -------------------------------------------------------------------------

    def _steering_map(self, kind):
        if kind not in self._maps:
            self._maps[kind] = build_steering_map(kind, self._vehicle, self._v_max)
        return self._maps[kind]

    def _tune(self, config, _):
        """Take over values of dynamic_reconfigure; answer with those that hold."""
        # Its first call brings values of its own, not those of the files.
        if self._tuning is not None:
            try:
                self._take(config)
            except MapRacingError as error:
                rospy.logwarn("not taken over: %s", error)
        parameters, limits = self._controller.parameters, self._supervisor.limits
        for known in (parameters, limits):
            for field in fields(known):
                if field.name in config:
                    config[field.name] = getattr(known, field.name)
        for kind, (m_m, q_s) in self._lookaheads.items():
            config[f"{kind}_m_m"], config[f"{kind}_q_s"] = m_m, q_s
        return config

    def _take(self, config):
        for name in (n for n, v in config.items() if isinstance(v, float) and not math.isfinite(v)):
            raise ParameterError(f"{name}: expected a finite number, got {config[name]}")
        lookaheads = {
            kind: (config[f"{kind}_m_m"], config[f"{kind}_q_s"]) for kind in STEERING_MAPS
        }
        kind = config["steering_map"]
        m_m, q_s = lookaheads.get(kind, (0.0, 0.0))
        changes = {
            field.name: config[field.name]
            for field in fields(ControllerParameters)
            if field.name in config
        }
        changes.update(m_m=m_m, q_s=q_s, v_max_mps=min(config["v_max_mps"], self._v_max))
        parameters = self._controller.parameters.with_(**changes)
        limits = replace(
            self._supervisor.limits,
            **{f.name: config[f.name] for f in fields(SafetyLimits) if f.name in config},
        )
        steering_map = self._steering_map(kind)
        with self._lock:
            self._lookaheads = lookaheads
            self._controller.parameters = parameters
            self._controller.steering_map = steering_map
            self._supervisor.limits = limits


_UNGUIDED = (Status.INVALID_STATE, Status.NO_RACELINE)


class _Tally:
    """Figures of the control steps since they were last asked for a second or longer ago."""

    def __init__(self):
        self._figures = 0.0, 0.0, 0.0
        self._clear()

    def _clear(self):
        self._begin = time.monotonic()
        self._steps = self._saturated = 0
        self._slowest = 0.0

    def add(self, latency, result):
        self._steps += 1
        self._slowest = max(self._slowest, latency)
        if result is not None and result.status is Status.SATURATED:
            self._saturated += 1

    def figures(self):
        """Rate [Hz], share of saturated steps, longest step [s]."""
        elapsed = time.monotonic() - self._begin
        if elapsed > 0.9:
            share = self._saturated / self._steps if self._steps else 0.0
            self._figures = self._steps / elapsed, share, self._slowest
            self._clear()
        return self._figures


def _text(mode, reason):
    return f"{mode.value}: {reason.value}" if reason.value else mode.value


def _trace(text):
    """A text with the exception that is being handled and where it came from, in one line."""
    error = sys.exc_info()[1]
    trace = error.__traceback__
    while trace.tb_next is not None:
        trace = trace.tb_next
    code = trace.tb_frame.f_code
    where = f"{os.path.basename(code.co_filename)}:{trace.tb_lineno}"
    return f"{text}: {type(error).__name__}: {error} ({where} in {code.co_name})"


def main():
    """Run the node; an impossible parameter or file is one line and exit code 1."""
    # rospy sends in a thread of its own: it shall not wait 5 ms for the one that computes.
    sys.setswitchinterval(SWITCH_S)
    run("controller", ControllerNode)
