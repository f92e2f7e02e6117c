"""Commands and poses compared with the motion of the car."""

import math
import random

import pytest

from map_racing.control.controller import ControlResult, Status
from map_racing.control.decision import Mode, Reason
from map_racing.control.obedience import APART, MOVING, PATIENCE, Course, Obedience, PoseMotion
from map_racing.control.safety import REST, Supervisor
from map_racing.control.safety_limits import SafetyLimits
from map_racing.control.state import CarState

PERIOD = 1 / 40


class Car:
    """A car on a straight, commanded to drive at `wanted`; a test sets its actual motion."""

    def __init__(self, wanted=4.0, **limits):
        self.supervisor = Supervisor(SafetyLimits(**limits), 12.0)
        self.now, self.x, self.speed, self.wanted = 100.0, 0.0, 0.0, wanted

    def step(self, x=None, v_x=None):
        x, v_x = self.x if x is None else x, self.speed if v_x is None else v_x
        state = CarState(self.now, x, 0.0, 0.0, v_x, 0.0, 0.0)
        trusted = self.supervisor.observe(self.now, state)
        result = ControlResult(
            0.0, self.wanted, Status.OK, state, x, 0.0, x + 1.0, 0.0, 1.0, 0.0, 0.0
        )
        decision = self.supervisor.decide(self.now, result if trusted else None)
        self.now += PERIOD
        self.x += self.speed * PERIOD
        return decision

    def drive(self, seconds, speed=None, **measured):
        if speed is not None:
            self.speed = speed
        return [self.step(**measured) for _ in range(round(seconds / PERIOD))]


def first_stop(decisions):
    """Time from the first decision to the first that does not drive [s], and its reason."""
    for k, decision in enumerate(decisions):
        if decision.mode is not Mode.DRIVING:
            return k * PERIOD, decision.reason
    return None


# -- commanded, but it stands --------------------------------------------------------------------


def test_a_car_at_a_wall_stops_being_told_to_drive():
    """From rest at 1.5 m/s^2, 1 m takes 1.15 s: a car that stands for longer is blocked."""
    t, reason = first_stop(Car().drive(3.0))
    assert reason is Reason.BLOCKED
    assert t == pytest.approx(math.sqrt(2.0 / 1.5), abs=2 * PERIOD)


def test_it_rests_and_then_tries_again_at_walking_pace():
    car = Car()
    decisions = car.drive(1.5 + REST)
    begin = next(k for k, d in enumerate(decisions) if d.reason is Reason.BLOCKED)
    again = next(k for k, d in enumerate(decisions) if k > begin and d.mode is Mode.DRIVING)
    assert (again - begin) * PERIOD == pytest.approx(REST, abs=2 * PERIOD)
    assert decisions[again].speed == 1.0
    assert first_stop(car.drive(3.0))[1] is Reason.BLOCKED  # again and again while it does not move


def test_the_rest_is_3_s_or_the_recovery_where_that_is_longer():
    for recovery, rest in ((0.5, 3.0), (5.0, 5.0)):
        reasons = [d.reason for d in Car(recovery_s=recovery).drive(8.0)]
        begin = reasons.index(Reason.BLOCKED)
        rests = reasons.index(Reason.NONE, begin) - begin
        assert rests * PERIOD == pytest.approx(rest, abs=2 * PERIOD)


def test_a_car_that_tries_again_is_not_told_to_be_faster_than_asked():
    car = Car(wanted=0.4)
    decisions = car.drive(4.0 + REST)
    begin = next(k for k, d in enumerate(decisions) if d.reason is Reason.BLOCKED)
    assert max(d.speed for d in decisions[begin:]) == 0.4


def test_a_blocked_car_whose_poses_end_is_blocked():
    car = Car()
    assert car.drive(1.5)[-1].reason is Reason.BLOCKED
    car.supervisor.resume()
    assert car.step(x=math.nan)[:2] == (Mode.STOPPED, Reason.INVALID_POSE)


@pytest.mark.parametrize(("speed", "blocked"), [(-0.5, True), (-0.51, False)])
def test_a_car_that_is_pushed_back_is_not_blocked(speed, blocked):
    car = Car()
    decisions = car.drive(1.5, v_x=speed)
    assert (Reason.BLOCKED in {d.reason for d in decisions}) is blocked


def test_once_it_moves_it_drives_on():
    car = Car()
    car.drive(1.5 + REST)
    assert car.drive(0.3, speed=1.0)[-1][1:] == (Reason.NONE, 0.0, 4.0)


def test_resume_does_not_wait():
    car = Car()
    assert car.drive(1.5)[-1].reason is Reason.BLOCKED
    car.supervisor.resume()
    assert car.step()[::3] == (Mode.DRIVING, 1.0)


@pytest.mark.parametrize("acceleration", [0.5, 2.0, 8.0])
def test_a_car_that_drives_off_is_not_blocked(acceleration):
    """Even a weak one, with 0.2 s of dead time."""
    car = Car()
    car.drive(0.2)
    for _ in range(200):
        car.speed = min(car.speed + acceleration * PERIOD, 4.0)
        assert car.step().mode is Mode.DRIVING


def test_a_car_that_is_told_to_stand_may():
    assert first_stop(Car(wanted=0.0).drive(10.0)) is None


@pytest.mark.parametrize("speed", [0.2, 0.5, 1.0])
def test_a_car_that_creeps_as_told_is_not_blocked(speed):
    assert first_stop(Car(wanted=speed).drive(10.0, speed=speed)) is None


def test_a_car_that_is_much_slower_than_told_is_not_blocked():
    """A speed controller far off, with a flat battery."""
    assert first_stop(Car(wanted=6.0).drive(10.0, speed=1.5)) is None


# -- the pose stays, except for jitter -----------------------------------------------------------


@pytest.mark.parametrize("speed", [1.0, 2.0, 4.0, 8.0])
@pytest.mark.parametrize("jitter", [0.0, 0.001])
def test_a_frozen_pose_shows_by_the_velocity(speed, jitter):
    car, noise = Car(wanted=speed), random.Random(1)
    car.drive(1.0, speed=speed)
    at = car.x
    decisions = [car.step(x=at + noise.uniform(-jitter, jitter)) for _ in range(20)]
    t, reason = first_stop(decisions)
    assert reason is Reason.FROZEN_POSE
    assert 0.2 <= t <= 0.2 + 2 * PERIOD


@pytest.mark.parametrize("jitter", [0.001, 0.01])
def test_without_a_velocity_it_shows_by_the_way_that_should_have_been_driven(jitter):
    car, noise = Car(), random.Random(1)
    car.drive(1.0, speed=4.0)
    at = car.x
    decisions = [car.step(x=at + noise.gauss(0.0, jitter), v_x=0.0) for _ in range(40)]
    t, reason = first_stop(decisions)
    assert reason in (Reason.FROZEN_POSE, Reason.BLOCKED)
    assert t <= 0.5


def test_noise_of_a_centimeter_does_not_freeze_a_moving_car():
    car, noise = Car(wanted=1.0), random.Random(2)
    car.speed = 1.0
    for _ in range(4000):
        assert car.step(x=car.x + noise.gauss(0.0, 0.01)).mode is Mode.DRIVING


def test_repeated_poses_of_a_slow_localization_do_not_freeze():
    """Odometry at 40 Hz with the pose of a filter at 10 Hz."""
    car = Car()
    car.speed = 4.0
    for k in range(400):
        at = car.x - (k % 4) * 4.0 * PERIOD
        assert car.step(x=at).mode is Mode.DRIVING


@pytest.mark.parametrize("v_x", [1.0, -1.0])
@pytest.mark.parametrize(("moved", "frozen"), [(0.0031, 0.0), (0.0029, 0.01)])
def test_a_pose_moves_by_more_than_3_mm(v_x, moved, frozen):
    motion = PoseMotion()
    assert motion.frozen(0.0, 0.0, 5.0, v_x) == 0.0
    assert motion.frozen(0.005, 0.0, 5.0, v_x) == 0.005
    assert motion.frozen(0.01, 0.0, 5.0 + moved, v_x) == frozen


def test_3_mm_are_no_motion():
    motion = PoseMotion()
    motion.frozen(0.0, 0.0, 5.0, 1.0)
    assert motion.frozen(0.01, 0.003, 5.0, 1.0) == 0.01


def test_corrections_of_a_car_that_stands_are_no_motion():
    """Also several in a row, and after driving; each gives a single velocity sample."""
    motion = PoseMotion()
    for k in range(40):
        motion.frozen(0.025 * k, 0.1 * k, 0.0, 4.0)
    at, found = 3.9, []
    for k in range(40, 400):
        jumped = k >= 240 and k % 12 == 0
        at += 2.0 * jumped
        found.append(motion.frozen(0.025 * k, at, 0.0, 4.0 * jumped, jumped))
    assert max(found[160:]) == 0.0


def test_a_pose_moves_by_more_than_a_tenth_of_the_way():
    """Of at most the last meter, in any direction."""
    for v_x in (4.0, -4.0):
        for way, least in ((0.5, 0.05), (3.0, 0.1)):
            for moved, frozen in ((least + 1e-3, False), (least - 1e-3, True)):
                motion = PoseMotion()
                motion.frozen(0.0, 0.0, 0.0, v_x)
                assert (motion.frozen(way / 4.0, moved, 0.0, v_x) > 0.0) is frozen


def test_a_velocity_that_ended_with_the_poses_counts_for_the_way():
    motion = PoseMotion()
    for k in range(20):
        motion.frozen(0.025 * k, 0.1 * k, 0.0, 4.0)
    frozen = [motion.frozen(0.5 + 0.025 * k, 1.9 + 0.005 * (k % 2), 0.0, 0.0) for k in range(20)]
    assert frozen[-1] == pytest.approx(0.5)


def test_a_car_that_is_carried_away_is_no_longer_frozen():
    motion = PoseMotion()
    for k in range(20):
        motion.frozen(0.025 * k, 0.1 * k, 0.0, 4.0)
    for k in range(20, 400):
        frozen = motion.frozen(0.025 * k, 1.9, 0.0, 4.0)
    assert frozen > 5.0
    assert motion.frozen(10.0, 2.01, 0.0, 4.0) == 0.0


def test_a_velocity_that_ended_with_the_poses_is_forgotten_after_a_while():
    """The car may have stopped by itself, as at a wall: another try shows it."""
    motion = PoseMotion()
    for k in range(20):
        motion.frozen(0.025 * k, 0.1 * k, 0.0, 4.0)
    frozen = [motion.frozen(0.5 + 0.025 * k, 1.9, 0.0, 0.0) for k in range(200)]
    assert max(frozen) == pytest.approx(3.0, abs=2 * PERIOD)
    assert frozen[-40:] == [0.0] * 40


# -- faster than commanded, or backwards ---------------------------------------------------------


def test_a_motor_that_runs_away_stops_the_car_until_resumed():
    car = Car(wanted=2.0)
    car.drive(1.0, speed=2.0)
    t, reason = first_stop(car.drive(1.0, speed=4.5))
    assert reason is Reason.OVERSPEED
    assert PATIENCE <= t <= PATIENCE + 2 * PERIOD
    car.drive(2.0, speed=0.0)
    assert car.step()[:2] == (Mode.STOPPED, Reason.OVERSPEED)
    car.supervisor.resume()
    assert car.step().mode is Mode.DRIVING


def test_a_car_that_stands_is_not_too_fast():
    car = Car(wanted=2.0, max_overspeed_mps=0.5)
    car.drive(1.0, speed=2.0)
    car.supervisor.request_stop("service")
    car.drive(3.0, speed=0.0)
    car.supervisor.resume()
    assert car.step().mode is Mode.DRIVING


def test_within_the_limit_it_may_be_faster():
    car = Car(wanted=2.0)
    assert first_stop(car.drive(5.0, speed=3.99)) is None


def test_a_short_excess_is_none():
    car = Car(wanted=2.0)
    for _ in range(5):
        assert first_stop(car.drive(PATIENCE - PERIOD, speed=4.5)) is None
        assert first_stop(car.drive(0.1, speed=2.0)) is None


def test_rolling_backwards_is_not_taken_for_a_wall():
    """So it need not try again at walking pace."""
    car = Car()
    assert car.drive(3.0, v_x=-0.7)[-1].reason is Reason.BACKWARDS
    assert car.drive(0.7)[-1][::3] == (Mode.DRIVING, 4.0)


def test_rolling_backwards_stops_until_it_ends():
    car = Car()
    car.drive(1.0, speed=2.0)
    t, reason = first_stop(car.drive(1.0, speed=-0.6))
    assert reason is Reason.BACKWARDS
    assert PATIENCE <= t <= PATIENCE + 2 * PERIOD
    assert car.drive(1.0, speed=0.0)[-1].mode is Mode.DRIVING


def test_a_car_that_waits_may_be_pushed():
    car = Car()
    car.supervisor.request_stop("topic")
    for _ in range(200):
        car.speed = -3.0
        assert car.step()[:2] == (Mode.WAITING, Reason.STOP_REQUESTED)
    car.supervisor.resume()
    car.speed = 0.0
    assert car.step().mode is Mode.DRIVING


@pytest.mark.parametrize(("moved", "moves"), [(0.049, False), (0.05, False), (0.051, True)])
def test_noise_of_5_cm_is_no_motion(moved, moves):
    for x, y in ((0.0, moved), (moved, 0.0)):
        obedience = Obedience()
        obedience.update(0.0, 0.0, 0.0, 1.0)
        assert not obedience.moves
        obedience.update(0.1, x, y, 1.0)
        assert obedience.moves is moves


def test_a_car_moves_by_a_fifth_of_what_it_should_have_driven():
    obedience = Obedience()
    for k in range(201):
        obedience.update(0.01 * k, 7.0, 5.0, 1.0)
    assert obedience.undriven == pytest.approx(2.0 - 1.0 / 3.0, abs=0.02)
    obedience.update(2.0, 7.0, 5.3, 1.0)
    assert not obedience.moves and obedience.undriven > 1.6
    obedience.update(2.0, 7.0, 5.35, 1.0)
    assert obedience.moves and obedience.undriven == 0.0
    # Two poses with the same time give no speed.
    obedience.update(2.0, 9.0, 5.0, 1.0)
    assert obedience.moves


def test_blocked_is_a_distance_and_a_time():
    obedience = Obedience()
    obedience.update(0.0, 0.0, 0.0, 1.0)
    obedience.undriven = 1.0
    assert obedience.blocked(0.21, 1.0, 0.2)
    assert not obedience.blocked(0.2, 1.0, 0.2)
    assert not obedience.blocked(0.21, 1.01, 0.2)


def test_half_a_second_of_patience():
    obedience = Obedience()
    told = [(obedience.too_fast(t, 2.5, 2.0), obedience.backwards(t, -0.6)) for t in (0, 0.5, 0.51)]
    assert told == [(False, False), (False, False), (True, True)]
    assert not obedience.too_fast(0.6, 2.0, 2.0) and not obedience.backwards(0.6, -0.5)
    assert not obedience.too_fast(0.7, 2.5, 2.0) and not obedience.backwards(0.7, -0.6)


def test_the_distance_that_should_have_been_driven():
    """From rest with 1.5 m/s^2 up to the command: after 2 s at 1 m/s, 1/3 m less than 2 m."""
    obedience = Obedience()
    for k in range(2001):
        obedience.update(0.001 * k, 0.0, 0.0, 1.0)
    assert obedience.undriven == pytest.approx(2.0 - 1.0 / 3.0, abs=2e-3)
    obedience.update(2.0, 0.5, 0.0, 1.0)
    assert obedience.undriven == 0.0 and obedience.moves


@pytest.mark.parametrize(("pause", "frozen"), [(0.15, 0.0), (0.16, 0.14)])
def test_a_velocity_counts_once_the_car_has_moved_for_150_ms(pause, frozen):
    motion = PoseMotion()
    motion.frozen(0.0, 0.0, 0.0, 4.0)
    motion.frozen(pause, 0.6, 0.0, 4.0)
    assert motion.frozen(0.3, 0.6, 0.0, 0.0) == pytest.approx(frozen)


@pytest.mark.parametrize(("since", "frozen"), [(2.99, 2.99), (3.0, 0.0)])
def test_a_velocity_that_ended_counts_for_3_s(since, frozen):
    motion = PoseMotion()
    motion.frozen(-1.0, 0.0, 0.0, 4.0)
    motion.frozen(0.0, 4.0, 0.0, 4.0)
    assert motion.frozen(since, 4.0, 0.0, 0.0) == frozen


def test_a_car_that_stood_moves_by_its_first_centimeters():
    motion = PoseMotion()
    for k in range(10):
        motion.frozen(0.1 * k, 0.0, 0.0, 0.0)
    assert motion.frozen(0.925, 0.02, 0.0, 1.2) == 0.0


def test_what_happened_while_the_car_was_told_to_stand_is_no_obedience():
    obedience = Obedience()
    obedience.update(0.0, 0.0, 0.0, 0.0)
    obedience.update(1.0, 5.0, 0.0, 1.0)
    assert not obedience.moves and obedience.undriven == 0.0


# -- heading against the motion --------------------------------------------------------------------


def asides(poses, v_x=4.0, jumped=()):
    course = Course()
    return [course.aside(*pose, v_x, k in jumped) for k, pose in enumerate(poses)]


def test_on_a_circle_the_heading_is_the_way():
    """For chords of half a meter, it equals the heading at their middle, also across half a
    turn."""
    turns = [0.25 * k for k in range(60)]
    poses = [(2.0 * math.sin(a), 2.0 - 2.0 * math.cos(a), a) for a in turns]
    assert max(asides(poses)) < 1e-9
    backwards = [(x, y, psi + math.pi) for x, y, psi in poses]
    assert max(asides(backwards, v_x=-4.0)) < 1e-9
    assert asides(backwards)[-1] == asides(poses, v_x=-4.0)[-1] == pytest.approx(math.pi)


def test_an_angle_counts_after_two_half_meters_one_beside_the_other():
    assert (APART, MOVING) == (0.5, 1.0)
    poses = [(0.125 * k, 0.0, 1.0) for k in range(9)]
    assert asides(poses) == [0.0] * 8 + [1.0]
    assert asides(poses, v_x=1.0)[-1] == 1.0 and asides(poses, v_x=-0.99)[-1] == 0.0
    # The smaller one counts.
    poses += [(1.5, 0.0, -0.7), (2.0, 0.0, -0.7)]
    assert asides(poses)[-2:] == pytest.approx([0.15, 0.15])


def test_a_way_is_as_long_anywhere_and_in_any_direction():
    course = Course()
    told = [course.aside(7.0, -9.0 + 0.25 * k, 0.5 * math.pi + 0.3, 2.0) for k in range(5)]
    assert told == pytest.approx([0.0, 0.0, 0.0, 0.0, 0.3])


def test_a_small_correction_of_the_position_is_in_one_of_them():
    poses = [(0.125 * k, 0.45 if k > 10 else 0.0, 0.0) for k in range(40)]
    assert max(asides(poses)) == 0.0


def test_a_jump_is_no_way():
    poses = [(0.5 * k, 5.0 * (k > 4), 1.0) for k in range(8)]
    assert asides(poses, jumped=(5,)) == [0.0, 0.0, 1.0, 1.0, 1.0, 0.0, 0.0, 1.0]


@pytest.mark.parametrize(("off", "stops"), [(0.79, False), (0.81, True), (-2.5, True)])
def test_a_heading_against_the_motion_stops_with_the_steering_held(off, stops):
    """As with a localization that turned around; it tries again by itself after 3 s."""
    car = Car(wanted=2.0, max_turn_rad=0.8)
    psi = 0.0
    decisions = []
    for k in range(80):
        psi = off if k >= 40 else 0.0
        state = CarState(car.now, 0.05 * k, 0.0, psi, 2.0, 0.0, 0.0)
        trusted = car.supervisor.observe(car.now, state)
        angle = 0.1 if psi == 0.0 else 0.3
        result = ControlResult(angle, 2.0, Status.OK, state, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0)
        decisions.append(car.supervisor.decide(car.now, result if trusted else None))
        car.now += PERIOD
    assert decisions[39].mode is Mode.DRIVING
    jumps = abs(off) > 0.8
    assert (decisions[40].reason is Reason.JUMP) is jumps
    assert (decisions[-1].reason is Reason.HEADING) is stops
    if not stops:
        assert decisions[-1].mode is Mode.DRIVING and decisions[-1].steering_angle == 0.3
        return
    # It steers by the pose for a moment: a jump must settle, and the motion takes a meter.
    told = next(k for k, d in enumerate(decisions) if d.reason is Reason.HEADING)
    assert told <= 61 and decisions[-1][2:] == decisions[told][2:3] + (0.0,)
    last, supervisor = car.now - PERIOD, car.supervisor
    assert supervisor.trouble(last + REST) is Reason.HEADING
    if off > 0.0:
        supervisor.resume()
        assert supervisor.trouble(last + REST) is Reason.NONE
    assert supervisor.trouble(last + REST + 0.01) is Reason.NONE
