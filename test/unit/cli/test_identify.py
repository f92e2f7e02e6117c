"""From driving to racing on the command line: ramp, identify, lookup check --raceline."""

import json
import struct

import numpy as np
import pytest
from rosbags.rosbag1 import Reader, Writer
from rosbags.typesys import Stores, get_typestore

from map_racing.bags.messages import decode_drive
from map_racing.bags.reader import read_recording, read_signals
from map_racing.bags.topics import DRIVE_TOPIC
from map_racing.cli import main
from map_racing.control.parameters import load_controller_parameters, load_safety_limits
from map_racing.identification.data import load_run
from map_racing.resources import config_directory
from map_racing.simulation.plants import load_plant
from map_racing.vehicle.lookup import load_table
from map_racing.vehicle.parameters import load_vehicle, parameter_hash
from map_racing.vehicle.steady_state import steady_state_table


@pytest.fixture(scope="module")
def identified(tmp_path_factory):
    """Results for the shipped recording, with every possible output."""
    folder = tmp_path_factory.mktemp("identified")
    arguments = ["nuc4_ramps", "--vehicle", "nuc4", "--output", str(folder / "my_car.yaml")]
    for option, name in (
        ("--json", "r.json"),
        ("--plots", "figures"),
        ("--linear-output", "l.yaml"),
    ):
        arguments += [option, str(folder / name)]
    # Left by an earlier call with more recordings.
    (folder / "figures").mkdir()
    for number in (1, 2, 11):
        (folder / "figures" / f"run_{number}.png").write_text("old")
    assert main(["identify", *arguments]) == 0
    return folder


def test_vehicle_and_table_are_a_pair(identified):
    vehicle, table = load_vehicle(identified / "my_car.yaml"), load_table(identified / "my_car.csv")
    assert vehicle.name == "my_car" == table.provenance.vehicle
    assert table.provenance.parameter_hash == parameter_hash(vehicle)
    expected = steady_state_table(vehicle, table.speeds, table.angles).a_lat
    np.testing.assert_allclose(table.a_lat, expected)
    head = (identified / "my_car.yaml").read_text().splitlines()[:4]
    assert all(line.startswith("# ") for line in head)
    assert "nuc4_ramps.bag" in head[1] and "peak reached in front" in head[2]
    assert load_vehicle(identified / "l.yaml").front.model == "linear"


def test_figures_and_report(identified):
    names = {path.name for path in (identified / "figures").iterdir()}
    assert names == {
        *("tires.png", "coverage.png", "prediction.png", "run_1.png"),
        *("lookup_surface.png", "lookup_curves.png"),
    }
    report = json.loads((identified / "r.json").read_text())
    assert report["vehicle"] == "my_car" and report["leave_one_out"] is None
    assert report["axles"]["front"]["peak_reached"] and not report["axles"]["rear"]["peak_reached"]


@pytest.mark.once
def test_doubts_stand_in_report_and_vehicle_file(identified, tmp_path, monkeypatch):
    report = json.loads((identified / "r.json").read_text())
    (said,) = report["notes"]
    assert said.startswith("recordings/nuc4_ramps.bag: pose: /car_state/odom")
    assert "warning" not in (identified / "my_car.yaml").read_text()

    def doubtful(path, channels):
        run = load_run(path, channels)
        run.notes.append("warning: /drive: the stamps are from another clock")
        return run

    monkeypatch.setattr("map_racing.cli.identify.load_run", doubtful)
    output = tmp_path / "a.yaml"
    arguments = ["--vehicle", "nuc4", "--output", str(output), "--json", str(tmp_path / "r.json")]
    assert main(["identify", "nuc4_ramps", *arguments]) == 0
    doubt = "recordings/nuc4_ramps.bag: warning: /drive: the stamps are from another clock"
    assert f"# {doubt}\n" in output.read_text()
    assert doubt in json.loads((tmp_path / "r.json").read_text())["notes"]
    assert load_vehicle(output).front == load_vehicle(identified / "my_car.yaml").front


def test_what_a_fix_would_repair_stands_in_the_vehicle_file(identified, tmp_path, monkeypatch):
    """A yaw rate 10 % too small is not refused, but makes the tires doubtful."""
    assert "check: " not in (identified / "my_car.yaml").read_text()

    def scaled(path, channels):
        run = load_run(path, channels)
        rate = run.signals["yaw_rate"]
        run.signals["yaw_rate"] = rate._replace(value=0.9 * rate.value)
        return run

    monkeypatch.setattr("map_racing.cli.identify.load_run", scaled)
    output = tmp_path / "a.yaml"
    assert main(["identify", "nuc4_ramps", "--vehicle", "nuc4", "--output", str(output)]) == 0
    (said,) = [line for line in output.read_text().splitlines() if line.startswith("# check: yaw")]
    assert "yaw rate" in said and "--fix would set yaw_rate_scale" in said


def test_the_example_is_as_the_plant(identified):
    """The shipped recording is from the plant nuc4, whose tires differ from its vehicle file."""
    found, nominal = load_vehicle(identified / "my_car.yaml"), load_vehicle("nuc4")
    force = [car.front.normalized_force(0.1) for car in (found, nominal)]
    # 0.98 of the friction, 0.92 of the stiffness
    stretched = 0.98 * nominal.front.normalized_force(0.092)
    assert force[0] == pytest.approx(stretched, rel=0.035) and force[0] < 0.97 * force[1]


def test_a_known_delay_of_the_steering_takes_its_bias_away(identified, tmp_path):
    """Delay and lag of the plant are 50 ms in total, in which this ramp's angle rises by 2 mrad."""
    output = tmp_path / "a.yaml"
    arguments = ["nuc4_ramps", "--vehicle", "nuc4", "--output", str(output)]
    assert main(["identify", *arguments, "--steering-delay", "0.05"]) == 0
    expected = 0.98 * load_vehicle("nuc4").front.normalized_force(0.092)
    errors = [
        abs(load_vehicle(path).front.normalized_force(0.1) / expected - 1.0)
        for path in (output, identified / "my_car.yaml")
    ]
    assert errors[0] < 0.015 and errors[0] < 0.6 * errors[1]


def test_race_with_the_result(identified, capsys):
    arguments = ["--vehicle", str(identified / "my_car.yaml"), "--laps", "1"]
    assert main(["race", *arguments, "--output", str(identified / "race.bag")]) == 0
    assert "completed after 1 timed lap," in capsys.readouterr().out


def test_corners_of_a_raceline(identified, refused, capsys):
    table = str(identified / "my_car.csv")
    assert main(["lookup", "check", table, "--raceline", "reference"]) == 0
    printed = capsys.readouterr().out
    assert printed.count("exceeds the table's limit at") == 5
    assert "s = 11.6 m, left, radius 1.00 m: exceeds the table's limit at 2.2" in printed
    assert "the raceline can be driven at up to 7" in printed
    assert "nowhere" in refused("lookup", "check", table, "--raceline", "nowhere")


def test_ramp_is_driven_and_identified(tmp_path, capsys):
    bag = tmp_path / "ramp.bag"
    arguments = ["--speed", "3.5", "--rate", "0.05", "--output", str(bag)]
    assert main(["ramp", *arguments]) == 0
    assert "nuc4 at 3.5 m/s, 0.1 to 0.4 rad" in capsys.readouterr().out
    assert read_recording(bag).commands.steering_angle.max() == pytest.approx(0.4, abs=1e-3)
    output = tmp_path / "a.yaml"
    arguments = [str(bag), "--vehicle", "nuc4", "--output", str(output), "--name", "fast"]
    assert main(["identify", *arguments, "--front-force", "paper", "--cutoff", "1.5"]) == 0
    printed = capsys.readouterr().out
    assert "front axle:" in printed and "understeer gradient" in printed
    assert "divided by the cosine" in printed and load_vehicle(output).name == "fast"


def test_csv_with_a_map_fix_and_leave_one_out(ramps_csv, tmp_path, refused, capsys):
    first, second, channels = ramps_csv
    output = tmp_path / "a.yaml"
    arguments = ["identify", first, second, "--vehicle", "nuc4", "--output", output]
    assert "expected a channel map" in refused(*arguments)
    arguments += ["--channels", channels]
    line = refused(*arguments)
    assert "its sign is wrong" in line and "--fix applies that" in line
    assert not output.exists()
    assert main([str(a) for a in (*arguments, "--fix", "--leave-one-out")]) == 0
    printed = capsys.readouterr().out
    assert "    lateral_scale: -1" in printed and "each run, from the others" in printed
    assert "corrected: lateral acceleration: a_y is -1.0" in printed


@pytest.fixture(scope="module")
def ramps_csv(tmp_path_factory):
    """Two drives as CSV files, with the accelerometer pointing right, and their channel map."""
    folder = tmp_path_factory.mktemp("csv")
    paths = []
    for speed in ("2.5", "4"):
        bag = folder / f"{speed}.bag"
        options = ["--speed", speed, "--rate", "0.05", "--output", str(bag)]
        assert main(["ramp", *options]) == 0
        recording = read_recording(bag)
        t, imu = read_signals(bag, recording, {"imu": ""})["imu"]
        a_y = np.interp(recording.t, t, imu["a_y"])
        rows = np.column_stack(
            (recording.t, recording.x, recording.y, recording.psi, recording.v_x)
            + (recording.yaw_rate, -a_y, recording.commands.steering_angle)
        )
        paths.append(folder / f"{speed}.csv")
        header = "t,x,y,yaw,v,gyro,ay,delta"
        np.savetxt(str(paths[-1]), rows, delimiter=",", header=header, comments="")
    channels = folder / "map.yaml"
    channels.write_text(
        "time: t\nx: x\ny: y\npsi: yaw\nv_x: v\nyaw_rate: gyro\na_y: ay\nsteering: delta\n"
    )
    return (*paths, channels)


def test_refusals(tmp_path, refused, capsys):
    bag, good = tmp_path / "a.bag", ["--vehicle", "nuc4", "--output", tmp_path / "a.yaml"]
    assert main(["race", "--laps", "1", "--output", str(bag)]) == 0
    capsys.readouterr()
    for arguments, expected in (
        ((tmp_path / "none.bag", *good), "no such file, nor one of the shipped recordings"),
        (
            (bag, "--vehicle", "nuc4", "--output", tmp_path / "a.csv"),
            "expected a vehicle file (.yaml)",
        ),
        ((bag, "--vehicle", "nowhere", "--output", tmp_path / "a.yaml"), "nowhere"),
        ((bag, *good, "--servo-topic", "/servo"), "/servo: expected messages"),
        ((bag, *good, "--servo-offset", "0.5"), "--servo-offset: expected --servo-topic"),
        ((bag, *good, "--servo-topic", "/servo", "--servo-gain", "0"), "--servo-gain"),
        ((bag, *good, "--steering-delay", "-1"), "steering_delay_s: expected"),
        ((bag, *good, "--cutoff", "-1"), "cutoff_hz: expected a positive number"),
        ((bag, *good, "--channels", "nowhere"), "nor one of the shipped channels"),
        ((bag, *good, "--pose-topic", "/nowhere"), "/nowhere"),
        ((bag, *good, "--leave-one-out"), "--leave-one-out: expected steady cornering"),
        ((bag, *good, "--validate", bag), "--validate: expected recordings that the car is not"),
    ):
        assert expected in refused("identify", *arguments)
    assert list(tmp_path.iterdir()) == [bag]
    ramp = ["ramp", "--output", tmp_path / "b.bag"]
    for option, value, expected in (
        ("--speed", "-1", "speed_mps: expected a positive number"),
        ("--rate", "1e-6", "--rate: expected a drive of at most an hour"),
        ("--sides", "up", "sides: expected both or left or right"),
        ("--plant", "nowhere", "nowhere"),
    ):
        assert expected in refused(*ramp, option, value)
    assert list(tmp_path.iterdir()) == [bag]


@pytest.mark.parametrize("ramps", [True, pytest.param(False, marks=pytest.mark.once)])
def test_laps_make_a_car(tmp_path, capsys, ramps):
    """Steady cornering gives the tire curves, laps the changes of the day; each alone is enough."""
    bag = tmp_path / "laps.bag"
    race = ["race", "--laps", "1", "--speed-scale", "0.7", "--output", str(bag)]
    assert main(race) == 0
    true = load_plant("nuc4").build_vehicle()
    controller = tmp_path / "controller.yaml"
    output, report = tmp_path / "car.yaml", tmp_path / "report.json"
    arguments = [*(["nuc4_ramps"] if ramps else []), str(bag), "--vehicle", "nuc4"]
    arguments += ["--output", str(output), "--json", str(report)]
    arguments += ["--controller-output", str(controller)]
    assert main(["identify", *arguments]) == 0
    printed = capsys.readouterr().out
    found = load_vehicle(output)
    assert found.mu * found.front.stiffness == pytest.approx(
        true.mu * true.front.stiffness, rel=0.05
    )
    laps = json.loads(report.read_text())["laps"]
    friction = laps["parameters"]["friction"]
    head = output.read_text().split("name:")[0]
    assert "ordinary driving" in printed and "ordinary driving" in head
    assert f"friction at least {laps['least_friction']:.3f}" in head
    assert f"Friction: {friction['value']:.3f} (95 %" in head
    assert laps["delays"]["delay_s"] == pytest.approx(0.07, abs=0.008)
    assert load_table(output.with_suffix(".csv")).provenance.parameter_hash == parameter_hash(found)
    changed = load_controller_parameters("map").with_(delay_s=round(laps["delays"]["delay_s"], 4))
    assert load_controller_parameters(controller) == changed
    assert "front axle:" in printed
    grips = 2 if ramps else 1
    assert head.count("Grip demonstrated: ") == head.count("friction at least ") == grips
    assert load_safety_limits(controller) == load_safety_limits("map")


def test_a_car_is_validated_by_replay(tmp_path, identified, capsys, refused):
    bag, output, report = tmp_path / "a.bag", tmp_path / "car.yaml", tmp_path / "report.json"
    race = ["race", "--laps", "1", "--speed-scale", "0.6", "--output", str(bag)]
    assert main(race) == 0
    arguments = ["nuc4_ramps", "--vehicle", "nuc4", "--output", str(output), "--json", str(report)]
    capsys.readouterr()
    assert main(["identify", *arguments, "--validate", str(bag), "--window", "1.5"]) == 0
    validation = json.loads(report.read_text())["validation"]
    assert validation["window_s"] == 1.5 and validation["worst_share"] < 0.12
    assert f"Validated by replay: {validation['headline']}" in output.read_text()
    assert validation["headline"] in capsys.readouterr().out
    (run,) = validation["runs"]
    assert run["channels"]["yaw_rate"]["share"] < 0.04

    check = ["lookup", "check", identified / "my_car.csv"]
    vehicle = ["--vehicle", identified / "my_car.yaml"]
    assert main([*map(str, [*check, *vehicle]), "--bag", str(bag)]) == 0
    printed = capsys.readouterr().out
    assert "replay by the commands alone, worst channel of 1 run" in printed
    assert "s of dead time and lag, fitted with my_car's tires held" in printed
    assert "expected --vehicle" in refused(*check, "--bag", bag)
    assert "--window: expected" in refused(*check, *vehicle, "--bag", bag, "--window", "0")


@pytest.mark.once
def test_a_servos_position_is_the_steering_angle(tmp_path, capsys, servo_bag):
    output = tmp_path / "a.yaml"
    arguments = ["--vehicle", "nuc4", "--output", str(output)]
    arguments += ["--servo-topic", "/servo", "--servo-gain", "-1.2", "--servo-offset", "0.5"]
    assert main(["identify", str(servo_bag), *arguments, "--json", str(tmp_path / "r.json")]) == 0
    report = json.loads((tmp_path / "r.json").read_text())
    (steering,) = [finding for finding in report["findings"] if finding["check"] == "steering"]
    assert not steering["fix"]  # gain and offset were right


@pytest.fixture
def servo_bag(tmp_path):
    """The shipped drive with the servo's position instead of the drive command."""
    types = get_typestore(Stores.ROS1_NOETIC)
    source = config_directory() / "recordings" / "nuc4_ramps.bag"
    definition, md5sum = types.generate_msgdef("std_msgs/msg/Float64")
    with Reader(source) as reader, Writer(tmp_path / "servo.bag") as writer:
        connections = {
            c.id: writer.add_connection(c.topic, c.msgtype, msgdef=text(c.msgdef), md5sum=c.digest)
            for c in reader.connections
            if c.topic != DRIVE_TOPIC
        }
        servo = writer.add_connection(
            "/servo", "std_msgs/msg/Float64", msgdef=definition, md5sum=md5sum
        )
        for connection, time, data in reader.messages():
            if connection.topic == DRIVE_TOPIC:
                angle = decode_drive([bytes(data)])[1][0, 0]
                writer.write(servo, time, struct.pack("<d", -1.2 * angle + 0.5))
            else:
                writer.write(connections[connection.id], time, data)
    return tmp_path / "servo.bag"


def text(definition):
    """Text of a message definition, however rosbags represents it."""
    return getattr(definition, "data", definition)


def test_a_ramp_beyond_the_cars_steering_is_refused(tmp_path, refused):
    arguments = ("ramp", "--limit", "3", "--output", tmp_path / "ramp.bag")
    assert "0.4189 rad, as far as the car steers" in refused(*arguments)


def test_nothing_is_written_where_figures_cannot_be(tmp_path, refused):
    (tmp_path / "figures").write_text("")
    arguments = ("nuc4_ramps", "--vehicle", "nuc4", "--output", tmp_path / "car.yaml")
    assert "figures" in refused("identify", *arguments, "--plots", tmp_path / "figures")
    assert [path.name for path in tmp_path.iterdir()] == ["figures"]
