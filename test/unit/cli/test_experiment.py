"""``map-racing experiment``: tables, figures and provenance of races on a small circle."""

import json
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from map_racing.bags.reader import read_recording
from map_racing.cli import main
from map_racing.cli.experiment import frame_rows
from map_racing.control.parameters import load_controller_parameters
from map_racing.evaluation.recordings import recorded_raceline
from map_racing.evaluation.runs import evaluate
from map_racing.simulation.recorded import GROUND_TRUTH_TOPIC
from map_racing.track.files.load import save_raceline
from map_racing.track.raceline import Raceline
from map_racing.vehicle.parameters import load_vehicle

LABELS = ["pure pursuit", "MAP linear", "MAP Pacejka", "MAP default", "MAP adaptive"]


def test_tables_of_tire_models(tires):
    table = pd.read_csv(tires / "table.csv")
    keys = [(scale, label) for scale in (0.7, 0.8) for label in LABELS]
    assert list(zip(table.speed_scale, table.controller)) == keys
    assert (table.days == 2).all()
    races = pd.read_csv(tires / "races.csv")
    assert len(races) == 20 and set(races.seed) == {1, 2}
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


@pytest.mark.parametrize(
    "kind, options, said",
    [
        ("tire-models", ["--vehicle", "nuc4", "--seeds", "1"], "N.C. after 0 laps"),
        ("velocity-scaling", ["--vehicle", "nuc4", "--seeds", "1"], r"MAP default +none +none"),
        ("robustness", ["--generated"], r"(?ms): +did not start$.*^map: 0 of \d+ completed$"),
    ],
)
def test_races_that_are_over_before_the_first_pose_are_results(
    tmp_path, capsys, kind, options, said
):
    """On a track narrower than the car."""
    angle = 2.0 * np.pi * np.arange(60) / 60
    wall = np.full(60, 0.05)
    x, y = 4.0 * np.cos(angle), 4.0 * np.sin(angle)
    line = Raceline(x, y, vx_mps=3.0 + wall, d_left_m=wall, d_right_m=wall)
    save_raceline(line, tmp_path / "narrow.csv")
    track = ["--tracks" if kind == "robustness" else "--track", str(tmp_path / "narrow.csv")]
    options = [*options, *track, "--laps", "1", "--output", str(tmp_path / "out"), "--jobs", "1"]
    options += [] if kind == "robustness" else ["--no-tuning"]
    assert main(["experiment", kind, *options]) == 0
    assert re.search(said, capsys.readouterr().out)
    assert main(["compare", str(tmp_path / "out"), str(tmp_path / "out")]) == 0


def test_what_is_not_known_is_a_dash():
    frame = pd.DataFrame({"controller": ["MAP"], "median_lap_time_s": [math.nan], "days": [0]})
    assert frame_rows(frame)[1] == ["MAP", "-", "0"]


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
    assert any("identified NUC4 from steering ramps" in note for note in provenance["notes"])
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


@pytest.mark.once
def test_the_same_command_again_drives_nothing(run, tires, capsys):
    before = (tires / "table.csv").read_bytes()
    run("experiment", "tire-models", "--laps", 2, "--bags", "--output", tires)
    told = r"^0 races driven, \d+ found on disk; 0 s simulated in 0 s of processor time, "
    assert re.search(told, capsys.readouterr().out, re.M)
    assert (tires / "table.csv").read_bytes() == before


def test_tables_of_velocity_scaling(scaling, tires):
    table = pd.read_csv(scaling / "table.csv")
    assert set(table.speed_scale) <= {0.6, 0.625, 0.65}
    assert set(table.controller) == set(LABELS)
    races = pd.read_csv(scaling / "races.csv")
    for _, own in races.groupby("controller"):  # all except the last are completed
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


def test_without_tuning_the_files_are_raced(shipped):
    assert not (shipped / "controllers").exists()
    raced = json.loads((shipped / "results.json").read_text())["provenance"]["controllers"]
    for label, name in zip(LABELS, ["pure_pursuit_paper", "map_linear_paper", "map_paper", "map"]):
        shipped = load_controller_parameters(name)
        assert (raced[label]["m_m"], raced[label]["q_s"]) == (shipped.m_m, shipped.q_s)


@pytest.mark.parametrize(
    "options, expected",
    [
        (["--laps", "0"], "--laps: expected 1 to 1000, got 0"),
        (["--jobs", "0"], "jobs: expected at least 1, got 0"),
        (["--seeds", "1", "1"], "seeds: expected different seeds, got 1 twice"),
        (["--seeds", "-1"], "seeds: expected whole numbers from 0, got [-1]"),
        (["--conditions", "rain"], "nor one of the shipped experiments (full_scale, paper, "),
        (["--conditions", "robustness"], "expected conditions of a track and its race days, such"),
        (["--track", "nowhere"], "nor one of the shipped tracks"),
        (["--plant", "nothing"], "nor one of the shipped plants"),
        (["--vehicle", "nobody"], "nor one of the shipped vehicles"),
        (["--reuse", "nowhere"], "nowhere: expected a result directory with a folder runs"),
        (["--output", ""], "expected the name of a folder"),
        (["--scheduler", "tcp://127.0.0.1:1"], "no Dask scheduler answers"),
    ],
)
def test_mistakes_are_one_line(tmp_path, refused, monkeypatch, options, expected):
    monkeypatch.setattr("map_racing.experiments.executors._PATIENCE", 1.0)
    vehicle = [] if "--vehicle" in options else ["--vehicle", "nuc4"]
    output = [] if "--output" in options else ["--output", tmp_path / "out"]
    command = ["experiment", "tire-models", *vehicle, *output]
    assert expected in refused(*command, *options)
    # Nothing was begun.
    assert options[0] in ("--reuse", "--scheduler") or not (tmp_path / "out").exists()


@pytest.mark.parametrize("to", ["0.5", "2.1", "nan"])
def test_impossible_scales(tmp_path, refused, to):
    command = ["experiment", "velocity-scaling", "--output", tmp_path / "out", "--to", to]
    assert "--to: expected 0.6 to 2" in refused(*command)


def test_results_of_another_kind_are_not_overwritten(tires, refused):
    line = refused("experiment", "velocity-scaling", "--output", tires)
    assert "holds results of tire-models; choose another" in line


@pytest.mark.once
def test_processes_work_from_the_script_for_rosrun(place, tmp_path):
    """They import the script again, which must not start it."""
    script = Path(__file__).resolve().parents[3] / "scripts" / "map-racing"
    options = ["--conditions", place / "conditions.yaml", "--jobs", 2, "--output", tmp_path / "out"]
    options += ["--vehicle", "nuc4", "--no-tuning", "--laps", 1, "--seeds", 5]
    command = [sys.executable, script, "experiment", "tire-models", *options]
    done = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert "\n10 races driven" in done.stdout


@pytest.mark.parametrize("option", ["--track", "--plant", "--vehicle", "--conditions", "--reuse"])
def test_a_failed_experiment_leaves_no_folder(tmp_path, capsys, option):
    output = tmp_path / "results"
    assert main(["experiment", "tire-models", option, "nowhere", "--output", str(output)]) == 1
    expected = "expected a result directory" if option == "--reuse" else "no such file"
    assert f"nowhere: {expected}" in capsys.readouterr().err
    assert not output.exists()
