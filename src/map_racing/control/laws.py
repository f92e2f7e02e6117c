"""Builds the controller that the parameters call for: L1 guidance or model predictive control."""

from __future__ import annotations

from .controller import Controller, build_controller
from .mpc import ModelPredictiveController
from .parameters import MpcParameters

__all__ = ["build_law"]


def build_law(
    parameters, vehicle, raceline, sectors=None
) -> Controller | ModelPredictiveController:
    """Build a controller of the law that the parameters belong to.

    Parameters
    ----------
    parameters : ControllerParameters or MpcParameters
    vehicle : Vehicle
    raceline : Raceline
    sectors : SpeedSectors, optional
    """
    if isinstance(parameters, MpcParameters):
        return ModelPredictiveController(parameters, vehicle, raceline, sectors)
    return build_controller(parameters, vehicle, raceline, sectors)
