"""Reports whether the car drives, and why not: ``/diagnostics`` and the controller node's log."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

import rospy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ..bags import messages
from ..bags.topics import STATE
from ..control.controller import Controller, ControlResult, Status
from ..control.decision import Mode, Reason, state_level, state_text
from ..control.safety import Supervisor
from ..control.settings import doubts_of
from .node import why_silent
from .priority import present_priority

if TYPE_CHECKING:
    import threading

__all__ = ["Diagnosis"]

# Shortest interval between log messages of the same reason [s].
QUIET_S = 1.0
# Interval at which the log says what a waiting car lacks [s].
MISSING_S = 2.0


class Diagnosis:
    """Publishes the state of the controller once per second and when it changes.

    Parameters
    ----------
    controller : Controller
    supervisor : Supervisor
    lock : threading.RLock
        Held while either of these changes.
    pose_source, pose_topic, pose_type : str
        Source of the poses for the log; resolved topic and type as the master knows them.

    Attributes
    ----------
    refused : str
        Why the latest raceline was rejected; empty if it was not.
    """

    def __init__(
        self,
        controller: Controller,
        supervisor: Supervisor,
        lock: threading.RLock,
        pose_source: str,
        pose_topic: str,
        pose_type: str,
    ):
        self.refused = ""
        self._controller, self._supervisor, self._lock = controller, supervisor, lock
        self._pose_source, self._pose_topic = pose_source, (pose_topic, pose_type)
        self._reported, self._quiet_until = None, {}
        self._publisher = rospy.Publisher("/diagnostics", DiagnosticArray, queue_size=10)
        self.restart()
        self._timers = [
            rospy.Timer(rospy.Duration.from_sec(1.0), self._publish, reset=True),
            rospy.Timer(rospy.Duration.from_sec(MISSING_S), self._log_missing, reset=True),
        ]

    def restart(self):
        """Reset the statistics after time was set back."""
        self._statistics = _Statistics()

    def add(self, latency: float, result: ControlResult | None):
        """Count one control step, which took `latency` [s]."""
        self._statistics.add(latency, result is not None and result.status is Status.SATURATED)

    def report(self):
        """Log and publish a change of mode or reason; the caller holds the lock."""
        mode, reason = now_reported = self._supervisor.mode, self._supervisor.reason
        if now_reported == self._reported:
            return
        before, self._reported = self._reported, now_reported
        now = time.monotonic()
        # Log a new reason once, not when it flickers or when a stopping car has stopped.
        if now > self._quiet_until.get(reason, 0.0) and (before is None or reason is not before[1]):
            self._quiet_until[reason] = now + QUIET_S
            log = rospy.logwarn if mode in (Mode.STOPPING, Mode.STOPPED) else rospy.loginfo
            age = f" ({self._supervisor.pose_age:.2f} s)" if reason is Reason.STALE_POSE else ""
            log(state_text(mode, reason) + age)
        self._publish()

    def _publish(self, _=None):
        with self._lock:
            mode, reason = self._supervisor.mode, self._supervisor.reason
            values = self._values()
        status = DiagnosticStatus(
            level=state_level(mode, reason),
            name=rospy.get_name().lstrip("/") + STATE,
            hardware_id=self._controller.vehicle.name,
            message=state_text(mode, reason),
            values=[KeyValue(key, value) for key, value in values.items()],
        )
        array = DiagnosticArray(status=[status])
        array.header.stamp = rospy.Time.now()
        self._publisher.publish(array)

    def _values(self):
        supervisor, parameters = self._supervisor, self._controller.parameters
        raceline = self._controller.raceline
        rate, saturated, slowest = self._statistics.latest()
        return {
            "mode": supervisor.mode.value,
            "reason": supervisor.reason.value,
            "waiting for": ", ".join(what for what, _, _ in self._missing()),
            "pose rate [Hz]": f"{rate:.1f}",
            "pose age [s]": f"{supervisor.pose_age:.3f}",
            "saturated share": f"{saturated:.3f}",
            "priority": present_priority(),
            "longest control step [ms]": f"{1e3 * slowest:.3f}",
            "steering map": parameters.steering_map,
            "speed scale": f"{parameters.speed_scale:g}",
            "raceline": "" if raceline is None else f"{raceline.name} ({raceline.length:.2f} m)",
            "doubts": "; ".join(doubts_of(self._controller)),
            **_believed(self._controller.adaptation),
        }

    def _missing(self):
        """What a waiting car lacks: text, topic and type, both None if it is not a message."""
        if self._supervisor.mode is not Mode.WAITING:
            return
        if math.isnan(self._supervisor.pose_age) and self._supervisor.reason is not Reason.FRAME:
            yield f"no pose yet on {self._pose_source}", *self._pose_topic
        if self._controller.raceline is None:
            topic = rospy.resolve_name("global_waypoints")
            if self.refused:
                yield self.refused, None, None
            else:
                yield f"no raceline yet on {topic}", topic, messages.WAYPOINTS

    def _log_missing(self, _):
        missing = [
            f"{what} ({why_silent(topic, kind)})" if topic else what
            for what, topic, kind in self._missing()
        ]
        if missing:
            rospy.logwarn_throttle(10.0, "waiting: " + ", ".join(missing))


class _Statistics:
    """Statistics of the control steps, renewed about once per second."""

    def __init__(self):
        self._latest = 0.0, 0.0, 0.0
        self._clear()

    def _clear(self):
        self._begin = time.monotonic()
        self._steps = self._saturated = 0
        self._slowest = 0.0

    def add(self, latency, saturated):
        self._steps += 1
        self._slowest = max(self._slowest, latency)
        self._saturated += saturated

    def latest(self):
        """Rate [Hz], share of saturated steps, longest step [s]."""
        elapsed = time.monotonic() - self._begin
        if elapsed > 0.9:
            share = self._saturated / self._steps if self._steps else 0.0
            self._latest = self._steps / elapsed, share, self._slowest
            self._clear()
        return self._latest


def _believed(adaptation):
    """The belief with 95 % intervals, and whether it is being learned."""
    if adaptation is None:
        return {"adaptation": "off"}
    belief, frozen = adaptation.belief, adaptation.frozen
    values = {"adaptation": f"frozen: {frozen}" if frozen else "learning"}
    for key, name in (
        ("friction", "friction"),
        ("front stiffness", "front_stiffness"),
        ("rear stiffness", "rear_stiffness"),
        ("delay [s]", "delay"),
    ):
        value, low, high = (getattr(belief, name + end) for end in ("", "_low", "_high"))
        values[f"believed {key}"] = f"{value:.3f} ({low:.3f} to {high:.3f})"
    values["grip in use"] = f"{belief.grip:.3f}"
    return values
