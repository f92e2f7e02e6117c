"""The experiments of the paper: what is raced with what, and what comes of it as tables.

Becker et al., ICRA 2023, section on the experiments: *velocity scaling* (laps at rising speed until
a crash, pure pursuit and MAP) and *tire models* (pure pursuit, MAP with linear tires and MAP with
Pacejka tires at two speeds).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd

from ..track.raceline import Raceline
from ..vehicle.parameters import Vehicle
from .campaign import Plan
from .conditions import Conditions, day_of
from .jobs import RaceJob, lap_row
from .tuning import tune

__all__ = [
    "CONTENDERS",
    "Contender",
    "Race",
    "Setting",
    "highest_scales",
    "lap_frame",
    "on_common_days",
    "race_frame",
    "scaling_plan",
    "scaling_table",
    "single_plan",
    "tire_table",
    "tuning_plan",
]


class Contender(NamedTuple):
    """A row of the tables.

    Parameters
    ----------
    label : str
    controller : str
        Shipped controller.
    tuned : bool
        Whether its lookahead is tuned for the occasion, or that of its file.
    """

    label: str
    controller: str
    tuned: bool


# As published, each tuned by itself; and what this project makes of it, as anyone gets it.
CONTENDERS = (
    Contender("pure pursuit", "pure_pursuit_paper", True),
    Contender("MAP linear", "map_linear_paper", True),
    Contender("MAP Pacejka", "map_paper", True),
    Contender("MAP default", "map", False),
)


@dataclass(frozen=True)
class Setting:
    """Conditions with everything loaded.

    Parameters
    ----------
    conditions : Conditions
    raceline : Raceline
    plant : PlantParameters or PublicSimulatorParameters
        On the day of identification.
    vehicle, linear_vehicle : Vehicle
        The car as controllers know it, with Pacejka and with linear tires.
    """

    conditions: Conditions
    raceline: Raceline
    plant: object
    vehicle: Vehicle
    linear_vehicle: Vehicle

    def day(self, seed):
        """The plant on the day of a seed."""
        return day_of(self.plant, self.conditions, seed)

    def job(self, label, controller, day, laps):
        """The race of a controller on a day."""
        linear = controller.steering_map == "linear_table"
        if self.plant.reference_point != "rear_axle":
            controller = controller.with_(reference_point=self.plant.reference_point)
        return RaceJob(
            label,
            controller,
            self.linear_vehicle if linear else self.vehicle,
            day.plant,
            self.raceline,
            laps,
            day.seed,
        )


class Race(NamedTuple):
    """A race of an experiment: whose, at what scale of the speeds, on which day, and its result."""

    label: str
    scale: float
    seed: int
    job: RaceJob
    result: object


# -- plans -----------------------------------------------------------------------------------------


def tuning_plan(setting, label, controller):
    """Plan that tunes a controller on the practice days; its result is a `Tuned`.

    Parameters
    ----------
    setting : Setting
    label : str
    controller : ControllerParameters
        What is not tuned of it is kept; the scale of the speeds does not matter.

    Returns
    -------
    Plan
    """
    conditions = setting.conditions
    days = [setting.day(seed) for seed in conditions.practice_seeds]

    def jobs_for(candidate):
        return [setting.job(label, candidate, day, conditions.tuning_laps) for day in days]

    def steps():
        tuned = yield from tune(jobs_for, controller.with_(speed_scale=conditions.tuning_scale))
        as_given = tuned.controller.with_(speed_scale=controller.speed_scale)
        return tuned._replace(controller=as_given)

    return Plan(steps(), 90 * len(days))


def scaling_plan(setting, label, controller, seed, laps, scales):
    """Plan that races on one day at rising speeds until a race is not completed.

    Parameters
    ----------
    setting : Setting
    label : str
    controller : ControllerParameters
    seed : int
        Of the day.
    laps : int
    scales : sequence of float
        Rising.

    Returns
    -------
    Plan
        With a list of `Race` as result.
    """

    def steps():
        day, races = setting.day(seed), []
        for scale in scales:
            job = setting.job(label, controller.with_(speed_scale=scale), day, laps)
            (result,) = yield [job]
            races.append(Race(label, scale, seed, job, result))
            if not result.completed:
                break
        return races

    return Plan(steps(), min(len(scales), 12))


def single_plan(setting, label, controller, seed, laps, scales):
    """Plan that races on one day at each of some speeds, whatever becomes of the others.

    Parameters and result are those of `scaling_plan`.
    """

    def steps():
        day = setting.day(seed)
        jobs = [
            setting.job(label, controller.with_(speed_scale=scale), day, laps) for scale in scales
        ]
        results = yield jobs
        return [Race(label, job.scale, seed, job, result) for job, result in zip(jobs, results)]

    return Plan(steps(), len(scales))


# -- tables ----------------------------------------------------------------------------------------


def race_frame(races):
    """One row for each race, with its seed.

    Parameters
    ----------
    races : list of Race

    Returns
    -------
    pandas.DataFrame
        Lateral errors are those of everything driven after the out-lap (of the out-lap where it
        ended there): the mean over time, and the maximum.
    """
    rows = []
    for race in races:
        result = race.result
        driven = [s for s in result.stretches if s.lap > 0] or list(result.stretches)
        if result.completed:
            driven = result.laps
        time = np.array([s.end_time_s - s.start_time_s for s in driven])
        mean = np.array([s.mean_abs_lateral_error_m for s in driven])
        square = np.array([s.rms_lateral_error_m for s in driven]) ** 2
        laps = [lap.lap_time_s for lap in result.laps]
        rows.append(
            {
                "speed_scale": race.scale,
                "controller": race.label,
                "seed": race.seed,
                "outcome": result.outcome,
                "laps_completed": len(laps),
                "mean_lap_time_s": float(np.mean(laps)) if laps else math.nan,
                "rms_lateral_error_m": _over_time(square, time) ** 0.5,
                "mean_abs_lateral_error_m": _over_time(mean, time),
                "max_abs_lateral_error_m": max(
                    (s.max_abs_lateral_error_m for s in driven), default=math.nan
                ),
                "duration_s": result.duration_s,
                "fingerprint": race.job.fingerprint,
            }
        )
    return _sorted(pd.DataFrame(rows))


def _over_time(values, time):
    return float(np.sum(values * time) / np.sum(time)) if time.size else math.nan


def lap_frame(races):
    """One row for each stretch of each race: the `LAP_COLUMNS` after those of the race."""
    return _sorted(
        pd.DataFrame(
            [
                {
                    "speed_scale": race.scale,
                    "controller": race.label,
                    "seed": race.seed,
                    "outcome": race.result.outcome,
                    **lap_row(stretch),
                }
                for race in races
                for stretch in race.result.stretches
            ]
        )
    )


def _sorted(frame):
    """By scale, controller in the order of the contenders, and seed."""
    order = {contender.label: place for place, contender in enumerate(CONTENDERS)}
    keys = [
        (row.speed_scale, order.get(row.controller, len(order)), row.seed, getattr(row, "lap", 0))
        for row in frame.itertuples()
    ]
    return frame.iloc[sorted(range(len(keys)), key=keys.__getitem__)].reset_index(drop=True)


def scaling_table(races, laps):
    """Velocity scaling: one row for each scale and controller.

    Parameters
    ----------
    races, laps : pandas.DataFrame
        From `race_frame` and `lap_frame`.

    Returns
    -------
    pandas.DataFrame
        ``days`` raced, of which ``days_completed``; minimum, quartiles and maximum of the RMS
        lateral error and of the time of the laps of these; NaN where there are none.
    """
    counted = laps[(laps.outcome == "completed") & laps.valid]
    rows = []
    for (scale, label), group in races.groupby(["speed_scale", "controller"], sort=False):
        own = counted[(counted.speed_scale == scale) & (counted.controller == label)]
        row = {"speed_scale": scale, "controller": label, **_completion(group), "laps": len(own)}
        for column in ("rms_lateral_error_m", "lap_time_s"):
            values = own[column].values if len(own) else np.array([math.nan])
            for name, share in (("min", 0), ("q1", 25), ("median", 50), ("q3", 75), ("max", 100)):
                row[f"{name}_{column}"] = float(np.percentile(values, share))
        row["mean_lap_time_s"] = float(own.lap_time_s.mean()) if len(own) else math.nan
        row["max_abs_lateral_error_m"] = (
            float(own.max_abs_lateral_error_m.max()) if len(own) else math.nan
        )
        rows.append(row)
    return pd.DataFrame(rows)


def tire_table(races):
    """Tire models: one row for each scale and controller, with the paper's columns.

    Parameters
    ----------
    races : pandas.DataFrame
        From `race_frame`.

    Returns
    -------
    pandas.DataFrame
        Means over the days of lap time and mean deviation, and the largest deviation of all; of the
        days completed or, where there are none, of all days until the crash.
    """
    rows = []
    for (scale, label), group in races.groupby(["speed_scale", "controller"], sort=False):
        completed = group[group.outcome == "completed"]
        shown = completed if len(completed) else group
        rows.append(
            {
                "speed_scale": scale,
                "controller": label,
                **_completion(group),
                "mean_lap_time_s": float(shown.mean_lap_time_s.mean()),
                "mean_abs_lateral_error_m": float(shown.mean_abs_lateral_error_m.mean()),
                "rms_lateral_error_m": float(shown.rms_lateral_error_m.mean()),
                "max_abs_lateral_error_m": float(shown.max_abs_lateral_error_m.max()),
            }
        )
    return pd.DataFrame(rows)


def _completion(group):
    """How many days were raced and completed, and after how many laps the others ended."""
    ended = group[group.outcome != "completed"]
    return {
        "days": len(group),
        "days_completed": len(group) - len(ended),
        "laps_until_end": " ".join(str(laps) for laps in sorted(ended.laps_completed)),
    }


def highest_scales(races):
    """Highest scale that each controller completed on each day.

    Parameters
    ----------
    races : pandas.DataFrame
        From `race_frame`.

    Returns
    -------
    pandas.DataFrame
        A row for each seed, a column for each controller; NaN where it completed none.
    """
    labels = list(dict.fromkeys(races.controller))
    completed = races[races.outcome == "completed"]
    best = completed.groupby(["seed", "controller"]).speed_scale.max()
    rows = [
        {"seed": seed, **{label: best.get((seed, label), math.nan) for label in labels}}
        for seed in sorted(set(races.seed))
    ]
    return pd.DataFrame(rows, columns=["seed", *labels])


def on_common_days(races, first, second):
    """Two controllers at each scale, on the days on which both completed it.

    Parameters
    ----------
    races : pandas.DataFrame
        From `race_frame`.
    first, second : str
        Labels.

    Returns
    -------
    pandas.DataFrame
        ``speed_scale``, number of ``days``, on how many of them the first had the smaller RMS error
        (``days_closer``), the ratio of both means (first to second), and by how much the first was
        faster, ``gain_s`` [s].
    """
    completed = races[races.outcome == "completed"]
    a, b = (
        completed[completed.controller == label].set_index(["speed_scale", "seed"])
        for label in (first, second)
    )
    rows = []
    for scale in sorted(set(races.speed_scale)):
        both = [key for key in a.index if key[0] == scale and key in b.index]
        if not both:
            continue
        error_a, error_b = (
            frame.rms_lateral_error_m.reindex(both).values.astype(float) for frame in (a, b)
        )
        time_a, time_b = (
            frame.mean_lap_time_s.reindex(both).values.astype(float) for frame in (a, b)
        )
        rows.append(
            {
                "speed_scale": scale,
                "days": len(both),
                "days_closer": int(np.sum(error_a < error_b)),
                "error_ratio": float(error_a.mean() / error_b.mean()),
                "gain_s": float(np.mean(time_b - time_a)),
            }
        )
    columns = ["speed_scale", "days", "days_closer", "error_ratio", "gain_s"]
    return pd.DataFrame(rows, columns=columns)
