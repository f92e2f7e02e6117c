"""Small recordings with known results that other programs, or this one, silently read wrong.

A car circles at 6 m with d = 0.1 sin(3 theta); a lap takes 2 pi / 0.8 s.
"""

import math

import pytest

from map_racing.evaluation.recordings import load_recording
from map_racing.evaluation.runs import evaluate
from map_racing.track.files.load import load_raceline

LAP = math.tau / 0.8
RMS = 0.1 / math.sqrt(2.0)


@pytest.fixture
def run(shared_cases):
    """Evaluate a case on the circle."""

    def evaluated(name, pose_topic=None):
        line = load_raceline(shared_cases / "circle.csv")
        return evaluate(load_recording(shared_cases / name, pose_topic), line)

    return evaluated


def valid(result):
    return [lap for lap in result.laps if lap.valid]


@pytest.mark.parametrize(
    "name",
    [
        "cmd_clock_year_early.bag",
        "cmd_clock_1s_early.bag",
        "odom_topic_map_odom_tf.bag",
        "tf_two_parents2.bag",
        "tf_scaled_slight.bag",
        "one_topic_two_frames.bag",
        "noslash.bag",
    ],
)
def test_five_laps(run, name):
    laps = valid(run(name))
    assert len(laps) == 5
    for lap in laps:
        assert lap.lap_time_s == pytest.approx(LAP, abs=1e-3)
        assert lap.rms_lateral_error_m == pytest.approx(RMS, abs=2e-4)
        assert lap.max_abs_lateral_error_m == pytest.approx(0.1, abs=5e-4)


@pytest.mark.parametrize("name", ["cmd_clock_year_early.bag", "cmd_clock_1s_early.bag"])
def test_commands_of_another_clock(run, name):
    result = run(name)
    assert any("/drive: the stamps are from another clock" in said for said in result.warnings)
    for lap in valid(result):
        assert lap.speed_reference == "command"
        assert lap.rms_speed_error_mps == pytest.approx(0.0, abs=1e-3)
        assert lap.mean_steering_rate_radps == pytest.approx(0.0255, abs=1e-4)


def test_localization_that_died(run):
    result = run("tf_map_died_drift.bag")
    assert len(valid(result)) == 1
    assert result.laps[-1].end_time_s == pytest.approx(14.9, abs=1e-6)
    assert any("map to odom ends 30.1 s before the others" in said for said in result.warnings)


def test_odometry_that_was_missing(run):
    result = run("tf_gap_short.bag")
    assert len(valid(result)) == 4
    assert [lap.reason for lap in result.laps[1:-1] if lap.reason] == ["gap of 0.60 s"]


def test_odometry_alone_is_no_pose_in_the_map(run):
    (said,) = run("odom_only.bag").warnings
    assert said.startswith("/odom is in frame odom")


def test_second_sender_on_a_topic(run):
    (said,) = run("one_topic_two_frames.bag").warnings
    assert "/odom: 1800 messages of a second sender, /vesc, left out" in said


@pytest.mark.parametrize("topic", ["pf/pose/odom", "/pf/pose/odom"])
def test_either_spelling_of_a_topic(run, topic):
    assert len(valid(run("noslash.bag", topic))) == 5


@pytest.mark.parametrize("topic", ["global_waypoints", "/global_waypoints"])
def test_either_spelling_of_a_raceline(shared_cases, topic):
    load_raceline(f"{shared_cases / 'noslash.bag'}#{topic}")


@pytest.mark.parametrize("name", ["quoted_list.csv", "quoted_tuple_before_xy.csv"])
def test_quoted_cells(run, name):
    laps = valid(run(name))
    assert len(laps) == 4  # in 35 s
    for lap in laps:
        assert lap.lap_time_s == pytest.approx(LAP, abs=1e-3)
        assert lap.rms_lateral_error_m == pytest.approx(RMS, abs=2e-4)


@pytest.mark.parametrize("waypoints", ["wp_xyyawv.csv", "wp_xyyawv_2pi.csv"])
def test_the_commonest_waypoint_file_counts_five_laps(shared_cases, waypoints):
    recording = load_recording(shared_cases / "ellipse_drive.bag")
    result = evaluate(recording, load_raceline(shared_cases / waypoints))
    assert len(valid(result)) == 5
