"""Every command in README and pages runs, in the order of its page.

Files that a page uses without making them are the reader's: their names are in capitals and in
`READERS`, and `MAKERS` makes them. Only commands that take minutes are shortened, by options
(`SHORTER`).
"""

import gzip
import re
import shlex
import subprocess
import sys
from dataclasses import fields
from glob import glob
from pathlib import Path

import numpy as np
import pytest
import yaml
from matplotlib.figure import Figure
from pages import PAGES, REPO, blocks, command_lines, name_of, prose
from PIL import Image
from ros2_bags import messages_of, write_sqlite

from map_racing.bags.writer import BagWriter
from map_racing.cli import main
from map_racing.control.parameters import STEERING_MAPS, ControllerParameters
from map_racing.experiments import tuning
from map_racing.identification import robust_fit
from map_racing.identification.data import load_run
from map_racing.resources import find_config
from map_racing.simulation.faults import KINDS
from map_racing.track import speed_profile
from map_racing.track.files.load import save_raceline
from map_racing.track.files.waypoints import waypoint_rows
from map_racing.track.raceline import Raceline

READERS = {
    "README.md": ["map_racing_2025.bag"],
    "doc/race_day.md": [
        *("map_racing_2025.bag", "TRACK.csv", "MY_BASE.yaml"),
        *("LAPS.bag", "OTHER_LAPS.bag"),
    ],
    "doc/safety.md": ["FAULTS.yaml"],
    "doc/evaluate.md": ["LOG.csv.gz", "TRACK.csv", "ROSBAG2", "LONG_0.bag", "LONG_1.bag"],
    "doc/racelines.md": ["HALL.yaml", "BY_HAND.bag"],
    "doc/report.md": ["RUN.bag", "TRACK.csv"],
    "doc/identify.md": [
        *("MY_BASE.yaml", "CIRCLES.csv"),
        *("steering_ramp_1.bag", "steering_ramp_2.bag"),
    ],
    "doc/results.md": [
        *("hangar.bag", "Austin_centerline.csv", "Austin_raceline.csv", "MY_BASE.yaml"),
        *("CIRCLES.csv", "OTHER_CIRCLES.csv", "HELD_CIRCLES.csv"),
    ],
}

# These options replace the command's; the longest matching prefix of the command counts.
ON_THE_RING = ["--conditions", "ring.yaml", "--vehicle", "nuc4", "--jobs", "1"]
RACED_ON_THE_RING = [*ON_THE_RING, "--no-tuning", "--laps", "1"]
ON_A_SMALL_GRID = ["--grid", "grid.yaml", "--jobs", "1"]
SHORTER = {
    "race": ["--laps", "1"],
    "season": ["--jobs", "1"],
    "faults": ["--fault", "pose_nan"],
    "tune": [*ON_THE_RING, "--track", "ring.csv"],
    "tune --robust": ON_A_SMALL_GRID,
    "experiment tire-models": RACED_ON_THE_RING,
    "experiment velocity-scaling": [
        *(*RACED_ON_THE_RING, "--track", "ring.csv"),
        *("--seeds", "1", "--to", "0.6"),
    ],
    "raceline optimize circuit": ["--step", "8", "--curvature-only"],
    "experiment robustness": ON_A_SMALL_GRID,
}
# The README shows the output of these, so they run unchanged.
WHOLE = ("README.md",)
# Run only with current libraries; the commands' own tests run with all versions.
EVERYWHERE = ("README.md",)

# Not run: commands that prepare a workspace or an environment, and slow ones, which other tests run
# briefly.
PREPARATION = {
    ". devel/setup.bash",
    ". ~/map_racing_venv/bin/activate",
    "./scripts/false_stops --laps 10000",
    "./scripts/delays_of_laps",
    "./scripts/laps_to_car reference club hangar.bag HANGAR_39M.json --generated-seeds 1 2",
    "./scripts/heats",
    "./scripts/soak",
    "./scripts/test",
    "catkin build map_racing",
    "./scripts/cold_start --loss 1 2 3 4 5 6 7 8 9 10",
    "./scripts/cold_start reference club hangar.bag HANGAR_39M.json --generated-seeds 1 2",
    "./scripts/latency --controller map_adaptive",
    "./scripts/latency --tuning --dropouts 40",
    "cd ..",
    "cd ~/catkin_ws/src",
    "git clone <this repository> map_racing",
    "pip install .",
    "python3 -m venv ~/map_racing_venv",
    "rosdep install --from-paths map_racing --ignore-src -y",
}


# -- the reader's files ----------------------------------------------------------------------------


def ring(radius=1.2):
    angle = 2.0 * np.pi * np.arange(60) / 60
    x, y = radius * np.cos(angle), radius * np.sin(angle)
    half = np.full(60, 0.7)
    return Raceline(x, y, vx_mps=np.full(60, 3.0), d_left_m=half, d_right_m=half, name="ring")


def positions(line):
    """Time [s] and pose of 2.5 laps at 3 m/s."""
    for i in range(int(2.5 * line.length / 0.075)):
        point = line.pose(0.075 * i - 2.0)
        yield 0.025 * i, point.x, point.y, point.psi


def raceline(path):
    save_raceline(ring(), path)


def wider(path):
    save_raceline(ring(1.3), path)


def centerline(path):
    save_raceline(ring(), path, "centerline")


def faults(path):
    """The schedule shown on the page."""
    shown = re.search(r"```yaml\n(.*?)```", (REPO / "doc" / "safety.md").read_text("utf-8"), re.S)
    path.write_text(shown.group(1))


def bag(path):
    line = ring()
    with BagWriter(path) as written:
        written.waypoints(1.0, waypoint_rows(line))
        for t, x, y, psi in positions(line):
            for topic in ("/car_state/odom", "/pf/pose/odom"):
                written.odometry(2.0 + t, x, y, psi, 3.0, 0.0, 2.5, topic=topic)


def by_hand(path):
    """Two and a half laps through the hall of the map, without a raceline."""
    with BagWriter(path) as written:
        for i in range(int(5.0 * np.pi / 0.02)):
            angle = 0.02 * i
            x, y = 2.3 * 1.4 * np.cos(angle) - 2.0, 2.3 * np.sin(angle)
            written.pose(1.0 + 0.025 * i, x, y, angle + 1.6)


def ros2(path):
    bag(path.with_suffix(".bag"))
    write_sqlite(path, messages_of(path.with_suffix(".bag")))


def part(path):
    """Half of a run, as a recorder splits it; the raceline was sent only once."""
    second = path.stem.endswith("1")
    line = ring()
    with BagWriter(path) as written:
        if not second:
            written.waypoints(1.0, waypoint_rows(line))
        for t, x, y, psi in positions(line):
            if (t >= 4.0) is second:
                written.odometry(2.0 + t, x, y, psi, 3.0, 0.0, 2.5)


def log(path):
    with gzip.open(path, "wt") as file:
        file.write("time,pose_x,pose_y\n")
        file.writelines(f"{t},{x},{y}\n" for t, x, y, _ in positions(ring()))


def hall(path):
    """A map of map_server: free space between two ellipses; (1.2, 0.5) is on the track."""
    y, x = np.mgrid[3.975:-4.0:-0.05, -6.975:3.0:0.05]
    radius = np.hypot((x + 2.0) / 1.4, y)
    pixels = np.where((radius > 1.5) & (radius < 3.2), 254, 0).astype(np.uint8)
    Image.fromarray(pixels).save(path.with_suffix(".png"))
    settings = {"image": "HALL.png", "resolution": 0.05, "origin": [-7.0, -4.0, 0.0]}
    settings.update(negate=0, occupied_thresh=0.65, free_thresh=0.196)
    path.write_text(yaml.safe_dump(settings))


def vehicle(path):
    path.write_bytes(find_config("vehicles", "nuc4", (".yaml",)).read_bytes())


def ramps(path):
    path.write_bytes(find_config("recordings", "nuc4_ramps", (".bag",)).read_bytes())


def laps(path):
    """Laps of the simulated car, with its commands."""
    assert main(["race", "--laps", "1", "--speed-scale", "0.7", "--output", str(path)]) == 0


def circles(path):
    """The shipped ramps as a log with the columns of the channel map circles_log."""
    signals = load_run(find_config("recordings", "nuc4_ramps", (".bag",))).signals
    t = signals["x"].t
    columns = {"t": t, "pose_t": t}
    for column, name, scale in (
        ("x", "x", 1.0),
        ("y", "y", 1.0),
        ("yaw", "psi", 1.0),
        ("erpm_meas", "v_x", 1.0 / 2.7964e-4),
        ("wz", "yaw_rate", 1.0),
        ("ax", "a_x", 1.0),
        ("ay", "a_y", -1.0),
        ("delta_cmd", "steering", 1.0),
    ):
        columns[column] = scale * np.interp(t, *signals[name])
    table = np.column_stack(list(columns.values()))
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="")


MAKERS = {
    "Austin_centerline.csv": centerline,
    "Austin_raceline.csv": wider,
    "BY_HAND.bag": by_hand,
    "CIRCLES.csv": circles,
    "OTHER_CIRCLES.csv": circles,
    "HELD_CIRCLES.csv": circles,
    "FAULTS.yaml": faults,
    "HALL.yaml": hall,
    "LAPS.bag": laps,
    "OTHER_LAPS.bag": laps,
    "LOG.csv.gz": log,
    "MY_BASE.yaml": vehicle,
    "TRACK.csv": raceline,
    "RUN.bag": bag,
    "hangar.bag": bag,
    "LONG_0.bag": part,
    "LONG_1.bag": part,
    "ROSBAG2": ros2,
    "map_racing_2025.bag": bag,
    "steering_ramp_1.bag": ramps,
    "steering_ramp_2.bag": ramps,
}


# -- commands --------------------------------------------------------------------------------------


def conditions(folder):
    """Conditions that take a second: one day, or one car, on the ring."""
    raceline(folder / "ring.csv")
    (folder / "ring.yaml").write_text(
        "track: ring.csv\nplant: nuc4\nmu_deviation: 0.05\nfront_stiffness_deviation: 0.1\n"
        "rear_stiffness_deviation: 0.1\nseeds: [1]\npractice_seeds: [11]\ntuning_laps: 1\n"
    )
    (folder / "grid.yaml").write_text(
        "plant: nuc4\ncars: {as shipped: {}}\ntracks: [ring.csv]\nlaps: 1\n"
    )


def run(line, folder, shorter=True):
    """Run a command of map-racing as a shell would."""
    words = []
    for word in shlex.split(line)[1:]:
        name = str(folder / word[2:]) if word.startswith("~/") else word
        words += sorted(glob(name)) if "*" in name else [name]
    if shorter:
        beginnings = (" ".join(words[:count]) for count in (3, 2, 1))
        words = replaced(words, next((SHORTER[b] for b in beginnings if b in SHORTER), []))
    assert main(words) == 0, line


def replaced(words, options):
    """Words with replaced options, each of which may occur only once."""
    ours = {word for word in options if word.startswith("--")}
    kept, skipping = [], False
    for word in words:
        skipping = word in ours or (skipping and not word.startswith("--"))
        kept += [] if skipping else [word]
    return [*kept, *options]


def demo(folder):
    """Do what scripts/demo does, without making an environment."""
    script = (REPO / "scripts" / "demo").read_text(encoding="utf-8").replace("\\\n", "")
    controllers = re.search(r"for controller in (.+); do", script).group(1).split()
    race = re.search(r'"\$map_racing" (race .+)', script).group(1)
    bags = []
    for controller in controllers:
        bags.append(f"{controller}.bag")
        words = shlex.split(race.replace("$controller", controller).replace("$bag", bags[-1]))
        assert main(words) == 0
    assert main(["evaluate", *bags]) == 0


def executed(line, folder, whole):
    """Run a line of a page, or check the program that it calls."""
    line = line.replace("rosrun map_racing map-racing", "map-racing")
    words = line.split()
    if words[0] == "map-racing":
        run(line, folder, shorter=not whole)
    elif line == "./scripts/demo":
        demo(folder)
    elif words[0] == "./scripts/generate_tracks":
        subprocess.run([sys.executable, str(REPO / words[0]), *words[1:]], check=True)
    elif words[0] == "./scripts/test_ros":
        assert words[1] == "--shell" and words[2] == "roslaunch"
    elif words[0] == "rosservice":
        node, _, service = words[2].lstrip("/").partition("/")
        assert node in ("controller", "simulator") and f'"~{service}"' in nodes(), line
        request = yaml.safe_load(shlex.split(line)[3]) if len(words) > 3 else {}
        assert request.get("fault", "") in {"", *KINDS}, line
    elif words[:2] == ["rosrun", "dynamic_reconfigure"]:
        node, _, name = words[4].lstrip("/").partition("/")
        assert node == "controller" and f'namespace="{name}"' in nodes(), line
        names = {f.name for f in fields(ControllerParameters) if f.metadata["tuning"]}
        lookaheads = {f"{kind}_{name}" for kind in STEERING_MAPS for name in ("m_m", "q_s")}
        assert words[5] in lookaheads | (names - {"m_m", "q_s"}), line
    else:
        assert words[0] == "roslaunch" or line in PREPARATION, line


def nodes():
    """Source code of the nodes, which cannot be imported without ROS."""
    folder = REPO / "src" / "map_racing" / "nodes"
    return "".join(path.read_text(encoding="utf-8") for path in sorted(folder.glob("*.py")))


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Figures are composed but not rendered; tuning tries few pairs; plans and fits are coarser.

    Other tests cover these in full.
    """
    monkeypatch.setattr(Figure, "tight_layout", lambda figure, **_: None)
    monkeypatch.setattr(Figure, "savefig", lambda figure, file, **_: None)
    monkeypatch.setattr(tuning, "GRID", range(8, 17, 8))
    monkeypatch.setattr(tuning, "MOST_MOVES", 1)
    monkeypatch.setattr(speed_profile, "_CELL", 0.1)
    monkeypatch.setattr(robust_fit, "MOST_STEPS", 2)


@pytest.fixture(scope="module")
def done():
    """Commands that ran on an earlier page."""
    return set()


@pytest.mark.parametrize(
    "page",
    [
        page if name_of(page) in EVERYWHERE else pytest.param(page, marks=pytest.mark.once)
        for page in PAGES
    ],
    ids=name_of,
)
def test_commands_run(page, done, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    conditions(tmp_path)
    for name in READERS.get(name_of(page), ()):
        path = Path(tmp_path / name)
        path.parent.mkdir(exist_ok=True)
        MAKERS[name](path)
    lines = [line for line in command_lines(page) if line not in done]
    for line in lines:
        executed(line, tmp_path, name_of(page) in WHOLE)
    done.update(lines)
    for block in blocks(page, "python"):
        exec(compile(block, name_of(page), "exec"), {})
    printed = capsys.readouterr().out.splitlines()
    for block in blocks(page, "text"):
        for line in block.splitlines():
            assert line in printed


def test_what_is_the_readers_is_named_so():
    """A file with a lowercase name exists at that point: shipped, or made by a command above."""
    recorded = (
        "map_racing_2025.bag",
        "steering_ramp_1.bag",
        "steering_ramp_2.bag",
    )  # made by a launch file
    for page, names in READERS.items():
        if page != "doc/results.md":  # names public files next to their links
            for name in names:
                assert name in recorded or name.split(".")[0].isupper(), (page, name)


def test_extras_exist():
    """As in ``pip install 'map_racing[cluster]'``."""
    project = (REPO / "pyproject.toml").read_text(encoding="utf-8")
    for page in PAGES:
        for extra in re.findall(r"pip\s+install\s+'[\w.]+\[(\w+)\]'", prose(page)):
            assert re.search(rf"^{extra} = ", project, re.MULTILINE), (page, extra)
