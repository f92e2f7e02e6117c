"""``map-racing raceline record``: a raceline from a lap driven by hand."""

import numpy as np
import pytest
import yaml
from PIL import Image

from map_racing.bags.writer import BagWriter
from map_racing.cli import main
from map_racing.track.files.load import load_raceline

RADIUS = 2.0


def drive(path, radius, speeds):
    """Two and a half laps, the first slower, as a bag."""
    with BagWriter(path) as bag:
        angle, t = 0.3, 100.0
        while angle < 0.3 + 5.0 * np.pi:
            v = speeds[angle >= 0.3 + 2.0 * np.pi]
            x, y = radius * np.cos(angle), radius * np.sin(angle)
            bag.odometry(t, x, y, angle + 0.5 * np.pi, v, 0.0, v / radius)
            angle, t = angle + v * 0.02 / radius, t + 0.02


@pytest.fixture(scope="module")
def by_hand(tmp_path_factory):
    """Two and a half laps at 2 and 3 m/s, without a raceline, and the map of the hall."""
    folder = tmp_path_factory.mktemp("by_hand")
    drive(folder / "run.bag", RADIUS, (2.0, 3.0))
    y, x = np.mgrid[3.975:-4.0:-0.05, -3.975:4.0:0.05]
    radius = np.hypot(x, y)
    pixels = np.where((radius > 1.5) & (radius < 3.0), 254, 0).astype(np.uint8)
    Image.fromarray(pixels).save(folder / "hall.png")
    settings = {"image": "hall.png", "resolution": 0.05, "origin": [-4.0, -4.0, 0.0]}
    settings.update(negate=0, occupied_thresh=0.65, free_thresh=0.196)
    (folder / "hall.yaml").write_text(yaml.safe_dump(settings))
    return folder


def record(folder, output, *options):
    arguments = ["raceline", "record", folder / "run.bag", "--output", output, *options]
    return main([str(argument) for argument in arguments])


def test_the_fastest_lap_becomes_a_raceline_with_walls(by_hand, tmp_path, capsys):
    output = tmp_path / "line.csv"
    assert record(by_hand, output, "--map", by_hand / "hall.yaml") == 0
    printed = capsys.readouterr().out
    assert "counter-clockwise" in printed and "nothing wrong" in printed
    assert "lap  2" in printed.split("<- taken")[0].splitlines()[-1]
    line = load_raceline(output)
    assert line.length == pytest.approx(2.0 * np.pi * RADIUS, rel=0.005)
    assert line.speed == pytest.approx(3.0, abs=0.05)
    assert line.d_left == pytest.approx(0.5, abs=0.06)
    assert line.d_right == pytest.approx(1.0, abs=0.06)


def test_another_lap_without_speeds(by_hand, tmp_path):
    output = tmp_path / "line.json"
    options = ["--lap", "1", "--speeds", "none", "--spacing", "0.2"]
    assert record(by_hand, output, *options) == 0
    line = load_raceline(output)
    assert line.speed is None and line.d_left is None
    assert line.s_points.size == pytest.approx(2.0 * np.pi * RADIUS / 0.2, abs=1)


def test_a_lap_of_a_race_is_that_of_evaluate(bags, tmp_path, capsys):
    source = str(bags["map"])
    assert main(["raceline", "record", source, "--output", str(tmp_path / "a.csv")]) == 0
    recorded = capsys.readouterr().out
    assert main(["evaluate", source]) == 0
    rows = (line.split() for line in capsys.readouterr().out.splitlines())
    best = min(row[1] for row in rows if row and row[0] in ("1", "2"))
    assert f"{best} s   <- taken" in recorded


def test_a_larger_car_has_points_farther_apart(tmp_path):
    drive(tmp_path / "run.bag", 20.0, (8.0, 10.0))
    assert record(tmp_path, tmp_path / "line.csv", "--vehicle", "bmw_320i") == 0
    line = load_raceline(tmp_path / "line.csv")
    assert np.diff(line.s_points) == pytest.approx(0.8, abs=0.05)  # 0.1 m at the size of 8.06
    assert line.length == pytest.approx(2.0 * np.pi * 20.0, rel=0.005)


def test_refused(by_hand, tmp_path, refused):
    run, line = by_hand / "run.bag", tmp_path / "line.csv"
    start = ("raceline", "record", run, "--output", line)
    assert "--lap: expected best or one of 1, 2, got 7" in refused(*start, "--lap", "7")
    assert "spacing: expected" in refused(*start, "--spacing", "0")
    assert "--join" in refused(*start[:3], run, *start[3:])
    text = by_hand / "hall.yaml"
    moved = yaml.safe_load(text.read_text())
    moved["origin"] = [-3.0, -4.0, 0.0]
    (by_hand / "moved.yaml").write_text(yaml.safe_dump(moved))
    assert "is it the map of that drive?" in refused(*start, "--map", by_hand / "moved.yaml")
    assert not line.exists()


def test_a_lap_along_a_wall_is_told(by_hand, tmp_path, capsys):
    """A car 0.3 m wide at a radius of 1.6 m is 0.1 m from the inner wall; at 1.4 m it is inside
    it."""
    drive(tmp_path / "run.bag", 1.6, (2.0, 3.0))
    output = tmp_path / "line.csv"
    assert record(tmp_path, output, "--map", by_hand / "hall.yaml") == 0
    printed = capsys.readouterr().out
    assert "from the line at s" in printed and "1 warning" in printed and "touches" in printed
    drive(tmp_path / "run.bag", 1.4, (2.0, 3.0))
    assert record(tmp_path, output, "--map", by_hand / "hall.yaml") == 1
    assert "choose another lap with --lap" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("frame", "factor", "said"),
    [
        (
            "odom",
            1.0,
            "warning: /car_state/odom is in frame odom, which drifts relative to the map",
        ),
        ("map", 1.3, "warning: /car_state/odom: the measured speed is 1.30 times the motion"),
    ],
)
def test_what_makes_the_lap_doubtful_stands_beside_the_line(tmp_path, capsys, frame, factor, said):
    with BagWriter(tmp_path / "run.bag") as bag:
        for i in range(1200):
            x, y, psi = 2.0 * np.cos(0.02 * i), 2.0 * np.sin(0.02 * i), 0.02 * i + 0.5 * np.pi
            speed = 2.0 * factor
            bag.odometry(100.0 + 0.02 * i, x, y, psi, speed, 0.0, 1.0, frame=frame)
    assert record(tmp_path, tmp_path / "line.csv") == 0
    printed = capsys.readouterr().out
    assert said in printed and "nothing wrong" not in printed
