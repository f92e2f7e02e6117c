"""RViz opens the shipped layout and shows what a driver wants to see: a real one, on a screen in
memory, looked at through a screenshot."""

import os
import subprocess

import numpy as np
import pytest
from map_racing.msg import LapResult
from matplotlib.image import imread

from map_racing.nodes.colors import WALL, gradient
from map_racing.nodes.lap_evaluator import LAP_TEXT_COLOR
from map_racing.nodes.lookahead_visualizer import CAR_COLOR, LOOKAHEAD_COLOR, STEERING_COLOR

SIZE = 1400, 760
# Fewest pixels of each color. Lines are a pixel or two wide where they have it.
EXPECTED = {
    "slow raceline": 20,
    "raceline": 40,
    "fast raceline": 40,
    "walls": 2000,
    "car": 200,
    "lookahead": 20,
    "steering": 20,
    "lap text": 300,
}


def near(picture, color, tolerance=0.06):
    """Number of pixels of a color."""
    return int(np.count_nonzero(np.abs(picture - np.array(color)).max(axis=2) < tolerance))


def shaded(picture, color):
    """Number of pixels of a color of which light and shadow made any brightness above a third."""
    brightness = picture @ np.array(color) / np.dot(color, color)
    away = np.abs(picture - brightness[..., None] * np.array(color)).max(axis=2)
    return int(np.count_nonzero((away < 0.12 * brightness) & (brightness > 0.33)))


def found(picture):
    """Pixels of each thing."""

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
    }


@pytest.fixture
def screen(processes, monkeypatch):
    """A screen in memory as DISPLAY."""
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


def test_the_layout_shows_the_race(screen, launch, listen, tmp_path):
    race = launch("simulate.launch", rviz="true", speed_scale=0.8)
    listen("/lap_result", LapResult).wait(lambda lap: lap.valid, 90.0, "a lap")
    path = tmp_path / "rviz.png"
    for _ in range(20):
        subprocess.run(["import", "-window", "root", path], check=True)
        picture = imread(path)[:, :, :3]
        # Behind menus and panels: only what is drawn in the map.
        counts = found(picture[70:-40, 370:-20])
        if all(counts[name] >= EXPECTED[name] for name in EXPECTED):
            break
        assert race.running, race.output
    print(f"{path}: pixels {counts}")
    missing = [name for name in EXPECTED if counts[name] < EXPECTED[name]]
    assert not missing, (missing, counts, str(path))
