"""Units of columns in files, and their factors to SI."""

from __future__ import annotations

import math
import re
from typing import Iterable

__all__ = ["SI", "factor_to_si", "is_unit", "no_unit", "unit_at_end"]

SI = {
    "length": "m",
    "angle": "rad",
    "time": "s",
    "speed": "m/s",
    "turn rate": "rad/s",
    "acceleration": "m/s^2",
    "curvature": "1/m",
}
"""The SI unit of each quantity."""

# Units of each quantity with the factor to SI, as `_plain` writes them: the same letters may mean
# different things, such as m/s and ms.
_KNOT, _DEGREE = 1852.0 / 3600.0, math.radians(1.0)
_LENGTHS = [("m meter meters metre metres", 1.0), ("cm", 0.01), ("mm", 0.001), ("km", 1000.0)]
_LENGTHS += [("ft feet", 0.3048), ("inch inches", 0.0254)]
_ANGLES = [("rad radian radians", 1.0), ("mrad", 0.001)]
_ANGLES += [("deg degree degrees \N{DEGREE SIGN}", _DEGREE)]
_TIMES = [
    ("s sec secs second seconds", 1.0),
    ("ms msec msecs millis millisecond milliseconds", 1e-3),
    ("us usec usecs micros microsecond microseconds", 1e-6),
    ("ns nsec nsecs nanos nanosecond nanoseconds", 1e-9),
    ("min mins minute minutes", 60.0),
    ("h hr hrs hour hours", 3600.0),
]
_SPEEDS = [
    ("mps ms ms1 msec meterssecond", 1.0),
    ("cmps cms", 0.01),
    ("mmps mms", 0.001),
    ("kmh kmph kph kmhr kmhour kmh1", 1.0 / 3.6),
    ("mph", 0.44704),
    ("ftps fts", 0.3048),
    ("kn kt kts knot knots", _KNOT),
]
_TURN_RATES = [
    ("rads radps rads1 radsec radianss radianssecond", 1.0),
    ("mrads mradps", 0.001),
    ("degs degps degs1 degsec dps degreess degreessecond \N{DEGREE SIGN}s", _DEGREE),
    ("rpm", 2.0 * math.pi / 60.0),
]
_ACCELERATIONS = [("mps2 ms2 mss mpss msec2", 1.0), ("cms2", 0.01), ("mms2", 0.001)]
_ACCELERATIONS += [("g", 9.80665)]
_QUANTITIES = {
    quantity: {name: factor for names, factor in units for name in names.split()}
    for quantity, units in {
        "length": _LENGTHS,
        "angle": _ANGLES,
        "time": _TIMES,
        "speed": _SPEEDS,
        "turn rate": _TURN_RATES,
        "acceleration": _ACCELERATIONS,
        "curvature": [("radpm radm 1m m1 pm", 1.0)],
    }.items()
}
_SIGNS = str.maketrans("\N{SUPERSCRIPT TWO}\N{SUPERSCRIPT ONE}\N{MICRO SIGN}\u03bc", "21uu")
_NONE = frozenset(("", "-", "none", "1", "si"))


def factor_to_si(quantity: str, unit: str) -> float | None:
    """The SI value of one unit of a quantity.

    Parameters
    ----------
    quantity : str
        A key of `SI`.
    unit : str
        In any common spelling, such as ``km/h``, ``kmph`` or ``m s^-2``; may be none, which is SI.

    Returns
    -------
    float or None
        None if the quantity has no such unit.
    """
    return 1.0 if no_unit(unit) else _QUANTITIES[quantity].get(_plain(unit))


def no_unit(text: str) -> bool:
    """Whether a text stands where a unit could, but is none, such as ``-``."""
    return text.strip().lower() in _NONE


def is_unit(text: str, quantities: Iterable[str] = tuple(SI)) -> bool:
    """Whether a text is a unit of one of the quantities."""
    return any(_plain(text) in _QUANTITIES[quantity] for quantity in quantities)


def unit_at_end(name: str, quantity: str) -> tuple[str, str]:
    """A column's name without the unit behind it, and this unit, empty if there is none.

    Parameters
    ----------
    name : str
        With words separated by blanks or underscores, such as ``speed_kmh`` or ``v_m_s``.
    quantity : str
        A key of `SI`: only its units are taken.
    """
    words = [word for word in re.split(r"[_\s]+", name) if word]
    for size in (3, 2, 1):
        ending = " ".join(words[-size:])
        if size < len(words) and _plain(ending) in _QUANTITIES[quantity]:
            return "_".join(words[:-size]), ending.replace(" ", "/")
    return name, ""


def _plain(unit):
    """A unit without what can be written in several ways: ``m/s^2``, ``m s-2`` are ``ms2``."""
    unit = unit.strip().lower().translate(_SIGNS).replace("**", "")
    unit = re.sub(r"(?<![a-z])per(?![a-z])", "", unit)
    return re.sub(r"[\s_/^*.\-\N{SUPERSCRIPT MINUS}\N{MIDDLE DOT}]+", "", unit)
