"""Geometry of the raceline against curves with known answers."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.errors import ParameterError, RacelineError
from map_racing.track.raceline import Raceline
from map_racing.track.spline import distinct_points


def circle(radius=5.0, spacing=0.2, center=(0.0, 0.0), **columns):
    angle = np.arange(round(2.0 * math.pi * radius / spacing)) * spacing / radius
    angle *= 2.0 * math.pi / (angle.size * spacing / radius)
    x, y = center[0] + radius * np.cos(angle), center[1] + radius * np.sin(angle)
    return Raceline(x, y, **{key: f(angle) for key, f in columns.items()})


def winding(n=150):
    """A track with bends to both sides and a waist where it runs back alongside itself."""
    t = np.arange(n) * 2.0 * math.pi / n
    return Raceline(
        8.0 * np.cos(t),
        2.5 * np.sin(t) + 1.2 * np.sin(3.0 * t),
        vx_mps=5.0 + np.cos(t),
        d_left_m=1.0 + 0.2 * np.sin(t),
        d_right_m=1.2 + 0.2 * np.cos(2.0 * t),
        name="winding",
    )


WINDING = winding()
DENSE_S = np.linspace(0.0, WINDING.length, 40001)[:-1]
DENSE = WINDING.sample(DENSE_S)


def brute_force_distance(x, y):
    return float(np.hypot(DENSE.x - x, DENSE.y - y).min())


# -- the curve -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "spacing, error", [(0.002, 1e-11), (0.05, 2e-10), (0.2, 4e-8), (0.5, 1.5e-6), (1.0, 2.5e-5)]
)
def test_circle(spacing, error):
    track = circle(5.0, spacing)
    at = track.sample(np.linspace(0.0, track.length, 5001))
    assert np.max(np.abs(np.hypot(at.x, at.y) - 5.0)) < error
    assert track.length == pytest.approx(10.0 * math.pi, abs=4.0 * error)
    assert np.max(np.abs(at.kappa - 0.2)) < 0.001


def test_given_points_lie_on_the_curve():
    t = np.arange(150) * 2.0 * math.pi / 150
    x, y = 8.0 * np.cos(t), 2.5 * np.sin(t) + 1.2 * np.sin(3.0 * t)
    at = WINDING.sample(WINDING.s_points)
    assert np.max(np.hypot(at.x - x, at.y - y)) < 2e-6


def test_curvature_is_positive_to_the_left():
    assert np.all(circle().kappa > 0.0)
    assert np.all(circle().reversed().kappa < 0.0)


def test_parameter_is_arc_length():
    at = WINDING.sample(np.linspace(0.0, WINDING.length, 200001))
    walked = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(at.x), np.diff(at.y)))))
    assert np.max(np.abs(walked - np.linspace(0.0, WINDING.length, 200001))) < 2e-5


def test_heading_and_curvature_are_derivatives_of_the_position():
    h = 1e-4
    ahead, behind = WINDING.sample(DENSE_S + h), WINDING.sample(DENSE_S - h)
    psi = np.arctan2(ahead.y - behind.y, ahead.x - behind.x)
    turned = (ahead.psi - behind.psi + math.pi) % (2.0 * math.pi) - math.pi
    assert np.max(np.abs(np.sin(psi - DENSE.psi))) < 1e-6
    assert np.max(np.abs(turned / (2.0 * h) - DENSE.kappa)) < 1e-3


def test_curve_is_closed_and_curvature_continuous_across_the_start():
    before, after = WINDING.pose(-1e-9), WINDING.pose(1e-9)
    assert before == pytest.approx(after, abs=1e-6)


def test_scalar_and_array_forms_agree():
    for s in (0.0, 0.03, 7.7, WINDING.length - 1e-12, -3.0, 2.5 * WINDING.length):
        at = WINDING.sample([s])
        pose = WINDING.pose(s)
        assert pose == pytest.approx((at.x[0], at.y[0], at.psi[0], at.kappa[0]), abs=1e-12)
        assert WINDING.position(s) == pytest.approx(pose[:2], abs=1e-12)
        assert WINDING.speed_at(s) == pytest.approx(at.speed[0], abs=1e-12)
        assert WINDING.widths_at(s) == pytest.approx((at.d_left[0], at.d_right[0]), abs=1e-12)


def test_grid_is_what_the_queries_give():
    at = WINDING.sample(WINDING.s)
    for name in ("x", "y", "psi", "kappa", "speed", "d_left", "d_right"):
        np.testing.assert_allclose(getattr(WINDING, name), getattr(at, name), atol=1e-12)
    assert WINDING.s.size == WINDING.n
    assert WINDING.n * WINDING.ds == pytest.approx(WINDING.length)
    assert WINDING.ds <= 0.1


def test_speed_is_linear_between_points():
    # 40 points, 1 m apart on a circle, whose cells divide the spacing.
    track = circle(20.0 / math.pi, 1.0, vx_mps=lambda angle: np.arange(angle.size) % 2 + 2.0)
    assert track.speed_at(0.0) == pytest.approx(2.0)
    assert track.speed_at(track.length / 40.0) == pytest.approx(3.0)
    assert track.speed_at(0.3 * track.length / 40.0) == pytest.approx(2.3)
    assert track.speed_at(39.5 * track.length / 40.0) == pytest.approx(2.5)


def test_memory_is_linear_in_the_points():
    angle = np.arange(20) * math.pi / 10.0
    assert Raceline(5e5 * np.cos(angle), 5e5 * np.sin(angle)).n <= 16 * 20


def test_dense_points_do_not_make_dense_cells():
    """The cost of a step rises when the cells no longer fit into the processor's cache."""
    assert circle(10.0, 0.002).ds == pytest.approx(0.02, rel=1e-3)
    assert circle(0.5, 0.0005).n == 1000
    track, denser = circle(10.0, 0.1), circle(10.0, 0.002)
    for s in (0.0, 1.234, 55.5):
        assert denser.pose(s) == pytest.approx(track.pose(s), abs=1e-6)


def test_coordinates_far_from_the_origin_lose_nothing():
    near, far = circle(), circle(center=(4.5e5, -5.2e6))
    assert far.length == pytest.approx(near.length, abs=1e-7)
    assert far.project(4.5e5 + 6.0, -5.2e6).d == pytest.approx(-1.0, abs=1e-7)


# -- projection ----------------------------------------------------------------------------------


@pytest.mark.once
@settings(deadline=None, max_examples=200)
@given(st.floats(0.0, 1.0), st.floats(-0.4, 0.4))
def test_projection_inverts_to_cartesian(part, d):
    s = part * WINDING.length
    foot = WINDING.project(*WINDING.to_cartesian(s, d))
    assert math.remainder(foot.s - s, WINDING.length) == pytest.approx(0.0, abs=1e-7)
    assert foot.d == pytest.approx(d, abs=1e-8)
    pose = WINDING.pose(foot.s)
    assert math.remainder(foot.psi - pose.psi, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-7)
    assert foot.kappa == pytest.approx(pose.kappa, abs=1e-4)
    assert 0.0 <= foot.s < WINDING.length


@pytest.mark.once
@settings(deadline=None, max_examples=300)
@given(st.floats(-15.0, 15.0), st.floats(-10.0, 10.0))
def test_projection_is_the_closest_point_of_all(x, y):
    foot = WINDING.project(x, y)
    at_x, at_y = WINDING.position(foot.s)
    # Where the curve is nearly a circle around the position, its closest point is known only to
    # 1e-5. The closest sample may be half the spacing away along the curve.
    closest = brute_force_distance(x, y)
    assert abs(foot.d) <= closest + 2e-5
    assert math.hypot(foot.d, 0.5 * DENSE_S[1]) >= closest - 2e-5
    assert math.hypot(x - at_x, y - at_y) == pytest.approx(abs(foot.d), abs=2e-5)


def test_projection_onto_what_runs_along():
    x, y = WINDING.to_cartesian(12.0, 0.3)
    psi = WINDING.pose(12.0).psi
    assert WINDING.project(x, y, psi) == pytest.approx(WINDING.project(x, y), abs=1e-9)
    other = WINDING.project(x, y, psi + math.pi)
    assert math.cos(other.psi - psi) <= 0.0
    opposite = np.cos(DENSE.psi - psi) <= 0.0
    nearest = np.hypot(DENSE.x[opposite] - x, DENSE.y[opposite] - y).min()
    assert abs(other.d) == pytest.approx(nearest, abs=1e-6)


@pytest.mark.parametrize("turn", [-1.5, 1.5])
def test_a_car_across_the_track_is_still_on_it(turn):
    x, y = WINDING.to_cartesian(12.0, 0.3)
    foot = WINDING.project(x, y, WINDING.pose(12.0).psi + turn)
    assert foot == pytest.approx(WINDING.project(x, y), abs=1e-9)


def test_the_curve_does_not_depend_on_where_its_points_begin():
    random = np.random.default_rng(2)
    angle = np.sort(random.uniform(0.0, 2.0 * math.pi, 40))
    x, y = 6.0 * np.cos(angle), 4.0 * np.sin(angle)
    track, other = Raceline(x, y), Raceline(np.roll(x, 17), np.roll(y, 17))
    assert other.length == pytest.approx(track.length, abs=1e-9)
    at = track.sample(track.s_points + 0.05)
    assert max(abs(other.project(*point).d) for point in zip(at.x, at.y)) < 1e-5


def test_projection_at_the_center_of_curvature():
    foot = circle().project(0.0, 0.0)
    assert foot.d == pytest.approx(5.0, abs=1e-7)


@pytest.mark.once
@settings(deadline=None, max_examples=200)
@given(st.floats(0.0, 1.0), st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
def test_projection_from_a_guess(part, d, off):
    s = part * WINDING.length
    foot = WINDING.project_near(*WINDING.to_cartesian(s, d), s + off)
    assert math.remainder(foot.s - s, WINDING.length) == pytest.approx(0.0, abs=1e-7)
    assert foot.d == pytest.approx(d, abs=1e-8)


@settings(deadline=None, max_examples=200)
@given(st.floats(-15.0, 15.0), st.floats(-10.0, 10.0), st.floats(0.0, 1.0))
def test_projection_from_any_guess_is_a_closest_point_or_none(x, y, part):
    foot = WINDING.project_near(x, y, part * WINDING.length)
    if foot is not None:
        distances = [
            math.hypot(x - px, y - py)
            for px, py in (WINDING.position(foot.s + step) for step in (-0.01, 0.0, 0.01))
        ]
        assert distances[1] <= min(distances) + 1e-9
        assert abs(foot.d) == pytest.approx(distances[1], abs=1e-6)


def test_farthest_point_is_no_projection():
    # From 1 m beyond the center, the guess on the far side is a stationary, but the farthest point.
    assert circle().project_near(-1.0, 0.0, 0.0) is None


def test_projection_within_reach_only():
    track = circle()
    x, y = track.position(2.0)
    assert track.project_near(x, y, 1.0, reach=1.1).s == pytest.approx(2.0, abs=1e-8)
    assert track.project_near(x, y, 1.0, reach=0.9) is None


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_projection_of_no_position(bad):
    assert WINDING.project_near(bad, 0.0, 1.0) is None
    assert WINDING.project_near(0.0, bad, 1.0) is None
    with pytest.raises(ParameterError, match="finite position"):
        WINDING.project(bad, 0.0)
    with pytest.raises(ParameterError, match="finite position"):
        WINDING.project(0.0, 0.0, bad)


@pytest.mark.parametrize("far", [1e9, -1e160, 1e300])
def test_projection_of_a_position_whose_square_is_none(far):
    with pytest.raises(ParameterError, match="finite position on earth"):
        WINDING.project(far, 0.0)
    with pytest.raises(ParameterError, match="finite position on earth"):
        WINDING.project(0.0, far, 0.5)


# -- point ahead ---------------------------------------------------------------------------------


@pytest.mark.parametrize("distance", [0.01, 0.3, 1.0, 4.0, 9.0, 9.999])
def test_point_ahead_on_a_circle(distance):
    track = circle()
    x, y = track.position(30.0)
    point = track.point_ahead(x, y, 30.0, distance)
    arc = 10.0 * math.asin(distance / 10.0)
    assert point.distance == pytest.approx(distance, abs=1e-6)
    assert math.hypot(point.x - x, point.y - y) == pytest.approx(distance, abs=1e-6)
    assert (point.s - 30.0) % track.length == pytest.approx(arc, abs=1e-4)


@pytest.mark.once
@settings(deadline=None, max_examples=300)
@given(st.floats(0.0, 1.0), st.floats(-1.5, 1.5), st.floats(0.01, 20.0))
def test_point_ahead_is_the_first_one(part, d, distance):
    s = part * WINDING.length
    x, y = (float(value) for value in WINDING.to_cartesian(s, d))
    point = WINDING.point_ahead(x, y, s, distance)
    ahead = np.linspace(0.0, 0.5 * WINDING.length, 20001)
    at = WINDING.sample(s + ahead)
    distances = np.hypot(at.x - x, at.y - y)
    beyond = np.flatnonzero(distances >= distance)
    if distances[0] >= distance:
        assert math.remainder(point.s - s, WINDING.length) == pytest.approx(0.0, abs=1e-5)
        assert point.distance == pytest.approx(distances[0], abs=1e-9)
    elif beyond.size == 0:
        assert point.distance >= distances.max() - WINDING.ds
        assert point.distance <= distances.max() + 1e-6
    elif distances[beyond[0] : beyond[0] + 400].max() > 1.01 * distance:
        assert point.distance == pytest.approx(distance, abs=1e-6)
        first = ahead[beyond[0]]
        assert (point.s - s) % WINDING.length == pytest.approx(first, abs=0.5)
        assert (point.s - s) % WINDING.length < first + 1e-6
    assert WINDING.position(point.s) == pytest.approx((point.x, point.y), abs=1e-6)
    assert math.hypot(point.x - x, point.y - y) == pytest.approx(point.distance, abs=1e-6)


def test_point_ahead_stops_where_the_track_turns_back():
    # Seen from the center of a circle, all points are equally far: half a lap without a crossing.
    track = circle()
    assert track.point_ahead(0.0, 0.0, 3.0, 5.5).distance == pytest.approx(5.0, abs=1e-6)
    assert track.point_ahead(0.0, 0.0, 3.0, math.inf).distance == pytest.approx(5.0, abs=1e-6)
    assert track.point_ahead(0.0, 0.0, 3.0, 5.0 + 1e-6).distance == pytest.approx(5.0, abs=1e-5)


def test_point_ahead_with_lookahead_beyond_the_largest_chord():
    track = circle()
    point = track.point_ahead(5.0, 0.0, 0.0, 50.0)
    assert (point.x, point.y) == pytest.approx((-5.0, 0.0), abs=track.ds)
    assert point.distance == pytest.approx(10.0, abs=1e-3)


@pytest.mark.parametrize("distance", [-1.0, 0.0])
def test_point_ahead_at_no_distance_is_where_the_search_begins(distance):
    assert circle().point_ahead(5.0, 0.0, 0.0, distance) == pytest.approx((0.0, 5.0, 0.0, 0.0))


@pytest.mark.parametrize("distance", [1e-12, 1e-6, 1e-3])
def test_point_ahead_at_hardly_any_distance(distance):
    x, y = WINDING.position(7.0)
    point = WINDING.point_ahead(x, y, 7.0, distance)
    assert point.s == pytest.approx(7.0 + distance, abs=1e-9)


def test_point_ahead_of_a_car_far_off_is_where_the_search_begins():
    point = circle().point_ahead(9.0, 0.0, 0.0, 1.5)
    assert point == pytest.approx((0.0, 5.0, 0.0, 4.0), abs=1e-9)


@pytest.mark.parametrize(
    "x, y, distance", [(math.nan, 0.0, 1.0), (0.0, math.inf, math.inf), (5.0, 0.0, math.nan)]
)
def test_point_ahead_of_no_position(x, y, distance):
    with pytest.raises(ParameterError, match="finite"):
        circle().point_ahead(x, y, 0.0, distance)


# -- derived tracks -----------------------------------------------------------------------------


def test_reversed():
    back = WINDING.reversed()
    assert back.length == pytest.approx(WINDING.length, abs=1e-6)
    for s in (0.0, 1.3, 20.0):
        assert back.position(s) == pytest.approx(WINDING.position(-s), abs=1e-5)
        assert back.pose(s).kappa == pytest.approx(-WINDING.pose(-s).kappa, abs=0.02)
        assert back.speed_at(s) == pytest.approx(WINDING.speed_at(-s), abs=1e-3)
        assert back.widths_at(s) == pytest.approx(WINDING.widths_at(-s)[::-1], abs=1e-3)
    assert back.name == "winding"


def test_rotated():
    moved = WINDING.rotated(4.25)
    assert moved.length == pytest.approx(WINDING.length, abs=1e-6)
    for s in (0.0, 1.3, 20.0):
        assert moved.pose(s) == pytest.approx(WINDING.pose(s + 4.25), abs=0.01)
        assert moved.position(s) == pytest.approx(WINDING.position(s + 4.25), abs=1e-5)
        assert moved.speed_at(s) == pytest.approx(WINDING.speed_at(s + 4.25), abs=1e-3)


# -- input ---------------------------------------------------------------------------------------

SQUARE = ([0.0, 10.0, 10.0, 0.0], [0.0, 0.0, 10.0, 10.0])


def test_four_points_are_enough():
    assert Raceline(*SQUARE).length > 40.0


def test_repeated_points_are_dropped():
    x, y = [0.0, 0.0, 10.0, 10.0, 10.0, 0.0, 0.0], [0.0, 0.0, 0.0, 10.0, 10.0, 10.0, 0.0]
    track = Raceline(x, y, vx_mps=[1, 9, 2, 3, 9, 4, 9])
    plain = Raceline(*SQUARE, vx_mps=[1, 2, 3, 4])
    assert track.length == plain.length
    np.testing.assert_array_equal(track.speed, plain.speed)
    expected = [True, False, True, True, False, True, False]
    assert distinct_points(np.array(x), np.array(y)).tolist() == expected


@pytest.mark.parametrize(
    "x, y, columns, message",
    [
        ([], [], {}, "at least 4 distinct points, got 0"),
        ([0, 1, 1], [0, 0, 1], {}, "at least 4 distinct points, got 3"),
        ([0, 0, 1, 1, 0], [0, 0, 0, 1, 0], {}, "at least 4 distinct points, got 3"),
        ([1] * 9, [2] * 9, {}, "at least 4 distinct points, got 1"),
        ([0, math.nan, 1, 0], [0, 0, 1, 1], {}, "point 1: expected a finite x, got nan"),
        ([0, 1, 1, 0], [0, 0, math.inf, 1], {}, "point 2: expected a finite y, got inf"),
        ([0, 1, 1, 0], [0, 0, 1], {}, "as many values in each column, got 4 of x, 3 of y"),
        ([[0, 1]], [[0, 1]], {}, r"one number per point, got shape \(1, 2\)"),
        (["a"] * 4, [0] * 4, {}, "x: expected one number per point"),
        (*SQUARE, {"vx_mps": [1, 2, -3, 4]}, "point 2: expected a speed >= 0 m/s, got -3"),
        (*SQUARE, {"vx_mps": [1, 2, math.nan, 4]}, "point 2: expected a finite speed, got nan"),
        (*SQUARE, {"d_left_m": [1] * 4}, "both walls or to neither"),
        (np.linspace(0.0, 9.0, 20), np.zeros(20), {}, "closed track, but the last point is 9.00"),
        (
            *(np.cos(np.linspace(0.0, 5.0, 200)), np.sin(np.linspace(0.0, 5.0, 200))),
            *({}, "closed track, but the last point is 1.20"),
        ),
    ],
)
def test_impossible_tracks_are_refused(x, y, columns, message):
    with pytest.raises(RacelineError, match=r"^hall\.csv: .*" + message):
        Raceline(x, y, source="hall.csv", **columns)


def test_missing_columns_are_named():
    track = Raceline(*SQUARE, name="square")
    assert track.speed is None and track.d_left is None
    with pytest.raises(RacelineError, match="square: expected a raceline with speeds, got none"):
        track.speed_at(0.0)
    with pytest.raises(RacelineError, match="square: expected a raceline with distances to"):
        track.widths_at(0.0)
    assert track.sample([0.0]).speed is None


def test_arrays_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        WINDING.speed[0] = 99.0


def test_coordinates_beyond_the_earth_are_refused():
    x, y = [0.0, 1.0, 1e300, 0.0], [0.0, 0.0, 1.0, 1.0]
    expected = "point 2: expected a x of at most 1e.08 m or m/s, got 1e.300"
    with pytest.raises(RacelineError, match=expected):
        Raceline(x, y)
