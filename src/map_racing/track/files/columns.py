"""Columns of racelines by their names in files and messages."""

from __future__ import annotations

import re
from typing import Any, Iterable, Mapping, NamedTuple

import numpy as np

from ...units import SI, factor_to_si, is_unit, no_unit

__all__ = [
    "ALIASES",
    "REFERENCE",
    "Meaning",
    "columns_of_waypoints",
    "from_reference_line",
    "may_be_unit",
    "meaning_of",
]

# Names of columns, without units and separators, in lower case. Where two columns of a file mean
# the same, the name that comes first here is taken.
ALIASES = {
    "s": ("s", "arc length", "arclength", "station", "chainage", "distance", "dist"),
    "x": ("x", "easting", "east"),
    "y": ("y", "northing", "north"),
    "psi": ("psi", "yaw", "theta", "heading", "th", "phi", "orientation", "course", "hdg"),
    "kappa": ("kappa", "curvature", "curv", "k"),
    "speed": (
        "vx",
        "v",
        "speed",
        "velocity",
        "vel",
        "v x",
        "vel x",
        "velocity x",
        "speed x",
        "lin vel",
        "linear vel",
        "linear velocity",
        "linear speed",
        "linear x",
        "long vel",
        "longitudinal velocity",
        "longitudinal speed",
        "vel long",
        "v long",
        "lon vel",
        "lon velocity",
        "lon speed",
    ),
    "ax": ("ax", "a", "acc", "acceleration", "accel", "a x", "acc x", "long acceleration"),
    "d_right": ("d right", "right"),
    "d_left": ("d left", "left"),
    "width": ("width", "w", "total width", "width total", "w total"),
    "half_width": ("half width", "width half", "w half"),
    # A reference line with widths; the raceline lies `alpha` along its normals.
    "x_ref": ("x ref",),
    "y_ref": ("y ref",),
    "x_normal": ("x normvec",),
    "y_normal": ("y normvec",),
    "alpha": ("alpha",),
    # What no raceline needs.
    "-": ("", "z", "height", "elevation", "altitude", "id", "index", "idx", "no", "nr", "number")
    + ("d", "t", "time", "stamp", "timestamp", "lap", "frame", "banking")
    + ("tz", "qx", "qy", "qz", "qw"),
}
REFERENCE = ("x_ref", "y_ref", "x_normal", "y_normal", "alpha")

_MEANING = {alias: column for column, aliases in ALIASES.items() for alias in aliases}
_ORDER = [alias for aliases in ALIASES.values() for alias in aliases]


def _words(text):
    return frozenset(text.split())


# Words that do not change what a column is.
_FILLERS = _words(
    "pos position positions pose coord coords coordinate coordinates point points wp wps "
    "waypoint waypoints wpnt traj trajectory racetraj raceline racing line track path global "
    "map world opt optimal optimized center centre centerline centreline iqp sp target targets "
    "desired des reference goal cmd command profile value tr ref of the in and field twist odom pf"
)
# Of these at least one stands beside "left" or "right" where the distance to a wall is meant.
_WALL = _words(
    "w width d dist distance wall boundary bound border edge side margin lane track tr limit n "
    "to free space half"
)
_GLUED = {
    **{
        name: "d left"
        for name in ("wl", "lw", "dl", "nl", "wleft", "dleft", "leftwidth", "widthleft")
    },
    **{
        name: "d right"
        for name in ("wr", "rw", "dr", "wright", "dright", "rightwidth", "widthright")
    },
    "trackwidth": "width",
    "lanewidth": "width",
    "halfwidth": "half width",
    "targetspeed": "speed",
    "targetvelocity": "speed",
    "tx": "x",
    "ty": "y",
    "xpos": "x",
    "ypos": "y",
    "posx": "x",
    "posy": "y",
    "xref": "x ref",
    "yref": "y ref",
    "vref": "v",
}

_QUANTITIES = {
    **dict.fromkeys(("s", "x", "y", "d_right", "d_left", "width", "half_width"), "length"),
    **dict.fromkeys(("x_ref", "y_ref", "alpha", "x_normal", "y_normal"), "length"),
    "psi": "angle",
    "kappa": "curvature",
    "speed": "speed",
    "ax": "acceleration",
}
_KNOWN = frozenset(_QUANTITIES.values())


class Meaning(NamedTuple):
    """What a column is by its name.

    Attributes
    ----------
    column : str
        One of the keys of `ALIASES`: ``"-"`` for what no raceline needs, ``"?"`` for what is not
        understood.
    factor : float
        By which its numbers are multiplied to have SI units.
    unit : str
        The unit as named, where it is not SI; empty otherwise.
    expected_unit : str
        The SI unit, where the unit is not one of this quantity; empty otherwise.
    rank : int
        Where two columns mean the same, the one of lower rank is taken.
    """

    column: str
    factor: float = 1.0
    unit: str = ""
    expected_unit: str = ""
    rank: int = 0


def meaning_of(name: str, unit: str = "") -> Meaning:
    """What a column is by its name, without regard to units, case, separators and order of words.

    Parameters
    ----------
    name : str
        Such as ``"x_m"``, ``"Target Speed [km/h]"``, ``"widthRight"``.
    unit : str, optional
        Its unit, where that stands elsewhere.

    Returns
    -------
    Meaning
    """
    name, unit = name.strip().strip("#\"'").strip(), unit.strip("[](){}<> ")
    bracket = re.search(r"[\[({<]([^\])}>]*)[\])}>]\s*$", name)
    if bracket:
        unit = unit or bracket.group(1)
        name = name[: bracket.start()]
    words = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    words = [word for word in re.split(r"[^a-z0-9]+", words.lower()) if word]
    if not words and any(map(str.isalpha, name)):
        return Meaning("?")  # in letters of another alphabet
    named = _by_words(words)
    if named is None or (not unit and _ends_with_unit(words)):
        # The longest ending that is a unit and leaves a name.
        for size in (4, 3, 2, 1):
            ending = " ".join(words[-size:])
            if size < len(words) and is_unit(ending, _KNOWN):
                shorter = _by_words(words[:-size])
                if shorter is not None and is_unit(ending, _quantities_of(shorter[0])):
                    named, unit = shorter, unit or ending
                    break
    if named is None:
        return Meaning("?")
    column, rank = named
    return _with_unit(column, rank, unit)


def may_be_unit(text: str) -> bool:
    """Whether a text is a unit that columns of racelines have, such as ``m/s``."""
    text = text.strip().strip("[](){}")
    return is_unit(text, _KNOWN) or no_unit(text)


def columns_of_waypoints(fields: Mapping[str, Any]) -> dict[str, Any]:
    """Columns by the names in `ALIASES` of the fields of ``f110_msgs/Wpnt``."""
    named = {field: meaning_of(field).column for field in fields}
    return {column: fields[field] for field, column in named.items() if column not in ("-", "?")}


def _by_words(words: Iterable[str]) -> tuple[str, int] | None:
    """Column and rank of a name given as words; None if it is not understood."""
    written = " ".join(words)
    words = " ".join(_GLUED.get(word, word) for word in words).split()
    text = " ".join(words)
    if text in _MEANING:
        # Behind the plain name: beside x and y, tx and ty are the tangent.
        return _MEANING[text], _ORDER.index(text) + (0 if text == written else 100)
    if {"x", "y"} & set(words) and {"ref", "normvec"} & set(words):
        for column in ("x_ref", "y_ref", "x_normal", "y_normal"):
            if set(column.replace("normal", "normvec").split("_")) == set(words) - {"vec"}:
                return column, 0
    side = [{"l": "left", "r": "right"}.get(word, word) for word in words]
    sides = [word for word in side if word in ("left", "right")]
    rest = [word for word in side if word not in ("left", "right") and word not in _FILLERS]
    if len(sides) == 1:
        bare = not rest and len(words) > 1 or words == sides
        if bare or (rest and set(rest) <= _WALL):
            return f"d_{sides[0]}", len(words)
        return None
    left = [word for word in words if word not in _FILLERS]
    text = " ".join(left)
    if left and len(left) < len(words) and text in _MEANING:
        # A name with more words stands back behind the plain one.
        return _MEANING[text], _ORDER.index(text) + 100 * (len(words) - len(left))
    if len(left) == 2 and left[0] in ("width", "w") and "half" in left:
        return "half_width", 0
    return None


def _ends_with_unit(words):
    return len(words) > 1 and is_unit(words[-1], _KNOWN)


def _quantities_of(column):
    """The quantity of a column; of one that no raceline needs, any."""
    return (_QUANTITIES[column],) if column in _QUANTITIES else _KNOWN


def _with_unit(column, rank, unit):
    if column not in _QUANTITIES or no_unit(unit):
        return Meaning(column, rank=rank)
    factor = factor_to_si(_QUANTITIES[column], unit)
    if factor is None:
        return Meaning(column, unit=unit, expected_unit=SI[_QUANTITIES[column]], rank=rank)
    return Meaning(column, factor, unit if factor != 1.0 else "", rank=rank)


def from_reference_line(columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Points and walls from a reference line with normals and shifts.

    The distances to the walls are measured along the normals of the raceline itself, to the
    polylines at ``ref + n width_right`` and ``ref - n width_left`` for normals to the right; the
    side of the normals is computed, too.

    Parameters
    ----------
    columns : dict of str to ndarray, shape (n,)
        With ``x_ref y_ref x_normal y_normal alpha`` and perhaps ``d_left d_right`` [m]; changed.

    Returns
    -------
    dict of str to ndarray, shape (n,)
        The same, with ``x y`` in place of the reference line.
    """
    reference = np.stack((columns.pop("x_ref"), columns.pop("y_ref")), axis=1)
    normal = np.stack((columns.pop("x_normal"), columns.pop("y_normal")), axis=1)
    alpha = columns.pop("alpha")
    track = reference + alpha[:, None] * normal
    columns.update(x=track[:, 0], y=track[:, 1])
    if "d_left" not in columns or "d_right" not in columns:
        return columns
    closed = np.array_equal(reference[0], reference[-1])
    ring = slice(None, -1) if closed else slice(None)
    tangent = _tangents(reference[ring])
    side = float(np.sum(tangent[:, 0] * normal[ring, 1] - tangent[:, 1] * normal[ring, 0]))
    left = normal * (1.0 if side > 0.0 else -1.0)
    shift = alpha if side > 0.0 else -alpha
    own = np.empty_like(left)
    own[ring] = _tangents(track[ring])
    own[-1] = own[0] if closed else own[-1]
    own = np.stack((-own[:, 1], own[:, 0]), axis=1)
    d_left, d_right = columns["d_left"], columns["d_right"]
    wall_left = reference + d_left[:, None] * left
    wall_right = reference - d_right[:, None] * left
    columns["d_left"] = _distance(track, own, wall_left[ring], d_left - shift)
    columns["d_right"] = _distance(track, -own, wall_right[ring], d_right + shift)
    return columns


def _tangents(points):
    way = np.roll(points, -1, axis=0) - np.roll(points, 1, axis=0)
    return way / np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-12)[:, None]


def _distance(points, directions, wall, guess):
    """Distance from points in a direction to a closed wall, nearest to a guess.

    Only the wall up to 12 vertices away is searched; where no ray meets it, the guess remains,
    measured along the normal of the reference line.
    """
    reach = min(12, len(wall) // 2)
    index = (np.arange(len(points))[:, None] + np.arange(-reach, reach)) % len(wall)
    start = wall[index] - points[:, None]
    way = wall[(index + 1) % len(wall)] - wall[index]
    dx, dy = directions[:, 0:1], directions[:, 1:2]
    area = dx * way[..., 1] - dy * way[..., 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (start[..., 0] * way[..., 1] - start[..., 1] * way[..., 0]) / area
        part = (start[..., 0] * dy - start[..., 1] * dx) / area
        off = np.where((part >= 0.0) & (part <= 1.0), np.abs(distance - guess[:, None]), np.inf)
    best = np.argmin(off, axis=1)
    rows = np.arange(len(points))
    return np.where(np.isfinite(off[rows, best]), distance[rows, best], guess)
