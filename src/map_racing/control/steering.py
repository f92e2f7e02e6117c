"""Steering maps: the steering angle for a lateral acceleration.

They are the only difference between pure pursuit and MAP. Each map has
``steering(v, a_lat) -> (delta, saturated)``: the angle [rad] at which the car turns with `a_lat`
[m/s^2] at speed `v` [m/s], and whether that exceeds what the car can reach, in which case `delta`
is the angle of the tightest turn.

:class:`map_racing.vehicle.lookup.LookupTable` is such a map. This module has the kinematic one and
builds the map that the parameters name.
"""

from __future__ import annotations

import math
from functools import lru_cache

from ..errors import ParameterError
from ..vehicle.grids import default_grid
from ..vehicle.parameters import linearized
from ..vehicle.steady_state import steady_state_table

__all__ = ["AckermannSteering", "build_steering_map", "build_steering_maps"]


class AckermannSteering:
    """Kinematic steering ``delta = atan(l_wb a_lat / v^2)``: pure pursuit.

    It ignores the tires: its only limit is the steering lock.

    Parameters
    ----------
    l_wb : float
        Wheelbase [m].
    delta_max : float
        Steering lock [rad].
    """

    def __init__(self, l_wb: float, delta_max: float):
        self.l_wb = l_wb
        self.delta_max = delta_max

    def steering(self, v: float, a_lat: float) -> tuple:
        """Steering angle [rad] for speed [m/s] and lateral acceleration [m/s^2], and saturation."""
        delta = math.atan2(self.l_wb * a_lat, v * v) if a_lat else 0.0
        if abs(delta) > self.delta_max:
            return math.copysign(self.delta_max, delta), True
        return delta, False

    def max_lateral_acceleration(self, v: float) -> float:
        """Lateral acceleration at full lock [m/s^2] at a speed [m/s], from kinematics alone."""
        return v * v * math.tan(self.delta_max) / self.l_wb


@lru_cache(maxsize=16)
def build_steering_map(kind, vehicle, v_max):
    """Steering map of a vehicle, cached because it is immutable.

    Parameters
    ----------
    kind : {"ackermann", "linear_table", "table"}
        See :class:`~map_racing.control.parameters.ControllerParameters`.
    vehicle : Vehicle
    v_max : float
        Largest speed in the table [m/s]; the table extrapolates beyond it.

    Returns
    -------
    AckermannSteering or LookupTable

    Raises
    ------
    ParameterError
        If there is no such steering map.
    """
    if kind == "ackermann":
        return AckermannSteering(vehicle.l_wb, vehicle.delta_max)
    if kind == "linear_table":
        vehicle = linearized(vehicle)
    elif kind != "table":
        raise ParameterError(
            f"steering_map: expected ackermann, linear_table or table, got {kind!r}"
        )
    v_max = min(max(v_max, 1.0), 100.0)
    return steady_state_table(vehicle, *default_grid(vehicle, v_max=v_max))


def build_steering_maps(parameters, vehicle):
    """Steering map that the parameters name, and the table that limits the speeds.

    The grip does not depend on how the steering angle is found, so the table that limits the speeds
    is always made with the vehicle's own tires.

    Parameters
    ----------
    parameters : ControllerParameters
    vehicle : Vehicle

    Returns
    -------
    steering_map : AckermannSteering or LookupTable
    grip : LookupTable
        The same object where the steering map is that table.
    """
    kind, v_max = parameters.steering_map, parameters.v_max_mps
    steering_map = build_steering_map(kind, vehicle, v_max)
    if kind == "table":
        return steering_map, steering_map
    return steering_map, build_steering_map("table", vehicle, v_max)
