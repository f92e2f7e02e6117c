"""The model driven by recorded commands, compared with the car's equations in small steps."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

from map_racing.identification.channels import SensorSetup
from map_racing.identification.laps import car_of
from map_racing.identification.output_error import NAMES, at_sensors, simulate
from map_racing.vehicle.parameters import linearized, load_vehicle
from map_racing.vehicle.single_track import single_track_derivatives

NUC4 = load_vehicle("nuc4")
STEP, STEPS, FINE = 0.005, 160, 10
SETS = (
    {"delay": 0.05, "share": 0.6},
    {"delay": 0.03, "share": 0.9, "front": -0.3, "rear": 0.2, "grip": -0.1, "height": 0.05},
    {"delay": 0.02, "share": 0.3, "gain": 0.1, "offset": 0.02, "inertia": 0.4, "shape": -0.2},
    {"share": 0.5, "bend": -0.5},
)


def motion(column, t):
    """Speed and acceleration."""
    if column == 0:
        return 4.0 + 1.5 * np.sin(2.0 * t), 3.0 * np.cos(2.0 * t)
    return 6.0 - 5.0 * t + 2.0 * t * t, -5.0 + 4.0 * t


def windows():
    """Two windows, one accelerating and one braking, each with its own commands."""
    t = STEP * np.arange(STEPS + 1)
    v_x, a_long = (np.stack([motion(column, t)[i] for column in (0, 1)], axis=1) for i in (0, 1))
    middle = t[:-1] + 0.5 * STEP

    def commands(kind, delay):
        assert kind == "steering"
        at = middle[:, None] - delay
        # The second has commands that the servo cannot follow, and beyond the lock.
        turn = np.where(at > 0.4, np.where(at > 0.6, -0.6, 0.6), 0.1)
        return np.stack((0.12 * np.sin(9.0 * at), turn), axis=2)

    return SimpleNamespace(
        step=STEP, steps=STEPS, v_x=v_x, a_long=a_long, r_0=np.array([0.3, -0.2]), commands=commands
    )


def wheels(vehicle, parameters, command):
    """Wheel angle in fine steps under the commands of one window."""
    lag = max(parameters["delay"] * parameters["share"], 1e-6)
    gain, slew = math.exp(parameters["gain"]), vehicle.delta_rate_max * STEP
    wanted = gain * np.clip(command, -vehicle.delta_max, vehicle.delta_max) + parameters["offset"]
    angle, found = wanted[0], [wanted[0]]
    for target in wanted:
        move = (target - angle) * -math.expm1(-STEP / lag)
        share = np.arange(1, FINE + 1) / FINE
        if abs(move) > slew:  # at full rate
            path = angle + math.copysign(slew, move) * share
        else:
            path = target + (angle - target) * np.exp(-share * STEP / lag)
        found += path.tolist()
        angle = path[-1]
    return found


def integrated(vehicle, parameters, given, column):
    """Yaw rate, lateral velocity and acceleration at each step of a window, integrated in small
    steps."""
    car = car_of(vehicle, parameters)
    car = dataclasses.replace(
        car,
        I_z=car.I_z * math.exp(parameters["inertia"]),
        h_cg=car.h_cg + parameters["height"],
    )
    delay = np.array([parameters["delay"] * (1.0 - parameters["share"])])
    delta = wheels(car, parameters, given.commands("steering", delay)[:, 0, column])
    derivatives = single_track_derivatives(car, 1e-3)
    r, h = float(given.r_0[column]), STEP / FINE
    v_y, rows = car.l_r * r, []
    for k in range(STEPS * FINE + 1):
        v_x, a_long = motion(column, k * h)
        slope = derivatives(v_x, v_y, r, delta[k], a_long)
        if k % FINE == 0:
            rows.append((r, v_y, slope[0] + v_x * r))
        if k < STEPS * FINE:
            middle = v_y + 0.5 * h * slope[0], r + 0.5 * h * slope[1]
            mean = 0.5 * (delta[k] + delta[k + 1])
            v_x, a_long = motion(column, (k + 0.5) * h)
            slope = derivatives(v_x, *middle, mean, a_long)
            v_y, r = v_y + h * slope[0], r + h * slope[1]
    return np.array(rows).T


@pytest.mark.parametrize("vehicle", [NUC4, linearized(NUC4)], ids=["pacejka", "linear"])
def test_it_drives_as_the_equations_say(vehicle):
    sets = [{**dict.fromkeys(NAMES, 0.0), **changes} for changes in SETS]
    given, theta = windows(), np.array([[values[name] for name in NAMES] for values in sets])
    found = simulate(vehicle, given, theta)
    for i, parameters in enumerate(sets):
        for column in range(2):
            exact = integrated(vehicle, parameters, given, column)
            for name, expected in zip(("r", "v_y", "a_y"), exact):
                error = np.max(np.abs(found[name][:, i, column] - expected)) / np.ptp(expected)
                assert error < (0.01 if name == "a_y" else 0.0015), (i, column, name)


def test_sensors_away_from_the_center_of_gravity_measure_the_motion_of_their_place():
    r = (0.3 + 0.8 * STEP * np.arange(STEPS + 1))[:, None, None]
    setup = SensorSetup(pose_x_m=0.1, imu_x_m=NUC4.l_r + 0.2, imu_y_m=-0.1)
    given = SimpleNamespace(step=STEP, drives=[SimpleNamespace(setup=setup)], drive=np.array([0]))
    found = at_sensors(NUC4, given, {"r": r, "v_y": 0.0 * r, "a_y": 0.0 * r})
    np.testing.assert_allclose(found["a_y"], 0.8 * 0.2 + 0.1 * r**2, rtol=1e-9)
    np.testing.assert_allclose(found["v_y"], (0.1 - NUC4.l_r) * r, rtol=1e-9)
    assert found["r"] is r
