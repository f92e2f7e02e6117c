"""Speeds and steering angles for which lookup tables are computed."""

from __future__ import annotations

import math

import numpy as np

from ..errors import ParameterError
from .parameters import Vehicle
from .size import ONE_TENTH, size_of

__all__ = ["GRID_SPEEDS", "default_grid", "published_grid"]

GRID_SPEEDS = 0.2, 100.0
"""Bounds of the fastest column of a grid [m/s]."""


def default_grid(vehicle: Vehicle, v_max: float | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Speeds and angles dense enough that interpolation errors hardly matter.

    There are 257 angles, and about one column per 0.1 m/s from 0.1 m/s on; the notes of
    `LookupTable` quantify the errors. The table of ``nuc4`` takes 27 ms to compute. For larger cars
    the spacing of the columns scales with their speed, and small angles are denser, because at full
    speed they steer by hundredths of a radian.

    Parameters
    ----------
    vehicle : Vehicle
    v_max : float, optional
        Fastest column [m/s], from 0.2 to 100; default: the vehicle's, within these bounds. Above
        it the table extrapolates.

    Returns
    -------
    speeds, angles : ndarray
        [m/s] and [rad], up to the vehicle's largest steering angle.

    Raises
    ------
    ParameterError
        If `v_max` is out of its range.
    """
    slowest, fastest = GRID_SPEEDS
    v_max = min(max(vehicle.v_max, slowest), fastest) if v_max is None else float(v_max)
    if not slowest <= v_max <= fastest:
        raise ParameterError(
            f"v_max: expected a speed from {slowest:g} to {fastest:g} m/s, got {v_max:g}"
        )
    size = size_of(vehicle)
    speeds = np.linspace(0.1, v_max, int(math.ceil(10.0 / size.time * (v_max - 0.1))) + 1)
    if size == ONE_TENTH:
        return speeds, np.linspace(0.0, vehicle.delta_max, 257)
    return speeds, vehicle.delta_max * np.linspace(0.0, 1.0, 257) ** 2


def published_grid() -> tuple[np.ndarray, np.ndarray]:
    """Speeds and angles of the published tables, which contain 0.1 rad twice.

    Returns
    -------
    speeds : ndarray, shape (65,)
        [m/s]
    angles : ndarray, shape (60,)
        [rad]
    """
    angles = np.concatenate((np.linspace(0.0, 0.1, 30), np.linspace(0.1, 0.4, 30)))
    return np.linspace(0.5, 7.0, 65), angles
