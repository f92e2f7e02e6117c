"""Where a lap loses time: known losses are found in the right places, and put into words."""

import dataclasses

import numpy as np
import pytest

from map_racing.control.controller import build_controller
from map_racing.control.parameters import load_controller_parameters
from map_racing.evaluation.analysis import analyze, corner_rows, references, same_track
from map_racing.evaluation.places import (
    Corner,
    Place,
    Reference,
    against_best,
    against_ideal,
    against_run,
    corners_of,
    costliest,
    ideal_lap,
)
from map_racing.evaluation.profiles import car_limits, profiles_of, track_profile
from map_racing.evaluation.recordings import load_recording
from map_racing.evaluation.runs import evaluate
from map_racing.simulation.plant import Localization, Plant
from map_racing.simulation.plants import load_plant
from map_racing.simulation.race import race
from map_racing.simulation.recorded import write_race_bag
from map_racing.track.raceline import Raceline
from map_racing.vehicle.parameters import load_vehicle


def profile(driving, line, *arguments, **options):
    recording = driving(line, *arguments, **options)
    return profiles_of(recording, evaluate(recording, line))


def bump(s, length, begin, end):
    """1 between two places of each lap, smooth at the ends."""
    inside = (np.mod(s, length) - begin) / (end - begin)
    return np.where((inside > 0.0) & (inside < 1.0), np.sin(np.pi * inside) ** 2, 0.0)


# -- corners ---------------------------------------------------------------------------------------


def test_corners_of_the_reference_track(reference):
    corners = corners_of(track_profile(reference, 0.0))
    assert [corner.name for corner in corners] == [
        *("first left", "first right", "second left", "second right"),
        *("third left", "fourth left", "fifth left"),
    ]
    apexes = [corner.apex for corner in corners]
    assert apexes == pytest.approx([3.5, 7.2, 11.5, 16.0, 21.7, 27.4, 33.5], abs=0.3)
    for corner, following in zip(corners, corners[1:] + corners[:1]):
        assert corner.end == following.begin
        assert corner.inside(np.array([corner.apex]), reference.length)[0]
    s = np.linspace(0.0, reference.length, 1001)[:-1]
    count = sum(corner.inside(s, reference.length).astype(int) for corner in corners)
    assert np.all(count == 1)


def test_corners_are_counted_from_the_start_line(reference):
    corners = corners_of(track_profile(reference, 5.5))
    assert corners[0].name == "first right" and corners[0].apex == pytest.approx(7.2 - 5.5, abs=0.3)


def test_corners_without_speeds(reference):
    bare = Raceline(reference.x, reference.y)
    found = [c.apex for c in corners_of(track_profile(bare, 0.0))]
    tight = [c.apex for c in corners_of(track_profile(reference, 0.0))]
    assert np.min(np.abs(np.subtract.outer(tight, found)), axis=1).max() < 0.6


def test_a_circle_is_one_stretch_without_name(ring):
    (whole,) = corners_of(track_profile(ring, 0.0))
    assert whole.name == "" and whole.side == 0
    assert whole.inside(np.array([0.0, 3.0, 9.0]), ring.length).all()


# -- ideal lap -------------------------------------------------------------------------------------


def test_ideal_lap_takes_the_best_of_each_mini_sector(reference, driving):
    half = 0.5 * reference.length

    def speed(s):  # one lap is slow in its first half, the next in its second
        second = np.mod(s, reference.length) > half
        return np.where(second == (np.floor(s / reference.length) == 0), 3.0, 4.0)

    run = profile(driving, reference, speed)
    ideal = ideal_lap(run)
    assert ideal.time_s == pytest.approx(reference.length / 4.0, abs=0.02)
    assert ideal.times.shape == (2, ideal.ends.size)
    assert ideal.times.sum(axis=1) == pytest.approx([p.lap.lap_time_s for p in run.laps])
    reference_lap = against_ideal(run, ideal)
    assert reference_lap.time[-1] == pytest.approx(ideal.time_s)
    assert np.all(np.diff(reference_lap.time) > -1e-9)


def test_no_lap_is_better_than_the_ideal_one(reference, driving):
    run = profile(driving, reference, lambda s: 4.0 + 0.3 * np.sin(0.37 * s), laps=4)
    assert ideal_lap(run).time_s <= run.best.lap.lap_time_s


# -- places ----------------------------------------------------------------------------------------


def test_a_slow_entry_and_a_wide_exit_are_the_first_two_places(reference, driving):
    length = reference.length

    def speed(s):
        return 4.0 - 1.0 * bump(s, length, 19.0, 22.0) - 0.6 * bump(s, length, 9.5, 11.5)

    def wide(s):  # to the right: the outside of a left-hand bend
        return -0.15 * bump(s, length, 20.0, 23.0)

    good = profile(driving, reference, lambda s: 4.0)
    bad = profile(driving, reference, speed, wide)
    corners = corners_of(bad.track)
    first, second, *rest = costliest(bad, against_run(good, "the other"), corners)
    assert [first.corner.name, second.corner.name] == ["third left", "second left"]
    s = np.arange(0.0, length, 0.001)
    lost = np.sum(0.001 / speed(s) - 0.001 / 4.0)
    assert first.loss_s + second.loss_s == pytest.approx(lost, rel=0.06)
    assert 19.0 < first.begin < 19.6 and 21.4 < first.end < 22.0
    assert first.wide_m == pytest.approx(0.15, abs=0.01)
    assert first.slowest == pytest.approx(3.0, abs=0.1) and first.slowest_reference == (
        pytest.approx(4.0, abs=0.1)
    )
    assert "third left: 0.12 s; " in str(first) and "0.15 m wide at the" in str(first)
    assert "slows to 3.0 instead of 4.0 m/s" in str(first) and "grip" not in str(first)
    assert all(place.loss_s < 0.02 for place in rest)


def test_side_and_place_of_the_deviation(reference, driving):
    """To the inside in a right-hand bend, before its apex."""
    good = profile(driving, reference, lambda s: 4.0)
    bad = profile(
        driving,
        reference,
        lambda s: 4.0 - bump(s, reference.length, 13.8, 17.5),
        lambda s: -0.2 * bump(s, reference.length, 13.8, 15.0),
    )
    place = costliest(bad, against_best(good.best), corners_of(bad.track))[0]
    assert place.corner.name == "second right" and place.wide_m == pytest.approx(-0.2, abs=0.02)
    assert place.wide_at == "entry" and "0.20 m closer to the inside at the entry" in place.why


def test_the_same_driving_has_no_places(reference, driving):
    run = profile(driving, reference, lambda s: 4.0)
    found = costliest(run, against_run(run, "itself"), corners_of(run.track))
    assert found == []


def test_who_is_faster_all_along_loses_nothing(reference, driving):
    run = profile(driving, reference, lambda s: 4.0)
    # Noise of the poses in one cell gives a lap of 3 m/s 4 ms less than this one.
    time = run.mean("time")
    slower = time * 4.0 / 3.0
    slower[72:] -= 0.004 + (slower[72] - slower[71]) - (time[72] - time[71])
    noisy = Reference("", slower, 0.75 * run.mean("v"), run.mean("d"))
    assert costliest(run, noisy, corners_of(run.track)) == []


def test_a_longer_way_costs_time_at_a_higher_speed(reference, driving):
    good = profile(driving, reference, lambda s: 4.0)
    wide = profile(
        driving, reference, lambda s: 3.9, lambda s: -0.3 * bump(s, reference.length, 9.0, 14.0)
    )
    slow = Reference("", good.mean("time"), 0.95 * wide.mean("v"), good.mean("d"))
    places = costliest(wide, slow, corners_of(wide.track))
    assert [place.corner.name for place in places] == ["second left"]


def test_a_place_over_the_start_line(reference, driving):
    length = reference.length
    slow = lambda s: 4.0 - bump(s + 1.5, length, 0.0, 3.0)  # noqa: E731
    bad = profile(driving, reference, slow, laps=3)
    good = profile(driving, reference, lambda s: 4.0)
    first = costliest(bad, against_run(good, "other"), corners_of(bad.track))[0]
    assert first.begin > first.end or first.end == pytest.approx(length, abs=0.1)


# -- two simulated runs ----------------------------------------------------------------------------


def simulated(line, path):
    """A lap of the shipped car after its out-lap, as a bag."""
    parameters = load_controller_parameters("map").with_(speed_scale=0.65)
    plant = load_plant("nuc4")
    controller = build_controller(parameters, load_vehicle("nuc4"), line)
    log = race(Plant(plant), controller, line, Localization(plant, 1), laps=1)
    write_race_bag(path, log, line)
    return load_recording(path)


@pytest.fixture(scope="module")
def two_runs(tmp_path_factory, reference):
    """One run that brakes 0.5 m too early before a bend and runs wide in another; a good one."""
    folder = tmp_path_factory.mktemp("two")
    corners = {c.name: c for c in corners_of(track_profile(reference, 0.0))}
    early, wide = corners["second left"], corners["fourth left"]
    s = reference.s_points
    at = reference.sample(s)
    sooner = np.minimum(at.speed, reference.sample(s + 0.5).speed)
    speed = np.where((s > early.begin) & (s < early.apex), sooner, at.speed)
    # Wide around the exit, by up to 0.35 m, over such a distance that the car is back on its line
    # before the next bend.
    d = -0.35 * bump(s, reference.length, wide.apex - 1.5, wide.end + 0.5)
    x, y = reference.to_cartesian(s, d)
    bad = Raceline(x, y, vx_mps=speed, d_left_m=at.d_left - d, d_right_m=at.d_right + d, name="bad")
    return [simulated(line, folder / f"{line.name}.bag") for line in (bad, reference)]


def test_the_first_two_places_are_the_bends_that_were_driven_badly(reference, two_runs):
    bad, good = (
        analyze(recording, evaluate(recording, reference), name=name)
        for recording, name in zip(two_runs, ("bad", "good"))
    )
    assert same_track(bad, good)
    other = references(bad, [good])[0]
    assert other.name == "the mean lap of good"
    places = costliest(bad.profile, other, bad.corners)
    assert {place.corner.name for place in places[:2]} == {"second left", "fourth left"}
    by_name = {place.corner.name: place for place in places}
    assert by_name["fourth left"].wide_m == pytest.approx(0.35, abs=0.08)
    assert "wide at the" in str(by_name["fourth left"])
    assert by_name["second left"].loss_s > 0.02
    assert by_name["second left"].early_m == pytest.approx(0.5, abs=0.15)
    assert "; brakes 0." in str(by_name["second left"])
    assert "brakes" not in str(by_name["fourth left"])
    assert not places[2:] or places[2].loss_s < 0.5 * places[1].loss_s


# -- over the laps ---------------------------------------------------------------------------------


def test_consistency_of_the_corners(reference, driving):
    speeds = [3.0, 4.0]

    def speed(s):
        lap = np.clip(np.floor(s / reference.length), 0, 1).astype(int)
        return np.array(speeds)[lap]

    recording = driving(reference, speed)
    run = analyze(recording, evaluate(recording, reference))
    rows = corner_rows(run)
    assert [row.corner for row in rows] == run.corners
    assert sum(row.time_s for row in rows) == pytest.approx(
        np.mean([p.lap.lap_time_s for p in run.profile.laps])
    )
    middle = rows[3]
    length = middle.corner.end - middle.corner.begin
    assert middle.best_s == pytest.approx(length / 4.0, rel=0.03)
    assert middle.time_std_s == pytest.approx(
        np.std([length / 3.0, length / 4.0], ddof=1), rel=0.03
    )
    assert middle.slowest_mps == pytest.approx(3.5, abs=0.03)
    assert middle.slowest_std_mps == pytest.approx(np.sqrt(0.5), abs=0.03)


def test_slowest_is_the_bend_not_the_stretch(reference, driving):
    """The stretch also contains the exit of the previous corner and the braking for the next."""

    def speed(s):
        return 0.7 * reference.sample(s % reference.length).speed

    recording = driving(reference, speed)
    run = analyze(recording, evaluate(recording, reference))
    track, v = run.profile.track, run.profile.mean("v")
    apart = 0
    for row in corner_rows(run):
        apex = v[int(np.argmin(np.abs(track.s - row.corner.apex)))]
        inside = row.corner.inside(track.s, track.length)
        assert v[inside].min() - 0.01 <= row.slowest_mps <= apex + 0.01
        assert row.slowest_mps > 0.85 * apex
        apart += v[inside].min() < 0.85 * apex
    assert apart


def test_grip_of_a_place_is_that_of_its_corner(reference, driving):
    recording = driving(reference, lambda s: 3.0 + 0.3 * np.floor(s / reference.length))
    limits = car_limits(load_vehicle("nuc4"))
    run = analyze(recording, evaluate(recording, reference), limits=limits)
    of_corner = {row.corner.name: row.grip_used for row in corner_rows(run)}
    places = costliest(run.profile, references(run, [])[-1], run.corners)
    assert places
    for place in places:
        assert place.grip_used <= of_corner[place.corner.name] + 1e-9


def test_another_raceline_is_not_compared(reference, driving):
    wide = Raceline(*reference.to_cartesian(reference.s, 0.1), vx_mps=reference.speed)
    runs = []
    for line in (reference, wide):
        recording = driving(line, lambda s: 4.0)
        runs.append(analyze(recording, evaluate(recording, line), name="run"))
    assert not same_track(*runs)
    assert [r.name for r in references(runs[0], runs[1:])] == [
        *("the ideal lap", "the best lap", "the raceline's speeds")
    ]


def test_a_single_lap_is_compared_with_the_speeds_of_the_raceline(reference, driving):
    recording = driving(reference, lambda s: 2.0, laps=1)
    run = analyze(recording, evaluate(recording, reference))
    (only,) = references(run, [])
    expected = np.mean(1.0 / reference.speed) * reference.length
    assert only.time[-1] == pytest.approx(expected, rel=0.01)
    place = costliest(run.profile, only, run.corners)[0]
    assert place.loss_s > 0.1


def test_an_invalid_lap_does_not_count(reference, driving):
    recording = driving(reference, lambda s: 4.0, laps=3)
    x = recording.x.copy()
    x[300:310] += 30.0
    broken = dataclasses.replace(recording, x=x)
    run = profiles_of(broken, evaluate(broken, reference))
    assert len(run.laps) == 3 and len(run.counted) == 2


def test_words_of_a_place_tell_what_is_the_same_and_what_cannot_be():
    bend = Corner("first left", 1, 0.0, 10.0, 5.0)
    place = Place(bend, 4.0, 8.0, 0.01, 5.0, 5.0, 4.0, 4.0, 5.0, 5.0, 0.0, "apex", 0.77)
    assert place.why == "the same speeds and line, 77 % of the grip used"
    assert "file of this car" in dataclasses.replace(place, grip_used=2.15).why
    assert dataclasses.replace(place, grip_used=np.nan).why == "the same speeds and line"
