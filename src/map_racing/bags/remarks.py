"""The controller's settings, and its states with reasons, from a bag."""

from __future__ import annotations

import struct
from contextlib import suppress
from typing import NamedTuple

import numpy as np

from . import messages as msg
from .opening import Source, open_bag
from .samples import Recording
from .topics import DIAGNOSTICS_TOPIC, SETTINGS_TOPIC, STATE

__all__ = ["Remarks", "read_remarks"]

# First words of the controller's status messages, and those of a car that may not drive.
_MODES = ("waiting", "driving", "stopping", "stopped")
_STOPS = _MODES[2:]


class Remarks(NamedTuple):
    """Texts with their times in a recording [s], each list in order.

    Attributes
    ----------
    settings : list of (float, str)
        Settings that the controller published.
    states : list of (float, str)
        Its state and reason, such as ``"stopping: pose too old"``, at each change.
    """

    settings: list
    states: list

    @property
    def stops(self) -> list[float]:
        """When the controller began to stop the car [s].

        A car that already stands, such as one that does not move although commanded, skips the
        state ``stopping``.
        """
        stops = [text.split(":")[0] in _STOPS for _, text in self.states]
        before = [True, *stops[:-1]]  # at first the car may have been standing already
        return [t for (t, _), now, then in zip(self.states, stops, before) if now and not then]


def read_remarks(source: Source, recording: Recording) -> Remarks:
    """Read the remarks in a bag.

    Parameters
    ----------
    source : str, pathlib.Path or sequence of them
        See `map_racing.bags.opening.open_bag`.
    recording : Recording
        Result of `read_recording` for the same bag.

    Returns
    -------
    Remarks
        Empty where nothing was recorded.

    Raises
    ------
    BagError
        If the file is no bag.
    """
    wanted = {
        (SETTINGS_TOPIC, msg.MD5[msg.STRING]): "settings",
        (DIAGNOSTICS_TOPIC, msg.MD5[msg.DIAGNOSTICS]): "states",
    }
    found = {"settings": [], "states": []}
    with open_bag(source) as bag:
        kinds = {
            number: wanted[connection.topic, connection.md5sum]
            for number, connection in bag.connections.items()
            if (connection.topic, connection.md5sum) in wanted
        }
        for message in bag.messages(set(kinds)) if kinds else ():
            with suppress(struct.error):
                kind, data = kinds[message.connection], message.data
                text = msg.decode_string(data)[0] if kind == "settings" else _state(data)
                if text and (not found[kind] or found[kind][-1][1] != text):
                    found[kind].append((message.time_ns, text))
    return Remarks(*(_on_clock(found[kind], recording) for kind in ("settings", "states")))


def _state(data):
    """State of the controller in a message of diagnostics; None if it is about something else."""
    _, statuses = msg.decode_diagnostics(data)
    for name, message, hardware in statuses:
        # Earlier versions used other names for status and hardware.
        ours = name.endswith(STATE) or (name.endswith(": driving") and hardware == "map_racing")
        if ours and message.split(":")[0] in _MODES:
            return message
    return None


def _on_clock(texts, recording):
    """Texts with times of receipt [ns] brought to the recording's clock [s]."""
    received = np.array([at for at, _ in texts], dtype=np.int64)
    times = received
    if recording.clock is not None:
        times = recording.clock.times(received, received, [], "")
    return [(1e-9 * float(t - recording.t0_ns), text) for t, (_, text) in zip(times, texts)]
