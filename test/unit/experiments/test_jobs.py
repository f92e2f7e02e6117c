"""A race as a job: the result depends only on the description."""

import dataclasses
import math
import pickle
import re
from pathlib import Path

import numpy as np
import pytest

from map_racing.bags.reader import read_recording
from map_racing.control.parameters import load_controller_parameters
from map_racing.errors import MapRacingError
from map_racing.evaluation import laps
from map_racing.evaluation.runs import evaluate
from map_racing.experiments import jobs
from map_racing.experiments.jobs import code_fingerprint, execute, fingerprint
from map_racing.simulation.plants import load_plant
from map_racing.simulation.recorded import GROUND_TRUTH_TOPIC
from map_racing.track.raceline import Raceline


def test_the_same_job_gives_the_same_result_wherever_it_goes(job_of):
    job = job_of(laps=2)
    travelled = pickle.loads(pickle.dumps(job))
    assert travelled.fingerprint == job.fingerprint
    first, second = execute(job, path=True), execute(travelled, path=True)
    assert repr(first.result) == repr(second.result)  # NaN is not equal to itself
    assert first.result.completed and len(first.result.laps) == 2
    assert first.code == code_fingerprint() and first.bag is None
    assert repr(pickle.loads(pickle.dumps(first)).result) == repr(first.result)


def test_all_that_measures_a_lap_is_in_the_fingerprint():
    """Otherwise results measured differently would be found on disk."""
    imports = re.findall(r"^from \.(\w+) import", Path(laps.__file__).read_text(), re.MULTILINE)
    assert "statistics" in imports
    assert {f"evaluation/{name}.py" for name in imports} <= set(jobs._DECISIVE)


def test_lateral_acceleration_is_that_of_the_circle(job_of):
    radius, v = 3.0, 3.0
    angle = np.arange(200) * 2.0 * np.pi / 200
    circle = Raceline(radius * np.cos(angle), radius * np.sin(angle), vx_mps=np.full(200, v))
    controller = load_controller_parameters("map").with_(speed_scale=1.0)
    noise = ("position_noise_m", "heading_noise_rad", "velocity_noise_mps", "yaw_rate_noise_radps")
    plant = dataclasses.replace(load_plant("nuc4"), **dict.fromkeys(noise, 0.0))
    result = execute(job_of(raceline=circle, controller=controller, plant=plant)).result
    assert result.lateral_mps2 == pytest.approx(v**2 / radius, rel=0.05)


def test_all_that_decides_is_in_the_fingerprint(job_of, ring):
    job = job_of()
    slower = Raceline(
        *(ring.x, ring.y), vx_mps=0.99 * ring.speed, d_left_m=ring.d_left, d_right_m=ring.d_right
    )
    open_ = Raceline(ring.x, ring.y, vx_mps=ring.speed)
    plant, vehicle = job.plant, job.vehicle
    front = dataclasses.replace(vehicle.front, B=vehicle.front.B * (1.0 + 1e-12))
    others = [
        job_of(scale=0.7 + 1e-12),
        job_of(seed=2),
        job_of(laps=2),
        job_of(controller=job.controller.with_(m_m=0.31)),
        job_of(controller=job.controller.with_(steering_map="linear_table")),
        job_of(vehicle=dataclasses.replace(vehicle, front=front)),
        job_of(plant=dataclasses.replace(plant, mu_scale=0.99)),
        job_of(plant=dataclasses.replace(plant, vehicle=dataclasses.replace(vehicle, m=3.4))),
        job_of(plant=load_plant("public_simulator")),
        job_of(raceline=slower),
        job_of(raceline=open_),
    ]
    prints = [other.fingerprint for other in [job, *others]]
    assert len(set(prints)) == len(prints)
    assert job_of(name="another name").fingerprint == job.fingerprint
    assert job_of().fingerprint == job.fingerprint


def test_what_has_no_fingerprint_is_refused():
    with pytest.raises(MapRacingError, match="no fingerprint of object"):
        fingerprint({"a": [object()]})


def test_laps_are_those_of_the_true_path_in_the_bag(job_of, tmp_path):
    job = job_of(laps=2)
    executed = execute(job, path=True, bag=True)
    (tmp_path / "race.bag").write_bytes(executed.bag)
    recording = read_recording(tmp_path / "race.bag", GROUND_TRUTH_TOPIC)
    counted = [lap for lap in evaluate(recording, job.raceline).laps if lap.valid]
    assert len(counted) == len(executed.result.laps) == 2
    for lap, own in zip(counted, executed.result.laps):
        assert lap.lap_time_s == pytest.approx(own.lap_time_s, abs=1e-6)
        assert lap.rms_lateral_error_m == pytest.approx(own.rms_lateral_error_m, abs=1e-6)
        assert lap.max_abs_lateral_error_m == pytest.approx(own.max_abs_lateral_error_m, abs=1e-6)
    path = np.array(executed.result.path)
    np.testing.assert_allclose(path[:, 1], recording.x, atol=1e-9)
    assert execute(job).result.path == ()


def test_a_crash_is_a_result(job_of):
    job = job_of(scale=1.9)
    result = execute(job).result
    assert (result.outcome, result.completed, result.laps) == ("crashed", False, [])
    (only,) = result.stretches
    assert (only.lap, only.valid) == (0, False) and math.isnan(only.lap_time_s)
    assert only.max_abs_lateral_error_m > 0.2


def test_the_public_simulator_drives_the_car_it_is_given(job_of):
    sim = load_plant("public_simulator")
    controller = job_of().controller.with_(reference_point="center_of_gravity")
    slippery = dataclasses.replace(sim, mu_scale=0.5)
    results = [
        execute(job_of(plant=plant, vehicle=sim.vehicle, controller=controller, seed=seed)).result
        for plant, seed in ((sim, 1), (sim, 2), (slippery, 1))
    ]
    assert all(result.completed for result in results)
    first, another_seed, with_less_grip = map(repr, results)
    assert first == another_seed != with_less_grip  # this plant has no noise


def test_files_are_named_for_people(job_of):
    job = job_of(scale=0.825, seed=12, name="pure pursuit")
    assert job.file_stem == f"pure_pursuit_082.5_seed12_{job.fingerprint[:6]}"
