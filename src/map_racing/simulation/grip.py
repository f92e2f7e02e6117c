"""Grip that changes during a race: dust, a wet patch, a floor that gets warm."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ..errors import ParameterError
from ..validation import POSITIVE, check, documented, parameter

__all__ = ["Grip", "GripChange", "is_between", "read_grip_changes"]


@documented
@dataclass(frozen=True)
class GripChange:
    """A change of friction from some time on, at some place, or both.

    A plant file holds a list of them, ``grip_changes``, such as ``{factor: 0.8, after_s: 12.0}`` or
    ``{factor: 0.7, from_m: 31.0, to_m: 34.0}``.
    """

    factor: float = parameter("Factor on the friction coefficient", low=0.1, high=2.0)
    after_s: float = parameter("Simulated time at which it begins", "s", low=0.0, default=0.0)
    until_s: float = parameter(
        "Simulated time at which it ends; by default never",
        "s",
        low=POSITIVE,
        default=1e9,
    )
    from_m: float = parameter(
        "Arc length of the raceline at which the place begins", "m", low=0.0, default=0.0
    )
    to_m: float = parameter(
        "Arc length at which it ends, less than `from_m` if it crosses the start line; if both are "
        "0, it is everywhere",
        "m",
        low=0.0,
        default=0.0,
    )

    def __post_init__(self):
        check(self)
        if self.until_s <= self.after_s:
            raise ParameterError(f"until_s: expected more than after_s, got {self.until_s:g}")

    def holds(self, t: float, s: float) -> bool:
        """Whether it applies at a time [s] and arc length [m]."""
        return self.after_s <= t < self.until_s and is_between(self.from_m, self.to_m, s)


def is_between(begin: float, end: float, s: float) -> bool:
    """Whether an arc length is within a place, which may cross the start line.

    A place without length is everywhere.
    """
    if begin <= end:
        return begin <= s < end or begin == end
    return s >= begin or s < end


class Grip:
    """Changes the friction of a plant as the race goes on.

    Parameters
    ----------
    plant : Plant or PublicSimulator
        Its parameters list the changes. Changes at the same time and place multiply.
    """

    def __init__(self, plant):
        self._plant, self._changes = plant, plant.parameters.grip_changes

    def update(self, t, s, fault=1.0):
        """Set the friction for a simulated time [s] and an arc length of the raceline [m].

        `fault` is an additional factor.
        """
        factors = [change.factor for change in self._changes if change.holds(t, s)]
        self._plant.set_grip(math.prod(factors, start=fault))


def read_grip_changes(values):
    """Grip changes from a list of mappings or of `GripChange`.

    Raises
    ------
    ParameterError
        For anything else, naming the entry.
    """
    if not isinstance(values, (list, tuple)):
        raise ParameterError(f"grip_changes: expected a list, got {values!r}")
    changes = []
    for number, value in enumerate(values, 1):
        if not isinstance(value, GripChange):
            try:
                value = GripChange(**value)
            except TypeError:
                names = ", ".join(GripChange.__dataclass_fields__)
                raise ParameterError(
                    f"grip_changes: entry {number}: expected a mapping with factor and some of "
                    f"{names}, got {value!r}"
                ) from None
            except ParameterError as error:
                raise ParameterError(f"grip_changes: entry {number}: {error}") from None
        changes.append(value)
    return tuple(changes)
