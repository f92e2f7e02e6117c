"""Speed scales by sector of the track."""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from typing import TYPE_CHECKING, Iterable

import numpy as np
from scipy import ndimage

from ..errors import ParameterError
from ..files import read_yaml_mapping, replacing
from ..printing import printable
from ..validation import finite

if TYPE_CHECKING:
    from pathlib import Path

    from ..track.raceline import Raceline

__all__ = [
    "LARGEST_SCALE",
    "SpeedSectors",
    "check_scale",
    "corners_and_straights",
    "load_speed_sectors",
    "save_speed_sectors",
]

LARGEST_SCALE = 2.0
"""Largest scale of a sector and ``speed_scale``; more is a mistake, such as percent."""

# A corner takes more than this share of the lap's largest lateral acceleration; a sector shorter
# than this share of the lap is merged with its neighbors.
_CORNER, _SHORTEST = 0.4, 0.03
# A sector that begins farther [m] from the place in its file belongs to another raceline.
_ELSEWHERE = 1.0
_PLACES = "start_points"  # key of the places where sectors begin
# A track that bends all the way is an oval if the curvature varies by more than this share of its
# maximum.
_OVAL = 0.1


class SpeedSectors:
    """Piecewise constant scale of the raceline's speed.

    Parameters
    ----------
    sectors : iterable of (start_m, end_m, scale)
        Sectors by arc length [m], within 0 to `length`. A sector that ends before it starts
        crosses the start line.
    length : float
        Length of the track [m].
    elsewhere : float
        Scale outside of all sectors.
    doubts : iterable of str
        Reasons to doubt that the sectors belong to this track.

    Raises
    ------
    ParameterError
        For a scale that is not from 0 to `LARGEST_SCALE`, a sector beyond the track or without
        length, or overlapping sectors.
    """

    def __init__(
        self,
        sectors: Iterable,
        length: float,
        elsewhere: float = 1.0,
        doubts: Iterable[str] = (),
    ):
        self.doubts = tuple(doubts)
        check_scale("speed elsewhere", elsewhere)
        stretches = []
        for start, end, scale in sectors:
            where = f"speed sector {start:g} to {end:g} m"
            check_scale(where, scale)
            if not (0.0 <= start <= length and 0.0 <= end <= length and start != end):
                raise ParameterError(f"{where}: expected different places from 0 to {length:g} m")
            if start < end:
                stretches.append((start, end, scale))
            else:
                stretches += [(start, length, scale), (0.0, end, scale)]
        self._length = length
        self._starts, self._scales = [0.0], [elsewhere]
        for start, end, scale in sorted(s for s in stretches if s[0] < s[1]):
            if start < self._starts[-1] - 1e-9:
                raise ParameterError(f"speed sectors: expected no overlap, got one at {start:g} m")
            self._starts += [start, end]
            self._scales += [scale, elsewhere]
        if self._starts[-1] >= length:  # rounding: -1e-17 % length is the length itself
            del self._starts[-1], self._scales[-1]

    def stretches(self) -> list:
        """Stretches of constant scale around the lap: ``(start_m, end_m, scale)`` of each."""
        ends = [*self._starts[1:], self._length]
        found = zip(self._starts, ends, self._scales)
        return [(start, end, scale) for start, end, scale in found if end - start > 1e-9]

    def scale_at(self, s: float) -> float:
        """Scale of the speed at arc length `s` [m]."""
        return self._scales[bisect_right(self._starts, s % self._length) - 1]

    def told(self, speed_scale: float) -> str:
        """Range of speeds that the sectors give, in words.

        Parameters
        ----------
        speed_scale : float
            The controller's scale, which multiplies the sectors'.

        Returns
        -------
        str
        """
        scales = [scale for *_, scale in self.stretches()]
        text = f"speed sectors: {_range(scales)} of the raceline's speed"
        if speed_scale == 1.0:
            return text
        driven = _range([speed_scale * scale for scale in scales])
        return (
            f"{text}, times speed_scale {speed_scale:g}: {driven}; sectors of advise are for "
            "speed_scale 1"
        )


def _range(scales):
    low, high = (f"{100.0 * scale:.0f}" for scale in (min(scales), max(scales)))
    return f"{low} %" if low == high else f"{low} to {high} %"


def check_scale(where: str, scale: float) -> None:
    """Check that a scale of the speed is plausible.

    Parameters
    ----------
    where : str
        File and field, for the error.
    scale : float

    Raises
    ------
    ParameterError
        If it is not from 0 to `LARGEST_SCALE`.
    """
    if not 0.0 <= scale <= LARGEST_SCALE:  # also true for NaN
        raise ParameterError(
            f"{where}: expected a scale from 0 to {LARGEST_SCALE:g}, 1 for 100 %, got {scale:g}"
        )


def load_speed_sectors(path: str | Path, raceline: Raceline) -> SpeedSectors:
    """Read the public stack's ``speed_scaling.yaml``.

    The file has ``global_limit``, ``n_sectors`` and ``Sector0: {start, end, scaling}``, ...;
    `start` and `end` are indices of the raceline's points, and no scale exceeds the global limit.
    Sectors from the first point to the last but one are extended to the end of the lap, because
    another form of the raceline, such as a bag's, may have one point fewer. If more points are left
    without a sector at the end of the lap, the sectors may belong to another raceline, which is
    noted as a doubt.

    Parameters
    ----------
    path : str or pathlib.Path
    raceline : Raceline
        The indices count its points.

    Returns
    -------
    SpeedSectors

    Raises
    ------
    ParameterError
        If the file is missing or malformed; the message names file and field.
    """
    content = read_yaml_mapping(path, "a speed_scaling.yaml")
    points = raceline.s_points
    if "n_sectors" not in content:
        raise ParameterError(f"{path}: not a speed_scaling.yaml: n_sectors is missing")
    limit = _scale(path, content, "global_limit", "global_limit", 1.0)
    sectors, count, last, covered = [], _index(path, content, "n_sectors"), -1, []
    for index in range(count):
        key = f"Sector{index}"
        sector = content.get(key)
        if not isinstance(sector, dict):
            raise ParameterError(f"{path}: {key}: expected start, end and scaling")
        missing = [name for name in ("start", "end", "scaling") if name not in sector]
        if missing:
            raise ParameterError(f"{path}: {key}: {missing[0]} is missing")
        start, end = (_index(path, sector, name, where=key) for name in ("start", "end"))
        if start > end:
            raise ParameterError(f"{path}: {key}: expected start <= end, got {start}, {end}")
        # Some files count the closing point, which repeats the first.
        if end > len(points) + 1:
            raise ParameterError(
                f"{path}: {key}: end: expected an index of the raceline's {len(points)} points, "
                f"got {end}"
            )
        last = max(last, end)
        covered.append((start, end))
        scale = _scale(path, sector, f"{key}: scaling", "scaling")
        if start >= len(points):
            continue
        # A sector extends to the first point of the next one.
        place = points[end + 1] if end + 1 < len(points) else raceline.length
        sectors.append((points[start], place, min(scale, limit)))
    if sectors and min(sectors)[0] == 0.0 and max(sectors)[1] == points[-1]:
        start, _, scale = sectors.pop(sectors.index(max(sectors)))
        sectors.append((start, raceline.length, scale))
    _refuse_unknown(path, content, count)
    doubts = []
    if count and last < len(points) - 2:
        doubts.append(
            f"{path}: the last sector ends at point {last}, the raceline has {len(points)}: are "
            "the sectors of another one?"
        )
    doubts += _gaps(path, covered)
    starts = [int(content[f"Sector{index}"]["start"]) for index in range(count)]
    doubts += _elsewhere(path, content.get(_PLACES), starts, raceline)
    try:
        return SpeedSectors(sectors, raceline.length, min(1.0, limit), doubts)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from error


def _refuse_unknown(path, content, count):
    """Refuse keys that a file with `count` sectors does not have."""
    for key in content:
        sector = re.fullmatch(r"Sector(0|[1-9]\d*)", str(key))
        known = key in ("global_limit", "n_sectors", _PLACES) or (sector and int(sector[1]) < count)
        if not known:
            raise ParameterError(
                f"{path}: {key}: unknown; known are global_limit, n_sectors and Sector0 to "
                f"Sector{count - 1}"
            )


def corners_and_straights(raceline: Raceline) -> list:
    """Divide a raceline where its corners begin and end.

    Parameters
    ----------
    raceline : Raceline
        With speeds.

    Returns
    -------
    list of (int, int, str)
        First and last point of each sector, as indices of `Raceline.s_points` in the order of the
        lap, and ``"left"``, ``"right"`` or ``"straight"``.

    Raises
    ------
    ParameterError
        If the raceline has no speeds.
    """
    if raceline.speed is None:
        raise ParameterError(f"{raceline.source or raceline.name}: the raceline has no speeds")
    at = raceline.sample(raceline.s_points)
    a_lat = at.speed**2 * at.kappa
    size = a_lat.size
    # Left 1, straight 0, right -1; the median removes short sectors.
    kind = np.sign(a_lat) * (np.abs(a_lat) > _CORNER * np.max(np.abs(a_lat)))
    bend = np.abs(at.kappa)
    if np.ptp(kind) == 0.0 and np.ptp(bend) > _OVAL * np.max(bend):
        # An oval bends everywhere; its corners are where it bends most.
        kind = np.where(bend > 0.5 * (bend.min() + bend.max()), kind, 0.0)
    window = max(3, int(_SHORTEST * size) | 1)
    kind = ndimage.median_filter(kind, 2 * window + 1, mode="wrap")
    starts = [0, *(np.flatnonzero(np.diff(kind)) + 1).tolist(), size]
    names = {1: "left", 0: "straight", -1: "right"}
    return [(a, b - 1, names[int(kind[a])]) for a, b in zip(starts, starts[1:])]


def _gaps(path, covered):
    """Doubt about points that are in no sector, before or between the sectors."""
    end = -1
    for start, last in sorted(covered):
        if start > end + 1:
            missing = f"points {end + 1} to {start - 1}"
            return [f"{path}: {missing} are in no sector: driven at the global limit"]
        end = max(end, last)
    return []


def _elsewhere(path, places, starts, raceline):
    """Doubt about sectors that do not begin at the places listed in their file."""
    if places is None:
        return []
    listed = isinstance(places, list) and all(isinstance(p, list) and len(p) == 2 for p in places)
    if not (listed and len(places) == len(starts)):
        raise ParameterError(f"{path}: {_PLACES}: expected x and y of the start of each sector")
    if not starts:
        return []
    places = np.array([[finite(f"{path}: {_PLACES}", v) for v in place] for place in places])
    at = raceline.sample(raceline.s_points[np.minimum(starts, raceline.s_points.size - 1)])
    for index, (x, y) in enumerate(places):
        away = math.hypot(at.x[index] - x, at.y[index] - y)
        if away > _ELSEWHERE:
            return [
                f"{path}: Sector{index} begins {away:.1f} m from where it begins on the raceline "
                "that the sectors were made for: are they of another one?"
            ]
    return []


def save_speed_sectors(
    path: str | Path, raceline: Raceline, sectors: list, notes: Iterable[str] = ()
) -> None:
    """Write the public stack's ``speed_scaling.yaml``, with the place where each sector begins.

    Parameters
    ----------
    path : str or pathlib.Path
        Replaced atomically if it exists.
    raceline : Raceline
        The sectors' indices count its points.
    sectors : list of (int, int, str) or (int, int, str, float)
        As from `corners_and_straights`, optionally with a scale, by default 1; the words become
        comments.
    notes : iterable of str, optional
        Comments at the top.
    """
    rows = [(*sector, 1.0)[:4] for sector in sectors]
    lines = [f"# {printable(note)}" for note in notes]
    lines += [
        "# Scale of the raceline's speed from waypoint start to end, for each sector; none exceeds",
        "# the global limit.",
        f"global_limit: {max([1.0, *(scale for *_, scale in rows)])}",
        f"n_sectors: {len(rows)}",
    ]
    for index, (start, end, what, scale) in enumerate(rows):
        lines += [
            f"Sector{index}:  # {what}",
            f"  start: {start}",
            f"  end: {end}",
            f"  scaling: {scale}",
            "  only_FTG: false",
            "  no_FTG: false",
        ]
    at = raceline.sample(raceline.s_points)
    places = ", ".join(f"[{at.x[start]:.2f}, {at.y[start]:.2f}]" for start, *_ in rows)
    lines.append(f"{_PLACES}: [{places}]")
    with replacing(path) as file:
        file.write("\n".join(lines) + "\n")


def _scale(path, mapping, where, key, default=None):
    value = finite(f"{path}: {where}", mapping.get(key, default))
    check_scale(f"{path}: {where}", value)
    return value


def _index(path, mapping, key, where=""):
    name = f"{path}: {where + ': ' if where else ''}{key}"
    value = finite(name, mapping[key])
    if value != int(value) or value < 0:
        raise ParameterError(f"{name}: expected a whole number >= 0, got {value:g}")
    return int(value)
