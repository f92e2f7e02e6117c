"""Steering compared with the table: a known excess is found in each band of the grip."""

import numpy as np
import pytest

from map_racing.evaluation.profiles import car_limits, profiles_of
from map_racing.evaluation.runs import evaluate
from map_racing.evaluation.table_check import table_check
from map_racing.vehicle.parameters import load_vehicle


@pytest.fixture(scope="module")
def limits():
    return car_limits(load_vehicle("nuc4"))


@pytest.mark.parametrize("more", [-0.2, 0.0, 0.3])
def test_a_share_of_the_angle_is_found(driving, reference, limits, more):
    def commands(s, v, kappa):
        pairs = zip(v.tolist(), (v**2 * kappa).tolist())
        return (1.0 + more) * np.array([limits.table.steering(*pair)[0] for pair in pairs]), v

    def speed(s):
        return 0.7 * reference.sample(s % reference.length).speed

    recording = driving(reference, speed, rate=50.0, commands=commands)
    run = profiles_of(recording, evaluate(recording, reference), limits)
    bands = table_check(run)
    assert [(band.low, band.high) for band in bands[:2]] == [(0.2, 0.5), (0.5, 0.8)]
    for band in bands[:2]:
        assert band.per_angle == pytest.approx(more, abs=0.03)
        assert np.sign(band.more_rad) == np.sign(more) or more == 0.0
    assert sum(band.share for band in bands) <= 1.0


def test_without_table_or_commands_nothing_is_said(driving, reference, limits):
    recording = driving(reference, lambda s: 3.0 + 0.0 * s, rate=50.0)
    result = evaluate(recording, reference)
    assert table_check(profiles_of(recording, result)) == []
    assert table_check(profiles_of(recording, result, limits)) == []
