"""What all nodes do alike: read parameters, and end in one line where they cannot run."""

import os
import time

import rospy

from ..errors import MapRacingError, ParameterError

__all__ = ["get_parameter", "run", "sleep", "to_launch_folder"]


def get_parameter(name, default, meaning):
    """Read a private parameter once and say in the log what it is.

    Parameters
    ----------
    name : str
        Without the ``~``.
    default : bool, int, float, str or list
        Its type is the type that the parameter must have; an integer passes for a float.
    meaning : str
        For the log, with the unit.

    Raises
    ------
    ParameterError
        If it has another type.
    """
    value = rospy.get_param(f"~{name}", default)
    if type(default) is float and type(value) is int:
        value = float(value)
    if type(value) is not type(default):
        raise ParameterError(f"~{name}: expected {type(default).__name__}, got {value!r}")
    rospy.loginfo("~%s = %r (%s)", name, value, meaning)
    return value


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
    try:
        rospy.init_node(name)
        node = make()
        getattr(node, "run", rospy.spin)()
    except MapRacingError as error:
        rospy.logfatal("%s", error)
        raise SystemExit(1) from None
    # The latter where it is shut down while it starts.
    except (rospy.ROSInterruptException, rospy.exceptions.ROSInitException):
        pass


def to_launch_folder():
    """Go where roslaunch was called, so that relative paths are the user's; it starts nodes in
    ``ROS_HOME``."""
    folder = os.environ.get("MAP_RACING_LAUNCH_FOLDER", "")
    if os.path.isdir(folder):
        os.chdir(folder)


def sleep(seconds):
    """Wait by the wall clock; false if the node is shut down meanwhile.

    Not with an Event: the signal handler that would set it runs in the thread that waits for it.
    """
    end = time.monotonic() + seconds
    while not rospy.is_shutdown():
        left = end - time.monotonic()
        if left <= 0.0:
            return True
        time.sleep(min(left, 0.05))
    return False
