"""Size of a car: factors on distances, speeds and times that were given for 1:10 race cars.

Cars of all sizes have about the same friction, and so the same accelerations. With equal
accelerations and lengths `length` times as large, speeds and times are ``sqrt(length)`` times as
large, and yaw rates smaller by that factor (Froude scaling).
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from .parameters import Vehicle

__all__ = ["ONE_TENTH", "Size", "size_of"]

WHEELBASE = 0.32  # of 1:10 race cars [m]
# Cars up to this wheelbase [m] count as 1:10 cars, whose values apply unscaled.
LONGEST = 2.0 * WHEELBASE


class Size(NamedTuple):
    """Factors on values for 1:10 race cars.

    Parameters
    ----------
    length : float
        Factor on distances; yaw accelerations are divided by it.
    time : float
        Factor on speeds and times; yaw rates are divided by it.
    """

    length: float
    time: float

    def __str__(self):
        return f"distances are {self.length:.2f} and times {self.time:.2f} times as long"


ONE_TENTH = Size(1.0, 1.0)


def size_of(vehicle: Vehicle) -> Size:
    """Size of a car by its wheelbase; `ONE_TENTH` up to twice the wheelbase of a 1:10 car."""
    if vehicle.l_wb <= LONGEST:
        return ONE_TENTH
    length = vehicle.l_wb / WHEELBASE
    return Size(length, math.sqrt(length))
