"""Names of files, and names in them, cannot affect the terminal."""

import pytest

from map_racing.bags.cdr import connection_of
from map_racing.bags.writer import BagWriter
from map_racing.cli import main
from map_racing.track.files.waypoints import waypoint_rows

ESCAPE, LINE = "\x1b[2J\x07\x9b1m\u202e", "\nall laps count"
NASTY = ESCAPE + LINE
T0 = 1600000000.0
HARMLESS = {"\n", "\t"}


@pytest.fixture
def folder(tmp_path):
    path = tmp_path / f"day{NASTY}"
    path.mkdir()
    return path


@pytest.fixture
def bag(folder, track):
    """A race with nasty names throughout."""
    path = folder / f"race{NASTY}.bag"
    with BagWriter(path) as bag:
        bag.waypoints(T0, waypoint_rows(track.raceline(speed=5.0, walls=1.0)))
        for i in range(int(2.5 * track.length / 5.0 * 40.0)):
            t = T0 + 0.025 * i
            x, y, psi = (float(value) for value in track.place(5.0 * 0.025 * i - 3.0, 0.1))
            for k in range(2):
                frame = f"map{NASTY}" if k == 0 or i % 2 else f"odom{NASTY}"
                bag.odometry(*(t, x, y, psi, 5.0, 0.1, 0.2), topic=f"/odom{k}{NASTY}", frame=frame)
            bag.drive(t, 0.05, 5.0)
    return path


@pytest.fixture
def printed(capfd):
    """Run a command; all that it prints."""

    def run(*words):
        code = main([str(word) for word in words])
        out = "".join(capfd.readouterr())
        bad = {c for c in out if not c.isprintable()} - HARMLESS
        assert not bad, (bad, out)
        assert "\nall laps count" not in out, out
        return code, out

    return run


def test_bags(bag, printed, tmp_path):
    code, out = printed("evaluate", bag, "--csv", tmp_path / "laps.csv")
    assert code == 0 and r"race\x1b[2J" in out and r"/odom0\x1b[2J" in out
    # The evaluation chose one of two topics, and the message names both.
    assert r"/odom1\x1b[2J\x07\x9b1m\u202e\nall laps count" in out
    assert printed("report", bag, "--output", tmp_path / "report.html")[0] == 0
    assert printed("raceline", "record", bag, "--output", tmp_path / "line.csv")[0] == 0
    assert printed("raceline", "check", bag)[0] in (0, 1)
    car = tmp_path / "car.yaml"
    for command in (("identify", "--vehicle", "nuc4", "--output", car), ("delay",)):
        assert r"\x1b[2J" in printed(*command, bag)[1]


def test_a_season(bag, printed, tmp_path):
    (bag.parent / f"broken{NASTY}.bag").write_bytes(b"#ROSBAG V2.0\n")
    code, out = printed("season", bag.parent, "--output", tmp_path / "season")
    assert r"broken\x1b[2J" in out


@pytest.mark.parametrize("command", ["evaluate", "raceline check"])
def test_columns(folder, printed, command):
    path = folder / f"line{NASTY}.csv"
    path.write_text(f'"x{NASTY}","y{ESCAPE}"\n1,2\n3,a{ESCAPE}\n', encoding="utf-8")
    code, out = printed(*command.split(), path)
    assert code == 1 and r"\x1b[2J" in out


def test_vehicles_and_options(folder, printed):
    path = folder / f"car{NASTY}.yaml"
    path.write_text('"a\\e[2J": 1\nname: "b\\e[2J"\n')
    code, out = printed("lookup", "generate", "--vehicle", path, "--output", folder / "table.csv")
    assert code == 1 and r"\x1b[2J" in out
    code, out = printed("race", "--track", f"none{NASTY}", "--output", folder / "a.bag")
    assert code == 1 and r"none\x1b[2J" in out


def test_a_topic_is_chosen_by_what_was_printed(bag, printed):
    name = r"/odom1\x1b[2J\x07\x9b1m\u202e\nall laps count"
    code, out = printed("evaluate", bag, "--pose-topic", name)
    assert code == 0 and name in out


def test_topics_of_ros_2():
    connection = connection_of(f"/odom{ESCAPE}", "nav_msgs/msg/Odometry", "")
    assert connection.topic == r"/odom\x1b[2J\x07\x9b1m\u202e"
