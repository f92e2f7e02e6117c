"""What makes the numbers of laps doubtful, in the same words live and from recordings."""

from __future__ import annotations

import math

import numpy as np

from ..bags.samples import is_odometry_frame
from ..track.findings import WARNING
from ..track.raceline import Raceline
from .results import Lap

__all__ = ["frame_warning", "raceline_warnings", "uncommanded"]


def frame_warning(topic: str, frame: str) -> str:
    """Doubt about poses in a frame of odometry; empty without."""
    if not is_odometry_frame(frame):
        return ""
    return (
        f"{topic} is in frame {frame}, which drifts against the map: the lateral errors are not "
        "those on the track"
    )


def raceline_warnings(raceline: Raceline) -> list[str]:
    """Doubts about a raceline, and so about all that is measured against it."""
    doubts = [finding for finding in raceline.findings if finding.severity == WARNING]
    return [f"raceline {raceline.name or raceline.source}: {finding}" for finding in doubts]


def uncommanded(t: np.ndarray, command: np.ndarray, laps: list[Lap]) -> list[str]:
    """Doubts about complete laps in which there were no commands for a time.

    Parameters
    ----------
    t, command : ndarray, shape (n,)
        Times [s], and the speed commanded, NaN without a command.
    laps : list of Lap
    """
    without, partly = [], []
    for lap in laps:
        if math.isnan(lap.lap_time_s):
            continue
        missing = np.isnan(command[(t >= lap.start_time_s) & (t <= lap.end_time_s)])
        if missing.all():
            without.append(str(lap.lap))
        elif missing.mean() > 0.02:
            partly.append(str(lap.lap))
    doubts = []
    if without:
        doubts.append(
            f"no drive commands in laps {', '.join(without)}: their speed error, if any, "
            "is to the raceline"
        )
    if partly:
        doubts.append(
            f"drive commands are missing for a part of laps {', '.join(partly)}: their "
            "speed error and steering rate are of the rest"
        )
    return doubts
