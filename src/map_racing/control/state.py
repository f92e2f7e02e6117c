"""State of the car, and how to move it to another reference point or time."""

from __future__ import annotations

import math
from typing import NamedTuple

__all__ = ["CarState", "moved", "predicted"]


class CarState(NamedTuple):
    """Planar state of one reference point of the car at one instant.

    Parameters
    ----------
    t : float
        Time of the measurement [s].
    x, y : float
        Position of the reference point in the map frame [m].
    psi : float
        Heading of the car, counter-clockwise from the map's x-axis [rad].
    v_x, v_y : float
        Velocity of the reference point along the car's own axes, forward and left [m/s].
        ``v_y`` is NaN if it is not measured; the controller then estimates it.
    r : float
        Yaw rate [rad/s].
    """

    t: float
    x: float
    y: float
    psi: float
    v_x: float
    v_y: float
    r: float


def moved(state: CarState, distance: float) -> CarState:
    """The same motion seen from a reference point `distance` [m] farther forward on the car.

    The distance is ``l_r`` from the rear axle to the center of gravity, and ``-l_r`` back.
    """
    t, x, y, psi, v_x, v_y, r = state
    return CarState(
        t,
        x + distance * math.cos(psi),
        y + distance * math.sin(psi),
        psi,
        v_x,
        v_y + distance * r,
        r,
    )


def predicted(state: CarState, horizon: float) -> CarState:
    """The state `horizon` [s] later, at constant body-fixed velocity and yaw rate (a circular arc).

    The chord of the arc has the length ``v T sin(h)/h`` with ``h = r T / 2`` and points ``h`` past
    the initial direction of motion; both are exact for constant ``v_x, v_y, r``.
    """
    t, x, y, psi, v_x, v_y, r = state
    half_turn = 0.5 * r * horizon
    if half_turn > 1e-4 or half_turn < -1e-4:
        reach = horizon * math.sin(half_turn) / half_turn
    else:  # sin(h)/h to double precision
        reach = horizon * (1.0 - half_turn * half_turn / 6.0)
    cos_chord = math.cos(psi + half_turn)
    sin_chord = math.sin(psi + half_turn)
    values = (
        t + horizon,
        x + reach * (v_x * cos_chord - v_y * sin_chord),
        y + reach * (v_x * sin_chord + v_y * cos_chord),
        psi + r * horizon,
        v_x,
        v_y,
        r,
    )
    # Same as CarState(...), in half the time.
    return tuple.__new__(CarState, values)
