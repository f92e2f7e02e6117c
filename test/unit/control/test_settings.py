"""Settings as text contain everything the car was driven with, and can be read back."""

import numpy as np
import pytest
import yaml

from map_racing import __version__
from map_racing.control.controller import Controller, build_controller
from map_racing.control.laws import build_law
from map_racing.control.parameters import load_controller_parameters, load_law
from map_racing.control.safety_limits import SafetyLimits
from map_racing.control.settings import doubts_of, parse_settings, settings_text
from map_racing.control.speed_sectors import SpeedSectors, load_speed_sectors
from map_racing.track.files.load import load_raceline
from map_racing.vehicle.parameters import load_vehicle, vehicle_values


@pytest.fixture(scope="module")
def line():
    return load_raceline("reference")


@pytest.fixture(scope="module")
def controller(line):
    sectors = SpeedSectors([(0.0, 10.0, 0.8), (20.0, 30.0, 0.9)], line.length)
    return build_controller(load_controller_parameters("map"), load_vehicle("nuc4"), line, sectors)


def test_settings_come_back(controller, line):
    text = settings_text(
        controller, name="my/map.yaml", sectors="speed_scaling.yaml", limits=SafetyLimits()
    )
    settings = parse_settings(text)
    assert settings.controller == controller.parameters
    assert settings.vehicle == controller.vehicle and settings.notes == ()
    assert settings.values["controller"]["name"] == "map"
    assert settings.values["raceline"]["name"] == "reference"
    assert settings.values["versions"]["map_racing"] == __version__
    assert settings.values["speed_sectors"]["file"] == "speed_scaling.yaml"
    assert settings.sectors[0] == (0.0, 10.0, 0.8)
    s = np.linspace(0.0, line.length, 200)
    assert settings.planned_speed(line)(s) == pytest.approx(controller.planned_speed(s), abs=0.02)


@pytest.mark.parametrize("track", ["reference", "club"])
def test_the_end_of_the_lap_survives_rounding_to_millimeters(track):
    line = load_raceline(track)
    sectors = SpeedSectors([(0.0, 10.0, 0.5), (10.0, line.length, 0.6)], line.length)
    parameters = load_controller_parameters("map").with_(grip_use=0.0)
    controller = build_controller(parameters, load_vehicle("nuc4"), line, sectors)
    settings = parse_settings(settings_text(controller))
    s = np.linspace(0.0, line.length - 0.01, 200)
    np.testing.assert_allclose(settings.planned_speed(line)(s), controller.planned_speed(s))


def test_settings_of_model_predictive_control_come_back(line):
    pytest.importorskip("osqp")
    controller = build_law(load_law("mpc_single_track"), load_vehicle("nuc4"), line)
    settings = parse_settings(settings_text(controller, name="mpc_single_track"))
    assert settings.controller == controller.parameters and settings.notes == ()
    s = np.linspace(0.0, line.length, 50)
    np.testing.assert_array_equal(settings.planned_speed(line)(s), controller.planned_speed(s))


def test_without_raceline_and_sectors(controller):
    bare = build_controller(controller.parameters, controller.vehicle)
    settings = parse_settings(settings_text(bare))
    assert settings.controller == controller.parameters and settings.sectors == ()
    assert "raceline" not in settings.values


def test_planned_speed_of_a_raceline_that_the_controller_cannot_drive(controller, ring):
    settings = parse_settings(settings_text(controller))
    short = ring  # the sectors are beyond its end
    assert settings.planned_speed(short) is None


@pytest.mark.parametrize(
    "text", ["", "hello", "[1, 2]", "a: [", "x: 2020-13-45", "a: 1\n---\nb: 2"]
)
def test_texts_of_something_else(text):
    settings = parse_settings(text)
    assert settings.controller is None and settings.vehicle is None
    assert settings.notes and settings.planned_speed(None) is None


def test_parts_of_another_version(controller):
    values = yaml.safe_load(settings_text(controller))
    values["controller"]["of_the_future"] = 1
    settings = parse_settings(yaml.safe_dump(values))
    assert settings.controller is None and settings.vehicle == controller.vehicle
    assert "of_the_future" in settings.notes[0]
    values["vehicle"] = {"name": "x", "m": "heavy"}
    assert parse_settings(yaml.safe_dump(values)).vehicle is None
    values["vehicle"] = vehicle_values(controller.vehicle)
    values["speed_sectors"] = {"sectors": [{"start_m": 0.0}]}
    settings = parse_settings(yaml.safe_dump(values))
    assert settings.sectors == () and "end_m: missing" in settings.notes[-1]


def test_doubts_of_vehicle_raceline_and_sectors_are_kept(line, tmp_path):
    """So that the report shows them beside the laps."""
    car = {**vehicle_values(load_vehicle("nuc4")), "delta_rate_max": 183.0}
    (tmp_path / "car.yaml").write_text(yaml.safe_dump(car))
    (tmp_path / "s.yaml").write_text("{n_sectors: 1, Sector0: {start: 0, end: 9, scaling: 0.5}}")
    (tmp_path / "line.csv").write_text(
        "# x_m,y_m\n"
        + "".join(f"{20 * np.cos(a)},{20 * np.sin(a)}\n" for a in np.arange(0, 5.8, 0.1))
    )
    line = load_raceline(tmp_path / "line.csv")
    sectors = load_speed_sectors(tmp_path / "s.yaml", line)
    vehicle = load_vehicle(tmp_path / "car.yaml")
    controller = build_controller(load_controller_parameters("map"), vehicle, line, sectors)
    notes = parse_settings(settings_text(controller)).notes
    assert [note.split(": ")[:2] for note in notes] == [
        ["warning", "vehicle NUC4"],
        ["warning", "raceline line"],
        ["warning", str(tmp_path / "s.yaml")],
    ]
    assert "closed over a gap" in notes[1]


@pytest.mark.parametrize("name", ["map", "map_linear", "pure_pursuit", "map_linear_paper"])
def test_nothing_is_doubted_of_what_is_shipped(line, name):
    """A table of linear tires has no limit, and need not match the limit of the car's tires."""
    car = load_vehicle("nuc4")
    assert doubts_of(build_law(load_law(name, car), car, line)) == []
    # A table of tires other than the controller's gives a warning.
    if name == "map":
        other = build_controller(load_law("map_linear", car), car, line)
        mixed = Controller(load_law("map", car), other.steering_map, car, line)
        assert "made for other tires, or linear ones?" in doubts_of(mixed)[0]
