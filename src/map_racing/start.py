"""Start of the programs: what is not installed, or a Ctrl-C meanwhile, is no traceback."""

import sys
from importlib import import_module

__all__ = ["command_line", "start"]


def start(module):
    """Import a module and run its ``main``.

    Parameters
    ----------
    module : str
        Name within the package, such as ``"nodes.controller"``.
    """
    try:
        main = import_module(f"map_racing.{module}").main
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] == "map_racing":
            raise
        sys.exit(
            f"map_racing: {sys.executable} has no module {error.name!r}: install what package.xml "
            "names (rosdep install --from-paths src --ignore-src; see the README)"
        )
    except KeyboardInterrupt:
        sys.exit(130)
    sys.exit(main())


def command_line():
    """Run the command line, as the installed program ``map-racing``."""
    start("cli")
