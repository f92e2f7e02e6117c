"""Controller and supervisor together."""

import math

import numpy as np
import pytest

from map_racing.control.controller import build_controller
from map_racing.control.parameters import load_controller_parameters
from map_racing.control.safety import Mode, Reason, SafetyLimits
from map_racing.control.state import CarState
from map_racing.control.supervised import SupervisedController, build_supervisor
from map_racing.track.raceline import Raceline
from map_racing.vehicle.parameters import load_vehicle

PERIOD = 1 / 40
RADIUS = 6.0


def circle(direction=1.0):
    angle = direction * 2.0 * np.pi * np.arange(100) / 100
    return Raceline(RADIUS * np.cos(angle), RADIUS * np.sin(angle), vx_mps=np.full(100, 4.0))


class Drive:
    """Round the circle counter-clockwise at the commanded speed, which is reached at once."""

    def __init__(self):
        parameters = load_controller_parameters("map").with_(speed_scale=1.0)
        controller = build_controller(parameters, load_vehicle("nuc4"), circle())
        self.told = []
        self.driver = SupervisedController(
            controller,
            build_supervisor(controller, SafetyLimits()),
            lambda: self.told.append(self.now),
        )
        self.now, self.angle, self.speed = 100.0, 0.0, 4.0

    def step(self):
        x, y = RADIUS * math.cos(self.angle), RADIUS * math.sin(self.angle)
        heading = self.angle + 0.5 * math.pi
        turn = self.speed / RADIUS
        state = CarState(self.now, x, y, heading, self.speed, 0.0, turn)
        step = self.driver.step(self.now, state)
        self.now += PERIOD
        self.angle += turn * PERIOD
        self.speed = step.decision.speed
        return step

    def drive(self, seconds):
        return [self.step() for _ in range(round(seconds / PERIOD))]

    def follow(self, raceline):
        setup = self.driver.controller.prepare(raceline=raceline, sectors=None)
        return self.driver.follow(raceline, None, setup)


def test_a_raceline_the_same_way_round_is_driven_at_once():
    drive = Drive()
    drive.drive(1.0)
    other = circle()
    assert drive.follow(other)
    assert drive.driver.controller.raceline is other
    assert drive.step().decision[:2] == (Mode.DRIVING, Reason.NONE)
    assert drive.told == []


def test_a_raceline_against_the_motion_waits_until_the_car_stands():
    drive = Drive()
    drive.drive(1.0)
    old, other = drive.driver.controller.raceline, circle(-1.0)
    assert not drive.follow(other)
    steps = drive.drive(3.0)
    stopped = next(k for k, step in enumerate(steps) if step.decision.mode is Mode.STOPPED)
    assert {step.decision.reason for step in steps[:stopped]} == {Reason.OPPOSED_RACELINE}
    # Along the old one, within the stopping distance of 2 m.
    assert all(abs(step.result.d) < 0.05 for step in steps[:stopped])
    assert 0.9 <= stopped * PERIOD <= 1.2
    assert len(drive.told) == 1 and drive.driver.controller.raceline is other is not old
    # It then turns around, at walking pace.
    assert steps[-1].decision.mode is Mode.DRIVING
    assert max(step.decision.speed for step in steps[stopped:]) <= 1.0


def test_the_last_of_two_racelines_counts():
    drive = Drive()
    drive.drive(1.0)
    assert not drive.follow(circle(-1.0))
    drive.drive(0.2)
    other = circle()
    assert drive.follow(other)
    assert drive.drive(2.0)[-1].decision.mode is Mode.DRIVING
    assert drive.driver.controller.raceline is other


def test_a_car_that_stands_takes_any():
    drive = Drive()
    drive.driver.supervisor.request_stop("service")
    drive.speed = 0.0
    drive.drive(0.2)
    assert drive.follow(circle(-1.0))


def test_live_tuning_meanwhile_is_kept():
    drive = Drive()
    drive.drive(1.0)
    controller = drive.driver.controller
    drive.follow(circle(-1.0))
    controller.parameters = controller.parameters.with_(speed_scale=0.3)
    drive.drive(3.0)
    assert controller.parameters.speed_scale == pytest.approx(0.3)
