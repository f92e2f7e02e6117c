"""A car identified from cautious laps is raced about as fast as one whose tires are known."""

import pytest

from map_racing.control.parameters import load_controller_parameters
from map_racing.experiments.jobs import RaceJob
from map_racing.experiments.laps_to_car import laps_to_car
from map_racing.simulation.plants import load_plant
from map_racing.track.files.load import load_raceline


@pytest.mark.once
def test_thirty_seconds_at_seventy_percent():
    plant = load_plant("nuc4")
    settings = load_controller_parameters("map")
    job = RaceJob("map", settings, plant.vehicle, plant, load_raceline("reference"), 1, 1)
    found = laps_to_car(job)
    assert found.outcome == found.true_outcome == "completed"
    assert abs(found.lap_s / found.true_lap_s - 1.0) < 0.02
    assert found.friction_determined and abs(found.friction - 1.0) < 0.05
    assert abs(found.delay_error_s) < 0.008
