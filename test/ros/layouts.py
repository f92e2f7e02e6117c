"""Topics and fields that the layouts of PlotJuggler and Foxglove show."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

FOLDER = Path(__file__).resolve().parents[2] / "config" / "layouts"

# Topics of the nodes with the stack race_stack; `test_launch` compares them with running nodes.
TYPES = {
    "/car_state/odom": "nav_msgs/Odometry",
    "/course_markers": "visualization_msgs/MarkerArray",
    "/diagnostics": "diagnostic_msgs/DiagnosticArray",
    "/guidance": "map_racing/Guidance",
    "/lap_markers": "visualization_msgs/MarkerArray",
    "/lap_result": "map_racing/LapResult",
    "/lookahead_markers": "visualization_msgs/MarkerArray",
    "/raceline_markers": "visualization_msgs/MarkerArray",
    "/tracking": "map_racing/Tracking",
}
# From map_server.
OTHERS = {"/map"}


def plotjuggler():
    """Topics with fields, ``topic/field/...``, in the layout of PlotJuggler."""
    root = ElementTree.parse(str(FOLDER / "plotjuggler.xml")).getroot()
    for curve in root.iter("curve"):
        names = [curve.get("name")]
        if curve.get("curve_x"):
            names = [curve.get("curve_x"), curve.get("curve_y")]
        for name in names:
            topic = max((t for t in TYPES if name.startswith(t + "/")), key=len, default=name)
            yield topic, tuple(name[len(topic) + 1 :].split("/"))


def foxglove():
    """Topics with fields, none for whole messages, in the layout of Foxglove."""
    layout = json.loads((FOLDER / "foxglove.json").read_text(encoding="utf-8"))
    for panel in layout["configById"].values():
        for path in panel.get("paths", ()):
            topic, *fields = re.split(r"\.", path["value"])
            yield topic, tuple(fields)
        for topic in panel.get("topics", ()):
            yield topic, ()
        for key in ("topicPath", "topicToRender"):
            if key in panel:
                yield panel[key], ()
