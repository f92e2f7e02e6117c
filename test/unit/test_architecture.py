"""Which packages may import which: one direction along a list, and ROS only in the nodes."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "src" / "map_racing"

# What each package may import besides itself and the top-level modules: only packages above it in
# this list.
ALLOWED = {
    "bags": set(),
    "vehicle": set(),
    "track": set(),
    "track/files": {"track", "bags"},
    "control": {"vehicle", "track"},
    "simulation": {"control", "vehicle", "track", "track/files", "bags"},
    "identification": {"vehicle", "bags"},
    "evaluation": {"control", "vehicle", "track", "track/files", "bags"},
    "plots": {"track"},
    "pages": {"evaluation", "vehicle"},
    "experiments": {
        *("plots", "evaluation", "identification", "simulation", "control", "track"),
        *("track/files", "vehicle", "bags"),
    },
    "nodes": {"evaluation", "simulation", "control", "track", "track/files", "vehicle", "bags"},
    "cli": {
        *("experiments", "pages", "plots", "evaluation", "identification", "simulation", "control"),
        *("track", "track/files", "vehicle", "bags"),
    },
}
TOP_LEVEL = {
    *("printing", "errors", "angles", "files", "resources", "tables", "transforms"),
    *("units", "validation"),
    "__version__",
}
# Starting points of the programs; they may import all packages.
ENTRIES = ("start.py", "__main__.py")
ROS = ("rospy", "rosbag", "genpy", "tf2_ros", "roslib")
# What the extras bring.
EXTRAS = (
    *("distributed", "dask", "plotly", "zstandard", "osqp", "vehiclemodels"),
    *("pytest", "hypothesis"),
)


def modules():
    return sorted(PACKAGE.rglob("*.py"))


def package_of(parts):
    """Package of a module; empty for a top-level module."""
    return "/".join(parts[:2]) if parts[:2] == ("track", "files") else parts[0]


def imported(path):
    """Absolute dotted names of what a module imports."""
    parent = ("map_racing", *path.relative_to(PACKAGE).parent.parts)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join(parent[: len(parent) - node.level + 1]) if node.level else ""
            if node.module:
                yield f"{base}.{node.module}".strip(".")
            else:
                yield from (f"{base}.{alias.name}" for alias in node.names)


def test_the_list_of_packages_is_in_order():
    above = set()
    for package, allowed in ALLOWED.items():
        assert allowed <= above, package
        above.add(package)


@pytest.mark.once
@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_run_one_way(path):
    inside = path.relative_to(PACKAGE).parts
    package = package_of(inside) if len(inside) > 1 else ""
    for name in imported(path):
        parts = tuple(name.split("."))
        if parts[0] in ROS:
            assert package == "nodes", name
        if parts[0] == "rosbags":
            assert inside[0] == "bags", name
        if parts[0] == "matplotlib":
            assert package == "plots", name
        if parts[:2] in (("scipy", "signal"), ("scipy", "stats")):
            # Without these imports, nodes start 25 % faster.
            assert package in ("identification", "evaluation"), name
        if parts[0] == "map_racing" and len(parts) > 1 and path.name not in ENTRIES:
            target = package_of(parts[1:])
            allowed = TOP_LEVEL | ALLOWED[package] | {package} if package else TOP_LEVEL
            if package == "nodes":
                allowed = allowed | {"cfg", "msg", "srv"}  # made by catkin
            assert target in allowed, name


@pytest.mark.once
def test_all_but_the_nodes_runs_without_ros_and_without_any_extra():
    """Import every module in a process in which neither can be imported.

    So does the site, which is built beside all extras here, but has only its own elsewhere.
    """
    names = []
    for path in modules():
        if "nodes" in path.parts:
            continue
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        names.append(".".join(part for part in parts if part != "__init__"))
    code = (
        "import sys, importlib\n"
        f"for name in {ROS + EXTRAS!r}: sys.modules[name] = None\n"
        f"sys.path.insert(0, {str(PACKAGE.parent)!r})\n"
        f"for name in {names!r}: importlib.import_module(name)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
