"""Whether a recording lacks commands, as of a recorder that throttles their topic."""

from __future__ import annotations

from dataclasses import replace
from typing import Callable, Sequence

import numpy as np

from .driving import GRID_HZ, Driving, Held
from .robust_fit import Fitted

__all__ = ["missing_commands"]

# Some are missing if commands come this much more rarely than the measurements, and those between
# leave residuals smaller by this factor. Every second one cannot be told from a slow controller, of
# which at a third of the poses' rate the factor is at most 1.00.
RARER, CLOSER = 2.5, 1.02


def missing_commands(
    drives: Sequence[Driving], fit: Callable[[list[Driving]], Fitted], found: Fitted
) -> float:
    """By how much a delay may be too short because commands are missing in the recording [s].

    A recorded command is held until the next one, while the car already turned by those between.
    Where commands change at an even rate between the recorded ones, the yaw rate follows them more
    closely than held ones; that of a car whose commands do come rarely does not.

    Parameters
    ----------
    drives : sequence of Driving
    fit : callable
        Fits a car to drives.
    found : Fitted
        Fit with the commands as recorded.

    Returns
    -------
    float
        Half of the time between two commands; 0 if none seem to be missing.
    """
    apart = [_usual_step(drive.steering.t) for drive in drives]
    rare = [
        step > RARER * _usual_step(drive.measured["r"].t) for drive, step in zip(drives, apart)
    ]
    if not any(rare):
        return 0.0
    between = [
        replace(drive, steering=_interpolated(drive.steering)) if one else drive
        for drive, one in zip(drives, rare)
    ]
    if CLOSER * fit(between).noise["r"] > found.noise["r"]:
        return 0.0
    return 0.5 * max(step for step, one in zip(apart, rare) if one)


def _usual_step(t):
    return float(np.median(np.diff(t))) if t.size > 1 else 0.0


def _interpolated(command):
    t = np.arange(command.t[0], command.t[-1], 1.0 / GRID_HZ)
    return Held(t, np.interp(t + 0.5 / GRID_HZ, *command))
