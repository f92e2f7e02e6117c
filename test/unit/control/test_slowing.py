"""Steering and braking within the friction ellipse while the car is too fast."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.control.controller import ControlResult, Status
from map_racing.control.decision import Mode, Reason
from map_racing.control.safety import Supervisor
from map_racing.control.safety_limits import SafetyLimits
from map_racing.control.slowing import MOST_BRAKING, STEERING_RATE, Slowing
from map_racing.control.state import CarState
from map_racing.control.steering import build_steering_map
from map_racing.vehicle.parameters import load_vehicle

PERIOD = 1 / 40
BRAKE = 6.0
VEHICLE = load_vehicle("nuc4")
TABLE = build_steering_map("table", VEHICLE, 12.0)
SLOWING = Slowing(TABLE, BRAKE, VEHICLE.delta_max)
PEAK = TABLE.max_lateral_acceleration(12.0)


def held_angle(v, share=1.0):
    return TABLE.steering(v, share * PEAK)[0]


@pytest.mark.once
@settings(max_examples=60, deadline=None)
@given(v=st.floats(0.0, 15.0), angle=st.floats(-0.5, 0.5), braking=st.floats(0.0, 4.8))
def test_steering_stays_within_the_grip_that_braking_leaves(v, angle, braking):
    found = SLOWING.steering(v, angle, 0.0, braking, 1.0)
    share = math.sqrt(1.0 - (braking / BRAKE) ** 2)
    assert abs(found) <= min(held_angle(v, 1.001 * share) + 1e-6, VEHICLE.delta_max)
    assert found == angle or abs(found) == pytest.approx(held_angle(v, share), rel=5e-3)


@settings(max_examples=60, deadline=None)
@given(v=st.floats(1.0, 12.0), share=st.floats(0.05, 0.999))
def test_braking_and_steering_are_on_the_ellipse(v, share):
    braking = SLOWING.braking(v, held_angle(v, share))
    reachable = min(share, TABLE.max_lateral_acceleration(v) / PEAK)
    assert braking == pytest.approx(BRAKE * math.sqrt(1.0 - reachable**2), abs=0.03)


def test_beyond_the_grip_nothing_is_left_for_braking():
    assert SLOWING.braking(6.0, 0.4) == SLOWING.braking(6.0, -0.4) == 0.0


def test_straight_ahead_all_of_it_is():
    assert SLOWING.braking(6.0, 0.0) == pytest.approx(BRAKE, abs=1e-3)


def test_at_walking_pace_the_lock_and_the_whole_braking_are_free():
    assert SLOWING.steering(0.5, 0.4, 0.4, 4.0, PERIOD) == 0.4
    assert SLOWING.braking(0.5, 0.4) > 0.99 * BRAKE


def test_a_stop_leaves_grip_for_steering():
    assert SLOWING.bounded(4.0) == 4.0
    assert SLOWING.bounded(15.0) == MOST_BRAKING * BRAKE


def test_the_rate_is_limited_from_the_last_command():
    assert STEERING_RATE == 1.5
    assert SLOWING.steering(1.0, 0.4, -0.1, 0.0, 0.1) == pytest.approx(-0.1 + 0.1 * STEERING_RATE)
    assert SLOWING.steering(1.0, -0.4, 0.1, 0.0, 0.1) == pytest.approx(0.1 - 0.1 * STEERING_RATE)


@pytest.mark.parametrize("always", [True, False])
def test_the_rate_ends_where_the_grip_does(always):
    """The measured speed rises suddenly, as with spinning wheels."""
    slowing = Slowing(TABLE, BRAKE, VEHICLE.delta_max, always)
    assert slowing.steering(9.0, 0.4, 0.4, 4.0, PERIOD) == pytest.approx(
        slowing.largest(9.0) if always else 0.4 - STEERING_RATE * PERIOD
    )


def test_no_angle_is_beyond_the_lock():
    small = Slowing(TABLE, BRAKE, 0.2)
    assert small.always and small.largest(0.3) == 0.2
    assert small.steering(0.3, 0.9, 0.2, 0.0, 1.0) == 0.2


# -- the supervisor with it ----------------------------------------------------------------------


class Car:
    """A car that follows the commanded speed with a lag, and its supervisor."""

    def __init__(self, speed=4.0, **limits):
        self.supervisor = Supervisor(SafetyLimits(**limits), 12.0, SLOWING)
        self.now, self.x, self.speed = 100.0, 0.0, speed
        self.angles, self.speeds, self.measured = [], [], []

    def step(self, trusted=True, **asked):
        state = CarState(self.now, self.x, 0.0, 0.0, self.speed, 0.0, 0.0)
        wanted = ControlResult(0.0, 4.0, Status.OK, state, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 2.0)
        if not trusted:
            state = state._replace(x=math.nan)
        trusted = self.supervisor.observe(self.now, state)
        result = wanted._replace(**asked) if trusted else None
        decision = self.supervisor.decide(self.now, result)
        self.angles.append(decision.steering_angle)
        self.speeds.append(decision.speed)
        self.measured.append(self.speed)
        self.now += PERIOD
        self.x += self.speed * PERIOD
        change = (decision.speed - self.speed) / 0.1
        self.speed += min(max(change, -BRAKE), 6.0) * PERIOD
        return decision

    def assert_within_the_ellipse(self, begin):
        """Check every sample from one on: rate, grip at the measured speed, and simultaneous
        braking."""
        for k in range(begin, len(self.angles)):
            angle, v = self.angles[k], self.measured[k]
            assert abs(angle) <= held_angle(v) + 1e-9
            assert abs(angle - self.angles[k - 1]) <= STEERING_RATE * PERIOD + 1e-9
            braking = (self.speeds[k - 1] - self.speeds[k]) / PERIOD
            if k > begin:  # the ramp begins at the measured speed
                assert braking <= SLOWING.braking(v, angle) + 1e-6


def test_off_course_at_speed_the_car_slows_down_within_the_grip():
    car = Car()
    for _ in range(20):
        car.step()
    begin = len(car.angles)
    for _ in range(60):
        decision = car.step(status=Status.OFF_COURSE, steering_angle=0.41, speed=1.0)
    car.assert_within_the_ellipse(begin)
    assert decision.mode is Mode.DRIVING
    assert car.speeds[begin] > 3.85 and decision.speed == 1.0
    assert decision.steering_angle == 0.41  # once it is slow


def test_back_on_course_the_command_is_the_controllers_again_without_a_step():
    car = Car()
    for _ in range(20):
        car.step()
    begin = len(car.angles)
    for _ in range(20):
        car.step(status=Status.OFF_COURSE, steering_angle=0.41, speed=1.0)
    for _ in range(30):
        decision = car.step(steering_angle=-0.05)
    car.assert_within_the_ellipse(begin)
    assert decision[2:] == (-0.05, 4.0)


def test_a_stop_in_a_bend_brakes_as_the_steering_gives_way():
    car = Car()
    angle = held_angle(4.0, 0.98)
    for _ in range(20):
        car.step(steering_angle=angle)
    begin = len(car.angles)
    car.supervisor.request_stop("service")
    for _ in range(60):
        decision = car.step(steering_angle=angle)
    car.assert_within_the_ellipse(begin)
    assert decision[::3] == (Mode.STOPPED, 0.0)
    assert car.speed < 0.05


@pytest.mark.parametrize("share", [0.3, 0.98])
def test_a_held_angle_stays_within_the_grip_as_well(share):
    car = Car()
    angle = held_angle(4.0, share)
    for _ in range(20):
        car.step(steering_angle=angle)
    begin = len(car.angles)
    for _ in range(60):
        decision = car.step(trusted=False)
    car.assert_within_the_ellipse(begin)
    assert decision[::3] == (Mode.STOPPED, 0.0)
    most = held_angle(4.0, math.sqrt(1.0 - (4.0 / BRAKE) ** 2))
    assert decision.steering_angle == pytest.approx(min(angle, most), abs=1e-5)


def test_a_raceline_that_asks_for_much_less_is_a_ramp():
    """As with a slower raceline, or a lowered speed scale."""
    car = Car()
    for _ in range(20):
        car.step()
    begin = len(car.angles)
    for _ in range(60):
        decision = car.step(speed=0.8, steering_angle=0.3)
    car.assert_within_the_ellipse(begin)
    assert decision[2:] == (0.3, 0.8) and decision.mode is Mode.DRIVING


def test_the_braking_of_a_raceline_is_left_alone():
    car = Car()
    for _ in range(20):
        car.step()
    for k in range(20):
        speed = 4.0 - 0.14 * k
        assert car.step(speed=speed, steering_angle=0.01 * k)[2:] == (0.01 * k, speed)


@pytest.mark.parametrize(("wanted", "ramps"), [(2.0, False), (1.9, True)])
def test_much_slower_is_slower_by_more_than_2_mps(wanted, ramps):
    """On a straight, with the full braking of the tires."""
    car = Car()
    for _ in range(20):
        car.step()
    speed = car.step(speed=wanted).speed
    assert speed == pytest.approx(4.0 - BRAKE * PERIOD, abs=1e-3) if ramps else speed == wanted


def test_hard_cornering_is_left_alone():
    """From one limit to the other, as in a chicane."""
    car = Car()
    for k in range(40):
        angle = held_angle(4.0, 0.98) * (-1) ** (k // 5)
        assert car.step(steering_angle=angle) == (Mode.DRIVING, Reason.NONE, angle, 4.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("always", [True, False])
def test_no_angle_is_beyond_the_largest_lateral_acceleration_but_for_pure_pursuit(sign, always):
    car = Car(speed=6.0)
    slowing = Slowing(TABLE, BRAKE, VEHICLE.delta_max, always)
    car.supervisor = Supervisor(SafetyLimits(), 12.0, slowing)
    angle = car.step(steering_angle=0.4 * sign, speed=6.0).steering_angle
    assert angle == sign * (slowing.largest(6.0) if always else 0.4)
    assert slowing.largest(6.0) < 0.35


def test_a_little_off_course_the_car_slows_down_by_a_ramp_as_well():
    car = Car(speed=2.5)
    for _ in range(20):
        car.step(speed=2.5)
    speeds = [car.step(status=Status.OFF_COURSE, speed=1.0).speed for _ in range(3)]
    assert speeds == pytest.approx([2.5 - 4.0 * PERIOD * k for k in (1, 2, 3)])


def test_a_car_that_accelerates_off_course_slows_down_from_its_own_speed():
    car = Car(speed=2.0)
    for _ in range(20):
        car.speed = 2.0
        car.step(speed=8.0)
    car.speed = 2.0
    assert car.step(status=Status.OFF_COURSE, speed=0.5).speed == pytest.approx(2.0 - 4.0 * PERIOD)


def test_a_car_that_slowed_down_more_than_told_stops_from_there():
    car = Car()
    for _ in range(20):
        car.step()
    car.step(status=Status.OFF_COURSE, speed=1.0)
    car.supervisor.request_stop("service")
    car.speed = 3.0
    decision = car.step(status=Status.OFF_COURSE, speed=1.0)
    assert decision.speed == pytest.approx(3.0 - 4.0 * PERIOD)


@pytest.mark.parametrize("stop", [True, False])
def test_a_velocity_that_is_lost_meanwhile_does_not_end_the_ramp(stop):
    car = Car()
    for _ in range(20):
        car.step()
    if stop:
        car.supervisor.request_stop("service")
    for k in range(1, 9):
        car.speed = 4.0 if k < 4 else 0.0
        decision = car.step(status=Status.OFF_COURSE, speed=0.5)
        assert decision.speed == pytest.approx(4.0 - 4.0 * PERIOD * k)


def test_a_stop_never_commands_more_than_before():
    """If the car is faster than commanded."""
    car = Car()
    for _ in range(20):
        car.step(speed=2.0)
    car.supervisor.request_stop("service")
    car.speed = 3.0
    assert car.step(speed=2.0).speed == pytest.approx(2.0 - 4.0 * PERIOD)


def test_the_first_step_of_a_stop_in_a_bend_is_within_the_grip_as_well():
    car = Car()
    angle = held_angle(4.0, 0.98)
    for _ in range(20):
        car.speed = 4.0
        car.step(steering_angle=angle)
    car.supervisor.request_stop("service")
    car.speed = 4.0
    decision = car.step(steering_angle=angle)
    braking = (4.0 - decision.speed) / PERIOD
    assert braking == pytest.approx(SLOWING.braking(4.0, decision.steering_angle), abs=1e-6)
    assert braking < 2.5


def test_a_stop_as_hard_as_wished_leaves_grip_for_steering():
    car = Car(stop_deceleration_mps2=15.0)
    for _ in range(20):
        car.step()
    speed = car.step(trusted=False).speed
    assert speed == pytest.approx(4.0 - MOST_BRAKING * BRAKE * PERIOD)


def test_a_car_that_rolls_back_fast_steers_within_its_grip():
    car = Car(speed=-4.0)
    for _ in range(40):
        car.speed = -4.0
        decision = car.step(steering_angle=0.4)
    assert 0.0 < decision.steering_angle <= held_angle(4.0)


def test_a_car_that_waits_shows_the_angle_that_it_will_steer():
    """The wheels of a standing car may turn at any rate; its first command is not part of a
    stop."""
    car = Car(speed=0.0)
    car.supervisor.request_stop("service")
    assert car.step(steering_angle=0.3)[::2] == (Mode.WAITING, 0.3)
    car.supervisor.resume()
    assert car.step(steering_angle=-0.3) == (Mode.DRIVING, Reason.NONE, -0.3, 4.0)


def test_the_first_command_off_course_steers_no_faster_than_the_others():
    car = Car(speed=0.0)
    angles = [car.step(status=Status.OFF_COURSE, steering_angle=0.3, speed=1.0)[2] for _ in "ab"]
    assert angles == pytest.approx([0.0, STEERING_RATE * PERIOD])


def test_a_car_that_rolls_on_steers_within_its_grip():
    """Its brakes are gone: the command is 0, the speed is not."""
    car = Car()
    for _ in range(20):
        car.step()
    car.supervisor.request_stop("service")
    for _ in range(60):
        car.speed = 4.0
        car.step(steering_angle=0.4)
    assert car.speeds[-1] == 0.0
    assert 0.0 < car.angles[-1] <= held_angle(4.0)


def test_recovery_begins_where_the_stop_ended():
    car = Car()
    for _ in range(20):
        car.step(steering_angle=0.1)
    for _ in range(4):
        car.step(trusted=False)
    begin = len(car.angles)
    for _ in range(40):
        decision = car.step(steering_angle=-0.1)
    car.assert_within_the_ellipse(begin)
    assert decision == (Mode.DRIVING, Reason.NONE, -0.1, 4.0)
