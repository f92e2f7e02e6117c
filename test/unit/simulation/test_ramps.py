"""Steering ramps without ROS."""

import dataclasses

import numpy as np
import pytest

from map_racing.bags.reader import read_recording, read_signals
from map_racing.control.steering_ramp import Phase, RampParameters
from map_racing.errors import ParameterError
from map_racing.simulation.ramps import drive_ramps
from map_racing.simulation.recorded import write_ramp_bag


def test_every_speed_and_both_sides_are_driven(ramps):
    phases = [sample.result.phase for sample in ramps.samples]
    assert phases.count(Phase.DONE) == 3 and phases[-1] is Phase.DONE
    ramping = [s for s in ramps.samples if s.result.phase is Phase.RAMPING]
    angles = np.array([s.result.steering_angle for s in ramping])
    assert angles.min() == pytest.approx(-0.4, abs=1e-3)
    assert angles.max() == pytest.approx(0.4, abs=1e-3)
    speeds = {round(float(s.result.speed), 3) for s in ramping}
    assert speeds == {2.0, 3.0, 4.0}
    t = np.array([s.measured.t for s in ramps.samples])
    assert np.all(np.diff(t) > 0.0)


def test_the_bag_holds_what_was_measured_and_commanded(ramps):
    recording = read_recording(ramps.path)
    seen = np.array([sample.measured for sample in ramps.samples])
    np.testing.assert_allclose(recording.x, seen[:, 1], atol=1e-9)
    np.testing.assert_allclose(recording.v_y, seen[:, 5], atol=1e-9)
    commands = [sample.result.steering_angle for sample in ramps.samples]
    np.testing.assert_allclose(recording.commands.steering_angle, commands, atol=1e-6)
    t, imu = read_signals(ramps.path, recording, {"imu": ""})["imu"]
    np.testing.assert_allclose(t, recording.t, atol=1e-6)
    lateral = [sample.acceleration[1] for sample in ramps.samples]
    np.testing.assert_allclose(imu["a_y"], lateral, atol=1e-9)


def test_same_seed_same_drive(ramps):
    one = RampParameters(speed_mps=1.5, rate_radps=0.2, sides="left")
    drives = [drive_ramps(ramps.parameters, [one], seed=seed) for seed in (4, 4, 5)]
    # v_y and all other values are numbers here, so that drives can be compared.
    assert drives[0] == drives[1] != drives[2]


def test_one_side(ramps):
    one = RampParameters(speed_mps=1.5, rate_radps=0.2, sides="right")
    angles = [s.result.steering_angle for s in drive_ramps(ramps.parameters, [one])]
    assert max(angles) <= 0.0 and min(angles) == pytest.approx(-0.4)


def test_refuses_what_cannot_be_driven(ramps):
    with pytest.raises(ParameterError, match="ramp at 14 m/s: the car is"):
        drive_ramps(ramps.parameters, [RampParameters(speed_mps=14.0)])


@pytest.mark.parametrize("beyond", [{"speed_mps": 40.0}, {"limit_rad": 0.5}])
def test_refuses_what_the_car_cannot_do(ramps, beyond):
    with pytest.raises(ParameterError, match=f"{next(iter(beyond))}: expected at most what NUC4"):
        drive_ramps(ramps.parameters, [RampParameters(**beyond)])


def test_progress_is_told(ramps):
    told = []
    one = RampParameters(speed_mps=1.5, rate_radps=0.2, sides="left")
    drive_ramps(ramps.parameters, [one], progress=told.append)
    assert told == sorted(told) and len(told) > 2


def test_compression_changes_nothing_but_size(ramps, tmp_path):
    short = ramps.samples[:200]
    recordings = []
    for compression in (None, "bz2"):
        path = tmp_path / f"{compression}.bag"
        write_ramp_bag(path, short, compression)
        recordings.append(dataclasses.replace(read_recording(path), source=""))
    np.testing.assert_array_equal(recordings[0].x, recordings[1].x)
    assert (tmp_path / "bz2.bag").stat().st_size < (tmp_path / "None.bag").stat().st_size
