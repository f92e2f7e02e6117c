"""Read recorded driving and further signals from bags."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ..errors import BagError
from . import messages as msg
from .clocks import COMMAND_DELAY_NS, rate_note, stamps_are_unusable
from .opening import Source, open_bag, source_name
from .samples import Beliefs, Commands, Recording, is_map_frame
from .series import Series, commands_of_two
from .tf_poses import FramePoses
from .topics import belief_connections, drive_connections, imu_topic, pose_sources
from .waypoints import WaypointCollection

__all__ = ["read_recording", "read_signals"]

# A pose that moves less than this [m] during the recording stands still.
_STANDS_STILL = 0.2
# One order of the poses is right if the path in it is shorter than in the other by this factor.
_SHORTER = 0.99
# Signals that can be read: decoder, and the names of its last columns.
_SIGNALS = {
    msg.MD5[msg.ODOMETRY]: (msg.decode_odometry, ("v_x", "v_y", "yaw_rate")),
    msg.MD5[msg.IMU]: (msg.decode_imu, ("yaw_rate", "a_x", "a_y", "a_z")),
    msg.MD5[msg.ACKERMANN]: (msg.decode_drive, ("steering", "speed")),
    msg.MD5[msg.FLOAT64]: (msg.decode_float64, ("value",)),
}


def read_recording(source: Source, pose_topic: str | None = None) -> Recording:
    """Read the driving recorded in a ROS 1 or 2 bag, or in several that are parts of one run.

    The pose is taken from Odometry, PoseStamped, PoseWithCovarianceStamped or tf. Without
    `pose_topic` the best source is chosen and the choice explained in the notes: a pose in ``map``
    before one in another frame, wheel odometry (frame ``odom``) last; Odometry, which has the
    velocity, before poses, and poses before tf; ``/car_state/odom`` before other names. Topics of
    ground truth come last, as do topics slower than 5 Hz; Frenet coordinates are never used.

    Times are the header stamps. A stamp of 0 is replaced by the time of receipt. Times of receipt
    are used throughout if the stamps of pose or command fall back by 1 s or more (a clock was set
    back), or if the stamps of the pose jump or are too coarse. From a damaged or unclosed bag all
    intact messages are read, and the notes say how many.

    Parameters
    ----------
    source : str, pathlib.Path or sequence of them
        See `map_racing.bags.opening.open_bag`.
    pose_topic : str, optional
        Topic of the pose. For tf, ``/tf`` (frame ``base_link``) or ``/tf:FRAME``; the transforms
        are chained in the plane up to ``map``, or to the root of the tree.

    Returns
    -------
    Recording

    Raises
    ------
    BagError
        If the file is no bag, has no pose or none on `pose_topic` (the message lists the possible
        topics), or its times of receipt fall back as well, because it holds several runs.

    Notes
    -----
    A recording of 63 s with 52,000 messages takes 0.04 s, an hour of odometry at 100 Hz 1.0 s.
    """
    path = source_name(source)
    with open_bag(source) as bag:
        sources = pose_sources(bag, pose_topic)
        first = _read(path, bag, *next(sources))
        if pose_topic is not None or _moves(first):
            return first
        for candidate, notes in sources:
            with suppress(BagError):
                other = _read(path, bag, candidate, notes)
                if _moves(other):
                    said = f"warning: {first.topic} stands still while {other.topic} moves"
                    return replace(other, notes=[*other.notes, said])
    return first


def _read(path, bag, source, notes):
    """The recording, with the pose from a source."""
    notes = list(notes)
    drive_topic, drives = drive_connections(bag)
    belief_topic, believing = belief_connections(bag)
    senders = {number: bag.connections[number] for number in drives}
    pose = source.series(bag)
    command = Series(msg.decode_drive, connections=senders, delay_ns=COMMAND_DELAY_NS)
    waypoints, believed = WaypointCollection(bag), Series(msg.decode_belief)
    takers = [
        (waypoints, set(waypoints.connections)),
        (believed, set(believing)),
        (command, set(drives)),
        (pose, set(source.connections)),
    ]
    _distribute(bag, [(taker, numbers) for taker, numbers in takers if numbers])
    damage = bag.notes()
    notes += waypoints.notes + [_as_doubt(note) for note in damage]
    clock = pose.clock(_use_receive_time(path, pose, command, notes))
    if not clock.use_receipt:
        note = rate_note(source.topic, *pose.stamps())
        notes += [note] if note else []
    before = len(notes)
    times, columns = pose.columns(notes, source.topic, clock)
    if times.size < 2:
        why = "; ".join([*notes[before:], *damage])
        raise BagError(
            f"{path}: {source.topic}: expected at least two poses, got {times.size}"
            + (f" ({why})" if why else "")
        )
    t0_ns = int(times[0])
    commands = _commands(command, drive_topic, clock, times, notes) if drives else None
    beliefs = _beliefs(believed, belief_topic, clock, t0_ns, notes) if believing else None
    frame = source.frame if source.poses else pose.frame
    first, later = _waypoints(waypoints, frame, clock, t0_ns, notes)
    return Recording(
        (times - t0_ns) * 1e-9,
        *columns,
        t0_ns=t0_ns,
        source=str(path),
        topic=source.topic,
        type=source.type,
        frame=frame,
        commands=commands,
        beliefs=beliefs,
        waypoints=first,
        later_waypoints=later,
        clock=clock,
        notes=notes,
    )


def _distribute(bag, takers):
    """Give each of the takers the messages of its connections."""
    for batch in bag.batches(set().union(*(numbers for _, numbers in takers))):
        for taker, numbers in takers:
            chosen = np.any([batch.numbers == number for number in numbers], axis=0)
            if chosen.any():
                taker.extend(batch.only(chosen))


def _waypoints(collected, pose_frame, clock, t0_ns, notes):
    """The first waypoints, and later ones with their times [s]; warnings go to the notes."""
    first = collected.best()
    if first is None:
        return None, []
    frame = collected.frames[first.topic]
    if not is_map_frame(frame) and frame != pose_frame:
        notes.append(
            f"warning: {first.topic} is in frame {frame}, the poses in {pose_frame or 'map'}: "
            "the lateral errors are right only if both are the same"
        )
    later = collected.later.get(first.topic, [])
    at = np.array([received for received, _ in later], dtype=np.int64)
    at = (clock.times(at, at, [], "") - t0_ns) * 1e-9
    return first, [(float(t), first._replace(columns=c)) for t, (_, c) in zip(at, later)]


def _beliefs(believed, topic, clock, t0_ns, notes):
    """Estimates of the adaptation, on the clock of the poses."""
    at, values = believed.columns(notes, topic, clock)
    return Beliefs((at - t0_ns) * 1e-9, np.stack(values, axis=1))


def _commands(command, topic, clock, times, notes):
    """The commands on the clock of the poses with these times [ns]; warnings go to the notes."""
    at, (angle, speed) = command.columns(notes, topic, clock)
    stamps, received = command.stamps()
    own = clock.times(stamps, received, [], "", COMMAND_DELAY_NS)
    shifted = not clock.use_receipt and stamps is not own
    lag = 1e-9 * float(np.median(received - stamps)) if stamps.size else math.nan
    doubt = commands_of_two(topic, angle, speed)
    notes += [f"warning: {doubt}"] if doubt else []
    if at.size and (at[-1] < times[0] or at[0] > times[-1]):
        when = "before" if at[-1] < times[0] else "after"
        notes.append(f"warning: {topic}: all {at.size} commands are {when} the poses")
    return Commands((at - int(times[0])) * 1e-9, angle, speed, topic, shifted, lag)


def _moves(recording):
    return max(np.ptp(recording.x), np.ptp(recording.y)) > _STANDS_STILL


def _as_doubt(note):
    """A note on the bag, as a warning if messages are missing: then the laps are doubtful."""
    missing = "damaged bag: " in note or "but the index of the bag lists" in note
    return f"warning: {note}" if missing else note


def _use_receive_time(path, pose, command, notes):
    """Whether to use times of receipt, because the stamps of pose or command are unusable."""
    jump = pose.jump_back() or command.jump_back()
    if jump:
        why = f"header stamps jump back by {jump:.1f} s"
    else:
        why = stamps_are_unusable(*pose.stamps())
        if not why:
            return False
    # If a recording was sorted by times of receipt whose clock was set back, only the order of the
    # stamps gives a continuous path.
    of_topic = not isinstance(pose, FramePoses)
    if of_topic and pose.way() < _SHORTER * pose.way(received=True):
        notes.append(f"warning: {why}, but the path is continuous in their order: used")
        return False
    again = pose.jump_back(received=True) or command.jump_back(received=True)
    if again:
        raise BagError(f"{path}: time jumps back by {again:.1f} s: two runs in one bag?")
    notes.append(f"{why}: time of receipt used instead")
    return True


def read_signals(source: Source, recording: Recording, topics: dict[str, str]) -> dict:
    """Read further topics of a bag, on the clock of its recording.

    Parameters
    ----------
    source : str, pathlib.Path or sequence of them
    recording : Recording
        Result of `read_recording` for the same bag.
    topics : dict of str to str
        Names to topics of Odometry, Imu, AckermannDriveStamped or Float64. An empty topic under the
        name ``"imu"`` selects the topic of the IMU, if there is one.

    Returns
    -------
    dict of str to (ndarray, dict)
        Names to times [s] and columns: ``v_x v_y yaw_rate``, ``yaw_rate a_x a_y a_z``,
        ``steering speed``, or ``value``. Without an IMU, an empty topic is left out.

    Raises
    ------
    BagError
        If a topic is not in the bag, has another type, or its time falls back.
    """
    path = source_name(source)
    with open_bag(source) as bag:
        found = {name: topic and "/" + topic.lstrip("/") for name, topic in topics.items()}
        found = {name: topic or imu_topic(bag) for name, topic in found.items()}
        found = {name: topic for name, topic in found.items() if topic is not None}
        signals, takers = {}, []
        for topic in found.values():
            if topic not in signals:
                numbers, decode, columns = _signal_connections(bag, topic)
                # Sensors are stamped when they measure, and are sent at once like commands.
                signals[topic] = Series(decode, delay_ns=COMMAND_DELAY_NS), columns
                takers.append((signals[topic][0], numbers))
        _distribute(bag, takers)
    read = {
        topic: _on_clock(path, recording, topic, series, columns)
        for topic, (series, columns) in signals.items()
    }
    return {name: read[topic] for name, topic in found.items()}


def _signal_connections(bag, topic):
    """Connections of a topic, and decoder and columns of its type."""
    numbers = {n for n, c in bag.connections.items() if c.topic == topic}
    kinds = {bag.connections[n].md5sum for n in numbers}
    if len(kinds) != 1 or not kinds <= set(_SIGNALS):
        there = ", ".join(sorted(bag.connections[n].type for n in numbers))
        known = ", ".join(kind for kind, md5 in msg.MD5.items() if md5 in _SIGNALS)
        raise BagError(
            f"{bag.path}: {topic}: expected messages of {known}; it has {there or 'none'}"
        )
    return (numbers, *_SIGNALS[kinds.pop()])


def _on_clock(path, recording, topic, series, columns):
    """Times on the clock of a recording, and named columns of a series."""
    if not series.size:
        raise BagError(f"{path}: {topic}: expected messages, got none")
    clock = recording.clock
    back = series.jump_back(received=clock is not None and clock.use_receipt)
    if back:
        raise BagError(f"{path}: {topic}: time jumps back by {back:.1f} s")
    times, values = series.columns(recording.notes, topic, clock)
    at = (times - recording.t0_ns) * 1e-9
    return at, dict(zip(columns, values[-len(columns) :]))
