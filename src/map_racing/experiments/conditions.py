"""Where, with what car and on which days the experiments are driven.

A plant as its file says is the car on the day of identification. On other days its tires differ by
amounts that nobody knows, drawn by a seed from stated distributions: controllers are tuned on some
of them and raced on others.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, replace
from typing import NamedTuple

from ..errors import ParameterError
from ..resources import find_config
from ..validation import read_parameters

__all__ = ["Conditions", "Day", "day_of", "load_conditions"]


@dataclass(frozen=True)
class Conditions:
    """Conditions of an experiment; a file in ``config/experiments`` holds the same names.

    Parameters
    ----------
    track : str
        Shipped track, raceline file or ``bag[#topic]``.
    plant : str
        Shipped plant or plant file.
    mu_deviation, front_stiffness_deviation, rear_stiffness_deviation : float
        Standard deviations of the factors by which friction and cornering stiffness of a day differ
        from those of the day of identification.
    seeds : tuple of int
        Race days.
    practice_seeds : tuple of int
        Days on which controllers are tuned.
    identification_seed : int
        Of the noise on the day of identification.
    tuning_scale : float
        Scale of the raceline's speeds at which controllers are tuned.
    tuning_laps : int
        Timed laps of each run that tunes.

    Raises
    ------
    ParameterError
        For an impossible value, naming it.
    """

    track: str
    plant: str
    mu_deviation: float
    front_stiffness_deviation: float
    rear_stiffness_deviation: float
    seeds: tuple
    practice_seeds: tuple
    identification_seed: int = 0
    tuning_scale: float = 0.6
    tuning_laps: int = 2

    def __post_init__(self):
        for name in ("track", "plant"):
            if not isinstance(getattr(self, name), str) or not getattr(self, name):
                raise ParameterError(f"{name} must be a name or a path")
        for name in ("mu_deviation", "front_stiffness_deviation", "rear_stiffness_deviation"):
            # With more, factors of 0 would be drawn.
            if not _is_number(getattr(self, name)) or not 0.0 <= getattr(self, name) <= 0.2:
                raise ParameterError(f"{name} must be 0 to 0.2, not {getattr(self, name)!r}")
        for name in ("seeds", "practice_seeds"):
            seeds = getattr(self, name)
            if not isinstance(seeds, (list, tuple)) or not seeds:
                raise ParameterError(f"{name} must be a list of numbers, not {seeds!r}")
            object.__setattr__(self, name, tuple(seeds))
        days = (*self.seeds, *self.practice_seeds)
        for seed in (*days, self.identification_seed):
            if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
                raise ParameterError(f"a seed must be a whole number from 0, not {seed!r}")
        for name in ("seeds", "practice_seeds"):
            seeds = getattr(self, name)
            for seed in seeds:
                if seeds.count(seed) > 1:
                    raise ParameterError(f"{name}: {seed} is given twice: a seed is one day")
        both = [str(seed) for seed in self.seeds if seed in self.practice_seeds]
        if both:
            raise ParameterError(
                f"seeds and practice_seeds must differ, but both have {', '.join(both)}: nobody "
                "tunes on a day of the races"
            )
        if not _is_number(self.tuning_scale) or not 0.0 < self.tuning_scale <= 2.0:
            raise ParameterError(f"tuning_scale must be 0 to 2, not {self.tuning_scale!r}")
        laps = self.tuning_laps
        if isinstance(laps, bool) or not isinstance(laps, int) or not 1 <= laps <= 1000:
            raise ParameterError(f"tuning_laps must be 1 to 1000, not {laps!r}")


class Day(NamedTuple):
    """Factors on a car's tires on one day, and its plant.

    Parameters
    ----------
    seed : int
    mu_scale, front_stiffness_scale, rear_stiffness_scale : float
        Relative to the day of identification.
    plant : PlantParameters or PublicSimulatorParameters
        With these tires.
    """

    seed: int
    mu_scale: float
    front_stiffness_scale: float
    rear_stiffness_scale: float
    plant: object


def load_conditions(source):
    """Read conditions from a shipped name or a YAML file.

    Raises
    ------
    ParameterError
        If a parameter is missing, unknown or impossible; the message names file and parameter.
    """
    return read_parameters(find_config("experiments", source, (".yaml",)), Conditions)


def day_of(plant, conditions, seed):
    """The plant on the day of a seed.

    Parameters
    ----------
    plant : PlantParameters or PublicSimulatorParameters
        On the day of identification.
    conditions : Conditions
    seed : int

    Returns
    -------
    Day
    """
    # A stream of its own: that of the noise begins with the number itself.
    gauss = random.Random(f"tires of race day {seed}").gauss
    mu, front, rear = (
        gauss(1.0, deviation)
        for deviation in (
            conditions.mu_deviation,
            conditions.front_stiffness_deviation,
            conditions.rear_stiffness_deviation,
        )
    )
    changed = replace(
        plant,
        mu_scale=plant.mu_scale * mu,
        front_stiffness_scale=plant.front_stiffness_scale * front,
        rear_stiffness_scale=plant.rear_stiffness_scale * rear,
    )
    return Day(seed, mu, front, rear, changed)


def _is_number(value):
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
