"""Controller and supervisor together."""

import math
from dataclasses import replace

import numpy as np
import pytest

from map_racing.control.controller import ControlResult, Status, build_controller
from map_racing.control.decision import Mode, Reason
from map_racing.control.parameters import load_controller_parameters
from map_racing.control.safety_limits import SafetyLimits
from map_racing.control.state import CarState
from map_racing.control.steering import build_steering_map
from map_racing.control.supervised import (
    SupervisedController,
    build_slowing,
    build_supervisor,
)
from map_racing.errors import ParameterError
from map_racing.track.raceline import Raceline
from map_racing.vehicle.parameters import load_vehicle

PERIOD = 1 / 40
RADIUS = 6.0


def circle(direction=1.0):
    angle = direction * 2.0 * np.pi * np.arange(100) / 100
    return Raceline(RADIUS * np.cos(angle), RADIUS * np.sin(angle), vx_mps=np.full(100, 4.0))


class Drive:
    """Around the circle counter-clockwise at the commanded speed, which is reached instantly."""

    def __init__(self, parameters=None):
        parameters = parameters or load_controller_parameters("map").with_(speed_scale=1.0)
        controller = build_controller(parameters, load_vehicle("nuc4"), circle())
        self.told = []
        self.driver = SupervisedController(
            controller,
            build_supervisor(controller, SafetyLimits()),
            lambda: self.told.append(self.now),
        )
        self.now, self.angle, self.speed = 100.0, 0.0, 4.0

    def step(self, outwards=0.0):
        radius = RADIUS + outwards
        x, y = radius * math.cos(self.angle), radius * math.sin(self.angle)
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
    # It is not new either once the car stands.
    drive.driver.supervisor.request_stop("service")
    assert drive.drive(2.0)[-1].decision.mode is Mode.STOPPED
    assert drive.told == []


def test_a_first_raceline_is_taken_however_the_car_rolls():
    """Pushed across the track while the nodes start."""
    drive = Drive()
    controller = build_controller(drive.driver.controller.parameters, load_vehicle("nuc4"))
    drive.driver = SupervisedController(
        controller, build_supervisor(controller, SafetyLimits()), lambda: None
    )
    assert {step.decision.reason for step in drive.drive(0.5)} == {Reason.NO_RACELINE}
    for _ in range(3):
        drive.speed = 2.0
        drive.step()
    other = circle(-1.0)
    assert drive.driver.supervisor.opposes(other)
    assert drive.follow(other) and controller.raceline is other


def test_a_raceline_against_the_motion_waits_until_the_car_stands():
    drive = Drive()
    drive.drive(1.0)
    old, other = drive.driver.controller.raceline, circle(-1.0)
    assert not drive.follow(other) and drive.driver.controller.raceline is old
    steps = drive.drive(3.0)
    stopped = next(k for k, step in enumerate(steps) if step.decision.mode is Mode.STOPPED)
    assert {step.decision.reason for step in steps[:stopped]} == {Reason.OPPOSED_RACELINE}
    # Along the old raceline, within the stopping distance of 2 m.
    assert all(abs(step.result.d) < 0.05 for step in steps[:stopped])
    assert 0.9 <= stopped * PERIOD <= 1.2
    assert len(drive.told) == 1 and drive.driver.controller.raceline is other is not old
    # It then turns around, at walking pace.
    assert steps[-1].decision.mode is Mode.DRIVING
    assert max(step.decision.speed for step in steps[stopped:]) <= 1.0


def test_a_change_that_is_prepared_meanwhile_loses_no_raceline():
    """The change was prepared for the old raceline: the new one waits until it is applied."""
    drive = Drive()
    drive.drive(1.0)
    driver, other = drive.driver, circle(-1.0)
    assert not drive.follow(other)
    with driver.changing:
        slower = driver.controller.parameters.with_(speed_scale=0.3)
        setup = driver.controller.prepare(parameters=slower)
        assert drive.drive(3.0)[-1].decision[:2] == (Mode.STOPPED, Reason.OPPOSED_RACELINE)
        driver.tune(setup, SafetyLimits())
    assert drive.drive(1.0)[-1].decision.mode is Mode.DRIVING
    assert driver.controller.raceline is other and driver.controller.parameters is slower
    assert not driver.changing.locked() and len(drive.told) == 1


def test_a_waiting_raceline_that_tuning_made_impossible_is_refused():
    drive = Drive()
    drive.drive(1.0)
    driver = drive.driver
    other = circle(-1.0)
    assert not drive.follow(Raceline(other.x, other.y))
    driver.controller.change(parameters=driver.controller.parameters.with_(grip_use=0.0))
    with pytest.raises(ParameterError, match="speeds"):
        drive.drive(3.0)
    assert drive.drive(0.2)[-1].decision[:2] == (Mode.STOPPED, Reason.INVALID_RACELINE)
    assert drive.follow(circle())
    assert drive.drive(1.0)[-1].decision.mode is Mode.DRIVING


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
    controller.change(parameters=controller.parameters.with_(speed_scale=0.3))
    drive.drive(3.0)
    assert controller.parameters.speed_scale == pytest.approx(0.3)


def test_a_clock_that_is_set_back_resets_the_controller(monkeypatch):
    drive, resets = Drive(), []
    monkeypatch.setattr(drive.driver.controller, "reset", lambda: resets.append(drive.now))
    drive.drive(1.0)
    assert resets == []
    drive.now = 50.0
    drive.drive(1.0)
    assert resets == [50.0]
    # Also if the watchdog or a pose in another frame notices first, and listeners are notified.
    drive.driver = SupervisedController(
        drive.driver.controller, drive.driver.supervisor, on_restart=lambda: resets.append("told")
    )
    for notice in (drive.driver.supervisor.watch, drive.driver.supervisor.refuse):
        del resets[:]
        drive.now -= 20.0
        notice(drive.now)
        assert resets == [drive.now, "told"]
        drive.drive(0.5)
        assert len(resets) == 2


def test_a_pose_that_is_not_trusted_does_not_reach_the_controller(monkeypatch):
    drive, steps = Drive(), []
    drive.drive(1.0)
    controller = drive.driver.controller
    step = controller.step
    monkeypatch.setattr(controller, "step", lambda state: steps.append(state) or step(state))
    for age, failed, asked in (
        *((0.0, False, True), (0.0, True, False)),
        *((1.0, False, False), (1.0, True, False)),
    ):
        angle = drive.angle
        x, y, psi = RADIUS * math.cos(angle), RADIUS * math.sin(angle), angle + 0.5 * math.pi
        state = CarState(drive.now - age, x, y, psi, 4.0, 0.0, 4.0 / RADIUS)
        found = drive.driver.step(drive.now, state, failed)
        assert (found.result is not None) is asked is (steps == [state])
        steps.clear()
        drive.now, drive.angle = drive.now + PERIOD, angle + 4.0 / RADIUS * PERIOD


def test_nobody_need_be_told_of_a_raceline_that_waited():
    drive = Drive()
    drive.driver = SupervisedController(drive.driver.controller, drive.driver.supervisor)
    drive.drive(1.0)
    other = circle(-1.0)
    assert not drive.follow(other)
    drive.drive(3.0)
    assert drive.driver.controller.raceline is other


def test_what_adapts_is_told_the_angle_that_was_sent():
    """Not the requested one: in a stop the supervisor may reduce it."""
    parameters = load_controller_parameters("map_adaptive").with_(speed_scale=1.0)
    drive, sent = Drive(parameters), []
    controller = drive.driver.controller
    update = controller.adaptation.update
    controller.adaptation.update = lambda state, angle: sent.append(angle) or update(state, angle)
    steps = drive.drive(1.0)
    drive.driver.supervisor.request_stop("service")
    steps.append(drive.step(outwards=0.3))
    assert steps[-1].result.steering_angle > 0.03 + steps[-1].decision.steering_angle
    steps += drive.drive(0.5)
    # The last command is sent before anything is learned from it.
    assert len(sent) == len(steps) - 1
    controller.learn()
    controller.learn()
    assert sent == [step.decision.steering_angle for step in steps]
    state = steps[-1].result.state
    drive.driver.step(drive.now, CarState(drive.now, math.nan, *state[2:]))
    controller.learn()
    assert len(sent) == len(steps)


def test_a_pose_that_is_not_trusted_changes_no_angle_that_was_sent():
    drive, sent = Drive(load_controller_parameters("map_adaptive").with_(speed_scale=1.0)), []
    controller = drive.driver.controller
    drive.drive(1.0)
    controller.learn()
    controller.adaptation.update = lambda state, angle: sent.append(angle)
    drive.speed = 6.0
    last = drive.step().decision.steering_angle
    stop = drive.driver.step(drive.now, CarState(drive.now, math.nan, *(0.0,) * 5)).decision
    assert stop.steering_angle < last  # to leave grip for braking
    controller.learn()
    assert sent == [last]


@pytest.mark.parametrize(("name", "always"), [("map", True), ("pure_pursuit", False)])
def test_the_grip_is_that_of_the_car_or_of_its_table(name, always):
    parameters, vehicle = load_controller_parameters(name), load_vehicle("nuc4")
    own = build_slowing(parameters, vehicle)
    assert own.always is always and own.bounded(99.0) == 0.8 * parameters.a_brake_max_mps2
    assert own.largest(0.5) == vehicle.delta_max
    weak = build_steering_map("table", replace(vehicle, mu=0.5 * vehicle.mu), 12.0)
    assert build_slowing(parameters, vehicle, weak).largest(6.0) < own.largest(6.0)
    # The supervisor uses it.
    controller = build_controller(parameters, vehicle, circle())
    for grip, slowing in ((None, own), (weak, build_slowing(parameters, vehicle, weak))):
        supervisor = build_supervisor(controller, SafetyLimits(), grip)
        state = CarState(100.0, RADIUS, 0.0, 0.5 * math.pi, 6.0, 0.0, 1.0)
        result = ControlResult(0.4, 6.0, Status.OK, state, *(0.0,) * 7)
        for k in range(40):
            at = 100.0 + k * PERIOD
            assert supervisor.observe(at, state._replace(t=at, y=6.0 * k * PERIOD))
            angle = supervisor.decide(at, result).steering_angle
        assert angle == (slowing.largest(6.0) if always else 0.4)


def test_a_raceline_that_waits_is_dropped_with_one_that_is_refused():
    drive = Drive()
    drive.drive(1.0)
    old = drive.driver.controller.raceline
    assert not drive.follow(circle(-1.0))
    drive.drive(0.1)
    drive.driver.refuse()
    last = drive.drive(3.0)[-1].decision
    assert last[:2] == (Mode.STOPPED, Reason.INVALID_RACELINE)
    assert drive.driver.controller.raceline is old and drive.told == []
    assert drive.follow(circle(-1.0))
    assert drive.drive(1.0)[-1].decision.mode is Mode.DRIVING


def test_stops_follow_live_tuning():
    """As if the car had started with these values."""
    drive = Drive()
    controller, supervisor = drive.driver.controller, drive.driver.supervisor
    grip = supervisor.slowing.grip
    parameters = load_controller_parameters("pure_pursuit").with_(a_brake_max_mps2=3.0)
    steering_map = build_steering_map("ackermann", controller.vehicle, 12.0)
    setup = controller.prepare(parameters=parameters, steering_map=steering_map)
    limits = SafetyLimits(recovery_s=2.0)
    drive.driver.tune(setup, limits)
    assert controller.parameters is parameters and supervisor.limits is limits
    tuned, fresh = supervisor.slowing, build_slowing(parameters, controller.vehicle)
    assert tuned.grip is grip and tuned.always is fresh.always is False
    assert tuned.bounded(9.0) == fresh.bounded(9.0) == pytest.approx(2.4)
    assert tuned.braking(6.0, 0.02) == fresh.braking(6.0, 0.02)
    supervisor.slowing = None
    drive.driver.tune(setup, SafetyLimits())
    assert supervisor.slowing is None and supervisor.limits == SafetyLimits()
