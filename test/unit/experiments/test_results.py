"""Result directories: read back as written, compared if that makes sense."""

import json
import math

import pandas as pd
import pytest

from map_racing.errors import FileFormatError, ParameterError
from map_racing.experiments.results import Results, compare, read_results, write_results


def results(kind="tire-models", sha="aa", name="reference", scales=(0.7, 0.8), **provenance):
    rows = [
        {
            "speed_scale": scale,
            "controller": label,
            "days": 2,
            "days_completed": 2 if scale < 0.8 else 0,
            "mean_lap_time_s": 8.0 + scale if scale < 0.8 else math.nan,
            "mean_abs_lateral_error_m": 0.1 * scale,
            "max_abs_lateral_error_m": scale,
        }
        for scale in scales
        for label in ("pure pursuit", "MAP Pacejka")
    ]
    track = {"name": name, "sha256": sha}
    return Results(kind, pd.DataFrame(rows), {"track": track, **provenance})


def test_results_come_back(tmp_path):
    written = results(seeds=[1, 2], days={"1": {"mu_scale": 0.97}})
    write_results(tmp_path, written, races=pd.DataFrame({"seed": [1, 2]}))
    read = read_results(tmp_path)
    assert (read.kind, read.provenance) == (written.kind, written.provenance)
    pd.testing.assert_frame_equal(
        read.table[written.table.columns], written.table, check_dtype=False
    )
    pd.testing.assert_frame_equal(pd.read_csv(tmp_path / "table.csv"), written.table)
    assert pd.read_csv(tmp_path / "races.csv").seed.tolist() == [1, 2]
    json.loads((tmp_path / "results.json").read_text(), parse_constant=pytest.fail)


def test_the_same_results_have_no_difference():
    comparison = compare(results(seeds=[1]), results(seeds=[1]))
    assert comparison.differences == comparison.only_a == comparison.only_b == []
    assert (comparison.table.max_abs_lateral_error_m_change == 0.0).all()
    assert comparison.values[0] == "days_completed"


def test_changes_and_what_differs_in_provenance():
    first = results(seeds=[1], days={"1": 0.9}, vehicle={"m": 3.31, "front": {"B": 4.0}}, laps=5)
    second = results(
        scales=(0.7, 0.9),
        seeds=[1, 2],
        days={"1": 0.95, "2": 1.1},
        vehicle={"m": 3.31, "front": {"B": 4.5}},
        note="x",
    )
    second.table.loc[1, "mean_abs_lateral_error_m"] += 0.02
    comparison = compare(first, second)
    assert comparison.table.mean_abs_lateral_error_m_change.tolist() == pytest.approx([0.0, 0.02])
    assert comparison.only_a == [(0.8, "pure pursuit"), (0.8, "MAP Pacejka")]
    assert comparison.only_b == [(0.9, "pure pursuit"), (0.9, "MAP Pacejka")]
    assert comparison.differences == [
        ("seeds", "1", "1, 2"),
        ("days.1", "0.9", "0.95"),
        ("vehicle.front.B", "4", "4.5"),
        ("laps", "5", "-"),
        ("note", "-", "x"),
    ]


@pytest.mark.parametrize(
    "other, expected",
    [
        (
            results("velocity-scaling"),
            "cannot compare tire-models with velocity-scaling: expected one experiment",
        ),
        (results(sha="bb", name="club"), "different tracks, reference and club"),
        (results(sha="bb"), "different versions of the track reference"),
        (results(scales=(0.9,)), "no scale and controller in common"),
    ],
)
def test_what_cannot_be_compared(other, expected):
    with pytest.raises(ParameterError, match=expected):
        compare(results(), other)


@pytest.mark.parametrize(
    "content", ["", "[]", "{}", '{"kind": "tire-models", "rows": [], "provenance": {}}']
)
def test_other_files_are_refused(tmp_path, content):
    (tmp_path / "results.json").write_text(content)
    with pytest.raises(FileFormatError, match="results.json: expected results of an experiment"):
        read_results(tmp_path)


@pytest.mark.parametrize("name", [None, 5, ["MAP"]])
def test_a_controller_without_name_is_refused(tmp_path, name):
    write_results(tmp_path, results())
    content = json.loads((tmp_path / "results.json").read_text())
    content["rows"][0]["controller"] = name
    (tmp_path / "results.json").write_text(json.dumps(content))
    with pytest.raises(FileFormatError, match="results.json: expected results of an experiment"):
        read_results(tmp_path)


@pytest.mark.parametrize("content", ["[" * 5000, "SCALE"])
def test_damaged_results_are_refused(tmp_path, content):
    write_results(tmp_path, results())
    path = tmp_path / "results.json"
    whole = path.read_text()
    path.write_text(whole.replace("0.7,", "null,") if content == "SCALE" else content)
    with pytest.raises(FileFormatError, match="results.json: expected results of an experiment"):
        read_results(tmp_path)


def test_other_folders_are_refused(tmp_path):
    with pytest.raises(FileFormatError, match="'': expected the name of a result directory"):
        read_results("")
    with pytest.raises(FileFormatError, match="expected a result directory with results.json"):
        read_results(tmp_path)
