"""Crossings of polylines with known answers."""

import math

import numpy as np
import pytest

from map_racing.track.crossings import Polyline, crossings

T = np.arange(200) * 2.0 * math.pi / 200 + 0.01


def circle(x=0.0, radius=1.0):
    return np.stack((x + radius * np.cos(T), radius * np.sin(T)), axis=1)


def test_a_circle_does_not_cross_itself_nor_one_inside():
    assert len(crossings(Polyline(circle()))) == 0
    assert len(crossings(Polyline(circle()), Polyline(circle(radius=0.9)))) == 0


def test_a_figure_of_eight_crosses_itself_once_where_it_does():
    eight = np.stack((np.sin(T), np.sin(2.0 * T)), axis=1)
    pairs = crossings(Polyline(eight))
    assert len(pairs) == 1
    for segment in pairs[0]:
        assert np.hypot(*eight[segment]) < 0.1


def test_a_crossing_in_a_vertex_is_found_whatever_its_rounding():
    a = 2.0 * np.pi * np.arange(400) / 400
    for digits in (3, 6, 16):
        eight = np.round(np.stack((12.0 * np.sin(a), 5.0 * np.sin(2.0 * a)), axis=1), digits)
        pairs = crossings(Polyline(eight))
        assert len(pairs) and np.all(np.hypot(*eight[pairs.ravel()].T) < 0.3)


@pytest.mark.parametrize("apart", [0.3, 1.0, 1.9])
def test_two_circles_cross_twice(apart):
    a, b = circle(), circle(apart)
    pairs = crossings(Polyline(a), Polyline(b))
    assert len(pairs) == 2
    np.testing.assert_allclose(a[pairs[:, 0], 0], 0.5 * apart, atol=0.04)
    np.testing.assert_allclose(a[pairs[:, 0]], b[pairs[:, 1]], atol=0.07)


def test_one_long_segment_among_short_ones():
    # The chord that closes a half circle, crossed by a line.
    half = np.stack((np.cos(T[:100]), np.sin(T[:100])), axis=1)
    stroke = np.array([[0.2, -0.5], [0.2, 0.5], [0.21, 0.5], [0.21, -0.5]])
    pairs = crossings(Polyline(half), Polyline(stroke))
    assert pairs.tolist() == [[99, 0], [99, 2]]


def test_against_every_pair():
    rng = np.random.default_rng(3)
    points = rng.uniform(size=(60, 2))

    def cross(a, b, c, d):
        def side(p, q, r):
            return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

        return side(a, b, c) * side(a, b, d) < 0.0 and side(c, d, a) * side(c, d, b) < 0.0

    ends = np.roll(points, -1, axis=0)
    expected = [
        [i, j]
        for i in range(60)
        for j in range(i + 2, 60)
        if (i, j) != (0, 59) and cross(points[i], ends[i], points[j], ends[j])
    ]
    assert crossings(Polyline(points)).tolist() == expected
