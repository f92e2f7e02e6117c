"""Grip that changes at a time or place."""

import dataclasses
import math

import pytest

from map_racing.errors import ParameterError
from map_racing.simulation.grip import Grip, GripChange
from map_racing.simulation.plant import Plant, PlantParameters
from map_racing.simulation.plants import load_plant
from map_racing.simulation.public_simulator import PublicSimulator
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.steady_state import steady_state_table

NUC4 = load_vehicle("nuc4")
SIMULATOR = load_plant("public_simulator")


def settled(plant, grip, speed=4.0, angle=0.03):
    """Lateral acceleration with the steering held [m/s^2]."""
    plant.reset(0.0, 0.0, 0.0, speed=speed)
    plant.set_grip(grip)
    for _ in range(round(1.5 / plant.time_step)):
        plant.advance(angle, speed)
    return plant.acceleration[1]


@pytest.mark.parametrize("grip", [0.5, 0.8, 1.0, 1.1])
def test_the_car_turns_as_the_table_of_that_friction_has_it(grip):
    plant = Plant(PlantParameters(vehicle="nuc4"))
    slippery = dataclasses.replace(NUC4, mu=NUC4.mu * grip)
    table = steady_state_table(slippery, [4.0, 5.0], [0.0, 0.08, 0.1])
    settled(plant, 0.3)  # the initial state no longer matters
    assert settled(plant, grip, 4.0, 0.08) == pytest.approx(table.a_lat[1, 0], rel=1e-3)


def test_the_linear_car_gets_softer_by_the_same_share():
    whole = PublicSimulator(SIMULATOR)
    scaled = PublicSimulator(dataclasses.replace(SIMULATOR, mu_scale=0.7))
    assert settled(whole, 0.7) == pytest.approx(settled(scaled, 1.0), rel=1e-9)
    assert abs(settled(whole, 0.7) - settled(whole, 1.0)) > 0.05


@pytest.mark.parametrize(
    "change, inside, outside",
    [
        (dict(after_s=5.0), [(5.0, 0.0), (99.0, 3.0)], [(4.99, 0.0)]),
        (dict(after_s=5.0, until_s=6.0), [(5.9, 0.0)], [(6.0, 0.0)]),
        (dict(from_m=2.0, to_m=3.0), [(0.0, 2.0), (99.0, 2.9)], [(0.0, 3.0), (0.0, 1.9)]),
        (dict(from_m=9.0, to_m=1.0), [(0.0, 9.5), (0.0, 0.5)], [(0.0, 1.0), (0.0, 8.9)]),
        (dict(from_m=2.0, to_m=3.0, after_s=5.0), [(5.0, 2.5)], [(4.0, 2.5), (5.0, 3.5)]),
    ],
)
def test_time_and_place(change, inside, outside):
    change = GripChange(0.8, **change)
    assert all(change.holds(*at) for at in inside)
    assert not any(change.holds(*at) for at in outside)


def test_changes_multiply_and_end():
    parameters = PlantParameters(
        vehicle="nuc4",
        grip_changes=[{"factor": 0.8, "after_s": 1.0}, {"factor": 0.5, "from_m": 2.0, "to_m": 3.0}],
    )
    plant = Plant(parameters)
    seen = []
    plant.set_grip = seen.append
    grip = Grip(plant)
    for t, s in ((0.0, 0.0), (0.0, 2.5), (1.0, 2.5), (1.0, 4.0)):
        grip.update(t, s)
    grip.update(1.0, 4.0, 0.5)
    assert seen == pytest.approx([1.0, 0.5, 0.4, 0.8, 0.4])


def test_twice_the_grip_at_walking_pace():
    """The integration must be stable there, too."""
    plant = Plant(PlantParameters(vehicle="nuc4"))
    assert settled(plant, 2.0, 0.8, 0.1) == pytest.approx(settled(plant, 1.0, 0.8, 0.1), rel=0.05)


@pytest.mark.parametrize(
    "values, expected",
    [
        (0.8, "expected a list"),
        ([0.8], "entry 1: expected a mapping"),
        ([{"after_s": 1.0}], "entry 1: expected a mapping"),
        ([{"factor": 0.8, "place": 1.0}], "entry 1: expected a mapping"),
        ([{"factor": 0.8}, {"factor": math.nan}], "entry 2: factor"),
        ([{"factor": 0.8, "after_s": 2.0, "until_s": 1.0}], "entry 1: until_s"),
    ],
)
def test_impossible_changes_are_refused_by_number_and_name(values, expected):
    with pytest.raises(ParameterError, match=expected):
        PlantParameters(vehicle="nuc4", grip_changes=values)
