"""Racelines as files and messages state them, nothing verified yet."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..findings import WARNING, Finding

__all__ = ["RacelineTable", "without_signs"]


class RacelineTable(NamedTuple):
    """A raceline as a file or a message states it, point by point, nothing verified yet.

    Attributes
    ----------
    columns : dict of str to ndarray, shape (n_points,)
        By the names in `map_racing.track.files.columns.ALIASES`, at least ``x`` and ``y``.
    name, source : str
        See `Raceline`.
    layout : str
        How it was read, for reports.
    lines : ndarray of int, shape (n_points,), or None
        Line of each point in the file.
    findings : tuple of Finding
        What was noticed while reading.
    bounds : tuple of ndarray, shape (k, 2)
        Sets of points on both walls that the file also holds [m]; any of them may be wrong.
    """

    columns: dict[str, np.ndarray]
    name: str = ""
    source: str = ""
    layout: str = ""
    lines: np.ndarray | None = None
    findings: tuple[Finding, ...] = ()
    bounds: tuple[np.ndarray, ...] = ()

    @property
    def xy(self) -> np.ndarray:
        """Points, shape (n_points, 2) [m]."""
        return np.stack((self.columns["x"], self.columns["y"]), axis=1)


def without_signs(table: RacelineTable) -> RacelineTable:
    """The table with positive distances where a file has the walls' offsets to one side.

    Then those of one wall are negative all around, and of the other one positive: no line lies
    beyond a wall for a whole lap.
    """
    columns = table.columns
    if not {"d_left", "d_right"} <= set(columns):
        return table
    with np.errstate(invalid="ignore"):
        negative = [side for side in ("left", "right") if np.all(columns[f"d_{side}"] < 0.0)]
        positive = [side for side in ("left", "right") if np.all(columns[f"d_{side}"] > 0.0)]
    if not (negative and positive):
        return table
    key = f"d_{negative[0]}"
    text = (
        f"every distance to the {negative[0]} wall is negative, as an offset to the {positive[0]}: "
        "taken without the sign"
    )
    findings = (*table.findings, Finding("signed-walls", WARNING, text))
    return table._replace(columns={**columns, key: np.abs(columns[key])}, findings=findings)
