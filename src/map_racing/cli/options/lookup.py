"""Options of ``map-racing lookup``."""

import argparse

from ...vehicle.comparison import LARGEST_DIFFERENCE
from .recording import add_replay_window, add_signal_options

CONTROLLER = "map"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.description = "Make a steering lookup table, or check one."
    actions = parser.add_subparsers(dest="action", metavar="ACTION")
    actions.required = True
    _add_generate(actions)
    _add_check(actions)


def _add_generate(actions):
    generate = actions.add_parser(
        "generate",
        help="table of a vehicle",
        description="Steady-state lateral acceleration over speed and steering angle, as CSV in "
        "the published layout, with its provenance in a .meta.yaml beside it.",
    )
    generate.add_argument(
        "--vehicle", required=True, metavar="NAME", help="shipped vehicle or YAML file"
    )
    generate.add_argument("--output", required=True, metavar="CSV", help="table to write")
    generate.add_argument(
        "--linear", action="store_true", help="with the vehicle's tires linearized"
    )
    generate.add_argument(
        "--v-max", type=float, metavar="V", help="largest speed [m/s] (default: the vehicle's)"
    )
    generate.add_argument(
        "--published-grid",
        action="store_true",
        help="the grid of the published tables: 60 angles to 0.4 rad, 65 speeds to 7 m/s",
    )
    generate.add_argument("--plots", metavar="DIR", help="draw the table as surface and curves")
    generate.set_defaults(run="lookup.run_generate")


def _add_check(actions):
    check = actions.add_parser(
        "check",
        help="describe a table, compare it with a vehicle",
        description="Report the grid, the largest lateral acceleration and defects of a table. "
        "With --vehicle, compare it with the vehicle's table; a difference of more than "
        f"{LARGEST_DIFFERENCE:g} m/s^2 is an error. With --bag, too, drive the vehicle open loop "
        "by the commands of recordings, and report its errors.",
    )
    check.add_argument("table", metavar="CSV", help="lookup table")
    check.add_argument(
        "--vehicle", metavar="NAME", help="shipped vehicle or YAML file to compare with"
    )
    check.add_argument(
        "--linear", action="store_true", help="with --vehicle: with its tires linearized"
    )
    check.add_argument(
        "--raceline",
        metavar="FILE",
        help="list the speed at which each corner exceeds the table's limit: shipped track, "
        "raceline file or bag[#topic]",
    )
    check.add_argument(
        "--controller",
        default=CONTROLLER,
        metavar="NAME",
        help="with --raceline: also list where the grip_use of this controller (shipped, or YAML "
        "file) makes it slower than the raceline at a speed scale of 1 (default: %(default)s)",
    )
    check.add_argument(
        "--bag",
        nargs="+",
        default=[],
        metavar="RECORDING",
        help="with --vehicle, drive it by the commands of these recordings; only delay and lag of "
        "steering and drive are fitted to them",
    )
    add_replay_window(check)
    add_signal_options(check)
    check.add_argument("--plots", metavar="DIR", help="draw the table as surface and curves")
    check.set_defaults(run="lookup.run_check")
