"""Writes the log of a node in separate threads, so that its reader cannot delay or end the node.

A control step logs while it holds its lock. A paused terminal, a pipe that nobody reads or a
hanging disk would therefore block the commands, and a closed pipe would raise.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from contextlib import suppress

from rospy.impl.rosout import RosOutHandler

__all__ = ["write_beside"]

# Most records that wait for a slow reader; further ones are lost.
MOST_WAITING = 1000
# Longest wait for the last lines at the end of the program [s].
LAST_LINES_S = 1.0


class _Threaded(logging.Handler):
    """Passes records to a handler in a separate thread."""

    def __init__(self, handler):
        super().__init__(handler.level)
        self._handler, self._records = handler, queue.Queue(MOST_WAITING)
        threading.Thread(target=self._write, daemon=True).start()

    def emit(self, record):
        with suppress(queue.Full):
            self._records.put_nowait(record)

    def _write(self):
        while True:
            record = self._records.get()
            # Not `handle`, whose lock would block the end of the program.
            with suppress(Exception):
                self._handler.emit(record)
            self._records.task_done()

    def flush(self):
        """Wait a limited time for the last lines; called at the end of the program."""
        end = time.monotonic() + LAST_LINES_S
        while self._records.unfinished_tasks and time.monotonic() < end:
            time.sleep(0.001)


def write_beside() -> None:
    """Make all log handlers except ``/rosout`` write in separate threads."""
    others = logging.root.manager.loggerDict.values()
    for logger in [logging.root, *(o for o in others if isinstance(o, logging.Logger))]:
        for handler in list(logger.handlers):
            if not isinstance(handler, (_Threaded, RosOutHandler, logging.NullHandler)):
                logger.removeHandler(handler)
                logger.addHandler(_Threaded(handler))
