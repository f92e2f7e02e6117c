"""Columns without names, told apart by their numbers.

A column that turns with the points is their heading, whatever it is measured from; arc length and
curvature are known alike. What is left is speed, distances to the walls, or height, and that is a
guess, which is said.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np

from ...angles import wrap
from ...errors import FileFormatError
from ...validation import FARTHEST
from ..findings import NOTE, WARNING, Finding
from ..spline import distinct_points

__all__ = ["LAYOUTS", "name_by_numbers"]

# Layouts of the public tools by number of columns. They hold if the numbers agree.
LAYOUTS = {
    7: ("s", "x", "y", "psi", "kappa", "speed", "ax"),
    8: ("s", "x", "y", "psi", "kappa", "speed", "ax", "-"),
    9: ("s", "x", "y", "psi", "kappa", "speed", "ax", "d_right", "d_left"),
    10: ("s", "x", "y", "psi", "kappa", "speed", "ax", "d_right", "d_left", "-"),
    12: (
        "x_ref",
        "y_ref",
        "d_right",
        "d_left",
        "x_normal",
        "y_normal",
        "alpha",
        "s",
        "psi",
        "kappa",
        "speed",
        "ax",
    ),
}
_WORDS = {
    "s": "arc length",
    "psi": "heading",
    "kappa": "curvature",
    "speed": "speed",
    "ax": "acceleration",
    "d_right": "distance to the right wall",
    "d_left": "distance to the left wall",
    "width": "total width",
}


# Correlation with the bends below which a column is one of speeds, see `_Curve.falling`.
_SLOWS = -0.6
# A constant column below this is a height [m], not a speed [m/s] to race with.
_SLOWEST_MPS = 0.5


def name_by_numbers(values: np.ndarray, where: str) -> tuple[list[str], list[Finding]]:
    """Name columns by their numbers.

    Parameters
    ----------
    values : ndarray, shape (n_points, n_columns)
        At least two columns.
    where : str
        File and line, for the error.

    Returns
    -------
    names : list of str
        ``"-"`` for columns that are not taken.
    findings : list of Finding
        What was guessed, and why.

    Raises
    ------
    FileFormatError
        If more columns are left than can be told apart.
    """
    count = values.shape[1]
    finite = np.where(np.isfinite(values), values, 0.0)
    finite[np.abs(finite) > FARTHEST] = 0.0
    if count in LAYOUTS and _holds(finite, LAYOUTS[count]):
        return list(LAYOUTS[count]), []
    if _is_trajectory(values):
        text = "a trajectory with time and orientation: only its positions are taken"
        return ["-", "x", "y"] + ["-"] * (count - 3), [Finding("trajectory", NOTE, text)]
    names, reasons = ["?"] * count, []
    first = 1 if count > 2 and _counts_along(finite) else 0
    names[first : first + 2] = "x", "y"
    if first:
        names[0] = "s" if _is_arc_length(*finite.T[:3]) else "-"
    curve = _Curve(finite[:, first], finite[:, first + 1])
    _name_the_curve(names, finite, curve, reasons)
    left = [k for k, name in enumerate(names) if name == "?"]
    for k in left:
        column = finite[:, k]
        if not column.any():
            names[k] = "-"
            reasons.append(f"column {k + 1} is 0 throughout: not given")
    left = [k for k, name in enumerate(names) if name == "?"]
    known = any(name in ("s", "psi", "kappa") for name in names)
    guessed = _name_the_rest(names, finite, left, curve, known, reasons)
    if "?" in names:
        raise FileFormatError(
            f"{where}: expected names of the {count} columns, as their numbers do not tell them "
            "apart: name them in the first line, or as in FILE#x,y,speed (- skips one)"
        )
    if not reasons:
        return names, []
    given = ",".join(names)
    text = (
        f"{count} unnamed columns: {'; '.join(reasons)}. Taken as {given}; other names after FILE# "
        "decide, as in FILE#x,y,speed"
    )
    return names, [Finding("unnamed-columns", WARNING if guessed else NOTE, text)]


def _is_trajectory(values):
    """Whether columns are ``timestamp tx ty tz qx qy qz qw``, as the TUM benchmark has them."""
    if values.shape[1] != 8 or len(values) < 4:
        return False
    with np.errstate(all="ignore"):
        lengths = np.sqrt(np.sum(values[:, 4:] ** 2, axis=1))
        return bool(np.all(np.diff(values[:, 0]) > 0.0) and np.all(np.abs(lengths - 1.0) < 1e-3))


def _name_the_curve(names, values, curve, reasons):
    """Name heading, arc length and curvature."""
    for k, name in enumerate(names):
        if name != "?":
            continue
        column = values[:, k]
        if "psi" not in names and curve.has_heading(column):
            names[k] = "psi"
            reasons.append(f"column {k + 1} is the heading of the points")
        elif "s" not in names and curve.has_arc_length(column):
            names[k] = "s"
            reasons.append(f"column {k + 1} is the arc length")
        elif "kappa" not in names and curve.has_curvature(column):
            names[k] = "kappa"
            reasons.append(f"column {k + 1} is the curvature")
    # A heading as a quaternion about the vertical, or as cosine and sine.
    open_ones = [k for k, name in enumerate(names) if name == "?"]
    for a, b in permutations(open_ones, 2):
        if "psi" in names or np.max(np.abs(np.hypot(values[:, a], values[:, b]) - 1.0)) > 0.01:
            continue
        angle = np.arctan2(values[:, a], values[:, b])
        if curve.has_heading(2.0 * angle) or curve.has_heading(angle):
            names[a] = names[b] = "-"
            reasons.append(f"columns {min(a, b) + 1} and {max(a, b) + 1} are the heading")
            break


def _name_the_rest(names, values, left, curve, known, reasons):
    """Name speeds and widths; whether anything was guessed."""
    negative = [k for k in left if np.any(values[:, k] < 0.0)]
    speeds = [k for k in left if k not in negative]
    # Accelerations stand behind the speeds they fit.
    for a in left:
        if a and a - 1 in speeds and curve.accelerates(values[:, a - 1], values[:, a]):
            names[a - 1], names[a] = "speed", "ax"
            reasons.append(f"columns {a} and {a + 1} are a speed and its acceleration")
            return _name_walls(names, values, [k for k in left if k not in (a - 1, a)], reasons)
    for k in negative:
        names[k] = "-"
        reasons.append(f"column {k + 1}, partly negative, is not taken")
    left = speeds
    if not left:
        return bool(negative)
    if len(left) == 1:
        # A file with more than positions and a width was made for driving.
        meaning, why = curve.speed_or_width(values[:, left[0]], len(names) > 3)
        names[left[0]] = meaning
        reasons.append(f"column {left[0] + 1} is taken as {_WORDS[meaning]}, as {why}")
        return True
    if all(curve.falling(values[:, k]) < _SLOWS for k in left):
        names[left[0]] = "speed"
        reasons.append(
            f"columns {' and '.join(str(k + 1) for k in left)} all drop where the track bends: the "
            "first is taken as speed"
        )
        for k in left[1:]:
            names[k] = "-"
        return True
    if len(left) == 2 and _are_walls(*values.T[left]) and not known:
        return _name_walls(names, values, left, reasons)
    constant = [k for k in left if np.ptp(values[:, k]) <= 1e-9]
    if len(left) == 3 and len(constant) == 1:
        names[constant[0]] = "-"
        reasons.append(f"column {constant[0] + 1}, constant, is taken as the height")
        # What a car can drive may be one speed for the whole lap.
        speed = values[0, constant[0]] >= _SLOWEST_MPS
        if speed:
            reasons[-1] += ", though it may be the speed"
        left = [k for k in left if k not in constant]
        if _are_walls(*values.T[left]):
            return _name_walls(names, values, left, reasons) or speed
    slowing = [(curve.falling(values[:, k]), k) for k in left]
    least, k = min(slowing)
    others = [other for other in left if other != k]
    if least < _SLOWS and all(value > least + 0.2 for value, other in slowing if other != k):
        names[k] = "speed"
        reasons.append(
            f"column {k + 1} is taken as speed, as it drops where the track bends "
            f"(correlation {least:.2f})"
        )
        if len(others) == 1:
            names[others[0]] = "-"
            reasons.append(f"column {others[0] + 1} is not understood and not taken")
            return True
        _name_walls(names, values, others, reasons)
        return True
    if len(left) == 2:
        return _name_walls(names, values, left, reasons)
    if len(left) == 3:
        # The height is last or, as in the TUM tools, between position and widths.
        a, b, c = left
        one, two, three = values.T[left]
        if _are_walls(one, two) and not _are_walls(two, three) and min(three) >= _SLOWEST_MPS:
            names[c] = "speed"
            reasons.append(f"column {c + 1} is taken as speed, as those before it are like walls")
            return _name_walls(names, values, [a, b], reasons)
        low = [float(np.max(np.abs(values[:, k]))) for k in left]
        height = a if low[0] < low[2] and np.ptp(values[:, a]) < np.ptp(values[:, c]) else c
        names[height] = "-"
        reasons.append(f"column {height + 1} is taken as the height")
        _name_walls(names, values, [k for k in left if k != height], reasons)
    return True


def _name_walls(names, values, left, reasons):
    """Name two columns as the distances to the right and to the left wall."""
    if not left:
        return False
    if len(left) != 2:
        for k in left:
            names[k] = "-" if len(left) == 1 else "?"
            reasons.append(f"column {k + 1} is not understood and not taken")
        return True
    a, b = left
    names[a], names[b] = "d_right", "d_left"
    reasons.append(
        f"columns {a + 1} and {b + 1} are taken as the distances to the right and to the left wall"
    )
    # The public tools write just these, and nothing speaks against it.
    return "speed" in names or "psi" in names or not _are_walls(values[:, a], values[:, b])


def _are_walls(a, b):
    """Whether two columns change like distances to two walls: alike, or one at the other's cost."""
    total = float(np.median(a + b))
    return bool(
        np.std(a + b) < 0.6 * min(np.std(a), np.std(b))
        or np.median(np.abs(a - b)) < 0.25 * total
        or max(np.ptp(a), np.ptp(b)) <= 1e-9
    )


def _holds(values, layout):
    """Whether arc length, heading or curvature are where a layout has them."""
    column = dict(zip(layout, values.T))
    if "x_ref" in layout:
        return bool(np.median(np.abs(np.hypot(column["x_normal"], column["y_normal"]) - 1)) < 0.02)
    curve = _Curve(column["x"], column["y"])
    return (
        curve.has_arc_length(column["s"])
        or curve.has_heading(column["psi"])
        or curve.has_curvature(column["kappa"])
    )


def _counts_along(values):
    """Whether the first of three columns counts points, time or distance and the next are x, y."""
    first = values[:, 0]
    steps = np.diff(first)
    if first.size < 4 or not np.all(steps > 0.0):
        return False
    # An open course may have an x that only increases; then its steps are not even.
    if _is_arc_length(*values.T[:3]) or np.all(steps == 1.0):
        return True
    # Time: the next two columns come back to where they began.
    way = np.hypot(*np.diff(values[:, 1:3], axis=0).T)
    back = np.hypot(*(values[-1, 1:3] - values[0, 1:3]))
    return bool(values.shape[1] > 3 and 0.0 < back < 3.0 * np.max(way) < 0.1 * np.sum(way))


def _is_arc_length(s, x, y):
    way = np.concatenate(([0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))))
    return bool(way[-1] > 0.0 and np.max(np.abs(s - s[0] - way)) < 0.02 * way[-1])


class _Curve:
    """Points of a track, to recognize what follows from them."""

    def __init__(self, x, y):
        self.keep = distinct_points(x, y)
        self.x, self.y = x[self.keep], y[self.keep]
        self.usable = self.x.size >= 9
        if not self.usable:
            return
        # Chords over several points: waypoints from a localization jitter.
        chord = np.hypot(np.diff(self.x), np.diff(self.y))
        usual = max(float(np.median(chord)), 1e-9)
        length = float(chord.sum())
        self.reach = int(np.clip(round(0.005 * length / usual), 1, max(1, self.x.size // 20)))
        after, before = (
            np.stack((np.roll(self.x, -step), np.roll(self.y, -step)))
            for step in (self.reach, -self.reach)
        )
        way = after - before
        self.heading = np.arctan2(way[1], way[0])
        turn = wrap(np.roll(self.heading, -self.reach) - np.roll(self.heading, self.reach))
        self.kappa = turn / np.maximum(np.hypot(way[0], way[1]), 1e-9)
        self.way = np.concatenate(([0.0], np.cumsum(chord)))

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
        return self.usable and _is_arc_length(s, self.x, self.y)

    def has_curvature(self, column):
        """Whether a column is the curvature, of either sign."""
        kappa = column[self.keep]
        scale = np.sqrt(np.mean(self.kappa**2)) if self.usable else 0.0
        if scale < 1e-6:
            return False
        smooth = np.mean([np.roll(kappa, k) for k in range(-self.reach, self.reach + 1)], axis=0)
        off = min(np.sqrt(np.mean((sign * smooth - self.kappa) ** 2)) for sign in (1.0, -1.0))
        return bool(off < 0.35 * scale)

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
        centerlines the correlation with the curvature, smoothed over nine points, is -0.73 to -0.91
        for speeds (but -0.52 on Monza, driven at top speed for most of a lap, and -0.28 on a
        circle), and -0.52 or more for widths.
        """
        column = column[self.keep]
        if not self.usable or np.ptp(column) <= 1e-6 * np.max(np.abs(column)):
            return 0.0
        ways = np.stack((np.roll(self.x, -1) - self.x, np.roll(self.y, -1) - self.y))
        heading = np.arctan2(ways[1], ways[0])
        bend = np.abs(wrap(heading - np.roll(heading, 1))) / np.hypot(ways[0], ways[1])
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
