"""Where a car stood during a lap, or stopped harder than its brakes can."""

from __future__ import annotations

import numpy as np

from .lap_limits import LapLimits

__all__ = ["stops"]

# A car stands if it moves less than this [m] in this time [s], until it leaves this radius [m].
_STANDING, _STANDING_TIME, _STANDING_RADIUS = 0.15, 0.5, 0.05
_BRAKING_TIME = 0.1  # time over which deceleration is measured [s]


def stops(
    t: np.ndarray, x: np.ndarray, y: np.ndarray, progress: np.ndarray, limits: LapLimits
) -> list[tuple[str, float]]:
    """Stops in a lap that are longer or harder than its limits: text and time [s] of each.

    Parameters
    ----------
    t, x, y, progress : ndarray, shape (n,)
        Times [s], positions and distance along the track [m].
    limits : LapLimits
    """
    moved = np.append(True, (np.diff(x) != 0.0) | (np.diff(y) != 0.0))
    moved[-1] = True
    t_new, x_new, y_new = t[moved], x[moved], y[moved]

    def at(times):
        return np.interp(times, t_new, x_new), np.interp(times, t_new, y_new)

    found = _stood(t, x, y, at, limits.max_stop), _hit(t, progress, at, limits.max_deceleration)
    return [stop for stop in found if stop]


def _stood(t, x, y, at, max_stop):
    """The longest time that the car stood."""
    begin = t[t <= t[-1] - _STANDING_TIME]
    slow = begin[_distance(at(begin), at(begin + _STANDING_TIME)) < _STANDING]
    if not slow.size:
        return None
    pieces = np.split(slow, np.flatnonzero(np.diff(slow) > _STANDING_TIME) + 1)
    longest = max(pieces, key=lambda piece: piece[-1] - piece[0])
    inside = (t >= longest[0]) & (t <= longest[-1] + _STANDING_TIME)
    away = np.hypot(x - np.median(x[inside]), y - np.median(y[inside]))
    still = t[inside & (away < _STANDING_RADIUS)]
    stood = float(still[-1] - still[0]) if still.size else 0.0
    return (f"stood {stood:.1f} s", still[0]) if stood > max_stop else None


def _hit(t, progress, at, max_deceleration):
    """The hardest stop."""
    wait = max(_BRAKING_TIME, 2.0 * float(np.median(np.diff(t))))
    now = t[(t >= t[0] + wait) & (t <= t[-1] - 3.0 * wait)]
    least = max_deceleration * wait
    at_now, at_end = at(now), at(now + wait)
    before = _distance(at(now - wait), at_now) / wait
    after = _distance(at_now, at_end) / wait
    if not now.size or not np.max(before - after) > least:
        return None
    s_1, s_2, s_3 = (np.interp(now + by, t, progress) for by in (-wait, 0.0, wait))
    # Corrections of the localization are not stops: neither sideways ones nor those backwards after
    # which the car is no slower.
    drop = np.minimum(before - after, (2.0 * s_2 - s_1 - s_3) / wait)
    later = _distance(at_end, at(now + 3.0 * wait)) / (2.0 * wait)
    drop = np.where(later < 0.5 * before, drop, 0.0)
    worst = int(np.argmax(drop))
    if not drop[worst] > least:
        return None
    return f"stopped from {before[worst]:.1f} to {after[worst]:.1f} m/s", now[worst]


def _distance(begin, end):
    return np.hypot(end[0] - begin[0], end[1] - begin[1])
