"""The part of tf that a car in the plane needs: poses of frames in each other over time.

Live and recorded transforms are looked up by the same rules. As in tf, nothing is extrapolated.
Unlike in tf, a frame may have several parents, such as a laser with a static mount and a particle
filter that sends ``map`` to ``laser``, or a car with two localizations; any path that connects two
frames is used, in either direction. Also unlike in tf, long gaps are not interpolated.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import deque
from typing import Iterator, NamedTuple, Sequence

__all__ = ["TransformTree"]

# A transform older than the last by more than this [ns] means that the clock was set back.
_BACKWARDS_NS = 5 * 10**8
# Gaps up to this long [ns], or up to this many periods of a slow sender, are interpolated.
_BRIDGED_NS, _BRIDGED_PERIODS = 25 * 10**7, 3
# Most paths considered between two frames, and most steps of the search for them.
_MOST_PATHS, _MOST_STEPS = 8, 2000


class _Link:
    """Poses of a frame in its parent frame over time; a static one holds at any time."""

    __slots__ = ("poses", "static", "times")

    def __init__(self, static):
        self.static, self.times, self.poses = static, [], []

    def add(self, stamp, pose, kept_ns):
        """Add a pose; true if time was set back and the earlier poses were dropped."""
        times, poses = self.times, self.poses
        back = bool(times) and stamp < times[-1] - _BACKWARDS_NS
        if self.static or back:
            times.clear()
            poses.clear()
        index = bisect_right(times, stamp)
        times.insert(index, stamp)
        poses.insert(index, pose)
        if kept_ns is not None and times[0] < times[-1] - kept_ns:
            gone = bisect_left(times, times[-1] - kept_ns)
            del times[:gone], poses[:gone]
        return back and not self.static

    def bridged(self):
        """Longest gap between two poses that is interpolated [ns]."""
        times = self.times
        if len(times) < 2:
            return _BRIDGED_NS
        return max(_BRIDGED_NS, _BRIDGED_PERIODS * (times[-1] - times[0]) // (len(times) - 1))

    def at(self, stamp):
        """Pose at a time, interpolated between the two around it; None if unknown."""
        if self.static:
            return self.poses[-1]
        times = self.times
        index = bisect_left(times, stamp)
        if index == len(times):
            return None
        if times[index] == stamp:
            return self.poses[index]
        if index == 0:
            return None
        before, after = times[index - 1], times[index]
        if after - before > self.bridged():
            return None
        (x_1, y_1, psi_1), (x_2, y_2, psi_2) = self.poses[index - 1], self.poses[index]
        part = (stamp - before) / (after - before)
        turn = math.remainder(psi_2 - psi_1, math.tau)
        return x_1 + part * (x_2 - x_1), y_1 + part * (y_2 - y_1), psi_1 + part * turn

    def borders(self):
        """Times at both ends of each gap that is not interpolated."""
        times, most = self.times, self.bridged()
        for before, after in zip(times, times[1:]):
            if after - before > most:
                yield before
                yield after


class _Step(NamedTuple):
    """A link on the path between two frames, up to the parent or down to the child."""

    link: _Link
    down: bool
    name: tuple  # parent and child


class TransformTree:
    """Poses of frames in each other over time, in the plane.

    Parameters
    ----------
    kept_ns : int, optional
        How far back the history of a frame is kept [ns]; by default all of it.
    """

    def __init__(self, kept_ns: int | None = None):
        self._kept_ns = kept_ns
        self._links: dict[tuple[str, str], _Link] = {}
        self._frames: set[str] = set()
        self._paths: dict[tuple[str, str], list[list[_Step]]] = {}

    def add(
        self,
        parent: str,
        child: str,
        stamp: int,
        pose: tuple[float, float, float],
        static: bool = False,
    ) -> None:
        """Add the pose ``(x, y, psi)`` of `child` in `parent` at a time [ns].

        A static pose does not replace a moving one between the same frames.
        """
        link = self._link(parent, child, static)
        if link.static == static and link.add(stamp, pose, self._kept_ns):
            # Another parent's poses from before the reset would stay the latest forever.
            for name in [name for name in self._links if name[1] == child]:
                if name[0] != parent and not self._links[name].static:
                    del self._links[name]
                    self._paths.clear()

    def extend(
        self,
        parent: str,
        child: str,
        stamps: Sequence[int],
        poses: Sequence[tuple[float, float, float]],
        static: bool = False,
    ) -> None:
        """Add poses of a frame at increasing times [ns], as `add` does one by one."""
        link = self._link(parent, child, static) if len(stamps) else None
        if link is not None and link.static == static:
            link.times = list(stamps[-1:] if static else stamps)
            link.poses = list(poses[-1:] if static else poses)

    def _link(self, parent, child, static):
        name = parent, child
        link = self._links.get(name)
        if link is None or (link.static and not static):
            link = self._links[name] = _Link(static)
            # Perception may keep adding frames. Keep the known paths unless one may use this frame.
            new = [frame for frame in name if frame not in self._frames]
            if not new or any(frame in ends for frame in new for ends in self._paths):
                self._paths.clear()
            self._frames.update(new)
        return link

    def lookup(
        self, parent: str, child: str, stamp: int | None = None
    ) -> tuple[int, float, float, float] | None:
        """Pose of a frame in another.

        Parameters
        ----------
        parent, child : str
        stamp : int, optional
            Time [ns]; by default the latest at which all transforms in between are known.

        Returns
        -------
        (stamp, x, y, psi) or None
            None if the frames are not connected at that time. If all transforms are static, the
            latest time is 0.
        """
        found = None
        for path in self.paths(parent, child):
            at = stamp
            if stamp is None:
                at = min((s.link.times[-1] for s in path if not s.link.static), default=0)
                if found is not None and at <= found[0]:
                    continue
            pose = _along(path, at)
            if pose is not None:
                found = at, pose[0], pose[1], math.remainder(pose[2], math.tau)
                if stamp is not None:
                    break
        return found

    def history(
        self, parent: str, child: str
    ) -> tuple[list[int], list[tuple[float, float, float]], list[list[_Step]]]:
        """All poses of a frame in another.

        They have the times of the link that is sent most often; other links are interpolated. If
        several paths connect the frames, the one with the most poses is used, and the next ones
        fill its gaps.

        Parameters
        ----------
        parent, child : str

        Returns
        -------
        times : list of int, length n
            Strictly increasing [ns].
        poses : list of (float, float, float), length n
            ``x, y, psi``.
        used : list of list
            Paths that poses came from, the most important first; each step has the names of its
            parent and child.
        """
        runs = [(_run(path), path) for path in self.paths(parent, child)]
        runs = [(run, path) for run, path in runs if run]
        runs.sort(key=lambda run: -len(run[0]))
        if not runs:
            return [], [], []
        found, used = runs[0][0], [runs[0][1]]
        for run, path in runs[1:]:
            times = [stamp for stamp, _ in found]
            more = [entry for entry in run if _in_hole(times, entry[0])]
            if more:
                found = sorted(found + more, key=lambda entry: entry[0])
                used.append(path)
        times, poses = zip(*found)
        return list(times), list(poses), used

    def paths(self, parent: str, child: str) -> list[list[_Step]]:
        """Paths from `child` to `parent`, the shortest first; at most 8."""
        key = parent, child
        if key not in self._paths:
            self._paths[key] = list(self._search(parent, child))
        return self._paths[key]

    def _search(self, parent, child) -> Iterator[list[_Step]]:
        steps = {}
        for name, link in self._links.items():
            steps.setdefault(name[1], []).append((name[0], _Step(link, False, name)))
            steps.setdefault(name[0], []).append((name[1], _Step(link, True, name)))
        waiting, found = deque([(child, [], {child})]), 0
        for _ in range(_MOST_STEPS):
            if not waiting or found == _MOST_PATHS:
                return
            frame, path, passed = waiting.popleft()
            if frame == parent:
                found += 1
                yield path
                continue
            for nearer, step in steps.get(frame, ()):
                ends = nearer != parent and len(steps[nearer]) == 1
                if nearer not in passed and not ends:
                    waiting.append((nearer, [*path, step], passed | {nearer}))


def _along(path, stamp):
    """Pose of a path's first frame in its last one; None if unknown."""
    x = y = psi = 0.0
    for link, down, _ in path:
        pose = link.at(stamp)
        if pose is None:
            return None
        e_x, e_y, e_psi = pose
        cos, sin = math.cos(e_psi), math.sin(e_psi)
        if down:
            x, y = x - e_x, y - e_y
            x, y, psi = cos * x + sin * y, cos * y - sin * x, psi - e_psi
        else:
            x, y, psi = e_x + cos * x - sin * y, e_y + sin * x + cos * y, psi + e_psi
    return x, y, psi


def _run(path):
    """Times and poses along a path."""
    moving = [step.link for step in path if not step.link.static]
    if not moving:
        return []
    often = max(moving, key=lambda link: len(link.times))
    times = set(often.times)
    for link in moving:
        if link is not often:
            times.update(link.borders())
    poses = ((stamp, _along(path, stamp)) for stamp in sorted(times))
    return [(stamp, pose) for stamp, pose in poses if pose is not None]


def _in_hole(times, stamp):
    """Whether a time falls into a gap of other times that is too long to interpolate."""
    index = bisect_left(times, stamp)
    before = times[index - 1] if index else -math.inf
    after = times[index] if index < len(times) else math.inf
    return stamp not in (before, after) and after - before > _BRIDGED_NS
