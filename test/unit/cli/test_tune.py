"""``map-racing tune``, reusing races of the experiment on tire models."""

from pathlib import Path

import pandas as pd
import pytest

from map_racing.control.parameters import load_controller_parameters, save_controller_parameters


@pytest.mark.once
def test_tuning_alone_finds_the_same(run, place, tires, capsys):
    output = place / "tuned"
    command = ["tune", "--controller", "map_paper", "--reuse", str(tires), "--output", str(output)]
    run(*command)
    assert "0 races driven" in capsys.readouterr().out
    name = Path("controllers") / "map_paper.yaml"
    assert (output / name).read_text() == (tires / name).read_text()
    assert (output / "figures" / "tuning_map_paper.png").is_file()
    table = pd.read_csv(output / "table.csv")
    assert table.controller.tolist() == ["map_paper"]


@pytest.mark.parametrize("name", ["own", "own.yml"])
def test_results_are_named_after_files_with_any_suffix(run, tires, tmp_path, capsys, name):
    (tmp_path / "in").mkdir()
    file, output = tmp_path / "in" / name, tmp_path / "out"
    save_controller_parameters(load_controller_parameters("map_paper"), file)
    options = ["--controller", file, "--vehicle", tires / "identified.yaml"]
    run("tune", *options, "--reuse", tires, "--output", output)
    assert f"--controller {output / 'controllers' / 'own.yaml'} ..." in capsys.readouterr().out
    assert (output / "controllers" / "own.yaml").is_file()


def test_a_vehicle_that_is_given_is_raced(run, tires, tmp_path, capsys):
    options = ["--controller", "map_paper", "--vehicle", tires / "identified.yaml"]
    run("tune", *options, "--reuse", tires, "--output", tmp_path / "given")
    printed = capsys.readouterr().out
    assert "identified NUC4" not in printed and not (tmp_path / "given" / "ramps.bag").exists()
    assert "\n0 races driven" in printed  # the same car as before
