"""Days: drawn from the stated distributions, always the same, and only tires differ."""

import dataclasses
import math

import numpy as np
import pytest

from map_racing.errors import ParameterError
from map_racing.experiments.conditions import day_of, load_conditions
from map_racing.simulation.plant import Plant
from map_racing.simulation.plants import build_plant, load_plant
from map_racing.simulation.public_simulator import PublicSimulator
from map_racing.track.files.load import load_raceline
from map_racing.vehicle.parameters import load_vehicle

PAPER = load_conditions("paper")


def test_shipped_conditions_can_be_driven():
    assert load_raceline(PAPER.track).d_left is not None
    assert load_plant(PAPER.plant).vehicle == load_vehicle("nuc4")
    assert PAPER.seeds == tuple(range(1, 11)) and not set(PAPER.seeds) & set(PAPER.practice_seeds)


def test_factors_have_the_stated_distributions():
    plant = load_plant("nuc4")
    factors = np.array([day_of(plant, PAPER, seed)[1:4] for seed in range(4000)])
    deviations = [0.05, 0.10, 0.10]
    # The standard errors of 4000 draws are 1.6 % of each deviation, and 1.1 % of its own estimate.
    assert np.all(np.abs(factors.mean(axis=0) - 1.0) < 4 * 0.016 * np.array(deviations))
    np.testing.assert_allclose(factors.std(axis=0), deviations, rtol=4 * 0.0112)
    correlations = np.corrcoef(factors.T)[np.triu_indices(3, 1)]
    assert np.abs(correlations).max() < 4 / math.sqrt(4000)


def test_days_are_the_same_for_ever():
    """Published figures must be reproducible from their seed on any Python."""
    day = day_of(load_plant("nuc4"), PAPER, 1)
    assert day[:4] == (1, 0.9757411193499714, 1.011569132200271, 1.0518666957289569)


def test_only_the_tires_differ():
    plant = load_plant("nuc4")
    day = day_of(plant, PAPER, 3)
    assert day.plant.mu_scale == pytest.approx(plant.mu_scale * day.mu_scale)
    unchanged = {
        "mu_scale": plant.mu_scale,
        "front_stiffness_scale": plant.front_stiffness_scale,
        "rear_stiffness_scale": plant.rear_stiffness_scale,
    }
    assert dataclasses.replace(day.plant, **unchanged) == plant
    sim = load_plant("public_simulator")
    day = day_of(sim, PAPER, 3)
    driven, car = day.plant.build_vehicle(), sim.build_vehicle()
    assert driven.mu == pytest.approx(car.mu * day.mu_scale)
    assert pytest.approx(car.front.C_S * day.front_stiffness_scale) == driven.front.C_S
    assert pytest.approx(car.rear.C_S * day.rear_stiffness_scale) == driven.rear.C_S
    assert dataclasses.replace(driven, mu=car.mu, front=car.front, rear=car.rear) == car


def test_plants_are_built_as_what_they_are():
    plant, localization = build_plant(load_plant("nuc4"), 1)
    assert isinstance(plant, Plant) and localization.parameters == plant.parameters
    plant, localization = build_plant(load_plant("public_simulator"), 1)
    assert isinstance(plant, PublicSimulator) and localization is None


def test_a_plant_carries_its_vehicle_with_it(tmp_path):
    (tmp_path / "car.yaml").write_text(
        "name: car\nm: 3.0\nI_z: 0.05\nl_f: 0.16\nl_r: 0.16\nh_cg: 0.02\nmu: 0.9\n"
        "tire_model: linear\nC_Sf: 5.0\nC_Sr: 6.0\n"
    )
    (tmp_path / "plant.yaml").write_text("vehicle: car.yaml\n")
    plant = load_plant(str(tmp_path / "plant.yaml"))
    (tmp_path / "car.yaml").unlink()
    assert plant.build_vehicle().m == 3.0


@pytest.mark.parametrize(
    "changes, expected",
    [
        ({"mu_deviation": 0.3}, "mu_deviation: expected 0 to 0.2, got 0.3"),
        (
            {"rear_stiffness_deviation": -0.1},
            "rear_stiffness_deviation: expected 0 to 0.2",
        ),
        (
            {"front_stiffness_deviation": "much"},
            "front_stiffness_deviation: expected a finite",
        ),
        ({"mu_deviation": math.nan}, "mu_deviation: expected a finite number, got nan"),
        ({"seeds": []}, r"seeds: expected whole numbers from 0, got \[\]"),
        ({"seeds": 3}, "seeds: expected whole numbers from 0, got 3"),
        ({"seeds": [1, 1]}, "seeds: expected different seeds, got 1 twice"),
        ({"practice_seeds": [5, 5]}, "practice_seeds: expected different seeds, got 5 twice"),
        (
            {"seeds": [1, 101]},
            "practice_seeds: expected other days than the races', got 101",
        ),
        ({"seeds": [1.5]}, r"seeds: expected whole numbers from 0, got \[1.5\]"),
        ({"practice_seeds": [True]}, "practice_seeds: expected whole numbers from 0"),
        ({"identification_seed": -1}, "identification_seed: expected 0 or more, got -1"),
        ({"tuning_scale": 0.0}, "tuning_scale: expected more than 0 to 2, got 0"),
        ({"tuning_laps": 0}, "tuning_laps: expected 1 to 1000, got 0"),
        ({"tuning_laps": 10**9}, "tuning_laps: expected 1 to 1000"),
        ({"track": ""}, "track: expected a text, got ''"),
        ({"plant": 3}, "plant: expected a text, got 3"),
    ],
)
def test_impossible_conditions(changes, expected):
    with pytest.raises(ParameterError, match=expected):
        dataclasses.replace(PAPER, **changes)


def test_a_file_says_what_is_wrong_with_it(tmp_path):
    (tmp_path / "c.yaml").write_text("track: reference\nplant: nuc4\nsedes: [1]\n")
    with pytest.raises(ParameterError, match="c.yaml: .* such as paper: unknown parameter sedes"):
        load_conditions(tmp_path / "c.yaml")
    with pytest.raises(ParameterError, match="of the shipped experiments .full_scale, paper, "):
        load_conditions("papr")


@pytest.mark.parametrize(
    "text, expected",
    [
        ("model: rocket\nvehicle: sim\n", "model: expected single_track, public_simulator, co"),
        ("model: [rocket]\nvehicle: sim\n", "model: expected single_track, public_simulator, co"),
        ("model: commonroad\nvehicle: sim\nparameters: [a]\n", "parameters: expected ford_escort"),
        ("model: public_simulator\nvehicle: sim\nmu: 1\n", "unknown parameter mu "),
        ("model: public_simulator\nvehicle: sim\nh_cg_m: low\n", "h_cg_m: expected a finite"),
        ("model: public_simulator\nvehicle: sim\nsteering_delay_s: 50\n", "0 to 1 s"),
        ("model: public_simulator\nvehicle: sim\nlocalization_rate_hz: 200\n", "1 to 100 Hz"),
    ],
)
def test_a_plant_file_says_what_is_wrong_with_it(tmp_path, text, expected):
    path = tmp_path / "plant.yaml"
    path.write_text(text)
    with pytest.raises(ParameterError, match=f"plant.yaml: .*{expected}"):
        load_plant(path)


def test_the_public_simulator_has_linear_tires(tmp_path):
    path = tmp_path / "plant.yaml"
    path.write_text("model: public_simulator\nvehicle: nuc4\n")
    with pytest.raises(ParameterError, match="expected a vehicle with linear tires, got NUC4"):
        build_plant(load_plant(path), 1)
