"""Options of ``map-racing advise``."""

import argparse

from .evaluate import add_evaluation_options
from .report import add_car_options
from .shared import add_number


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.description = (
        "A speed scale for each sector of the raceline for the next heat, and the predicted lap "
        "time. They follow from the grip used in the last heat, the distance to the walls and the "
        "lateral error. Drive these scales at speed_scale 1."
    )
    add_evaluation_options(parser)
    add_car_options(parser)
    parser.add_argument(
        "--speed-sectors", metavar="YAML", help="write the scales as speed_scaling.yaml"
    )
    add_number(parser, "--step", 0.15, "largest relative increase of a scale", metavar="SHARE")
    parser.set_defaults(run="advise.run")
