"""Checks whether a lookup table belongs to a vehicle by comparing it with the vehicle's own."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .lookup import LookupTable

__all__ = ["LARGEST_COMPARED", "LARGEST_DIFFERENCE", "TableDifference", "compare_tables"]

# Only linear tires, which never slide, reach larger lateral accelerations [m/s^2]; tables made by
# integrating for a fixed time have not settled there.
LARGEST_COMPARED = 25.0
LARGEST_DIFFERENCE = 0.05  # [m/s^2], well below the day-to-day change of tires


class TableDifference(NamedTuple):
    """Difference between the cells of two tables on the same grid.

    Parameters
    ----------
    compared : int
        Cells compared.
    largest : float
        Largest absolute difference [m/s^2]; 0 if no cell was compared.
    speed, angle : float
        Where it occurs [m/s], [rad].
    beyond : int
        Cells not compared because the expected acceleration exceeds `LARGEST_COMPARED`.
    one_sided : int
        Cells with a stable steady state in only one of the tables.
    """

    compared: int
    largest: float
    speed: float
    angle: float
    beyond: int
    one_sided: int


def compare_tables(table: LookupTable, expected: LookupTable) -> TableDifference:
    """Compare a table with the expected one on its grid, cell by cell.

    Parameters
    ----------
    table, expected : LookupTable
        With the same speeds and angles.

    Returns
    -------
    TableDifference
    """
    stable, expected_stable = np.isfinite(table.a_lat), np.isfinite(expected.a_lat)
    both = stable & expected_stable
    with np.errstate(invalid="ignore"):
        beyond = both & (expected.a_lat > LARGEST_COMPARED)
    both &= ~beyond
    difference = np.where(both, np.abs(expected.a_lat - table.a_lat), 0.0)
    row, column = np.unravel_index(np.argmax(difference), difference.shape)
    return TableDifference(
        compared=int(both.sum()),
        largest=float(difference[row, column]),
        speed=float(table.speeds[column]),
        angle=float(table.angles[row]),
        beyond=int(beyond.sum()),
        one_sided=int((stable ^ expected_stable).sum()),
    )
