"""Doubt about a measured speed that is of another moment than its pose."""

from __future__ import annotations

import numpy as np

from ..bags.twist import lag_of_speed, when
from .speed import fresh

__all__ = ["late_speed"]


def late_speed(topic: str, t: np.ndarray, x: np.ndarray, y: np.ndarray, v: np.ndarray) -> str:
    """Doubt about a measured speed that is of another moment than its pose; or empty.

    Parameters
    ----------
    topic : str
        Name of the poses.
    t, x, y, v : ndarray, shape (n,)
        Times [s], positions [m], and measured speeds [m/s].
    """
    if not (np.isfinite(v).all() and v.any()):
        return ""
    new = fresh(t, x, y)
    lag = lag_of_speed(t, v, t[new], x[new], y[new])
    if lag is None:
        return ""
    return (
        f"{topic}: the measured speed comes {when(lag)} the motion of the poses: speeds at places, "
        "and speed errors, are those of another moment"
    )
