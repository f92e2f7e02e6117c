"""All that a report says about a run, computed once."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from ..bags.remarks import Remarks
from ..bags.samples import Recording
from ..control.settings import Settings
from .driving import PoseTiming, SpeedTracking, pose_timing, speed_tracking
from .lap_limits import LapLimits
from .places import (
    Corner,
    Ideal,
    Reference,
    against_best,
    against_ideal,
    against_run,
    corners_of,
    ideal_lap,
)
from .profiles import CarLimits, RunProfile, profiles_of
from .results import RunResult

__all__ = ["CornerRow", "RunAnalysis", "analyze", "corner_rows", "references", "same_track"]

# Tracks are the same if their lengths and places differ by less [m].
_SAME = 0.02


@dataclass(frozen=True)
class RunAnalysis:
    """A run with all results about it.

    Attributes
    ----------
    name : str
        Short name of the run.
    recording : Recording
    profile : RunProfile
    corners : list of Corner
    ideal : Ideal or None
        None if no lap counts.
    timing : PoseTiming
    tracking : SpeedTracking or None
        None without commands, or if the speed does not follow them.
    remarks : Remarks
    settings : Settings or None
        The last ones that the controller published, or None.
    limits : CarLimits or None
        None if the car is not known.
    planned : ndarray, shape (n,), or None
        Speed planned by the controller, at the places of the profile [m/s].
    delays : dict or None
        Delays of the car, as `map_racing.identification.delay.delay_data` has them.
    notes : list of str
    """

    name: str
    recording: Recording
    profile: RunProfile
    corners: list
    ideal: Ideal | None
    timing: PoseTiming
    tracking: SpeedTracking | None
    remarks: Remarks
    settings: Settings | None
    limits: CarLimits | None
    planned: np.ndarray | None
    delays: dict | None = None
    notes: list = field(default_factory=list)

    @property
    def result(self) -> RunResult:
        """Result of `evaluate` for the run."""
        return self.profile.result


def analyze(
    recording: Recording,
    result: RunResult,
    *,
    name: str = "",
    limits: CarLimits | None = None,
    settings: Settings | None = None,
    remarks: Remarks | None = None,
    delays: dict | None = None,
) -> RunAnalysis:
    """Analyze an evaluated run.

    Parameters
    ----------
    recording : Recording
    result : RunResult
        Result of `evaluate` for it.
    name : str, optional
    limits : CarLimits, optional
        Limits of the car; without them its table is not evaluated.
    settings : Settings, optional
        Settings that the controller published.
    remarks : Remarks, optional
    delays : dict, optional

    Returns
    -------
    RunAnalysis
    """
    profile = profiles_of(recording, result, limits)
    track = profile.track
    planned = settings.planned_speed(result.raceline) if settings is not None else None
    return RunAnalysis(
        name or result.source,
        recording,
        profile,
        corners_of(track),
        ideal_lap(profile) if profile.counted else None,
        pose_timing(recording, LapLimits().on(result.raceline)),
        speed_tracking(recording) if result.commands_followed else None,
        remarks or Remarks([], []),
        settings,
        limits,
        None if planned is None else planned(track.s + track.start_s),
        delays,
        [*profile.notes, *(settings.notes if settings is not None else ())],
    )


def same_track(one: RunAnalysis, other: RunAnalysis) -> bool:
    """Whether two runs can be compared place by place."""
    a, b = one.profile.track, other.profile.track
    if a.s.size != b.s.size or abs(a.length - b.length) > _SAME:
        return False
    return bool(np.max(np.hypot(a.x - b.x, a.y - b.y)) < _SAME)


def references(run: RunAnalysis, others: list[RunAnalysis]) -> list[Reference]:
    """References for the mean lap of a run, the most telling first.

    Parameters
    ----------
    run : RunAnalysis
        With a lap that counts.
    others : list of RunAnalysis
        Other runs; those on other tracks or without a lap that counts are left out.

    Returns
    -------
    list of Reference
    """
    found = [
        against_run(other.profile, f"the mean lap of {other.name}")
        for other in others
        if other.profile.counted and same_track(run, other)
    ]
    if len(run.profile.counted) > 1:
        found.append(against_ideal(run.profile, run.ideal))
        found.append(against_best(run.profile.best))
    speed, name = run.planned, "the speeds asked for"
    if speed is None:
        speed, name = run.profile.track.speed, "the raceline's speeds"
    if speed is not None and np.min(speed) > 0.0:
        s = run.profile.track.s
        pace = 0.5 * (1.0 / speed[1:] + 1.0 / speed[:-1])
        time = np.append(0.0, np.cumsum(pace * np.diff(s)))
        found.append(Reference(name, time, speed, np.zeros(s.size)))
    return found


@dataclass(frozen=True)
class CornerRow:
    """A corner over the laps of a run; standard deviations over laps, NaN for a single lap.

    Attributes
    ----------
    corner : Corner
    time_s, time_std_s, best_s : float
        Time in its stretch [s].
    entry_mps, entry_std_mps, slowest_mps, slowest_std_mps : float
        Speeds at the beginning of the stretch and at the slowest place of the bend itself [m/s].
    apex_d_m, apex_std_m : float
        Lateral deviation at the apex, left positive [m].
    grip_used : float
        Largest share of the table's lateral acceleration in a mean lap; NaN if unknown.
    """

    corner: Corner
    time_s: float
    time_std_s: float
    best_s: float
    entry_mps: float
    entry_std_mps: float
    slowest_mps: float
    slowest_std_mps: float
    apex_d_m: float
    apex_std_m: float
    grip_used: float


def corner_rows(run: RunAnalysis) -> list[CornerRow]:
    """Consistency over the laps that count, corner by corner.

    Parameters
    ----------
    run : RunAnalysis

    Returns
    -------
    list of CornerRow
        Empty if no lap counts.
    """
    track, laps = run.profile.track, run.profile.counted
    if not laps:
        return []
    s, cells = track.s, track.s.size - 1
    kappa = track.kappa[:cells]
    time = np.array([lap.values["time"] for lap in laps])
    v = np.array([lap.values["v"] for lap in laps])
    d = np.array([lap.values["d"] for lap in laps])
    grip = np.mean([lap.grip_used for lap in laps], axis=0)
    rows = []
    for corner in run.corners:
        stretch = corner.inside(s[:cells], track.length)
        inside = np.flatnonzero(stretch)
        bend = inside if not corner.side else _bend(corner, stretch, kappa, s)
        spent = np.sum(np.diff(time, axis=1)[:, inside], axis=1)
        begin, apex = (int(np.argmin(np.abs(s - at))) for at in (corner.begin, corner.apex))
        rows.append(
            CornerRow(
                corner,
                *_spread(spent),
                float(spent.min()),
                *_spread(v[:, begin]),
                *_spread(v[:, bend].min(axis=1)),
                *_spread(d[:, apex]),
                float(np.max(grip[inside])),
            )
        )
    return rows


def _bend(corner, stretch, kappa, s):
    """Places around the apex of a corner, within its stretch, with at least half its curvature."""
    apex = int(np.argmin(np.abs(s[:-1] - corner.apex)))
    bent = np.roll(stretch & (kappa * kappa[apex] >= 0.5 * kappa[apex] ** 2), -apex)
    ends = np.flatnonzero(~bent)
    if not ends.size:
        return np.flatnonzero(stretch)
    return (apex + np.arange(ends[-1] + 1 - bent.size, ends[0])) % bent.size


def _spread(values):
    deviation = float(np.std(values, ddof=1)) if values.size > 1 else math.nan
    return float(np.mean(values)), deviation
