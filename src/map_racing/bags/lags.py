"""Lag of an effect behind its cause."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import uniform_filter1d

__all__ = ["LONGEST_LAG_S", "lag_of_effect"]

LONGEST_LAG_S = 0.5
"""A car acts at most this long after a command [s]."""

# Smaller variances count as 0.
_NOTHING = 1e-12
# `lag_of_effect` compares effect and cause in these steps [s], up to this lag [s], in the first
# part of the recording [s].
_STEP_S, _FARTHEST_S, _PART_S = 0.02, 20.0, 1200.0
# Longest median time between two causes [s]: with fewer, most of them are missing.
_SELDOM_S = 0.2
# Both signals are band-passed: the mean over the first number of steps minus the mean over the
# second, because slow changes show no lag. And the fewest steps that two signals must share.
_SMOOTH, _SLOW, _FEWEST = 11, 201, 500
# An impossible lag is certain if its correlation is at least the first number, and its unexplained
# variance at most this share of that of the best possible lag.
_FOLLOWS, _PLAIN = 0.8, 0.6
# Peaks that are lower by no more than this count as equal: those of other laps.
_AS_GOOD = 0.02
# Smallest correlation about zero that shows the sign.
_LIKE = 0.3


def lag_of_effect(
    t: np.ndarray,
    cause: np.ndarray,
    at: np.ndarray,
    effect: np.ndarray,
    longest_s: float = LONGEST_LAG_S,
    earliest_s: float = -0.05,
    least: float = _AS_GOOD,
) -> float | None:
    """Lag of an effect behind its cause, if it is clearly impossible.

    Commands that were stamped and received on another clock can be recognized only by their effect:
    a car turns shortly after the steering command.

    Parameters
    ----------
    t, cause : ndarray, shape (k,)
        Times [s], increasing, and values, each held until the next, such as steering angles.
    at, effect : ndarray, shape (n,)
        Times [s], increasing, and a quantity proportional to the cause, such as the curvature of
        the path; NaN where it is unknown.
    longest_s, earliest_s : float, optional
        Longest and shortest possible lag [s]; negative if the measurement of the effect looks
        ahead, as averages do.
    least : float, optional
        By how much more an impossible lag must correlate.

    Returns
    -------
    float or None
        [s]; None if the lag is possible, or not clear.
    """
    if t.size < 2 or at.size < 2 or float(np.median(np.diff(t))) > _SELDOM_S:
        return None
    grid = np.arange(at[0], min(at[-1], at[0] + _PART_S), _STEP_S)
    finite, given = np.isfinite(effect), np.isfinite(cause)
    if np.count_nonzero(finite) < 2 or np.count_nonzero(given) < 2:
        return None
    known = np.interp(grid, at, finite.astype(float)) > 0.999
    effect = np.interp(grid, at[finite], effect[finite])
    # At the ends there is no centered average.
    edge = 0.5 * _SLOW * _STEP_S
    known &= (grid > grid[0] + edge) & (grid < grid[-1] - edge)
    has_cause, held = _held(t, cause, given, grid, edge)
    # A car usually turns in the direction of its wheels; if not, only the size counts.
    both = known & has_cause
    a, b = held[both], effect[both]
    signed = float(a @ b) > _LIKE * float(np.sqrt((a @ a) * (b @ b)))
    effect = _band_passed(effect)
    # No correlation exceeds 1, so that without lag usually leaves no room for a better one.
    follows = _alike(_band_passed(held)[both], effect[both], np.count_nonzero(known))
    if (follows if signed else abs(follows)) > 1.0 - least:
        return None
    most = round(_FARTHEST_S / _STEP_S)
    wide = grid[0] + _STEP_S * np.arange(-most, grid.size + most)
    has_cause, held = _held(t, cause, given, wide, edge)
    held = _band_passed(held)
    follows = _correlation(held, has_cause, effect, known)
    follows = follows if signed else np.abs(follows)
    lags = _STEP_S * np.arange(most, -most - 1, -1)
    possible = (lags >= earliest_s) & (lags <= longest_s)
    best, usual = float(np.max(follows)), float(np.max(follows[possible]))
    plain = best > usual + least and 1.0 - best**2 < _PLAIN * (1.0 - usual**2)
    if best < _FOLLOWS or not plain:
        return None
    peaks = np.flatnonzero(follows > best - _AS_GOOD)
    nearest = peaks[np.argmin(np.abs(lags[peaks]))]
    nearby = np.abs(lags - lags[nearest]) < 0.5
    peak = int(np.argmax(np.where(nearby, follows, -1.0)))
    # No peak at the ends of the search: the correlation may still rise beyond.
    return float(lags[peak]) if 0 < peak < lags.size - 1 else None


def _held(t, cause, given, times, edge):
    """Whether there is a cause, away from the edges [s], and its held value, at times [s]."""
    last = np.searchsorted(t, times, side="right") - 1
    has_cause = (last >= 0) & (times <= t[-1] + 1.0) & given[last]
    has_cause &= (times > t[0] + edge) & (times < t[-1] + 1.0 - edge)
    last = np.searchsorted(t[given], times, side="right") - 1
    return has_cause, cause[given][np.maximum(last, 0)]


def _band_passed(values):
    return uniform_filter1d(values, _SMOOTH) - uniform_filter1d(values, _SLOW)


def _alike(a, b, most):
    """Correlation of two signals, of at most `most` samples; 0 if they are too short."""
    if a.size <= max(_FEWEST, 0.5 * most):
        return 0.0
    a, b = a - np.mean(a), b - np.mean(b)
    variances = float(a @ a) * float(b @ b) / a.size**2
    return float(a @ b) / a.size / math.sqrt(variances) if variances > _NOTHING else 0.0


def _correlation(held, has_cause, effect, known):
    """Correlation of an effect with every part of its cause of the same length."""
    held = np.where(has_cause, held - (np.mean(held[has_cause]) if has_cause.any() else 0.0), 0.0)
    effect = np.where(known, effect - (np.mean(effect[known]) if known.any() else 0.0), 0.0)
    # SciPy has the same, but importing it takes longer than all else that the nodes need from it.
    size = 1 << (held.size - 1).bit_length()
    has_cause, known = has_cause.astype(float), known.astype(float)
    causes = [np.fft.rfft(part, size) for part in (has_cause, held, held**2)]
    effects = [np.conj(np.fft.rfft(part, size)) for part in (known, effect, effect**2)]

    def sums(i, j):
        """Sums of the products of powers of cause and effect."""
        return np.fft.irfft(causes[i] * effects[j], size)[: held.size - effect.size + 1]

    count = np.maximum(sums(0, 0), 1.0)
    a, b = sums(1, 0) / count, sums(0, 1) / count
    variances = (sums(2, 0) / count - a**2) * (sums(0, 2) / count - b**2)
    with np.errstate(divide="ignore", invalid="ignore"):
        result = (sums(1, 1) / count - a * b) / np.sqrt(variances)
    enough = count > max(_FEWEST, 0.5 * float(np.max(count)))
    return np.where(enough & (variances > _NOTHING), result, 0.0)
