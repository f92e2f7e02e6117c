"""The log of a node, written in threads of its own: no reader of the log can delay or end the node.

Lines are written under the lock of a control step. A terminal that is paused, a pipe that nobody
reads, and a disk that hangs would stop the commands with them; a pipe that is closed raises.
"""

from __future__ import annotations

import logging
import queue
import threading
import time
from contextlib import suppress

from rospy.impl.rosout import RosOutHandler

__all__ = ["write_beside"]

# At most this many records wait for a slow reader; later ones are lost.
MOST_WAITING = 1000
# The end of the program waits this long [s] for the last lines.
LAST_LINES_S = 1.0


class _Beside(logging.Handler):
    """Hands records to a handler in a thread of its own."""

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
            # Not `handle`: the end of the program would wait for its lock.
            with suppress(Exception):
                self._handler.emit(record)
            self._records.task_done()

    def flush(self):
        """Wait for the last lines, but not for ever; called at the end of the program."""
        end = time.monotonic() + LAST_LINES_S
        while self._records.unfinished_tasks and time.monotonic() < end:
            time.sleep(0.001)


def write_beside() -> None:
    """Have all handlers of the log write in threads of their own, except ``/rosout``."""
    others = logging.root.manager.loggerDict.values()
    for logger in [logging.root, *(o for o in others if isinstance(o, logging.Logger))]:
        for handler in list(logger.handlers):
            if not isinstance(handler, (_Beside, RosOutHandler, logging.NullHandler)):
                logger.removeHandler(handler)
                logger.addHandler(_Beside(handler))
