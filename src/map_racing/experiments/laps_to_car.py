"""From cautious laps to a race at the limit: the value of identification from laps.

A car is driven at reduced speed with the tires of its file, identified from half a minute of laps,
and raced with the result and, for comparison, with its true tires and delay.
"""

from __future__ import annotations

import dataclasses
import math
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..identification.car import identify_car
from ..identification.data import Run, Signal, load_run
from ..vehicle.parameters import Vehicle
from .jobs import RaceJob, execute
from .robustness import Grid, load_robustness

__all__ = ["Found", "at_the_limit", "laps_to_car", "nine_cars", "truth"]

CAUTIOUS, SECONDS, LAPS, GRIP_USE = 0.7, 30.0, 3, 0.95
FASTEST_MPS = 8.0


class Found(NamedTuple):
    """Result of an identification, and of the races with it and with the truth.

    Parameters
    ----------
    outcome, true_outcome : str
    lap_s, true_lap_s : float
        Mean laps [s]; NaN if none counts.
    friction, front, rear : float
        Identified over true value: friction, and cornering stiffness of both axles including
        friction.
    friction_determined : bool
    delay_error_s : float
        Error of ``delay_s``; NaN if it was not determined.
    """

    outcome: str
    true_outcome: str
    lap_s: float
    true_lap_s: float
    friction: float
    front: float
    rear: float
    friction_determined: bool
    delay_error_s: float


def nine_cars(tracks: list[str], generated_seeds: list[int], seed: int) -> Grid:
    """The cars of the robustness grid derived from ``nuc4``, on given tracks.

    Parameters
    ----------
    tracks : list of str
        Names or files.
    generated_seeds : list of int
        More tracks.
    seed : int
        Of the noise.
    """
    shipped = load_robustness("robustness")
    cars = {name: values for name, values in shipped.cars.items() if "plant" not in values}
    given = dict(cars=cars, tracks=tracks, generated_seeds=generated_seeds, seed=seed)
    return Grid(dataclasses.replace(shipped, **given))


def truth(job: RaceJob) -> tuple[Vehicle, float]:
    """The controller's vehicle with the true tires of a job's plant, and its true ``delay_s``."""
    plant = job.plant
    tires = plant.build_vehicle()
    vehicle = dataclasses.replace(job.vehicle, mu=tires.mu, front=tires.front, rear=tires.rear)
    delay = plant.localization_latency_s + plant.steering_delay_s + plant.steering_time_constant_s
    return vehicle, delay


def at_the_limit(job: RaceJob, vehicle: Vehicle, delay_s: float) -> RaceJob:
    """The race of a job whose controller uses these tires and this delay."""
    settings = job.controller.with_(speed_scale=1.0, grip_use=GRIP_USE, delay_s=delay_s)
    return dataclasses.replace(job, controller=settings, vehicle=vehicle, laps=LAPS)


def laps_to_car(job: RaceJob) -> Found:
    """Identify a car from laps at 70 % of the speed, and race it at the raceline's speeds.

    Parameters
    ----------
    job : RaceJob
        Car, track, controller and its initial model of the car; its scale and number of laps do not
        matter.
    """
    run = _cautious_laps(job)
    laps = identify_car([run], job.vehicle).laps
    delay = laps.delays.delay.value
    true, true_delay = truth(job)
    races = []
    for vehicle, delay_s in (
        (laps.vehicle, job.controller.delay_s if delay is None else delay),
        (true, true_delay),
    ):
        result = execute(at_the_limit(job, vehicle, delay_s)).result
        times = [lap.lap_time_s for lap in result.laps]
        races.append((result.outcome, float(np.mean(times)) if times else math.nan))
    found = laps.vehicle
    stiffness = [
        found.mu * getattr(found, axle).stiffness / (true.mu * getattr(true, axle).stiffness)
        for axle in ("front", "rear")
    ]
    return Found(
        races[0][0],
        races[1][0],
        races[0][1],
        races[1][1],
        found.mu / true.mu,
        *stiffness,
        laps.parameters["friction"].determined,
        math.nan if delay is None else delay - true_delay,
    )


def _cautious_laps(job: RaceJob) -> Run:
    """Half a minute of laps, from their bag."""
    settings = job.controller.with_(speed_scale=CAUTIOUS)
    laps = math.ceil(SECONDS * FASTEST_MPS * CAUTIOUS / job.raceline.length)
    driven = dataclasses.replace(job, controller=settings, laps=laps)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "laps.bag"
        path.write_bytes(execute(driven, bag=True).bag)
        run = load_run(path)
    end = run.signals["x"].t[0] + SECONDS
    cut = {
        name: Signal(signal.t[signal.t < end], signal.value[signal.t < end])
        for name, signal in run.signals.items()
    }
    return dataclasses.replace(run, signals=cut)
