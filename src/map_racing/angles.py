"""Angles in radians, counter-clockwise positive."""

from __future__ import annotations

import math

__all__ = ["wrap", "yaw_from_quaternion"]

_TWO_PI = 2.0 * math.pi


def wrap(angle):
    """Bring angles into [-pi, pi), up to rounding.

    Parameters
    ----------
    angle : float or ndarray
        Angle [rad].

    Returns
    -------
    float or ndarray
        The same direction, of the same shape [rad].
    """
    return (angle + math.pi) % _TWO_PI - math.pi


def yaw_from_quaternion(x: float, y: float, z: float, w: float) -> float:
    """Yaw of a quaternion of any length, the rotation about the vertical axis (REP-103).

    Parameters
    ----------
    x, y, z, w : float
        Components of the quaternion.

    Returns
    -------
    float
        Yaw [rad] in [-pi, pi].
    """
    return math.atan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)
