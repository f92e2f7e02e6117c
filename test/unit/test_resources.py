"""Shipped data files by name, others by path."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import map_racing
from map_racing.errors import ParameterError
from map_racing.resources import config_directory, find_config, list_config


def test_shipped_files_are_found_by_name():
    assert list_config("vehicles") == ["bmw_320i", "f1tenth_drift", "nuc4", "sim", "sim_identified"]
    assert {"map", "map_linear", "pure_pursuit"} <= set(list_config("controllers"))
    assert {"club", "reference"} <= set(list_config("tracks"))
    for name in list_config("vehicles"):
        path = find_config("vehicles", name, (".yaml",))
        assert path == config_directory() / "vehicles" / f"{name}.yaml"


def test_suffixes_are_tried_in_order():
    assert find_config("tracks", "club", (".json", ".csv")).name == "club.csv"


def test_a_path_is_taken_as_it_is(tmp_path, monkeypatch):
    path = tmp_path / "mine.yaml"
    path.write_text("m: 1\n")
    assert find_config("vehicles", path, (".yaml",)) == path
    assert find_config("vehicles", str(path), (".yaml",)) == path
    monkeypatch.chdir(tmp_path)
    assert find_config("vehicles", "mine.yaml", (".yaml",)) == Path("mine.yaml")


def test_a_folder_of_the_name_does_not_hide_the_shipped_file(tmp_path, monkeypatch):
    (tmp_path / "nuc4").mkdir()
    monkeypatch.chdir(tmp_path)
    assert find_config("vehicles", "nuc4", (".yaml",)).parent == config_directory() / "vehicles"


@pytest.mark.parametrize("source", ["nuc5", "", "../vehicles/nuc4", "no/such/file.yaml"])
def test_an_unknown_name_is_refused_with_the_known_ones(source):
    with pytest.raises(ParameterError) as caught:
        find_config("vehicles", source, (".yaml",))
    assert str(caught.value) == (
        f"{source or repr(source)}: no such file, nor one of the shipped vehicles "
        "(bmw_320i, f1tenth_drift, nuc4, sim, sim_identified)"
    )


@pytest.mark.parametrize("source", [".", "..", "/"])
def test_a_folder_is_called_that(source):
    with pytest.raises(ParameterError, match=r"expected a file or one .* nuc4, .*, got a folder"):
        find_config("vehicles", source, (".yaml",))


def test_data_of_an_installed_package_are_found_beside_it(tmp_path):
    """Layout of pip and catkin: the package in lib, its data in share below the same prefix."""
    packages = tmp_path / "lib" / "python3" / "site-packages"
    shutil.copytree(str(Path(map_racing.__file__).parent), str(packages / "map_racing"))
    code = "from map_racing.resources import config_directory; print(config_directory())"
    run = [sys.executable, "-c", code]
    lost = subprocess.run(run, cwd=str(packages), capture_output=True, check=False)
    assert b"ParameterError: the data files of map_racing are missing" in lost.stderr
    shipped = tmp_path / "share" / "map_racing" / "config"
    shipped.mkdir(parents=True)
    found = subprocess.run(run, cwd=str(packages), stdout=subprocess.PIPE, check=True)
    assert Path(found.stdout.decode().strip()).resolve() == shipped.resolve()
