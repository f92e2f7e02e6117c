"""Where a lap loses time: corners, mini-sectors, the ideal lap, and the places that cost most."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.signal import find_peaks

from ..errors import EvaluationError
from ..track.corners import runs_around
from ..track.speed_profile import speed_profile
from .profiles import LapProfile, RunProfile, TrackProfile

__all__ = [
    "Corner",
    "Ideal",
    "Place",
    "Reference",
    "corners_of",
    "costliest",
    "against_ideal",
    "against_best",
    "against_run",
    "ideal_lap",
]

# Length of a mini-sector [m], and their number.
_MINI, _FEWEST, _MOST = 2.0, 6, 60
# A corner is slower than the straights around it by this share of the range of speeds.
_PROMINENCE = 0.1
# A bend has at least this share of the largest lateral acceleration; a track on which it varies
# less than this is uniform.
_BENT, _UNIFORM = 0.35, 0.02
# The stretch of a corner begins this far before braking [m], but at most this share of the straight
# before it.
_AHEAD, _SHARE = 1.5, 0.4
# Limits of an ordinary car, for racelines without speeds [m/s^2, m/s].
_ORDINARY = {"a_lat_max": 6.0, "a_drive_max": 5.0, "a_brake_max": 6.0, "v_max": 10.0}
_ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth", "seventh", "eighth", "ninth")
# Smallest loss [s].
_LEAST = 0.0005
# Share of a loss that is cut off at each end of its place.
_TAIL = 0.03
# Smaller differences are not mentioned [m].
_WIDE, _EARLY = 0.05, 0.15
# Braking is compared if the speed falls by at least this [m/s], from the reference's speed within
# this share; it may begin this many places before the stretch.
_FALL, _SAME, _BEFORE = 0.5, 0.03, 15
# No day has more grip than this share of the vehicle file's.
_DOUBTFUL_GRIP = 1.3


@dataclass(frozen=True)
class Corner:
    """A bend with the straight before it, and as much of the next as matters.

    Attributes
    ----------
    name : str
        Such as ``"second left"``, counted from the start line; empty on a track without corners.
    side : int
        1 for left, -1 for right, 0 without a bend.
    begin, apex, end : float
        Distances from the start line [m]: stretch, and its slowest place. For a stretch that
        crosses the start line, `end` is less than `begin`.
    """

    name: str
    side: int
    begin: float
    apex: float
    end: float

    def inside(self, s: np.ndarray, length: float) -> np.ndarray:
        """Mask of the distances within the stretch.

        Parameters
        ----------
        s : array_like, shape (n,)
            Distances from the start line [m].
        length : float
            Length of the track [m].

        Returns
        -------
        ndarray of bool, shape (n,)
        """
        s = np.asarray(s) % length
        if self.begin < self.end:
            return (s >= self.begin) & (s < self.end)
        return (s >= self.begin) | (s < self.end)


@dataclass(frozen=True)
class Ideal:
    """A lap composed of the best mini-sectors of all laps.

    Attributes
    ----------
    time_s : float
        Lap time [s].
    ends : ndarray, shape (k,)
        Ends of the mini-sectors [m].
    times : ndarray, shape (laps, k)
        Times of each lap in them [s].
    """

    time_s: float
    ends: np.ndarray
    times: np.ndarray


@dataclass(frozen=True)
class Reference:
    """Reference of a comparison, over distance.

    Attributes
    ----------
    name : str
        Such as "the ideal lap".
    time, v, d : ndarray, shape (n,)
        Time [s], speed [m/s] and lateral deviation [m] at the places of the profiles.
    """

    name: str
    time: np.ndarray
    v: np.ndarray
    d: np.ndarray


@dataclass(frozen=True)
class Place:
    """A stretch that costs time.

    Attributes
    ----------
    corner : Corner
    begin, end : float
        Distances from the start line [m]; they enclose all but 6 % of the loss.
    loss_s : float
        Time lost there in a mean lap [s].
    entry, entry_reference, slowest, slowest_reference, exit, exit_reference : float
        Speeds at the beginning, at the slowest place and at the end [m/s].
    wide_m : float
        Largest distance from the reference towards the outside of the bend [m], from `begin` to
        `end`.
    wide_at : str
        Where: ``"entry"``, ``"apex"`` or ``"exit"``.
    grip_used : float
        Largest share of the table's lateral acceleration in the mean lap; NaN if unknown.
    early_m : float
        Distance by which the car brakes earlier for the bend than the reference [m].
    """

    corner: Corner
    begin: float
    end: float
    loss_s: float
    entry: float
    entry_reference: float
    slowest: float
    slowest_reference: float
    exit: float
    exit_reference: float
    wide_m: float
    wide_at: str
    grip_used: float
    early_m: float = 0.0

    def __str__(self):
        name = f", {self.corner.name}" if self.corner.name else ""
        return f"s = {self.begin:.0f} to {self.end:.0f} m{name}: {self.loss}; {self.why}"

    @property
    def loss(self) -> str:
        """The time lost, in words."""
        return f"{self.loss_s:.2f} s" if self.loss_s >= 0.1 else f"{self.loss_s:.3f} s"

    @property
    def why(self) -> str:
        """The differences there, in words."""
        said = []
        for verb, own, other in (
            ("enters at", self.entry, self.entry_reference),
            ("slows to", self.slowest, self.slowest_reference),
            ("leaves at", self.exit, self.exit_reference),
        ):
            if f"{own:.1f}" != f"{other:.1f}":
                said.append(f"{verb} {own:.1f} instead of {other:.1f} m/s")
        # The most telling two.
        if len(said) == 3:
            del said[2]
        if abs(self.early_m) >= _EARLY:
            when = "earlier" if self.early_m > 0.0 else "later"
            said = [f"brakes {abs(self.early_m):.1f} m {when}", *said[:2]]
        if self.wide_m >= _WIDE:
            said.append(f"{self.wide_m:.2f} m wide at the {self.wide_at}")
        elif self.wide_m <= -_WIDE:
            said.append(f"{-self.wide_m:.2f} m closer to the inside at the {self.wide_at}")
        said = said or ["the same speeds and line"]
        if not math.isnan(self.grip_used):
            said.append(f"{self.grip_used:.0%} of the grip used".replace("%", " %"))
        if self.grip_used > _DOUBTFUL_GRIP:
            said.append("more than the vehicle file's tires have: is it the file of this car?")
        return ", ".join(said)


def corners_of(track: TrackProfile) -> list[Corner]:
    """Corners of a track in the order of the lap; together they cover it.

    A corner is a minimum of the raceline's speed or, without speeds, of an ordinary car's. Each
    stretch begins shortly before braking does.

    Parameters
    ----------
    track : TrackProfile

    Returns
    -------
    list of Corner
        At least one; on a circle, a single one without name.
    """
    kappa, cells = track.kappa[:-1], track.s.size - 1
    ds = track.length / cells
    speed = track.speed
    if speed is None or np.ptp(speed) < _UNIFORM * np.max(speed):
        speed = speed_profile(kappa, ds, v_min=0.5, **_ORDINARY)
    apexes = _apexes(kappa, speed[:cells])
    if not apexes:
        return [Corner("", 0, 0.0, 0.0, track.length)]
    starts = [
        _beginning(kappa, speed, np.arange(before, low if low > before else low + cells), ds)
        for before, low in zip(apexes[-1:] + apexes[:-1], apexes)
    ]
    corners, counts = [], {1: 0, -1: 0}
    for begin, low, end in zip(starts, apexes, starts[1:] + starts[:1]):
        side = 1 if kappa[low] > 0.0 else -1
        number, counts[side] = counts[side], counts[side] + 1
        which = _ORDINALS[number] if number < len(_ORDINALS) else f"{number + 1}th"
        name = f"{which} {'left' if side > 0 else 'right'}"
        corners.append(Corner(name, side, begin * ds, low * ds, end * ds))
    return corners


def _apexes(kappa, speed):
    """Cells of the slowest places of the bends; a bend with several counts as several.

    In a bend the lateral acceleration has one sign and is not small.
    """
    needed = speed**2 * kappa
    if not np.ptp(np.abs(kappa)) > _UNIFORM * np.max(np.abs(kappa)):
        return []
    cells = kappa.size
    slow = find_peaks(-np.tile(speed, 3), prominence=_PROMINENCE * float(np.ptp(speed)))[0]
    slow = set((slow[(slow >= cells) & (slow < 2 * cells)] - cells).tolist())
    kind = np.where(np.abs(needed) > _BENT * np.max(np.abs(needed)), np.sign(kappa), 0.0)
    apexes = []
    for bend in runs_around(kind):
        inside = [cell for cell in bend.tolist() if cell in slow]
        apexes += inside or [int(bend[np.argmax(np.abs(needed[bend]))])]
    return sorted(apexes)


def _beginning(kappa, speed, between, ds):
    """First cell of the stretch of an apex, among the cells since the previous apex.

    It is shortly before the fastest place or, if the speed only rises or only falls, at the
    straightest.
    """
    between = between % kappa.size
    fastest = int(np.argmax(speed[between]))
    if not 0 < fastest < between.size - 1:
        return int(between[np.argmin(np.abs(kappa[between]))])
    back = min(int(_AHEAD / ds), int(_SHARE * fastest))
    return int(between[fastest - back])


def ideal_lap(run: RunProfile) -> Ideal:
    """The ideal lap of a run, from mini-sectors of about 2 m.

    Parameters
    ----------
    run : RunProfile

    Returns
    -------
    Ideal

    Raises
    ------
    EvaluationError
        If no lap counts.
    """
    if not run.counted:
        raise EvaluationError(f"{run.result.source}: expected a lap that counts, got none")
    track = run.track
    count = int(np.clip(round(track.length / _MINI), _FEWEST, _MOST))
    ends = track.length * np.arange(1, count + 1) / count
    times = np.array(
        [
            np.diff(np.interp(np.append(0.0, ends), track.s, profile.values["time"]))
            for profile in run.counted
        ]
    )
    return Ideal(float(np.sum(np.min(times, axis=0))), ends, times)


def against_ideal(run: RunProfile, ideal: Ideal) -> Reference:
    """The ideal lap as a reference: in each mini-sector, the lap that is fastest there."""
    s = run.track.s
    sector = np.minimum(np.searchsorted(ideal.ends, s, side="left"), ideal.ends.size - 1)
    fastest = np.argmin(ideal.times, axis=0)[sector]
    columns = {
        name: np.array([p.values[name] for p in run.counted])[fastest, np.arange(s.size)]
        for name in ("time", "v", "d")
    }
    # The time runs on from sector to sector.
    begins = np.append(0.0, ideal.ends[:-1])
    before = np.append(0.0, np.cumsum(np.min(ideal.times, axis=0))[:-1])
    entered = np.array([np.interp(begins, s, p.values["time"]) for p in run.counted])
    time = columns["time"] - entered[fastest, sector] + before[sector]
    return Reference("the ideal lap", time, columns["v"], columns["d"])


def against_best(best: LapProfile) -> Reference:
    """The best lap as a reference."""
    return Reference("the best lap", *(best.values[channel] for channel in ("time", "v", "d")))


def against_run(other: RunProfile, name: str) -> Reference:
    """The mean lap of another run on the same track as a reference."""
    return Reference(name, *(other.mean(channel) for channel in ("time", "v", "d")))


def costliest(run: RunProfile, reference: Reference, corners: list[Corner]) -> list[Place]:
    """The three places where the mean lap of a run loses most against a reference.

    In each corner's stretch, the place is the part with the largest total loss.

    Parameters
    ----------
    run : RunProfile
    reference : Reference
        At the same places as the run.
    corners : list of Corner

    Returns
    -------
    list of Place
        The costliest first; only places that cost time.
    """
    track = run.track
    cells = track.s.size - 1
    loss = np.diff(run.mean("time") - reference.time)
    v, d = run.mean("v")[:cells], run.mean("d")[:cells]
    v_reference, d_reference = reference.v[:cells], reference.d[:cells]
    kappa, places = track.kappa[:cells], []
    slower = _progress(v, d, kappa) <= _progress(v_reference, d_reference, kappa)
    grip = np.mean([profile.grip_used[:cells] for profile in run.counted], axis=0)
    for corner in corners:
        inside = np.flatnonzero(corner.inside(track.s[:cells], track.length))
        if corner.begin >= corner.end:  # over the start line
            inside = np.roll(inside, -np.count_nonzero(track.s[inside] < corner.begin))
        first, last = _largest_sum(loss[inside])
        lost = float(loss[inside[first:last]].sum())
        if lost < _LEAST:
            continue
        part = inside[slice(*_without_tails(loss[inside], first, last))]
        # Faster throughout: the loss is only noise of the poses.
        if not slower[part].any():
            continue
        end = (part[-1] + 1) % cells
        wide, where = _deviation((d - d_reference)[part], part, corner, track)
        # Early braking may begin before the stretch.
        before = (inside[0] - np.arange(_BEFORE, 0, -1)) % cells
        approach = np.concatenate((before, inside))
        slow = part[int(np.argmin(v[part]))]
        slow_reference = v_reference[part].min()
        places.append(
            Place(
                corner,
                float(track.s[part[0]]),
                float(track.s[end]) or track.length,
                lost,
                float(v[part[0]]),
                float(reference.v[part[0]]),
                float(v[slow]),
                float(slow_reference),
                float(v[end]),
                float(reference.v[end]),
                wide,
                where,
                float(np.max(grip[part])),
                _brakes_earlier_by(v[approach], v_reference[approach], track.length / cells),
            )
        )
    return sorted(places, key=lambda place: -place.loss_s)[:3]


def _progress(v, d, kappa):
    """Speed projected onto the raceline [m/s]; off the line, a bend has a different length."""
    return v / np.maximum(1.0 - kappa * d, 0.1)


def _deviation(left, part, corner, track):
    """Largest deviation to the outside in a part of the lap [m], and where it is."""
    cells, begin, widest = track.s.size - 1, track.s[part[0]], int(np.argmax(np.abs(left)))
    apex, at = (corner.apex - begin) % track.length, (track.s[part[widest]] - begin) % track.length
    near = 0.15 * len(part) * track.length / cells
    inside = apex <= (track.s[(part[-1] + 1) % cells] - begin) % track.length
    where = "apex" if inside and abs(at - apex) <= near else "entry" if at < apex else "exit"
    return float(-corner.side * left[widest]), where


def _brakes_earlier_by(own, reference, step):
    """Distance [m] by which one speed reaches mid-braking earlier than another."""
    low = int(np.argmin(reference))
    high, own_high = (int(np.argmax(v[: low + 1])) for v in (reference, own))
    fall = reference[high] - reference[low]
    if not fall >= _FALL or abs(own[own_high] / reference[high] - 1.0) > _SAME:
        return 0.0
    middle = reference[low] + 0.5 * fall
    places = []
    for v, begin in ((reference, high), (own, own_high)):
        below = np.flatnonzero(v[begin:] < middle)
        if not below.size or not below[0]:
            return 0.0
        i = begin + int(below[0])
        places.append(i - (middle - v[i]) / (v[i - 1] - v[i]))
    return float(step * (places[0] - places[1]))


def _largest_sum(values):
    """Begin and end of the contiguous part with the largest sum."""
    total = np.append(0.0, np.cumsum(values))
    lowest = np.minimum.accumulate(total)
    end = int(np.argmax(total - lowest))
    begin = int(np.argmin(total[: end + 1]))
    return begin, end


def _without_tails(values, begin, end):
    """The part without the ends, which add next to nothing."""
    share = np.cumsum(values[begin:end]) / np.sum(values[begin:end])
    first = np.flatnonzero(share >= _TAIL)[0]
    before = np.flatnonzero(share < 1.0 - _TAIL)
    return begin + int(first), begin + (int(before[-1]) + 2 if before.size else 1)
