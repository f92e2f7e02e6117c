"""Identifies tires from steady cornering.

All signals of a run are brought to one clock (`cornering`), and the sensors are checked against
physics and corrected on demand (`sensor_checks`). Steady cornering gives points of axle force over
slip angle, and the curve through them is the tire (`tire_fit`).
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Iterable, NamedTuple

import numpy as np

from ..errors import IdentificationError, ParameterError
from ..vehicle.parameters import Vehicle, holding
from ..vehicle.single_track import GRAVITY
from ..vehicle.steady_state import steady_state_table
from ..vehicle.tires import PacejkaTire
from .axles import AxlePoints, axle_points
from .channels import SensorSetup
from .cornering import ProcessedRun, motion_of
from .data import Run
from .limits import RATE_HZ, SteadyLimits
from .sensor_findings import SensorFinding
from .survey import Survey, survey
from .tire_fit import (
    LinearFit,
    PacejkaFit,
    Parameter,
    beside_rear,
    fit_linear,
    fit_pacejka,
    left_by,
)

__all__ = [
    "Axle",
    "Identification",
    "Prediction",
    "identify",
    "largest_a_y",
    "leave_one_out",
    "points_of",
    "predict",
    "steady_acceleration",
    "steady_tires",
]

POINT_RATE_HZ = 10.0
WINDOW_S = 1.5
# Smaller lateral accelerations are too small to identify tires or judge relative errors [m/s^2].
SMALLEST_MPS2 = 1.0
AT_LIMIT = 0.9
# Runs differ in car or floor if the residual of the common curve exceeds MIXED times that of a
# curve fitted to one run alone, and MIXED_SHARE of the load.
MIXED, MIXED_SHARE = 2.0, 0.01


class Prediction(NamedTuple):
    """A segment of steady cornering, measured and predicted by a car's steady state.

    Parameters
    ----------
    run : str
    t : float
        Middle of the segment [s].
    v, delta : float
        Mean speed [m/s] and steering angle [rad].
    a_y, r : float
        Measured lateral acceleration [m/s^2] and yaw rate [rad/s].
    a_y_predicted, r_predicted : float
        Predicted from speed and steering angle; NaN without a steady state.
    at_limit : bool
        Whether the measured acceleration exceeds 90 % of the largest.
    """

    run: str
    t: float
    v: float
    delta: float
    a_y: float
    r: float
    a_y_predicted: float
    r_predicted: float
    at_limit: bool


class Axle(NamedTuple):
    """Measured points of an axle and both tires fitted to them."""

    points: AxlePoints
    pacejka: PacejkaFit
    linear: LinearFit


@dataclass(frozen=True)
class Identification:
    """Tires identified from steady cornering, and the data behind them.

    Parameters
    ----------
    vehicle, linear_vehicle : Vehicle
        The car with Pacejka tires and with linear tires fitted to the same points, ``mu = 1``.
    base : Vehicle
        The given car: mass, geometry, and parameters that the data do not determine.
    axles : dict of str to Axle
        Keys are ``front`` and ``rear``.
    motions : list of ProcessedRun
        The runs used.
    refused : list of (str, str)
        Unusable runs, with the reason.
    checked, corrections : list of SensorFinding
        Results of the sensor checks after corrections, and the corrections made.
    setup : SensorSetup
        As used, after corrections.
    limits : SteadyLimits
    front_force, acceleration : str
        As given to `identify`.
    """

    vehicle: Vehicle
    linear_vehicle: Vehicle
    base: Vehicle
    axles: dict[str, Axle]
    motions: list[ProcessedRun]
    refused: list[tuple[str, str]]
    checked: list[SensorFinding]
    corrections: list[SensorFinding]
    setup: SensorSetup
    limits: SteadyLimits
    front_force: str
    acceleration: str

    @cached_property
    def findings(self) -> list[SensorFinding]:
        """Findings of the sensor checks, and whether the runs differ in car or floor."""
        # Computed lazily: a curve for each run takes longer than the common one.
        mixture = _mixture(self.motions, self.axles, self.base, self.limits, self.front_force)
        return [*self.checked, *mixture]

    @property
    def largest_a_y(self) -> float:
        """Largest sustained lateral acceleration [m/s^2]: 98th percentile of the points."""
        return largest_a_y(self.motions)

    @property
    def friction(self) -> float:
        """Friction coefficient needed for this acceleration [-], a lower bound of the floor's."""
        return self.largest_a_y / GRAVITY

    @property
    def understeer_gradient(self) -> Parameter:
        """``m / l_wb (l_r / C_f - l_f / C_r)`` [rad s^2/m], with the stiffness at zero slip."""
        car, shares, unsure = self.vehicle, [], []
        for name, arm in (("front", car.l_r), ("rear", car.l_f)):
            value, _, high, _ = self.axles[name].pacejka.parameters["stiffness_n_per_rad"]
            shares.append(car.m / car.l_wb * arm / value)
            unsure.append(shares[-1] * (high / value - 1.0))
        value, half = shares[0] - shares[1], math.hypot(*unsure)
        known = all(
            axle.pacejka.parameters["stiffness_n_per_rad"].determined
            for axle in self.axles.values()
        )
        return Parameter(value, value - half, value + half, known)

    def predictions(self) -> list[Prediction]:
        """Predictions of the fitted data by the identified car."""
        return predict(self.vehicle, self.motions, self.largest_a_y)


def identify(
    runs: Iterable[Run],
    base_vehicle: Vehicle,
    *,
    fix: bool = False,
    limits: SteadyLimits | None = None,
    front_force: str = "model",
    acceleration: str = "imu",
    name: str | None = None,
) -> Identification:
    """Identify the tires of a car from one or more runs.

    Parameters
    ----------
    runs : iterable of Run
        Runs of one car with one sensor setup; the setup of the first is used for all.
    base_vehicle : Vehicle
        Mass, geometry, and tire parameters to keep if the data do not determine them.
    fix : bool
        Correct the sensor setup where it contradicts physics; by default a critical contradiction
        is an error.
    limits : SteadyLimits, optional
        Limits of steady driving.
    front_force : {"model", "paper"}
        See `map_racing.identification.axles.axle_points`.
    acceleration : {"imu", "yaw_rate"}
        Source of the lateral acceleration, see `map_racing.identification.cornering.motion_of`.
    name : str, optional
        Name of the identified car; default: the base's with ``_identified`` appended.

    Returns
    -------
    Identification

    Raises
    ------
    IdentificationError
        If no run has steady cornering, or sensors contradict each other (the message names the
        repair), or no tire curve fits the points.
    """
    limits = limits or SteadyLimits()
    surveyed = survey(runs, base_vehicle, fix, limits, acceleration)
    return steady_tires(surveyed, base_vehicle, limits, front_force, acceleration, name)


def steady_tires(
    surveyed: Survey,
    base_vehicle: Vehicle,
    limits: SteadyLimits,
    front_force: str = "model",
    acceleration: str = "imu",
    name: str | None = None,
) -> Identification:
    """Identify the tires from the steady cornering of a survey; see `identify`."""
    used = surveyed.steady
    _require_evidence(used, surveyed)
    axles = _fit_axles(used, base_vehicle, limits, front_force)
    name = name or base_vehicle.name + "_identified"
    tires = {key: axle.pacejka.tire for key, axle in axles.items()}
    linear = {key: axle.linear.tire for key, axle in axles.items()}
    base = holding(base_vehicle, largest_a_y(used))
    return Identification(
        vehicle=dataclasses.replace(base, name=name, mu=1.0, **tires),
        linear_vehicle=dataclasses.replace(base, name=name + "_linear", mu=1.0, **linear),
        base=base_vehicle,
        axles=axles,
        motions=used,
        refused=surveyed.refused,
        checked=surveyed.findings,
        corrections=surveyed.corrections,
        setup=surveyed.setup,
        limits=limits,
        front_force=front_force,
        acceleration=acceleration,
    )


def _require_evidence(used, surveyed):
    """Raise an error if no run can identify tires."""
    if not used:
        reasons = "; ".join(f"{label}: {reason}" for label, reason in surveyed.refused)
        raise IdentificationError(f"no usable run: {reasons}")
    if largest_a_y(used) < SMALLEST_MPS2:
        raise IdentificationError(
            f"straight driving: expected at least {SMALLEST_MPS2:g} m/s^2 of lateral acceleration "
            f"to identify tires from, got {largest_a_y(used):.2f} m/s^2 in {len(used)} runs"
        )


def _fit_axles(motions, vehicle, limits, front_force):
    """Both axles by name."""
    oversampling = _oversampling(limits)

    def fitted(name, points):
        start = getattr(vehicle, name)
        if isinstance(start, PacejkaTire):  # the fit has mu = 1
            start = dataclasses.replace(start, D=start.D * vehicle.mu)
        try:
            fit = fit_pacejka(points, start, _threshold(vehicle), oversampling)
        except IdentificationError as error:
            raise IdentificationError(f"{name} axle: {error}") from None
        return Axle(points, fit, fit_linear(points, fit.inlier, oversampling))

    front, rear = points_of(motions, vehicle, front_force)
    rear = fitted("rear", rear)
    if len(motions) > 1:
        # Localization errors shift the slip of both axles equally, so within one run they hardly
        # affect the table, which depends on the difference. Between runs these errors differ.
        front = beside_rear(front, rear.points, rear.pacejka.tire)
    return {"front": fitted("front", front), "rear": rear}


def _mixture(motions, axles, vehicle, limits, front_force):
    """Finding that the runs differ in car or floor, if some run's own curve fits it much better.

    A friction that differs by a tenth is enough.
    """
    odd = []
    for motion in motions if len(motions) > 1 else ():
        for (name, axle), points in zip(axles.items(), points_of([motion], vehicle, front_force)):
            tire = axle.pacejka.tire
            try:
                own = fit_pacejka(points, tire, _threshold(vehicle), _oversampling(limits)).tire
            except IdentificationError:  # too few points for one
                continue
            common, alone = (left_by(each, points) for each in (tire, own))
            if common > max(MIXED * alone, MIXED_SHARE * points.load):
                odd.append(f"{motion.run.label}, {name}: {common:.2f} N, its own {alone:.2f} N")
    if not odd:
        return []
    text = "runs: not of one car on one floor: residuals of the common curve: " + "; ".join(odd)
    return [SensorFinding("runs", text, critical=True)]


def _oversampling(limits):
    """Points per independent measurement."""
    return max(POINT_RATE_HZ / (2.0 * limits.cutoff_hz), 1.0)


def _threshold(vehicle):
    """Threshold of rejection [N]: the paper's 10 N for 3.5 kg, scaled by mass."""
    return 10.0 * vehicle.m / 3.5


def leave_one_out(runs: Iterable[Run], base_vehicle: Vehicle, **options: Any) -> list[Prediction]:
    """Predict each run with the tires, and sensor corrections, identified from the others.

    Parameters
    ----------
    runs, base_vehicle, options
        As for `identify`; at least two runs must be usable.

    Returns
    -------
    list of Prediction

    Raises
    ------
    IdentificationError
        If only one run is usable, or the others identify nothing.
    """
    runs = list(runs)
    everything = identify(runs, base_vehicle, **options)
    usable = {motion.run.name for motion in everything.motions}
    runs = [run for run in runs if run.name in usable]
    if len(runs) < 2:
        raise IdentificationError("--leave-one-out: expected at least two usable runs, got 1")
    predictions = []
    for left_out in runs:
        others = identify([run for run in runs if run is not left_out], base_vehicle, **options)
        run = dataclasses.replace(left_out, setup=others.setup)
        motion = motion_of(run, base_vehicle, options.get("limits"), others.acceleration)
        predictions += predict(others.vehicle, [motion], everything.largest_a_y)
    return predictions


def predict(vehicle: Vehicle, motions: Iterable[ProcessedRun], largest: float) -> list[Prediction]:
    """Predict segments of steady cornering of about 1.5 s and at least 1 m/s^2.

    Parameters
    ----------
    vehicle : Vehicle
    motions : iterable of ProcessedRun
    largest : float
        Largest lateral acceleration of the data [m/s^2]: the limit.

    Returns
    -------
    list of Prediction
    """
    predictions = []
    for motion in motions:
        for cut in motion.segments():
            count = max(round((cut.stop - cut.start) / (WINDOW_S * RATE_HZ)), 1)
            for piece in np.array_split(np.arange(cut.start, cut.stop), count):
                v, delta, a_y, r, t = (
                    float(np.mean(column[piece]))
                    for column in (motion.v_x, motion.delta, motion.a_y, motion.r, motion.t)
                )
                if abs(a_y) < SMALLEST_MPS2:
                    continue
                predicted = float(np.copysign(steady_acceleration(vehicle, v, abs(delta)), delta))
                at_limit = abs(a_y) > AT_LIMIT * largest
                label, r_predicted = motion.run.label, predicted / v
                predictions.append(
                    Prediction(label, t, v, delta, a_y, r, predicted, r_predicted, at_limit)
                )
    return predictions


def steady_acceleration(vehicle: Vehicle, v: float, delta: float) -> float:
    """Lateral acceleration of the steady state [m/s^2].

    Without a stable steady state at that angle, the largest at smaller angles; NaN if none exists.

    Parameters
    ----------
    vehicle : Vehicle
    v : float
        Speed [m/s].
    delta : float
        Steering angle [rad], not negative.
    """
    try:
        table = steady_state_table(vehicle, [v], delta * np.arange(1, 33) / 32.0)
    except ParameterError:
        return math.nan
    column = table.a_lat[:, 0]
    return float(column[-1]) if np.isfinite(column[-1]) else float(np.nanmax(column))


def points_of(
    motions: list[ProcessedRun], vehicle: Vehicle, front_force: str = "model"
) -> tuple[AxlePoints, AxlePoints]:
    """Points of the front and the rear axle from the steady cornering of runs, at 10 Hz."""
    columns = [[] for _ in range(5)]
    for motion in motions:
        v_y = motion.v_y(vehicle.l_r)
        for cut in motion.segments():
            pick = slice(cut.start, cut.stop, round(RATE_HZ / POINT_RATE_HZ))
            for column, values in zip(
                columns, (motion.v_x, v_y, motion.r, motion.delta, motion.a_y)
            ):
                column.append(values[pick])
    front, rear = axle_points(vehicle, *map(np.concatenate, columns), front_force=front_force)
    beta, a_y, turning = (
        float(np.median([getattr(motion, f"{name}_noise") for motion in motions]))
        for name in ("beta", "a_y", "turning")
    )
    return tuple(
        axle._replace(
            slip_noise=beta,
            force_noise=axle.load / GRAVITY * a_y,
            difference_noise=vehicle.l_wb * turning,
        )
        for axle in (front, rear)
    )


def largest_a_y(motions: Iterable[ProcessedRun]) -> float:
    """Largest sustained lateral acceleration [m/s^2]: 98th percentile of its magnitude."""
    held = [np.abs(motion.a_y[cut]) for motion in motions for cut in motion.segments()]
    return float(np.percentile(np.concatenate(held), 98.0)) if held else 0.0
