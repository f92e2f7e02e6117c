"""The command line ``map-racing``: it parses, calls the core and prints; nothing else."""

import argparse
import os
import sys

from .. import __version__
from ..errors import MapRacingError
from . import compare, evaluate, experiment, identify, lookup, race, raceline, ramp, tune

__all__ = ["main"]


def build_parser():
    """The parser of all commands; each command's module adds its own part."""
    parser = argparse.ArgumentParser(
        prog="map-racing",
        description="Model- and Acceleration-based Pursuit for 1:10 race cars: "
        "race a simulated car, evaluate laps from bags, identify tires, make and check lookup "
        "tables and racelines, tune controllers, repeat the paper's experiments.",
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND")
    commands.required = True
    for module in (
        *(race, evaluate, lookup, raceline, ramp, identify),
        *(tune, experiment, compare),
    ):
        module.add_parser(commands)
    return parser


def main(argv=None):
    """Run one command.

    Parameters
    ----------
    argv : list of str, optional
        Arguments without the program's name; by default those of the process.

    Returns
    -------
    int
        Exit code: 0, or 1 after an error, which is one line on stderr. argparse itself exits with 2
        on arguments that it cannot take.
    """
    _prepare_streams()
    arguments = build_parser().parse_args(argv)
    try:
        return arguments.run(arguments) or 0
    except MapRacingError as error:
        print(f"map-racing: {error}", file=sys.stderr)
        return 1
    except OSError as error:
        name = f"{error.filename}: " if error.filename else ""
        print(f"map-racing: {name}{error.strerror or error}", file=sys.stderr)
        return 1
    except MemoryError:
        print("map-racing: not enough memory", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("map-racing: interrupted", file=sys.stderr)
        return 130


def _prepare_streams():
    """Print whatever a file is called, whatever the terminal can show, and without a stderr."""
    if sys.stderr is None:
        # Progress bars ask it whether it is a terminal.
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="backslashreplace")
