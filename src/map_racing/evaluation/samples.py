"""What a recording holds, whatever kind of file it came from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import List, Optional

import numpy as np

from ..track.raceline import Raceline

__all__ = ["Commands", "Recording"]


@dataclass(frozen=True)
class Commands:
    """Drive commands over time.

    Attributes
    ----------
    t : ndarray, shape (k,)
        Time on the clock of the recording [s]; may begin before 0.
    steering_angle : ndarray, shape (k,)
        Steering angle, positive to the left [rad]; NaN where unknown.
    speed : ndarray, shape (k,)
        Speed [m/s]; NaN where unknown.
    topic : str
        Topic or columns it came from.
    """

    t: np.ndarray
    steering_angle: np.ndarray
    speed: np.ndarray
    topic: str = ""


@dataclass(frozen=True)
class Recording:
    """Poses of a car over time, strictly increasing in time, without NaN in ``t``, ``x``, ``y``.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Time since the first pose [s].
    x, y : ndarray, shape (n,)
        Position in ``frame`` [m].
    psi : ndarray, shape (n,)
        Heading [rad]; NaN where unknown.
    v_x, v_y, yaw_rate : ndarray, shape (n,)
        Velocity in the body frame [m/s, m/s, rad/s]; NaN where unknown.
    t0_ns : int
        Time stamp of the first pose [ns]; 0 for a file without absolute time.
    source : str
        File.
    topic, type, frame : str
        Where in the file the pose comes from.
    commands : Commands, optional
        Drive commands of the same recording.
    raceline : Raceline, optional
        Raceline that the recording itself carries.
    notes : list of str
        What was chosen, repaired or left out while reading, one line each.
    """

    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    psi: np.ndarray
    v_x: np.ndarray
    v_y: np.ndarray
    yaw_rate: np.ndarray
    t0_ns: int = 0
    source: str = ""
    topic: str = ""
    type: str = ""
    frame: str = ""
    commands: Optional[Commands] = None
    raceline: Optional[Raceline] = None
    notes: List[str] = field(default_factory=list)
