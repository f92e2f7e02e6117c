"""Results of an evaluation: laps with their values, and statistics over them."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, fields, replace
from typing import NamedTuple, Sequence

import numpy as np

from ..bags.messages import BELIEF_FIELDS
from ..track.raceline import Raceline

__all__ = ["Lap", "LapTrace", "RunResult", "Summary"]


class LapTrace(NamedTuple):
    """Samples of a lap, for plots; the first and last are the interpolated crossings.

    Each has the shape (n,): time ``t`` [s] on the recording's clock, position ``x, y`` [m],
    distance ``s`` along the track [m] from the start line (in an out-lap from its first sample),
    deviation ``d`` [m] positive to the left, speed ``v`` [m/s], speed ``command`` in force [m/s] or
    NaN.
    """

    t: np.ndarray
    x: np.ndarray
    y: np.ndarray
    s: np.ndarray
    d: np.ndarray
    v: np.ndarray
    command: np.ndarray


# Columns of a lap, and the fields of a belief that they contain.
_BELIEVED = {
    **{f"believed_{name}": name for name in ("grip", "friction", "friction_low", "friction_high")},
    **{f"believed_{name}": name for name in ("front_stiffness", "rear_stiffness")},
    "believed_delay_s": "delay",
}


@dataclass(frozen=True)
class Lap:
    """A lap, or a stretch that is not a complete lap. Unknown values are NaN.

    Attributes
    ----------
    lap : int
        Number: 0 is the out-lap.
    lap_time_s : float
        NaN if the lap was not completed.
    rms_lateral_error_m, mean_abs_lateral_error_m, max_abs_lateral_error_m : float
        Of the lateral deviation from the raceline.
    valid : bool
        Whether it counts.
    reason : str
        Why it does not count; empty if it does.
    mean_lateral_error_m : float
        Signed, left positive.
    p95_abs_lateral_error_m : float
        Exceeded 5 % of the time.
    min_clearance_m : float
        Smallest distance from a side of the car to a wall, negative beyond it.
    mean_speed_mps, max_speed_mps : float
        Of the measured speed or, where none was measured, of the motion of the pose.
    rms_speed_error_mps : float
        RMS of the speed minus `speed_reference`.
    speed_reference : str
        ``"command"`` or, without commands, ``"raceline"``; empty without either.
    mean_steering_rate_radps : float
        Mean absolute rate of the commanded steering angle. Unlike the RMS it does not depend on
        how long a command is held.
    start_time_s, end_time_s : float
        On the recording's clock.
    believed_grip, believed_friction, believed_friction_low, believed_friction_high, \
    believed_front_stiffness, believed_rear_stiffness, believed_delay_s : float
        Estimates of an adaptive controller at the end of the lap: relative to the vehicle file's
        tires, the lateral limit used for speeds, friction with the ends of its interval, and
        cornering stiffness of both axles; and the delay.
    sector_times_s : tuple of float
        Sectors have equal lengths, from the start line on.
    trace : LapTrace, optional
    """

    lap: int
    lap_time_s: float
    rms_lateral_error_m: float = math.nan
    mean_abs_lateral_error_m: float = math.nan
    max_abs_lateral_error_m: float = math.nan
    valid: bool = False
    reason: str = ""
    mean_lateral_error_m: float = math.nan
    p95_abs_lateral_error_m: float = math.nan
    min_clearance_m: float = math.nan
    mean_speed_mps: float = math.nan
    max_speed_mps: float = math.nan
    rms_speed_error_mps: float = math.nan
    speed_reference: str = ""
    mean_steering_rate_radps: float = math.nan
    start_time_s: float = math.nan
    end_time_s: float = math.nan
    believed_grip: float = math.nan
    believed_friction: float = math.nan
    believed_friction_low: float = math.nan
    believed_friction_high: float = math.nan
    believed_front_stiffness: float = math.nan
    believed_rear_stiffness: float = math.nan
    believed_delay_s: float = math.nan
    sector_times_s: tuple = ()
    trace: LapTrace | None = None

    def believed(self, times: Sequence[float], values: Sequence[Sequence[float]]) -> Lap:
        """The lap with the estimates at its end.

        Parameters
        ----------
        times : sequence of float
            Times of the estimates, ascending [s].
        values : sequence of sequences of 13 floats
            `map_racing.bags.messages.BELIEF_FIELDS`.
        """
        last = bisect_right(times, self.end_time_s) - 1
        if last < 0:
            return self
        belief = dict(zip(BELIEF_FIELDS, map(float, values[last])))
        return replace(self, **{name: belief[field] for name, field in _BELIEVED.items()})

    def row(self) -> dict:
        """Row of a table: values by name, the sectors as ``sector_1_s`` and so on."""
        row = {field.name: getattr(self, field.name) for field in fields(self)[:-2]}
        row.update((f"sector_{i}_s", time) for i, time in enumerate(self.sector_times_s, 1))
        return row


@dataclass(frozen=True)
class Summary:
    """Statistics over the valid laps of a run, NaN without any (N.C., not completed).

    Standard deviations are sample standard deviations (n - 1), NaN for a single lap.
    """

    laps_completed: int
    laps_not_counted: int
    mean_lap_time_s: float
    std_lap_time_s: float
    best_lap_time_s: float
    mean_rms_lateral_error_m: float
    std_rms_lateral_error_m: float
    mean_abs_lateral_error_m: float
    max_abs_lateral_error_m: float
    min_clearance_m: float
    mean_speed_mps: float
    max_speed_mps: float

    @classmethod
    def of(cls, laps: list[Lap]) -> Summary:
        """Summary of a list of `Lap`."""
        valid = [lap for lap in laps if lap.valid]

        def over(name, function):
            values = np.array([getattr(lap, name) for lap in valid])
            return float(function(values)) if values.size else math.nan

        def deviation(values):
            return np.std(values, ddof=1) if values.size > 1 else math.nan

        return cls(
            len(valid),
            len(laps) - len(valid),
            over("lap_time_s", np.mean),
            over("lap_time_s", deviation),
            over("lap_time_s", np.min),
            over("rms_lateral_error_m", np.mean),
            over("rms_lateral_error_m", deviation),
            over("mean_abs_lateral_error_m", np.mean),
            over("max_abs_lateral_error_m", np.max),
            over("min_clearance_m", np.min),
            over("mean_speed_mps", np.mean),
            over("max_speed_mps", np.max),
        )


@dataclass(frozen=True)
class RunResult:
    """Laps of a run on a raceline.

    Attributes
    ----------
    laps : list of Lap
        All stretches in order, valid or not.
    summary : Summary
    raceline : Raceline
    start_s : float
        Arc length of the start line [m].
    source : str
        File of the recording.
    notes : tuple of str
        Notes on reading and evaluation; warnings begin with ``warning:``.
    commands_followed : bool
        Whether the car's speed follows the one commanded, as `evaluate` finds it.
    """

    laps: list[Lap]
    summary: Summary
    raceline: Raceline
    start_s: float = 0.0
    source: str = ""
    notes: tuple = ()
    commands_followed: bool = True

    def places_of(self, lap: Lap) -> np.ndarray:
        """Arc lengths along the raceline of the samples of a lap.

        Parameters
        ----------
        lap : Lap
            With a trace of n samples.

        Returns
        -------
        ndarray, shape (n,)
            [m], not taken modulo the length.
        """
        begin = self.start_s
        if lap.reason.startswith("out-lap"):
            begin = self.raceline.project(lap.trace.x[0], lap.trace.y[0]).s
        return begin + lap.trace.s

    @property
    def none_counts(self) -> str:
        """Why no lap counts; empty if one does."""
        if self.summary.laps_completed:
            return ""
        driven = [lap.reason for lap in self.laps if not math.isnan(lap.lap_time_s)]
        if not driven:
            return "no lap was completed"
        return f"no lap counts ({'; '.join(dict.fromkeys(driven))})"

    @property
    def warnings(self) -> list[str]:
        """Notes that are warnings."""
        mark = "warning: "
        return [note[len(mark) :] for note in self.notes if note.startswith(mark)]
