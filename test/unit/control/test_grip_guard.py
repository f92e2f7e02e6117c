"""The guard: inactive within the grip, slows down to what holds beyond it, robust to noise."""

import math
import random
from dataclasses import replace

import numpy as np
import pytest

from map_racing.control.controller import Controller
from map_racing.control.grip_guard import GripGuard
from map_racing.control.parameters import ControllerParameters, load_controller_parameters
from map_racing.control.speed_plan import WALKING_PACE
from map_racing.control.state import CarState
from map_racing.control.steering import build_steering_map
from map_racing.simulation.car import SimulatedCar, hits_wall
from map_racing.simulation.plant import Localization, Plant
from map_racing.simulation.plants import load_plant
from map_racing.simulation.race import Outcome, race
from map_racing.track.files.load import load_raceline
from map_racing.track.tracker import RacelineTracker
from map_racing.vehicle.parameters import load_vehicle

NUC4 = load_vehicle("nuc4")
TABLE = build_steering_map("table", NUC4, 12.0)
PLANT = load_plant("nuc4")
MAP = load_controller_parameters("map").with_(speed_scale=1.0, grip_use=0.85)
RACELINES = {name: load_raceline(name) for name in ("reference", "club")}


def settled(v, share, planned=9.0, steps=40):
    """Command after a second on a circle that needs a given share of the grip."""
    guard = GripGuard(TABLE, 12.0)
    kappa = share * TABLE.max_lateral_acceleration(v) / v**2
    return [guard.limited(0.025 * k, v, kappa, planned) for k in range(steps)][-1]


@pytest.mark.parametrize("v", [0.7, 3.0, 6.0, 11.0])
@pytest.mark.parametrize("share", [0.0, 0.5, 0.99])
def test_silent_within_the_grip(v, share):
    assert settled(v, share) == 9.0


@pytest.mark.parametrize("share", [1.35, 1.8])
@pytest.mark.parametrize("v", [3.0, 6.0])
def test_beyond_it_the_speed_at_which_the_circle_holds(v, share):
    held = settled(v, share)
    kappa = share * TABLE.max_lateral_acceleration(v) / v**2
    assert held == pytest.approx(v / math.sqrt(share), rel=1e-6)
    # This is exact where the limit no longer grows with speed.
    if v > 5.0:
        assert held**2 * kappa == pytest.approx(TABLE.max_lateral_acceleration(held), rel=0.05)


def test_the_transition_is_continuous():
    commands = [settled(4.0, share, planned=5.0) for share in np.linspace(0.9, 1.6, 141)]
    steps = -np.diff(commands)
    assert np.all(steps >= 0.0) and steps.max() < 0.05
    assert (commands[0], commands[-1]) == (5.0, pytest.approx(4.0 / math.sqrt(1.6)))


def test_never_faster_than_planned_and_a_car_can_always_turn_round():
    assert settled(4.0, 1.9, planned=1.5) == 1.5
    assert settled(0.2, 50.0, planned=3.0) == WALKING_PACE
    assert settled(-3.0, 50.0, planned=3.0) <= 3.0
    assert settled(30.0, 1.9, planned=9.0) == 9.0
    assert settled(4.0, 1.9, planned=0.0) == 0.0


def test_a_single_wild_pose_does_little_and_a_slide_is_answered_within_a_tenth():
    guard = GripGuard(TABLE, 12.0)
    wild = 4.0 * TABLE.max_lateral_acceleration(4.0) / 16.0
    commands = [guard.limited(0.025 * k, 4.0, wild if k == 10 else 0.0, 4.0) for k in range(20)]
    assert min(commands) == 4.0
    commands = [guard.limited(0.5 + 0.025 * k, 4.0, wild, 4.0) for k in range(5)]
    assert commands[-1] < 3.2


@pytest.mark.parametrize("times", [[0.0, 0.0, -5.0, math.inf], [1.7e9, 1.7e9 + 0.025, 0.0]])
def test_times_that_repeat_or_go_back(times):
    guard = GripGuard(TABLE, 12.0)
    for t in times:
        if math.isfinite(t):
            assert 0.0 < guard.limited(t, 4.0, 0.1, 4.0) <= 4.0


def test_only_with_grip_use():
    line = RACELINES["reference"]
    point = line.pose(0.0)
    # 0.4 m beside the line and turned away from it
    state = CarState(0.0, point.x, point.y, point.psi + 1.0, 4.0, 0.0, 0.0)
    plain = ControllerParameters("table", m_m=0.2, q_s=0.17, speed_lookahead_s=0.1, delay_s=0.05)
    off = Controller(plain, TABLE, NUC4, line).step(state)
    on = Controller(plain.with_(grip_use=0.9), TABLE, NUC4, line).step(state)
    assert on.speed < 3.2 < off.speed
    assert on.steering_angle == off.steering_angle


def test_a_change_while_sliding_does_not_let_go():
    line = RACELINES["reference"]
    subject = Controller(MAP, TABLE, NUC4, line)
    point = line.pose(0.0)

    def command(k):
        state = CarState(0.025 * k, point.x, point.y, point.psi + 1.0, 4.0, 0.0, 0.0)
        return subject.step(state).speed

    before = [command(k) for k in range(8)][-1]
    subject.change(parameters=MAP.with_(grip_use=0.9))
    assert command(8) == pytest.approx(before, abs=0.02)


# -- closed loop -----------------------------------------------------------------------------------


class _Bold(Controller):
    """Always drives its plan."""

    def apply(self, setup):
        super().apply(setup)
        self._guard = None


def pair(line, **changes):
    """The unchanged controller, and one without guard."""
    parameters = MAP.with_(**changes)
    return [kind(parameters, TABLE, NUC4, line) for kind in (Controller, _Bold)]


def survives(controller, line, seed, times, offset):
    """Whether a car that starts beside the line at `times` the planned speed gets 10 m ahead."""
    chance = random.Random(seed)
    s = chance.random() * line.length
    left, right = line.widths_at(s)
    d = min(max(chance.choice((-1.0, 1.0)) * offset, 0.2 - right), left - 0.2)
    x, y = (float(value) for value in line.to_cartesian(s, d))
    plant = Plant(PLANT)
    car = SimulatedCar(plant, Localization(PLANT, seed))
    car.put(x, y, line.pose(s).psi)
    speed = times * controller.plan.speed_at(s)
    plant.reset(x, y, line.pose(s).psi, speed)
    controller.reset()
    tracker, angle, driven = RacelineTracker(line), 0.0, 0.0
    while driven < 10.0 and car.now < 20.0:
        taken, arrived = car.observe()
        if taken is not None:
            at, d = tracker.update(*taken.true[1:4])[:2]
            driven += math.remainder(at - s, line.length)
            s = at
            if hits_wall(line, at, d, NUC4.width):
                return False
        for seen in arrived:
            result = controller.step(seen.measured)
            angle, speed = result.steering_angle, result.speed
        car.advance(angle, speed)
    return driven >= 10.0


@pytest.mark.once
def test_cars_that_begin_too_fast_and_beside_the_line_stay_on_the_track():
    line = RACELINES["reference"]
    guarded, bold = (
        sum(survives(subject, line, seed, 1.3, 0.6) for seed in range(24))
        for subject in pair(line, grip_use=0.95)
    )
    assert guarded >= 23 and bold <= 18


@pytest.mark.once
def test_a_floor_with_a_third_less_grip_than_believed_is_survived():
    line = RACELINES["reference"]
    slippery = replace(PLANT, mu_scale=0.68)
    outcomes = [
        race(Plant(slippery), subject, line, Localization(slippery, 1), laps=2).outcome
        for subject in pair(line)
    ]
    assert outcomes == [Outcome.COMPLETED, Outcome.CRASHED]


@pytest.mark.once
@pytest.mark.parametrize("track", ["reference", "club"])
def test_noise_as_shipped_changes_speeds_by_millimeters_per_second(track):
    line = RACELINES[track]
    guarded, bold = pair(line)
    log = race(Plant(PLANT), guarded, line, Localization(PLANT, 1), laps=2)
    less = np.array([bold.step(s.measured).speed - s.result.speed for s in log.samples])
    assert np.all(less >= 0.0)
    assert np.mean(less) < 0.005 and np.mean(less > 0.0) < 0.06 and less.max() < 0.4
