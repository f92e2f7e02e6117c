"""The tf transforms in a bag."""

from __future__ import annotations

import struct
from array import array
from itertools import combinations

import numpy as np

from ..transforms import TransformTree
from .bag import Bag
from .clocks import Clock, coarse_note, mended
from .messages import MD5, TF, decode_transforms
from .samples import in_order, jump_back, usable
from .series import quaternion_note

__all__ = ["RecordedTransforms", "on_one_clock"]

# Localization may stamp its transforms up to a second ahead, so that they hold until the next.
_EARLIEST_NS, _LATEST_NS = 3 * 10**8, -15 * 10**8
# A localization has died if, after this many corrections, it sends the same one for this long [ns],
# this many times as long as ever before, while the car drives.
_CORRECTED, _SAME_NS, _LONGER = 20, 3 * 10**9, 10


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

    def ends(self, parent: str, child: str, received: bool) -> dict:
        """Last times of the moving links between two frames on one clock [ns]."""
        links = self.links(parent, child)
        offsets = {} if received else _offsets(links)
        return {
            name: (times if received else stamps + offsets.get(name, 0)).max()
            for name, (stamps, times) in links.items()
            if times.size
        }

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


def on_one_clock(lag_ns: int) -> bool:
    """Whether stamps that are this much earlier than others may be from the same clock."""
    return _LATEST_NS < lag_ns < _EARLIEST_NS


def _offsets(links: dict) -> dict:
    """Corrections [ns] of stamps for links on another clock."""
    lags = {name: int(np.median(at - stamps)) for name, (stamps, at) in links.items() if at.size}
    if len(lags) < 2:
        return {}
    sizes = {name: at.size for name, (_, at) in links.items()}
    sound = [name for name, lag in lags.items() if on_one_clock(lag)]
    first = max(sound or lags, key=lambda name: sizes[name])
    apart = {name: lag - lags[first] for name, lag in lags.items()}
    return {
        name: offset for name, offset in apart.items() if not on_one_clock(offset) and name != first
    }


def _is_base(frame):
    return frame.rpartition("/")[2] == "base_link"
