"""Speeds at which the corners of a raceline reach the limit of a lookup table."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..errors import RacelineError
from .raceline import Raceline

__all__ = ["Corner", "corners", "runs_around"]

FASTEST_MPS = 30.0  # unless the table reaches farther
# A bend is a corner where its curvature exceeds SHARE of the largest, or where speed / limit
# exceeds NEAR times the largest ratio of the lap.
SHARE, NEAR = 0.25, 0.9


class Corner(NamedTuple):
    """The place in a corner that is closest to the limit.

    Parameters
    ----------
    s : float
        Arc length [m].
    curvature : float
        Curvature there [1/m], positive to the left.
    limit_speed : float
        Speed that uses all of the table's lateral acceleration [m/s]; inf above 30 m/s and the
        table's last speed, 0 if the bend is tighter than any angle of the table.
    speed : float
        Speed of the raceline there [m/s]; NaN if it has none.
    """

    s: float
    curvature: float
    limit_speed: float
    speed: float

    @property
    def share(self) -> float:
        """Speed of the raceline as a share of the limit."""
        return self.speed / self.limit_speed if self.limit_speed > 0.0 else math.inf


def corners(raceline: Raceline, table) -> list[Corner]:
    """Find the corners of a raceline and the speeds at which they reach the limit of a table.

    Parameters
    ----------
    raceline : Raceline
    table : LookupTable

    Returns
    -------
    list of Corner
        In the order of arc length. Each is the place driven closest to the limit or, if the
        raceline has no speeds, the tightest.

    Raises
    ------
    RacelineError
        If there are no corners.
    """
    kappa = np.asarray(raceline.kappa)
    largest = float(np.max(np.abs(kappa)))
    if largest < 1e-3:
        raise RacelineError(f"{raceline.name or 'raceline'}: expected corners, got none")
    limit = _limit_speeds(table, np.abs(kappa))
    speed = raceline.speed if raceline.speed is not None else np.full(kappa.size, math.nan)
    bent = np.abs(kappa) > SHARE * largest
    need = np.abs(kappa)
    if raceline.speed is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            need = np.where(limit > 0.0, speed / limit, math.inf)
        # A fast bend may be closer to the limit than a tight one.
        steered = need[limit > 0.0]
        bent |= need > NEAR * (steered.max() if steered.size else 0.0)
    found = []
    for cells in runs_around(np.where(bent, np.sign(kappa), 0.0)):
        worst = cells[int(np.argmax(need[cells]))]
        found.append(
            Corner(*(float(column[worst]) for column in (raceline.s, kappa, limit, speed)))
        )
    return sorted(found)


def _limit_speeds(table, kappa):
    """Speeds at which ``v^2 kappa`` reaches the limit of the table, by interpolation."""
    v = np.linspace(0.02, max(FASTEST_MPS, float(table.speeds[-1])), 3000)
    # Largest curvature that can be driven at each speed, made non-increasing.
    allowed = np.minimum.accumulate(table.max_lateral_acceleration(v) / (v * v))
    limit = np.where(kappa > allowed[0], 0.0, np.interp(-kappa, -allowed, v))
    return np.where(kappa < allowed[-1], math.inf, limit)


def runs_around(kind: np.ndarray) -> list[np.ndarray]:
    """Cells of each run of equal non-zero values around the lap.

    Parameters
    ----------
    kind : ndarray, shape (n,)

    Returns
    -------
    list of ndarray of int
        Indices of each run, which may wrap around the end of the array.
    """
    changes = np.flatnonzero(kind != np.roll(kind, 1))
    if not changes.size:
        return [np.arange(kind.size)] if kind.any() else []
    ends = np.append(changes[1:], changes[0] + kind.size)
    bends = [np.arange(begin, end) % kind.size for begin, end in zip(changes, ends)]
    return [cells for cells in bends if kind[cells[0]] != 0.0]
