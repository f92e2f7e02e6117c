"""A controller that learns comes near one that knows the tires."""

import dataclasses

import pytest

from map_racing.control.parameters import load_controller_parameters
from map_racing.experiments.cold_start import cold_start, loss_of_grip
from map_racing.experiments.jobs import RaceJob
from map_racing.simulation.plants import load_plant
from map_racing.track.files.load import load_raceline


@pytest.fixture(scope="module")
def job():
    plant, settings = load_plant("nuc4"), load_controller_parameters("map")
    return RaceJob("map", settings, plant.vehicle, plant, load_raceline("reference"), 1, 1)


@pytest.fixture(scope="module")
def found(job):
    return cold_start(job)


def test_the_last_lap_of_a_cold_start_is_beside_one_that_was_told(found):
    assert found.outcome == "completed"
    assert abs(found.slower) < 0.03 and found.slower == found.lap_s / found.told_lap_s - 1.0
    assert 0.0 < found.error_m < 0.1 and found.clearance_m > 0.3


@pytest.mark.once
def test_after_a_loss_of_grip_laps_are_those_of_less_grip(job, found):
    lost, told_before = loss_of_grip(job), found.told_lap_s
    assert lost.outcome == "completed" and lost.told_lap_s > 1.05 * told_before
    assert abs(lost.slower) < 0.02
    # No controller could cope with losing nearly all friction.
    assert loss_of_grip(job, factor=0.15).outcome != "completed"


def test_a_race_that_ends_before_the_lap_gives_no_figures(job):
    plant = dataclasses.replace(job.plant, mu_scale=0.15)
    found = loss_of_grip(dataclasses.replace(job, plant=plant))
    assert found.outcome != "completed" and found.lap_s != found.lap_s
