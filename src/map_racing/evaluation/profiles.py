"""Laps over distance: every signal of every lap at the same places along the track.

Times are the same as from `evaluate`: a profile resamples the samples of a `Lap`, and re-evaluates
nothing. Places are distances from the start line.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy import ndimage

from ..bags.samples import Recording
from ..control.parameters import ControllerParameters
from ..control.steering import build_steering_map
from ..track.raceline import Raceline
from ..track.speed_profile import raceline_speeds
from ..vehicle.lookup import LookupTable
from ..vehicle.parameters import Vehicle
from .laps import passage_times
from .results import Lap, RunResult
from .turning import speed_driven, turning_of

__all__ = [
    "CHANNELS",
    "CarLimits",
    "LapProfile",
    "RunProfile",
    "TrackProfile",
    "car_limits",
    "profiles_of",
]

# Distance between places [m], and their number on short and long tracks.
_STEP, _FEWEST, _MOST = 0.1, 100, 1000
# Accelerations are low-passed: standard deviation of the Gaussian [s].
_SMOOTHING = 0.03
# An incomplete lap that covers less than this share of the track is not drawn.
_WORTH = 0.2
# A command this close to the largest useful angle counts as saturated.
_AT_LIMIT = 0.99

CHANNELS = {
    "time": ("time since the start line", "s"),
    "v": ("speed", "m/s"),
    "v_command": ("commanded speed", "m/s"),
    "d": ("lateral deviation, left positive", "m"),
    "steering": ("commanded steering angle, left positive", "rad"),
    "steering_table": ("steering angle of the table for the turning measured", "rad"),
    "a_lat": ("lateral acceleration, left positive", "m/s^2"),
    "a_lon": ("longitudinal acceleration", "m/s^2"),
}
"""Channels of a lap, with meaning and unit."""


@dataclass(frozen=True)
class CarLimits:
    """Limits of the car that was driven.

    Attributes
    ----------
    vehicle : Vehicle
    table : LookupTable
        Lookup table of its own tires.
    delta_max : float
        Largest steering angle [rad].
    a_drive_max, a_brake_max : float
        Longitudinal limits [m/s^2], positive.
    v_max : float
        Largest speed [m/s].
    """

    vehicle: Vehicle
    table: LookupTable
    delta_max: float
    a_drive_max: float
    a_brake_max: float
    v_max: float

    def lateral(self, v: np.ndarray) -> np.ndarray:
        """Largest lateral acceleration of the tires.

        At low speeds, where the steering lock allows less, the value of the next higher speed
        counts.

        Parameters
        ----------
        v : ndarray, shape (n,)
            Speeds [m/s].

        Returns
        -------
        ndarray, shape (n,)
            [m/s^2]
        """
        return np.interp(v, *self._lateral)

    @cached_property
    def _lateral(self):
        speeds = np.linspace(0.25, max(self.v_max, 1.0), 200)
        limit = self.table.max_lateral_acceleration(speeds)
        return speeds, np.maximum.accumulate(limit[::-1])[::-1]


def car_limits(vehicle: Vehicle, parameters: ControllerParameters | None = None) -> CarLimits:
    """Limits of a car: longitudinally its controller's planning limits, otherwise the vehicle's."""
    drive, brake, v_max = vehicle.a_max, vehicle.a_brake_max, vehicle.v_max
    if parameters is not None:
        drive, brake = parameters.a_drive_max_mps2, parameters.a_brake_max_mps2
        v_max = min(v_max, parameters.v_max_mps)
    table = build_steering_map("table", vehicle, v_max)
    return CarLimits(vehicle, table, vehicle.delta_max, drive, brake, v_max)


@dataclass(frozen=True)
class TrackProfile:
    """A raceline at the places of the profiles.

    Attributes
    ----------
    s : ndarray, shape (n,)
        Distance from the start line [m]; the last place is the start line again.
    x, y, psi, kappa : ndarray, shape (n,)
        Position [m], heading [rad] and curvature [1/m] of the raceline.
    speed, grip_speed : ndarray, shape (n,), or None
        Speed of the raceline, and the highest within the car's limits [m/s].
    d_left, d_right : ndarray, shape (n,), or None
        Distances to the walls [m].
    start_s : float
        Arc length of the start line [m].
    """

    s: np.ndarray
    x: np.ndarray
    y: np.ndarray
    psi: np.ndarray
    kappa: np.ndarray
    speed: np.ndarray | None
    grip_speed: np.ndarray | None
    d_left: np.ndarray | None
    d_right: np.ndarray | None
    start_s: float

    @property
    def length(self) -> float:
        """Length of the track [m]."""
        return float(self.s[-1])


@dataclass(frozen=True)
class LapProfile:
    """A lap at the places of its track.

    Attributes
    ----------
    lap : Lap
    values : dict of str to ndarray, shape (n,)
        By the names of `CHANNELS`; NaN where the lap does not reach, or a signal is unknown.
    saturated : float
        Share of the lap time with a command at or beyond the largest useful steering angle; NaN if
        unknown.
    grip_used : ndarray, shape (n,)
        Lateral acceleration as a share of `CarLimits.lateral`; NaN without a table.
    """

    lap: Lap
    values: dict
    saturated: float
    grip_used: np.ndarray


@dataclass(frozen=True)
class RunProfile:
    """All laps of a run over distance.

    Attributes
    ----------
    result : RunResult
    track : TrackProfile
    laps : list of LapProfile
        Completed laps; if there are none, the longer stretches.
    notes : list of str
        Warnings about the signals.
    """

    result: RunResult
    track: TrackProfile
    laps: list
    notes: list = field(default_factory=list)

    @property
    def counted(self) -> list[LapProfile]:
        """The laps that count; comparisons use only these."""
        return [profile for profile in self.laps if profile.lap.valid]

    @property
    def best(self) -> LapProfile | None:
        """The fastest of them."""
        return min(self.counted, key=lambda profile: profile.lap.lap_time_s, default=None)

    def mean(self, channel: str) -> np.ndarray:
        """Mean of a channel over the laps that count.

        Parameters
        ----------
        channel : str

        Returns
        -------
        ndarray, shape (n,)
            In the unit of the channel, at the places of the profiles.
        """
        return np.mean([profile.values[channel] for profile in self.counted], axis=0)


def profiles_of(
    recording: Recording, result: RunResult, limits: CarLimits | None = None
) -> RunProfile:
    """Profiles of the laps of a run.

    Parameters
    ----------
    recording : Recording
    result : RunResult
        Result of `evaluate`, with traces.
    limits : CarLimits, optional

    Returns
    -------
    RunProfile
    """
    track = track_profile(result.raceline, result.start_s, limits)
    signals, notes = _signals(recording)
    laps = []
    complete = [lap for lap in result.laps if not math.isnan(lap.lap_time_s)]
    for lap in complete or result.laps:
        s = np.maximum.accumulate(lap.trace.s)
        if not complete:
            s = np.maximum.accumulate(result.places_of(lap) - result.start_s)
            if s[-1] - s[0] < _WORTH * track.length:
                continue
        laps.append(_lap_profile(lap, s, track, signals, recording, limits))
    return RunProfile(result, track, laps, notes)


def track_profile(
    raceline: Raceline, start_s: float, limits: CarLimits | None = None
) -> TrackProfile:
    """A raceline at equal steps from the start line."""
    cells = int(np.clip(math.ceil(raceline.length / _STEP), _FEWEST, _MOST))
    s = raceline.length * np.arange(cells + 1) / cells
    at = raceline.sample(s + start_s)
    grip_speed = None
    if limits is not None:
        fastest, _ = raceline_speeds(
            raceline,
            a_lat_max=limits.table.max_lateral_acceleration,
            a_drive_max=limits.a_drive_max,
            a_brake_max=limits.a_brake_max,
            v_max=limits.v_max,
            v_min=1.0,
        )
        grip_speed = np.interp(at.s, np.append(raceline.s, raceline.length), _closed(fastest))
    return TrackProfile(
        s, at.x, at.y, at.psi, at.kappa, at.speed, grip_speed, at.d_left, at.d_right, start_s
    )


def _closed(values):
    return np.append(values, values[0])


def _signals(recording):
    """Accelerations over the time of the recording, and notes about them."""
    t = recording.t
    rate, notes = turning_of(recording)
    v, _ = speed_driven(recording)
    width = _SMOOTHING / max(float(np.median(np.diff(t))), 1e-4)

    def smooth(values):
        return ndimage.gaussian_filter1d(values, width) if width > 0.3 else values

    with np.errstate(invalid="ignore"):
        return {"a_lat": smooth(v * rate), "a_lon": np.gradient(smooth(v), t)}, notes


def _lap_profile(lap, s, track, signals, recording, limits):
    trace = lap.trace
    rising = np.append(True, np.diff(s) > 0.0)
    s = s[rising]

    def at_places(values):
        return np.interp(track.s, s, values[rising], left=np.nan, right=np.nan)

    if math.isnan(lap.lap_time_s):
        time = at_places(trace.t)
    else:
        s[0], s[-1] = 0.0, track.s[-1]  # rounding may leave the ends outside by 1e-15 m
        time = passage_times(trace.t, trace.s, track.s)
    values = {"time": time - trace.t[0], "v": at_places(trace.v), "d": at_places(trace.d)}
    speed = steering = np.full(trace.t.size, np.nan)
    if recording.commands is not None:
        speed = recording.commands.held(trace.t, recording.commands.speed)
        steering = recording.commands.held(trace.t, recording.commands.steering_angle)
    values["v_command"], values["steering"] = at_places(speed), at_places(steering)
    for name, signal in signals.items():
        values[name] = at_places(np.interp(trace.t, recording.t, signal))
    saturated, grip = np.nan, np.full(track.s.size, np.nan)
    values["steering_table"] = grip
    if limits is not None:
        limit = limits.lateral(values["v"])
        grip = np.abs(values["a_lat"]) / np.maximum(limit, 1e-6)
        values["steering_table"] = _angles(limits, values["v"], values["a_lat"])
        useful = _angles(limits, values["v"], 2.0 * limit)
        known = np.isfinite(values["steering"]) & np.isfinite(values["time"])
        if known.sum() > 1:
            at_limit = np.abs(values["steering"]) >= _AT_LIMIT * useful
            spent = np.gradient(values["time"])[known]
            saturated = float(np.sum(spent * at_limit[known]) / np.sum(spent))
    return LapProfile(lap, values, saturated, grip)


def _angles(limits, v, a_lat):
    """Steering angles of the table [rad], within the lock."""
    steering, lock = limits.table.steering, limits.delta_max
    return np.array(
        [
            math.nan if speed != speed or a != a else min(max(steering(speed, a)[0], -lock), lock)
            for speed, a in zip(v.tolist(), a_lat.tolist())
        ]
    )
