"""The part of a controller that can be replaced while it drives."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

from ..track.tracker import RacelineTracker
from .grip_guard import GripGuard
from .speed_plan import AdaptiveSpeedPlan, SpeedPlan, requested_speed

if TYPE_CHECKING:
    from ..track.raceline import Raceline
    from .adaptation import Adaptation
    from .parameters import ControllerParameters
    from .speed_sectors import SpeedSectors

__all__ = ["Setup"]


class Setup(NamedTuple):
    """Arguments of `map_racing.control.controller.Controller` and objects built from them.

    Parameters
    ----------
    parameters : ControllerParameters
    steering_map, grip : object
    raceline : Raceline or None
    sectors : SpeedSectors or None
    top_speed : float
        Top speed of the car [m/s].
    tracker : RacelineTracker or None
        None without raceline.
    plan : SpeedPlan or None
        None without raceline or with a ``grip_use`` of 0.
    guard : GripGuard or None
        None without plan.
    adaptation : Adaptation or None
        None while adaptation is off.
    """

    parameters: ControllerParameters
    steering_map: Any
    grip: Any
    raceline: Raceline | None
    sectors: SpeedSectors | None
    top_speed: float
    tracker: RacelineTracker | None = None
    plan: SpeedPlan | None = None
    guard: GripGuard | None = None
    adaptation: Adaptation | None = None

    @property
    def grip_map(self) -> Any:
        """The steering map whose ``max_lateral_acceleration`` limits the speeds."""
        if self.adaptation is not None:
            return self.adaptation.file_steering
        return self.steering_map if self.grip is None else self.grip

    def with_plan(self, old: Setup | None) -> Setup:
        """This setup with its tracker and speed plan.

        Parameters
        ----------
        old : Setup or None
            The setup in use; its tracker and plan are kept if nothing they depend on changes.

        Raises
        ------
        ParameterError
            If the raceline has no speeds and ``grip_use`` is 0.
        """
        parameters, raceline = self.parameters, self.raceline
        if raceline is None:
            return self._replace(tracker=None, plan=None, guard=None)
        setup = self
        if old is None or raceline is not old.raceline:
            setup = setup._replace(tracker=RacelineTracker(raceline))
        if not parameters.grip_use:
            requested_speed(raceline, parameters)  # raises if the raceline has no speeds
            return setup._replace(plan=None, guard=None)
        if old is None or setup.plan is None or setup._plan_key() != old._plan_key():
            kind = SpeedPlan if setup.adaptation is None else AdaptiveSpeedPlan
            setup = setup._replace(
                plan=kind(raceline, parameters, setup.grip_map, setup.sectors, setup.top_speed),
                guard=GripGuard(setup.grip_map, parameters.v_max_mps),
            )
        return setup

    def _plan_key(self):
        """What a speed plan depends on; equal for equal plans."""
        return (
            *(id(self.raceline), id(self.sectors), id(self.grip_map)),
            *(getattr(self.parameters, name) for name in SpeedPlan.DEPENDS_ON),
        )
