"""Options of ``map-racing identify``."""

import argparse

from ...identification.limits import SteadyLimits
from ...resources import list_config
from .shared import add_join_option, add_number


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.description = (
        "Identify the tires of a car from recordings of steady cornering: ramps of the steering "
        "angle or circles at steady speeds. Writes the vehicle file and, beside it, its lookup "
        "table (.csv). Data that cannot identify tires are refused with the reason."
    )
    parser.add_argument(
        "data",
        nargs="+",
        metavar="DATA",
        help="bags of ROS 1 or 2 (folder, .db3, .mcap), or CSV files with --channels",
    )
    add_join_option(parser)
    parser.add_argument(
        "--vehicle",
        required=True,
        help="mass and geometry of the car, and tire parameters to keep where the data determine "
        "none (shipped vehicle or YAML file)",
    )
    parser.add_argument("--output", required=True, metavar="YAML", help="vehicle file to write")
    parser.add_argument(
        "--linear-output",
        metavar="YAML",
        help="also write the car with linear tires, by regression",
    )
    parser.add_argument("--name", help="name of the identified car (default: the name of the file)")
    parser.add_argument(
        "--channels",
        metavar="YAML",
        help="channel map of columns or topics: YAML file, or shipped: "
        + ", ".join(list_config("channels")),
    )
    parser.add_argument(
        "--pose-topic", metavar="TOPIC", help="topic of the poses in bags (default: the best)"
    )
    parser.add_argument(
        "--servo-topic",
        metavar="TOPIC",
        help="take the steering angle from the servo position (std_msgs/Float64) instead of the "
        "drive command",
    )
    servo = "position = gain * angle + offset, as in the configuration of the VESC"
    add_number(parser, "--servo-gain", -1.2135, servo)
    add_number(parser, "--servo-offset", 0.5304, "offset of the same")
    parser.add_argument(
        "--steering-delay",
        type=float,
        metavar="S",
        help="latency of the steering [s], also in a channel map (default: 0; on a ramp of "
        "0.02 rad/s, 50 ms are 1 mrad)",
    )
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
        ("--steady-dv", "dv_mps2", "largest steady rate of speed [m/s^2]"),
        ("--steady-dr", "dr_radps2", "largest steady rate of yaw rate [rad/s^2]"),
        ("--steady-ddelta", "ddelta_radps", "largest steady rate of steering angle [rad/s]"),
        ("--steady-time", "shortest_s", "shortest steady segment [s]"),
    ):
        add_number(parser, option, getattr(limits, name), meaning, dest=name, metavar="X")
    parser.add_argument("--json", metavar="FILE", help="write the report as JSON")
    parser.add_argument("--plots", metavar="DIR", help="write figures")
    parser.set_defaults(run="identify.run")
