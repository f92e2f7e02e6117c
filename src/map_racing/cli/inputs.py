"""Inputs that several commands read, with what there is to say about them."""

from __future__ import annotations

from ..vehicle.parameters import Vehicle, load_vehicle

__all__ = ["joined", "read_vehicle"]


def joined(paths: list[str], join: bool) -> list:
    """Sources of the recordings to read: each file, or with ``--join`` all of them as one run."""
    return [tuple(paths)] if join else list(paths)


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
