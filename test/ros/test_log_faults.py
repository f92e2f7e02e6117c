"""A blocked or closed log must neither delay nor stop the nodes that drive."""

import fcntl
import os
import subprocess
import sys

import pytest
from conftest import default_signals
from harness import ROOT, Car, Rig
from nav_msgs.msg import Odometry


def clog(write):
    """Fill a pipe."""
    # A separate file description: the node's own stays blocking.
    other = os.open(f"/proc/self/fd/{write}", os.O_WRONLY | os.O_NONBLOCK)
    try:
        while True:
            os.write(other, b"." * 512)
    except BlockingIOError:
        pass
    finally:
        os.close(other)


@pytest.fixture(params=["stuck", "closed"])
def piped(request, roscore):
    """``piped("controller")`` starts a node that logs to a pipe, with a way to break the pipe."""
    nodes = []

    def start(name, *arguments):
        read, write = os.pipe()
        fcntl.fcntl(write, fcntl.F_SETPIPE_SZ, 1 << 16)
        command = [sys.executable, ROOT / "scripts" / name, f"__name:={name}", *arguments]
        node = subprocess.Popen(
            command, stdout=write, stderr=write, start_new_session=True, preexec_fn=default_signals
        )
        nodes.append(node)

        def break_it():
            if request.param == "stuck":
                clog(write)
            else:
                os.close(read)
            os.close(write)

        return break_it

    yield start
    for node in nodes:
        node.kill()
        node.wait()


def test_the_controller_stops_all_the_same(ros, piped, advertise, listen):
    break_it = piped("controller", "_raceline:=reference", "_max_pose_age_s:=0.8")
    car = Car(ros, [advertise("/odom", Odometry).publish])
    rig = Rig(car, None, listen)
    try:
        rig.driving()
        break_it()
        car.silent = True
        rig.wait_mode("stopped", "pose too old")
        car.silent = False
        rig.driving()
        car.change = lambda message: setattr(message.header, "frame_id", "odom") or message
        rig.wait_mode("stopped", "pose in another frame")
        assert rig.drive[-1].drive.speed == 0.0
    finally:
        car.stop()
