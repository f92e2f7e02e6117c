"""Poses from tf transforms: of a frame, of a sensor on the car, of odometry in the map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..angles import wrap
from .clocks import Clock
from .samples import in_order
from .series import PoseSeries
from .transforms import RecordedTransforms, on_one_clock

__all__ = ["ComposedPoses", "FramePoses", "MountedPoses"]

# A link that ends earlier than the others by more than this [ns] is noted.
_ENDED_NS = 5 * 10**8
# A car that drives this far [m] should have been localized meanwhile.
_DRIVEN = 5.0


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
        ends = self.transforms.ends(self.root, self.frame, clock.use_receipt)
        _say_ends(ends, times, notes, topic)
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


def _say_ends(ends, times, notes, topic):
    """Note which link ended before the others, so that there is no pose."""
    for (parent, child), end in ends.items():
        over = max(ends.values()) - end
        if over > _ENDED_NS and times.size and times[-1] <= end:
            notes.append(
                f"warning: {topic}: {parent} to {child} ends {over * 1e-9:.1f} s before the "
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
    return 0 if on_one_clock(-apart) else apart
