"""Raceline files: every layout, every convention, and every fault."""

import gzip
import json
import math

import numpy as np
import pytest

from map_racing.errors import FileFormatError, MapRacingError, ParameterError, RacelineError
from map_racing.track.files.load import load_raceline, save_raceline
from map_racing.track.files.readers import (
    raceline_from_columns,
    read_raceline_file,
)
from map_racing.track.raceline import Raceline

# A counter-clockwise ellipse, with everything that a file may contain.
T = np.arange(120) * 2.0 * math.pi / 120
TRACK = Raceline(
    6.0 * np.cos(T),
    4.0 * np.sin(T),
    vx_mps=4.0 + np.cos(T),
    d_left_m=1.0 + 0.1 * np.cos(T),
    d_right_m=1.5 + 0.1 * np.sin(T),
    name="ellipse",
)
COLUMNS = {
    "s_m": TRACK.s,
    "x_m": TRACK.x,
    "y_m": TRACK.y,
    "psi_rad": TRACK.psi,
    "kappa_radpm": TRACK.kappa,
    "vx_mps": TRACK.speed,
    "ax_mps2": 0.0 * TRACK.s,
    "d_right": TRACK.d_right,
    "d_left": TRACK.d_left,
}
TUM = ["s_m", "x_m", "y_m", "psi_rad", "kappa_radpm", "vx_mps", "ax_mps2"]


def write(path, names, header=None, separator=",", closed=False, **changed):
    """A CSV file with columns of the ellipse; returns its path."""
    table = np.stack([changed.get(name, COLUMNS.get(name)) for name in names], axis=1)
    if closed:
        table = np.concatenate((table, table[:1]))
    rows = [separator.join(f"{value:.9f}" for value in row) for row in table]
    path.write_text("\n".join(([] if header is None else [header]) + rows) + "\n")
    return path


def assert_same_curve(track, other=TRACK, atol=1e-5):
    assert track.length == pytest.approx(other.length, abs=atol)
    at, expected = (curve.sample(np.linspace(0.0, 20.0, 99)) for curve in (track, other))
    np.testing.assert_allclose(at.x, expected.x, atol=atol)
    np.testing.assert_allclose(at.y, expected.y, atol=atol)
    return at, expected


# -- layouts -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "names, header, separator",
    [
        (TUM, "# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2", "; "),
        (TUM, "# uuid\n# hash\n# s_m; x_m; y_m; psi_rad; kappa_radpm; vx_mps; ax_mps2", ";"),
        (TUM, None, ","),
        (TUM, "# no names at all", "\t"),
        (
            ["x_m", "y_m", "vx_mps", "psi_rad", "kappa_radpm"],
            "#x_m ; y_m ; vx_mps ; psi_rad ; kappa_radpm",
            ";",
        ),
        ([*TUM, "d_right", "d_left"], ",".join([*TUM, "d_right_iqp", "d_left_iqp"]), ","),
        ([*TUM, "d_right", "d_left"], None, "  "),
        (["vx_mps", "y_m", "x_m", "ax_mps2"], "V,Y,X,unknown", ","),
    ],
)
def test_racelines(tmp_path, names, header, separator):
    track = load_raceline(write(tmp_path / "ellipse.csv", names, header, separator))
    at, expected = assert_same_curve(track)
    np.testing.assert_allclose(at.speed, expected.speed, atol=1e-4)
    if "d_left" in names:
        np.testing.assert_allclose(at.d_left, expected.d_left, atol=1e-4)
        np.testing.assert_allclose(at.d_right, expected.d_right, atol=1e-4)
    assert track.name == "ellipse"
    assert track.source == str(tmp_path / "ellipse.csv")


@pytest.mark.parametrize(
    "header", [None, "# x_m,y_m,w_tr_right_m,w_tr_left_m", "x_m,y_m,w_tr_right_m,w_tr_left_m"]
)
def test_centerline_with_walls(tmp_path, header):
    path = write(tmp_path / "center.csv", ["x_m", "y_m", "d_right", "d_left"], header)
    track = load_raceline(path)
    at, expected = assert_same_curve(track)
    np.testing.assert_allclose(at.d_left, expected.d_left, atol=1e-4)
    assert track.speed is None
    # Without names, the meaning is a good guess.
    assert [finding.code for finding in track.findings] == ["unnamed-columns"][: header is None]


def test_five_columns_end_with_the_height(tmp_path):
    path = write(tmp_path / "c.csv", ["x_m", "y_m", "d_right", "d_left", "ax_mps2"])
    np.testing.assert_allclose(load_raceline(path).d_left, TRACK.d_left, atol=1e-4)


def test_three_columns_are_the_total_width(tmp_path):
    track = load_raceline(write(tmp_path / "c.csv", ["x_m", "y_m", "d_right"]))
    np.testing.assert_allclose(track.d_left, 0.5 * TRACK.d_right, atol=1e-4)
    np.testing.assert_allclose(track.d_right, 0.5 * TRACK.d_right, atol=1e-4)
    assert [finding.code for finding in track.findings] == ["unnamed-columns", "total-width"]


def test_two_columns_and_windows_line_ends(tmp_path):
    path = write(tmp_path / "c.txt", ["x_m", "y_m"])
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes().replace(b"\n", b"\r\n") + b"\r\n;;\r\n")
    track = load_raceline(path)
    assert_same_curve(track)
    assert track.name == "c"


def test_gzip(tmp_path):
    path = write(tmp_path / "c.csv", ["x_m", "y_m"])
    (tmp_path / "c.csv.gz").write_bytes(gzip.compress(path.read_bytes()))
    track = load_raceline(tmp_path / "c.csv.gz")
    assert_same_curve(track)
    assert track.name == "c"


def waypoints(speed=None):
    names = ["s_m", "x_m", "y_m", "d_right", "d_left", "psi_rad", "kappa_radpm", "vx_mps"]
    columns = dict(COLUMNS, vx_mps=TRACK.speed if speed is None else speed)
    rows = zip(*(columns[name].tolist() for name in names))
    return {"wpnts": [dict(zip(names, row), id=k, d_m=0.0) for k, row in enumerate(rows)]}


def test_race_stack_json(tmp_path):
    content = {
        "map_info_str": {"data": "a hall"},
        "global_traj_wpnts_iqp": waypoints(),
        "centerline_waypoints": waypoints(0.0 * TRACK.s),
    }
    path = tmp_path / "global_waypoints.json.gz"
    path.write_bytes(gzip.compress(json.dumps(content).encode()))
    at, expected = assert_same_curve(load_raceline(path))
    np.testing.assert_allclose(at.speed, expected.speed, atol=1e-4)
    track = load_raceline(f"{path}#centerline_waypoints")
    assert track.speed is None
    assert "every speed is 0: taken as not given" in map(str, track.findings)
    with pytest.raises(
        FileFormatError,
        match="waypoints under nowhere, got global_traj_wpnts_iqp, centerline_waypoints",
    ):
        load_raceline(f"{path}#nowhere")


# -- findings ------------------------------------------------------------------------------------


def findings(**changed):
    columns = {"x": TRACK.x, "y": TRACK.y, **changed}
    return "\n".join(map(str, raceline_from_columns(columns).findings))


def test_heading_conventions():
    psi = TRACK.psi
    assert "measured from +x; fits" in findings(psi=psi)
    assert "measured from +x; fits" in findings(psi=psi % (2.0 * math.pi))
    assert "measured from +y (north): recomputed" in findings(psi=psi - 0.5 * math.pi)
    assert "against the order of the points" in findings(psi=psi + math.pi)
    assert "does not fit the points: recomputed" in findings(psi=psi + 0.8)
    assert "does not fit the points: recomputed" in findings(psi=0.0 * psi)


def test_curvature_conventions():
    assert findings(kappa=TRACK.kappa) == ""
    assert "positive to the right" in findings(kappa=-TRACK.kappa)
    assert "curvature does not fit" in findings(kappa=3.0 * TRACK.kappa)


def test_arc_length_is_compared():
    assert findings(s=TRACK.s + 17.0) == ""
    assert "arc length is up to" in findings(s=1.1 * TRACK.s)


def test_closure_and_repetitions(tmp_path):
    track = load_raceline(write(tmp_path / "c.csv", TUM, closed=True))
    assert str(track.findings[0]) == "the last point repeats the first: dropped"
    assert_same_curve(track)
    repeated = np.repeat(np.arange(TRACK.n), np.arange(TRACK.n) % 50 // 49 + 1)
    assert "6 repeated points dropped" in findings(x=TRACK.x[repeated], y=TRACK.y[repeated])
    gap = slice(0, TRACK.n - 9)
    assert "closed over a gap of 0.99 m, 10 times" in findings(x=TRACK.x[gap], y=TRACK.y[gap])


def test_walls_crossed_are_counted():
    left = np.where(TRACK.x > 5.0, -0.1, 1.0)
    text = findings(d_left=left, d_right=1.0 + 0.0 * left)
    assert f"{np.sum(TRACK.x > 5.0)} points beyond the left wall" in text


# -- what is wrong in a file ---------------------------------------------------------------------


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "got no line of numbers"),
        ("# x_m,y_m\n", "got no line of numbers"),
        ("hello\nworld\n", "got no line of numbers"),
        ("image: hall.png\nresolution: 0.05\n", "got a map; map-racing raceline optimize makes"),
        (
            "1,2,3,4,5,6\n",
            "1: expected names of the 6 columns",
        ),
        ("time,speed\n1,2\n", r"1: expected names of columns with x_m and y_m"),
        ("x_m,y_m\n1,2,3\n", "1: expected 3 names of columns, got 2"),
        ("x_m,y_m,x\n1,2,3\n", "1: expected each column once, got x twice"),
        ("x_m,y_m\n1,2\n3\n", "3: expected 2 columns, got 1"),
        ("# c\nx_m,y_m\n1,2\n\n3,abc\n", r"5: column 2 \(y_m\): expected a number, got 'abc'"),
        ("x_m,y_m\n1,2\n3,\n", r"3: column 2 \(y_m\): expected a number, got ''"),
        ("x_m,y_m\n1,2\n3,1_0\n", r"3: column 2 \(y_m\): expected a number, got '1_0'"),
        ("{", "invalid JSON"),
        ("[1]", "expected waypoints under global_traj_wpnts_iqp, got none"),
        ('{"global_traj_wpnts_iqp": {"wpnts": [1]}}', "waypoint 0: expected named fields"),
        ('{"global_traj_wpnts_iqp": {"wpnts": []}}', "expected waypoints with x_m and y_m"),
        (
            '{"global_traj_wpnts_iqp": {"wpnts": [{"x_m": 1, "y_m": "2"}]}}',
            "waypoint 0: expected a number as y_m, got '2'",
        ),
        (
            '{"global_traj_wpnts_iqp": {"wpnts": [{"x": 1, "y": 1, "v": 1}, {"x": 1, "y": 2}]}}',
            "expected v of all waypoints, got only some",
        ),
    ],
)
def test_malformed_files(tmp_path, text, message):
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=r"bad\.csv:.*" + message) as caught:
        load_raceline(path)
    assert "\n" not in str(caught.value)


def test_files_that_are_no_text(tmp_path):
    (tmp_path / "binary.csv").write_bytes(b"\xff\x81\x00\xfe" * 9)
    (tmp_path / "broken.csv.gz").write_bytes(gzip.compress(b"1,2\n" * 99)[:20])
    (tmp_path / "bent.csv.gz").write_bytes(gzip.compress(b"1,2\n" * 99)[:10] + b"\xff" * 30)
    for name in ("binary.csv", "broken.csv.gz", "bent.csv.gz", "missing.csv", "."):
        with pytest.raises(FileFormatError, match="cannot read|expected UTF-8"):
            read_raceline_file(tmp_path / name)


def test_an_image_is_called_one(tmp_path):
    """Of a map, in place of its YAML file."""
    for name, data in (
        ("hall.png", b"\x89PNG\r\n\x1a\n\0"),
        ("hall.pgm", b"P5\n2 1\n255\n\xfe\xcd"),
    ):
        (tmp_path / name).write_bytes(data)
        with pytest.raises(FileFormatError, match=name + ": expected UTF-8 text, got an image"):
            load_raceline(tmp_path / name)


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_unicode_text_of_windows_is_read(tmp_path, encoding):
    path = write(tmp_path / "c.csv", ["x_m", "y_m"], separator="\t")
    text = "\ufeff" + path.read_text().replace("\n", "\r\n")
    (tmp_path / "wide.txt").write_bytes(text.encode(encoding))
    (tmp_path / "wide.csv.gz").write_bytes(gzip.compress(text.encode(encoding)))
    for name in ("wide.txt", "wide.csv.gz"):
        assert np.array_equal(load_raceline(tmp_path / name).x, load_raceline(path).x)


def test_other_encodings_are_named(tmp_path):
    path = write(tmp_path / "c.csv", ["x_m", "y_m"])
    (tmp_path / "old.csv").write_bytes(b"# L\xe4nge\n" + path.read_bytes())
    (tmp_path / "bare.csv").write_bytes(path.read_text().encode("utf-16-le"))
    for name in ("old.csv", "bare.csv"):
        with pytest.raises(FileFormatError, match=name + ": expected UTF-8 text"):
            load_raceline(tmp_path / name)


def test_key_for_a_file_without_keys(tmp_path):
    path = write(tmp_path / "c.csv", ["x_m", "y_m"])
    with pytest.raises(FileFormatError, match="expected JSON with the key a"):
        load_raceline(f"{path}#a")


def test_too_few_points_name_the_file(tmp_path):
    path = tmp_path / "short.csv"
    path.write_text("0,0\n1,0\n1,1\n")
    with pytest.raises(RacelineError, match=r"short\.csv: expected at least 4 distinct points"):
        load_raceline(path)


def test_unknown_names_list_the_shipped_ones():
    with pytest.raises(ParameterError, match="club, reference"):
        load_raceline("monaco")


# -- writing -------------------------------------------------------------------------------------


def test_saved_is_read_as_the_same(tmp_path):
    path = tmp_path / "ellipse.csv"
    save_raceline(TRACK, path)
    track = load_raceline(path)
    at, expected = assert_same_curve(track, atol=2e-6)
    for name in ("speed", "d_left", "d_right"):
        np.testing.assert_allclose(getattr(at, name), getattr(expected, name), atol=2e-6)
    np.testing.assert_allclose(at.kappa, expected.kappa, atol=2e-3)
    assert track.n == TRACK.n
    assert [str(finding) for finding in track.findings] == [
        "heading is measured from +x; fits the points within 0.000 rad (95 %)"
    ]
    assert [entry.name for entry in tmp_path.iterdir()] == ["ellipse.csv"]


def test_saved_without_speed_and_walls(tmp_path):
    save_raceline(Raceline(TRACK.x, TRACK.y), tmp_path / "plain.csv")
    track = load_raceline(tmp_path / "plain.csv")
    assert_same_curve(track)
    assert track.speed is None and track.d_left is None


def test_acceleration_in_the_file_is_that_of_the_speeds(tmp_path):
    save_raceline(TRACK, tmp_path / "c.csv")
    table = np.loadtxt(str(tmp_path / "c.csv"), delimiter=";")
    v, a = table[:, 5], table[:, 6]
    np.testing.assert_allclose(np.roll(v, -1) ** 2, v**2 + 2.0 * a * TRACK.ds, atol=2e-5)


def test_writing_where_there_is_no_folder(tmp_path):
    with pytest.raises(MapRacingError, match="cannot write"):
        save_raceline(TRACK, tmp_path / "nowhere" / "c.csv")


# -- real files ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "file, length, heading",
    [
        ("tracks/Spielberg/Spielberg_raceline.csv", 338.13, "+x"),
        ("tracks/Monza/Monza_raceline.csv", 439.17, "+x"),
        ("tracks/Oschersleben/Oschersleben_raceline.csv", 250.29, "+x"),
        ("tracks/Austin/Austin_raceline.csv", 406.53, "+x"),
        ("laps/ipz20/IPZ20_wp.csv", 25.22, "+y (north)"),
        ("laps/ipz20/IPZ20_wp_reverse.csv", 25.22, "+y (north)"),
        ("tracks/hangar/global_waypoints.json.gz", 39.45, "+x"),
        ("tracks/circle/global_waypoints.json.gz", 22.52, "+x"),
    ],
)
def test_real_racelines(shared_data, file, length, heading):
    track = load_raceline(shared_data / file)
    assert track.length == pytest.approx(length, abs=0.01)
    assert [finding.code for finding in track.findings] == [
        "closing-point",
        "heading-x" if heading == "+x" else "heading-north",
    ]
    assert track.speed.min() > 1.0


@pytest.mark.parametrize(
    "file", ["tracks/Spielberg/Spielberg_centerline.csv", "laps/ipz20/centerline.csv"]
)
def test_real_centerlines(shared_data, file):
    track = load_raceline(shared_data / file)
    # A centerline need not be drivable, and its walls fold inside its sharpest bends.
    told = {"unnamed-columns"} if "ipz20" in file else set()
    assert {finding.code for finding in track.findings} == {"tight-bend", "wall-folds"} | told
    assert {finding.severity for finding in track.findings} == {"note"}
    assert track.speed is None
    assert track.d_left.min() > 0.4
