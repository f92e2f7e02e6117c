import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from map_racing.experiments.driving_data import load_run
from map_racing.experiments.ramp_drive import drive_ramps, write_ramp_bag
from map_racing.experiments.steering_ramp import RampParameters
from map_racing.simulation.plant import load_plant_parameters
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.tires import PacejkaTire

SPEEDS = (2.0, 3.0, 4.0)


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
