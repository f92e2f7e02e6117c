"""``map-racing report``: the numbers of ``evaluate`` on one page."""

import base64
import html
import json
import math
import re
import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from map_racing.bags.writer import BagWriter
from map_racing.cli import main
from map_racing.cli.report import parse_laps
from map_racing.control.parameters import load_controller_parameters
from map_racing.errors import ParameterError
from map_racing.pages import report as pages
from map_racing.track.files.load import load_raceline
from map_racing.track.files.waypoints import waypoint_rows


def report(tmp_path, *arguments):
    output = tmp_path / "report.html"
    assert main(["report", *map(str, arguments), "--output", str(output)]) == 0
    return output.read_text(encoding="utf-8")


def text_of(page):
    """Text of a page as one line."""
    body = page[page.index("<body>") : page.index("<script")]
    return " ".join(html.unescape(re.sub("<[^>]+>", " ", body)).split())


def data_of(page):
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.S)
    return json.loads(found.group(1))


def unpacked(packed):
    whole = np.frombuffer(base64.b64decode(packed["b"]), "<i2")
    return np.where(whole == -32768, np.nan, packed["o"] + packed["k"] * whole)


@pytest.fixture(scope="module")
def page(bags, tmp_path_factory):
    return report(tmp_path_factory.mktemp("page"), *bags.values())


def test_its_numbers_are_those_of_evaluate(page, bags, tmp_path):
    laps = tmp_path / "laps.json"
    assert main(["evaluate", *map(str, bags.values()), "--json", str(laps)]) == 0
    text = text_of(page)
    for run in json.loads(laps.read_text())["runs"]:
        best = run["summary"]["best_lap_time_s"]
        assert f"{best:.3f} s (lap" in text
        for lap in run["laps"]:
            if lap["valid"]:
                cells = [f"{lap['lap']} {lap['lap_time_s']:.3f} s"]
                cells += [f"{lap[f'sector_{i}_s']:.3f} s" for i in (1, 2, 3)]
                cells += [f"{lap['rms_lateral_error_m']:.3f} m"]
                assert " ".join(cells) in text


@pytest.mark.parametrize(
    "name, told", [("global_waypoints", "raceline of /global_waypoints"), ("club", "club")]
)
def test_a_raceline_known_by_its_topic_alone_is_said_to_be_of_it(name, told):
    run = SimpleNamespace(
        name="a.bag",
        result=SimpleNamespace(raceline=SimpleNamespace(name="", length=36.54)),
        settings=SimpleNamespace(values={"raceline": {"name": name}}),
        recording=SimpleNamespace(waypoints=SimpleNamespace(topic="/global_waypoints")),
    )
    assert pages._track_name(run) == f"{told}, 36.5 m"


def test_it_says_what_was_driven_with(page):
    text = text_of(page)
    assert "vehicle: name NUC4" in text and "versions: map_racing" in text
    assert " · simulated" in text and "UTC" not in text
    assert "reference, 36.5 m" in text and "speed_scale 0.7" in text
    differs, same = text[text.index("What differs") :].split("The same in all")
    assert "controller: steering_map table ackermann" in differs and "vehicle: m " not in differs
    assert "vehicle: m 3.31" in same and "steering_map" not in same


def test_doubts_are_told_on_the_first_screen(bags, tmp_path, page):
    other = text_of(report(tmp_path, bags["map"], "--vehicle", "sim"))
    assert other.index("Doubtful: --vehicle is SIM") < other.index("Where the time goes")
    assert "Doubtful" not in text_of(page)


def test_everything_is_in_the_file(page):
    start = page[: page.index("plotly.js")]
    assert not re.search(r'(src|href)="(?!data:,)', start)
    assert len(page.encode()) < 6_000_000


def test_charts_have_all_laps_and_the_track(page):
    data = data_of(page)
    assert [len(run["laps"]) for run in data["runs"]] == [2, 2]
    assert len(data["tracks"]) == 1 and data["runs"][1]["track"] == 0
    assert data["tracks"][0]["length"] == pytest.approx(36.54, abs=0.01)
    assert all(run["limit"]["a"] for run in data["runs"])
    assert data["places"][0][0][0]["name"]


def test_laps_to_look_at(bags, tmp_path, refused):
    data = data_of(report(tmp_path, bags["map"], "--laps", "2"))
    assert [lap["number"] for lap in data["runs"][0]["laps"]] == [2]
    assert "has none of them" in refused(
        *("report", bags["map"], "--laps", "7-9", "--output", tmp_path / "r.html")
    )


def test_lap_numbers():
    assert parse_laps("2-5,8") == [(2, 5), (8, 8)]
    for text in ("a", "2-", "-3", "1,,2", "1.5"):
        with pytest.raises(ParameterError, match="--laps"):
            parse_laps(text)


def test_a_car_that_is_not_known(tmp_path, race_bag):
    page = report(tmp_path, race_bag())
    assert "give --vehicle" in text_of(page) and data_of(page)["runs"][0]["limit"] is None
    page = report(tmp_path, race_bag(), "--vehicle", "nuc4")
    assert data_of(page)["runs"][0]["limit"] and "give --vehicle" not in text_of(page)


def test_a_command_that_is_no_speed_is_not_shown_as_one(tmp_path, bags):
    line = load_raceline("reference")
    with BagWriter(tmp_path / "throttle.bag") as bag:
        bag.waypoints(1.0, waypoint_rows(line))
        for t in np.arange(0.0, 30.0, 0.025):
            s = 3.5 * t + 3.0 * math.sin(0.5 * t)
            v = 3.5 + 1.5 * math.cos(0.5 * t)
            x, y = line.to_cartesian(s, 0.0)
            bag.odometry(2.0 + t, float(x), float(y), line.pose(s).psi, v, 0.0, 0.0)
            bag.drive(2.0 + t, 0.0, 2.0 + math.sin(1.7 * t))
    page = report(tmp_path, tmp_path / "throttle.bag")
    assert "does not follow the speed commanded" in text_of(page)
    laps = data_of(page)["runs"][0]["laps"]
    assert laps and all(not np.isfinite(unpacked(lap["v_command"])).any() for lap in laps)
    row = re.search(r"1 \d+\.\d{3} s (.*?) yes", text_of(page)[text_of(page).index("counts") :])
    assert row.group(1).split()[-2:] == ["–", "–"]  # speed error, saturated


def test_it_advises_on_the_next_heat_and_on_the_car(page, tmp_path, race_bag):
    text = text_of(page)
    section = text[text.index("For the next heat") : text.index("Corners, lap by lap")]
    assert section.count("s predicted with these scales") == 2 and "0.700 0.80" in section
    section = text[text.index("The car, as it drove") : text.index("Drive, poses and stops")]
    assert section.count("delay of the steering") == 2
    delay = f"{load_controller_parameters('map').delay_s:.3f} s"
    assert re.search(rf"0\.0\d\d to 0\.0\d\d s {delay} (keep|delay_s: 0\.0)", section)
    assert "friction" in section and "keep: off by less than 1 degree" in section
    assert re.search(r"degrees \(\d+ %\) (more|less) than the table, in \d+ % of the laps", section)
    text = text_of(report(tmp_path, race_bag()))
    assert "No advice: the car is not known, give --vehicle" in text
    text = text_of(report(tmp_path, race_bag(), "--vehicle", "nuc4"))
    assert "beyond that not determined" in text


@pytest.mark.once
def test_a_vehicle_file_of_another_car_is_doubted(page, bags, tmp_path):
    assert "is it the file of another car" not in text_of(page)
    text = text_of(report(tmp_path, bags["map"], "--vehicle", "sim"))
    assert "not determined: at the end of the search range" in text


def test_what_cannot_be_read_is_left_out(bags, tmp_path, capsys, refused):
    (tmp_path / "text.bag").write_text("hello\n" * 100)
    output = tmp_path / "report.html"
    arguments = [str(bags["map"]), str(tmp_path / "text.bag"), "--output", str(output)]
    assert main(["report", *arguments]) == 1
    assert "text.bag" in capsys.readouterr().err and output.exists()
    output.unlink()
    refused("report", tmp_path / "text.bag", "--output", output)
    assert not output.exists()
    assert "also an input" in refused("report", bags["map"], "--output", bags["map"])


def test_a_run_without_a_lap(tmp_path):
    line = load_raceline("reference")
    with BagWriter(tmp_path / "short.bag") as bag:
        bag.waypoints(1.0, waypoint_rows(line))
        for i in range(200):
            here = line.pose(0.1 * i + 1.0)
            bag.odometry(2.0 + 0.025 * i, here.x, here.y, here.psi, 4.0, 0.0, 4.0 * here.kappa)
    page = report(tmp_path, tmp_path / "short.bag")
    text = text_of(page)
    assert "No lap was completed." in text and "out-lap" in text
    assert len(data_of(page)["runs"][0]["laps"]) == 1


def test_laps_that_do_not_count_are_neither_best_nor_compared(bags, tmp_path):
    narrow = ("--max-deviation", "0.0001")
    text = text_of(report(tmp_path, bags["map"], *narrow))
    first = text[: text.index("Over distance")]
    assert re.search(r"saturated 0 of \d+ none – – – – –", first), first
    assert "best" not in first.replace("best lap", "") and "✗ off track" in first
    assert "No lap counts (off track" in first and "of the grip used" not in first
    assert "No advice: no lap counts" in text


def test_more_laps_than_fit(tmp_path, monkeypatch, ring):
    """The best lap, the last and others at equal steps have charts; the tables have all."""
    with BagWriter(tmp_path / "long.bag") as bag:
        bag.waypoints(1.0, waypoint_rows(ring))
        t, s = 2.0, -1.0
        while s < 12.5 * ring.length:
            here, v = ring.pose(s), 3.3 if 4.0 < s / ring.length < 5.0 else 3.0
            bag.odometry(t, here.x, here.y, here.psi, v, 0.0, v * here.kappa)
            t, s = t + 0.025, s + 0.025 * v
    monkeypatch.setattr(pages, "_PAGE", 0)
    monkeypatch.setattr(pages, "_LEAST", 14_300)
    page = report(tmp_path, tmp_path / "long.bag")
    (run,) = data_of(page)["runs"]
    numbers = [lap["number"] for lap in run["laps"]]
    assert 4 <= len(numbers) <= 6 and numbers[-1] == 12 and 5 in numbers
    assert run["laps"][run["best"]]["number"] == 5 and run["left_out"] == 12 - len(numbers)
    assert "charts show" in text_of(page) and "11 3." in text_of(page)


def test_of_many_laps_the_best_and_those_that_do_not_count_are_listed():
    laps = [SimpleNamespace(lap=i, valid=i not in (3, 700)) for i in range(5000)]
    some = pages._selected_laps(laps, 100, best=laps[1234])
    numbers = [lap.lap for lap in some]
    assert len(some) <= 101 and numbers == sorted(set(numbers))
    assert {0, 3, 700, 1234, 4999} <= set(numbers)
    assert max(b - a for a, b in zip(numbers, numbers[1:])) < 60
    assert pages._selected_laps(laps[:100], 100) == laps[:100]


@pytest.mark.once
def test_each_of_many_runs_is_compared_with_the_fastest(bags, tmp_path, monkeypatch):
    monkeypatch.setattr(pages, "_MOST_OTHERS", 1)
    copies = [tmp_path / f"{name}.bag" for name in ("a", "b", "c")]
    for copy, name in zip(copies, ("pure_pursuit", "map", "pure_pursuit")):
        shutil.copy(str(bags[name]), str(copy))
    page = report(tmp_path, *copies)
    against = re.findall(r'run="(\d)" data-reference="0" data-name="the mean lap of (\w)"', page)
    assert against == [("0", "b"), ("1", "a"), ("2", "b")]
