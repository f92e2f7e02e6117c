"""Real nodes against a real roscore; ``./scripts/test_ros`` makes the workspace and runs them."""

from __future__ import annotations

import copy
import importlib
import os
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import pytest

if "map_racing" not in os.environ.get("ROS_PACKAGE_PATH", ""):
    pytest.exit("run these tests with ./scripts/test_ros, which builds their workspace", 4)

from forked import Forked
from harness import ROOT, Car, Rig, wait_for
from nav_msgs.msg import Odometry

from map_racing.errors import MapRacingError


def default_signals():
    """Let the process be interrupted, even if a script runs the tests in the background.

    In the background, the shell ignores SIGINT, which a child inherits.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    signal.signal(signal.SIGQUIT, signal.SIG_DFL)


class Process:
    """A child process with its output in a file.

    Parameters
    ----------
    command : list of str
    log : pathlib.Path
        Receives its standard output and error.
    environment : dict of str to str, optional
    forked : bool, optional
        The command is a node's script, which is run in a fork instead of a new interpreter.
    """

    def __init__(self, command, log, environment=None, forked=False):
        self.log = log
        self.command = [str(part) for part in command]
        log.touch()
        self._process = Forked(self.command, log) if forked else self._started(environment)
        self.pid = self._process.pid

    def _started(self, environment):
        with open(self.log, "wb") as file:
            return subprocess.Popen(
                self.command,
                stdout=file,
                stderr=subprocess.STDOUT,
                stdin=subprocess.DEVNULL,
                env=environment,
                start_new_session=True,
                preexec_fn=default_signals,
            )

    @property
    def output(self):
        """Its output so far."""
        return self.log.read_text(errors="replace")

    @property
    def running(self):
        return self._process.poll() is None

    def wait(self, timeout=20.0):
        """Wait for its end; return the exit code."""
        try:
            return self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            pytest.fail(f"still running after {timeout:g} s: {self.command}\n{self.output}")

    def signal(self, number):
        """Send a signal to this process only."""
        self._process.send_signal(number)

    def stop(self, timeout=10.0):
        """End it as Ctrl-C would, finally by force; return the exit code."""
        if self.running:
            self._process.send_signal(signal.SIGINT)
        try:
            return self._process.wait(timeout)
        except subprocess.TimeoutExpired:
            os.killpg(self.pid, signal.SIGKILL)
            return self._process.wait()

    def kill(self):
        """End it without warning."""
        if self.running:
            os.killpg(self.pid, signal.SIGKILL)
        return self._process.wait()


@pytest.fixture(scope="session")
def roscore(tmp_path_factory):
    """URI of this session's own master: on a free port, with its logs in a temporary folder."""
    folder = tmp_path_factory.mktemp("ros")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    uri = f"http://127.0.0.1:{port}"
    os.environ.update(
        ROS_MASTER_URI=uri,
        ROS_IP="127.0.0.1",
        ROS_HOME=str(folder),
        ROS_LOG_DIR=str(folder / "log"),
        PYTHONUNBUFFERED="1",
        # So that a test sees the lines of a node's log as they are.
        ROSCONSOLE_FORMAT="[${severity}] ${message}",
    )
    os.environ.pop("ROS_HOSTNAME", None)
    core = Process(["roscore", "-p", port], folder / "roscore.log")

    import rosgraph

    try:
        wait_for(lambda: rosgraph.is_master_online(uri), 30.0, "roscore")
        wait_for(lambda: "/rosout" in core.output, 30.0, "rosout")
        yield uri
    finally:
        core.stop()


@pytest.fixture(scope="session")
def ros(roscore):
    """The module `rospy`, with this process as a node."""
    import rospy

    rospy.init_node("test", disable_signals=True, anonymous=True)
    return rospy


@pytest.fixture(autouse=True)
def _clean_parameters(roscore):
    """Clear the parameter server, so that no test's parameters reach the next one.

    Nodes of several tests run in parallel: with real-time priority they would starve the others.
    """
    import rosgraph

    master = rosgraph.Master("/test")
    for name in ("controller", "steering_ramp"):
        master.setParam(f"/{name}/realtime_priority", 0)
    policy = os.sched_getscheduler(0)
    yield
    # This process may not have it either: all its children would inherit it.
    assert os.sched_getscheduler(0) == policy
    for name in master.getParamNames():
        if not name.startswith(("/ros", "/run_id")):
            # It may have been deleted with its namespace.
            with suppress(rosgraph.MasterError):
                master.deleteParam(name)


@pytest.fixture
def processes(tmp_path):
    """A function that starts a command as a `Process`; all of them end with the test."""
    started = []

    def run(command, environment=None, forked=False):
        log = tmp_path / f"{len(started):02d}_{Path(str(command[0])).name}.log"
        process = Process(command, log, environment, forked)
        started.append(process)
        return process

    yield run
    for process in reversed(started):
        process.stop()
    for process in started:
        # pytest shows this for a failed test.
        print(f"-- {' '.join(process.command)}\n{process.output}")


@pytest.fixture
def start(roscore, processes):
    """Start a node: ``start("controller", {"vehicle": "nuc4"}, {"odom": "/odom"})``.

    Parameters
    ----------
    node : str
        Name of its script.
    params : dict, optional
        Private parameters.
    remaps : dict, optional
    name : str, optional
        Name of the node; by default that of its script.
    python : path, optional
        Interpreter; by default the node is a fork, see `forked`.
    wait : bool, optional
        Wait until the master knows the node, with its subscriptions.

    Returns
    -------
    Process
    """

    def run(node, params=None, remaps=None, *, name=None, python=None, wait=True, environment=None):
        import rosgraph

        name = name or node
        master = rosgraph.Master("/test")
        # On the server rather than the command line, to preserve all types.
        for key, value in (params or {}).items():
            master.setParam(f"/{name}/{key}", value)
        command = [ROOT / "scripts" / node, f"__name:={name}"]
        command += [f"{old}:={new}" for old, new in (remaps or {}).items()]
        if python is None:
            process = processes(command, forked=True)
        else:
            process = processes([python, *command], environment)
        if wait:

            def up():
                if not process.running:
                    pytest.fail(f"{node} ended with {process.wait()}:\n{process.output}")
                return registered(f"/{name}")

            wait_for(up, 30.0, f"/{name}")
        return process

    return run


@pytest.fixture
def refusal(start):
    """``refusal("controller", {"vehicle": "none"})``: message of a node that refuses to start."""

    def run(node, params):
        process = start(node, params, wait=False)
        assert process.wait() == 1
        assert "Traceback" not in process.output
        return process.output

    return run


@pytest.fixture
def refused(no_master, monkeypatch):
    """As `refusal`, but in this process, which takes a hundredth of the time."""

    def run(node, params):
        # This process must not take the priority: nodes that it starts later would inherit it.
        given = {"realtime_priority": 0, **params}
        no_master.params.update({f"~{key}": value for key, value in given.items()})
        module = importlib.import_module(f"map_racing.nodes.{node}")
        made = []
        monkeypatch.setattr(module, "run", lambda _, make: made.append(make))
        # Other settings are those of the whole process.
        monkeypatch.setattr(sys, "setswitchinterval", lambda _: None)
        module.main()
        with pytest.raises(MapRacingError) as error:
            made[0]()
        assert "\n" not in str(error.value)
        return str(error.value)

    return run


def registered(name):
    """Whether a node of this name is known to the master."""
    import rosgraph

    try:
        return bool(rosgraph.Master("/test").lookupNode(name))
    except rosgraph.MasterError:
        return False


@pytest.fixture
def launch(roscore, processes):
    """``launch("simulate.launch", track="club")`` runs roslaunch on one of the shipped files."""

    def run(file, **arguments):
        given = [f"{key}:={value}" for key, value in arguments.items()]
        return processes(["roslaunch", "--wait", "map_racing", file, *given])

    return run


class Inbox(list):
    """Messages of a topic in the order of their arrival."""

    def wait(self, condition=None, timeout=30.0, what=None):
        """Wait for the first message that meets the condition (any, by default); return it."""

        def first():
            return next((m for m in list(self) if condition is None or condition(m)), None)

        return wait_for(lambda: [m for m in [first()] if m is not None], timeout, what or self)[0]


@pytest.fixture
def listen(ros):
    """``listen("/drive", AckermannDriveStamped)`` collects messages in an `Inbox`."""
    subscribers = []

    def subscribe(topic, kind):
        inbox = Inbox()
        subscribers.append(ros.Subscriber(topic, kind, inbox.append, queue_size=None))
        return inbox

    yield subscribe
    for subscriber in subscribers:
        subscriber.unregister()


@pytest.fixture
def advertise(ros):
    """``advertise("/odom", Odometry)`` gives a publisher; it waits for `subscribers` to connect."""
    publishers = []

    def publish(topic, kind, subscribers=1, latch=False):
        publisher = ros.Publisher(topic, kind, queue_size=1000, latch=latch)
        publishers.append(publisher)
        wait_for(
            lambda: publisher.get_num_connections() >= subscribers, 20.0, f"subscribers of {topic}"
        )
        return publisher

    yield publish
    for publisher in publishers:
        publisher.unregister()


@pytest.fixture
def rig(ros, start, advertise, listen):
    """``rig({"v_max_mps": 3.0})`` starts the controller and a car that sends it poses."""
    cars = []

    def make(params=None, **options):
        # A busy computer delays the poses of this process; tests of the age set the default.
        given = {"raceline": "reference", "max_pose_age_s": 0.8, **(params or {})}
        node = start("controller", {k: v for k, v in given.items() if v is not None})
        publisher = advertise("/odom", Odometry)
        car = Car(ros, [publisher.publish], **options)
        cars.append(car)
        return Rig(car, node, listen)

    yield make
    for car in cars:
        car.stop()


class Published:
    """A publisher that records its messages."""

    def __init__(self, name, kind, **options):
        self.name, self.sent = name, []

    def publish(self, *message, **fields):
        self.sent.append(copy.deepcopy(message[0] if message else fields))

    def get_num_connections(self):
        return 1


@pytest.fixture
def no_master(monkeypatch):
    """Create nodes in this process without a master; gives their parameters and logs."""
    import rospy

    params, said = {}, []

    def log(*words):
        said.append(" ".join(map(str, words)))

    monkeypatch.setattr(rospy.rostime, "_rostime_initialized", True)
    for name, fake in {
        "Publisher": Published,
        "Subscriber": lambda *_, **__: SimpleNamespace(resolved_name="/global_waypoints"),
        "Service": lambda *_: None,
        "Timer": lambda *_, **__: None,
        "on_shutdown": lambda _: None,
        "get_param": lambda name, default=None: params.get(name, default),
        "has_param": lambda name: name in params,
        "get_name": lambda: "/controller",
        "resolve_name": lambda name: "/" + name,
        **dict.fromkeys(("loginfo", "logwarn", "logerr_throttle"), log),
    }.items():
        monkeypatch.setattr(rospy, name, fake)
    return SimpleNamespace(params=params, said=said)
