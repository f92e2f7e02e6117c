"""Options of ``map-racing evaluate``."""

import argparse

from .shared import add_number, add_recording_options

__all__ = ["add_evaluation_options", "add_limit_options", "add_options"]


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.description = (
        "Lap times and lateral errors of recorded driving. Pose and raceline are found in the bag; "
        "a CSV file needs --raceline."
    )
    add_evaluation_options(parser)
    parser.add_argument("--csv", metavar="FILE", help="write the laps of all runs")
    parser.add_argument("--json", metavar="FILE", help="write the laps and summaries of all runs")
    parser.add_argument("--plots", metavar="DIR", help="write figures")
    parser.set_defaults(run="evaluate.run")


def add_evaluation_options(parser: argparse.ArgumentParser) -> None:
    """Add the recordings and the options for evaluating them."""
    add_recording_options(parser)
    parser.add_argument(
        "--reverse", action="store_true", help="the raceline was driven in the opposite direction"
    )
    parser.add_argument(
        "--start-line",
        type=float,
        default=0.0,
        metavar="S",
        help="arc length of the start line on the raceline [m] (default: its first point)",
    )
    add_number(parser, "--sectors", 3, "number of timed sectors in CSV and JSON", metavar="N")
    add_limit_options(parser)
    # As in `map_racing.evaluation.lap_limits.LapLimits`, which is slow to import for --help.
    stop = "longest time that the car may stand in a lap that counts [s]"
    add_number(parser, "--max-stop", 0.3, stop, metavar="S")
    braking = "harder braking counts as hitting a wall [m/s^2]"
    add_number(parser, "--max-deceleration", 25.0, braking, metavar="A")


def add_limit_options(parser: argparse.ArgumentParser) -> None:
    """Add the width of the car, and the limits of the track."""
    width = "width of the car, for the clearance to the walls [m]"
    add_number(parser, "--car-width", 0.3, width, metavar="M")
    parser.add_argument(
        "--max-deviation",
        type=float,
        metavar="M",
        help="largest lateral error of the car's center that is still on the track [m] (default: "
        "up to the walls or, without walls, 2 m)",
    )
