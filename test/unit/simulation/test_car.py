"""The simulated car's clock, and commands at arbitrary times."""

import math

import numpy as np
import pytest

from map_racing.simulation.car import COMMAND_TIMEOUT, DrivenCar, SimulatedCar, hits_wall
from map_racing.simulation.plant import Localization, Plant, PlantParameters
from map_racing.simulation.plants import build_plant, load_plant
from map_racing.track.raceline import Raceline

ANGLE = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
RADIUS = 20.0


def circle(width=1.0):
    """Counter-clockwise, from (RADIUS, 0) heading +y."""
    return Raceline(
        RADIUS * np.cos(ANGLE),
        RADIUS * np.sin(ANGLE),
        d_left_m=np.full(ANGLE.size, width),
        d_right_m=np.full(ANGLE.size, width),
    )


def driven(raceline=None, **parameters):
    parameters = PlantParameters("nuc4", **parameters)
    car = DrivenCar(
        SimulatedCar(Plant(parameters), Localization(parameters, 1)), raceline or circle()
    )
    car.put(RADIUS, 0.0, 0.5 * math.pi)
    return car


def drive(car, seconds, speed, angle=0.0):
    """Command at every observation; return the observations."""
    seen = []
    end = car.car.tick + round(seconds / car.car.plant.time_step)
    for observation in car.advance_to(end):
        car.command(angle, speed)
        seen.append(observation)
    return seen


@pytest.mark.parametrize("rate", [40.0, 50.0, 100.0, 73.0])
def test_poses_come_at_their_rate_and_are_as_old_as_stated(rate):
    car = driven(localization_rate_hz=rate, localization_latency_s=0.015)
    step = car.car.plant.time_step
    arrivals = []
    for seen in car.advance_to(5000):
        arrivals.append((car.car.now, seen))
    times = np.array([seen.measured.t for _, seen in arrivals])
    # Each is at the last tick before it is due.
    due = np.arange(times.size) / rate
    assert np.all(times <= due + 1e-9) and np.all(due < times + step)
    for now, seen in arrivals:
        assert seen.arrival == pytest.approx(seen.measured.t + 0.015)
        assert now <= seen.arrival + 1e-9 < now + step + 2e-9


def test_it_can_sleep_until_the_next_event():
    """Waking only for events gives the same as waking at each tick."""
    parameters = PlantParameters("nuc4", localization_latency_s=0.011)
    each, few = (SimulatedCar(Plant(parameters), Localization(parameters, 1)) for _ in range(2))
    expected = []
    for _ in range(500):
        taken, arrived = each.observe()
        if taken or arrived:
            expected.append(each.tick)
        each.advance(0.0, 1.0)
    woken = []
    while few.tick < 500:
        if few.tick == few.next_event:
            woken.append(few.tick)
            few.observe()
        few.advance(0.0, 1.0)
    assert woken == expected


def test_a_command_holds_for_a_while_then_the_car_stops():
    car = driven()
    drive(car, 2.0, 3.0)
    assert car.car.plant.state.v_x == pytest.approx(3.0, abs=0.01)
    begin = car.car.tick
    car.command(0.0, 3.0)
    timeout = round(COMMAND_TIMEOUT / car.car.plant.time_step)
    list(car.advance_to(begin + timeout))
    assert car.car.plant.state.v_x == pytest.approx(3.0, abs=0.01)
    list(car.advance_to(begin + timeout + 50))
    assert car.car.plant.state.v_x < 2.5
    list(car.advance_to(begin + timeout + 1000))
    assert car.car.plant.state.v_x == pytest.approx(0.0, abs=0.01)


def test_the_wheels_stay_when_commands_stop():
    car = driven()
    drive(car, 0.5, 1.0, 0.2)
    list(car.advance_to(car.car.tick + 500))
    assert car.car.plant.steering_angle == pytest.approx(0.2)


@pytest.mark.parametrize("bad", [(math.nan, 1.0), (0.0, math.inf), (math.nan, math.nan)])
def test_what_is_not_finite_is_no_command(bad):
    car = driven()
    car.command(*bad)
    list(car.advance_to(100))
    assert car.car.plant.state.v_x == 0.0


def test_a_wall_stops_the_car_until_it_is_put_elsewhere():
    car = driven()
    # Straight on from the circle, the car reaches the right wall, a meter away, after about 6 m.
    drive(car, 4.0, 4.0)
    assert car.crashed
    stood = car.car.plant.reference_state()
    assert math.hypot(stood.x, stood.y) == pytest.approx(RADIUS + 0.85, abs=0.1)
    drive(car, 1.0, 4.0)
    after = car.car.plant.reference_state()
    assert (after.x, after.y, after.v_x) == (stood.x, stood.y, 0.0)

    car.put(0.0, RADIUS, math.pi)
    assert not car.crashed
    drive(car, 0.5, 2.0)
    assert not car.crashed and car.car.plant.reference_state().x < -0.3


def test_time_goes_on_when_the_car_is_put_elsewhere():
    car = driven()
    drive(car, 1.0, 1.0)
    car.put(0.0, RADIUS, math.pi)
    seen = drive(car, 0.5, 0.0)
    assert seen[0].measured.t >= 1.0 and seen[0].true.t == seen[0].measured.t
    assert (seen[0].true.x, seen[0].true.y) == pytest.approx((0.0, RADIUS))
    assert [s.measured.t for s in seen] == sorted(s.measured.t for s in seen)


def test_the_public_simulator_too():
    car = DrivenCar(SimulatedCar(*build_plant(load_plant("public_simulator"), 1)), circle(30.0))
    car.put(RADIUS, 0.0, 0.5 * math.pi)
    drive(car, 1.0, 2.0)
    car.put(0.0, RADIUS, math.pi)
    seen = drive(car, 1.0, 2.0)
    assert seen[0].measured.t == pytest.approx(1.0, abs=0.03)
    assert math.isnan(seen[0].measured.v_y) and seen[-1].true.v_x > 1.0


def test_a_wall_is_half_a_car_closer():
    raceline = circle(1.0)
    assert not hits_wall(raceline, 0.0, 0.84, 0.3) and hits_wall(raceline, 0.0, 0.86, 0.3)
    assert not hits_wall(raceline, 0.0, -0.84, 0.3) and hits_wall(raceline, 0.0, -0.86, 0.3)
    assert not hits_wall(Raceline(np.cos(ANGLE), np.sin(ANGLE)), 0.0, 50.0, 0.3)
