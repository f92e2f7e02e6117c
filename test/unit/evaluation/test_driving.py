"""Speed tracking and timing of poses with known answers."""

import dataclasses

import numpy as np
import pytest

from map_racing.bags.clocks import Clock
from map_racing.bags.samples import Commands, Recording
from map_racing.evaluation.driving import pose_timing, speed_tracking


def recording(t, v, command=None, **changes):
    nan = np.full(t.size, np.nan)
    x = np.append(0.0, np.cumsum(np.diff(t) * v[:-1]))
    commands = None if command is None else Commands(t, 0.0 * t, command)
    return Recording(t, x, 0.0 * t, 0.0 * t, v, nan, nan, commands=commands, **changes)


def wave(t):
    return 4.0 + 1.5 * np.sin(1.3 * t) + 0.5 * np.sin(3.1 * t)


@pytest.mark.parametrize("lag", [0.0, 0.08, 0.25])
def test_lag_of_a_pure_delay(lag):
    t = np.arange(0.0, 40.0, 0.01)
    found = speed_tracking(recording(t, wave(t - lag), wave(t)))
    assert found.lag_s == pytest.approx(lag, abs=0.01)
    assert found.rms_lagged_mps < 0.03
    rms = np.sqrt(np.mean((wave(t - lag) - wave(t)) ** 2))
    assert found.rms_mps == pytest.approx(rms, abs=0.02)


def test_lag_of_a_first_order_drive_is_its_time_constant():
    t, tau = np.arange(0.0, 60.0, 0.01), 0.15
    command, v = wave(0.5 * t), np.empty(t.size)
    v[0] = command[0]
    for i in range(1, t.size):
        v[i] = v[i - 1] + 0.01 / tau * (command[i - 1] - v[i - 1])
    assert speed_tracking(recording(t, v, command)).lag_s == pytest.approx(tau, abs=0.02)


def test_overshoot_and_undershoot():
    t = np.arange(0.0, 40.0, 0.01)
    above = np.where(np.mod(t, 4.0) < 0.4, 0.5, 0.0)
    found = speed_tracking(recording(t, wave(t) + above, wave(t)))
    assert found.overshoot_mps == pytest.approx(0.5, abs=0.05) and found.undershoot_mps < 0.1


def test_a_constant_speed_has_no_lag():
    t = np.arange(0.0, 10.0, 0.01)
    found = speed_tracking(recording(t, np.full(t.size, 3.1), np.full(t.size, 3.0)))
    assert np.isnan(found.lag_s) and found.rms_mps == pytest.approx(0.1)


def test_nothing_to_track():
    t = np.arange(0.0, 10.0, 0.01)
    assert speed_tracking(recording(t, wave(t))) is None
    assert speed_tracking(recording(t, 0.0 * t, wave(t))) is None
    assert speed_tracking(recording(t, np.full(t.size, np.nan), wave(t))) is None


def test_rate_gaps_jumps_and_ages():
    t = np.arange(0.0, 20.0, 0.025)
    t = t[(t < 5.0) | (t > 5.4)]
    run = recording(t, np.full(t.size, 2.0))
    x = run.x.copy()
    x[300:] += 1.5
    received = np.rint(1e9 * (t + 0.03)).astype(np.int64)
    clock = Clock(received, received - np.rint(1e9 * t).astype(np.int64))
    timing = pose_timing(dataclasses.replace(run, x=x, clock=clock))
    assert timing.rate_hz == pytest.approx(40.0)
    assert timing.longest_gap_s == pytest.approx(0.425, abs=0.03) and timing.gaps == 1
    assert timing.jumps == 1 and timing.largest_jump_m == pytest.approx(1.55)
    assert timing.age_s == pytest.approx(0.03) and timing.oldest_s == pytest.approx(0.03)


def test_rate_is_the_mean_where_times_between_poses_alternate():
    t = np.cumsum(np.tile([0.024, 0.026], 300))
    t[400:] += 3.0
    timing = pose_timing(recording(t, np.full(t.size, 2.0)))
    assert timing.rate_hz == pytest.approx(40.0, abs=0.01) and timing.gaps == 1


@pytest.mark.parametrize("lag", [0.0, -3.0, 1e6])
def test_stamps_of_another_clock_say_nothing_about_age(lag):
    t = np.arange(0.0, 5.0, 0.025)
    lags = np.full(t.size, int(lag * 1e9))
    run = recording(t, np.full(t.size, 2.0), clock=Clock(lags, lags))
    assert np.isnan(pose_timing(run).age_s)
    assert np.isnan(pose_timing(recording(t, np.full(t.size, 2.0))).age_s)
