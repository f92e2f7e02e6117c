"""Real-time priority of the nodes that command the car."""

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest
import rospy
from diagnostic_msgs.msg import DiagnosticArray, KeyValue

from map_racing.errors import ParameterError
from map_racing.nodes import priority

TRIED = "import os; os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))"


def permitted():
    return subprocess.run([sys.executable, "-c", TRIED], stderr=subprocess.DEVNULL).returncode == 0


def policies(pid):
    """Scheduling policy of each thread of a process."""
    return {os.sched_getscheduler(int(t.name)) for t in Path(f"/proc/{pid}/task").iterdir()}


@pytest.mark.parametrize("wanted", [1, 0])
def test_all_threads_of_the_controller_have_it_where_it_is_permitted(start, listen, wanted):
    diagnostics = listen("/diagnostics", DiagnosticArray)
    node = start("controller", {"raceline": "reference", "realtime_priority": wanted})
    granted = wanted and permitted()
    expected = KeyValue("priority", "real-time 1" if granted else "ordinary")
    # On a busy computer, the last messages of the previous controller come late.
    diagnostics.wait(
        lambda m: m.status[0].name == "controller: state" and expected in m.status[0].values
    )
    assert policies(node.pid) == {os.SCHED_RR if granted else os.SCHED_OTHER}
    assert ("no real-time priority" in node.output) == bool(wanted and not granted)


@pytest.fixture
def scheduler(monkeypatch, no_master):
    """Requests to the operating system, and its answers."""
    asked, answers = [], {}

    def take(thread, policy, parameter):
        asked.append((thread, policy, parameter.sched_priority))
        if thread in answers:
            raise answers[thread]

    monkeypatch.setattr(os, "sched_setscheduler", take)
    monkeypatch.setattr(os, "sched_getscheduler", lambda _: os.SCHED_OTHER)
    return asked, answers


def test_each_thread_is_asked_for(scheduler):
    asked, answers = scheduler
    waiting = threading.Event()
    other = threading.Thread(target=waiting.wait)
    other.start()
    try:
        # Threads may have ended meanwhile.
        answers[other.native_id] = ProcessLookupError()
        assert priority.take_priority(7) == ""
    finally:
        waiting.set()
        other.join()
    assert {(other.native_id, os.SCHED_RR, 7), (os.getpid(), os.SCHED_RR, 7)} <= set(asked)


def test_a_refusal_is_told_and_the_node_drives(scheduler, no_master, monkeypatch):
    said = []
    monkeypatch.setattr(rospy, "logwarn", lambda text, *values: said.append(text % values))
    scheduler[1][os.getpid()] = PermissionError(1, "Operation not permitted")
    assert priority.urgent(lambda: "node")() == "node"
    assert said[0].startswith("no real-time priority (Operation not permitted): ")
    no_master.params["~realtime_priority"] = 0
    scheduler[0].clear()
    assert priority.urgent(lambda: "node")() == "node" and len(said) == 1 and not scheduler[0]


def test_a_process_keeps_the_priority_that_it_was_started_with(scheduler, monkeypatch):
    monkeypatch.setattr(os, "sched_getscheduler", lambda _: os.SCHED_FIFO)
    assert priority.take_priority(1) == "" and scheduler[0] == []
    monkeypatch.setattr(os, "sched_getparam", lambda _: os.sched_param(20))
    assert priority.present_priority() == "real-time 20"


def test_systems_without_it_say_so(monkeypatch):
    for name in ("sched_getscheduler", "sched_setscheduler"):
        monkeypatch.delattr(os, name)
    assert priority.take_priority(1) == "not on this system"
    assert priority.present_priority() == "ordinary"


@pytest.mark.parametrize("wanted", [-1, 100])
def test_priorities_that_do_not_exist_are_refused(scheduler, no_master, wanted):
    no_master.params["~realtime_priority"] = wanted
    with pytest.raises(ParameterError, match=f"~realtime_priority: expected 0 to 99, got {wanted}"):
        priority.urgent(lambda: None)()
