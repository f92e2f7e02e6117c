"""Options of ``map-racing identify``."""

import argparse

from ...identification.limits import SteadyLimits
from .recording import add_replay_window, add_runs, add_signal_options
from .shared import add_number


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.description = (
        "Identify the tires of a car from recordings of steady cornering (ramps of the steering "
        "angle or circles at steady speeds), of ordinary laps, or of both. Writes the vehicle file "
        "and, beside it, its lookup table (.csv). Data that cannot identify tires are refused with "
        "the reason."
    )
    add_runs(parser)
    parser.add_argument(
        "--vehicle",
        required=True,
        metavar="NAME",
        help="mass and geometry of the car, and tire parameters to keep where the data do not "
        "determine them (shipped vehicle or YAML file)",
    )
    parser.add_argument("--output", required=True, metavar="YAML", help="vehicle file to write")
    parser.add_argument(
        "--linear-output",
        metavar="YAML",
        help="also write the car with linear tires (a regression; from laps, the slope "
        "at zero slip)",
    )
    parser.add_argument(
        "--controller-output",
        metavar="YAML",
        help="also write the controller map with the delay_s found in ordinary driving",
    )
    parser.add_argument(
        "--name", metavar="NAME", help="name of the identified car (default: the name of the file)"
    )
    add_signal_options(parser)
    parser.add_argument(
        "--fix",
        action="store_true",
        help="correct signs, axes, scales, offsets and steering gain that contradict physics",
    )
    parser.add_argument(
        "--leave-one-out",
        action="store_true",
        help="also predict each run from the others, and report the error",
    )
    parser.add_argument(
        "--validate",
        nargs="+",
        default=[],
        metavar="RECORDING",
        help="recordings that the car is not fitted to: it is driven open loop with their "
        "commands, and the largest error of all channels and runs heads the report",
    )
    add_replay_window(parser)
    _add_steady(parser)
    parser.add_argument("--json", metavar="FILE", help="write the report as JSON")
    parser.add_argument("--plots", metavar="DIR", help="write figures")
    parser.set_defaults(run="identify.run")


def _add_steady(parser):
    """Add the options for finding and fitting steady cornering."""
    parser.add_argument(
        "--acceleration",
        choices=("imu", "yaw_rate"),
        default="imu",
        help="lateral acceleration of the IMU, or speed times yaw rate (default: %(default)s)",
    )
    parser.add_argument(
        "--front-force",
        choices=("model", "paper"),
        default="model",
        help="front force as in the equations of motion, or divided by the cosine of the steering "
        "angle as in the paper (default: %(default)s)",
    )
    limits = SteadyLimits()
    for option, name, meaning in (
        ("--cutoff", "cutoff_hz", "cutoff frequency of the low-pass [Hz]"),
        ("--steady-dv", "dv_mps2", "in a steady segment, largest rate of the speed [m/s^2]"),
        ("--steady-dr", "dr_radps2", "in a steady segment, largest rate of the yaw rate [rad/s^2]"),
        (
            "--steady-ddelta",
            "ddelta_radps",
            "in a steady segment, largest rate of steering [rad/s]",
        ),
        ("--steady-time", "shortest_s", "shortest steady segment [s]"),
    ):
        add_number(parser, option, getattr(limits, name), meaning, dest=name, metavar="X")
