"""Axle forces, slip angles, and curves through them."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.errors import IdentificationError, ParameterError
from map_racing.identification.axles import AxlePoints, axle_points
from map_racing.identification.tire_fit import beside_rear, fit_linear, fit_pacejka
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.single_track import GRAVITY
from map_racing.vehicle.steady_state import steady_state_table
from map_racing.vehicle.tires import LinearTire, PacejkaTire

FRONT = PacejkaTire(7.4, 1.3, 0.9, 0.4)
LOAD = 16.0


def measured(tire, widest=0.3, count=600, slip_noise=0.0, force_noise=0.0, seed=1):
    """Points of a tire, left and right, with noise."""
    rng = np.random.default_rng(seed)
    slip = np.linspace(-widest, widest, count)
    force = -LOAD * tire.normalized_force(slip)
    return AxlePoints(
        slip + rng.normal(0.0, 1.0, count) * slip_noise,
        force + rng.normal(0.0, 1.0, count) * force_noise,
        *(LOAD, slip_noise, force_noise),
    )


def worst(tire, fitted, widest):
    """Largest difference of two curves up to a slip, as a share of the first one's peak in that
    range."""
    slip = np.linspace(0.0, widest, 300)
    true = tire.normalized_force(slip)
    return np.max(np.abs(fitted.normalized_force(slip) - true)) / np.max(true)


def steady(vehicle, v, delta):
    """Lateral velocity, yaw rate and acceleration in steady state, from the model itself."""
    a_y = steady_state_table(vehicle, [v], [delta]).a_lat[0, 0]
    r = a_y / v
    rear_slip = -vehicle.rear.slip(a_y / (GRAVITY * vehicle.mu))
    return v * np.tan(rear_slip) + vehicle.l_r * r, r, a_y


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("delta", [0.05, 0.2, 0.35])
def test_points_of_the_model_lie_on_its_tires(side, delta):
    vehicle, v = load_vehicle("nuc4"), 3.0
    v_y, r, a_y = steady(vehicle, v, delta)
    motion = (np.array([value]) for value in (v, side * v_y, side * r, side * delta, side * a_y))
    for points, tire in zip(axle_points(vehicle, *motion), (vehicle.front, vehicle.rear)):
        assert points.slip[0] * side < 0.0 < points.force[0] * side
        on_curve = -vehicle.mu * points.load * tire.normalized_force(points.slip)
        assert points.force[0] == pytest.approx(on_curve[0], abs=1e-6)
    assert sum(p.load for p in axle_points(vehicle, *np.ones((5, 1)))) == pytest.approx(
        vehicle.m * GRAVITY
    )


def test_the_papers_front_force_has_the_cosine():
    vehicle, delta = load_vehicle("nuc4"), np.array([0.4])
    motion = np.array([3.0]), np.array([0.1]), np.array([1.5]), delta, np.array([4.5])
    model, paper = (axle_points(vehicle, *motion, front_force=f) for f in ("model", "paper"))
    expected = vehicle.m * vehicle.l_r * 4.5 / vehicle.l_wb
    assert model[0].force[0] == pytest.approx(expected)
    assert paper[0].force[0] == pytest.approx(expected / np.cos(0.4))
    assert (
        paper[1].force[0]
        == model[1].force[0]
        == pytest.approx(vehicle.m * vehicle.l_f * 4.5 / vehicle.l_wb)
    )
    with pytest.raises(ParameterError, match="front_force"):
        axle_points(vehicle, *motion, front_force="theirs")


@pytest.mark.once
def test_errors_that_both_axles_share_are_told_by_the_rear():
    """Each third of the points has its own heading error and heading noise, neither of which
    affects the front."""
    rng, rear_tire, count = np.random.default_rng(4), PacejkaTire(25.0, 1.3, 1.2, 0.4), 600
    front = measured(FRONT, 0.2, count)
    force = front.force
    rear = AxlePoints(-rear_tire.slip(np.abs(force) / LOAD) * np.sign(force), force, LOAD)
    shared = np.repeat([0.012, -0.008, 0.004], count // 3) + rng.normal(0.0, 0.005, count)
    noise = {"slip_noise": 0.005, "force_noise": 0.05, "difference_noise": 1e-3}
    seen = [axle._replace(slip=axle.slip + shared, **noise) for axle in (front, rear)]
    found = beside_rear(*seen, rear_tire)
    assert np.max(np.abs(found.slip - front.slip)) < 2e-3
    assert found.slip_noise == 1e-3 and found.force is seen[0].force
    true, without = (worst(FRONT, fit_pacejka(p).tire, 0.2) for p in (found, seen[0]))
    assert true < 0.01 < without


def test_without_noise_nothing_is_moved():
    points = measured(FRONT)
    assert beside_rear(points, points, PacejkaTire(8.0, 1.4, 1.0, 0.0)) is points


def test_exact_points_give_the_curve_back():
    fit = fit_pacejka(measured(FRONT))
    assert worst(FRONT, fit.tire, 0.3) < 1e-3
    assert fit.inlier.all() and fit.mean_residual_n < 1e-2 and fit.rejected_share == 0.0


@pytest.mark.rest_once
@pytest.mark.parametrize("seed", range(5))
def test_curve_is_recovered_from_noise(seed):
    fit = fit_pacejka(measured(FRONT, force_noise=0.4, seed=seed))
    assert worst(FRONT, fit.tire, 0.3) < 0.03
    assert fit.covered_slip == pytest.approx(0.3, abs=0.02)
    peak = fit.parameters["peak_n"]
    assert peak.determined and peak.low < LOAD * FRONT.peak < peak.high


@pytest.mark.once
@given(st.floats(4.0, 15.0), st.floats(1.1, 1.5), st.floats(0.5, 1.3), st.floats(-1.0, 0.9))
@settings(deadline=None, max_examples=15)
def test_any_tire_within_the_bounds(B, C, D, E):
    tire = PacejkaTire(B, C, D, E)
    assert worst(tire, fit_pacejka(measured(tire, force_noise=0.1)).tire, 0.3) < 0.03


def test_a_shape_factor_beyond_the_bound_is_fitted_within_it():
    tire = load_vehicle("nuc4").front
    assert tire.C > 1.5
    fit = fit_pacejka(measured(tire, widest=0.4, force_noise=0.1))
    assert fit.tire.C <= 1.5 and fit.tire.E <= 1.1
    assert worst(tire, fit.tire, 0.4) < 0.03


@pytest.mark.rest_once
@pytest.mark.parametrize("seed", range(5))
def test_a_quarter_of_gross_outliers(seed):
    points = measured(FRONT, force_noise=0.3, seed=seed)
    rng = np.random.default_rng(100 + seed)
    gross = rng.random(points.force.size) < 0.25
    # All to one side, so that they do not cancel out.
    force = np.where(gross, points.force + rng.uniform(4.0, 25.0, gross.size), points.force)
    fit = fit_pacejka(points._replace(force=force))
    assert worst(FRONT, fit.tire, 0.3) < 0.05
    assert not np.any(fit.inlier & gross)
    assert fit.rejected_share == pytest.approx(np.mean(gross), abs=0.01)


def test_steps_of_rejection_keep_what_is_within_the_last_threshold():
    points = measured(FRONT, force_noise=0.9)
    fit = fit_pacejka(points)
    error = points.force + LOAD * fit.tire.normalized_force(points.slip)
    # In left turns the slip is negative; residuals refer to the force over positive slip.
    np.testing.assert_allclose(fit.residual, error, atol=1e-9)
    assert 0.0 < fit.rejected_share < 0.3
    np.testing.assert_allclose(fit.error, error, atol=1e-9)
    # The mask is from the second-to-last fit: nearly all of it also holds for the last.
    assert np.mean(fit.inlier == (np.abs(error) < 10.0 / 2**3)) > 0.98


def test_sum_of_squares_is_what_is_smallest():
    """A fit that receives squared residuals would minimize fourth powers."""
    points = measured(FRONT, force_noise=0.4, seed=7)
    fit = fit_pacejka(points)

    def squares(tire):
        error = points.force + LOAD * tire.normalized_force(points.slip)
        return np.sum(error[fit.inlier] ** 2)

    least = squares(fit.tire)
    for name in "BCDE":
        for factor in (0.98, 1.02):
            value = getattr(fit.tire, name) * factor
            if name == "C" and value > 1.5:
                continue
            assert squares(dataclasses.replace(fit.tire, **{name: value})) > least - 0.05


@pytest.mark.once
def test_noise_of_the_slip_angle_does_not_soften_a_stiff_tire():
    tire = PacejkaTire(25.0, 1.4, 1.2, 0.0)
    bias = {"ignored": [], "known": []}
    for seed in range(8):
        points = measured(tire, 0.012, 400, slip_noise=0.004, force_noise=0.2, seed=seed)
        for name, given_points in (
            ("ignored", points._replace(slip_noise=0.0)),
            ("known", points),
        ):
            stiffness = fit_linear(given_points).tire.C_S
            bias[name].append(stiffness)
    secant = fit_linear(measured(tire, 0.012, 400)).tire.C_S
    assert np.mean(bias["ignored"]) < 0.85 * secant
    assert np.mean(bias["known"]) == pytest.approx(secant, rel=0.02)
    fitted = [
        fit_pacejka(
            measured(tire, 0.012, 400, slip_noise=0.004, force_noise=0.2, seed=seed)
        ).tire.normalized_force(0.01)
        for seed in range(8)
    ]
    assert np.mean(fitted) == pytest.approx(tire.normalized_force(0.01), rel=0.03)


def test_what_the_data_do_not_reach_is_not_sold_as_measured():
    base = PacejkaTire(5.0, 1.4, 1.1, 0.2)
    fit = fit_pacejka(measured(FRONT, widest=0.04, force_noise=0.1), base)
    assert not fit.saturated and fit.rise > 0.6
    assert not any(fit.parameters[name].determined for name in ("C", "D", "E", "peak_n"))
    assert fit.parameters["stiffness_n_per_rad"].determined
    stiffness = fit.parameters["stiffness_n_per_rad"]
    assert stiffness.low < LOAD * FRONT.stiffness < stiffness.high
    # It stays near the base.
    assert (pytest.approx(1.4, abs=0.1), pytest.approx(1.1, abs=0.35)) == (fit.tire.C, fit.tire.D)


def test_saturation_is_seen():
    assert fit_pacejka(measured(FRONT, widest=0.4, force_noise=0.2)).saturated


@pytest.mark.once
@pytest.mark.parametrize("share", [0.84, 0.9, 0.98])
@pytest.mark.parametrize(
    "tire", [FRONT, PacejkaTire(8.0, 1.5, 0.9, 0.2), PacejkaTire(6.0, 1.1, 1.0, -0.5)]
)
def test_the_peak_is_reached_only_where_the_forces_end_at_it(tire, share):
    slip = np.linspace(0.0, tire.peak_slip, 4000)
    widest = slip[np.searchsorted(tire.normalized_force(slip), share * tire.peak)]
    for seed in range(3):
        points = measured(tire, widest, 400, slip_noise=0.003, force_noise=0.4, seed=seed)
        fit = fit_pacejka(points, PacejkaTire(6.0, 1.3, 1.0, 0.0), oversampling=5.0)
        assert fit.saturated == fit.parameters["peak_n"].determined == (share > 0.95)
        assert fit.reach == pytest.approx(share, abs=0.06)


@pytest.mark.parametrize("least, widest, known", [(0.12, 0.16, False), (0.0, 0.16, True)])
def test_forces_at_a_single_slip_tell_no_stiffness(least, widest, known):
    """As of a car that circles at one speed: they tell a chord of the curve."""
    slip = np.linspace(least, widest, 400)
    slip[::2] *= -1.0
    noise = np.random.default_rng(3).normal(0.0, 0.1, slip.size)
    points = AxlePoints(slip, noise - LOAD * FRONT.normalized_force(slip), LOAD, 0.001, 0.1)
    fit = fit_pacejka(points, PacejkaTire(20.0, 1.5, 0.8, 0.0))
    found = fit.parameters["stiffness_n_per_rad"]
    assert found.determined == known
    assert fit.parameters["B"].determined <= known
    if known:
        assert found.low < LOAD * FRONT.stiffness < found.high
    else:
        chord = fit_linear(points).stiffness_n_per_rad
        expected = LOAD * FRONT.normalized_force(0.14) / 0.14
        assert chord.determined and chord.value == pytest.approx(expected, rel=0.02)


def test_forces_at_a_single_slip_tell_no_peak():
    """One steering angle at one speed: even a flat curve through it is a guess."""
    rng = np.random.default_rng(1)
    slip = 0.07 + np.cumsum(rng.normal(0.0, 0.002, 400))
    force = 0.6 * LOAD + rng.normal(0.0, 0.4, 400)
    fit = fit_pacejka(AxlePoints(-slip, force, LOAD, 0.001, 0.4), oversampling=5.0)
    assert fit.reach > 0.95 and not fit.saturated


def test_intervals_do_not_shrink_with_the_rate_of_sampling():
    few, many = measured(FRONT, count=100, force_noise=0.3), measured(FRONT, force_noise=0.3)
    width = {}
    for name, points, oversampling in (("few", few, 1.0), ("many", many, 6.0)):
        p = fit_pacejka(points, oversampling=oversampling).parameters["stiffness_n_per_rad"]
        width[name] = p.high - p.low
    assert width["many"] == pytest.approx(width["few"], rel=0.35)


@pytest.mark.once
def test_the_stiffness_is_within_its_interval_about_as_often_as_it_says():
    inside = 0
    for seed in range(40):
        fit = fit_pacejka(measured(FRONT, count=200, force_noise=0.3, seed=seed))
        p = fit.parameters["stiffness_n_per_rad"]
        inside += p.low < LOAD * FRONT.stiffness < p.high
    assert inside >= 34


def test_linear_tire_is_the_regression_through_the_origin():
    points = measured(FRONT, widest=0.1, force_noise=0.3)
    fit = fit_linear(points._replace(slip_noise=0.0))
    expected = -(points.slip @ points.force) / (points.slip @ points.slip)
    assert isinstance(fit.tire, LinearTire)
    assert pytest.approx(expected, rel=1e-6) == fit.tire.C_S * LOAD
    assert fit.stiffness_n_per_rad.low < expected < fit.stiffness_n_per_rad.high
    half = points.slip < 0.0
    assert fit_linear(points, half).tire.C_S != fit.tire.C_S


def test_refuses_what_is_no_tire():
    points = measured(FRONT, count=12)
    with pytest.raises(IdentificationError, match="at least 20 points"):
        fit_pacejka(points)
    rng = np.random.default_rng(1)
    scattered = AxlePoints(rng.uniform(-0.3, 0.3, 500), rng.uniform(-40.0, 40.0, 500), LOAD)
    with pytest.raises(IdentificationError, match="of any tire curve"):
        fit_pacejka(scattered)
