"""Distances to walls, marching toward them, smoothing between them."""

import math

import numpy as np
import pytest

from map_racing.track.raceline import Raceline
from map_racing.track.walls import Walls, clearance_of, smooth_between


def ring(count=200):
    angle = np.linspace(0.0, 2.0 * math.pi, count, endpoint=False)
    return Raceline(
        *(5.0 * np.cos(angle), 5.0 * np.sin(angle)),
        d_left_m=np.full(count, 1.5),
        d_right_m=np.full(count, 1.0),
    )


def test_distance_to_the_walls_of_a_ring():
    walls = Walls(ring())
    generator = np.random.default_rng(1)
    angle, radius = generator.uniform(0.0, 2.0 * math.pi, 300), generator.uniform(3.5, 6.0, 300)
    points = np.stack((radius * np.cos(angle), radius * np.sin(angle)), axis=1)
    expected = np.minimum(radius - 3.5, 6.0 - radius)
    # Walls are polygons: a segment of 0.1 m deviates from the circle by 0.3 mm.
    np.testing.assert_allclose(walls.distance(points), expected, atol=4e-4)


@pytest.mark.parametrize("offset", [0.0, 1.2, -0.7, 1.5 + 0.2, -1.0 - 0.3])
def test_clearance_is_negative_beyond_a_wall(offset):
    track = ring()
    line = Raceline(*track.to_cartesian(track.s, np.full(track.s.size, offset)))
    expected = min(1.5 - offset, 1.0 + offset)
    assert clearance_of(line, track) == pytest.approx(expected, abs=4e-4)


def test_clearance_in_a_bend_tighter_than_the_track_is_wide():
    """Around the end of a thin inner wall, as measured from that wall itself."""
    half, length, radius = (
        0.15,
        5.0,
        0.5,
    )  # half width of the inner wall, length of the straights, radius of the track
    wide = 1.2  # from the track to the outer wall
    turn = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 60)
    leg = np.linspace(-length, length, 200)[1:-1]
    end = np.stack((length + radius * np.cos(turn), radius * np.sin(turn)))
    leg = np.stack((leg[::-1], np.full(leg.size, radius)))
    points = np.concatenate((end, leg, -end, -leg), axis=1)
    count = points.shape[1]
    track = Raceline(
        *points, d_left_m=np.full(count, radius - half), d_right_m=np.full(count, wide)
    )
    # A wide line through the bend, with points nearer to the other leg's wall than to
    # the middle of the bend.
    for shift in (-0.2, 0.0, 0.6, 1.0):
        line = Raceline(*track.to_cartesian(track.s, np.full(track.s.size, -shift)))
        expected = min(radius - half + shift, wide - shift)
        assert clearance_of(line, track) == pytest.approx(expected, abs=0.01)
    # Widths along the normals that reach beyond the center of the bend.
    folded = Raceline(*points, d_left_m=np.full(count, 0.45), d_right_m=np.full(count, wide))
    assert clearance_of(folded, folded) == pytest.approx(0.45, abs=0.01)


@pytest.mark.parametrize("clearance", [0.0, 0.3])
@pytest.mark.parametrize("lean", [0.0, 0.6, -1.1])
def test_reach_is_the_distance_to_where_the_clearance_begins(clearance, lean):
    walls = Walls(ring())
    angle = np.linspace(0.0, 2.0 * math.pi, 37)
    points = 5.0 * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    direction = np.stack((np.cos(angle + lean), np.sin(angle + lean)), axis=1)
    reach = walls.reach(points, direction, clearance, 20.0)
    end = points + reach[:, None] * direction
    np.testing.assert_allclose(np.hypot(*end.T), 6.0 - clearance, atol=1e-3)


def test_reach_away_from_where_the_clearance_begins():
    walls = Walls(ring())
    angle = np.linspace(0.0, 2.0 * math.pi, 37)
    for radius, sign in ((5.7, -1.0), (5.7 + 1e-4, -1.0), (3.8, 1.0), (3.8 - 1e-4, 1.0)):
        out = np.stack((np.cos(angle), np.sin(angle)), axis=1)
        reach = walls.reach(radius * out, sign * out, 0.3, 20.0)
        np.testing.assert_allclose(reach, 1.9, atol=2e-3)
        # Nothing is left toward the wall.
        np.testing.assert_allclose(
            walls.reach(radius * out, -sign * out, 0.3, 20.0), 0.0, atol=1e-3
        )


def test_reach_ends_at_the_farthest_and_is_negative_too_close_to_a_wall():
    walls = Walls(ring())
    out = np.array([[1.0, 0.0]])
    assert walls.reach(np.array([[5.0, 0.0]]), out, 0.1, 0.4) == pytest.approx([0.4])
    assert walls.reach(np.array([[5.9, 0.0]]), out, 0.3, 1.0) == pytest.approx([-0.2], abs=1e-3)


def test_walls_of_a_sharp_corner_meet_in_its_point():
    """Inside a corner of 0.2 m radius on a track of 1 m to each side, at (3, 3)."""
    turn = np.linspace(-0.5 * math.pi, 0.0, 12)
    side = np.linspace(-3.8, 3.8, 60)[:-1]
    quarter = np.concatenate(
        (
            np.stack((side, np.full(59, -4.0)), axis=1),
            np.stack((3.8 + 0.2 * np.cos(turn), -3.8 + 0.2 * np.sin(turn)), axis=1),
        )
    )
    parts = [quarter]
    for _ in range(3):
        parts.append(np.stack((-parts[-1][:, 1], parts[-1][:, 0]), axis=1))
    x, y = np.concatenate(parts).T
    track = Raceline(x, y, d_left_m=np.full(x.size, 1.0), d_right_m=np.full(x.size, 1.0))
    walls = Walls(track)
    assert [finding.code for finding in walls.findings] == ["crossing-normals"]
    inside = walls.segments[np.max(np.abs(walls.segments[:, 0]), axis=1) < 4.0]
    # No wall remains within the track, and the two sides meet at the corner.
    assert np.max(np.abs(inside)) < 3.02
    corner = walls.distance(np.array([[3.0, 3.0], [-3.0, 3.0], [3.0, -3.0]]))
    np.testing.assert_allclose(corner, 0.0, atol=0.06)


def test_stretches_that_claim_the_same_ground_are_told():
    """Two straights 2 m apart that claim 1.3 m each toward the other."""
    turn = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 30)
    straight = np.linspace(-6.0, 6.0, 120)[1:-1]
    x = np.concatenate((6.0 + np.cos(turn), straight[::-1], -6.0 - np.cos(turn), straight))
    y = np.concatenate((np.sin(turn), np.full(118, 1.0), -np.sin(turn), np.full(118, -1.0)))
    walls = Walls(Raceline(x, y, d_left_m=np.full(x.size, 1.3), d_right_m=np.full(x.size, 0.5)))
    assert "shared-ground" in [finding.code for finding in walls.findings]
    # Each gets what the other's wall leaves.
    assert walls.distance(np.array([[0.0, 1.0]])) == pytest.approx([0.5], abs=1e-3)
    assert walls.distance(np.array([[0.0, 0.5]])) == pytest.approx([0.2], abs=1e-3)


def test_smoothing_stays_between_the_walls():
    track = ring()
    noise = 0.05 * np.random.default_rng(2).standard_normal((track.n, 2))
    points = np.stack((track.x, track.y), axis=1) + noise
    walls = Walls(track)
    smooth, clear = smooth_between(points, track.length, 0.5, walls.distance, 0.9)
    assert clear
    assert np.std(np.hypot(*smooth.T)) < 0.3 * np.std(np.hypot(*points.T))
    _, clear = smooth_between(points, track.length, 0.5, walls.distance, 1.2)
    assert not clear
    # Strong smoothing would shrink the ring; it is halved until the ring is clear.
    smooth, clear = smooth_between(points, track.length, 6.0, walls.distance, 0.3)
    assert clear and walls.distance(smooth).min() >= 0.3
