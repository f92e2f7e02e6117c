"""Options of ``map-racing delay``."""

import argparse

from .recording import add_runs, add_signal_options


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.description = (
        "Estimate the delays of a car from recorded laps: age of the pose, dead time and lag of "
        "the steering and of the drive, and the controller's delay_s and speed_lookahead_s that "
        "follow, each with its 95 % interval. It says so if the driving was too straight to show a "
        "delay."
    )
    add_runs(parser)
    parser.add_argument(
        "--vehicle",
        metavar="NAME",
        help="model of the car, which makes the estimate more certain: shipped vehicle or YAML "
        "file (default: any car of this size)",
    )
    add_signal_options(parser)
    parser.add_argument("--json", metavar="FILE", help="write the delays as JSON")
    parser.set_defaults(run="delay.run")
