"""Options of the commands that read recordings of a car."""

import argparse

from ...identification.limits import REPLAY_WINDOW_S
from ...resources import list_config
from .shared import add_join_option, add_number

__all__ = ["SERVO", "add_replay_window", "add_runs", "add_signal_options"]

SERVO = (-1.2135, 0.5304)
"""Gain and offset of the servo position, unless given."""


def add_runs(parser: argparse.ArgumentParser) -> None:
    """Add the recordings of a car."""
    parser.add_argument(
        "data",
        nargs="+",
        metavar="RECORDING",
        help="bag of ROS 1 or 2 (folder, .db3, .mcap), or CSV file with --channels",
    )
    add_join_option(parser)


def add_signal_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that locate the signals of a recording."""
    parser.add_argument(
        "--channels",
        metavar="YAML",
        help="channel map of columns or topics: YAML file, or shipped: "
        + ", ".join(list_config("channels")),
    )
    parser.add_argument(
        "--pose-topic", metavar="TOPIC", help="topic of the pose (default: the best in the bag)"
    )
    parser.add_argument(
        "--servo-topic",
        metavar="TOPIC",
        help="take the steering angle from the servo position (std_msgs/Float64) instead of the "
        "drive command",
    )
    servo = "with --servo-topic: position = gain * angle + offset, as configured in the VESC"
    gain, offset = SERVO
    add_number(parser, "--servo-gain", gain, servo, metavar="X")
    add_number(parser, "--servo-offset", offset, "offset in the same formula", metavar="X")
    parser.add_argument(
        "--steering-delay",
        type=float,
        metavar="S",
        help="latency of the steering [s]; a channel map may hold it, too (default: 0; on a ramp "
        "of 0.02 rad/s, 50 ms shift the angle by 1 mrad)",
    )


def add_replay_window(parser: argparse.ArgumentParser) -> None:
    """Add the length of the windows of a replay."""
    add_number(
        parser, "--window", REPLAY_WINDOW_S, "length of the windows of a replay [s]", metavar="S"
    )
