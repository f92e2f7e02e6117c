"""Experiments, tuning and comparison from the command line, on a small circle."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from map_racing.bags.reader import read_recording
from map_racing.cli import main
from map_racing.control.parameters import load_controller_parameters, save_controller_parameters
from map_racing.evaluation.laps import evaluate
from map_racing.evaluation.recordings import recorded_raceline
from map_racing.simulation.recorded import GROUND_TRUTH_TOPIC
from map_racing.track.files.load import save_raceline
from map_racing.track.raceline import Raceline
from map_racing.vehicle.parameters import load_vehicle

LABELS = ["pure pursuit", "MAP linear", "MAP Pacejka", "MAP default"]


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A folder with a track and conditions."""
    folder = tmp_path_factory.mktemp("experiments")
    angle = 2.0 * np.pi * np.arange(50) / 50
    half = np.full(50, 0.4)
    ring = Raceline(
        *(1.2 * np.cos(angle), 1.2 * np.sin(angle)),
        vx_mps=np.full(50, 3.5),
        d_left_m=half,
        d_right_m=half,
    )
    save_raceline(ring, folder / "ring.csv")
    (folder / "conditions.yaml").write_text(
        f"track: {folder / 'ring.csv'}\nplant: nuc4\nmu_deviation: 0.05\n"
        "front_stiffness_deviation: 0.1\nrear_stiffness_deviation: 0.1\n"
        "seeds: [1, 2]\npractice_seeds: [11]\ntuning_scale: 0.6\ntuning_laps: 1\n"
    )
    return folder


def run(place, *command):
    """Run a command under these conditions; its exit code."""
    arguments = [*command, "--conditions", str(place / "conditions.yaml")]
    return main([str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def tires(place):
    """Result directory of tire-models, with bags."""
    output = place / "tires"
    assert run(place, "experiment", "tire-models", "--laps", 2, "--bags", "--output", output) == 0
    return output


def refused(capsys, *arguments):
    """Run a command that must fail; its one line on stderr."""
    assert main([str(argument) for argument in arguments]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("map-racing: ")
    return lines[0]


def test_tables_of_tire_models(tires):
    table = pd.read_csv(tires / "table.csv")
    keys = [(scale, label) for scale in (0.7, 0.8) for label in LABELS]
    assert list(zip(table.speed_scale, table.controller)) == keys
    assert (table.days == 2).all()
    races = pd.read_csv(tires / "races.csv")
    assert len(races) == 16 and set(races.seed) == {1, 2}
    laps = pd.read_csv(tires / "laps.csv")
    completed = races[races.outcome == "completed"]
    assert len(completed) and (completed.laps_completed == 2).all()
    one = completed.iloc[0]
    own = laps[(laps.speed_scale == one.speed_scale) & (laps.controller == one.controller)]
    own = own[(own.seed == one.seed) & own.valid]
    assert own.lap_time_s.mean() == pytest.approx(one.mean_lap_time_s)
    figures = sorted(path.name for path in (tires / "figures").iterdir())
    assert figures == [
        "trajectories_seed1.png",
        "trajectories_seed2.png",
        *(f"tuning_{name}_paper.png" for name in ("map_linear", "map", "pure_pursuit")),
    ]


def test_the_bags_hold_the_races_of_the_table(tires):
    races = pd.read_csv(tires / "races.csv")
    bags = sorted((tires / "bags").iterdir())
    assert len(bags) == len(races)
    row = races[(races.controller == "MAP Pacejka") & (races.seed == 2)].iloc[0]
    (bag,) = [path for path in bags if f"_{row.fingerprint[:6]}.bag" in path.name]
    recording = read_recording(bag, GROUND_TRUTH_TOPIC)
    summary = evaluate(recording, recorded_raceline(recording)).summary
    assert summary.mean_lap_time_s == pytest.approx(row.mean_lap_time_s, abs=1e-5)
    assert summary.max_abs_lateral_error_m == pytest.approx(row.max_abs_lateral_error_m, abs=1e-5)


def test_provenance_says_what_was_raced(tires):
    provenance = json.loads((tires / "results.json").read_text())["provenance"]
    assert provenance["conditions"]["seeds"] == [1, 2]
    assert set(provenance["days"]) == {"1", "2", "11"}
    assert provenance["identification"]["vehicle"] == "identified.yaml"
    assert set(provenance["controllers"]) == set(LABELS)
    tuned = load_controller_parameters(tires / "controllers" / "map_paper.yaml")
    assert provenance["controllers"]["MAP Pacejka"]["m_m"] == tuned.m_m
    pairs = pd.read_csv(tires / "controllers" / "map_paper.csv")
    best = pairs.loc[pairs.rms_lateral_error_m.idxmin()]
    assert (best.m_m, best.q_s) == (tuned.m_m, tuned.q_s)
    assert tuned.delay_s == 0.0 and tuned.speed_scale == 0.7


def test_the_car_is_identified_from_a_recording_of_the_plant(tires):
    found, linear = (
        load_vehicle(tires / name) for name in ("identified.yaml", "identified_linear.yaml")
    )
    true = load_vehicle("nuc4")
    assert found.front != true.front and linear.front.model == "linear"
    # nuc4's plant: friction 0.98 and 0.92 of the front stiffness
    slip = np.array([0.05, 0.1, 0.2])
    softer = 0.98 * true.front.normalized_force(0.92 * slip)
    np.testing.assert_allclose(found.front.normalized_force(slip), softer, rtol=0.05)
    recording = read_recording(tires / "ramps.bag")
    assert recording.t[-1] > 60.0


def test_the_same_command_again_drives_nothing(place, tires, capsys):
    before = (tires / "table.csv").read_bytes()
    run(place, "experiment", "tire-models", "--laps", 2, "--bags", "--output", tires)
    assert re.search(r"^0 races driven, \d+ found on disk; 0 s of", capsys.readouterr().out, re.M)
    assert (tires / "table.csv").read_bytes() == before


@pytest.fixture(scope="module")
def scaling(place, tires):
    """Result directory of velocity-scaling, which takes over the races that tuned."""
    output = place / "scaling"
    options = ["--laps", 1, "--to", 0.65, "--seeds", 1, "--reuse", tires, "--jobs", 1]
    assert run(place, "experiment", "velocity-scaling", *options, "--output", output) == 0
    return output


def test_tables_of_velocity_scaling(scaling, tires):
    table = pd.read_csv(scaling / "table.csv")
    assert set(table.speed_scale) <= {0.6, 0.625, 0.65}
    assert set(table.controller) == set(LABELS)
    races = pd.read_csv(scaling / "races.csv")
    for _, own in races.groupby("controller"):  # all but the last are completed
        assert (own.outcome[:-1] == "completed").all()
        assert own.outcome.iloc[-1] != "completed" or own.speed_scale.iloc[-1] == 0.65
    highest = pd.read_csv(scaling / "highest_scales.csv")
    assert highest.seed.tolist() == [1] and set(highest.columns[1:]) == set(LABELS)
    assert (scaling / "figures" / "velocity_scaling.png").is_file()
    for name in ("map_paper", "pure_pursuit_paper"):
        first, second = (
            (folder / "controllers" / f"{name}.yaml").read_text() for folder in (scaling, tires)
        )
        assert first == second


def test_tuning_alone_finds_the_same(place, tires, capsys):
    output = place / "tuned"
    command = ["tune", "--controller", "map_paper", "--reuse", str(tires), "--output", str(output)]
    run(place, *command)
    assert "0 races driven" in capsys.readouterr().out
    name = Path("controllers") / "map_paper.yaml"
    assert (output / name).read_text() == (tires / name).read_text()
    assert (output / "figures" / "tuning_map_paper.png").is_file()
    table = pd.read_csv(output / "table.csv")
    assert table.controller.tolist() == ["map_paper"]


@pytest.mark.parametrize("name", ["own", "own.yml"])
def test_results_are_named_after_files_with_any_suffix(place, tires, tmp_path, capsys, name):
    (tmp_path / "in").mkdir()
    file, output = tmp_path / "in" / name, tmp_path / "out"
    save_controller_parameters(load_controller_parameters("map_paper"), file)
    options = ["--controller", file, "--vehicle", tires / "identified.yaml"]
    run(place, "tune", *options, "--reuse", tires, "--output", output)
    assert f"--controller {output / 'controllers' / 'own.yaml'} ..." in capsys.readouterr().out
    assert (output / "controllers" / "own.yaml").is_file()


def test_without_tuning_the_files_are_raced(place, tires, capsys):
    output = place / "shipped"
    options = ["--no-tuning", "--laps", 1, "--seeds", 1, "--output", output]
    run(place, "experiment", "tire-models", *options)
    assert "tuned" not in capsys.readouterr().out and not (output / "controllers").exists()
    raced = json.loads((output / "results.json").read_text())["provenance"]["controllers"]
    for label, name in zip(LABELS, ["pure_pursuit_paper", "map_linear_paper", "map_paper", "map"]):
        shipped = load_controller_parameters(name)
        assert (raced[label]["m_m"], raced[label]["q_s"]) == (shipped.m_m, shipped.q_s)


def test_comparison(place, tires, scaling, tmp_path, capsys):
    assert main(["compare", str(tires), str(tires), "--plots", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "No difference in provenance." in printed
    assert (tmp_path / "comparison.png").is_file()
    other = place / "one day"
    options = ["--laps", 2, "--seeds", 2, "--reuse", tires, "--output", other]
    run(place, "experiment", "tire-models", *options)
    capsys.readouterr()
    assert main(["compare", str(tires), str(other)]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"conditions\.seeds +1, 2 +2$", printed, re.M)
    assert "cannot compare" in refused(capsys, "compare", tires, scaling)
    assert "expected a result directory" in refused(capsys, "compare", tires, tmp_path)


def test_a_vehicle_that_is_given_is_raced(place, tires, tmp_path, capsys):
    options = ["--controller", "map_paper", "--vehicle", tires / "identified.yaml"]
    run(place, "tune", *options, "--reuse", tires, "--output", tmp_path / "given")
    printed = capsys.readouterr().out
    assert "identified NUC4" not in printed and not (tmp_path / "given" / "ramps.bag").exists()
    assert "\n0 races driven" in printed  # the same car as before


@pytest.mark.parametrize(
    "options, expected",
    [
        (["--laps", "0"], "--laps must be 1 to 1000, not 0"),
        (["--jobs", "0"], "jobs: expected at least 1, got 0"),
        (["--seeds", "1", "1"], "seeds: expected different seeds, got 1 twice"),
        (["--seeds", "-1"], "seeds: expected whole numbers from 0, got [-1]"),
        (["--conditions", "rain"], "nor one of the shipped experiments (paper)"),
        (["--track", "nowhere"], "nor one of the shipped tracks"),
        (["--plant", "nothing"], "nor one of the shipped plants"),
        (["--vehicle", "nobody"], "nor one of the shipped vehicles"),
        (["--reuse", "nowhere"], "nowhere: expected a result directory with a folder runs"),
        (["--output", ""], "expected the name of a folder"),
        (["--scheduler", "tcp://127.0.0.1:1"], "no Dask scheduler answers"),
    ],
)
def test_mistakes_are_one_line(tmp_path, capsys, monkeypatch, options, expected):
    monkeypatch.setattr("map_racing.experiments.executors._PATIENCE", 1.0)
    vehicle = [] if "--vehicle" in options else ["--vehicle", "nuc4"]
    command = ["experiment", "tire-models", *vehicle, "--output", tmp_path / "out"]
    assert expected in refused(capsys, *command, *options)


@pytest.mark.parametrize("to", ["0.5", "2.1", "nan"])
def test_impossible_scales(tmp_path, capsys, to):
    command = ["experiment", "velocity-scaling", "--output", tmp_path / "out", "--to", to]
    assert "--to must be 0.6 to 2" in refused(capsys, *command)


def test_results_of_another_kind_are_not_overwritten(tires, capsys):
    line = refused(capsys, "experiment", "velocity-scaling", "--output", tires)
    assert "holds results of tire-models; choose another" in line


def test_processes_work_from_the_script_for_rosrun(place, tires, tmp_path):
    """They import the script anew, which must not start it again."""
    script = Path(__file__).resolve().parents[3] / "scripts" / "map-racing"
    options = ["--conditions", place / "conditions.yaml", "--jobs", 2, "--reuse", tires]
    command = ["experiment", "tire-models", "--laps", 1, "--seeds", 5, "--output", tmp_path / "out"]
    arguments = [sys.executable, script, *command, *options]
    done = subprocess.run(list(map(str, arguments)), capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert "\n8 races driven" in done.stdout
