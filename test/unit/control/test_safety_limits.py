"""The supervisor at its limits, and its memory from one pose to the next."""

import math
from dataclasses import FrozenInstanceError, fields

import numpy as np
import pytest
from supervised_car import PERIOD, Car

from map_racing.control.controller import Status
from map_racing.control.decision import Mode, Reason
from map_racing.control.safety import Supervisor
from map_racing.control.safety_limits import SafetyLimits
from map_racing.track.raceline import Raceline

# Sums and differences of these are exact.
QUARTER, EIGHTH = 0.25, 0.125


def straight(direction=1.0):
    """A raceline along x at the car, returning 20 m beside it."""
    x = np.r_[np.arange(-40.0, 40.0), np.arange(40.0, -40.0, -1.0)]
    y = np.r_[np.zeros(80), np.full(80, 20.0)]
    order = slice(None, None, int(direction))
    return Raceline(x[order], y[order], vx_mps=np.full(160, 4.0))


# -- before any input ----------------------------------------------------------------------------


def test_a_new_supervisor_knows_nothing():
    supervisor = Supervisor(SafetyLimits(), 12.0)
    assert (supervisor.mode, supervisor.reason) == (Mode.WAITING, Reason.NO_POSE)
    assert (supervisor.jumped, supervisor.stands) == (False, True)
    assert math.isnan(supervisor.pose_age)
    assert supervisor.opposes(straight(-1.0)) is False


def test_a_first_pose_that_is_none_commands_nothing():
    car = Car()
    assert car.step(car.pose(x=math.nan)) == (Mode.WAITING, Reason.INVALID_POSE, 0.0, 0.0)


def test_a_request_before_the_first_pose_is_the_reason():
    supervisor = Supervisor(SafetyLimits(), 12.0)
    supervisor.request_stop("service")
    assert supervisor.watch(5.0) is None
    assert supervisor.reason is Reason.STOP_REQUESTED


def test_a_car_that_never_drove_is_not_commanded_when_its_poses_end():
    car = Car()
    car.supervisor.request_stop("service")
    car.drive()
    assert car.supervisor.watch(car.now + 1.0) is None


# -- exactly at the limits -----------------------------------------------------------------------


@pytest.mark.parametrize("age", [QUARTER, -QUARTER])
def test_a_pose_as_old_as_the_limit_drives(age):
    car = Car(max_pose_age_s=QUARTER)
    assert car.step(car.pose(age=age)).mode is Mode.DRIVING


def test_a_pause_as_long_as_the_limit_is_none_for_the_pose_that_ends_it():
    car = Car(max_pose_age_s=QUARTER)
    car.drive()
    car.now += QUARTER - PERIOD
    car.x += 4.0 * (QUARTER - PERIOD)
    assert car.step().mode is Mode.DRIVING


def test_the_watch_stops_at_the_limit_and_then_goes_on_every_20_ms():
    car = Car(max_pose_age_s=QUARTER)
    car.drive()
    supervisor, due = car.supervisor, car.now - PERIOD + QUARTER
    assert supervisor.deadline == due
    assert supervisor.watch(due).reason is Reason.STALE_POSE
    assert supervisor.deadline == due + 0.02


def test_frozen_for_as_long_as_the_limit_drives():
    car = Car(max_pose_age_s=QUARTER)
    car.drive()
    x = car.x
    modes = [car.step(car.pose(x=x)).mode for _ in range(10)]
    assert modes == [Mode.DRIVING] * 9 + [Mode.STOPPING]


@pytest.mark.parametrize(("field", "most"), [("v_x", 50.0), ("r", 100.0)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_as_fast_as_a_car_can_be_is_not_absurd(field, most, sign):
    car = Car(speed=0.0)
    for value, good in ((most, True), (1.01 * most, False)):
        state = car.pose(**{field: sign * value})
        assert car.supervisor.observe(car.now, state) is good


@pytest.mark.parametrize(
    ("change", "jumps"),
    [
        ({"x": 0.5}, False),
        ({"x": 0.51}, True),
        ({"psi": 0.75}, False),
        ({"psi": 0.76}, True),
        ({"psi": -0.76}, True),
    ],
)
def test_a_jump_is_more_than_the_limit(change, jumps):
    car = Car(speed=0.0, max_jump_m=0.5, max_turn_rad=0.75)
    car.x = 0.0
    car.step(speed=0.0)
    car.step(car.pose(**change), speed=0.0)
    assert car.supervisor.jumped is jumps
    car.step(car.pose(**change), speed=0.0)
    assert not car.supervisor.jumped


@pytest.mark.parametrize(
    ("measured", "commanded", "moved", "jumps"),
    [
        (0.0, 8.0, 1.4, False),  # velocity not measured
        (8.0, 0.0, 1.4, False),  # pushed, or rolling on
        (-8.0, 0.0, -1.4, False),
        (0.0, 0.0, 1.4, True),
        (45.0, 0.0, 2.9, False),  # 0.5 m and twice the largest speed for 1/8 s
        (45.0, 0.0, 3.1, True),
    ],
)
def test_what_the_car_can_have_driven(measured, commanded, moved, jumps):
    car = Car(speed=0.0, max_speed=10.0, max_jump_m=0.5)
    car.step(car.pose(v_x=measured), speed=commanded)
    car.now += EIGHTH - PERIOD
    car.step(car.pose(x=moved, v_x=measured), speed=commanded)
    assert car.supervisor.jumped is jumps


@pytest.mark.parametrize("r", [8.0, -8.0])
def test_what_the_car_can_have_turned(r):
    car = Car(speed=0.0, max_turn_rad=0.75)
    for psi, jumps in ((0.0, False), (1.7, False), (3.5, True)):
        car.step(car.pose(psi=psi, r=r))
        assert car.supervisor.jumped is jumps
        car.now += EIGHTH - PERIOD


def test_poses_out_of_order_are_no_jump():
    car = Car(max_jump_m=0.5)
    car.drive()
    late = car.pose(age=EIGHTH)
    assert car.step(late._replace(x=late.x - 0.45)).mode is Mode.DRIVING


def test_as_far_from_the_raceline_as_the_limit_drives():
    car = Car(max_deviation_m=1.0)
    assert car.step(d=1.0).mode is car.step(d=-1.0).mode is Mode.DRIVING


def test_grip_exceeded_for_as_long_as_the_limit_drives():
    car = Car(max_saturated_s=1.0)
    assert car.drive(33 * PERIOD, status=Status.SATURATED)[-1].mode is Mode.DRIVING
    assert car.step(status=Status.SATURATED).reason is Reason.GRIP


@pytest.mark.parametrize(("speed", "counts"), [(1.0, True), (0.99, False), (-2.0, False)])
def test_grip_is_exceeded_by_a_car_that_moves(speed, counts):
    car = Car(speed=speed, max_saturated_s=1.0)
    car.drive(2.0, status=Status.SATURATED, speed=2.0)
    car.speed = 2.0
    assert (car.drive(2.0, speed=2.0)[-1].reason is Reason.GRIP) is counts


@pytest.mark.parametrize(("back", "restarts"), [(0.5, False), (0.53125, True)])
def test_a_clock_set_back_by_half_a_second_is_noticed(back, restarts):
    for call in ("observe", "refuse", "watch"):
        car = Car()
        car.drive()
        told = []
        car.supervisor.on_restart = lambda told=told: told.append(True)
        now = car.now - PERIOD - back
        arguments = {"observe": (now, car.pose()), "refuse": (now,), "watch": (now,)}[call]
        getattr(car.supervisor, call)(*arguments)
        assert told == [True] * restarts, call


def test_a_stopped_car_is_held_for_as_long_as_stated():
    car = Car(max_pose_age_s=QUARTER, hold_s=2.0, stop_deceleration_mps2=4.0)
    car.drive()
    supervisor, last = car.supervisor, car.now - PERIOD
    for k in range(1, 20):
        assert supervisor.watch(last + 0.0625 * k) or k < 4
    assert supervisor.watch(last + 1.25)[::3] == (Mode.STOPPED, 0.0)
    assert supervisor.watch(last + 3.25).speed == 0.0
    assert supervisor.watch(last + 3.28125) is None


# -- what is trusted -----------------------------------------------------------------------------


def test_a_failure_waits_for_resume():
    car = Car()
    car.drive()
    car.supervisor.fail()
    assert car.step()[:2] == (Mode.STOPPING, Reason.FAILURE)
    assert car.drive(3.0)[-1].reason is Reason.FAILURE
    car.supervisor.resume()
    assert car.step().mode is Mode.DRIVING


def test_after_a_jump_poses_are_not_trusted_for_150_ms():
    car = Car()
    supervisor = car.supervisor
    for now, x, trusted in (
        *((-0.1, 0.0, True), (0.0, 3.0, False), (0.1, 3.3, False)),
        *((0.15, 3.45, False), (0.16, 3.48, True)),
    ):
        state = car.pose()._replace(t=now, x=x)
        assert supervisor.observe(now, state) is trusted, now
        assert supervisor.decide(now, car.result() if trusted else None).mode is not Mode.WAITING
        assert supervisor.jumped is (x == 3.0)


def test_frozen_poses_are_not_trusted():
    car = Car(max_pose_age_s=QUARTER)
    car.drive()
    x = car.x
    decisions = [car.step(car.pose(x=x), steering_angle=0.01 * k) for k in range(20)]
    assert decisions[8].steering_angle == 0.08
    assert {d.steering_angle for d in decisions[9:]} == {0.08}


def test_the_speed_of_a_pose_that_is_not_trusted_does_not_count():
    car = Car()
    car.drive()
    assert car.step(car.pose(age=1.0, v_x=1.0)).speed == 3.875


def test_a_state_that_the_controller_finds_invalid_does_not_steer():
    car = Car()
    car.drive()
    decision = car.step(status=Status.INVALID_STATE, steering_angle=0.3)
    assert decision[:3] == (Mode.STOPPING, Reason.INVALID_POSE, 0.1)


def test_without_a_result_nothing_is_driven():
    """As if the controller was not called although nothing seems wrong."""
    car = Car()
    car.drive()
    car.supervisor.observe(car.now, car.pose())
    assert car.supervisor.decide(car.now, None) == (Mode.STOPPING, Reason.NONE, 0.1, 3.875)


def test_poses_in_another_frame_are_poses_for_the_watch():
    car = Car(max_pose_age_s=QUARTER)
    car.drive()
    for _ in range(20):
        assert car.supervisor.refuse(car.now).reason is Reason.FRAME
        assert car.supervisor.deadline == car.now + QUARTER
        assert car.supervisor.watch(car.now + PERIOD) is None
        car.now += PERIOD


def test_the_age_of_a_pose_grows_while_none_comes():
    car = Car(max_pose_age_s=QUARTER)
    car.step(car.pose(age=EIGHTH))
    assert car.supervisor.pose_age == EIGHTH
    car.supervisor.watch(car.now - PERIOD + 0.5)
    assert car.supervisor.pose_age == 0.5 + EIGHTH
    # No pose was in the right frame.
    supervisor = Supervisor(SafetyLimits(), 12.0)
    supervisor.refuse(5.0)
    supervisor.watch(6.0)
    assert supervisor.pose_age == 1.0


# -- what is kept and forgotten ------------------------------------------------------------------


@pytest.mark.parametrize("event", ["resume", "pose"])
def test_time_beyond_the_grip_begins_anew(event):
    car = Car(max_saturated_s=1.0)
    car.drive(0.9, status=Status.SATURATED)
    if event == "resume":
        car.supervisor.resume()
    else:
        car.step(car.pose(x=math.nan))
        car.drive(0.6)
    assert car.drive(0.9, status=Status.SATURATED)[-1].reason is not Reason.GRIP


def test_a_pose_that_is_not_trusted_ends_the_time_beyond_the_grip():
    car = Car(max_saturated_s=1.0)
    car.drive(0.9, status=Status.SATURATED)
    car.step(car.pose(age=1.0))
    assert car.drive(0.9, status=Status.SATURATED)[-1].reason is not Reason.GRIP


def test_a_longer_recovery_does_not_bring_back_what_is_over():
    """As when somebody moves the slider while the car drives."""
    car = Car(recovery_s=0.5)
    car.drive()
    car.step(car.pose(x=math.nan))
    assert car.drive(2.0)[-1].mode is Mode.DRIVING
    car.supervisor.limits = SafetyLimits(recovery_s=10.0)
    assert car.step().mode is Mode.DRIVING


# -- motion --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("measured", "commanded", "stands"),
    [
        (0.0, 0.0, True),
        (0.29, 0.0, True),
        (-0.29, 0.0, True),
        (0.3, 0.0, False),
        (-2.0, 0.0, False),
        (0.0, 1.0, False),
    ],
)
def test_a_car_stands_that_neither_moves_nor_is_told_to(measured, commanded, stands):
    car = Car(speed=0.0)
    car.step(car.pose(v_x=measured), speed=commanded)
    assert car.supervisor.stands is stands


@pytest.mark.parametrize("direction", [1.0, -1.0])
@pytest.mark.parametrize(
    ("measured", "along"), [(4.0, True), (0.5, True), (0.0, True), (-2.0, False)]
)
def test_a_raceline_is_opposed_by_the_motion_not_by_the_nose(direction, measured, along):
    car = Car(speed=measured)
    car.step(speed=4.0)
    opposed = along if direction < 0.0 else not along
    assert car.supervisor.opposes(straight(direction)) is opposed


@pytest.mark.parametrize("limit", fields(SafetyLimits), ids=lambda limit: limit.name)
def test_live_tuning_reaches_to_both_sides_of_what_is_usual_and_no_impossible_limit(limit):
    low, high = limit.metadata["tuning"]
    assert low < limit.default < high
    for value in (low, high):
        assert getattr(SafetyLimits(**{limit.name: value}), limit.name) == value


def test_limits_in_use_are_not_changed_but_replaced():
    """So that a change happens between two steps, and is noticed."""
    with pytest.raises(FrozenInstanceError):
        SafetyLimits().hold_s = 1.0
