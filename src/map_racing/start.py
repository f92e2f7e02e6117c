"""Start of the scripts: what is not installed is one line, not a traceback."""

import sys
from importlib import import_module

__all__ = ["start"]


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
