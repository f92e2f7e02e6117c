"""Closed loops: laps, crashes, stalls, timing, and the benefit of the compensation."""

import dataclasses
import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pytest

from map_racing.control.controller import Controller, build_controller
from map_racing.control.parameters import load_controller_parameters
from map_racing.control.speed_sectors import SpeedSectors
from map_racing.control.steering import build_steering_map
from map_racing.errors import ParameterError
from map_racing.evaluation.laps import LapEvaluator
from map_racing.simulation.plant import (
    Localization,
    Plant,
    PlantParameters,
)
from map_racing.simulation.plants import load_plant
from map_racing.simulation.public_simulator import PublicSimulator
from map_racing.simulation.race import Outcome, race
from map_racing.track.files.load import load_raceline
from map_racing.track.raceline import Raceline
from map_racing.vehicle.parameters import load_vehicle

NUC4 = load_vehicle("nuc4")
TABLE = build_steering_map("table", NUC4, 12.0)
MAP = load_controller_parameters("map").with_(speed_scale=1.0)
REFERENCE = load_raceline("reference")
PLANT = load_plant("nuc4")
IDEAL = PlantParameters(vehicle="nuc4")


def circle(radius=3.0, speed=4.0, left=None, right=None):
    angle = 2.0 * np.pi * np.arange(120) / 120
    widths = {}
    if left is not None:
        widths = {"d_left_m": np.full(120, left), "d_right_m": np.full(120, right)}
    return Raceline(
        radius * np.cos(angle), radius * np.sin(angle), vx_mps=np.full(120, speed), **widths
    )


def drive(raceline=REFERENCE, plant=IDEAL, seed=None, sectors=None, laps=1, limit=None, **changes):
    controller = Controller(MAP.with_(**changes), TABLE, NUC4, raceline, sectors)
    localization = None if seed is None else Localization(plant, seed)
    subject = _Honest(plant) if localization is None else Plant(plant)
    return race(subject, controller, raceline, localization, laps=laps, time_limit=limit)


class _Honest(Plant):
    """A plant whose pose is measured perfectly and without delay."""

    def measured_state(self):
        return self.reference_state()


def evaluated(log, raceline, car_width=0.296):
    path = log.true_path()
    evaluator = LapEvaluator(raceline, car_width=car_width)
    evaluator.update(path[:, 0], path[:, 1], path[:, 2], np.hypot(path[:, 4], path[:, 5]))
    return evaluator.finish()


# -- laps ----------------------------------------------------------------------------------------


@pytest.mark.rest_once
@pytest.mark.parametrize("laps", [1, 3])
def test_a_race_is_an_out_lap_and_the_laps_asked_for(laps):
    log = drive(plant=PLANT, seed=1, laps=laps, speed_scale=0.7)
    assert (log.outcome, log.laps) == (Outcome.COMPLETED, laps)
    result = evaluated(log, REFERENCE)
    assert sum(lap.valid for lap in result.laps) == laps
    assert result.laps[0].reason == "out-lap"
    assert log.duration == pytest.approx(log.samples[-1].true.t, abs=0.1)
    times = [lap.lap_time_s for lap in result.laps if lap.valid]
    assert 7.0 < min(times) <= max(times) < 9.5


@pytest.mark.once
def test_the_last_lap_of_a_fast_car_is_complete():
    """At 45 m/s and 40 Hz, poses are 1.1 m apart and arrive 0.9 m later."""
    car, line = load_vehicle("bmw_320i"), circle(400.0, 45.0)
    plant = dataclasses.replace(PLANT, vehicle=car)
    controller = build_controller(load_controller_parameters("map", car), car, line)
    log = race(Plant(plant), controller, line, Localization(plant, 1), laps=1)
    assert sum(lap.valid for lap in evaluated(log, line).laps) == 1


@pytest.mark.rest_once
@pytest.mark.parametrize("latency", [0.02, 0.04, 0.1])
def test_the_last_lap_is_complete_however_late_the_poses(latency):
    """At 12 m/s a car is 1.2 m farther when a pose that is 0.1 s old arrives."""
    plant = dataclasses.replace(PLANT, localization_latency_s=latency)
    line = circle(30.0, 12.0)
    log = drive(line, plant, seed=1)
    assert log.outcome is Outcome.COMPLETED
    assert sum(lap.valid for lap in evaluated(log, line).laps) == 1


@pytest.mark.once
def test_lap_time_on_a_circle_is_length_over_speed():
    """At constant speed and without lateral error: within 1 ms."""
    raceline = circle(3.0, 3.0)
    log = drive(raceline, laps=5)
    lap = [lap for lap in evaluated(log, raceline).laps if lap.valid][-1]
    assert lap.rms_lateral_error_m < 1e-3
    assert lap.lap_time_s == pytest.approx(raceline.length / 3.0, abs=1e-3)


@pytest.mark.once
def test_the_shipped_race_is_won_by_the_tires_as_they_are():
    """MAP follows most closely, then MAP with linear tires, then pure pursuit."""
    errors = {}
    for name in ("map", "map_linear", "pure_pursuit"):
        parameters = load_controller_parameters(name).with_(speed_scale=0.8)
        controller = build_controller(parameters, NUC4, REFERENCE)
        log = race(Plant(PLANT), controller, REFERENCE, Localization(PLANT, 1), laps=2)
        laps = [lap for lap in evaluated(log, REFERENCE).laps if lap.valid]
        assert log.outcome is Outcome.COMPLETED
        errors[name] = np.mean([lap.rms_lateral_error_m for lap in laps])
    assert errors["map"] < errors["map_linear"] < errors["pure_pursuit"]
    assert errors["map"] < 0.06


@pytest.mark.once
def test_same_seed_same_race_and_another_seed_another():
    first, again, other = (
        drive(plant=PLANT, seed=seed, speed_scale=0.6).true_path() for seed in (5, 5, 6)
    )
    assert np.array_equal(first, again)
    n = min(len(first), len(other))
    assert not np.array_equal(first[:n], other[:n])
    assert np.array_equal(first[0], other[0])


@pytest.mark.once
def test_the_mirrored_race_is_the_mirror_image():
    """Through controller, actuators, plant and walls."""
    mirrored = Raceline(
        REFERENCE.x,
        -REFERENCE.y,
        vx_mps=REFERENCE.speed,
        d_left_m=REFERENCE.d_right,
        d_right_m=REFERENCE.d_left,
    )
    plain = Raceline(
        REFERENCE.x,
        REFERENCE.y,
        vx_mps=REFERENCE.speed,
        d_left_m=REFERENCE.d_left,
        d_right_m=REFERENCE.d_right,
    )
    noiseless = dataclasses.replace(
        IDEAL, steering_delay_s=0.02, steering_time_constant_s=0.03, mu_scale=0.95
    )
    left, right = (
        drive(track, noiseless, speed_scale=0.75).true_path() for track in (plain, mirrored)
    )
    assert left.shape == right.shape
    signs = np.array([1.0, 1.0, -1.0, -1.0, 1.0, -1.0, -1.0])
    np.testing.assert_allclose(right * signs, left, rtol=0.0, atol=1e-4)


# -- how it ends ----------------------------------------------------------------------------------


def test_absurd_speed_ends_in_the_wall():
    log = drive(plant=PLANT, seed=1, speed_scale=2.0, v_max_mps=20.0, grip_use=0.0)
    assert (log.outcome, log.laps) == (Outcome.CRASHED, 0)
    assert 1.0 < log.duration < 20.0
    # the last sample is still on the track, but by less than the next step, at most 0.3 m
    result = evaluated(log, REFERENCE)
    assert -0.3 < min(lap.min_clearance_m for lap in result.laps) < 0.3


@pytest.mark.parametrize("side", ["left", "right"])
def test_the_cars_own_width_is_kept_from_the_walls(side):
    """On the line, it passes where half its width fits, and does not start where it does not."""
    half = 0.5 * NUC4.width
    for gap, outcome in ((half + 0.03, Outcome.COMPLETED), (half - 0.001, Outcome.CRASHED)):
        walls = {"left": 1.0, "right": 1.0, side: gap}
        log = drive(circle(3.0, 3.0, **walls))
        assert log.outcome is outcome
    assert (log.duration, log.samples) == (0.0, [])


def test_without_walls_there_is_nothing_to_hit():
    raceline = Raceline(REFERENCE.x, REFERENCE.y, vx_mps=REFERENCE.speed)
    assert drive(raceline, PLANT, seed=1, speed_scale=1.1).outcome is Outcome.COMPLETED


def test_a_car_that_is_told_to_stand_stalls():
    log = drive(speed_scale=0.0, limit=5.0)
    assert (log.outcome, log.laps) == (Outcome.STALLED, 0)
    assert log.duration == pytest.approx(5.0, abs=0.1)
    path = log.true_path()
    assert np.ptp(path[:, 1]) == np.ptp(path[:, 2]) == 0.0


def test_a_car_that_makes_no_headway_is_not_waited_for():
    """Standing, or driving in circles."""
    assert drive(speed_scale=0.0).outcome is Outcome.STALLED
    creeping = drive(v_max_mps=0.03)
    assert creeping.outcome is Outcome.STALLED and creeping.duration < 12.0
    raceline = Raceline(REFERENCE.x, REFERENCE.y, vx_mps=REFERENCE.speed)
    log = race(Plant(IDEAL), _Circling(), raceline, Localization(IDEAL, 1))
    assert log.outcome is Outcome.STALLED
    assert np.ptp(log.true_path()[:, 3]) > 4.0 * math.pi
    assert log.duration < 20.0


def test_a_car_that_sees_no_pose_is_not_waited_for():
    controller = Controller(MAP, TABLE, NUC4, REFERENCE)
    log = race(_Honest(IDEAL), controller, REFERENCE, rate=1e-3)
    assert (log.outcome, len(log.samples)) == (Outcome.STALLED, 1)


@pytest.mark.once
@pytest.mark.parametrize("kind", ["limit", "sectors"])
def test_a_slow_race_is_no_stall(kind):
    if kind == "limit":
        log = drive(v_max_mps=0.8)
    else:
        log = drive(sectors=SpeedSectors([(0.0, REFERENCE.length, 0.12)], REFERENCE.length))
    assert (log.outcome, log.laps) == (Outcome.COMPLETED, 1)


@pytest.mark.parametrize("laps", [0, -1])
def test_no_laps_are_no_race(laps):
    with pytest.raises(ParameterError, match=f"laps: expected at least 1, got {laps}"):
        drive(laps=laps)


def test_progress_is_told_in_laps():
    told = []
    controller = Controller(MAP.with_(speed_scale=0.6), TABLE, NUC4, REFERENCE)
    race(_Honest(IDEAL), controller, REFERENCE, laps=1, progress=told.append)
    assert told == sorted(told)
    assert 0.0 < told[0] < 0.5 and 1.5 < told[-1] < 2.1


# -- when things happen -----------------------------------------------------------------------


class _Command(NamedTuple):
    steering_angle: float
    speed: float


class _Recorder:
    """A controller that records its calls, and whose commands identify them."""

    def __init__(self):
        self.states = []

    def reset(self):
        pass

    def step(self, state):
        self.states.append(state)
        return _Command(1e-6 * len(self.states), 1.0)


class _Circling:
    """A controller with constant steering."""

    def reset(self):
        pass

    def step(self, state):
        return _Command(0.4, 1.5)


class _Witness(Plant):
    """A plant that records its commands and their times."""

    def __init__(self, parameters):
        super().__init__(parameters)
        self.commands = []

    def advance(self, steering_command, speed_command, steps=1):
        for _ in range(steps):
            self.commands.append((self.state.t, steering_command))
            super().advance(steering_command, speed_command)


@pytest.mark.parametrize("rate", [40.0, 50.0, 33.0, 500.0])
@pytest.mark.parametrize("latency", [0.0, 0.02, 0.055])
def test_poses_come_at_their_rate_and_act_after_their_latency(rate, latency):
    parameters = PlantParameters(
        vehicle="nuc4", localization_rate_hz=rate, localization_latency_s=latency
    )
    plant, controller = _Witness(parameters), _Recorder()
    log = race(plant, controller, circle(), Localization(parameters, 1), laps=1, time_limit=1.0)
    step = plant.time_step
    held = np.array([sample.true.t for sample in log.samples])
    due = np.arange(held.size) / rate
    assert np.all(held <= due + 1e-9) and np.all(held > due - step - 1e-9)
    assert len(held) == pytest.approx(rate * (log.duration - latency), abs=1.5)
    for sample, state in zip(log.samples, controller.states):
        assert sample.measured == state == sample.true
        assert sample.arrival == pytest.approx(sample.true.t + latency)
    # a command takes effect in the tick in which its pose arrived
    first = {}
    for t, steering in plant.commands:
        first.setdefault(round(steering * 1e6), t)
    for k, arrival in enumerate(held + latency):
        if k + 1 in first:
            assert first[k + 1] == pytest.approx(arrival, abs=step - 1e-9)


def test_samples_hold_what_localization_and_imu_reported():
    log = drive(plant=PLANT, seed=3, speed_scale=0.6)
    errors = np.array([np.subtract(s.measured, s.true) for s in log.samples])
    expected = [0.0, 0.005, 0.005, 0.005, 0.05, 0.05, 0.03]
    np.testing.assert_allclose(errors.std(axis=0), expected, rtol=0.15, atol=0.0)
    path = log.true_path()
    lateral = np.array([sample.acceleration[1] for sample in log.samples])
    assert np.std(lateral - path[:, 4] * path[:, 6]) < 1.0
    assert np.corrcoef(lateral, path[:, 4] * path[:, 6])[0, 1] > 0.97


# -- the public simulator -----------------------------------------------------------------------


HANGARS = {
    "21 m": ("recordings", "hangar_global_waypoints.bag"),
    "39 m": ("tracks", "hangar", "global_waypoints.json.gz"),
}
# Median lap [s] and RMS lateral error [m] of the authors' MAP, measured in the simulator itself.
AUTHORS = {"21 m": (5.362, 0.108), "39 m": (7.741, 0.159)}


@lru_cache(maxsize=None)
def hangar_race(shared_data, name, hangar="21 m", delay_s=0.05, rate=100.0):
    """Like `simulator_race`, on the hangar track."""
    raceline = load_raceline(shared_data.joinpath(*HANGARS[hangar]))
    return simulator_race(raceline, name, delay_s, rate)


def simulator_race(raceline, name, delay_s=0.05, rate=100.0, laps=6):
    """RMS lateral error [m], median lap time [s] and least clearance [m] over some laps."""
    vehicle = load_vehicle("sim")
    # its base_link is the center of gravity
    parameters = load_controller_parameters(name).with_(
        reference_point="center_of_gravity", speed_scale=1.0
    )
    controller = build_controller(parameters, vehicle, raceline)
    plant = dataclasses.replace(load_plant("public_simulator"), steering_delay_s=delay_s)
    simulator = PublicSimulator(plant)
    log = race(simulator, controller, raceline, rate=rate, laps=laps)
    assert (log.outcome, log.laps) == (Outcome.COMPLETED, laps)
    valid = [lap for lap in evaluated(log, raceline, vehicle.width).laps if lap.valid]
    assert len(valid) == laps
    return (
        math.sqrt(np.mean([lap.rms_lateral_error_m**2 for lap in valid])),
        np.median([lap.lap_time_s for lap in valid]),
        min(lap.min_clearance_m for lap in valid),
    )


@pytest.mark.once
@pytest.mark.parametrize("delay_s", [0.04, 0.05, 0.06, 0.07])
@pytest.mark.parametrize("hangar", HANGARS)
def test_the_shipped_map_halves_the_error_and_is_faster(shared_data, hangar, delay_s):
    error, lap_time, clearance = hangar_race(shared_data, "map", hangar, delay_s)
    their_lap_time, their_error = AUTHORS[hangar]
    assert error < 0.5 * their_error and lap_time < their_lap_time
    assert clearance > 0.15


@pytest.mark.once
@pytest.mark.parametrize(
    "straight, radius, speed, most_error, most_lap",
    [
        # At its top speed the simulator's car keeps shifting load if commanded more: it ran 0.19 m
        # wide.
        (10.0, 12.0, 11.0, 0.06, 13.8),
        # At 0.92 of the curvature at full lock, a fifth of the tires' grip; the lap used to take
        # 8.4 s.
        (6.0, 0.935, 3.4, 0.04, 6.0),
    ],
    ids=["beyond the top speed", "at the lock"],
)
def test_the_shipped_map_where_the_tires_are_not_the_limit(
    straight, radius, speed, most_error, most_lap
):
    half, bend = np.arange(0.0, straight, 0.1), np.arange(0.0, math.pi, 0.1 / radius)
    x = np.concatenate((half, straight + radius * np.sin(bend)))
    y = np.concatenate((0.0 * half, radius - radius * np.cos(bend)))
    x, y = np.append(x, straight - x), np.append(y, 2.0 * radius - y)
    raceline = Raceline(x, y, vx_mps=np.full(x.size, speed))
    error, lap_time, _ = simulator_race(raceline, "map", laps=3)
    assert error < most_error and lap_time < most_lap


@pytest.mark.once
@pytest.mark.parametrize("hangar", HANGARS)
def test_the_shipped_map_at_the_rate_of_the_authors_loop(shared_data, hangar):
    """With the same bound as at other rates: the values are a compromise for many tracks and
    cars."""
    error, lap_time, _ = hangar_race(shared_data, "map", hangar, rate=40.0)
    their_lap_time, their_error = AUTHORS[hangar]
    assert error < 0.5 * their_error and lap_time < their_lap_time


@pytest.mark.once
@pytest.mark.parametrize("hangar", HANGARS)
def test_map_as_published_does_there_what_was_measured(shared_data, hangar):
    """Lap time and error no worse than the authors' code, and away from the walls."""
    error, lap_time, clearance = hangar_race(shared_data, "map_paper", hangar)
    their_lap_time, their_error = AUTHORS[hangar]
    assert 0.9 * their_error < error < their_error
    assert 0.99 * their_lap_time < lap_time < their_lap_time
    assert clearance > 0.1


@pytest.mark.once
def test_pure_pursuit_as_published_does_there_what_was_measured(shared_data):
    """The public pure pursuit, with its loop at 40 Hz, was measured at 5.62 s and 0.139 m."""
    error, lap_time, _ = hangar_race(shared_data, "pure_pursuit_paper", rate=40.0)
    assert error == pytest.approx(0.139, abs=0.005)
    assert lap_time == pytest.approx(5.62, abs=0.02)


@pytest.mark.once
@pytest.mark.parametrize("name", ["pure_pursuit", "map_paper", "pure_pursuit_paper"])
def test_what_feedforward_compensation_and_tires_are_worth_there(shared_data, name):
    """Half the error of the published ones; the gain over the shipped pure pursuit is smaller here.

    Pure pursuit has the same compensation and speeds, and these tires hardly understeer. `map`
    accepts some error here to stay stable with soft rear tires.
    """
    ours = hangar_race(shared_data, "map", "39 m")[0]
    theirs = hangar_race(shared_data, name, "39 m")[0]
    assert theirs > (2.0 if name.endswith("_paper") else 1.5) * ours
