"""Nodes as forks of a process that has already made their imports, which take half of a start.

Each node is still a separate process that runs its script. Tests that launch nodes check that each
makes all its imports itself.
"""

import atexit
import multiprocessing
import os
import runpy
import signal
import subprocess
import sys

NODES = (
    *("controller", "lap_evaluator", "lookahead_visualizer", "raceline_publisher", "simulator"),
    "steering_ramp",
)
_context = multiprocessing.get_context("forkserver")
_context.set_forkserver_preload([f"map_racing.nodes.{name}" for name in NODES])


class Forked:
    """A script that runs in a fork, with the part of `subprocess.Popen` that the tests use.

    Parameters
    ----------
    command : list of str
        The script and its arguments.
    log : pathlib.Path
        Takes its standard output and error.
    """

    def __init__(self, command, log):
        self._command = command
        arguments = (command, str(log), dict(os.environ), os.getcwd())
        self._process = _context.Process(target=_run, args=arguments)
        self._process.start()
        self.pid = self._process.pid

    def poll(self):
        return self._process.exitcode

    def wait(self, timeout=None):
        self._process.join(timeout)
        if self.poll() is None:
            raise subprocess.TimeoutExpired(self._command, timeout)
        return self.poll()

    def send_signal(self, number):
        if self.poll() is None:
            os.kill(self.pid, number)


def _run(command, log, environment, folder):
    """Do what a new interpreter does, without the imports."""
    import rospy

    os.setsid()
    os.chdir(folder)
    file = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for number, name in ((1, "stdout"), (2, "stderr")):
        os.dup2(file, number)
        setattr(sys, name, os.fdopen(number, "w", buffering=1, closefd=False))
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGQUIT, signal.SIG_DFL)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv[:] = command
    rospy.names.reload_mappings(command)  # rospy reads them on import
    try:
        runpy.run_path(command[0], run_name="__main__")
    finally:
        atexit._run_exitfuncs()
