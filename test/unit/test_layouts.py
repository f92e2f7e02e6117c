"""Layouts for PlotJuggler and Foxglove: existing topics and fields, numbers with stamps."""

import json
import re
from pathlib import Path
from xml.etree import ElementTree

import layouts
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

REPO = Path(__file__).resolve().parents[2]
PLAIN = {"float64", "float32", "int32", "uint8", "bool"}


@pytest.fixture(scope="module")
def fields():
    """Names and types of the fields of each message type."""
    types = get_typestore(Stores.ROS1_NOETIC)
    for path in (REPO / "msg").glob("*.msg"):
        text = path.read_text(encoding="utf-8").replace("\nHeader ", "\nstd_msgs/Header ")
        types.register(get_types_from_msg(text, f"map_racing/msg/{path.stem}"))

    def of(kind):
        package, name = kind.split("/")
        definition = types.generate_msgdef(f"{package}/msg/{name}")[0].split("=" * 80)[0]
        rows = (line.split() for line in definition.splitlines() if "=" not in line)
        return {row[1]: row[0] for row in rows if len(row) == 2}

    return of


@pytest.mark.parametrize("tool", ["plotjuggler", "foxglove"])
def test_every_topic_and_field_exists(tool, fields):
    shown = list(getattr(layouts, tool)())
    assert len(shown) > 8
    for topic, path in shown:
        if topic in layouts.OTHERS:
            continue
        kind = layouts.TYPES[topic]
        assert not path or "header" in fields(kind), f"{topic} has no stamp"
        for field in path:
            assert field in fields(kind), (topic, path)
            kind = fields(kind)[field]
            kind = kind if "/" in kind or kind in PLAIN else f"geometry_msgs/{kind}"
        assert not path or kind in PLAIN, (topic, path)


def test_foxglove_has_a_place_for_each_panel():
    layout = json.loads((layouts.FOLDER / "foxglove.json").read_text(encoding="utf-8"))

    def panels(part):
        if isinstance(part, str):
            return [part]
        assert part["direction"] in ("row", "column")
        return panels(part["first"]) + panels(part["second"])

    assert sorted(panels(layout["layout"])) == sorted(layout["configById"])
    kinds = {name.split("!")[0] for name in layout["configById"]}
    assert kinds == {"3D", "Plot", "RawMessages", "DiagnosticSummary"}
    for name, panel in layout["configById"].items():
        assert name.startswith("Plot!") == ("foxglovePanelTitle" in panel)


def test_plotjuggler_splits_into_as_many_places_as_it_says():
    root = ElementTree.parse(str(layouts.FOLDER / "plotjuggler.xml")).getroot()
    tabs = root.findall("tabbed_widget[@parent='main_window']/Tab")
    assert all(tab.get("containers") == str(len(tab.findall("Container"))) == "1" for tab in tabs)
    for split in root.iter("DockSplitter"):
        sizes = [float(size) for size in split.get("sizes").split(";")]
        assert split.get("orientation") in ("-", "|")
        assert int(split.get("count")) == len(sizes) == len(list(split))
        assert sum(sizes) == pytest.approx(1.0)
        for area in split.findall("DockArea"):
            assert area.find("plot").get("mode") in ("TimeSeries", "XYPlot")
    shown = {topic for topic, _ in layouts.plotjuggler()}
    for plugin in root.iter("plugin"):
        assert plugin.get("ID") in ("DataLoad ROS bags", "ROS Topic Subscriber")
        assert set(plugin.find("selected_topics").get("value").split(";")) == shown


def test_own_topics_are_those_of_the_nodes():
    """By name, as the nodes advertise them; `test_launch` checks running nodes."""
    nodes = REPO / "src" / "map_racing" / "nodes"
    source = "".join(path.read_text(encoding="utf-8") for path in sorted(nodes.glob("*.py")))
    advertised = dict(re.findall(r'_?[Pp]ublisher\(\s*"/?([\w/]+)",\s*(\w+)', source))
    for topic, kind in layouts.TYPES.items():
        if topic != "/car_state/odom":
            assert advertised[topic.lstrip("/")] == kind.split("/")[1], topic
