"""Tables and provenance of the races over a grid of tracks and cars."""

from __future__ import annotations

import math

import numpy as np
import pandas as pd

from .jobs import fingerprint, plain
from .results import software

__all__ = ["grid_provenance", "grid_table", "race_rows"]


def race_rows(grid, label, results):
    """One row for each race.

    Parameters
    ----------
    grid : Grid
    label : str
    results : list of RaceResult
        In the order of ``grid.jobs``.

    Returns
    -------
    pandas.DataFrame
        ``controller track car outcome laps_completed lap_time_s rms_lateral_error_m
        max_abs_lateral_error_m end_s_m cause``: median lap time, RMS error over all laps and, if a
        race was not completed, where and why it ended.
    """
    rows = []
    for (track, car), result in zip(grid.names, results):
        laps = result.laps
        square = [lap.rms_lateral_error_m**2 for lap in laps]
        rows.append(
            {
                "controller": label,
                "track": track,
                "car": car,
                "outcome": result.outcome,
                "laps_completed": len(laps),
                "lap_time_s": float(np.median([lap.lap_time_s for lap in laps]))
                if laps
                else math.nan,
                "rms_lateral_error_m": math.sqrt(np.mean(square)) if laps else math.nan,
                "max_abs_lateral_error_m": max(
                    (
                        stretch.max_abs_lateral_error_m
                        for stretch in result.stretches
                        if stretch.lap
                    ),
                    default=math.nan,
                ),
                "end_s_m": math.nan if result.completed or not result.end else result.end.s,
                "cause": "" if result.completed else cause_of(result),
            }
        )
    return pd.DataFrame(rows)


def cause_of(result):
    """Why a race was not completed, in a few words."""
    end = result.end
    if not end:
        return "did not start"
    if result.outcome != "crashed":
        return "no headway"
    if abs(end.sideslip) > 0.5:
        return f"spun at {end.speed:.1f} m/s"
    if end.d * end.kappa < 0.0:
        return f"ran wide at {end.speed:.1f} m/s"
    return f"cut the bend at {end.speed:.1f} m/s"


def grid_table(races, scale):
    """One row for each controller.

    Parameters
    ----------
    races : pandas.DataFrame
        From `race_rows`.
    scale : float
        Of the raceline's speeds.

    Returns
    -------
    pandas.DataFrame
        ``races`` and ``races_completed``; of the latter, ``worst_`` and
        ``mean_rms_lateral_error_m``, ``max_abs_lateral_error_m`` and ``mean_lap_time_s``.
    """
    rows = []
    for label, group in races.groupby("controller", sort=False):
        done = group[group.outcome == "completed"]
        rows.append(
            {
                "speed_scale": scale,
                "controller": label,
                "races": len(group),
                "races_completed": len(done),
                "worst_rms_lateral_error_m": float(done.rms_lateral_error_m.max()),
                "mean_rms_lateral_error_m": float(done.rms_lateral_error_m.mean()),
                "max_abs_lateral_error_m": float(done.max_abs_lateral_error_m.max()),
                "mean_lap_time_s": float(done.lap_time_s.mean()),
            }
        )
    return pd.DataFrame(rows)


def grid_provenance(grid, controllers):
    """What the results of a grid depend on, as plain values.

    Parameters
    ----------
    grid : Grid
    controllers : dict of str to ControllerParameters
        Controllers raced, by label.

    Returns
    -------
    dict
        For JSON.
    """
    return {
        **software(),
        "notes": grid.notes,
        "conditions": plain(grid.conditions),
        "track": {
            "name": f"{len(grid.tracks)} tracks",
            "sha256": fingerprint(list(grid.tracks)),
        },
        "tracks": plain(list(grid.tracks)),
        "cars": {car.name: plain(car.plant) for car in grid.cars},
        "controllers": {label: plain(value) for label, value in controllers.items()},
    }
