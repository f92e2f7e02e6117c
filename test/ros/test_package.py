"""The catkin package: lint, install space, command line, entry points."""

import os
import shutil
import subprocess
import sys
from xml.etree import ElementTree

from map_racing import __version__, resources


def run(*command, **options):
    """Output of a command that must succeed."""
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, **options)
    output = done.stdout.decode(errors="replace")
    assert done.returncode == 0, output
    return output


def test_the_command_line_works_from_the_workspace(roscore, request):
    assert run("rosrun", "map_racing", "map-racing", "--version").split()[-1] == __version__
    root = request.config.rootpath.resolve()
    assert resources.config_directory() == root / "config"


def test_package_and_python_have_one_version(request):
    root = ElementTree.parse(request.config.rootpath / "package.xml").getroot()
    assert root.findtext("version") == __version__


def test_catkin_lint():
    # Use the folder in the workspace: the checkout may have any name.
    output = run(
        *("/usr/bin/catkin_lint", "-W2", "--offline"),
        run("rospack", "find", "map_racing").strip(),
        env={**os.environ, "PATH": "/usr/bin:/bin"},
    )
    assert "checked 1 packages and found 0 problems" in output, output


def test_the_install_space_is_complete(roscore, request, tmp_path):
    """Installed outside of the checkout, the package finds its data and its nodes run."""
    root = request.config.rootpath
    source = tmp_path / "src" / "map_racing"
    source.mkdir(parents=True)
    for name in ("CMakeLists.txt", "package.xml", "setup.py"):
        shutil.copy(str(root / name), str(source))
    for name in ("config", "launch", "msg", "scripts", "src", "srv"):
        shutil.copytree(str(root / name), str(source / name))
    build = f"catkin_make install --cmake-args -DPYTHON_EXECUTABLE={sys.executable} -Wno-dev"
    # Messages for Python only: other languages are not tested here.
    languages = {"ROS_LANG_DISABLE": "genlisp:geneus:gennodejs:gencpp"}
    run("bash", "-c", f"cd '{tmp_path}' && {build}", env={**os.environ, **languages})
    shutil.rmtree(str(tmp_path / "src"))
    shutil.rmtree(str(tmp_path / "devel"))

    # A clean shell: the environment of the test workspace must not help.
    environment = {key: os.environ[key] for key in ("HOME", "ROS_MASTER_URI", "ROS_IP", "LANG")}
    environment["PATH"] = os.environ["PATH"]

    def installed(command):
        setup = f". '{tmp_path}/install/setup.bash'"
        return run("bash", "-c", f"{setup} && {command}", env=environment)

    where = installed("python3 -c 'from map_racing import resources as r; print(r.__file__)'")
    assert where.startswith(f"{tmp_path}/install/")
    bag = tmp_path / "run.bag"
    installed(f"rosrun map_racing map-racing race --laps 1 --output {bag}")
    assert "1 lap counted" in installed(f"rosrun map_racing map-racing evaluate {bag}")
    launched = installed("roslaunch --nodes map_racing simulate.launch rviz:=true")
    assert {"/simulator", "/controller", "/rviz"} <= set(launched.split())
    for node in ("controller", "lap_evaluator", "lookahead_visualizer", "raceline_publisher"):
        assert f"/{node}" in launched.split()
    for node in ("simulator", "steering_ramp"):
        found = installed(f"catkin_find --first-only --libexec map_racing {node}")
        assert os.access(found.strip(), os.X_OK)
