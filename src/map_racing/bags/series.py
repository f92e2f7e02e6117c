"""Messages of a bag decoded into columns over time."""

from __future__ import annotations

from typing import Callable

import numpy as np

from .bag import Batch, Connection
from .clocks import LATENCY_NS, Clock, coarse_note, mended
from .messages import SHORTEST_QUATERNION, UNIT_QUATERNION, decode_frame
from .samples import in_order, is_map_frame, is_odometry_frame, jump_back, usable

__all__ = ["FrameChoice", "PoseSeries", "Series", "commands_of_two", "followed", "quaternion_note"]

_BATCH, _NONE = 2048, np.zeros(0, dtype=np.int64)
# Commands come from two nodes if, in a block of this many, a larger share than the first number
# differs from both neighbors by more than the second [rad, m/s]. With noisy poses, a single node
# has a share of up to 0.12 for angles and 0.01 for speeds.
_BLOCK, _ANGLE, _SPEED = 200, (0.2, 0.05), (0.03, 0.1)
# The neighbors must agree within this share of the difference, which must be this many times this
# percentile.
_AGREE, _MANY, _MOST = 0.2, 5.0, 30.0
# Or if at least this many differ from agreeing neighbors by more [rad, m/s] than those of a single
# node.
_FEW, _FAR_ANGLE, _FAR_SPEED = 5, 0.2, 1.0
# After this long without a message [ns] a node or frame is gone, and another may replace it.
_SENDER_GONE = 10**9


class _Senders:
    """Picks the first of several nodes that publish on one topic, for as long as it publishes."""

    def __init__(self, names):
        self._names = names
        self._sender, self._heard = None, -_SENDER_GONE
        self._left_out, self._followed = {}, []

    def counts(self, message):
        """Whether a message comes from the node that counts."""
        sender = self._names[message.connection]
        if sender != self._sender:
            pair = sender, self._sender
            if message.time_ns - self._heard < _SENDER_GONE:
                self._left_out[pair] = self._left_out.get(pair, 0) + 1
                return False
            if self._sender is not None:
                self._followed.append(pair)
            self._sender = sender
        self._heard = message.time_ns
        return True

    def say(self, notes, topic):
        """Note which senders were left out, and which replaced another."""
        for (sender, first), count in self._left_out.items():
            notes.append(
                f"warning: {topic}: {count} messages of a second sender, {sender}, left out: "
                f"only the first, {first}, counts"
            )
        for sender, before in self._followed:
            notes.append(f"warning: {topic}: {before} fell silent, and {sender} took its place")


class FrameChoice:
    """Picks the frame whose poses count on a topic, live and from bags alike.

    It is the first one. Once that is gone, a frame nearer to the map replaces it, as when
    localization starts after wheel odometry; earlier poses are then dropped.

    Attributes
    ----------
    frame : str or None
        The frame that counts, ``map`` if it has no name; None before the first pose.
    """

    def __init__(self):
        self.frame, self._heard = None, 0

    def counts(self, frame: str, at_ns: int) -> bool:
        """Whether a pose in a frame at a time [ns] counts; if so, `frame` becomes its frame."""
        frame = frame or "map"
        if frame != self.frame and self.frame is not None:
            gone = at_ns - self._heard >= _SENDER_GONE
            if not gone or _from_map(frame) >= _from_map(self.frame):
                return False
        self.frame, self._heard = frame, at_ns
        return True


def followed(lost: str, before: str, frame: str, early: int = 0) -> str:
    """Warning that a frame replaced another.

    Parameters
    ----------
    lost : str
        What is lost in the previous frame, such as ``"12 messages"``.
    before, frame : str
    early : int, optional
        Number in the new frame that came before the other was gone, and are lost as well.
    """
    also = f" and {early} in {frame}" if early else ""
    return (
        f"{lost} in frame {before}{also} left out: {before} fell silent, and {frame} took its place"
    )


def _from_map(frame):
    return 0 if is_map_frame(frame) else 2 if is_odometry_frame(frame) else 1


class Series:
    """Messages of one topic, decoded in batches, so that an hour at 100 Hz takes 26 MB.

    Parameters
    ----------
    decode : callable
        A decoder of `map_racing.bags.messages`.
    coordinates : int, optional
        The first columns that are required coordinates, see `in_order`.
    connections : dict of int to Connection, optional
        By number; only messages of the first sender count, as long as it sends.
    delay_ns : int, optional
        See `map_racing.bags.clocks.Clock.times`.
    """

    def __init__(
        self,
        decode: Callable,
        coordinates: int = 0,
        connections: dict[int, Connection] | None = None,
        delay_ns: int = LATENCY_NS,
    ):
        self._decode, self._coordinates, self._delay_ns = decode, coordinates, delay_ns
        names = {n: c.sender or f"connection {n}" for n, c in (connections or {}).items()}
        self._senders = _Senders(names) if len(set(names.values())) > 1 else None
        self._data, self._received, self._waiting = [], [_NONE], 0
        self._stamps, self._times, self._values = [], [], []
        self._broken, self._whole = 0, None

    def extend(self, batch: Batch) -> None:
        """Add messages."""
        if self._senders is not None:
            batch = batch.only(np.array([self._senders.counts(m) for m in batch], dtype=bool))
        self._data.append(batch.contents())
        self._received.append(batch.times)
        self._waiting += len(batch)
        if self._waiting >= _BATCH:
            self._flush()

    def _flush(self):
        if not self._waiting and self._stamps:
            return
        data, received = self._counted(_together(self._data), np.concatenate(self._received))
        stamps, values, good = self._decode(data)
        self._broken += np.count_nonzero(~good)
        self._stamps.append(stamps[good])
        self._times.append(received[good])
        self._values.append(values[good])
        self._data, self._received, self._waiting, self._whole = [], [_NONE], 0, None

    def _counted(self, data, received):
        """Those of the messages that count, and their times of receipt."""
        return data, received

    @property
    def size(self) -> int:
        """Number of messages."""
        return self._waiting + sum(times.size for times in self._times)

    def jump_back(self, received: bool = False) -> float | None:
        """How far the stamps or times of receipt fall back [s]; None if they do not.

        Samples that `columns` leaves out do not count.
        """
        stamps, times = self.stamps()
        found = jump_back(times if received else stamps, 10**9)
        return found and found[1]

    def stamps(self) -> tuple[np.ndarray, np.ndarray]:
        """Stamps (corrected by times of receipt) and times of receipt of usable samples.

        Repeated messages are left out.

        Returns
        -------
        stamps, received : ndarray of int, shape (n,)
            [ns]
        """
        self._all()
        return self._whole[-1]

    def _all(self, topic="", notes=None):
        """Corrected stamps, times of receipt and values; corrections go to the notes."""
        self._flush()
        parts = self._stamps, self._times, self._values
        if self._whole is None:
            for part in parts:
                part[:] = [np.concatenate(part)]
            self._whole = self._mended(*(part[0] for part in parts))
        (given,), (times,), (values,) = parts
        stamps, coarse, spread, _ = self._whole
        if notes is None:
            return stamps, times, values
        unstamped = np.count_nonzero(given == 0)
        good = f", accurate to {spread:.3f} s" if spread else ""
        if unstamped:
            notes.append(f"{topic}: {unstamped} of {times.size} stamps are 0: receive time{good}")
        if coarse.any():
            notes.append(coarse_note(topic, coarse, spread))
        return stamps, times, values

    def _mended(self, given, times, values):
        """What `mended` gives, and the `stamps`."""
        changed = _changed(values)
        stamps, coarse, spread = mended(given, times, changed)
        keep = usable(stamps, values.T[: self._coordinates])
        keep &= np.append(True, np.diff(stamps) != 0)[: stamps.size] | changed
        return stamps, coarse, spread, (stamps[keep], times[keep])

    def clock(self, use_receipt: bool) -> Clock:
        """Clock of the stamps, or of receipt."""
        stamps, received = self.stamps()
        return Clock(received, received - stamps, use_receipt)

    def columns(
        self, notes: list[str], topic: str, clock: Clock | None = None
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """Samples in strict order of time.

        Parameters
        ----------
        notes : list of str
            Gets a line for each kind of repair.
        topic : str
            Name of the samples in the notes.
        clock : Clock, optional
            Brings the stamps to this clock.

        Returns
        -------
        times : ndarray of int64
            Header stamps or, if they are 0, times of receipt [ns].
        columns : list of ndarray
        """
        by_receipt = clock is not None and clock.use_receipt
        stamps, times, values = self._all(topic, None if by_receipt else notes)
        if self._broken:
            notes.append(f"{topic}: {self._broken} messages that do not match their type left out")
        if clock is not None:
            stamps = clock.times(stamps, times, notes, topic, self._delay_ns)
        if self._senders is not None:
            self._senders.say(notes, topic)
        columns = [np.ascontiguousarray(column) for column in values.T]
        return in_order(stamps, columns, notes, topic, self._coordinates)


class PoseSeries(Series):
    """Poses of one topic, from its first sender as long as it sends, and in one frame.

    Parameters
    ----------
    decode : callable
        Decoder of a pose whose first columns are ``x y psi q``, see `messages.decode_odometry`.
    connections : dict of int to Connection
        By number.
    """

    def __init__(self, decode: Callable, connections: dict[int, Connection]):
        super().__init__(decode, coordinates=2, connections=connections)
        self._choice, self._encoded = FrameChoice(), None
        self._elsewhere, self._before = {}, {}

    @property
    def frame(self) -> str | None:
        """The frame in which poses count."""
        self._flush()
        return self._choice.frame

    def _counted(self, data, received):
        if not len(data):
            return data, received
        if self._encoded is None:
            self._encoded = _frame_bytes(bytes(data[0]))
        size = 12 + len(self._encoded)
        same = isinstance(data, np.ndarray) and data.shape[1] >= size
        if same and np.all(data[:, 12:size] == np.frombuffer(self._encoded, np.uint8)):
            at = _time(bytes(data[-1]), int(received[-1]))
            self._choice.counts(_name(self._encoded), at)
            return data, received
        return self._choose([bytes(message) for message in data], received)

    def _choose(self, messages, received):
        """Keep messages in the frame that counts; truncated ones are left to the decoder."""
        kept = []
        for index, (data, at) in enumerate(zip(messages, received.tolist())):
            encoded, before = _frame_bytes(data), self._choice.frame
            name = _name(encoded)
            if not self._choice.counts(name, _time(data, at)):
                self._elsewhere[name] = self._elsewhere.get(name, 0) + 1
                continue
            if before not in (None, self._choice.frame):
                count = len(kept) + sum(times.size for times in self._times)
                early = self._elsewhere.pop(self._choice.frame, 0)
                self._before[before] = followed(
                    f"{count} messages", before, self._choice.frame, early
                )
                self._stamps, self._times, self._values, kept = [], [], [], []
                self._broken = 0
            self._encoded = encoded
            kept.append(index)
        return [messages[index] for index in kept], received[kept]

    def way(self, received: bool = False) -> float:
        """Length of the path through the poses in the order of stamps or times of receipt [m]."""
        stamps, times, values = self._all()
        values = values[np.argsort(times if received else stamps, kind="mergesort")]
        values = values[usable(np.zeros(len(values)), values.T[:2])]
        return float(np.sum(np.hypot(*np.diff(values[:, :2], axis=0).T)))

    def columns(self, notes, topic, clock=None):
        """Samples in strict order of time, as `Series.columns`: ``x y psi v_x v_y yaw_rate``."""
        # Whatever the receipts are, the poses' own stamps are on the poses' clock.
        used = clock if clock is not None and clock.use_receipt else None
        times, columns = super().columns(notes, topic, used)
        quaternion_note(notes, topic, columns.pop(3))
        frame = self._choice.frame
        notes += [f"warning: {topic}: {said}" for said in self._before.values()]
        for other, count in self._elsewhere.items():
            notes.append(
                f"warning: {topic}: {count} messages in another frame, {other}, left out: only "
                f"{frame} counts"
            )
        return times, columns


def _together(parts):
    """Contents of batches as those of one."""
    rows = [part for part in parts if isinstance(part, np.ndarray)]
    if len(rows) == len(parts) and len({part.shape[1] for part in rows}) == 1:
        return np.concatenate(rows)
    return [bytes(message) for part in parts for message in part]


def _changed(values):
    """Which messages differ from the one before."""
    same = (values[1:] == values[:-1]) | np.isnan(values[1:])
    return np.append(True, ~np.all(same, axis=1))[: len(values)]


def _time(data, received):
    """Stamp of a message, or else its time of receipt [ns], as in the nodes."""
    seconds, rest = (int.from_bytes(data[at : at + 4], "little") for at in (4, 8))
    return seconds * 10**9 + rest or received


def _name(encoded):
    """Name of a frame as in a message."""
    return decode_frame(encoded[4:]) or "map"


def _frame_bytes(data):
    """Length and name of the frame of a message."""
    return bytes(data[12 : 16 + int.from_bytes(data[12:16], "little")])


def quaternion_note(notes: list[str], topic: str, lengths: np.ndarray) -> None:
    """Note quaternions whose length is not 1.

    Parameters
    ----------
    notes : list of str
        Gets a line if there are any.
    topic : str
    lengths : ndarray, shape (n,)
        [-]
    """
    low, high = UNIT_QUATERNION
    with np.errstate(invalid="ignore"):
        other = lengths[~((lengths > low) & (lengths < high))]
        headed = np.all(other > SHORTEST_QUATERNION)
    if other.size:
        notes.append(
            f"{topic}: {other.size} of {lengths.size} quaternions do not have length 1 but "
            f"{np.median(other):.3g}: normalized"
            + ("" if headed else ", no heading from those of length 0")
        )


def commands_of_two(topic: str, angle: np.ndarray, speed: np.ndarray) -> str:
    """Warning of commands that alternate, as from two unnamed nodes; otherwise empty.

    Parameters
    ----------
    topic : str
    angle, speed : ndarray, shape (k,)
        Steering angles [rad] and speeds [m/s], in the order of time.
    """
    of_angles, of_speeds = (
        _alternating_share(angle, _ANGLE[1]),
        _alternating_share(speed, _SPEED[1]),
    )
    count = max(_far_off(angle, _FAR_ANGLE), _far_off(speed, _FAR_SPEED))
    if of_angles > _ANGLE[0] or of_speeds > _SPEED[0]:
        many = f"up to {max(of_angles, of_speeds):.0%}"
    elif count >= _FEW:
        many = f"{count}"
    else:
        return ""
    return (
        f"{topic}: {many} of the commands differ from those before and after, which agree: from "
        "two nodes? All of them count"
    )


def _far_off(values, least):
    """Number of values that differ by more than `least` from both neighbors, which agree."""
    steps = np.abs(np.diff(values))
    away, across = np.minimum(steps[1:], steps[:-1]), np.abs(values[2:] - values[:-2])
    with np.errstate(invalid="ignore"):
        return int(np.count_nonzero((away > least) & (across < 0.5 * _AGREE * away)))


def _alternating_share(values, least):
    """Largest share in any block of values that differ from both neighbors."""
    if values.size < _BLOCK:
        return 0.0
    steps = np.abs(np.diff(values))
    away, across = np.minimum(steps[1:], steps[:-1]), np.abs(values[2:] - values[:-2])
    length, longer = divmod(away.size, away.size // _BLOCK or 1)
    most, begin = 0.0, longer * (length + 1)
    for part, size in ((slice(begin), length + 1), (slice(begin, None), length)):
        one, other = away[part].reshape(-1, size), across[part].reshape(-1, size)
        with np.errstate(invalid="ignore"):
            some = np.any((one > least) & (other < _AGREE * one), axis=1)
        # The percentile is the slowest part, and rarely needed.
        some &= np.isfinite(one).all(axis=1)
        one, other = one[some], other[some]
        if one.size:
            usual = np.percentile(other, _MOST, axis=1)[:, None]
            leaves = (one > np.maximum(least, _MANY * usual)) & (other < _AGREE * one)
            most = max(most, float(np.max(np.mean(leaves, axis=1))))
    return most
