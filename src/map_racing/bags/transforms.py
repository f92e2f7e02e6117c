"""Poses from the tf transforms in a bag."""

from __future__ import annotations

import struct
from array import array
from itertools import combinations
from typing import NamedTuple

import numpy as np

from ..angles import wrap
from ..transforms import TransformTree
from .bag import Bag
from .clocks import Clock, coarse_note, mended
from .messages import MD5, TF, decode_transforms
from .samples import in_order, jump_back, usable
from .series import PoseSeries, quaternion_note

__all__ = ["ComposedPoses", "FramePoses", "MountedPoses", "RecordedTransforms"]

# Localization may stamp its transforms up to a second ahead, so that they hold until the next.
_EARLIEST_NS, _LATEST_NS = 3 * 10**8, -15 * 10**8
# A link that ends earlier than the others by more than this [ns] is noted.
_ENDED_NS = 5 * 10**8
# A localization has died if, after this many corrections, it sends the same one for this long [ns],
# this many times as long as ever before, while the car drives this far [m].
_CORRECTED, _SAME_NS, _LONGER, _DRIVEN = 20, 3 * 10**9, 10, 5.0


class _Samples:
    """Recorded poses of a frame in its parent frame."""

    def __init__(self):
        self.stamps, self.times, self.values = array("q"), array("q"), array("d")
        # First and last time of receipt of each sender [ns].
        self.senders: dict[str, tuple[int, int]] = {}

    def at_once(self):
        """Names of senders that sent at the same time."""
        spans = sorted((span, name) for name, span in self.senders.items())
        pairs = ((one, other) for one, other in combinations(spans, 2) if other[0][0] < one[0][1])
        return sorted({name for pair in pairs for _, name in pair})

    def columns(self, notes=None, what=""):
        """Corrected stamps, times of receipt, and columns ``x y psi q``."""
        stamps, times = (np.array(part, dtype=np.int64) for part in (self.stamps, self.times))
        values = np.array(self.values).reshape(-1, 4)
        changed = np.append(True, np.any(values[1:] != values[:-1], axis=1))[: times.size]
        stamps, coarse, spread = mended(stamps, times, changed)
        if notes is not None and coarse.any():
            notes.append(coarse_note(what, coarse, spread))
        return stamps, times, list(values.T)

    def good(self):
        """Stamps and times of receipt of finite poses."""
        stamps, times, columns = self.columns()
        keep = usable(stamps, columns[:3])
        return stamps[keep], times[keep]


class RecordedTransforms:
    """Transforms of a bag.

    Parameters
    ----------
    bag : Bag
    """

    def __init__(self, bag: Bag):
        static = {
            number: connection.topic.endswith("/tf_static")
            for number, connection in bag.connections.items()
            if connection.md5sum == MD5[TF]
        }
        # By parent, child, and whether it is static.
        self._samples: dict[tuple[str, str, bool], _Samples] = {}
        self._broken = 0
        for message in bag.messages(set(static)) if static else ():
            try:
                for transform in decode_transforms(message.data):
                    key = transform.parent, transform.child, static[message.connection]
                    samples = self._samples.get(key)
                    if samples is None:
                        samples = self._samples[key] = _Samples()
                    samples.stamps.append(transform.stamp_ns or message.time_ns)
                    samples.times.append(message.time_ns)
                    sender = bag.connections[message.connection].sender
                    begun, _ = samples.senders.get(sender, (message.time_ns, 0))
                    samples.senders[sender] = begun, message.time_ns
                    samples.values.extend(transform[3:])
            except struct.error:
                self._broken += 1
        # Frames are connected even where all their poses are unusable.
        self._frames = TransformTree()
        for parent, child, is_static in self._samples:
            self._frames.extend(parent, child, [0], [(0.0, 0.0, 0.0)], is_static)

    @property
    def frames(self) -> list[str]:
        """Names of all frames that have a parent."""
        children = [child for _, child, _ in self._samples]
        parents = [parent for parent, _, _ in self._samples if _is_base(parent)]
        return list(dict.fromkeys(children + parents))

    def root(self, frame: str) -> str:
        """``map`` if it is connected with a frame, otherwise the root of the tree above it."""
        if self.connected("map", frame):
            return "map"
        parents = {child: parent for parent, child, _ in reversed(list(self._samples))}
        passed = {frame}
        while frame in parents and parents[frame] not in passed:
            frame = parents[frame]
            passed.add(frame)
        return frame

    def mount(self, child: str) -> tuple[float, float, float] | tuple[()]:
        """Static pose ``(x, y, psi)`` of a frame on the car; empty if there is none."""
        for base in self.frames:
            if not _is_base(base) or not self.connected(base, child):
                continue
            if (base, child, True) not in self._samples and self.links(base, child):
                continue
            found = self.tree(base, child, [], "", False).lookup(base, child)
            if found is not None:
                return found[1:]
        return ()

    def frozen(self, parent: str, child: str, received: bool) -> list[tuple[tuple, int, int]]:
        """Links between two frames that stop changing after they had been corrected.

        Returns
        -------
        list of ((str, str), int, int)
            Parent and child; times of the last correction and of the last repetition of it [ns].
        """
        links = self.links(parent, child)
        offsets = {} if received else _offsets(links)
        found = []
        for name in links:
            stamps, times, columns = self._samples[(*name, False)].columns()
            own = times if received else stamps + offsets.get(name, 0)
            changed = np.flatnonzero(np.any(np.diff(columns[:3], axis=1) != 0.0, axis=0)) + 1
            if changed.size < _CORRECTED:
                continue
            bounds = np.append(own[changed], own[-1])
            spans = np.diff(bounds)
            longest = int(np.argmax(spans))
            usual = np.max(np.delete(spans, longest))
            if spans[longest] > max(_SAME_NS, _LONGER * usual):
                found.append((name, int(bounds[longest]), int(bounds[longest + 1])))
        return found

    def connected(self, parent: str, child: str) -> bool:
        """Whether transforms connect two frames."""
        return parent != child and bool(self._frames.paths(parent, child))

    def links(self, parent: str, child: str) -> dict:
        """Moving links between two frames: names to stamps and times of receipt [ns]."""
        names = {step.name for path in self._frames.paths(parent, child) for step in path}
        found = {}
        for name in sorted(names):
            samples = self._samples.get((*name, False))
            if samples is not None:
                found[name] = samples.good()
        return found

    def jump_back(self, parent: str, child: str, received: bool = False) -> float | None:
        """How far the times between two frames fall back [s]; None if they do not."""
        for name, (stamps, times) in self.links(parent, child).items():
            _, _, columns = self._samples[(*name, False)].columns()
            moving = any(np.ptp(c) > 0.0 for c in columns[:3] if c.size and np.isfinite(c).all())
            found = jump_back(times if received else stamps, 10**9)
            # The stamp of a constant transform has no meaning.
            if found and moving:
                return found[1]
        return None

    def tree(
        self, parent: str, child: str, notes: list[str], topic: str, received: bool
    ) -> TransformTree:
        """Transforms between two frames on one clock.

        Parameters
        ----------
        parent, child : str
        notes : list of str
            Gets a line for each kind of repair.
        topic : str
            Name of the poses in the notes.
        received : bool
            Use times of receipt instead of stamps.

        Returns
        -------
        TransformTree
        """
        if self._broken:
            notes.append(f"{topic}: {self._broken} messages that do not match their type left out")
        offsets = {} if received else _offsets(self.links(parent, child))
        lengths = []
        tree = TransformTree()
        names = {step.name for path in self._frames.paths(parent, child) for step in path}
        for key in self._samples:
            above, below, static = key
            if (above, below) not in names:
                continue
            what = f"{topic}: {above} to {below}"
            stamps, times, columns = self._samples[key].columns(notes, what)
            offset = offsets.get((above, below), 0) if not static else 0
            if offset:
                notes.append(
                    f"warning: {what}: the stamps are from another clock, by "
                    f"{abs(offset) * 1e-9:.6g} s: brought to the others by the times of receipt"
                )
            senders = [] if static else self._samples[key].at_once()
            if senders:
                notes.append(
                    f"warning: {what}: sent by {len(senders)} nodes at once, {', '.join(senders)}: "
                    "all of them count"
                )
            if static and (above, below, False) in self._samples:
                notes.append(f"{what}: static, and sent by a localization, which counts")
            if static and any(np.ptp(column) > 1e-6 for column in columns[:3]):
                notes.append(f"warning: {what}: static, and sent with other values: the last count")
            own = times if received else stamps + offset
            stamps = np.arange(stamps.size) if static else own
            stamps, columns = in_order(stamps, columns, notes, what, required=3)
            lengths.append(columns[3])
            poses = list(zip(*(column.tolist() for column in columns[:3])))
            tree.extend(above, below, stamps.tolist(), poses, static)
        quaternion_note(notes, topic, np.concatenate(lengths) if lengths else np.zeros(0))
        return tree

    def clock(self, parent: str, child: str, received: bool) -> Clock:
        """Clock of the most frequent link between two frames; empty if all are static."""
        links = self.links(parent, child)
        if not links:
            nothing = np.zeros(0, dtype=np.int64)
            return Clock(nothing, nothing, received)
        offsets = _offsets(links)
        name = max(links, key=lambda name: links[name][0].size)
        stamps, times = links[name]
        return Clock(times, times - stamps - offsets.get(name, 0), received)


def _offsets(links: dict) -> dict:
    """Corrections [ns] of stamps for links on another clock."""
    lags = {name: int(np.median(at - stamps)) for name, (stamps, at) in links.items() if at.size}
    if len(lags) < 2:
        return {}
    sizes = {name: at.size for name, (_, at) in links.items()}
    sound = [name for name, lag in lags.items() if _LATEST_NS < lag < _EARLIEST_NS]
    first = max(sound or lags, key=lambda name: sizes[name])
    apart = {name: lag - lags[first] for name, lag in lags.items()}
    return {
        name: offset
        for name, offset in apart.items()
        if not _LATEST_NS < offset < _EARLIEST_NS and name != first
    }


def _is_base(frame):
    return frame.rpartition("/")[2] == "base_link"


class FramePoses(NamedTuple):
    """Poses of a frame, with the methods of a `Series` of poses."""

    transforms: RecordedTransforms
    frame: str

    @property
    def root(self) -> str:
        """Frame that the poses are in."""
        return self.transforms.root(self.frame)

    def jump_back(self, received: bool = False) -> float | None:
        """How far the times fall back [s]; None if they do not."""
        return self.transforms.jump_back(self.root, self.frame, received)

    def stamps(self) -> tuple[np.ndarray, np.ndarray]:
        """As `Series.stamps`, for the most frequent link."""
        links = self.transforms.links(self.root, self.frame)
        return max(links.values(), key=lambda link: link[0].size)

    def clock(self, use_receipt: bool) -> Clock:
        """Clock of the poses."""
        return self.transforms.clock(self.root, self.frame, use_receipt)

    def columns(
        self, notes: list[str], topic: str, clock: Clock
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """As `map_racing.bags.series.Series.columns`: ``x y psi``, and velocities that are NaN."""
        tree = self.transforms.tree(self.root, self.frame, notes, topic, clock.use_receipt)
        times, poses, used = tree.history(self.root, self.frame)
        if len(used) > 1:
            ways = (" to ".join(_frames(path, self.frame)) for path in used)
            notes.append(f"warning: {topic}: poses come from several chains: {', '.join(ways)}")
        times = np.array(times, dtype=np.int64)
        _say_ends(self.transforms, self.root, self.frame, times, notes, topic, clock)
        x, y, psi = np.array(poses, dtype=float).reshape(-1, 3).T
        found = self.transforms.frozen(self.root, self.frame, clock.use_receipt)
        _say_frozen(found, times, x, y, notes, topic)
        nan = np.full(times.size, np.nan)
        return in_order(times, [x, y, wrap(psi), nan, nan, nan], notes, topic, required=2)


def _frames(path, frame):
    """Names of the frames along a path."""
    yield frame
    for step in path:
        yield step.name[1] if step.down else step.name[0]


def _say_ends(transforms, root, frame, times, notes, topic, clock):
    """Note which link ended before the others, so that there is no pose."""
    links = transforms.links(root, frame)
    offsets = {} if clock.use_receipt else _offsets(links)
    for name, (stamps, received) in links.items():
        if not stamps.size:
            continue
        own = received if clock.use_receipt else stamps + offsets.get(name, 0)
        rest = [
            (at if clock.use_receipt else other + offsets.get(key, 0)).max()
            for key, (other, at) in links.items()
            if key != name and other.size
        ]
        over = max(rest, default=own.max()) - own.max()
        if over > _ENDED_NS and times.size and times[-1] <= own.max():
            notes.append(
                f"warning: {topic}: {name[0]} to {name[1]} ends {over * 1e-9:.1f} s before the "
                "others: no pose after it"
            )


def _say_frozen(frozen, times, x, y, notes, topic):
    """Note where a localization repeats the same correction while the car drives."""
    for name, begin, end in frozen:
        inside = (times >= begin) & (times <= end)
        way = float(np.sum(np.hypot(np.diff(x[inside]), np.diff(y[inside]))))
        if way > _DRIVEN:
            at, until = ((bound - times[0]) * 1e-9 for bound in (begin, end))
            notes.append(
                f"warning: {topic}: {name[0]} to {name[1]} stays the same from {at:.1f} to "
                f"{until:.1f} s, while the car drove {way:.0f} m: localization lost?"
            )


class _PlacedPoses:
    """Poses that are transformed when they are read."""

    def __init__(self, poses):
        self._poses = poses
        self.extend, self.jump_back = poses.extend, poses.jump_back
        self.stamps, self.clock, self.way = poses.stamps, poses.clock, poses.way

    @property
    def size(self) -> int:
        """Number of poses."""
        return self._poses.size

    @property
    def frame(self) -> str | None:
        """The frame in which poses count."""
        return self._poses.frame


class MountedPoses(_PlacedPoses):
    """Poses of the car from those of a sensor and its mount, as a `PoseSeries`.

    Parameters
    ----------
    poses : PoseSeries or ComposedPoses
    mount : (float, float, float)
        Pose of the sensor on the car [m, rad].
    """

    def __init__(self, poses: PoseSeries | ComposedPoses, mount: tuple[float, float, float]):
        super().__init__(poses)
        self._mount = mount

    def columns(
        self, notes: list[str], topic: str, clock: Clock
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """As `map_racing.bags.series.Series.columns`: ``x y psi v_x v_y yaw_rate``."""
        times, (x, y, psi, *rest) = self._poses.columns(notes, topic, clock)
        ahead, left, turn = self._mount
        psi = wrap(psi - turn)
        cos, sin = np.cos(psi), np.sin(psi)
        known = np.isfinite(psi)
        x = np.where(known, x - cos * ahead + sin * left, x)
        y = np.where(known, y - sin * ahead - cos * left, y)
        return times, [x, y, psi, *rest]


class ComposedPoses(_PlacedPoses):
    """Odometry in its own frame, brought into the map by transforms, as a `PoseSeries`.

    Parameters
    ----------
    poses : PoseSeries
    frame, child : str
        Frames of the odometry.
    transforms : RecordedTransforms
    """

    def __init__(self, poses: PoseSeries, frame: str, child: str, transforms: RecordedTransforms):
        super().__init__(poses)
        self._frame, self._child, self._transforms = frame, child, transforms

    @property
    def frame(self) -> str | None:
        """The frame in which poses count."""
        return "map" if self._poses.frame == self._frame else self._poses.frame

    def columns(
        self, notes: list[str], topic: str, clock: Clock
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        """As `map_racing.bags.series.Series.columns`, in the map: ``x y psi v_x v_y yaw_rate``."""
        times, columns = self._poses.columns(notes, topic, clock)
        if not times.size or self._poses.frame != self._frame:
            return times, columns
        start = self._frame if self._transforms.connected("map", self._frame) else self._child
        tree = self._transforms.tree("map", start, notes, topic, clock.use_receipt)
        shift = _shift_to(clock, self._transforms.clock("map", start, clock.use_receipt))
        x, y, psi = columns[:3]
        own = list(zip(x.tolist(), y.tolist(), psi.tolist()))
        stamps = (times + shift).tolist()
        tree.extend(self._frame, self._child, stamps, own)
        found = [tree.lookup("map", self._child, stamp) for stamp in stamps]
        keep = np.array([pose is not None for pose in found], dtype=bool)
        if not keep.all():
            # The last pose is usually newer than the last transform.
            missing = np.count_nonzero(~keep)
            doubt = "" if missing < 0.01 * keep.size else "warning: "
            notes.append(
                f"{doubt}{topic}: {missing} of {keep.size} poses left out, at whose times no "
                f"transform from {self._frame} to map is known"
            )
        placed = np.array([pose[1:] for pose in found if pose is not None]).reshape(-1, 3).T
        found = self._transforms.frozen("map", start, clock.use_receipt)
        _say_frozen(found, times[keep] + shift, *placed[:2], notes, topic)
        rest = [column[keep] for column in columns[3:]]
        return times[keep], [placed[0], placed[1], wrap(placed[2]), *rest]


def _shift_to(clock, other):
    """Shift [ns] from one clock to another, if they do not agree."""
    if clock.use_receipt or not (clock.lag.size and other.lag.size):
        return 0
    apart = int(np.median(clock.lag) - np.median(other.lag))
    return 0 if _LATEST_NS < -apart < _EARLIEST_NS else apart
