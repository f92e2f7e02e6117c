"""Racelines as the waypoints of ``f110_msgs/WpntArray``, which the public stacks send."""

from __future__ import annotations

from typing import Callable

import numpy as np

from ...bags.messages import WAYPOINT_FIELDS
from ..raceline import Raceline
from ..speed_profile import accelerations

__all__ = ["waypoint_array", "waypoint_rows"]


def waypoint_array(count: int, **columns: np.ndarray | None) -> np.ndarray:
    """Waypoints with these fields; those that are None or missing are 0.

    Returns
    -------
    ndarray, shape (count,)
        Structured, with the fields of ``f110_msgs/Wpnt`` except ``id``: ``s_m d_m x_m y_m d_right
        d_left psi_rad kappa_radpm vx_mps ax_mps2``.
    """
    rows = np.zeros(count, dtype=[(field, float) for field in WAYPOINT_FIELDS])
    for field, column in columns.items():
        if column is not None:
            rows[field] = column
    return rows


def waypoint_rows(
    raceline: Raceline,
    spacing: float = 0.1,
    speed: Callable[[np.ndarray], np.ndarray] | None = None,
) -> np.ndarray:
    """Waypoints at even distances along a raceline.

    Parameters
    ----------
    raceline : Raceline
        Speeds and widths that it lacks are 0.
    spacing : float, optional
        Distance between the waypoints [m], rounded to divide the lap evenly.
    speed : callable, optional
        Speeds [m/s] at an array of arc lengths [m], instead of the raceline's own.

    Returns
    -------
    ndarray, shape (n,)
        See `waypoint_array`. The acceleration is constant from one waypoint to the next:
        ``v_2^2 = v_1^2 + 2 a ds``.
    """
    count = max(4, int(round(raceline.length / spacing)))
    s = np.arange(count) * (raceline.length / count)
    curve = raceline.sample(s)
    v = curve.speed if speed is None else speed(s)
    return waypoint_array(
        count,
        s_m=s,
        x_m=curve.x,
        y_m=curve.y,
        d_right=curve.d_right,
        d_left=curve.d_left,
        psi_rad=curve.psi,
        kappa_radpm=curve.kappa,
        vx_mps=v,
        ax_mps2=None if v is None else accelerations(v, raceline.length / count),
    )
