"""Were all drives, and all parts of each, of one car on one floor? Else no tires fit them."""

from __future__ import annotations

from typing import Mapping

import numpy as np

from ..vehicle.parameters import Vehicle
from .data import Run
from .driving import FEWEST_WINDOWS, Driving, Windows, windows_of
from .output_error import believed, own_errors
from .robust_fit import Believed, Fitted
from .sensor_findings import SensorFinding

__all__ = ["mixed_parts", "mixed_runs"]

# Runs or parts differ in car or floor if the residual of the common fit exceeds this many times
# that of a fit to one of them alone. Halves of drives of simulated and real cars: 0.5 to 1.3 times;
# with 0.5 to 0.8 of the grip in a part of the drive or of the track: 1.5 to 3.3 times.
MIXED = 1.5


def mixed_runs(
    base: Vehicle,
    drives: list[Driving],
    labels: list[str],
    prior: Mapping[str, float],
    fitted: Fitted,
    **cut: float,
) -> SensorFinding | None:
    """Finding that the runs differ in car or floor, if some run's own fit is much better.

    Parameters
    ----------
    base : Vehicle
    drives : list of Driving
    labels : list of str
        Of the drives.
    prior : dict of str to float
        Standard deviations of what is believed.
    fitted : Fitted
        The common fit.
    **cut
        See `windows_of`.

    Returns
    -------
    SensorFinding or None
    """
    odd, beliefs = [], believed(**prior)
    for drive, label in zip(drives, labels):
        windows = windows_of([drive], **cut)
        if windows.count < FEWEST_WINDOWS:
            continue
        whole = np.ones(windows.count, dtype=bool)
        ((common, alone),) = own_errors(base, windows, beliefs, fitted, [whole])
        if common > MIXED * alone:
            odd.append(f"{label}: {common:.3f} rad/s of yaw rate, its own {alone:.3f} rad/s")
    if not odd:
        return None
    text = "runs: not of one car on one floor: residuals of the common fit: " + "; ".join(odd)
    return SensorFinding("runs", text, critical=True)


def mixed_parts(
    vehicle: Vehicle,
    windows: Windows,
    beliefs: dict[str, Believed],
    fitted: Fitted,
    runs: list[Run],
) -> str:
    """Which half of a drive, in time or by place, is not of one car on one floor with the rest.

    Parameters
    ----------
    vehicle : Vehicle
    windows : Windows
    beliefs : dict of str to Believed
    fitted : Fitted
        To all windows.
    runs : list of Run
        Of the drives of the windows.

    Returns
    -------
    str
        A sentence on the half that is farthest off; empty without.
    """
    halves, names = [], []
    for index, run in enumerate(runs):
        own = windows.drive == index
        if not own.any():
            continue
        for pair, values in _places(run, windows.begin).items():
            lower = values < np.median(values[own])
            if min(np.count_nonzero(own & lower), np.count_nonzero(own & ~lower)) < FEWEST_WINDOWS:
                continue
            halves += [own & lower, own & ~lower]
            names += [f"{run.label} is not of one car on one floor: of its {name}" for name in pair]
    if not halves:
        return ""
    found = own_errors(vehicle, windows, beliefs, fitted, halves)
    k = max(range(len(found)), key=lambda k: found[k][0] / max(found[k][1], 1e-9))
    common, alone = found[k]
    if common <= MIXED * alone:
        return ""
    return (
        f"{names[k]} the common fit leaves {common:.3f} rad/s of the yaw rate, one of its own "
        f"about {alone:.3f}"
    )


def _places(run, begin):
    """By what a drive is cut in halves, with their names: time and place of its windows."""
    places = {("first half", "second half"): begin}
    for axis in ("x", "y"):
        if axis in run.signals:
            t, value = run.signals[axis]
            names = f"half with smaller {axis}", f"half with larger {axis}"
            places[names] = np.interp(begin, run.setup.time_scale * t, value)
    return places
