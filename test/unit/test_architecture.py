"""Who may import whom: arrows run down the list of rooms, and ROS stays outside."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "src" / "map_racing"

# Each room may import those before it in its own entry.
ALLOWED = {
    "vehicle": {"vehicle"},
    "track": {"track"},
    "control": {"control", "vehicle", "track"},
    "simulation": {"simulation", "control", "vehicle", "track"},
    "evaluation": {"evaluation", "track"},
    "experiments": {"experiments", "evaluation", "simulation", "control", "vehicle", "track"},
    "cli": {"cli", "experiments", "evaluation", "simulation", "control", "vehicle", "track"},
}
GROUND = {"errors", "angles", "files", "resources", "__version__"}


def modules():
    return sorted(path for path in PACKAGE.rglob("*.py") if "nodes" not in path.parts)


def imported(path):
    """Absolute dotted names of what a module imports."""
    package = ("map_racing", *path.relative_to(PACKAGE).parent.parts)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(package[: len(package) - node.level + 1]) if node.level else ""
            if node.module:
                yield f"{base}.{node.module}".strip(".")
            else:
                yield from (f"{base}.{alias.name}" for alias in node.names)


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_run_one_way(path):
    room = path.relative_to(PACKAGE).parts[0]
    for name in imported(path):
        parts = name.split(".")
        assert parts[0] not in ("rospy", "rosbag", "genpy", "tf2_ros"), name
        if parts[0] == "rosbags":
            assert path.name == "bags.py" and room == "evaluation"
        if parts[0] == "matplotlib":
            assert path.parent.name == "plots" and room == "evaluation"
        if parts[0] == "map_racing" and len(parts) > 1 and room in ALLOWED:
            assert parts[1] in ALLOWED[room] | GROUND, name


def test_all_but_the_nodes_runs_without_ros():
    """Import every module in a process in which ROS cannot be imported."""
    names = []
    for path in modules():
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        names.append(".".join(part for part in parts if part != "__init__"))
    code = (
        "import sys, importlib\n"
        "for name in ('rospy', 'rosbag', 'genpy', 'tf2_ros', 'roslib'): sys.modules[name] = None\n"
        f"sys.path.insert(0, {str(PACKAGE.parent)!r})\n"
        f"for name in {names!r}: importlib.import_module(name)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
