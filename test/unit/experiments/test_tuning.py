"""The search finds the bottom of known valleys."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.control.parameters import load_controller_parameters
from map_racing.errors import MapRacingError
from map_racing.evaluation.results import Lap
from map_racing.experiments.jobs import RaceResult
from map_racing.experiments.tuning import (
    ROBUST_STEPS,
    STEP_M,
    STEP_Q,
    frame_of,
    lap_error,
    tune,
    tune_robust,
)
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.size import Size, size_of

CONTROLLER = load_controller_parameters("map_paper")
NAN = math.nan


def lap(error, number=1, valid=True):
    return Lap(number, 8.0, error, error, error, valid, start_time_s=0.0, end_time_s=8.0)


def raced(*errors, outcome="completed"):
    out_lap = Lap(0, NAN, 9.0, reason="out-lap", start_time_s=0.0, end_time_s=8.0)
    laps = [lap(error, number) for number, error in enumerate(errors, 1)]
    return RaceResult(outcome, (out_lap, *laps), 30.0)


def tuned_by(error_at, days=2):
    """Tune on a known surface; infinite means a crash on the last day."""
    plan = tune(
        lambda controller: [(controller.m_m, controller.q_s, day) for day in range(days)],
        CONTROLLER,
    )
    asked = []
    try:
        races = next(plan)
        while True:
            asked += races
            results = []
            for m, q, day in races:
                error = error_at(m, q)
                crashes = math.isinf(error) and day == days - 1
                kind = "crashed" if crashes else "completed"
                results.append(raced(0.1 if math.isinf(error) else error, outcome=kind))
            races = plan.send(results)
    except StopIteration as stop:
        return stop.value, asked


def test_error_is_the_mean_over_laps_of_completed_races():
    assert lap_error([raced(0.1, 0.2), raced(0.6)]) == pytest.approx(0.3)
    assert math.isinf(lap_error([raced(0.1), raced(0.1, outcome="crashed")]))
    assert math.isinf(lap_error([raced(outcome="stalled")]))
    # Completed, but off the track: there is no counted lap with an error.
    assert math.isinf(lap_error([raced(0.1), raced()]))


@pytest.mark.once
@settings(deadline=None, max_examples=30)
@given(st.floats(0.0, 1.3), st.floats(0.0, 0.4), st.floats(2.0, 6.0))
def test_finds_the_bottom_of_a_valley(m, q, v):
    """Long and oblique, like real ones: along its axis, the lookahead at speed v is constant."""

    def error_at(m_m, q_s):
        across = (m_m - m) + v * (q_s - q)
        return 0.01 + abs(across) ** 2 + 0.05 * abs(m_m - m - v * (q_s - q)) ** 2

    found, asked = tuned_by(error_at)
    assert len(set(asked)) == len(asked)  # no race is driven twice
    assert {race[:2] for race in asked} == {pair[:2] for pair in found.pairs}
    assert found.races == len(asked)
    lowest = min(pair.error for pair in found.pairs if not pair.given_up)
    assert all(pair.error >= lowest for pair in found.pairs)
    assert found.error == lowest == pytest.approx(0.01, abs=1e-3)
    assert found.controller == CONTROLLER.with_(m_m=found.controller.m_m, q_s=found.controller.q_s)
    assert all(pair.m >= 0.0 and pair.q >= 0.0 for pair in found.pairs)
    for i, j in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        beside = found.controller.m_m + i * STEP_M, found.controller.q_s + j * STEP_Q
        assert min(beside) < 0.0 or error_at(*beside) >= found.error - 1e-12


def test_a_valley_beside_a_cliff():
    """The best pair is at the edge of the cliff, and all pairs beyond are infeasible."""

    def error_at(m, q):
        return math.inf if m + 4.0 * q < 0.72 else 0.05 + 0.2 * (m + 4.0 * q - 0.72)

    found, _ = tuned_by(error_at)
    assert 0.72 <= found.controller.m_m + 4.0 * found.controller.q_s < 0.72 + STEP_M
    frame = frame_of(found)
    beyond = frame.m_m + 4.0 * frame.q_s < 0.72
    driven = frame[~frame.given_up]
    # All complete the first day: some infeasible ones were dropped before the last.
    assert (~driven.completed == beyond[~frame.given_up]).all()
    assert driven.rms_lateral_error_m.isna().equals(~driven.completed)


def test_what_cannot_become_the_best_is_not_driven_to_its_end():
    """Pairs far from the bottom get one race each; the result is the same as with all races."""

    def error_at(m, q):
        return 0.02 + (m - 0.4) ** 2 + 4.0 * (q - 0.1) ** 2

    found, asked = tuned_by(error_at, days=5)
    assert (found.controller.m_m, found.controller.q_s) == (0.4, 0.1)
    assert len(asked) < 0.5 * 5 * len(found.pairs)
    given_up = [pair for pair in found.pairs if pair.given_up]
    assert given_up and min(pair.error for pair in given_up) > 1.05 * found.error


ROBUST = CONTROLLER.with_(delay_s=0.05)


def robustly(error_at, jobs=12):
    """Robust tuning on known surfaces, one for each job."""

    def jobs_for(controller):
        return [(controller.m_m, controller.q_s, controller.delay_s, job) for job in range(jobs)]

    plan, asked = tune_robust(jobs_for, ROBUST), []
    try:
        races = next(plan)
        while True:
            asked += races
            errors = [error_at(*race) for race in races]
            races = plan.send(
                [
                    raced(0.5, outcome="crashed") if math.isinf(error) else raced(error)
                    for error in errors
                ]
            )
    except StopIteration as stop:
        return stop.value, asked


def test_the_robust_search_finds_the_bottom_of_the_mean():
    def error_at(m, q, delay, job):
        return (
            0.02 + 0.1 * (m - 0.3) ** 2 + (q - 0.25) ** 2 + 9.0 * (delay - 0.065) ** 2 + job * 1e-3
        )

    found, asked = robustly(error_at)
    best = found[0]
    assert (best.controller.m_m, best.controller.delay_s) == (0.3, 0.065)
    assert best.controller.q_s == pytest.approx(0.25, abs=1e-9)
    assert best.races == 12 and best.worst == pytest.approx(0.031)
    assert len(set(asked)) == len(asked)


def test_the_robust_search_first_completes_everything():
    """Starting where one job crashes, it moves away, although the error is smallest there."""

    def error_at(m, q, delay, job):
        return math.inf if job == 7 and delay < 0.057 else 0.02 + delay

    found, _ = robustly(error_at)
    assert found[0].controller.delay_s == pytest.approx(0.06)
    assert all(math.isinf(c.error) for c in found if c.controller.delay_s < 0.057)


@pytest.mark.parametrize("off", [(), ("slip_lookahead", "yaw_rate_gain_s")])
def test_the_robust_search_varies_all_its_parameters_but_those_that_are_off(off):
    given = load_controller_parameters("map").with_(**dict.fromkeys(off, 0.0))
    plan = tune_robust(lambda controller: [controller], given)
    try:
        races = next(plan)
        while True:
            races = plan.send([raced(0.02) for _ in races])
    except StopIteration as stop:
        found = [candidate.controller for candidate in stop.value]
    varied = {name for name in ROBUST_STEPS if len({getattr(c, name) for c in found}) > 1}
    assert varied == set(ROBUST_STEPS) - set(off)


def test_steps_of_the_robust_search_grow_with_the_car():
    car = load_vehicle("bmw_320i")
    given, size = load_controller_parameters("map").of_size(car), size_of(car)
    plan = tune_robust(lambda controller: [controller], given, size)
    next(plan)
    around = plan.send([raced(0.02)])
    steps = {round(abs(c.m_m - given.m_m), 4) for c in around if c.q_s == given.q_s}
    assert steps == {0.0, round(2.0 * ROBUST_STEPS["m_m"] * size.length, 4)}
    # Delays do not scale with the car.
    assert {round(abs(c.delay_s - given.delay_s), 4) for c in around} == {0.0, 0.01}


def test_a_robust_search_without_anything_that_completes_is_an_error():
    with pytest.raises(MapRacingError, match="lower grip_use"):
        robustly(lambda m, q, delay, job: math.inf if job == 3 else 0.1)


def test_nothing_feasible_is_an_error():
    with pytest.raises(MapRacingError, match="no lookahead of the grid completes a race at 70%"):
        tuned_by(lambda m, q: math.inf)


def test_the_search_of_a_larger_car_has_larger_steps():
    size, asked = Size(8.0, math.sqrt(8.0)), []
    plan = tune(lambda c: [(c.m_m, c.q_s)], CONTROLLER, size)
    try:
        races = next(plan)
        while True:
            asked += races
            # The valley is far beyond the grid of a 1:10 car.
            races = plan.send([raced(0.01 + abs(m - 4.0) + 30.0 * abs(q - 0.5)) for m, q in races])
    except StopIteration as stop:
        found = stop.value.controller
    assert found.m_m == pytest.approx(4.0, abs=8.0 * STEP_M)
    assert found.q_s == pytest.approx(0.5, abs=size.time * STEP_Q)
    assert len(asked) < 150
