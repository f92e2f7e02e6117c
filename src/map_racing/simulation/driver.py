"""Drivers of a simulated car: a controller alone, or supervised as on the real car."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..control.controller import ControlResult, Status
from ..control.decision import Decision
from ..control.safety_limits import SafetyLimits
from ..control.supervised import SupervisedController, build_supervisor
from ..track.raceline import Raceline

__all__ = ["Command", "DirectDriver", "SupervisedDriver", "reversed_raceline"]


class Command(NamedTuple):
    """A supervised command and its time [s]."""

    t: float
    decision: Decision


class DirectDriver:
    """A controller without a supervisor; every pose gets a command."""

    deadline = None
    commands = ()

    def __init__(self, controller):
        self._controller = controller

    def step(self, seen):
        """Answer an `Observation` with a `ControlResult`."""
        return self._controller.step(seen.measured)


class SupervisedDriver:
    """A controller under its supervisor, as in the node but without ROS.

    Parameters
    ----------
    controller : Controller
    limits : SafetyLimits, optional
        By default scaled to the car's size.

    Attributes
    ----------
    supervisor : Supervisor
    commands : list of Command
        All commands, including those sent without a pose.
    """

    def __init__(self, controller, limits=None):
        limits = limits or SafetyLimits().of_size(controller.vehicle)
        self.supervisor = build_supervisor(controller, limits)
        self._driver = SupervisedController(controller, self.supervisor)
        self._raceline, self._failing = controller.raceline, False
        self.commands = []

    @property
    def deadline(self):
        """Time at which to call `watch` unless a pose comes [s], or None."""
        return self.supervisor.deadline

    def step(self, seen):
        """Answer an `Observation`.

        Returns
        -------
        ControlResult
            With the supervisor's command; status invalid if the controller was not run.
        """
        now, state = seen.arrival, seen.measured
        if seen.frame:
            result, decision = None, self.supervisor.refuse(now)
        else:
            result, decision = self._driver.step(now, state, self._failing)
        self.commands.append(Command(now, decision))
        if result is None:
            result = ControlResult(0.0, 0.0, Status.INVALID_STATE, state, *(math.nan,) * 7)
        return result._replace(steering_angle=decision.steering_angle, speed=decision.speed)

    def watch(self, now):
        """Notice a dropout of the poses; return the command for it, or None."""
        decision = self.supervisor.watch(now)
        if decision is not None:
            self.commands.append(Command(now, decision))
        return decision

    def begin(self, fault):
        """Begin a fault outside the car, caused by operators or other nodes."""
        supervisor, name = self.supervisor, fault.fault
        if name == "stop_requested":
            supervisor.request_stop("service")
        elif name == "resumed":
            self._failing = False
            supervisor.resume()
        elif name == "controller_failed":
            self._failing = True
            supervisor.fail()
        elif name == "raceline_lost":
            self._driver.refuse()
        elif name == "raceline_reversed":
            self._follow(reversed_raceline(self._raceline))

    def end(self, fault):
        """End a fault outside the car."""
        if fault.fault == "raceline_lost":
            self.supervisor.raceline_changed(True)
        elif fault.fault == "raceline_reversed":
            self._follow(self._raceline)

    def _follow(self, raceline):
        controller = self._driver.controller
        self._driver.follow(raceline, None, controller.prepare(raceline=raceline, sectors=None))


def reversed_raceline(raceline: Raceline) -> Raceline:
    """The same line in the opposite direction."""
    s = np.arange(0.0, raceline.length, 0.2)[::-1]
    x, y = (np.array(values) for values in zip(*(raceline.position(at) for at in s.tolist())))
    speed = None if raceline.speed is None else [raceline.speed_at(at) for at in s.tolist()]
    return Raceline(x, y, vx_mps=speed, name=f"{raceline.name}, reversed")
