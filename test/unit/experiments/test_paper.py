"""Plans of the paper's experiments, and tables with known content."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from map_racing.cli.experiment import saturation_lines
from map_racing.control.parameters import load_controller_parameters
from map_racing.evaluation.results import Lap
from map_racing.experiments import paper
from map_racing.experiments.conditions import load_conditions
from map_racing.experiments.jobs import RaceResult
from map_racing.simulation.plants import load_plant
from map_racing.track.files.load import load_raceline
from map_racing.vehicle.parameters import linearized

NAN = math.nan
MAP, PURE_PURSUIT = "MAP Pacejka", "pure pursuit"


@pytest.fixture(scope="module")
def setting():
    return setting_of(load_conditions("paper"))


def setting_of(conditions):
    """Setting in which the tires of the plant are known."""
    plant = load_plant(conditions.plant)
    vehicle = plant.build_vehicle()
    raceline = load_raceline(conditions.track)
    return paper.Setting(conditions, raceline, plant, vehicle, linearized(vehicle))


def stretch(number, time, rms, mean, largest, valid=True, duration=None):
    return Lap(
        number,
        time,
        rms,
        mean,
        largest,
        valid,
        "" if valid else "in-lap",
        min_clearance_m=0.2,
        mean_speed_mps=4.0,
        max_speed_mps=5.0,
        start_time_s=0.0,
        end_time_s=duration or time,
    )


def race(job_of, label, scale, seed, laps, last=None):
    """A race with laps of (time, RMS, mean, maximum); `last` is where it crashed."""
    stretches = [stretch(0, NAN, 9.0, 9.0, 9.0, False, 10.0)]
    stretches += [stretch(number, *lap) for number, lap in enumerate(laps, 1)]
    if last:
        stretches.append(stretch(len(laps) + 1, NAN, *last[1:], False, last[0]))
    outcome = "crashed" if last else "completed"
    result = RaceResult(outcome, tuple(stretches), 50.0, lateral_mps2=5.0 + 0.5 * len(laps))
    return paper.Race(label, scale, seed, job_of(seed=seed), result)


@pytest.fixture
def races(job_of):
    return [
        race(job_of, MAP, 0.7, 2, [(8.0, 0.03, 0.02, 0.10), (8.2, 0.05, 0.04, 0.12)]),
        race(job_of, MAP, 0.7, 1, [(8.4, 0.01, 0.01, 0.05), (8.6, 0.02, 0.02, 0.06)]),
        race(job_of, PURE_PURSUIT, 0.7, 1, [(9.0, 0.2, 0.1, 0.3)], last=(3.0, 0.6, 0.5, 0.9)),
        race(job_of, PURE_PURSUIT, 0.7, 2, [(9.0, 0.1, 0.1, 0.3), (9.4, 0.2, 0.1, 0.4)]),
        race(job_of, MAP, 0.8, 1, [(7.0, 0.04, 0.03, 0.2), (7.0, 0.04, 0.03, 0.2)]),
        race(job_of, MAP, 0.8, 2, [], last=None)._replace(
            result=RaceResult("crashed", (stretch(0, NAN, 0.3, 0.2, 0.7, False, 4.0),), 4.0)
        ),
    ]


# -- plans -----------------------------------------------------------------------------------------


def ended_at(scale):
    """Results for jobs: completed below a scale."""
    return lambda job: RaceResult("completed" if job.scale < scale else "crashed", (), 1.0)


def carry_out(plan, answer):
    batches = []
    try:
        jobs = next(plan.steps)
        while True:
            batches.append(jobs)
            jobs = plan.steps.send([answer(job) for job in jobs])
    except StopIteration as stop:
        return stop.value, batches


def test_speeds_rise_until_a_race_is_not_completed(setting):
    controller = load_controller_parameters("map_paper")
    plan = paper.scaling_plan(setting, MAP, controller, 4, 10, [0.6, 0.625, 0.65, 0.675, 0.7])
    races, batches = carry_out(plan, ended_at(0.65))
    assert [job.scale for (job,) in batches] == [0.6, 0.625, 0.65]
    assert [race.result.completed for race in races] == [True, True, False]
    (job,) = batches[0]
    assert (job.seed, job.laps, job.plant) == (4, 10, setting.day(4).plant)
    assert job.vehicle == setting.vehicle and job.controller == controller.with_(speed_scale=0.6)


def test_without_a_crash_the_last_scale_ends_it(setting):
    controller = load_controller_parameters("map_paper")
    plan = paper.scaling_plan(setting, MAP, controller, 1, 1, [0.6, 0.7])
    races, _ = carry_out(plan, ended_at(2.0))
    assert [race.scale for race in races] == [0.6, 0.7]


def test_tire_models_are_raced_at_each_speed_whatever_happens(setting):
    controller = load_controller_parameters("map_linear_paper")
    plan = paper.scaling_plan(setting, "MAP linear", controller, 2, 5, (0.7, 0.8), False)
    races, ((first, second),) = carry_out(plan, ended_at(0.5))
    assert [race.scale for race in races] == [0.7, 0.8] == [first.scale, second.scale]
    assert first.vehicle == setting.linear_vehicle != setting.vehicle


def test_tuning_races_on_practice_days_at_its_own_speed(setting):
    controller = load_controller_parameters("map_paper")
    plan = paper.tuning_plan(setting, MAP, controller)
    jobs = next(plan.steps)
    conditions, driven = setting.conditions, []
    laps = (stretch(1, 8.0, 0.1, 0.1, 0.1),)

    def answer(job):
        return RaceResult("completed", laps, 1.0)

    try:
        while True:
            driven += jobs
            jobs = plan.steps.send([answer(job) for job in jobs])
    except StopIteration as stop:
        tuned = stop.value
    assert {job.seed for job in driven} == set(conditions.practice_seeds)
    assert {job.scale for job in driven} == {0.6} and {job.laps for job in driven} == {2}
    days = {setting.day(seed).plant for seed in conditions.practice_seeds}
    assert {job.plant for job in driven} == days
    assert tuned.controller.speed_scale == controller.speed_scale
    assert tuned.error == pytest.approx(0.1)


def test_the_public_simulator_is_driven_at_the_center_of_gravity(setting):
    conditions = replace(setting.conditions, plant="public_simulator")
    there = setting_of(conditions)
    controller = load_controller_parameters("map_paper")
    job = there.job(MAP, controller, there.day(1), 1)
    assert job.controller.reference_point == "center_of_gravity"
    assert setting.job(MAP, controller, setting.day(1), 1).controller == controller


def test_contenders_are_those_of_the_paper_and_the_default():
    assert [c.controller for c in paper.CONTENDERS if c.tuned] == [
        "pure_pursuit_paper",
        "map_linear_paper",
        "map_paper",
    ]
    for contender in paper.CONTENDERS:
        parameters = load_controller_parameters(contender.controller)
        as_published = parameters.delay_s == 0.0 and parameters.speed_source == "command"
        assert as_published == contender.tuned


# -- tables ----------------------------------------------------------------------------------------


def test_rows_of_races(races):
    frame = paper.race_frame(races)
    keys = list(zip(frame.speed_scale, frame.controller, frame.seed))
    assert keys == [
        (0.7, PURE_PURSUIT, 1),
        (0.7, PURE_PURSUIT, 2),
        (0.7, MAP, 1),
        (0.7, MAP, 2),
        (0.8, MAP, 1),
        (0.8, MAP, 2),
    ]
    crashed, in_out_lap = frame.iloc[0], frame.iloc[5]
    # 9 s at 0.1 m and 3 s at 0.5 m
    assert (crashed.outcome, crashed.laps_completed, crashed.mean_lap_time_s) == ("crashed", 1, 9.0)
    assert crashed.mean_abs_lateral_error_m == pytest.approx(0.2)
    assert crashed.rms_lateral_error_m == pytest.approx(math.sqrt((9 * 0.04 + 3 * 0.36) / 12))
    assert crashed.max_abs_lateral_error_m == 0.9
    assert in_out_lap.laps_completed == 0 and math.isnan(in_out_lap.mean_lap_time_s)
    assert in_out_lap.max_abs_lateral_error_m == 0.7
    assert frame.iloc[3].max_abs_lateral_error_m == 0.12  # without the out-lap's
    assert len(set(frame.fingerprint)) == 2


def test_scaling_table(races):
    table = paper.scaling_table(paper.race_frame(races), paper.lap_frame(races))
    assert list(zip(table.speed_scale, table.controller)) == [
        (0.7, PURE_PURSUIT),
        (0.7, MAP),
        (0.8, MAP),
    ]
    first, second, third = (row for row in table.itertuples())
    assert (first.days, first.days_completed, first.laps_until_end, first.laps) == (2, 1, "1", 2)
    assert first.median_rms_lateral_error_m == pytest.approx(0.15)  # of the completed day only
    assert (second.days_completed, second.laps) == (2, 4)
    rms = [second.min_rms_lateral_error_m, second.q1_rms_lateral_error_m]
    rms += [second.median_rms_lateral_error_m, second.q3_rms_lateral_error_m]
    np.testing.assert_allclose(
        [*rms, second.max_rms_lateral_error_m], [0.01, 0.0175, 0.025, 0.035, 0.05]
    )
    assert second.mean_lap_time_s == pytest.approx(8.3)
    assert second.max_abs_lateral_error_m == 0.12
    assert (third.days_completed, third.laps_until_end) == (1, "0")
    assert (second.max_speed_mps, second.lateral_acceleration_mps2) == (5.0, 6.0)


def test_scales_that_change_no_speeds(races):
    """As where the grip limits the speeds on all days: laps differ by rounding alone."""
    frame, laps = paper.race_frame(races), paper.lap_frame(races)
    own = frame[(frame.controller == MAP) & (frame.speed_scale == 0.7)]
    copies = [own.assign(speed_scale=0.7 + 0.1 * k) for k in range(4)]
    times = own.mean_lap_time_s
    copies[1] = copies[1].assign(mean_lap_time_s=times - [0.0, 0.1])
    copies[2] = copies[2].assign(mean_lap_time_s=times - [0.0, 0.1004])
    copies[3] = copies[3].assign(mean_lap_time_s=times - [0.0, 0.1])
    table = paper.scaling_table(pd.concat(copies, ignore_index=True), laps)
    assert table.same_speeds.tolist() == [False, False, True, True]
    (line,) = saturation_lines(table)
    assert line.startswith(f"{MAP}: the speeds of scale 0.800 at all higher ones")
    ended = pd.concat([copies[0], copies[0].assign(speed_scale=0.8, outcome="crashed")])
    table = paper.scaling_table(ended, laps)
    assert table.same_speeds.tolist() == [False, False] and saturation_lines(table) == []


def test_a_scale_that_nobody_completed_is_a_row_without_values(races):
    table = paper.scaling_table(paper.race_frame(races[2:3]), paper.lap_frame(races[2:3]))
    (row,) = table.itertuples()
    assert (row.days_completed, row.laps) == (0, 0)
    assert math.isnan(row.median_rms_lateral_error_m) and math.isnan(row.mean_lap_time_s)


def test_tire_table(races):
    table = paper.tire_table(paper.race_frame(races))
    first, second, third = table.itertuples()
    assert first.mean_lap_time_s == pytest.approx(9.2)  # the crashed day does not count
    assert second.mean_lap_time_s == pytest.approx(8.3)
    assert second.mean_abs_lateral_error_m == pytest.approx((0.01498 + 0.03012) / 2, abs=2e-4)
    assert second.max_abs_lateral_error_m == 0.12
    assert third.days_completed == 1
    until_the_crash = paper.tire_table(paper.race_frame(races[2:3])).iloc[0]
    assert until_the_crash.days_completed == 0
    assert until_the_crash.mean_abs_lateral_error_m == pytest.approx(0.2)


def test_highest_scales(races):
    highest = paper.highest_scales(paper.race_frame(races))
    assert list(highest.columns) == ["seed", PURE_PURSUIT, MAP]
    assert highest.seed.tolist() == [1, 2]
    assert math.isnan(highest[PURE_PURSUIT][0]) and highest[PURE_PURSUIT][1] == 0.7
    assert highest[MAP].tolist() == [0.8, 0.7]


def test_two_controllers_on_days_that_both_completed(races):
    against = paper.on_common_days(paper.race_frame(races), MAP, PURE_PURSUIT)
    (row,) = against.itertuples()
    assert (row.speed_scale, row.days, row.days_closer) == (0.7, 1, 1)
    assert row.gain_s == pytest.approx(9.2 - 8.1)
    squares = (8.0 * 0.03**2 + 8.2 * 0.05**2) / 16.2, (9.0 * 0.1**2 + 9.4 * 0.2**2) / 18.4
    assert row.error_ratio == pytest.approx(math.sqrt(squares[0] / squares[1]))
