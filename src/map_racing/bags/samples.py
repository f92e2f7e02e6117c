"""Recorded driving, whatever kind of file it came from."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from datetime import datetime, timezone
from typing import NamedTuple, Sequence

import numpy as np

from ..validation import FARTHEST
from .clocks import Clock

__all__ = [
    "COMMAND_HOLD_S",
    "SIMULATED",
    "SIMULATED_NS",
    "Beliefs",
    "Commands",
    "Recording",
    "Waypoints",
    "child_warning",
    "date_of",
    "in_order",
    "is_map_frame",
    "is_odometry_frame",
    "jump_back",
    "usable",
]

COMMAND_HOLD_S = 1.5
"""Age [s] beyond which a drive command is no longer in force: no driver obeys an older one."""

SIMULATED_NS = 1_700_000_000_000_000_000
"""Start time of simulated races [ns]: fixed, so that the same race gives the same file."""
SIMULATED = "simulated"
"""Shown for such races instead of a date."""

# A simulated race begins within this time after `SIMULATED_NS` [ns]. Times before 1973 [ns] come
# from clocks that were never set, or from simulated time.
_BEGIN, _DATED = 600 * 10**9, 10**17
_MAPS = ("", "map", "world")
_SENSORS = ("laser", "lidar", "scan", "imu", "camera")
# A step back in time: number of samples on both sides that are examined, the most steps that
# can come from clocks that were set, and the lowest speed of a driving car [m/s].
_AROUND, _MOST_SET, _DRIVES = 25, 5, 0.5
# Two poses with the same stamp are in different places if they are farther apart [m].
_AWAY = 0.3
# Shorter steps back in time [s] come from transport and threads; longer ones mean that a clock was
# set back or that another run begins.
_JITTER = 1.0


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
        Topic or columns of origin.
    shifted : bool
        Whether their stamps were from another clock and were shifted to the poses' clock by the
        times of receipt; they are then too early by the age of the poses.
    lag : float
        Median time from stamp to receipt [s]; NaN unless both are known.
    """

    t: np.ndarray
    steering_angle: np.ndarray
    speed: np.ndarray
    topic: str = ""
    shifted: bool = False
    lag: float = math.nan

    def held(self, t: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Values of the commands in force at each time; NaN without any.

        Parameters
        ----------
        t : ndarray, shape (n,)
            On the clock of the recording [s].
        values : ndarray, shape (k,)

        Returns
        -------
        ndarray, shape (n,)
        """
        # Before the first command the index is -1: the appended NaN.
        index = np.searchsorted(self.t, t, side="right") - 1
        with np.errstate(invalid="ignore"):
            fresh = t - np.append(self.t, np.nan)[index] <= COMMAND_HOLD_S
        return np.where(fresh, np.append(values, np.nan)[index], np.nan)


class Beliefs(NamedTuple):
    """Estimates of an adaptive controller over time.

    Attributes
    ----------
    t : ndarray, shape (k,)
        Time on the clock of the recording [s].
    values : ndarray, shape (k, 13)
        `map_racing.bags.messages.BELIEF_FIELDS`.
    """

    t: np.ndarray
    values: np.ndarray


class Waypoints(NamedTuple):
    """Waypoints of a message.

    Attributes
    ----------
    topic, type : str
        Origin; the type without its package.
    columns : dict of str to ndarray, shape (n,)
        Fields of ``f110_msgs/Wpnt``, at least ``x_m`` and ``y_m``.
    """

    topic: str
    type: str
    columns: dict


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
        Origin of the pose in the file.
    commands : Commands, optional
        Drive commands of the same recording.
    beliefs : Beliefs, optional
        Estimates of the adaptive controller.
    waypoints : Waypoints, optional
        Raceline in the recording, as it was sent.
    later_waypoints : list of (float, Waypoints)
        Later racelines on the same topic, with their times [s].
    clock : Clock, optional
        Clock of the poses in a bag, to bring further topics to it.
    notes : list of str
        What was chosen, repaired or left out while reading, one line each; lines about doubtful
        results begin with ``warning:``.
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
    commands: Commands | None = None
    beliefs: Beliefs | None = None
    waypoints: Waypoints | None = None
    later_waypoints: list[tuple[float, Waypoints]] = field(default_factory=list)
    clock: Clock | None = None
    notes: list[str] = field(default_factory=list)

    @property
    def speed(self) -> np.ndarray:
        """Measured speed [m/s]; without a lateral velocity, the longitudinal one."""
        return np.hypot(self.v_x, np.where(np.isnan(self.v_y), 0.0, self.v_y))

    @property
    def date(self) -> str:
        """Date of the recording, see `date_of`."""
        return date_of(self.t0_ns)


def is_map_frame(frame: str) -> bool:
    """Whether a frame is one that racelines use; a frame without a name counts as the map."""
    return frame.rpartition("/")[2] in _MAPS


def is_odometry_frame(frame: str) -> bool:
    """Whether a frame is one of wheel odometry, which drifts relative to the map."""
    return "odom" in frame.rpartition("/")[2].lower()


def child_warning(topic: str, child: str) -> str:
    """Warning that poses are those of a sensor, not of the car; otherwise empty."""
    if not any(name in child.rpartition("/")[2].lower() for name in _SENSORS):
        return ""
    return (
        f"{topic} has the pose of {child}, not of base_link: the lateral errors are those of that "
        "place"
    )


def usable(times: np.ndarray, columns: Sequence[np.ndarray]) -> np.ndarray:
    """Mask of samples with a finite time and values within `FARTHEST`.

    Parameters
    ----------
    times : ndarray, shape (n,)
    columns : sequence of ndarray, shape (n,)

    Returns
    -------
    ndarray of bool, shape (n,)
    """
    keep = np.isfinite(times)
    for column in columns:
        with np.errstate(invalid="ignore"):
            keep &= np.abs(column) < FARTHEST
    return keep


def jump_back(times: np.ndarray, second: int = 1) -> tuple[int, float] | None:
    """First place where time falls back so far that a new run must begin.

    Parameters
    ----------
    times : ndarray, shape (n,)
        In the order of recording.
    second : int, optional
        One second in the unit of ``times``.

    Returns
    -------
    tuple of (int, float) or None
        Index of the sample, and how far it falls behind the latest earlier one [s].
    """
    back = np.maximum.accumulate(times) - times
    far = np.flatnonzero(back >= _JITTER * second)
    return (int(far[0]), float(back[far[0]] / second)) if far.size else None


def in_order(
    times: np.ndarray,
    columns: Sequence[np.ndarray],
    notes: list[str],
    what: str,
    required: int = 0,
) -> tuple[np.ndarray, list[np.ndarray]]:
    """Bring samples of one run (see `jump_back`) into strict order of time.

    Parameters
    ----------
    times : ndarray, shape (n,)
    columns : sequence of ndarray, shape (n,)
    notes : list of str
        Gets a line for each kind of repair.
    what : str
        Name of the samples in the notes.
    required : int, optional
        Number of first columns that are coordinates [m]: samples are left out if the time or a
        coordinate is not finite or beyond `FARTHEST`.

    Returns
    -------
    times : ndarray
    columns : list of ndarray
    """
    keep = usable(times, columns[:required])
    if not keep.all():
        missing = np.count_nonzero(~keep)
        notes.append(f"{what}: {missing} of {keep.size} without a finite pose left out")
        times, columns = times[keep], [column[keep] for column in columns]
    backwards = np.count_nonzero(np.diff(times) < 0)
    if backwards:
        notes += _set_back(times, columns, what) if required else []
        notes.append(f"{what}: {backwards} steps back in time: sorted")
        order = np.argsort(times, kind="mergesort")
        times, columns = times[order], [column[order] for column in columns]
    first = np.append(True, np.diff(times) > 0)[: times.size]
    if not first.all():
        notes += _elsewhere(columns, first, what) if required else []
        notes.append(f"{what}: {np.count_nonzero(~first)} repeated time stamps left out")
        times, columns = times[first], [column[first] for column in columns]
    return times, list(columns)


def _elsewhere(columns, first, what):
    """Warning of poses that share a stamp but are far apart."""
    x, y = columns[:2]
    kept = np.flatnonzero(first)[np.cumsum(first) - 1]
    away = np.hypot(x - x[kept], y - y[kept])
    step = float(np.median(np.hypot(np.diff(x[first]), np.diff(y[first])))) if kept[-1] else 0.0
    far = away > _AWAY + 5.0 * step
    if not far.any():
        return []
    return [
        f"warning: {what}: {np.count_nonzero(far)} poses share the stamp of another up to "
        f"{np.max(away):.1f} m away, and are left out: was a clock set back, or are these two "
        "runs?"
    ]


def _set_back(times, columns, what):
    """Warnings of a clock that was set back while the car drove.

    Such poses form one path in the order of recording, and two alternating paths in the order of
    time. Poses that were merely reordered do not.
    """
    second = 1e9 if times.dtype.kind == "i" else 1.0
    back, warnings = np.flatnonzero(np.diff(times) < 0), []
    if back.size > _MOST_SET:
        return []
    for k in back:
        near = slice(max(k + 1 - _AROUND, 0), k + 1 + _AROUND)
        t, (x, y) = times[near], (column[near] for column in columns[:2])
        order = np.argsort(t, kind="mergesort")
        steps = np.hypot(np.diff(x), np.diff(y))
        way = float(np.sum(steps))
        sorted_way = float(np.sum(np.hypot(np.diff(x[order]), np.diff(y[order]))))
        usual = float(np.median(np.diff(t)))
        ago = float(times[k] - times[k + 1])
        pace = float(np.median(steps)) / usual if usual > 0.0 else 0.0
        if sorted_way - way > 0.3 * pace * ago and pace * second > _DRIVES:
            warnings.append(
                f"warning: {what}: time falls back by {(ago + usual) / second:.2f} s at "
                f"{float(times[k] - times[0]) / second:.1f} s, while the car drives on: that lap "
                "is too short by as much"
            )
    return warnings


def date_of(time_ns: int) -> str:
    """Date of a recording.

    Parameters
    ----------
    time_ns : int
        Time stamp of its first pose [ns], `Recording.t0_ns`.

    Returns
    -------
    str
        Such as ``"2026-05-14 16:20:00"`` (UTC), ``"simulated"`` for races of ``map-racing race``,
        empty where no clock was set.
    """
    if time_ns < _DATED:
        return ""
    if 0 <= time_ns - SIMULATED_NS < _BEGIN:
        return SIMULATED
    moment = datetime.fromtimestamp(time_ns // 10**9, timezone.utc)
    return moment.strftime("%Y-%m-%d %H:%M:%S")
