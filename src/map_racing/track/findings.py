"""Findings about racelines: a code for programs, a text for people, and the places."""

from __future__ import annotations

from typing import TYPE_CHECKING, Iterable, NamedTuple

if TYPE_CHECKING:
    from .raceline import Raceline

__all__ = [
    "ERROR",
    "NOTE",
    "WARNING",
    "Finding",
    "Place",
    "points",
    "raceline_warnings",
    "worst_first",
]

NOTE = "note"
"""A convention: nothing is wrong."""
WARNING = "warning"
"""Wrong or doubtful, but usable."""
ERROR = "error"
"""Unusable."""


class Place(NamedTuple):
    """A point of a raceline as given.

    ``index`` counts from 0; ``line`` in the file counts from 1, None without a text file. Arc
    length ``s`` [m] is None without a curve. Position ``x``, ``y`` [m].
    """

    index: int
    line: int | None
    s: float | None
    x: float
    y: float

    def __str__(self):
        line = "" if self.line is None else f" (line {self.line})"
        s = "" if self.s is None else f" s = {self.s:.2f} m,"
        return f"point {self.index}{line}:{s} x = {self.x:.3f} m, y = {self.y:.3f} m"


class Finding(NamedTuple):
    """One finding; as text it is one line.

    Attributes
    ----------
    code : str
        Short name of the kind, for programs; it does not change with the text.
    severity : {"note", "warning", "error"}
    text : str
    places : tuple of Place
        The worst point, or all of them in order. Empty if the finding concerns the whole line.
    """

    code: str
    severity: str
    text: str
    places: tuple[Place, ...] = ()

    def __str__(self):
        if not self.places:
            return self.text
        return f"{self.text}, {'first ' if len(self.places) > 1 else ''}at {self.places[0]}"


def worst_first(findings: Iterable[Finding]) -> list[Finding]:
    """Sort findings: errors, warnings, notes, each in their original order."""
    order = (ERROR, WARNING, NOTE)
    return sorted(findings, key=lambda finding: order.index(finding.severity))


def points(count: int, adjective: str = "") -> str:
    """``"1 point"`` or ``"2 points"``, for the texts of findings."""
    return " ".join(filter(None, (str(count), adjective, "point" if count == 1 else "points")))


def raceline_warnings(raceline: Raceline, origin: str = "") -> list[str]:
    """Warnings about a raceline from `origin`, which apply to all results based on it."""
    origin = origin or raceline.name or raceline.source
    doubts = [finding for finding in raceline.findings if finding.severity == WARNING]
    return [f"raceline {origin}: {finding}" for finding in doubts]
