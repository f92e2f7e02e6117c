"""Tracking: on the right branch while driving, anywhere after a jump."""

import csv
import gzip
import math

import numpy as np
import pytest

from map_racing.errors import ParameterError
from map_racing.track.files.load import load_raceline
from map_racing.track.raceline import Raceline
from map_racing.track.tracker import RacelineTracker


def figure_eight():
    t = np.arange(300) * 2.0 * math.pi / 300
    return Raceline(10.0 * np.sin(t), 5.0 * np.sin(2.0 * t))


def hairpin(walls=None):
    """Two straights, 2 m apart, joined by half circles."""
    straight, bend = np.arange(-10.0, 10.0, 0.2), np.arange(0.0, math.pi, 0.2)
    x = np.concatenate((straight, 10.0 + np.sin(bend), -straight, -10.0 - np.sin(bend)))
    y = np.concatenate((-np.ones(100), -np.cos(bend), np.ones(100), np.cos(bend)))
    widths = {} if walls is None else {"d_left_m": walls + 0.0 * x, "d_right_m": walls + 0.0 * x}
    return Raceline(x, y, **widths)


def drive(tracker, step, laps, noise=0.0, offset=0.0, seed=0):
    """Errors of the arc length and flags (reacquired, lost) for each update."""
    track = tracker.raceline
    random = np.random.default_rng(seed)
    s = np.arange(3.0, laps * track.length, step)
    x, y = track.to_cartesian(s, offset)
    if noise:
        x, y = (column + random.normal(0.0, noise, s.size) for column in (x, y))
    errors, flags = [], []
    for k, position in enumerate(zip(x.tolist(), y.tolist())):
        found = tracker.update(*position)
        errors.append(abs(math.remainder(found.s - s[k], track.length)))
        flags.append((tracker.reacquired, tracker.lost))
    return np.array(errors), flags


@pytest.mark.parametrize("track", [figure_eight(), hairpin()], ids=["figure eight", "hairpin"])
@pytest.mark.parametrize("step", [0.01, 0.28, 1.1])
@pytest.mark.parametrize("offset", [-0.4, 0.0, 0.4])
def test_stays_on_its_branch(track, step, offset):
    errors, flags = drive(RacelineTracker(track), step, 2.2, offset=offset)
    assert errors.max() < 1e-6
    assert flags[0] == (True, False)
    assert not any(reacquired or lost for reacquired, lost in flags[1:])


@pytest.mark.parametrize("track", [figure_eight(), hairpin()], ids=["figure eight", "hairpin"])
def test_stays_on_its_branch_with_noise(track):
    errors, flags = drive(RacelineTracker(track), 0.1, 3.0, noise=0.05)
    assert errors.max() < 0.5
    assert sum(reacquired for reacquired, _ in flags) == 1


def test_stays_on_its_branch_nearer_to_the_other_one():
    track = hairpin(walls=1.0)
    tracker = RacelineTracker(track)
    tracker.update(0.0, -1.0)
    for y in np.arange(-1.0, 0.4, 0.1).tolist():
        found = tracker.update(0.0, y)
    assert found.d == pytest.approx(1.3, abs=1e-6)
    assert not tracker.reacquired
    assert track.project(0.0, y).d == pytest.approx(0.7, abs=1e-6)


def test_beyond_a_wall_another_branch_is_found():
    tracker = RacelineTracker(hairpin(walls=1.0))
    tracker.update(0.0, -1.0)
    found = tracker.update(0.0, 0.6)
    assert tracker.reacquired and not tracker.lost
    assert found.d == pytest.approx(0.4, abs=1e-6)


def test_reacquires_after_a_jump():
    track = figure_eight()
    tracker = RacelineTracker(track)
    for s in (5.0, 5.1, 5.2):
        tracker.update(*track.position(s))
    assert not tracker.reacquired
    found = tracker.update(*track.position(30.0))
    assert found.s == pytest.approx(30.0, abs=1e-6)
    assert tracker.reacquired
    tracker.update(*track.position(30.1))
    assert not tracker.reacquired


def test_recovers_from_a_start_on_the_crossing():
    """Either branch is possible there; driving on shows which one it is."""
    track = figure_eight()
    tracker = RacelineTracker(track)
    wrong = (tracker.update(0.0, 0.0).s + 0.5 * track.length) % track.length
    for way in np.arange(0.0, 6.0, 0.1).tolist():
        found = tracker.update(*track.position(wrong + way))
    assert math.remainder(found.s - wrong - way, track.length) == pytest.approx(0.0, abs=1e-6)


def test_heading_tells_branches_apart():
    track = figure_eight()
    for s in (0.0, 0.5 * track.length):
        psi = track.pose(s).psi
        found = RacelineTracker(track).update(0.0, 0.0, psi + 0.5)
        assert math.remainder(found.s - s, track.length) == pytest.approx(0.0, abs=1e-6)


def test_heading_does_not_carry_a_car_facing_backwards_to_a_far_branch():
    track = hairpin(walls=1.0)
    assert RacelineTracker(track).update(0.0, -1.2, math.pi).d == pytest.approx(-0.2, abs=1e-6)


def test_lost_far_from_the_track_and_found_again():
    track = figure_eight()
    tracker = RacelineTracker(track)
    tracker.update(*track.position(5.0))
    tracker.update(0.0, 40.0)
    assert tracker.lost
    tracker.update(0.0, 39.5)
    assert tracker.lost and not tracker.reacquired
    tracker.update(*track.position(5.0))
    assert not tracker.lost and tracker.reacquired


def test_standing_and_reversing():
    track = hairpin()
    tracker = RacelineTracker(track)
    for s in (5.0, 5.0, 5.0, 4.9, 4.8, 2.0, 0.1, -0.2):
        found = tracker.update(*track.position(s))
        assert found.s == pytest.approx(s % track.length, abs=1e-6)


def test_spinning_through_the_center_of_the_bend():
    """Across a center of curvature the projection may leap, but is always the closest one."""
    track = hairpin()
    tracker = RacelineTracker(track)
    tracker.max_deviation = 1.5
    for y in np.arange(-1.2, 1.2, 0.05).tolist():
        found = tracker.update(10.05, y)
        if abs(y) > 0.1:
            nearest = track.project(10.05, y)
            assert abs(found.d) == pytest.approx(abs(nearest.d), abs=1e-6)


def test_reset_forgets():
    track = figure_eight()
    tracker = RacelineTracker(track)
    tracker.update(*track.position(1.0))
    tracker.reset()
    assert not tracker.reacquired and not tracker.lost
    tracker.update(*track.position(1.1))
    assert tracker.reacquired


def test_no_position_leaves_the_tracker_where_it_was():
    track = figure_eight()
    tracker = RacelineTracker(track)
    tracker.update(*track.position(5.0))
    with pytest.raises(ParameterError, match="finite position"):
        tracker.update(math.nan, 0.0)
    found = tracker.update(*track.position(5.1))
    assert found.s == pytest.approx(5.1, abs=1e-6)
    assert not tracker.reacquired


def test_implausible_follows_the_walls():
    assert RacelineTracker(hairpin()).max_deviation == 2.0
    assert RacelineTracker(hairpin(walls=1.2)).max_deviation == pytest.approx(1.7)


def test_real_laps_are_tracked_without_a_break(shared_data):
    folder = shared_data / "laps" / "ipz20"
    track = load_raceline(folder / "IPZ20_wp.csv")
    laps = {}
    for path in sorted(folder.glob("2026*.csv.gz")):
        tracker, progress, last = RacelineTracker(track), 0.0, None
        with gzip.open(str(path), "rt") as lines:
            for k, row in enumerate(csv.DictReader(line for line in lines if line[0] != "#")):
                found = tracker.update(float(row["pose_x"]), float(row["pose_y"]))
                assert tracker.reacquired == (k == 0)
                assert abs(found.d) < 0.9
                if last is not None:
                    progress += math.remainder(found.s - last, track.length)
                last = found.s
        laps[path.name[11:19]] = progress / track.length
    expected = {"01-45-24": 4.43, "01-48-12": 4.80, "01-53-39": 4.39}
    assert laps == pytest.approx(expected, abs=0.01)
