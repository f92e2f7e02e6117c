"""The plants of the CommonRoad models: converged, physical, refused in one line without the
package."""

import builtins
import math
from dataclasses import replace

import numpy as np
import pytest

from map_racing.cli import main
from map_racing.errors import MapRacingError, ParameterError
from map_racing.identification.identify import steady_acceleration
from map_racing.simulation.commonroad import CommonRoadCar, _PerAxle
from map_racing.simulation.plants import build_plant, load_plant
from map_racing.vehicle.parameters import load_vehicle

BMW, F1TENTH = load_plant("bmw_320i"), load_plant("f1tenth_drift")


@pytest.fixture
def models():
    """Tests of the equations need the package, which scripts/test installs."""
    pytest.importorskip("vehiclemodels")


def car(parameters, speed=0.0, **changes):
    plant = CommonRoadCar(replace(parameters, **changes))
    plant.reset(0.0, 0.0, 0.0, speed)
    return plant


def drive(plant, seconds, steering, speed):
    """Final state under commands that are constant or functions of time."""
    for step in range(round(1000 * seconds)):
        t = 0.001 * step
        plant.advance(*(value(t) if callable(value) else value for value in (steering, speed)))
    return plant.state


def test_without_the_package_one_line_says_which_install_brings_it(monkeypatch, capsys, tmp_path):
    real = builtins.__import__

    def without(name, *rest):
        if name.split(".")[0] == "vehiclemodels":
            raise ImportError(name)
        return real(name, *rest)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MapRacingError, match=r"pip install 'map_racing\[rivals\]'"):
        build_plant(BMW, 1)
    arguments = ["ramp", "--plant", "f1tenth_drift", "--output", str(tmp_path / "ramp.bag")]
    assert main(arguments) == 1
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "pip install 'map_racing[rivals]'" in error


@pytest.mark.once
@pytest.mark.parametrize(
    ("parameters", "speed", "amplitude", "frequency"),
    [
        pytest.param(BMW, 20.0, 0.04, 2.0, marks=pytest.mark.once, id="multi-body"),
        pytest.param(F1TENTH, 4.0, 0.15, 6.0, id="drift"),
    ],
)
def test_one_step_per_millisecond_is_converged(models, parameters, speed, amplitude, frequency):
    coarse, fine = (
        drive(
            car(parameters, speed, integration_steps=steps),
            1.0,
            lambda t: amplitude * math.sin(frequency * t),
            speed,
        )
        for steps in (1, 4)
    )
    assert abs(fine.r) > 0.05
    # Less than a tenth of a millimeter after 20 m.
    np.testing.assert_allclose(coarse, fine, rtol=0.0, atol=5e-5)


@pytest.mark.once
def test_the_drift_model_turns_as_its_cornering_stiffness_says(models):
    plant, v, delta = car(F1TENTH, 4.0), 4.0, 0.01
    # The drive holds the speed: the command is above it because of cornering drag.
    state = drive(plant, 2.0, delta, v)
    l_f, l_r = 0.15875, 0.17145
    c_f, c_r = 1.0489 * 4.718, 1.0489 * 5.4562  # slopes normalized by the load, times friction
    gradient = (1.0 / c_f - 1.0 / c_r) / 9.81  # per lateral acceleration [rad s^2/m]
    expected = state.v_x * delta / (l_f + l_r + gradient * state.v_x**2)
    assert state.r == pytest.approx(expected, rel=3e-3)


def test_stiffer_tires_in_front_turn_the_car_in(models):
    rates = [
        drive(car(F1TENTH, 4.0, front_stiffness_scale=scale), 1.0, 0.05, 4.0).r
        for scale in (0.8, 0.92745, 1.1)
    ]
    assert rates == sorted(rates)
    assert rates[2] > 1.1 * rates[0]


@pytest.mark.parametrize("parameters", [BMW, F1TENTH], ids=["multi-body", "drift"])
def test_tires_of_each_axle_reach_the_equations_in_their_order(models, parameters):
    plain = car(parameters, 8.0, front_stiffness_scale=1.0, rear_stiffness_scale=1.0)
    turns = car(parameters, 8.0, front_stiffness_scale=1.0, rear_stiffness_scale=1.0)
    turns._car = _PerAxle(plain._car, [plain._car.tire] * len(plain._model.axles))
    stiffer = car(parameters, 8.0, front_stiffness_scale=1.0, rear_stiffness_scale=1.0 + 1e-12)
    states = [drive(plant, 0.05, 0.02, 8.0) for plant in (plain, turns, stiffer)]
    assert states[0] == states[1]
    np.testing.assert_allclose(states[2], states[0], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("parameters", [BMW, F1TENTH], ids=["multi-body", "drift"])
def test_from_standstill_the_car_rolls_on_its_geometry_and_hands_over_smoothly(models, parameters):
    plant = car(parameters)
    delta, top = 0.05, 1.2 * plant.slowest
    radius = plant.vehicle.l_wb / math.tan(delta)
    yaw, fastest = [], 0.0
    for _ in range(3000):
        before = plant.state
        plant.advance(delta, top)
        yaw.append(plant.state.r)
        fastest = max(fastest, abs(plant.state.v_x - before.v_x))
    assert plant.state.v_x == pytest.approx(top, rel=0.03)
    # At walking pace, tires hardly slip.
    assert plant.state.r == pytest.approx(plant.state.v_x / radius, rel=0.05)
    assert fastest < 0.02  # no jump in speed
    assert np.abs(np.diff(yaw)).max() < 0.02 * max(yaw)


@pytest.mark.once
@pytest.mark.parametrize("parameters", [BMW, F1TENTH], ids=["multi-body", "drift"])
def test_the_car_brakes_to_a_stop_and_stands(models, parameters):
    plant = car(parameters, 8.0)
    state = drive(plant, 8.0, 0.0, 0.0)
    assert 0.0 <= state.v_x < 1e-3
    # No shorter than the drive's braking distance.
    assert state.x - plant.vehicle.l_r > 8.0**2 / (2.0 * parameters.a_brake_max_mps2) - 0.1


@pytest.mark.once
def test_half_the_grip_is_half_the_lateral_acceleration(models):
    limits = []
    for factor in (1.0, 0.5):
        plant = car(F1TENTH, 5.0)
        plant.set_grip(factor)
        drive(plant, 3.0, lambda t: 0.15 * t, 5.0)
        limits.append(plant.acceleration[1])
    assert limits[1] == pytest.approx(0.5 * limits[0], rel=0.1)
    assert limits[0] < 1.0489 * 9.81


def test_a_car_that_spins_slides_to_a_halt_and_drives_on(models):
    plant = car(BMW, 30.0)
    slid = False
    for _ in range(9000):
        plant.advance(0.3, 30.0)
        slid |= plant.sliding
        assert all(map(math.isfinite, plant.state))
        if slid and not plant.sliding:
            break
    assert slid
    assert not plant.sliding
    x, y = plant.state.x, plant.state.y
    state = drive(plant, 1.5, 0.0, 3.0)
    assert math.hypot(state.x - x, state.y - y) > 1.0


@pytest.mark.parametrize("sideslip", [0.9, 1.25])
def test_a_slow_spin_does_not_become_rolling_straight_ahead(models, sideslip):
    plant = car(F1TENTH, 5.0)
    drive(plant, 0.3, 0.0, 5.0)
    plant._x[5], plant._x[6] = 4.0, sideslip
    velocities = []
    for _ in range(1500):
        plant.advance(0.0, 0.0)
        _, _, _, psi, v_x, v_y, _ = plant.state
        turn = complex(math.cos(psi), math.sin(psi))
        velocities.append(turn * complex(v_x, v_y))
    # Until it stands, no more than tires can do in a millisecond.
    changes = np.abs(np.diff(velocities))
    assert changes.max() < 2.0 * 9.81 * plant.time_step
    assert abs(velocities[-1]) < 1e-3


@pytest.mark.once
@pytest.mark.parametrize(
    ("parameters", "speeds", "accelerations"),
    [(BMW, (16.0, 30.0), (4.0, 8.0)), (F1TENTH, (2.5, 4.0), (2.0, 5.0, 7.0))],
    ids=["multi-body", "drift"],
)
def test_steady_states_are_those_of_the_vehicle_identified_on_it(
    models, parameters, speeds, accelerations
):
    vehicle = load_vehicle(parameters.vehicle.name.lower())
    assert vehicle == parameters.vehicle
    for speed in speeds:
        plant, angle = car(parameters, speed), 0.0
        for wanted in accelerations:
            begin, angle = angle, math.atan(vehicle.l_wb * wanted / speed**2)
            size = max(vehicle.l_wb, 0.5)
            for step in range(round(2500 * math.sqrt(size))):
                delta = min(begin + (angle - begin) * step / 700, angle)
                # Hold the speed: otherwise the tires' drag would slow the car.
                state = plant.state
                command = speed + 20.0 * parameters.drive_time_constant_s * (speed - state.v_x)
                plant.advance(delta, command)
            reached = plant.state.v_x * plant.state.r
            expected = steady_acceleration(vehicle, plant.state.v_x, plant.steering_angle)
            assert expected == pytest.approx(reached, rel=0.03), (speed, wanted)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ("dynamics: rocket\n", "dynamics: expected multi_body or drift, got 'rocket'"),
        ("parameters: bmw\n", "parameters: expected ford_escort, bmw_320i, vw_vanagon or a map"),
        ("integration_steps: 0\n", "integration_steps: expected"),
    ],
)
def test_a_plant_file_is_refused_by_name(tmp_path, changes, message):
    path = tmp_path / "plant.yaml"
    path.write_text("model: commonroad\nvehicle: bmw_320i\n" + changes)
    with pytest.raises(ParameterError, match=message):
        load_plant(path)


def test_parameters_that_do_not_fit_are_named(models):
    given = F1TENTH.parameters
    for changed, message in (
        ({**given, "wings": 2}, "parameters.wings: unknown"),
        ({key: value for key, value in given.items() if key != "R_w"}, "parameters.R_w: missing"),
        ({**given, "tire": 3}, "parameters.tire: expected a mapping"),
        ({**given, "m": "heavy"}, "parameters.m: expected a finite number"),
        ({**given, "m": 4.0}, "vehicle: expected the plant's m, 4, got 3.47 in F1TENTH_drift"),
    ):
        with pytest.raises(ParameterError, match=message):
            CommonRoadCar(replace(F1TENTH, parameters=changed))
