"""The experiments of the paper: their races and tables.

Becker et al., ICRA 2023, section on the experiments: *velocity scaling* (laps at rising speed until
a crash, pure pursuit and MAP) and *tire models* (pure pursuit, MAP with linear tires and MAP with
Pacejka tires at two speeds).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple, Sequence

import numpy as np
import pandas as pd

from ..control.parameters import ControllerParameters
from ..simulation.plant import PlantParameters
from ..simulation.public_simulator import PublicSimulatorParameters
from ..track.raceline import Raceline
from ..vehicle.parameters import Vehicle
from ..vehicle.size import size_of
from .campaign import Plan
from .conditions import Conditions, Day, day_of
from .jobs import LAP_COLUMNS, RaceJob, RaceResult, lap_row
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
    "tire_table",
    "tuning_plan",
]


class Contender(NamedTuple):
    """A row of the tables: label, shipped controller, and whether its lookahead is tuned."""

    label: str
    controller: str
    tuned: bool


# The published controllers, each tuned separately, and those of this package, untuned: the default,
# and the one that learns the tires of the day.
CONTENDERS = (
    Contender("pure pursuit", "pure_pursuit_paper", True),
    Contender("MAP linear", "map_linear_paper", True),
    Contender("MAP Pacejka", "map_paper", True),
    Contender("MAP default", "map", False),
    Contender("MAP adaptive", "map_adaptive", False),
)


@dataclass(frozen=True)
class Setting:
    """Conditions with everything loaded; the vehicles are the models of the controllers.

    With a ``slowdown``, the computing time of the controllers times this factor counts; see `race`.
    """

    conditions: Conditions
    raceline: Raceline
    plant: PlantParameters | PublicSimulatorParameters
    vehicle: Vehicle
    linear_vehicle: Vehicle
    slowdown: float | None = None

    def day(self, seed: int) -> Day:
        """The plant on the day of a seed."""
        return day_of(self.plant, self.conditions, seed)

    def job(self, label: str, controller: ControllerParameters, day: Day, laps: int) -> RaceJob:
        """The race of a controller on a day."""
        linear = getattr(controller, "steering_map", "") == "linear_table"
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
            self.slowdown,
        )


class Race(NamedTuple):
    """A race of an experiment: controller, scale of the speeds, day, and its result."""

    label: str
    scale: float
    seed: int
    job: RaceJob
    result: RaceResult


# Lap times that differ by less [s] are those of the same speeds.
_SAME_LAP_S = 1e-3

# -- plans -----------------------------------------------------------------------------------------


def tuning_plan(setting: Setting, label: str, controller: ControllerParameters) -> Plan:
    """Plan that tunes a controller's lookahead on the practice days; its result is a `Tuned`."""
    conditions = setting.conditions
    days = [setting.day(seed) for seed in conditions.practice_seeds]

    def jobs_for(candidate):
        return [setting.job(label, candidate, day, conditions.tuning_laps) for day in days]

    def steps():
        start = controller.with_(speed_scale=conditions.tuning_scale)
        tuned = yield from tune(jobs_for, start, size_of(setting.vehicle))
        as_given = tuned.controller.with_(speed_scale=controller.speed_scale)
        return tuned._replace(controller=as_given)

    return Plan(steps(), 90 * len(days))


def scaling_plan(
    setting: Setting,
    label: str,
    controller: ControllerParameters,
    seed: int,
    laps: int,
    scales: Sequence[float],
    until_failure: bool = True,
) -> Plan:
    """Plan that races on one day at rising scales until a race is not completed.

    If ``until_failure`` is False, it races at all scales, in parallel. Its result is a list of
    `Race`.
    """

    def steps():
        day, races = setting.day(seed), []
        for group in [[scale] for scale in scales] if until_failure else [scales]:
            controllers = [controller.with_(speed_scale=scale) for scale in group]
            jobs = [setting.job(label, scaled, day, laps) for scaled in controllers]
            results = yield jobs
            races += [Race(label, job.scale, seed, job, r) for job, r in zip(jobs, results)]
            if not results[-1].completed:
                break
        return races

    return Plan(steps(), min(len(scales), 12))


# -- tables ----------------------------------------------------------------------------------------


def race_frame(races: list[Race]) -> pd.DataFrame:
    """One row for each race, with its seed.

    Lateral errors (mean over time, and maximum) and top speed cover everything after the out-lap,
    or the out-lap if the race ended in it. The lateral acceleration of the race is exceeded 1 % of
    the time.
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
                "max_speed_mps": max((s.max_speed_mps for s in driven), default=math.nan),
                "lateral_acceleration_mps2": result.lateral_mps2,
                "duration_s": result.duration_s,
                "fingerprint": race.job.fingerprint,
            }
        )
    return _sorted(pd.DataFrame(rows))


def _over_time(values, time):
    return float(np.sum(values * time) / np.sum(time)) if time.size else math.nan


def lap_frame(races: list[Race]) -> pd.DataFrame:
    """One row for each stretch of each race, with its `LAP_COLUMNS`."""
    rows = [
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
    columns = ["speed_scale", "controller", "seed", "outcome", *LAP_COLUMNS]
    # Without any lap the column would not be boolean.
    return _sorted(pd.DataFrame(rows, columns=columns).astype({"valid": bool}))


def _sorted(frame):
    """Sorted by scale, contender, seed and lap."""
    order = {contender.label: place for place, contender in enumerate(CONTENDERS)}
    keys = [
        (row.speed_scale, order.get(row.controller, len(order)), row.seed, getattr(row, "lap", 0))
        for row in frame.itertuples()
    ]
    return frame.iloc[sorted(range(len(keys)), key=keys.__getitem__)].reset_index(drop=True)


def scaling_table(races: pd.DataFrame, laps: pd.DataFrame) -> pd.DataFrame:
    """Velocity scaling: one row for each scale and controller.

    Parameters
    ----------
    races, laps : pandas.DataFrame
        From `race_frame` and `lap_frame`.

    Returns
    -------
    pandas.DataFrame
        ``days`` and ``days_completed``; minimum, quartiles and maximum of the RMS lateral error and
        of the lap time on the days completed, the top speed, and the median of the lateral
        accelerations; NaN without any. Where ``same_speeds`` is true, the controller drives the
        speeds of the scale before, on all days: the grip limits them, not the scale.
    """
    counted = laps[(laps.outcome == "completed") & laps.valid]
    rows, before = [], {}
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
        done = group[group.outcome == "completed"]
        row["max_speed_mps"] = float(done.max_speed_mps.max())
        row["lateral_acceleration_mps2"] = float(done.lateral_acceleration_mps2.median())
        times = done.set_index("seed").mean_lap_time_s
        change = (times - before.get(label, times * math.nan)).abs()
        row["same_speeds"] = bool(len(done)) and bool((change < _SAME_LAP_S).all())
        before[label] = times
        rows.append(row)
    return pd.DataFrame(rows)


def tire_table(races: pd.DataFrame) -> pd.DataFrame:
    """Tire models: one row for each scale and controller, with the paper's columns.

    Means over days of lap time and mean lateral error, and largest lateral error, over the days
    completed or, without any, over all days up to the crash. `races` is from `race_frame`.
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
    """Number of days raced and completed, and of laps after which the others ended."""
    ended = group[group.outcome != "completed"]
    return {
        "days": len(group),
        "days_completed": len(group) - len(ended),
        "laps_until_end": " ".join(str(laps) for laps in sorted(ended.laps_completed)),
    }


def highest_scales(races: pd.DataFrame) -> pd.DataFrame:
    """Highest scale completed: a row for each seed, a column for each controller; NaN for none.

    `races` is from `race_frame`.
    """
    labels = list(dict.fromkeys(races.controller))
    completed = races[races.outcome == "completed"]
    best = completed.groupby(["seed", "controller"]).speed_scale.max()
    rows = [
        {"seed": seed, **{label: best.get((seed, label), math.nan) for label in labels}}
        for seed in sorted(set(races.seed))
    ]
    return pd.DataFrame(rows, columns=["seed", *labels])


def on_common_days(races: pd.DataFrame, first: str, second: str) -> pd.DataFrame:
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
        ``speed_scale``; number of ``days``, and of ``days_closer`` on which the first had the
        smaller RMS error; ``error_ratio`` of the mean RMS errors, first to second;
        ``gain_s`` [s] per lap.
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
        (error_a, error_b), (time_a, time_b) = (
            [frame[column].reindex(both).values.astype(float) for frame in (a, b)]
            for column in ("rms_lateral_error_m", "mean_lap_time_s")
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
