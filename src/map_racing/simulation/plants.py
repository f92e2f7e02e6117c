"""Every plant that can be raced: by its name or file, and built."""

from __future__ import annotations

from dataclasses import replace

from ..vehicle.parameters import Vehicle, load_vehicle
from .plant import Localization, Plant, load_plant_parameters
from .public_simulator import PublicSimulator, PublicSimulatorParameters

__all__ = ["PUBLIC_SIMULATOR", "build_plant", "load_plant"]

PUBLIC_SIMULATOR = "public_simulator"


def load_plant(source):
    """A plant with all that it is made of, so that a run depends on no file.

    Parameters
    ----------
    source : str
        Shipped plant, plant file, or ``public_simulator``.

    Returns
    -------
    PlantParameters or Vehicle
        The latter for the public simulator, whose only parameters are those of its car.
    """
    if source == PUBLIC_SIMULATOR:
        return load_vehicle("sim")
    parameters = load_plant_parameters(source)
    return replace(parameters, vehicle=load_vehicle(parameters.vehicle))


def build_plant(plant, seed):
    """A car that can be driven.

    Parameters
    ----------
    plant : PlantParameters, PublicSimulatorParameters or Vehicle
        As from `load_plant`.
    seed : int
        Of the noise.

    Returns
    -------
    plant : Plant or PublicSimulator
    localization : Localization or None
        The public simulator has none: its poses are true.
    """
    if isinstance(plant, Vehicle):
        return PublicSimulator(plant), None
    if isinstance(plant, PublicSimulatorParameters):
        return plant.build(), None
    return Plant(plant), Localization(plant, seed)
