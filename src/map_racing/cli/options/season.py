"""Options of ``map-racing season``."""

import argparse

from .evaluate import add_limit_options
from .shared import add_number, add_worker_options


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.description = (
        "Evaluate all bags of ROS 1 and 2 below folders: a table of heats (season.csv) and a page "
        "of trends that opens offline (season.html). Bags that have not changed are not read "
        "again, and an interrupted season continues. A bag that cannot be read becomes a "
        "row that says why."
    )
    parser.add_argument("folders", nargs="+", metavar="DIR", help="folders with bags, or bags")
    parser.add_argument(
        "--output", required=True, metavar="DIR", help="folder for results, may be among the bags"
    )
    parser.add_argument(
        "--tracks",
        nargs="+",
        default=[],
        metavar="FILE",
        help="racelines that name the tracks; bags without a raceline are evaluated on them",
    )
    add_number(
        parser,
        "--reports",
        0,
        "write the missing reports of this many of the latest heats",
        metavar="N",
    )
    add_limit_options(parser)
    add_worker_options(parser)
    parser.set_defaults(run="season.run")
