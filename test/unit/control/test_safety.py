import math

import pytest
from supervised_car import PERIOD, Car

from map_racing.control.controller import Status
from map_racing.control.decision import Mode, Reason
from map_racing.control.safety import (
    FIRST_STEP,
    LONGEST_STEP,
    QUICKEST,
    RISING,
    Supervisor,
)
from map_racing.control.safety_limits import SafetyLimits
from map_racing.errors import ParameterError
from map_racing.track.raceline import Raceline


def test_good_poses_drive_at_once_with_the_controllers_command():
    decision = Car().step()
    assert decision == (Mode.DRIVING, Reason.NONE, 0.1, 4.0)


def test_a_stop_ramps_down_at_the_stated_deceleration_while_steering():
    car = Car(stop_deceleration_mps2=4.0)
    car.drive()
    car.supervisor.request_stop("service")
    decisions = car.drive(1.2, steering_angle=-0.2)
    speeds = [decision.speed for decision in decisions]
    assert speeds[:3] == [3.875, 3.75, 3.625]
    assert speeds[30] == 0.125
    assert speeds[31:] == [0.0] * len(speeds[31:])
    assert {decision.steering_angle for decision in decisions} == {-0.2}
    assert {decision.reason for decision in decisions} == {Reason.STOP_REQUESTED}
    assert [decisions[i].mode for i in (0, 30, 31)] == [Mode.STOPPING, Mode.STOPPING, Mode.STOPPED]


def test_a_stop_starts_from_the_measured_speed_of_a_car_that_still_accelerates():
    car = Car(speed=2.0)
    car.drive(speed=8.0)
    car.supervisor.request_stop("service")
    assert car.step(speed=8.0).speed == 1.875


def test_a_stop_never_commands_more_than_the_controller():
    car = Car()
    car.drive()
    car.supervisor.request_stop("service")
    assert car.step(speed=1.0).speed == 1.0


def test_a_requested_stop_waits_for_resume():
    car = Car()
    car.drive()
    car.supervisor.request_stop("topic")
    assert car.drive(5.0)[-1].mode is Mode.STOPPED
    car.supervisor.resume()
    assert car.step().mode is Mode.DRIVING


def test_withdrawing_one_request_leaves_the_other():
    car = Car()
    car.drive()
    car.supervisor.request_stop("topic")
    car.supervisor.request_stop("service")
    car.supervisor.withdraw("topic")
    assert car.step().reason is Reason.STOP_REQUESTED
    car.supervisor.withdraw("service")
    assert car.step().mode is Mode.DRIVING


@pytest.mark.parametrize("age", [0.21, -0.21, 1e6])
def test_old_or_future_stamps_stop_and_hold_the_steering(age):
    car = Car(max_pose_age_s=0.2)
    car.drive()
    decision = car.step(car.pose(age=age), steering_angle=0.3)
    assert decision[:3] == (Mode.STOPPING, Reason.STALE_POSE, 0.1)
    assert decision.speed == 3.875


def test_ages_within_the_limit_drive():
    car = Car(max_pose_age_s=0.2)
    for _ in range(40):
        assert car.step(car.pose(age=0.19)).mode is Mode.DRIVING


def test_frozen_localization_that_goes_on_publishing_its_last_stamp():
    car = Car()
    car.drive()
    frozen = car.pose()
    decisions = [car.step(frozen) for _ in range(20)]
    assert [decision.mode for decision in decisions[:7]] == [Mode.DRIVING] * 7  # up to 0.19 s old
    assert decisions[7].reason is Reason.STALE_POSE


def test_frozen_poses_without_stamps_show_by_the_speed():
    car = Car()
    car.drive()
    x = car.x
    modes = [car.step(car.pose(x=x)).mode for _ in range(12)]
    assert modes == [Mode.DRIVING] * 7 + [Mode.STOPPING] * 5
    assert car.supervisor.reason is Reason.FROZEN_POSE


def test_frozen_poses_whose_velocity_is_worked_out_from_them():
    """The velocity ends with the poses; the stop ramps down from the last speed."""
    car = Car(stop_deceleration_mps2=4.0)
    car.drive()
    x = car.x
    decisions = [car.step(car.pose(x=x, v_x=4.0 if k == 0 else 0.0)) for k in range(20)]
    assert [decision.mode for decision in decisions[:7]] == [Mode.DRIVING] * 7
    assert decisions[7][:2] == (Mode.STOPPING, Reason.FROZEN_POSE)
    assert decisions[7].speed == 3.875
    assert car.drive(0.6)[-1].mode is Mode.DRIVING


def test_one_pose_elsewhere_is_no_motion():
    """A correction of the localization gives a standing car a single velocity sample."""
    car = Car(speed=0.0)
    car.drive()
    car.x += 0.3
    car.step(car.pose(v_x=4.0))
    assert car.drive(3.0)[-1].mode is Mode.DRIVING


def test_poses_in_another_frame_stop_and_recover():
    car = Car()
    car.drive()
    decision = car.supervisor.refuse(car.now)
    assert decision[:3] == (Mode.STOPPING, Reason.FRAME, 0.1)
    assert decision.speed == 3.875
    assert car.drive(0.6)[-1].mode is Mode.DRIVING


def test_a_standing_car_may_have_the_same_pose_for_ever():
    car = Car(speed=0.0)
    assert car.drive(5.0)[-1].mode is Mode.DRIVING


@pytest.mark.parametrize("field", ["t", "x", "y", "psi", "v_x", "r"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_pose_that_is_not_finite_stops_and_recovers(field, value):
    car = Car(recovery_s=0.5)
    car.drive()
    decision = car.step(car.pose(**{field: value}), steering_angle=9.0)
    assert decision[:3] == (Mode.STOPPING, Reason.INVALID_POSE, 0.1)
    modes = [decision.mode for decision in car.drive(0.6)]
    assert modes == [Mode.STOPPING] * 16 + [Mode.DRIVING] * 3


def test_invalid_state_found_by_the_controller():
    car = Car()
    car.drive()
    assert car.step(status=Status.INVALID_STATE, speed=0.0).reason is Reason.INVALID_POSE
    assert car.supervisor.mode is Mode.STOPPING


def test_unknown_lateral_velocity_is_no_fault():
    car = Car()
    assert car.step(car.pose(v_y=math.nan)).mode is Mode.DRIVING


@pytest.mark.parametrize("move", [{"x": 0.9}, {"y": -0.9}, {"psi": 1.2}])
def test_a_jump_stops_and_the_new_place_is_accepted_after_a_while(move):
    car = Car(max_jump_m=0.5, max_turn_rad=0.8)
    car.drive()
    first = car.pose()
    base = first._replace(**{name: getattr(first, name) + by for name, by in move.items()})
    decisions = []
    for _ in range(30):
        way = car.x - first.x  # continue in the direction of its heading
        x, y = base.x + way * math.cos(base.psi), base.y + way * math.sin(base.psi)
        decisions.append(car.step(base._replace(t=car.now, x=x, y=y)))
    assert decisions[0].reason is Reason.JUMP
    assert decisions[0].steering_angle == 0.1
    assert [decision.mode for decision in decisions[:17]] == [Mode.STOPPING] * 17
    assert decisions[17].mode is Mode.DRIVING


def test_fast_driving_and_a_lost_pose_are_no_jump():
    car = Car(speed=10.0)
    car.drive()
    for _ in range(3):  # 1.25 m without a pose
        car.now += PERIOD
        car.x += car.speed * PERIOD
    assert car.step().mode is Mode.DRIVING


def test_far_from_the_raceline_stops_while_steering_back():
    car = Car(max_deviation_m=1.0)
    assert car.drive(d=0.99)[-1].mode is Mode.DRIVING
    decision = car.step(d=-1.01, steering_angle=0.3)
    assert decision[:3] == (Mode.STOPPING, Reason.DEVIATION, 0.3)
    assert car.drive(0.6, d=0.2)[-1].mode is Mode.DRIVING


def test_without_raceline_a_new_car_waits_and_a_driving_one_stops():
    car = Car()
    nothing = {"status": Status.NO_RACELINE, "speed": 0.0, "d": math.nan}
    assert car.step(**nothing)[:2] == (Mode.WAITING, Reason.NO_RACELINE)
    assert car.drive(0.6)[-1].mode is Mode.DRIVING
    assert car.step(**nothing)[:2] == (Mode.STOPPING, Reason.NO_RACELINE)


def test_a_raceline_that_cannot_be_driven_stops_along_the_old_one():
    car = Car()
    car.drive()
    car.supervisor.raceline_changed(False)
    decision = car.step()
    assert decision[:3] == (Mode.STOPPING, Reason.INVALID_RACELINE, 0.1)
    car.drive(5.0)
    car.supervisor.raceline_changed(True)
    assert car.drive(0.6)[-1].mode is Mode.DRIVING


def test_grip_exceeded_for_long_stops_until_resumed():
    car = Car(max_saturated_s=1.0)
    saturated = {"status": Status.SATURATED}
    assert car.drive(1.0, **saturated)[-1].mode is Mode.DRIVING
    car.step()
    assert car.drive(1.0, **saturated)[-1].mode is Mode.DRIVING
    assert car.drive(0.1, **saturated)[-1].reason is Reason.GRIP
    assert car.drive(5.0)[-1].mode is Mode.STOPPED
    car.supervisor.resume()
    assert car.step().mode is Mode.DRIVING


@pytest.mark.parametrize(("psi", "trusted"), [(0.8, True), (-0.8, True), (0.81, False)])
def test_a_pose_whose_heading_is_not_the_motion_is_not_trusted(psi, trusted):
    """The controller does not use it either."""
    car = Car(max_turn_rad=0.8)
    for _ in range(40):
        found = car.supervisor.observe(car.now, car.pose(psi=psi))
        car.now, car.x = car.now + PERIOD, car.x + car.speed * PERIOD
    assert found is trusted
    assert (car.supervisor.trouble(car.now) is Reason.NONE) is trusted


def test_a_crawling_car_at_its_lock_has_grip():
    car = Car(speed=0.5)
    assert car.drive(5.0, status=Status.SATURATED)[-1].mode is Mode.DRIVING


@pytest.mark.parametrize("speed", [12.1, 1e9])
def test_no_speed_beyond_the_limit(speed):
    assert Car(max_speed=5.0).step(speed=speed).speed == 5.0


@pytest.mark.parametrize("command", [{"speed": math.nan}, {"steering_angle": math.inf}])
def test_a_command_that_is_not_finite_is_a_failure(command):
    car = Car()
    car.drive()
    decision = car.step(**command)
    assert decision[:3] == (Mode.STOPPING, Reason.FAILURE, 0.1)
    assert math.isfinite(decision.speed)
    assert car.drive(5.0)[-1].mode is Mode.STOPPED
    car.supervisor.resume()
    assert car.step().mode is Mode.DRIVING


def test_negative_speeds_are_not_passed_on():
    assert Car().step(speed=-1.0).speed == 0.0


def test_poses_that_stop_coming():
    car = Car(max_pose_age_s=0.2, hold_s=2.0)
    car.drive()
    supervisor, begin = car.supervisor, car.now - PERIOD
    assert supervisor.watch(begin + 0.19) is None
    decision = supervisor.watch(begin + 0.25)
    assert decision[:3] == (Mode.STOPPING, Reason.STALE_POSE, 0.1)
    assert decision.speed == 4.0 - 4.0 * FIRST_STEP
    speeds = [supervisor.watch(begin + 0.25 + 0.0625 * k).speed for k in range(1, 16)]
    assert speeds == pytest.approx([3.8 - 0.25 * k for k in range(1, 16)])
    assert supervisor.watch(begin + 1.25)[::3] == (Mode.STOPPED, 0.0)
    assert supervisor.watch(begin + 3.25).speed == 0.0
    assert supervisor.watch(begin + 3.26) is None
    car.now = begin + 5.0
    assert car.drive(0.5)[-1].mode is Mode.STOPPED
    assert car.drive(0.1)[-1].mode is Mode.DRIVING


def test_a_stop_after_a_gap_begins_with_a_step_as_any_other():
    """The command held meanwhile: missed braking is not made up for at once."""
    assert (FIRST_STEP, LONGEST_STEP) == (0.05, 0.1)
    car = Car(max_pose_age_s=0.5)
    car.drive()
    car.supervisor.request_stop("service")
    car.now += 0.4
    assert car.step().speed == 4.0 - 4.0 * FIRST_STEP
    car.now += 0.4 - PERIOD
    assert car.step().speed == pytest.approx(3.8 - 4.0 * LONGEST_STEP)
    assert car.step().speed == pytest.approx(3.4 - 4.0 * PERIOD)


def test_a_clock_that_goes_back_a_little_is_no_time_for_steering_or_braking():
    """As when poses arrive out of order: otherwise the rates would act in reverse."""
    car = Car()
    car.drive()
    car.supervisor.request_stop("service")
    first = car.step()
    car.now -= 3 * PERIOD
    again = car.step()
    assert again.speed == first.speed and again.steering_angle == first.steering_angle


@pytest.mark.parametrize(
    ("gains", "told", "first"),
    [(4.0, 8.0, 0.8), (4.0, 4.5, 0.5), (9.0, 8.0, 1.0), (0.0, 8.0, 0.0), (-4.0, 8.0, 0.0)],
)
def test_a_car_that_was_accelerating_did_so_in_a_gap_but_not_beyond_the_command(gains, told, first):
    """A command far below its present speed would be hard braking."""
    assert (RISING, QUICKEST) == (0.1, 5.0)
    car = Car(speed=4.0 - gains, max_overspeed_mps=10.0)
    for _ in range(33):
        car.step(speed=told)
        car.speed += gains * PERIOD
    first += car.speed - gains * PERIOD
    decision = car.supervisor.watch(car.now - PERIOD + 0.2)
    assert decision.mode is Mode.STOPPING
    assert decision.speed == pytest.approx(first - 4.0 * FIRST_STEP, abs=1e-4)


@pytest.mark.parametrize("apart", [PERIOD, 0.15])
def test_noise_of_the_speed_is_averaged_before_it_counts_as_getting_faster(apart):
    car = Car(speed=4.0, max_overspeed_mps=10.0)
    car.drive(speed=8.0)
    car.now, car.speed = car.now - PERIOD + apart, 4.1
    car.step(speed=8.0)
    decision = car.supervisor.watch(car.now - PERIOD + 0.2)
    rise = 0.1 / max(apart, RISING)
    assert decision.speed == pytest.approx(4.1 + rise * 0.2 - 4.0 * FIRST_STEP)


def test_the_deadline_is_the_limit_after_the_last_pose():
    """A call of `watch` at the deadline begins the stop, whatever the rate of the calls."""
    car = Car(max_pose_age_s=0.2)
    assert car.supervisor.deadline is None
    car.drive()
    supervisor, last = car.supervisor, car.now - PERIOD
    assert supervisor.deadline == last + 0.2
    assert supervisor.watch(last + 0.1) is None
    assert supervisor.deadline == last + 0.2
    assert supervisor.watch(supervisor.deadline).mode is Mode.STOPPING
    # After that, commands continue.
    assert last + 0.2 < supervisor.deadline <= last + 0.23
    car.step()
    assert supervisor.deadline == car.now - PERIOD + 0.2


@pytest.mark.parametrize("field", ["v_x", "r"])
@pytest.mark.parametrize("value", [1e9, -1e9, 200.0])
def test_an_absurd_velocity_is_no_pose_to_trust(field, value):
    car = Car()
    car.drive()
    assert car.step(car.pose(**{field: value}))[:2] == (Mode.STOPPING, Reason.INVALID_POSE)


def test_before_the_first_pose_nothing_is_commanded():
    supervisor = Supervisor(SafetyLimits(), 12.0)
    assert supervisor.watch(5.0) is None
    assert (supervisor.mode, supervisor.reason) == (Mode.WAITING, Reason.NO_POSE)
    car = Car()
    car.supervisor = supervisor
    car.now = 5.01
    assert car.step().mode is Mode.DRIVING


@pytest.mark.parametrize("by", ["watch", "pose in another frame", "pose that is not finite"])
def test_a_clock_set_back_stops_a_car_until_a_pose_can_be_trusted(by):
    """Its position is unknown, and it still follows the last command."""
    car = Car(hold_s=1.0, max_pose_age_s=0.2)
    car.drive(2.0)
    supervisor, begin = car.supervisor, 10.0
    decisions = []
    for k in range(100):
        car.now = begin + k * PERIOD
        if by == "watch":
            decisions.append(supervisor.watch(car.now))
            assert supervisor.deadline == pytest.approx(car.now + 0.02)
        elif by == "pose in another frame":
            decisions.append(supervisor.refuse(car.now))
        else:
            decisions.append(car.step(car.pose(x=math.nan)))
    reason = {
        "watch": Reason.NO_POSE,
        "pose in another frame": Reason.FRAME,
        "pose that is not finite": Reason.INVALID_POSE,
    }[by]
    first = 4.0 - 4.0 * FIRST_STEP
    ramp = [max(first - 4.0 * PERIOD * k, 0.0) for k in range(len(decisions))]
    held = [d for d in decisions if d is not None]
    assert [d.speed for d in held] == pytest.approx(ramp[: len(held)])
    assert {d[1:3] for d in held} == {(reason, 0.1)}
    standing = [d.mode for d in held].index(Mode.STOPPED)
    assert held[standing].speed == 0.0 < held[standing - 1].speed
    # Without any poses, standstill is commanded only for a while.
    assert len(held) == (standing + 33 if by == "watch" else 100)
    car.now, car.speed = begin + 100 * PERIOD, 0.0
    decision = car.drive(0.6)[0 if by == "watch" else -1]
    assert decision[:2] == (Mode.DRIVING, Reason.NONE)


def test_a_clock_set_back_stops_a_car_that_stands_and_none_that_never_drove():
    car = Car(hold_s=1.0)
    car.drive()
    car.supervisor.request_stop("service")
    car.drive(2.0)
    supervisor = car.supervisor
    assert [supervisor.watch(10.0 + k)[::3] for k in (0.0, 1.0)] == [(Mode.STOPPED, 0.0)] * 2
    assert supervisor.watch(11.01) is None
    car = Car()
    car.supervisor.refuse(100.0)
    assert car.supervisor.watch(10.0) is None and car.supervisor.deadline is None
    assert car.supervisor.mode is Mode.WAITING


def test_a_clock_set_back_stops_a_car_from_the_speed_that_it_had():
    car = Car(speed=2.0)
    car.drive(speed=8.0, seconds=0.4)
    assert car.supervisor.watch(10.0).speed == 2.0 - 4.0 * FIRST_STEP


def test_a_clock_set_back_and_a_raceline_before_the_next_pose():
    """Position and direction of the car are no longer known."""
    car = Car()
    car.drive()
    car.supervisor.watch(10.0)
    assert not car.supervisor.stands
    angle = [2.0 * math.pi * k / 50 for k in range(50)]
    x, y = [10.0 * math.cos(a) for a in angle], [10.0 * math.sin(a) for a in angle]
    assert not car.supervisor.opposes(Raceline(x, y))


def test_a_clock_set_back_begins_anew_but_keeps_the_request():
    car = Car()
    car.drive(2.0)
    car.supervisor.request_stop("service")
    car.now, car.x, restarts = 10.0, 50.0, []
    car.supervisor.on_restart = lambda: restarts.append(car.supervisor.mode)
    car.step()
    assert restarts == [Mode.STOPPING]
    assert (car.supervisor.mode, car.supervisor.reason) == (Mode.STOPPING, Reason.STOP_REQUESTED)
    car.supervisor.resume()
    car.step()
    assert len(restarts) == 1 and car.supervisor.mode is Mode.DRIVING


@pytest.mark.parametrize(
    "changes",
    [
        {"max_jump_m": 0.0},
        {"max_pose_age_s": math.nan},
        {"max_pose_age_s": 200.0},  # milliseconds
        {"recovery_s": 0.1},
        {"max_jump_m": True},
        {"hold_s": "2"},
    ],
)
def test_impossible_limits_are_refused_by_name(changes):
    with pytest.raises(ParameterError, match=next(iter(changes))):
        SafetyLimits(**changes)


def test_what_is_absurdly_fast_depends_on_the_fastest_speed_of_the_car():
    small, large = Car(speed=60.0), Car(speed=60.0, max_speed=50.0)
    assert small.drive(0.2)[-1].reason is Reason.INVALID_POSE
    assert large.drive(0.2)[-1].mode is Mode.DRIVING
    assert Car(speed=99.0, max_speed=50.0).drive(0.2)[-1].mode is Mode.DRIVING
    large.speed = 101.0
    assert large.step().reason is Reason.INVALID_POSE
