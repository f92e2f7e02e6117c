"""The plant: exact integration, actuators in closed form, symmetry, a reproducible localization."""

import dataclasses
import math

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp

from map_racing.control.state import CarState, moved
from map_racing.errors import ParameterError
from map_racing.simulation.plant import (
    Localization,
    Plant,
    PlantParameters,
)
from map_racing.simulation.plants import build_plant, load_plant
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.single_track import single_track_derivatives
from map_racing.vehicle.steady_state import steady_state_table

CARS = ["nuc4", "sim"]
NUMBERS = [
    field.name
    for field in dataclasses.fields(PlantParameters)
    if field.name not in ("vehicle", "measures_v_y", "grip_changes")
]


def drive(plant, steering, speed, duration):
    """Advance under constant commands; return the history of states at the center of gravity."""
    history = []
    for _ in range(int(round(duration / plant.time_step))):
        plant.advance(steering, speed)
        history.append(plant.state)
    return history


# -- integration -------------------------------------------------------------------------------


def turning_in(vehicle, duration, steering=0.3, brake=-2.0, speed=6.0):
    """Exact state after turning the wheels at the servo's rate while braking evenly."""
    derivatives = single_track_derivatives(vehicle)

    def right_hand_side(t, state):
        _, _, psi, v_x, v_y, r = state
        delta = min(vehicle.delta_rate_max * t, steering)
        v_y_dot, r_dot = derivatives(v_x, v_y, r, delta, brake)
        cosine, sine = math.cos(psi), math.sin(psi)
        return [v_x * cosine - v_y * sine, v_x * sine + v_y * cosine, r, brake, v_y_dot, r_dot]

    solution = solve_ivp(
        right_hand_side,
        (0.0, duration),
        [1.0 + vehicle.l_r * math.cos(0.4), 2.0 + vehicle.l_r * math.sin(0.4), 0.4, speed, 0, 0],
        method="LSODA",
        rtol=1e-12,
        atol=1e-13,
    )
    return solution.y[:, -1]


def turned_in(car, step, duration, speed=6.0):
    plant = Plant(PlantParameters(vehicle=car, a_brake_max_mps2=2.0))
    plant.time_step = step
    plant.reset(1.0, 2.0, 0.4, speed)
    return np.array(drive(plant, 0.3, 0.0, duration)[-1][1:])


@pytest.mark.parametrize("car", CARS)
def test_integration_agrees_with_scipy(car):
    """During turn-in: within 1e-6 m and rad at the plant's own step of 2 ms."""
    vehicle = load_vehicle(car)
    expected = turning_in(vehicle, 0.09)
    assert turned_in(car, Plant.time_step, 0.09)[:3] == pytest.approx(expected[:3], abs=1e-6)
    assert turned_in(car, Plant.time_step, 0.09) == pytest.approx(expected, abs=1e-5)
    assert turned_in(car, 0.0005, 0.09) == pytest.approx(expected, abs=3e-8)


@pytest.mark.parametrize("car", CARS)
def test_integration_is_of_fourth_order(car):
    expected = turning_in(load_vehicle(car), 0.08)
    coarse, fine = (
        np.linalg.norm(turned_in(car, step, 0.08) - expected) for step in (0.001, 0.0005)
    )
    assert 12.0 < coarse / fine < 24.0


@pytest.mark.parametrize("car", CARS)
@pytest.mark.parametrize("v, delta", [(1.5, 0.3), (3.0, 0.15), (5.0, 0.08), (8.0, -0.05)])
def test_a_held_wheel_settles_on_the_circle_of_the_table(car, v, delta):
    plant = Plant(PlantParameters(vehicle=car))
    vehicle = dataclasses.replace(plant.vehicle, v_max=20.0)
    plant.vehicle = vehicle
    table = steady_state_table(vehicle, [v], [0.0, abs(delta)])
    expected = math.copysign(table.a_lat[1, 0], delta)
    plant.reset(0.0, 0.0, 0.0, v)
    drive(plant, delta, v, 4.0)
    assert plant.state.v_x == v
    assert v * plant.state.r == pytest.approx(expected, abs=1e-6)
    assert plant.acceleration == pytest.approx((0.0, expected), abs=1e-6)
    # a full circle ends at the start
    turn = 2.0 * math.pi / abs(plant.state.r)
    before = plant.state
    steps = turn / plant.time_step
    drive(plant, delta, v, math.floor(steps) * plant.time_step)
    speed = math.hypot(before.v_x, before.v_y)
    left = math.hypot(plant.state.x - before.x, plant.state.y - before.y)
    assert left == pytest.approx((steps - math.floor(steps)) * plant.time_step * speed, abs=1e-6)


@pytest.mark.parametrize("car", CARS)
@pytest.mark.parametrize("delta", [0.4189, -0.2])
def test_a_standing_car_stays_where_it_is_whatever_its_wheels_do(car, delta):
    plant = Plant(PlantParameters(vehicle=car))
    plant.reset(1.0, 2.0, 0.3)
    before = plant.state
    drive(plant, delta, 0.0, 2.0)
    assert plant.steering_angle == pytest.approx(delta)
    assert plant.state[1:] == before[1:]
    assert plant.state.t == pytest.approx(2.0)
    assert plant.acceleration == (0.0, 0.0)


@pytest.mark.parametrize("car", CARS)
def test_a_mirrored_race_is_the_mirror_image(car):
    left, right = (Plant(PlantParameters(vehicle=car, mu_scale=0.9)) for _ in range(2))
    left.reset(0.0, 0.5, 0.2)
    right.reset(0.0, -0.5, -0.2)
    for k in range(3000):
        steering, speed = 0.3 * math.sin(0.004 * k), 4.0 + 3.0 * math.sin(0.003 * k)
        left.advance(steering, speed)
        right.advance(-steering, speed)
        t, x, y, psi, v_x, v_y, r = left.state
        assert right.state == (t, x, -y, -psi, v_x, -v_y, -r)
    assert abs(left.state.y - 0.5) > 1.0


def test_the_reference_point_is_the_rear_axle():
    plant = Plant(PlantParameters(vehicle="nuc4"))
    plant.reset(1.0, 2.0, 0.5, 3.0)
    assert plant.reference_state() == pytest.approx((0.0, 1.0, 2.0, 0.5, 3.0, 0.0, 0.0))
    drive(plant, 0.2, 3.0, 0.5)
    assert moved(plant.reference_state(), plant.vehicle.l_r) == pytest.approx(plant.state)


# -- drive -------------------------------------------------------------------------------------


def test_full_throttle_straight_ahead_is_uniform_acceleration():
    plant = Plant(PlantParameters(vehicle="nuc4", a_max_mps2=5.0))
    plant.reset(0.0, 0.0, 0.0)
    for state in drive(plant, 0.0, 10.0, 1.8):  # 1 m/s below the target, the lag takes over
        assert state.v_x == pytest.approx(5.0 * state.t, abs=1e-9)
        assert state.x - plant.vehicle.l_r == pytest.approx(2.5 * state.t**2, abs=1e-9)
        assert state[2:4] == (0.0, 0.0) and state[5:] == (0.0, 0.0)
    assert plant.acceleration == (5.0, 0.0)


def test_the_last_metre_per_second_fades_in_with_the_time_constant():
    plant = Plant(PlantParameters(vehicle="nuc4", drive_time_constant_s=0.1))
    plant.reset(0.0, 0.0, 0.0, 4.5)
    for state in drive(plant, 0.0, 5.0, 1.0):
        assert 5.0 - state.v_x == pytest.approx(0.5 * math.exp(-10.0 * state.t), abs=0.003)


@pytest.mark.parametrize("time_constant", [0.1, 0.01, 0.002, 1e-6])
def test_brakes_hold_their_limit_and_never_drive_backwards(time_constant):
    plant = Plant(
        PlantParameters(vehicle="nuc4", a_brake_max_mps2=8.0, drive_time_constant_s=time_constant)
    )
    plant.reset(0.0, 0.0, 0.0, 6.0)
    history = drive(plant, 0.0, -3.0, 3.0)
    speeds = np.array([6.0] + [state.v_x for state in history])
    assert np.all(speeds >= 0.0)
    assert speeds[-1] < 1e-9
    decelerations = -np.diff(speeds) / plant.time_step
    assert np.all((decelerations >= -1e-9) & (decelerations <= 8.0 + 1e-9))
    braking = speeds[1:] > 8.0 * (time_constant + plant.time_step)
    assert np.allclose(decelerations[braking], 8.0, rtol=0.0, atol=1e-9)
    distance = history[-1].x - plant.vehicle.l_r
    assert distance == pytest.approx(6.0**2 / 16.0 + 0.5 * 8.0 * time_constant**2, abs=0.01)


def test_speed_ends_at_the_vehicles_own():
    plant = Plant(PlantParameters(vehicle="sim"))
    drive(plant, 0.0, 50.0, 3.0)
    assert plant.state.v_x == pytest.approx(7.0, abs=1e-6)


def test_drive_waits_for_its_dead_time():
    plant = Plant(PlantParameters(vehicle="nuc4", drive_delay_s=0.05))
    plant.reset(0.0, 0.0, 0.0, 2.0)
    speeds = [state.v_x for state in drive(plant, 0.0, 9.0, 0.1)]
    assert speeds[:25] == [2.0] * 25
    assert speeds[25:] == pytest.approx([2.0 + 7.51 * 0.002 * k for k in range(1, 26)])


# -- servo -------------------------------------------------------------------------------------


def angles(parameters, command, duration):
    plant = Plant(parameters)
    plant.reset(0.0, 0.0, 0.0, 1.0)
    found = []
    for _ in range(int(round(duration / plant.time_step))):
        plant.advance(command, 1.0)
        found.append(plant.steering_angle)
    return plant.time_step * np.arange(1, len(found) + 1), np.array(found)


@pytest.mark.parametrize("command", [0.05, -0.05])
def test_servo_lags_exponentially_within_its_rate(command):
    t, found = angles(PlantParameters(vehicle="nuc4", steering_time_constant_s=0.03), command, 0.3)
    np.testing.assert_allclose(found, command * (1.0 - np.exp(-t / 0.03)), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("command, end", [(0.35, 0.35), (-0.35, -0.35), (9.0, 0.4189)])
def test_servo_turns_at_its_rate_up_to_the_lock(command, end):
    t, found = angles(PlantParameters(vehicle="nuc4"), command, 0.2)
    expected = np.sign(command) * np.minimum(3.2 * t, abs(end))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)


def test_lag_and_rate_together_turn_no_faster_than_either():
    """First at the rate limit; once the lag demands less, exponentially."""
    t, found = angles(PlantParameters(vehicle="nuc4", steering_time_constant_s=0.05), 0.4, 0.5)
    switch = 0.4 - 3.2 * 0.05  # the angle at which the remainder is rate times lag
    at = switch / 3.2
    expected = np.where(t <= at, 3.2 * t, 0.4 - 0.16 * np.exp(-(t - at) / 0.05))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=4e-3)
    assert np.max(np.diff(np.r_[0.0, found])) <= 3.2 * Plant.time_step + 1e-12


@pytest.mark.parametrize("delay_ms", [0, 2, 20, 50])
def test_servo_dead_time(delay_ms):
    t, found = angles(PlantParameters(vehicle="nuc4", steering_delay_s=1e-3 * delay_ms), 0.4, 0.1)
    expected = np.clip(3.2 * (t - 1e-3 * delay_ms), 0.0, 0.4)
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=1e-12)


def test_reset_forgets_all_that_happened():
    parameters = load_plant("nuc4")
    plant, fresh = Plant(parameters), Plant(parameters)
    drive(plant, 0.3, 5.0, 1.0)
    for each in (plant, fresh):
        each.reset(1.0, 2.0, 0.3, 2.0)
    assert drive(plant, 0.1, 3.0, 0.5) == drive(fresh, 0.1, 3.0, 0.5)


# -- parameters --------------------------------------------------------------------------------


def test_plant_and_controllers_vehicle_may_differ():
    parameters = PlantParameters(
        vehicle="nuc4",
        mu_scale=0.9,
        front_stiffness_scale=0.8,
        rear_stiffness_scale=0.7,
        a_max_mps2=4.0,
        a_brake_max_mps2=5.0,
    )
    nominal, actual = load_vehicle("nuc4"), parameters.build_vehicle()
    assert actual.mu == pytest.approx(0.9 * nominal.mu)
    assert actual.front.stiffness == pytest.approx(0.8 * nominal.front.stiffness)
    assert actual.rear.stiffness == pytest.approx(0.7 * nominal.rear.stiffness)
    assert actual.front.peak == pytest.approx(nominal.front.peak)
    assert actual.rear.peak == pytest.approx(nominal.rear.peak)
    assert (actual.a_max, actual.a_brake_max) == (4.0, 5.0)
    linear = dataclasses.replace(parameters, vehicle="sim").build_vehicle()
    assert linear.front.stiffness == pytest.approx(0.8 * 4.718)
    assert linear.rear.stiffness == pytest.approx(0.7 * 5.4562)


def refusal(tmp_path, values):
    path = tmp_path / "plant.yaml"
    path.write_text(yaml.safe_dump(values))
    with pytest.raises(ParameterError) as caught:
        load_plant(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and "\n" not in message
    return message


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", [math.nan, math.inf, 10**400, -0.1, "1.0", True, None, [1.0]])
def test_impossible_numbers_are_refused_by_name(tmp_path, name, value):
    assert f": {name}: expected " in refusal(tmp_path, {"vehicle": "nuc4", name: value})


@pytest.mark.parametrize(
    "name, value, expected",
    [
        ("steering_delay_s", 20.0, "expected 0 to 1 s, got 20"),
        ("drive_delay_s", 1.1, "expected 0 to 1 s, got 1.1"),
        ("localization_latency_s", 30.0, "expected 0 to 1 s, got 30"),
        ("localization_rate_hz", 0.5, "expected 1 to 500 Hz"),
        ("localization_rate_hz", 501.0, "expected 1 to 500 Hz"),
        ("a_max_mps2", 1e300, "expected a number of at most"),
        ("steering_time_constant_s", 30.0, "expected 0 to 2 s, got 30"),
        ("drive_time_constant_s", 100.0, "expected more than 0 to 5 s, got 100"),
        ("position_noise_m", 5.0, "expected 0 to 1 m, got 5"),
        ("heading_noise_rad", 1.0, "expected 0 to 0.5 rad, got 1"),
        ("yaw_rate_noise_radps", 3.0, "expected 0 to 2 rad/s, got 3"),
        ("mu_scale", 0.05, "expected 0.1 to 3, got 0.05"),
        ("rear_stiffness_scale", 85.0, "expected 0.1 to 3, got 85"),
    ],
)
def test_values_in_another_unit_are_refused_by_name(tmp_path, name, value, expected):
    """Milliseconds, percent, or more poses than the plant has steps."""
    assert f": {name}: {expected}" in refusal(tmp_path, {"vehicle": "nuc4", name: value})


@pytest.mark.parametrize("name", [name for name in NUMBERS if name.endswith("scale")])
def test_tires_without_grip_are_refused(tmp_path, name):
    assert f"{name}: expected 0.1 to 3, got 0" in refusal(tmp_path, {"vehicle": "nuc4", name: 0})


def test_other_impossible_values_are_refused_by_name(tmp_path):
    assert "missing parameter 'vehicle'" in refusal(tmp_path, {"mu_scale": 1.0})
    assert "unknown parameter mu " in refusal(tmp_path, {"vehicle": "nuc4", "mu": 1.0})
    for value in (1, 0.5, "yes", None):
        message = refusal(tmp_path, {"vehicle": "nuc4", "measures_v_y": value})
        assert "measures_v_y: expected true or false" in message
    for value in (4, None, ["nuc4"], ""):
        assert "vehicle: expected a name or a path" in refusal(tmp_path, {"vehicle": value})
    with pytest.raises(ParameterError, match="nuc5"):
        PlantParameters(vehicle="nuc5").build_vehicle()


@pytest.mark.parametrize("v, error", [(0.5, 0.05), (1.0, 0.05), (2.0, 1e-9), (4.0, 1e-9)])
def test_the_stiffest_tires_are_integrated_stably(v, error):
    """At walking pace their modes are faster than a step of 2 ms resolves."""
    plant = Plant(PlantParameters(vehicle="nuc4", rear_stiffness_scale=3.0))
    plant.reset(0.0, 0.0, 0.0, v)
    drive(plant, 0.2, v, 3.0)
    rates = [state.r for state in drive(plant, 0.2, v, 0.2)]
    assert np.ptp(rates) < 1e-9
    table = steady_state_table(plant.vehicle, [v], [0.0, 0.2])
    assert v * rates[-1] == pytest.approx(table.a_lat[1, 0], rel=error)


def test_the_imu_feels_the_force_of_the_tires_not_only_the_turning():
    plant = Plant(PlantParameters(vehicle="nuc4"))
    plant.reset(0.0, 0.0, 0.0, 5.0)
    drive(plant, 0.2, 5.0, 0.03)
    before, delta = plant.state, plant.steering_angle
    plant.advance(0.2, 5.0)
    v_y_dot, _ = single_track_derivatives(plant.vehicle)(*before[4:], delta, 0.0)
    assert plant.acceleration[1] == pytest.approx(v_y_dot + before.v_x * before.r, rel=1e-12)
    assert abs(v_y_dot) > 1.0


# -- localization ------------------------------------------------------------------------------

NOISY = PlantParameters(
    vehicle="nuc4",
    position_noise_m=0.02,
    heading_noise_rad=0.01,
    velocity_noise_mps=0.1,
    yaw_rate_noise_radps=0.05,
    acceleration_noise_mps2=0.3,
)
TRUE = CarState(1.0, 2.0, -3.0, 0.5, 4.0, -0.2, 1.5)


def test_noise_is_white_and_as_strong_as_said():
    """Bounds of four standard errors; the seed is fixed."""
    n = 20_000
    localization = Localization(NOISY, seed=7)
    errors = np.array([localization.measure(TRUE) for _ in range(n)]) - np.array(TRUE)
    sigma = np.array([0.02, 0.02, 0.01, 0.1, 0.1, 0.05])
    assert np.all(errors[:, 0] == 0.0)
    errors = errors[:, 1:] / sigma
    assert np.all(np.abs(errors.mean(axis=0)) < 4.0 / math.sqrt(n))
    np.testing.assert_allclose(errors.std(axis=0), 1.0, rtol=0.0, atol=4.0 / math.sqrt(2.0 * n))
    correlation = np.corrcoef(errors.T) - np.eye(6)
    assert np.max(np.abs(correlation)) < 5.0 / math.sqrt(n)
    following = np.mean(errors[1:] * errors[:-1], axis=0)
    assert np.max(np.abs(following)) < 5.0 / math.sqrt(n)


def test_noise_of_the_imu():
    localization = Localization(NOISY, seed=3)
    errors = np.array([localization.measure_acceleration((1.0, -5.0)) for _ in range(20_000)])
    errors = (errors - [1.0, -5.0]) / 0.3
    assert np.all(np.abs(errors.mean(axis=0)) < 4.0 / math.sqrt(20_000))
    np.testing.assert_allclose(errors.std(axis=0), 1.0, rtol=0.0, atol=0.02)


def test_without_noise_it_tells_the_truth():
    localization = Localization(PlantParameters(vehicle="nuc4"), seed=1)
    assert localization.measure(TRUE) == TRUE
    assert localization.measure_acceleration((1.0, 2.0)) == (1.0, 2.0)


def test_a_lateral_velocity_that_nothing_measures_is_nan():
    blind = dataclasses.replace(NOISY, measures_v_y=False)
    measured = Localization(blind, seed=1).measure(TRUE)
    assert math.isnan(measured.v_y)
    assert all(math.isfinite(value) for value in measured[:5] + measured[6:])


def test_noise_depends_on_the_seed_alone():
    first, again, other = (Localization(NOISY, seed) for seed in (5, 5, 6))
    series = [[each.measure(TRUE) for _ in range(10)] for each in (first, again, other)]
    assert series[0] == series[1]
    assert series[0][0] != series[2][0]
    with pytest.raises(ParameterError, match="seed: expected 0 or more, got -5"):
        build_plant(NOISY, -5)
