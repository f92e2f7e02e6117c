"""Filters of recorded signals: low-pass, gaps and spikes."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import butter, sosfiltfilt

from ..vehicle.size import Size

__all__ = [
    "LONGEST_GAP_S",
    "LONGEST_HOLD_S",
    "briefly_far",
    "low_passed",
    "near",
    "running_median",
    "spike_thresholds",
    "spikes_in",
    "stretches",
]

LONGEST_GAP_S = 0.25
"""A signal is known between samples this far apart [s]."""
LONGEST_HOLD_S = 0.6
"""A command holds until the next one, but no longer than this [s]."""

# Window of the local median [s]; a spike is farther from it than SPIKE_FACTOR median distances and
# than its threshold, for at most LONGEST_SPIKE_S.
SPIKE_WINDOW_S, SPIKE_FACTOR, LONGEST_SPIKE_S = 1.2, 6.5, 0.2
# Thresholds for 1:10 cars [SI].
SPIKES = {"x": 0.05, "y": 0.05, "psi": 0.03, "v_x": 0.1, "v_y": 0.1, "yaw_rate": 0.05}
SPIKES.update(a_x=0.3, a_y=0.3, a_z=0.3)


def low_passed(values: np.ndarray, rate_hz: float, cutoff_hz: float) -> np.ndarray:
    """Zero-phase Butterworth low-pass along the last axis; half the power passes at the cutoff.

    Parameters
    ----------
    values : ndarray, shape (..., n)
    rate_hz, cutoff_hz : float
        Rate of the samples and cutoff [Hz].

    Returns
    -------
    ndarray, shape (..., n)
    """
    # Forwards and backwards through a second-order filter: at the cutoff each pass leaves sqrt(1/2)
    # of the power.
    once = cutoff_hz / (math.sqrt(2.0) - 1.0) ** 0.25
    padding = min(values.shape[-1] - 1, int(3.0 * rate_hz / cutoff_hz))
    return sosfiltfilt(_sections(min(once / (0.5 * rate_hz), 0.99)), values, padlen=padding)


@lru_cache(maxsize=16)
def _sections(cutoff):
    return butter(2, cutoff, output="sos")


def near(t: np.ndarray, samples: np.ndarray, longest: float) -> np.ndarray:
    """Whether each time is in a gap of at most `longest` between samples.

    After the last sample, times count up to that long, because the car's behavior after its last
    command is unknown.

    Parameters
    ----------
    t, samples : ndarray, shape (n,), (k,)
        Times, increasing [s].
    longest : float
        [s]

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    at = np.searchsorted(samples, t, side="right")
    before, after = np.append(-np.inf, samples)[at], np.append(samples, np.inf)[at]
    return np.where(at < samples.size, after, t) - before <= longest


def spike_thresholds(size: Size) -> dict[str, float]:
    """Least distance of a spike by quantity [SI], for a car's size."""
    length, speed = size
    factors = {"x": length, "y": length, "v_x": speed, "v_y": speed, "yaw_rate": 1.0 / speed}
    return {name: factors.get(name, 1.0) * value for name, value in SPIKES.items()}


def spikes_in(
    t: np.ndarray, value: np.ndarray, least: float, window_s: float = SPIKE_WINDOW_S
) -> np.ndarray:
    """Spikes of a signal: samples far from the local median.

    Parameters
    ----------
    t, value : ndarray, shape (n,)
        Times [s] and values.
    least : float
        Least distance of a spike from the median.
    window_s : float, optional
        Window of the median [s].

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    return briefly_far(t, np.abs(value - running_median(t, value, window_s)), least, window_s)


def briefly_far(t: np.ndarray, distance: np.ndarray, least: float, window_s: float) -> np.ndarray:
    """Mark distances that are briefly large for their neighborhood; NaN is not marked.

    Like `spikes_in`, but for given distances from the expected values.
    """
    with np.errstate(invalid="ignore"):
        far = distance > np.maximum(SPIKE_FACTOR * running_median(t, distance, window_s), least)
    for cut in stretches(far):
        # A longer one is a step: the car brakes, or localization corrects itself.
        if t[cut.stop - 1] - t[cut.start] > LONGEST_SPIKE_S:
            far[cut] = False
    return far


def running_median(t: np.ndarray, value: np.ndarray, window_s: float) -> np.ndarray:
    """Running median over a window [s]; too few samples stay as they are."""
    window = 2 * int(0.5 * window_s / max(float(np.median(np.diff(t))), 1e-3)) + 1
    return median_filter(value, window, mode="nearest") if value.size >= 3 * window else value


def stretches(mask: np.ndarray) -> list[slice]:
    """Slices in which a mask, shape (n,), is true."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(np.int8), [0]))))
    return [slice(begin, end) for begin, end in zip(edges[::2], edges[1::2])]
