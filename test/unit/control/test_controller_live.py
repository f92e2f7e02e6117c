import math

import pytest

from map_racing.control.controller import build_controller
from map_racing.control.parameters import load_controller_parameters
from map_racing.control.state import CarState
from map_racing.control.steering import AckermannSteering
from map_racing.track.files.load import load_raceline
from map_racing.vehicle.parameters import load_vehicle


@pytest.fixture(scope="module")
def raceline():
    return load_raceline("reference")


@pytest.fixture
def controller(raceline):
    return build_controller(load_controller_parameters("map"), load_vehicle("nuc4"), raceline)


def beside(raceline, s, d, t=0.0, speed=4.0):
    point = raceline.pose(s)
    x, y = point.x - d * math.sin(point.psi), point.y + d * math.cos(point.psi)
    return CarState(t, x, y, point.psi, speed, 0.0, speed * point.kappa)


@pytest.mark.parametrize("s", [0.05, 7.0, 21.0])
def test_lateral_error_is_that_of_the_measured_pose(controller, raceline, s):
    state = beside(raceline, s, 0.12)
    state = state._replace(psi=state.psi + 0.1)
    result = controller.step(state)
    assert result.d > 0.13  # of the predicted pose
    assert controller.lateral_error(state, result) == pytest.approx(0.12, abs=1e-9)


def test_no_lateral_error_without_raceline(raceline):
    controller = build_controller(load_controller_parameters("map"), load_vehicle("nuc4"))
    state = beside(raceline, 1.0, 0.0)
    assert math.isnan(controller.lateral_error(state, controller.step(state)))


def test_the_same_raceline_again_changes_no_command(raceline):
    """Replacing the raceline while driving restarts neither steering nor its rate limit."""
    commands = []
    for replace in (False, True):
        controller = build_controller(
            load_controller_parameters("map"), load_vehicle("nuc4"), raceline
        )
        for k in range(20):
            if replace and k == 10:
                controller.change(raceline=load_raceline("reference"))
            last = controller.step(beside(raceline, 2.0 + 0.1 * k, 0.1, 0.025 * k))
        commands.append((last.steering_angle, last.speed))
    assert abs(last.steering_angle) < 0.4
    assert commands[0] == pytest.approx(commands[1], abs=1e-12)


def test_a_new_raceline_steers_at_the_rate_of_the_servo(controller, raceline):
    for k in range(20):
        before = controller.step(beside(raceline, 2.0 + 0.1 * k, 0.0, 0.025 * k))
    controller.change(raceline=raceline.reversed())
    after = controller.step(beside(raceline, 4.0, 0.0, 0.5))
    limit = load_vehicle("nuc4").delta_rate_max * 0.025
    assert abs(after.steering_angle - before.steering_angle) <= limit * (1.0 + 1e-9)


def test_lateral_acceleration_at_the_lock():
    steering = AckermannSteering(0.33, 0.4)
    limit = steering.max_lateral_acceleration(3.0)
    assert steering.steering(3.0, 0.999 * limit)[1] is False
    assert steering.steering(3.0, 1.001 * limit) == (0.4, True)
