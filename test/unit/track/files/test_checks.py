"""Faults of a track are found at the right place, without false alarms."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.errors import RacelineError
from map_racing.track.files.checks import examine, raceline_of
from map_racing.track.files.load import load_raceline
from map_racing.track.files.readers import read_raceline_file
from map_racing.track.files.table import RacelineTable
from map_racing.track.findings import ERROR, NOTE, WARNING
from map_racing.track.raceline import Raceline

# A track with bends both ways, driven counter-clockwise, with the walls and speeds of a racing
# line: close to the inner wall and slow in bends.
T = np.arange(400) * 2.0 * math.pi / 400
R = 6.0 + 1.5 * np.cos(3.0 * T)
LINE = Raceline(R * np.cos(T), R * np.sin(T))
KAPPA = LINE.kappa
GOOD = {
    "s": LINE.s,
    "x": LINE.x,
    "y": LINE.y,
    "psi": LINE.psi,
    "kappa": KAPPA,
    "speed": 5.0 - 3.0 * np.abs(KAPPA),
    "d_left": 1.0 - 0.5 * KAPPA,
    "d_right": 1.0 + 0.5 * KAPPA,
}
GOOD["ax"] = (np.roll(GOOD["speed"], -1) ** 2 - GOOD["speed"] ** 2) / (2.0 * LINE.ds)
N = LINE.n


def table(rows=None, without=(), **changed):
    columns = {k: np.array(v, dtype=float) for k, v in {**GOOD, **changed}.items()}
    rows = np.arange(N) if rows is None else rows
    columns = {k: column[rows] for k, column in columns.items() if k not in without}
    return RacelineTable(columns, "track", "c.csv", lines=np.arange(len(rows)) + 4)


def codes(table):
    return {f.code: f for f in examine(table).findings if f.severity != NOTE}


def set_at(column, places, value):
    column = GOOD[column].copy()
    column[places] = value
    return column


def test_nothing_is_wrong_with_a_good_track():
    examination = examine(table())
    assert [finding.code for finding in examination.findings] == ["heading-x"]
    assert raceline_of(table()).findings == examination.findings


def test_a_finding_names_its_point():
    finding = codes(table(d_left=set_at("d_left", 30, -0.2)))["beyond-wall"]
    (place,) = finding.places
    assert (place.index, place.line) == (30, 34)
    assert place.s == pytest.approx(LINE.s[30], abs=1e-3)
    assert (place.x, place.y) == (LINE.x[30], LINE.y[30])
    text = f"1 point beyond the left wall, at point 30 (line 34): s = {LINE.s[30]:.2f} m, x = "
    assert str(finding).startswith(text)


@pytest.mark.parametrize("key", ["x", "speed", "d_right"])
def test_what_is_not_finite_is_refused_where_it_is_needed(key):
    bad = table(**{key: set_at(key, [7, 9], math.nan)})
    finding = codes(bad)["not-finite"]
    assert finding.severity == ERROR
    assert [place.line for place in finding.places] == [11, 13]
    with pytest.raises(RacelineError, match=rf"c\.csv: expected a finite {key}, .*\(line 11\)"):
        raceline_of(bad)


@pytest.mark.parametrize("key", ["s", "psi", "kappa", "ax"])
def test_what_is_recomputed_need_not_be_finite(key):
    assert list(codes(table(**{key: set_at(key, 7, math.inf)}))) == ["not-finite-unused"]


def test_impossible_numbers():
    assert codes(table(y=set_at("y", 5, 1e12)))["impossible"].places[0].index == 5
    assert codes(table(speed=set_at("speed", 5, -1.0)))["negative-speed"].places[0].index == 5
    assert "few-points" in codes(table(rows=[0, 1, 2]))


def test_repetitions():
    found = codes(table(rows=np.sort(np.append(np.arange(N), [50, 50, 90]))))
    assert list(found) == ["repeated-points"]
    assert [place.index for place in found["repeated-points"].places] == [51, 52, 93]


def test_two_laps_of_the_same_track():
    found = codes(table(rows=np.tile(np.arange(N), 2), without=("s",)))
    assert found["two-loops"].severity == ERROR
    assert found["two-loops"].places[0].index == N
    # As recorded: the laps differ by 10 cm, and one is incomplete.
    rows = np.append(np.arange(N), np.arange(N - 20))
    width = 0.1 * np.sin(np.arange(rows.size) / 70.0)
    x, y = LINE.to_cartesian(LINE.s[rows], width)
    found = codes(RacelineTable({"x": x, "y": y}))
    assert abs(found["two-loops"].places[0].index - N) < 3
    # Anything longer than one lap.
    for laps in (1.2, 1.5, 3.0, 7.0):
        rows = np.arange(int(laps * N)) % N
        finding = codes(table(rows=rows, without=("s",)))["two-loops"]
        assert f"make {max(2, int(round(laps)))};" in finding.text
        assert finding.places[0].index == N


def test_two_loops_one_after_the_other():
    walls = [LINE.to_cartesian(LINE.s, d) for d in (1.0, -1.0)]
    columns = {key: np.concatenate([wall[k] for wall in walls]) for k, key in enumerate("xy")}
    found = codes(RacelineTable(columns))
    assert found["two-loops"].severity == ERROR
    assert found["two-loops"].places[0].index == N


def test_neither_hairpins_nor_crossings_are_two_loops():
    eight = {"x": 8.0 * np.sin(T), "y": 4.0 * np.sin(2.0 * T)}
    examination = examine(RacelineTable(eight))
    assert [finding.code for finding in examination.findings] == ["self-crossing"]
    assert examination.findings[0].severity == NOTE
    assert np.hypot(*examination.findings[0].places[0][3:]) < 0.2
    # Out and back, 1 m apart.
    long = {"x": 20.0 * np.cos(T), "y": 0.5 * np.sign(np.sin(T)) * np.abs(np.sin(T)) ** 0.4}
    assert "two-loops" not in codes(RacelineTable(long))


def test_an_end_that_overlaps_the_start():
    found = codes(table(rows=np.arange(N + 9) % N, without=("s", "ax")))
    assert list(found) == ["overlap"] and found["overlap"].severity == ERROR
    assert [place.index for place in found["overlap"].places] == list(range(N, N + 9))


def test_points_that_turn_back():
    rows = np.arange(N)
    rows[[100, 102]] = rows[[102, 100]]
    found = codes(table(rows=rows, without=("s", "ax", "psi", "kappa")))
    assert found["turns-back"].severity == ERROR
    assert {place.index for place in found["turns-back"].places} <= {100, 101, 102}


@pytest.mark.parametrize("count", [4, 10, 100])
@pytest.mark.parametrize("slope", [0.0, 1.0, 0.3])
def test_a_line_driven_there_and_back_is_no_track(count, slope):
    there = np.arange(count) * 0.5
    way = np.append(there, there[::-1])
    with pytest.raises(RacelineError, match="turns back|back and forth"):
        raceline_of(RacelineTable({"x": way, "y": slope * way}))


def test_a_wrong_order_is_not_a_second_loop():
    rows = np.arange(0, N, 8)
    rows[[6, 12]] = rows[[12, 6]]
    found = codes(table(rows=rows, without=("s", "ax", "psi", "kappa")))
    assert [f.code for f in found.values() if f.severity == ERROR] == ["turns-back"]


def test_gaps():
    found = codes(table(rows=np.arange(N - 9)))
    assert list(found) == ["gap"] and found["gap"].places[0].index == N - 10
    found = codes(table(rows=np.append(np.arange(100), np.arange(110, N)), without=("ax",)))
    assert list(found) == ["spacing"] and found["spacing"].places[0].index == 99
    found = codes(table(rows=np.arange(N // 2)))
    assert found["open"].severity == ERROR
    assert "expected a closed track, but the last point is" in found["open"].text


def test_an_open_track_whose_column_only_rises_is_asked_about():
    found = codes(RacelineTable({"x": GOOD["s"], "y": GOOD["x"]}))
    assert "x only increases: is it really the x column?" in found["open"].text


def test_too_few_points_for_the_bends():
    angles = np.arange(7) * 2.0 * math.pi / 7
    found = codes(RacelineTable({"x": 6.0 * np.cos(angles), "y": 6.0 * np.sin(angles)}))
    assert list(found) == ["coarse"] and found["coarse"].severity == WARNING


def test_arc_length():
    assert list(codes(table(s=1.1 * LINE.s))) == ["arc-length"]
    assert list(codes(table(s=LINE.s[::-1]))) == ["reversed-arc-length"]
    assert "arc-length-order" in codes(table(s=set_at("s", 20, 0.0)))
    assert codes(table(s=0.0 * LINE.s)) == {}


PSI = GOOD["psi"]


@pytest.mark.parametrize(
    "psi, code",
    [
        (PSI - 0.5 * math.pi, "heading-north"),
        (PSI + 2.0 * math.pi, "heading-x"),
        (PSI + math.pi, "heading-against"),
        (0.5 * math.pi - PSI, "heading-compass"),
        (-PSI, "heading-clockwise"),
        (np.degrees(PSI), "heading-degrees"),
        (np.degrees(PSI) - 90.0, "heading-degrees-north"),
        (PSI + 0.8, "heading"),
    ],
)
def test_headings(psi, code):
    found = [f.code for f in examine(table(psi=psi)).findings]
    assert found == [code]


def test_one_wrong_heading():
    found = codes(table(psi=set_at("psi", 44, PSI[44] + 1.0)))
    assert list(found) == ["heading-point"] and found["heading-point"].places[0].index == 44


def test_curvature():
    assert list(codes(table(kappa=-KAPPA))) == ["curvature-sign"]
    assert list(codes(table(kappa=2.0 * KAPPA))) == ["curvature"]


def test_exchanged_axes():
    found = codes(table(x=GOOD["y"], y=GOOD["x"], without=("d_left", "d_right")))
    assert set(found) == {"curvature-sign", "swapped-xy"}


def test_bends_too_tight_for_a_car():
    small = {key: 0.3 * GOOD[key] for key in ("x", "y")}
    assert examine(RacelineTable(small)).findings[0].code == "tight-bend"
    assert examine(RacelineTable(small)).findings[0].severity == NOTE
    small["speed"] = 1.0 + 0.0 * LINE.s
    assert codes(RacelineTable(small))["tight-bend"].severity == WARNING


def test_tracks_in_another_unit():
    for scale in (1000.0, 0.05):
        found = codes(RacelineTable({key: scale * GOOD[key] for key in ("x", "y")}))["size"]
        assert found.severity == WARNING and "is it in meters?" in found.text
    assert "size" not in codes(RacelineTable({key: GOOD[key] for key in ("x", "y")}))


def test_a_small_loop():
    # A limaçon with an inner loop.
    r = 0.8 + 1.0 * np.cos(T)
    x, y = 3.0 * r * np.cos(T), 3.0 * r * np.sin(T)
    assert codes(RacelineTable({"x": x, "y": y}))["loop"].severity == WARNING


def test_walls():
    found = codes(table(d_left=set_at("d_left", [3, 4], -2.0)))
    assert {"beyond-wall", "no-width"} <= set(found)
    assert "walls-cross" in codes(table(d_left=GOOD["d_left"] + 9.0))
    # A waist of 1 m with walls declared 0.8 m away on both sides.
    peanut = {"x": 12.0 * np.cos(T), "y": (0.5 + 6.0 * np.cos(T) ** 2) * np.sin(T)}
    peanut.update(d_left=0.0 * T + 0.8, d_right=0.0 * T + 0.8)
    texts = [f.text for f in examine(RacelineTable(peanut)).findings if f.code == "walls-cross"]
    assert any(text.startswith("the left wall crosses itself") for text in texts)
    found = {f.code: f.severity for f in examine(table(d_right=GOOD["d_right"] + 1.5)).findings}
    assert found["wall-folds"] == NOTE
    assert "one-wall" in codes(table(without=("d_left",)))


def exchanged(line):
    return RacelineTable({"x": line.x, "y": line.y, "d_left": line.d_right, "d_right": line.d_left})


def test_exchanged_walls():
    assert list(codes(exchanged(load_raceline("reference")))) == ["swapped-walls"]
    # Walls at a constant distance from each other are equally smooth: the line stays outside in all
    # bends.
    assert list(codes(exchanged(load_raceline("club")))) == ["swapped-walls"]
    # A line that weaves between two circles, whose bends reveal nothing.
    r = 6.0 + 0.4 * np.sin(2.0 * T)
    columns = {"x": r * np.cos(T), "y": r * np.sin(T), "d_left": r - 5.0, "d_right": 7.5 - r}
    assert codes(RacelineTable(columns)) == {}


@pytest.mark.parametrize("digits", [2, 3])
def test_rounded_points_do_not_exchange_the_walls(digits):
    """Normals at jittering points swing, which moves the far wall more than the near one."""
    far = 14.0 * np.cos(T), 9.0 * np.sin(T)
    walls = {"d_left": 1.3 + 0.2 * np.cos(3.0 * T), "d_right": 1.0 + 0.15 * np.sin(2.0 * T)}
    x, y = (np.round(column, digits) for column in far)
    assert "swapped-walls" not in codes(RacelineTable({"x": x, "y": y, **walls}))


def test_walls_of_a_track_that_crosses_itself_cross_there():
    columns = {"x": 12.0 * np.sin(T), "y": 5.0 * np.sin(2.0 * T), "d_left": 0.0 * T + 1.0}
    far = np.where(np.abs(T - 0.25 * math.pi) < 0.05, 11.0, 1.0)  # across the other branch
    assert "walls-cross" not in codes(RacelineTable({**columns, "d_right": 0.0 * T + 1.0}))
    assert "walls-cross" in codes(RacelineTable({**columns, "d_right": far}))


def test_a_last_point_beside_the_first_closes_the_track():
    """The first point repeated with rounding: no overlap of a millimeter."""
    for off in (-0.001, 0.001):
        ends = {key: np.append(GOOD[key], GOOD[key][0]) for key in ("x", "y", "speed")}
        ends["x"][-1] += off * np.cos(LINE.psi[0])
        ends["y"][-1] += off * np.sin(LINE.psi[0])
        examination = examine(RacelineTable(ends))
        assert [finding.code for finding in examination.findings] == ["closing-point"]
        assert examination.raceline.length == pytest.approx(LINE.length, abs=1e-3)


@pytest.mark.rest_once
@pytest.mark.parametrize("turned", ["line", "both", "other", "nothing"])
@pytest.mark.parametrize("shown", ["markers", "line"])
def test_a_file_that_shows_its_walls_tells_whether_they_are_exchanged(tmp_path, shown, turned):
    """A line that weaves evenly between two circles: neither shape nor bends reveal anything."""
    r, a = 6.0 + 0.4 * np.sin(2.0 * T), 2.0 * T
    walls = [[w * np.cos(a), w * np.sin(a)] for w in (5.0, 7.5)]

    def waypoints(radius, exchange):
        sides = radius - 5.0 + 0.0 * T, 7.5 - radius + 0.0 * T
        columns = radius * np.cos(T), radius * np.sin(T), *(sides[::-1] if exchange else sides)
        names = ("x_m", "y_m", "d_left", "d_right")
        return {"wpnts": [dict(zip(names, map(float, row))) for row in zip(*columns)]}

    content = {"global_traj_wpnts_iqp": waypoints(r, turned in ("line", "both"))}
    if shown == "line":
        content["centerline_waypoints"] = waypoints(6.2, turned in ("other", "both"))
    else:
        places = [{"x": float(x), "y": float(y)} for wall in walls for x, y in zip(*wall)]
        markers = [{"pose": {"position": place}} for place in places]
        content["trackbounds_markers"] = {"markers": markers}
    path = tmp_path / "global_waypoints.json"
    path.write_text(json.dumps(content))
    found = codes(read_raceline_file(path))
    assert ("swapped-walls" in found) == (turned in ("line", "both"))
    # A file whose shape is another track's proves nothing.
    content["trackbounds_markers"] = {"markers": [{"pose": {"position": {"x": 50.0, "y": 9.0}}}]}
    path.write_text(json.dumps(content))
    assert codes(read_raceline_file(path)) == {}


@pytest.mark.parametrize("unit", [1.0, 100.0, 1000.0])
def test_walls_in_other_units(unit):
    line = load_raceline("reference")
    columns = {"d_left": unit * line.d_left, "d_right": unit * line.d_right}
    found = codes(RacelineTable({"x": line.x, "y": line.y, **columns}))
    assert ("walls-far" in found) == (unit > 1.0)


@pytest.mark.rest_once
@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("track", ["reference", "club"])
def test_a_line_along_one_wall_is_not_taken_for_exchanged(track, side):
    """Close to one wall all around, and weaving: the other wall is equally smooth."""
    middle = load_raceline(track)
    room = middle.d_left if side == "left" else -middle.d_right
    for share, swing in ((0.85, 0.0), (0.7, 0.3)):
        wave = np.sin(6.0 * np.pi * middle.s / middle.length)
        line = Raceline(*middle.to_cartesian(middle.s, room * (share + swing * wave * share)))
        feet = [middle.project(x, y) for x, y in zip(line.x, line.y)]
        at = middle.sample([foot.s for foot in feet])
        d, slope = np.array([foot.d for foot in feet]), np.cos(line.psi - at.psi)
        columns = {"d_left": (at.d_left - d) / slope, "d_right": (at.d_right + d) / slope}
        found = codes(RacelineTable({"x": line.x, "y": line.y, **columns}))
        assert "swapped-walls" not in found, (share, swing)


@pytest.mark.parametrize(
    "file",
    [
        "tracks/hangar/global_waypoints.json.gz",
        "tracks/circle/global_waypoints.json.gz",
        "laps/ipz20/IPZ20_wp.csv",
    ],
)
def test_exchanged_real_walls(shared_data, file):
    assert "swapped-walls" in codes(exchanged(load_raceline(shared_data / file)))


def test_speeds():
    found = codes(table(speed=set_at("speed", 10, 0.0), without=("ax",)))
    assert found["zero-speed"].places[0].index == 10
    assert found["speed-jump"].places[0].index in (9, 10)
    found = codes(table(speed=GOOD["speed"] + 5.0, without=("ax",)))
    assert list(found) == ["too-fast"]
    lateral = (GOOD["speed"] + 5.0) ** 2 * np.abs(KAPPA)
    assert lateral[found["too-fast"].places[0].index] == pytest.approx(lateral.max(), rel=1e-3)
    assert list(codes(table(speed=3.6 * GOOD["speed"]))) == ["kmh"]
    assert list(codes(table(ax=-GOOD["ax"]))) == ["acceleration"]


@pytest.mark.parametrize("value", [0.0, 50.0])
def test_a_mistyped_distance_to_a_wall(value):
    finding = codes(table(d_right=set_at("d_right", 30, value)))["wall-single"]
    near = GOOD["d_right"][[29, 31]]
    assert finding.text == (
        f"the distance to the right wall is {value:.2f} m between {near[0]:.2f} and "
        f"{near[1]:.2f} m: mistyped? At 1 point"
    )
    assert [place.line for place in finding.places] == [34]
    # Walls with steps are none.
    step = np.where(np.arange(N) < 200, 0.8, 2.5)
    assert "wall-single" not in codes(table(d_left=step, d_right=step))


def test_one_wall_that_is_not_given():
    finding = codes(table(d_left=0.0 * KAPPA))["wall-zero"]
    assert finding.text == "every distance to the left wall is 0: not given?"


def test_speeds_beyond_grip_that_are_so_only_in_kmh():
    found = codes(table(speed=3.6 * (GOOD["speed"] + 2.0), without=("ax",)))
    assert "in km/h?" in found["too-fast"].text


@pytest.mark.parametrize(("points", "speeds"), [(0.0, 3.0), (0.004, 0.0)])
def test_jitter_is_no_other_unit(points, speeds):
    rng = np.random.default_rng(1)
    x, y = (GOOD[name] + points * rng.normal(size=N) for name in ("x", "y"))
    speed = np.maximum(GOOD["speed"] + speeds * rng.normal(size=N), 0.1)
    found = codes(table(x=x, y=y, speed=speed, without=("ax", "s", "psi", "kappa")))
    assert "do points or speeds jitter?" in found["too-fast"].text
    assert "km/h" not in found["too-fast"].text


def test_errors_leave_out_what_they_spoil():
    rows = np.arange(N)
    rows[[100, 102]] = rows[[102, 100]]
    found = codes(table(rows=rows, without=("s", "ax", "psi", "kappa")))
    assert list(found) == ["turns-back"]


@pytest.mark.once
@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    clockwise=st.booleans(),
    size=st.floats(4.0, 200.0),
    count=st.integers(120, 500),
)
def test_no_false_alarm_on_good_tracks(seed, clockwise, size, count):
    """Smooth tracks with true columns, in any size and direction, have nothing wrong."""
    rng = np.random.RandomState(seed)
    t = np.arange(count) * 2.0 * math.pi / count
    r = 1.0 + sum(
        rng.uniform(0.0, 0.25) / k**2 * np.cos(k * t + rng.uniform(0.0, 6.0)) for k in (2, 3, 4)
    )
    x, y = size * r * np.cos(t), size * r * np.sin(t) * (-1.0 if clockwise else 1.0)
    line = Raceline(x, y)
    at = line.sample(line.s_points)
    width = 0.2 / np.max(np.abs(line.kappa))
    columns = {"s": at.s, "x": x, "y": y, "psi": at.psi - 0.5 * math.pi, "kappa": at.kappa}
    hugging = 0.8 * width * at.kappa / np.max(np.abs(at.kappa))
    columns.update(d_left=width - hugging, d_right=width + hugging)
    columns["speed"] = np.full(count, math.sqrt(9.0 / np.max(np.abs(at.kappa))))
    found = codes(RacelineTable(columns))
    found.pop("tight-bend", None)
    assert found == {}


def test_long_tracks_of_full_size_cars_are_told_from_other_units():
    """A circuit in meters, and a 1:10 track in centimeters with the same length."""
    grown = {key: 60.0 * GOOD[key] for key in ("x", "y")}
    fast = {**grown, "speed": math.sqrt(60.0) * GOOD["speed"]}
    wide = {**grown, "d_left": 6.0 * GOOD["d_left"], "d_right": 6.0 * GOOD["d_right"]}
    for columns in (fast, wide):
        assert "size" not in codes(RacelineTable(columns))
    slow = {**grown, "speed": 2.0 * GOOD["speed"]}
    walls = {**grown, "d_left": 35.0 * GOOD["d_left"], "d_right": 35.0 * GOOD["d_right"]}
    for columns in (grown, slow, walls, {**walls, "speed": 2.0 * GOOD["speed"]}):
        assert codes(RacelineTable(columns))["size"].severity == WARNING


@pytest.mark.parametrize("scale", [100.0, 1000.0])
@pytest.mark.parametrize("without", [("speed",), ("d_left", "d_right"), ()])
def test_a_track_that_is_certainly_in_another_unit_is_refused(scale, without):
    """In centimeters, a lap lasts minutes without a bend, or the track is as wide as a field."""
    lengths = ("x", "y", "d_left", "d_right")
    columns = {key: GOOD[key] * (scale if key in lengths else 1.0) for key in (*lengths, "speed")}
    for key in without:
        del columns[key]
    found = codes(RacelineTable(columns))["unit"]
    assert found.severity == ERROR and "in mm or cm? Name it, as in x [mm]" in found.text


@pytest.mark.parametrize("scale, said", [(1.0, False), (10.0, False), (30.0, True)])
def test_a_track_wider_than_any_is_doubted(scale, said):
    """Shorter than two kilometers, without speeds: a small hall in centimeters."""
    lengths = ("x", "y", "d_left", "d_right")
    found = codes(RacelineTable({key: scale * GOOD[key] for key in lengths}))
    assert ("size" in found) == said


def test_a_long_track_too_narrow_for_full_size_cars_is_doubted():
    """A centerline in centimeters whose widths are in meters."""
    points = {key: 100.0 * GOOD[key] for key in ("x", "y")}
    walls = {key: GOOD[key] for key in ("d_left", "d_right")}
    assert "size" in codes(RacelineTable({**points, **walls}))
    assert codes(RacelineTable({**points, **{key: 5.0 * walls[key] for key in walls}})) == {}


def test_a_track_smaller_than_a_car_is_refused():
    tiny = codes(RacelineTable({key: 0.001 * GOOD[key] for key in ("x", "y")}))["unit"]
    assert tiny.severity == ERROR and "shorter than a car" in tiny.text


@pytest.mark.parametrize("speed, size", [(0.5, 1.0), (1.5, 10.0), (15.0, 100.0)])
def test_slow_laps_in_meters_are_driven(speed, size):
    """At walking pace around a hall or a parking lot, or at the speed of a full-size car."""
    columns = {key: size * GOOD[key] for key in ("x", "y")}
    assert "unit" not in codes(RacelineTable({**columns, "speed": speed + 0.0 * GOOD["speed"]}))


@pytest.mark.parametrize(
    ("scale", "speeds", "said"),
    [
        (30.0, 1.0, True),  # positions in pixels
        (1.0, 1.0, False),
        (1.0, 0.5, False),  # driven at half speed
        (30.0, 6.0, False),  # a full-size car
        (30.0, 0.4, False),  # at walking pace
        (30.0, 0.0, False),  # constant speed, as when mapping a large hall
    ],
)
def test_speeds_that_need_no_grip_tell_another_unit(scale, speeds, said):
    speed = speeds * GOOD["speed"] if speeds else np.full(N, 3.0)
    columns = {"x": scale * GOOD["x"], "y": scale * GOOD["y"], "speed": speed}
    assert ("size" in codes(RacelineTable(columns))) == said
