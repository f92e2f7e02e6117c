"""Options of ``map-racing tune``."""

import argparse

from ...resources import list_config
from .shared import add_grid_options, add_shared_options

DEFAULTS = ("pure_pursuit_paper", "map_linear_paper", "map_paper")


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.description = (
        "For each controller, find m and q of the lookahead distance L_d = m + q v with the "
        "smallest RMS lateral error of the true path, averaged over the laps of races on practice "
        "days. Writes a controller file for --controller, a figure of the error, and all pairs as "
        "CSV."
    )
    parser.add_argument(
        "--controller",
        nargs="+",
        default=list(DEFAULTS),
        metavar="NAME",
        help=f"YAML files, or shipped: {', '.join(list_config('controllers'))} (default: the three "
        "as published)",
    )
    parser.add_argument(
        "--speed-scale",
        dest="tuning_scale",
        type=float,
        metavar="SCALE",
        help="scale of the raceline's speeds (default: as in the conditions, 0.6)",
    )
    parser.add_argument(
        "--robust",
        action="store_true",
        help="race on a grid of tracks and cars, at its speeds. Of the values of m, q, slip "
        "lookahead, delay, curvature feedforward, yaw rate gain and speed lookahead that complete "
        "every race, find those with the smallest error (geometric mean over the races); the "
        "search begins at the controller's own values, and what is 0 stays off",
    )
    add_grid_options(parser)
    parser.add_argument(
        "--grip-use",
        type=float,
        nargs="+",
        metavar="SHARE",
        help="with --robust: race the result with each of these values of grip_use, too",
    )
    add_shared_options(parser, "practice_seeds")
    parser.set_defaults(run="tune.run")
