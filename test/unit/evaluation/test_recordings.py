import gzip
import os
import re

import numpy as np
import pytest

from map_racing.bags.reader import read_recording
from map_racing.errors import BagError, FileFormatError, ParameterError
from map_racing.evaluation.csv_recordings import parse_columns, read_csv_recording
from map_racing.evaluation.recordings import load_recording, recorded_raceline
from map_racing.track.files.load import load_raceline, save_raceline

ROWS = "t,x,y,yaw,v\n0.0,1.0,2.0,0.1,3.0\n0.5,1.5,2.5,0.2,4.0\n1.0,2.0,3.0,0.3,5.0\n"


@pytest.fixture
def csv(tmp_path):
    def make(text, name="run.csv"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return make


def test_usual_names_are_recognized(csv):
    recording = read_csv_recording(csv(ROWS))
    assert recording.t.tolist() == [0.0, 0.5, 1.0]
    assert recording.x.tolist() == [1.0, 1.5, 2.0]
    assert recording.psi.tolist() == [0.1, 0.2, 0.3]
    assert recording.v_x.tolist() == [3.0, 4.0, 5.0]
    assert np.isnan(recording.v_y).all()
    assert np.isnan(recording.yaw_rate).all()
    assert recording.commands is None
    assert recording.waypoints is None
    assert recording.notes == []
    assert recording.type == "CSV"


def test_units_behind_the_names(csv):
    text = "Time [ms],x [cm],y (m),yaw [deg],v [km/h],r [Hz]\n0,100,2,180,36,1\n500,150,3,90,18,2\n"
    recording = read_csv_recording(csv(text))
    assert recording.t.tolist() == [0.0, 0.5]
    assert (recording.x.tolist(), recording.y.tolist()) == ([1.0, 1.5], [2.0, 3.0])
    np.testing.assert_allclose(recording.psi, [np.pi, 0.5 * np.pi])
    np.testing.assert_allclose(recording.v_x, [10.0, 5.0])
    assert recording.notes == [
        "column Time [ms]: ms converted to s",
        "column x [cm]: cm converted to m",
        "column yaw [deg]: deg converted to rad",
        "column v [km/h]: km/h converted to m/s",
        "warning: column r [Hz]: expected a unit such as rad/s, got Hz: taken as SI",
    ]


@pytest.mark.parametrize(
    "name, value, expected",
    [
        *(
            ("v [kmph]", 36, 10.0),
            ("v (kph)", 36, 10.0),
            ("speed_kmh", 36, 10.0),
            ("v_km/h", 36, 10.0),
        ),
        *(("v [mph]", 100, 44.704), ("v [kn]", 36, 18.52), ("speed_knots", 36, 18.52)),
        *(
            ("v [m s^-1]", 3, 3.0),
            ("v_m_s", 3, 3.0),
            ("vx_cmps", 300, 3.0),
            ("v [ft/s]", 10, 3.048),
        ),
        *(("v [m\u00b7s\u207b\u00b9]", 3, 3.0), ("speed [ms]", 3, 3.0), ("V [KM/H]", 36, 10.0)),
    ],
)
@pytest.mark.parametrize("below", [False, True])
def test_units_of_speeds(csv, name, value, expected, below):
    unit = re.search(r"[\[(](.*)[\])]", name)
    head = f"t,x,y,{name}\n"
    if below and unit:
        head = f"t,x,y,v\ns,m,m,{unit.group(1)}\n"
    recording = read_csv_recording(csv(f"{head}0,1,2,{value}\n1,2,2,{value}\n"))
    assert recording.v_x.tolist() == pytest.approx([expected, expected])
    assert len(recording.notes) == (value != expected)


@pytest.mark.parametrize(
    "name, factor",
    [
        *(("t [min]", 60.0), ("time_ms", 1e-3), ("time_us", 1e-6), ("t [\u00b5s]", 1e-6)),
        *(
            ("stamp_nsec", 1e-9),
            ("%time [ns]", 1e-9),
            ("header.stamp [ns]", 1e-9),
            ("t [h]", 3600.0),
        ),
    ],
)
def test_units_of_times(csv, name, factor):
    rows = "".join(f"{round(0.5 * i / factor, 9)},{i},2\n" for i in range(3))
    recording = read_csv_recording(csv(f"{name},x,y\n{rows}"))
    assert recording.t.tolist() == pytest.approx([0.0, 0.5, 1.0])
    assert [note.split(": ")[0] for note in recording.notes] == [f"column {name}"]


def test_a_time_in_two_columns_is_asked_for(csv):
    with pytest.raises(FileFormatError, match="which column is t"):
        read_csv_recording(csv("stamp_sec,stamp_nsec,x,y\n1,500000000,1,2\n2,0,1,2\n"))


def test_a_unit_of_a_named_column_counts(csv):
    path = csv("t,x,y,wheel_kmh,yaw_dps\n0,1,2,36,180\n1,2,2,36,180\n")
    recording = read_csv_recording(path, "v_x=wheel_kmh,yaw_rate=yaw_dps")
    assert recording.v_x.tolist() == pytest.approx([10.0, 10.0])
    assert recording.yaw_rate.tolist() == pytest.approx([np.pi, np.pi])


@pytest.mark.parametrize("cells", ["9,1,2", "[1, 2],3,4", "'1,2',3,4"])
def test_rows_with_more_cells_than_names_are_refused(csv, cells):
    with pytest.raises(FileFormatError, match=r"run\.csv:2: expected 3 columns, got [45]"):
        read_csv_recording(csv(f"t,x,y\n0,{cells}\n1,{cells}\n"))
    recording = read_csv_recording(csv("t,x,y\n0,1,2,\n1,2,3, ,\n"))
    assert recording.y.tolist() == [2.0, 3.0]


def test_names_that_are_there_twice(csv):
    recording = read_csv_recording(csv("t,x,y,x\n0,1,2,5\n1,2,3,6\n"))
    assert recording.x.tolist() == [1.0, 2.0]
    assert recording.notes == ["warning: several columns are named x: the first is taken"]


@pytest.mark.parametrize("offset", [0.0, 1.0])
def test_headings_in_degrees(csv, offset):
    angle = 0.05 * np.arange(200)
    rows = [
        f"{0.1 * i},{np.cos(a)},{np.sin(a)},{np.degrees(a + 0.5 * np.pi + offset) % 360}"
        for i, a in enumerate(angle)
    ]
    recording = read_csv_recording(csv("\n".join(["t,x,y,yaw", *rows])))
    turned = np.unwrap(recording.psi) - angle - 0.5 * np.pi - offset
    np.testing.assert_allclose(turned, turned[0], atol=1e-9)
    assert recording.notes == ["warning: column yaw is in degrees: converted"]


def test_column_map(csv):
    path = csv("clock,a,b,u,w\n10,1,2,0.1,3\n11,3,4,0.2,5\n")
    recording = read_csv_recording(path, "t=clock, x=b,y=a,steering=u,speed_command=w")
    assert recording.t.tolist() == [0.0, 1.0]
    assert recording.t0_ns == 10 * 10**9
    assert recording.x.tolist() == [2.0, 4.0]
    assert recording.commands.steering_angle.tolist() == [0.1, 0.2]
    assert recording.commands.speed.tolist() == [3.0, 5.0]
    assert recording.commands.topic == "u w"
    same = read_csv_recording(path, {"t": "clock", "x": "b", "y": "a"})
    assert same.y.tolist() == recording.y.tolist()


@pytest.mark.parametrize(
    "text",
    [
        "# t;x;y\n0;1;2\n1;3;4\n",
        "# made by hand\n\n#t,x,y\n# 0\n0,1,2\n# pause\n1,3,4\n".replace("# 0\n", ""),
        "t\tx\ty\n0\t1\t2\n1\t3\t4\n",
        "\ufeffT, X, Y\r\n0, 1, 2\r\n1, 3, 4\r\n",
        '"t","x","y"\n"0","1","2"\n"1", "3", "4"\n',
        "t x   y\n0 1 2\n1  3 4\n",
        "t;x;y;note\n0,0;1,0;2,0;a, b\n1,0;3,0;4,0;1,2,3\n",
        "t\tx\ty\n0,0\t1,0\t2,0\n1,0\t3,0\t4,0\n",
        "t x y\n0,0 1,0 2,0\n1,0 3,0 4,0\n",
        "t,x,y\ns,m,m\n0,1,2\n1,3,4\n",
        "t;x;y\n[ms];[cm];[-]\n0;100;2\n1000;300;4\n",
        "# t x y\n0 1 2\n1 3 4\n",
    ],
)
def test_layouts(csv, text):
    recording = read_csv_recording(csv(text))
    assert recording.t.tolist() == [0.0, 1.0]
    assert (recording.x.tolist(), recording.y.tolist()) == ([1.0, 3.0], [2.0, 4.0])


@pytest.mark.parametrize(
    "head", ["", "# timestamp tx ty tz qx qy qz qw\n", "# ground truth of the hall\n"]
)
def test_trajectories_of_the_tum_benchmark(tmp_path, head):
    path = tmp_path / "run.tum"
    rows = [f"{1700000000 + 0.5 * i:.6f} {i} 2.5 0 0 0 1 1\n" for i in range(4)]
    path.write_text(head + "".join(rows))
    recording = load_recording(path)
    assert recording.t.tolist() == [0.0, 0.5, 1.0, 1.5]
    assert recording.x.tolist() == [0.0, 1.0, 2.0, 3.0] and recording.y.tolist() == 4 * [2.5]
    np.testing.assert_allclose(recording.psi, 0.5 * np.pi)
    assert recording.t0_ns == 1700000000 * 10**9


def test_units_below_the_names_are_brought_to_si(csv):
    text = "t;x;y;psi;v_x\nms;mm;m;deg;km/h\n0;1000,5;2;180;3,6\n500;3000;4;-90;36\n"
    recording = read_csv_recording(csv(text))
    assert recording.t.tolist() == [0.0, 0.5]
    np.testing.assert_allclose(recording.x, [1.0005, 3.0])
    np.testing.assert_allclose(recording.psi, [np.pi, -0.5 * np.pi])
    np.testing.assert_allclose(recording.v_x, [1.0, 10.0])


def test_gzip(tmp_path):
    path = tmp_path / "run.csv.gz"
    path.write_bytes(gzip.compress(ROWS.encode()))
    assert load_recording(path).t.size == 3
    path.rename(tmp_path / "zipped.csv")
    assert load_recording(tmp_path / "zipped.csv").t.size == 3
    path.write_bytes(gzip.compress(ROWS.encode())[:-20])
    with pytest.raises(FileFormatError, match="cannot read"):
        load_recording(path)


def test_rows_that_cannot_be_used_are_reported(csv):
    text = "t,x,y\n0,1,2\n1,,3\n3,nan,3\n2,1,1\n2,5,5\n1.5,7,7\n4,0,0\n5,0"
    recording = read_csv_recording(csv(text))
    assert recording.t.tolist() == [0.0, 1.5, 2.0, 4.0]
    assert recording.x.tolist() == [1.0, 7.0, 1.0, 0.0]
    notes = "; ".join(recording.notes)
    assert "line 9, the last, is truncated" in notes
    assert "2 of 7 without a finite pose" in notes
    assert "1 steps back in time" in notes
    assert "1 repeated time stamps" in notes


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("t,x,y\n0,1,2\n1,a,2\n", r"run.csv:3: column x: expected a number, got 'a'"),
        ("t,x,y\n0,1,2\n1," + 99 * "a" + ",2\n", "expected a number, got 'a{37}...'$"),
        ("0,1,2\n1,2,3\n", "expected names of columns above the numbers, got none"),
        ("t,x,y\n0,1,2\n1,2\n2,3,4\n", r"run.csv:3: expected 3 columns, got 2"),
        ("t,x,z\n0,1,2\n", r"which column is y\? It has t, x, z"),
        ("a,b,c\n0,1,2\n", "which columns are t, x, y.* say --columns t=NAME,x=NAME,y=NAME"),
        ("t,x,y\n0,1,2\n25000000,1,2\n50000000,1,2\n", "column t: .* seconds, .* 2.5e.07 between"),
        ('t,x,y\n0,"1,2\n1,1,2\n', "run.csv:3: expected 3 columns, got 2|at least two rows"),
        ("t,x,y\nfurlong,m,m\n0,1,2\n", "column t: expected a unit such as s, got furlong"),
        ("", "expected rows of numbers"),
        ("# only a comment\n", "expected rows of numbers"),
        ("t,x,y\n", "at least two rows"),
        ("t,x,y\n0,1,2\n", "at least two rows"),
        ("t,x,y\n0,,2\n1,,3\n", "at least two rows .*2 of 2 without a finite pose left out"),
        ("t,x,y\n0,1,2\n1e300,1,2\n", "run.csv:3: column t: expected a time in sec.* 1e.300"),
        ("t,x,y\n1700000000000000000,1,2\n1,1,2\n", "run.csv:2: column t: expected a time in sec"),
        ("t,x,y\n-1e300,1,2\n1,1,2\n", "run.csv:2: column t: expected a time in seconds"),
    ],
)
def test_malformed_files(csv, text, expected):
    with pytest.raises(FileFormatError, match=expected) as error:
        read_csv_recording(csv(text))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "text",
    [
        't,cov,x,y\n0,"[1, 2, 3]",5,6\n1,"[1, 2, 3]",7,8\n',
        't,"a,b",x,y\n0,"1,2",5,6\n1,"3,4",7,8\n',
        't;cov;x;y\n0;"a;""b"";,";5;6\n1;"c";7;8\n',
        't,note,x,y\n0,"two\nlines",5,6\n1, "c,d",7,8\n',
        't,x,y,note\n"0","5","6","a, b"\n"1","7","8",""\n',
    ],
)
def test_quoted_cells_may_hold_delimiters(csv, text):
    recording = read_csv_recording(csv(text))
    assert recording.t.tolist() == [0.0, 1.0]
    assert recording.x.tolist() == [5.0, 7.0]
    assert recording.y.tolist() == [6.0, 8.0]


ECHO = (
    "%time,field.header.seq,field.header.stamp,field.header.frame_id,field.child_frame_id,"
    "field.pose.pose.position.x,field.pose.pose.position.y,field.pose.pose.position.z,"
    "field.pose.pose.orientation.x,field.pose.pose.orientation.y,field.pose.pose.orientation.z,"
    "field.pose.pose.orientation.w,field.twist.twist.linear.x,field.twist.twist.linear.y,"
    "field.twist.twist.angular.z\n"
)


@pytest.mark.parametrize("stamped", [True, False])
def test_files_of_rostopic_echo(csv, stamped):
    rows = [
        f"{1700000000000000000 + 25000000 * i},{i},{(1699999999990000000 + 25000000 * i) * stamped}"
        f",map,base_link,{i},2.0,0.0,0.0,0.0,2.0,2.0,3.0,0.5,0.25\n"
        for i in range(4)
    ]
    recording = read_csv_recording(csv(ECHO + "".join(rows)))
    np.testing.assert_allclose(recording.t, 0.025 * np.arange(4), atol=1e-6)
    assert recording.t0_ns == pytest.approx(1.7e18 - 1e7 * stamped, abs=1000)
    assert recording.x.tolist() == [0.0, 1.0, 2.0, 3.0]
    np.testing.assert_allclose(recording.psi, 0.5 * np.pi)
    assert (recording.v_x[0], recording.v_y[0], recording.yaw_rate[0]) == (3.0, 0.5, 0.25)
    notes = "; ".join(recording.notes)
    assert "nanoseconds" in notes and "quaternions do not have length 1 but 2.83" in notes
    assert ("4 of 4 stamps are 0" in notes) != stamped


@pytest.mark.parametrize("name", ["field.header.frame_id", "header.frame_id", "frame_id"])
def test_frames_of_messages(csv, name):
    rows = [f"{0.1 * i},{'map' if i % 3 else 'odom'},{i},{2 * i}" for i in range(1, 10)]
    recording = read_csv_recording(csv(f"t,{name},x,y\n" + "\n".join(rows)))
    assert recording.frame == "map" and recording.x.tolist() == [1, 2, 4, 5, 7, 8]
    (said,) = [note for note in recording.notes if note.startswith("warning")]
    assert "3 rows in another frame, odom, left out: only map counts" in said
    recording = read_csv_recording(csv(f"t,{name},x,y\n" + "\n".join(rows).replace("map", "odom")))
    assert recording.frame == "odom" and recording.x.size == 9


def test_commands_between_the_rows_of_poses(csv):
    """As in a table of two topics; over empty cells, the last command holds."""
    rows = [f"{0.1 * i:.2f},{i},{2 * i},,\n{0.1 * i + 0.03:.2f},,,0.{i},{i}" for i in range(1, 9)]
    recording = read_csv_recording(csv("t,x,y,steering,speed_command\n" + "\n".join(rows)))
    assert recording.x.tolist() == list(range(1, 9))
    commands = recording.commands
    np.testing.assert_allclose(commands.t, 0.03 + 0.1 * np.arange(8), atol=1e-9)
    assert commands.speed.tolist() == list(range(1, 9))
    held = commands.held(recording.t, commands.speed)
    assert np.isnan(held[0]) and held[1:].tolist() == list(range(1, 8))


def test_two_columns_that_may_be_of_the_car(csv):
    rows = "\n".join(f"{0.1 * i},{i},{2 * i},{i + 1},{2 * i}" for i in range(9))
    recording = read_csv_recording(csv("t,pose_x,pose_y,x,y\n" + rows))
    said = [note for note in recording.notes if note.startswith("warning")]
    assert "x is column x; pose_x may be the car's, too (--columns x=pose_x)" in said[0]
    chosen = read_csv_recording(csv("t,pose_x,pose_y,x,y\n" + rows), "x=pose_x,y=pose_y")
    assert chosen.x.tolist() == list(range(9)) and chosen.notes == []


def test_a_frame_of_odometry_gives_way_to_the_map(csv):
    rows = [f"{0.5 * i},{'odom' if i < 5 else 'map'},{i},{2 * i}" for i in range(12)]
    recording = read_csv_recording(csv("t,frame_id,x,y\n" + "\n".join(rows)))
    assert recording.frame == "map" and recording.x.tolist() == [6, 7, 8, 9, 10, 11]
    said = "; ".join(recording.notes)
    assert "5 rows in frame odom and 1 in map left out: odom fell silent, and map took" in said


def test_nanoseconds_since_1970_under_any_name(csv):
    text = "timestamp,x,y\n1700000000000000000,0,0\n1700000000025000000,1,0\n"
    np.testing.assert_allclose(read_csv_recording(csv(text)).t, [0.0, 0.025], atol=1e-6)


def test_malformed_arguments(csv, tmp_path):
    path = csv(ROWS)
    with pytest.raises(FileFormatError, match="no column 'q'; it has t, x, y, yaw, v"):
        read_csv_recording(path, "x=q")
    with pytest.raises(ParameterError, match="unknown field 'q'"):
        read_csv_recording(path, "q=x")
    for text in ("x", "x=", "=y", "x=y,,t=z"):
        with pytest.raises(ParameterError, match="field=column"):
            parse_columns(text)
    with pytest.raises(ParameterError, match="field 't' is given twice"):
        parse_columns("t=t,t=x")
    with pytest.raises(ParameterError, match="pose topic /odom: expected a bag"):
        load_recording(path, pose_topic="/odom")
    with pytest.raises(FileFormatError, match="No such file"):
        load_recording(tmp_path / "missing.csv")
    for read in (load_recording, load_raceline):
        with pytest.raises(FileFormatError, match="^'': expected the name of a file"):
            read("")
    with pytest.raises(BagError, match="No such file"):
        load_recording(tmp_path / "missing.bag")
    binary = tmp_path / "image.csv"
    binary.write_bytes(bytes(range(128, 256)))
    with pytest.raises(FileFormatError, match="expected UTF-8 text"):
        load_recording(binary)


def test_bags_are_recognized_by_their_content(race_bag, tmp_path):
    path = tmp_path / "bag_without_suffix"
    path.write_bytes(race_bag().read_bytes())
    assert load_recording(path).topic == "/car_state/odom"
    assert load_recording(path, "/car_state/pose").topic == "/car_state/pose"
    with pytest.raises(ParameterError, match="columns: expected a CSV file"):
        load_recording(path, columns="t=time")
    length = recorded_raceline(load_recording(path)).length
    assert load_raceline(path).length == pytest.approx(length)


def test_tracks_from_files_and_bags(tmp_path, race_bag, track):
    line = track.raceline(speed=5.0, walls=1.0)
    save_raceline(line, tmp_path / "line.csv")
    assert load_raceline(tmp_path / "line.csv").length == pytest.approx(line.length, abs=1e-3)
    assert load_raceline(f"{race_bag()}#/global_waypoints").length == pytest.approx(
        line.length, abs=1e-3
    )
    with pytest.raises(BagError, match="no raceline"):
        load_raceline(f"{race_bag()}#/other")
    sharp = tmp_path / "run#1.bag"
    sharp.write_bytes(race_bag().read_bytes())
    for source in (sharp, f"{sharp}#/global_waypoints"):
        assert load_raceline(source).length == pytest.approx(line.length, abs=1e-3)
    with pytest.raises(ParameterError):
        load_raceline("no_such_track")


def test_real_laps(shared_data):
    folder = shared_data / "laps" / "ipz20"
    for path in sorted(folder.glob("*.csv.gz")):
        recording = load_recording(path)
        assert np.median(np.diff(recording.t)) == pytest.approx(0.04)
        assert recording.notes == []
        assert recording.commands.topic == "angular_control translational_control"
        told = load_recording(
            path,
            columns="t=time,x=pose_x,y=pose_y,psi=pose_theta,v_x=linear_vel_x,v_y=linear_vel_y,"
            "yaw_rate=angular_vel_z,steering=angular_control,speed_command=translational_control",
        )
        np.testing.assert_array_equal(told.x, recording.x)
        np.testing.assert_array_equal(told.yaw_rate, recording.yaw_rate)


def test_two_runs_in_one_file_are_refused(csv):
    text = "t,x,y\n" + "".join(f"{t},1,2\n" for t in [0, 5, 12.5, "nan", 0.2, 5.2])
    expected = r"run.csv: time jumps back by 12.3 s at line 6: two runs in one file\?"
    with pytest.raises(FileFormatError, match=expected):
        read_csv_recording(csv(text))


def test_a_clock_that_is_set_back_while_the_car_drives(csv):
    """Rows in the wrong order do not count, nor those of a standing car."""
    t, speed = 0.02 * np.arange(1000), 4.0

    def said(t, x):
        text = "t,x,y\n" + "".join(f"{a:.4f},{b:.4f},0\n" for a, b in zip(t, x))
        notes = read_csv_recording(csv(text)).notes
        return [note for note in notes if note.startswith("warning: ")]

    (doubt,) = said(np.where(t > 10.0, t - 0.09, t), speed * t)
    assert "time falls back by 0.09 s at 10.0 s, while the car drives on" in doubt
    swapped = np.arange(1000)
    swapped[300], swapped[301] = 301, 300
    swapped[500], swapped[505] = 505, 500
    assert said(t[swapped], speed * t[swapped]) == []
    assert said(np.where(t > 10.0, t - 0.09, t), 0.0 * t) == []


def test_damaged_gzip_is_one_line(tmp_path):
    rows = "t,x,y\n" + "".join(f"{0.025 * i},{i % 7},{i % 13}\n" for i in range(2000))
    data = gzip.compress(rows.encode())
    path = tmp_path / "run.csv.gz"
    for at in range(20, len(data) - 8, 97):
        path.write_bytes(data[:at] + bytes([data[at] ^ 0xFF]) + data[at + 1 :])
        with pytest.raises(FileFormatError, match="run.csv.gz") as error:
            load_recording(path)
        assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["run.bag", "run.csv", "run", "run.csv.gz"])
def test_pipes_are_refused_before_they_are_opened(tmp_path, name):
    path = tmp_path / name
    os.mkfifo(path)
    for read in (load_recording, load_raceline, read_csv_recording):
        with pytest.raises(FileFormatError, match=f"{name}: expected a file, got a pipe"):
            read(path)
    with pytest.raises(BagError, match=f"{name}: expected a bag, got a pipe"):
        read_recording(path)
