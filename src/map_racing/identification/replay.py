"""Validation by replay: a car driven open loop by the commands of a recording.

The recording is cut into windows. In each the car starts from the measured state; after a short
time in which the initial state decays, only the steering and speed commands drive it. Its motion is
then compared with the measured one. Nothing is fed back, so errors grow with the length of the
window, which is reported.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from ..errors import IdentificationError, ParameterError
from ..vehicle.parameters import Vehicle
from .cornering import motion_of
from .data import Run
from .drive import BELIEVED as DRIVE_BELIEVED
from .drive import drive_windows, driven_speed, fit_drive
from .driving import (
    FEWEST_WINDOWS,
    GRID_HZ,
    SMOOTH_HZ,
    Driving,
    driving_of,
    windows_of,
    without_outliers,
)
from .filters import low_passed
from .limits import REPLAY_WINDOW_S
from .output_error import NAMES, at_sensors, believed, fit_car, simulate
from .usable_runs import reason_to_refuse

__all__ = [
    "Actuators",
    "ChannelError",
    "Replay",
    "RunReplay",
    "actuators_of",
    "replay",
    "replay_data",
    "replay_lines",
]

STEP_S, BURN_IN_S, SHORTEST_S, LONGEST_S = 0.005, 0.3, 0.2, 60.0
ALL = 100000  # more windows than any recording has
# Prior of the sum of a servo's dead time and lag, and its standard deviation [s].
USUAL_DELAY_S, DELAY_SPREAD_S = 0.05, 0.03
MOST_WINDOWS = 40
# Lowest speed of the model [m/s]; it does not hold at standstill.
SLOWEST_MPS = 0.3
HEADING_HZ = 3.0
LEAST_BEYOND = 0.02  # share of the driving that is worth a note

# Errors are given as shares of the measured RMS, but at least of this value, because on a straight
# the measured RMS is close to 0.
LEAST_MEASURED = {"yaw rate": 0.3, "lateral acceleration": 1.0, "speed": 1.0}

UNITS = {
    "yaw rate": "rad/s",
    "lateral acceleration": "m/s^2",
    "speed": "m/s",
    "lateral drift": "m",
}
TIRES = ("front", "rear", "grip", "shape", "gain", "offset", "inertia", "height")


class Actuators(NamedTuple):
    """Parameters of the actuators between commands and motion.

    Parameters
    ----------
    delay, share : float
        Sum of dead time and lag of the steering [s], and the lag's share of it.
    drive : ndarray or None
        Parameters of `map_racing.identification.drive.driven_speed`; None if unknown.
    fitted : bool, optional
        Whether the steering parameters are fitted; otherwise they are the usual ones.
    """

    delay: float
    share: float
    drive: np.ndarray | None
    fitted: bool = True


class ChannelError(NamedTuple):
    """Error of a channel over the windows of a run.

    Parameters
    ----------
    rms : float
        RMS error over all windows, sensor noise included; for the drift, over the ends of the
        windows [SI].
    worst : float
        Largest RMS error of a window [SI].
    worst_t : float
        Start of that window [s].
    noise : float
        Approximate sensor noise left in the measurement; 0 for the drift [SI].
    share : float
        `rms` as a share of the measured RMS, see `LEAST_MEASURED`; for the drift, of the distance
        driven.
    """

    rms: float
    worst: float
    worst_t: float
    noise: float
    share: float


@dataclass(frozen=True)
class RunReplay:
    """Replay of one run: its label, number of windows, and errors by channel, see `UNITS`."""

    label: str
    windows: int
    channels: dict[str, ChannelError]
    notes: list[str]


@dataclass(frozen=True)
class Replay:
    """Replays of recordings.

    Parameters
    ----------
    length : float
        Length of each window [s].
    runs : list of RunReplay
    refused : list of (str, str)
        Labels of runs that could not be replayed, and why.
    """

    length: float
    runs: list[RunReplay]
    refused: list[tuple[str, str]]

    @property
    def worst(self) -> tuple[RunReplay, str]:
        """The run and the channel with the largest share of error."""
        return max(
            ((run, name) for run in self.runs for name in run.channels),
            key=lambda entry: entry[0].channels[entry[1]].share,
        )

    @property
    def headline(self) -> str:
        """The worst channel of the worst run, in words."""
        run, name = self.worst
        error = run.channels[name]
        of = " of the distance driven" if name == "lateral drift" else ""
        return (
            f"worst channel of {len(self.runs)} run{'s' if len(self.runs) != 1 else ''}: {name} of "
            f"{run.label}, {error.share:.1%}{of} (RMS {error.rms:.3f} {UNITS[name]}) in windows of "
            f"{self.length:g} s"
        )


def actuators_of(runs: list[Run], vehicle: Vehicle) -> Actuators:
    """Delay and lag of steering and drive, fitted to runs with the car held.

    Parameters
    ----------
    runs : list of Run
    vehicle : Vehicle
    """
    drives = []
    for run in runs:
        try:
            drives.append(driving_of(run))
        except IdentificationError:
            continue
    delay, share, lane, fitted = USUAL_DELAY_S, 0.5, None, False
    if drives:
        windows = windows_of(drives, step=STEP_S, channels=("r",), most=MOST_WINDOWS, least=0.15)
        if windows.count >= FEWEST_WINDOWS:
            beliefs = believed(**dict.fromkeys(TIRES, 0.0))
            beliefs["delay"] = beliefs["delay"]._replace(
                center=USUAL_DELAY_S, spread=DELAY_SPREAD_S
            )
            found = fit_car(vehicle, windows, beliefs)
            delay, share, fitted = found["delay"], found["share"], True
    commanded = [drive for drive in drives if drive.speed_command is not None]
    if commanded:
        windows = drive_windows(commanded)
        if windows.count >= FEWEST_WINDOWS:
            lane = fit_drive(windows).values
        else:
            lane = np.array([belief.center for belief in DRIVE_BELIEVED.values()])
    return Actuators(delay, share, lane, fitted)


def replay(
    vehicle: Vehicle,
    runs: list[Run],
    actuators: Actuators,
    length: float = REPLAY_WINDOW_S,
    reached: float | None = None,
) -> Replay:
    """Drive a car open loop by the commands of recordings.

    Parameters
    ----------
    vehicle : Vehicle
    runs : list of Run
        Their setup is applied.
    actuators : Actuators
    length : float, optional
        Length of the windows [s].
    reached : float, optional
        Lateral acceleration up to which the tires were identified [m/s^2]; driving beyond it is
        noted, because there the tires are extrapolated.

    Raises
    ------
    IdentificationError
        If no run can be replayed.
    ParameterError
        If the length is not between 0.2 and 60 s.
    """
    if not SHORTEST_S <= length <= LONGEST_S:
        raise ParameterError(
            f"--window: expected {SHORTEST_S:g} to {LONGEST_S:g} s, got {length:g}"
        )
    found, refused = [], []
    for run in runs:
        try:
            found.append(_replayed(vehicle, run, actuators, length, reached))
        except IdentificationError as error:
            refused.append((run.label, str(error)))
    if not found:
        reasons = "; ".join(f"{label}: {reason}" for label, reason in refused)
        raise IdentificationError(f"no run to replay: {reasons}")
    return Replay(length, found, refused)


def _replayed(vehicle, run, actuators, length, reached):
    """Replay of one run."""
    notes, motion, path = [], None, None
    try:
        motion = motion_of(run, vehicle, acceleration="yaw_rate")
    except IdentificationError as error:
        notes.append(f"no drift: {error}")
    else:
        reason = reason_to_refuse(motion)
        if reason:
            raise IdentificationError(reason)
    drive = _commanded(driving_of(run), notes)
    windows = windows_of(
        [drive], length=length, burn_in=BURN_IN_S, step=STEP_S, channels=(), most=ALL
    )
    if not windows.count:
        raise IdentificationError(
            "; ".join([*notes, f"expected {length + BURN_IN_S:g} s of commanded driving at a time"])
        )
    if motion is not None:
        path = _path(run, drive.t, motion.clock_offset_s)
    if reached is not None:
        beyond = float(np.mean(np.abs(drive.v_x * drive.r)[drive.usable] > reached))
        if beyond > LEAST_BEYOND:
            notes.append(
                f"{beyond:.0%} of the driving is beyond the {reached:.2f} m/s^2 at which the tires "
                "were identified: extrapolated"
            )
    driven = drive.speed_command is not None and actuators.drive is not None
    if not driven:
        notes.append("speed as measured: no speed commands, or the drive was not identified")
    else:
        lane = actuators.drive[None]
        v_x = driven_speed(windows, lane, windows.burn_in)[:, 0, :]
        v_x = np.maximum(v_x, SLOWEST_MPS)
        windows = replace(windows, v_x=v_x, a_long=np.gradient(v_x, windows.step, axis=0))
    theta = np.zeros((1, len(NAMES)))
    theta[0, NAMES.index("delay")] = actuators.delay
    theta[0, NAMES.index("share")] = actuators.share
    simulated = at_sensors(vehicle, windows, simulate(vehicle, windows, theta))
    simulated = {name: value[:, 0, :] for name, value in simulated.items()}
    return RunReplay(
        run.label,
        windows.count,
        _errors(drive, windows, simulated, path, driven),
        notes,
    )


def _commanded(drive, notes):
    """The drive without stops, because a car commanded 0 m/s may either brake or roll out."""
    if drive.speed_command is None:
        return drive
    at = np.searchsorted(drive.speed_command.t, drive.t, side="right") - 1
    stopping = drive.usable & (drive.speed_command.value[np.maximum(at, 0)] <= 0.0)
    if stopping.any():
        seconds = np.count_nonzero(stopping) / GRID_HZ
        notes.append(f"{seconds:.1f} s with a speed command of 0 left out: braking or rolling?")
    return replace(drive, usable=drive.usable & ~stopping)


def _errors(drive: Driving, windows, simulated, path, with_speed):
    """Errors of all channels, at the times of the smoothed signals."""
    each = round(1.0 / GRID_HZ / windows.step)
    skip = windows.burn_in // each
    count = windows.steps // each + 1
    rows = np.searchsorted(drive.t, windows.begin - 1e-9)[None, :] + np.arange(count)[:, None]
    channels = {}

    def put(name, wrong, measured, noise):
        error, value = wrong[skip:], measured[skip:]
        each_window = np.sqrt(np.mean(error**2, axis=0))
        at = int(np.argmax(each_window))
        rms = float(np.sqrt(np.mean(error**2)))
        share = rms / max(float(np.sqrt(np.mean(value**2))), LEAST_MEASURED[name])
        channels[name] = ChannelError(rms, float(each_window[at]), _when(windows, at), noise, share)

    r = simulated["r"][::each]
    put("yaw rate", r - drive.r[rows], drive.r[rows], _noise(drive, "r", drive.r))
    if "a_y" in drive.measured:
        smooth = _smooth(drive, "a_y")
        a_y, noise = smooth[rows], _noise(drive, "a_y", smooth)
        put("lateral acceleration", simulated["a_y"][::each] - a_y, a_y, noise)
    v = windows.v_x[::each]
    if with_speed:
        put("speed", v - drive.v_x[rows], drive.v_x[rows], _noise(drive, "v_x", drive.v_x))
    if path is not None:
        v_y = simulated["v_y"][::each]
        drift = _drift(path[:, rows[skip:]], v[skip:], v_y[skip:], r[skip:])
        driven = np.mean(np.sum(drive.v_x[rows[skip:]], axis=0)) / GRID_HZ
        at = int(np.argmax(np.abs(drift)))
        rms = float(np.sqrt(np.mean(drift**2)))
        channels["lateral drift"] = ChannelError(
            rms, float(np.abs(drift[at])), _when(windows, at), 0.0, rms / driven
        )
    return channels


def _when(windows, at):
    return float(windows.begin[at] + windows.burn_in * windows.step)


def _smooth(drive, name):
    """A measured quantity at the even times, smoothed without delay."""
    values = np.interp(drive.t, *without_outliers(*drive.measured[name]))
    return low_passed(values, GRID_HZ, SMOOTH_HZ)


def _noise(drive, name, smooth):
    """Standard deviation of the noise left by the low-pass, estimated from what it removed."""
    t, value = without_outliers(*drive.measured[name])
    passes = min(2.0 * SMOOTH_HZ * float(np.median(np.diff(t))), 0.8)
    taken = float(np.std(value - np.interp(t, drive.t, smooth)))
    return taken * (passes / (1.0 - passes)) ** 0.5


def _path(run, t, clock_offset):
    """Position and heading of the car from the poses at times, shape (3, n)."""
    setup = run.setup

    def at(name, cutoff):
        own, value = run.signals[name]
        if name == "psi":
            value = np.unwrap(value) + setup.heading_offset_rad
        values = np.interp(t, setup.time_scale * own + clock_offset, value)
        return low_passed(values, GRID_HZ, cutoff)

    return np.stack([at("x", SMOOTH_HZ), at("y", SMOOTH_HZ), at("psi", HEADING_HZ)])


def _drift(path, v, v_y, r):
    """Lateral position error at the end of each window, left positive [m], shape (n,)."""
    x, y, psi = path
    step = 1.0 / GRID_HZ

    def integral(rate):
        return step * np.vstack(
            [np.zeros(rate.shape[1]), np.cumsum(0.5 * (rate[1:] + rate[:-1]), axis=0)]
        )

    heading = psi[0] + integral(r)
    cos, sin = np.cos(heading), np.sin(heading)
    dx = integral(v * cos - v_y * sin)[-1] - (x[-1] - x[0])
    dy = integral(v * sin + v_y * cos)[-1] - (y[-1] - y[0])
    return dy * np.cos(psi[-1]) - dx * np.sin(psi[-1])


def replay_lines(found: Replay) -> list[str]:
    """The replays as lines of text, the headline first."""
    lines = [f"replay by the commands alone, {found.headline}"]
    for run in found.runs:
        lines.append(f"  {run.label}, {run.windows} windows of {found.length:g} s:")
        for name, error in run.channels.items():
            unit = UNITS[name]
            of = " of the distance" if name == "lateral drift" else ""
            lines.append(
                f"    {name}: {error.share:.1%}{of}, RMS {error.rms:.3f} {unit}"
                + (f" ({error.noise:.3f} of it noise)" if error.noise else "")
                + f"; worst window {error.worst:.3f} {unit} at t = {error.worst_t:.1f} s"
            )
        lines += [f"    {note}" for note in run.notes]
    return lines + [f"  {label}: not replayed: {reason}" for label, reason in found.refused]


def replay_data(found: Replay) -> dict[str, Any]:
    """The replays as plain data."""
    run, name = found.worst
    return {
        "window_s": found.length,
        "worst_run": run.label,
        "worst_channel": name,
        "worst_share": run.channels[name].share,
        "headline": found.headline,
        "runs": [
            {
                "run": run.label,
                "windows": run.windows,
                "notes": list(run.notes),
                "channels": {
                    name.replace(" ", "_"): {**error._asdict(), "unit": UNITS[name]}
                    for name, error in run.channels.items()
                },
            }
            for run in found.runs
        ],
        "runs_refused": [{"run": label, "reason": reason} for label, reason in found.refused],
    }
