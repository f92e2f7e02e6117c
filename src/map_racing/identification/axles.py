"""Axle forces and slip angles from steady-state cornering.

At constant speed and yaw rate, the forces of both axles follow from the lateral acceleration alone,
and the slip angles from the velocity of the center of gravity, the yaw rate and the steering angle
(Becker et al., ICRA 2023, section on the identification of the tires; Voser et al., 2010).

The paper divides the front force by the cosine of the steering angle, but this cosine is neither in
its equations of motion nor in ours (`single_track`). A tire identified with it and used without it
overestimates the acceleration by the factor ``1 / cos(delta)``, 8 % at 0.4 rad. So the default is
the force in the equations of motion; ``front_force="paper"`` divides it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..errors import ParameterError
from ..vehicle.parameters import Vehicle
from ..vehicle.single_track import GRAVITY, axle_loads, slip_angles

__all__ = ["AxlePoints", "axle_points"]


class AxlePoints(NamedTuple):
    """Measured points of one axle.

    Parameters
    ----------
    slip : ndarray, shape (n,)
        Slip angle [rad], signs as in `single_track`: negative in a left turn.
    force : ndarray, shape (n,)
        Lateral force [N], positive to the left.
    load : float
        Static vertical load [N].
    slip_noise, force_noise : float
        Standard deviations of their errors [rad], [N]; only their ratio matters.
    difference_noise : float
        Standard deviation of the error of the difference between the slips of both axles [rad].
    """

    slip: np.ndarray
    force: np.ndarray
    load: float
    slip_noise: float = 0.0
    force_noise: float = 0.0
    difference_noise: float = 0.0


def axle_points(
    vehicle: Vehicle,
    v_x: np.ndarray,
    v_y: np.ndarray,
    r: np.ndarray,
    delta: np.ndarray,
    a_y: np.ndarray,
    front_force: str = "model",
) -> tuple[AxlePoints, AxlePoints]:
    """Slip angles and forces of both axles from steady-state cornering.

    Parameters
    ----------
    vehicle : Vehicle
        Mass and geometry; its tires do not matter.
    v_x, v_y : ndarray, shape (n,)
        Velocity of the center of gravity along the car's axes [m/s].
    r : ndarray, shape (n,)
        Yaw rate [rad/s].
    delta : ndarray, shape (n,)
        Steering angle of the front wheels [rad].
    a_y : ndarray, shape (n,)
        Lateral acceleration of the center of gravity [m/s^2].
    front_force : {"model", "paper"}
        ``F_yf = m l_r a_y / (l_r + l_f)`` as in `single_track`, or divided by ``cos(delta)``.

    Returns
    -------
    front, rear : AxlePoints
        Without noise levels.

    Raises
    ------
    ParameterError
        For another `front_force`.
    """
    if front_force not in ("model", "paper"):
        raise ParameterError(f"front_force: expected model or paper, got {front_force!r}")
    alpha_f, alpha_r = slip_angles(vehicle, v_x, v_y, r, delta, v_eps=1e-3)
    load_f, load_r = axle_loads(vehicle, 0.0)
    F_yf, F_yr = load_f / GRAVITY * a_y, load_r / GRAVITY * a_y
    if front_force == "paper":
        F_yf = F_yf / np.cos(delta)
    return AxlePoints(alpha_f, F_yf, load_f), AxlePoints(alpha_r, F_yr, load_r)
