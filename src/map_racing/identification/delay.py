"""Delays of a car: age of the pose, dead time and lag of the steering and of the drive.

The yaw rate lags behind the wheels even without any delay, and that lag depends on the tires. So
the delays are fitted together with the tires in a model of the car (`output_error`). A delay shows
only while the commands change: windows without turning, or without a change of speed, do not count.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Iterable, NamedTuple

import numpy as np

from ..errors import IdentificationError, ParameterError
from ..vehicle.parameters import Vehicle
from .data import Run, is_age
from .drive import drive_windows, fit_drive
from .driving import AT_LONGEST_S, FEWEST_WINDOWS, LONGEST_DELAY_S, driving_of, windows_of
from .missing_commands import missing_commands
from .one_floor import mixed_parts
from .output_error import believed, fit_car
from .robust_fit import CONFIDENCE
from .stepping_servo import SAMPLE_S, behind_stepping_servo, on_raster

__all__ = ["Delays", "Part", "delay_data", "delay_text", "estimate_delays"]

ESTIMATED, NOT_DETERMINED = "estimated", "not determined"
# Standard deviation of the yaw rate that a window needs to show a delay of the steering [rad/s];
# most windows used.
LEAST_TURNING_RADPS, MOST_WINDOWS = 0.3, 30
# Largest half-width of a useful interval [s].
WIDEST_STEERING_S, WIDEST_DRIVE_S = 0.015, 0.04
# The model must explain this share of the variance.
LEAST_SHARE = 0.8
# A servo is a stepping one if its best number of samples leaves smaller residuals than a servo with
# a lag, and less than this share of the residuals with one sample more or less.
STEPPING = 0.9
# Number of samples tried below the delay of the fit with a lag.
STEPS_AROUND = 3
OWN = believed(inertia=0.15)
ANY = believed(front=1.0, rear=1.0, grip=0.3, gain=0.15, inertia=0.3, height=0.03)
STEP_S = 0.005
# No delay is known better than half a step of the model [s], because servos have steps, too.
COARSE_S = 0.5 * STEP_S


class Part(NamedTuple):
    """A delay with its 95 % interval.

    Parameters
    ----------
    value, low, high : float or None
        [s]; None if not determined.
    reason : str
        Why it is not determined, or how it was determined.
    """

    value: float | None = None
    low: float | None = None
    high: float | None = None
    reason: str = ""

    @property
    def status(self) -> str:
        """``estimated`` or ``not determined``."""
        return NOT_DETERMINED if self.value is None else ESTIMATED


@dataclass(frozen=True)
class Delays:
    """Delays of a car, and the controller parameters that follow from them.

    Parameters
    ----------
    delay : Part
        The controller's ``delay_s``, from the time of a pose until its command turns the wheels:
        age of the pose plus dead time and lag of the steering.
    speed_lookahead : Part
        The controller's ``speed_lookahead_s``: by how much the drive is slower than the steering.
    pose_age, steering_dead_time, steering_lag, steering : Part
        `steering` is the sum of dead time and lag, which is known better than either.
    drive_dead_time, drive_lag : Part
    notes : list of str
    """

    delay: Part
    speed_lookahead: Part
    pose_age: Part
    steering: Part
    steering_dead_time: Part
    steering_lag: Part
    drive_dead_time: Part
    drive_lag: Part
    notes: list[str] = field(default_factory=list)


def estimate_delays(
    runs: list[Run], vehicle: Vehicle | None = None, others: Iterable[Vehicle] = ()
) -> Delays:
    """Estimate the delays of a car from one or more drives.

    Parameters
    ----------
    runs : list of Run
    vehicle : Vehicle, optional
        The car's own file, from which the fit starts.
    others : iterable of Vehicle
        Without such a file: cars of about this size to start from. Their tires, inertia and
        steering gain, which also compensates the wheelbase, are free. The best fit is used.

    Returns
    -------
    Delays

    Raises
    ------
    ParameterError
        If there is no car to start from.
    """
    models = [(vehicle, OWN)] if vehicle else [(other, ANY) for other in others]
    if not models:
        raise ParameterError("delays: expected the car's vehicle, or others of about its size")
    used, drives, notes = [], [], []
    for run in runs:
        notes += [f"{run.label}: {note}" for note in run.notes]
        try:
            drive = driving_of(run)
        except IdentificationError as error:
            notes.append(f"{run.label}: left out: {error}")
            continue
        used.append(run)
        drives.append(drive)
        notes += [f"{run.label}: {note}" for note in drive.notes]
    age, shifted = _pose_age(runs)
    total, dead, lag = _steering(used, drives, models)
    drive_dead, drive_lag = _drive(drives)
    delay = total
    if total.value is None:
        age_note = ""
    elif shifted:
        age_note = "the clocks differ, so the age of the pose is in the steering's"
        age = Part(reason=age_note)
    elif age.value is None:
        age_note = f"without the age of the pose: {age.reason}"
    else:
        age_note = ""
        delay = Part(*(one + age.value for one in total[:3]), total.reason)
    if age_note:
        reason = "; ".join(filter(None, (total.reason, age_note)))
        delay = delay._replace(reason=reason)
    return Delays(
        delay,
        _speed_lookahead(total, drive_dead, drive_lag),
        age,
        total,
        dead,
        lag,
        drive_dead,
        drive_lag,
        notes,
    )


def _pose_age(runs):
    """Age of the poses on arrival, and whether commands were shifted to the pose clock."""
    shifted, recorded = any(run.commands_shifted for run in runs), ""
    stamped = []
    for run in runs:
        lag = run.pose_lag
        if lag is None:
            continue
        if not is_age(lag[1]) and run.command_lag is not None and not run.commands_shifted:
            # The recorder has another clock. Commands are stamped when they are sent.
            lag = tuple(value - run.command_lag for value in lag)
            recorded = "relative to the commands', because the recorder has another clock"
        stamped.append(lag)
    if not stamped:
        return Part(reason="the recording does not say when poses were received"), shifted
    low, middle, high = (float(np.median(values)) for values in zip(*stamped))
    if not is_age(middle):
        reason = f"the timestamps of the poses are from another clock ({middle:+.3f} s)"
        return Part(reason=reason), shifted
    if low == high == 0.0:
        return Part(reason="poses are stamped when they are received"), shifted
    return Part(middle, low, high, recorded), shifted


def _steering(runs, drives, models):
    """Sum of dead time and lag of the steering, and each."""
    if not drives:
        return (Part(reason="no drive with commands and yaw rate"),) * 3
    windows = _windows(drives)
    if windows.count < FEWEST_WINDOWS:
        return (
            Part(
                reason=f"the yaw rate varies by {LEAST_TURNING_RADPS:g} rad/s in {windows.count} s "
                f"of the {FEWEST_WINDOWS} s needed: straight or steady driving shows no delay"
            ),
        ) * 3
    found, vehicle, beliefs = min(
        ((fit_car(car, windows, beliefs), car, beliefs) for car, beliefs in models),
        key=lambda entry: entry[0].noise["r"],
    )
    value, share = found["delay"], found["share"]
    unsure = float(np.hypot(CONFIDENCE * found.deviation({"delay": 1.0}), COARSE_S))
    explained = 1.0 - (found.noise["r"] / _spread(windows.observed["r"])) ** 2
    if explained < LEAST_SHARE:
        reason = f"the commands explain {max(explained, 0.0):.0%} of how the yaw rate varies"
        return (Part(reason=reason),) * 3
    odd = mixed_parts(vehicle, windows, beliefs, found, runs)
    if odd:
        return (Part(reason=f"{value:.3f} s, but {odd}"),) * 3
    short = missing_commands(drives, lambda some: fit_car(vehicle, _windows(some), beliefs), found)
    samples = _stepping(drives, vehicle, beliefs, found)
    if samples is not None:
        text = f"the servo moves in steps of {SAMPLE_S:g} s, with a dead time of {samples} steps"
        dead = _part(samples * SAMPLE_S, 0.5 * SAMPLE_S)
        return _too_short(dead, short), dead._replace(reason=text), Part(0.0, 0.0, 0.0)
    if value > AT_LONGEST_S:
        reason = (
            f"the wheels turn at least {value:.2f} s after their commands, expected less than "
            f"{LONGEST_DELAY_S:g} s: are commands and measurements on one clock?"
        )
        return (Part(reason=reason),) * 3
    if unsure > WIDEST_STEERING_S:
        reason = f"{value:.3f} +- {unsure:.3f} s: too little turning"
        return (Part(reason=reason),) * 3
    dead = CONFIDENCE * found.deviation({"delay": 1.0 - share, "share": -value})
    lag = CONFIDENCE * found.deviation({"delay": share, "share": value})
    total = _too_short(_part(value, unsure), short)
    return total, _part(value * (1.0 - share), dead), _part(value * share, lag)


def _too_short(part, short):
    """The part if commands are missing that could make it longer by `short` [s]."""
    if not short:
        return part
    reason = f"commands are missing in the recording: up to {short:.3f} s too short"
    return part._replace(high=part.high + short, reason=reason)


def _windows(drives):
    """Windows with turning; a measured lateral velocity helps to identify the tires."""
    measured = all("v_y" in drive.measured for drive in drives)
    return windows_of(
        drives,
        step=STEP_S,
        channels=("r", "v_y") if measured else ("r",),
        excited="r",
        least=LEAST_TURNING_RADPS,
        most=MOST_WINDOWS,
    )


def _stepping(drives, vehicle, beliefs, found):
    """Dead time of a stepping servo in samples; None if the servo does not step."""
    if not all(on_raster(drive.measured["r"].t) for drive in drives):
        return None
    free = replace(vehicle, delta_rate_max=1e6)
    held = {
        name: belief._replace(center=0.0, spread=0.0) if name in ("delay", "share") else belief
        for name, belief in beliefs.items()
    }

    def noise_behind(samples):
        if samples < 0:
            return np.inf
        stepped = [
            behind_stepping_servo(drive, vehicle.delta_rate_max, vehicle.delta_max, samples)
            for drive in drives
        ]
        return fit_car(free, _windows(stepped), held).noise["r"]

    about = round(found["delay"] / SAMPLE_S)
    around = range(about - STEPS_AROUND, about + 2)
    noise = {samples: noise_behind(samples) for samples in around}
    while True:
        best = min(noise, key=noise.get)
        beside = [samples for samples in (best - 1, best + 1) if samples not in noise]
        if not beside or noise[best] > found.noise["r"]:
            break
        noise[beside[0]] = noise_behind(beside[0])
    others = min(noise[samples] for samples in (best - 1, best + 1) if samples in noise)
    clear = noise[best] < min(STEPPING * others, found.noise["r"])
    return best if clear else None


def _drive(drives):
    """Dead time and lag of the drive."""
    drives = [drive for drive in drives if drive.speed_command is not None]
    if not drives:
        return (Part(reason="no speed commands"),) * 2
    windows = drive_windows(drives)
    if windows.count < FEWEST_WINDOWS:
        return (Part(reason="the speed hardly changes"),) * 2
    found = fit_drive(windows)
    explained = 1.0 - (found.noise["v_x"] / _spread(windows.observed["v_x"])) ** 2
    parts = []
    for name in ("delay", "lag"):
        unsure = CONFIDENCE * found.deviation({name: 1.0})
        if explained < LEAST_SHARE or unsure > WIDEST_DRIVE_S:
            parts.append(
                Part(
                    reason=f"{found[name]:.3f} +- {unsure:.3f} s; a model with lag and "
                    f"limits explains {max(explained, 0.0):.0%} of the changes of speed"
                )
            )
        else:
            parts.append(_part(found[name], unsure))
    return tuple(parts)


def _speed_lookahead(steering, drive_dead, drive_lag):
    """Delay of the drive beyond the steering's, over which the state is already predicted."""
    for part, name in ((steering, "steering"), (drive_dead, "drive"), (drive_lag, "drive")):
        if part.value is None:
            return Part(reason=f"{name}: {part.reason}")
    low, middle, high = (
        max(drive_dead[i] + drive_lag[i] - steering[j], 0.0) for i, j in ((1, 2), (0, 0), (2, 1))
    )
    return Part(middle, low, high)


def _spread(observed):
    """Standard deviation of measurements around the mean of their window."""
    window, value = observed[0], observed[-1]
    count = np.maximum(np.bincount(window), 1)
    mean = np.bincount(window, value) / count
    return float(np.sqrt(np.mean((value - mean[window]) ** 2)))


def _part(value, unsure):
    return Part(float(value), max(float(value - unsure), 0.0), float(value + unsure))


PARTS = (
    *("pose_age", "steering", "steering_dead_time", "steering_lag"),
    *("drive_dead_time", "drive_lag", "speed_lookahead"),
)


def delay_data(delays: Delays) -> dict[str, Any]:
    """The delays as plain data, the controller's ``delay_s`` first."""

    def entries(part, name):
        return {
            name: part.value,
            f"{name[:-2]}_interval_s": None if part.value is None else [part.low, part.high],
            "status": part.status,
            "reason": part.reason,
        }

    result = entries(delays.delay, "delay_s")
    for name in PARTS:
        part = getattr(delays, name)
        result[name] = {
            "value_s": part.value,
            "interval_s": None if part.value is None else [part.low, part.high],
            "status": part.status,
            "reason": part.reason,
        }
    result["speed_lookahead_s"] = delays.speed_lookahead.value
    result["notes"] = list(delays.notes)
    return result


def delay_text(delays: Delays) -> str:
    """The notes and the delays as lines of text."""
    rows = [
        ("age of the pose", delays.pose_age),
        ("steering, dead time and lag", delays.steering),
        ("  dead time", delays.steering_dead_time),
        ("  lag", delays.steering_lag),
        ("drive, dead time", delays.drive_dead_time),
        ("drive, lag", delays.drive_lag),
        ("delay_s", delays.delay),
        ("speed_lookahead_s", delays.speed_lookahead),
    ]
    lines = []
    for name, part in rows:
        if part.value is None:
            lines.append(f"{name}: not determined: {part.reason}")
        else:
            note = f"; {part.reason}" if part.reason else ""
            lines.append(
                f"{name}: {part.value:.3f} s (95 %: {part.low:.3f} to {part.high:.3f} s){note}"
            )
    return "\n".join([*delays.notes, *lines])
