"""Start the programs: a missing library, or Ctrl-C during the imports, is no traceback."""

from __future__ import annotations

import sys
from importlib import import_module

__all__ = ["command_line", "start"]


def start(module: str) -> None:
    """Import a module and run its ``main``.

    Parameters
    ----------
    module : str
        Name within the package, such as ``"nodes.controller"``.
    """
    try:
        sys.exit(import_module(f"map_racing.{module}").main())
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] == "map_racing":
            raise
        sys.exit(
            f"map_racing: {sys.executable} has no module {error.name!r}: install what package.xml "
            "names (rosdep install --from-paths src --ignore-src; see the README)"
        )
    except KeyboardInterrupt:
        sys.exit(130)


def command_line() -> None:
    """Run the command line, as the installed program ``map-racing``."""
    start("cli")
