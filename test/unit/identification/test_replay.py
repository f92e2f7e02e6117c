"""Open-loop replay: the true car reproduces the recording, another one drifts off."""

import dataclasses
import json

import numpy as np
import pytest
from driven_laps import QUIET, laps_of

from map_racing.errors import IdentificationError, ParameterError
from map_racing.identification.car import identify_car
from map_racing.identification.channels import load_channel_map
from map_racing.identification.data import Signal, load_run
from map_racing.identification.replay import (
    actuators_of,
    replay,
    replay_data,
    replay_lines,
)
from map_racing.vehicle.parameters import load_vehicle, scaled_tires


@pytest.fixture(scope="module")
def quiet():
    """Laps without noise, the true car, and its actuators as fitted to them."""
    run, true = laps_of(0.7, **QUIET)
    return run, true, actuators_of([run], true)


def test_without_commands_the_usual_delays_are_not_called_fitted(quiet):
    run, true, actuators = quiet
    assert actuators.fitted
    signals = {key: signal for key, signal in run.signals.items() if key != "steering"}
    assert not actuators_of([dataclasses.replace(run, signals=signals)], true).fitted


def test_delays_with_the_tires_held(quiet):
    _, _, actuators = quiet
    assert actuators.delay == pytest.approx(0.05, abs=0.002)
    assert actuators.share == pytest.approx(0.6, abs=0.05)
    np.testing.assert_allclose(actuators.drive[:2], (0.02, 0.1), atol=0.005)


def test_the_true_car_does_what_was_recorded(quiet):
    run, true, actuators = quiet
    found = replay(true, [run], actuators)
    (only,) = found.runs
    assert only.windows >= 7 and not found.refused
    assert set(only.channels) == {"yaw rate", "lateral acceleration", "speed", "lateral drift"}
    assert found.worst[0] is only and only.channels[found.worst[1]].share < 0.025
    assert only.channels["yaw rate"].share < 0.01
    assert only.channels["lateral drift"].rms < 0.02


def test_another_car_does_not(quiet):
    run, true, actuators = quiet
    softer = scaled_tires(true, 1.0, 0.85, 1.0)
    errors = [
        replay(car, [run], actuators, length).runs[0].channels
        for car, length in ((true, 2.0), (softer, 1.0), (softer, 2.0))
    ]
    for name in ("yaw rate", "lateral acceleration", "lateral drift"):
        assert errors[2][name].share > 2.0 * errors[0][name].share
    # There is no feedback: a car that turns too wide drifts farther and farther.
    assert errors[2]["lateral drift"].rms > 2.0 * errors[1]["lateral drift"].rms


def test_drift_is_measured_across_where_the_car_was(quiet):
    """Poses that turn away by a known angle per second: after 2 s they are off to the side."""
    run, true, actuators = quiet
    t, v = run.signals["v_x"]
    # A straight drive at 3 m/s with zero steering, seen by a localization that drifts to the left.
    speed, side = 3.0, 0.1
    signals = {
        "x": Signal(t, speed * t),
        "y": Signal(t, side * t),
        "psi": Signal(t, 0.0 * t),
        "v_x": Signal(t, np.full(t.size, speed)),
        "yaw_rate": Signal(t, 0.0 * t),
        "steering": Signal(t, 0.0 * t),
    }
    straight = dataclasses.replace(run, signals=signals)
    (only,) = replay(true, [straight], actuators).runs
    drift = only.channels["lateral drift"]
    assert drift.rms == pytest.approx(2.0 * side, rel=0.01)
    assert drift.share == pytest.approx(side / speed, rel=0.02)
    assert "speed" not in only.channels and "speed as measured" in only.notes[0]


def test_worst_of_several_runs_is_the_headline(quiet):
    run, true, actuators = quiet
    t, r = run.signals["yaw_rate"]
    wrong = dataclasses.replace(
        run, name="x/wrong.bag", signals={**run.signals, "yaw_rate": Signal(t, 1.1 * r)}
    )
    standing = {name: Signal(s.t, 0.0 * s.value) for name, s in run.signals.items()}
    still = dataclasses.replace(run, name="x/still.bag", signals=standing)
    found = replay(true, [run, wrong, still], actuators)
    assert found.worst[0].label == "x/wrong.bag"
    assert [label for label, _ in found.refused] == ["x/still.bag"]
    text, data = "\n".join(replay_lines(found)), replay_data(found)
    assert "x/wrong.bag" in text.splitlines()[0] and "windows of 2 s" in text.splitlines()[0]
    assert "x/still.bag: not replayed: the car never drove" in text
    assert json.loads(json.dumps(data, allow_nan=False))["worst_run"] == "x/wrong.bag"
    assert data["worst_share"] == max(
        channel["share"] for run in data["runs"] for channel in run["channels"].values()
    )
    with pytest.raises(IdentificationError, match="no run to replay: x/still.bag"):
        replay(true, [still], actuators)
    with pytest.raises(ParameterError, match="--window"):
        replay(true, [run], actuators, 0.0)


def test_pieces_with_a_command_to_stop_are_left_out(quiet):
    """At a command of 0 m/s a car may brake or roll; the log does not show which."""
    run, true, actuators = quiet
    t, speed = run.signals["speed_command"]
    stop = Signal(t, np.where(t < 12.0, speed, 0.0))
    stopped = dataclasses.replace(run, signals={**run.signals, "speed_command": stop})
    (only,) = replay(true, [stopped], actuators).runs
    assert only.windows <= 5 and only.channels["speed"].share < 0.01
    assert any("s with a speed command of 0 left out" in note for note in only.notes)


def test_what_is_beyond_the_identified_tires_is_said(quiet):
    run, true, actuators = quiet
    least, most = replay(true, [run], actuators, reached=2.0), replay(true, [run], actuators)
    assert any("% of the driving is beyond the 2.00 m/s^2" in note for note in least.runs[0].notes)
    assert not most.runs[0].notes


@pytest.mark.once
def test_a_real_car_from_its_other_circles(shared_data):
    channels = load_channel_map("circles_log")
    folder = shared_data / "tyre_id"
    names = ("circles_055329", "circles_055502", "circles_055600", "circles_061435")
    runs = [load_run(folder / name / "cmd.csv", channels) for name in names]
    base = dataclasses.replace(load_vehicle("nuc4"), m=3.548, I_z=0.06, l_f=0.16, l_r=0.16)
    car = identify_car(runs[:-1], base, fix=True)
    held = dataclasses.replace(runs[-1], setup=car.setup)
    (only,) = replay(car.vehicle, [held], actuators_of(car.runs, car.vehicle)).runs
    assert only.windows >= 12
    for name, most in (("yaw rate", 0.08), ("lateral acceleration", 0.1), ("speed", 0.02)):
        assert only.channels[name].share < most
    assert only.channels["lateral drift"].share < 0.05
