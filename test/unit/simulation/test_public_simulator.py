"""The public simulator's plant, compared with its published figures and the equations of its
model."""

import dataclasses
import math

import numpy as np
import pytest

from map_racing.bags.reader import read_recording
from map_racing.simulation.public_simulator import PublicSimulator, PublicSimulatorParameters
from map_racing.vehicle.parameters import load_vehicle

SIM = load_vehicle("sim")
# interfaces of the public simulator
L_WB, L_R, L_F, M, I_Z, C_SF, C_SR = 0.3302, 0.17145, 0.15875, 3.47, 0.04712, 4.718, 5.4562
H_CG = 0.074


def simulator(speed=0.0, steering=0.0):
    plant = PublicSimulator(PublicSimulatorParameters(SIM))
    plant.reset(0.0, 0.0, 0.0, speed)
    plant.steering_angle = steering
    return plant


def advance(plant, steering, speed, steps):
    """Records of (steering angle, speed) after each step."""
    records = []
    for _ in range(steps):
        plant.advance(steering, speed)
        records.append((plant.steering_angle, plant.speed))
    return np.array(records)


def test_figures_are_the_published_ones():
    assert SIM.l_wb == pytest.approx(L_WB)
    assert (SIM.l_r, SIM.l_f, SIM.m, SIM.I_z) == (L_R, L_F, M, I_Z)
    assert (SIM.front.C_S, SIM.rear.C_S) == (C_SF, C_SR)
    assert (SIM.delta_max, SIM.delta_rate_max) == (0.4189, 3.2)
    assert (SIM.a_max, SIM.a_brake_max, SIM.v_max) == (7.51, 8.26, 7.0)
    assert PublicSimulator.time_step == 0.01


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_steering_acts_after_five_samples_at_the_servos_rate_up_to_the_lock(side):
    angles = side * advance(simulator(2.0), side * 1.0, 3.0, 25)[:, 0]
    assert np.all(angles[:5] == 0.0)
    expected = np.minimum(0.032 * np.arange(1, 21), 0.4189)
    np.testing.assert_allclose(angles[5:], expected, rtol=0.0, atol=1e-12)


def test_each_steering_command_has_its_turn():
    plant = simulator(2.0)
    for command in (0.1, -0.1, 0.1, -0.1, 0.1):
        plant.advance(command, 2.0)
    assert plant.steering_angle == 0.0
    moves = np.diff(np.r_[0.0, advance(plant, 0.0, 2.0, 5)[:, 0]])
    np.testing.assert_allclose(moves, [0.032, -0.032, 0.032, -0.032, 0.032], atol=1e-12)


def test_the_servo_is_bang_bang_with_a_tiny_dead_band():
    """It oscillates about its target by one step of 32 mrad, and ignores 0.1 mrad."""
    angles = advance(simulator(2.0), 0.1, 2.0, 60)[10:, 0]
    assert np.max(np.abs(angles - 0.1)) <= 0.032 + 1e-12
    assert set(np.round(np.abs(np.diff(angles)), 9)) == {0.032}
    still = simulator(2.0)
    assert np.all(advance(still, 0.9e-4, 2.0, 20)[:, 0] == 0.0)
    assert np.any(advance(still, 1.1e-4, 2.0, 20)[:, 0] != 0.0)


@pytest.mark.parametrize(
    "speed, target, acceleration",
    [
        (2.0, 3.0, 2.0 * 7.51 / 7.0),  # proportional
        (2.0, 5.4, 2.0 * 7.51 / 7.0 * 3.4),
        (2.0, 5.6, 7.51),  # up to the limit, reached at half of the largest speed
        (2.0, 9.0, 7.51),
        (0.0, 7.0, 7.51),
        (5.0, 4.999, -8.26),  # full braking for any excess speed
        (5.0, 5.0, -8.26),
        (5.0, 0.0, -8.26),
    ],
)
def test_acceleration_law(speed, target, acceleration):
    plant = simulator(speed)
    plant.advance(0.0, target)
    assert plant.acceleration[0] == pytest.approx(acceleration)
    assert plant.speed == pytest.approx(speed + 0.01 * acceleration)


def test_speed_stays_within_the_simulators_own():
    assert advance(simulator(6.5), 0.0, 20.0, 100)[-1, 1] == 7.0


def test_a_standing_car_stays_and_one_that_stops_comes_to_rest():
    plant = simulator()
    advance(plant, 0.3, 0.0, 200)
    assert (plant.x, plant.y, plant.psi, plant.speed) == (0.0, 0.0, 0.0, 0.0)
    speeds = advance(simulator(3.0), 0.2, 0.0, 1000)[:, 1]
    assert speeds.min() >= -8.26 * 0.01
    assert abs(speeds[-1]) < 1e-3


def test_straight_ahead_is_euler_integration():
    plant = simulator(3.0)
    speeds = np.r_[3.0, advance(plant, 0.0, 6.0, 100)[:, 1]]
    assert plant.x == pytest.approx(0.01 * speeds[:-1].sum(), rel=1e-12)
    assert (plant.y, plant.psi, plant.slip_angle, plant.yaw_rate) == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("v, delta", [(2.0, 0.2), (4.0, 0.1), (6.0, -0.06)])
def test_a_held_wheel_settles_on_the_circle_of_the_linear_single_track_model(v, delta):
    """Understeer gradient: each axle carries its share of m v r."""
    plant = simulator(v, delta)
    for _ in range(10):  # fill the delay line, then hold the angle
        plant.advance(delta, v + 1e-9)
    plant.steering_angle = delta
    for _ in range(1500):
        plant.advance(delta, v + 1e-9)
    v = plant.speed
    g = 9.81
    # a = v r; front and rear slip angle are a / (g C_Sf) and a / (g C_Sr)
    a = delta / (L_WB / v**2 + (1.0 / C_SF - 1.0 / C_SR) / g)
    r = a / v
    beta = L_R * r / v - a / (g * C_SR)
    assert plant.acceleration[0] == pytest.approx(0.0, abs=1e-6)
    assert plant.yaw_rate == pytest.approx(r, rel=1e-9)
    assert plant.slip_angle == pytest.approx(beta, rel=1e-8)
    assert plant.acceleration[1] == pytest.approx(a, rel=1e-8)
    state = plant.reference_state()
    assert math.hypot(state.v_x, state.v_y) == pytest.approx(v)
    assert state.v_y / state.v_x == pytest.approx(math.tan(beta))


@pytest.mark.parametrize("target", [5.0, 3.0])
def test_one_step_of_the_dynamic_model_is_the_published_one(target):
    """CommonRoad's single-track model as printed: load transfer shifts grip between the axles."""
    car = dataclasses.replace(SIM, mu=1.0489)
    plant = PublicSimulator(PublicSimulatorParameters(car))
    plant.reset(0.0, 0.0, 0.0, 4.0)
    plant.steering_angle, plant.slip_angle, plant.yaw_rate = 0.1, -0.03, 0.8
    v, delta, beta, r = plant.speed, plant.steering_angle, plant.slip_angle, plant.yaw_rate
    plant.advance(0.0, target)
    a, g = plant.acceleration[0], 9.81
    assert abs(a) > 1.0
    front = C_SF * (g * L_R - a * H_CG)
    rear = C_SR * (g * L_F + a * H_CG)
    mu, wheelbase = car.mu, L_R + L_F
    beta_dot = (
        (mu / (v**2 * wheelbase) * (rear * L_R - front * L_F) - 1.0) * r
        - mu / (v * wheelbase) * (rear + front) * beta
        + mu / (v * wheelbase) * front * delta
    )
    r_dot = (
        mu
        * M
        / (I_Z * wheelbase)
        * (
            front * L_F * delta
            + (rear * L_R - front * L_F) * beta
            - (front * L_F**2 + rear * L_R**2) * r / v
        )
    )
    assert (plant.slip_angle - beta) / 0.01 == pytest.approx(beta_dot, rel=1e-9)
    assert (plant.yaw_rate - r) / 0.01 == pytest.approx(r_dot, rel=1e-9)
    assert plant.acceleration[1] == pytest.approx(v * (r + beta_dot), rel=1e-9)
    assert plant.psi == pytest.approx(0.01 * r)
    assert plant.y == pytest.approx(0.01 * v * math.sin(beta))


def test_one_step_of_the_rolling_model_keeps_its_angles():
    """tan(beta) = l_r / l_wb tan(delta) and r = v cos(beta) tan(delta) / l_wb, differentiated."""
    plant = simulator()
    for _ in range(5):  # fills the delay line
        plant.advance(0.4, 0.0)
    plant.speed, plant.steering_angle = 0.4, 0.2
    plant.slip_angle = math.atan(L_R / L_WB * math.tan(0.2))
    r = plant.yaw_rate = 0.4 * math.cos(plant.slip_angle) * math.tan(0.2) / L_WB
    beta = plant.slip_angle
    plant.advance(0.4, 0.6)
    a, h = plant.acceleration[0], 1e-6
    assert a > 0.3 and plant.steering_angle == pytest.approx(0.232)

    def rolling(time):
        delta = 0.2 + 3.2 * time
        slip = math.atan(L_R / L_WB * math.tan(delta))
        return slip, (0.4 + a * time) * math.cos(slip) * math.tan(delta) / L_WB

    slopes = [(ahead - behind) / (2.0 * h) for ahead, behind in zip(rolling(h), rolling(-h))]
    assert (plant.slip_angle - beta) / 0.01 == pytest.approx(slopes[0], rel=1e-6)
    assert (plant.yaw_rate - r) / 0.01 == pytest.approx(slopes[1], rel=1e-6)


# Step, then x, y, psi, speed, steering angle, yaw rate and slip angle, computed by the code of the
# public simulator for the commands below, with steps of 10 ms.
ITS_OWN = """
50 0.8929560231297 0.091210434441606272 0.19095288657447315 3.5357114393796047 0.128 \
    0.78054025626717072 0.0051257020099572236
400 13.272686727891294 2.9608931309106614 0.36602460971760059 0.16855555222069854 0.096 \
    -0.056894501995647842 0.037720592893380422
1000 27.132810200240453 11.275335668696373 0.92263841934369284 3.5843605490972448 -0.064 \
    -0.64969919765021111 0.00181210653155467
1500 32.105248341524479 25.818380343375491 1.5527668886019679 4.3200319818585804 -0.096 \
    -0.71305813087911118 0.020325827144902529
"""


def test_it_moves_as_the_simulators_own_code():
    """From standstill through both models, with driving, braking and steering both ways."""
    plant, expected = simulator(), [line.split() for line in ITS_OWN.strip().splitlines()]
    expected = {int(step): np.array(state, float) for step, *state in expected}
    for k in range(1, max(expected) + 1):
        plant.advance(0.12 * math.sin(0.05 * (k - 1)), 4.0 + 3.9 * math.sin(0.013 * (k - 1)))
        if k in expected:
            pose = plant.x, plant.y, plant.psi
            rest = plant.speed, plant.steering_angle, plant.yaw_rate, plant.slip_angle
            np.testing.assert_allclose(pose + rest, expected[k], rtol=0.0, atol=1e-10)


def test_the_recorded_simulator_is_this_one(shared_data):
    """Axle forces from recorded motion: rear tires, load transfer and servo match exactly.

    Poses and rates of the recording have no noise; the length of each step is its travel over its
    speed. The rear tires' slip is known, so their law can be read off; the front tires' law then
    gives the steering angle, which moves at the servo's rate or not at all.
    """
    driven = read_recording(shared_data / "recordings" / "hangar_map_12laps.bag")
    v, r, psi = driven.v_x, driven.yaw_rate, np.unwrap(driven.psi)
    d_x, d_y = np.diff(driven.x), np.diff(driven.y)
    slow = v < 2.0
    step = np.hypot(d_x, d_y) / np.where(slow, 1.0, v)[:-1]
    beta = np.arctan2(d_y, d_x) - psi[:-1]
    beta -= 2.0 * math.pi * np.round(beta / (2.0 * math.pi))
    n = beta.size - 1
    dt, beta_dot = step[:n], np.diff(beta) / step[:n]
    r_dot, a = np.diff(r)[:n] / dt, np.diff(v)[:n] / dt
    v, r, beta = v[:n], r[:n], beta[:n]
    both, turn = v * (beta_dot + r), I_Z / M * r_dot
    rear, slip_r = (L_F * both - turn) / L_WB, L_R * r / v - beta
    known = ~slow[:n] & (np.abs(slip_r) > 0.05)
    # rear / slip_r = C_SR (g l_f + a h) / l_wb: linear in a
    stiffness = rear[known] / slip_r[known]
    slope, constant = np.polyfit(a[known], stiffness, 1)
    assert np.ptp(a[known]) > 10.0
    assert constant * L_WB / (9.81 * L_F) == pytest.approx(SIM.mu * C_SR, rel=1e-9)
    assert slope * L_WB / (SIM.mu * C_SR) == pytest.approx(H_CG, rel=1e-9)
    front = C_SF * SIM.mu * (9.81 * L_R - a * H_CG) / L_WB
    delta = (L_R * both + turn) / L_WB / front + beta + L_F * r / v
    rate = np.abs(np.diff(delta) / dt[:-1])[known[:-1] & known[1:]]
    servo = np.minimum(rate, np.abs(rate - SIM.delta_rate_max)) < 1e-6
    assert np.mean(servo) > 0.99
    assert np.min(a) == pytest.approx(-SIM.a_brake_max, rel=1e-9)


def test_walking_speed_is_pure_rolling():
    """Below 0.5 m/s: psi' = v tan(delta) / l_wb, without slip."""
    plant = simulator(0.3, 0.2)
    before = plant.psi
    plant.advance(0.2, 0.3 + 1e-9)
    assert (plant.psi - before) / 0.01 == pytest.approx(0.3 * math.tan(0.2) / L_WB)


def test_the_models_change_with_hysteresis():
    plant = simulator(0.52)
    assert not plant._is_dynamic(0.52)
    assert plant._is_dynamic(0.54)
    assert plant._is_dynamic(0.51)
    assert not plant._is_dynamic(0.49)
    assert not plant._is_dynamic(0.52)


def test_from_standstill_into_a_bend_and_back_nothing_blows_up():
    plant = simulator()
    states = []
    for k in range(4000):
        plant.advance(0.3 * math.sin(0.02 * k), 3.3 + 3.2 * math.sin(0.007 * k))
        states.append(plant.reference_state())
    states = np.array(states)
    assert np.all(np.isfinite(states))
    assert np.max(np.abs(states[:, 6])) < 12.0
    assert states[:, 4].min() > -0.1 and states[:, 4].max() > 5.0


def test_a_mirrored_drive_is_the_mirror_image():
    left, right = simulator(), simulator()
    for k in range(2000):
        steering, speed = 0.3 * math.sin(0.02 * k), 3.0 + 2.5 * math.sin(0.007 * k)
        left.advance(steering, speed)
        right.advance(-steering, speed)
        t, x, y, psi, v_x, v_y, r = left.reference_state()
        assert right.reference_state() == (t, x, -y, -psi, v_x, -v_y, -r)


def test_it_publishes_speed_along_the_heading_and_no_lateral_velocity():
    plant = simulator(4.0)
    advance(plant, 0.15, 4.0, 100)
    true, measured = plant.reference_state(), plant.measured_state()
    assert true.v_y != 0.0
    assert math.isnan(measured.v_y)
    assert measured.v_x == plant.speed > true.v_x
    assert measured[:4] + measured[6:] == true[:4] + true[6:]
    assert true.t == pytest.approx(1.0)
