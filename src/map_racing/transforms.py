"""The little of tf that a car in the plane needs: poses of frames in each other over time.

Live and recorded transforms are looked up by the same rules. As in tf, nothing is extrapolated.
Unlike in tf, a frame may have several parents: a particle filter that sends ``map`` to ``laser``
beside the static mount of the laser, or a second localization. Whatever connects two frames counts,
in either direction. Nor is a time without transforms bridged, however long tf would.
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections import deque
from typing import Iterator, NamedTuple, Sequence

__all__ = ["TransformTree"]

# A transform older than the last by more than this [ns] was sent after a clock was set back.
_BACKWARDS_NS = 5 * 10**8
# Shorter times without transforms [ns] are always bridged, of slow senders three of their periods.
_BRIDGED_NS, _BRIDGED_PERIODS = 25 * 10**7, 3
# Ways from one frame to another that are looked at, and frames on the search for them.
_MOST_PATHS, _MOST_STEPS = 8, 2000


class _Link:
    """Poses of a frame in its parent frame over time; a static one holds at any time."""

    __slots__ = ("poses", "static", "times")

    def __init__(self, static):
        self.static, self.times, self.poses = static, [], []

    def add(self, stamp, pose, kept_ns):
        """Add a pose; true if time was set back, so that the earlier ones are gone."""
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
        """Longest time between two poses that is interpolated [ns]."""
        times = self.times
        if len(times) < 2:
            return _BRIDGED_NS
        return max(_BRIDGED_NS, _BRIDGED_PERIODS * (times[-1] - times[0]) // (len(times) - 1))

    def at(self, stamp):
        """Pose at a time, linear between the two around it; None where it is not known."""
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
        """Times around those that are not bridged."""
        times, most = self.times, self.bridged()
        for before, after in zip(times, times[1:]):
            if after - before > most:
                yield before
                yield after


class _Step(NamedTuple):
    """A link on the way from a frame to another, up to the parent or down to the child."""

    link: _Link
    down: bool
    name: tuple  # parent and child


class TransformTree:
    """Poses of frames in each other over time, in the plane.

    Parameters
    ----------
    kept_ns : int, optional
        How far back the history of a frame goes [ns]; without it, all is kept.
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

        A static pose does not replace what a localization sends.
        """
        link = self._link(parent, child, static)
        if link.static == static and link.add(stamp, pose, self._kept_ns):
            # Another parent from before the clock was set back would be the latest forever.
            for name in [n for n, other in self._links.items() if n[1] == child]:
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
            # Perception may name all that it sees anew: a new frame is on no way but its own.
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
            Time [ns]; by default the latest that all transforms in between are known for.

        Returns
        -------
        (stamp, x, y, psi) or None
            None where they are not connected, or not at that time. Where all transforms are
            static the latest time is 0.
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

        They have the times of the link that is sent most often; the others are interpolated. Where
        several ways lead from one frame to the other, the one with the most poses counts, and the
        next where that has none.

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
            Ways that poses came from, the most important first; each step has the names of the
            ``parent`` and ``child``.
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
        """Ways from `child` to `parent`, the shortest first; at most a few."""
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
    """Pose at the end of a path of the frame at its beginning; None where it is not known."""
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
    """Whether a time is where others are missing for longer than is bridged."""
    index = bisect_left(times, stamp)
    before = times[index - 1] if index else -math.inf
    after = times[index] if index < len(times) else math.inf
    return stamp not in (before, after) and after - before > _BRIDGED_NS
