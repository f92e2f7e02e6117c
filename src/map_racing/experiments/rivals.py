"""MAP against model predictive control: the same car, days, delay, search and speeds."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pandas as pd

from ..vehicle.parameters import scaled_tires
from .campaign import Plan
from .paper import Contender, Race

__all__ = ["BELIEFS", "RIVALS", "sensitivity_frame", "sensitivity_plan", "work_frame"]

# All are tuned by the same search on the same practice days, two parameters each.
RIVALS = (
    Contender("MAP Pacejka", "map_paper", True),
    Contender("MAP default", "map", True),
    Contender("MPC kinematic", "mpc_kinematic", True),
    Contender("MPC single-track", "mpc_single_track", True),
)

# Wrong beliefs of the controllers: name, additional delay [s], and factors on friction and
# stiffness.
BELIEFS = (
    ("as identified", 0.0, 1.0, 1.0),
    ("delay + 20 ms", 0.02, 1.0, 1.0),
    ("delay - 20 ms", -0.02, 1.0, 1.0),
    ("friction x 1.1", 0.0, 1.1, 1.0),
    ("friction x 0.9", 0.0, 0.9, 1.0),
    ("stiffness x 1.2", 0.0, 1.0, 1.2),
    ("stiffness x 0.8", 0.0, 1.0, 0.8),
)


def sensitivity_plan(setting, label, controller, seed, laps, scales):
    """Plan that races on one day at one speed with each of the `BELIEFS`.

    Its result is a list of (belief, Race). A controller without delay compensation skips the
    beliefs about delay.

    Parameters
    ----------
    setting : Setting
    label : str
        Name of the controller in the results.
    controller : ControllerParameters
    seed : int
        Of the day.
    laps : int
    scales : sequence of float
        The first is the scale of the speeds [-].

    Returns
    -------
    Plan
    """

    def steps():
        day, jobs, names = setting.day(seed), [], []
        for name, delay, mu, stiffness in BELIEFS:
            if delay and not controller.delay_s:
                continue
            given = controller.with_(
                speed_scale=scales[0], delay_s=max(controller.delay_s + delay, 0.0)
            )
            job = setting.job(label, given, day, laps)
            jobs.append(replace(job, vehicle=scaled_tires(job.vehicle, mu, stiffness, stiffness)))
            names.append(name)
        results = yield jobs
        return [
            (name, Race(label, scales[0], seed, job, result))
            for name, job, result in zip(names, jobs, results)
        ]

    return Plan(steps(), len(BELIEFS))


def sensitivity_frame(races):
    """One row for each controller and belief: days, days completed, median RMS error [m], lap [s].

    Parameters
    ----------
    races : list of (str, Race)
        From `sensitivity_plan`.
    """
    rows = []
    for label in dict.fromkeys(race.label for _, race in races):
        for belief, *_ in BELIEFS:
            own = [race.result for name, race in races if (name, race.label) == (belief, label)]
            if not own:
                continue
            done = [result for result in own if result.completed]
            laps = [lap for result in done for lap in result.laps]
            rows.append(
                {
                    "controller": label,
                    "belief": belief,
                    "days": len(own),
                    "days_completed": len(done),
                    "median_rms_lateral_error_m": _median(lap.rms_lateral_error_m for lap in laps),
                    "median_lap_time_s": _median(lap.lap_time_s for lap in laps),
                }
            )
    return pd.DataFrame(rows)


def work_frame(races, controllers, tuned, memory):
    """One row for each controller: what it costs to compute and to tune.

    Parameters
    ----------
    races : list of Race
        With a ``slowdown``.
    controllers : dict of str to ControllerParameters or MpcParameters
    tuned : dict of str to Tuned
    memory : dict of str to float
        Largest memory of a process that races with it [MB].

    Returns
    -------
    pandas.DataFrame
        Processor time of a step in milliseconds (median over races of the median and the 99th
        percentile, and the largest 99th percentile), shares of steps failed and late, memory,
        parameters of the controller, and races driven to tune two of them.
    """
    rows = []
    for label, controller in controllers.items():
        work = [r.result.work for r in races if r.label == label and r.result.work]
        steps = max(sum(each.steps for each in work), 1)
        rows.append(
            {
                "controller": label,
                "median_step_ms": 1e3 * _median(each.median_s for each in work),
                "p99_step_ms": 1e3 * _median(each.p99_s for each in work),
                "worst_p99_step_ms": 1e3 * max([each.p99_s for each in work] or [math.nan]),
                "failed_share": sum(each.failed for each in work) / steps,
                "late_share": sum(each.late for each in work) / steps,
                "memory_mb": memory.get(label, math.nan),
                "parameters": _numbers(controller),
                "tuning_races": tuned[label].races if label in tuned else 0,
            }
        )
    return pd.DataFrame(rows)


def _numbers(controller):
    """Number of a controller's parameters, without those of the speeds, which all have."""
    speeds = ("speed_lookahead_s", "speed_scale", "v_max_mps", "grip_use")
    speeds += ("a_drive_max_mps2", "a_brake_max_mps2")
    names = [f.name for f in fields(controller) if f.name not in speeds]
    return sum(isinstance(getattr(controller, name), (int, float)) for name in names)


def _median(values):
    values = list(values)
    return float(np.median(values)) if values else math.nan
