"""Sizes of cars."""

import math
from dataclasses import replace

import pytest

from map_racing.control.parameters import (
    load_controller_parameters,
    load_safety_limits,
    save_controller_parameters,
)
from map_racing.control.safety_limits import SafetyLimits
from map_racing.control.steering_ramp import RampParameters
from map_racing.control.supervised import build_slowing
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.size import ONE_TENTH, size_of


@pytest.mark.parametrize("name", ["nuc4", "sim", "f1tenth_drift"])
def test_1_10_cars_are_the_measure(name):
    vehicle = load_vehicle(name)
    assert size_of(vehicle) is ONE_TENTH
    assert RampParameters.of(vehicle) == RampParameters()
    assert RampParameters.of(vehicle, speed_mps=4.0) == RampParameters(speed_mps=4.0)


def test_safety_limits_are_those_of_the_size(tmp_path):
    """For shipped controllers; the user's own files are used unchanged."""
    assert load_safety_limits("map", load_vehicle("nuc4")) == SafetyLimits()
    car = load_vehicle("bmw_320i")
    length, time = size_of(car)
    limits = load_safety_limits("map", car)
    assert limits == replace(
        SafetyLimits(),
        max_jump_m=0.5 * length,
        max_deviation_m=1.5 * length,
        max_blocked_m=1.0 * length,
        max_overspeed_mps=2.0 * time,
        max_saturated_s=1.5 * time,
    )
    own = tmp_path / "own.yaml"
    save_controller_parameters(load_controller_parameters("map", car), own, SafetyLimits())
    assert load_safety_limits(own, car) == SafetyLimits()


def test_a_stop_of_a_road_car_turns_its_wheels_slower():
    car = load_vehicle("bmw_320i")
    slowing = build_slowing(load_controller_parameters("map", car), car)
    _, time = size_of(car)
    assert slowing.sudden == 2.0 * time
    assert slowing.steering(0.5, 0.5, 0.0, 0.0, 0.1) == pytest.approx(0.15 / time)


def test_cars_up_to_twice_the_wheelbase_drive_with_the_same_values():
    vehicle = load_vehicle("nuc4")
    assert size_of(replace(vehicle, l_f=0.05, l_r=0.05)) is ONE_TENTH
    assert size_of(replace(vehicle, l_f=0.32, l_r=0.32)) is ONE_TENTH


def test_at_equal_accelerations_speeds_grow_with_the_root_of_lengths():
    car = load_vehicle("bmw_320i")
    length, time = size_of(car)
    assert length == pytest.approx(car.l_wb / 0.32)
    # v^2 / r is the same.
    assert time**2 / length == pytest.approx(1.0)


@pytest.mark.parametrize("speed", [8.0, 16.0, 33.0])
def test_ramps_of_a_road_car_begin_and_rise_at_the_same_accelerations_at_any_speed(speed):
    car = load_vehicle("bmw_320i")
    ramp = RampParameters.of(car, speed_mps=speed)
    per_angle = speed**2 / car.l_wb
    assert ramp.start_rad * per_angle == pytest.approx(1.3, rel=1e-9)
    assert ramp.rate_radps * per_angle <= 0.2 + 1e-9
    assert math.atan(car.l_wb * 10.0 / speed**2) < ramp.limit_rad <= 0.4
    assert RampParameters.of(car, speed_mps=speed, start_rad=0.02).start_rad == 0.02
