"""RViz opens on the track and shows what a driver needs: a real RViz on a virtual screen, checked
in a screenshot."""

import os
import subprocess

import numpy as np
import pytest
from map_racing.msg import LapResult
from matplotlib.image import imread
from nav_msgs.msg import OccupancyGrid

from map_racing.errors import MapRacingError
from map_racing.nodes import open_rviz
from map_racing.nodes.colors import WALL, gradient
from map_racing.nodes.lap_evaluator import LAP_TEXT_COLOR
from map_racing.nodes.lookahead_visualizer import CAR_COLOR, LOOKAHEAD_COLOR, STEERING_COLOR
from map_racing.track.files.load import load_raceline, save_raceline
from map_racing.track.raceline import Raceline

SIZE = 1400, 760
# Fewest pixels of each color. Lines are one or two pixels wide at full color.
EXPECTED = {
    "slow raceline": 20,
    "raceline": 40,
    "fast raceline": 40,
    "walls": 2000,
    "car": 200,
    "lookahead": 12,
    "steering": 20,
    "lap text": 300,
    "map": 8000,
}
# White at the layout's 70 % over its background.
MAP_COLOR = (0.77, 0.77, 0.78)


def near(picture, color, tolerance=0.06):
    """Number of pixels of a color."""
    return int(np.count_nonzero(np.abs(picture - np.array(color)).max(axis=2) < tolerance))


def shaded(picture, color):
    """Number of pixels of a color, shaded to any brightness above a third."""
    brightness = picture @ np.array(color) / np.dot(color, color)
    away = np.abs(picture - brightness[..., None] * np.array(color)).max(axis=2)
    return int(np.count_nonzero((away < 0.12 * brightness) & (brightness > 0.33)))


def found(picture):
    """Number of pixels of each item."""

    def speed(fraction):
        color = gradient(fraction)
        return color.r, color.g, color.b

    return {
        "slow raceline": near(picture, speed(0.0)),
        "raceline": sum(near(picture, speed(0.1 * i), 0.03) for i in range(3, 8)),
        "fast raceline": near(picture, speed(1.0)),
        "walls": near(picture, WALL),
        "car": shaded(picture, CAR_COLOR),
        "lookahead": shaded(picture, LOOKAHEAD_COLOR),
        "steering": shaded(picture, STEERING_COLOR),
        "lap text": near(picture, LAP_TEXT_COLOR, 0.02),
        "map": near(picture, MAP_COLOR, 0.04),
    }


@pytest.fixture
def screen(processes, monkeypatch):
    """A virtual screen as DISPLAY."""
    read, write = os.pipe()
    os.set_inheritable(write, True)
    server = subprocess.Popen(
        ["Xvfb", "-displayfd", str(write), "-screen", "0", "{}x{}x24".format(*SIZE)],
        pass_fds=[write],
        stderr=subprocess.DEVNULL,
    )
    os.close(write)
    with os.fdopen(read) as file:
        display = f":{file.readline().strip()}"
    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.setenv("LIBGL_ALWAYS_SOFTWARE", "1")
    yield display
    server.terminate()
    server.wait()


def extent(picture, color, tolerance=0.06):
    """First and last row and column with pixels of a color."""
    rows, columns = np.nonzero(np.abs(picture - np.array(color)).max(axis=2) < tolerance)
    return rows.min(), rows.max(), columns.min(), columns.max()


def elsewhere():
    """The track reference, 25 % larger and at another place."""
    line = load_raceline("reference")
    return Raceline(
        *(1.25 * line.x + 40.0, 1.25 * line.y - 25.0),
        vx_mps=line.speed,
        d_left_m=1.25 * line.d_left,
        d_right_m=1.25 * line.d_right,
    )


def a_map():
    """A free room of 3 x 4 m within the inner wall of that track."""
    grid = OccupancyGrid(data=[0] * 1200)
    grid.header.frame_id = "map"
    grid.info.resolution, grid.info.width, grid.info.height = 0.1, 30, 40
    grid.info.origin.position.x, grid.info.origin.position.y = 38.5, -22.0
    grid.info.origin.orientation.w = 1.0
    return grid


def watched(race, path):
    """Picture of the map view, and what is found in it, once all is there or after a while."""
    for _ in range(20):
        # In color even while the screen is still black.
        subprocess.run(["import", "-window", "root", f"PNG24:{path}"], check=True)
        # Only the map view, without menus and panels.
        picture = imread(path)[70:-40, 370:-20, :3]
        counts = found(picture)
        if all(counts[name] >= EXPECTED[name] for name in EXPECTED):
            break
        assert race.running, race.output
    return picture, counts


def test_a_computer_without_rviz_is_told_so(monkeypatch):
    monkeypatch.setattr(open_rviz.shutil, "which", lambda name: None)
    with pytest.raises(MapRacingError, match="rviz is not installed: sudo apt install"):
        open_rviz._Opener._open(None)


def test_rviz_shows_the_race_on_its_track(screen, launch, listen, ros, tmp_path):
    publisher = ros.Publisher("/map", OccupancyGrid, queue_size=1, latch=True)
    publisher.publish(a_map())
    track = tmp_path / "elsewhere.csv"
    save_raceline(elsewhere(), track, "map_racing")
    path = tmp_path / "rviz.png"
    # RViz itself sometimes dies of a memory error when it starts: then once more.
    for _ in range(3):
        pace = {"speed_scale": 0.8, "clock_rate": 8, "lockstep": "true"}
        race = launch("simulate.launch", rviz="true", track=track, **pace)
        listen("/lap_result", LapResult).wait(lambda lap: lap.valid, 120.0, "a lap")
        picture, counts = watched(race, path)
        if "[rviz-" not in race.output or "process has died" not in race.output:
            break
        race.stop()
    print(f"{path}: pixels {counts}")
    missing = [name for name in EXPECTED if counts[name] < EXPECTED[name]]
    assert not missing, (missing, counts, str(path))
    # The text is above the whole track, which is as large as the window allows.
    height, width = picture.shape[:2]
    beneath = extent(picture, LAP_TEXT_COLOR, 0.02)[1] + 10
    top, bottom, left, right = extent(picture[beneath:], WALL)
    assert 0 < top < 40 and 0.9 * height < beneath + bottom < height - 1
    assert left > 0 and right < width - 1 and abs(left + right - width) < 0.1 * width
    publisher.unregister()
