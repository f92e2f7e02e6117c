"""Controllers by the law of their files: L1 guidance, or its rival, model predictive control."""

from __future__ import annotations

from pathlib import Path

from ..files import read_yaml_mapping
from ..resources import find_config
from ..validation import read_parameters
from .controller import Controller, build_controller
from .mpc import ModelPredictiveController
from .parameters import ControllerParameters, MpcParameters, load_controller_parameters

__all__ = ["build_law", "load_law"]


def load_law(source: str | Path) -> ControllerParameters | MpcParameters:
    """Read a controller file of any law.

    Parameters
    ----------
    source : str or pathlib.Path
        Shipped name or path of a YAML file; with ``law: mpc`` it holds `MpcParameters`.

    Raises
    ------
    ParameterError
        If a parameter is missing, unknown or impossible; the message names file and parameter.
    """
    path = find_config("controllers", source, (".yaml",))
    values = read_yaml_mapping(path)
    if values.get("law") != "mpc":
        return load_controller_parameters(source)
    del values["law"]
    return read_parameters(path, MpcParameters, values)


def build_law(
    parameters, vehicle, raceline, sectors=None
) -> Controller | ModelPredictiveController:
    """The controller that parameters are for.

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
