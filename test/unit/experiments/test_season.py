"""A season: bags are found, read once, named by track, and continued."""

import csv
import os
import re
import shutil
from xml.etree import ElementTree

import pytest
from ros2_bags import messages_of, write_mcap, write_sqlite

from map_racing.bags.samples import SIMULATED_NS
from map_racing.bags.writer import BagWriter
from map_racing.cli import main
from map_racing.control.settings import parse_settings
from map_racing.errors import MapRacingError
from map_racing.experiments import season as season_module
from map_racing.experiments.executors import SerialExecutor
from map_racing.experiments.season import BagOptions, evaluate_season
from map_racing.experiments.season_bags import find_bags
from map_racing.pages.season import season_page
from map_racing.track.files.load import save_raceline
from map_racing.track.files.waypoints import waypoint_rows
from map_racing.track.raceline import Raceline

T0 = 1750000000.0


def heat(path, line, begin=T0, speed=3.0, raceline=True, laps=2.3, settings=""):
    """A drive on a line at a constant speed."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with BagWriter(path) as bag:
        if raceline:
            bag.waypoints(begin, waypoint_rows(line))
        if settings:
            bag.text(begin, settings)
        for i in range(int(laps * line.length / (speed * 0.025))):
            point = line.pose(speed * 0.025 * i - 1.0)
            state = point.x, point.y, point.psi, speed, 0.0, speed * point.kappa
            bag.odometry(begin + 0.025 * i, *state)
    return path


@pytest.fixture(scope="module")
def bags(tmp_path_factory, ring, track):
    """A typical folder of a team."""
    folder = tmp_path_factory.mktemp("bags")
    heat(folder / "friday" / "a.bag", ring)
    heat(folder / "friday" / "b.bag", ring, T0 + 3600, 3.2)
    heat(folder / "saturday" / "a.bag", track.raceline(), T0 + 90000, 5.0)
    messages = list(messages_of(folder / "friday" / "b.bag"))
    write_sqlite(folder / "saturday" / "ros2", messages)
    write_mcap(folder / "saturday" / "alone.mcap", messages)
    (folder / "saturday" / "broken.bag").write_bytes(b"#ROSBAG V2.0\nnothing")
    (folder / "saturday" / "notes.txt").write_text("no bag")
    return folder


def evaluated(folder, output, **options):
    paths = find_bags([folder], without=output)
    return evaluate_season(paths, output, BagOptions(**options), SerialExecutor(), 1)


def test_bags_are_found_once_each(bags, tmp_path):
    names = [str(path.relative_to(bags)) for path in find_bags([bags, bags / "friday"])]
    assert names == [
        *("friday/a.bag", "friday/b.bag", "saturday/a.bag", "saturday/alone.mcap"),
        *("saturday/broken.bag", "saturday/ros2"),
    ]
    never_closed = tmp_path / "rosbag2_x"
    never_closed.mkdir()
    for number in range(2):
        shutil.copy(
            str(bags / "saturday" / "alone.mcap"), f"{never_closed}/rosbag2_x_{number}.mcap"
        )
    assert find_bags([tmp_path]) == [never_closed]
    assert find_bags([tmp_path], without=never_closed) == []
    with pytest.raises(MapRacingError, match="no such folder"):
        find_bags([tmp_path / "nowhere"])
    with pytest.raises(MapRacingError, match="'': expected the name of a folder or a bag"):
        find_bags([""])


def test_heats_are_in_order_with_their_tracks_and_reasons(bags, tmp_path):
    season = evaluated(bags, tmp_path)
    assert (season.read, season.kept) == (6, 0)
    rows = {os.path.relpath(row["bag"], str(bags)): row for row in season.heats}
    # The row already has the name of the bag.
    assert rows["saturday/broken.bag"]["reason"].startswith("no topic with the pose")
    dates = [row["date"] for row in season.heats if not row["reason"]]
    assert dates == sorted(dates) and dates[0] == "2025-06-15 15:06:40"
    # Lines of the same track have the same name, whatever the format; the others are numbered.
    names = {name: row["track"] for name, row in rows.items()}
    assert names["friday/a.bag"] == "track 1" and names["saturday/a.bag"] == "track 2"
    same = ("friday/b.bag", "saturday/ros2", "saturday/alone.mcap")
    assert {names[name] for name in same} == {"track 1"}
    for name in same:
        assert rows[name]["laps"] == 2
        assert rows[name]["best_lap_time_s"] == rows["friday/b.bag"]["best_lap_time_s"]
        assert rows[name]["rms_lateral_error_m"] < 0.01


def test_simulated_races_have_no_date_and_are_in_the_order_of_their_writing(ring, tmp_path):
    begin = 1e-9 * SIMULATED_NS
    names = ["b.bag", "c.bag", "a.bag"]
    for number, name in enumerate(names):
        heat(tmp_path / "bags" / name, ring, begin + 0.03)
        os.utime(str(tmp_path / "bags" / name), ns=(0, (number + 1) * 10**9))
    heat(tmp_path / "bags" / "real.bag", ring)
    heats = evaluated(tmp_path / "bags", tmp_path / "out").heats
    assert [os.path.basename(row["bag"]) for row in heats] == ["real.bag", *names]
    assert [row["date"] for row in heats] == ["2025-06-15 15:06:40", *["simulated"] * 3]


@pytest.mark.once
def test_what_has_not_changed_is_not_read_again(bags, tmp_path, monkeypatch, ring):
    folder = tmp_path / "bags"
    shutil.copytree(str(bags), str(folder))
    before = evaluated(folder, tmp_path / "out")
    reads = []
    original = season_module._rows
    monkeypatch.setattr(
        season_module, "_rows", lambda path, options: reads.append(path) or original(path, options)
    )
    again = evaluated(folder, tmp_path / "out")
    assert not reads and again.kept == 6
    assert str(again.heats) == str(before.heats)  # NaN is not equal to itself
    heat(folder / "friday" / "b.bag", ring, T0 + 3600, 3.5)
    os.utime(str(folder / "saturday" / "ros2" / "metadata.yaml"), (1, 1))
    (folder / "friday" / "a.bag").unlink()
    evaluated(folder, tmp_path / "out")
    assert sorted(os.path.basename(path) for path in reads) == ["b.bag", "ros2"]
    evaluated(folder, tmp_path / "out", car_width=0.2)
    assert len(reads) == 2 + 5
    # Damaged records are made again.
    for record in (tmp_path / "out" / "heats").iterdir():
        record.write_text("{")
    assert evaluated(folder, tmp_path / "out", car_width=0.2).read == 5
    # Changed code with the same version may evaluate differently.
    monkeypatch.setattr(season_module, "fingerprint_of_code", lambda parts: "other")
    assert evaluated(folder, tmp_path / "out", car_width=0.2).read == 5


def test_an_interrupted_season_continues(bags, tmp_path, monkeypatch):
    original, done = season_module._rows, []

    def interrupted(path, options):
        if len(done) == 3:
            raise KeyboardInterrupt
        done.append(path)
        return original(path, options)

    monkeypatch.setattr(season_module, "_rows", interrupted)
    with pytest.raises(KeyboardInterrupt):
        evaluated(bags, tmp_path)
    monkeypatch.setattr(season_module, "_rows", original)
    season = evaluated(bags, tmp_path)
    assert (season.read, season.kept) == (3, 3) and len(season.heats) == 6


def test_an_error_of_the_program_costs_one_row_and_is_tried_again(bags, tmp_path, monkeypatch):
    original = season_module._rows

    def faulty(path, options):
        if path.endswith("friday/a.bag"):
            raise ZeroDivisionError("oops")
        return original(path, options)

    monkeypatch.setattr(season_module, "_rows", faulty)
    season = evaluated(bags, tmp_path)
    assert [row["reason"] for row in season.heats].count("ZeroDivisionError: oops") == 1
    monkeypatch.setattr(season_module, "_rows", original)
    assert evaluated(bags, tmp_path).read == 1


def test_given_tracks_name_heats_and_stand_in_for_missing_racelines(tmp_path, ring, track):
    save_raceline(ring, tmp_path / "hall.csv")
    save_raceline(track.raceline(), tmp_path / "bean.csv")
    heat(tmp_path / "bags" / "bare.bag", track.raceline(0.2), speed=5.0, raceline=False)
    tracks = tuple(str(tmp_path / name) for name in ("hall.csv", "bean.csv"))
    (row,) = evaluated(tmp_path / "bags", tmp_path / "out", tracks=tracks).heats
    assert row["track"] == "bean" and row["laps"] == 2 and row["reason"] == ""
    (row,) = evaluated(tmp_path / "bags", tmp_path / "out", tracks=tracks[:1]).heats
    assert "driven on none of the given tracks" in row["reason"] and row["date"]
    (row,) = evaluated(tmp_path / "bags", tmp_path / "out").heats
    assert "--tracks" in row["reason"] and "--raceline" not in row["reason"]


def test_tracks_of_one_name_are_told_apart_by_their_folders(tmp_path, ring, track):
    """As in a stack's maps: each has its own folder, all have the same file name."""
    lines = {"hall/map": ring, "arena/map": track.raceline()}
    heat(tmp_path / "bags" / "a.bag", ring)
    heat(tmp_path / "bags" / "b.bag", track.raceline(), T0 + 3600)
    tracks = []
    for folder, line in lines.items():
        (tmp_path / folder).mkdir(parents=True)
        tracks.append(str(tmp_path / folder / "reference.csv"))
        save_raceline(line, tracks[-1])
    rows = evaluated(tmp_path / "bags", tmp_path / "out", tracks=tuple(tracks)).heats
    assert [row["track"] for row in rows] == ["hall/map/reference", "arena/map/reference"]
    # A shipped track keeps its name; a track given twice counts once.
    rows = evaluated(tmp_path / "bags", tmp_path / "out", tracks=(tracks[0], tracks[0])).heats
    assert [row["track"] for row in rows] == ["map/reference", "track 1"]


def test_a_track_that_has_changed_is_raced_anew(tmp_path, ring, track):
    """A raceline was re-optimized under its old name; a running process notices it, too."""
    line = tmp_path / "hall.csv"
    save_raceline(ring, line)
    heat(tmp_path / "bags" / "bare.bag", ring, raceline=False)
    found = [evaluated(tmp_path / "bags", tmp_path / "out", tracks=(str(line),)) for _ in range(2)]
    assert [season.read for season in found] == [1, 0]
    s = ring.s_points
    wider = Raceline(*ring.to_cartesian(s, 0.1 + 0.0 * s), vx_mps=ring.speed_at(0.0) + 0.0 * s)
    save_raceline(wider, line)
    season = evaluated(tmp_path / "bags", tmp_path / "out", tracks=(str(line),))
    assert season.read == 1
    assert found[1].heats[0]["rms_lateral_error_m"] < 0.01
    assert season.heats[0]["rms_lateral_error_m"] == pytest.approx(0.1, abs=0.01)


def test_reports_are_made_as_their_heats(tmp_path, ring, capsys, monkeypatch):
    """On the given track, with the given limit; a failure affects nothing else."""
    save_raceline(ring, tmp_path / "hall #1.csv")
    heat(tmp_path / "bags" / "bare.bag", ring, raceline=False)
    heat(tmp_path / "bags" / "own.bag", ring)
    monkeypatch.chdir(tmp_path)
    words = ["season", "bags", "--output", "out", "--tracks", "hall #1.csv", "--jobs", "1"]
    assert main([*words, "--reports", "2", "--max-deviation", "0.5"]) == 0
    assert capsys.readouterr().err == ""
    pages = [tmp_path / "out" / "reports" / f"{name}.html" for name in ("bare", "own")]
    assert all(page.is_file() for page in pages)
    made = [page.stat().st_mtime_ns for page in pages]
    later = made[0] / 1e9 + 10.0
    os.utime(str(tmp_path / "hall #1.csv"), (later, later))
    assert main([*words, "--reports", "2", "--max-deviation", "0.5"]) == 0
    assert [page.stat().st_mtime_ns > at for page, at in zip(pages, made)] == [True, False]

    def fails(arguments):
        raise MapRacingError("no page today")

    monkeypatch.setattr("map_racing.cli.report.run", fails)
    pages[1].unlink()
    assert main([*words, "--reports", "2"]) == 0
    assert "no report of bags/own.bag: no page today" in capsys.readouterr().err


def test_a_refused_option_leaves_no_folder(bags, tmp_path, capsys):
    output = tmp_path / "season"
    assert main(["season", str(bags), "--output", str(output), "--jobs", "0"]) == 1
    assert "jobs: expected at least 1, got 0" in capsys.readouterr().err
    assert not output.exists()


@pytest.mark.once
def test_the_command(bags, tmp_path, capsys):
    output = tmp_path / "season"
    arguments = ["season", str(bags), "--output", str(output), "--jobs", "2"]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    assert "6 bags: 6 read, 0 known; 5 heats" in printed
    broken = bags / "saturday" / "broken.bag"
    assert f"not evaluated: {broken}: no topic with the pose" in printed
    (output / "reports" / "friday").mkdir(parents=True)
    (output / "reports" / "friday" / "a.html").write_text("report")
    assert main(arguments) == 0
    assert "0 read, 6 known" in capsys.readouterr().out
    with (output / "season.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [row["report"] for row in rows if row["report"]] == ["reports/friday/a.html"]
    page = (output / "season.html").read_text()
    assert 'href="reports/friday/a.html"' in page
    # Nothing is loaded from the network, and each trend has a point for each heat.
    assert not re.search(r"(src|href)=\"(https?:)?//", page)
    drawings = re.findall(r"<svg.*?</svg>", page, re.DOTALL)
    assert len(drawings) == 2 * 3
    points = [len(ElementTree.fromstring(svg).findall(".//circle")) for svg in drawings]
    assert sorted(points) == [1, 1, 1, 4, 4, 4]
    assert main(["season", str(tmp_path / "season"), "--output", str(tmp_path / "b")]) == 1
    assert "no bags below" in capsys.readouterr().err
    assert main(["season", str(bags), "--output", ""]) == 1
    assert "'': expected the name of a folder" in capsys.readouterr().err
    assert main([*arguments, "--car-width", "-1"]) == 1
    assert "car width: expected 0 to 10 m, got -1" in capsys.readouterr().err


def test_a_cluster_gives_the_same_table(bags, tmp_path, monkeypatch):
    from distributed import LocalCluster

    monkeypatch.chdir(bags)  # the workers have another working folder
    tables = []
    options = {"n_workers": 1, "threads_per_worker": 2, "dashboard_address": None}
    with LocalCluster(**options) as cluster:
        for where in (["--jobs", "1"], ["--scheduler", cluster.scheduler_address]):
            output = tmp_path / where[0].strip("-")
            assert main(["season", "friday", "saturday", "--output", str(output), *where]) == 0
            tables.append((output / "season.csv").read_text())
    # Errors name the file by the path that the process used.
    assert tables[0] == tables[1] and tables[0].count("\n") == 7


def test_reports_of_the_latest_heats(bags, tmp_path):
    words = ["season", str(bags / "friday"), "--output", str(tmp_path), "--jobs", "1"]
    assert main([*words, "--reports", "1"]) == 0
    (report,) = (tmp_path / "reports").rglob("*.html")
    assert report.name == "b.html" and "b</title>" in report.read_text()
    assert 'href="reports/b.html"' in (tmp_path / "season.html").read_text()
    made = report.stat().st_mtime_ns
    assert main([*words, "--reports", "1"]) == 0
    assert report.stat().st_mtime_ns == made
    assert main([*words, "--reports", "-1"]) == 1


def test_names_are_escaped_in_the_page(tmp_path, ring):
    heat(tmp_path / "bags" / "<b>&.bag", ring)
    assert main(["season", str(tmp_path / "bags"), "--output", str(tmp_path), "--jobs", "1"]) == 0
    page = (tmp_path / "season.html").read_text()
    assert "<b>" not in page and "&lt;b&gt;&amp;.bag" in page


def test_settings_are_columns(tmp_path, ring):
    text = "controller: {name: map, speed_scale: 0.8}\nvehicle: {name: nuc4}\n"
    assert parse_settings(text).values["vehicle"] == {"name": "nuc4"}
    heat(tmp_path / "a.bag", ring, settings=text)
    heat(tmp_path / "b.bag", ring, T0 + 100, settings=text)
    first, second = evaluated(tmp_path, tmp_path / "out").heats
    assert (first["controller"], first["vehicle"], first["speed_scale"]) == ("map", "nuc4", 0.8)
    assert first["settings"] == second["settings"] != ""


def test_a_run_that_was_split_is_one_heat(tmp_path, ring, capsys):
    """By names and times; the lap across the split counts. Heats that are merely numbered stay
    separate."""
    folder = tmp_path / "bags"
    heat(tmp_path / "whole.bag", ring, laps=4.3)
    for number in range(2):
        heat(folder / f"morning_{number}.bag", ring, T0 + 600 * number)
        copy = folder / f"run_2023-11-14-22-13-{20 + 5 * number}_{number}.bag"
        with BagWriter(copy) as bag:
            if not number:
                bag.waypoints(T0, waypoint_rows(ring))
            rate = 3.0 * 0.025
            for i in range(int(4.3 * ring.length / rate)):
                point = ring.pose(rate * i - 1.0)
                if (i >= 200) == bool(number):
                    state = point.x, point.y, point.psi, 3.0, 0.0, 3.0 * point.kappa
                    bag.odometry(T0 + 0.025 * i, *state)
    found = find_bags([folder])
    assert [len(one) if isinstance(one, tuple) else 1 for one in found] == [1, 1, 2]
    words = ["season", str(folder), "--output", str(tmp_path / "out"), "--jobs", "1"]
    assert main([*words, "--reports", "1"]) == 0
    assert "3 bags: 3 read, 0 known; 3 heats" in capsys.readouterr().out
    with (tmp_path / "out" / "season.csv").open() as file:
        rows = list(csv.DictReader(file))
    joined = next(row for row in rows if "_1.bag" in row["bag"] and "..." in row["bag"])
    (single,) = evaluated(tmp_path / "whole.bag", tmp_path / "other").heats
    assert int(joined["laps"]) == single["laps"] == 4
    assert float(joined["best_lap_time_s"]) == pytest.approx(single["best_lap_time_s"])
    assert main(words) == 0 and "0 read, 3 known" in capsys.readouterr().out
    with (folder / "run_2023-11-14-22-13-25_1.bag").open("ab") as file:
        file.write(b" ")
    assert main(words) == 0 and "1 read, 2 known" in capsys.readouterr().out


def test_a_bag_that_is_removed_meanwhile_is_a_row_with_its_reason(tmp_path, ring):
    heat(tmp_path / "here.bag", ring)
    paths = [*find_bags([tmp_path]), tmp_path / "gone.bag"]
    options = BagOptions()
    season = evaluate_season(paths, tmp_path / "season", options, SerialExecutor(), 1)
    reasons = {row["bag"]: row["reason"] for row in season.heats}
    assert len(reasons) == 2
    assert [bool(reason) for name, reason in sorted(reasons.items())] == [True, False]


def test_the_row_of_a_damaged_bag_says_so(tmp_path, ring):
    path = heat(tmp_path / "bags" / "a.bag", ring, laps=3.5)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    (row,) = evaluated(tmp_path / "bags", tmp_path / "out").heats
    assert row["laps"] == 1 and row["warnings"].startswith("damaged bag: ") and not row["reason"]


def test_bags_without_a_heat_are_not_counted_as_heats(tmp_path, ring, capsys):
    heat(tmp_path / "bags" / "a.bag", ring)
    (tmp_path / "bags" / "empty.bag").write_bytes(b"")
    assert main(["season", str(tmp_path / "bags"), "--output", str(tmp_path / "out")]) == 0
    assert "2 bags: 2 read, 0 known; 1 heat, " in capsys.readouterr().out


def test_bags_without_a_heat_stand_apart(tmp_path, ring):
    heat(tmp_path / "bags" / "a.bag", ring)
    (tmp_path / "bags" / "empty.bag").write_bytes(b"")
    page = season_page(evaluated(tmp_path / "bags", tmp_path / "out").heats)
    heats, others = page.split("Bags that cannot be evaluated</h2>")
    assert "<td>a.bag</td>" in heats and "<td>empty.bag</td>" not in heats
    assert "Heats: 1; laps" in heats and "bags that cannot be evaluated: 1" in heats
    assert "got an empty file" in others
