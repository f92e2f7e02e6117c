"""Real-time priority of a node that commands the car, if the computer permits it.

Without it, the node may wait tens of milliseconds for the processor when several other processes
compute.
"""

from __future__ import annotations

import os
from contextlib import suppress
from typing import Callable

import rospy

from ..errors import ParameterError
from .node import get_parameter

__all__ = ["present_priority", "take_priority", "urgent"]

HIGHEST = 99
THREADS = "/proc/self/task"


def urgent(make: Callable[[], object]) -> Callable[[], object]:
    """Wrap a node's constructor to take the priority of the parameter ``~realtime_priority``."""

    def build():
        wanted = get_parameter("realtime_priority", 1, "1 to 99; 0: ordinary")
        if not 0 <= wanted <= HIGHEST:
            raise ParameterError(f"~realtime_priority: expected 0 to {HIGHEST}, got {wanted}")
        refused = take_priority(wanted) if wanted else ""
        if refused:
            rospy.logwarn(
                "no real-time priority (%s): on a busy computer, commands and stops may be tens of "
                "milliseconds late. Permit it by rtprio in /etc/security/limits.conf, see "
                "doc/safety.md, or set ~realtime_priority to 0",
                refused,
            )
        return make()

    return build


def take_priority(priority: int) -> str:
    """Give a real-time priority to all threads of this process, present and future.

    A process that was started with one keeps it.

    Returns
    -------
    str
        Why that failed; empty if the process has one.
    """
    if _scheduled():
        return ""
    try:
        for thread in os.listdir(THREADS):
            with suppress(ProcessLookupError):  # the thread has ended
                os.sched_setscheduler(int(thread), os.SCHED_RR, os.sched_param(priority))
    except (OSError, AttributeError) as error:  # AttributeError: not on Linux
        return getattr(error, "strerror", None) or "not on this system"
    return ""


def present_priority() -> str:
    """The priority of this thread, in words."""
    return f"real-time {os.sched_getparam(0).sched_priority}" if _scheduled() else "ordinary"


def _scheduled():
    """Whether this thread has a real-time priority."""
    try:
        return os.sched_getscheduler(0) in (os.SCHED_FIFO, os.SCHED_RR)
    except AttributeError:
        return False
