"""Options of the commands that read recordings of a car."""

import argparse

from ...identification.limits import REPLAY_WINDOW_S
from ...resources import list_config
from .shared import add_number

__all__ = ["add_signal_options", "add_replay_window"]


def add_signal_options(parser: argparse.ArgumentParser) -> None:
    """Add what says where the signals of a recording are."""
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
    add_number(parser, "--servo-offset", 0.5304, "offset in the same formula")
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
