"""A car identified from any driving: steady cornering, ordinary laps, or both.

Steady cornering gives the tire curve of each axle. Ordinary driving gives the stiffness and, near
the limit, the friction. With both, the curves are the prior for the fit to the laps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Iterable

from ..errors import IdentificationError
from ..vehicle.parameters import Vehicle, linearized
from ..vehicle.plausibility import HIGHEST_FRICTION
from ..vehicle.single_track import GRAVITY
from .channels import SensorSetup
from .data import Run
from .identify import Identification, steady_tires
from .laps import PRIOR, LapTires, tires_from_laps
from .limits import SteadyLimits
from .robust_fit import CONFIDENCE
from .sensor_findings import SensorFinding
from .survey import Survey, survey

__all__ = ["IdentifiedCar", "identify_car"]

# Laps and circles may be from different days: least standard deviation of a factor between them.
DAY = 0.05


@dataclass(frozen=True)
class IdentifiedCar:
    """A car identified from recorded driving; at least one of `steady` and `laps` is not None.

    Parameters
    ----------
    base : Vehicle
        The given car: mass, geometry, and parameters that the data do not determine.
    steady : Identification or None
        Result from steady cornering.
    laps : LapTires or None
        Result from ordinary driving; its base is the car from steady cornering, if there is one.
    survey : Survey
    """

    base: Vehicle
    steady: Identification | None
    laps: LapTires | None
    survey: Survey

    @property
    def vehicle(self) -> Vehicle:
        """The identified car."""
        return (self.laps or self.steady).vehicle

    @property
    def linear_vehicle(self) -> Vehicle:
        """The car with linear tires: from regression of steady cornering, or the slope at zero."""
        return linearized(self.vehicle) if self.laps else self.steady.linear_vehicle

    @property
    def runs(self) -> list[Run]:
        """The runs used, with their sensor setup."""
        steady = [motion.run for motion in self.steady.motions] if self.steady else []
        return [*steady, *(self.survey.ordinary if self.laps else [])]

    @property
    def setup(self) -> SensorSetup:
        """The sensor setup used."""
        return self.survey.setup

    @property
    def corrections(self) -> list[SensorFinding]:
        """Corrections made to the setup."""
        return self.survey.corrections

    @property
    def findings(self) -> list[SensorFinding]:
        """Findings of the sensor checks after the corrections."""
        return self.survey.findings

    @property
    def largest_a_y(self) -> float:
        """Largest sustained lateral acceleration [m/s^2]."""
        return max(part.largest_a_y for part in (self.steady, self.laps) if part)

    @property
    def refused(self) -> list[tuple[str, str]]:
        """Labels of the runs that were not used, and why."""
        used = self.laps.runs if self.laps else []
        return [(label, reason) for label, reason in self.survey.refused if label not in used]

    @property
    def notes(self) -> list[str]:
        """Notes from reading the files, and doubts about the result."""
        notes = [f"{self.base.name}: {note}" for note in self.base.notes]
        if self.steady:
            for motion in self.steady.motions:
                notes += [f"{motion.run.label}: {note}" for note in motion.run.notes]
        notes += self.laps.notes if self.laps else []
        return notes + [f"warning: {doubt}" for doubt in self.doubts]

    @property
    def doubts(self) -> list[str]:
        """Doubts about the result."""
        friction = self.largest_a_y / GRAVITY
        why = f", needed for the sustained {self.largest_a_y:.2f} m/s^2,"
        if self.laps and self.laps.parameters["friction"].determined:
            tires = self.vehicle.front, self.vehicle.rear
            identified = self.vehicle.mu * min(tire.peak for tire in tires)
            if identified > friction:
                friction, why = identified, " identified,"
        if friction <= HIGHEST_FRICTION:
            return []
        return [
            f"a friction (mu times D) of {friction:.2f}{why} expected at most "
            f"{HIGHEST_FRICTION:g} for rubber on a floor without downforce: check units and scales "
            "of speed, yaw rate and acceleration"
        ]


def identify_car(
    runs: Iterable[Run],
    base_vehicle: Vehicle,
    *,
    fix: bool = False,
    limits: SteadyLimits | None = None,
    front_force: str = "model",
    acceleration: str = "imu",
    name: str | None = None,
) -> IdentifiedCar:
    """Identify the tires of a car from any driving.

    Parameters are those of `map_racing.identification.identify.identify`.

    Returns
    -------
    IdentifiedCar

    Raises
    ------
    IdentificationError
        If neither steady cornering nor ordinary driving identifies anything, or sensors contradict
        each other (the message names the repair).
    """
    limits = limits or SteadyLimits()
    surveyed = survey(runs, base_vehicle, fix, limits, acceleration)
    name = name or base_vehicle.name + "_identified"
    steady = None
    if surveyed.steady:
        try:
            steady = steady_tires(surveyed, base_vehicle, limits, front_force, acceleration, name)
            surveyed = surveyed._replace(findings=steady.findings)
        except IdentificationError:
            if not surveyed.ordinary:
                raise
    if not surveyed.ordinary:
        if steady is None:
            steady_tires(surveyed, base_vehicle, limits)  # raises the reason
        return IdentifiedCar(base_vehicle, steady, None, surveyed)
    try:
        before = steady.vehicle if steady else base_vehicle
        laps = tires_from_laps(surveyed.ordinary, before, name, _spreads(steady))
    except IdentificationError as error:
        if steady is None:
            reasons = "; ".join(f"{label}: {reason}" for label, reason in surveyed.refused)
            raise IdentificationError(f"no usable run: {reasons}; {error}") from None
        refused = [(label, f"{reason}; {error}") for label, reason in surveyed.refused]
        return IdentifiedCar(base_vehicle, steady, None, surveyed._replace(refused=refused))
    finding = laps.steering_finding
    if finding and fix and finding.fix and steady is None:
        setup = replace(surveyed.setup, **finding.fix)
        surveyed = surveyed._replace(
            setup=setup,
            corrections=[*surveyed.corrections, finding],
            ordinary=[replace(run, setup=setup) for run in surveyed.ordinary],
        )
        laps = tires_from_laps(surveyed.ordinary, before, name, _spreads(steady))
    elif finding:
        surveyed = surveyed._replace(findings=[*surveyed.findings, finding])
    if laps.runs_finding:
        surveyed = surveyed._replace(findings=[*surveyed.findings, laps.runs_finding])
    return IdentifiedCar(base_vehicle, steady, laps, surveyed)


def _spreads(steady):
    """Prior spreads for `tires_from_laps` after steady cornering."""
    if steady is None:
        return {}
    spreads = {}
    for name, axle in steady.axles.items():
        stiffness = axle.pacejka.parameters["stiffness_n_per_rad"]
        if stiffness.determined:
            own = 0.5 * (stiffness.high - stiffness.low) / (CONFIDENCE * stiffness.value)
            spreads[name] = min(max(own, 2.0 * DAY), PRIOR[name])
    if any(axle.pacejka.saturated for axle in steady.axles.values()):
        spreads.update(grip=DAY, shape=DAY)
    return spreads
