"""``open_rviz``: open RViz with the view fitted to the track.

A layout has a fixed view. This waits for the raceline, fits the view of the shipped layout to the
track, and then replaces itself by RViz.
"""

from __future__ import annotations

import math
import os
import shutil
import sys
import threading

import rospy
import yaml

from ..errors import MapRacingError
from ..files import read_yaml_mapping, replacing
from ..resources import config_directory
from ..track.raceline import Raceline
from .markers import lap_text_place, track_box
from .node import ros_home, run, sleep
from .waypoints import RacelineSubscriber

__all__ = ["fitted", "main"]

# Without a raceline for this long [s], RViz opens with the view of the layout.
PATIENCE_S = 10.0
# Width and height of the window that menus and panels take up [pixel].
PANELS = 380, 95
# Share of the view left free on each side.
MARGIN = 0.04


def fitted(layout: dict, raceline: Raceline) -> dict:
    """Fit the view from above, and the grid, to the whole track and the lap text.

    Parameters
    ----------
    layout : dict
        Content of an RViz configuration file, which is changed.
    raceline : Raceline

    Returns
    -------
    dict
        The layout.
    """
    window = layout["Window Geometry"]
    view = layout["Visualization Manager"]["Views"]["Current"]
    x_min, x_max, y_min, y_max = track_box(raceline)
    _, y_text, size = lap_text_place(raceline)
    y_max = max(y_max, y_text + 1.7 * size)
    free = 1.0 - 2.0 * MARGIN
    view["Scale"] = min(
        free * (window["Width"] - PANELS[0]) / (x_max - x_min),
        free * (window["Height"] - PANELS[1]) / (y_max - y_min),
    )
    view["X"], view["Y"] = 0.5 * (x_min + x_max), 0.5 * (y_min + y_max)
    for display in layout["Visualization Manager"]["Displays"]:
        if display["Class"] == "rviz/Grid":
            display["Offset"].update(X=round(view["X"]), Y=round(view["Y"]))
            display["Plane Cell Count"] = 2 * math.ceil(max(x_max - x_min, y_max - y_min))
    return layout


class _Opener:
    """Waits for the raceline, writes the layout, and opens RViz."""

    def __init__(self):
        self._raceline, self._came = None, threading.Event()
        self._subscriber = RacelineSubscriber(self._receive)
        self.path = ros_home() / "map_racing.rviz"

    def _receive(self, raceline):
        self._raceline = raceline
        self._came.set()

    def run(self):
        for _ in range(int(PATIENCE_S / 0.1)):
            if self._came.is_set() or not sleep(0.1):
                break
        layout = read_yaml_mapping(config_directory() / "map_racing.rviz")
        if self._raceline is None:
            rospy.logwarn("no raceline within %g s: the view fits the reference track", PATIENCE_S)
        else:
            layout = fitted(layout, self._raceline)
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(self.path) as file:
            file.write(yaml.safe_dump(layout, sort_keys=False))
        self._open()

    def _open(self):
        if rospy.is_shutdown():
            return
        if shutil.which("rviz") is None:
            raise MapRacingError("rviz is not installed: sudo apt install ros-noetic-rviz")
        rospy.signal_shutdown("RViz takes over")
        os.execvp("rviz", ["rviz", "-d", str(self.path), *sys.argv[1:]])


def main():
    """Wait for the raceline, then open RViz."""
    run("rviz", _Opener)
