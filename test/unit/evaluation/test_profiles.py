"""Laps over distance: the evaluator's times, and channels with known answers."""

import dataclasses

import numpy as np
import pytest

from map_racing.control.parameters import load_controller_parameters
from map_racing.control.speed_plan import SpeedPlan
from map_racing.evaluation.profiles import CHANNELS, car_limits, profiles_of, track_profile
from map_racing.evaluation.runs import evaluate
from map_racing.vehicle.parameters import load_vehicle


@pytest.fixture(scope="module")
def limits():
    return car_limits(load_vehicle("nuc4"))


def test_the_controller_plans_no_more_than_the_grip_allows(reference):
    """Both use the controller's braking and driving limits, whatever the vehicle file says."""
    parameters = load_controller_parameters("map").with_(speed_scale=1.0)
    limits = car_limits(load_vehicle("nuc4"), parameters)
    track = track_profile(reference, 0.0, limits)
    plan = SpeedPlan(reference, parameters.with_(grip_use=1.0), limits.table)
    asked = np.interp(track.s, plan.s, plan.speed, period=reference.length)
    assert np.max(asked / track.grip_speed) == pytest.approx(1.0, abs=0.03)


def test_times_are_those_of_the_evaluator(reference, driving):
    recording = driving(reference, lambda s: 4.0 + np.sin(s), laps=3)
    result = evaluate(recording, reference, start_s=5.0, sectors=4)
    run = profiles_of(recording, result)
    assert [profile.lap for profile in run.laps] == result.laps[1:-1]
    for profile in run.laps:
        time, s = profile.values["time"], run.track.s
        assert time[0] == 0.0 and time[-1] == pytest.approx(profile.lap.lap_time_s, abs=1e-9)
        at = np.interp(run.track.length * np.arange(5) / 4, s, time)
        assert np.diff(at) == pytest.approx(profile.lap.sector_times_s, abs=2e-4)
    assert run.best.lap.lap_time_s == result.summary.best_lap_time_s


def test_channels_of_steady_driving(reference, driving, limits):
    angle = 0.05
    recording = driving(
        reference,
        lambda s: 2.0,
        lambda s: 0.1,
        commands=lambda s, v, kappa: (np.full(s.size, angle), np.full(s.size, 2.5)),
    )
    run = profiles_of(recording, evaluate(recording, reference), limits)
    assert len(run.laps) == 2 and set(run.laps[0].values) == set(CHANNELS)
    values, kappa = run.laps[0].values, run.track.kappa
    assert values["d"] == pytest.approx(0.1, abs=2e-3)
    assert values["v"] == pytest.approx(2.0 * (1.0 - 0.1 * kappa), abs=0.02)
    assert values["v_command"] == pytest.approx(2.5) and values["steering"] == pytest.approx(angle)
    a_lat = 4.0 * kappa * (1.0 - 0.1 * kappa)
    assert values["a_lat"] == pytest.approx(a_lat, abs=0.1)
    table = limits.table
    expected = [table.steering(v, a)[0] for v, a in zip(values["v"], values["a_lat"])]
    assert values["steering_table"] == pytest.approx(expected)
    limit = limits.lateral(values["v"])
    assert run.laps[0].grip_used == pytest.approx(np.abs(values["a_lat"]) / limit)
    assert run.laps[0].saturated == 0.0


def test_acceleration_along_the_track(reference, driving):
    # v^2 = 4 + 2 a s with a = 0.2 m/s^2 in the first lap
    speed = lambda s: np.sqrt(4.0 + 0.4 * np.mod(s, reference.length))  # noqa: E731
    recording = driving(reference, speed, laps=2)
    run = profiles_of(recording, evaluate(recording, reference))
    middle = slice(20, -20)  # the speed steps down at the start line
    assert run.laps[0].values["a_lon"][middle] == pytest.approx(0.2, abs=0.02)


def test_share_of_saturated_steering_is_of_the_time(reference, driving, limits):
    # Full lock for a quarter of the length at half speed: 0.4 of the time.
    quarter = reference.length / 4.0
    slow = lambda s: np.where(np.mod(s, reference.length) < quarter, 1.0, 2.0)  # noqa: E731
    recording = driving(
        reference,
        slow,
        commands=lambda s, v, kappa: (np.where(slow(s) == 1.0, limits.delta_max, 0.0), v),
    )
    run = profiles_of(recording, evaluate(recording, reference), limits)
    assert run.laps[0].saturated == pytest.approx(0.4, abs=0.01)


def test_without_a_car_nothing_is_said_about_its_table(reference, driving):
    recording = driving(reference, lambda s: 3.0)
    run = profiles_of(recording, evaluate(recording, reference))
    assert np.isnan(run.laps[0].grip_used).all() and np.isnan(run.laps[0].saturated)
    assert run.track.grip_speed is None


def test_grip_speed_is_within_the_limits(reference, limits, driving):
    recording = driving(reference, lambda s: 3.0, laps=1)
    track = profiles_of(recording, evaluate(recording, reference), limits).track
    use = track.grip_speed**2 * np.abs(track.kappa)
    assert np.all(use <= 1.02 * limits.table.max_lateral_acceleration(track.grip_speed))


def test_a_run_without_a_lap_still_has_its_stretch(reference, driving):
    recording = driving(reference, lambda s: 3.0, laps=1)
    half = recording.t < 0.6 * recording.t[-1]
    columns = {n: getattr(recording, n)[half] for n in ("t", "x", "y", "psi", "v_x", "v_y")}
    short = dataclasses.replace(recording, yaw_rate=recording.yaw_rate[half], **columns)
    run = profiles_of(short, evaluate(short, reference))
    assert run.counted == [] and run.best is None and len(run.laps) == 1
    v = run.laps[0].values["v"]
    assert np.isnan(v[-1]) and v[1] == pytest.approx(3.0)


def test_the_limit_of_the_tires_does_not_depend_on_the_lock(limits):
    """At walking pace the lock keeps the car far below the tires' limit, which counts at speed."""
    table = limits.table
    assert table.max_lateral_acceleration(1.5) < 0.5 * table.max_lateral_acceleration(5.0)
    v = np.array([0.5, 1.5, 3.0, 5.0, 2.0 * limits.v_max])
    fast = np.linspace(0.25, limits.v_max, 1000)
    most = np.max(table.max_lateral_acceleration(fast))
    assert limits.lateral(v)[:2] == pytest.approx(most, rel=1e-3)
    above = table.max_lateral_acceleration(np.minimum(v, limits.v_max))
    assert np.all(limits.lateral(v) >= 0.999 * above)
