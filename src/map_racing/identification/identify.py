"""From recorded driving to a car with identified tires.

Runs are brought to one clock (`cornering`), their sensors checked against physics and, if asked,
corrected (`sensor_checks`); what is steady cornering gives points of axle force over slip angle,
and a curve through them is the tire (`map_racing.identification.tire_fit`).
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..errors import IdentificationError, ParameterError
from ..vehicle.parameters import Vehicle
from ..vehicle.single_track import GRAVITY
from ..vehicle.steady_state import steady_state_table
from ..vehicle.tires import PacejkaTire
from .cornering import motion_of
from .data import SensorSetup
from .limits import RATE_HZ, SteadyLimits
from .sensor_checks import check, correct, reason_to_refuse
from .tire_fit import AxlePoints, LinearFit, PacejkaFit, axle_points, fit_linear, fit_pacejka

__all__ = [
    "Hold",
    "Identification",
    "identify",
    "largest_a_y",
    "leave_one_out",
    "points_of",
    "predict",
    "steady_acceleration",
]

POINT_RATE_HZ = 10.0
WINDOW_S = 1.5
# Relative errors of smaller lateral accelerations say nothing [m/s^2].
SMALLEST_MPS2 = 1.0
AT_LIMIT = 0.9
LEAST_MPS2 = 1.0


class Hold(NamedTuple):
    """A piece of steady cornering, measured and predicted by the steady state of a car.

    Parameters
    ----------
    run : str
    t : float
        Its middle [s].
    v, delta : float
        Mean speed [m/s] and steering angle [rad].
    a_y, r : float
        Measured lateral acceleration [m/s^2] and yaw rate [rad/s].
    a_y_predicted, r_predicted : float
        Those of the steady state at that speed and angle; NaN where it has none.
    at_limit : bool
        Whether the measured acceleration is beyond 90 % of the largest.
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


@dataclass(frozen=True)
class Identification:
    """What driving data say about the tires of a car.

    Parameters
    ----------
    vehicle : Vehicle
        The car with the identified Pacejka tires, ``mu = 1``.
    linear_vehicle : Vehicle
        The car with linear tires by regression on the same points.
    base : Vehicle
        The car that was given: mass, geometry, and what the data do not determine.
    front, rear : PacejkaFit
    front_linear, rear_linear : LinearFit
    front_points, rear_points : AxlePoints
    motions : list of Motion
        The runs used.
    refused : list of (str, str)
        Runs of which nothing could be used, and why.
    findings : list of Finding
        What the checks of the sensors say, after corrections.
    corrections : list of Finding
        What was corrected.
    setup : SensorSetup
        The setup that was used.
    front_force, acceleration : str
        As given to `identify`.
    """

    vehicle: Vehicle
    linear_vehicle: Vehicle
    base: Vehicle
    front: PacejkaFit
    rear: PacejkaFit
    front_linear: LinearFit
    rear_linear: LinearFit
    front_points: AxlePoints
    rear_points: AxlePoints
    motions: list
    refused: list
    findings: list
    corrections: list
    setup: SensorSetup
    front_force: str
    acceleration: str

    @property
    def largest_a_y(self):
        """Largest lateral acceleration that was held [m/s^2]: 98th percentile of the points."""
        return largest_a_y(self.motions)

    @property
    def friction(self):
        """Friction coefficient that this acceleration takes [-]."""
        return self.largest_a_y / GRAVITY

    @property
    def understeer_gradient(self):
        """Steering angle beyond Ackermann's per lateral acceleration [rad s^2/m], of both slopes.

        ``m / l_wb (l_r / C_f - l_f / C_r)`` with the stiffness of the curves at zero slip.
        """
        car = self.vehicle
        front = self.front.parameters["stiffness_n_per_rad"].value
        rear = self.rear.parameters["stiffness_n_per_rad"].value
        return car.m / car.l_wb * (car.l_r / front - car.l_f / rear)

    def holds(self):
        """The data that were fitted to, and what the identified car makes of them."""
        return predict(self.vehicle, self.motions, self.largest_a_y)


def identify(
    runs,
    base_vehicle,
    *,
    fix=False,
    limits=None,
    front_force="model",
    acceleration="imu",
    name=None,
):
    """Identify the tires of a car from one or more runs.

    Parameters
    ----------
    runs : iterable of Run
        See `map_racing.identification.data.load_run`. They must be of one car, and are taken
        to have one setup of sensors: that of the first.
    base_vehicle : Vehicle
        Mass and geometry; its tires are where parameters stay that the data do not determine.
    fix : bool
        Correct the sensors' setup where it contradicts physics. Without it, what would spoil the
        tires is an error.
    limits : SteadyLimits, optional
        What counts as steady.
    front_force : {"model", "paper"}
        See `map_racing.identification.tire_fit.axle_points`.
    acceleration : {"imu", "yaw_rate"}
        Where the lateral acceleration comes from, see
        `map_racing.identification.cornering.motion_of`.
    name : str, optional
        Of the identified car; by default that of the base with ``_identified`` appended.

    Returns
    -------
    Identification

    Raises
    ------
    IdentificationError
        If no run has steady cornering in it, or sensors contradict each other (the message says
        what would repair it), or the points fit no tire.
    """
    runs, limits = list(runs), limits or SteadyLimits()
    if not runs:
        raise IdentificationError("expected at least one run")
    setup, corrections = runs[0].setup, []

    def motions_with(setup):
        motions, refused = [], []
        for run in runs:
            changed = dataclasses.replace(run, setup=setup)
            try:
                motion = motion_of(changed, base_vehicle, limits, acceleration)
                reason = reason_to_refuse(motion)
            except IdentificationError as error:
                motion, reason = None, str(error).replace(f"{run.name}: ", "")
            if reason:
                refused.append((run.label, reason))
            if motion is not None:
                motions.append((motion, not reason))
        return motions, refused

    if fix:
        setup, corrections = correct(motions_with, setup, base_vehicle)
    motions, refused = motions_with(setup)
    findings = check([motion for motion, _ in motions], setup, base_vehicle)
    grave = [finding for finding in findings if finding.grave]
    used = [motion for motion, good in motions if good]
    if grave:
        raise IdentificationError(
            "; ".join(finding.text for finding in grave)
            + (" (--fix applies that)" if not fix and grave[0].fix else "")
        )
    if not used:
        reasons = "; ".join(f"{label}: {reason}" for label, reason in refused)
        raise IdentificationError(f"nothing to identify tires from: {reasons}")
    if largest_a_y(used) < LEAST_MPS2:
        raise IdentificationError(
            f"straight driving: at most {largest_a_y(used):.2f} m/s^2 of lateral acceleration in "
            f"{len(used)} runs, which say nothing about tires"
        )

    front_points, rear_points = points_of(used, base_vehicle, front_force)
    oversampling = max(POINT_RATE_HZ / (2.0 * limits.cutoff_hz), 1.0)
    fits = []
    for axle, points, start in (
        ("front", front_points, base_vehicle.front),
        ("rear", rear_points, base_vehicle.rear),
    ):
        try:
            fits.append(
                fit_pacejka(points, _with_friction(start, base_vehicle.mu), 10.0, oversampling)
            )
        except IdentificationError as error:
            raise IdentificationError(f"{axle} axle: {error}") from None
    front, rear = fits
    front_linear = fit_linear(front_points, front.inlier, oversampling)
    rear_linear = fit_linear(rear_points, rear.inlier, oversampling)
    name = name or base_vehicle.name + "_identified"
    return Identification(
        vehicle=dataclasses.replace(
            base_vehicle, name=name, mu=1.0, front=front.tire, rear=rear.tire
        ),
        linear_vehicle=dataclasses.replace(
            base_vehicle,
            name=name + "_linear",
            mu=1.0,
            front=front_linear.tire,
            rear=rear_linear.tire,
        ),
        base=base_vehicle,
        front=front,
        rear=rear,
        front_linear=front_linear,
        rear_linear=rear_linear,
        front_points=front_points,
        rear_points=rear_points,
        motions=used,
        refused=refused,
        findings=findings,
        corrections=corrections,
        setup=setup,
        front_force=front_force,
        acceleration=acceleration,
    )


def leave_one_out(runs, base_vehicle, **options):
    """Predict each run with what the others say.

    Corrections of the sensors, too, come from the others alone.

    Parameters
    ----------
    runs, base_vehicle, options
        As of `identify`. At least two of the runs must be usable.

    Returns
    -------
    list of Hold
        Those of all usable runs, each predicted by the identification from the others.

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
        raise IdentificationError("leaving one run out needs at least two usable runs")
    holds = []
    for left_out in runs:
        others = identify([run for run in runs if run is not left_out], base_vehicle, **options)
        run = dataclasses.replace(left_out, setup=others.setup)
        motion = motion_of(run, base_vehicle, options.get("limits"), others.acceleration)
        holds += predict(others.vehicle, [motion], everything.largest_a_y)
    return holds


def predict(vehicle, motions, largest):
    """Compare steady cornering with the steady state of a car.

    Parameters
    ----------
    vehicle : Vehicle
    motions : iterable of Motion
    largest : float
        Largest lateral acceleration of the data [m/s^2], to tell what is at the limit.

    Returns
    -------
    list of Hold
        Pieces of at most 1.5 s with at least 1 m/s^2.
    """
    holds = []
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
                holds.append(
                    Hold(
                        *(motion.run.label, t, v, delta, a_y, r, predicted, predicted / v),
                        abs(a_y) > AT_LIMIT * largest,
                    )
                )
    return holds


def steady_acceleration(vehicle, v, delta):
    """Lateral acceleration of the steady state at a speed and a steering angle.

    Parameters
    ----------
    vehicle : Vehicle
    v : float
        Speed [m/s].
    delta : float
        Steering angle [rad], not negative.

    Returns
    -------
    float
        [m/s^2]; where no stable steady state exists at that angle, the largest of smaller angles,
        and NaN where none exists at all.
    """
    try:
        table = steady_state_table(vehicle, [v], delta * np.arange(1, 33) / 32.0)
    except ParameterError:
        return math.nan
    column = table.a_lat[:, 0]
    return float(column[-1]) if np.isfinite(column[-1]) else float(np.nanmax(column))


def points_of(motions, vehicle, front_force="model"):
    """Points of both axles from the steady cornering of runs, at 10 Hz.

    Parameters
    ----------
    motions : iterable of Motion
    vehicle : Vehicle
        Mass and geometry.
    front_force : {"model", "paper"}

    Returns
    -------
    front, rear : AxlePoints
    """
    columns = [[] for _ in range(5)]
    beta_noise, a_y_noise = [], []
    for motion in motions:
        v_y = motion.v_y(vehicle.l_r)
        for cut in motion.segments():
            pick = slice(cut.start, cut.stop, round(RATE_HZ / POINT_RATE_HZ))
            for column, values in zip(
                columns, (motion.v_x, v_y, motion.r, motion.delta, motion.a_y)
            ):
                column.append(values[pick])
        beta_noise.append(motion.beta_noise)
        a_y_noise.append(motion.a_y_noise)
    front, rear = axle_points(vehicle, *map(np.concatenate, columns), front_force=front_force)
    slip_noise, a_y_noise = float(np.median(beta_noise)), float(np.median(a_y_noise))
    return tuple(
        axle._replace(slip_noise=slip_noise, force_noise=axle.load / GRAVITY * a_y_noise)
        for axle in (front, rear)
    )


def largest_a_y(motions):
    """Largest lateral acceleration that was held in steady cornering [m/s^2].

    Parameters
    ----------
    motions : iterable of Motion

    Returns
    -------
    float
        The 98th percentile of its magnitude.
    """
    held = [np.abs(motion.a_y[cut]) for motion in motions for cut in motion.segments()]
    return float(np.percentile(np.concatenate(held), 98.0)) if held else 0.0


def _with_friction(tire, mu):
    """A tire of the base as it is where ``mu`` is 1."""
    return dataclasses.replace(tire, D=tire.D * mu) if isinstance(tire, PacejkaTire) else tire
