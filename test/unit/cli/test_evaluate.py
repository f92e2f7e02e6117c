"""``map-racing evaluate`` as its users meet it."""

import argparse
import json
import os
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from map_racing.bags.writer import BagWriter
from map_racing.cli import main
from map_racing.cli.evaluate import run_names
from map_racing.cli.options.evaluate import add_evaluation_options
from map_racing.evaluation.lap_limits import LapLimits
from map_racing.track.files.waypoints import waypoint_rows


def test_evaluate_writes_what_it_prints(bags, tmp_path, capsys):
    paths = [str(path) for path in bags.values()]
    table, report, plots = tmp_path / "l.csv", tmp_path / "l.json", tmp_path / "plots"
    files = ["--csv", str(table), "--json", str(report), "--plots", str(plots)]
    assert main(["evaluate", *paths, *files]) == 0
    printed = capsys.readouterr().out
    assert "map_0.7" in printed and "out-lap" in printed

    laps = pd.read_csv(table)
    assert list(laps.columns[:3]) == ["bag", "lap", "lap_time_s"]
    runs = json.loads(report.read_text())["runs"]
    assert [run["bag"] for run in runs] == paths
    for run in runs:
        assert run["summary"]["laps_completed"] == 2
        valid = [lap for lap in run["laps"] if lap["valid"]]
        read = laps[(laps["bag"] == run["bag"]) & laps["valid"]]
        assert [lap["lap_time_s"] for lap in valid] == pytest.approx(list(read["lap_time_s"]))
    ours, theirs = (run["summary"]["mean_rms_lateral_error_m"] for run in runs)
    assert ours < 0.3 * theirs
    names = {path.name for path in plots.iterdir()}
    assert names == {"boxes.png", "difference.png"} | {
        f"{name}_0.7_{kind}.png" for name in bags for kind in ("laps", "speed", "error")
    }


def test_evaluate_refuses(bags, tmp_path, refused):
    bag = bags["map"]
    assert "no such file" in refused("evaluate", tmp_path / "none.bag").lower()
    (tmp_path / "text.bag").write_text("hello\n" * 100)
    assert "text.bag" in refused("evaluate", tmp_path / "text.bag")
    (tmp_path / "empty.bag").write_bytes(b"")
    assert "empty.bag" in refused("evaluate", tmp_path / "empty.bag")
    (tmp_path / "car.yaml").write_text("m: 3\n")
    told = "car.yaml: expected a bag of ROS 1 (format 2.0) or ROS 2, or a CSV file, got another"
    assert told in refused("evaluate", tmp_path / "car.yaml")
    assert "/nothing" in refused("evaluate", bag, "--pose-topic", "/nothing")
    assert "club" in refused("evaluate", bag, "--raceline", "club")
    assert "no pose on /" in refused("evaluate", bag, "--pose-topic", "")
    assert "'': expected the name" in refused("evaluate", bag, "--raceline", "")
    assert "'': expected the name" in refused("evaluate", "")
    assert "map-racing season takes folders of bags" in refused("evaluate", tmp_path)
    assert "start line" in refused("evaluate", bag, "--start-line", "nan")
    assert "max-deviation" in refused("evaluate", bag, "--max-deviation", "0")
    assert "max-stop" in refused("evaluate", bag, "--max-stop", "0")
    assert "max-deceleration" in refused("evaluate", bag, "--max-deceleration", "nan")
    path = tmp_path / "run.csv"
    path.write_text("t,x,y\n0,0,0\n1,1,0\n")
    told = refused("evaluate", path)
    assert "no raceline" in told and "map-racing raceline record" in told
    assert refused("evaluate", bag, "--csv", tmp_path / "no" / "laps.csv")


def test_runs_on_different_tracks_have_no_difference(bags, tmp_path, capsys):
    other = tmp_path / "club.bag"
    arguments = ["--laps", "1", "--track", "club", "--speed-scale", "0.5", "--output", str(other)]
    assert main(["race", *arguments]) == 0
    (tmp_path / "two").mkdir()
    for name in ("difference.png", "mine.png"):
        (tmp_path / "two" / name).write_text("of an earlier call")
    assert main(["evaluate", str(bags["map"]), str(other), "--plots", str(tmp_path / "two")]) == 0
    printed = capsys.readouterr().out
    assert "no difference.png: club: expected the raceline" in printed
    assert "difference.png: removed: left over from an earlier call" in printed
    names = {path.name for path in (tmp_path / "two").iterdir()}
    assert {"boxes.png", "mine.png"} <= names and "difference.png" not in names


def test_one_bad_recording_does_not_hold_up_the_others(bags, tmp_path, capsys):
    table = tmp_path / "laps.csv"
    paths = [str(bags["map"]), str(tmp_path / "none.bag"), str(bags["pure_pursuit"])]
    assert main(["evaluate", *paths, "--csv", str(table)]) == 1
    printed = capsys.readouterr()
    assert len(printed.err.splitlines()) == 1 and "none.bag" in printed.err
    assert set(pd.read_csv(table)["bag"]) == {paths[0], paths[2]}


def test_the_report_tells_the_raceline_that_was_used(bags, tmp_path, capsys):
    assert main(["evaluate", str(bags["map"]), "--raceline", "reference"]) == 0
    printed = capsys.readouterr().out
    assert "raceline: reference; heading" in printed and "/global_waypoints" not in printed
    assert main(["evaluate", str(bags["map"]), "--reverse"]) == 0
    printed = capsys.readouterr().out
    assert "raceline reversed" in printed and "0 laps counted" in printed


def test_a_stop_that_is_allowed(tmp_path, capsys):
    """A car circles at 2 m/s on 5 m of radius, and stands for 4 s in its second lap."""
    t = np.arange(0.0, 80.0, 0.025)
    angle = np.interp(t, [0.0, 30.0, 34.0, 80.0], [0.0, 60.0, 60.0, 152.0]) / 5.0 - 0.5
    rows = [f"{at},{5 * np.cos(a)},{5 * np.sin(a)}" for at, a in zip(t, angle)]
    (tmp_path / "run.csv").write_text("\n".join(["t,x,y", *rows]))
    ring = 2.0 * np.pi * np.arange(60) / 60
    points = np.stack((5 * np.cos(ring), 5 * np.sin(ring)), axis=1)
    np.savetxt(tmp_path / "line.csv", points, delimiter=",")
    arguments = ["evaluate", str(tmp_path / "run.csv"), "--raceline", str(tmp_path / "line.csv")]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    assert "stood 4.0 s at s = 26.0 m" in printed and "3 laps counted" in printed
    assert main([*arguments, "--max-stop", "5"]) == 0
    assert "4 laps counted" in capsys.readouterr().out
    parser = argparse.ArgumentParser()
    add_evaluation_options(parser)
    given, limits = vars(parser.parse_args(["run.bag"])), LapLimits()
    for name in ("max_deviation", "max_stop", "max_deceleration"):
        assert given[name] == getattr(limits, name)


def test_driven_the_other_way_round(shared_data, tmp_path):
    folder = shared_data / "laps" / "ipz20"
    run = str(min(folder.glob("*.csv.gz")))
    reports = []
    for raceline, option in (("IPZ20_wp.csv", []), ("IPZ20_wp_reverse.csv", ["--reverse"])):
        report = tmp_path / f"{raceline}.json"
        arguments = ["--raceline", str(folder / raceline), "--json", str(report), *option]
        assert main(["evaluate", run, "--max-deviation", "1", *arguments]) == 0
        reports.append(json.loads(report.read_text())["runs"][0]["summary"])
    assert reports[0]["laps_completed"] == reports[1]["laps_completed"] == 3


def test_a_truncated_bag_gives_the_laps_it_still_has(bags, tmp_path):
    data = bags["map"].read_bytes()
    path = tmp_path / "cut.bag"
    path.write_bytes(data[: int(0.6 * len(data))])
    assert main(["evaluate", str(path), "--json", str(tmp_path / "l.json")]) == 0
    (run,) = json.loads((tmp_path / "l.json").read_text())["runs"]
    assert any("messages" in note for note in run["notes"])
    assert run["laps"]


def test_the_hangar_recording_as_it_is(shared_data, tmp_path):
    recording = shared_data / "recordings" / "hangar_map_12laps.bag"
    assert main(["evaluate", str(recording), "--csv", str(tmp_path / "l.csv")]) == 0
    laps = pd.read_csv(tmp_path / "l.csv")
    laps = laps[laps["valid"]]
    assert len(laps) == 11
    assert laps["lap_time_s"].between(5.34, 5.39).all()
    assert laps["rms_lateral_error_m"].between(0.10, 0.12).all()


def test_real_laps_from_csv(shared_data, tmp_path):
    folder = shared_data / "laps" / "ipz20"
    runs = sorted(str(path) for path in folder.glob("*.csv.gz"))
    raceline, report = str(folder / "IPZ20_wp.csv"), tmp_path / "l.json"
    assert main(["evaluate", *runs, "--raceline", raceline, "--json", str(report)]) == 0
    runs = json.loads(report.read_text())["runs"]
    times = [lap["lap_time_s"] for run in runs for lap in run["laps"] if lap["lap_time_s"]]
    assert len(times) == 10
    assert min(times) > 6.6 and max(times) < 9.4


def test_names_of_runs_keep_their_dots():
    assert run_names(["a/map_0.7.bag", "b/pp.csv.gz", "c.bag.active"]) == ["map_0.7", "pp", "c"]
    assert run_names(["a/x.bag", "b/x.bag"]) == ["a/x.bag", "b/x.bag"]
    assert run_names(["/m/n/a/x.bag", "/m/n/b/x.bag"]) == ["a/x.bag", "b/x.bag"]
    assert run_names(["/m/n/x.bag", "/m/n/x.bag"]) == ["x.bag", "x.bag"]


def test_figures_of_runs_with_strange_names(bags, tmp_path, capsys):
    """Two are equal, one is not UTF-8."""
    path = tmp_path / f"\u8d5b $\\frac$ {'long' * 40}.bag"
    latin = Path(os.fsdecode(os.fsencode(str(tmp_path)) + b"/r\xfcn.bag"))
    plots = tmp_path / "p"
    for copy in (path, latin):
        shutil.copy(str(bags["map"]), str(copy))
    assert main(["evaluate", str(path), str(path), "--plots", str(plots)]) == 0
    assert len(list(plots.iterdir())) == 5
    assert main(["evaluate", str(latin), "--plots", str(plots)]) == 0
    # Three other runs; difference.png showed the former two.
    assert len(list(plots.iterdir())) == 7
    assert capsys.readouterr().err == ""


def test_a_second_raceline_begins_a_second_run(tmp_path, track, capsys):
    """As live: the laps on each raceline belong to their own run."""
    t0, path = 1600000000.0, tmp_path / "two.bag"
    with BagWriter(path) as bag:
        for i in range(int(5.0 * track.length / 5.0 * 40.0)):
            t = t0 + 0.025 * i
            if i % 100 == 0:
                speed = 5.0 if t < t0 + 2.5 * track.length / 5.0 else 4.0
                bag.waypoints(t, waypoint_rows(track.raceline(speed=speed, walls=1.0)))
            x, y, psi = (float(value) for value in track.place(0.125 * i - 3.0))
            bag.odometry(t, x, y, psi, 5.0, 0.0, 0.0)
    assert main(["evaluate", str(path), "--json", str(tmp_path / "a.json")]) == 0
    runs = json.loads((tmp_path / "a.json").read_text())["runs"]
    assert [run["summary"]["laps_completed"] for run in runs] == [2, 1]
    errors = [[lap["rms_speed_error_mps"] for lap in r["laps"] if lap["valid"]] for r in runs]
    assert errors[0] == pytest.approx([0.0, 0.0], abs=1e-6)
    assert errors[1] == pytest.approx([1.0], abs=1e-6)
    assert "warning: run 2 of 2: another raceline was used until" in capsys.readouterr().out
    assert runs[0]["bag"] == f"{path} (run 1)"
