"""Options of ``map-racing report``."""

import argparse

from ...resources import list_config
from .evaluate import add_evaluation_options

__all__ = ["add_car_options", "add_options"]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.description = (
        "One HTML page on one run, or on several side by side: laps, the places that cost most "
        "time, charts over distance, the map, grip, consistency. It opens offline in any browser. "
        "Needs plotly (pip install 'map_racing[report]')."
    )
    add_evaluation_options(parser)
    add_car_options(parser)
    parser.add_argument("--output", required=True, metavar="HTML", help="page to write")
    parser.set_defaults(run="report.run")


def add_car_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for car and laps."""
    parser.add_argument(
        "--vehicle",
        metavar="NAME",
        help=f"the car that was driven: {', '.join(list_config('vehicles'))} or YAML file "
        "(default: the one in the controller's settings in the bag)",
    )
    parser.add_argument(
        "--laps",
        metavar="LAPS",
        help="numbers of the laps to include, such as 2-5,8 (default: all)",
    )
