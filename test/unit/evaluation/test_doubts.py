"""Warnings about laps: frames, two nodes on one topic, bunches, ..."""

from dataclasses import replace

import numpy as np
import pytest

from map_racing.bags.samples import Commands, Recording
from map_racing.evaluation.doubts import (
    alternation,
    bunches,
    command_clock,
    command_units,
    doubts_of,
    frame_warning,
    time_jump,
    unfollowed,
)
from map_racing.evaluation.speed import chords, speed_of
from map_racing.evaluation.speed_doubts import speed_warning
from map_racing.evaluation.statistics import mean
from map_racing.evaluation.turning import speed_driven

T = np.arange(0.0, 30.0, 0.0125)


def circling(radius=6.0, omega=0.8):
    return radius * np.cos(omega * T), radius * np.sin(omega * T)


@pytest.mark.parametrize("frame", ["map", "", "world", "car_1/map"])
def test_frames_of_racelines(frame):
    assert frame_warning("/pose", frame) == ""


@pytest.mark.parametrize(
    ("frame", "said"), [("odom", "drifts"), ("car/odom", "drifts"), ("vesc_wheel", "only if both")]
)
def test_frames_that_are_no_map(frame, said):
    assert frame_warning("/pose", frame).startswith(f"/pose is in frame {frame}, ")
    assert said in frame_warning("/pose", frame)


@pytest.mark.parametrize("apart", [0.1, 0.4, 5.0])
def test_poses_of_two_nodes_alternate(apart):
    x, y = circling()
    x[::2] += apart
    doubt = alternation("/pose", T, x, y)
    assert doubt.startswith("/pose: poses alternate between two places ")
    assert f"{apart:.2f} m apart" in doubt


@pytest.mark.parametrize("noise", [0.0, 1e-4])
@pytest.mark.parametrize("times", [2, 3])
def test_poses_that_are_sent_again_do_not_alternate(times, noise):
    x, y = (np.repeat(values[::times], times) for values in circling())
    x, y = (v[: T.size] + noise * np.random.default_rng(1).normal(size=T.size) for v in (x, y))
    assert alternation("/pose", T, x, y) == ""


@pytest.mark.parametrize("early", [0.002, 0.008])
def test_uneven_times_of_a_car_that_drives_do_not_alternate(early):
    t = T.copy()
    t[1::2] -= early
    assert alternation("/pose", t, 6.0 * np.cos(0.8 * t), 6.0 * np.sin(0.8 * t)) == ""


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.1, 1.0])
@pytest.mark.parametrize("omega", [0.0, 0.8, 3.0])
def test_noise_and_driving_do_not_alternate(noise, omega):
    x, y = circling(omega=omega)
    rng = np.random.default_rng(1)
    x, y = x + noise * rng.normal(size=T.size), y + noise * rng.normal(size=T.size)
    assert alternation("/pose", T, x, y) == ""


def test_a_second_sender_for_a_while():
    """In part of the recording, or slower than the first; a late stamp is not a second sender."""
    for part, apart in ((slice(800, 1200, 2), 0.3), (slice(800, 1200, 7), 0.3)):
        x, y = circling()
        x[part] += apart
        y[part] += apart
        assert "from two nodes?" in alternation("/pose", T, x, y)
    late = T.copy()
    late[800:1200:7] -= 0.012
    x, y = 6.0 * np.cos(0.8 * late), 6.0 * np.sin(0.8 * late)
    assert alternation("/pose", T, x, y) == ""


@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_a_single_pose_that_is_wrong(noise):
    rng = np.random.default_rng(1)
    x, y = (v + noise * rng.normal(size=T.size) for v in circling())
    assert alternation("/pose", T, x, y) == ""
    x[1000] += 0.2
    y[1000] += 0.2
    assert "1 pose lies beside those before and after: is it wrong?" in alternation("/p", T, x, y)
    # A correction of the localization is permanent.
    x[1000:] += 0.2
    y[1001:] += 0.2
    assert alternation("/pose", T, x, y) == ""


def test_the_largest_of_twenty_thousand_errors_of_a_noisy_localization_is_no_wrong_pose():
    """In one of many blocks, most errors happen to be small, and one large."""
    noise = np.random.default_rng(1)
    t, errors = np.arange(400) / 40.0, 0.016 * noise.standard_normal((2, 400))
    for aside, wrong in ((0.13, False), (0.25, True)):
        errors[1, 200], errors[1, [199, 201]] = aside, 0.0
        said = alternation("/p", t, 25.0 * t + errors[0], errors[1])
        assert bool(said) == wrong


@pytest.mark.parametrize("ahead", [0.0, 0.07, 0.15, 0.5])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_clock_that_is_set_while_the_car_drives(ahead, noise):
    rng = np.random.default_rng(1)
    x, y = (v + noise * rng.normal(size=T.size) for v in circling())
    t = T + np.where(T > 20.0, ahead, 0.0)
    doubt = time_jump("/pose", t, x, y)
    assert bool(doubt) == (ahead > 0.0)
    if doubt:
        said = f"ahead by {ahead:.2f} s at 20.0 s, while the car moves as in 0.0"
        assert said in doubt or noise > 0.0


@pytest.mark.parametrize("lost", [0.05, 0.2, 1.0])
def test_poses_that_are_missing_are_no_jump_of_time(lost):
    """The car drove on meanwhile; a pose that catches up is not a jump either."""
    there = np.abs(T - 20.0 - 0.5 * lost) > 0.5 * lost
    t, (x, y) = T[there], (v[there] for v in circling())
    assert time_jump("/pose", t, x, y) == ""
    late = np.where(np.abs(T - 20.0 - 0.5 * lost) < 0.5 * lost, 20.0, T)
    x, y = 6.0 * np.cos(0.8 * late), 6.0 * np.sin(0.8 * late)
    assert time_jump("/pose", T, x, y) == ""
    stood = np.where(T < 20.0, T, np.maximum(T - lost, 20.0))
    x, y = 6.0 * np.cos(0.8 * stood), 6.0 * np.sin(0.8 * stood)
    assert time_jump("/pose", T, x, y) == ""


def test_bunches():
    assert bunches("/pose", T) == ""
    four = T[np.arange(T.size) // 4 * 4] + 1e-5 * (np.arange(T.size) % 4)
    assert "0.05 s apart" in bunches("/pose", four)
    jitter = T + 0.004 * np.random.default_rng(1).uniform(size=T.size)
    assert bunches("/pose", jitter) == ""


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (1.0, ""),
        (0.8, "0.80 times"),
        (0.92, ""),
        (1.05, ""),
        (1.12, "1.12 times"),
        (3.6, "in km/h?"),
        (0.1, " 0.10 times"),
        (0.0, ""),
    ],
)
def test_a_speed_that_is_not_the_motion_of_the_poses(factor, said):
    doubt = speed_warning("/odom", T, *circling(), np.full(T.size, factor * 4.8))
    assert said in doubt and bool(doubt) == bool(said)
    still = np.zeros(T.size)
    assert speed_warning("/odom", T, still, still, still) == ""


@pytest.mark.parametrize(
    ("factor", "told", "said"),
    [
        (1.0, 1.0, ""),
        (3.6, 1.0, "from 10.1 to 14.9 s the measured speed is 3.61 times the motion of the poses"),
        (0.0, 1.0, "from 10.1 to 14.9 s the measured speed is 0.00 times"),
        (1.3, 1.0, ""),
        (1.5, 1.0, "from 10.1 to 14.9 s the measured speed is 1.50 times"),
        (0.7, 1.0, ""),
        (0.6, 1.0, "from 10.1 to 14.9 s the measured speed is 0.60 times"),
        (1.0, 3.6, "from 10.1 to 14.9 s the speed commanded is 3.61 times"),
        (1.0, 0.0, "from 10.1 to 14.9 s the speed commanded is 0.00 times"),
        (1.0, -1.0, "from 10.1 to 14.9 s the speed commanded is -1.00 times"),
    ],
)
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_speeds_that_are_wrong_for_a_while(factor, told, said, noise):
    """Only within complete laps: before and after, wheels may spin and somebody else may drive."""
    rng, part = np.random.default_rng(1), (T >= 10.0) & (T <= 15.0)
    x, y = (v + noise * rng.normal(size=T.size) for v in circling())
    v, unknown = 4.8 * np.where(part, factor, 1.0), np.full(T.size, np.nan)
    commands = Commands(T, 0.0 * T, 4.8 * np.where(part, told, 1.0), "/drive")
    driven = Recording(T, x, y, unknown, v, unknown, unknown, topic="/odom", commands=commands)
    doubts = doubts_of(driven, [(5.0, 12.0), (12.0, 20.0)])
    assert len(doubts) == bool(said)
    if said and noise == 0.0:
        assert said in doubts[0]
    for spans in ([], [(20.0, 25.0)], [(1.0, 9.5)]):
        assert doubts_of(driven, spans) == []


@pytest.mark.parametrize(("top", "said"), [(25.0, True), (13.0, True), (11.0, False)])
def test_a_single_speed_that_no_car_has(top, said):
    """More than 2 m/s above twice the speed of the poses."""
    v, unknown = np.full(T.size, 4.8), np.full(T.size, np.nan)
    v[1000] = top
    driven = Recording(T, *circling(), unknown, v, unknown, unknown, topic="/odom")
    doubts = doubts_of(driven, [(5.0, 20.0)])
    told = f"/odom: the measured speed reaches {top} m/s at 12.5 s, where the poses"
    assert len(doubts) == said and all(doubt.startswith(told) for doubt in doubts)
    assert doubts_of(driven, [(5.0, 10.0)]) == []


def test_a_few_samples_tell_nothing_and_ten_seconds_the_unit():
    for few in (2, 3, 20):
        driven = of_poses(*(c[:few] for c in circling()), np.full(few, 20.0), T[:few])
        assert doubts_of(driven, []) == []
    x, y = (c[:800] for c in circling())
    assert "in km/h?" in speed_warning("/odom", T[:800], x, y, np.full(800, 3.6 * 4.8))


@pytest.mark.parametrize("repeated", [1, 5])
@pytest.mark.parametrize(
    ("lag", "said"), [(0.0, ""), (0.3, "0.30 s after"), (-0.3, "0.30 s before")]
)
def test_a_speed_that_is_of_another_moment_than_its_pose(lag, said, repeated):
    """Also if a slower localization repeats its poses; the report then uses the poses' speed."""
    v = 4.0 + 1.2 * np.sin(1.3 * (T - lag)) + 0.5 * np.sin(3.1 * (T - lag))
    way = 4.0 * T - 1.2 / 1.3 * np.cos(1.3 * T) - 0.5 / 3.1 * np.cos(3.1 * T)
    angle = np.repeat(way[::repeated], repeated) / 8.0
    x, y, unknown = 8.0 * np.cos(angle), 8.0 * np.sin(angle), np.full(T.size, np.nan)
    driven = Recording(T, x, y, unknown, v, unknown, unknown, topic="/odom")
    doubts = doubts_of(driven, [(5.0, 20.0)])
    assert len(doubts) == bool(said)
    if said:
        assert f"/odom: the measured speed comes {said} the motion of the poses" in doubts[0]
    assert speed_driven(driven)[1] == (not said)


@pytest.mark.parametrize(
    ("shift", "said"),
    [(0.0, ""), (0.1, ""), (-0.3, ""), (0.5, " before "), (-1.0, " after ")],
)
@pytest.mark.parametrize("turned", [0.0, 3.0])
def test_commands_that_are_not_of_the_time_at_which_the_car_turns(shift, said, turned):
    """Stamps and receipts come from the other clock, so only the driving reveals it."""
    kappa = 0.3 * np.sin(1.3 * T) + 0.2 * np.sin(2.9 * T)
    psi = turned + np.cumsum(5.0 * kappa) * 0.0125
    x, y = (np.cumsum(5.0 * f(psi)) * 0.0125 for f in (np.cos, np.sin))
    unknown = np.full(T.size, np.nan)
    commands = Commands(T - 0.1 + shift, 0.32 * kappa, 5.0 + 0.0 * T, "/drive")
    driven = Recording(T, x, y, psi, unknown, unknown, unknown, commands=commands)
    for heading in (psi, unknown):
        doubt = command_clock(replace(driven, psi=heading))
        assert said in doubt and bool(doubt) == bool(said)


@pytest.mark.parametrize(
    ("angle", "speed", "said"),
    [
        (0.2, 4.8, []),
        (0.2, 6.0, []),
        (0.2, 0.0, []),
        (0.2, -4.8, ["-1.00 times the motion of the poses"]),
        (11.5, 4.8, ["steering angles of 11.5 rad: in degrees?"]),
        (0.2, 17.3, ["3.61 times the motion of the poses: in km/h?"]),
        (0.2, 480.0, ["100.17 times the motion of the poses"]),
    ],
)
def test_commands_in_other_units(angle, speed, said):
    same = np.full(T.size, 1.0)
    commands = Commands(T, angle * same, speed * same, "/drive")
    doubts = command_units(commands, *chords(T, *circling())[:2])
    assert len(doubts) == len(said) and all(a in b for a, b in zip(said, doubts))


def driven_at(v, command):
    """A recording of a straight drive with a speed and a commanded speed over `T`."""
    unknown = np.full(T.size, np.nan)
    commands = Commands(T, 0.0 * T, command, "/drive")
    x = np.cumsum(v) * (T[1] - T[0])
    return Recording(T, x, 0.0 * T, unknown, v, unknown, unknown, commands=commands)


@pytest.mark.parametrize("lag", [0.0, 0.2, 0.5])
@pytest.mark.parametrize("more", [0.8, 1.0, 2.0])
def test_a_speed_that_follows_its_command(lag, more):
    def wave(t):
        return 4.0 + 1.2 * np.sin(1.3 * t) + 0.5 * np.sin(3.1 * t)

    noise = 0.3 * np.random.default_rng(1).normal(size=T.size)
    assert unfollowed(driven_at(wave(T - lag) + noise, more * wave(T))) == ""


def test_commands_that_are_no_speed_to_follow():
    v = 4.0 + 1.2 * np.sin(1.3 * T)
    throttle = 2.0 + 1.3 * np.cos(1.3 * T + 0.4) + 0.4 * np.sin(9.0 * T)  # while accelerating
    for command in (6.0 - v, 2.0 + 1.2 * np.sin(4.1 * T), throttle):
        assert "does not follow the speed commanded" in unfollowed(driven_at(v, command))
    # A speed that hardly varies shows nothing.
    for command in (3.0 + 0.0 * T, 4.0 + 0.1 * np.sin(4.1 * T), 0.0 * T):
        assert unfollowed(driven_at(v, command)) == ""
    # A jump of the pose does not change the speed.
    jumping = driven_at(v, v)
    jumping.x[300::100] += 30.0
    jumping.v_x[:] = np.nan
    assert unfollowed(jumping) == ""


@pytest.mark.parametrize("jitter", [0.0, 0.004, 0.012])
def test_mean_and_top_speed_hold_where_stamps_jitter(jitter):
    """With stamps given on receipt, step length over time step would give arbitrary speeds."""
    x, y = circling()
    t = T + np.random.default_rng(3).uniform(0.0, jitter, T.size)
    v = speed_of(t, x, y, np.full(T.size, np.nan))
    # Uniform jitter of almost a period spreads differences over 0.1 s by 4.9 ms.
    assert mean(v, np.diff(t)) == pytest.approx(4.8, rel=1e-3 + 0.5 * (jitter / 0.1) ** 2)
    assert np.max(v) < 4.8 * (1.001 + 0.2 * (jitter > 0.0))


@pytest.mark.parametrize("every", [1, 4])
@pytest.mark.parametrize("noise", [0.0, 0.003, 0.01, 0.03])
def test_mean_and_top_speed_hold_where_poses_are_noisy(noise, every):
    """The path from pose to pose is longer than the car's, by 6 % for 1 cm at 80 Hz."""
    rng = np.random.default_rng(4)
    x, y = (v[::every] + noise * rng.normal(size=T.size // every) for v in circling())
    v = speed_of(T[::every], x, y, np.full(x.size, np.nan))
    assert mean(v, np.diff(T[::every])) == pytest.approx(4.8, rel=0.002 + 0.2 * noise)
    assert np.max(v) < 4.8 * 1.002 + (0.2 + 25.0 * noise) * (noise > 0.0)


@pytest.mark.parametrize("lost", [0.1, 0.5, 0.7])
@pytest.mark.parametrize("noise", [0.001, 0.003, 0.01])
def test_mean_and_top_speed_hold_where_poses_are_noisy_and_lost(noise, lost):
    """Chords that reduce the noise span a time, not a number of poses: 1 to 3 m/s."""
    rng = np.random.default_rng(4)
    kept = rng.uniform(size=T.size) > lost
    x, y = (v[kept] + noise * rng.normal(size=np.count_nonzero(kept)) for v in circling())
    v = speed_of(T[kept], x, y, np.full(x.size, np.nan))
    assert mean(v, np.diff(T[kept])) == pytest.approx(4.8, rel=0.01)
    assert np.max(v) < 4.8 * 1.01 + 25.0 * noise


def test_half_a_period_of_the_steering_is_no_lag():
    """Steering in step with the turning of a circle with waves."""
    theta = 0.8 * T
    r = 6.0 - 0.1 * np.sin(3.0 * theta)
    x, y = r * np.cos(theta), r * np.sin(theta)
    psi = np.unwrap(np.arctan2(np.gradient(y, T), np.gradient(x, T)))
    kappa = np.gradient(psi, T) / np.hypot(np.gradient(x, T), np.gradient(y, T))
    unknown = np.full(T.size, np.nan)
    commands = Commands(T, np.arctan(0.32 * kappa), 4.8 + 0.0 * T, "/drive")
    assert command_clock(Recording(T, x, y, psi, *[unknown] * 3, commands=commands)) == ""


def of_poses(x, y, v=None, t=T):
    unknown = np.full(t.size, np.nan)
    v = unknown if v is None else v
    return Recording(t, x, y, unknown, v, unknown, unknown, topic="/odom")


@pytest.mark.parametrize("noise", [0.0, 0.01])
@pytest.mark.parametrize("by", [(0.3, 0.0), (0.0, 0.5), (1.5, 1.5)])
def test_a_localization_that_is_corrected_at_once(noise, by):
    """In one step between two poses, forward, sideways or both; not if poses are missing."""
    rng = np.random.default_rng(1)
    x, y = (v + noise * rng.normal(size=T.size) for v in circling())
    assert doubts_of(of_poses(x, y), [(5.0, 20.0)]) == []
    x[1200:], y[1200:] = x[1200:] + by[0], y[1200:] + by[1]
    (doubt,) = doubts_of(of_poses(x, y), [(5.0, 20.0)])
    assert "/odom: at 15.0 s the poses jump sideways by " in doubt
    assert float(doubt.split(" by ")[1].split()[0]) == pytest.approx(np.hypot(*by), abs=0.05)
    assert doubts_of(of_poses(x, y), [(15.5, 20.0)]) == []


@pytest.mark.parametrize("lost", [0.2, 0.6])
def test_poses_that_are_lost_at_random_do_not_step_aside(lost):
    kept = np.random.default_rng(2).uniform(size=T.size) > lost
    x, y = circling(3.0, 1.8)
    assert doubts_of(of_poses(x[kept], y[kept], t=T[kept]), [(5.0, 20.0)]) == []


@pytest.mark.parametrize("digits", [1, 2])
def test_positions_that_were_rounded(digits):
    doubts = doubts_of(of_poses(*(np.round(v, digits) for v in circling())), [])
    assert [doubt for doubt in doubts if "rounded" in doubt] == (
        ["/odom: positions are rounded to 0.1 m: errors are no better than that"]
        if digits == 1
        else []
    )


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (lambda v: 0.0 * v, "from 10.1 to 10.9 s the measured speed is 0.0"),
        (lambda v: 9.0 * v, "from 10.1 to 10.9 s the measured speed is 9."),
        (lambda v: 3.0 * v, "from 10.1 to 10.9 s the measured speed is 3."),
        (lambda v: 2.2 * v, ""),
        (lambda v: 0.7 * v, ""),
        (lambda v: 0.25 * v, "from 10.1 to 10.9 s the measured speed is 0.25"),
    ],
)
def test_a_speed_that_is_nonsense_for_a_second(wrong, said):
    v = np.where((T >= 10.0) & (T <= 11.0), wrong(4.8 + 0.0 * T), 4.8)
    doubts = doubts_of(of_poses(*circling(), v), [(5.0, 20.0)])
    assert len(doubts) == bool(said) and all(said in doubt for doubt in doubts)


def test_a_speed_that_is_held_while_the_car_goes_on():
    v = 4.0 + 1.2 * np.sin(1.3 * T)
    way = 4.0 * T - 1.2 / 1.3 * np.cos(1.3 * T)
    x, y = 8.0 * np.cos(way / 8.0), 8.0 * np.sin(way / 8.0)
    assert doubts_of(of_poses(x, y, v), [(5.0, 20.0)]) == []
    for end in (13.3, 14.0):
        v[(T > 12.0) & (end > T)] = v[T > 12.0][0]
        (doubt,) = doubts_of(of_poses(x, y, v), [(5.0, 20.0)])
        assert f"from 12.0 to {end} s the measured speed stays the same" in doubt
    for span in ((5.0, 11.0), (15.0, 20.0)):
        assert doubts_of(of_poses(x, y, v), [span]) == []
    still = np.full(T.size, 4.8)
    assert doubts_of(of_poses(*circling(), still), [(5.0, 20.0)]) == []


def test_a_speed_that_is_late_from_some_time_on():
    def wave(t):
        return 4.0 + 1.2 * np.sin(1.3 * t) + 0.5 * np.sin(3.1 * t)

    t = np.arange(0.0, 90.0, 0.02)
    way = 4.0 * t - 1.2 / 1.3 * np.cos(1.3 * t) - 0.5 / 3.1 * np.cos(3.1 * t)
    x, y = 8.0 * np.cos(way / 8.0), 8.0 * np.sin(way / 8.0)
    (doubt,) = doubts_of(of_poses(x, y, wave(t - 0.4 * (t > 60.0)), t), [(5.0, 80.0)])
    assert "s the measured speed comes 0.40 s after the motion of the poses" in doubt
