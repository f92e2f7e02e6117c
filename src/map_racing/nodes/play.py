"""``play``: play a bag once its subscribers are there.

A node takes seconds to start on a small computer, and misses what is played before.
"""

from __future__ import annotations

import os
import sys
import time

import rosgraph

from .node import to_launch_folder

__all__ = ["main"]

PATIENCE_S = 60.0
AWAIT = "--await="


def main(arguments: list[str] | None = None) -> int:
    """Wait for subscribers, then become ``rosbag play``.

    Parameters
    ----------
    arguments : list of str, optional
        ``--await=NODE:TOPIC`` names a subscriber to wait for, and may be repeated; all others go to
        ``rosbag play``.

    Returns
    -------
    int
        Exit code, if a bag or a subscriber is missing; otherwise it does not return.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    to_launch_folder()
    for bag in (a for a in arguments if not a.startswith("-") and ":=" not in a):
        if not os.path.isfile(bag):
            print(f"play: bag: {bag or 'none given'}: no such file in {os.getcwd()}")
            return 1
    end = time.monotonic() + PATIENCE_S
    for argument in arguments:
        if argument.startswith(AWAIT):
            node, _, topic = argument[len(AWAIT) :].partition(":")
            while not _subscribed(node, topic):
                if time.monotonic() > end:
                    print(f"play: {node} did not subscribe to {topic} within {PATIENCE_S:g} s")
                    return 1
                try:
                    time.sleep(0.1)
                except KeyboardInterrupt:
                    return 130
    options = [argument for argument in arguments if not argument.startswith(AWAIT)]
    os.execvp("rosbag", ["rosbag", "play", *options])


def _subscribed(node, topic):
    return node in dict(rosgraph.Master("/play").getSystemState()[1]).get(topic, ())
