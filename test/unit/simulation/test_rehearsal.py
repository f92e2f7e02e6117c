"""Every fault once: the car's reaction, and its table in the documentation."""

import math
import re
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
import yaml

from map_racing.control.controller import build_controller
from map_racing.control.decision import Mode, Reason
from map_racing.control.parameters import load_controller_parameters
from map_racing.control.safety_limits import SafetyLimits
from map_racing.control.steering import build_steering_maps
from map_racing.control.supervised import build_slowing
from map_racing.resources import find_config
from map_racing.simulation.faults import KINDS, Fault, kinds_table
from map_racing.simulation.plants import build_plant, load_plant
from map_racing.simulation.race import race
from map_racing.simulation.rehearsal import (
    BEGIN,
    HEADER,
    SCENARIOS,
    Scenario,
    bounds_of,
    bounds_text,
    rehearse,
)
from map_racing.track.files.load import load_raceline
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.size import ONE_TENTH, size_of

PAGE = Path(__file__).resolve().parents[3] / "doc" / "safety.md"
POSE_S = 1 / 40
# A pose arrives 20 ms after it was measured.
LATENCY_S = 0.02
VEHICLE = load_vehicle("nuc4")

rehearsed = lru_cache(maxsize=None)(rehearse)


def names(scenario):
    return f"{scenario.fault}-{scenario.size}-{scenario.for_s}"


@pytest.mark.once
@pytest.mark.parametrize("scenario", SCENARIOS, ids=names)
def test_no_command_is_beyond_limit_lock_or_grip(scenario):
    """At the measured speed, in every sample, with any fault."""
    found = rehearsed(scenario)
    bounds = found.bounds
    assert bounds.commands == len(found.log.commands) > 50
    assert min(c.decision.speed for c in found.log.commands) >= 0.0
    assert bounds.speed <= bounds.max_speed == 12.0
    assert bounds.angle <= bounds.lock == VEHICLE.delta_max
    assert bounds.beyond <= 1e-9


@pytest.mark.once
@pytest.mark.parametrize("at", [8.0, 11.5])
def test_a_stop_without_poses_brakes_and_steers_within_the_grip(at):
    """Checked on the true car, which accelerates out of a bend when its poses stop."""
    parameters, plant_parameters = load_controller_parameters("map"), load_plant("nuc4")
    parameters, track = parameters.with_(speed_scale=1.0), load_raceline("reference")
    plant, localization = build_plant(plant_parameters, 1)
    controller = build_controller(parameters, plant_parameters.vehicle, track)
    dropout = [Fault("pose_dropout", at, 1.0)]
    log = race(plant, controller, track, localization, time_limit=at + 1.0, faults=dropout)
    t, _, _, _, v_x, _, r = np.array([state for state in log.truth if state.t >= at]).T
    grip = build_steering_maps(parameters, plant_parameters.vehicle)[1]
    across = v_x * r / grip.max_lateral_acceleration(6.0)
    along = np.minimum(np.gradient(v_x, t), 0.0) / parameters.a_brake_max_mps2
    assert t[-1] - t[0] > 0.9 and log.commands[-1].decision.mode is Mode.STOPPING
    assert np.max(np.hypot(along, across)) < 1.0


@pytest.fixture(scope="module")
def road_car(tmp_path_factory):
    """Plant file of a passenger car with the single-track model, which needs no other library."""
    values = yaml.safe_load(find_config("plants", "nuc4", (".yaml",)).read_text())
    values.update(vehicle="bmw_320i", drive_time_constant_s=0.3, a_max_mps2=3.5, a_brake_max_mps2=7)
    path = tmp_path_factory.mktemp("plants") / "road_car.yaml"
    path.write_text(yaml.safe_dump(values))
    return str(path)


@pytest.mark.once
@pytest.mark.parametrize(
    ("fault", "value", "reason"),
    [
        ("pose_dropout", None, "pose too old"),
        ("pose_jump", 0.4, ""),
        ("pose_jump", 3.0, "pose jumped"),
        ("stop_requested", None, "stop requested"),
    ],
)
def test_a_road_car_is_supervised_as_a_small_one(road_car, fault, value, reason):
    """With limits, track and faults scaled to its size, it reacts in the same way."""
    scenario = Scenario(fault, value)
    found, small = rehearse(scenario, road_car), rehearsed(scenario)
    assert found.reason.value == small.reason.value == reason
    assert found.row()[-1] == small.row()[-1] or reason == "pose jumped"
    assert found.bounds.beyond <= 1e-9
    size = size_of(load_vehicle("bmw_320i"))
    assert found.scenario.size == (None if value is None else value * size.length)
    assert max(state.v_x for state in found.log.truth) == pytest.approx(4.0 * size.time, rel=0.02)
    if reason:
        assert found.begins_s == pytest.approx(small.begins_s, abs=0.03)
        assert found.stands_s < small.stands_s * 1.5 * size.time


def test_a_rehearsal_of_another_size_keeps_what_is_no_length_or_speed():
    car = size_of(load_vehicle("bmw_320i"))
    assert Scenario("grip_lost", 0.5).of_size(car).size == 0.5
    assert Scenario("servo_slow", 0.5).of_size(car).size == 0.5 / car.time
    assert Scenario("pose_dropout", for_s=0.15).of_size(car).for_s == 0.15
    assert all(scenario.of_size(ONE_TENTH) == scenario for scenario in SCENARIOS)


def test_an_angle_beyond_the_grip_would_be_told():
    """The checks notice a changed command."""
    found, parameters = rehearsed(SCENARIOS[0]), load_controller_parameters("map")
    measured = {sample.arrival: sample.measured.v_x for sample in found.log.samples}
    at = max(k for k, c in enumerate(found.log.commands) if c.t in measured and c.t < BEGIN)
    command = found.log.commands[at]
    held = build_slowing(parameters, VEHICLE).largest(measured[command.t])
    for angle, speed in ((held + 0.05, 4.0), (-held - 0.05, 13.0)):
        changed = command._replace(
            decision=command.decision._replace(steering_angle=angle, speed=speed)
        )
        log = replace(found.log, commands=[*found.log.commands[:at], changed])
        bounds = bounds_of(log, parameters, VEHICLE)
        assert bounds.beyond == pytest.approx(0.05, abs=1e-9) and bounds.speed >= speed
        assert "rad beyond" in bounds_text([replace(found, bounds=bounds)])


@pytest.mark.once
@pytest.mark.parametrize("scenario", SCENARIOS, ids=names)
def test_a_stop_is_a_ramp(scenario):
    commands = [c for c in rehearsed(scenario).log.commands if c.t >= BEGIN]
    for before, after in zip(commands, commands[1:]):
        if before.decision.mode is after.decision.mode is Mode.STOPPING:
            fell = before.decision.speed - after.decision.speed
            # 4 m/s^2, or more if the raceline demands it.
            hardest = load_controller_parameters("map").a_brake_max_mps2
            assert fell <= hardest * (after.t - before.t) + 1e-9


# Faults that the supervisor must notice, and within what time [s] beside the pose's latency.
NOTICED = {
    "pose_dropout": ("pose too old", 0.2),
    "pose_frozen": ("pose too old", 0.2),
    "pose_stuck": ("pose frozen while moving", 0.2),
    "pose_jitter": ("pose frozen while moving", 0.2),
    "pose_future": ("pose too old", POSE_S),
    "pose_frame": ("pose in another frame", POSE_S),
    "pose_nan": ("pose not finite or absurd", POSE_S),
    "velocity_absurd": ("pose not finite or absurd", POSE_S),
    "velocity_reversed": ("heading against the motion", 1.0 / 4.0 + 3 * POSE_S),
    "blocked": ("no motion although commanded", 0.3),
    "stop_requested": ("stop requested", POSE_S),
    "raceline_lost": ("raceline not drivable", POSE_S),
    "raceline_reversed": ("raceline against the motion", POSE_S),
    "controller_failed": ("controller failed", POSE_S),
}


@pytest.mark.once
@pytest.mark.parametrize(
    "scenario", [s for s in SCENARIOS if s.fault in NOTICED and s.for_s > 0.2], ids=names
)
def test_a_fault_is_noticed_in_time(scenario):
    reason, after = NOTICED[scenario.fault]
    found = rehearsed(scenario)
    assert found.reason.value == reason
    assert 0.0 <= found.begins_s <= after + LATENCY_S + 0.01
    if scenario.fault != "blocked":
        assert found.stands_s < found.begins_s + 1.5


def test_a_dropout_within_the_limit_is_none():
    assert rehearsed(SCENARIOS[0]).reason is Reason.NONE
    assert SCENARIOS[0].for_s < SafetyLimits().max_pose_age_s


@pytest.mark.once
def test_a_car_that_stood_drives_again():
    for scenario in SCENARIOS:
        found = rehearsed(scenario)
        if found.reason is not Reason.NONE and "wall" not in found.row()[-1]:
            assert not math.isnan(found.back_s), scenario


# -- the page ------------------------------------------------------------------------------------


def cells(table):
    lines = [line for line in table.splitlines() if line.startswith("| ")]
    return [[cell.strip() for cell in line.strip("| ").split("|")] for line in lines]


def on_page(title):
    text = PAGE.read_text(encoding="utf-8")
    return re.search(rf"<!-- {title} -->\n(.*?)<!-- end -->", text, re.DOTALL).group(1)


@pytest.mark.once
def test_the_table_of_the_page_is_what_comes_of_the_rehearsal():
    """Numbers agree within a pose and a few centimeters; ``map-racing faults`` prints a new
    table."""
    rows = [line.split("|")[1:-1] for line in on_page("rehearsal").splitlines() if "|" in line]
    rows = [[cell.strip() for cell in row] for row in rows]
    assert tuple(rows[0]) == HEADER
    assert len(rows) == 2 + len(SCENARIOS) >= 32
    for written, scenario in zip(rows[2:], SCENARIOS):
        now = rehearsed(scenario).row()
        for title, old, new in zip(HEADER, written, now):
            if re.fullmatch(r"\d+\.\d+", old):
                assert float(new) == pytest.approx(float(old), abs=0.11), (scenario, title)
            else:
                number = r"\d+\.\d+ s"
                assert re.sub(number, "", new) == re.sub(number, "", old), (scenario, title)


def test_the_names_of_the_page_are_the_names():
    assert on_page("names").strip() == kinds_table().strip()
    assert {scenario.fault for scenario in SCENARIOS} == {
        name for name, kind in KINDS.items() if "race" in kind.where and name != "resumed"
    }
