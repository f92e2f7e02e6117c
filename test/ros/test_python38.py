"""The nodes under Python 3.8, as on a Noetic car, if that interpreter exists.

rospy and the messages are plain Python, so another Python's can be used. Only pure-Python packages
are shared, so a node that needs a compiled one would fail.
"""

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest
from map_racing.msg import LapResult

# All pure Python. dynamic_reconfigure needs rosservice, which needs rosbag and its dependencies.
LENT = (
    *("catkin", "dynamic_reconfigure", "genmsg", "genpy", "rosbag", "roscpp", "rosgraph"),
    *("roslib", "rosmsg", "rospkg", "rospy", "rosservice", "rostopic", "rosparam"),
    *("ackermann_msgs", "actionlib_msgs", "diagnostic_msgs", "geometry_msgs", "nav_msgs"),
    *("rosgraph_msgs", "sensor_msgs", "std_msgs", "std_srvs", "tf2_msgs", "visualization_msgs"),
    *("catkin_pkg", "defusedxml", "gnupg", "message_filters", "roslaunch", "rosmaster", "rosnode"),
    *("rosclean", "rosunit", "distro", "docutils", "dateutil", "pyparsing", "six"),
)


@pytest.fixture(scope="module")
def car_python():
    """The car's interpreter and libraries, as prepared by ./scripts/test."""
    python = Path(sys.prefix).parent / "car" / "bin" / "python"
    version = "import sys; print('%d.%d' % sys.version_info[:2])"
    if not python.exists():
        pytest.skip("no environment with Python 3.8 (./scripts/test makes it where there is one)")
    assert subprocess.check_output([str(python), "-c", version]).decode().strip() == "3.8"
    return python


@pytest.fixture
def environment(tmp_path, roscore):
    """Environment in which the interpreter finds ROS."""
    folder = tmp_path / "lent"
    folder.mkdir()
    for name in LENT:
        spec = importlib.util.find_spec(name)
        if spec is None:
            continue
        origin = Path(spec.origin)
        source = origin.parent if origin.name == "__init__.py" else origin
        (folder / source.name).symlink_to(source)
    devel = Path(os.environ["CMAKE_PREFIX_PATH"].split(":")[0]) / "lib/python3/dist-packages"
    # ./scripts/test has compiled the libraries there.
    compiled = str(Path(sys.prefix).parent / "compiled")
    found = {"PYTHONPATH": f"{devel}:{folder}", "PYTHONPYCACHEPREFIX": compiled}
    return {**os.environ, **found}


def test_a_race_on_python_38(ros, start, listen, car_python, environment):
    if sys.version_info[:2] == (3, 8):
        pytest.skip("all tests here run on Python 3.8")
    ros.set_param("/use_sim_time", True)
    inbox = listen("/lap_result", LapResult)
    options = {"python": car_python, "environment": environment}
    nodes = [
        start("raceline_publisher", **options),
        start("lap_evaluator", **options),
        start("controller", {"speed_scale": 0.7}, **options),
        start("lookahead_visualizer", **options),
        start("steering_ramp", remaps={"drive": "unused"}, **options),
        start("simulator", {"clock_rate": 8.0, "lockstep": True}, **options),
    ]
    lap = inbox.wait(lambda lap: lap.laps_completed == 1, 60.0)
    assert lap.lap_time_s == pytest.approx(8.98, rel=0.01)
    assert all(node.running and "Traceback" not in node.output for node in nodes)
