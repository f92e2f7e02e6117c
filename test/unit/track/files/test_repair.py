"""Repairs restore the broken track, and report what they did."""

import math

import numpy as np
import pytest

from map_racing.errors import RacelineError
from map_racing.track.files.checks import examine, raceline_of
from map_racing.track.files.load import load_raceline
from map_racing.track.files.repair import driven_columns, repaired, resampled, reversed_table
from map_racing.track.files.table import RacelineTable
from map_racing.track.findings import NOTE
from map_racing.track.raceline import Raceline

T = np.arange(400) * 2.0 * math.pi / 400
R = 6.0 + 1.5 * np.cos(3.0 * T) + 0.5 * np.cos(2.0 * T)
LINE = Raceline(R * np.cos(T), R * np.sin(T))
GOOD = {
    "s": LINE.s,
    "x": LINE.x,
    "y": LINE.y,
    "psi": LINE.psi,
    "kappa": LINE.kappa,
    "speed": 5.0 - 2.0 * np.abs(LINE.kappa),
    "d_left": 1.0 - 0.4 * LINE.kappa,
    "d_right": 1.0 + 0.4 * LINE.kappa,
}
GOOD["ax"] = (np.roll(GOOD["speed"], -1) ** 2 - GOOD["speed"] ** 2) / (2.0 * LINE.ds)
N = LINE.n
POINTS = ("x", "y", "speed", "d_left", "d_right")


def table(rows=None, keys=POINTS, **changed):
    rows = np.arange(N) if rows is None else rows
    columns = {key: np.array({**GOOD, **changed}[key], dtype=float)[rows] for key in keys}
    return RacelineTable(columns, "track", "c.csv", lines=np.arange(len(rows)) + 4)


def set_at(column, places, value):
    column = GOOD[column].copy()
    column[places] = value
    return column


def wrong(table):
    return [finding for finding in examine(table).findings if finding.severity != NOTE]


def mended(broken, atol, repairs):
    """Repair; the result must equal the good track everywhere."""
    assert wrong(broken)
    track, done = repaired(broken)
    assert done == repairs
    assert wrong(track) == []
    line = raceline_of(track)
    assert line.length == pytest.approx(LINE.length, abs=max(10.0 * atol, 1e-6))
    distance = [abs(line.project(*LINE.position(s)).d) for s in np.arange(0.0, LINE.length, 0.3)]
    assert max(distance) <= max(atol, 1e-6)
    return track


def test_a_good_track_needs_no_repair():
    track, done = repaired(table(keys=GOOD))
    assert done == []
    for key in POINTS:
        assert np.array_equal(track.columns[key], GOOD[key])


def test_points_without_position_and_values_that_are_no_numbers():
    broken = table(x=set_at("x", 20, math.nan), speed=set_at("speed", [0, 60], math.inf))
    track = mended(
        broken,
        1e-6,
        [
            "1 point without position dropped",
            "2 values of speed filled in from their neighbors",
        ],
    )
    assert track.columns["speed"][0] == pytest.approx(GOOD["speed"][0], abs=0.05)


def test_repeated_points():
    rows = np.sort(np.append(np.arange(N), [50, 50, 90]))
    track = mended(table(rows), 0.0, ["3 repeated points dropped"])
    assert np.array_equal(track.columns["x"], LINE.x)
    closed = table(np.append(np.arange(N), 0))
    assert repaired(closed)[1] == [] and repaired(closed)[0].columns["x"].size == N


def test_exchanged_axes_and_walls():
    keys = ("x", "y", "psi", "kappa")
    track = mended(
        table(keys=keys, x=LINE.y, y=LINE.x),
        0.0,
        ["x and y exchanged, as heading and curvature say"],
    )
    assert np.array_equal(track.columns["x"], LINE.x)
    line = load_raceline("reference")
    columns = {"x": line.x, "y": line.y, "d_left": line.d_right, "d_right": line.d_left}
    track, done = repaired(RacelineTable(columns))
    assert done == ["left and right walls exchanged, as their shape says"]
    assert np.array_equal(track.columns["d_left"], line.d_left)


def test_reversed_points():
    track = mended(
        table(np.arange(N)[::-1], keys=GOOD),
        0.0,
        ["points reordered along arc length and heading"],
    )
    assert np.array_equal(track.columns["x"], LINE.x)


def test_what_follows_from_the_points_is_recomputed():
    broken = table(keys=GOOD, psi=-LINE.psi, kappa=3.0 * LINE.kappa, s=2.0 * LINE.s)
    mended(broken, 0.0, ["arc length, curvature, heading recomputed"])


def test_kmh():
    track = mended(
        table(keys=GOOD, speed=3.6 * GOOD["speed"]),
        0.0,
        ["speeds converted from km/h to m/s, as the accelerations say"],
    )
    np.testing.assert_allclose(track.columns["speed"], GOOD["speed"], rtol=1e-12)


def test_second_loops():
    track = mended(table(np.tile(np.arange(N), 2)), 0.0, ["only the first of 2 loops kept"])
    assert np.array_equal(track.columns["x"], LINE.x)


def test_overlapping_ends():
    mended(table(np.arange(N + 9) % N), 0.0, ["9 last points dropped that overlapped the start"])


def test_points_that_turn_back():
    rows = np.arange(N)
    rows[[100, 102]] = rows[[102, 100]]
    mended(table(rows), 1e-4, ["2 points dropped at which the track turned back"])
    # There and back to the same point, which then occurs twice.
    rows = np.insert(np.arange(N), 100, [150, 99])
    mended(table(rows), 0.0, ["2 points dropped at which the track turned back"])
    # One point far off: the line turns back at both of its neighbors.
    broken = table(x=set_at("x", 200, 3.0 * LINE.x[200]), y=set_at("y", 200, 3.0 * LINE.y[200]))
    mended(broken, 1e-5, ["1 point dropped at which the track turned back"])


def test_a_wrong_order_in_the_second_lap():
    rows = np.tile(np.arange(N), 2)
    rows[[N + 100, N + 102]] = rows[[N + 102, N + 100]]
    track, done = repaired(table(rows))
    assert [text.split()[0] for text in done] == ["2", "only"]
    assert np.array_equal(track.columns["x"], LINE.x)


def test_gaps_are_filled_along_the_curve_and_points_stay():
    rows = np.append(np.arange(100), np.arange(109, N - 9))
    track = mended(table(rows), 0.02, ["18 points added along the curve where they were far apart"])
    assert track.columns["x"].size == N
    for key in POINTS:
        assert np.array_equal(track.columns[key][:100], GOOD[key][:100])
    np.testing.assert_allclose(track.columns["speed"], GOOD["speed"], atol=0.1)


def test_walls_beyond_the_track():
    track, done = repaired(table(d_left=set_at("d_left", [3, 4], -0.5)))
    assert done == ["2 negative distances to walls set to 0"]
    assert track.columns["d_left"].min() == 0.0


def test_what_cannot_be_mended_is_refused():
    with pytest.raises(RacelineError, match="expected a closed track"):
        repaired(table(np.arange(N // 2)))
    with pytest.raises(RacelineError, match="expected a speed >= 0"):
        repaired(table(speed=set_at("speed", 7, -1.0)))
    with pytest.raises(RacelineError, match="expected at least 4 distinct points"):
        repaired(table(np.zeros(9, dtype=int)))
    with pytest.raises(RacelineError, match="expected a finite x"):
        repaired(table(x=np.full(N, math.nan)))


def test_reversed_twice_is_the_same():
    track = driven_columns(table())
    back = reversed_table(track)
    assert (back.columns["x"][0], back.columns["x"][1]) == (LINE.x[0], LINE.x[-1])
    assert back.columns["d_left"][1] == GOOD["d_right"][-1]
    np.testing.assert_allclose(raceline_of(back).kappa, -LINE.reversed().kappa * -1.0, atol=1e-6)
    again = reversed_table(back)
    for key in POINTS:
        assert np.array_equal(again.columns[key], GOOD[key])


def test_resampled_points_lie_on_the_curve():
    track = resampled(driven_columns(table()), 0.25)
    line = raceline_of(track)
    steps = np.diff(np.append(line.s_points, line.length))
    assert np.ptp(steps) < 1e-4 and steps[0] == pytest.approx(0.25, abs=0.002)
    assert max(abs(LINE.project(x, y).d) for x, y in zip(line.x, line.y)) < 1e-4
    assert examine(track).findings == ()
