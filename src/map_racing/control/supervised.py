"""A controller and its supervisor together: pose in, supervised command out."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Callable, NamedTuple

from ..errors import MapRacingError
from ..vehicle.size import size_of
from .controller import Controller, ControlResult
from .decision import Decision
from .safety import Supervisor
from .safety_limits import SafetyLimits
from .slowing import Slowing
from .steering import build_steering_maps

if TYPE_CHECKING:
    from ..track.raceline import Raceline
    from ..vehicle.parameters import Vehicle
    from .parameters import ControllerParameters
    from .state import CarState

__all__ = ["SupervisedController", "SupervisedStep", "build_slowing", "build_supervisor"]


class SupervisedStep(NamedTuple):
    """Outcome of one pose; `result` is None if the controller may not use it."""

    result: ControlResult | None
    decision: Decision


class SupervisedController:
    """Controller and supervisor, as they drive the car in the node and in simulation.

    Parameters
    ----------
    controller : Controller
    supervisor : Supervisor
    on_raceline : callable, optional
        Called when a raceline that had to wait for the car to stop is finally in use.
    on_restart : callable, optional
        Called when time was set back and the controller has been reset.

    Attributes
    ----------
    controller, supervisor
    changing : threading.Lock
        Hold it to change the controller's settings, from `Controller.prepare` on. The steps never
        wait for it; while it is held, a pending raceline waits for another step.
    """

    def __init__(
        self,
        controller: Controller,
        supervisor: Supervisor,
        on_raceline: Callable[[], None] = lambda: None,
        on_restart: Callable[[], None] = lambda: None,
    ):
        self.controller, self.supervisor = controller, supervisor
        self._on_raceline, self._on_restart, self._waiting = on_raceline, on_restart, None
        self.changing = threading.Lock()
        supervisor.on_restart = self._restart

    def _restart(self):
        self.controller.reset()
        self._on_restart()

    def step(self, now: float, state: CarState, failed: bool = False) -> SupervisedStep:
        """Answer a pose.

        Parameters
        ----------
        now : float
            Time of its arrival [s].
        state : CarState
        failed : bool, optional
            Whether the controller has failed and must not be run.
        """
        controller, supervisor = self.controller, self.supervisor
        trusted = supervisor.observe(now, state)
        if self._waiting is not None and supervisor.stands:
            self._follow_waiting()
        result = controller.step(state) if trusted and not failed else None
        decision = supervisor.decide(now, result)
        if result is not None:
            controller.sent(decision.steering_angle)
        return SupervisedStep(result, decision)

    def _follow_waiting(self):
        """Drive the pending raceline, unless another thread is changing the settings."""
        if not self.changing.acquire(blocking=False):
            return
        try:
            waiting, self._waiting = self._waiting, None
            try:
                self.controller.change(**waiting)
            except MapRacingError:
                # Tuning in the meantime may have set grip_use to 0 for a raceline without speeds.
                self.refuse()
                raise
            self.supervisor.raceline_changed(True)
            self._on_raceline()
        finally:
            self.changing.release()

    def follow(self, raceline: Raceline, sectors, setup: object) -> bool:
        """Drive along another raceline from the next step on.

        A raceline that runs against the motion of the car, as when somebody publishes it reversed,
        has to wait until the car has stopped along the old one.

        Parameters
        ----------
        raceline : Raceline
        sectors : SpeedSectors or None
        setup : object
            Result of `Controller.prepare` for both.

        Returns
        -------
        bool
            Whether it is in use now.
        """
        opposed = self.controller.raceline is not None and self.supervisor.opposes(raceline)
        self._waiting = {"raceline": raceline, "sectors": sectors} if opposed else None
        if not opposed:
            self.controller.apply(setup)
        self.supervisor.raceline_changed(True, opposed)
        return not opposed

    def refuse(self) -> None:
        """Stop for a raceline that cannot be driven, and drop a pending one."""
        self._waiting = None
        self.supervisor.raceline_changed(False)

    def tune(self, setup: object, limits: SafetyLimits) -> None:
        """Drive with other parameters and limits from the next step on.

        Parameters
        ----------
        setup : object
            Result of `Controller.prepare` for the parameters, which also set how the car stops.
        limits : SafetyLimits
        """
        controller, supervisor = self.controller, self.supervisor
        controller.apply(setup)
        supervisor.limits = limits
        if supervisor.slowing is not None:
            grip = supervisor.slowing.grip
            supervisor.slowing = build_slowing(controller.parameters, controller.vehicle, grip)


def build_supervisor(controller: Controller, limits: SafetyLimits, grip=None) -> Supervisor:
    """Supervisor of a controller, with the grip of the car's own tires.

    Parameters
    ----------
    controller : Controller
        Its parameters give the largest speed and the braking on a straight.
    limits : SafetyLimits
    grip : LookupTable, optional
        By default the table of the vehicle.
    """
    parameters = controller.parameters
    slowing = build_slowing(parameters, controller.vehicle, grip)
    return Supervisor(limits, parameters.v_max_mps, slowing)


def build_slowing(parameters: ControllerParameters, vehicle: Vehicle, grip=None) -> Slowing:
    """Friction ellipse for the supervisor; `grip` is by default the table of the vehicle."""
    if grip is None:
        grip = build_steering_maps(parameters, vehicle)[1]
    return Slowing(
        grip,
        parameters.a_brake_max_mps2,
        vehicle.delta_max,
        always=parameters.steering_map != "ackermann",
        size=size_of(vehicle),
    )
