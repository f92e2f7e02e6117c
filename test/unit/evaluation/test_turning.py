"""The path reveals wrong yaw rates."""

import dataclasses

import numpy as np
import pytest

from map_racing.bags.samples import Recording
from map_racing.evaluation.profiles import profiles_of
from map_racing.evaluation.runs import evaluate
from map_racing.evaluation.turning import speed_driven, turning_of


def changed(recording, **factors):
    values = {name: factor * getattr(recording, name) for name, factor in factors.items()}
    return dataclasses.replace(recording, **values)


@pytest.mark.parametrize(
    "factors",
    [
        pytest.param({"yaw_rate": 0.0}, id="never filled in"),
        pytest.param({"yaw_rate": 180.0 / np.pi}, id="in degrees"),
        pytest.param({"yaw_rate": -1.0}, id="to the right"),
        pytest.param({"yaw_rate": np.nan}, id="unknown"),
    ],
)
def test_a_wrong_yaw_rate_is_replaced_by_that_of_the_heading(reference, driving, factors):
    recording = driving(reference, lambda s: 3.0, laps=2)
    rate, notes = turning_of(changed(recording, **factors))
    assert rate == pytest.approx(recording.yaw_rate, abs=0.05 * np.max(np.abs(recording.yaw_rate)))
    doubtful = any(note.startswith("warning: ") for note in notes)
    assert doubtful == (abs(factors["yaw_rate"]) >= 1.0)


def test_without_either_nothing_is_said_of_accelerations_to_the_side(reference, driving):
    recording = changed(driving(reference, lambda s: 3.0, laps=2), psi=0.0, yaw_rate=180.0 / np.pi)
    run = profiles_of(recording, evaluate(recording, reference))
    (note,) = run.notes
    turned = float(note.split("the path by ")[1].split()[0])
    expected = 2.0 * np.pi * recording.t[-1] / (reference.length / 3.0)
    assert turned == pytest.approx(expected, abs=1.5)
    assert np.isnan(run.laps[0].values["a_lat"]).all()
    assert np.isfinite(run.laps[0].values["a_lon"]).all()


def test_noise_and_pauses_are_no_other_turning(reference, driving):
    recording = driving(reference, lambda s: 3.0, laps=2)
    noise = np.random.default_rng(1).normal(0.0, 0.03, (2, recording.t.size))
    later = np.where(recording.t > 5.0, 20.0, 0.0)
    x, y, t = recording.x + noise[0], recording.y + noise[1], recording.t + later
    rate, notes = turning_of(dataclasses.replace(recording, t=t, x=x, y=y))
    assert rate is recording.yaw_rate and notes == []


def test_less_than_half_a_turn_tells_nothing(reference, driving):
    recording = driving(reference, lambda s: 3.0, laps=1)
    names = ("t", "x", "y", "psi", "v_x", "v_y", "yaw_rate")
    short = {name: getattr(recording, name)[:20] for name in names}
    short["yaw_rate"] = short["yaw_rate"] + 9.0
    short = dataclasses.replace(recording, **short)
    rate, notes = turning_of(short)
    assert rate is short.yaw_rate and notes == []


@pytest.mark.parametrize("factor", [180.0 / np.pi, -1.0])
def test_a_wrong_rate_is_told_on_a_figure_eight_too(factor):
    """Its laps turn by zero in total."""
    recording = figure_eight()
    rate, notes = turning_of(changed(recording, yaw_rate=factor))
    assert np.array_equal(rate, recording.yaw_rate)
    (note,) = notes
    turned, path = (float(part.split(" rad")[0]) for part in note.split(" by ")[1:])
    assert note.startswith("warning: ") and turned == pytest.approx(factor * path, rel=0.05)


def test_a_heading_that_was_never_filled_in_is_told_on_a_figure_eight():
    recording = changed(figure_eight(), yaw_rate=np.nan, psi=0.0)
    rate, notes = turning_of(recording)
    assert np.isnan(rate).all() and "recorded heading does not change" in notes[0]


def test_a_rate_that_was_never_filled_in_is_told_on_a_figure_eight_too():
    recording = figure_eight()
    rate, notes = turning_of(changed(recording, yaw_rate=0.0))
    assert np.array_equal(rate, recording.yaw_rate)
    assert notes == ["the recorded yaw rate does not change: the rate of the heading is used"]
    rate, notes = turning_of(recording)
    assert rate is recording.yaw_rate and notes == []


def figure_eight():
    """Two laps of a figure eight."""
    t = np.arange(0.0, 20.0, 0.02)
    phase = 2.0 * np.pi * t / 10.0
    x, y = 5.0 * np.sin(phase), 2.5 * np.sin(2.0 * phase)
    psi = np.arctan2(np.gradient(y, t), np.gradient(x, t))
    turning = np.gradient(np.unwrap(psi), t)
    v = np.hypot(np.gradient(x, t), np.gradient(y, t))
    return Recording(t, x, y, psi, v, 0.0 * v, turning)


@pytest.mark.parametrize("factor", [0.0, 1.0, 1.12, 3.6])
def test_a_speed_that_is_not_the_motion_of_the_poses_is_not_used(reference, driving, factor):
    recording = driving(reference, lambda s: 3.0, laps=1)
    v, measured = speed_driven(changed(recording, v_x=factor, v_y=factor))
    assert v == pytest.approx(3.0, abs=0.02) and measured == (factor == 1.0)
