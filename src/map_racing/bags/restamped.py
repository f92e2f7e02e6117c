"""Copies of bags, with the times that the evaluation uses as stamps.

A node that receives a replayed message without a stamp has only the time of ``/clock``, which runs
in steps; the stamps of another computer are off. In the copy each pose and drive command carries
its corrected time; poses from tf stay as they are.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

from .clocks import COMMAND_DELAY_NS, mended
from .messages import TF
from .reader import read_recording
from .records import BagFile
from .writer import copy_bag

__all__ = ["write_restamped"]

_STAMP = struct.Struct("<II")
_STAMP_AT = 4  # in the header, after its number


def write_restamped(path: str | Path, output: str | Path, pose_topic: str | None = None) -> bool:
    """Write a copy of a bag in which poses and drive commands have the times of `read_recording`.

    Parameters
    ----------
    path, output : str or pathlib.Path
    pose_topic : str, optional
        See `read_recording`.

    Returns
    -------
    bool
        Whether a copy was written; none is needed if the stamps are good.

    Raises
    ------
    BagError
        If the bag cannot be read, or the copy cannot be written.
    """
    recording = read_recording(path, pose_topic)
    # A transform has its stamp at another place than the other messages.
    topics = [recording.topic] if recording.type != TF else []
    topics += [recording.commands.topic] if recording.commands else []
    with BagFile(path) as bag:
        changed = {}
        for topic in topics:
            changed.update(_changed(bag, topic, recording.clock, topic == recording.topic))
        if not changed:
            return False

        def stamped(place, message):
            stamp = changed.get((message.connection, place))
            if stamp is None:
                return message.data
            end = _STAMP_AT + _STAMP.size
            return message.data[:_STAMP_AT] + _STAMP.pack(*stamp) + message.data[end:]

        copy_bag(bag, output, stamped)
    return True


def _changed(bag, topic, clock, is_pose):
    """New stamps (s, ns) by connection and number of the message in it, where they differ."""
    wanted = {number for number, connection in bag.connections.items() if connection.topic == topic}
    keys, stamps, received, others, count = [], [], [], [], {}
    before = b""
    for message in bag.messages(wanted) if wanted else ():
        place = count[message.connection] = count.get(message.connection, -1) + 1
        if len(message.data) < _STAMP_AT + _STAMP.size:
            continue
        seconds, rest = _STAMP.unpack_from(message.data, _STAMP_AT)
        keys.append((message.connection, place))
        stamps.append(seconds * 10**9 + rest)
        received.append(message.time_ns)
        contents = message.data[_STAMP_AT + _STAMP.size :]
        others.append(contents != before)
        before = contents
    stamps, received = (np.array(times, dtype=np.int64) for times in (stamps, received))
    times, *_ = mended(stamps, received, np.array(others, dtype=bool))
    if is_pose and clock.use_receipt:
        times = received
    elif not is_pose:
        times = clock.times(times, received, [], topic, COMMAND_DELAY_NS)
    return {
        key: divmod(int(time), 10**9)
        for key, time, stamp in zip(keys, times, stamps.tolist())
        if time != stamp
    }
