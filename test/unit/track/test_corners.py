"""Speeds at which corners exceed a table's limit."""

import math

import numpy as np
import pytest

from map_racing.errors import RacelineError
from map_racing.track.corners import corners, runs_around
from map_racing.track.files.load import load_raceline
from map_racing.track.raceline import Raceline
from map_racing.vehicle.grids import default_grid
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.steady_state import steady_state_table


@pytest.fixture(scope="module")
def table():
    vehicle = load_vehicle("nuc4")
    return steady_state_table(vehicle, *default_grid(vehicle))


def test_a_corner_takes_all_of_the_table_at_its_limit(table):
    phi = np.linspace(0.0, 2.0 * math.pi, 400, endpoint=False)
    found = corners(Raceline(8.0 * np.cos(phi), 3.5 * np.sin(phi)), table)
    assert len(found) == 2
    for corner in found:
        assert corner.curvature == pytest.approx(8.0 / 3.5**2, rel=2e-3)  # at the end of an ellipse
        demand = corner.limit_speed**2 * corner.curvature
        assert demand == pytest.approx(table.max_lateral_acceleration(corner.limit_speed), rel=1e-3)
        assert math.isnan(corner.speed)


def test_a_raceline_with_speeds_is_judged_where_it_is_nearest_to_the_limit(table):
    raceline = load_raceline("reference")
    found = corners(raceline, table)
    assert [corner.s for corner in found] == sorted(corner.s for corner in found)
    worst = max(found, key=lambda corner: corner.share)
    # At that share of its speeds, no place of the line exceeds the table's limit.
    v = raceline.speed / worst.share * (1.0 - 1e-3)
    assert np.all(v * v * np.abs(raceline.kappa) < table.max_lateral_acceleration(v))
    v = raceline.speed / worst.share * 1.01
    assert np.any(v * v * np.abs(raceline.kappa) > table.max_lateral_acceleration(v))


def test_left_and_right_are_told_apart(table):
    line = load_raceline("reference")
    there = [corner.curvature for corner in corners(line, table)]
    back = [corner.curvature for corner in corners(line.reversed(), table)]
    assert any(k < 0.0 for k in there) and any(k > 0.0 for k in there)
    assert sum(k < 0.0 for k in there) == sum(k > 0.0 for k in back)


def test_a_circle_is_one_corner_and_a_huge_one_none(table):
    phi = np.linspace(0.0, 2.0 * math.pi, 200, endpoint=False)
    assert len(corners(Raceline(3.0 * np.cos(phi), 3.0 * np.sin(phi)), table)) == 1
    wide = Raceline(400.0 * np.cos(phi), 400.0 * np.sin(phi))
    assert corners(wide, table)[0].limit_speed == math.inf
    with pytest.raises(RacelineError, match="corners"):
        corners(Raceline(4e3 * np.cos(phi), 4e3 * np.sin(phi)), table)


def _egg(radius):
    """A wide arc of 5 m, driven fast, and a tight one, driven slowly, joined by straights."""
    wide, between = 5.0, 12.0
    turn = math.acos((wide - radius) / between)
    far = np.linspace(turn, 2.0 * math.pi - turn, 400)
    near = np.linspace(-turn, turn, 100)
    arc = np.stack((wide * np.cos(far), wide * np.sin(far)), axis=1)
    hairpin = np.stack((between + radius * np.cos(near), radius * np.sin(near)), axis=1)
    part = np.linspace(0.0, 1.0, 100)[1:-1, None]
    straights = [a + part * (b - a) for a, b in ((arc[-1], hairpin[0]), (hairpin[-1], arc[0]))]
    points = np.concatenate((arc, straights[0], hairpin, straights[1]))
    speed = np.where(np.arange(len(points)) < 400, math.sqrt(5.0 * 7.06) * 1.2, 0.5)
    return Raceline(*points.T, vx_mps=speed)


def test_a_fast_bend_beyond_the_limit_is_not_hidden_by_a_tight_one(table):
    line = _egg(0.9)
    worst = max(corners(line, table), key=lambda corner: corner.share)
    assert 0.19 < abs(worst.curvature) < 0.3  # at the arc of radius 5 m, not of 0.9 m
    v = line.speed / worst.share * (1.0 - 1e-3)
    assert np.all(v * v * np.abs(line.kappa) < table.max_lateral_acceleration(v))


def test_a_corner_that_no_angle_of_the_table_steers_has_no_speed(table):
    found = corners(_egg(0.5), table)
    tight = max(found, key=lambda corner: abs(corner.curvature))
    assert tight.limit_speed == 0.0 and tight.share == math.inf
    assert any(0.0 < corner.limit_speed < math.inf for corner in found)
    line = _egg(0.5)
    without_speeds = corners(Raceline(line.x, line.y), table)
    assert max(without_speeds, key=lambda corner: abs(corner.curvature)).limit_speed == 0.0


def test_a_fast_bend_of_a_full_size_car_has_a_limit():
    vehicle = load_vehicle("bmw_320i")
    table = steady_state_table(vehicle, *default_grid(vehicle))
    phi = np.linspace(0.0, 2.0 * math.pi, 600, endpoint=False)
    found = corners(Raceline(400.0 * np.cos(phi), 260.0 * np.sin(phi)), table)
    radius = 260.0**2 / 400.0
    for corner in found:
        expected = math.sqrt(radius * table.max_lateral_acceleration(corner.limit_speed))
        assert corner.limit_speed == pytest.approx(expected, rel=2e-3)
        assert corner.limit_speed > 30.0


def test_runs_of_cells_around_the_lap():
    kinds = {(1, 1, 0, 2, 1): [[3], [4, 0, 1]], (3, 3, 3): [[0, 1, 2]], (0, 0, 0): []}
    for kind, runs in kinds.items():
        assert [cells.tolist() for cells in runs_around(np.array(kind))] == runs
