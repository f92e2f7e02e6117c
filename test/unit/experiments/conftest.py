"""Races that take a few hundredths of a second, and steering ramps."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from map_racing.control.parameters import load_controller_parameters
from map_racing.experiments.conditions import load_plant
from map_racing.experiments.driving_data import load_run
from map_racing.experiments.jobs import RaceJob
from map_racing.experiments.ramp_drive import drive_ramps, write_ramp_bag
from map_racing.experiments.steering_ramp import RampParameters
from map_racing.simulation.plant import load_plant_parameters
from map_racing.track.raceline import Raceline
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.tires import PacejkaTire

SPEEDS = (2.0, 3.0, 4.0)


@pytest.fixture(scope="session")
def ring():
    """A circle of 1.5 m radius between walls, at 3.2 m/s."""
    angle = 2.0 * np.pi * np.arange(60) / 60
    half = np.full(60, 0.4)
    return Raceline(
        *(1.5 * np.cos(angle), 1.5 * np.sin(angle)),
        vx_mps=np.full(60, 3.2),
        d_left_m=half,
        d_right_m=half,
        name="ring",
    )


@pytest.fixture(scope="session")
def job_of(ring):
    """Make a job; what is not given is that of a race that is completed."""
    plant, vehicle = load_plant("nuc4"), load_vehicle("nuc4")
    controller = load_controller_parameters("map_paper").with_(m_m=0.3, q_s=0.1)

    def make(scale=0.7, seed=1, laps=1, **changes):
        values = {
            "name": "MAP",
            "controller": controller.with_(speed_scale=scale),
            "vehicle": vehicle,
            "plant": plant,
            "raceline": ring,
            "laps": laps,
            "seed": seed,
        }
        values.update(changes)
        return RaceJob(**values)

    return make


def moderate(vehicle):
    """The car on tires that are neither its own nor the plant's."""
    return dataclasses.replace(
        vehicle,
        name="base",
        front=PacejkaTire(6.0, 1.3, 1.0, 0.0),
        rear=PacejkaTire(8.0, 1.3, 1.0, 0.0),
    )


@pytest.fixture(scope="session")
def ramps(tmp_path_factory):
    """Ramps of the shipped plant, with its noise and delays, as samples, as bag and as run."""
    parameters = load_plant_parameters("nuc4")
    samples = drive_ramps(parameters, [RampParameters(speed_mps=v) for v in SPEEDS], seed=5)
    path = tmp_path_factory.mktemp("ramps") / "ramps.bag"
    write_ramp_bag(path, samples)
    return SimpleNamespace(
        parameters=parameters,
        samples=samples,
        path=path,
        run=load_run(path),
        true=parameters.build_vehicle(),
        base=moderate(load_vehicle("nuc4")),
    )


@pytest.fixture(scope="session")
def curve_error():
    """Largest error of an identified axle over the covered slip, as a share of the true peak."""

    def error(found, true, axle):
        fit, tire = getattr(found, axle), getattr(true, axle)
        slip = np.linspace(0.0, fit.covered_slip, 300)
        expected = true.mu * tire.normalized_force(slip)
        return float(
            np.max(np.abs(fit.tire.normalized_force(slip) - expected)) / (true.mu * tire.peak)
        )

    return error
