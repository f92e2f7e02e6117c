"""Columns without names, or with any spelling: read correctly, or with a clear warning."""

import math
from contextlib import suppress

import numpy as np
import pytest

from map_racing.errors import FileFormatError
from map_racing.track.files.columns import meaning_of
from map_racing.track.files.load import load_raceline, read_raceline
from map_racing.track.findings import NOTE, WARNING
from map_racing.track.raceline import Raceline

T = np.arange(150) * 2.0 * math.pi / 150
LINE = Raceline(9.0 * np.cos(T), 4.5 * np.sin(T))
AT = LINE.sample(LINE.s_points)
SLOW = 4.5 - 1.5 * np.abs(AT.kappa) / np.max(np.abs(AT.kappa))  # 3.0 to 4.5 m/s or so
COLUMNS = {
    "s": AT.s,
    "x": AT.x,
    "y": AT.y,
    "psi": AT.psi,
    "kappa": AT.kappa,
    "speed": SLOW,
    "ax": np.gradient(0.5 * SLOW**2) / np.gradient(AT.s),
    "d_right": 1.0 + 0.1 * np.sin(5.0 * T),
    "d_left": 1.2 + 0.1 * np.cos(3.0 * T),
    "z": 0.0 * T,
    "high": 0.0 * T + 0.3,
    "constant": 0.0 * T + 3.0,
    "rising": 3.0 + np.abs(AT.kappa),
    "qz": np.sin(0.5 * AT.psi),
    "qw": np.cos(0.5 * AT.psi),
    "index": np.arange(150.0),
    "slower": 0.8 * SLOW,
    "time": np.append(0.0, np.cumsum(np.diff(AT.s) / SLOW[1:])),
    "wild": 4.0 + np.sin(7.0 * T),
    "radius": 1.0 / AT.kappa,
    "steering": np.arctan(0.33 * AT.kappa),
    "yaw_rate": AT.kappa * SLOW,
    "stamp": 1.7e9 + np.append(0.0, np.cumsum(np.diff(AT.s) / SLOW[1:])),
}


def write(path, *columns, header="", separator=", "):
    columns = [COLUMNS[column] if isinstance(column, str) else column for column in columns]
    rows = [separator.join(f"{value:.6f}" for value in row) for row in zip(*columns)]
    path.write_text("\n".join([header] * bool(header) + rows) + "\n")
    return path


def codes(findings):
    return {finding.code: finding.severity for finding in findings}


@pytest.mark.parametrize(
    "heading",
    [
        lambda psi: psi,
        lambda psi: np.mod(psi, 2.0 * math.pi),
        lambda psi: np.mod(psi - 0.5 * math.pi, 2.0 * math.pi),  # from north
        lambda psi: 0.5 * math.pi - psi,  # compass
        lambda psi: -psi,
        lambda psi: np.unwrap(psi) + 4.0 * math.pi,
        np.degrees,
        lambda psi: np.mod(90.0 - np.degrees(psi), 360.0),
        lambda psi: psi + 1.0,  # of a car with a rotated localization
        lambda psi: psi + 0.05 * np.sin(np.arange(150)),  # measured
    ],
)
@pytest.mark.parametrize("speed", ["speed", "constant", "rising"])
def test_waypoints_with_heading_and_speed(tmp_path, heading, speed):
    """x, y, yaw, speed in any heading convention: the speeds are not mistaken for walls."""
    path = write(tmp_path / "wp.csv", "x", "y", heading(COLUMNS["psi"]), speed)
    read = read_raceline(path)
    assert set(read.columns) == {"x", "y", "psi", "speed"}
    np.testing.assert_allclose(read.columns["speed"], COLUMNS[speed], atol=1e-5)
    assert codes(load_raceline(path).findings)["unnamed-columns"] == WARNING


@pytest.mark.parametrize(
    "columns, expected, severity",
    [
        ("x y", "x y", None),
        ("x y speed", "x y speed", WARNING),
        ("s x y", "s x y", None),
        ("index x y", "x y", None),
        ("x y speed psi", "x y speed psi", WARNING),
        ("x y d_right d_left", "x y d_right d_left", NOTE),
        ("x y z psi speed", "x y psi speed", WARNING),
        ("x y z speed", "x y speed", WARNING),
        ("x y qz qw speed", "x y speed", WARNING),
        ("x y z z z qz qw", "x y", NOTE),
        ("x y z z z qz qw speed", "x y speed", WARNING),
        ("x y kappa speed", "x y kappa speed", WARNING),
        ("s x y psi kappa speed", "s x y psi kappa speed", WARNING),
        ("s x y psi kappa speed ax", "s x y psi kappa speed ax", None),
        ("x y psi kappa speed ax", "x y psi kappa speed ax", NOTE),
        ("x y psi speed d_right d_left", "x y psi speed d_right d_left", WARNING),
        ("x y psi speed d_right d_left z", "x y psi speed d_right d_left", WARNING),
        ("x y speed d_right d_left", "x y speed d_right d_left", WARNING),
        ("x y d_right d_left speed", "x y d_right d_left speed", WARNING),
        ("x y d_right d_left z", "x y d_right d_left", NOTE),
        ("x y high d_right d_left", "x y d_right d_left", NOTE),
        ("index x y psi speed", "x y psi speed", WARNING),
        ("time x y psi speed", "x y psi speed", WARNING),
        ("x y speed slower", "x y speed", WARNING),
        ("x y psi speed slower", "x y psi speed", WARNING),
        ("time x y speed", "x y speed", WARNING),
        ("stamp x y speed", "x y speed", WARNING),
        ("stamp x y psi speed", "x y psi speed", WARNING),
        # Neither a wall nor a speed.
        ("x y speed time", "x y speed", WARNING),
        ("x y time speed", "x y speed", WARNING),
        ("x y radius speed", "x y speed", WARNING),
        ("x y psi steering speed", "x y psi speed", WARNING),
        ("x y psi speed yaw_rate", "x y psi speed", WARNING),
        # Seven columns in an order other than the public tools', followed by walls in either order.
        ("s x y psi speed kappa ax", "s x y psi speed kappa", WARNING),
        (
            "s x y psi kappa speed ax d_right d_left",
            "s x y psi kappa speed ax d_right d_left",
            WARNING,
        ),
    ],
)
def test_columns_without_names(tmp_path, columns, expected, severity):
    read = read_raceline(write(tmp_path / "c.csv", *columns.split()))
    assert set(read.columns) == set(expected.split())
    for name, column in read.columns.items():
        np.testing.assert_allclose(column, COLUMNS[name], atol=1e-5, err_msg=name)
    assert codes(read.findings).get("unnamed-columns") == severity


def test_three_constant_columns_are_a_guess(tmp_path):
    """Speed and walls, or walls and height: only their magnitudes tell."""
    ones = np.ones(150)
    path = write(tmp_path / "c.csv", "x", "y", 3.0 * ones, 1.1 * ones, 0.9 * ones)
    (finding,) = read_raceline(path).findings
    assert finding.severity == WARNING and "column 3 is taken as speed" in str(finding)


@pytest.mark.parametrize("head", ["", "# timestamp tx ty tz qx qy qz qw\n"])
def test_a_trajectory_of_the_tum_benchmark(tmp_path, head):
    angle = 0.05 * np.arange(125)
    rows = [
        f"{1700000000 + 0.05 * i:.3f} {3 * np.cos(a):.6f} {3 * np.sin(a):.6f} 0 0 0 "
        f"{np.sin(0.5 * a):.9f} {np.cos(0.5 * a):.9f}\n"
        for i, a in enumerate(angle)
    ]
    (tmp_path / "lap.txt").write_text(head + "".join(rows))
    read = read_raceline(tmp_path / "lap.txt")
    assert sorted(read.columns) == ["x", "y"]
    np.testing.assert_allclose(read.columns["x"], 3 * np.cos(angle), atol=1e-5)
    assert WARNING not in codes(read.findings).values()


def test_columns_that_numbers_do_not_tell_are_refused(tmp_path):
    path = write(tmp_path / "c.csv", "x", "y", "wild", "rising", "constant", "d_right")
    with pytest.raises(FileFormatError, match=r"expected names of the 6 columns.*FILE#x,y,speed"):
        read_raceline(path)
    read = read_raceline(f"{path}#x,y,speed,-,-,-")
    assert set(read.columns) == {"x", "y", "speed"} and read.findings == ()


@pytest.mark.parametrize(
    "header, column, factor",
    [
        ("# X [m];Y [m];Speed [m/s]", "speed", 1.0),
        ("x, y, v", "speed", 1.0),
        ("X_M,Y_M,VX_MPS", "speed", 1.0),
        ("pos_x,pos_y,target_speed", "speed", 1.0),
        ("position.x,position.y,targetVelocity", "speed", 1.0),
        ("x_ref,y_ref,v_ref", "speed", 1.0),
        ("xRef;yRef;vRef", "speed", 1.0),
        ('"x","y","velocity [m s^-1]"', "speed", 1.0),
        ("x_m,y_m,speed_kmh", "speed", 3.6),
        ("x,y,v (km/h)", "speed", 3.6),
        ("x,y,Speed [kph]", "speed", 3.6),
        ("x,y,speed_km_h", "speed", 3.6),
        ("x,y,speed\nm,m,km/h", "speed", 3.6),
        ("# x,y,speed\n# [m],[m],[m/s]", "speed", 1.0),
        ("x,y,track_width", "width", 1.0),
        ("x,y,half_width_m", "width", 0.5),
        ("x [m] y [m] psi [deg]", "psi", 180.0 / math.pi),
        ("x_m,y_m,v_mmps", "speed", 1000.0),
        ("x_m,y_m,lon_vel [ft/s]", "speed", 1.0 / 0.3048),
        ("x,y,speed (knots)", "speed", 3600.0 / 1852.0),
        ("x,y,total_width", "width", 1.0),
    ],
)
def test_names_of_any_spelling(tmp_path, header, column, factor):
    expected = COLUMNS["psi" if column == "psi" else "speed"]
    separator = ";" if ";" in header else " " if "," not in header else ","
    path = write(
        tmp_path / "c.csv", "x", "y", factor * expected, header=header, separator=separator
    )
    read = read_raceline(path)
    assert set(read.columns) == {"x", "y", column}
    np.testing.assert_allclose(read.columns[column], expected, atol=1e-5)
    assert not {WARNING} & set(codes(read.findings).values())
    if factor != 1.0 and column != "width":
        assert codes(read.findings) == {"units": NOTE}


@pytest.mark.parametrize(
    "right, left",
    [
        ("width_right", "width_left"),
        ("w_tr_right_m", "w_tr_left_m"),
        ("w_r", "w_l"),
        ("wr", "wl"),
        ("rw", "lw"),
        ("right_width", "left_width"),
        ("Width Right [m]", "Width Left [m]"),
        ("distance_to_right_wall", "distance_to_left_wall"),
        ("right_bound", "left_bound"),
        ("dRight", "dLeft"),
        ("d_right_sp", "d_left_sp"),
        ("right", "left"),
    ],
)
def test_names_of_walls(tmp_path, right, left):
    path = write(
        tmp_path / "c.csv", "x", "y", "d_left", "d_right", header=f"# x_m,y_m,{left},{right}"
    )
    read = read_raceline(path)
    assert set(read.columns) == {"x", "y", "d_right", "d_left"} and read.findings == ()
    np.testing.assert_allclose(read.columns["d_right"], COLUMNS["d_right"], atol=1e-5)
    np.testing.assert_allclose(read.columns["d_left"], COLUMNS["d_left"], atol=1e-5)


def test_names_that_are_not_understood_are_named(tmp_path):
    path = write(tmp_path / "c.csv", "x", "y", "d_right", "speed", header="# x_m,y_m,foo,bar_mps")
    read = read_raceline(path)
    assert set(read.columns) == {"x", "y"}
    assert "foo, bar_mps" in str(read.findings[0]) and read.findings[0].severity == WARNING
    # Under a header, with # or not, no column is taken by position.
    for mark in ("# ", "#", ""):
        path = write(tmp_path / "c.csv", "x", "y", "speed", header=f"{mark}lat,lon,speed")
        with pytest.raises(FileFormatError, match=r"1: expected names of columns with x_m and y_m"):
            read_raceline(path)
    # A comment is not a header.
    path = write(tmp_path / "c.csv", "x", "y", header="# recorded on Monday, by hand")
    assert set(read_raceline(path).columns) == {"x", "y"}


def test_a_unit_that_is_not_understood_is_named(tmp_path):
    path = write(tmp_path / "c.csv", "x", "y", "speed", header="x_m,y_m,speed [furlongs]")
    assert "furlongs" in str(read_raceline(path).findings[0])


def test_of_two_columns_that_mean_the_same_the_plain_name_is_taken(tmp_path):
    header = "x,y,target_speed,speed"
    read = read_raceline(write(tmp_path / "c.csv", "x", "y", "constant", "speed", header=header))
    np.testing.assert_allclose(read.columns["speed"], COLUMNS["speed"], atol=1e-5)
    assert "target_speed" in str(read.findings[0])


@pytest.mark.parametrize(
    "name, column",
    [("vy", "?"), ("x_left", "?"), ("yaw_rate", "?"), ("v_max", "?"), ("z_m", "-"), ("id", "-")],
)
def test_names_that_only_look_alike(name, column):
    assert meaning_of(name).column == column


def test_one_speed_in_two_units(tmp_path):
    header = "x,y,v_kmh,v_mps"
    path = write(tmp_path / "c.csv", "x", "y", 3.6 * SLOW, "speed", header=header)
    np.testing.assert_allclose(read_raceline(path).columns["speed"], SLOW, atol=1e-5)
    path = write(tmp_path / "c.csv", "x", "y", 3.0 * SLOW, "speed", header=header)
    with pytest.raises(FileFormatError, match="expected each column once"):
        read_raceline(path)


@pytest.mark.parametrize("cell", ['"[0.1, 0.2]"', '"0.1,0.2"', "left", '""'])
def test_cells_that_are_not_used_may_hold_anything(tmp_path, cell):
    rows = [f'{cell},"{x:.6f}",{y:.6f}' for x, y in zip(COLUMNS["x"], COLUMNS["y"])]
    (tmp_path / "c.csv").write_text("\n".join(["note,x,y", *rows]))
    read = read_raceline(tmp_path / "c.csv")
    np.testing.assert_allclose(read.columns["x"], COLUMNS["x"], atol=1e-6)
    assert codes(read.findings) == {"unknown-columns": WARNING}


@pytest.mark.parametrize(
    "cells, warned",
    [
        ([f"{k}" for k in range(500)], False),
        ([f"{s:.4f}" for s in COLUMNS["s"]], False),
        ([""] * 500, False),
        (["0.5", "0.6"] * 250, True),
    ],
)
def test_a_column_without_a_name_under_a_header(tmp_path, cells, warned):
    """A number of the row, as pandas writes it, an arc length and an empty one need no name."""
    rows = [f"{c},{x:.6f},{y:.6f}" for c, x, y in zip(cells, COLUMNS["x"], COLUMNS["y"])]
    (tmp_path / "c.csv").write_text("\n".join([",x,y", *rows]))
    read = read_raceline(tmp_path / "c.csv")
    np.testing.assert_allclose(read.columns["x"], COLUMNS["x"], atol=1e-6)
    assert codes(read.findings) == ({"unknown-columns": WARNING} if warned else {})
    assert [f.text for f in read.findings] == ["columns without a name are not used: 1"][:warned]


def test_the_shared_cases(shared_cases):
    """Compared with the column "right" in their README."""
    for name in ("wp_xyyawv.csv", "wp_xyyawv_2pi.csv"):
        track = load_raceline(shared_cases / name)
        assert track.d_left is None
        assert (track.speed.min(), track.speed.max()) == pytest.approx((3.0, 4.5), abs=0.01)
    walls = load_raceline(shared_cases / "hdr_width_right.csv")
    assert np.ptp(walls.d_right) == np.ptp(walls.d_left) == 0.0
    assert (walls.d_right[0], walls.d_left[0]) == pytest.approx((1.0, 1.2))
    units = load_raceline(shared_cases / "hdr_units_2.csv")
    assert units.d_left is None and np.unique(units.speed).tolist() == [3.5]
    for name in ("quoted_list.csv", "quoted_tuple_before_xy.csv"):
        read = read_raceline(shared_cases / name)
        assert np.max(np.abs(np.hypot(*read.xy.T) - 6.0)) == pytest.approx(0.1, abs=1e-3)


def test_a_speed_behind_both_walls_is_no_height(tmp_path):
    """A speed that does not drop in bends, after columns that look like walls."""
    path = write(tmp_path / "a.csv", "x", "y", "d_right", "d_left", "wild")
    line = load_raceline(path)
    assert line.speed_at(0.0) == pytest.approx(4.0, abs=0.01)
    assert np.median(line.d_left) == pytest.approx(1.2, abs=0.02)
    assert codes(line.findings)["unnamed-columns"] == WARNING


def test_a_column_that_is_not_taken_makes_the_places_a_guess(tmp_path):
    """The speed comes first, so it is taken for x, and y is not recognized."""
    line = load_raceline(write(tmp_path / "a.csv", "wild", "x", "y"))
    assert codes(line.findings)["unnamed-columns"] == WARNING


@pytest.mark.parametrize("jitter", [0.005, 0.02])
@pytest.mark.parametrize(
    "columns",
    ["x y speed", "x y psi kappa speed", "x y high psi speed", "x y psi speed d_right d_left"],
)
def test_waypoints_of_a_localization_jitter(tmp_path, jitter, columns):
    noise = np.random.RandomState(3).normal(0.0, jitter, (2, T.size))
    moved = {"x": AT.x + noise[0], "y": AT.y + noise[1]}
    path = write(tmp_path / "c.csv", *(moved.get(column, column) for column in columns.split()))
    read = read_raceline(path)
    assert set(read.columns) == set(columns.split()) - {"high"}
    np.testing.assert_allclose(read.columns["speed"], SLOW, atol=1e-5)
    assert codes(read.findings)["unnamed-columns"] == WARNING


@pytest.mark.parametrize("size", [1e-310, 1e-160, 1e160])
def test_numbers_that_nothing_has_do_not_overflow(tmp_path, size):
    """Neither do their squares or inverses: a RuntimeWarning is an error in these tests."""
    one = SLOW.copy()
    one[7] = size
    for column in (one, size * np.sin(3.0 * T), size * SLOW):
        path = tmp_path / "c.csv"
        np.savetxt(path, np.stack((AT.x, AT.y, column), axis=1), fmt="%.9g", delimiter=",")
        with suppress(FileFormatError):
            read_raceline(path)


def test_a_wide_track_is_a_guess(tmp_path):
    """On a circle, only the magnitude distinguishes two speeds from two walls."""
    circle = 6.0 * np.cos(T), 6.0 * np.sin(T)
    for size, severity in ((1.1, NOTE), (4.4, WARNING)):
        path = write(tmp_path / "c.csv", *circle, size + 0.0 * T, 0.9 * size + 0.0 * T)
        assert codes(read_raceline(path).findings) == {"unnamed-columns": severity}


@pytest.mark.parametrize(
    "remark", ["# raceline of the hall, 2024", "#", "# made today", "# [m], x"]
)
def test_a_remark_between_names_and_numbers(tmp_path, remark):
    header = f"# x_m, y_m, d_left_m, d_right_m\n{remark}"
    read = read_raceline(write(tmp_path / "c.csv", "x", "y", "d_left", "d_right", header=header))
    np.testing.assert_allclose(read.columns["d_left"], COLUMNS["d_left"], atol=1e-5)
    assert read.findings == ()


def test_units_stand_below_the_names_whatever_follows(tmp_path):
    path = write(tmp_path / "c.csv", "x", "y", "speed", header="x,y,v\nm,m,km/h\n# made today")
    np.testing.assert_allclose(read_raceline(path).columns["speed"], SLOW / 3.6, atol=1e-5)


def test_names_in_another_alphabet_are_named(tmp_path):
    read = read_raceline(write(tmp_path / "c.csv", "x", "y", "speed", header="x,y,\uc18d\ub3c4"))
    assert set(read.columns) == {"x", "y"}
    (finding,) = read.findings
    assert finding.severity == WARNING and "not used: \uc18d\ub3c4" in str(finding)


def test_the_tangent_beside_the_position(tmp_path):
    names = "x,y,left_dist,right_dist,Tx,Ty"
    tangent = np.cos(AT.psi), np.sin(AT.psi)
    path = write(tmp_path / "c.csv", "x", "y", "d_left", "d_right", *tangent, header=names)
    read = read_raceline(path)
    assert set(read.columns) == {"x", "y", "d_left", "d_right"}
    np.testing.assert_allclose(read.xy, np.stack((AT.x, AT.y), axis=1), atol=1e-5)


@pytest.mark.parametrize("prefix", ["", "field.pose.", "/pf/pose/odom/pose/"])
def test_names_of_the_fields_of_messages(tmp_path, prefix):
    names = [f"{prefix}pose.position.{axis}" for axis in "xy"] + [f"{prefix}twist.linear.x"]
    path = write(tmp_path / "c.csv", "x", "y", "speed", header=",".join(names))
    assert set(read_raceline(path).columns) == {"x", "y", "speed"}


@pytest.mark.parametrize("value, speed", [(3.0, True), (0.7, False)])
def test_a_constant_beside_walls_is_a_guess(tmp_path, value, speed):
    path = write(tmp_path / "c.csv", "x", "y", value + 0.0 * T, "d_right", "d_left")
    read = read_raceline(path)
    assert set(read.columns) == {"x", "y", "d_right", "d_left"} | ({"speed"} if speed else set())
    (finding,) = read.findings
    other = "height" if speed else "speed"
    assert finding.severity == WARNING and f"though it may be the {other}" in str(finding)


@pytest.mark.parametrize("jitter", [0.0, 0.01])
@pytest.mark.parametrize("value", [0.2, 1.0, 4.8])
def test_a_constant_on_a_circle_is_neither_curvature_nor_radius(tmp_path, jitter, value):
    noise = np.random.RandomState(3).normal(0.0, jitter, (2, T.size))
    x, y, psi = 6.0 * np.cos(T) + noise[0], 6.0 * np.sin(T) + noise[1], T + 0.5 * math.pi
    read = read_raceline(write(tmp_path / "c.csv", x, y, psi, value + 0.0 * T))
    assert set(read.columns) == {"x", "y", "psi", "speed"}
    assert codes(read.findings)["unnamed-columns"] == WARNING


def test_a_wall_that_is_near_in_bends_is_no_speed(tmp_path):
    """The smaller of the two remaining columns, because racing lines touch one wall in bends."""
    near = 0.6 - 0.2 * np.abs(AT.kappa) / np.max(np.abs(AT.kappa)) + 0.07 * np.sin(7.0 * T)
    path = write(tmp_path / "c.csv", "x", "y", "psi", near, "d_left")
    read = read_raceline(path)
    assert set(read.columns) == {"x", "y", "psi", "d_right", "d_left"}
    assert codes(read.findings)["unnamed-columns"] == WARNING
