"""What all nodes have in common."""

import sys

import pytest
from harness import wait_for

NODES = (
    "controller",
    "lap_evaluator",
    "lookahead_visualizer",
    "raceline_publisher",
    "steering_ramp",
)


@pytest.fixture
def simulated_time(ros):
    ros.set_param("/use_sim_time", True)
    yield
    ros.delete_param("/use_sim_time")


def test_simulated_time_that_does_not_run_is_named(simulated_time, start):
    """Left on the parameter server by a simulation, it makes everything wait."""
    # Interpreters of their own, in which each has to import all that it needs.
    nodes = {name: start(name, python=sys.executable) for name in NODES}
    text = "/use_sim_time is true, but there is no time on /clock (nobody publishes it)"
    for name, node in nodes.items():
        wait_for(lambda: text in node.output, 30.0, name)  # noqa: B023
