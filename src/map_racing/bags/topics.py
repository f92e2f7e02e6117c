"""Which topics of a bag hold pose, drive command and IMU."""

from __future__ import annotations

import struct
from contextlib import suppress
from typing import NamedTuple

from ..errors import BagError
from . import messages as msg
from .records import BagFile
from .series import FramePoses, RecordedTransforms

__all__ = ["DRIVE_TOPIC", "choose_source", "drive_connections", "imu_topic"]

DRIVE_TOPIC = "/vesc/high_level/ackermann_cmd_mux/input/nav_1"
"""Where racing stacks publish the drive command."""

POSE_DECODERS = {
    msg.MD5[msg.ODOMETRY]: msg.decode_odometry,
    msg.MD5[msg.POSE]: msg.decode_pose,
    msg.MD5[msg.POSE_COVARIANCE]: msg.decode_pose,
}
_KINDS = {md5: rank for rank, md5 in enumerate(POSE_DECODERS)}
_KNOWN_IMUS = ("/vesc/sensors/imu/raw", "/sensors/imu/raw", "/imu")
_KNOWN_POSES = ("/car_state/odom", "/car_state/pose", "/pf/pose/odom", "/odom")
_KNOWN_DRIVES = (DRIVE_TOPIC, "/drive", "/nav")
_TRUTH = ("ground_truth", "groundtruth", "gt_pose")
# Slower poses [Hz] are goals, initial guesses or rare fixes, not the path of a car.
_SLOWEST_POSE = 5.0


class _Source(NamedTuple):
    """A topic or frame of tf with the pose of the car.

    ``rank`` orders sources, the best first: (doubt, frame, kind, name, -count, topic), where doubt
    is 0 for none, 1 for a source that is chosen only if there is no better one, 2 for a source
    that is used only on demand. ``poses`` is for tf.
    """

    topic: str
    type: str
    md5sum: str
    frame: str
    rank: tuple
    connections: frozenset = frozenset()
    poses: FramePoses | None = None


def choose_source(bag: BagFile, pose_topic: str | None) -> tuple[_Source, list[str]]:
    """The source of the pose, and notes that explain the choice."""
    sources = _topic_sources(bag)
    wanted = None if pose_topic is None else _canonical(pose_topic)
    matching = [source for source in sources if source.topic == wanted]
    certain = sources and sources[0].rank[:2] == (0, 0)
    if (wanted and not matching) or not (wanted or certain):
        sources = sorted(sources + _tf_sources(bag), key=lambda source: source.rank)
        matching = [source for source in sources if source.topic == wanted]
    described = ", ".join(source.topic for source in sources[:12])
    if wanted:
        if not matching:
            offers = f"expected one of {described}" if sources else "the bag has no pose at all"
            raise BagError(f"{bag.path}: no pose on {wanted}: {offers}")
        return matching[0], []
    if not sources or sources[0].rank[0] == 2:
        topics = sorted(
            {f"{c.topic} ({c.type})" for n, c in bag.connections.items() if bag.counts.get(n)}
        )
        listed = ", ".join(topics[:12]) + (", ..." if len(topics) > 12 else "")
        what = f"it has {listed}" if topics else "it has no messages"
        what = "; ".join([what, *bag.notes()])
        on_demand = f"; --pose-topic can take {described}" if sources else ""
        raise BagError(f"{bag.path}: no topic with the pose of a car; {what}{on_demand}")
    best = sources[0]
    others = [source.topic for source in sources[1:] if source.rank[0] < 2]
    note = f"pose: {best.topic} ({best.type} in frame {best.frame or '(unnamed)'})"
    return best, [note + (f", preferred to {', '.join(others)}" if others else "")]


def _canonical(topic):
    """Name of a source in the form of `_Source.topic`."""
    topic = "/" + topic.lstrip("/")
    if topic.startswith("/tf:"):
        frame = topic[4:].lstrip("/")
        return "/tf" if frame == "base_link" else f"/tf:{frame}"
    return topic


def _topic_sources(bag):
    """Topics that carry a pose, best first."""
    groups: dict[tuple, list[int]] = {}
    for number, connection in bag.connections.items():
        if bag.counts.get(number) and connection.md5sum in POSE_DECODERS:
            groups.setdefault((connection.topic, connection.md5sum), []).append(number)
    frames = _first_frames(bag, groups)
    duration = max((bag.end_ns - bag.start_ns) * 1e-9, 1e-9)
    sources = []
    for (topic, md5sum), numbers in groups.items():
        count = sum(bag.counts[number] for number in numbers)
        frame = frames.get((topic, md5sum), "")
        doubt = 2 if "frenet" in topic.lower() else int(count < _SLOWEST_POSE * duration)
        if any(word in topic.lower() for word in _TRUTH):
            doubt = max(doubt, 1)
        rank = (doubt, _frame_rank(frame), _KINDS[md5sum], _name_rank(topic, _KNOWN_POSES))
        kind = bag.connections[numbers[0]].type
        sources.append(
            _Source(topic, kind, md5sum, frame, rank + (-count, topic), frozenset(numbers))
        )
    return sorted(sources, key=lambda source: source.rank)


def _first_frames(bag, groups):
    """Frame of the first message of each group of connections."""
    missing = {number: key for key, numbers in groups.items() for number in numbers}
    frames = {}
    for message in bag.messages(set(missing)) if missing else ():
        key = missing[message.connection]
        if key not in frames:
            with suppress(struct.error):
                frames[key] = msg.decode_header(message.data)[1]
            if len(frames) == len(groups):
                break
    return frames


def _tf_sources(bag):
    """Frames of tf: ``base_link`` is the car, others are used only on demand."""
    md5sum = msg.MD5[msg.TF]
    numbers = {number for number, c in bag.connections.items() if c.md5sum == md5sum}
    tree = RecordedTransforms(bag.messages(numbers)) if numbers else None
    sources = []
    for child in tree.edges if tree else ():
        frame = tree.chain(child)[-1]
        base = child.rpartition("/")[2] == "base_link"
        topic = "/tf" if child == "base_link" else f"/tf:{child}"
        rank = (0 if base else 2, _frame_rank(frame), len(_KINDS), int(child != "base_link"))
        poses = FramePoses(tree, child)
        sources.append(_Source(topic, msg.TF, md5sum, frame, rank + (0, topic), poses=poses))
    return sources


def _frame_rank(frame):
    return 0 if frame == "map" else 2 if frame.rpartition("/")[2] == "odom" else 1


def _name_rank(topic, known):
    return known.index(topic) if topic in known else len(known)


def drive_connections(bag: BagFile) -> tuple[str, set[int]]:
    """Topic of the drive command and its connections; empty without commands."""
    counts: dict[str, int] = {}
    for number, connection in bag.connections.items():
        if connection.md5sum == msg.MD5[msg.ACKERMANN] and bag.counts.get(number):
            counts[connection.topic] = counts.get(connection.topic, 0) + bag.counts[number]
    if not counts:
        return "", set()
    topic = min(counts, key=lambda name: (_name_rank(name, _KNOWN_DRIVES), -counts[name], name))
    md5sum = msg.MD5[msg.ACKERMANN]
    return topic, {
        number
        for number, connection in bag.connections.items()
        if connection.topic == topic and connection.md5sum == md5sum
    }


def imu_topic(bag: BagFile) -> str | None:
    """Topic of the IMU, or None."""
    topics = {
        connection.topic
        for number, connection in bag.connections.items()
        if connection.md5sum == msg.MD5[msg.IMU] and bag.counts.get(number)
    }
    return min(topics, key=lambda name: (_name_rank(name, _KNOWN_IMUS), name), default=None)
