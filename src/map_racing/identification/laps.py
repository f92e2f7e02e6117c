"""Tires from ordinary driving: laps instead of ramps and circles.

The single-track model is driven by the recorded commands (`output_error`), and tires, delay and lag
of the steering are fitted to the measured motion, with the vehicle file as prior. Below the limit
friction and stiffness trade off. So only what is determined is reported: first the cornering
stiffness of each axle and the understeer gradient; the friction only if the drive came close enough
to the limit to bend the tire curves, whose shape is itself uncertain. Parameters that the data do
not determine stay as in the file. The demonstrated grip is a lower bound of the friction in any
case.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Mapping

import numpy as np

from ..errors import IdentificationError
from ..vehicle.parameters import Vehicle, holding, scaled_tires
from ..vehicle.single_track import GRAVITY
from ..vehicle.tires import PacejkaTire
from .channels import SensorSetup
from .data import Run
from .delay import Delays, estimate_delays
from .driving import (
    AT_LONGEST_S,
    FEWEST_WINDOWS,
    GRID_HZ,
    LONGEST_DELAY_S,
    Driving,
    driving_of,
    windows_of,
)
from .filters import low_passed
from .kinematic_checks import LOCK_MARGIN
from .one_floor import mixed_parts, mixed_runs
from .output_error import believed, fit_car
from .robust_fit import CONFIDENCE, Fitted
from .sensor_findings import SensorFinding
from .tire_fit import Parameter

__all__ = ["LapTires", "tires_from_laps"]

# Standard deviation of the yaw rate that a window needs [rad/s]; most windows used.
LEAST_TURNING_RADPS, MOST_WINDOWS = 0.15, 60
# The model must explain this share of the variance of the yaw rate.
LEAST_EXPLAINED = 0.8
# Standard deviations of the prior, of logarithms of factors (except `bend`).
PRIOR = {
    "front": 0.4,
    "rear": 0.6,
    "grip": 0.15,
    "shape": 0.15,
    "bend": 0.3,
    "inertia": 0.15,
    "gain": 0.02,
}
# If the gain is DOUBT prior standard deviations off, the fit is repeated with the prior ANY_GAIN.
DOUBT, ANY_GAIN = 2.0, 0.2
# A factor is determined if its standard deviation is at most this.
DETERMINED = {"front": 0.1, "rear": 0.15, "grip": 0.07, "shape": 0.075, "bend": 0.0}
# A drive that used less than this share of the friction never determines it, whatever the fit says:
# at small slip the tire curve bends so little that errors of its assumed shape dominate.
LEAST_USE = 0.5
# Deviations of steering gain and offset from 1 and 0 that are worth a finding.
LEAST_GAIN_ERROR, LEAST_OFFSET_RAD = 0.05, 0.01
# The shape of the curves stays the file's unless that changes the logarithm of the friction by more
# than SHAPE_MATTERS; then the friction counts only if its standard deviation is at most SURE.
SHAPE_MATTERS, SURE = 0.04, 0.05
# Demonstrated grip: percentile of the lateral acceleration, low-passed at this frequency [Hz].
SUSTAINED_HZ, SUSTAINED_PERCENT = 1.0, 99.0


@dataclass(frozen=True)
class LapTires:
    """Tires identified from ordinary driving, and the data behind them.

    Parameters
    ----------
    vehicle, base : Vehicle
        The identified car, and the car that served as prior.
    used : list of Run
        The runs used.
    notes : list of str
    windows : int
        Windows of 1 s that were used.
    parameters : dict of str to Parameter
        ``front_stiffness_n_per_rad`` and ``rear_stiffness_n_per_rad`` of the whole axle under its
        static load, ``understeer_gradient_rad_s2_per_m``, ``friction``, ``shape`` (factor on C),
        ``bend`` (added to E), and, for the steering, ``gain``, ``offset_rad`` and ``fit_delay_s``.
        The latter is the single delay with which the tires were fitted, and includes anything else
        that shifts the yaw rate; `delays` separates dead time and lag of the steering.
    largest_a_y : float
        Largest sustained lateral acceleration [m/s^2].
    explained : float
        Share of the variance of the yaw rate that the model explains.
    widest : float
        Largest wheel angle, with the identified gain and offset [rad]: 99th percentile.
    noise : dict of str to float
        Standard deviation of the residuals, by quantity [SI].
    fitted : Fitted
    runs_finding : SensorFinding or None
        Finding that the runs, or parts of one, differ in car or floor.
    """

    vehicle: Vehicle
    base: Vehicle
    used: list[Run]
    notes: list[str]
    windows: int
    parameters: dict[str, Parameter]
    largest_a_y: float
    explained: float
    widest: float
    noise: dict[str, float]
    fitted: Fitted
    runs_finding: SensorFinding | None = None

    @property
    def runs(self) -> list[str]:
        """Labels of the runs used."""
        return [run.label for run in self.used]

    @property
    def setup(self) -> SensorSetup:
        """Sensor setup of these runs."""
        return self.used[0].setup

    @cached_property
    def delays(self) -> Delays:
        """Delays of the same runs, with the identified tires."""
        return estimate_delays(self.used, self.vehicle)

    @property
    def least_friction(self) -> float | None:
        """Lower bound of the vehicle's `mu` [-], from the demonstrated grip.

        None for linear tires, which have no limit.
        """
        peak = min(self.vehicle.front.peak, self.vehicle.rear.peak)
        return self.largest_a_y / (GRAVITY * peak) if math.isfinite(peak) else None

    @property
    def steering_finding(self) -> SensorFinding | None:
        """Finding, with its repair, that the wheels clearly turn differently than commanded."""
        gain, offset = self.parameters["gain"], self.parameters["offset_rad"]
        off = [
            abs(value - right) > max(least, 0.75 * (high - low))
            for (value, low, high, _), right, least in (
                (gain, 1.0, LEAST_GAIN_ERROR),
                (offset, 0.0, LEAST_OFFSET_RAD),
            )
        ]
        if not any(off):
            return None
        text = (
            f"steering: in ordinary driving the wheels turn {gain.value:.3f} "
            f"({gain.low:.3f} to {gain.high:.3f}) times the commanded angle "
            f"{offset.value:+.4f} rad ({offset.low:+.4f} to {offset.high:+.4f}); the "
            "table is for the angle of the wheels"
        )
        if off[0]:
            text += f"; or {self.base.l_wb:.3f} m is not the car's wheelbase"
        if self.widest > LOCK_MARGIN * self.base.delta_max:
            return SensorFinding(
                "steering",
                f"{text}; but that is {self.widest:.3f} rad, beyond their lock of "
                f"{self.base.delta_max:.3f} rad (delta_max), so there must be another cause",
            )
        return SensorFinding(
            "steering",
            text,
            {
                "steering_gain": round(self.setup.steering_gain * gain.value, 4),
                "steering_offset_rad": round(
                    self.setup.steering_offset_rad * gain.value + offset.value, 4
                ),
            },
        )


def tires_from_laps(
    runs: list[Run],
    base: Vehicle,
    name: str | None = None,
    spreads: Mapping[str, float] | None = None,
) -> LapTires:
    """Identify the tires of a car from ordinary driving.

    Parameters
    ----------
    runs : list of Run
        Drives of one car, with the setup of its sensors.
    base : Vehicle
        Prior of the car.
    name : str, optional
        Name of the identified car; default: the base's with ``_identified`` appended.
    spreads : dict of str to float, optional
        Standard deviations of the prior instead of the usual ones: ``front``, ``rear``, ``grip``
        and ``shape``, of logarithms of factors.

    Returns
    -------
    LapTires
        Incomplete runs are left out, and noted.

    Raises
    ------
    IdentificationError
        If there is too little turning, if the commands do not explain it, or if the delay of the
        steering exceeds the range of the fit.
    """
    used, drives, notes = _drives_of(runs)
    labels = [run.label for run in used]
    if not drives:
        raise IdentificationError("; ".join(notes))
    cut = {"excited": "r", "least": LEAST_TURNING_RADPS, "most": MOST_WINDOWS}
    windows = windows_of(drives, **cut)
    if windows.count < FEWEST_WINDOWS:
        raise IdentificationError(
            f"{', '.join(labels)}: expected at least {FEWEST_WINDOWS} s in which the yaw rate "
            f"varies by {LEAST_TURNING_RADPS:g} rad/s at 1 m/s or more, got {windows.count} s: "
            "straight driving does not identify tires"
        )
    prior = {**PRIOR, **(spreads or {})}
    if not isinstance(base.front, PacejkaTire):
        prior.update(grip=0.0, shape=0.0, bend=0.0)  # linear tires have none of them
    demonstrated = _demonstrated(drives)
    free, fitted, unknown, prior = _fitted(base, windows, prior, demonstrated)
    explained = _explained(windows, fitted, labels)
    mixed = mixed_runs(base, drives, labels, prior, fitted, **cut) if len(drives) > 1 else None
    if mixed is None:
        odd = mixed_parts(base, windows, believed(**prior), free, used)
        mixed = SensorFinding("runs", f"runs: {odd}", critical=True) if odd else None
    commands = np.concatenate([drive.steering.value for drive in drives])
    angles = math.exp(fitted["gain"]) * commands + fitted["offset"]
    vehicle = holding(car_of(base, fitted), demonstrated)
    vehicle = replace(vehicle, name=name or base.name + "_identified")
    return LapTires(
        vehicle=vehicle,
        base=base,
        used=used,
        notes=notes,
        windows=windows.count,
        parameters=_parameters(vehicle, fitted, free, unknown),
        largest_a_y=demonstrated,
        explained=explained,
        widest=float(np.percentile(np.abs(angles), 99.0)),
        noise=fitted.noise,
        fitted=fitted,
        runs_finding=mixed,
    )


def _drives_of(runs):
    """Usable runs, their driving, and notes on all runs."""
    used, drives, notes = [], [], []
    for run in runs:
        try:
            drive = driving_of(run)
        except IdentificationError as error:
            notes.append(f"{run.label}: left out: {error}")
            continue
        used.append(run)
        drives.append(drive)
        notes += [f"{run.label}: {note}" for note in (*run.notes, *drive.notes)]
    return used, drives, notes


def car_of(base: Vehicle, fitted: Fitted) -> Vehicle:
    """The car with the tires of a fit."""
    names = ("front", "rear", "grip", "shape")
    front, rear, grip, wide = (math.exp(fitted[name]) for name in names)
    car = scaled_tires(base, grip, front / grip, rear / grip)
    if not isinstance(base.front, PacejkaTire):
        return car
    tires = {
        axle: replace(
            tire,
            B=tire.B / wide,
            C=tire.C * wide,
            E=min(tire.E + fitted["bend"], max(tire.E, 1.0)),
        )
        for axle, tire in (("front", car.front), ("rear", car.rear))
    }
    return replace(car, **tires)


def _fitted(base, windows, prior, demonstrated):
    """Fit with all parameters free, final fit, names of the undetermined parameters, and prior.

    In the final fit undetermined parameters are held at the prior.
    """
    # The grip is at least the demonstrated one.
    least = math.log(max(demonstrated / _limit(base), 1e-6))

    def beliefs(spreads):
        result = believed(**spreads)
        grip = result["grip"]
        result["grip"] = grip._replace(low=max(grip.low, least), center=max(grip.center, least))
        return result

    free = fit_car(base, windows, beliefs(prior))
    if abs(free["gain"]) > DOUBT * prior["gain"]:
        # The prior of the gain was wrong: let the data determine it.
        prior = {**prior, "gain": ANY_GAIN}
        free = fit_car(base, windows, beliefs(prior), near=free)
    unknown = {
        name
        for name, enough in DETERMINED.items()
        if prior[name] == 0.0 or free.deviation({name: 1.0}) > enough
    }
    if demonstrated < LEAST_USE * _limit(car_of(base, free)):
        unknown |= {"grip", "shape", "bend"}
    held = {**prior, **dict.fromkeys(unknown, 0.0)}
    if held == prior:
        return free, free, unknown, prior
    fitted = fit_car(base, windows, beliefs(held), near=free)
    if "grip" not in unknown and abs(fitted["grip"] - free["grip"]) > SHAPE_MATTERS:
        # The file's shape changes the friction, so the shape is wrong.
        if free.deviation({"grip": 1.0}) <= SURE:
            return free, free, unknown - {"shape", "bend"}, prior
        unknown = unknown | {"grip"}
        held["grip"] = 0.0
        fitted = fit_car(base, windows, beliefs(held), near=free)
    return free, fitted, unknown, prior


def _limit(vehicle: Vehicle) -> float:
    """Lateral acceleration at which the first axle saturates [m/s^2]."""
    return vehicle.mu * GRAVITY * min(vehicle.front.peak, vehicle.rear.peak)


def _explained(windows, fitted, labels):
    """Share of the variance of the yaw rate that a fit explains; refuses one of other commands."""
    explained = 1.0 - (fitted.noise["r"] / float(np.std(windows.observed["r"][-1]))) ** 2
    if explained < LEAST_EXPLAINED:
        raise IdentificationError(
            f"{', '.join(labels)}: the steering commands explain {max(explained, 0.0):.0%} of the "
            f"yaw rate, expected {LEAST_EXPLAINED:.0%}: not the commands of this drive, or not the "
            "size of this car"
        )
    if fitted["delay"] > AT_LONGEST_S:
        raise IdentificationError(
            f"{', '.join(labels)}: the wheels turn at least {fitted['delay']:.2f} s after their "
            f"commands, expected less than {LONGEST_DELAY_S:g} s: are commands and measurements on "
            "one clock (--steering-delay corrects a known delay)?"
        )
    return explained


def _parameters(vehicle, fitted, free, unknown):
    """Values of the final fit, with the intervals of the fit with all parameters free."""
    parameters = {}

    def put(name, value, deviation, known):
        half = CONFIDENCE * deviation
        parameters[name] = Parameter(float(value), float(value - half), float(value + half), known)

    def put_factor(name, value, deviation, known):
        low, high = (value * math.exp(sign * CONFIDENCE * deviation) for sign in (-1.0, 1.0))
        parameters[name] = Parameter(float(value), float(low), float(high), known)

    stiffness = {}
    for axle, arm in (("front", vehicle.l_r), ("rear", vehicle.l_f)):
        load = vehicle.m * GRAVITY * arm / vehicle.l_wb
        stiffness[axle] = vehicle.mu * load * getattr(vehicle, axle).stiffness
        spread = free.deviation({axle: 1.0})
        put_factor(f"{axle}_stiffness_n_per_rad", stiffness[axle], spread, axle not in unknown)
    per_front = vehicle.m / vehicle.l_wb * vehicle.l_r / stiffness["front"]
    per_rear = vehicle.m / vehicle.l_wb * vehicle.l_f / stiffness["rear"]
    put(
        "understeer_gradient_rad_s2_per_m",
        per_front - per_rear,
        free.deviation({"front": -per_front, "rear": per_rear}),
        not {"front", "rear"} & unknown,
    )
    # Linear tires have no limit, so the friction keeps the spread of the prior.
    spread = free.deviation({"grip": 1.0}) or PRIOR["grip"]
    put_factor("friction", vehicle.mu, spread, "grip" not in unknown)
    put_factor(
        *("shape", math.exp(fitted["shape"]), free.deviation({"shape": 1.0})),
        "shape" not in unknown,
    )
    put("bend", fitted["bend"], free.deviation({"bend": 1.0}), "bend" not in unknown)
    put("fit_delay_s", fitted["delay"], free.deviation({"delay": 1.0}), True)
    put_factor("gain", math.exp(fitted["gain"]), free.deviation({"gain": 1.0}), True)
    put("offset_rad", fitted["offset"], free.deviation({"offset": 1.0}), True)
    return parameters


def _demonstrated(drives: list[Driving]) -> float:
    """Largest sustained lateral acceleration, from speed and yaw rate [m/s^2]."""
    held = [
        np.abs(low_passed(drive.v_x * drive.r, GRID_HZ, SUSTAINED_HZ)[drive.usable])
        for drive in drives
    ]
    return float(np.percentile(np.concatenate(held), SUSTAINED_PERCENT))
