"""Tuning: the lookahead ``L_d = m + q v`` with which a controller follows a track closest.

The measure is the RMS lateral error of the true path, lap by lap, as mean over all laps of all
races that are driven with a pair (m, q): one on each of several days. A pair with which any of them
is not completed is infeasible. A coarse grid finds the valley, a pattern search (Hooke and Jeeves,
with all eight neighbors) its lowest point to 0.025 m and 0.006 s. The gain q is not negative: a
lookahead that shortens as the car gets faster would follow well at the speed it was tuned at, and
swing beyond.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import pandas as pd

from ..errors import MapRacingError

__all__ = ["Pair", "Tuned", "frame_of", "lap_error", "tune"]

# Finest steps of m [m] and q [s]; all pairs are whole multiples of them.
STEP_M, STEP_Q = 0.025, 0.00625
# The grid, in these steps: m from 0 to 1.2 m by 0.2 m, q from 0 to 0.3 s by 0.05 s. It holds the
# values of the authors' code; the search may leave it.
COARSE = 8
GRID = range(0, 49, COARSE)
# Moves of the search at each width; it needs a few.
MOST_MOVES = 20


class Pair(NamedTuple):
    """One pair: offset [m], gain [s], mean RMS lateral error [m], infinite if infeasible."""

    m: float
    q: float
    error: float


class Tuned(NamedTuple):
    """Result of tuning.

    Parameters
    ----------
    controller : ControllerParameters
        As given, with the best pair.
    error : float
        Its mean RMS lateral error [m].
    pairs : list of Pair
        All that were driven, by m and q.
    """

    controller: object
    error: float
    pairs: list


def lap_error(results):
    """Mean over all laps of races of their RMS lateral error [m]; infinite if one is not completed.

    Parameters
    ----------
    results : iterable of RaceResult
    """
    if not all(result.completed for result in results):
        return math.inf
    return float(np.mean([lap.rms_lateral_error_m for result in results for lap in result.laps]))


def frame_of(tuned):
    """All pairs as a table: ``m_m q_s rms_lateral_error_m completed``.

    Parameters
    ----------
    tuned : Tuned

    Returns
    -------
    pandas.DataFrame
        The error is NaN where not all races were completed.
    """
    rows = [
        {
            "m_m": pair.m,
            "q_s": pair.q,
            "rms_lateral_error_m": pair.error if math.isfinite(pair.error) else math.nan,
            "completed": math.isfinite(pair.error),
        }
        for pair in tuned.pairs
    ]
    return pd.DataFrame(rows)


def tune(jobs_for, controller):
    """Plan that tunes a controller, for `map_racing.experiments.campaign.carry_out`.

    Parameters
    ----------
    jobs_for : callable
        ``jobs_for(controller) -> list of RaceJob``: the races that judge it.
    controller : ControllerParameters

    Returns
    -------
    generator
        It returns a `Tuned`.

    Raises
    ------
    MapRacingError
        From the generator, if no pair of the grid is feasible.
    """
    errors = {}

    def with_pair(i, j):
        return controller.with_(m_m=round(i * STEP_M, 6), q_s=round(j * STEP_Q, 6))

    def measure(cells):
        new = [cell for cell in cells if cell not in errors]
        jobs = [jobs_for(with_pair(*cell)) for cell in new]
        results = iter((yield [job for group in jobs for job in group]))
        for cell, group in zip(new, jobs):
            errors[cell] = lap_error([next(results) for _ in group])

    yield from measure([(i, j) for i in GRID for j in GRID])
    best = min(errors, key=lambda cell: (errors[cell], cell))
    if math.isinf(errors[best]):
        raise MapRacingError(
            f"tuning: no lookahead of the grid completes a race at {controller.speed_scale:.0%} "
            "speed; tune at a lower one"
        )
    width = COARSE // 2
    while width:
        for _ in range(MOST_MOVES):
            around = [
                (best[0] + i, best[1] + j)
                for i in (-width, 0, width)
                for j in (-width, 0, width)
                if best[1] + j >= 0
            ]
            yield from measure(around)
            lowest = min(around, key=lambda cell: (errors[cell], cell))
            if errors[lowest] >= errors[best]:
                break
            best = lowest
        width //= 2
    pairs = [
        Pair(with_pair(*cell).m_m, with_pair(*cell).q_s, errors[cell]) for cell in sorted(errors)
    ]
    return Tuned(with_pair(*best), errors[best], pairs)
