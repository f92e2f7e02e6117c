"""Every launch file, for every stack; and three laps of simulate.launch."""

import json
import os
from xml.etree import ElementTree

import pytest
import rospy
from ackermann_msgs.msg import AckermannDriveStamped
from harness import wait_for
from layouts import TYPES
from map_racing.msg import LapResult
from roslaunch.arg_dump import get_args
from roslaunch.core import RLException

from map_racing.bags.remarks import read_remarks
from map_racing.cli import main
from map_racing.control.parameters import (
    load_controller_parameters,
    save_controller_parameters,
)
from map_racing.control.settings import parse_settings
from map_racing.errors import ParameterError
from map_racing.evaluation.recordings import load_recording
from map_racing.nodes.launched import check_launch_arguments
from map_racing.resources import config_directory
from map_racing.vehicle.parameters import load_vehicle

STACKS = {
    "race_stack": ("/car_state/odom", "/vesc/high_level/ackermann_cmd_mux/input/nav_1"),
    "f1tenth_system": ("/pf/pose/odom", "/vesc/high_level/ackermann_cmd_mux/input/nav_0"),
    "f1tenth_simulator": ("/odom", "/drive"),
}
NEEDED = {"replay": ["bag:=run.bag"], "identify": []}
# Start only the nodes that a test is about: each takes most of a second.
BARE = {"evaluate": "false", "visualize": "false"}
EVALUATED = {"visualize": "false"}
MAIN_NODE = {
    "simulate": "simulator",
    "race": "controller",
    "replay": "lap_evaluator",
    "identify": "steering_ramp",
    "rviz": "rviz",
}


@pytest.fixture
def config_of(folder):
    """``config_of("race", "stack:=race_stack")``: nodes and parameters, as roslaunch reads them."""
    from roslaunch.config import ROSLaunchConfig
    from roslaunch.xmlloader import XmlLoader

    def load(file, *arguments):
        config = ROSLaunchConfig()
        path = str(folder / f"{file}.launch")
        XmlLoader(resolve_anon=False).load(path, config, argv=arguments, verbose=False)
        return config

    return load


@pytest.fixture
def nodes_of(config_of):
    """``nodes_of("race", "stack:=race_stack")``: what roslaunch would start."""

    def load(file, *arguments):
        return {node.name: node for node in config_of(file, *arguments).nodes}

    return load


@pytest.fixture(scope="module")
def folder(request):
    return request.config.rootpath / "launch"


def test_every_argument_is_documented(folder):
    files = sorted(folder.rglob("*.launch"))
    assert {file.stem for file in files} == {*MAIN_NODE, "nodes"}
    for file in files:
        for argument in ElementTree.parse(file).getroot().iter("arg"):
            # Arguments with a value are passed on or computed, and cannot be set.
            if "value" not in argument.attrib:
                assert argument.get("doc"), f"{file.name}: {argument.get('name')}"


def test_every_argument_that_counts_is_listed(folder):
    """roslaunch --ros-args lists only what a file itself declares."""
    topics = {"odom", "pose", "drive", "waypoints"}
    expected = {
        "race": {*topics, "imu", "reference_point", "vehicle", "car_width"},
        "simulate": {*topics, "imu", "vehicle", "car_width"},
        "replay": {*topics, "vehicle", "car_width"},
        "identify": {"odom", "drive", "imu", "joy", "vehicle"},
    }
    for file, names in expected.items():
        own = ElementTree.parse(folder / f"{file}.launch").getroot().findall("arg")
        assert names <= {argument.get("name") for argument in own}, file
        # Arguments that cannot be set are not listed.
        assert not [argument.get("name") for argument in own if "value" in argument.attrib]
        listed = get_args([str(folder / f"{file}.launch")])
        assert names <= set(listed), file


@pytest.mark.parametrize("stack", STACKS)
@pytest.mark.parametrize("file", MAIN_NODE)
def test_every_file_for_every_stack(nodes_of, file, stack):
    stacked = [] if file == "rviz" else [f"stack:={stack}"]
    assert MAIN_NODE[file] in nodes_of(file, *stacked, *NEEDED.get(file, []))


def test_laps_and_drawing_are_of_the_car_that_is_named(config_of):
    def values(file, *arguments):
        params = config_of(file, *NEEDED.get(file, []), *arguments).params
        names = "/lap_evaluator/car_width", "/lookahead_visualizer/vehicle"
        return tuple(params[name].value for name in names)

    for file in ("race", "simulate", "replay"):
        assert values(file) == (0.3, "nuc4")
        assert values(file, "vehicle:=car.yaml", "car_width:=0.2") == (0.2, "car.yaml")
    assert values("simulate", "plant:=bmw_320i") == (load_vehicle("bmw_320i").width, "bmw_320i")


def test_a_misspelled_argument_is_refused(launch):
    """roslaunch ignores it, and the car would drive at the speed of the controller's file."""
    race = launch("race.launch", speedscale=0.3)
    race.wait(60.0)
    told = "lists, got speedscale (like speed_scale)"
    assert told in race.output and "Traceback" not in race.output


@pytest.mark.parametrize("file", MAIN_NODE)
def test_arguments_that_a_file_has_are_not_refused(folder, file):
    words = ["/usr/bin/python3", "/opt/ros/noetic/bin/roslaunch", "--wait", "map_racing"]
    words.append(f"{file}.launch")
    own = ElementTree.parse(folder / f"{file}.launch").getroot().findall("arg")
    check_launch_arguments([*words, *(f"{one.get('name')}:=1" for one in own), "__ns:=a"])
    with pytest.raises(ParameterError, match=f"roslaunch {file}.launch: .* got nonsense"):
        check_launch_arguments([*words, "nonsense:=1"])
    # Other launch files may have other arguments.
    check_launch_arguments([*words[:3], "my_car", "race.launch", "nonsense:=1"])
    check_launch_arguments([*words[:3], "my.launch", "nonsense:=1"])
    check_launch_arguments(["bash", "map_racing", f"{file}.launch", "nonsense:=1"])


@pytest.mark.parametrize(
    ("file", "word"),
    [("race", "drive_car:=false"), ("race", "drive_topic:=/drive"), ("rviz", "track:=club")],
)
def test_an_argument_that_does_not_count_is_refused(file, word):
    """A launch file overrides it, computes it or does not pass it on."""
    with pytest.raises(ParameterError, match=f"got {word.partition(':')[0]}"):
        check_launch_arguments(["roslaunch", "map_racing", f"{file}.launch", word])
    # An argument that is passed on counts.
    check_launch_arguments(["roslaunch", "map_racing", "race.launch", "evaluate:=false"])


def test_values_of_the_options_of_roslaunch_hide_no_misspelled_argument():
    for words in (
        ["-p", "11312", "map_racing", "race.launch", "speedscale:=0.3"],
        ["map_racing", "race.launch", "-p", "11312", "speedscale:=0.3"],
        ["map_racing", "-p", "11312", "race.launch", "speedscale:=0.3"],
    ):
        with pytest.raises(ParameterError, match="speedscale"):
            check_launch_arguments(["roslaunch", *words])
    check_launch_arguments(["roslaunch", "--help"])
    check_launch_arguments(["roslaunch"])


def test_another_stack_is_refused(nodes_of):
    text = "stack: expected race_stack, f1tenth_system or f1tenth_simulator, got autoware"
    with pytest.raises(RLException, match=text):
        nodes_of("race", "stack:=autoware")


@pytest.mark.parametrize("stack", ["f1tenth_system", "f1tenth_simulator"])
def test_topics_of_a_stack(launch, stack, listen, tmp_path):
    """And a saved controller keeps its speed unless the launch sets one."""
    from nav_msgs.msg import Odometry

    path = tmp_path / "tuned.yaml"
    save_controller_parameters(load_controller_parameters("map").with_(speed_scale=0.55), path)
    odom, drive = STACKS[stack]
    odometry, commands = listen(odom, Odometry), listen(drive, AckermannDriveStamped)
    car = {"plant": "public_simulator", "vehicle": "sim", "controller": path}
    race = launch("simulate.launch", stack=stack, clock_rate=3, **car, **BARE)
    odometry.wait(timeout=30.0)
    commands.wait(lambda m: m.drive.speed > 2.0, timeout=30.0)
    wait_for(lambda: "~speed_scale = 0.55" in race.output, 30.0)


def test_relative_paths_are_those_of_the_shell(roscore, processes, tmp_path):
    """Raceline, laps and bag; and a missing raceline ends the launch.

    With a custom topic.
    """
    track = config_directory() / "tracks" / "reference.csv"
    (tmp_path / "mine.csv").write_text(track.read_text())
    environment = {**os.environ, "PWD": str(tmp_path)}

    def run(track):
        command = ["roslaunch", "--wait", "map_racing", "race.launch", f"track:={track}"]
        options = ["record:=true", "record_to:=run", "csv:=laps.csv", "visualize:=false"]
        options.append("odom:=/my/odom")
        return processes(["env", "-C", tmp_path, *command, *options], environment)

    race = run("mine.csv")
    wait_for(lambda: "raceline of /global_waypoints: 36.54 m" in race.output, 30.0)
    wait_for(lambda: list(tmp_path.glob("run*.bag*")), 20.0)
    wait_for((tmp_path / "laps.csv").is_file, 20.0)
    wait_for(lambda: "no pose yet on /my/odom (nobody publishes it)" in race.output, 30.0)
    race.stop(30.0)
    other = run("other.csv")
    other.wait(60.0)
    assert "other.csv: no such file" in other.output


def test_a_missing_bag_is_one_line(launch, tmp_path):
    replay = launch("replay.launch", bag=tmp_path / "none.bag", **BARE)
    replay.wait(60.0)
    assert f"play: bag: {tmp_path / 'none.bag'}: no such file" in replay.output
    assert "Traceback" not in replay.output
    empty = tmp_path / "empty.bag"
    empty.touch()
    replay = launch("replay.launch", bag=empty, **BARE)
    replay.wait(60.0)
    assert f"play: {empty}: expected a ROS 1 bag (format 2.0), got an empty file" in replay.output
    assert "Error reading" not in replay.output


def test_a_replay_without_a_bag_or_a_place_for_its_laps_ends_with_the_reason(launch, tmp_path):
    replay = launch("replay.launch", **BARE)
    replay.wait(60.0)
    assert "play: bag: expected its name, got none" in replay.output
    bag = tmp_path / "run.bag"
    assert main(["race", "--laps", "1", "--output", str(bag)]) == 0
    replay = launch("replay.launch", bag=bag, csv=tmp_path / "none" / "laps.csv", **EVALUATED)
    replay.wait(120.0)
    assert f"{tmp_path / 'none' / 'laps.csv'}: cannot write: No such file" in replay.output
    assert "did not subscribe" not in replay.output and "no time on /clock" not in replay.output


def test_a_replay_of_other_topics_says_so(launch, tmp_path):
    """The bag of one stack on the topics of another."""
    bag = tmp_path / "run.bag"
    assert main(["race", "--laps", "1", "--output", str(bag)]) == 0
    replay = launch("replay.launch", bag=bag, rate=20, stack="f1tenth_system", **EVALUATED)
    replay.wait(60.0)
    assert "no poses on /pf/pose/odom: nothing was evaluated" in replay.output
    assert "run.bag: no pose on /pf/pose/odom: expected one of /car_state/odom" in replay.output


def laps_of(bag, report):
    """Valid laps of a bag, evaluated without ROS."""
    assert main(["evaluate", str(bag), "--json", str(report)]) == 0
    (run,) = json.loads(report.read_text())["runs"]
    return [lap for lap in run["laps"] if lap["valid"]]


def test_three_laps_as_in_the_core_recorded_in_a_bag_that_evaluates(launch, listen, tmp_path):
    bag, report = tmp_path / "core.bag", tmp_path / "core.json"
    assert main(["race", "--laps", "3", "--speed-scale", "0.7", "--output", str(bag)]) == 0
    expected = laps_of(bag, report)

    inbox = listen("/lap_result", LapResult)
    written = {"csv": tmp_path / "laps.csv", "record": "true", "record_to": tmp_path / "run"}
    process = launch("simulate.launch", clock_rate=4, lockstep="true", **written)
    inbox.wait(lambda lap: lap.laps_completed == 3, 90.0)
    # The layouts for plots show topics that really exist.
    sent = dict(rospy.get_published_topics())
    assert {topic: sent.get(topic) for topic in TYPES} == TYPES
    laps = [lap for lap in inbox if lap.valid]
    assert [lap.lap for lap in laps] == [1, 2, 3] and len(expected) == 3
    assert [lap.lap for lap in inbox if not lap.valid] == [0]
    for live, core in zip(laps, expected):
        assert live.lap_time_s == pytest.approx(core["lap_time_s"], rel=0.01)
        assert live.rms_lateral_error_m == pytest.approx(core["rms_lateral_error_m"], abs=0.01)
        assert live.max_abs_lateral_error_m < core["max_abs_lateral_error_m"] + 0.05
    # Each lap is in the file by the time it is published.
    assert len((tmp_path / "laps.csv").read_text().splitlines()) == 1 + len(inbox)

    process.stop(30.0)
    (bag,) = tmp_path.glob("run*.bag")
    # The bag has the settings, and what the report needs to know about the car.
    remarks = read_remarks(bag, load_recording(bag))
    settings = parse_settings(remarks.settings[-1][1])
    assert settings.controller is not None and settings.vehicle is not None
    assert "driving" in [text for _, text in remarks.states]
    # The recorder may begin late and end early: it has at least one of three laps.
    offline = laps_of(bag, report)
    assert offline
    for lap in offline:
        times = {abs(live.lap_time_s - lap["lap_time_s"]): live for live in inbox if live.valid}
        live = times[min(times)]
        assert lap["lap_time_s"] == pytest.approx(live.lap_time_s, abs=1e-6)
        assert lap["rms_lateral_error_m"] == pytest.approx(live.rms_lateral_error_m, abs=1e-6)
