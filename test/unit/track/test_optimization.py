"""Optimized lines compared with known answers, other solvers and published lines."""

import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear

from map_racing.errors import ParameterError, RacelineError
from map_racing.track import least_curvature
from map_racing.track.files.load import load_raceline
from map_racing.track.optimization import fastest_line, minimum_curvature, squared_curvature
from map_racing.track.raceline import Raceline
from map_racing.track.speed_profile import raceline_speeds
from map_racing.track.walls import Walls
from map_racing.vehicle.grids import default_grid
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.steady_state import steady_state_table

LIMITS = {"a_lat_max": 7.0, "a_drive_max": 3.0, "a_brake_max": 3.0, "v_max": 15.0}
CIRCUITS = (
    "Spielberg",
    *(pytest.param(name, marks=pytest.mark.once) for name in ("Monza", "Oschersleben", "Austin")),
)


def bean(count=300, width=1.0, **keywords):
    """A smooth track with bends both ways, driven counter-clockwise."""
    angle = np.linspace(0.0, 2.0 * math.pi, count, endpoint=False)
    radius = 7.0 + 2.0 * np.cos(3.0 * angle)
    walls = {"d_left_m": np.full(count, width), "d_right_m": np.full(count, width)}
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return Raceline(x, y, name="bean", **{**walls, **keywords})


def ring(radius=5.0, width=1.0, count=200):
    angle = np.linspace(0.0, 2.0 * math.pi, count, endpoint=False)
    walls = np.full(count, width)
    return Raceline(
        radius * np.cos(angle), radius * np.sin(angle), d_left_m=walls, d_right_m=walls, name="ring"
    )


def test_on_a_ring_the_widest_circle_bends_least():
    found = minimum_curvature(ring(5.0, 1.0), 0.25)
    assert squared_curvature(found.raceline) == pytest.approx(2.0 * math.pi / 5.75, rel=1e-4)
    np.testing.assert_allclose(np.hypot(found.raceline.x, found.raceline.y), 5.75, atol=2e-3)
    np.testing.assert_allclose(found.raceline.d_right, 0.25, atol=2e-3)
    np.testing.assert_allclose(found.raceline.d_left, 1.75, atol=2e-3)
    assert found.clearance == pytest.approx(0.25, abs=1e-3)


def test_under_much_tension_the_narrowest_circle_is_shortest():
    # (1/R^2 + t) 2 pi R has its least value at R = 1/sqrt(t), here inside of the ring.
    found = minimum_curvature(ring(5.0, 1.0), 0.25, tension=1.0)
    np.testing.assert_allclose(np.hypot(found.raceline.x, found.raceline.y), 4.25, atol=2e-3)
    found = minimum_curvature(ring(5.0, 1.0), 0.25, tension=1.0 / 4.8**2)
    np.testing.assert_allclose(np.hypot(found.raceline.x, found.raceline.y), 4.8, atol=0.01)


def test_the_line_of_a_symmetric_track_is_symmetric():
    """Two half circles and two straights: least curvature is outside all the way."""
    turn = np.linspace(-0.5 * math.pi, 0.5 * math.pi, 40)
    straight = np.linspace(-6.0, 6.0, 60)[1:-1]
    x = np.concatenate((6.0 + 3 * np.cos(turn), straight[::-1], -6.0 - 3 * np.cos(turn), straight))
    y = np.concatenate(
        (3.0 * np.sin(turn), np.full(58, 3.0), -3.0 * np.sin(turn), np.full(58, -3.0))
    )
    track = Raceline(x, y, d_left_m=np.full(x.size, 1.0), d_right_m=np.full(x.size, 1.0))
    found = minimum_curvature(track, 0.2)
    line = found.raceline
    assert squared_curvature(line) < 0.75 * squared_curvature(track)
    assert line.d_right.min() == pytest.approx(0.2, abs=2e-3)
    # The track is symmetric about both axes, and so is its best line.
    for mirrored in ((line.x, -line.y), (-line.x, line.y)):
        away = [
            abs(line.project(x, y).d) for x, y in zip(*(column.tolist() for column in mirrored))
        ]
        assert max(away) < 0.01


@pytest.mark.once
@settings(deadline=None, max_examples=6)
@given(st.floats(0.0, 2.0 * math.pi), st.floats(0.3, 4.0), st.booleans())
def test_place_size_and_side_do_not_matter(angle, scale, mirror):
    """A moved, scaled or mirrored track has the moved, scaled or mirrored line."""
    track = bean()
    expected = minimum_curvature(track, 0.3, step=0.2).raceline
    cos, sin = scale * math.cos(angle), scale * math.sin(angle)
    y = -track.y if mirror else track.y
    moved = Raceline(
        3.0 + cos * track.x - sin * y,
        -5.0 + sin * track.x + cos * y,
        d_left_m=scale * track.d_left,
        d_right_m=scale * track.d_right,
    )
    found = minimum_curvature(moved, 0.3 * scale, step=0.2 * scale).raceline
    assert scale * squared_curvature(found, 0.1 * scale) == pytest.approx(
        squared_curvature(expected, 0.1), rel=2e-3
    )


@pytest.mark.once
@settings(deadline=None, max_examples=25)
@given(st.floats(0.0, 1.0), st.floats(0.5, 4.0), st.floats(-0.05, 0.05))
def test_no_bump_that_keeps_clear_of_the_walls_lowers_the_curvature(place, wide, high):
    found = optimized_bean()
    line = found.raceline
    along = np.abs(np.mod(line.s - place * line.length + 0.5 * line.length, line.length))
    bump = high * np.exp(-(((along - 0.5 * line.length) / wide) ** 2))
    bumped = Raceline(*line.to_cartesian(line.s, bump))
    clear = found.walls.distance(np.stack((bumped.x, bumped.y), axis=1)).min()
    assert clear < found.clearance - 1e-4 or squared_curvature(bumped) > (
        1.0 - 1e-4
    ) * squared_curvature(line)


_OPTIMIZED = []


def optimized_bean():
    if not _OPTIMIZED:
        _OPTIMIZED.append(minimum_curvature(bean(), 0.3))
    return _OPTIMIZED[0]


def test_the_clearance_is_kept_also_between_the_points():
    found = optimized_bean()
    line = found.raceline
    at = line.sample(np.linspace(0.0, line.length, 20 * line.n, endpoint=False))
    assert found.walls.distance(np.stack((at.x, at.y), axis=1)).min() > 0.3 - 1e-3


def test_a_wall_that_juts_out_between_the_normals_is_not_touched():
    width = np.full(300, 1.0)
    width[75] = 0.35  # a post, thinner than the spacing of the normals
    found = minimum_curvature(bean(d_left_m=width, d_right_m=np.full(300, 1.0)), 0.2, step=0.3)
    line = found.raceline
    at = line.sample(np.linspace(0.0, line.length, 20 * line.n, endpoint=False))
    post = np.array(bean().to_cartesian(bean().s_points[75], 0.35))
    assert np.hypot(at.x - post[0], at.y - post[1]).min() > 0.2 - 1e-3


def test_derivatives_of_the_model():
    generator = np.random.default_rng(1)
    track = bean(60)
    points = np.stack((track.x, track.y), axis=1)[:60]
    normals = np.stack((-np.sin(track.psi), np.cos(track.psi)), axis=1)[:60]
    alpha = 0.2 * generator.standard_normal(60)
    model = least_curvature._model(points, normals, alpha, 0.3)
    for k in (0, 1, 17, 58, 59):
        step = np.zeros(60)
        step[k] = 1e-6
        ahead, behind = (
            least_curvature._model(points, normals, alpha + sign * step, 0.3).value
            for sign in (1.0, -1.0)
        )
        assert 2.0 * model.gradient[k] == pytest.approx((ahead - behind) / 2e-6, rel=1e-5, abs=1e-6)


@settings(deadline=None, max_examples=40)
@given(st.integers(8, 40), st.integers(0, 10**6))
def test_bounded_steps_are_those_of_another_solver(n, seed):
    generator = np.random.default_rng(seed)
    before, at, after = generator.standard_normal((3, n))
    jacobian = np.zeros((n, n))
    index = np.arange(n)
    jacobian[index, index] = at
    jacobian[index, index - 1] = before
    jacobian[index, (index + 1) % n] = after
    residual = generator.standard_normal(n)
    low = -np.abs(generator.standard_normal(n)) - 0.01
    high = np.abs(generator.standard_normal(n)) + 0.01
    normal = jacobian.T.dot(jacobian)
    model = least_curvature._Model(
        0.0,
        jacobian.T.dot(residual),
        normal[index, index],
        normal[index, (index + 1) % n],
        normal[index, (index + 2) % n],
    )
    step = least_curvature._bounded_minimum(model, low, high)
    assert np.all((step >= low) & (step <= high))
    expected = lsq_linear(jacobian, -residual, (low, high), method="bvls").x
    costs = [float(np.sum((residual + jacobian.dot(x)) ** 2)) for x in (step, expected)]
    assert costs[0] <= costs[1] + 1e-6 * (1.0 + costs[1])


@pytest.mark.once
def test_on_a_ring_the_narrowest_circle_is_fastest():
    """The lap takes 2 pi sqrt(R / a), although the widest circle has the least curvature."""
    found = fastest_line(ring(5.0, 1.0), 0.25, LIMITS)
    np.testing.assert_allclose(np.hypot(found.raceline.x, found.raceline.y), 4.25, atol=3e-3)
    _, time = raceline_speeds(found.raceline, **LIMITS)
    assert time == pytest.approx(2.0 * math.pi * math.sqrt(4.25 / 7.0), rel=1e-3)


@pytest.mark.once
def test_the_fastest_line_is_faster_and_bends_little_more():
    track = load_raceline("reference")
    least = minimum_curvature(track, 0.25)
    fastest = fastest_line(track, 0.25, LIMITS)
    times = [raceline_speeds(found.raceline, **LIMITS)[1] for found in (least, fastest)]
    assert times[1] < 0.97 * times[0]
    sums = [squared_curvature(found.raceline) for found in (least, fastest)]
    assert sums[0] <= sums[1] <= 1.1 * sums[0]
    assert fastest.tension > 0.0 and least.tension == 0.0
    np.testing.assert_allclose(
        fastest.raceline.speed, raceline_speeds(fastest.raceline, **LIMITS)[0], rtol=1e-3
    )


@pytest.mark.once
@pytest.mark.parametrize("name", ["reference", "club"])
def test_shipped_tracks_have_room_for_better(name):
    """Within the clearance of the shipped line, both curvature and lap time decrease."""
    track = load_raceline(name)
    clearance = Walls(track).distance(np.stack((track.x, track.y), axis=1)).min()
    found = fastest_line(track, float(clearance), LIMITS)
    assert found.clearance > clearance - 1e-3
    assert squared_curvature(found.raceline) < 0.9 * squared_curvature(track)
    before, after = (raceline_speeds(line, **LIMITS)[1] for line in (track, found.raceline))
    assert after < 0.95 * before


@pytest.mark.parametrize("circuit", CIRCUITS)
def test_no_worse_than_the_published_line(shared_data, circuit):
    """Within the clearance of the published line, with the limits of the shipped car."""
    folder = shared_data / "tracks" / circuit
    track = load_raceline(folder / f"{circuit}_centerline.csv")
    published = load_raceline(folder / f"{circuit}_raceline.csv")
    walls = Walls(track)
    at = published.sample(np.linspace(0.0, published.length, 4 * published.n, endpoint=False))
    clearance = float(walls.distance(np.stack((at.x, at.y), axis=1)).min())
    vehicle = load_vehicle("nuc4")
    limits = {
        "a_lat_max": steady_state_table(vehicle, *default_grid(vehicle)).max_lateral_acceleration,
        "a_drive_max": vehicle.a_max,
        "a_brake_max": vehicle.a_brake_max,
        "v_max": vehicle.v_max,
    }
    found = fastest_line(track, clearance, limits, step=0.25)
    assert found.clearance > clearance - 1.5e-3
    assert squared_curvature(found.raceline) <= squared_curvature(published)
    assert raceline_speeds(found.raceline, **limits)[1] <= raceline_speeds(published, **limits)[1]


@pytest.mark.once
def test_memory_is_linear_in_the_number_of_points():
    peaks = []
    for step in (0.2, 0.05):
        tracemalloc.start()
        minimum_curvature(bean(), 0.3, step=step)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[1] < 5.0 * peaks[0]


# -- impossible inputs, and repairs -------------------------------------------------------------


def test_crossing_normals_are_mended_and_told():
    """A square whose corners are sharper than the track is wide."""
    side = np.linspace(-4.0, 4.0, 80, endpoint=False)
    x = np.concatenate((side, np.full(80, 4.0), -side, np.full(80, -4.0)))
    y = np.concatenate((np.full(80, -4.0), side, np.full(80, 4.0), -side))
    track = Raceline(x, y, d_left_m=np.full(320, 1.0), d_right_m=np.full(320, 1.0))
    found = minimum_curvature(track, 0.2)
    assert "crossing-normals" in [finding.code for finding in found.findings]
    assert found.clearance > 0.2 - 1e-3
    # The inner corners are at 3 m; a circle around them is the widest that fits between the corners
    # and the outer walls, and the line has less curvature.
    assert np.hypot(np.abs(found.raceline.x) - 3.0, np.abs(found.raceline.y) - 3.0).min() > 0.199
    assert squared_curvature(found.raceline) < 2.0 * math.pi / (3.0 * math.sqrt(2.0) + 0.2)
    assert 1.0 / np.abs(found.raceline.kappa).max() > 3.0


@pytest.mark.parametrize("bad", [0.0, -0.2])
@pytest.mark.parametrize("side", ["left", "right"])
def test_zero_or_negative_widths_are_named(side, bad):
    width = np.full(300, 1.0)
    width[98:103] = bad
    with pytest.raises(RacelineError, match=f"positive distance to the {side} wall"):
        minimum_curvature(bean(**{f"d_{side}_m": width}), 0.2)


def test_too_narrow_a_place_is_named():
    width = np.full(300, 1.0)
    width[140:150] = 0.2
    track = bean(d_left_m=width, d_right_m=width)
    x, y = track.position(track.s_points[145])
    with pytest.raises(
        RacelineError, match="too narrow at .* 0.[0-9]* m from wall to wall"
    ) as error:
        minimum_curvature(track, 0.3)
    place = [float(part) for part in str(error.value).split("(")[1].split(")")[0].split(",")]
    assert math.hypot(place[0] - x, place[1] - y) < 1.0


def test_a_track_too_tight_for_the_car_is_refused():
    limits = {**LIMITS, "a_lat_max": lambda v: np.minimum(v**2 / 4.0, 7.0)}
    with pytest.raises(RacelineError, match="bean: no line for this car: .* cannot steer a radius"):
        fastest_line(bean(), 0.3, limits)


def test_a_track_without_walls_is_refused():
    track = bean()
    with pytest.raises(RacelineError, match="distances to both walls"):
        minimum_curvature(Raceline(track.x, track.y), 0.2)


def test_an_open_track_is_refused():
    track = bean()
    part = slice(0, int(0.9 * track.n))
    with pytest.raises(RacelineError, match="expected a closed track"):
        minimum_curvature(
            Raceline(
                track.x[part],
                track.y[part],
                d_left_m=track.d_left[part],
                d_right_m=track.d_right[part],
            ),
            0.2,
        )


def test_a_track_that_crosses_itself_is_refused():
    angle = np.linspace(0.0, 2.0 * math.pi, 300, endpoint=False)
    width = np.full(300, 0.5)
    eight = Raceline(
        8.0 * np.cos(angle), 4.0 * np.sin(2.0 * angle), d_left_m=width, d_right_m=width
    )
    with pytest.raises(RacelineError, match="expected one loop"):
        minimum_curvature(eight, 0.2)


def test_a_track_that_goes_round_twice_is_refused():
    angle = np.linspace(0.0, 4.0 * math.pi, 600, endpoint=False)
    radius = 5.0 + 0.05 * np.sin(0.5 * angle)
    width = np.full(600, 0.5)
    twice = Raceline(
        radius * np.cos(angle), radius * np.sin(angle), d_left_m=width, d_right_m=width
    )
    with pytest.raises(RacelineError, match="meets itself"):
        minimum_curvature(twice, 0.2)


@pytest.mark.parametrize(
    "arguments, name",
    [
        ({"clearance": 0.0}, "clearance"),
        ({"clearance": math.nan}, "clearance"),
        ({"clearance": 0.2, "step": -1.0}, "step"),
        ({"clearance": 0.2, "tension": -1.0}, "tension"),
    ],
)
def test_impossible_parameters_are_named(arguments, name):
    with pytest.raises(ParameterError, match=name):
        minimum_curvature(bean(), **arguments)
