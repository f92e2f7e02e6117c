"""Tracks from seeds: as requested, without crossing walls, the same on every computer."""

import dataclasses
import subprocess
import sys
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from map_racing.errors import ParameterError
from map_racing.track.crossings import Polyline, crossings
from map_racing.track.files.load import load_raceline
from map_racing.track.generator import TrackShape
from map_racing.track.generator import draw_track as draw

ROOT = Path(__file__).resolve().parents[3]
SHAPES = {
    "usual": TrackShape(),
    "tight": TrackShape(length=22.0, tightest_radius=0.8, straights=1, width=1.5, left=False),
    "long": TrackShape(length=60.0, tightest_radius=1.2, straights=3),
    "round": TrackShape(length=35.0, tightest_radius=1.5, straights=0, left=False),
}

draw_track = lru_cache(maxsize=None)(draw)


@pytest.mark.rest_once
@pytest.mark.parametrize("kind", SHAPES)
@pytest.mark.parametrize(
    "seed", [3, *(pytest.param(seed, marks=pytest.mark.once) for seed in (1, 2))]
)
def test_a_track_is_as_asked_for(kind, seed):
    shape = SHAPES[kind]
    track = draw_track(seed, shape)
    assert track.length == pytest.approx(shape.length, rel=0.025)
    assert 1.0 / np.abs(track.kappa).max() == pytest.approx(shape.tightest_radius, rel=0.06)
    turned = np.sum(track.kappa) * track.ds
    assert turned == pytest.approx(2.0 * np.pi * (1.0 if shape.left else -1.0), rel=1e-3)
    if shape.length > 25.0 * shape.tightest_radius:
        assert min(-track.kappa.min(), track.kappa.max()) > 0.1 / shape.tightest_radius
    # Smooth: no jump of curvature from one point, 0.1 m on, to the next.
    assert np.max(np.abs(np.diff(track.kappa))) < 0.5 / shape.tightest_radius**2 * 0.1 * 4.0


@pytest.mark.rest_once
@pytest.mark.parametrize("kind", SHAPES)
def test_neither_line_nor_walls_cross(kind):
    shape = SHAPES[kind]
    track = draw_track(3, shape)
    lines = [
        np.stack(track.to_cartesian(track.s, d), axis=1)
        for d in (track.d_left, np.zeros(track.n), -track.d_right)
    ]
    assert not any(len(crossings(Polyline(line))) for line in lines)
    assert not len(crossings(Polyline(lines[0]), Polyline(lines[2])))
    across = track.d_left + track.d_right
    assert across.min() > 0.95 * shape.width and across.max() < 1.3 * shape.width


@pytest.mark.once
def test_speeds_are_the_vehicles_limits_times_what_is_stated():
    plain, beyond = (draw_track(2, TrackShape(beyond=factor)) for factor in (1.0, 1.6))
    lateral = [np.max(np.abs(track.kappa) * track.speed**2) for track in (plain, beyond)]
    assert lateral == pytest.approx([7.0, 1.6 * 7.0], rel=0.02)
    driving = np.diff(plain.speed**2) / (2.0 * plain.ds)
    assert driving.max() < 7.2 and driving.min() > -7.2
    np.testing.assert_array_equal(plain.x, beyond.x)


@pytest.mark.once
def test_left_and_right_are_mirror_images():
    left, right = (draw_track(6, TrackShape(left=side)) for side in (True, False))
    np.testing.assert_allclose(left.x, right.x, atol=1e-9)
    np.testing.assert_allclose(left.y, -right.y, atol=1e-9)
    np.testing.assert_allclose(left.d_left, right.d_right, atol=1e-6)


def test_another_seed_is_another_track():
    shape = TrackShape()
    assert draw_track(1, shape).x.tolist() != draw_track(2, shape).x.tolist()


def test_a_seed_is_the_same_track_everywhere():
    """Figures of one track, so that no library version can change it unnoticed."""
    track = draw_track(1, TrackShape())
    expected = [40.634181209, -2.203349668, 8.383926012, 0.991160378, 2.657523134]
    assert expected == pytest.approx(
        [track.length, track.x[100], track.y[100], track.kappa.max(), track.speed.min()], abs=1e-6
    )


@pytest.mark.parametrize(
    "changes",
    [
        {"length": 10.0},
        {"width": 2.5},
        {"straights": 5},
        {"tightest_radius": 0.0},
        {"beyond": -1.0},
        {"a_lat_max_mps2": float("nan")},
    ],
)
def test_impossible_shapes_are_refused(changes):
    with pytest.raises(ParameterError, match=next(iter(changes))):
        dataclasses.replace(TrackShape(), **changes)


@pytest.mark.once
def test_the_script_writes_what_the_function_draws(tmp_path):
    command = [sys.executable, str(ROOT / "scripts" / "generate_tracks"), "--seeds", "3"]
    options = ["--output", str(tmp_path), "--length", "25", "--straights", "1", "--right"]
    done = subprocess.run([*command, *options], check=True, stdout=subprocess.PIPE)
    assert b"track3.csv: 25" in done.stdout or b"track3.csv: 24" in done.stdout
    written = load_raceline(tmp_path / "track3.csv")
    drawn = draw_track(3, TrackShape(length=25.0, straights=1, left=False))
    assert written.length == pytest.approx(drawn.length, abs=1e-3)
    np.testing.assert_allclose(written.speed, drawn.speed, atol=2e-3)
    bad = subprocess.run([*command, *options, "--width", "9"], stderr=subprocess.PIPE)
    assert bad.returncode == 1 and b"width: expected" in bad.stderr
