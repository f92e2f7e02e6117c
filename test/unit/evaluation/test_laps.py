import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.bags.reader import read_recording
from map_racing.bags.samples import Commands, Recording
from map_racing.errors import EvaluationError, ParameterError
from map_racing.evaluation.driving import pose_timing
from map_racing.evaluation.lap_limits import LapLimits
from map_racing.evaluation.laps import LapEvaluator
from map_racing.evaluation.recordings import load_recording, recorded_raceline
from map_racing.evaluation.results import Summary
from map_racing.evaluation.runs import evaluate
from map_racing.track.files.load import load_raceline
from map_racing.track.raceline import Raceline

V = 6.0
RATE = 40.0


def run(line, t, x, y, *columns, **options):
    evaluator = LapEvaluator(line, **options)
    evaluator.update(t, x, y, *columns)
    return evaluator.finish()


@pytest.fixture(scope="session")
def drive(track):
    """Function from a function s(t) and a deviation d(s) to samples ``t, x, y``."""

    def make(duration, s=lambda t: V * t - 3.0, d=lambda s: np.full_like(s, 0.1), rate=RATE):
        t = np.arange(int(duration * rate)) / rate
        x, y, _ = track.place(s(t), d(s(t)))
        return t, x, y

    return make


@pytest.fixture(scope="session")
def line(track):
    return track.raceline(speed=V, walls=1.0)


def reasons(result):
    return [lap.reason.split(" of ")[0] for lap in result.laps]


# -- known answers ---------------------------------------------------------------------------------


@pytest.mark.rest_once
@pytest.mark.parametrize("spacing", [0.02, 0.1, 0.3, 0.7])
@pytest.mark.parametrize("phase", [0.0, 0.011])
def test_known_laps_at_any_waypoint_spacing(track, spacing, phase):
    """Speed and deviation vary; both are known functions of time."""

    def progress(t):
        return 7.0 * t + 0.8 * np.sin(1.7 * t) - 3.0

    def deviation(s):
        turn = 2.0 * np.pi * s / track.length
        return 0.1 + 0.25 * np.sin(3.0 * turn) + 0.05 * np.cos(5.0 * turn)

    t = np.arange(0.0, 20.0, 1.0 / RATE) + phase
    x, y, _ = track.place(progress(t), deviation(progress(t)))
    laps = [lap for lap in run(track.raceline(spacing), t, x, y).laps if lap.valid]
    assert len(laps) == 4
    fine = np.linspace(0.0, 20.0, 2000001)
    crossings = np.interp(track.length * np.arange(5), progress(fine), fine)
    for lap, start, end in zip(laps, crossings, crossings[1:]):
        d = deviation(progress(np.linspace(start, end, 100001)))
        assert lap.start_time_s == pytest.approx(start, abs=1e-3)
        assert lap.lap_time_s == pytest.approx(end - start, abs=1e-3)
        assert lap.rms_lateral_error_m == pytest.approx(math.sqrt(np.mean(d * d)), abs=1e-3)
        assert lap.mean_abs_lateral_error_m == pytest.approx(np.mean(np.abs(d)), abs=1e-3)
        assert lap.mean_lateral_error_m == pytest.approx(np.mean(d), abs=1e-3)
        assert lap.max_abs_lateral_error_m == pytest.approx(np.abs(d).max(), abs=1e-3)
        p95 = np.percentile(np.abs(d), 95.0)
        assert lap.p95_abs_lateral_error_m == pytest.approx(p95, abs=1e-3)
        assert sum(lap.sector_times_s) == pytest.approx(lap.lap_time_s, abs=1e-12)
        thirds = progress(start) + track.length * np.array([1.0, 2.0]) / 3.0
        ends = [start, *np.interp(thirds, progress(fine), fine), end]
        np.testing.assert_allclose(lap.sector_times_s, np.diff(ends), atol=1e-3)


@pytest.mark.parametrize(
    ("count", "phase", "expected"),
    [(52, 0.0, 2.3e-3), (52, 0.5, 7.8e-3), (104, 0.0, 0.3e-3), (104, 0.5, 0.5e-3)],
)
def test_waypoints_that_are_coarse_for_a_bend(count, phase, expected):
    """A lap on an ellipse with end radii of 0.7 m, given by points 1 m or 0.5 m apart."""
    angle = np.linspace(0.0, 2.0 * np.pi, 100001)
    x, y = 12.0 * np.cos(angle), 2.9 * np.sin(angle)
    s = np.append(0.0, np.cumsum(np.hypot(np.diff(x), np.diff(y))))

    def place(at):
        at = np.interp(at % s[-1], s, angle)
        return 12.0 * np.cos(at), 2.9 * np.sin(at)

    line = Raceline(*place((np.arange(count) + phase) * s[-1] / count))
    t = np.arange(0.0, 20.0, 1.0 / RATE)
    laps = [lap for lap in run(line, t, *place(V * t - 3.0), start_s=1.0).laps if lap.valid]
    assert len(laps) == 2
    for lap in laps:
        assert lap.rms_lateral_error_m == pytest.approx(expected, abs=0.1e-3)


@pytest.mark.parametrize("rate", [7.0, 25.0, 40.0, 100.0])
def test_lap_time_does_not_depend_on_the_sampling(drive, track, line, rate):
    limits = LapLimits(max_gap=1.0)
    result = run(line, *drive(18.0, rate=rate), limits=limits)
    laps = [lap for lap in result.laps if lap.valid]
    assert len(laps) == 3
    for lap in laps:
        assert lap.lap_time_s == pytest.approx(track.length / V, abs=1e-3)
        assert lap.rms_lateral_error_m == pytest.approx(0.1, abs=1e-3)


@pytest.mark.parametrize("start", [0.1, 1.7e9 + 0.1])
@pytest.mark.parametrize("decimals", [3, 9])
def test_four_poses_a_second_are_no_gaps(drive, line, start, decimals):
    """0.25 s apart, as long as a gap may be, but for the rounding of times."""
    t, x, y = drive(18.0, rate=4.0)
    t = start + np.round(t + 0.0004 * (-1.0) ** np.arange(t.size), decimals)
    recorded = recording(t, x, y)
    assert [lap.valid for lap in evaluate(recorded, line).laps].count(True) == 3
    assert pose_timing(recorded).gaps == 0


def test_values_of_a_lap(drive, track, line):
    t, x, y = drive(12.0)
    v = np.full(t.size, 5.5)
    steering = np.repeat(np.arange(t.size // 8), 8) % 2 * 0.1
    result = run(line, t, x, y, v, None, steering, car_width=0.4, sectors=4)
    lap = result.laps[1]
    assert lap.valid
    assert lap.min_clearance_m == pytest.approx(1.0 - 0.1 - 0.2, abs=1e-3)
    assert lap.mean_speed_mps == pytest.approx(5.5)
    assert lap.max_speed_mps == 5.5
    assert lap.speed_reference == "raceline"
    assert lap.rms_speed_error_mps == pytest.approx(0.5, abs=1e-9)
    # 0.1 rad every 8 samples, however long it is held: 0.5 rad/s.
    assert lap.mean_steering_rate_radps == pytest.approx(0.5, abs=0.02)
    assert len(lap.sector_times_s) == 4
    np.testing.assert_allclose(lap.sector_times_s, track.length / V / 4.0, atol=1e-3)
    commanded = run(line, t, x, y, v, np.full(t.size, 7.0))
    assert commanded.laps[1].speed_reference == "command"
    assert commanded.laps[1].rms_speed_error_mps == pytest.approx(1.5)


def test_speed_without_measurement_is_that_of_the_pose(drive, line):
    lap = run(line, *drive(12.0, d=lambda s: np.zeros_like(s))).laps[1]
    assert lap.mean_speed_mps == pytest.approx(V, abs=0.01)
    assert lap.max_speed_mps == pytest.approx(V, abs=0.05)


def test_without_walls_and_speeds(drive, track):
    lap = run(track.raceline(), *drive(12.0)).laps[1]
    assert lap.valid
    assert math.isnan(lap.min_clearance_m)
    assert math.isnan(lap.rms_speed_error_mps)
    assert lap.speed_reference == ""


# -- start line ------------------------------------------------------------------------------------


def test_stretches_before_and_after_are_reported(drive, line):
    result = run(line, *drive(12.0))
    assert reasons(result) == ["out-lap", "", "", "in-lap"]
    assert [lap.lap for lap in result.laps] == [0, 1, 2, 3]
    assert [lap.valid for lap in result.laps] == [False, True, True, False]
    assert [math.isnan(lap.lap_time_s) for lap in result.laps] == [True, False, False, True]
    for before, after in zip(result.laps, result.laps[1:]):
        assert before.end_time_s == after.start_time_s


@pytest.mark.parametrize("start", [0.3, 0.5, 0.7, -0.2])
def test_start_line_can_be_moved(drive, track, line, start):
    result = run(line, *drive(16.0), start_s=start * track.length)
    assert result.start_s == pytest.approx(start % 1.0 * track.length)
    valid = [lap for lap in result.laps if lap.valid]
    assert len(valid) == 2
    expected = (3.0 + start % 1.0 * track.length) / V
    assert valid[0].start_time_s == pytest.approx(expected, abs=1e-3)
    for lap in valid:
        assert lap.lap_time_s == pytest.approx(track.length / V, abs=1e-3)


@pytest.mark.parametrize("start", [1.01, 17.0, -1.01])
def test_a_start_line_beyond_the_lap_is_refused(track, line, start):
    with pytest.raises(ParameterError, match="start line: expected an arc length of at most"):
        LapEvaluator(line, start_s=start * track.length)


def test_a_standing_start_on_the_line_is_an_out_lap(drive, line):
    result = run(line, *drive(11.0, s=lambda t: V * t))
    assert reasons(result) == ["out-lap", "", "in-lap"]


def test_crossing_the_line_to_and_fro_is_no_lap(drive, track, line):
    """Out, across the line, 3 m on, 5 m back across the line, and then a lap."""
    knots = [0.0, 1.0, 3.0, 4.0, 6.0, 12.0]
    places = [-2.0, 3.0, 3.0, -2.0, -2.0, -2.0 + V * 6.0]
    result = run(line, *drive(12.0, s=lambda t: np.interp(t, knots, places)))
    assert reasons(result) == ["out-lap", "not completed; reverse", "", "in-lap"]
    lap = result.laps[2]
    assert lap.start_time_s == pytest.approx(6.0 + 2.0 / V, abs=1e-3)
    assert lap.lap_time_s == pytest.approx(track.length / V, abs=1e-3)


def test_a_car_that_wobbles_on_the_line_starts_its_lap_when_it_leaves(drive, track, line):
    def s(t):
        return np.where(t < 4.0, 0.05 * np.sin(9.0 * t - 0.1), V * (t - 4.0) + 0.01)

    result = run(line, *drive(10.0, s=s))
    assert [lap.valid for lap in result.laps].count(True) == 1
    (lap,) = [lap for lap in result.laps if lap.valid]
    assert lap.start_time_s == pytest.approx(3.99, abs=0.05)


# -- laps that do not count ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pause", "expected"), [(0.2, []), (0.6, ["not completed"]), (3.0, ["not completed"])]
)
def test_time_spent_at_the_line_does_not_vanish(drive, line, pause, expected):
    """The car crosses the line, stands 0.3 m beyond it, rolls back 0.4 m and sets out again."""

    def progress(t):
        times = [0.0, 1.0, 1.2, 1.2 + pause, 1.4 + pause, 2.0 + pause, 20.0]
        return np.interp(t, times, [-3.0, 0.0, 0.3, 0.3, -0.1, 0.2, 0.2 + 6.0 * (18.0 - pause)])

    result = run(line, *drive(16.0, progress))
    laps = len([lap for lap in result.laps if lap.valid])
    assert laps >= 2
    assert reasons(result) == ["out-lap", *expected, *[""] * laps, "in-lap"]
    if expected:
        stood = result.laps[1]
        assert stood.end_time_s - stood.start_time_s == pytest.approx(0.6 + pause, abs=0.02)


def test_gap(drive, line):
    t, x, y = drive(17.5)
    keep = (t < 7.0) | (t > 7.4)
    result = run(line, t[keep], x[keep], y[keep])
    assert reasons(result) == ["out-lap", "", "gap", "", "in-lap"]
    assert "gap of 0.45 s" in result.laps[2].reason
    assert not math.isnan(result.laps[2].lap_time_s)
    assert result.summary.laps_completed == 2


def test_the_largest_of_several_faults_is_named(drive, line):
    t, x, y = drive(17.5)
    keep = (np.abs(t - 7.0) > 0.3) & (np.abs(t - 8.5) > 0.2)
    assert run(line, t[keep], x[keep], y[keep]).laps[2].reason == "gap of 0.65 s"
    x = x + np.where(np.abs(t - 7.0) < 0.05, 2.0, 0.0) + np.where(np.abs(t - 8.5) < 0.05, 1.2, 0.0)
    limits = LapLimits(max_deviation=5.0)
    largest = max(np.hypot(np.diff(x), np.diff(y))[(t[1:] > 6.0) & (t[1:] < 9.0)])
    assert run(line, t, x, y, limits=limits).laps[2].reason.startswith(f"jump of {largest:.2f} m")


def test_steps_of_a_fast_car_are_no_jumps_where_its_speed_is_measured():
    """At 30 m/s and 10 Hz, steps are 3 m; the raceline has no speeds."""
    angle = 2.0 * np.pi * np.arange(400) / 400
    line = Raceline(50.0 * np.cos(angle), 50.0 * np.sin(angle))
    t = np.arange(0.0, 25.0, 0.1)
    turn = 0.6 * t - 0.1
    x, y = 50.0 * np.cos(turn), 50.0 * np.sin(turn)
    assert [lap.valid for lap in run(line, t, x, y, np.full(t.size, 30.0)).laps] == [
        *(False, True, True, False)
    ]
    # Up to 1.5 times the measured speed, and no more.
    for v in (np.zeros(t.size), np.full(t.size, 15.0), 30.0 * (np.arange(t.size) % 2)):
        assert reasons(run(line, t, x, y, v))[1] == "jump"


def test_laps_too_short_to_brake_in_count():
    """On a circle of 0.25 m radius at 4 m/s: 0.39 s."""
    angle = 2.0 * np.pi * np.arange(40) / 40
    line = Raceline(0.25 * np.cos(angle), 0.25 * np.sin(angle))
    t = np.arange(0.0, 2.0, 0.05)
    turn = 16.0 * t - 0.5
    laps = run(line, t, 0.25 * np.cos(turn), 0.25 * np.sin(turn)).laps[1:-1]
    assert len(laps) >= 4 and all(lap.valid for lap in laps)
    assert all(lap.lap_time_s == pytest.approx(2.0 * np.pi / 16.0, abs=2e-3) for lap in laps)


def test_the_first_sample_beyond_the_line_is_an_in_lap(drive, line):
    t, x, y = drive(16.0)
    end = 1 + int(np.searchsorted(t, run(line, t, x, y).laps[2].end_time_s))
    for size, expected in (
        (end - 1, ["out-lap", "", "in-lap"]),
        (end, ["out-lap", "", "", "in-lap"]),
    ):
        assert reasons(run(line, t[:size], x[:size], y[:size])) == expected


def test_gap_over_the_line_spoils_both_laps(drive, track, line):
    t, x, y = drive(17.5)
    crossing = (3.0 + track.length) / V
    keep = np.abs(t - crossing) > 0.2
    result = run(line, t[keep], x[keep], y[keep])
    assert reasons(result) == ["out-lap", "gap", "gap", "", "in-lap"]


def test_jump(drive, track, line):
    t, x, y = drive(17.5)
    x = x + np.where((t > 7.0) & (t < 7.1), 0.8, 0.0)
    result = run(line, t, x, y, limits=LapLimits(max_deviation=5.0))
    assert reasons(result) == ["out-lap", "", "jump", "", "in-lap"]


def test_a_shortcut_is_a_jump(drive, track, line):
    t, x, y = drive(17.5, s=lambda t: V * t - 3.0 + np.where(t > 7.0, 0.4 * track.length, 0.0))
    result = run(line, t, x, y)
    assert reasons(result)[2] == "jump"
    assert [lap.valid for lap in result.laps] == [False, True, False, True, False]


@pytest.mark.parametrize(
    ("left", "along", "seen"), [(1.0, 4.2, True), (0.2, None, True), (4.0, None, False)]
)
def test_a_car_that_cuts_across_between_two_straights_takes_a_shortcut(left, along, seen):
    """Straights of 12 m, 1.4 m apart; the car leaves the first at a distance [m] before its end.

    If poses are missing there, for 0.35 s, only the gap is reported.
    """
    bend = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 23)[1:-1]
    ahead = np.linspace(-6.0, 6.0, 121)
    x = np.concatenate((ahead, 6.0 + 0.7 * np.cos(bend), -ahead, -6.0 - 0.7 * np.cos(bend)))
    y = np.concatenate((0.0 * ahead - 0.7, 0.7 * np.sin(bend)))
    walls = np.full(x.size, 0.5)
    line = Raceline(x, np.append(y, -y), d_left_m=walls, d_right_m=walls)
    before = line.sample(np.arange(-2.0, 12.0 - left, 0.1))
    across = np.arange(-0.7, 0.7, 0.1)
    s = line.project(6.0 - left, 0.7).s
    after = line.sample(np.arange(s, 2.0 * line.length + 1.0, 0.1))
    x = np.concatenate((before.x, np.full(across.size, 6.0 - left), after.x))
    y = np.concatenate((before.y, across, after.y))
    limits = LapLimits(max_deviation=5.0)
    t = np.arange(x.size) / RATE
    kept = np.full(t.size, True)
    if not seen:
        kept[before.x.size : before.x.size + across.size] = False
    out, lap, whole, _ = run(line, t[kept], x[kept], y[kept], limits=limits).laps
    if not seen:
        assert lap.reason == "gap of 0.38 s"
    elif along is None:
        assert lap.reason == ""
    else:
        kind, size = lap.reason[:-2].split(" of ")
        assert kind == "shortcut" and float(size) == pytest.approx(along, abs=0.15)
    assert whole.valid


def test_a_car_carried_back_behind_the_line_starts_a_new_lap(drive, track, line):
    """After a crash during the lap, the car is put down before the start line."""
    length = track.length

    def s(t):
        return np.where(t < 7.0, V * t - 3.0, V * (t - 7.0) + length - 2.0)

    result = run(line, *drive(14.0, s=s))
    assert [lap.valid for lap in result.laps] == [False, True, False, True, False]
    assert result.laps[2].reason.startswith("not completed; jump")
    assert math.isnan(result.laps[2].lap_time_s)
    assert result.laps[3].lap_time_s == pytest.approx(length / V, abs=1e-3)


@pytest.mark.parametrize("hold", [4, 8])
def test_a_pose_that_catches_up_is_no_jump(drive, line, hold):
    """The localization repeats its pose for up to 0.2 s, and then catches up with the car."""
    t, x, y = drive(17.5, rate=40.0)
    held = np.arange(t.size) // hold * hold
    result = run(line, t, x[held], y[held], limits=LapLimits(max_speed=8.0))
    assert reasons(result) == ["out-lap", "", "", "", "in-lap"]


def test_a_pose_that_was_repeated_for_long_is_a_gap(drive, line):
    t, x, y = drive(17.5, rate=40.0)
    held = np.where((t > 7.0) & (t < 7.5), 280, np.arange(t.size))
    result = run(line, t, x[held], y[held])
    assert result.laps[2].reason == "gap of 0.50 s"
    assert [lap.valid for lap in result.laps] == [False, True, False, True, False]


def test_a_pose_that_hangs_over_the_line_crosses_it_in_its_last_step(drive, line):
    t, x, y = drive(16.0)
    end = run(line, t, x, y).laps[1].end_time_s
    hangs = (t > end - 0.3) & (t < end + 0.2)
    for column in (x, y):
        column[hangs] = column[np.flatnonzero(hangs)[0]]
    lap = run(line, t, x, y).laps[1]
    assert lap.reason.startswith("gap of 0.5")
    last = t[np.flatnonzero(hangs)[-1]]
    assert last < lap.end_time_s < last + 1.0 / RATE + 1e-9


def test_a_small_step_of_the_pose_is_no_jump_wherever_the_tracker_looked(track, drive):
    """Far outside of the limits the whole track is searched; the projection moves a little more."""
    line = track.raceline(walls=0.2)
    t, x, y = drive(17.5, d=lambda s: 0.9 * np.sin(0.2 * s))
    assert not any("jump" in lap.reason for lap in run(line, t, x, y).laps)


@pytest.mark.parametrize(
    ("stood", "counts"), [(0.2, True), (0.35, False), (0.8, False), (5.0, False)]
)
def test_a_car_that_stood(drive, track, line, stood, counts):
    """It brakes at 8 m/s^2 from 6 m/s, stands at s = 20 m, and sets out again."""
    brake = V / 8.0
    way = 0.5 * V * brake

    def s(t):
        t_1 = (track.length + 20.0 + 3.0 - way) / V
        t_2, t_3 = t_1 + brake, t_1 + brake + stood
        slowing = np.clip(t - t_1, 0.0, brake)
        going = np.clip(t - t_3, 0.0, brake)
        there = V * np.minimum(t, t_1) + V * slowing - 4.0 * slowing**2 + 4.0 * going**2
        return there + V * np.maximum(t - t_3 - brake, 0.0) - 3.0 + 0.0 * t_2

    result = run(line, *drive(23.0, s=s))
    reason = result.laps[2].reason
    assert result.laps[2].valid is counts
    assert not math.isnan(result.laps[2].lap_time_s)
    if not counts:
        seconds, place = re.fullmatch(r"stood (.*) s at s = (.*) m", reason).groups()
        # It is within 5 cm of the place for another 0.1 s before and after.
        assert float(seconds) == pytest.approx(stood + 0.2, abs=0.11)
        assert float(place) == pytest.approx(20.0, abs=0.1)
        (moved,) = [
            lap.reason
            for lap in run(line, *drive(23.0, s=s), start_s=5.0).laps
            if "stood" in lap.reason
        ]
        assert float(moved[:-2].split(" = ")[1]) == pytest.approx(20.0, abs=0.1)
    longer = LapLimits(max_stop=stood + 0.5)
    assert run(line, *drive(23.0, s=s), limits=longer).laps[2].valid


@pytest.mark.parametrize(("times", "place"), [((1.0, 2.0), "22"), ((2.0, 1.0), "10")])
def test_the_longest_of_two_stops_is_told(drive, track, line, times, place):
    first = (track.length + 3.0 + 10.0) / V
    knots = np.cumsum([0.0, first, times[0], 2.0, times[1], 10.0])
    places = np.cumsum([-3.0, V * first, 0.0, 12.0, 0.0, 60.0])
    reason = run(line, *drive(19.0, s=lambda t: np.interp(t, knots, places))).laps[2].reason
    assert re.search(r"stood 2\.\d s at s = (\d+)\.", reason)[1] == place


def test_a_car_that_creeps_around_has_not_stood(drive, track, line):
    result = run(line, *drive(1.3 * track.length / 0.25, s=lambda t: 0.25 * t - 2.0, rate=10.0))
    assert [lap.valid for lap in result.laps] == [False, True, False]


def test_a_wall_stops_a_car_as_no_brake_does(drive, track, line):
    """7 m/s in one sample, 0.5 m/s in the next, and on after 0.25 s."""
    hit = (track.length + 12.0 + 3.0) / 7.0
    knots, places = [0.0, hit, hit + 0.25, 18.0], np.cumsum([-3.0, 7.0 * hit, 0.1, 80.0])
    result = run(line, *drive(13.0, s=lambda t: np.interp(t, knots, places)))
    assert result.laps[2].reason.startswith("stopped from 6.7 to 0.4 m/s")
    assert result.laps[2].reason.endswith("at s = 12.0 m")
    assert [lap.valid for lap in result.laps[:3]] == [False, True, False]


def test_a_wall_is_seen_at_a_low_rate(drive, track, line):
    """7 m/s, then 0.4 m/s for a second, with 10 poses per second."""
    hit = (track.length + 12.0 + 3.0) / 7.0
    knots, places = [0.0, hit, hit + 1.0, 18.0], np.cumsum([-3.0, 7.0 * hit, 0.4, 80.0])
    result = run(line, *drive(14.0, s=lambda t: np.interp(t, knots, places), rate=10.0))
    assert result.laps[2].reason.startswith("stopped from ")


@pytest.mark.parametrize(("deceleration", "stopped"), [(20.0, False), (30.0, True)])
def test_brakes_are_weaker_than_walls(drive, track, line, deceleration, stopped):
    """From 7 m/s; after 0.1 s it accelerates again just as hard."""
    begin = (track.length + 15.0) / 7.0
    brake = 7.0 / deceleration

    def s(t):
        slowing = np.clip(t - begin, 0.0, brake)
        going = np.clip(t - begin - brake - 0.1, 0.0, brake)
        way = 7.0 * np.minimum(t, begin + brake) - 0.5 * deceleration * (slowing**2 - going**2)
        return way + 7.0 * np.maximum(t - begin - 2.0 * brake - 0.1, 0.0) - 3.0

    result = run(line, *drive(13.0, s=s))
    assert result.laps[2].reason.startswith("stopped") is stopped
    assert result.laps[2].valid is not stopped


def test_speed_where_stamps_come_in_bunches(drive, line):
    """Four poses within 60 us, 0.1 s apart: the car still drives 6 m/s."""
    t, x, y = drive(12.0, rate=40.0)
    bunched = t[np.arange(t.size) // 4 * 4] + 2e-5 * (np.arange(t.size) % 4)
    lap = run(line, bunched, x, y).laps[1]
    assert lap.max_speed_mps == pytest.approx(V, rel=0.02)
    assert lap.mean_speed_mps == pytest.approx(V, rel=0.02)


@pytest.mark.parametrize("repeats", [1, 2, 4])
def test_a_localization_slower_than_its_messages(drive, line, repeats):
    """Each pose is repeated until the next: the lap takes 5 s at 6 m/s, whatever the phase."""
    t, x, y = drive(18.0, rate=40.0)
    index = np.arange(t.size) // repeats * repeats
    result = run(line, t, x[index], y[index])
    laps = [lap for lap in result.laps if lap.valid]
    expected = line.length / V
    assert len(laps) == 3
    for lap in laps:
        assert lap.lap_time_s == pytest.approx(expected, abs=1e-3)
        assert lap.max_speed_mps == pytest.approx(V, rel=0.02)


def test_odometry_without_velocity(drive, line):
    """It was never filled in: the speed comes from the poses."""
    lap = run(line, *drive(12.0), 0.0).laps[1]
    # 0.1 m to the left the lap is shorter.
    expected = V * (1.0 - 0.1 * math.tau / line.length)
    assert lap.mean_speed_mps == pytest.approx(expected, rel=1e-3)
    assert run(line, np.arange(5.0), np.zeros(5), np.zeros(5), 0.0).laps[0].mean_speed_mps == 0.0


@pytest.mark.parametrize("stood", [0.4, 3.0])
def test_speed_of_a_car_that_stands_between_poses(drive, track, line, stood):
    """Repeated poses of a standing car do not mean a slow localization."""
    hit = (track.length + 12.0 + 3.0) / V
    there = track.length + 12.0
    knots = [0.0, hit, hit + stood, 30.0 + stood]
    places = [-3.0, there, there, there + V * (30.0 - hit)]
    lap = run(line, *drive(15.0, s=lambda t: np.interp(t, knots, places))).laps[2]
    assert not lap.valid
    assert lap.mean_speed_mps == pytest.approx(track.length / lap.lap_time_s, rel=0.05)
    assert lap.max_speed_mps < 1.5 * V


def test_reverse(drive, line):
    knots = [0.0, 3.0, 4.0, 12.0]
    places = [-3.0, 15.0, 13.0, 13.0 + 8.0 * V]
    result = run(line, *drive(12.0, s=lambda t: np.interp(t, knots, places)))
    assert reasons(result) == ["out-lap", "reverse", "", "in-lap"]
    assert "reverse of 2.00 m" in result.laps[1].reason


def test_off_track(drive, track, line):
    def d(s):
        return np.where(np.abs(s - 1.5 * track.length) < 1.0, 1.2, 0.1)

    limits = LapLimits(max_speed=100.0)
    result = run(line, *drive(17.5, d=d), limits=limits)
    assert reasons(result) == ["out-lap", "", "off track by 0.20 m", "", "in-lap"]
    assert result.laps[2].min_clearance_m == pytest.approx(-0.35, abs=1e-3)
    limits = LapLimits(max_speed=100.0, max_deviation=1.5)
    assert reasons(run(line, *drive(17.5, d=d), limits=limits))[2] == ""
    without_walls = track.raceline()
    assert (
        reasons(run(without_walls, *drive(17.5, d=d), limits=LapLimits(max_speed=100.0)))[2] == ""
    )


def test_walls_and_speeds_are_those_where_the_car_is(drive, track, line):
    """Wherever the start line is."""
    narrow = np.where(np.abs(line.s_points - 10.0) < 1.0, 0.5, 1.0)
    speed = 5.0 + np.sin(2.0 * np.pi * line.s_points / track.length)
    raceline = Raceline(line.x, line.y, vx_mps=speed, d_left_m=narrow, d_right_m=1.0 + 0.0 * narrow)
    t, x, y = drive(12.0)
    v = 5.0 + np.sin(2.0 * np.pi * (V * t - 3.0) / track.length)
    for start in (0.0, 8.0):
        lap = run(raceline, t, x, y, v, start_s=start).laps[1]
        assert lap.rms_speed_error_mps == pytest.approx(0.0, abs=1e-3)
        assert lap.min_clearance_m == pytest.approx(0.4 - 0.15, abs=1e-3)
    beside = run(raceline, *drive(0.4 * track.length / V, lambda t: 12.0 + V * t), start_s=8.0)
    assert beside.laps[0].min_clearance_m == pytest.approx(0.9 - 0.15, abs=1e-3)


@pytest.mark.parametrize("beyond, counts", [(-0.1, True), (0.1, False)])
@pytest.mark.parametrize(
    "limit, fault",
    [
        ("max_gap", "gap of 0.38 s"),
        ("max_reverse", "reverse of 0.60 m"),
        ("no walls", "off track by 0.10 m"),
    ],
)
def test_limits_as_documented(drive, track, line, limit, fault, beyond, counts):
    """A gap of 0.25 s, rolling back by 0.5 m, and 2 m off a track without walls."""
    t, x, y = drive(17.5)
    if limit == "max_gap":
        keep = np.abs(t - 8.0) > 0.5 * (0.25 + beyond)
        t, x, y = t[keep], x[keep], y[keep]
    elif limit == "max_reverse":
        back = 0.5 + beyond
        knots, places = [0.0, 8.0, 8.0 + back, 18.0], [-3.0, 45.0, 45.0 - back, 105.0 - 2.0 * back]
        t, x, y = drive(17.5, s=lambda t: np.interp(t, knots, places))
    else:
        line = track.raceline()
        far = 2.0 + beyond
        t, x, y = drive(17.5, d=lambda s: np.where(np.abs(s - 55.0) < 0.5, -far, 0.1))
        limits = LapLimits(max_speed=200.0)
        result = run(line, t, x, y, limits=limits)
    if limit != "no walls":
        result = run(line, t, x, y, limits=LapLimits(max_deceleration=1000.0))
    assert result.laps[2].valid is counts
    assert result.laps[2].reason.startswith("" if counts else fault)


def test_deviation_that_changes_sides_between_samples(drive, track):
    """Linear in between: the mean magnitude of +-0.1 m is half of that."""
    t, x, y = drive(12.0, d=lambda s: 0.1 * (-1.0) ** np.arange(s.size))
    lap = run(track.raceline(), t, x, y).laps[1]
    assert lap.mean_abs_lateral_error_m == pytest.approx(0.05, abs=1e-4)
    assert lap.rms_lateral_error_m == pytest.approx(0.1 / math.sqrt(3.0), abs=1e-4)
    assert lap.p95_abs_lateral_error_m == pytest.approx(0.095, abs=2e-4)
    assert lap.mean_lateral_error_m == pytest.approx(0.0, abs=1e-3)


def test_a_sector_ends_at_its_first_passage(drive, track, line):
    third = track.length / 3.0
    knots = [0.0, (third + 3.2) / V, (third + 3.2) / V + 0.4, 12.0]
    places = [-3.0, third + 0.2, third - 0.2, third - 0.2 + V * (12.0 - knots[2])]
    limits = LapLimits(max_deceleration=1000.0)
    samples = drive(12.0, s=lambda t: np.interp(t, knots, places))
    out, lap = run(line, *samples, limits=limits).laps[:2]
    assert len(out.sector_times_s) == 3 and all(map(math.isnan, out.sector_times_s))
    assert lap.valid
    assert lap.sector_times_s[0] == pytest.approx(third / V, abs=2e-3)
    assert sum(lap.sector_times_s) == pytest.approx(lap.lap_time_s, abs=1e-9)


def test_a_car_pulled_back_over_the_line_at_once_is_told(drive, line):
    knots, places = [0.0, 0.5, 0.8, 1.1, 8.1], [-3.0, 0.0, 2.0, -1.0, -1.0 + 7.0 * V]
    result = run(line, *drive(8.0, s=lambda t: np.interp(t, knots, places)))
    assert reasons(result)[:2] == ["out-lap", "not completed; reverse"]
    assert result.laps[2].valid


# -- one sample or a million -----------------------------------------------------------------------


def as_bits(result):
    rows = [lap.row() for lap in result.laps]
    return [
        [np.float64(v).tobytes() if isinstance(v, float) else v for v in row.values()]
        for row in rows
    ]


@pytest.mark.once
@given(st.data())
@settings(deadline=None, max_examples=25)
def test_any_chunking_gives_identical_laps(drive, line, data):
    t, x, y = drive(12.0)
    t, x, y = (np.delete(column, slice(300, 320)) for column in (t, x, y))
    columns = (t, x, y, 5.0 + 0.1 * np.sin(t), np.full(t.size, 5.0), 0.1 * np.cos(3.0 * t))
    whole = LapEvaluator(line)
    whole.update(*columns)
    cuts = sorted(data.draw(st.lists(st.integers(0, t.size), max_size=8)))
    parts = LapEvaluator(line)
    ended = []
    for first, last in zip([0, *cuts], [*cuts, t.size]):
        ended += parts.update(*(column[first:last] for column in columns))
    result = parts.finish()
    assert as_bits(result) == as_bits(whole.finish())
    assert [lap.lap for lap in ended] == [lap.lap for lap in result.laps[: len(ended)]]


def test_single_samples_give_identical_laps(drive, line):
    t, x, y = drive(12.0)
    single = LapEvaluator(line)
    ended = [lap for row in zip(t, x, y) for lap in single.update(*map(float, row))]
    result = single.finish()
    assert as_bits(result) == as_bits(run(line, t, x, y))
    assert len(ended) == len(result.laps) - 1


def test_samples_that_cannot_be_used_are_passed_over(drive, line):
    t, x, y = drive(12.0)
    expected = run(line, t, x, y)
    rows = []
    for i, row in enumerate(zip(t, x, y)):
        rows.append(row)
        if i % 50 == 0:
            rows += [row, (row[0], row[1] + 5.0, row[2])]
            rows += [(row[0] - 0.01, 0.0, 0.0), (row[0] + 0.001, math.nan, 0.0)]
            rows += [(math.nan, row[1], row[2]), (row[0] + 0.001, 1e300, 0.0)]
    assert as_bits(run(line, *np.array(rows).T)) == as_bits(expected)


@pytest.mark.parametrize("rate", [RATE, 10.0])
def test_clock_set_back_begins_a_new_out_lap(drive, line, rate):
    t, x, y = drive(8.0, rate=rate)
    evaluator = LapEvaluator(line)
    evaluator.update(t, x, y)
    evaluator.update(t, x, y)
    result = evaluator.finish()
    assert reasons(result) == ["out-lap", "", "clock set back", "out-lap", "", "in-lap"]
    assert result.laps[1].lap_time_s == result.laps[4].lap_time_s
    first = int(0.4 * rate)
    evaluator.update(t[:first], x[:first], y[:first])
    evaluator.update(t, x, y)
    assert reasons(evaluator.finish()) == ["out-lap; clock set back", "out-lap", "", "in-lap"]


def test_finish_makes_the_evaluator_as_new(drive, line):
    evaluator = LapEvaluator(line)
    assert evaluator.finish().laps == []
    t, x, y = drive(12.0)
    evaluator.update(t, x, y)
    first = evaluator.finish()
    evaluator.update(t + 1000.0, x, y)
    second = evaluator.finish()
    assert [lap.lap for lap in second.laps] == [0, 1, 2, 3]
    assert second.summary.mean_lap_time_s == pytest.approx(first.summary.mean_lap_time_s)


def test_memory_is_released_with_each_lap(drive, line):
    evaluator = LapEvaluator(line)
    t, x, y = drive(60.0)
    evaluator.update(t, x, y)
    assert len(evaluator._samples) < 8 * 6.0 * RATE
    assert all(lap.trace is None for lap in evaluator.finish().laps)


@pytest.mark.parametrize(
    "options, said",
    [
        ({"start_s": math.nan}, "start line: expected a finite"),
        ({"car_width": -1.0}, "car width: expected 0 to 10 m, got -1.0"),
        ({"car_width": math.nan}, "car width: expected 0 to 10 m, got nan"),
        ({"car_width": 300.0}, "car width: expected 0 to 10 m, got 300.0"),
        ({"sectors": 0}, "sectors: expected 1 to 1000, got 0"),
        ({"sectors": 1001}, "sectors: expected 1 to 1000, got 1001"),
    ],
)
def test_impossible_parameters(line, options, said):
    with pytest.raises(ParameterError, match=said):
        LapEvaluator(line, **options)


def test_bounds_are_possible_parameters(drive, line):
    for width in (0.0, 10.0):
        assert len(run(line, *drive(8.0), car_width=width).laps) == 3
    assert len(run(line, *drive(8.0), sectors=1000).laps[1].sector_times_s) == 1000
    (whole,) = run(line, *drive(8.0), sectors=1).laps[1].sector_times_s
    assert whole == pytest.approx(run(line, *drive(8.0)).laps[1].lap_time_s, nan_ok=True)
    assert len(run(line, *drive(8.0), start_s=line.length + 0.009).laps) == 3
    with pytest.raises(ParameterError, match="start line"):
        LapEvaluator(line, start_s=line.length + 0.011)


# -- summary ---------------------------------------------------------------------------------------


def test_summary_counts_valid_laps_only(drive, line):
    t, x, y = drive(23.0)
    keep = (t < 7.0) | (t > 7.4)
    result = run(line, t[keep], x[keep], y[keep])
    valid = [lap for lap in result.laps if lap.valid]
    times = [lap.lap_time_s for lap in valid]
    summary = result.summary
    assert (summary.laps_completed, summary.laps_not_counted) == (3, 3)
    assert summary.mean_lap_time_s == pytest.approx(np.mean(times))
    assert summary.std_lap_time_s == pytest.approx(np.std(times, ddof=1))
    assert summary.best_lap_time_s == min(times)
    assert summary.max_abs_lateral_error_m == max(lap.max_abs_lateral_error_m for lap in valid)


def test_summary_of_nothing_is_not_completed():
    summary = Summary.of([])
    assert summary.laps_completed == 0
    assert math.isnan(summary.mean_lap_time_s)
    assert math.isnan(summary.best_lap_time_s)


# -- recordings ------------------------------------------------------------------------------------


def recording(t, x, y, **options):
    nan = np.full(t.size, math.nan)
    values = {"psi": nan, "v_x": nan, "v_y": nan, "yaw_rate": nan, "source": "run.bag", **options}
    return Recording(t, x, y, **values)


def test_a_recording_is_evaluated_as_its_samples_are(drive, line):
    t, x, y = drive(12.0)
    options = {"start_s": 5.0, "car_width": 0.4, "sectors": 5}
    result = evaluate(recording(t, x, y), line, **options)
    assert as_bits(result) == as_bits(run(line, t, x, y, **options))
    assert as_bits(evaluate(recording(t, x, y), line)) == as_bits(run(line, t, x, y))


def test_a_single_sample_is_no_recording(drive, line):
    t, x, y = drive(12.0)
    with pytest.raises(EvaluationError, match="run.bag: expected at least two samples"):
        evaluate(recording(t[:1], x[:1], y[:1]), line)


def test_commands_are_held(drive, line):
    t, x, y = drive(12.0)
    at = np.arange(1.0, 12.0, 0.5) + 0.003
    commands = Commands(at, np.where(np.arange(at.size) % 2, 0.1, -0.1), np.full(at.size, 4.0))
    result = evaluate(recording(t, x, y, v_x=np.full(t.size, 6.0), commands=commands), line)
    assert result.source == "run.bag"
    lap = result.laps[1]
    assert lap.speed_reference == "command"
    assert lap.rms_speed_error_mps == pytest.approx(2.0)
    assert lap.mean_steering_rate_radps == pytest.approx(0.2 / 0.5, abs=0.05)
    assert lap.trace.t[0] == lap.start_time_s
    assert lap.trace.s[0] == 0.0
    assert lap.trace.s[-1] == pytest.approx(line.length)


def test_commands_that_begin_later_or_never(drive, line):
    t, x, y = drive(12.0)
    none, late = np.zeros(0), np.arange(7.0, 12.0)
    for commands in (Commands(none, none, none), Commands(late, 0.0 * late, 0.0 * late + 4.0)):
        laps = evaluate(recording(t, x, y, v_x=np.full(t.size, 6.0), commands=commands), line).laps
        before = [lap for lap in laps if lap.end_time_s < 7.0]
        assert [lap.speed_reference for lap in before] == ["raceline", "raceline"]
        assert before[1].rms_speed_error_mps == pytest.approx(0.0, abs=1e-9)
    assert laps[-1].speed_reference == "command"
    assert laps[-1].rms_speed_error_mps == pytest.approx(2.0)


def test_commands_that_end_are_not_held_for_ever(drive, line):
    """The speed error covers only the time with commands, and a warning says so."""
    t, x, y = drive(18.0)
    at = np.arange(0.0, 8.0, 0.025)
    commands = Commands(at, 0.0 * at, np.where(at < 7.9, 6.0, 1.0))
    result = evaluate(recording(t, x, y, v_x=np.full(t.size, 6.0), commands=commands), line)
    assert result.laps[1].rms_speed_error_mps == pytest.approx(0.0, abs=1e-9)
    assert result.laps[3].speed_reference == "raceline"
    assert result.warnings == [
        "no drive commands in laps 3: their speed error, if any, is relative to the raceline",
        "drive commands are missing for a part of laps 2: their speed error and steering rate "
        "cover only the rest",
    ]


def test_car_that_drove_elsewhere(drive, line):
    t, x, y = drive(12.0)
    with pytest.raises(EvaluationError, match=r"run.bag: the car drove elsewhere.*bean") as error:
        evaluate(recording(t, x + 30.0, y), line)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("off, elsewhere", [(1.3, False), (1.7, True)])
def test_walls_drawn_too_tight_are_not_elsewhere(drive, line, off, elsewhere):
    t, x, y = drive(12.0, d=lambda s: np.full_like(s, -off))
    if elsewhere:
        with pytest.raises(EvaluationError, match="half of the time more than 1.7 m off"):
            evaluate(recording(t, x, y), line)
    else:
        assert "off track by 0.30 m" in evaluate(recording(t, x, y), line).laps[1].reason


def test_a_recording_is_judged_by_the_limits_given(drive, line):
    limits = LapLimits(max_deviation=0.05)
    assert evaluate(recording(*drive(12.0)), line, limits=limits).laps[1].reason == (
        "off track by 0.05 m"
    )


@pytest.mark.parametrize(
    "walls, limit, off, elsewhere",
    [
        ((0.3, 2.2), None, 0.7, False),
        ((0.3, 2.2), None, 0.9, True),
        ((1.0, 2.2), None, -2.6, False),
        ((1.0, 2.2), None, -2.8, True),
        (None, None, 2.4, False),
        (None, None, -2.6, True),
        ((1.0, 1.0), 2.0, 2.4, False),
        ((1.0, 1.0), 2.0, 2.6, True),
    ],
)
def test_elsewhere_is_half_a_meter_beyond_walls_or_limit(drive, line, walls, limit, off, elsewhere):
    t, x, y = drive(12.0, d=lambda s: np.full_like(s, off))
    widths = {} if walls is None else dict(zip(("d_left_m", "d_right_m"), walls))
    columns = {name: np.full(line.x.size, width) for name, width in widths.items()}
    raceline, limits = Raceline(line.x, line.y, **columns), LapLimits(max_deviation=limit)
    if elsewhere:
        with pytest.raises(EvaluationError, match="drove elsewhere.* the raceline raceline$"):
            evaluate(recording(t, x, y), raceline, limits=limits)
    else:
        assert evaluate(recording(t, x, y), raceline, limits=limits).laps


@pytest.mark.parametrize("begin, elsewhere", [(0.1, False), (0.6, True)])
def test_walls_are_those_where_the_car_is(drive, track, line, begin, elsewhere):
    """Wide ones in the first half of the track, narrow ones in the second."""
    width = np.where(line.s_points < 0.5 * track.length, 1.0, 0.1)
    raceline = Raceline(line.x, line.y, d_left_m=width, d_right_m=width)
    duration = 0.3 * track.length / V
    driven = recording(
        *drive(duration, lambda t: begin * track.length + V * t, lambda s: 0 * s + 0.65)
    )
    if elsewhere:
        with pytest.raises(EvaluationError, match="drove elsewhere"):
            evaluate(driven, raceline, start_s=0.35 * track.length)
    else:
        assert evaluate(driven, raceline, start_s=0.35 * track.length).laps


@pytest.mark.parametrize("share", [0.4, 0.7, 3.0])
def test_car_that_never_came_along_drove_elsewhere(track, line, share):
    """Circles at 4 m/s beside the line; less than half a lap may be a start."""
    t = np.arange(0.0, share * track.length / 4.0, 1.0 / 40.0)
    x, y, psi = track.place(10.0)
    circle = recording(t, x + 0.5 * np.cos(8.0 * t), y + 0.5 * np.sin(8.0 * t))
    if share < 0.5:
        assert not evaluate(circle, line).summary.laps_completed
        return
    with pytest.raises(EvaluationError) as error:
        evaluate(circle, line)
    found = re.search(r": (\d+) m, but only \d m along the raceline bean$", str(error.value))
    assert int(found.group(1)) == pytest.approx(share * track.length, rel=0.1)


def test_car_that_drove_against_the_direction(drive, line):
    result = evaluate(recording(*drive(12.0, s=lambda t: -V * t)), line)
    assert result.summary.laps_completed == 0
    assert result.laps[0].reason.startswith("out-lap; reverse")
    assert any("against the direction" in note for note in result.notes)


@pytest.mark.parametrize("share, noted", [(-0.3, False), (-0.7, True), (0.7, False)])
def test_half_a_lap_backwards_is_against_the_direction(drive, track, line, share, noted):
    t, x, y = drive(abs(share) * track.length / V, s=lambda t: math.copysign(V, share) * t + 5.0)
    notes = evaluate(recording(t, x, y), line).notes
    assert bool(notes) is noted


def test_hangar_recording(shared_data):
    path = shared_data / "recordings" / "hangar_map_12laps.bag"
    driven = read_recording(path)
    for source in (driven, read_recording(path, "/car_state/pose")):
        result = evaluate(source, recorded_raceline(driven))
        valid = [lap for lap in result.laps if lap.valid]
        assert len(valid) == 11
        assert reasons(result) == ["out-lap"] + 11 * [""] + ["in-lap"]
        for lap in valid:
            assert 5.34 <= lap.lap_time_s <= 5.39
            assert 0.10 <= lap.rms_lateral_error_m <= 0.12


def test_hangar_laps_agree_with_the_printout_of_its_own_tracker(shared_data):
    """Its clock restarts up to 0.1 m late, so each lap is about 0.06 s too short."""
    folder = shared_data / "recordings"
    driven = read_recording(folder / "hangar_map_12laps.bag")
    text = (folder / "hangar_map_12laps.txt").read_text()
    printed = [float(time) for time in re.findall(r"Lap duration: ([0-9.]+)", text)]
    summary = evaluate(driven, recorded_raceline(driven)).summary
    assert summary.mean_lap_time_s - np.mean(printed[1:]) == pytest.approx(0.06, abs=0.01)


@pytest.mark.once
def test_hangar_bag_on_another_track(shared_data):
    driven = read_recording(shared_data / "recordings" / "hangar_map_12laps.bag")
    other = load_raceline(shared_data / "laps" / "ipz20" / "IPZ20_wp.csv")
    with pytest.raises(EvaluationError, match="drove elsewhere"):
        evaluate(driven, other)


def test_real_laps(shared_data):
    folder = shared_data / "laps" / "ipz20"
    line = load_raceline(folder / "IPZ20_wp.csv")
    times = []
    for path in sorted(folder.glob("*.csv.gz")):
        result = evaluate(load_recording(path), line)
        assert result.laps[0].reason.startswith("out-lap")
        assert result.laps[-1].reason.startswith("in-lap")
        times += [lap.lap_time_s for lap in result.laps[1:-1]]
    assert len(times) == 10
    assert min(times) > 6.6
    assert max(times) < 9.4


@pytest.mark.once
def test_a_lap_of_a_full_size_car_has_no_jumps():
    """50 m/s at 50 Hz is one meter from pose to pose; the raceline's speeds show that this is
    normal."""
    track = load_raceline("circuit")
    ends = np.cumsum(track.ds / track.speed)
    t = np.arange(-3.0, ends[-1] + 3.0, 0.02)
    at = track.sample(np.interp(t % ends[-1], ends, track.s + track.ds) % track.length)
    result = run(track, t, at.x, at.y)
    (lap,) = [lap for lap in result.laps if lap.valid]
    assert lap.lap_time_s == pytest.approx(ends[-1], abs=0.1)
    slow = Raceline(track.x, track.y)
    assert not any(lap.valid for lap in run(slow, t, at.x, at.y).laps)
