"""Heading, arc length and bends of points, to recognize the columns that state them."""

from __future__ import annotations

import math

import numpy as np

from ...angles import wrap
from ..spline import distinct_points

__all__ = ["Shape", "is_arc_length"]

# Jitter [m] times length of the track over the square of a chord that is long enough.
_JITTER = 1.3


def is_arc_length(s: np.ndarray, x: np.ndarray, y: np.ndarray) -> bool:
    """Whether a column is the way along points, to 2 % of its length, from wherever it counts."""
    way = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))))
    return bool(way[-1] > 0.0 and np.max(np.abs(s - s[0] - way)) < 0.02 * way[-1])


def _is_even(column):
    """Whether a column varies so little that it is a constant, or the curvature of a circle."""
    return bool(np.std(column) <= 0.1 * np.abs(np.mean(column)))


class Shape:
    """Points of a track, to recognize columns that follow from them."""

    def __init__(self, x, y):
        self.keep = distinct_points(x, y)
        self.x, self.y = x[self.keep], y[self.keep]
        self.usable = self.x.size >= 9
        if not self.usable:
            return
        chord = np.hypot(np.diff(self.x), np.diff(self.y))
        self.reach = self._reach(chord)
        after, before = (
            np.stack((np.roll(self.x, -step), np.roll(self.y, -step)))
            for step in (self.reach, -self.reach)
        )
        way = after - before
        self.heading = np.arctan2(way[1], way[0])
        turn = wrap(np.roll(self.heading, -self.reach) - np.roll(self.heading, self.reach))
        self.kappa = turn / np.maximum(np.hypot(way[0], way[1]), 1e-9)
        self.way = np.concatenate(([0.0], np.cumsum(chord)))

    def _reach(self, chord):
        """Points between the ends of a chord: waypoints from a localization jitter."""
        usual, length = max(float(np.median(chord)), 1e-9), float(chord.sum())
        # Of white noise fourth differences have 8.4 times its deviation, of a curve next to
        # nothing; it shall be small in a turn that is measured over twice the reach.
        fourth = np.hypot(np.diff(self.x, 4), np.diff(self.y, 4))
        jitter = float(np.median(fourth)) / 8.4
        quiet = math.sqrt(jitter * length / _JITTER) / usual
        return int(np.clip(max(round(0.005 * length / usual), quiet), 1, max(1, self.x.size // 20)))

    def has_heading(self, column):
        """Whether a column is the heading, in any convention: zero, sense of rotation, unit."""
        column = column[self.keep]
        if not self.usable or np.ptp(column) <= 1e-9:
            return False
        for angle in (column, np.radians(column)):
            for turned in (angle, -angle):
                off = wrap(turned - self.heading)
                off = wrap(off - np.arctan2(np.mean(np.sin(off)), np.mean(np.cos(off))))
                if np.percentile(np.abs(off), 75) < 0.2:
                    return True
        return False

    def has_arc_length(self, column):
        """Whether a column is the arc length."""
        s = column[self.keep]
        return self.usable and is_arc_length(s, self.x, self.y)

    def has_curvature(self, column):
        """Whether a column is the curvature, of either sign."""
        return self._are_bends(column[self.keep], self.kappa if self.usable else None)

    def follows_bends(self, column):
        """Whether a column is what the bends make of it: radius, size of curvature, steering."""
        column = column[self.keep]
        if not self.usable or _is_even(column):
            return False
        with np.errstate(divide="ignore"):
            inverse = np.where(column == 0.0, 0.0, 1.0 / column)
        size = np.abs(self.kappa)
        if any(self._are_bends(kappa, size) for kappa in (np.abs(column), np.abs(inverse))):
            return True
        smooth = self._smooth(column)
        if min(np.std(smooth), np.std(self.kappa)) <= 1e-6 * np.max(np.abs(smooth)):
            return False
        slope, offset = np.polyfit(self.kappa, smooth, 1)
        alike = abs(np.corrcoef(self.kappa, smooth)[0, 1]) > 0.9
        return bool(alike and abs(offset) < 0.2 * np.max(np.abs(slope * self.kappa)))

    def _are_bends(self, column, own):
        scale = 0.0 if own is None else np.sqrt(np.mean(own**2))
        if scale < 1e-6:
            return False
        smooth = self._smooth(column)
        off = min(np.sqrt(np.mean((sign * smooth - own) ** 2)) for sign in (1.0, -1.0))
        # A constant is no curvature because it has the size of one.
        close = 0.05 if _is_even(smooth) else 0.35
        return bool(off < close * scale)

    def _smooth(self, column):
        shifts = range(-self.reach, self.reach + 1)
        return np.mean([np.roll(column, k) for k in shifts], axis=0)

    def accelerates(self, speed, column):
        """Whether a column is the acceleration ``v dv/ds`` of another, a speed."""
        v, a = speed[self.keep], column[self.keep]
        if not self.usable or np.ptp(v) <= 1e-9 or np.ptp(a) <= 1e-9:
            return False
        own = np.gradient(0.5 * v**2) / np.maximum(np.gradient(self.way), 1e-9)
        return bool(np.sqrt(np.mean((own - a) ** 2)) < 0.6 * np.sqrt(np.mean(own**2)))

    def falling(self, column):
        """Correlation of a column with the bends; 0 where one of them is constant.

        Speeds are low where the track bends; widths hardly depend on it. On 14 real racelines and
        centerlines the correlation with the curvature, smoothed over nine points, is -0.75 to -0.90
        for speeds (but -0.48 on Monza, driven at top speed for most of a lap), and -0.45 or more
        for total widths; the distance to one wall alone has down to -0.69.
        """
        column = column[self.keep]
        if not self.usable or np.ptp(column) <= 1e-6 * np.max(np.abs(column)):
            return 0.0
        bend = np.abs(self.kappa)
        bend = np.mean([np.roll(bend, shift) for shift in range(-4, 5)], axis=0)
        if np.ptp(bend) <= 1e-9:
            return 0.0
        return float(np.corrcoef(bend, column)[0, 1])

    def speed_or_width(self, column, known):
        """Whether a single column is a speed or a total width, and the evidence."""
        falling = self.falling(column)
        evidence = f"(correlation {falling:.2f})"
        most = float(np.mean(column >= np.max(column) * (1.0 - 1e-6)))
        if falling < -0.6:
            return "speed", f"it drops where the track bends {evidence}"
        if falling < -0.4 and most > 0.2:
            return "speed", f"it drops where the track bends {evidence}, mostly from one maximum"
        if known:
            return "speed", "files with more than positions and widths have speeds"
        if falling == 0.0:
            return "width", "it or the curvature is constant, which decides nothing"
        return "width", f"it does not drop where the track bends {evidence}"
