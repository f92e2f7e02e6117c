"""Checks of the speeds and accelerations."""

from __future__ import annotations

import math

import numpy as np

from ..findings import WARNING, points
from ..speed_profile import accelerations
from .draft import Draft

__all__ = ["KMH", "check_accelerations", "check_stops"]

GRIP = 20.0  # [m/s^2], beyond any 1:10 car on any floor, lateral or longitudinal
KMH = 3.6  # [km/h] are 1 m/s
WAY = 1.0  # [m] over which jitter of points and speeds is averaged


def check_stops(draft: Draft) -> None:
    """Check that the speed is nowhere 0."""
    if "speed" in draft.columns:
        zeros = np.flatnonzero(draft.columns["speed"] == 0.0)
        if zeros.size:
            text = f"the speed is 0 at {points(zeros.size)}: the car stops there"
            draft.add("zero-speed", WARNING, text, zeros)


def check_accelerations(draft: Draft) -> None:
    """Check that a car can follow the speeds and that the accelerations stated fit them."""
    line, columns = draft.raceline, draft.columns
    if line.speed is None:
        return
    v, kappa = columns["speed"], draft.at.kappa
    a_x = accelerations(v, np.diff(np.append(line.s_points, line.length)))
    stated = columns.get("ax")
    if stated is not None and _in_kmh(draft, stated, a_x):
        return
    a_y = v**2 * np.abs(kappa)
    worst = int(np.argmax(a_y))
    if a_y[worst] > GRIP:
        text = f"the speeds require a lateral acceleration of {a_y[worst]:.1f} m/s^2"
        # Another unit is too fast in all of a bend, jitter of points or speeds here and there.
        lasting = float(np.max(_over_a_way(line, v**2 * draft.at.kappa)))
        if lasting < min(GRIP, 0.7 * a_y[worst]):
            text += f" ({lasting:.1f} m/s^2 over a meter: do points or speeds jitter?)"
        elif 3.0 * GRIP < a_y[worst] < KMH**2 * GRIP:
            text += " (in km/h?)"
        draft.add("too-fast", WARNING, text, [worst])
    worst = int(np.argmax(np.abs(a_x)))
    if abs(a_x[worst]) > GRIP:
        text = f"the speeds require a longitudinal acceleration of {a_x[worst]:.1f} m/s^2"
        draft.add("speed-jump", WARNING, text, [worst])


def _over_a_way(line, values):
    """Absolute means of values over the points within a meter, at least three."""
    around = max(1, math.ceil(0.5 * WAY * values.size / line.length))
    around = min(around, (values.size - 1) // 2)
    turned = np.concatenate(([0.0], values[values.size - around :], values, values[:around]))
    sums = np.cumsum(turned)
    return np.abs(sums[2 * around + 1 :] - sums[: -2 * around - 1]) / (2 * around + 1)


def _in_kmh(draft, stated, a_x):
    """Compare accelerations with speeds; whether only km/h explains them."""
    weight = float(np.sum(stated**2))
    scale = math.sqrt(weight / stated.size)
    text = "accelerations do not fit the speeds: recomputed"
    if scale < 0.05:
        if math.sqrt(np.mean(a_x**2)) > 0.5 and np.any(stated):
            draft.add("acceleration", WARNING, text)
        return False
    factor = float(np.sum(stated * a_x)) / weight
    if 0.85 < factor / KMH**2 < 1.15:
        draft.add("kmh", WARNING, "the speeds fit the accelerations in km/h, not in m/s")
        return True
    off = np.abs(stated - a_x)
    if math.sqrt(np.mean(off**2)) > 0.5 * scale + 0.1:
        worst = int(np.argmax(off))
        text += f", largest difference {off[worst]:.1f} m/s^2"
        draft.add("acceleration", WARNING, text, [worst])
    return False
