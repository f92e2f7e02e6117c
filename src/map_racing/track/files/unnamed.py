"""Columns without names, told apart by their numbers.

A column that turns with the points is their heading, whatever it is measured from; arc length and
curvature are recognized in the same way. What is left is speed, distances to the walls, or height:
a guess, which becomes a warning.
"""

from __future__ import annotations

from itertools import permutations

import numpy as np

from ...errors import FileFormatError
from ...validation import FARTHEST
from ..findings import NOTE, WARNING, Finding
from .shape import Shape, is_arc_length

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


# A column is a speed if its correlation with the bends is below this, see `Shape.falling`;
_SLOWS = -0.6
# and certainly if it is below this: the distance to one wall reaches -0.76.
_SURELY = -0.8
# Of two columns, the one with values this many times as large is the speed, the other a width.
_MANY = 3.0
# A track is not wider than this share of its length: real ones have up to 0.075.
_WIDE = 0.12
# Smaller values are rounding errors, counted as 0: squares and inverses would overflow.
_ROUNDING = 1e-12
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
    if abs(finite[0, 0]) > FARTHEST:
        # Stamps, in seconds or nanoseconds; how much they count does not matter.
        finite[:, 0] -= finite[0, 0]
        finite[:, 0] /= max(1.0, 1e-3 * np.max(np.abs(finite[:, 0])))
    finite[(np.abs(finite) > FARTHEST) | (np.abs(finite) < _ROUNDING)] = 0.0
    if count in LAYOUTS and _holds(finite, LAYOUTS[count]):
        return list(LAYOUTS[count]), _doubted_sides(LAYOUTS[count])
    if _is_trajectory(values):
        text = "a trajectory with time and orientation: only its positions are taken"
        return ["-", "x", "y"] + ["-"] * (count - 3), [Finding("trajectory", NOTE, text)]
    names, reasons = ["?"] * count, []
    first = 1 if count > 2 and _counts_along(finite) else 0
    names[first : first + 2] = "x", "y"
    if first:
        names[0] = "s" if is_arc_length(*finite.T[:3]) else "-"
    curve = Shape(finite[:, first], finite[:, first + 1])
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


def _doubted_sides(layout):
    """What is a guess in a layout: no public tool writes walls behind its seven columns."""
    if "x_ref" in layout or "d_right" not in layout:
        return []
    text = (
        f"{len(layout)} unnamed columns: taken as {','.join(layout)}; which of the walls is the "
        "right one is a guess, other names after FILE# decide"
    )
    return [Finding("unnamed-columns", WARNING, text)]


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
        elif curve.follows_bends(column):
            names[k] = "-"
            reasons.append(
                f"column {k + 1} follows the bends, as a radius or a steering angle does"
            )
        elif np.all(np.diff(column) >= 0.0) and column[-1] > column[0]:
            names[k] = "-"
            reasons.append(f"column {k + 1} only increases: a time or a number, not taken")
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
        return _name_first_speed(names, left, reasons)
    if len(left) == 2:
        return _name_two(names, values, left, curve, known, reasons)
    constant = [k for k in left if np.ptp(values[:, k]) <= 1e-9]
    speed = False
    if len(left) == 3 and len(constant) == 1:
        left = [k for k in left if k not in constant]
        speed = _name_constant(names, values, constant[0], left, reasons)
        if _are_walls(*values.T[left]):
            return _name_walls(names, values, left, reasons) or speed
    if _name_falling(names, values, left, curve, reasons):
        return True
    if len(left) == 2:
        return _name_walls(names, values, left, reasons)
    if len(left) == 3:
        _name_three(names, values, left, reasons)
    return True


def _name_constant(names, values, k, others, reasons):
    """Name a constant column beside two others; whether it may be a speed.

    What a car can drive may be one speed for the whole lap.
    """
    value = values[0, k]
    speed = value >= _SLOWEST_MPS
    if value > 1.5 * np.max(np.median(values[:, others], axis=0)):
        names[k] = "speed"
        reasons.append(f"column {k + 1}, constant, is taken as speed, though it may be the height")
        return speed
    names[k] = "-"
    reasons.append(f"column {k + 1}, constant, is taken as the height")
    if speed:
        reasons[-1] += ", though it may be the speed"
    return speed


def _name_first_speed(names, left, reasons):
    """Of several columns that all drop in the bends the first is the speed."""
    names[left[0]] = "speed"
    reasons.append(
        f"columns {' and '.join(str(k + 1) for k in left)} all drop where the track bends: the "
        "first is taken as speed"
    )
    for k in left[1:]:
        names[k] = "-"
    return True


def _name_two(names, values, left, curve, known, reasons):
    """Name two columns: walls, or a speed and something else; whether that is a guess."""
    one, two = values.T[left]
    if (_are_walls(one, two) and not known) or _at_the_others_cost(one, two):
        return _name_walls(names, values, left, reasons)
    if _name_falling(names, values, left, curve, reasons):
        return True
    sizes = [float(np.median(values[:, k])) for k in left]
    if max(sizes) > _MANY * min(sizes) and max(sizes) >= _SLOWEST_MPS:
        k = left[int(np.argmax(sizes))]
        names[k] = "speed"
        reasons.append(f"column {k + 1} is taken as speed, as it is many times the other")
        return _not_understood(names, [other for other in left if other != k], reasons)
    return _name_walls(names, values, left, reasons)


def _name_falling(names, values, left, curve, reasons):
    """Name the one column that drops in the bends; whether there is one."""
    slowing = [(curve.falling(values[:, k]), k) for k in left]
    least, k = min(slowing)
    if least >= _SLOWS or any(value <= least + 0.2 for value, other in slowing if other != k):
        return False
    others = [other for other in left if other != k]
    sizes = np.median(values[:, [k, *others]], axis=0)
    if least >= _SURELY and len(others) == 1 and sizes[0] < sizes[1]:
        return False  # it is the distance to one wall, which racing lines touch in bends
    names[k] = "speed"
    reasons.append(
        f"column {k + 1} is taken as speed, as it drops where the track bends (correlation "
        f"{least:.2f})"
    )
    if len(others) == 1:
        return _not_understood(names, others, reasons)
    _name_walls(names, values, others, reasons)
    return True


def _name_three(names, values, left, reasons):
    """Name two walls and a speed or a height among three columns.

    The height is last or, as in the TUM tools, between position and widths. A speed is larger than
    the distances to both walls, which are more alike than it is to either.
    """
    a, b, c = left
    one, two, three = values.T[left]
    speed = c if _are_walls(one, two) and not _are_walls(two, three) else None
    low, middle, high = sorted(left, key=lambda k: np.median(values[:, k]))
    sizes = [float(np.median(values[:, k])) for k in (low, middle, high)]
    if sizes[2] > 1.5 * sizes[1] and sizes[1] * sizes[1] < 0.5 * sizes[0] * sizes[2]:
        speed = high
    if speed is not None and np.min(values[:, speed]) >= _SLOWEST_MPS:
        names[speed] = "speed"
        why = "those before it" if speed == c else "the others"
        reasons.append(f"column {speed + 1} is taken as speed, as {why} are like walls")
        _name_walls(names, values, [k for k in left if k != speed], reasons)
        return
    most = [float(np.max(np.abs(values[:, k]))) for k in left]
    height = a if most[0] < most[2] and np.ptp(values[:, a]) < np.ptp(values[:, c]) else c
    names[height] = "-"
    reasons.append(f"column {height + 1} is taken as the height")
    _name_walls(names, values, [k for k in left if k != height], reasons)


def _not_understood(names, left, reasons):
    for k in left:
        names[k] = "-"
        reasons.append(f"column {k + 1} is not understood and not taken")
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
    width = float(np.median(values[:, a] + values[:, b]))
    doubtful = width > _WIDE * _length(values, names)
    return doubtful or "speed" in names or "psi" in names or not _are_walls(*values.T[[a, b]])


def _length(values, names):
    """Length of the way along the points."""
    x, y = (values[:, names.index(name)] for name in ("x", "y"))
    return float(np.sum(np.hypot(np.diff(x), np.diff(y))))


def _are_walls(a, b):
    """Whether two columns change like distances to two walls: alike, or one at the other's cost."""
    total = float(np.median(a + b))
    return bool(
        _at_the_others_cost(a, b)
        or np.median(np.abs(a - b)) < 0.25 * total
        or max(np.ptp(a), np.ptp(b)) <= 1e-9
    )


def _at_the_others_cost(a, b):
    """Whether one column takes what the other leaves, as the walls beside a racing line do."""
    return bool(np.std(a + b) < 0.6 * min(np.std(a), np.std(b)))


def _holds(values, layout):
    """Whether arc length, heading or curvature are where a layout has them."""
    column = dict(zip(layout, values.T))
    if "x_ref" in layout:
        return bool(np.median(np.abs(np.hypot(column["x_normal"], column["y_normal"]) - 1)) < 0.02)
    if np.any(column["speed"] < 0.0) and np.all(column["ax"] >= 0.0):
        return False  # exchanged
    curve = Shape(column["x"], column["y"])
    tests = {"s": curve.has_arc_length, "psi": curve.has_heading, "kappa": curve.has_curvature}
    there = [name for name, test in tests.items() if test(column[name])]
    # What is not there may be jittery, or stand where something else is expected.
    others = [column[name] for name in column if name not in (*tests, "x", "y")]
    missing = [test for name, test in tests.items() if name not in there]
    return bool(there) and not any(test(other) for test in missing for other in others)


def _counts_along(values):
    """Whether the first of three columns counts points, time or distance and the next are x, y."""
    first = values[:, 0]
    steps = np.diff(first)
    if first.size < 4 or not np.all(steps > 0.0):
        return False
    # An open course may have an x that only increases; then its steps are not even.
    if is_arc_length(*values.T[:3]) or np.all(steps == 1.0):
        return True
    # Time: the next two columns come back to where they began.
    way = np.hypot(*np.diff(values[:, 1:3], axis=0).T)
    back = np.hypot(*(values[-1, 1:3] - values[0, 1:3]))
    return bool(values.shape[1] > 3 and 0.0 < back < 3.0 * np.max(way) < 0.1 * np.sum(way))
