"""Options of ``map-racing ramp``."""

import argparse

from ...control.steering_ramp import RampParameters
from .shared import add_number, add_plant_option


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.description = (
        "Drive at constant speed with slowly rising steering angle, left and right, as "
        "identify.launch does on the car: the data from which tires are identified."
    )
    defaults = RampParameters()
    add_plant_option(parser)
    parser.add_argument(
        "--speed",
        type=float,
        nargs="+",
        metavar="V",
        help="speeds [m/s], one ramp after the other (default: 2 for a 1:10 car; this "
        "and the default of --rate scale with the wheelbase)",
    )
    for option, name, meaning in (
        ("--rate", "rate_radps", "rise of the steering angle [rad/s]"),
        ("--start", "start_rad", "steering angle at the beginning [rad]"),
        ("--limit", "limit_rad", "steering angle at the end [rad]"),
    ):
        parser.add_argument(
            option,
            dest=name,
            type=float,
            metavar="X",
            help=f"{meaning} (default: {getattr(defaults, name):g})",
        )
    parser.add_argument(
        "--sides",
        default="both",
        metavar="SIDE",
        help="sides to turn to: both, left or right (default: both)",
    )
    add_number(parser, "--seed", 1, "seed of the noise", metavar="N")
    parser.add_argument(
        "--compression",
        choices=("lz4", "bz2", "none"),
        default="lz4",
        help="compression of the bag; bz2 is smaller (default: %(default)s)",
    )
    parser.add_argument("--output", required=True, metavar="BAG", help="bag to write")
    parser.set_defaults(run="ramp.run")
