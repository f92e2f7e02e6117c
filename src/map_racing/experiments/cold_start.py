"""The value of adaptation: a race at the limit that begins with the tires of the vehicle file.

It is compared with a controller that knows the car's true tires and delay.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from ..control.parameters import load_controller_parameters
from .jobs import RaceJob, RaceResult, execute
from .laps_to_car import at_the_limit, truth

__all__ = ["Learned", "cold_start", "loss_of_grip"]

CONTROLLER, LAPS = "map_adaptive", 6
# The lap in which the grip is lost, and the one that is compared.
LOST_IN, COMPARED = 2, 4


class Learned(NamedTuple):
    """A race of the controller that learns, compared with one that knows the tires.

    Parameters
    ----------
    outcome : str
    lap_s, told_lap_s : float
        The lap compared, and the mean lap of the controller that knows the tires [s]; NaN if none
        counts.
    error_m : float
        Largest distance from the raceline [m].
    clearance_m : float
        Least distance to a wall [m]; NaN where none are known.
    """

    outcome: str
    lap_s: float
    told_lap_s: float
    error_m: float
    clearance_m: float

    @property
    def slower(self) -> float:
        """Relative increase of the lap time."""
        return self.lap_s / self.told_lap_s - 1.0


def cold_start(job: RaceJob) -> Learned:
    """Race six laps at the raceline's speeds, and compare the last one.

    Parameters
    ----------
    job : RaceJob
        Car, track, seed, initial tires, and the controller that knows the true ones; its scale and
        number of laps do not matter.
    """
    return _compared(execute(_learning(job, LAPS)).result, LAPS, job)


def loss_of_grip(job: RaceJob, factor: float = 0.8, at: float = 0.5) -> Learned:
    """Lose a share of the friction in the second lap, and compare the fourth.

    Parameters
    ----------
    job : RaceJob
        As for `cold_start`.
    factor : float
        On the friction.
    at : float
        Place of the loss, as a share of the lap.
    """
    plant = job.plant
    before = execute(_learning(job, LOST_IN)).result
    lost = before.laps[LOST_IN - 1] if len(before.laps) >= LOST_IN else None
    if lost is None:
        return _compared(before, COMPARED, job)
    change = {"factor": factor, "after_s": lost.start_time_s + at * lost.lap_time_s}
    changed = dataclasses.replace(plant, grip_changes=(change,))
    weak = dataclasses.replace(plant, mu_scale=factor * plant.mu_scale)
    result = execute(_learning(dataclasses.replace(job, plant=changed), COMPARED)).result
    return _compared(result, COMPARED, dataclasses.replace(job, plant=weak))


def _learning(job, laps):
    """The race of the controller that learns."""
    settings = load_controller_parameters(CONTROLLER).with_(
        speed_scale=1.0, reference_point=job.controller.reference_point
    )
    return dataclasses.replace(job, name=CONTROLLER, controller=settings, laps=laps)


def _compared(result: RaceResult, lap: int, job: RaceJob) -> Learned:
    """Compare lap `lap` of a race with those of a controller that knows the job's car."""
    informed = [own.lap_time_s for own in execute(at_the_limit(job, *truth(job))).result.laps]
    found = [own.lap_time_s for own in result.laps][lap - 1 : lap]
    return Learned(
        result.outcome,
        found[0] if found else math.nan,
        float(np.mean(informed)) if informed else math.nan,
        max((part.max_abs_lateral_error_m for part in result.stretches), default=math.nan),
        min((part.min_clearance_m for part in result.stretches), default=math.nan),
    )
