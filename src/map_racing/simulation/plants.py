"""Reads plant files and builds their plants."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from ..errors import ParameterError
from ..files import read_yaml_mapping
from ..resources import find_config
from ..validation import read_parameters
from ..vehicle.parameters import load_vehicle
from .commonroad import CommonRoadCar, CommonRoadParameters
from .plant import Localization, Plant, PlantParameters
from .public_simulator import PublicSimulator, PublicSimulatorParameters

__all__ = ["build_plant", "load_plant"]

# Models of plant files; the first is the default.
MODELS = {
    "single_track": PlantParameters,
    "public_simulator": PublicSimulatorParameters,
    "commonroad": CommonRoadParameters,
}


def load_plant(source: str | Path) -> PlantParameters | PublicSimulatorParameters:
    """Read a plant file and the vehicle file that it names.

    Parameters
    ----------
    source : str or pathlib.Path
        Shipped plant or plant file; its vehicle may be a file in the same folder.

    Raises
    ------
    ParameterError
        If a parameter is missing, unknown or impossible; the message names file and parameter.
    """
    path = find_config("plants", source, (".yaml",))
    values = read_yaml_mapping(path, "a plant file")
    model = values.pop("model", "single_track")
    if not isinstance(model, str) or model not in MODELS:
        raise ParameterError(f"{path}: model: expected {', '.join(MODELS)}, got {model!r}")
    parameters = read_parameters(path, MODELS[model], values)
    beside = path.parent / parameters.vehicle
    try:
        vehicle = load_vehicle(beside if beside.is_file() else parameters.vehicle)
    except ParameterError as error:
        raise ParameterError(f"{path}: vehicle: {error}") from None
    return replace(parameters, vehicle=vehicle)


def build_plant(
    parameters: PlantParameters | PublicSimulatorParameters, seed: int
) -> tuple[Plant | CommonRoadCar | PublicSimulator, Localization | None]:
    """Build a car and its localization, with noise from a seed.

    The public simulator has no localization, because its poses are exact.

    Raises
    ------
    ParameterError
        If the seed is negative.
    """
    if seed < 0:  # `random` would use its absolute value
        raise ParameterError(f"seed: expected 0 or more, got {seed}")
    if isinstance(parameters, PublicSimulatorParameters):
        return PublicSimulator(parameters), None
    kind = CommonRoadCar if isinstance(parameters, CommonRoadParameters) else Plant
    return kind(parameters), Localization(parameters, seed)
