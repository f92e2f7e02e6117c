"""What is noticed about a track: with a code for programs, a text for people, and the places."""

from typing import NamedTuple, Optional, Tuple

__all__ = ["ERROR", "NOTE", "WARNING", "Finding", "Place", "points", "worst_first"]

NOTE = "note"
"""A convention recognized: nothing is wrong."""
WARNING = "warning"
"""Wrong or doubtful; the track can be used."""
ERROR = "error"
"""Wrong beyond use."""


class Place(NamedTuple):
    """A point of a track as it was given.

    ``index`` counts from 0, ``line`` is that of the file, from 1; arc length ``s``, ``x`` and ``y``
    are in meters. ``line`` is None where there are no lines, ``s`` where there is no curve.
    """

    index: int
    line: Optional[int]
    s: Optional[float]
    x: float
    y: float

    def __str__(self):
        line = "" if self.line is None else f" (line {self.line})"
        s = "" if self.s is None else f" s = {self.s:.2f} m,"
        return f"point {self.index}{line}:{s} x = {self.x:.3f} m, y = {self.y:.3f} m"


class Finding(NamedTuple):
    """One thing noticed; as text it is one line.

    Attributes
    ----------
    code : str
        Short name of the kind, for programs; it stays when the text changes.
    severity : {"note", "warning", "error"}
    text : str
    places : tuple of Place
        Where it stands: the worst point, or all of them in order. Empty if it is everywhere.
    """

    code: str
    severity: str
    text: str
    places: Tuple[Place, ...] = ()

    def __str__(self):
        if not self.places:
            return self.text
        return f"{self.text}, {'first ' if len(self.places) > 1 else ''}at {self.places[0]}"


def worst_first(findings):
    """Findings as a list, errors before warnings before notes, else in their order."""
    order = (ERROR, WARNING, NOTE)
    return sorted(findings, key=lambda finding: order.index(finding.severity))


def points(count, adjective=""):
    """``"1 point"`` or ``"2 points"``, as texts of findings have them."""
    return " ".join(filter(None, (str(count), adjective, "point" if count == 1 else "points")))
