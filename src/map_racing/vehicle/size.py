"""Size of a car: factors on distances, speeds and times that were given for 1:10 race cars.

Cars of all sizes have about the same friction, so about the same accelerations. Where these are the
same and lengths are `length` times as large, speeds and times are ``sqrt(length)`` times as large
and yaw rates so much smaller (Froude's law of similarity).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from .parameters import Vehicle

__all__ = ["ONE_TENTH", "Size", "size_of"]

WHEELBASE = 0.32  # of 1:10 race cars [m]
# Up to this wheelbase [m] a car counts as one of them, and values given for them hold as they are.
LONGEST = 2.0 * WHEELBASE


class Size(NamedTuple):
    """Factors on values for 1:10 race cars.

    Parameters
    ----------
    length : float
        On distances; yaw accelerations are divided by it.
    time : float
        On speeds and times; yaw rates are divided by it.
    """

    length: float
    time: float

    def __str__(self):
        return f"distances are {self.length:.2f} and times {self.time:.2f} times as long"


ONE_TENTH = Size(1.0, 1.0)


def size_of(vehicle: Vehicle) -> Size:
    """The size of a car by its wheelbase; `ONE_TENTH` for all up to twice as long."""
    if vehicle.l_wb <= LONGEST:
        return ONE_TENTH
    length = vehicle.l_wb / WHEELBASE
    return Size(length, math.sqrt(length))
