"""Controller parameters: the shipped files, and refusals that name parameter and file."""

import dataclasses
import math

import pytest
import yaml

from map_racing.control.guidance import LookaheadLaw
from map_racing.control.parameters import (
    ControllerParameters,
    load_controller_parameters,
    load_law,
    load_safety_limits,
    save_controller_parameters,
)
from map_racing.control.safety_limits import SafetyLimits
from map_racing.errors import FileFormatError, MapRacingError, ParameterError
from map_racing.resources import find_config, list_config
from map_racing.vehicle.parameters import load_vehicle

NUMBERS = [
    "m_m",
    "q_s",
    "lookahead_min_m",
    "lookahead_max_m",
    "delay_s",
    "speed_lookahead_s",
    "speed_scale",
    "v_max_mps",
    "grip_use",
    "a_drive_max_mps2",
    "a_brake_max_mps2",
]


def written(tmp_path, **changes):
    """A controller file with some values changed, or left out if None."""
    values = dataclasses.asdict(load_controller_parameters("map"))
    values.update(changes)
    path = tmp_path / "tuned.yaml"
    path.write_text(yaml.safe_dump({k: v for k, v in values.items() if v is not None}))
    return path


def refusal(path):
    """The one-line message that refuses a file."""
    with pytest.raises(ParameterError) as caught:
        load_controller_parameters(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ") and "\n" not in message
    return message


@pytest.mark.parametrize("name", list_config("controllers"))
def test_shipped_files_say_everything(name):
    """A reader of the file need not know the defaults."""
    parameters = load_law(name)
    text = find_config("controllers", name, (".yaml",)).read_text(encoding="utf-8")
    assert set(yaml.safe_load(text)) - {"law"} == {
        field.name for field in dataclasses.fields(parameters)
    }


@pytest.mark.parametrize(
    "name, steering_map",
    [("map", "table"), ("map_linear", "linear_table"), ("pure_pursuit", "ackermann")],
)
def test_compensation_is_on_by_default_and_off_as_published(name, steering_map):
    default = load_controller_parameters(name)
    assert default.steering_map == steering_map
    assert default.delay_s > 0.0 and default.speed_source == "measured"
    paper = load_controller_parameters(name + "_paper")
    assert paper.steering_map == steering_map
    assert paper.delay_s == paper.speed_lookahead_s == 0.0
    assert paper.speed_source == "command" and paper.eta_from == "heading"
    assert paper.curvature_feedforward == paper.yaw_rate_gain_s == 0.0
    assert paper.table_v_max_mps == 7.0


def test_a_file_reads_back(tmp_path):
    values = {"m_m": -0.165, "q_s": 0.6, "slip_lookahead": 0, "speed_scale": 0, "v_max_mps": 7}
    path = written(tmp_path, **values)
    expected = load_controller_parameters("map").with_(**values)
    assert load_controller_parameters(path) == expected
    assert load_controller_parameters(str(path)).lookahead(load_vehicle("nuc4")) == LookaheadLaw(
        -0.165, 0.6, 0.3, 5.0
    )


@pytest.mark.parametrize("name", ["steering_map", "m_m", "q_s"])
def test_what_is_required_is_missed_by_name(tmp_path, name):
    assert refusal(written(tmp_path, **{name: None})).endswith(f"missing parameter '{name}'")


def test_all_that_is_missing_is_named(tmp_path):
    path = tmp_path / "tuned.yaml"
    path.write_text("steering_map: table\n")
    assert "'m_m'" in refusal(path) and "'q_s'" in refusal(path)


def test_the_rest_has_defaults(tmp_path):
    path = tmp_path / "tuned.yaml"
    path.write_text("{steering_map: table, m_m: 0.1, q_s: 0.2}\n")
    assert load_controller_parameters(path) == ControllerParameters("table", 0.1, 0.2)


@pytest.mark.parametrize("name", ["m_l1", "M_m", "delay", 3])
def test_unknown_names_are_refused_with_the_known_ones(tmp_path, name):
    path = written(tmp_path)
    path.write_text(path.read_text() + f"{name}: 1\n")
    message = refusal(path)
    assert f"unknown parameter {name} " in message
    assert "lookahead_max_m" in message


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("m_m", 30.0, "-25 to 25 m"),
        ("q_s", 150.0, "-10 to 10 s"),
        ("lookahead_min_m", 300.0, "more than 0 to 50 m"),
        ("lookahead_max_m", 5000.0, "more than 0 to 500 m"),
        ("v_max_mps", 1200.0, "more than 0 to 200 m/s"),
        ("a_brake_max_mps2", 600.0, "more than 0 to 100 m/s^2"),
    ],
)
def test_values_in_other_units_are_refused(tmp_path, name, value, expected):
    """Impossible for any car: centimeters, milliseconds, millimeters, centimeters per second."""
    message = refusal(written(tmp_path, **{name: value}))
    assert f"{name}: expected {expected}, got {value:g}" in message


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, "0.3", True, [0.3]])
def test_what_is_no_number_is_refused_by_name(tmp_path, name, value):
    assert f"{name}: expected a finite number, got {value!r}" in refusal(
        written(tmp_path, **{name: value})
    )


@pytest.mark.parametrize("value", [10**400, -(10**400), 1e300])
def test_numbers_that_would_overflow_are_refused_by_name(tmp_path, value):
    assert ": m_m: expected a number" in refusal(written(tmp_path, m_m=value))


@pytest.mark.parametrize("name", NUMBERS)
def test_an_empty_value_is_refused_by_name(tmp_path, name):
    path = written(tmp_path, **{name: "EMPTY"})
    path.write_text(path.read_text().replace("EMPTY", ""))
    assert f"{name}: expected a finite number, got None" in refusal(path)


@pytest.mark.parametrize(
    "name", ["steering_map", "speed_source", "eta_from", "lookahead_from", "reference_point"]
)
@pytest.mark.parametrize("value", ["Table", "", 1, ["table"], {"a": 1}])
def test_choices_are_refused_with_what_there_is(tmp_path, name, value):
    message = refusal(written(tmp_path, **{name: value}))
    assert f"{name}: expected " in message and message.endswith(f", got {value!r}")


@pytest.mark.parametrize(
    "changes",
    [
        {"delay_s": -0.01},
        {"speed_lookahead_s": -0.1},
        {"speed_scale": -1e-9},
        {"v_max_mps": 0.0},
        {"v_max_mps": -3.0},
        {"table_v_max_mps": 0.0},
        {"curvature_feedforward": 1.1},
        {"curvature_feedforward": -0.1},
        {"yaw_rate_gain_s": -0.01},
        {"yaw_rate_gain_s": 0.6},
        {"lookahead_min_m": 0.0},
        {"lookahead_min_m": -0.5},
        {"lookahead_max_m": 0.2},
    ],
)
def test_impossible_values_are_refused_by_name(tmp_path, changes):
    message = refusal(written(tmp_path, **changes))
    ((name, value),) = changes.items()
    assert f": {name}: expected " in message or name == "lookahead_max_m"
    assert f"{value:g}" in message


def test_a_changed_copy_is_checked_too():
    parameters = load_controller_parameters("map")
    assert parameters.with_(speed_scale=1.0).speed_scale == 1.0
    assert parameters.speed_scale == 0.7
    with pytest.raises(ParameterError, match="speed_scale"):
        parameters.with_(speed_scale=-1.0)
    with pytest.raises(ParameterError, match="speed_scale: expected 0 to 2, got 70"):
        parameters.with_(speed_scale=70.0)


@pytest.mark.parametrize("law", ["l2", ["mpc"], {"a": 1}, 1])
def test_an_unknown_law_is_refused_with_the_known_ones(tmp_path, law):
    message = refusal(written(tmp_path, law=law))
    assert message.endswith(f"law: expected l1 or mpc, got {law!r}")


def test_unknown_files_and_broken_ones_are_refused(tmp_path):
    with pytest.raises(ParameterError, match=r"mpa: no such file.*controllers .*map_paper"):
        load_controller_parameters("mpa")
    path = tmp_path / "broken.yaml"
    path.write_text("steering_map: [table\n")
    with pytest.raises(FileFormatError, match=r"broken\.yaml:"):
        load_controller_parameters(path)


# -- saved ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list_config("controllers"))
def test_saved_parameters_are_read_back(tmp_path, name):
    given = load_law(name)
    parameters = given.with_(v_max_mps=7, **{given.TUNED[1]: 0.1234567890123})
    path = tmp_path / "tuned.yaml"
    save_controller_parameters(parameters, path)
    assert load_law(path) == parameters
    assert [file.name for file in tmp_path.iterdir()] == ["tuned.yaml"]


def test_safety_limits_are_saved_and_read_back(tmp_path):
    limits = SafetyLimits(max_deviation_m=0.7, recovery_s=1.5)
    path = tmp_path / "tuned.yaml"
    save_controller_parameters(load_controller_parameters("map"), path, limits)
    assert load_controller_parameters(path) == load_controller_parameters("map")
    assert load_safety_limits(path) == limits
    assert load_safety_limits("map") == SafetyLimits()


@pytest.mark.parametrize(
    "safety, text",
    [
        ("[1, 2]", "tuned.yaml: safety: expected names and values"),
        ("{max_age: 1.0}", "tuned.yaml: safety: unknown parameter max_age"),
        ("{recovery_s: 0.01}", "tuned.yaml: safety: recovery_s: expected 0.15 or more, got 0.01"),
    ],
)
def test_safety_limits_that_cannot_be(tmp_path, safety, text):
    path = tmp_path / "tuned.yaml"
    save_controller_parameters(load_controller_parameters("map"), path)
    path.write_text(f"{path.read_text()}safety: {safety}\n")
    with pytest.raises(MapRacingError, match=text):
        load_safety_limits(path)


def test_a_file_is_replaced_whole(tmp_path):
    path = tmp_path / "tuned.yaml"
    path.write_text("longer than before\n" * 100)
    save_controller_parameters(ControllerParameters("table", 0.2, 0.1), path)
    assert load_controller_parameters(path).q_s == 0.1


def test_what_cannot_be_written_is_said_in_one_line(tmp_path):
    with pytest.raises(MapRacingError, match="cannot write"):
        save_controller_parameters(
            ControllerParameters("table", 0.2, 0.1), tmp_path / "no" / "folder.yaml"
        )


# -- other sizes -----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", list_config("controllers"))
def test_1_10_cars_are_driven_with_the_values_of_the_file(name):
    assert load_law(name, load_vehicle("nuc4")) == load_law(name)


@pytest.mark.parametrize("name", ["map", "map_paper", "pure_pursuit"])
def test_a_larger_car_is_driven_with_values_of_its_size(name):
    """At equal accelerations, distances scale with the size, and times with its square root."""
    car = load_vehicle("bmw_320i")
    length = car.l_wb / 0.32
    time = math.sqrt(length)
    small, large = load_controller_parameters(name), load_controller_parameters(name, car)
    for names, factor in (
        (("m_m", "lookahead_min_m", "lookahead_max_m"), length),
        (("speed_lookahead_s",), time),
        # Delays of sensors and actuators stay the same, so they are relatively short.
        (("delay_s",), 1.0),
        (("q_s",), math.sqrt(time)),
        (("yaw_rate_gain_s",), time * math.sqrt(time)),
    ):
        for each in names:
            expected = factor * getattr(small, each)
            assert getattr(large, each) == pytest.approx(expected, rel=1e-4), each
    assert large.v_max_mps == car.v_max <= large.table_v_max_mps
    assert large.a_drive_max_mps2 < car.a_max and large.a_brake_max_mps2 < car.a_brake_max


def test_the_horizon_of_a_larger_car_is_as_many_of_its_lengths():
    car = load_vehicle("bmw_320i")
    length = car.l_wb / 0.32
    small, large = load_law("mpc_single_track"), load_law("mpc_single_track", car)
    assert large.heading_weight_m == pytest.approx(length * small.heading_weight_m, rel=1e-5)
    assert large.stage_s == pytest.approx(math.sqrt(length) * small.stage_s, rel=1e-4)
    rate = small.steering_rate_weight_ms * length**1.5
    assert large.steering_rate_weight_ms == pytest.approx(rate, rel=1e-4)


def test_files_of_ones_own_are_taken_as_they_stand(tmp_path):
    path = written(tmp_path, v_max_mps=5.0)
    car = load_vehicle("bmw_320i")
    assert load_controller_parameters(path, car) == load_controller_parameters(path)
    assert load_controller_parameters(path, car).v_max_mps == 5.0
