"""Every format is written and read back: the track stays unchanged."""

import gzip
import json
import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.angles import wrap
from map_racing.bags import encoding
from map_racing.bags import messages as msg
from map_racing.bags.writer import BagWriter
from map_racing.errors import BagError, FileFormatError, ParameterError, RacelineError
from map_racing.track.files.checks import raceline_of
from map_racing.track.files.formats import FORMATS, choose_format
from map_racing.track.files.load import load_raceline, read_raceline, save_raceline
from map_racing.track.files.repair import driven_columns, repaired
from map_racing.track.files.table import RacelineTable
from map_racing.track.files.waypoints import waypoint_rows
from map_racing.track.files.writers import raceline_columns
from map_racing.track.findings import NOTE
from map_racing.track.raceline import Raceline

SUFFIX = {"race_stack": ".json", "bag": ".bag"}
HAS = {  # which columns survive
    "map_racing": ("speed", "d_left", "d_right"),
    "tum": ("speed",),
    "racetracks": ("speed",),
    "centerline": ("d_left", "d_right"),
    "race_stack": ("speed", "d_left", "d_right"),
    "bag": ("speed", "d_left", "d_right"),
}


def smooth(rng, t, low, high, waves=3):
    """A random smooth periodic function between two values."""
    k = np.arange(1, waves + 1)[:, None]
    size, shift = rng.normal(size=k.shape) / k, rng.uniform(0.0, 6.3, k.shape)
    total = np.sum(size * np.cos(k * t + shift), axis=0)
    part = (total - total.min()) / np.ptp(total)
    return low + (high - low) * part


def random_track(seed, count=150, size=8.0, origin=(0.0, 0.0), clockwise=False):
    """Uneven points of a random smooth closed curve, with speeds and walls."""
    rng = np.random.RandomState(seed)
    t = (np.arange(count) + rng.uniform(-0.3, 0.3, count)) * 2.0 * math.pi / count
    r = size * smooth(rng, t, 0.7, 1.3)
    t = -t if clockwise else t
    return RacelineTable(
        {
            "x": origin[0] + r * np.cos(t),
            "y": origin[1] + r * np.sin(t),
            "speed": smooth(rng, t, 1.0, 9.0),
            "d_left": smooth(rng, t, 0.3, 2.0),
            "d_right": smooth(rng, t, 0.3, 2.0),
        },
        "random",
    )


def same(read, track, columns=(), atol=1e-6):
    """The table equals the track, at its points and along the curve."""
    driven = driven_columns(read)
    assert driven.columns["x"].size == track.columns["x"].size
    for key in ("x", "y", *columns):
        np.testing.assert_allclose(driven.columns[key], track.columns[key], rtol=0.0, atol=atol)
    lines = [raceline_of(RacelineTable({k: t.columns[k] for k in "xy"})) for t in (driven, track)]
    at = [line.sample(np.linspace(0.0, 1.0, 97) * line.length) for line in lines]
    np.testing.assert_allclose(at[0].x, at[1].x, rtol=0.0, atol=atol)
    np.testing.assert_allclose(at[0].y, at[1].y, rtol=0.0, atol=atol)


@pytest.mark.rest_once
@pytest.mark.parametrize("form", FORMATS)
@settings(max_examples=6, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(40, 300),
    size=st.floats(2.0, 60.0),
    x=st.floats(-1e4, 1e4),
    y=st.floats(-1e4, 1e4),
    clockwise=st.booleans(),
)
def test_round_trips(tmp_path_factory, form, seed, count, size, x, y, clockwise):
    track = random_track(seed, count, size, (x, y), clockwise)
    path = tmp_path_factory.getbasetemp() / f"round_trip_{form}{SUFFIX.get(form, '.csv')}"
    raceline = raceline_of(track)
    save_raceline(raceline, path, form, track)
    read = read_raceline(path)
    same(read, track, HAS[form])
    # Its statements about the curve are true, so none of them is reported.
    codes = {f.code for f in load_raceline(path).findings}
    assert not codes & {"heading", "heading-point", "curvature", "arc-length", "acceleration"}
    # A second round trip changes nothing more.
    again = driven_columns(read)
    save_raceline(raceline_of(again), path, form, again)
    same(read_raceline(path), again, HAS[form], atol=1e-12 if form in SUFFIX else 1e-6)


# -- readers of layouts that are not written -----------------------------------------------------

TRACK = random_track(7)
LINE = raceline_of(TRACK)
AT = raceline_columns(LINE, TRACK)
ROWS = {
    "s": AT.s,
    "x": AT.x,
    "y": AT.y,
    "north": AT.psi - 0.5 * math.pi,
    "psi": AT.psi,
    "kappa": AT.kappa,
    "v": AT.speed,
    "a": AT.a_x,
    "right": AT.d_right,
    "left": AT.d_left,
    "z": 0.1 * np.sin(AT.s),
    "total": AT.d_left + AT.d_right,
}
TUM = ("s", "x", "y", "north", "kappa", "v", "a")
TUM_HEADER = "# id\n# hash\n# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2"
GYM_HEADER = "#x_m ; y_m ; vx_mps ; psi_rad ; kappa_radpm"


def text(names, header="", separator=",", closed=False):
    table = np.stack([ROWS[name] for name in names], axis=1)
    table = np.concatenate((table, table[:1])) if closed else table
    rows = [separator.join(f"{value:.9f}" for value in row) for row in table]
    return "\n".join(([header] if header else []) + rows) + "\n"


@pytest.mark.parametrize(
    "content, columns",
    [
        (text(TUM), ("speed",)),
        (text((*TUM, "z")), ("speed",)),
        (text((*TUM, "right", "left"), separator="\t"), ("speed", "d_left", "d_right")),
        (text((*TUM, "right", "left", "z"), separator="; "), ("speed", "d_left", "d_right")),
        (text(TUM, TUM_HEADER, "; ", closed=True), ("speed",)),
        (text(("x", "y", "v", "psi", "kappa"), GYM_HEADER, " ; "), ("speed",)),
        (text(("x", "y", "right", "left", "z")), ("d_left", "d_right")),
        (text(("x", "y", "z", "right", "left")), ("d_left", "d_right")),
        (
            text(("x", "y", "right", "left", "z"), "# x_m,y_m,w_tr_right_m,w_tr_left_m,z_m"),
            ("d_left", "d_right"),
        ),
        (text(("x", "y"), separator=" "), ()),
        (text(("x", "y", "z")), ()),
        (text(("x", "y"), "x,y,").replace("\n", ",\n").replace("x,y,,", "x,y,"), ()),
        (text(("x", "y", "v"), "x;y;v", ";").replace(".", ","), ("speed",)),
        (text(("x", "y"), separator="\t").replace(".", ","), ()),
        ("\ufeff" + text(("y", "x", "v"), "Y_m,X_m,Velocity").replace("\n", "\r\n"), ("speed",)),
        (text(("x", "y", "v")) + "# a remark\n\n", ("speed",)),
    ],
)
@pytest.mark.parametrize("packed", [False, True])
def test_layouts(tmp_path, content, columns, packed):
    path = tmp_path / ("c.csv.gz" if packed else "c.csv")
    data = content.encode()
    path.write_bytes(gzip.compress(data) if packed else data)
    read = read_raceline(path)
    # Speeds unrelated to bends are not recognized as speeds unless named.
    if columns == ("speed",) and "width" in read.columns:
        read = read_raceline(f"{path}#x,y,speed")
    same(read, TRACK, columns)


def test_three_unnamed_columns_are_told_apart_by_their_numbers(tmp_path):
    path = tmp_path / "c.csv"
    slow = 6.0 - 4.0 * np.abs(LINE.sample(LINE.s_points).kappa) / np.max(np.abs(LINE.kappa))
    for third, key in ((slow, "speed"), (ROWS["total"], "width"), (0.0 * slow + 2.0, "width")):
        np.savetxt(str(path), np.stack((AT.x, AT.y, third), axis=1))
        read = read_raceline(path)
        assert np.array_equal(np.round(read.columns[key], 9), np.round(third, 9))
        assert [finding.code for finding in read.findings] == ["unnamed-columns"]
        assert f"Taken as x,y,{key}" in read.findings[0].text
        # With given columns, nothing is guessed.
        for name, meaning in (("v", "speed"), ("width", "width"), ("-", None)):
            told = read_raceline(f"{path}#x,y,{name}")
            assert set(told.columns) == {"x", "y", meaning} - {None} and told.findings == ()


def test_three_columns_of_real_racelines_and_centerlines(shared_data, tmp_path):
    lines = {
        "tracks/hangar/global_waypoints.json.gz": ("speed", "width"),
        "tracks/hangar/global_waypoints.json.gz#centerline_waypoints": ("width",),
        "laps/ipz20/IPZ20_wp.csv": ("speed", "width"),
        "laps/ipz20/centerline.csv": ("width",),
        "recordings/hangar_global_waypoints.bag": ("speed", "width"),
        "tracks/Spielberg/Spielberg_raceline.csv": ("speed",),
        "tracks/Spielberg/Spielberg_centerline.csv": ("width",),
        "tracks/Monza/Monza_raceline.csv": ("speed",),
        "tracks/Austin/Austin_raceline.csv": ("speed",),
        "tracks/Oschersleben/Oschersleben_raceline.csv": ("speed",),
    }
    for source, meanings in lines.items():
        line = load_raceline(f"{shared_data}/{source}")
        at = line.sample(line.s_points)
        for meaning in meanings:
            third = at.speed if meaning == "speed" else at.d_left + at.d_right
            np.savetxt(str(tmp_path / "c.csv"), np.stack((at.x, at.y, third), axis=1))
            assert meaning in read_raceline(tmp_path / "c.csv").columns, source


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("named", [False, True])
def test_reference_lines_with_shifts(tmp_path, side, closed, named):
    """On a ring, the walls of the shifted line are at the known distances along its own normals."""
    radius, inner, outer = 6.0, 5.0, 7.5
    t = np.arange(300) * 2.0 * math.pi / 300
    ref = np.stack((radius * np.cos(t), radius * np.sin(t)), axis=1)
    normal = side * np.stack((np.cos(t), np.sin(t)), axis=1)  # to the right for side 1
    alpha = 0.4 * np.sin(2.0 * t)
    right, left = np.full(300, outer - radius), np.full(300, radius - inner)
    track = ref + alpha[:, None] * normal
    line = Raceline(track[:, 0], track[:, 1], vx_mps=3.0 + np.cos(t))
    at = line.sample(line.s_points)
    columns = [*ref.T, right, left, *normal.T, alpha]
    columns += [at.s, at.psi - 0.5 * math.pi, at.kappa, at.speed, 0.0 * t]
    table = np.stack(columns, axis=1)
    table = np.concatenate((table, table[:1])) if closed else table
    header = (
        "x_ref_m; y_ref_m; width_right_m; width_left_m; x_normvec_m; y_normvec_m; alpha_m; "
        "s_racetraj_m; psi_racetraj_rad; kappa_racetraj_radpm; vx_racetraj_mps; ax_racetraj_mps2"
    )
    path = tmp_path / "ltpl.csv"
    np.savetxt(str(path), table, fmt="%.7f", delimiter="; ", header=header if named else "id")
    read = load_raceline(path)
    assert read.length == pytest.approx(line.length, abs=1e-5)
    found = {finding.code for finding in read.findings} - {"closing-point", "acceleration"}
    assert found == {"reference-line", "heading-north"}
    for s in np.arange(0.0, read.length, 0.5):
        left, right = read.widths_at(s)
        assert math.hypot(*read.to_cartesian(s, left)) == pytest.approx(inner, abs=2e-3)
        assert math.hypot(*read.to_cartesian(s, -right)) == pytest.approx(outer, abs=2e-3)
    # The widths of the reference line would be off by the shift.
    assert np.max(np.abs(read.d_left - 1.0)) > 0.35


def encode_path(seq, stamp_ns, poses, oriented=True, frames=("map",)):
    body = []
    for number, (x, y, psi) in enumerate(poses):
        half = 0.5 * psi if oriented else 0.0
        body.append(encoding._header(number, 0, frames[number % len(frames)]))
        body.append(struct.pack("<7d", x, y, 0.3, 0.0, 0.0, math.sin(half), math.cos(half)))
    return b"".join([encoding._header(seq, stamp_ns, "map"), struct.pack("<I", len(poses)), *body])


POSES = np.stack((AT.x, AT.y, AT.psi), axis=1)


@pytest.mark.parametrize("oriented", [False, True])
def test_paths_in_bags(tmp_path, oriented):
    path = tmp_path / "paths.bag"
    with BagWriter(path) as bag:
        for k, (topic, poses) in enumerate(
            [("/local_plan", POSES), ("/path", POSES[:3]), ("/path", POSES), ("/path", POSES[:20])]
        ):
            values = (poses, oriented, ("map", "", "a_longer_frame"))
            bag._write(topic, msg.PATH, 1.0 + k, None, encode_path, values)
    read = read_raceline(path)
    assert read.layout == "Path on /path"
    same(read, TRACK)
    found = [finding.code for finding in load_raceline(path).findings]
    assert found == (["heading-x"] if oriented else [])
    same(read_raceline(f"{path}#local_plan"), TRACK)
    with pytest.raises(BagError, match="no raceline"):
        read_raceline(f"{path}#/nowhere")


def test_waypoints_come_before_paths(tmp_path):
    with BagWriter(tmp_path / "a.bag") as bag:
        bag._write("/global_path", msg.PATH, 1.0, None, encode_path, (POSES,))
        bag.waypoints(1.0, waypoint_rows(LINE))
    assert read_raceline(tmp_path / "a.bag").layout == "WpntArray on /global_waypoints"
    assert read_raceline(f"{tmp_path / 'a.bag'}#/global_path").layout == "Path on /global_path"


def test_a_path_cut_short_is_told(tmp_path):
    whole = encode_path(0, 10**9, POSES)
    with pytest.raises(struct.error):
        msg.decode_path(whole[: len(whole) // 2])
    with BagWriter(tmp_path / "a.bag") as bag:
        bag._write("/p", msg.PATH, 1.0, None, lambda *values: whole[:-900], ())
    with pytest.raises(BagError, match="cannot decode nav_msgs/Path"):
        read_raceline(tmp_path / "a.bag")


# -- what is written -----------------------------------------------------------------------------


def test_the_raceline_of_the_tum_tools(tmp_path):
    save_raceline(LINE, tmp_path / "c.csv", "tum", TRACK)
    lines = (tmp_path / "c.csv").read_text().splitlines()
    assert [line[:2] for line in lines[:3]] == ["# "] * 3
    assert lines[2] == "# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2"
    assert lines[3].count("; ") == 6
    table = np.loadtxt(str(tmp_path / "c.csv"), delimiter=";")
    assert np.array_equal(table[0, 1:], table[-1, 1:])
    assert table[-1, 0] == pytest.approx(LINE.length, abs=1e-6)
    # Counter-clockwise from +y: a track along +y has heading 0.
    heading = np.arctan2(-np.sin(table[:, 3]), np.cos(table[:, 3]))
    ahead = np.stack((np.sin(heading), np.cos(heading)), axis=1)[:-1]
    chords = np.diff(table[:, 1:3], axis=0)
    assert np.all(np.sum(ahead * chords, axis=1) > 0.9 * np.hypot(*chords.T))
    assert np.abs(table[:, 3]).max() <= math.pi
    v, a, s = table[:, 5], table[:, 6], table[:, 0]
    np.testing.assert_allclose(v[1:] ** 2, v[:-1] ** 2 + 2.0 * a[:-1] * np.diff(s), atol=1e-5)


def test_the_raceline_of_f1tenth_racetracks(tmp_path):
    save_raceline(LINE, tmp_path / "c.csv", "racetracks", TRACK)
    content = (tmp_path / "c.csv").read_text()
    assert "; " not in content.split("ax_mps2\n")[1]
    table = np.loadtxt(str(tmp_path / "c.csv"), delimiter=";")
    assert table[:, 3].min() >= 0.0 and table[:, 3].max() < 2.0 * math.pi
    assert np.array_equal(table[0, 1:], table[-1, 1:])
    chords = np.diff(table[:, 1:3], axis=0)
    ahead = np.stack((np.cos(table[:-1, 3]), np.sin(table[:-1, 3])), axis=1)
    assert np.all(np.sum(ahead * chords, axis=1) > 0.9 * np.hypot(*chords.T))


def test_the_centerline(tmp_path):
    save_raceline(LINE, tmp_path / "c.csv", "centerline", TRACK)
    lines = (tmp_path / "c.csv").read_text().splitlines()
    assert lines[0] == "# x_m,y_m,w_tr_right_m,w_tr_left_m"
    assert lines[1] != lines[-1] and len(lines) == 1 + AT.x.size
    table = np.loadtxt(str(tmp_path / "c.csv"), delimiter=",")
    np.testing.assert_allclose(table, np.stack((AT.x, AT.y, AT.d_right, AT.d_left), 1), atol=1e-7)


WPNT = ["id", "s_m", "d_m", "x_m", "y_m", "d_right", "d_left"]
WPNT += ["psi_rad", "kappa_radpm", "vx_mps", "ax_mps2"]


def keys_of(value):
    """The keys of nested dictionaries and of the first elements of lists."""
    if isinstance(value, dict):
        return {key: keys_of(inner) for key, inner in value.items()}
    if isinstance(value, list):
        return [keys_of(inner) for inner in value[:1]]
    return None


def test_race_stack_has_the_keys_of_a_real_file(shared_data, tmp_path):
    packed = (shared_data / "tracks" / "circle" / "global_waypoints.json.gz").read_bytes()
    real = json.loads(gzip.decompress(packed).decode())
    save_raceline(LINE, tmp_path / "c.json", "race_stack", TRACK)
    written = json.loads((tmp_path / "c.json").read_text())
    assert keys_of(written) == keys_of(real)
    kinds = {"int": int, "float": float}
    for key in ("global_traj_wpnts_iqp", "centerline_waypoints"):
        for field, value in real[key]["wpnts"][0].items():
            assert type(written[key]["wpnts"][0][field]) is kinds[type(value).__name__], field


def test_race_stack(tmp_path):
    save_raceline(LINE, tmp_path / "c.json", "race_stack", TRACK)
    content = json.loads((tmp_path / "c.json").read_text())
    wpnts = content["global_traj_wpnts_iqp"]["wpnts"]
    assert list(wpnts[0]) == WPNT
    assert [wpnt["id"] for wpnt in wpnts] == list(range(AT.x.size + 1))
    # Its readers treat the last point as the first, and its s as the length.
    assert wpnts[-1]["s_m"] == LINE.length and wpnts[-1]["x_m"] == wpnts[0]["x_m"]
    ds = np.diff(np.append(AT.s, LINE.length))
    time = np.sum(2.0 * ds / (AT.speed + np.roll(AT.speed, -1)))
    assert content["est_lap_time"]["data"] == pytest.approx(time)
    assert f"IQP estimated lap time: {time:.4f}s" in content["map_info_str"]["data"]
    assert content["global_traj_wpnts_sp"] == content["global_traj_wpnts_iqp"]
    assert len(content["trackbounds_markers"]["markers"]) == 2 * AT.x.size
    # The line in the middle has the same walls.
    middle = load_raceline(f"{tmp_path / 'c.json'}#centerline_waypoints")
    np.testing.assert_allclose(middle.d_left, middle.d_right, atol=1e-9)
    mean = np.mean(AT.d_left + AT.d_right)
    assert np.mean(middle.d_left + middle.d_right) == pytest.approx(mean, rel=0.05)


def test_what_a_format_needs(tmp_path):
    table = RacelineTable({"x": AT.x, "y": AT.y})
    bare = raceline_of(table)
    for form in ("tum", "racetracks"):
        with pytest.raises(
            RacelineError, match=f"c.csv: expected a raceline with speeds .* {form}"
        ):
            save_raceline(bare, tmp_path / "c.csv", form, table)
    with pytest.raises(RacelineError, match="expected a raceline with walls"):
        save_raceline(bare, tmp_path / "c.csv", "centerline", table)
    assert list(tmp_path.iterdir()) == []
    for name, form in (("c.json", "race_stack"), ("c.bag", "bag")):
        save_raceline(bare, tmp_path / name, form, table)
        same(read_raceline(tmp_path / name), TRACK)
        line = load_raceline(tmp_path / name)
        assert line.speed is None and line.d_left is None


def test_the_format_follows_from_the_name_or_is_asked_for():
    assert choose_format("a.json") == "race_stack"
    assert choose_format("a.BAG") == "bag"
    assert choose_format("a.txt", "tum") == "tum"
    for name, form, message in (
        ("a.csv", None, "expected --format for a .csv file: map_racing, tum, racetracks"),
        ("a.yaml", None, r"expected a file named .csv, .json or .bag"),
        ("a.csv", "race_stack", "expected a file named .json for format race_stack"),
        ("a.csv", "bag", "expected a file named .bag for format bag"),
        ("a.json", "tum", "expected a file named .csv for format tum"),
        ("a.csv", "gpx", "format gpx: expected one of map_racing, tum"),
    ):
        with pytest.raises(ParameterError, match=message):
            choose_format(name, form)


# -- wrong files ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "key, message",
    [
        ("x,y", "expected 3 names of columns, got 2"),
        ("a,b,c", "expected JSON with the key a,b,c, or columns with x and y"),
        ("x,y,x", "expected each column once, got x twice"),
    ],
)
def test_wrong_names_of_columns(tmp_path, key, message):
    (tmp_path / "c.csv").write_text(text(("x", "y", "v")))
    with pytest.raises(FileFormatError, match=message):
        read_raceline(f"{tmp_path / 'c.csv'}#{key}")


def test_garbage_in_the_middle_of_a_file(tmp_path):
    lines = text(("x", "y")).splitlines()
    for line, message in (
        ("oops", ":10: expected 2 columns, got 1"),
        ("1.0,oops", r":10: column 2: expected a number, got 'oops'"),
        ("1.0;2.0", ":10: expected 2 columns, got 1"),
        ("0x10,2", r":10: column 1: expected a number, got '0x10'"),
    ):
        (tmp_path / "c.csv").write_text("\n".join([*lines[:9], line, *lines[9:]]))
        with pytest.raises(FileFormatError, match=message):
            read_raceline(tmp_path / "c.csv")


def test_a_large_file(tmp_path):
    """50,000 rows are read, each with its line number."""
    count = 50000
    t = np.arange(count) * 2.0 * math.pi / count
    rows = [f"{x:.4f},{y:.4f}" for x, y in zip(700.0 * np.cos(t), 700.0 * np.sin(t))]
    (tmp_path / "c.csv").write_text("\n".join(rows))
    read = read_raceline(tmp_path / "c.csv")
    assert read.columns["x"].size == count and read.lines[-1] == count
    assert raceline_of(read).length == pytest.approx(2.0 * math.pi * 700.0, rel=1e-6)


# -- real files ----------------------------------------------------------------------------------

MAPS = ("Spielberg", "Monza", "Austin", "Oschersleben")
REAL = {
    **{f"tracks/{m}/{m}_raceline.csv": ("heading-x", 1) for m in MAPS},
    **{f"tracks/{m}/{m}_centerline.csv": (None, 0) for m in MAPS},
    "laps/ipz20/IPZ20_wp.csv": ("heading-north", 1),
    "laps/ipz20/IPZ20_wp_reverse.csv": ("heading-north", 1),
    "laps/ipz20/centerline.csv": (None, 0),
    "recordings/hangar_global_waypoints.bag": ("heading-x", 1),
    "recordings/hangar_global_waypoints.bag#/centerline_waypoints": ("heading-x", 0),
    "tracks/hangar/global_waypoints.json.gz": ("heading-x", 1),
    "tracks/hangar/global_waypoints.json.gz#centerline_waypoints": ("heading-x", 0),
    "tracks/circle/global_waypoints.json.gz": ("heading-x", 1),
    "tracks/circle/global_waypoints.json.gz#global_traj_wpnts_sp": ("heading-x", 1),
}
OTHER_CIRCUITS = tuple(f"tracks/{name}/" for name in MAPS[1:])


@pytest.mark.rest_once
@pytest.mark.parametrize("source", REAL)
def test_real_files_are_read_right(shared_data, tmp_path, source):
    """Nothing is wrong with them, and their values agree with recomputed ones."""
    heading, closed = REAL[source]
    table = read_raceline(f"{shared_data}/{source}")
    line = raceline_of(table)
    assert {finding.severity for finding in line.findings} <= {NOTE}
    codes = [finding.code for finding in line.findings]
    assert [code for code in codes if code.startswith("heading")] == [heading] * bool(heading)
    assert codes.count("closing-point") == closed
    rows = slice(0, line.s_points.size)
    at = line.sample(line.s_points)
    if "kappa" in table.columns and closed:  # centerlines have the curvature of smoothed lines
        assert np.max(np.abs(table.columns["kappa"][rows] - at.kappa)) < 0.05
    if "s" in table.columns:
        np.testing.assert_allclose(table.columns["s"][rows], line.s_points, atol=0.02 * line.length)
    if "psi" in table.columns:
        zero = 0.0 if heading == "heading-x" else 0.5 * math.pi
        off = np.abs(wrap(table.columns["psi"][rows] + zero - at.psi))
        assert np.percentile(off, 95) < 0.02
    # They survive every format that can store them; all circuits behave the same.
    track = driven_columns(table)
    for form in () if source.startswith(OTHER_CIRCUITS) else FORMATS:
        if line.speed is None and form in ("tum", "racetracks"):
            continue
        if line.d_left is None and form == "centerline":
            continue
        path = tmp_path / f"c{SUFFIX.get(form, '.csv')}"
        save_raceline(line, path, form, track)
        kept = [key for key in HAS[form] if key in track.columns]
        same(read_raceline(path), track, kept)


@pytest.mark.parametrize("side, other", [("right", "left"), ("left", "right")])
def test_offsets_of_the_walls_to_one_side_are_distances(tmp_path, side, other):
    """With the same sign all around: kept in everything made from the file, also by a repair."""
    a = np.arange(200) * 2.0 * np.pi / 200
    walls = {"left": 1.3 + 0.0 * a, "right": 0.9 + 0.0 * a}
    walls[side] = -walls[side]
    rows = zip(9.0 * np.cos(a), 6.0 * np.sin(a), walls["left"], walls["right"])
    text = "".join(",".join(f"{value:.6f}" for value in row) + "\n" for row in rows)
    path = tmp_path / "line.csv"
    path.write_text("x_m,y_m,d_left,d_right\n" + text)
    line = load_raceline(path)
    assert (np.median(line.d_left), np.median(line.d_right)) == pytest.approx((1.3, 0.9))
    (said,) = [finding for finding in line.findings if finding.severity == "warning"]
    assert said.code == "signed-walls" and f"as an offset to the {other}" in said.text
    table, repairs = repaired(read_raceline(path))
    assert repairs == [] and np.median(table.columns["d_right"]) == pytest.approx(0.9)
    assert np.min(driven_columns(read_raceline(path)).columns[f"d_{side}"]) > 0.0
