"""Everything that README and pages refer to exists: links, files, names in the code, launch
arguments."""

import ast
import dataclasses
import importlib.util
import re
import shlex
from xml.etree import ElementTree

import pytest
from pages import PAGES, REPO, anchors, command_lines, name_of, prose

from map_racing.control.parameters import STEERING_MAPS, ControllerParameters
from map_racing.control.safety_limits import SafetyLimits
from map_racing.control.steering_ramp import RampParameters
from map_racing.resources import list_config
from map_racing.simulation.plants import load_plant
from map_racing.vehicle.parameters import load_vehicle

SOURCE = REPO / "src" / "map_racing"
ARCHITECTURE = REPO / "doc" / "architecture.md"
FOLDERS = ("config", "doc", "launch", "msg", "scripts", "src", "test")


def test_the_readme_fits_on_a_few_screens():
    assert len((REPO / "README.md").read_text(encoding="utf-8").splitlines()) <= 150


def test_the_readme_shows_how_the_tests_end():
    script = (REPO / "scripts" / "test").read_text(encoding="utf-8")
    judged = re.findall(r'^ *(?:judge|finish) "([^",$]+)', script, re.MULTILINE)
    shown = re.findall(r"^passed +([^,\n]+)", PAGES[0].read_text(encoding="utf-8"), re.MULTILINE)
    assert shown == list(dict.fromkeys(judged))


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_lead_somewhere(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        if target.startswith("https://"):
            continue
        path, _, anchor = target.partition("#")
        linked = page.parent / path if path else page
        assert linked.is_file(), target
        assert not anchor or anchor in anchors(linked), target


def test_every_page_is_in_the_contents():
    for page in PAGES[1:]:
        if page.stem not in ("index", "api"):
            assert f"(doc/{page.name})" in PAGES[0].read_text(encoding="utf-8"), page
            assert f"({page.name})" in (REPO / "doc" / "index.md").read_text(encoding="utf-8"), page


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_shipped_files_exist(page):
    for path in re.findall(rf"`(?:\./)?((?:{'|'.join(FOLDERS)})/[\w./-]+)`", prose(page)):
        assert (REPO / path).exists(), path


def spans(text):
    return re.findall(r"`([^`]+)`", text)


def defined(path):
    """Names that a Python file defines or assigns, at any depth."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)):
            names.add(node.name)
        elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names.add(node.id)
    return names


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_modules_exist(page):
    for path in spans(prose(page)):
        if re.fullmatch(r"[a-z_0-9/]+\.py", path):
            assert (SOURCE / path).is_file() or (REPO / path).is_file(), path


def test_every_package_is_described():
    text = prose(ARCHITECTURE)
    for init in SOURCE.rglob("__init__.py"):
        package = init.parent.relative_to(SOURCE).as_posix()
        assert package == "." or package.startswith("cli/") or f"| `{package}/` |" in text, package
    for module in SOURCE.glob("*.py"):
        assert module.name == "__init__.py" or f"`{module.name}`" in text, module


def test_the_answers_are_where_the_table_says():
    text = prose(ARCHITECTURE)
    rows = re.findall(r"^\|[^|]+\?[^|]*\| `([^`]+)` \| `([^`]+)` \|$", text, re.M)
    assert len(rows) == len(re.findall(r"^\|[^|]+\?", text, re.M)) >= 20
    for path, name in rows:
        if path.endswith(".py"):
            assert name in defined(SOURCE / path), (path, name)
        else:
            assert f'"{name}"' in (REPO / path).read_text(encoding="utf-8"), (path, name)


def test_live_tuning_is_generated_again_when_what_it_reads_changes():
    config = (REPO / "config" / "Controller.cfg").read_text(encoding="utf-8")
    modules = re.findall(r"^from map_racing\.([\w.]+) import", config, re.M)
    expected = {f"src/${{PROJECT_NAME}}/{module.replace('.', '/')}.py" for module in modules}
    expected |= {f"config/controllers/{name}.yaml" for name in STEERING_MAPS.values()}
    build = (REPO / "CMakeLists.txt").read_text(encoding="utf-8")
    (listed,) = re.findall(r"\n  DEPENDS\n([^)]+?)\n  APPEND", build)
    assert set(listed.split()) == expected


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_names_beside_a_module_are_in_it(page):
    """As in "`a.py` (`Name`, `name`)", "`a.py`: `name`" and "`name` (`a.py`)"."""
    text = prose(page)
    found = re.findall(r"`([a-z_/]+\.py)`(?:\s\(|:\s)((?:`[\w.]+`(?:,\s)?)+)", text)
    reverse = re.findall(r"`([\w.]+)`\s(?:in\s|\()`([a-z_/]+\.py)`", text)
    found += [(path, f"`{name}`") for name, path in reverse]
    for path, names in found:
        known = defined(SOURCE / path)
        for name in spans(names):
            assert set(name.split(".")) <= known or name.endswith(".py"), (path, name)


# -- launch files ----------------------------------------------------------------------------------


def launch_arguments(name):
    """Arguments of a launch file and its includes."""
    tree = ElementTree.parse(REPO / "launch" / name)
    taken = {arg.get("name") for arg in tree.getroot().findall("arg") if not arg.get("value")}
    for include in tree.getroot().findall("include"):
        if include.get("pass_all_args"):
            taken |= launch_arguments(include.get("file").split("/launch/")[1])
    return taken


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_launch_commands_have_such_files_and_arguments(page):
    for line in command_lines(page):
        if "roslaunch" in line:
            words = shlex.split(line.split("roslaunch ")[1].replace("--ros-args ", ""))
            assert words[0] == "map_racing"
            given = {word.partition(":=")[0] for word in words[2:]}
            assert given <= launch_arguments(words[1]), line


def test_every_node_that_asks_for_the_car_is_told_it():
    """Otherwise the controller would drive one car, and RViz show another."""
    tree = ElementTree.parse(REPO / "launch" / "include" / "nodes.launch")
    told = {
        node.get("type"): {param.get("name") for param in node.findall("param")}
        for node in tree.getroot().iter("node")
    }
    for kind in ("controller", "lookahead_visualizer"):
        assert "vehicle" in told[kind], kind


def test_simulated_cars_are_known_to_their_controller():
    tree = ElementTree.parse(REPO / "launch" / "simulate.launch")
    (default,) = [
        arg.get("default") for arg in tree.getroot().findall("arg") if arg.get("name") == "vehicle"
    ]
    for plant in list_config("plants"):
        known = eval(default[len("$(eval ") : -1], {"plant": plant})
        assert load_vehicle(known).name == load_plant(plant).vehicle.name, plant


def test_arguments_in_the_text_are_those_of_launch_files():
    files = [path.name for path in (REPO / "launch").glob("*.launch")]
    known = set().union(*map(launch_arguments, files))
    for page in PAGES:
        for name in re.findall(r"`(\w+):=[^`]*`", prose(page)):
            assert name in known, (page, name)


def test_programs_that_rosrun_starts_are_installed():
    installed = (REPO / "CMakeLists.txt").read_text(encoding="utf-8")
    for page in PAGES:
        for line in command_lines(page):
            if line.startswith("rosrun map_racing "):
                assert f"scripts/{line.split()[2]}\n" in installed, line


def test_parameters_of_the_nodes_are_documented():
    """The table of a node has exactly the parameters that it reads."""
    text = (REPO / "doc" / "nodes.md").read_text(encoding="utf-8")
    # Read by nodes/waypoints.py and nodes/priority.py for several nodes.
    known = {"waypoints_from", "realtime_priority"}
    for kind in (ControllerParameters, SafetyLimits, RampParameters):
        known |= {field.name for field in dataclasses.fields(kind)}
    for title, section in re.findall(r"^## (\w+)\n(.*?)(?=^## |\Z)", text, re.M | re.S):
        read = set()
        for node in ast.walk(ast.parse((SOURCE / "nodes" / f"{title}.py").read_text("utf-8"))):
            reads = isinstance(node, ast.Call) and getattr(node.func, "id", "") == "get_parameter"
            if reads and isinstance(node.args[0], ast.Constant):
                read.add(node.args[0].value)
        cells = "".join(re.findall(r"^\| (.+?) \|", section, re.M))
        documented = set(re.findall(r"`~(\w+)`", cells))
        assert read <= documented <= read | known, title


def test_tables_of_parameters_are_those_of_the_classes():
    """If this fails, ``python doc/tables.py`` rewrites them."""
    spec = importlib.util.spec_from_file_location("tables", REPO / "doc" / "tables.py")
    tables = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(tables)
    texts = [page.read_text(encoding="utf-8") for page in PAGES]
    assert [tables.with_tables(text) for text in texts] == texts
    written = {kind for text in texts for _, kind, _ in tables.TABLE.findall(text)}
    assert written == set(tables.KINDS)
