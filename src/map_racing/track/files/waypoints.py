"""A raceline as the waypoints that the public stacks send."""

import numpy as np

from ...errors import ParameterError
from ..speed_profile import accelerations

__all__ = ["WAYPOINT_COLUMNS", "scaled_speed", "waypoint_rows"]

# Fields of f110_msgs/Wpnt that are read, and what `raceline_from_columns` calls them.
WAYPOINT_COLUMNS = {
    "s_m": "s",
    "x_m": "x",
    "y_m": "y",
    "psi_rad": "psi",
    "kappa_radpm": "kappa",
    "vx_mps": "speed",
    "ax_mps2": "ax",
    "d_left": "d_left",
    "d_right": "d_right",
}


def waypoint_rows(raceline, spacing=0.1, speed=None):
    """Waypoints at even distances along the raceline.

    Parameters
    ----------
    raceline : Raceline
        Speeds and widths that it lacks are written as 0.
    spacing : float, optional
        Distance between the waypoints [m], rounded so that they divide the lap evenly.
    speed : callable, optional
        Speeds [m/s] at an array of arc lengths [m], instead of the raceline's own.

    Returns
    -------
    ndarray, shape (n, 10)
        ``s_m d_m x_m y_m d_right d_left psi_rad kappa_radpm vx_mps ax_mps2``, the order of
        ``f110_msgs/Wpnt``. The acceleration is constant from one waypoint to the next:
        ``v_2^2 = v_1^2 + 2 a ds``.
    """
    count = max(4, int(round(raceline.length / spacing)))
    s = np.arange(count) * (raceline.length / count)
    curve = raceline.sample(s)
    zeros = np.zeros(count)
    v = zeros if curve.speed is None else curve.speed
    if speed is not None:
        v = speed(s)
    a_x = accelerations(v, raceline.length / count)
    right = zeros if curve.d_right is None else curve.d_right
    left = zeros if curve.d_left is None else curve.d_left
    return np.stack((s, zeros, curve.x, curve.y, right, left, curve.psi, curve.kappa, v, a_x), 1)


def scaled_speed(raceline, scale=1.0, sectors=None):
    """Speed along a raceline under a scale and speed sectors.

    Parameters
    ----------
    raceline : Raceline
    scale : float
        At least 0.
    sectors : SpeedSectors, optional
        Anything with ``scale_at(s)``.

    Returns
    -------
    callable
        Speeds [m/s] at an array of arc lengths [m].

    Raises
    ------
    ParameterError
        If the raceline has no speeds, or the scale is negative or not finite.
    """
    if raceline.speed is None:
        raise ParameterError(f"{raceline.source or raceline.name}: the raceline has no speeds")
    if not 0.0 <= scale < np.inf:
        raise ParameterError(f"speed_scale: expected 0 or more, got {scale}")

    def speed(s):
        v = scale * raceline.sample(s).speed
        return v if sectors is None else v * np.array([sectors.scale_at(at) for at in s.tolist()])

    return speed
