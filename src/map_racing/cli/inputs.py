"""Inputs of several commands; notes about them are printed."""

from __future__ import annotations

import argparse
import dataclasses
from typing import TYPE_CHECKING

from ..errors import ParameterError
from ..identification.channels import Channel, ChannelMap, load_channel_map
from ..vehicle.parameters import Vehicle, load_vehicle
from .options.recording import SERVO

if TYPE_CHECKING:
    from ..simulation.plant import PlantParameters
    from ..simulation.public_simulator import PublicSimulatorParameters

__all__ = ["channel_map", "joined", "read_plant", "read_vehicle"]


def joined(paths: list[str], join: bool) -> list:
    """Sources of the recordings to read: each file or, with ``--join``, all as one run."""
    return [tuple(paths)] if join else list(paths)


def read_plant(source: str) -> PlantParameters | PublicSimulatorParameters:
    """Load a plant and print the notes on the vehicle that it names.

    Parameters
    ----------
    source : str
        See `load_plant`.

    Raises
    ------
    FileFormatError, ParameterError
        If it cannot be read.
    """
    # Imported here: most commands that read a vehicle do not simulate.
    from ..simulation.plants import load_plant

    plant = load_plant(source)
    for note in plant.vehicle.notes:
        print(f"{source}: its vehicle {plant.vehicle.name}: {note}")
    return plant


def read_vehicle(source: str) -> Vehicle:
    """Load a car and print the notes on its file.

    Parameters
    ----------
    source : str
        See `load_vehicle`.

    Returns
    -------
    Vehicle

    Raises
    ------
    FileFormatError, ParameterError
        If it cannot be read.
    """
    vehicle = load_vehicle(source)
    for note in vehicle.notes:
        print(f"{source}: {note}")
    return vehicle


def channel_map(arguments: argparse.Namespace) -> ChannelMap:
    """The channel map with the changes from the command line."""
    channels = load_channel_map(arguments.channels) if arguments.channels else ChannelMap()
    if arguments.pose_topic:
        channels = dataclasses.replace(channels, pose_topic=arguments.pose_topic)
    gain, offset = arguments.servo_gain, arguments.servo_offset
    if not arguments.servo_topic and (gain, offset) != SERVO:
        raise ParameterError("--servo-gain, --servo-offset: expected --servo-topic, too")
    if arguments.servo_topic:
        if not gain:
            raise ParameterError("--servo-gain: expected a number other than 0, got 0")
        steering = Channel(arguments.servo_topic, scale=1.0 / gain, offset=-offset / gain)
        merged = {**channels.channels, "steering": steering}
        channels = dataclasses.replace(channels, channels=merged)
    if arguments.steering_delay is not None:
        setup = dataclasses.replace(channels.setup, steering_delay_s=arguments.steering_delay)
        channels = dataclasses.replace(channels, setup=setup)
    return channels
