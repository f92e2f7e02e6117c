"""The supervisor's decision: whether the car drives, why not, and the command."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

__all__ = ["Decision", "Mode", "Reason", "state_level", "state_text"]


class Mode(Enum):
    """What the supervisor lets the car do."""

    WAITING = "waiting"  # it has not driven yet
    DRIVING = "driving"
    STOPPING = "stopping"  # the commanded speed ramps down
    STOPPED = "stopped"


class Reason(Enum):
    """Why the car may not drive, by descending priority."""

    NONE = ""
    STOP_REQUESTED = "stop requested"
    FAILURE = "controller failed"
    NO_POSE = "no pose yet"
    FRAME = "pose in another frame"
    INVALID_POSE = "pose not finite or absurd"
    STALE_POSE = "pose too old"
    FROZEN_POSE = "pose frozen while moving"
    JUMP = "pose jumped"
    HEADING = "heading against the motion"
    BACKWARDS = "rolling backwards"
    BLOCKED = "no motion although commanded"
    INVALID_RACELINE = "raceline not drivable"
    OPPOSED_RACELINE = "raceline against the motion"
    NO_RACELINE = "no raceline"
    DEVIATION = "too far from the raceline"
    OVERSPEED = "faster than commanded for long"
    GRIP = "grip exceeded for long"


class Decision(NamedTuple):
    """Command to the car, and why."""

    mode: Mode
    reason: Reason
    steering_angle: float
    speed: float


def state_text(mode: Mode, reason: Reason) -> str:
    """Mode and reason as text, as in diagnostics and bags."""
    return f"{mode.value}: {reason.value}" if reason.value else mode.value


def state_level(mode: Mode, reason: Reason) -> int:
    """Diagnostics level: 0 driving, 1 (warning) waiting or stopped on request, else 2 (error)."""
    if mode is Mode.DRIVING:
        return 0
    return 1 if mode is Mode.WAITING or reason is Reason.STOP_REQUESTED else 2
