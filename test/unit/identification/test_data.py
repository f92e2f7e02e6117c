"""Runs from bags and CSV files."""

import math

import numpy as np
import pytest

from map_racing.bags.writer import BagWriter
from map_racing.errors import BagError, FileFormatError, ParameterError
from map_racing.identification.channels import Channel, ChannelMap, SensorSetup, load_channel_map
from map_racing.identification.data import load_run
from map_racing.resources import find_config, list_config

T0 = 1600000000.0
COLUMNS = {"time": "t", "x": "px", "y": "py", "psi": "yaw", "steering": "servo"}
MAP = ChannelMap({name: Channel(column) for name, column in COLUMNS.items()})
NAMES = "time: t\nx: px\ny: py\npsi: {column: yaw, unit: deg}\nsteering: servo\n"


def csv(path, rows, header="t,px,py,yaw,servo,gyro,pt"):
    path.write_text(header + "\n" + "".join(",".join(map(str, row)) + "\n" for row in rows))
    return path


def rows(count=50):
    return [(0.02 * i, 0.1 * i, 1.0, 90.0, 0.5, 60.0, 7.0 + 0.02 * i) for i in range(count)]


def channels(tmp_path, text):
    path = tmp_path / "map.yaml"
    path.write_text(text)
    return load_channel_map(path)


def test_units_scales_and_offsets(tmp_path):
    text = NAMES.replace("steering: servo", "steering: {column: servo, scale: -2.0, offset: 0.3}")
    text += "yaw_rate: {column: gyro, unit: deg/s, scale: -1}\n"
    run = load_run(csv(tmp_path / "a.csv", rows()), channels(tmp_path, text))
    assert run.signals["psi"].value[0] == pytest.approx(0.5 * math.pi)
    assert run.signals["yaw_rate"].value[0] == pytest.approx(-math.pi / 3.0)
    assert run.signals["steering"].value[0] == pytest.approx(-0.7)
    assert run.signals["x"].t[-1] == pytest.approx(49 * 0.02)
    assert not run.pose_clock


def test_units_of_the_file_count_where_the_map_has_none(tmp_path):
    header = "t,px,py,yaw,servo,gyro,pt\nms,cm,m,deg,rad,deg/s,s"
    channels_ = {name: Channel(column) for name, column in COLUMNS.items()}
    channels_["yaw_rate"] = Channel("gyro", unit="rad/s")
    data = [(20 * i, 10 * i, 1.0, 90.0, 0.5, 60.0, 0.0) for i in range(50)]
    run = load_run(csv(tmp_path / "a.csv", data, header), ChannelMap(channels_))
    assert run.signals["x"].t[-1] == pytest.approx(0.98)
    assert run.signals["x"].value[-1] == pytest.approx(4.9)
    assert run.signals["psi"].value[0] == pytest.approx(0.5 * math.pi)
    assert run.signals["yaw_rate"].value[0] == 60.0


def test_units_at_the_end_of_names_and_units_of_the_map(tmp_path):
    header = "t_ms,x_mm,y_m,yaw_deg,servo,speed_kmph,pt"
    columns = ["t_ms", "x_mm", "y_m", "yaw_deg", "servo", "speed_kmph"]
    names = ["time", "x", "y", "psi", "steering", "v_x"]
    channels_ = {name: Channel(column) for name, column in zip(names, columns)}
    data = [(20 * i, 1000 * i, 1.0, 90.0, 0.5, 36.0, 0.0) for i in range(50)]
    run = load_run(csv(tmp_path / "a.csv", data, header), ChannelMap(channels_))
    assert run.signals["x"].t[-1] == pytest.approx(0.98)
    assert run.signals["x"].value[-1] == pytest.approx(49.0)
    assert run.signals["psi"].value[0] == pytest.approx(0.5 * math.pi)
    assert run.signals["v_x"].value[0] == pytest.approx(10.0)
    assert "column speed_kmph: kmph converted to m/s" in run.notes
    channels_["v_x"] = Channel("speed_kmph", unit="m/s")
    run = load_run(tmp_path / "a.csv", ChannelMap(channels_))
    assert run.signals["v_x"].value[0] == 36.0


def test_servo_position_becomes_an_angle(tmp_path):
    text = NAMES.replace("servo\n", "{column: servo, servo_gain: -1.2135, servo_offset: 0.5304}\n")
    run = load_run(csv(tmp_path / "a.csv", rows()), channels(tmp_path, text))
    # position = gain * angle + offset
    assert -1.2135 * run.signals["steering"].value[0] + 0.5304 == pytest.approx(0.5)


def test_a_clock_of_its_own_for_the_pose(tmp_path):
    text = NAMES + "pose_time: pt\n"
    run = load_run(csv(tmp_path / "a.csv", rows()), channels(tmp_path, text))
    assert run.pose_clock
    assert run.signals["x"].t[0] == pytest.approx(run.signals["steering"].t[0], abs=0.05)
    assert np.diff(run.signals["x"].t) == pytest.approx(0.02)


def test_a_row_without_time_does_not_lose_the_clock_of_the_pose(tmp_path):
    table = [("", *row[1:]) if i == 7 else row for i, row in enumerate(rows())]
    run = load_run(csv(tmp_path / "a.csv", table), channels(tmp_path, NAMES + "pose_time: pt\n"))
    assert run.signals["x"].t[0] == pytest.approx(run.signals["steering"].t[0], abs=0.05)


def test_rows_before_the_first_message_are_left_out(tmp_path):
    table = [(t, 0, 0, 0, 0.1, 0, 0) if t < 0.2 else (t, *rest) for t, *rest in rows()]
    run = load_run(csv(tmp_path / "a.csv", table), channels(tmp_path, NAMES))
    assert run.signals["x"].t[0] == pytest.approx(0.2)
    assert run.signals["steering"].t[0] == 0.0
    assert any("10 rows without pose" in note for note in run.notes)
    table = [(0, 0, 0, 0, 0.1, 0, 0), *rows()[1:]]
    run = load_run(csv(tmp_path / "b.csv", table), channels(tmp_path, NAMES))
    assert any("1 row without pose" in note for note in run.notes)


def test_time_in_other_units(tmp_path):
    text = NAMES.replace("time: t", "time: {column: t, unit: ns}")
    table = [(int(1.7e18) + 20000000 * i, *row[1:]) for i, row in enumerate(rows())]
    run = load_run(csv(tmp_path / "a.csv", table), channels(tmp_path, text))
    assert np.ptp(run.signals["x"].t) == pytest.approx(0.98)


@pytest.mark.parametrize(
    "text, expected",
    [
        ("speeed: v\n", "speeed: unknown"),
        ("v_x: {column: v, unit: furlongs}\n", "v_x: unit: expected .* m/s, got 'furlongs'"),
        ("v_x: {column: v, unit: deg}\n", "v_x: unit: expected one such as m/s, got 'deg'"),
        ("v_x: {column: v, unit: [m]}\n", "v_x: unit: expected a text, got"),
        ("v_x: {column: v, unit: }\n", "v_x: unit: expected a text, got None"),
        ("v_x: {scale: 2}\n", "v_x: expected column or topic"),
        ("v_x: {column: v, factor: 2}\n", "v_x: factor: unknown"),
        ("v_x: 3\n", "v_x: expected a column"),
        ("v_x: {column: v, scale: big}\n", "scale: expected a finite number"),
        ("steering: {topic: s, servo_gain: 1.0}\n", "servo_gain"),
        ("steering: {topic: s, servo_gain: 0.0, servo_offset: 1.0}\n", "servo_gain"),
        ("setup: {lateral_axis: w}\n", "lateral_axis: expected x, y or z"),
        ("setup: {time_scale: 0}\n", "time_scale: expected"),
        ("setup: {delay: 0}\n", "setup: delay: unknown"),
        ("setup: 3\n", "setup: expected keys"),
        ("pose_topic: 3\n", "pose_topic: expected a topic"),
    ],
)
def test_impossible_maps_are_refused(tmp_path, text, expected):
    with pytest.raises(ParameterError, match=expected) as error:
        channels(tmp_path, text)
    assert str(error.value).startswith(str(tmp_path))


def test_shipped_maps_load():
    assert list_config("channels") == ["circles_log", "sysid_log"]
    for name in list_config("channels"):
        assert load_channel_map(name).setup == SensorSetup()


def test_csv_refusals(tmp_path):
    path = csv(tmp_path / "a.csv", rows())
    with pytest.raises(ParameterError, match="expected a channel map.*--channels"):
        load_run(path)
    with pytest.raises(ParameterError, match="got a YAML file: vehicles go to --vehicle"):
        load_run(find_config("vehicles", "nuc4", (".yaml",)))
    with pytest.raises(FileFormatError, match="no column 'nothing'; it has t, px"):
        load_run(path, channels(tmp_path, NAMES + "v_x: nothing\n"))
    with pytest.raises(ParameterError, match="steering: missing"):
        load_run(path, channels(tmp_path, NAMES.replace("steering: servo\n", "")))
    with pytest.raises(FileFormatError, match="time jumps back by 1.6 s: two runs"):
        load_run(csv(tmp_path / "b.csv", [*rows(80), *rows()]), channels(tmp_path, NAMES))
    with pytest.raises(FileFormatError, match=r"c.csv:3: column px: expected a number"):
        load_run(csv(tmp_path / "c.csv", [rows()[0], (0.1, "x", 0, 0, 0, 0, 0)]), MAP)
    with pytest.raises(ParameterError, match="no such file, nor one of the shipped recordings"):
        load_run(tmp_path / "nowhere.bag")


@pytest.fixture
def bag(tmp_path):
    """One second of driving with an IMU, commands and wheel odometry."""
    path = tmp_path / "a.bag"
    with BagWriter(path) as writer:
        for i in range(50):
            t = T0 + 0.02 * i
            writer.odometry(t, 0.04 * i, 0.0, 0.0, 0.0, 0.0, 0.0)
            writer.odometry(t, 0.0, 0.0, 0.0, 2.0, 0.0, 0.5, topic="/vesc/odom", frame="odom")
            writer.imu(t, 0.1, 1.0, 0.5)
            writer.drive(t, 0.2, 2.0)
    return path


def test_bag_as_it_usually_is(bag):
    run = load_run(bag)
    assert set(run.signals) == {
        "x",
        "y",
        "psi",
        "yaw_rate",
        "a_x",
        "a_y",
        "a_z",
        "steering",
        "speed_command",
    }
    # The localization's twist is not filled in: yaw rate from the IMU, speed from the path.
    assert run.signals["yaw_rate"].value[0] == 0.5
    assert run.signals["steering"].value[0] == pytest.approx(0.2)
    assert any("v_x is 0 throughout" in note for note in run.notes)


def test_channels_of_a_bag(bag, tmp_path):
    text = "v_x: /vesc/odom\nyaw_rate: {topic: vesc/odom, scale: 2}\npose_topic: /car_state/odom\n"
    run = load_run(bag, channels(tmp_path, text))
    assert run.signals["v_x"].value[0] == 2.0 and run.signals["yaw_rate"].value[0] == 1.0


def test_bag_refusals(bag, tmp_path):
    for text, error, expected in (
        ("v_x: /nowhere\n", BagError, "/nowhere: expected messages of .*; it has none"),
        ("v_x: {topic: /vesc/odom, field: a_x}\n", ParameterError, "got 'a_x'"),
        ("x: /vesc/odom\n", ParameterError, "x: expected in CSV files only"),
    ):
        with pytest.raises(error, match=expected):
            load_run(bag, channels(tmp_path, text))


def test_shipped_recording_loads():
    assert list_config("recordings") == ["nuc4_ramps"]
    run = load_run("nuc4_ramps")
    assert {"x", "psi", "v_x", "yaw_rate", "a_y", "steering"} <= set(run.signals)
