"""The tracks in config/tracks are as documented, and come from their generator."""

import importlib.machinery
import importlib.util
import math
from pathlib import Path

import numpy as np
import pytest

from map_racing.track.files.load import load_raceline
from map_racing.track.speed_profile import lap_time

ROOT = Path(__file__).resolve().parents[3]


def shipped(name):
    return load_raceline(ROOT / "config" / "tracks" / f"{name}.csv")


def load_generator():
    path = str(ROOT / "scripts" / "generate_tracks")
    loader = importlib.machinery.SourceFileLoader("generate_tracks", path)
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader(loader.name, loader))
    loader.exec_module(module)
    return module


@pytest.mark.parametrize(
    "name, length, time, v_max, tightest",
    [
        ("reference", 36.5, 6.20, 8.5, 1.0),
        ("club", 108.7, 13.68, 11.0, 2.19),
        ("circuit", 3456.0, 120.73, 50.0, 25.51),
    ],
)
def test_figures(name, length, time, v_max, tightest):
    track = shipped(name)
    assert track.length == pytest.approx(length, abs=0.05)
    assert lap_time(track.speed, track.ds) == pytest.approx(time, abs=0.005)
    assert track.speed.max() == pytest.approx(v_max, abs=1e-6)
    assert 1.0 / np.abs(track.kappa).max() == pytest.approx(tightest, abs=0.01)
    assert [str(finding) for finding in track.findings] == [
        "heading is measured from +x; fits the points within 0.000 rad (95 %)"
    ]


@pytest.mark.parametrize("name", ["reference", "club"])
def test_bends_both_ways_smoothly_within_the_grip(name):
    track = shipped(name)
    assert track.kappa.min() < -0.25 < 0.25 < track.kappa.max()
    assert np.max(np.abs(np.diff(track.kappa))) < 0.1
    lateral = track.speed**2 * track.kappa
    driving = (np.roll(track.speed, -1) ** 2 - track.speed**2) / (2.0 * track.ds)
    assert np.abs(lateral).max() == pytest.approx(9.5, abs=0.05)
    assert driving.max() <= 7.51 and driving.min() >= -8.01


@pytest.mark.parametrize("name", ["reference", "club"])
def test_walls_leave_room_and_do_not_cross(name):
    track = shipped(name)
    assert min(track.d_left.min(), track.d_right.min()) > 0.35
    for side, widths in ((1, track.d_left), (-1, track.d_right)):
        x, y = track.to_cartesian(track.s, side * widths)
        for k in range(track.n):
            # No wall point is within the walls at another place of the track.
            foot = track.project(float(x[k]), float(y[k]))
            assert math.remainder(foot.s - track.s[k], track.length) == pytest.approx(0, abs=1e-3)
            assert side * foot.d == pytest.approx(widths[k], abs=1e-5)


@pytest.mark.once
@pytest.mark.parametrize("name", ["reference", "club"])
def test_generator_makes_the_shipped_file(name):
    generator = load_generator()
    track, made = shipped(name), generator.make_track(name, **generator.TRACKS[name])
    assert made.n == track.n
    for column in ("x", "y", "speed", "d_left", "d_right"):
        np.testing.assert_allclose(getattr(made, column), getattr(track, column), atol=2e-5)
