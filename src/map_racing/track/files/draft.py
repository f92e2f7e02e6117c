"""A raceline under examination: the points kept so far, the curve through them, the findings."""

from __future__ import annotations

from typing import Iterable, Sequence

import numpy as np

from ...errors import RacelineError
from ..findings import ERROR, Finding, Place
from ..raceline import CurveSamples, Raceline
from .table import RacelineTable

__all__ = ["MOST_PLACES", "Draft"]

MOST_PLACES = 200  # listed for one finding


class Draft:
    """A table while it is examined.

    Attributes
    ----------
    columns : dict of str to ndarray, shape (n,)
        Columns of the points kept.
    rows : ndarray of int, shape (n,)
        Rows of these points in the table.
    findings : list of Finding
    raceline : Raceline or None
        Curve through the points, once `build` has succeeded.
    at : CurveSamples or None
        That curve at the points.
    """

    def __init__(self, table: RacelineTable):
        self.table = table
        self.columns = {key: np.asarray(c, dtype=float) for key, c in table.columns.items()}
        self.rows = np.arange(self.columns["x"].size)
        self.findings: list[Finding] = list(table.findings)
        self.raceline: Raceline | None = None
        self.at: CurveSamples | None = None
        self._s = None  # arc length of every row of the table, once there is a curve

    @property
    def fatal(self) -> bool:
        """Whether a finding is an error."""
        return any(finding.severity == ERROR for finding in self.findings)

    @property
    def xy(self) -> np.ndarray:
        """Points kept, shape (n, 2)."""
        return np.stack((self.columns["x"], self.columns["y"]), axis=1)

    def keep(self, mask: np.ndarray) -> None:
        """Drop all points but these.

        Parameters
        ----------
        mask : ndarray of bool, shape (n,)
            One for each point kept so far.
        """
        self.columns = {key: column[mask] for key, column in self.columns.items()}
        self.rows = self.rows[mask]

    def add(self, code: str, severity: str, text: str, at: Sequence[int] = ()) -> None:
        """Add a finding at points, given by their indices among those kept."""
        given, lines = self.table.columns, self.table.lines
        places = tuple(
            Place(
                row,
                None if lines is None else int(lines[row]),
                None if self._s is None else float(self._s[row]),
                float(given["x"][row]),
                float(given["y"][row]),
            )
            for row in (int(self.rows[point]) for point in at[:MOST_PLACES])
        )
        self.findings.append(Finding(code, severity, text, places))

    def build(self) -> None:
        """Make the curve through the points, or find that there is none."""
        columns, table = self.columns, self.table
        try:
            self.raceline = Raceline(
                columns["x"],
                columns["y"],
                vx_mps=columns.get("speed"),
                d_left_m=columns.get("d_left"),
                d_right_m=columns.get("d_right"),
                name=table.name,
                source=table.source,
            )
        except RacelineError as error:
            text = str(error)[len(f"{table.source or table.name or 'raceline'}: ") :]
            rising = [key for key in ("x", "y") if np.all(np.diff(columns[key]) > 0.0)]
            if rising:
                text += f"; {rising[0]} only increases: is it really the {rising[0]} column?"
            self.add("open", ERROR, text)
            # What else is wrong with the points may be for want of this.
            self.findings.insert(0, self.findings.pop())
            return
        self.at = self.raceline.sample(self.raceline.s_points)
        s = np.full(len(table.columns["x"]), np.nan)
        s[self.rows] = self.raceline.s_points
        # Dropped points get the arc length of the point kept before them.
        last = np.maximum.accumulate(np.where(np.isfinite(s), np.arange(s.size), 0))
        self._s = s[last]
        for k, finding in enumerate(self.findings):
            places = tuple(p._replace(s=float(self._s[p.index])) for p in finding.places)
            self.findings[k] = finding._replace(places=places)

    def points_near(self, cells: Iterable[int]) -> list[int]:
        """Indices of the points closest along the curve to cells of the raceline."""
        line = self.raceline
        away = (np.abs(line.s_points - line.s[cell]) for cell in cells)
        return [int(np.argmin(np.minimum(off, line.length - off))) for off in away]
