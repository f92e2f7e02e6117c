"""Start the programs: a missing library, Ctrl-C or a closed pipe is no traceback."""

from __future__ import annotations

import os
import sys
from contextlib import contextmanager
from importlib import import_module
from typing import Iterator

__all__ = ["command_line", "start", "without_traceback"]

# Made by catkin, in a workspace; a checkout has none of them.
_GENERATED = ("map_racing.cfg", "map_racing.msg", "map_racing.srv")


def start(module: str) -> None:
    """Import a module and run its ``main``.

    Parameters
    ----------
    module : str
        Name within the package, such as ``"nodes.controller"``.
    """
    with without_traceback():
        sys.exit(import_module(f"map_racing.{module}").main())


@contextmanager
def without_traceback() -> Iterator[None]:
    """End the program without a traceback, where it is no error of the program.

    A library that is missing, and an error for the user, is one line on stderr, with exit code 1.
    Ctrl-C ends it with 130. A reader of its output that ends first, such as ``head``, ends it
    silently with 141, the code of programs that SIGPIPE ends.
    """
    try:
        try:
            yield
        finally:
            for stream in _streams():
                stream.flush()
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] == "map_racing" and error.name not in _GENERATED:
            raise
        sys.exit(
            f"map_racing: {sys.executable} has no module {error.name!r}: activate the environment "
            "in which map_racing is installed; nodes need a built workspace (. devel/setup.bash), "
            "and what package.xml names (rosdep install --from-paths src --ignore-src)"
        )
    except KeyboardInterrupt:
        sys.exit(130)
    except BrokenPipeError:
        # What is left in the buffers would fail again when Python ends.
        for stream in _streams():
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
        sys.exit(141)
    except Exception as error:
        # The base of the errors is imported late: this file needs nothing but Python.
        from .errors import MapRacingError

        if not isinstance(error, MapRacingError):
            raise
        sys.exit(f"map_racing: {error}")


def _streams():
    return [stream for stream in (sys.stdout, sys.stderr) if stream is not None]


def command_line() -> None:
    """Run the command line, as the installed program ``map-racing``."""
    start("cli")
