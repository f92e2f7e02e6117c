"""Whether the steering lookup table is the car's: what was steered against what the table has."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .profiles import RunProfile

__all__ = ["Band", "table_check"]

# Shares of the grip between which laps are looked at; less says nothing about tires.
_BANDS = ((0.2, 0.5), (0.5, 0.8), (0.8, 1.2))
# Fewer places say nothing.
_FEWEST = 20


class Band(NamedTuple):
    """Turning at some share of the grip.

    Attributes
    ----------
    low, high : float
        Lateral acceleration as a share of what the tires give.
    share : float
        Of the laps' length.
    more_rad : float
        Mean angle by which was steered more than the table has for the turning that was measured
        [rad]: positive understeers more than the table says.
    per_angle : float
        The same as a share of the mean angle of the table.
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
        Those with enough turning; empty without table or commands.

    Notes
    -----
    The command precedes the turning by the delay, so one place says little. Over a bend the lead at
    its entry makes up for the one at its exit.
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
