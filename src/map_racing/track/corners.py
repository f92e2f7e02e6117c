"""How fast a raceline's corners can be driven with the grip that a lookup table knows."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..errors import RacelineError

__all__ = ["Corner", "corners"]

FASTEST_MPS = 30.0
# A bend counts as a corner where its curvature exceeds this share of the raceline's largest, or
# where the raceline is so near to the limit as this share of the place that is nearest.
SHARE, NEAR = 0.25, 0.9


class Corner(NamedTuple):
    """The place of a corner that has the least to spare.

    Parameters
    ----------
    s : float
        Arc length [m].
    curvature : float
        Curvature there [1/m], positive to the left.
    limit_speed : float
        Speed at which it takes all of the table's lateral acceleration [m/s]; inf beyond 30 m/s,
        and 0 where it is tighter than any angle of the table.
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
        return self.speed / self.limit_speed if self.limit_speed > 0.0 else math.inf


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
    bent = np.abs(kappa) > SHARE * largest
    need = np.abs(kappa)
    if raceline.speed is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            need = np.where(limit > 0.0, speed / limit, math.inf)
        # A fast bend may be nearer to the limit than a tight one.
        steered = need[limit > 0.0]
        bent |= need > NEAR * (steered.max() if steered.size else 0.0)
    found = []
    for cells in _bends(np.where(bent, np.sign(kappa), 0.0)):
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
    limit = np.where(kappa > allowed[0], 0.0, np.interp(-kappa, -allowed, v))
    return np.where(kappa < allowed[-1], math.inf, limit)


def _bends(kind):
    """Cells of each bend: neighbors of one kind, 1 or -1, around the lap."""
    changes = np.flatnonzero(kind != np.roll(kind, 1))
    if not changes.size:
        return [np.arange(kind.size)]
    ends = np.append(changes[1:], changes[0] + kind.size)
    bends = [np.arange(begin, end) % kind.size for begin, end in zip(changes, ends)]
    return [cells for cells in bends if kind[cells[0]] != 0.0]
