"""``play``: play a bag once its subscribers are ready.

A node takes seconds to start on a small computer, and misses messages played before. If timestamps
are missing or from another clock, a copy is played in which each message has the time that an
evaluation of the bag would use.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path

import rosgraph

from ..bags.records import BagFile
from ..bags.restamped import write_restamped
from ..errors import BagError, MapRacingError
from .node import to_launch_folder

__all__ = ["main"]

PATIENCE_S = 60.0
CONNECTING_S = 3.0
# Queue for a busy subscriber: rosbag's default of 100 lasts only a quarter of a second at ten times
# real time.
QUEUE = 10000
AWAIT = "--await="


def main(arguments: list[str] | None = None) -> int:
    """Wait for subscribers, then run ``rosbag play``.

    Parameters
    ----------
    arguments : list of str, optional
        ``--await=NODE:TOPIC`` names a subscriber to wait for, and may be repeated; all others go to
        ``rosbag play``. Arguments without a dash are bags, so options need the form
        ``--option=value``.

    Returns
    -------
    int
        Exit code if a bag or a subscriber is missing, or a copy was played; otherwise ``rosbag``
        replaces this process.
    """
    arguments = sys.argv[1:] if arguments is None else arguments
    to_launch_folder()
    options = [argument for argument in arguments if not argument.startswith(AWAIT)]
    if not any(option.startswith(("-d", "--delay")) for option in options):
        # Subscribers still have to connect. The second that rosbag allows is too short when
        # everything starts at once on a busy computer.
        options.insert(0, f"--delay={CONNECTING_S:g}")
    if not any(option.startswith("--queue") for option in options):
        options.insert(0, f"--queue={QUEUE}")
    bags = [o for o in options if not o.startswith("-") and ":=" not in o]
    for bag in bags:
        if not os.path.isfile(bag):
            missing = f"{bag}: no such file in {os.getcwd()}"
            print(f"play: bag: {missing if bag else 'expected its name, got none'}")
            return 1
        try:
            BagFile(bag).close()
        except BagError as error:  # rosbag would not name the bag
            print(f"play: {error}")
            return 1
    awaited = [a[len(AWAIT) :].partition(":")[::2] for a in arguments if a.startswith(AWAIT)]
    with tempfile.TemporaryDirectory(prefix="map_racing_") as folder:
        copies = _copies(bags, [topic for _, topic in awaited], folder)
        code = _await_all(awaited)
        if code == 0 and copies:
            # Play in a child process, because the copies must be deleted afterwards.
            return _play([copies.get(option, option) for option in options])
    if code == 0:
        os.execvp("rosbag", ["rosbag", "play", *options])
    return code


def _copies(bags, topics, folder):
    """Copies, by name, of bags whose timestamps the evaluation would replace."""
    copies = {}
    for number, bag in enumerate(bags):
        copy = Path(folder) / f"{number}.bag"
        try:
            if write_restamped(bag, copy, topics[0] if topics else None):
                print(
                    f"play: {bag}: timestamps missing or from another clock: replaced by those of "
                    "the evaluation"
                )
                copies[bag] = str(copy)
        except MapRacingError as error:
            print(f"play: {error}; it is played unchanged")
    return copies


def _await_all(awaited):
    """Wait for subscribers; return the exit code, 0 if all are ready."""
    end = time.monotonic() + PATIENCE_S
    for node, topic in awaited:
        while not _subscribed(node, topic):
            if time.monotonic() > end:
                print(f"play: {node} did not subscribe to {topic} within {PATIENCE_S:g} s")
                return 1
            try:
                time.sleep(0.1)
            except KeyboardInterrupt:
                return 130
    return 0


def _play(options):
    """Play in a child process, and return its exit code."""
    with subprocess.Popen(["rosbag", "play", *options]) as player:
        while True:
            with suppress(KeyboardInterrupt):  # the player receives the signal, too
                return player.wait()


def _subscribed(node, topic):
    return node in dict(rosgraph.Master("/play").getSystemState()[1]).get(topic, ())
