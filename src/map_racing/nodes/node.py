"""What all nodes do alike: read parameters, and end in one line where they cannot run."""

import math
import os
import signal
import sys
import threading
import time
from dataclasses import fields, replace

import rosgraph
import rospy

from ..errors import MapRacingError, ParameterError
from ..validation import meaning

__all__ = [
    "FirstSender",
    "SteadyClock",
    "get_parameter",
    "overridden",
    "run",
    "sleep",
    "to_launch_folder",
    "why_silent",
]

# A clock that goes on by more or less than this [s] than the time that passed was set.
CLOCK_STEP_S = 0.2
MASTER_PERIOD_S = 10.0
# Whoever publishes nothing for so long [s] has gone.
SENDER_GONE_S = 1.0


def get_parameter(name, default, meaning):
    """Read a private parameter and log its value, and whether that is the default.

    Parameters
    ----------
    name : str
        Without the ``~``.
    default : bool, int, float, str or list
        Its type is the type that the parameter must have; an integer passes for a float.
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


def overridden(values):
    """A dataclass of parameters with those values replaced that are parameters of the node.

    Parameters
    ----------
    values : object
        Its fields are made by `map_racing.validation.parameter`.

    Returns
    -------
    object
        Of the same class.

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


def run(name, make):
    """Run a node until it is shut down.

    Parameters
    ----------
    name : str
    make : callable
        Makes the node; what it returns may have a method ``run`` that does not return before the
        node is shut down. A `MapRacingError` ends the node with one line and exit code 1.
    """
    to_launch_folder()
    _wait_for_master()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        # A node that was started with nohup outlives its terminal.
        if number != signal.SIGHUP or signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _shut_down)
    node = None
    try:
        rospy.init_node(name, disable_signals=True)
        threading.Thread(target=_watch_master, daemon=True).start()
        node = make()
        if not rospy.core.is_shutdown_requested():
            getattr(node, "run", rospy.spin)()
    except MapRacingError as error:
        rospy.logfatal("%s", error)
        raise SystemExit(1) from None
    except Exception as error:
        # What fails because the node is shut down is no fault: anything while it starts, and what
        # it publishes when the topics are closed.
        expected = node is None or isinstance(error, rospy.ROSException)
        if not (expected and rospy.core.is_shutdown_requested()):
            raise


def _wait_for_master():
    """Wait for the master where Ctrl-C works; ``init_node`` without one can only be killed."""
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
                time.sleep(0.2)
    except ValueError as error:
        raise SystemExit(f"ROS_MASTER_URI: {error}") from None
    except KeyboardInterrupt:
        raise SystemExit(130) from None


def _watch_master():
    """Say it where the master has gone or was started again; what is connected stays connected."""
    while sleep(MASTER_PERIOD_S):
        try:
            rosgraph.Master(rospy.get_name()).lookupNode(rospy.get_name())
        except rosgraph.MasterError:
            rospy.logerr(
                "the ROS master was started again and does not know this node: nodes and commands "
                "that start now do not reach it; start it again"
            )
        except Exception as error:
            rospy.logerr(
                "the ROS master at %s does not answer: %s", rosgraph.get_master_uri(), error
            )


def why_silent(topic, kind):
    """What the master knows about a topic from which nothing comes.

    Parameters
    ----------
    topic : str
        Its resolved name.
    kind : str
        Type that was expected, such as ``nav_msgs/Odometry``.
    """
    try:
        master = rosgraph.Master(rospy.get_name())
        nodes = dict(master.getSystemState()[0]).get(topic)
        found = dict(master.getTopicTypes()).get(topic, kind)
    except Exception:
        return "the ROS master does not answer"
    if not nodes:
        return "nobody publishes it"
    if found != kind:
        return f"{nodes[0]} publishes {found} there, expected {kind}"
    return f"{nodes[0]} publishes it, but none came"


def _shut_down(number, _):
    """Handle a signal in a thread of its own.

    rospy's own handler asks the master in the thread that it interrupts, and waits for ever where
    that one is waiting for the master's answer, as a node does all the time while it starts.
    """
    threading.Thread(target=rospy.signal_shutdown, args=(f"signal {number}",)).start()


def to_launch_folder():
    """Go where roslaunch was called, so that relative paths are the user's; it starts nodes in
    ``ROS_HOME``."""
    folder = os.environ.get("MAP_RACING_LAUNCH_FOLDER", "")
    if os.path.isdir(folder):
        os.chdir(folder)


class SteadyClock:
    """ROS time, but for the steps that somebody makes who sets the computer's clock.

    A car must not stop dead, nor go on for an hour, because its computer found a time server.
    Simulated time may do as it likes.

    Attributes
    ----------
    steps : float
        Sum of the steps so far [s]: subtract it from stamps.
    """

    def __init__(self):
        self.steps = 0.0
        self._ahead = None

    def now(self):
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
    """Of several nodes that publish on one topic, the first, for as long as it publishes.

    Parameters
    ----------
    topic : str
        For the log.
    """

    def __init__(self, topic):
        self._topic, self._sender, self._heard = topic, None, -math.inf

    def sent(self, message):
        """Whether a message is of the sender that counts."""
        sender, now = message._connection_header["callerid"], time.monotonic()
        if sender != self._sender:
            if now - self._heard < SENDER_GONE_S:
                rospy.logerr_throttle(
                    10.0,
                    f"{self._topic}: {sender} publishes it, too; only {self._sender} counts",
                )
                return False
            self._sender = sender
        self._heard = now
        return True


def sleep(seconds):
    """Wait by the wall clock; false if the node is shut down meanwhile."""
    end = time.monotonic() + seconds
    while not rospy.is_shutdown():
        left = end - time.monotonic()
        if left <= 0.0:
            return True
        time.sleep(min(left, 0.05))
    return False
