import pytest

from map_racing.control.parameters import (
    ControllerParameters,
    load_controller_parameters,
    load_safety_limits,
    save_controller_parameters,
)
from map_racing.control.safety import SafetyLimits
from map_racing.errors import MapRacingError
from map_racing.resources import list_config


@pytest.mark.parametrize("name", list_config("controllers"))
def test_saved_parameters_are_read_back(tmp_path, name):
    parameters = load_controller_parameters(name).with_(q_s=0.1234567890123, v_max_mps=7)
    path = tmp_path / "tuned.yaml"
    save_controller_parameters(parameters, path)
    assert load_controller_parameters(path) == parameters
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
