"""Laps found in the path itself, and the closed line of one of them."""

import numpy as np
import pytest

from map_racing.bags.samples import Recording
from map_racing.errors import EvaluationError, ParameterError
from map_racing.evaluation.driven_line import driven_laps, line_of_lap
from map_racing.track.files.checks import raceline_of
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.size import size_of


def recording(t, x, y, v=None):
    nan = np.full(t.size, np.nan)
    v_x = nan if v is None else np.full(t.size, float(v))
    return Recording(t, x, y, nan, v_x, nan, nan, source="run.bag", topic="/pose")


@pytest.fixture(scope="module")
def driven(track):
    """Factory of drives at 4 m/s and 50 Hz, from standstill: ``driven(laps, d, noise, wait)``."""

    def make(laps=2.6, d=None, noise=0.0, wait=0.0, v=4.0):
        moving = np.arange(int(laps * track.length / v * 50.0)) * 0.02
        s = np.append(np.zeros(int(wait * 50.0)), v * moving)
        t = 0.02 * np.arange(s.size)
        x, y, _ = track.place(s - 2.0, 0.0 if d is None else d(s))
        random = np.random.RandomState(3)
        x, y = (column + noise * random.standard_normal(t.size) for column in (x, y))
        return recording(t, x, y)

    return make


def deviation(track, line):
    """Distance of the points of a line from the true track."""
    truth = track.raceline(0.02)
    apart = np.hypot(truth.x - line.x[:, None], truth.y - line.y[:, None])
    return apart.min(axis=1)


def test_laps_are_found_without_a_raceline(track, driven):
    laps = driven_laps(driven(laps=3.7, wait=2.0, noise=0.01))
    assert [lap.number for lap in laps] == list(range(1, len(laps) + 1)) and len(laps) >= 2
    times = [lap.end - lap.begin for lap in laps]
    assert times == pytest.approx([track.length / 4.0] * len(times), abs=0.02)
    assert not any(lap.reason for lap in laps)


def test_the_line_is_the_one_driven(track, driven):
    drive = driven(noise=0.02)
    table = line_of_lap(drive, driven_laps(drive)[0])
    line = raceline_of(table)
    assert line.length == pytest.approx(track.length, abs=0.1)
    assert np.hypot(*np.diff(table.xy[[0, -1]], axis=0)[0]) == pytest.approx(0.1, abs=0.005)
    assert np.sqrt(np.mean(deviation(track, line) ** 2)) < 0.015  # of noise of 0.028 m
    # Noise of 0.028 m in steps of 0.08 m.
    assert table.columns["speed"] == pytest.approx(4.0, abs=0.4)
    assert np.mean(table.columns["speed"]) == pytest.approx(4.0, abs=0.03)
    # With the noise, radii would be centimeters; only the track's bends remain.
    assert 1.0 / np.abs(line.kappa).max() == pytest.approx(0.65, abs=0.2)


def test_without_noise_smoothing_moves_no_point_far(track, driven):
    drive = driven()
    line = raceline_of(line_of_lap(drive, driven_laps(drive)[0], smoothing=1.0))
    assert deviation(track, line).max() < 0.01


def test_a_lap_that_ends_beside_its_start_is_closed_without_a_bend(track, driven):
    # The car moves 0.1 m to the left each lap, which tightens bends of 0.65 m.
    drive = driven(laps=2.2, d=lambda s: 0.1 * s / track.length - 0.1)
    line = raceline_of(line_of_lap(drive, driven_laps(drive)[0]))
    on_track = raceline_of(line_of_lap(driven(), driven_laps(driven())[0]))
    assert np.abs(line.kappa).max() < 1.2 * np.abs(on_track.kappa).max()
    assert 0.0 <= deviation(track, line).max() < 0.12


def test_measured_speeds_are_taken(track, driven):
    drive = driven()
    drive = recording(drive.t, drive.x, drive.y, v=4.4)
    assert line_of_lap(drive, driven_laps(drive)[0]).columns["speed"] == pytest.approx(4.4)


def test_laps_that_are_no_model(track, driven):
    drive = driven(laps=3.6)
    keep = (drive.t < 6.0) | (drive.t > 6.5)  # no poses for half a second
    gap = recording(drive.t[keep], drive.x[keep], drive.y[keep])
    assert [lap.reason for lap in driven_laps(gap)].count("gap") == 1
    laps = driven_laps(driven(laps=3.6), track.raceline())
    assert [lap.number for lap in laps][0] == 1


@pytest.mark.parametrize("laps", [0.02, 0.8])
def test_a_path_that_does_not_close(driven, laps):
    with pytest.raises(EvaluationError, match="no closed lap"):
        driven_laps(driven(laps=laps))


def test_impossible_distances(driven):
    drive = driven()
    lap = driven_laps(drive)[0]
    with pytest.raises(ParameterError, match=r"spacing: expected 0\.001 to 10 m"):
        line_of_lap(drive, lap, spacing=0.0)
    with pytest.raises(ParameterError, match="smoothing"):
        line_of_lap(drive, lap, smoothing=float("nan"))
    with pytest.raises(EvaluationError, match="too few poses"):
        line_of_lap(drive, lap._replace(end=lap.begin + 0.05))


def test_laps_of_a_passenger_car_are_those_of_a_small_one_enlarged(track, driven):
    small, size = driven(laps=3.7, wait=2.0, noise=0.01, d=aside), size_of(load_vehicle("bmw_320i"))
    large = recording(size.time * small.t, size.length * small.x, size.length * small.y)
    expected, laps = driven_laps(small), driven_laps(large, size=size)
    times = [lap.begin for lap in laps] + [lap.end for lap in laps]
    assert times == pytest.approx(
        [size.time * lap.begin for lap in expected] + [size.time * lap.end for lap in expected]
    )
    assert [lap.reason for lap in laps] == [lap.reason for lap in expected]
    line, same = line_of_lap(small, expected[0]), line_of_lap(large, laps[0], size=size)
    np.testing.assert_allclose(same.xy, size.length * line.xy, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(same.columns["speed"], size.time * line.columns["speed"], rtol=1e-6)


def aside(s):
    """Farther to the left in each lap."""
    return 0.01 * s


@pytest.mark.parametrize("begin", [0.0, 0.3, -0.3, 1.5])
def test_a_crossing_is_no_lap(begin):
    """A figure eight passes its center twice per lap."""
    u = begin + 2.0 * np.pi * np.arange(1300) / 500.0  # 2.6 laps
    length = 36.583  # of x = 6 sin u, y = 6 sin u cos u, by quadrature
    noise = 0.02 * np.random.RandomState(1).standard_normal((2, u.size))
    x, y = 6.0 * np.sin(u) + noise[0], 6.0 * np.sin(u) * np.cos(u) + noise[1]
    drive = recording(0.02 * np.arange(u.size), x, y)
    laps = driven_laps(drive)
    assert [lap.end - lap.begin for lap in laps] == pytest.approx([10.0] * len(laps), abs=0.1)
    assert line_of_lap(drive, laps[0]).xy.shape[0] == pytest.approx(10 * length, abs=3)


def test_much_noise_neither_lengthens_nor_bends_the_line(track, driven):
    """Noise as large as the car's motion between two poses."""
    drive = driven(noise=0.08)
    line = raceline_of(line_of_lap(drive, driven_laps(drive)[0]))
    assert line.length == pytest.approx(track.length, rel=0.01)
    assert 1.0 / np.abs(line.kappa).max() > 0.3
    assert np.sqrt(np.mean(deviation(track, line) ** 2)) < 0.04  # of noise of 0.11 m
