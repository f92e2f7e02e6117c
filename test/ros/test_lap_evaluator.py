"""The live evaluator: the same laps as from the recording, however the messages arrive."""

import csv
import math
import signal
import time

import pytest
import rosgraph
from harness import wait_for
from map_racing.msg import LapResult
from visualization_msgs.msg import MarkerArray

from map_racing.bags.topics import DRIVE_TOPIC
from map_racing.bags.writer import BagWriter
from map_racing.control.controller import build_controller
from map_racing.control.parameters import load_controller_parameters
from map_racing.evaluation.recordings import load_recording, recorded_raceline
from map_racing.evaluation.runs import evaluate
from map_racing.nodes.waypoints import waypoint_array_class
from map_racing.simulation.plant import Localization, Plant
from map_racing.simulation.plants import load_plant
from map_racing.simulation.race import race
from map_racing.simulation.recorded import write_race_bag
from map_racing.track.files.load import load_raceline
from map_racing.track.files.waypoints import waypoint_rows
from map_racing.vehicle.parameters import load_vehicle

REMAPS = {"odom": "/car_state/odom", "pose": "/car_state/pose", "drive": DRIVE_TOPIC}
# The evaluator without the visualizer.
ALONE = {"visualize": "false"}
SAME = 1e-6
T0 = 1600000000.0


@pytest.fixture(scope="module")
def log():
    """Two timed laps of the reference track."""
    line, plant = load_raceline("reference"), load_plant("nuc4")
    parameters = load_controller_parameters("map").with_(speed_scale=0.8)
    controller = build_controller(parameters, load_vehicle("nuc4"), line)
    return race(Plant(plant), controller, line, Localization(plant, seed=1), laps=2)


@pytest.fixture(scope="module")
def race_bag(log, tmp_path_factory):
    path = tmp_path_factory.mktemp("bag") / "race.bag"
    write_race_bag(path, log, load_raceline("reference"))
    return path


def all_rows(path):
    """Laps in the file that the node writes, as text."""
    with open(path) as file:
        return list(csv.DictReader(file))


def rows(path, run=1):
    """Laps of a run in the file that the node writes, numbers as numbers."""

    def value(text):
        try:
            return float(text) if text else math.nan
        except ValueError:
            return text

    table = all_rows(path)
    return [{k: value(v) for k, v in row.items()} for row in table if int(row["run"]) == run]


def offline(path, **options):
    recording = load_recording(path)
    carried = recording.waypoints is not None
    raceline = recorded_raceline(recording) if carried else load_raceline("reference")
    result = evaluate(recording, raceline, **options)
    return [lap.row() for lap in result.laps]


def differences(laps, others):
    """Largest numeric differences of two lists of laps by column; texts must be equal."""
    assert [row["lap"] for row in laps] == [row["lap"] for row in others]
    largest = {}
    for row, other in zip(laps, others):
        for name, expected in other.items():
            got = row[name]
            if isinstance(expected, float):
                difference = 0.0 if got != got and expected != expected else abs(got - expected)
                largest[name] = max(largest.get(name, 0.0), difference)
            elif not isinstance(expected, int):
                assert (got if got == got else "") == expected, name
    return largest


def assert_same(laps, others):
    largest = differences(laps, others)
    print("largest differences", {name: f"{value:.1e}" for name, value in largest.items()})
    assert max(largest.values()) <= SAME, largest


@pytest.fixture
def evaluator(start):
    """Start the node, and wait until it has subscribed to its last topic."""

    def run(params, remaps=REMAPS):
        node = start("lap_evaluator", params, remaps)
        topic = remaps[params.get("pose_source", "odom")]
        master = rosgraph.Master("/test")
        wait_for(
            lambda: any(
                name == topic and "/lap_evaluator" in nodes
                for name, nodes in master.getSystemState()[1]
            ),
            what=f"the node to subscribe to {topic}",
        )
        return node

    return run


def playing(processes, bag, rate=20):
    """Start playing a bag."""
    # A long queue for a busy computer: nothing may be lost.
    options = ["--quiet", "--clock", "--queue=10000", "--delay=1", f"--rate={rate}"]
    return processes(["rosbag", "play", *options, bag])


def play(processes, bag):
    """Play a bag to its end."""
    player = playing(processes, bag)
    assert player.wait(120.0) == 0, player.output


def stop(node):
    """End the node as roslaunch does, after it has had time to read all messages."""
    time.sleep(1.0)
    assert node.stop() == 0, node.output
    return node.output


def test_replay_is_offline(race_bag, evaluator, processes, tmp_path):
    node = evaluator({"csv": str(tmp_path / "laps.csv")})
    play(processes, race_bag)
    output = stop(node)
    assert_same(rows(tmp_path / "laps.csv"), offline(race_bag))
    assert "2 laps counted, 2 stretches not" in output


def test_live_is_replay_is_offline(launch, listen, tmp_path):
    """The lap of a simulated race: live, from a replay of its bag, and offline."""
    table = tmp_path / "live.csv"
    # On a busy computer, late poses would stop the car, and commands come later than laps wait for
    # them: so time waits for the controller, and laps wait longer.
    rosgraph.Master("/test").setParam("/lap_evaluator/patience", 30.0)
    record = {"record": "true", "record_to": tmp_path / "race"}
    paced = {"clock_rate": 2, "lockstep": "true"}
    race = launch("simulate.launch", speed_scale=0.8, csv=table, **record, **paced, **ALONE)
    listen("/lap_result", LapResult).wait(lambda result: result.laps_completed == 1, 90.0)
    time.sleep(1.0)
    # Longer than roslaunch waits before it kills a node, so that it can name the node.
    assert race.stop(30.0) == 0, race.output
    assert "escalating" not in race.output, race.output
    (bag,) = tmp_path.glob("race*.bag")
    expected = offline(bag)
    assert [row["valid"] for row in expected] == [False, True, False]
    assert expected[1]["speed_reference"] == "command"
    # Recorder and node did not begin and end with the same pose: only complete laps can be equal,
    # with times relative to their beginnings.
    assert_same([relative(rows(table)[1])], [relative(expected[1])])

    table = tmp_path / "replay.csv"
    replay = launch("replay.launch", bag=bag, rate=10, csv=table, **ALONE)
    replay.wait(90.0)
    assert_same(rows(table), expected)


def test_a_replay_without_stamps_is_offline(log, launch, tmp_path):
    """Poses and commands with stamp 0: times are those of receipt, to the nanosecond."""
    bag, table = tmp_path / "race.bag", tmp_path / "laps.csv"
    line = load_raceline("reference")
    with BagWriter(bag) as writer:
        writer.waypoints(T0, waypoint_rows(line), received=T0)
        for sample in log.samples:
            at, (x, y, psi), v = T0 + sample.measured.t, sample.measured[1:4], sample.measured.v_x
            command = sample.result.steering_angle, sample.result.speed
            writer.odometry(0, x, y, psi, v, 0.0, 0.0, received=at)
            writer.drive(0, *command, received=at + 0.004)
    replay = launch("replay.launch", bag=bag, rate=20, csv=table, **ALONE)
    replay.wait(90.0)
    expected = offline(bag)
    assert [row["valid"] for row in expected] == [False, True, True, False]
    assert expected[1]["speed_reference"] == "command"
    assert_same(rows(table), expected)
    assert "stamps missing or from another clock" in replay.output


def relative(row):
    """A lap without its position in the run."""
    return {name: v for name, v in row.items() if name not in ("start_time_s", "end_time_s")}


def test_recorded_laps_of_the_public_stack(shared_data, evaluator, processes, tmp_path):
    """Waypoints of a message package that is not built here; each lap as offline."""
    bag, table = shared_data / "recordings" / "hangar_map_12laps.bag", tmp_path / "laps.csv"
    node = evaluator({"csv": str(table)})
    play(processes, bag)
    output = stop(node)
    expected = offline(bag)
    assert sum(row["valid"] for row in expected) == 11
    assert_same(rows(table), expected)
    assert "11 laps counted" in output


def test_a_bag_in_a_loop_is_run_after_run(race_bag, launch, listen, tmp_path):
    table = tmp_path / "laps.csv"
    results = listen("/lap_result", LapResult)
    replay = launch("replay.launch", bag=race_bag, rate=10, loop="true", csv=table, **ALONE)
    results.wait(lambda result: result.run == 3 and result.lap == 1, 60.0)
    expected = offline(race_bag)
    for run in (1, 2):
        assert_same(rows(table, run), expected)
        assert [r.lap for r in results if r.run == run] == [0, 1, 2, 3]
    replay.stop()
    # The lap cut off by the shutdown is published, written and included in the summary, too.
    last = max(int(row["run"]) for row in all_rows(table))
    written = [int(row["lap"]) for row in rows(table, last)]
    wait_for(lambda: [r.lap for r in results if r.run == last] == written, what="the last lap")
    assert written and "run 1" in replay.output and f"run {last}" in replay.output


def test_results_and_text_are_published_and_latched(race_bag, evaluator, processes, listen):
    node = evaluator({"sectors": 2})
    play(processes, race_bag)
    result = listen("/lap_result", LapResult).wait()
    markers = listen("/lap_markers", MarkerArray).wait().markers
    recording, lap = load_recording(race_bag), offline(race_bag, sectors=2)[2]
    assert (result.run, result.lap, result.valid, result.reason) == (1, 2, True, "")
    for name, value in lap.items():
        if not name.startswith("sector_"):
            told = getattr(result, name)
            assert told == value or (value != value and told != told), name
    assert list(result.sector_times_s) == [lap["sector_1_s"], lap["sector_2_s"]]
    assert abs(result.header.stamp.to_nsec() - recording.t0_ns - 1e9 * lap["end_time_s"]) <= 1
    assert result.header.frame_id == "map"
    assert result.laps_completed == 2
    assert result.best_lap_time_s == min(row["lap_time_s"] for row in offline(race_bag)[1:3])
    (marker,) = markers
    assert marker.text.startswith(f"lap 2: {lap['lap_time_s']:.3f} s\nbest ")
    assert node.running


def test_poses_without_twist_or_command(race_bag, evaluator, processes, tmp_path):
    table = tmp_path / "laps.csv"
    parameters = {"csv": str(table), "pose_source": "pose", "start_line": 5, "max_deviation": 1.5}
    node = evaluator(parameters, {**REMAPS, "drive": "/nobody"})
    play(processes, race_bag)
    stop(node)
    expected = offline(race_bag, start_s=5.0)
    laps = rows(table)
    for name in ("lap_time_s", "rms_lateral_error_m", "max_abs_lateral_error_m"):
        assert [row[name] for row in laps] == pytest.approx(
            [row[name] for row in expected], abs=SAME, nan_ok=True
        )
    assert laps[1]["speed_reference"] == "raceline"


def test_a_start_line_beyond_the_lap_is_refused(race_bag, evaluator, processes):
    node = evaluator({"start_line": 5000.0})
    play(processes, race_bag)
    stop(node)
    assert "start line: expected an arc length of at most" in node.output
    assert "Traceback" not in node.output and "lap 2" not in node.output


def test_what_makes_laps_doubtful_stands_beside_them(evaluator, processes, listen, tmp_path):
    """Poses in an odometry frame, and some in another frame in between."""
    bag, table = tmp_path / "odom.bag", tmp_path / "laps.csv"
    line, v = load_raceline("reference"), 6.0
    with BagWriter(bag) as writer:
        for i in range(int(2.2 * line.length / v * 40.0)):
            at, s = T0 + i / 40.0, v * i / 40.0 - 2.0
            x, y, psi, *_ = line.pose(s)
            writer.odometry(at, x, y, psi, v, 0.0, 0.0, frame="odom", received=at)
            if i % 5 == 1:
                writer.odometry(at + 0.01, x + 0.2, y, psi, v, 0.0, 0.0, received=at + 0.01)
    node = evaluator({"csv": str(table), "raceline": "reference"})
    results = listen("/lap_result", LapResult)
    play(processes, bag)
    output = stop(node)
    laps = rows(table)
    assert [row["valid"] for row in laps] == ["False", "True", "True", "False"]
    doubts = (
        "/car_state/odom is in frame odom, which drifts relative to the map: the lateral errors "
        "are "
        "not those on the track; /car_state/odom: messages in another frame, map, left out: only "
        "odom counts"
    )
    assert [row["warnings"] for row in laps] == [doubts] * 4
    assert {result.warnings for result in results} == {doubts}
    assert doubts in output
    assert all(row["rms_lateral_error_m"] < 1e-3 for row in laps[1:3])


def test_poses_that_are_in_the_map_only_later(evaluator, processes, tmp_path):
    """A new run begins, with the laps of the bag; those in the earlier frame were another run."""
    bag, table = tmp_path / "run.bag", tmp_path / "laps.csv"
    line, v = load_raceline("reference"), 6.0
    with BagWriter(bag) as writer:
        for i in range(int(4.2 * line.length / v * 40.0)):
            at, s = T0 + i / 40.0, v * i / 40.0 - 2.0
            x, y, psi, *_ = line.pose(s)
            frame = "odom" if s < 1.5 * line.length else "map"
            x += 0.4 if frame == "odom" else 0.0
            writer.odometry(at, x, y, psi, v, 0.0, 0.0, frame=frame, received=at)
    node = evaluator({"csv": str(table), "raceline": "reference"})
    play(processes, bag)
    output = stop(node)
    result = evaluate(load_recording(bag), line)
    laps = rows(table, 2)
    assert [row["valid"] for row in laps] == [str(lap.valid) for lap in result.laps]
    assert sum(lap.valid for lap in result.laps) == 2
    for row, lap in zip(laps, result.laps):
        assert row["rms_lateral_error_m"] == pytest.approx(lap.rms_lateral_error_m, abs=1e-6)
        assert "odom fell silent, and map took its place" in row["warnings"]
    assert any("odom fell silent, and map took its place" in said for said in result.warnings)
    assert "odom fell silent, and map took its place" in output


@pytest.mark.parametrize(
    ("name", "odom", "doubt"),
    [
        ("cmd_clock_1s_early.bag", "/car_state/odom", "the stamps are from another clock"),
        ("one_topic_two_frames.bag", "/odom", "messages in another frame, odom, left out"),
    ],
)
def test_recordings_that_went_wrong(
    shared_cases, evaluator, processes, tmp_path, name, odom, doubt
):
    """A lap takes 2 pi / 0.8 s, with d = 0.1 sin(3 theta); the speed is the one commanded."""
    table = tmp_path / "laps.csv"
    line = str(shared_cases / "circle.csv")
    remaps = {"odom": odom, "pose": "/pose", "drive": "/drive"}
    node = evaluator({"csv": str(table), "raceline": line}, remaps)
    play(processes, shared_cases / name)
    stop(node)
    laps = [row for row in rows(table) if row["valid"] == "True"]
    assert len(laps) == 5
    for lap in laps:
        assert lap["lap_time_s"] == pytest.approx(math.tau / 0.8, abs=1e-3)
        assert lap["rms_lateral_error_m"] == pytest.approx(0.1 / math.sqrt(2.0), abs=2e-4)
        assert doubt in lap["warnings"]
        if lap["speed_reference"] == "command":
            assert lap["rms_speed_error_mps"] < 0.1


def test_no_lap_is_lost_when_the_node_is_killed(race_bag, evaluator, processes, tmp_path):
    table = tmp_path / "laps.csv"
    node = evaluator({"csv": str(table)})
    play(processes, race_bag)
    wait_for(lambda: table.is_file() and len(rows(table)) == 3, what="the laps")
    node.signal(signal.SIGKILL)
    node.wait()
    assert_same(rows(table), offline(race_bag)[:3])


def test_what_was_sent_is_evaluated_before_the_end(race_bag, evaluator, processes, tmp_path):
    """The node, delayed as on a busy computer, has not read everything when it is told to end."""
    table = tmp_path / "laps.csv"
    node = evaluator({"csv": str(table)})
    player = playing(processes, race_bag, rate=10)
    wait_for(lambda: table.is_file() and len(rows(table)) == 1, what="the first lap")
    node.signal(signal.SIGSTOP)
    assert player.wait(120.0) == 0, player.output
    node.signal(signal.SIGINT)
    node.signal(signal.SIGCONT)
    assert node.wait() == 0
    assert_same(rows(table), offline(race_bag))


def test_waypoints_without_points_are_refused_and_later_ones_taken(start, advertise, ros):
    array, waypoint = waypoint_array_class()
    node = start("lap_evaluator")
    publisher = advertise("/global_waypoints", array)

    def told():
        publisher.publish(array())
        return "expected waypoints" in node.output

    # rospy drops what comes between its registration and that of the callback.
    wait_for(told)
    line = load_raceline("reference")
    points = [waypoint(x_m=x, y_m=y, vx_mps=3.0) for x, y in zip(line.x, line.y)]
    publisher.publish(array(wpnts=points))
    wait_for(lambda: "raceline global_waypoints" in node.output)
    assert f"raceline global_waypoints, {line.length:.2f} m" in node.output


@pytest.mark.parametrize(
    ("parameters", "text"),
    [
        ({"raceline": "nowhere"}, "nowhere: no such file"),
        ({"pose_source": "gps"}, "expected odom or pose, got 'gps'"),
        ({"sectors": "three"}, "~sectors: expected int, got 'three'"),
        ({"car_width": -1.0}, "car width: expected 0 to 10 m, got -1"),
        ({"csv": "/nowhere/laps.csv"}, "/nowhere/laps.csv: cannot write"),
    ],
)
def test_what_cannot_be_is_one_line(parameters, text, refused):
    assert text in refused("lap_evaluator", parameters)
