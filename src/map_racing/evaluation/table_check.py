"""Does the steering lookup table fit the car? Commanded steering angles against the table's."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .profiles import RunProfile

__all__ = ["Band", "table_check"]

# Bands of the grip that are compared; less says nothing about tires.
_BANDS = ((0.2, 0.5), (0.5, 0.8), (0.8, 1.2))
# Fewest places in a band.
_FEWEST = 20


class Band(NamedTuple):
    """Turning within a range of the grip.

    Attributes
    ----------
    low, high : float
        Lateral acceleration as a share of the tires' limit.
    share : float
        Share of the length of the laps.
    more_rad : float
        Mean steering angle minus the table's angle for the measured turning [rad]; positive if the
        car understeers more than the table.
    per_angle : float
        The same as a share of the table's mean angle.
    """

    low: float
    high: float
    share: float
    more_rad: float
    per_angle: float


def table_check(run: RunProfile) -> list[Band]:
    """Compare steering and table over the laps that count.

    Parameters
    ----------
    run : RunProfile

    Returns
    -------
    list of Band
        Bands with enough turning; empty without table or commands.

    Notes
    -----
    The command precedes the turning by the delay, so a single place says little. Over a bend, the
    lead at the entry and the one at the exit cancel out.
    """
    if not run.counted:
        return []
    side, steered, table, used = (
        np.concatenate([values(lap) for lap in run.counted])
        for values in (
            lambda lap: np.sign(lap.values["a_lat"]),
            lambda lap: lap.values["steering"],
            lambda lap: lap.values["steering_table"],
            lambda lap: lap.grip_used,
        )
    )
    known = np.isfinite(side) & np.isfinite(steered) & np.isfinite(table) & np.isfinite(used)
    bands = []
    for low, high in _BANDS:
        with np.errstate(invalid="ignore"):
            inside = known & (used >= low) & (used < high)
        if np.count_nonzero(inside) < _FEWEST:
            continue
        more = float(np.mean((side * (steered - table))[inside]))
        angle = float(np.mean(np.abs(table[inside])))
        share = np.count_nonzero(inside) / inside.size
        bands.append(Band(low, high, share, more, more / max(angle, 1e-6)))
    return bands
