"""Tuning: the parameters with which a controller follows its racelines most closely.

The measure is the RMS lateral error of the true path per lap, averaged over all laps of all races
with a candidate. A candidate that fails to complete any race is infeasible.

`tune` finds the lookahead ``L_d = m + q v``, or the two weights of a rival's cost, for one track,
with a race on each of several days. A coarse grid finds the valley, a pattern search (Hooke and
Jeeves, with all eight neighbors) its lowest point to 0.025 m and 0.006 s. Neither parameter is
negative: a lookahead that shortens with speed would work well at the tuning speed, but oscillate
above it; with a negative offset the car would oscillate below it. `tune_robust` searches around
given values, including the other guidance parameters, for many tracks and cars.

Candidates are compared race by race, on the same days. A candidate that does not complete a race,
or whose error so far is well above the best one's on the same races, is dropped: it would not
become the best.
"""

from __future__ import annotations

import math
import random
from contextlib import suppress
from typing import NamedTuple

import numpy as np
import pandas as pd

from ..control.parameters import growth
from ..errors import MapRacingError, ParameterError
from ..vehicle.size import ONE_TENTH

__all__ = [
    "ROBUST_STEPS",
    "Candidate",
    "Pair",
    "Tuned",
    "frame_of",
    "lap_error",
    "tune",
    "tune_robust",
    "typical_error",
]

# Finest steps of m [m] and q [s]; all pairs are whole multiples of them.
STEP_M, STEP_Q = 0.025, 0.00625
# The grid, in these steps: m from 0 to 1.2 m by 0.2 m, q from 0 to 0.3 s by 0.05 s. It contains the
# values of the authors' code; the search may leave it.
COARSE = 8
GRID = range(0, 49, COARSE)
# Most moves of the search at each step width; a few are usually enough.
MOST_MOVES = 20
# A candidate is dropped if its mean error over the n races so far is more than 1 + GIVE_UP /
# sqrt(n) times the best one's on the same races: means of more races are more reliable. With days
# and cars as different as in the experiments, errors of neighboring candidates change alike.
GIVE_UP = 0.3
# The races of a grid differ far more: candidates are dropped only after this many.
FEWEST = 24
# Parameters of the robust search and their steps [m], [s], [-], [s], [-], [s], [s]; it begins with
# twice these. What is 0 (off) in the given controller stays off. Speeds are not searched: slower
# always means a smaller error.
ROBUST_STEPS = {
    "m_m": 0.025,
    "q_s": 0.0125,
    "slip_lookahead": 0.125,
    "delay_s": 0.005,
    "curvature_feedforward": 0.1,
    "yaw_rate_gain_s": 0.01,
    "speed_lookahead_s": 0.01,
}


class Pair(NamedTuple):
    """One pair: offset [m], gain [s], mean RMS lateral error [m], infinite if infeasible.

    For a dropped pair, the error covers the races driven.
    """

    m: float
    q: float
    error: float
    given_up: bool = False


class Tuned(NamedTuple):
    """Result of tuning.

    Parameters
    ----------
    controller : ControllerParameters
        As given, with the best pair.
    error : float
        Its mean RMS lateral error [m].
    pairs : list of Pair
        All pairs that were driven, sorted by m and q.
    races : int
        Number of races driven.
    """

    controller: object
    error: float
    pairs: list
    races: int


def lap_error(results):
    """RMS lateral error [m] per lap, averaged over all laps of races.

    Infinite if a race is not completed, or none of its laps counts.

    Parameters
    ----------
    results : iterable of RaceResult
    """
    if not all(result.completed and result.laps for result in results):
        return math.inf
    return float(np.mean([lap.rms_lateral_error_m for result in results for lap in result.laps]))


def frame_of(tuned):
    """All pairs as a table: the two parameters and ``rms_lateral_error_m completed given_up``.

    Parameters
    ----------
    tuned : Tuned

    Returns
    -------
    pandas.DataFrame
        The error is NaN where a race was not completed.
    """
    rows = [
        {
            **dict(zip(tuned.controller.TUNED, (pair.m, pair.q))),
            "rms_lateral_error_m": pair.error if math.isfinite(pair.error) else math.nan,
            "completed": math.isfinite(pair.error) and not pair.given_up,
            "given_up": pair.given_up,
        }
        for pair in tuned.pairs
    ]
    return pd.DataFrame(rows)


def tune(jobs_for, controller, size=ONE_TENTH):
    """Plan that tunes a controller, for `map_racing.experiments.campaign.carry_out`.

    Parameters
    ----------
    jobs_for : callable
        ``jobs_for(controller) -> list of RaceJob``: the races that judge it.
    controller : ControllerParameters
    size : Size, optional
        Of the car; the steps of the search grow with it.

    Returns
    -------
    generator
        It returns a `Tuned`.

    Raises
    ------
    MapRacingError
        From the generator, if no pair of the grid is feasible.
    """
    errors, races, given_up = {}, {}, set()

    first, second = controller.TUNED
    step_m, step_q = STEP_M * growth(first, size), STEP_Q * growth(second, size)

    def with_pair(i, j):
        return controller.with_(**{first: round(i * step_m, 6), second: round(j * step_q, 6)})

    def measure(cells):
        new = [cell for cell in cells if cell not in errors]
        found = yield from _compare([jobs_for(with_pair(*cell)) for cell in new], reference)
        for cell, results in zip(new, found):
            races[cell], errors[cell] = len(results), lap_error(results)
            if len(results) < len(jobs_for(controller)):
                given_up.add(cell)
            elif errors[cell] < min([errors[c] for c in complete] or [math.inf]):
                reference[:] = results
            if cell not in given_up:
                complete.append(cell)

    reference, complete = [], []
    yield from measure([(i, j) for i in GRID for j in GRID])
    best = min(complete or errors, key=lambda cell: (errors[cell], cell))
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
                if best[0] + i >= 0 and best[1] + j >= 0
            ]
            yield from measure(around)
            lowest = min(
                (cell for cell in around if cell not in given_up),
                key=lambda cell: (errors[cell], cell),
            )
            if errors[lowest] >= errors[best]:
                break
            best = lowest
        width //= 2
    pairs = [
        Pair(
            *(getattr(with_pair(*cell), name) for name in (first, second)),
            errors[cell],
            cell in given_up and math.isfinite(errors[cell]),
        )
        for cell in sorted(errors)
    ]
    return Tuned(with_pair(*best), errors[best], pairs, sum(races.values()))


def _compare(groups, reference, first=1, measure=lap_error):
    """Drive groups of races, each as long as it may still become the best.

    Parameters
    ----------
    groups : list of list of RaceJob
        One list for each candidate, all in the same order.
    reference : list of RaceResult
        Results of the best candidate so far; empty if there is none.
    first : int, optional
        Number of races before a candidate may be dropped for its error.
    measure : callable, optional
        Error of a list of RaceResult.

    Yields
    ------
    list of RaceJob

    Returns
    -------
    list of list of RaceResult
        Fewer results than jobs for candidates that were dropped.
    """
    found = [[] for _ in groups]
    going = list(range(len(groups)))
    for begin, end in zip(*_stages(len(groups[0]), first)) if groups else ():
        results = iter((yield [job for k in going for job in groups[k][begin:end]]))
        for k in going:
            found[k] += [next(results) for _ in range(begin, end)]
        share = 1.0 + GIVE_UP / math.sqrt(end)
        errors = {k: measure(found[k]) for k in going}
        best = min([*errors.values(), measure(reference[:end]) if reference else math.inf])
        going = [k for k in going if math.isfinite(errors[k]) and errors[k] <= share * best]
    return found


def _stages(total, first):
    """Beginning and end of each round of races, with sizes 1, 1, 2, 4, ... if `first` is 1."""
    ends = []
    while not ends or ends[-1] < total:
        ends.append(min(total, 2 * ends[-1] if ends else first))
    return [0, *ends[:-1]], ends


class Candidate(NamedTuple):
    """A controller of the robust search, and its results.

    Parameters
    ----------
    controller : ControllerParameters
    error : float
        Error over the races driven [m], see `typical_error`; infinite if one was not completed.
    worst : float
        Largest RMS lateral error of a race [m].
    races : int
        Number of races driven: all, unless it was dropped.
    """

    controller: object
    error: float
    worst: float
    races: int


def typical_error(results):
    """Geometric mean over races of their RMS lateral error [m]; infinite if one is not completed.

    So a 10 % reduction counts the same where all errors are small as where a car slides.

    Parameters
    ----------
    results : iterable of RaceResult
    """
    errors = [lap_error([result]) for result in results]
    if not all(map(math.isfinite, errors)):
        return math.inf
    return float(np.exp(np.mean(np.log(np.maximum(errors, 1e-6)))))


def tune_robust(jobs_for, controller, size=ONE_TENTH):
    """Plan that tunes the parameters in `ROBUST_STEPS` over many tracks and cars.

    The races are driven in one random order, so that the first ones are representative, except that
    races that the given values do not complete come first.

    Parameters
    ----------
    jobs_for : callable
        ``jobs_for(controller) -> list of RaceJob``: the races that judge it.
    controller : ControllerParameters
        Start of the search.
    size : Size, optional
        Of the cars; the steps of the search grow with it.

    Returns
    -------
    generator
        It returns a list of `Candidate`: the best, then the others as they were driven.

    Raises
    ------
    MapRacingError
        From the generator, if no candidate completes all races.
    """
    first = yield jobs_for(controller)
    order = list(range(len(first)))
    random.Random(1).shuffle(order)
    order.sort(key=lambda k: first[k].completed)
    reference = [first[k] for k in order]
    best = Candidate(controller, typical_error(first), _worst(first), len(first))
    candidates = {_key(controller): best}
    for width in (2, 1):
        for _ in range(MOST_MOVES):
            around = [
                near
                for near in _around(best.controller, width, size)
                if _key(near) not in candidates
            ]
            groups = [[jobs_for(near)[k] for k in order] for near in around]
            # Until a candidate completes all races, the search maximizes the number completed.
            begun = reference if math.isfinite(best.error) else []
            found = yield from _compare(groups, begun, FEWEST, typical_error)
            for near, results in zip(around, found):
                driven = Candidate(near, typical_error(results), _worst(results), len(results))
                candidates[_key(near)] = driven
                if len(results) == len(order) and driven.error < best.error:
                    best, reference = driven, results
            if best.controller not in around:
                break
    if math.isinf(best.error):
        raise MapRacingError(
            "tuning: no values near the given ones complete all races; lower grip_use or the speed"
        )
    return [best, *(c for c in candidates.values() if c is not best)]


def _around(controller, width, size):
    """Controllers one step away in one parameter, or in m and q with the same lookahead."""
    steps = {name: step * growth(name, size) for name, step in ROBUST_STEPS.items()}
    moves = []
    for sign in (width, -width):
        moves += [{name: sign * step} for name, step in steps.items()]
        moves.append({"m_m": 2.0 * sign * steps["m_m"], "q_s": -sign * steps["q_s"]})
    around = []
    for move in moves:
        values = {name: getattr(controller, name) for name in move}
        if all(value for name, value in values.items() if name not in ("m_m", "q_s")):
            changes = {name: round(value + move[name], 6) for name, value in values.items()}
            with suppress(ParameterError):  # a step beyond the bounds of a parameter
                around += [controller.with_(**changes)] if changes.get("q_s", 0.0) >= 0.0 else []
    return around


def _key(controller):
    return tuple(getattr(controller, name) for name in ROBUST_STEPS)


def _worst(results):
    return max(lap_error([result]) for result in results)
