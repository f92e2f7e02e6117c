"""``map-racing race`` as its users meet it."""

import json
import re

import numpy as np
import pytest
import yaml

from map_racing.bags.reader import read_recording
from map_racing.cli import main
from map_racing.resources import find_config

SECTORS = "global_limit: 1.0\nn_sectors: 1\nSector0: {start: 0, end: 365, scaling: 0.5}\n"


def test_race_says_how_it_ended(tmp_path, capsys):
    assert main(["race", "--laps", "1", "--output", str(tmp_path / "a.bag")]) == 0
    assert "completed after 1 timed lap," in capsys.readouterr().out


def test_race_and_lookup_name_the_same_places_that_are_slowed(tmp_path, capsys):
    arguments = ["--laps", "1", "--speed-scale", "1", "--output", str(tmp_path / "a.bag")]
    assert main(["race", "--track", "club", *arguments]) == 0
    printed = capsys.readouterr().out
    slowed = re.search(r"grip_use 0\.\d+: (slower than the raceline on .*)", printed)
    table = tmp_path / "t.csv"
    vehicle = ["--vehicle", "nuc4", "--v-max", "12"]
    assert main(["lookup", "generate", *vehicle, "--output", str(table)]) == 0
    assert main(["lookup", "check", str(table), "--raceline", "club"]) == 0
    assert slowed.group(1) in capsys.readouterr().out
    paper = ["--controller", "map_paper"]
    assert main(["lookup", "check", str(table), "--raceline", "club", *paper]) == 0
    assert (
        "map_paper, speed_scale 1, grip_use 0: drives the raceline's speeds"
        in capsys.readouterr().out
    )


def test_model_predictive_control_is_raced_recorded_and_evaluated(tmp_path, capsys):
    pytest.importorskip("osqp")
    bag = str(tmp_path / "mpc.bag")
    sectors = tmp_path / "sectors.yaml"
    sectors.write_text(SECTORS)
    command = ["race", "--controller", "mpc_kinematic", "--laps", "1", "--output", bag]
    assert main([*command, "--speed-sectors", str(sectors)]) == 0
    assert "completed after 1 timed lap," in capsys.readouterr().out
    assert main(["evaluate", bag]) == 0
    assert "1 lap counted" in capsys.readouterr().out
    faults = tmp_path / "faults.yaml"
    faults.write_text("faults:\n  - {fault: pose_nan, at_s: 1.0}\n")
    assert main([*command[:-1], str(tmp_path / "no.bag"), "--faults", str(faults)]) == 1
    assert "--faults: expected a controller that the node drives" in capsys.readouterr().err
    assert not (tmp_path / "no.bag").exists()


def test_a_raceline_without_speeds_is_raced_within_the_grip(tmp_path, capsys):
    line = tmp_path / "oval.csv"
    angle = np.linspace(0.0, 2.0 * np.pi, 100, endpoint=False)
    rows = "".join(f"{8.0 * np.cos(a):.4f},{4.0 * np.sin(a):.4f}\n" for a in angle)
    line.write_text("# x_m,y_m\n" + rows)
    arguments = ["--track", str(line), "--laps", "1", "--output", str(tmp_path / "a.bag")]
    assert main(["race", *arguments]) == 0
    printed = capsys.readouterr().out
    assert "the raceline has no speeds: driven as fast as the grip allows" in printed
    assert "completed after 1 timed lap," in printed
    assert main(["race", *arguments, "--controller", "map_paper"]) == 1
    assert "oval.csv: expected speeds, got none" in capsys.readouterr().err


def test_a_crash_is_recorded_as_far_as_it_went(tmp_path, capsys):
    path = tmp_path / "a.bag"
    arguments = ["--controller", "pure_pursuit_paper", "--speed-scale", "0.9"]
    assert main(["race", *arguments, "--output", str(path)]) == 3
    printed, error = capsys.readouterr()
    assert "crashed after 0 timed laps" in printed and "of the raceline" in printed
    assert error == "map-racing: not completed (N.C.), crashed\n"
    assert main(["evaluate", str(path)]) == 0
    assert "N.C." in capsys.readouterr().out


def test_a_fault_that_came_too_late_is_named(tmp_path, capsys):
    faults = tmp_path / "faults.yaml"
    faults.write_text("faults: [{fault: pose_nan, at_s: 100.0}]")
    arguments = ["--laps", "1", "--output", str(tmp_path / "a.bag"), "--faults", str(faults)]
    assert main(["race", *arguments]) == 0
    assert "pose_nan at 100 s: the race ended before" in capsys.readouterr().out


@pytest.mark.once
def test_same_seed_same_bag(tmp_path):
    for name, seed in (("a", "3"), ("b", "3"), ("c", "4")):
        output = str(tmp_path / f"{name}.bag")
        assert main(["race", "--laps", "1", "--seed", seed, "--output", output]) == 0
    a, b, c = (read_recording(tmp_path / f"{name}.bag") for name in "abc")
    assert np.array_equal(a.x, b.x) and not np.array_equal(a.x[:50], c.x[:50])


def test_sectors_of_another_track_are_doubted_where_they_are_raced(tmp_path, capsys):
    sectors, bag = tmp_path / "s.yaml", str(tmp_path / "a.bag")
    sectors.write_text(SECTORS.replace("365", "226"))
    assert main(["race", "--laps", "1", "--speed-sectors", str(sectors), "--output", bag]) == 0
    doubt = f"warning: {sectors}: the last sector ends at point 226, the raceline has 366"
    told = capsys.readouterr().out
    assert doubt in told
    assert "times speed_scale 0.7: 35 to 70 %; sectors of advise are for speed_scale 1" in told


def test_race_with_a_table_and_sectors(tmp_path):
    table, sectors = tmp_path / "t.csv", tmp_path / "s.yaml"
    assert main(["lookup", "generate", "--vehicle", "nuc4", "--output", str(table)]) == 0
    sectors.write_text(SECTORS)
    output = ["--laps", "1", "--output", str(tmp_path / "a.bag")]
    extra = ["--lookup-table", str(table), "--speed-sectors", str(sectors)]
    assert main(["race", "--speed-scale", "1", *extra, *output]) == 0
    assert main(["evaluate", str(tmp_path / "a.bag"), "--json", str(tmp_path / "a.json")]) == 0
    (run,) = json.loads((tmp_path / "a.json").read_text())["runs"]
    assert run["summary"]["max_speed_mps"] == pytest.approx(0.5 * 8.5, abs=0.35)


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["--track", "nowhere"], "nowhere: .*reference"),
        (["--vehicle", "nowhere"], "nowhere: .*nuc4"),
        (["--controller", "nowhere"], "nowhere: .*pure_pursuit"),
        (["--plant", "nowhere"], "nowhere: "),
        (["--laps", "0"], "--laps: expected 1 to 1000, got 0"),
        (["--speed-scale", "-1"], "speed_scale"),
        (["--speed-scale", "70"], "speed_scale: expected 0 to 2"),
        (["--speed-scale", "nan"], "speed_scale"),
        (["--lookup-table", "nowhere.csv"], "nowhere.csv"),
        (["--speed-sectors", "nowhere.yaml"], "nowhere.yaml"),
        (["--controller", "pure_pursuit", "--lookup-table", "t.csv"], "no lookup table"),
        (["--track", ""], "'': expected the name of a file"),
    ],
)
def test_race_refuses(tmp_path, refused, arguments, said):
    line = refused("race", *arguments, "--output", tmp_path / "a.bag")
    assert re.search(said, line), line
    assert list(tmp_path.iterdir()) == []


def test_race_refuses_a_track_in_millimeters(tmp_path, refused):
    angle = np.arange(100) * 2.0 * np.pi / 100
    path = tmp_path / "mm.csv"
    rows = zip((5000.0 * np.cos(angle)).tolist(), (5000.0 * np.sin(angle)).tolist())
    path.write_text("x_m,y_m\n" + "\n".join(f"{x},{y}" for x, y in rows))
    line = refused("race", "--track", path, "--output", tmp_path / "a.bag")
    assert "expected a lap of at most 5000 m, got 31416 m: is it in meters?" in line
    path.write_text(
        "x_m,y_m,v\n" + path.read_text().partition("\n")[2].replace("\n", ",3\n") + ",3"
    )
    line = refused("race", "--track", path, "--output", tmp_path / "a.bag")
    assert "expected meters, got a lap of 31416 m, which takes 10472 s" in line


def test_an_output_may_be_called_like_a_shipped_file(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["race", "--laps", "1", "--controller", "map", "--output", "map"]) == 0
    assert (tmp_path / "map").is_file()
    # Only its name tells that a file in a folder is a bag.
    assert "map: not named .bag: season does not find it" in capsys.readouterr().out


def test_race_refuses_a_folder_that_is_not_there(tmp_path, refused):
    assert "does not exist" in refused("race", "--output", tmp_path / "no" / "a.bag")


def test_notes_on_the_vehicle_of_a_plant_are_printed(tmp_path, capsys):
    """A published model file in a plant file: assumptions are printed as with --vehicle."""
    values = yaml.safe_load(find_config("vehicles", "nuc4", (".yaml",)).read_text())
    del values["mu"]
    (tmp_path / "car.yaml").write_text(yaml.safe_dump({**values, "C_R": 2.0}))
    plant = yaml.safe_load(find_config("plants", "nuc4", (".yaml",)).read_text())
    (tmp_path / "plant.yaml").write_text(yaml.safe_dump({**plant, "vehicle": "car.yaml"}))
    path = str(tmp_path / "plant.yaml")
    bag = str(tmp_path / "run.bag")
    assert main(["race", "--plant", path, "--laps", "1", "--output", bag]) == 0
    printed = capsys.readouterr().out
    assert f"{path}: its vehicle NUC4: no mu: 1 assumed" in printed
    assert "its vehicle NUC4: keys not used: C_R" in printed


def test_a_full_size_car_is_driven_by_the_shipped_controllers(tmp_path, capsys):
    """The plant of `nuc4` with the vehicle of a road car, on an oval of 740 m without speeds."""
    plant = yaml.safe_load(find_config("plants", "nuc4", (".yaml",)).read_text(encoding="utf-8"))
    path = tmp_path / "road_car.yaml"
    path.write_text(yaml.safe_dump({**plant, "vehicle": "bmw_320i"}))
    line = tmp_path / "oval.csv"
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    rows = "".join(f"{150.0 * np.cos(a):.4f},{80.0 * np.sin(a):.4f},6,6\n" for a in angle)
    line.write_text("# x_m,y_m,w_tr_right_m,w_tr_left_m\n" + rows)
    bag = tmp_path / "a.bag"
    arguments = ["--track", str(line), "--plant", str(path), "--speed-scale", "1", "--laps", "1"]
    assert main(["race", *arguments, "--output", str(bag)]) == 0
    printed = capsys.readouterr().out
    assert "map: for 1:10 cars; distances are 8.06 and times 2.84 times as long" in printed
    assert "completed after 1 timed lap," in printed
    table = tmp_path / "laps.json"
    assert main(["evaluate", str(bag), "--car-width", "1.61", "--json", str(table)]) == 0
    (lap,) = [lap for lap in json.loads(table.read_text())["runs"][0]["laps"] if lap["valid"]]
    assert lap["rms_lateral_error_m"] < 0.3
    # 0.86 of the grip on bends of 43 m radius, and more beside them.
    assert lap["mean_speed_mps"] > 18.0


def test_another_vehicle_than_the_plants_is_named_by_its_file(tmp_path, capsys):
    """Both files may contain the same name."""
    values = yaml.safe_load(find_config("vehicles", "nuc4", (".yaml",)).read_text())
    car = tmp_path / "heavy.yaml"
    car.write_text(yaml.safe_dump({**values, "m": 3.6}))
    output = ["--laps", "1", "--output", str(tmp_path / "a.bag")]
    assert main(["race", "--vehicle", str(car), *output]) == 0
    told = f"the controller knows NUC4 of {car}, but the plant nuc4 is NUC4 with other values"
    assert told in capsys.readouterr().out
