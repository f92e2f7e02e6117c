"""Notices a dropout of the poses as soon as it exceeds the limit."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, Callable

import rospy

if TYPE_CHECKING:
    from ..control.safety import Supervisor
    from .node import SteadyClock

__all__ = ["Watchdog"]

# Longest interval between calls [s], for the time before the first pose and a clock set back.
IDLE_S = 0.1


class Watchdog:
    """Calls a function at the deadline of a supervisor, in a separate thread.

    Each pose postpones the deadline; the thread wakes at the old one, and sleeps again.

    Parameters
    ----------
    lock : threading.RLock
        Guards the supervisor; also held during the call.
    clock : SteadyClock
    supervisor : Supervisor
    watch : callable
        Called with the time [s].
    """

    def __init__(
        self,
        lock: threading.RLock,
        clock: SteadyClock,
        supervisor: Supervisor,
        watch: Callable[[float], None],
    ):
        self._lock, self._clock = lock, clock
        self._supervisor, self._watch = supervisor, watch
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self):
        while not rospy.is_shutdown():
            with self._lock:
                now = self._clock.now()
                self._watch(now)
                due = self._supervisor.deadline
            left = IDLE_S if due is None else min(due - now, IDLE_S)
            try:
                rospy.sleep(max(left, 0.0))
            except rospy.ROSException:  # time was set back, or the node ends
                time.sleep(0.001)
