"""The search finds the bottom of valleys that are known."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.control.parameters import load_controller_parameters
from map_racing.errors import MapRacingError
from map_racing.evaluation.results import Lap
from map_racing.experiments.jobs import RaceResult
from map_racing.experiments.tuning import STEP_M, STEP_Q, frame_of, lap_error, tune

CONTROLLER = load_controller_parameters("map_paper")
NAN = math.nan


def lap(error, number=1, valid=True):
    return Lap(number, 8.0, error, error, error, valid, start_time_s=0.0, end_time_s=8.0)


def raced(*errors, outcome="completed"):
    out_lap = Lap(0, NAN, 9.0, reason="out-lap", start_time_s=0.0, end_time_s=8.0)
    laps = [lap(error, number) for number, error in enumerate(errors, 1)]
    return RaceResult(outcome, (out_lap, *laps), 30.0)


def tuned_by(error_at, days=2):
    """Tune on a known surface; infinite is a crash on the last day."""
    plan = tune(lambda controller: [(controller.m_m, controller.q_s)] * days, CONTROLLER)
    asked = []
    try:
        pairs = next(plan)
        while True:
            asked += pairs
            results = []
            for place, pair in enumerate(pairs, 1):
                error = error_at(*pair)
                if math.isinf(error):
                    ends = "completed" if place % days else "crashed"
                    results.append(raced(0.1, outcome=ends))
                else:
                    results.append(raced(error))
            pairs = plan.send(results)
    except StopIteration as stop:
        return stop.value, asked


def test_error_is_the_mean_over_laps_of_completed_races():
    assert lap_error([raced(0.1, 0.2), raced(0.6)]) == pytest.approx(0.3)
    assert math.isinf(lap_error([raced(0.1), raced(0.1, outcome="crashed")]))
    assert math.isinf(lap_error([raced(outcome="stalled")]))


@settings(deadline=None, max_examples=30)
@given(st.floats(-0.2, 1.3), st.floats(0.0, 0.4), st.floats(2.0, 6.0))
def test_finds_the_bottom_of_a_valley(m, q, v):
    """Long, oblique, as real ones are: its axis has one lookahead at the speed v."""

    def error_at(m_m, q_s):
        across = (m_m - m) + v * (q_s - q)
        return 0.01 + abs(across) ** 2 + 0.05 * abs(m_m - m - v * (q_s - q)) ** 2

    found, asked = tuned_by(error_at)
    assert len(set(asked)) == len(found.pairs) == len(asked) // 2  # nothing is driven twice
    lowest = min(pair.error for pair in found.pairs)
    assert found.error == lowest == pytest.approx(0.01, abs=1e-3)
    assert found.controller == CONTROLLER.with_(m_m=found.controller.m_m, q_s=found.controller.q_s)
    assert all(pair.q >= 0.0 for pair in found.pairs)
    for i, j in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        beside = found.controller.m_m + i * STEP_M, found.controller.q_s + j * STEP_Q
        assert beside[1] < 0.0 or error_at(*beside) >= found.error - 1e-12


def test_a_valley_beside_a_cliff():
    """The best pair lies on the cliff, and all pairs beyond are infeasible."""

    def error_at(m, q):
        return math.inf if m + 4.0 * q < 0.72 else 0.05 + 0.2 * (m + 4.0 * q - 0.72)

    found, _ = tuned_by(error_at)
    assert 0.72 <= found.controller.m_m + 4.0 * found.controller.q_s < 0.72 + STEP_M
    frame = frame_of(found)
    beyond = frame.m_m + 4.0 * frame.q_s < 0.72
    assert (~frame.completed == beyond).all() and beyond.any()
    assert frame.rms_lateral_error_m.isna().equals(~frame.completed)


def test_nothing_feasible_is_an_error():
    with pytest.raises(MapRacingError, match="no lookahead of the grid completes a race at 70%"):
        tuned_by(lambda m, q: math.inf)
