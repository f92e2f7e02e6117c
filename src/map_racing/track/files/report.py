"""Reports on racelines, for people and for programs."""

from __future__ import annotations

import math
from typing import Any, Iterable

import numpy as np

from ..findings import ERROR, WARNING, Finding, worst_first
from ..raceline import Raceline
from ..speed_profile import lap_time

__all__ = ["raceline_facts", "facts_text", "findings_count", "findings_rows"]


def raceline_facts(raceline: Raceline) -> dict[str, Any]:
    """Key figures of a raceline, all recomputed from its points.

    Parameters
    ----------
    raceline : Raceline

    Returns
    -------
    dict
        ``length_m``, ``direction`` (``"counter-clockwise"``, ``"clockwise"``, or ``"crossing"`` for
        a track that turns as much to the left as to the right), ``points``, ``spacing_m`` (least,
        median, most), ``min_radius_m``, ``vx_mps`` (least, most), ``lap_time_s`` at these speeds,
        ``d_left_m`` and ``d_right_m`` (least, most); None where unknown.
    """
    spacing = np.diff(np.append(raceline.s_points, raceline.length))
    # The heading turns by 2 pi in a lap, by nothing in a figure eight; the area has the direction.
    x, y = raceline.x, raceline.y
    area = float(np.sum((x - x[0]) * np.roll(y - y[0], -1) - np.roll(x - x[0], -1) * (y - y[0])))
    crossing = abs(float(np.sum(raceline.kappa)) * raceline.ds) < math.pi
    direction = "crossing" if crossing else "counter-clockwise" if area > 0.0 else "clockwise"
    v, time = raceline.speed, None
    if v is not None:
        time = lap_time(v, raceline.ds)
        time = time if math.isfinite(time) else None
    return {
        "length_m": raceline.length,
        "direction": direction,
        "points": int(raceline.s_points.size),
        "spacing_m": [float(f(spacing)) for f in (np.min, np.median, np.max)],
        "min_radius_m": float(1.0 / max(np.max(np.abs(raceline.kappa)), 1e-9)),
        "vx_mps": _range(v),
        "lap_time_s": time,
        "d_left_m": _range(raceline.d_left),
        "d_right_m": _range(raceline.d_right),
    }


def facts_text(facts: dict[str, Any]) -> list[str]:
    """Lines of text with the figures of `raceline_facts`."""
    least, usual, most = facts["spacing_m"]
    lines = [
        f"{facts['length_m']:.3f} m, {facts['direction']}, {facts['points']} points "
        f"{least:.3f} to {most:.3f} m apart (median {usual:.3f} m), least radius "
        f"{facts['min_radius_m']:.2f} m"
    ]
    if facts["vx_mps"] is None:
        lines.append("no speeds")
    else:
        low, high = facts["vx_mps"]
        time = facts["lap_time_s"]
        lap = "" if time is None else f", a lap takes {time:.3f} s with them"
        lines.append(f"speeds {low:.2f} to {high:.2f} m/s{lap}")
    if facts["d_left_m"] is None:
        lines.append("no walls")
    else:
        left, right = facts["d_left_m"], facts["d_right_m"]
        lines.append(
            f"walls {left[0]:.2f} to {left[1]:.2f} m to the left, {right[0]:.2f} to "
            f"{right[1]:.2f} m to the right"
        )
    return lines


def findings_count(findings: Iterable[Finding]) -> str:
    """Number of errors and warnings, as text."""
    counts = []
    for severity in (ERROR, WARNING):
        count = sum(finding.severity == severity for finding in findings)
        if count:
            counts.append(f"{count} {severity}{'s' if count > 1 else ''}")
    return ", ".join(counts) or "nothing wrong"


def findings_rows(findings: Iterable[Finding]) -> list[dict[str, Any]]:
    """Findings as dictionaries ``code severity text places`` for JSON, errors first."""
    return [
        {
            "code": finding.code,
            "severity": finding.severity,
            "text": finding.text,
            "places": [
                {
                    "index": place.index,
                    "line": place.line,
                    "s_m": place.s,
                    "x_m": _number(place.x),
                    "y_m": _number(place.y),
                }
                for place in finding.places
            ],
        }
        for finding in worst_first(findings)
    ]


def _range(column):
    return None if column is None else [float(column.min()), float(column.max())]


def _number(value):
    # JSON has no NaN.
    return value if math.isfinite(value) else None
