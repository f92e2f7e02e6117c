"""The command line ``map-racing``: it parses, calls the core and prints; nothing else.

Each command is a module that does the work and one in `options` that defines the arguments; both
are imported only when the command is chosen.
"""

from __future__ import annotations

import argparse
import sys
from importlib import import_module

from .. import __version__
from ..errors import MapRacingError
from ..printing import printing

__all__ = ["main"]

COMMANDS = {
    "race": "race a simulated car, write a ROS 1 bag",
    "evaluate": "lap times and lateral errors from bags of ROS 1 or 2, or CSV files",
    "report": "one HTML page on runs: where the time was lost, and why",
    "advise": "speed sectors for the next heat, from the last one",
    "season": "all bags below folders: table of heats, page of trends",
    "lookup": "make or check a steering lookup table",
    "raceline": "check, convert, optimize and record racelines",
    "ramp": "drive steering ramps with a simulated car, write a ROS 1 bag",
    "identify": "identify tires from laps or steady cornering, write vehicle file and table",
    "delay": "delays of steering, drive and localization from recorded laps",
    "faults": "rehearse faults: what stops the car, how soon, and what lets it drive again",
    "tune": "find the lookahead with which a controller follows a track most closely",
    "experiment": "repeat the paper's experiments, race a grid of tracks and cars, or against MPC",
    "compare": "compare two result directories of experiments or of tuning",
}


class _StoreOnce(argparse._StoreAction):
    """Store the value of an option, and refuse a second one, which would replace the first."""

    given = False

    def __call__(self, parser, namespace, values, option_string=None):
        if self.given and self.option_strings:
            parser.error(f"argument {'/'.join(self.option_strings)}: expected once, got it again")
        self.given = True
        super().__call__(parser, namespace, values, option_string)


class _CommandParser(argparse.ArgumentParser):
    """Parser of a command; its arguments are defined only when it is chosen."""

    command = None

    def __init__(self, *args, **options):
        super().__init__(*args, **options)
        for name in (None, "store"):
            self.register("action", name, _StoreOnce)

    def parse_known_args(self, args=None, namespace=None):
        if self.command:
            import_module(f".options.{self.command}", __package__).add_options(self)
            self.command = None
        return super().parse_known_args(args, namespace)


def build_parser() -> argparse.ArgumentParser:
    """Parser of all commands."""
    parser = argparse.ArgumentParser(
        prog="map-racing",
        description="Model- and Acceleration-based Pursuit for 1:10 race cars: "
        "race a simulated car, evaluate laps from bags, identify tires, make and check lookup "
        "tables and racelines, tune controllers, repeat the paper's experiments.",
    )
    parser.add_argument("--version", action="version", version=f"%(prog)s {__version__}")
    commands = parser.add_subparsers(dest="command", metavar="COMMAND", parser_class=_CommandParser)
    commands.required = True
    for command, text in COMMANDS.items():
        commands.add_parser(command, help=text).command = command
    return parser


def main(argv: list[str] | None = None) -> int:
    """Run one command.

    Parameters
    ----------
    argv : list of str, optional
        Arguments without the program's name; by default the arguments of the process.

    Returns
    -------
    int
        Exit code: 0, 1 after an error, which is one line on stderr, or 3 after a race that was not
        completed. argparse itself exits with 2 on invalid arguments.
    """
    with printing():
        return _run(argv)


def _run(argv):
    try:
        arguments = build_parser().parse_args(argv)
        module, function = arguments.run.split(".")
        run = getattr(import_module(f".{module}", __package__), function)
        code = run(arguments) or 0
        sys.stdout.flush()
        return code
    except MapRacingError as error:
        print(f"map-racing: {error}", file=sys.stderr)
        return 1
    except BrokenPipeError:
        raise
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
