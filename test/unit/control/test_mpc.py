"""Model predictive control: its discretization, its plan, and its fallback without a plan."""

import math
import sys

import numpy as np
import pytest
from scipy.linalg import expm

from map_racing.control import mpc
from map_racing.control.controller import Status
from map_racing.control.laws import build_law
from map_racing.control.parameters import (
    MPC_MODELS,
    MpcParameters,
    load_controller_parameters,
    load_law,
    save_controller_parameters,
)
from map_racing.control.safety_limits import SafetyLimits
from map_racing.control.state import CarState, moved
from map_racing.control.steering import build_steering_map
from map_racing.errors import ParameterError
from map_racing.simulation import race as races
from map_racing.simulation.plants import build_plant, load_plant
from map_racing.track.files.load import load_raceline
from map_racing.track.raceline import Raceline
from map_racing.vehicle.parameters import load_vehicle

NUC4 = load_vehicle("nuc4")
GIVEN = load_law("mpc_single_track").with_(delay_s=0.0, grip_use=0.0, speed_scale=1.0)


@pytest.fixture
def solver():
    """Tests with the solver need OSQP, which scripts/test installs."""
    pytest.importorskip("osqp")


def circle(radius, speed, count=400):
    angle = np.arange(count) * 2.0 * math.pi / count
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    return Raceline(x, y, vx_mps=np.full(count, speed))


def on_circle(radius, speed, v_y, ahead):
    """State of the reference point on a left-hand circle, `ahead` of the center of gravity."""
    r = speed / radius
    psi = 0.5 * math.pi - math.atan2(v_y + ahead * r, speed)
    return CarState(0.0, radius, 0.0, psi, speed, v_y + ahead * r, r)


def test_steps_are_exact():
    generator = np.random.default_rng(3)
    A, c = generator.normal(size=(4, 5, 5)), generator.normal(size=(4, 5))
    A[1] *= 60.0  # settles within a step, like the rear tire of NUC4
    step, inputs, rest = mpc._discrete(A, c, 0.05)
    for k in range(4):
        M = np.zeros((7, 7))
        M[:5, :5], M[:5, 6], M[4, 5] = A[k], c[k], 1.0
        exact = expm(0.05 * M)
        scale = np.abs(exact).max()
        np.testing.assert_allclose(step[k], exact[:5, :5], rtol=0, atol=1e-4 * scale)
        np.testing.assert_allclose(inputs[k], exact[:5, 5], rtol=0, atol=1e-4 * scale)
        np.testing.assert_allclose(rest[k], exact[:5, 6], rtol=0, atol=1e-4 * scale)


@pytest.mark.parametrize("model", MPC_MODELS)
def test_a_straight_is_driven_straight(solver, model):
    x = np.concatenate([np.linspace(0, 50, 251), np.linspace(50, 0, 251)])
    y = np.concatenate([np.zeros(251), np.full(251, 20.0)])
    controller = build_law(GIVEN.with_(model=model), NUC4, Raceline(x, y, vx_mps=np.full(502, 4.0)))
    result = controller.step(CarState(0.0, 20.0, 0.0, 0.0, 4.0, 0.0, 0.0))
    assert result.status is Status.OK
    assert abs(result.steering_angle) < 2e-3 and result.speed == pytest.approx(4.0, abs=1e-6)
    for side in (1.0, -1.0):  # back to the line, symmetrically from both sides
        controller.reset()
        angle = controller.step(CarState(0.0, 20.0, 0.1 * side, 0.0, 4.0, 0.0, 0.0)).steering_angle
        assert -0.02 > side * angle > -NUC4.delta_max


@pytest.mark.once
def test_a_circle_is_held_with_the_steady_state_angle(solver):
    radius, speed = 4.0, 4.0
    controller = build_law(GIVEN, NUC4, circle(radius, speed))
    steady, _ = build_steering_map("table", NUC4, 12.0).steering(speed, speed**2 / radius)
    # The model itself, driven by the controller's commands, settles on the circle.
    derivatives = mpc.single_track_derivatives(NUC4)
    state, angle = on_circle(radius, speed, 0.0, -NUC4.l_r), 0.0
    center = moved(state, NUC4.l_r)
    t, x, y, psi, v, v_y, r = center
    for k in range(4000):
        if k % 25 == 0:
            state = moved(CarState(t, x, y, psi, v, v_y, r), -NUC4.l_r)
            angle = controller.step(state).steering_angle
        v_y_dot, r_dot = derivatives(v, v_y, r, angle, 0.0)
        v_y, r, psi = v_y + 1e-3 * v_y_dot, r + 1e-3 * r_dot, psi + 1e-3 * r
        x += 1e-3 * (v * math.cos(psi) - v_y * math.sin(psi))
        y += 1e-3 * (v * math.sin(psi) + v_y * math.cos(psi))
        t += 1e-3
    assert angle == pytest.approx(steady, abs=2e-3)
    rear = moved(CarState(t, x, y, psi, v, v_y, r), -NUC4.l_r)
    assert math.hypot(rear.x, rear.y) == pytest.approx(radius, abs=0.02)
    assert controller.failures == 0


def test_a_step_without_solution_follows_the_last_plan(solver):
    controller = build_law(GIVEN.with_(stages=20, stage_s=0.05), NUC4, circle(4.0, 3.0))
    state = on_circle(4.0, 3.0, 0.0, -NUC4.l_r)
    angle = controller.step(state).steering_angle
    planned = controller._program._rates.copy()
    assert np.abs(planned).max() > 0.1
    controller._program._solver.solve = lambda raise_error: type(
        "Found", (), {"x": np.full(20, np.nan), "info": type("Info", (), {"status": "failed"})}
    )
    for k in range(1, 45):  # at 40 Hz two poses a stage; the plan ends after 40
        before, angle = angle, controller.step(state._replace(t=0.025 * k)).steering_angle
        rate = planned[k // 2] if k // 2 < 20 else 0.0
        assert angle - before == pytest.approx(0.025 * rate, abs=1e-9)
    assert controller.failures == 44


def test_damaged_states_stop(solver):
    controller = build_law(GIVEN, NUC4, circle(4.0, 3.0))
    for name in ("t", "x", "psi", "v_x", "r"):
        state = CarState(0.0, 4.0, 0.0, 1.6, 3.0, 0.0, 0.75)._replace(**{name: math.nan})
        result = controller.step(state)
        assert result.status is Status.INVALID_STATE and result.speed == 0.0
        assert math.isfinite(result.steering_angle)


@pytest.mark.once
@pytest.mark.parametrize("name, error", [("mpc_single_track", 0.03), ("mpc_kinematic", 0.3)])
def test_a_lap_of_the_reference(solver, name, error):
    plant = load_plant("nuc4")
    raceline = load_raceline("reference")
    controller = build_law(load_law(name), plant.vehicle, raceline)
    log = races.race(
        *build_plant(plant, 1)[:1], controller, raceline, build_plant(plant, 1)[1], laps=1
    )
    assert log.outcome is races.Outcome.COMPLETED and controller.failures == 0
    d = [raceline.project(*sample.true[1:3]).d for sample in log.samples[300:]]
    assert np.sqrt(np.mean(np.square(d))) < error


@pytest.mark.once
def test_computing_takes_time(monkeypatch):
    """With a pose every 25 ms, a step of 30 ms acts 30 ms later, and counts as late."""
    clock = iter(np.arange(0.0, 1e6, 0.015))
    monkeypatch.setattr(races, "thread_time", lambda: float(next(clock)))
    acted = []

    def step(seen):
        acted.append(seen.measured.t)
        return seen.measured.t

    processor = races._Processor(step, 2.0, 0.002)
    seen = [
        type("Seen", (), {"measured": CarState(t, 0, 0, 0, 0, 0, 0)})() for t in (0.0, 0.025, 0.05)
    ]
    assert processor.take(0.0, seen[:1]) == [] and processor.due == pytest.approx(0.03)
    assert processor.take(0.025, seen[1:2]) == []
    finished = processor.take(0.03, [])
    assert [result for _, result in finished] == [0.0]
    assert processor.due == pytest.approx(0.06) and acted == [0.0, 0.025]
    work = processor.work(None)
    assert (work.steps, work.late, work.failed) == (2, 1, 0)
    assert work.median_s == pytest.approx(0.015)
    # With plant steps of 80 ms they round to none.
    (finished,) = races._Processor(step, 2.0, 0.08).take(0.0, seen[:1])
    assert finished == (seen[0], 0.0)


@pytest.mark.parametrize("slowdown", [-1.0, math.nan, math.inf])
def test_impossible_slowdowns_are_refused(slowdown):
    with pytest.raises(ParameterError, match="slowdown: expected 0 or more"):
        races.race(None, None, circle(4.0, 3.0), slowdown=slowdown)


def test_without_the_solver_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "osqp", None)
    with pytest.raises(ParameterError, match=r"pip install 'map_racing\[rivals\]'"):
        build_law(GIVEN, NUC4, circle(4.0, 3.0))


def test_files(tmp_path):
    path = tmp_path / "mine.yaml"
    save_controller_parameters(GIVEN, path)
    assert load_law(path) == GIVEN and isinstance(load_law("map_paper"), type(load_law("map")))
    with pytest.raises(ParameterError, match="law: expected l1 here, got 'mpc'"):
        load_controller_parameters(path)
    path.write_text("law: mpc\nmodel: bicycle\n")
    with pytest.raises(ParameterError, match="model|heading_weight_m"):
        load_law(path)
    path.write_text("law: lqr\n")
    for load in (load_law, load_controller_parameters):
        with pytest.raises(ParameterError, match="law: expected l1 or mpc, got 'lqr'"):
            load(path)
    save_controller_parameters(GIVEN, path, SafetyLimits())
    assert load_law(path) == GIVEN
    assert isinstance(GIVEN, MpcParameters)


@pytest.mark.parametrize("name", ["map", "mpc_single_track"])
def test_a_plan_that_would_crawl_is_refused(name):
    with pytest.raises(ParameterError, match="grip_use: expected 0 .off. or 0.1 to 1.2, got 0.05"):
        load_law(name).with_(grip_use=0.05)
