"""Acceleration limits of a vehicle for speed profiles."""

from __future__ import annotations

from typing import Any

import numpy as np

from .grids import GRID_SPEEDS, default_grid
from .lookup import LookupTable
from .parameters import Vehicle
from .steady_state import steady_state_table

__all__ = ["speed_limits"]


def speed_limits(
    vehicle: Vehicle,
    table: LookupTable | None = None,
    *,
    lateral_scale: float = 1.0,
    longitudinal_scale: float = 1.0,
    v_max: float | None = None,
    power: float | None = None,
) -> dict[str, Any]:
    """Limits of a vehicle, as keyword arguments of `map_racing.track.speed_profile.speed_profile`.

    Parameters
    ----------
    vehicle : Vehicle
    table : LookupTable, optional
        Table with the lateral limit, by default the vehicle's own.
    lateral_scale, longitudinal_scale : float, optional
        Share of the lateral acceleration, and of driving and braking, to use.
    v_max : float, optional
        Top speed [m/s], if lower than the vehicle's.
    power : float, optional
        Power of the drive [W], which limits the acceleration at speed v to ``power / (m v)``.

    Returns
    -------
    dict
        ``a_lat_max``, ``a_drive_max``, ``a_brake_max`` [m/s^2] and ``v_max`` [m/s].
    """
    fastest = vehicle.v_max if v_max is None else min(vehicle.v_max, v_max)
    if table is None:
        column = min(max(fastest, 0.5), GRID_SPEEDS[1])
        table = steady_state_table(vehicle, *default_grid(vehicle, column))
    drive = longitudinal_scale * vehicle.a_max
    if power is not None:
        corner = power / (vehicle.m * drive)  # speed up to which a_max is the limit, not the power

        def drive(v, most=drive):
            return most * corner / np.maximum(v, corner)

    return {
        "a_lat_max": lambda v: lateral_scale * table.max_lateral_acceleration(v),
        "a_drive_max": drive,
        "a_brake_max": longitudinal_scale * vehicle.a_brake_max,
        "v_max": fastest,
    }
