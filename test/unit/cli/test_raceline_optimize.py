"""``map-racing raceline optimize`` as users call it, and races on its output."""

import math
import re

import numpy as np
import pytest
import yaml
from PIL import Image

from map_racing.cli import main
from map_racing.control.controller import Controller
from map_racing.control.parameters import load_controller_parameters
from map_racing.control.speed_sectors import load_speed_sectors
from map_racing.control.steering import build_steering_map
from map_racing.simulation.plant import Localization, Plant
from map_racing.simulation.plants import load_plant
from map_racing.simulation.race import Outcome, race
from map_racing.track import optimization
from map_racing.track.files.load import load_raceline, save_raceline
from map_racing.track.raceline import Raceline
from map_racing.vehicle.parameters import linearized, load_vehicle
from map_racing.vehicle.steady_state import steady_state_table


def run(*arguments):
    return main(["raceline", "optimize", *map(str, arguments)])


def centerline(path, width=0.9, columns="{x},{y},{right},{left}", **changes):
    """A bean of 31 m as a centerline file; `changes` of the arrays x, y, right, left."""
    angle = np.linspace(0.0, 2.0 * math.pi, 160, endpoint=False)
    radius = 4.5 + 1.2 * np.cos(3.0 * angle)
    data = {"x": radius * np.cos(angle), "y": radius * np.sin(angle)}
    data["right"] = data["left"] = np.full(160, width)
    data = {key: changes.get(key, lambda column: column)(data[key].copy()) for key in data}
    rows = zip(*(data[key].tolist() for key in ("x", "y", "right", "left")))
    lines = ["# x_m, y_m, w_tr_right_m, w_tr_left_m"]
    lines += [columns.format(x=x, y=y, right=right, left=left) for x, y, right, left in rows]
    path.write_text("\n".join(lines) + "\n")
    return path


def set_at(index, value):
    def change(column):
        column[index] = value
        return column

    return change


def table_of(text):
    """Rows of the printed table, by name."""
    rows = [line.split() for line in text.splitlines()]
    begin = next(k for k, row in enumerate(rows) if row[:2] == ["[m]", "[rad^2/m]"])
    return {row[0]: row[1:] for row in rows[begin + 1 :] if len(row) == 6}


def test_centerline_to_raceline(tmp_path, capsys):
    source = centerline(tmp_path / "hall.csv")
    out = tmp_path / "line.csv"
    assert run(source, "--output", out, "--margin", "0.2", "--plots", tmp_path) == 0
    rows = table_of(capsys.readouterr().out)
    assert set(rows) == {"hall", "middle", "optimized"}
    length, bending, _, clearance, lap = map(float, rows["optimized"])
    assert bending < 0.8 * float(rows["hall"][1]) and lap < 0.95 * float(rows["hall"][4])
    assert clearance == pytest.approx(0.348, abs=1.1e-3)
    line = load_raceline(str(out))
    assert line.length == pytest.approx(length, abs=0.01)
    assert min(line.d_left.min(), line.d_right.min()) > 0.345
    assert line.speed.max() <= load_vehicle("nuc4").v_max
    assert (tmp_path / "hall_optimized.png").stat().st_size > 20000


def test_a_slower_line_is_told_and_why(tmp_path, capsys):
    """A line along the inner wall is shorter than any line with room for a car."""
    angle = np.linspace(0.0, 2.0 * math.pi, 200, endpoint=False)
    path = tmp_path / "ring.csv"
    track = Raceline(
        *(4.0 * np.cos(angle), 4.0 * np.sin(angle)),
        vx_mps=np.full(200, 3.0),
        d_left_m=np.full(200, 0.05),
        d_right_m=np.full(200, 1.2),
    )
    save_raceline(track, path)
    assert run(path, "--vehicle", "sim") == 0
    printed = capsys.readouterr().out
    assert "warning: the optimized line is slower than ring by" in printed
    assert "comes within 0.050 m of the walls; this one keeps 0.20" in printed
    assert "--margin -0.05" in printed
    rows = table_of(printed)
    assert float(rows["optimized"][4]) > float(rows["ring"][4])


def test_the_given_path_is_kept_where_no_faster_one_is_found(tmp_path, capsys, monkeypatch):
    source = centerline(tmp_path / "hall.csv")
    track = load_raceline(str(source))
    wave = 0.3 * np.cos(2.0 * math.pi * 9 * track.s / track.length)
    worse = Raceline(*track.to_cartesian(track.s, wave))
    monkeypatch.setattr(optimization._Search, "best", lambda *_: worse)
    assert run(source) == 0
    printed = capsys.readouterr().out
    rows = table_of(printed)
    assert "no faster line than the given one was found: its path is kept" in printed
    assert float(rows["optimized"][4]) == pytest.approx(float(rows["hall"][4]), abs=0.002)


@pytest.mark.once
def test_rows_of_one_name_are_told_apart(tmp_path, capsys):
    source = centerline(tmp_path / "hall.csv")
    track = load_raceline(str(source))
    (tmp_path / "other").mkdir()
    other = tmp_path / "other" / "hall.csv"
    save_raceline(Raceline(*track.to_cartesian(track.s, np.full(track.s.size, 0.4))), other)
    assert run(source, "--compare", other) == 0
    assert set(table_of(capsys.readouterr().out)) == {"hall", "compared", "middle", "optimized"}


def test_an_open_course_is_called_that_first(tmp_path, capsys):
    x = np.linspace(0.0, 20.0, 160)
    course = {"x": lambda _: x, "y": lambda _: 2.0 * np.sin(0.3 * x)}
    assert run(centerline(tmp_path / "course.csv", **course)) == 1
    told = capsys.readouterr().err
    assert "course.csv: expected a closed track, but the last point is" in told


def test_a_line_that_cannot_be_steered_is_named_below_the_table(tmp_path, capsys):
    source = centerline(tmp_path / "hall.csv")
    track = load_raceline(str(source))
    wave = 0.05 * np.cos(2.0 * math.pi * 40 * track.s / track.length)
    other = Raceline(*track.to_cartesian(track.s, wave), name="wave")
    save_raceline(other, tmp_path / "wave.csv")
    assert run(source, "--compare", tmp_path / "wave.csv") == 0
    printed = capsys.readouterr().out
    assert table_of(printed)["wave"][4] == "-"
    row, told = printed.splitlines()[-2:]
    assert row.split()[0] == "optimized"
    assert "  lap times: at the highest speeds of NUC4, whatever speeds a file has\n" in printed
    assert told.startswith("  wave: no lap time: speed profile: s = ")


def test_speed_options(tmp_path, capsys):
    source = centerline(tmp_path / "hall.csv")

    def optimized(*options):
        assert run(source, "--curvature-only", *options) == 0
        return [float(cell) for cell in table_of(capsys.readouterr().out)["optimized"]]

    def lap(*options):
        return optimized(*options)[4]

    length, _, _, _, full = optimized()
    assert lap("--speed-scale", "0.5") == pytest.approx(2.0 * full, abs=2e-3)
    # The top speed is not reached here: with half the accelerations, speeds fall to no less than
    # sqrt(1/2), and less strongly where the limit falls with speed.
    half = lap("--lateral-scale", "0.5", "--longitudinal-scale", "0.5")
    assert 1.2 * full < half < 1.5 * full
    assert lap("--power", "5") > 1.02 * full
    assert lap("--v-max", "2") == pytest.approx(length / 2.0, rel=1e-3)


def test_compare_gives_the_same_room(tmp_path, capsys):
    source = centerline(tmp_path / "hall.csv")
    track = load_raceline(str(source))
    angle = 2.0 * math.pi * track.s / track.length
    other = Raceline(*track.to_cartesian(track.s, 0.4 + 0.0 * angle), name="other")
    save_raceline(other, tmp_path / "other.csv")
    assert run(source, "--compare", tmp_path / "other.csv") == 0
    rows = table_of(capsys.readouterr().out)
    assert float(rows["other"][3]) == pytest.approx(0.5, abs=0.005)
    assert float(rows["optimized"][3]) == pytest.approx(float(rows["other"][3]), abs=2e-3)
    beyond = Raceline(*track.to_cartesian(track.s, 1.2 + 0.0 * angle), name="beyond")
    save_raceline(beyond, tmp_path / "beyond.csv")
    assert run(source, "--compare", tmp_path / "beyond.csv") == 0
    printed = capsys.readouterr().out
    assert "beyond.csv is 0.3" in printed and "m beyond a wall" in printed
    assert "  the optimized line keeps 0.2" in printed
    assert float(table_of(printed)["beyond"][3]) == pytest.approx(-0.3, abs=0.02)


def test_doubts_about_lines_to_compare_with_and_about_the_table_are_told(tmp_path, capsys):
    source = centerline(tmp_path / "hall.csv")
    track = load_raceline(str(source))
    inner = Raceline(*track.to_cartesian(track.s, np.full(track.s.size, 0.4)))
    rows = np.column_stack((inner.x, inner.y, 3.0 + 0.0 * inner.x))
    np.savetxt(str(tmp_path / "unnamed.csv"), rows, delimiter=",")
    linear = linearized(load_vehicle("nuc4"))
    own = steady_state_table(linear, np.linspace(0.5, 7.0, 20), np.linspace(0.0, 0.4, 41))
    own.save(tmp_path / "table.csv")
    options = ["--compare", tmp_path / "unnamed.csv", "--lookup-table", tmp_path / "table.csv"]
    assert run(source, *options) == 0
    printed = capsys.readouterr().out
    assert re.search(r"warning: raceline \S+unnamed.csv: 3 unnamed columns", printed)
    assert "warning: lookup table: reaches " in printed


@pytest.mark.once
def test_several_lines_to_compare_with(tmp_path, capsys):
    source = centerline(tmp_path / "hall.csv")
    track = load_raceline(str(source))
    compared = []
    for folder, d in (("a", 0.4), ("b", 0.55), ("c", 1.2), ("d", 0.3)):
        (tmp_path / folder).mkdir()
        line = Raceline(*track.to_cartesian(track.s, np.full(track.s.size, d)))
        save_raceline(line, tmp_path / folder / "line.csv")
        compared += ["--compare", tmp_path / folder / "line.csv"]
    assert run(source, *compared) == 0
    printed = capsys.readouterr().out
    assert f"{tmp_path / 'c' / 'line.csv'} is 0.3" in printed
    table = printed[printed.index("[rad^2/m]") :].splitlines()[1:8]
    clearances = {line[:26].strip(): float(line[26:].split()[3]) for line in table}
    expected = {"line": 0.5, "compared": 0.35, "compared 2": -0.3, "compared 3": 0.6}
    # As close to the walls as the closest line that a car can follow.
    expected["optimized"] = 0.35
    found = {name: clearances[name] for name in expected}
    assert found == pytest.approx(expected, abs=0.02)


@pytest.mark.parametrize("suffix", ["csv", pytest.param("json", marks=pytest.mark.once)])
def test_speed_sectors_fit_the_output(tmp_path, suffix):
    source = centerline(tmp_path / "hall.csv")
    out, sectors = tmp_path / f"line.{suffix}", tmp_path / "speed_scaling.yaml"
    assert run(source, "--output", out, "--sectors", sectors) == 0
    content = yaml.safe_load(sectors.read_text())
    count = content["n_sectors"]
    assert content["global_limit"] == 1.0 and 2 <= count <= 12
    line = load_raceline(str(out))
    assert content["Sector0"]["start"] == 0
    assert content[f"Sector{count - 1}"]["end"] == line.s_points.size - 1
    for k in range(1, count):
        assert content[f"Sector{k}"]["start"] == content[f"Sector{k - 1}"]["end"] + 1
    assert {load_speed_sectors(sectors, line).scale_at(s) for s in line.s.tolist()} == {1.0}
    # A scale written into a sector is read back there and nowhere else.
    content["Sector1"]["scaling"] = 0.5
    sectors.write_text(yaml.safe_dump(content))
    scales = load_speed_sectors(sectors, line)
    begin, end = (line.s_points[content["Sector1"][key]] for key in ("start", "end"))
    assert scales.scale_at(0.5 * (begin + end)) == 0.5
    assert scales.scale_at(begin - 0.01) == scales.scale_at(end + 0.11) == 1.0


def hall_map(folder):
    """A drawn hall as after a mapping run: gray outside, a few specks."""
    axis = (np.arange(280) + 0.5) * 0.05 - 7.0
    x, y = np.meshgrid(axis, axis[::-1])
    radius = np.hypot(x / 1.3, y)
    gray = np.full(x.shape, 205, dtype=np.uint8)
    gray[(radius > 2.3) & (radius < 4.7)] = 0
    gray[(radius > 2.5) & (radius < 4.5)] = 254
    gray[40, 100] = gray[150, 20] = 0
    Image.fromarray(gray).save(str(folder / "hall.pgm"))
    text = "image: hall.pgm\nresolution: 0.05\norigin: [-7, -7, 0]\nnegate: 0\n"
    (folder / "hall.yaml").write_text(text + "occupied_thresh: 0.65\nfree_thresh: 0.25\n")
    return folder / "hall.yaml"


@pytest.mark.parametrize(
    "start, turn",
    [
        (["--start", "-4.5,0,-1.57"], 1.0),
        pytest.param(["--start", "-4.5", "0", "1.57"], -1.0, marks=pytest.mark.once),
        pytest.param(["--start", "-4.5,0"], 1.0, marks=pytest.mark.once),
    ],
)
def test_a_map_becomes_a_raceline_in_one_command(tmp_path, capsys, start, turn):
    out = tmp_path / "line.csv"
    assert run(hall_map(tmp_path), *start, "--output", out) == 0
    assert "taken as unknown" in capsys.readouterr().out
    line = load_raceline(str(out))
    assert np.sum(line.kappa) * line.ds == pytest.approx(turn * 2.0 * math.pi, abs=0.01)
    assert math.hypot(line.x[0] + 4.5, line.y[0]) < 1.2
    radius = np.hypot(line.x / 1.3, line.y)
    assert radius.min() > 2.6 and radius.max() < 4.4


@pytest.mark.parametrize(
    "options, text",
    [
        ([], "expected --start X,Y[,PSI] for a map, such as --start "),
        (["--start", "1"], "--start: expected X,Y or X,Y,PSI"),
        (["--start", "a,b"], "--start: expected X,Y or X,Y,PSI"),
        (["--start", "0,0"], "is in a wall or on unknown ground"),
        (["--start", "-4.5,0", "--passage", "0"], "--passage: expected 0.001 to 100, got 0"),
    ],
)
def test_starts_that_cannot_be(tmp_path, capsys, options, text):
    assert run(hall_map(tmp_path), *options) == 1
    error = capsys.readouterr().err
    assert text in error and error.count("\n") == 1


@pytest.mark.once
def test_the_start_that_the_error_names_will_do(tmp_path, capsys):
    assert run(hall_map(tmp_path)) == 1
    start = re.search(r"such as --start (\S+), the widest", capsys.readouterr().err).group(1)
    assert run(hall_map(tmp_path), "--start", start, "--output", tmp_path / "line.csv") == 0


WHOLE = ("x", "y", "right", "left")


def keep(part):
    return lambda column: column[part]


@pytest.mark.parametrize(
    "changes, text",
    [
        ({key: keep(slice(0, 100)) for key in WHOLE}, "closed"),
        ({"x": set_at(20, math.nan)}, "finite"),
        ({"left": set_at(20, math.nan)}, "finite"),
        ({"left": set_at(slice(20, 24), 0.0)}, "positive distance to the left wall"),
        ({"right": set_at(20, -0.3)}, "beyond the right wall"),
        ({"right": set_at(slice(20, 24), 0.05), "left": set_at(slice(20, 24), 0.05)}, "narrow"),
        ({key: lambda c: np.concatenate((c, c)) for key in WHOLE}, "one loop"),
        ({"x": lambda c: 1e3 * np.sign(c)}, ""),
    ],
    ids=["open", "NaN", "NaN width", "zero", "negative", "narrow", "two loops", "no track"],
)
def test_bad_input_is_one_line(tmp_path, capsys, changes, text):
    source = centerline(tmp_path / "bad.csv", **changes)
    out = tmp_path / "line.csv"
    assert run(source, "--output", out) == 1
    error = capsys.readouterr().err
    assert text in error and "bad.csv" in error and error.count("\n") == 1
    assert not out.exists()


@pytest.mark.parametrize(
    "columns", ["{right},{left},{x},{y}", "{x},{right},{y},{left}"], ids=["both", "one"]
)
def test_swapped_columns_are_refused(tmp_path, capsys, columns):
    source = centerline(tmp_path / "bad.csv", columns=columns)
    assert run(source) == 1
    assert capsys.readouterr().err.count("\n") == 1


def test_exchanged_walls_are_refused(tmp_path, capsys):
    """With a raceline, which is not in the middle."""
    line = load_raceline("reference")
    swapped = Raceline(line.x, line.y, d_left_m=line.d_right, d_right_m=line.d_left)
    save_raceline(swapped, tmp_path / "swapped.csv")
    capsys.readouterr()
    assert run(tmp_path / "swapped.csv") == 1
    assert "swapped" in capsys.readouterr().err


@pytest.mark.parametrize(
    "options, text",
    [
        (["--margin", "nan"], "--margin"),
        (["--step", "0"], "--step"),
        (["--lateral-scale", "0"], "--lateral-scale"),
        (["--start", "0,0"], "--start: expected the YAML file of a map"),
        (["--margin", "2"], "too narrow"),
        (["--vehicle", "none"], "none: no such file"),
        (["--output", "line.txt"], "line.txt"),
        (["--v-max", "-1"], "--v-max"),
    ],
)
def test_options_that_cannot_be(tmp_path, capsys, monkeypatch, options, text):
    monkeypatch.chdir(tmp_path)
    assert run(centerline(tmp_path / "hall.csv"), *options) == 1
    error = capsys.readouterr().err
    assert text in error and error.count("\n") == 1


def race_lap(path, speed_scale=0.9):
    """Mean time of the timed lap of MAP on a line, and the log."""
    plant_parameters = load_plant("nuc4")
    parameters = load_controller_parameters("map").with_(speed_scale=speed_scale)
    vehicle = plant_parameters.vehicle
    line = load_raceline(path)
    controller = Controller(
        parameters, build_steering_map("table", vehicle, parameters.v_max_mps), vehicle, line
    )
    log = race(Plant(plant_parameters), controller, line, Localization(plant_parameters, 1), laps=1)
    assert log.outcome is Outcome.COMPLETED
    path = log.true_path()
    start = path[:, 0][np.hypot(*(path[:, 1:3] - line.position(0.0)).T) < 0.5]
    # The timed lap begins when the out-lap ends, and ends one lap later.
    crossings = start[np.flatnonzero(np.diff(np.append(-10.0, start)) > 1.0)]
    return crossings[2] - crossings[1]


@pytest.mark.once
@pytest.mark.parametrize(
    "track, gain", [("reference", 1.1), pytest.param("club", 1.2, marks=pytest.mark.once)]
)
def test_the_car_is_faster_on_the_optimized_line_and_stays_on_the_track(tmp_path, track, gain):
    """MAP on the middle line and on the optimized one, with speeds made in the same way."""
    out, middle = tmp_path / "line.csv", tmp_path / "middle.csv"
    assert run(track, "--output", out, "--middle", middle) == 0
    assert race_lap(middle) > gain * race_lap(out)


def _oval(path, unit, width):
    phi = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    rows = np.stack((6.0 * np.cos(phi), 3.5 * np.sin(phi), 0.0 * phi + width, 0.0 * phi + width), 1)
    np.savetxt(str(path), unit * rows, delimiter=",", header="x_m,y_m,w_tr_right_m,w_tr_left_m")
    return str(path)


@pytest.mark.parametrize("unit, width, text", [(1e3, 1.0, "in mm"), (1.0, 1e6, "1000000 m")])
def test_what_would_take_all_day_is_refused(tmp_path, capsys, unit, width, text):
    assert main(["raceline", "optimize", _oval(tmp_path / "line.csv", unit, width)]) == 1
    assert text in capsys.readouterr().err


@pytest.mark.once
def test_margin_and_step_are_those_of_the_car(tmp_path, capsys):
    source = centerline(
        tmp_path / "circuit.csv",
        width=7.0,
        x=lambda x: 12.0 * x,
        y=lambda y: 12.0 * y,
    )
    out = tmp_path / "line.csv"
    car = load_vehicle("bmw_320i")
    assert run(source, "--vehicle", "bmw_320i", "--output", out) == 0
    size = car.l_wb / 0.32
    printed = capsys.readouterr().out
    count = int(re.search(r"(\d+) points optimized", printed).group(1))
    line = load_raceline(out)
    assert count == pytest.approx(line.length / (0.1 * size), abs=2)
    clearance = float(table_of(printed)["optimized"][3])
    assert clearance == pytest.approx(0.5 * car.width + 0.1 * size, abs=0.02)
