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
        help="shipped track, raceline file or bag[#topic] (default: %(default)s)",
    )
    parser.add_argument(
        "--controller",
        default="map",
        help="shipped controller or YAML file; those named _paper are as published, without delay "
        "compensation (default: %(default)s)",
    )
    parser.add_argument(
        "--plant",
        default="nuc4",
        help="the simulated car: shipped plant, YAML file, or public_simulator for the plant of "
        "the public ROS 1 simulator, which has no noise (default: %(default)s)",
    )
    parser.add_argument(
        "--vehicle",
        help="the controller's model of the car: shipped vehicle or YAML file (default: the "
        "vehicle of the plant)",
    )
    parser.add_argument(
        "--lookup-table", metavar="CSV", help="steer with this table, not the vehicle's own"
    )
    parser.add_argument(
        "--speed-sectors", metavar="YAML", help="speed_scaling.yaml of the public stack"
    )
    parser.add_argument(
        "--faults",
        metavar="YAML",
        help="drive under the supervisor, as the node does, with the faults of this schedule; "
        "map-racing faults --list names them",
    )
    add_number(parser, "--laps", 5, "timed laps")
    parser.add_argument(
        "--speed-scale",
        type=float,
        help="scale of the raceline's speeds, 0.7 for 70 %% (default: the controller's); grip_use "
        "may lower them further",
    )
    add_number(parser, "--seed", 1, "seed of the noise")
    parser.add_argument("--output", required=True, metavar="BAG", help="bag to write")
    parser.set_defaults(run="race.run")
