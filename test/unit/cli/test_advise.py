"""``map-racing advise``: a table, and speed sectors that the next race drives with."""

import dataclasses
from argparse import ArgumentParser

import pytest
import yaml

from map_racing.cli import main
from map_racing.cli.options.advise import add_options
from map_racing.control.speed_sectors import load_speed_sectors
from map_racing.evaluation.advice import STEP
from map_racing.track.files.load import load_raceline
from map_racing.vehicle.parameters import load_vehicle, save_vehicle


def test_the_next_race_drives_what_was_advised(bags, tmp_path, capsys):
    file, following = tmp_path / "speed_scaling.yaml", tmp_path / "next.bag"
    assert main(["advise", str(bags["map"]), "--speed-sectors", str(file)]) == 0
    said = capsys.readouterr().out
    predicted = float(said.split(" s predicted")[0].split()[-1])
    content = yaml.safe_load(file.read_text())
    scales = [content[f"Sector{i}"]["scaling"] for i in range(content["n_sectors"])]
    count = len(scales)
    assert f"{count} sectors, the one across the start line as two, for speed_scale 1" in said
    assert content["global_limit"] == 1.0
    assert max(scales) <= 0.7 * (1.0 + STEP) and min(scales) >= 0.7
    # The track has one point more than the bag, yet every place has advice.
    stretches = load_speed_sectors(file, load_raceline("reference")).stretches()
    assert {scale for *_, scale in stretches} == set(scales)
    race = ["race", "--laps", "2", "--speed-scale", "1", "--speed-sectors", str(file)]
    assert main([*race, "--output", str(following)]) == 0
    capsys.readouterr()
    assert main(["advise", str(following), "--step", "0.05"]) == 0
    said = capsys.readouterr().out
    driven = float(said.split(" s driven")[0].split()[-1])
    assert abs(driven / predicted - 1.0) < 0.01
    assert "grip_use" in said  # it holds some of the speeds back


def test_the_step_is_the_one_of_the_library():
    parser = ArgumentParser()
    add_options(parser)
    assert parser.parse_args(["run.bag"]).step == STEP


def test_what_it_refuses(bags, tmp_path, race_bag, refused):
    one = bags["map"]
    assert "--join" in refused("advise", one, bags["pure_pursuit"])
    assert "--reverse" in refused("advise", one, "--reverse")
    assert "step" in refused("advise", one, "--step", "2")
    assert "--vehicle" in refused("advise", race_bag())
    assert "also an input" in refused("advise", one, "--speed-sectors", one)
    assert "has none" in refused("advise", one, "--laps", "9")


def test_doubts_stand_beside_the_advice(bags, capsys):
    assert main(["advise", str(bags["map"]), "--vehicle", "sim"]) == 0
    said = capsys.readouterr().out
    assert "warning: --vehicle is SIM, but the controller drove with NUC4" in said


@pytest.mark.once
def test_another_car_of_the_same_name_is_a_doubt(bags, tmp_path, capsys):
    car = load_vehicle("nuc4")
    for mu, other in ((car.mu, False), (0.9 * car.mu, True)):
        save_vehicle(dataclasses.replace(car, mu=mu), tmp_path / "mine.yaml")
        assert main(["advise", str(bags["map"]), "--vehicle", str(tmp_path / "mine.yaml")]) == 0
        text = "warning: --vehicle is NUC4, but the controller drove with NUC4 with other values"
        assert (text in capsys.readouterr().out) == other
