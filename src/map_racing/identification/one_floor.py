"""Were all drives, and all parts of each, of one car on one floor? Else no tires fit them."""

from __future__ import annotations

from typing import Mapping

import numpy as np

from ..vehicle.parameters import Vehicle
from .data import Run
from .driving import Driving, Windows, windows_of
from .output_error import believed, fit_car, own_errors, simulate
from .robust_fit import Believed, Fitted
from .sensor_findings import SensorFinding

__all__ = ["mixed_parts", "mixed_runs"]

# Runs or parts are not of one car on one floor where the common fit leaves this many times what a
# fit of one of them alone does. Halves of drives of simulated and real cars: 0.5 to 1.3 times; with
# 0.5 to 0.8 of the grip in a part of the drive or of the track: 1.5 to 3.3 times.
MIXED = 1.5
# Fewer windows tell nothing.
FEWEST_WINDOWS = 5


def mixed_runs(
    base: Vehicle,
    drives: list[Driving],
    labels: list[str],
    prior: Mapping[str, float],
    fitted: Fitted,
    **cut: float,
) -> SensorFinding | None:
    """The finding that fits of their own explain some runs much better than the common one.

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
    odd = []
    for drive, label in zip(drives, labels):
        windows = windows_of([drive], **cut)
        if windows.count < FEWEST_WINDOWS:
            continue
        own = fit_car(base, windows, believed(**prior), near=fitted)
        common, alone = (_left(base, windows, values) for values in (fitted, own))
        if common > MIXED * alone:
            odd.append(f"{label} {common:.3f} rad/s of its yaw rate, one of its own {alone:.3f}")
    if not odd:
        return None
    text = "runs: not of one car on one floor: the common fit leaves of " + "; of ".join(odd)
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
        if np.count_nonzero(own) < 2 * FEWEST_WINDOWS:
            continue
        for pair, values in _places(run, windows.begin).items():
            lower = values < np.median(values[own])
            halves += [own & lower, own & ~lower]
            names += [f"{run.label} is not of one car on one floor: of its {name}" for name in pair]
    found = own_errors(vehicle, windows, beliefs, fitted, halves)
    gains = [common / alone for common, alone in found]
    k = int(np.argmax(gains)) if gains else -1
    if k < 0 or gains[k] <= MIXED:
        return ""
    common, alone = found[k]
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


def _left(base, windows, fitted):
    """Standard deviation of what a fit leaves of the yaw rate, without outliers [rad/s]."""
    simulated = windows.at("r", simulate(base, windows, fitted.values)["r"])[0]
    return 1.4826 * float(np.median(np.abs(simulated - windows.observed["r"][-1])))
