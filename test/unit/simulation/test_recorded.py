"""The bag of a simulated race contains the race."""

import numpy as np
import pytest

from map_racing.bags.reader import read_recording
from map_racing.bags.records import BagFile
from map_racing.bags.samples import SIMULATED_NS
from map_racing.control.controller import build_controller
from map_racing.control.parameters import load_controller_parameters
from map_racing.evaluation.recordings import recorded_raceline
from map_racing.evaluation.runs import evaluate
from map_racing.simulation.plant import Localization, Plant
from map_racing.simulation.plants import load_plant
from map_racing.simulation.race import Outcome, race
from map_racing.simulation.recorded import GROUND_TRUTH_TOPIC, write_race_bag
from map_racing.track.files.load import load_raceline
from map_racing.vehicle.parameters import load_vehicle


@pytest.fixture(scope="module")
def raced():
    raceline, plant = load_raceline("reference"), load_plant("nuc4")
    parameters = load_controller_parameters("map").with_(speed_scale=0.7)
    controller = build_controller(parameters, load_vehicle("nuc4"), raceline)
    log = race(Plant(plant), controller, raceline, Localization(plant, 1), laps=1)
    assert log.outcome is Outcome.COMPLETED
    return raceline, log


@pytest.mark.parametrize("compression", [None, "lz4", "bz2"])
def test_recording_is_what_was_measured_and_commanded(raced, tmp_path, compression):
    raceline, log = raced
    write_race_bag(tmp_path / "race.bag", log, raceline, compression=compression)
    recording = read_recording(tmp_path / "race.bag")
    assert recording.topic == "/car_state/odom" and recording.t0_ns == SIMULATED_NS
    seen = np.array([sample.measured for sample in log.samples])
    columns = (recording.t, recording.x, recording.y, recording.v_x, recording.v_y)
    for column, expected in zip(columns, seen[:, [0, 1, 2, 4, 5]].T):
        np.testing.assert_allclose(column, expected, atol=1e-9)
    angles = [sample.result.steering_angle for sample in log.samples]
    np.testing.assert_allclose(recording.commands.steering_angle, angles, atol=1e-7)
    # A command cannot precede the pose that it answers.
    assert np.all(recording.commands.t >= recording.t + 0.02 - 1e-9)


def test_records_bear_the_time_of_arrival(raced, tmp_path):
    raceline, log = raced
    write_race_bag(tmp_path / "race.bag", log, raceline)
    arrivals = [SIMULATED_NS + round(sample.arrival * 1e9) for sample in log.samples]
    with BagFile(tmp_path / "race.bag") as bag:
        times = {}
        for message in bag.messages():
            times.setdefault(bag.connections[message.connection].topic, []).append(message.time_ns)
    del times["/global_waypoints"]
    assert len(times) == 6 and all(column == arrivals for column in times.values())


def test_truth_and_raceline_are_in_it(raced, tmp_path):
    raceline, log = raced
    write_race_bag(tmp_path / "race.bag", log, raceline)
    truth = read_recording(tmp_path / "race.bag", GROUND_TRUTH_TOPIC)
    np.testing.assert_allclose(truth.x, log.true_path()[:, 1], atol=1e-9)
    read = load_raceline(tmp_path / "race.bag")
    assert read.length == pytest.approx(raceline.length, abs=1e-4)
    feet = [raceline.project(x, y).d for x, y in zip(read.x.tolist(), read.y.tolist())]
    assert np.abs(feet).max() < 1e-5


def test_laps_of_the_bag_are_those_of_the_race(raced, tmp_path):
    raceline, log = raced
    write_race_bag(tmp_path / "race.bag", log, raceline)
    recording = read_recording(tmp_path / "race.bag", GROUND_TRUTH_TOPIC)
    summary = evaluate(recording, recorded_raceline(recording)).summary
    assert summary.laps_completed == log.laps == 1
    truth = log.true_path()
    offset = np.array([raceline.project(x, y).d for x, y in truth[:, 1:3].tolist()])
    assert summary.max_abs_lateral_error_m <= np.abs(offset).max() + 1e-3
