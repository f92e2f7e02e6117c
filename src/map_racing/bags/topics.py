"""Which topics of a bag hold pose, drive command and IMU."""

from __future__ import annotations

import struct
from contextlib import suppress
from typing import Iterator, NamedTuple

from ..errors import BagError
from . import messages as msg
from .bag import Bag
from .samples import child_warning, is_odometry_frame
from .series import PoseSeries
from .tf_poses import ComposedPoses, FramePoses, MountedPoses
from .transforms import RecordedTransforms

__all__ = [
    "BELIEF_TOPIC",
    "DIAGNOSTICS_TOPIC",
    "DRIVE_TOPIC",
    "SETTINGS_TOPIC",
    "STATE",
    "PoseSource",
    "belief_connections",
    "drive_connections",
    "imu_topic",
    "pose_sources",
]

DRIVE_TOPIC = "/vesc/high_level/ackermann_cmd_mux/input/nav_1"
"""Topic where racing stacks publish the drive command."""
BELIEF_TOPIC = "/map_racing/belief"
"""Topic of the adaptive controller's estimates."""
SETTINGS_TOPIC = "/map_racing/settings"
"""Topic of the controller's settings, as text."""
DIAGNOSTICS_TOPIC = "/diagnostics"
"""Topic of the nodes' diagnostics."""
STATE = ": state"
"""Suffix to the node's name in the name of the controller's status there."""

POSE_DECODERS = {
    msg.MD5[msg.ODOMETRY]: msg.decode_odometry,
    msg.MD5[msg.POSE]: msg.decode_pose,
    msg.MD5[msg.POSE_COVARIANCE]: msg.decode_pose,
}
_KINDS = {md5: rank for rank, md5 in enumerate(POSE_DECODERS)}
_KNOWN_IMUS = ("/vesc/sensors/imu/raw", "/sensors/imu/raw", "/imu")
_KNOWN_POSES = ("/car_state/odom", "/car_state/pose", "/pf/pose/odom", "/odom")
_KNOWN_DRIVES = (DRIVE_TOPIC, "/drive", "/nav")
# Ground truth, which a car does not know, and poses of something else.
_LAST = ("ground_truth", "groundtruth", "gt_pose")
_LAST += ("goal", "lookahead", "target", "opponent", "opp_", "obstacle")
# Slower poses [Hz] are goals, initial guesses or rare fixes, not the path of the car.
_SLOWEST_POSE = 5.0


class PoseSource(NamedTuple):
    """A topic or frame of tf with the pose of the car.

    ``rank`` orders sources, the best first: (doubt, frame, kind, name, -count, topic), where doubt
    is 0 for none, 1 for a source that is chosen only if there is no better one, 2 for a source
    that is used only on demand. ``poses`` is for tf; ``transforms`` bring poses of the frame
    ``child`` from another frame into the map; if ``child`` is a sensor, ``mount`` is its pose on
    the car.
    """

    topic: str
    type: str
    md5sum: str
    frame: str
    rank: tuple
    connections: frozenset = frozenset()
    poses: FramePoses | None = None
    transforms: RecordedTransforms | None = None
    own_frame: str = ""
    child: str = ""
    mount: tuple = ()

    def series(self, bag: Bag) -> PoseSeries | FramePoses | ComposedPoses | MountedPoses:
        """Object that collects the poses."""
        if self.poses is not None:
            return self.poses
        lines = {number: bag.connections[number] for number in self.connections}
        series = PoseSeries(POSE_DECODERS[self.md5sum], lines)
        if self.transforms is not None:
            series = ComposedPoses(series, self.own_frame, self.child, self.transforms)
        return MountedPoses(series, self.mount) if self.mount else series


def pose_sources(bag: Bag, pose_topic: str | None) -> Iterator[tuple[PoseSource, list[str]]]:
    """Sources of the pose, the best first, each with notes that explain the choice.

    Raises
    ------
    BagError
        If there is none, or none on `pose_topic`.
    """
    sources = _topic_sources(bag)
    wanted = None if pose_topic is None else _canonical(pose_topic)
    matching = [source for source in sources if source.topic == wanted]
    first = matching if wanted else sources
    certain = [s for s in first[:1] if s.frame == "map" and (wanted or s.rank[0] == 0)]
    certain = [s for s in certain if not child_warning(s.topic, s.child)]
    if wanted and certain:
        yield certain[0], []
        return
    if wanted or not certain:
        sources = _with_transforms(bag, sources)
        matching = [source for source in sources if source.topic == wanted]
    described = ", ".join(source.topic for source in sources[:12])
    if wanted:
        if not matching:
            offers = f"expected one of {described}" if sources else "the bag has no pose at all"
            raise BagError(f"{bag.path}: no pose on {wanted}: {offers}")
        yield matching[0], _origin(matching[0])
        return
    if not sources or sources[0].rank[0] == 2:
        topics = sorted(
            {f"{c.topic} ({c.type})" for n, c in bag.connections.items() if bag.counts.get(n)}
        )
        listed = ", ".join(topics[:12]) + (", ..." if len(topics) > 12 else "")
        what = f"it has {listed}" if topics else "it has no messages"
        what = "; ".join([what, *bag.notes()])
        on_demand = f"; --pose-topic can take {described}" if sources else ""
        raise BagError(f"{bag.path}: no topic with the pose of a car; {what}{on_demand}")
    yield sources[0], _described(sources[0], sources)
    if certain:
        sources = _with_transforms(bag, sources)
        sources = certain + [source for source in sources if source.topic != certain[0].topic]
    for source in sources[1:]:
        if source.rank[0] == 0:
            yield source, _described(source, [source])


def _described(source, sources):
    """Notes on a source that was chosen among others."""
    note = f"pose: {source.topic} ({source.type} in frame {source.frame or '(unnamed)'})"
    others = [s.topic for s in sources if s.rank[0] < 2 and s is not source]
    return [note + (f", preferred to {', '.join(others)}" if others else ""), *_origin(source)]


def _origin(source):
    notes = []
    if source.transforms is not None:
        notes.append(f"{source.topic}: from {source.own_frame} into map by the transforms of tf")
    if source.mount:
        notes.append(f"{source.topic}: from {source.child} to base_link by its static mount")
    elif child_warning(source.topic, source.child):
        notes.append(f"warning: {child_warning(source.topic, source.child)}")
    return notes


def _canonical(topic):
    """Name of a source in the form of `PoseSource.topic`."""
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
        frame, child = frames.get((topic, md5sum), ("", ""))
        doubt = 2 if "frenet" in topic.lower() else int(count < _SLOWEST_POSE * duration)
        if any(word in topic.lower() for word in _LAST):
            doubt = max(doubt, 1)
        rank = (doubt, _frame_rank(frame), _KINDS[md5sum], _name_rank(topic, _KNOWN_POSES))
        kind = bag.connections[numbers[0]].type
        sources.append(
            PoseSource(
                topic,
                kind,
                md5sum,
                frame,
                rank + (-count, topic),
                frozenset(numbers),
                child=child,
            )
        )
    return sorted(sources, key=lambda source: source.rank)


def _first_frames(bag, groups):
    """Frame, and frame of the car, of the first message of each group of connections."""
    missing = {number: key for key, numbers in groups.items() for number in numbers}
    frames = {}
    for message in bag.messages(set(missing)) if missing else ():
        key = missing[message.connection]
        if key not in frames:
            with suppress(struct.error):
                frames[key] = msg.decode_frames(message.data, key[1] == msg.MD5[msg.ODOMETRY])
            if len(frames) == len(groups):
                break
    return frames


def _with_transforms(bag, sources):
    """Sources including frames of tf, and poses that tf brings into the map, best first."""
    transforms = RecordedTransforms(bag)
    sources = [_composed(source, transforms) for source in sources]
    return sorted(sources + _tf_sources(transforms), key=lambda source: source.rank)


def _composed(source, transforms):
    """A source in another frame, brought into the map if tf connects them."""
    child = source.child or "base_link"
    if child_warning(source.topic, child):
        source = source._replace(mount=transforms.mount(child))
    if source.frame in ("map", "") or child == source.frame:
        return source
    if not (transforms.connected("map", source.frame) or transforms.connected("map", child)):
        return source
    doubt, _, kind, *rest = source.rank
    return source._replace(
        frame="map",
        # After tf's own pose, which needs no second topic.
        rank=(doubt, 0, len(_KINDS) + 1 + kind, *rest),
        transforms=transforms,
        own_frame=source.frame,
        child=child,
    )


def _tf_sources(transforms):
    """Frames of tf: ``base_link`` is the car, others are used only on demand."""
    sources = []
    for child in transforms.frames:
        poses = FramePoses(transforms, child)
        frame = poses.root
        if not transforms.links(frame, child):
            continue
        base = child.rpartition("/")[2] == "base_link"
        topic = "/tf" if child == "base_link" else f"/tf:{child}"
        rank = (0 if base else 2, _frame_rank(frame), len(_KINDS), int(child != "base_link"))
        md5sum = msg.MD5[msg.TF]
        sources.append(PoseSource(topic, msg.TF, md5sum, frame, rank + (0, topic), poses=poses))
    return sources


def _frame_rank(frame):
    return 0 if frame == "map" else 2 if is_odometry_frame(frame) else 1


def _name_rank(topic, known):
    return known.index(topic) if topic in known else len(known)


def drive_connections(bag: Bag) -> tuple[str, set[int]]:
    """Topic of the drive command and its connections; empty without commands."""
    return _connections(bag, msg.MD5[msg.ACKERMANN], _KNOWN_DRIVES)


def belief_connections(bag: Bag) -> tuple[str, set[int]]:
    """Topic of a controller's estimates and its connections; otherwise empty."""
    return _connections(bag, msg.MD5[msg.BELIEF], (BELIEF_TOPIC,))


def _connections(bag, md5sum, known):
    """The best topic with messages of a type, and its connections."""
    counts: dict[str, int] = {}
    for number, connection in bag.connections.items():
        if connection.md5sum == md5sum and bag.counts.get(number):
            counts[connection.topic] = counts.get(connection.topic, 0) + bag.counts[number]
    if not counts:
        return "", set()
    topic = min(counts, key=lambda name: (_name_rank(name, known), -counts[name], name))
    return topic, {
        number
        for number, connection in bag.connections.items()
        if connection.topic == topic and connection.md5sum == md5sum
    }


def imu_topic(bag: Bag) -> str | None:
    """Topic of the IMU, or None."""
    topics = {
        connection.topic
        for number, connection in bag.connections.items()
        if connection.md5sum == msg.MD5[msg.IMU] and bag.counts.get(number)
    }
    return min(topics, key=lambda name: (_name_rank(name, _KNOWN_IMUS), name), default=None)
