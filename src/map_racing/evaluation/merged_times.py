"""Doubt about poses of two times that were put in one order."""

from __future__ import annotations

import numpy as np

__all__ = ["to_and_fro"]

# Samples to both sides that tell the way; so many times the usual scatter along it, and this share
# of a step and more, are steps back; so many of them are within so many samples.
_AROUND, _SCATTER, _BACK, _STEPS, _WITHIN = 6, 8.0, 0.3, 2, 12
# Speed [m/s] of a car that drives.
_DRIVES = 1.0


def to_and_fro(topic: str, t: np.ndarray, x: np.ndarray, y: np.ndarray) -> str:
    """Doubt about poses that go to and fro along the way for some samples; or empty.

    As where all clocks were set back, and the messages were then sorted by them: poses of before
    and after lie between each other. A correction of a localization is one step back.

    Parameters
    ----------
    topic : str
        Name of the poses.
    t, x, y : ndarray, shape (n,)
        Times [s] and positions [m].
    """
    if t.size < 4 * _AROUND:
        return ""
    step = np.stack([np.diff(x), np.diff(y)])[:, _AROUND:-_AROUND]
    way = np.stack([v[2 * _AROUND + 1 :] - v[: -2 * _AROUND - 1] for v in (x, y)])
    length = np.hypot(*way)
    spent = t[2 * _AROUND + 1 :] - t[: -2 * _AROUND - 1]
    drives = length > _DRIVES * spent
    if not drives.any():
        return ""
    along = np.sum(step * way, axis=0) / np.maximum(length, 1e-9)
    expected = length / (2 * _AROUND + 1)
    scatter = float(np.median(np.abs(along - expected)[drives]))
    least = np.maximum(_SCATTER * scatter, _BACK * expected)
    back = np.flatnonzero(drives & (along < -least))
    if back.size < _STEPS:
        return ""
    close = np.flatnonzero(back[_STEPS - 1 :] - back[: 1 - _STEPS] <= _WITHIN)
    if not close.size:
        return ""
    first = int(back[close[0]])
    return (
        f"{topic}: poses go to and fro along the way at {t[first + _AROUND]:.1f} s: was a clock "
        "set back, and the recording sorted by it? That lap is so much too short"
    )
