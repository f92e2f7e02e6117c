"""Steering ramps: known angles at known times, the area, the button, and a simulated car."""

import math

import numpy as np
import pytest

from map_racing.control.steering_ramp import (
    Box,
    Circle,
    Phase,
    RampParameters,
    SteeringRamp,
    circle_widths,
    told_room,
)
from map_racing.errors import ParameterError
from map_racing.simulation.plant import Plant, PlantParameters
from map_racing.simulation.plants import load_plant
from map_racing.simulation.ramps import drive_ramps
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.steady_state import steady_state_table

WIDE = Circle(0.0, 0.0, 100.0)
STEP = 0.025


def drive(ramp, seconds, t=0.0, x=0.0, v=None, enabled=True):
    """Commands for a car that follows them instantly."""
    commands = []
    speed = 0.0
    for _ in range(round(seconds / STEP)):
        command = ramp.update(t, x, 0.0, speed if v is None else v, enabled)
        speed = command.speed
        commands.append((t, command))
        t += STEP
    return commands


def test_the_angle_rises_at_the_stated_rate_to_either_side():
    parameters = RampParameters(speed_mps=2.0, rate_radps=0.02, start_rad=0.1, limit_rad=0.3)
    ramp = SteeringRamp(parameters, WIDE)
    commands = drive(ramp, 30.0)
    assert commands[-1][1] == (0.0, 0.0, Phase.DONE) and ramp.completed == 2
    ramping = [(t, c) for t, c in commands if c.phase is Phase.RAMPING]
    assert all(c.speed == 2.0 for _, c in ramping)
    for sign in (1.0, -1.0):
        t, angle = np.array(
            [(t, c.steering_angle) for t, c in ramping if c.steering_angle * sign > 0.0]
        ).T
        assert np.diff(angle) / np.diff(t) == pytest.approx(sign * 0.02, abs=1e-9)
        assert abs(angle[0]) < 0.102 and abs(angle[-1]) == pytest.approx(0.3, abs=0.001)
        # 0.2 rad at 0.02 rad/s.
        assert t[-1] - t[0] == pytest.approx(10.0, abs=2 * STEP)


def test_it_settles_at_speed_before_the_ramp():
    parameters = RampParameters(speed_mps=3.0, settle_s=2.0, acceleration_mps2=1.5)
    commands = drive(SteeringRamp(parameters, WIDE), 6.0)
    first = next(t for t, c in commands if c.phase is Phase.RAMPING)
    # 2 s to reach the speed, 2 s to settle.
    assert first == pytest.approx(4.0, abs=3 * STEP)
    speeds = np.array([c.speed for _, c in commands])
    assert np.all(np.diff(speeds) <= 1.5 * STEP + 1e-12) and speeds.max() == 3.0


@pytest.mark.parametrize(("sides", "sign"), [("left", 1.0), ("right", -1.0)])
def test_one_side(sides, sign):
    ramp = SteeringRamp(RampParameters(sides=sides, limit_rad=0.15), WIDE)
    commands = drive(ramp, 10.0)
    assert ramp.completed == 1 and commands[-1][1].phase is Phase.DONE
    assert all(sign * c.steering_angle >= 0.0 for _, c in commands)


def test_nothing_moves_without_the_button():
    commands = drive(SteeringRamp(RampParameters(), WIDE), 2.0, enabled=False)
    assert {c for _, c in commands} == {(0.0, 0.0, Phase.WAITING)}


@pytest.mark.parametrize(
    ("cause", "phase"),
    [
        ({"enabled": False}, Phase.WAITING),
        ({"x": 200.0}, Phase.OUTSIDE),
        ({"x": math.nan}, Phase.OUTSIDE),
        ({"v": math.nan}, Phase.WAITING),
    ],
)
def test_a_ramp_cut_short_stops_and_begins_anew(cause, phase):
    ramp = SteeringRamp(RampParameters(), WIDE)
    before = drive(ramp, 6.0)[-1][1]
    assert before.phase is Phase.RAMPING and before.steering_angle > 0.1
    stopped = drive(ramp, 1.0, t=6.0, **cause)
    # At once, with unchanged steering.
    assert {c for _, c in stopped} == {(before.steering_angle, 0.0, phase)}
    # All conditions are good again, but it is still rolling.
    rolling = drive(ramp, 1.0, t=7.0, v=0.5)
    assert {c.speed for _, c in rolling} == {0.0}
    again = [c for _, c in drive(ramp, 6.0, t=8.0)]
    assert again[0].phase is Phase.STARTING and again[0].steering_angle == 0.1
    assert again[-1].phase is Phase.RAMPING and ramp.completed == 0


def test_a_pause_of_the_poses_is_no_leap_of_the_steering():
    ramp = SteeringRamp(RampParameters(), WIDE)
    before = drive(ramp, 5.0)[-1][1].steering_angle
    after = ramp.update(60.0, 0.0, 0.0, 2.0, True).steering_angle
    assert after - before <= 0.02 * 0.1 + 1e-12


def test_areas():
    box, circle = Box(-1.0, 2.0, 0.0, 3.0), Circle(1.0, 1.0, 2.0)
    assert box.contains(2.0, 3.0) and not box.contains(2.01, 1.0)
    assert circle.contains(3.0, 1.0) and not circle.contains(3.0, 1.1)
    assert not box.contains(math.nan, 1.0) and not circle.contains(0.0, math.nan)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: RampParameters(speed_mps=0.0), "speed_mps: expected a positive number, got 0"),
        (lambda: RampParameters(rate_radps=math.nan), "rate_radps"),
        (
            lambda: RampParameters(start_rad=0.5),
            "start_rad: expected less than limit_rad",
        ),
        (lambda: RampParameters(settle_s=-1.0), "settle_s"),
        (lambda: RampParameters(sides="up"), "sides: expected both or left or right, got 'up'"),
        (lambda: RampParameters(start_rad=0.4), "start_rad: expected less than limit_rad"),
        (lambda: Box(1.0, 1.0, 0.0, 1.0), "area: expected a box"),
        (lambda: Box(0.0, 1.0, 1.0, 1.0), "area: expected a box"),
        (lambda: Circle(0.0, 0.0, 0.0), "area: expected a circle"),
        (lambda: Circle(0.0, 0.0, math.inf), "area: expected a circle"),
    ],
)
def test_refusals(make, words):
    with pytest.raises(ParameterError, match=words):
        make()


def test_edges_belong_to_the_area():
    box = Box(-1.0, 2.0, -3.0, 4.0)
    for x, y in ((-1.0, 0.0), (2.0, 0.0), (0.0, -3.0), (0.0, 4.0)):
        assert box.contains(x, y) and not box.contains(1.01 * x, 1.01 * y)
    assert (box.room, Box(-3.0, 4.0, -1.0, 2.0).room) == (3.0, 3.0)
    assert Circle(1.0, 0.0, 2.0).contains(3.0, 0.0)
    assert Circle(0.0, 0.0, 0.5).room == 0.5


def test_a_ramp_ends_at_the_last_angle_and_the_next_begins_at_standstill():
    """In exact numbers: 8 steps of 1/64 rad; 0.1 m/s counts as standstill."""
    parameters = RampParameters(
        rate_radps=0.25, start_rad=0.125, limit_rad=0.25, settle_s=0.0, acceleration_mps2=100.0
    )
    ramp = SteeringRamp(parameters, WIDE)
    commands = [ramp.update(k / 16, 0.0, 0.0, 0.1 if k == 0 else 2.0, True) for k in range(11)]
    assert commands[0].phase is Phase.STARTING
    angles = [c.steering_angle for c in commands if c.phase is Phase.RAMPING]
    assert angles == [0.125 + k / 64 for k in range(len(angles))] and len(angles) == 8
    assert commands[9] == (0.25, 0.0, Phase.STOPPING) and ramp.completed == 1
    for v in (0.11, -0.11):
        assert ramp.update(1.0, 0.0, 0.0, v, True).phase is Phase.STOPPING
    assert ramp.update(1.1, 0.0, 0.0, 0.1, True).phase is Phase.STARTING


def test_the_simulated_car_is_taken_through_its_steady_states():
    """At each instant the car is in the steady state of the table."""
    plant = Plant(PlantParameters("nuc4"))
    plant.reset(0.0, 0.0, 0.0)
    ramp = SteeringRamp(RampParameters(sides="left", limit_rad=0.35), Circle(0.0, 3.0, 6.0))
    command, turned = None, []
    for tick in range(round(30.0 / plant.time_step)):
        if tick % 10 == 0:
            state = plant.reference_state()
            command = ramp.update(state.t, state.x, state.y, state.v_x, True)
            if command.phase is Phase.RAMPING:
                turned.append((plant.steering_angle, state.r * state.v_x))
        plant.advance(command.steering_angle, command.speed)
    assert command.phase is Phase.DONE and ramp.completed == 1
    angle, a_lat = np.array(turned[10:]).T
    table = steady_state_table(plant.vehicle, np.array([1.5, 2.0, 2.5]), np.linspace(0.0, 0.4, 161))
    expected = [table.acceleration(2.0, at) for at in angle.tolist()]
    assert a_lat == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("wheelbase", [0.3, 3.0])
def test_a_ramp_ends_where_the_rear_breaks_away(wheelbase):
    """A car that turns geometrically up to 0.2 rad, and beyond that faster and faster."""
    parameters = RampParameters(speed_mps=2.0, rate_radps=0.02, start_rad=0.1, sides="left")
    ramp = SteeringRamp(parameters, WIDE)
    t, speed, angle, reached = 0.0, 0.0, 0.0, []
    while ramp.completed == 0 and t < 30.0:
        excess = max(abs(angle) - 0.2, 0.0)
        r = speed * angle / wheelbase * (1.0 + 20.0 * excess)
        if round(t / STEP) % 20 == 10:
            r = math.nan  # a sensor that fails now and then
        angle, speed, phase = ramp.update(t, 0.0, 0.0, speed, True, r)
        if phase is Phase.RAMPING:
            reached.append(angle)
        t += STEP
    # 1.3 times as fast at 0.215 rad; the average lags by 0.3 s, or 6 mrad.
    assert max(reached) == pytest.approx(0.221, abs=0.003)
    # The wheels straighten, to catch the car.
    assert (angle, speed, phase) == (0.0, 0.0, Phase.STOPPING)


@pytest.mark.parametrize("settles, ends", [(0.29, 0.3), (0.3, 0.22), (1.0, 0.22)])
def test_what_the_car_did_before_it_settled_does_not_count(settles, ends):
    """Its wheels come from the other side; a car that hardly settles never counts as breaking
    away."""
    parameters = RampParameters(
        rate_radps=0.02, start_rad=0.1, limit_rad=0.3, sides="left", settle_s=settles
    )
    ramp = SteeringRamp(parameters, WIDE)
    t, speed, angle, wheels, reached = 0.0, 0.0, 0.0, -0.3, []
    while ramp.completed == 0 and t < 30.0:
        wheels += min(max(angle - wheels, -0.5 * STEP), 0.5 * STEP)
        r = speed * wheels / 0.3 * (1.0 + 20.0 * max(wheels - 0.2, 0.0))
        angle, speed, phase = ramp.update(t, 0.0, 0.0, speed, True, r)
        if phase is Phase.RAMPING:
            reached.append(angle)
        t += STEP
    assert max(reached) == pytest.approx(ends, abs=0.004)


@pytest.mark.parametrize(("start", "silent"), [(0.1, 3.0), (0.0, 0.0)])
def test_without_a_turn_to_compare_with_nothing_breaks_away(start, silent):
    """A yaw rate of 0 until the ramp has begun, and a ramp that begins straight ahead."""
    parameters = RampParameters(start_rad=start, limit_rad=0.3, sides="left", rate_radps=0.1)
    ramp = SteeringRamp(parameters, WIDE)
    t, speed, angle, reached = 0.0, 0.0, 0.0, []
    while ramp.completed == 0 and t < 30.0:
        r = speed * angle / 0.3 if t >= silent else 0.0
        angle, speed, phase = ramp.update(t, 0.0, 0.0, speed, True, r)
        reached.append(angle)
        t += STEP
    assert max(reached) == 0.3


def test_an_understeering_car_is_driven_to_the_last_angle():
    parameters = RampParameters(sides="left", limit_rad=0.3)
    drives = [SteeringRamp(parameters, WIDE) for _ in range(2)]
    t, speed, angle = 0.0, 0.0, 0.0
    while t < 20.0:
        r = speed * math.sin(3.0 * angle)  # ever less yaw rate per steering angle
        seen = [
            ramp.update(t, 0.0, 0.0, speed, True, *given) for ramp, given in zip(drives, ((), (r,)))
        ]
        assert seen[0] == seen[1]
        angle, speed = seen[0][:2]
        t += STEP
    assert drives[0].completed == 1


# -- room ------------------------------------------------------------------------------------------


def farthest(start, sides, speed=3.0):
    """Largest distance of the simulated car from its start [m]."""
    parameters = RampParameters(speed_mps=speed, start_rad=start, sides=sides)
    samples = drive_ramps(load_plant("nuc4"), [parameters])
    return max(math.hypot(sample.true.x, sample.true.y) for sample in samples)


@pytest.mark.once
@pytest.mark.parametrize("start, fits", [(0.1, False), (0.14, True)])
def test_the_first_circle_is_as_wide_as_said(start, fits):
    parameters = RampParameters(speed_mps=3.0, start_rad=start, sides="left")
    text, said = told_room(parameters, load_vehicle("nuc4"), Circle(0.0, 0.0, 8.0).room)
    assert said is fits and (farthest(start, "left") <= 8.0) is fits
    (width,) = circle_widths(parameters, load_vehicle("nuc4"), [start])
    assert f"is {width:.1f} m wide" in text
    # Until it has reached its speed, the car drives a smaller circle.
    assert 0.85 * width < farthest(start, "left") < width
    assert ("start at 0.13 rad, or widen the area to 9.6 m" in text) is not fits


def test_both_sides_take_more_room():
    """With the defaults, the car leaves the area on the second side, which begins where the first
    ends."""
    parameters = RampParameters()
    text, fits = told_room(parameters, load_vehicle("nuc4"), 8.0)
    assert not fits and farthest(0.1, "both", 2.0) > 8.0
    assert "drive each side by itself from the middle of the area, or widen" in text
    width = circle_widths(parameters, load_vehicle("nuc4"), [0.1])[0]
    assert told_room(parameters, load_vehicle("nuc4"), 2.0 * width)[1]


def test_no_angle_fits_a_car_that_is_too_fast():
    parameters = RampParameters(speed_mps=6.0, sides="left")
    text, fits = told_room(parameters, load_vehicle("nuc4"), 8.0)
    assert not fits and "start at" not in text and "widen the area to 20.9 m" in text


def test_the_width_without_slip_is_known():
    """At walking pace a car with stiff tires follows Ackermann: 2 l_wb / tan(delta)."""
    vehicle = load_vehicle("nuc4")
    parameters = RampParameters(speed_mps=0.1)
    angles = [0.1, 0.3]
    expected = 2.0 * vehicle.l_wb / np.tan(angles)
    assert circle_widths(parameters, vehicle, angles) == pytest.approx(expected, rel=2e-3)
