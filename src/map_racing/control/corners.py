"""How fast a raceline's corners can be driven with the grip that a lookup table knows."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..errors import RacelineError

__all__ = ["Corner", "corners"]

FASTEST_MPS = 30.0
# A bend counts as a corner where its curvature exceeds this share of the raceline's largest.
SHARE = 0.25


class Corner(NamedTuple):
    """The place of a corner that has the least to spare.

    Parameters
    ----------
    s : float
        Arc length [m].
    curvature : float
        Curvature there [1/m], positive to the left.
    limit_speed : float
        Speed at which it takes all of the table's lateral acceleration [m/s]; inf beyond 30 m/s.
    speed : float
        The raceline's own speed there [m/s]; NaN where it has none.
    """

    s: float
    curvature: float
    limit_speed: float
    speed: float

    @property
    def share(self):
        """The raceline's speed as a share of the limit."""
        return self.speed / self.limit_speed


def corners(raceline, table):
    """Corners of a raceline and the speeds at which they exceed a table's limit.

    Parameters
    ----------
    raceline : Raceline
    table : LookupTable

    Returns
    -------
    list of Corner
        In the order of arc length. Where the raceline has speeds, each is the place that it drives
        nearest to the limit, else the tightest.

    Raises
    ------
    RacelineError
        If it has no corners.
    """
    kappa = np.asarray(raceline.kappa)
    largest = float(np.max(np.abs(kappa)))
    if largest < 1e-3:
        raise RacelineError(f"{raceline.name or 'raceline'}: expected corners, it has none")
    limit = _limit_speeds(table, np.abs(kappa))
    speed = raceline.speed if raceline.speed is not None else np.full(kappa.size, math.nan)
    need = speed / limit if raceline.speed is not None else np.abs(kappa)
    found = []
    for cells in _bends(kappa, SHARE * largest):
        worst = cells[int(np.argmax(need[cells]))]
        found.append(
            Corner(*(float(column[worst]) for column in (raceline.s, kappa, limit, speed)))
        )
    return sorted(found)


def _limit_speeds(table, kappa):
    """Speeds at which ``v^2 kappa`` is the table's limit: by interpolation of what it allows."""
    v = np.linspace(0.02, FASTEST_MPS, 3000)
    # What curvature can be driven at each speed; it falls with speed, or is made to.
    allowed = np.minimum.accumulate(table.max_lateral_acceleration(v) / (v * v))
    limit = np.interp(-kappa, -allowed, v)
    return np.where(kappa < allowed[-1], math.inf, limit)


def _bends(kappa, least):
    """Cells of each bend: neighbors with curvature of one sign beyond `least`, around the lap."""
    kind = np.where(np.abs(kappa) > least, np.sign(kappa), 0.0)
    changes = np.flatnonzero(kind != np.roll(kind, 1))
    if not changes.size:
        return [np.arange(kappa.size)]
    ends = np.append(changes[1:], changes[0] + kappa.size)
    bends = [np.arange(begin, end) % kappa.size for begin, end in zip(changes, ends)]
    return [cells for cells in bends if kind[cells[0]] != 0.0]
