import pytest

from map_racing.control.parameters import (
    ControllerParameters,
    load_controller_parameters,
    save_controller_parameters,
)
from map_racing.errors import MapRacingError
from map_racing.resources import list_config


@pytest.mark.parametrize("name", list_config("controllers"))
def test_saved_parameters_are_read_back(tmp_path, name):
    parameters = load_controller_parameters(name).with_(q_s=0.1234567890123, v_max_mps=7)
    path = tmp_path / "tuned.yaml"
    save_controller_parameters(parameters, path)
    assert load_controller_parameters(path) == parameters
    assert [file.name for file in tmp_path.iterdir()] == ["tuned.yaml"]


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
