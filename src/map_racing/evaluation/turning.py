"""Speed and yaw rate of a recording: as recorded, unless they contradict the path."""

from __future__ import annotations

import math

import numpy as np

from ..bags.samples import Recording
from .speed import speed_of
from .speed_doubts import late_speed, speed_warning

__all__ = ["speed_driven", "turning_of"]

# The integral of a rate must match the turning of the path within this share, if the path turns by
# more than a half turn; shorter steps of the path [m] have no reliable direction; longer pauses [s]
# are left out.
_SHARE, _LEAST_STEP, _PAUSE = 0.3, 0.3, 0.25


def turning_of(recording: Recording) -> tuple[np.ndarray, list[str]]:
    """Yaw rate of a recording, and notes about it.

    It is the recorded one or, if that is missing or does not match the path (never filled in, in
    degrees, of another axis), the rate of the heading.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    rate : ndarray, shape (n,)
        Yaw rate [rad/s]; NaN if neither is usable.
    notes : list of str
        Doubts begin with ``warning:``.
    """
    notes = []
    for what, rate in _recorded(recording):
        turned, path = _turned(recording, rate)
        little = abs(path) < math.pi and (what == "heading" or rate.any())
        if little or abs(turned - path) < _SHARE * abs(path):
            return rate, [f"{note}: the rate of the {what} is used" for note in notes]
        notes.append(
            f"warning: the recorded {what} turns by {turned:.1f} rad, the path by {path:.1f} rad"
            if rate.any()
            else f"the recorded {what} does not change"
        )
    left_out = "lateral acceleration and grip are left out"
    unknown = np.full(recording.t.size, np.nan)
    if not notes:
        return unknown, []
    said = "; ".join(note.replace("warning: ", "") for note in notes)
    return unknown, [f"warning: {said}: {left_out}"]


def speed_driven(recording: Recording) -> tuple[np.ndarray, bool]:
    """Speed of a recording [m/s], shape (n,), and whether it was measured.

    If the measured speed is missing, or does not match the poses or is late, it is their speed.
    """
    t, x, y = recording.t, recording.x, recording.y
    v = recording.speed
    doubtful = bool(speed_warning("", t, x, y, v) or late_speed("", t, x, y, v))
    driven = speed_of(t, x, y, np.full(v.size, np.nan) if doubtful else v)
    return driven, driven is v


def _recorded(recording):
    """Known yaw rates, the best first, each with its origin."""
    if np.isfinite(recording.yaw_rate).all():
        yield "yaw rate", recording.yaw_rate
    if np.isfinite(recording.psi).all():
        yield "heading", np.gradient(np.unwrap(recording.psi), recording.t)


def _turned(recording, rate):
    """Total angles [rad] by which a yaw rate and the path turn.

    If the path turns by less than a half turn, as on a figure eight, both are over the stretch in
    which it turns farthest.
    """
    t, x, y = recording.t, recording.x, recording.y
    kept = _apart(x.tolist(), y.tolist())
    if kept.size < 3:
        return 0.0, 0.0
    course = np.arctan2(np.diff(y[kept]), np.diff(x[kept]))
    steps = np.where(np.diff(t) < _PAUSE, np.diff(t), 0.0)
    angle = np.append(0.0, np.cumsum(0.5 * (rate[1:] + rate[:-1]) * steps))
    known = np.diff(t[kept]) < 4.0 * _PAUSE
    known = known[1:] & known[:-1]
    path = np.angle(np.exp(1j * np.diff(course)))[known]
    # A course is the mean heading between two places.
    turned = 0.5 * (angle[kept[2:]] - angle[kept[:-2]])[known]
    if abs(np.sum(path)) < math.pi:
        way = np.append(0.0, np.cumsum(path))
        farthest = slice(*sorted((int(np.argmin(way)), int(np.argmax(way)))))
        turned, path = turned[farthest], path[farthest]
    return float(np.sum(turned)), float(np.sum(path))


def _apart(x, y):
    """Indices of samples far enough apart that noise hardly turns the course."""
    kept = [0]
    for i in range(1, len(x)):
        if math.hypot(x[i] - x[kept[-1]], y[i] - y[kept[-1]]) > _LEAST_STEP:
            kept.append(i)
    return np.array(kept)
