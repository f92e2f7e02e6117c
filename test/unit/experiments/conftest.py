"""Races that take a few hundredths of a second."""

import numpy as np
import pytest

from map_racing.control.parameters import load_controller_parameters
from map_racing.experiments.conditions import load_plant
from map_racing.experiments.jobs import RaceJob
from map_racing.track.raceline import Raceline
from map_racing.vehicle.parameters import load_vehicle


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
