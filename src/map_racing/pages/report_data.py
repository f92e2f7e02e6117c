"""The data of a report's charts and map, for the page's script."""

from __future__ import annotations

import math
from dataclasses import asdict

import numpy as np

from ..evaluation.analysis import RunAnalysis, same_track
from ..vehicle.single_track import GRAVITY
from .html import pack

__all__ = ["chart_data", "charted_laps"]

# Size of a value [bytes], including a tenth for the rest of the data.
_VALUE = 1.1 * 8.0 / 3.0
_CHARTED = ("v", "v_command", "d", "steering", "steering_table", "a_lat", "a_lon")
# Speeds at which the limit of the tires is drawn.
_LIMITS = 40


def chart_data(runs: list[RunAnalysis], compared: list, shown: list[list[int]]) -> dict:
    """Data for the page's script.

    Parameters
    ----------
    runs : list of RunAnalysis
    compared : list of list of (Reference, list of Place)
        For each run, the places that cost most against each of its references.
    shown : list of list of int
        For each run, indices of the laps to chart, see `charted_laps`.

    Returns
    -------
    dict
        For JSON; arrays are packed by `map_racing.pages.html.pack`.
    """
    tracks, entries = [], []
    for run, laps in zip(runs, shown):
        track = next((k for k, other in tracks if same_track(run, other)), None)
        if track is None:
            track = len(tracks)
            tracks.append((track, run))
        best = run.profile.best
        entries.append(
            {
                "name": run.name,
                "track": track,
                "known": run.limits is not None,
                "best": next((i for i, k in enumerate(laps) if run.profile.laps[k] is best), 0),
                "left_out": len(run.profile.laps) - len(laps),
                "planned": pack(run.planned),
                "laps": [_lap(run, index) for index in laps],
                "limit": _limit(run),
            }
        )
    return {
        "runs": entries,
        "tracks": [_track(run) for _, run in tracks],
        "places": [
            [[_place(place) for place in places] for _, places in comparisons]
            for comparisons in compared
        ],
    }


def _place(place):
    values = asdict(place)
    return {"begin": values["begin"], "end": values["end"], "name": place.corner.name}


def charted_laps(runs: list[RunAnalysis], budget: float) -> list[list[int]]:
    """Indices of the laps in the charts: all, or as many as the size of the page allows.

    If there are too many: the best, the last, and others at equal steps.

    Parameters
    ----------
    runs : list of RunAnalysis
    budget : float
        Largest size of their data [bytes].

    Returns
    -------
    list of list of int
        One list for each run.
    """
    cost = [_VALUE * (len(_CHARTED) + 1) * run.profile.track.s.size for run in runs]
    wanted = sum(c * len(run.profile.laps) for c, run in zip(cost, runs))
    share = min(1.0, budget / max(wanted, 1.0))
    chosen = []
    for run in runs:
        laps = run.profile.laps
        count = len(laps) if share == 1.0 else max(int(share * len(laps)), min(len(laps), 2))
        indices = set(np.linspace(0, len(laps) - 1, count).round().astype(int).tolist())
        if run.profile.best is not None and len(indices) < len(laps):
            best = next(i for i, lap in enumerate(laps) if lap is run.profile.best)
            if best not in indices and len(indices) > 1:
                indices.discard(min(indices))
            indices.add(best)
        chosen.append(sorted(indices))
    return chosen


def _lap(run, index):
    profile, track = run.profile.laps[index], run.profile.track
    lap, time = profile.lap, profile.values["time"]
    known = np.isfinite(time)
    total = float(time[known][-1]) if known.any() else 0.0
    even = total * track.s / track.length
    values = dict(profile.values)
    if not run.result.commands_followed:  # not a speed, such as a throttle
        values["v_command"] = np.full(track.s.size, math.nan)
    return {
        "index": index,
        "number": lap.lap,
        "time": lap.lap_time_s,
        "valid": lap.valid,
        "total": total,
        "residual": pack(time - even),
        **{name: pack(values[name]) for name in _CHARTED},
    }


def _track(run):
    track = run.profile.track
    return {
        "length": track.length,
        "n": track.s.size,
        "x": pack(track.x),
        "y": pack(track.y),
        "cos": pack(np.cos(track.psi)),
        "sin": pack(np.sin(track.psi)),
        "speed": pack(track.speed),
        "grip": pack(track.grip_speed),
        "left": pack(track.d_left),
        "right": pack(track.d_right),
        "corners": [{"name": c.name, "apex": c.apex} for c in run.corners if c.name],
    }


def _limit(run):
    """Limits: lateral over speed, and longitudinal [m/s^2]."""
    limits = run.limits
    if limits is None:
        return None
    v = np.linspace(0.0, max(limits.v_max, 1.0), _LIMITS)
    return {
        "v": v.round(3).tolist(),
        "a": limits.lateral(v).round(3).tolist(),
        "drive": min(limits.a_drive_max, GRAVITY * 2.0),
        "brake": min(limits.a_brake_max, GRAVITY * 2.0),
    }
