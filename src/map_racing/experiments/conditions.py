"""Track, car and days of the experiments.

A plant file describes the car on the day of identification. On other days its tires differ by
unknown amounts, drawn by a seed from stated distributions: controllers are tuned on some days and
raced on others.
"""

from __future__ import annotations

import random
from dataclasses import dataclass, replace
from typing import NamedTuple

from ..errors import ParameterError
from ..resources import find_config
from ..simulation.plant import PlantParameters
from ..simulation.public_simulator import PublicSimulatorParameters
from ..validation import POSITIVE, check, documented, parameter, read_parameters

__all__ = ["Conditions", "Day", "day_of", "load_conditions"]


def _deviation(what):
    # With more than 0.2, factors of 0 could be drawn.
    text = f"Standard deviation of the factor on {what} from day to day"
    return parameter(text, low=0.0, high=0.2)


@documented
@dataclass(frozen=True)
class Conditions:
    """Conditions of an experiment; a file in ``config/experiments`` holds the same names.

    Factors on the tires are relative to the day of identification.
    """

    track: str = parameter("Shipped track, raceline file or bag#topic")
    plant: str = parameter("Shipped plant or plant file")
    mu_deviation: float = _deviation("the friction coefficient")
    front_stiffness_deviation: float = _deviation("the cornering stiffness at the front")
    rear_stiffness_deviation: float = _deviation("the cornering stiffness at the rear")
    seeds: tuple = parameter("Seeds of the race days")
    practice_seeds: tuple = parameter("Seeds of the days on which controllers are tuned")
    identification_seed: int = parameter(
        "Seed of the noise on the day of identification", low=0, default=0
    )
    tuning_scale: float = parameter(
        "Scale of the raceline's speeds at which controllers are tuned",
        low=POSITIVE,
        high=2.0,
        default=0.6,
    )
    tuning_laps: int = parameter("Timed laps of each tuning run", low=1, high=1000, default=2)

    def __post_init__(self):
        check(self)
        for name in ("seeds", "practice_seeds"):
            seeds = getattr(self, name)
            whole = isinstance(seeds, (list, tuple)) and all(type(s) is int for s in seeds)
            if not whole or not seeds or min(seeds) < 0:
                raise ParameterError(f"{name}: expected whole numbers from 0, got {seeds!r}")
            for seed in seeds:
                if seeds.count(seed) > 1:
                    raise ParameterError(f"{name}: expected different seeds, got {seed} twice")
            object.__setattr__(self, name, tuple(seeds))
        both = ", ".join(str(seed) for seed in self.seeds if seed in self.practice_seeds)
        if both:
            raise ParameterError(
                f"practice_seeds: expected other days than the races', got {both} in both"
            )


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
    plant: PlantParameters | PublicSimulatorParameters


def load_conditions(source: str) -> Conditions:
    """Read conditions from a shipped name or a YAML file.

    Raises
    ------
    ParameterError
        If a parameter is missing, unknown or impossible; the message names file and parameter.
    """
    what = "conditions of a track and its race days, such as paper"
    return read_parameters(find_config("experiments", source, (".yaml",)), Conditions, what=what)


def day_of(
    plant: PlantParameters | PublicSimulatorParameters, conditions: Conditions, seed: int
) -> Day:
    """The plant on the day of a seed, from the plant on the day of identification."""
    # A random stream of its own, independent of the noise, which is seeded with the number itself.
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
