"""A stepping servo: at each sample it turns by its full rate toward the command, or not at all.

The servo of the public ROS 1 simulator does so, behind a delay line. It oscillates around a held
command, which a first-order lag cannot reproduce. If the yaw rate shows this, the dead time is a
whole number of samples and is known exactly.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from .driving import Driving, Held

__all__ = ["SAMPLE_S", "behind_stepping_servo", "on_raster"]

SAMPLE_S = 0.01
DEAD_BAND_RAD = 1e-4
JITTER_S = 1e-3


def behind_stepping_servo(driving: Driving, rate: float, lock: float, samples: int) -> Driving:
    """The drive with the angle of such a servo in place of its commands.

    Parameters
    ----------
    driving : Driving
    rate, lock : float
        Rate and lock of the servo [rad/s], [rad].
    samples : int
        Length of the delay line.

    Returns
    -------
    Driving
    """
    stamps = driving.measured["r"].t
    first = stamps[0] + float(np.median(_off_raster(stamps)))
    ticks = np.arange(first, stamps[-1], SAMPLE_S)
    commands = driving.steering
    # A command sent before the next sample applies to this one.
    last = np.searchsorted(commands.t, ticks + SAMPLE_S - 1e-6) - 1
    last = np.maximum(np.append(np.zeros(samples, dtype=int), last)[: ticks.size], 0)
    wanted = commands.value[last].tolist()
    move = rate * SAMPLE_S
    angle, angles = 0.0, []
    for target in wanted:
        angles.append(angle)
        error = target - angle
        if abs(error) > DEAD_BAND_RAD:
            angle = min(max(angle + math.copysign(move, error), -lock), lock)
    # A simulated speed has no noise: use it unsmoothed, as its rate may change at each sample.
    v_t, v = driving.measured["v_x"]
    v_t = first + SAMPLE_S * np.round((v_t - first) / SAMPLE_S)
    v_t, own = np.unique(v_t, return_index=True)
    v = v[own]
    rates = np.append(np.diff(v) / np.diff(v_t), 0.0)
    at = np.clip(np.searchsorted(v_t, driving.t + 1e-6) - 1, 0, v_t.size - 1)
    return replace(
        driving,
        steering=Held(ticks, np.array(angles)),
        v_x=np.interp(driving.t, v_t, v),
        a_long=rates[at],
    )


def on_raster(t: np.ndarray) -> bool:
    """Whether times are whole samples apart, which happens only in simulation.

    In a simulation in real time, some are late.

    Parameters
    ----------
    t : ndarray, shape (n,)
        [s]
    """
    off = _off_raster(t)
    return bool(np.percentile(np.abs(off - np.median(off)), 98.0) < JITTER_S)


def _off_raster(t):
    """Offset of times from whole samples after the first [s]."""
    return (t - t[0]) - SAMPLE_S * np.round((t - t[0]) / SAMPLE_S)
