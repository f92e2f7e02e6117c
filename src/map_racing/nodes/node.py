"""Shared by all nodes: parameters, start and shutdown, clock, and choice of the publisher."""

from __future__ import annotations

import logging
import math
import os
import signal
import sys
import threading
import time
from dataclasses import fields, replace
from pathlib import Path
from typing import Callable, TypeVar

import rosgraph
import rospy

from ..errors import MapRacingError, ParameterError
from ..printing import printable
from ..validation import meaning
from .launched import check_launch_arguments
from .log import write_beside

__all__ = [
    "FirstSender",
    "SteadyClock",
    "get_parameter",
    "overridden",
    "ros_home",
    "run",
    "sleep",
    "to_launch_folder",
    "trace",
    "why_silent",
]

# A wall clock that drifts this far [s] from the monotonic clock was set.
CLOCK_STEP_S = 0.2
MASTER_PERIOD_S = 10.0
# Warn if there is no simulated time after this time [s].
CLOCK_S = 5.0
Value = TypeVar("Value", bool, int, float, str, list)
# Message types from which a node can take its pose.
_POSES = ("nav_msgs/Odometry", "geometry_msgs/PoseStamped")
# Most topics listed in a line of the log.
_MOST_TOPICS = 12
# A publisher that has been silent for this long [s] counts as gone.
_SENDER_GONE_S = 1.0


def get_parameter(name: str, default: Value, meaning: str) -> Value:
    """Read a private parameter, and log its value and whether it is the default.

    Parameters
    ----------
    name : str
        Without the ``~``.
    default : bool, int, float, str or list
        The parameter must have this type; an integer is accepted for a float.
    meaning : str
        For the log, with the unit.

    Returns
    -------
    bool, int, float, str or list

    Raises
    ------
    ParameterError
        If it has another type.
    """
    value = rospy.get_param(f"~{name}", default)
    source = "" if rospy.has_param(f"~{name}") else ", default"
    if type(default) is float and type(value) is int:
        value = float(value)
    if type(value) is not type(default):
        raise ParameterError(f"~{name}: expected {type(default).__name__}, got {value!r}")
    rospy.loginfo("~%s = %r (%s%s)", name, value, meaning, source)
    return value


def overridden(values: object) -> object:
    """A dataclass of parameters, overridden by the private parameters of the node.

    Parameters
    ----------
    values : object
        Its fields are made by `map_racing.validation.parameter`.

    Returns
    -------
    object
        An object of the same class.

    Raises
    ------
    ParameterError
        For a value of another type or out of its range.
    """
    changes = {
        field.name: get_parameter(field.name, getattr(values, field.name), meaning(field))
        for field in fields(values)
    }
    return replace(values, **changes)


def run(name: str, make: Callable[[], object]) -> None:
    """Run a node until it is shut down.

    Parameters
    ----------
    name : str
    make : callable
        Creates the node, which may have a method ``run`` that returns on shutdown. A
        `MapRacingError` ends the node with one line and exit code 1.
    """
    to_launch_folder()
    logging.getLogger("rosout").addFilter(_harmless)
    _wait_for_master()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        # A node started with nohup ignores the end of its terminal.
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _shut_down)
    node = None
    try:
        rospy.init_node(name, disable_signals=True)
        write_beside()
        for watch in (_watch_master, _watch_clock):
            threading.Thread(target=watch, daemon=True).start()
        check_launch_arguments()
        node = make()
        if not rospy.core.is_shutdown_requested():
            getattr(node, "run", rospy.spin)()
    except MapRacingError as error:
        rospy.logfatal("%s", error)
        raise SystemExit(1) from None
    except Exception as error:
        # During shutdown a starting node may fail anywhere, and a running one on closed topics.
        expected = node is None or isinstance(error, rospy.ROSException)
        if not (expected and rospy.core.is_shutdown_requested()):
            raise


def _harmless(record):
    """Log filter that makes control characters visible instead of effective."""
    record.msg, record.args = printable(record.getMessage(), lines=True), ()
    return True


def _wait_for_master():
    """Wait for the master; Ctrl-C works here, but not in ``init_node`` without a master."""
    # `is_master_online` would take an exception for a missing master.
    interrupted = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: interrupted.set())
    try:
        while not rosgraph.is_master_online():
            print(
                f"no ROS master at {rosgraph.get_master_uri()} (ROS_MASTER_URI): waiting for one; "
                "roscore or roslaunch starts it",
                file=sys.stderr,
                flush=True,
            )
            end = time.monotonic() + 10.0
            while time.monotonic() < end and not rosgraph.is_master_online():
                if interrupted.wait(0.2):
                    raise SystemExit(130)
    except ValueError as error:
        raise SystemExit(f"ROS_MASTER_URI: {error}") from None
    if interrupted.is_set():
        raise SystemExit(130)


def _watch_master():
    """Log when the master is gone or was restarted; existing connections stay up."""
    while sleep(MASTER_PERIOD_S):
        try:
            rosgraph.Master(rospy.get_name()).lookupNode(rospy.get_name())
        except rosgraph.MasterError:
            rospy.logerr(
                "the ROS master was restarted and does not know this node: new nodes and commands "
                "do not reach it; restart the node"
            )
        except Exception as error:
            rospy.logerr(
                "the ROS master at %s does not answer: %s", rosgraph.get_master_uri(), error
            )


def _watch_clock():
    """Warn if there is no simulated time although ``/use_sim_time`` is true.

    Timers then do not run and every timestamp is 0, so the node would wait without saying why.
    """
    wait = CLOCK_S
    while not rospy.rostime.is_wallclock() and sleep(wait) and rospy.Time.now().is_zero():
        why = why_silent("/clock", "rosgraph_msgs/Clock")
        rospy.logwarn(
            f"/use_sim_time is true, but there is no time on /clock ({why}): everything waits. For "
            "real time: rosparam set /use_sim_time false, and restart the nodes"
        )
        wait *= 2.0


def why_silent(topic: str, kind: str) -> str:
    """Why a topic is silent, as far as the master knows, and which topics have such messages.

    Parameters
    ----------
    topic : str
        Resolved name.
    kind : str
        Expected type, such as ``nav_msgs/Odometry``.
    """
    try:
        master = rosgraph.Master(rospy.get_name())
        published = dict(master.getSystemState()[0])
        types = dict(master.getTopicTypes())
    except Exception:
        return "the ROS master does not answer"
    nodes, found = published.get(topic), types.get(topic, kind)
    if nodes and found == kind:
        return f"{nodes[0]} publishes it, but no message has arrived"
    why = f"{nodes[0]} publishes {found} there, expected {kind}" if nodes else "nobody publishes it"
    alike = _POSES if kind in _POSES else (kind,)
    # The node does not wait for its own topics.
    own = [rospy.get_name()]
    others = [name for name in sorted(published) if published[name] != own]
    others = [f"{name} ({types[name]})" for name in others if types.get(name) in alike]
    others = [name for name in others if not name.startswith(f"{topic} ")]
    listed = ", ".join(others[:_MOST_TOPICS]) + (", ..." if len(others) > _MOST_TOPICS else "")
    return f"{why}; there is {listed}" if others else why


def _shut_down(number, _):
    """Handle a signal in a separate thread.

    rospy's own handler calls the master in the interrupted thread, and deadlocks if that thread is
    waiting for the master's answer, as a starting node usually is.
    """
    threading.Thread(target=rospy.signal_shutdown, args=(f"signal {number}",)).start()


def to_launch_folder() -> None:
    """Change to the folder in which the user called roslaunch, so that relative paths work.

    roslaunch starts nodes in ``ROS_HOME``.
    """
    folder = os.environ.get("MAP_RACING_LAUNCH_FOLDER", "")
    if os.path.isdir(folder):
        os.chdir(folder)


def ros_home() -> Path:
    """Folder in which ROS keeps the user's files."""
    return Path(os.environ.get("ROS_HOME") or Path.home() / ".ros")


class SteadyClock:
    """ROS time without the steps of a wall clock that is set.

    A car must neither stop dead nor ignore a dropout for an hour because its computer found a time
    server. Simulated time is not changed.

    Attributes
    ----------
    steps : float
        Sum of the steps so far [s], to be subtracted from timestamps.
    """

    def __init__(self):
        self.steps = 0.0
        self._ahead = None

    def now(self) -> float:
        """Time [s]."""
        now = rospy.Time.now().to_sec()
        if rospy.rostime.is_wallclock():
            ahead = now - time.monotonic()
            if self._ahead is not None and abs(ahead - self._ahead) > CLOCK_STEP_S:
                self.steps += ahead - self._ahead
                rospy.logwarn("the clock was set by %+.2f s", ahead - self._ahead)
            self._ahead = ahead
        return now - self.steps


class FirstSender:
    """Selects the first of several nodes that publish a topic, as long as it publishes.

    Parameters
    ----------
    topic : str
        For the log.
    on_other : callable, optional
        Called with a warning when another node publishes.
    """

    def __init__(self, topic: str, on_other: Callable[[str], object] = lambda text: None):
        self._topic, self._sender, self._heard = topic, None, -math.inf
        self._on_other = on_other

    def sent(self, message: object) -> bool:
        """Whether a message comes from the selected node."""
        sender, now = message._connection_header["callerid"], time.monotonic()
        if sender != self._sender:
            if now - self._heard < _SENDER_GONE_S:
                text = f"{self._topic}: {sender} publishes it, too; only {self._sender} counts"
                rospy.logerr_throttle(10.0, text)
                self._on_other(text)
                return False
            if self._sender is not None:
                text = f"{self._topic}: {self._sender} fell silent, and {sender} took its place"
                self._on_other(text)
            self._sender = sender
        self._heard = now
        return True


def sleep(seconds: float) -> bool:
    """Sleep by the wall clock; false if the node is shut down meanwhile."""
    end = time.monotonic() + seconds
    while not rospy.is_shutdown():
        left = end - time.monotonic()
        if left <= 0.0:
            return True
        time.sleep(min(left, 0.05))
    return False


def trace(text: str) -> str:
    """A text with the current exception and its origin, in one line."""
    error = sys.exc_info()[1]
    trace = error.__traceback__
    while trace.tb_next is not None:
        trace = trace.tb_next
    code = trace.tb_frame.f_code
    where = f"{os.path.basename(code.co_filename)}:{trace.tb_lineno}"
    return f"{text}: {type(error).__name__}: {error} ({where} in {code.co_name})"
