"""Tracks as they are given, before anything of them is believed."""

from typing import NamedTuple, Optional, Tuple

from ..findings import Finding

__all__ = ["RacelineTable"]


class RacelineTable(NamedTuple):
    """A track as a file or a message has it, point by point; nothing of it is believed yet.

    Attributes
    ----------
    columns : dict of str to ndarray, shape (n_points,)
        By the names in `map_racing.track.files.readers.ALIASES`, at least ``x`` and ``y``.
    name, source : str
        As of `Raceline`.
    layout : str
        What it was read as, for reports.
    lines : ndarray of int, shape (n_points,), or None
        Line of each point in the file.
    findings : tuple of Finding
        What was noticed when it was read.
    """

    columns: dict
    name: str = ""
    source: str = ""
    layout: str = ""
    lines: Optional[object] = None
    findings: Tuple[Finding, ...] = ()
