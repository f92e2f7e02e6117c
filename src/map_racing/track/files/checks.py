"""Examination of racelines as given: everything stated is recomputed from the points and compared.

`examine` fits the curve through the points and compares it with what the table states: closure,
order, spacing, heading, curvature, arc length, walls, speeds. A `NOTE` reports a convention, a
`WARNING` what is wrong or doubtful, an `ERROR` what cannot be driven.
"""

from __future__ import annotations

from typing import NamedTuple

from ...errors import RacelineError
from ..findings import ERROR, Finding
from ..raceline import Raceline
from . import check_curve, check_points, check_speeds, check_walls
from .draft import Draft
from .table import RacelineTable

__all__ = ["Examination", "examine", "raceline_of"]


class Examination(NamedTuple):
    """Result of `examine`.

    ``raceline`` is None where there is no curve through the points.
    """

    raceline: Raceline | None
    findings: tuple[Finding, ...]

    def worst(self, severity: str) -> list[Finding]:
        """Findings of one severity."""
        return [finding for finding in self.findings if finding.severity == severity]


def raceline_of(table: RacelineTable) -> Raceline:
    """Drivable raceline of a table.

    Parameters
    ----------
    table : RacelineTable

    Returns
    -------
    Raceline
        With all `findings`.

    Raises
    ------
    RacelineError
        If any finding is an error.
    """
    examination = examine(table)
    errors = examination.worst(ERROR)
    if errors:
        count = len(errors) - 1
        more = f" (and {count} more error{'s' if count > 1 else ''})" if count else ""
        raise RacelineError(f"{table.source or table.name or 'raceline'}: {errors[0]}{more}")
    examination.raceline.findings = examination.findings
    return examination.raceline


def examine(table: RacelineTable) -> Examination:
    """Fit the curve of a table and compare it with what the table states.

    Takes about 20 ms for a track of 340 m with points 0.2 m apart, half of it for the curve.
    """
    draft = Draft(table)
    check_points.check_values(draft)
    if draft.fatal:
        return Examination(None, tuple(draft.findings))
    check_points.check_order(draft)
    draft.build()
    if draft.raceline is not None:
        check_curve.check_size(draft)
        check_curve.check_stated(draft)
        check_walls.check_distances(draft)
        check_speeds.check_stops(draft)
        # Where the points are in a wrong order, bends and walls are meaningless.
        if not draft.fatal:
            check_curve.check_shape(draft)
            check_walls.check_polygons(draft)
            check_speeds.check_accelerations(draft)
    return Examination(draft.raceline, tuple(draft.findings))
