"""The robustness experiment and robust tuning from the command line, on a small grid."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from map_racing.cli import main
from map_racing.control.parameters import (
    load_controller_parameters,
    load_law,
    save_controller_parameters,
)
from map_racing.errors import ParameterError
from map_racing.experiments import tuning
from map_racing.experiments.jobs import execute
from map_racing.experiments.robustness import Grid, Robustness, bumped, load_robustness
from map_racing.experiments.robustness_tables import race_rows
from map_racing.track.files.load import load_raceline
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.size import size_of

GRID = """\
plant: nuc4
cars:
  as shipped: {}
  slippery: {mu_scale: x 0.9}
  "public simulator, 50 ms": {plant: public_simulator, localization_rate_hz: 100.0}
generated_seeds: [13]
laps: 1
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with a grid and a controller without a grip limit."""
    folder = tmp_path_factory.mktemp("robustness")
    (folder / "grid.yaml").write_text(GRID)
    bold = load_controller_parameters("map").with_(grip_use=0.0)
    save_controller_parameters(bold, folder / "bold.yaml")
    return folder


def run(folder, *command):
    """Run a command on the grid in this process; its exit code."""
    arguments = [*command, "--grid", folder / "grid.yaml", "--jobs", 1]
    return main([str(argument) for argument in arguments])


@pytest.fixture(scope="module")
def results(folder):
    """Result directory with a scale at which speeds beyond the grip end in the wall."""
    output = folder / "grid"
    assert (
        run(
            *(folder, "experiment", "robustness", "--controller", "map", folder / "bold.yaml"),
            *("--speed-scale", 1.4, "--output", output),
        )
        == 0
    )
    return output


def test_every_car_is_raced_on_every_track(results):
    races = pd.read_csv(results / "races.csv")
    assert races.groupby(["controller", "track"]).size().tolist() == [3, 3]
    assert set(races.car) == {"as shipped", "slippery", "public simulator, 50 ms"}
    ours = races[(races.controller == "map") & ~races.car.str.startswith("public")]
    assert (ours.outcome == "completed").all() and ours.cause.isna().all()
    assert (ours.rms_lateral_error_m < 0.05).all()
    assert (ours.lap_time_s > 3.0).all()


def test_what_was_not_completed_has_place_and_cause(results):
    races = pd.read_csv(results / "races.csv")
    ended = races[(races.controller == "bold") & (races.outcome != "completed")]
    assert len(ended) and ended.end_s_m.between(0.0, 25.0).all()
    assert ended.cause.str.contains(" at [0-9]").all()


def test_table_provenance_and_figures(results):
    table = pd.read_csv(results / "table.csv").set_index("controller")
    assert table.loc["map", "races"] == 3
    assert table.loc["map", "races_completed"] > table.loc["bold", "races_completed"]
    content = json.loads((results / "results.json").read_text())
    assert content["kind"] == "robustness"
    cars = content["provenance"]["cars"]
    assert cars["slippery"]["mu_scale"] == pytest.approx(0.9 * cars["as shipped"]["mu_scale"])
    assert cars["public simulator, 50 ms"]["steering_delay_s"] == 0.05
    assert {path.name for path in (results / "figures").iterdir()} == {
        "robustness_map.png",
        "robustness_bold.png",
    }


def test_doubts_about_tracks_stand_in_the_provenance(results, tmp_path):
    content = json.loads((results / "results.json").read_text())
    assert content["provenance"]["notes"] == []
    angle = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    x, y, v = 5.0 * np.cos(angle), 4.0 * np.sin(angle), 4.0 + np.sin(angle) ** 2
    np.savetxt(tmp_path / "line.csv", np.stack((x, y, v), axis=1), delimiter=",")
    notes = Grid(Robustness("nuc4", {"a": {}}, tracks=(str(tmp_path / "line.csv"),))).notes
    assert len(notes) == 2 and "3 unnamed columns" in notes[0] and "no walls" in notes[1]


def test_the_same_again_drives_nothing(folder, results, capsys):
    options = ("--controller", "map", "--speed-scale", 1.4, "--output", results)
    (results / "figures" / "robustness_final.png").write_text("the user's own")
    assert run(folder, "experiment", "robustness", *options) == 0
    own = {"robustness_map.png", "robustness_final.png"}
    assert {path.name for path in (results / "figures").iterdir()} == own
    said = capsys.readouterr().out
    assert "robustness_bold.png: removed: left over from an earlier call" in said
    assert "0 races driven, 3 found on disk" in said
    assert "RMS error" in said and "map: " in said


@pytest.mark.parametrize(
    "text, expected",
    [
        ("plant: nuc4\ncars: {a: {}}\n", "expected at least one track, got none"),
        (GRID.replace("x 0.9", "x much"), "cars: slippery: mu_scale: expected x and a number"),
        (GRID.replace("mu_scale", "mu"), "cars: slippery: unknown parameter mu"),
        (GRID.replace("laps: 1", "laps: 0"), "laps: expected at least 1"),
        (GRID.replace("plant: nuc4", "plant: nuc5"), "nuc5: no such file"),
        (GRID + "day: 1\n", "unknown parameter day"),
        ("track: reference\nplant: nuc4\n", "expected a grid of tracks and cars, such as"),
        (GRID.replace("plant: nuc4", "plant: [a]"), "of the shipped plants or a path, got ['a']"),
        (GRID.replace("as shipped: {}", "own: {vehicle: 5}"), "shipped vehicles or a path, got 5"),
    ],
)
def test_mistakes_in_the_grid_are_one_line(tmp_path, capsys, text, expected):
    (tmp_path / "grid.yaml").write_text(text)
    command = ("experiment", "robustness", "--output", tmp_path / "out")
    assert run(tmp_path, *command) == 1
    said = capsys.readouterr().err
    assert expected in said and said.count("\n") == 1


def test_a_grid_of_passenger_cars_is_raced_at_their_size(folder, tmp_path, capsys):
    small = Grid(load_robustness(folder / "grid.yaml")).tracks[0]
    (tmp_path / "car.yaml").write_text("vehicle: bmw_320i\na_max_mps2: 3.5\n")
    text = GRID.replace("nuc4", str(tmp_path / "car.yaml")).replace("as shipped: {}", "own: {}")
    (tmp_path / "grid.yaml").write_text("\n".join(text.splitlines()[:3] + text.splitlines()[5:]))
    track = Grid(load_robustness(tmp_path / "grid.yaml")).tracks[0]
    size = size_of(load_vehicle("bmw_320i"))
    assert track.length == pytest.approx(size.length * small.length)
    assert track.d_left.mean() == pytest.approx(size.length * small.d_left.mean())
    # The same lateral accelerations.
    assert np.median(track.speed**2 * np.abs(track.kappa)) == pytest.approx(
        np.median(small.speed**2 * np.abs(small.kappa)), rel=0.02
    )
    assert run(tmp_path, "experiment", "robustness", "--output", tmp_path / "out") == 0
    assert "map: 1 of 1 completed" in capsys.readouterr().out
    content = json.loads((tmp_path / "out" / "results.json").read_text())
    controller = content["provenance"]["controllers"]["map"]
    assert controller["m_m"] == load_law("map", load_vehicle("bmw_320i")).m_m


@pytest.mark.once
def test_robust_tuning(place, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(tuning, "MOST_MOVES", 1)
    small = GRID.replace("generated_seeds: [13]", f"tracks: [{place / 'ring.csv'}]")
    (tmp_path / "grid.yaml").write_text(small)
    output = tmp_path / "tuned"
    options = ("--controller", "map", "--grip-use", 0.8, "--output", output)
    assert run(tmp_path, "tune", "--robust", *options) == 0
    said = capsys.readouterr().out
    assert "all 3 races completed" in said and "grip_use 0.8: 3 of 3 completed" in said
    candidates = pd.read_csv(output / "candidates.csv")
    best = candidates[candidates.races == 3].typical_rms_lateral_error_m.min()
    table = pd.read_csv(output / "table.csv").iloc[0]
    assert table.typical_rms_lateral_error_m == best
    found = load_controller_parameters(output / "controllers" / "map.yaml")
    # Up to the last digit, which old versions of pandas read differently.
    values = (table.m_m, table.q_s, table.delay_s)
    assert (found.m_m, found.q_s, found.delay_s) == pytest.approx(values, rel=1e-12)
    assert found.grip_use == load_controller_parameters("map").grip_use


@pytest.mark.parametrize("option", ["--grid", "--tracks", "--generated", "--grip-use"])
def test_options_of_the_grid_belong_to_robust_tuning(tmp_path, capsys, option):
    assert main(["tune", option, "1", "--output", str(tmp_path / "x")]) == 1
    assert f"{option} belongs to --robust" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--speed-scale", "--seeds", "--track", "--plant", "--vehicle"])
def test_robust_tuning_refuses_what_it_would_ignore(tmp_path, capsys, option):
    assert run(tmp_path, "tune", "--robust", option, 1, "--output", tmp_path / "x") == 1
    assert f"{option}: not with --robust" in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_an_impossible_share_is_refused_before_the_tuning(tmp_path, capsys):
    words = ["tune", "--robust", "--grip-use", "0.8", "2", "--output", str(tmp_path / "x")]
    assert main(words) == 1
    assert "grip_use: expected 0 to 1.2, got 2" in capsys.readouterr().err
    assert not (tmp_path / "x" / "runs").exists()


@pytest.mark.once
def test_a_bump_leaves_the_rest_of_the_line_where_it_is():
    line = load_raceline("reference")
    changed = bumped(line, place=0.35, length_m=2.5, offset_m=0.3)
    points = changed.sample(np.linspace(0.0, changed.length, 4000, endpoint=False))
    d = np.array([line.project(x, y).d for x, y in zip(points.x, points.y)])
    at = np.array([line.project(x, y).s for x, y in zip(points.x, points.y)])
    along = (at - 0.35 * line.length) / 2.5
    wanted = np.where((along > 0.0) & (along < 1.0), 0.3 * np.sin(np.pi * along) ** 2, 0.0)
    assert np.max(np.abs(d - wanted)) < 2e-3
    assert d.max() == pytest.approx(0.3, abs=2e-3)
    # The walls stay in their places.
    left = points.d_left + d
    original = line.sample(at).d_left
    assert np.max(np.abs(np.where(points.d_left > 0.21, left - original, 0.0))) < 0.02


def test_each_track_is_raced_with_each_bump():
    bumps = [{"place": 0.1, "length_m": 2.5, "offset_m": o} for o in (0.3, -0.4)]
    grid = Grid(Robustness("nuc4", {"a": {}}, ("reference",), (13,), bumps))
    assert [name for name, _ in grid.names] == [
        "reference, +0.3 m at 10%",
        "reference, -0.4 m at 10%",
        "track13, +0.3 m at 10%",
        "track13, -0.4 m at 10%",
    ]


@pytest.mark.once
def test_map_finds_back_to_rough_lines():
    grid = Grid(replace(load_robustness("rough_lines"), tracks=("reference",)))
    results = [execute(job).result for job in grid.jobs("map", load_controller_parameters("map"))]
    races = race_rows(grid, "map", results)
    assert (races.outcome == "completed").all()
    assert races.rms_lateral_error_m.mean() < 0.055


@pytest.mark.parametrize(
    "bump, message",
    [
        ({"place": 0.1}, "bumps: expected length_m, offset_m, place"),
        ({"place": 1.0, "length_m": 1.0, "offset_m": 0.1}, "bumps: place: expected 0 to 1"),
        ({"place": 0.1, "length_m": 0.0, "offset_m": 0.1}, "bumps: length_m: expected more"),
        ({"place": 0.1, "length_m": 1.0, "offset_m": float("nan")}, "bumps: offset_m"),
        ({"place": 0.1, "length_m": 99.0, "offset_m": 0.1}, "bumps: length_m: .* lap of reference"),
    ],
)
def test_impossible_bumps_are_refused(bump, message):
    with pytest.raises(ParameterError, match=message):
        Grid(Robustness("nuc4", {"a": {}}, ("reference",), bumps=[bump]))
