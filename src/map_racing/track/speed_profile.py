"""Fastest speeds along a closed curve for a car of given acceleration limits."""

import math

import numpy as np

from ..errors import ParameterError

__all__ = ["lap_time", "speed_profile"]


def speed_profile(kappa, ds, *, a_lat_max, a_drive_max, a_brake_max, v_max):
    """Highest speeds within the friction ellipse, forwards and backwards around the lap.

    Lateral and longitudinal acceleration share the grip,
    ``(v^2 kappa / a_lat_max)^2 + (a_long / a_long_max)^2 <= 1``, where the longitudinal limit is
    `a_drive_max` or `a_brake_max`. The acceleration of a cell is constant and bounded by the
    ellipse at the end that is slower.

    Parameters
    ----------
    kappa : array_like, shape (n,)
        Curvature at equal steps of arc length around the closed curve [1/m].
    ds : float
        The step [m].
    a_lat_max, a_drive_max, a_brake_max : float
        Largest lateral, driving and braking acceleration [m/s^2], all positive.
    v_max : float
        Top speed [m/s].

    Returns
    -------
    ndarray, shape (n,)
        Speed [m/s].

    Raises
    ------
    ParameterError
        If a limit is not positive or the curvature is not finite.
    """
    limits = {
        "ds": ds,
        "a_lat_max": a_lat_max,
        "a_drive_max": a_drive_max,
        "a_brake_max": a_brake_max,
        "v_max": v_max,
    }
    for key, value in limits.items():
        if not 0.0 < value < math.inf:
            raise ParameterError(f"speed profile: expected {key} > 0, got {value}")
    kappa = np.abs(np.asarray(kappa, dtype=float))
    if kappa.ndim != 1 or not kappa.size or not np.all(np.isfinite(kappa)):
        raise ParameterError("speed profile: expected one finite curvature per point")
    square = np.minimum(v_max**2, a_lat_max / np.maximum(kappa, 1e-12))
    # Nothing lowers the slowest point, since from there speed can only grow in both directions:
    # one pass each way around the lap, begun there, is the converged solution.
    start = int(np.argmin(square))
    square = np.roll(square, -start).tolist()
    use = (np.roll(kappa, -start) / a_lat_max).tolist()
    square = _accelerate(square, use, 2.0 * ds * a_drive_max)
    # Mirrored, with the slowest point kept first, braking is driving.
    square = _accelerate(square[:1] + square[:0:-1], use[:1] + use[:0:-1], 2.0 * ds * a_brake_max)
    return np.roll(np.sqrt(square[:1] + square[:0:-1]), start)


def _accelerate(square, use, gain):
    """Limit squared speeds to what the grip left over by lateral acceleration reaches."""
    reached = square[0]
    limited = [reached]
    for i in range(1, len(square)):
        lateral = reached * use[i - 1]
        reached += gain * math.sqrt(max(0.0, 1.0 - lateral * lateral))
        reached = min(reached, square[i])
        limited.append(reached)
    return limited


def lap_time(speed, ds):
    """Time of one lap at constant acceleration from each point to the next.

    Parameters
    ----------
    speed : array_like, shape (n,)
        Speed at equal steps of arc length around the lap [m/s].
    ds : float
        The step [m].

    Returns
    -------
    float
        Lap time [s]; infinite if the car would stand still between two points.
    """
    speed = np.asarray(speed, dtype=float)
    both = speed + np.roll(speed, -1)
    return float(2.0 * ds * np.sum(1.0 / both)) if np.all(both > 0.0) else math.inf
