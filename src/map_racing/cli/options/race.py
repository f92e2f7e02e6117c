"""Options of ``map-racing race``."""

import argparse

from ...resources import list_config
from .shared import add_number

KINDS = ("tracks", "controllers", "plants", "vehicles")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.description = (
        "Race a simulated car from a standing start: an out-lap, then timed laps. A race that "
        "ends in a crash or a stall is recorded as well; the exit code is then 3. Shipped: "
        + "; ".join(f"{kind} {', '.join(list_config(kind))}" for kind in KINDS)
        + "."
    )
    parser.add_argument(
        "--track",
        default="reference",
        metavar="NAME",
        help="shipped track, raceline file or bag[#topic] (default: %(default)s)",
    )
    parser.add_argument(
        "--controller",
        default="map",
        metavar="NAME",
        help="shipped controller or YAML file; those named _paper are as published, without delay "
        "compensation (default: %(default)s)",
    )
    parser.add_argument(
        "--plant",
        default="nuc4",
        metavar="NAME",
        help="the simulated car: shipped plant or YAML file; public_simulator is the plant of the "
        "public ROS 1 simulator, which has no noise (default: %(default)s)",
    )
    parser.add_argument(
        "--vehicle",
        metavar="NAME",
        help="the controller's model of the car: shipped vehicle or YAML file (default: the "
        "vehicle of the plant)",
    )
    parser.add_argument(
        "--lookup-table", metavar="CSV", help="steer with this table, not the vehicle's own"
    )
    parser.add_argument("--speed-sectors", metavar="YAML", help="speed_scaling.yaml of race_stack")
    parser.add_argument(
        "--faults",
        metavar="YAML",
        help="drive under the supervisor, as the node does, with the faults of this schedule; "
        "map-racing faults --list names them",
    )
    add_number(parser, "--laps", 5, "timed laps", metavar="N")
    parser.add_argument(
        "--speed-scale",
        type=float,
        metavar="SCALE",
        help="scale of the raceline's speeds, 0.7 for 70 %% (default: the controller's); its "
        "grip_use may lower the speeds further",
    )
    add_number(parser, "--seed", 1, "seed of the noise", metavar="N")
    parser.add_argument("--output", required=True, metavar="BAG", help="bag to write")
    parser.set_defaults(run="race.run")
