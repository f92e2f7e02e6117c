"""Statistics over time of signals that are linear between their samples.

All take the values at n samples, shape (n,), and the times between them [s], shape (n - 1,). The
results do not depend on how densely a signal is sampled.
"""

from __future__ import annotations

import math

import numpy as np

__all__ = ["mean", "mean_abs", "mean_rate", "percentile_abs", "rms"]


def mean(values: np.ndarray, dt: np.ndarray) -> float:
    """Mean over time."""
    return float(np.sum(0.5 * (values[1:] + values[:-1]) * dt) / np.sum(dt))


def rms(values: np.ndarray, dt: np.ndarray) -> float:
    """Root mean square over time of the finite intervals; NaN without any."""
    a, b = values[:-1], values[1:]
    squares = (a * a + a * b + b * b) / 3.0
    known = np.isfinite(squares)
    total = np.sum(dt[known])
    return math.sqrt(np.sum(squares[known] * dt[known]) / total) if total > 0.0 else math.nan


def mean_abs(values: np.ndarray, dt: np.ndarray) -> float:
    """Mean magnitude over time."""
    a, b = np.abs(values[:-1]), np.abs(values[1:])
    crossing = values[:-1] * values[1:] < 0.0
    sums = np.where(crossing, a + b, 1.0)
    pieces = np.where(crossing, (a * a + b * b) / (2.0 * sums), 0.5 * (a + b))
    return float(np.sum(pieces * dt) / np.sum(dt))


def percentile_abs(values: np.ndarray, dt: np.ndarray, fraction: float) -> float:
    """Magnitude not exceeded for a given fraction of the time."""
    a, b = np.abs(values[:-1]), np.abs(values[1:])
    # Split intervals that change sign in two: the magnitude falls to 0 and rises again.
    split = values[:-1] * values[1:] < 0.0
    part = a[split] / (a[split] + b[split])
    low = np.concatenate((np.where(split, 0.0, np.minimum(a, b)), np.zeros(part.size)))
    high = np.concatenate((np.where(split, a, np.maximum(a, b)), b[split]))
    time = np.concatenate((dt, dt[split] * (1.0 - part)))
    time[: dt.size][split] *= part
    # The signal is linear in each interval, so the time spent below a magnitude is piecewise linear
    # in that magnitude, with kinks at the ends of intervals.
    high = np.maximum(high, low + 1e-9)
    density = time / (high - low)
    edges = np.concatenate((low, high))
    order = np.argsort(edges, kind="mergesort")
    edges = edges[order]
    slope = np.cumsum(np.concatenate((density, -density))[order])[:-1]
    below = np.append(0.0, np.cumsum(slope * np.diff(edges)))
    return float(np.interp(fraction * np.sum(dt), below, edges))


def mean_rate(values: np.ndarray, dt: np.ndarray) -> float:
    """Mean absolute rate over time of the finite intervals; NaN without any."""
    steps = np.abs(np.diff(values))
    known = np.isfinite(steps)
    total = np.sum(dt[known])
    return float(np.sum(steps[known]) / total) if total > 0.0 else math.nan
