import json
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from map_racing.bags.samples import Recording
from map_racing.errors import MapRacingError
from map_racing.evaluation import report
from map_racing.evaluation.lap_limits import LapLimits
from map_racing.evaluation.runs import evaluate
from map_racing.files import write_json

BOUNDARY_COLUMNS = [
    "lap",
    "lap_time_s",
    "rms_lateral_error_m",
    "mean_abs_lateral_error_m",
    "max_abs_lateral_error_m",
    "valid",
    "reason",
]


@pytest.fixture(scope="module")
def results(track):
    def run(duration, source):
        t = np.arange(int(duration * 40.0)) / 40.0
        x, y, psi = track.place(6.0 * t - 3.0, 0.1)
        nan = np.full(t.size, math.nan)
        recording = Recording(t, x, y, psi, nan + 6.0, nan, nan, source=source, notes=["a note"])
        return evaluate(recording, track.raceline(walls=1.0))

    return [run(12.0, "a.bag"), run(0.4, "b.bag")]


def test_csv(tmp_path, results):
    path = tmp_path / "laps.csv"
    path.write_text("old")
    report.write_csv(path, results)
    table = pd.read_csv(path)
    assert list(table.columns[:8]) == ["bag", *BOUNDARY_COLUMNS]
    assert list(table["bag"]) == 4 * ["a.bag"] + ["b.bag"]
    assert list(table["valid"]) == [False, True, True, False, False]
    assert table["lap_time_s"][1] == pytest.approx(results[0].laps[1].lap_time_s, abs=1e-12)
    assert math.isnan(table["lap_time_s"][0])
    assert list(table.columns[-4:]) == ["sector_1_s", "sector_2_s", "sector_3_s", "warnings"]
    assert list(tmp_path.iterdir()) == [path]


def test_json(tmp_path, results):
    path = tmp_path / "laps.json"
    write_json(path, report.lap_data(results))
    runs = json.loads(path.read_text())["runs"]
    assert [run["bag"] for run in runs] == ["a.bag", "b.bag"]
    assert set(BOUNDARY_COLUMNS) <= set(runs[0]["laps"][0])
    assert runs[0]["laps"][0]["lap_time_s"] is None
    assert runs[0]["laps"][1]["valid"] is True
    assert runs[0]["summary"]["laps_completed"] == 2
    assert runs[1]["summary"]["mean_lap_time_s"] is None
    assert runs[0]["notes"] == ["a note"]


def test_data_of_nothing():
    assert report.lap_data([]) == {"runs": []}


def test_lap_table(results):
    lines = report.lap_table(results[0]).splitlines()
    assert len(lines) == 1 + 4 + 2
    assert lines[1].split()[1] == "-"
    assert lines[1].endswith("out-lap")
    assert f"{results[0].laps[1].lap_time_s:.3f}" in lines[2]
    assert "2 laps counted, 2 stretches not" in lines[-1]
    assert "N.C." in report.lap_table(results[1]).splitlines()[-1]
    assert all(line == line.rstrip() for line in lines)


def test_summary_table(results):
    lines = report.summary_table([("first", results[0]), ("second", results[1])]).splitlines()
    assert len(lines) == 3
    assert lines[1].startswith("first ")
    summary = results[0].summary
    assert f"{summary.mean_lap_time_s:.3f} +- {summary.std_lap_time_s:.3f}" in lines[1]
    assert summary.std_lap_time_s < 0.01
    assert lines[2].split()[:3] == ["second", "0", "N.C."]


def test_single_lap_has_no_deviation(results):
    summary = replace(results[0].summary, std_lap_time_s=math.nan)
    lines = report.summary_table([("one", replace(results[0], summary=summary))]).splitlines()
    assert "nan" not in lines[1]


def test_places_where_nothing_can_be_written(tmp_path, results):
    for path in (tmp_path / "missing" / "laps", tmp_path):
        with pytest.raises(MapRacingError, match="cannot write"):
            report.write_csv(path, results)
    assert list(tmp_path.iterdir()) == []


def test_laps_that_were_driven_but_do_not_count_are_not_called_incomplete(track):
    s = 5.0 * np.arange(800) / 40.0
    x, y, _ = track.place(s - 3.0, 2.5)
    t = np.arange(800) / 40.0
    nan = np.full(800, math.nan)
    driven = Recording(t, x, y, nan, nan, nan, nan, source="wide.bag")
    limits = LapLimits(max_deviation=2.2)
    text = report.lap_table(evaluate(driven, track.raceline(), limits=limits))
    assert "3 laps driven, but none counts, 3 of them off track: --max-deviation" in text
    assert "N.C." not in text
