"""Surveys recorded drives: their motion, checks of their sensors, and a common setup.

It separates steady cornering, for `identify`, from ordinary driving, for `laps`.
"""

from __future__ import annotations

import dataclasses
from typing import Iterable, NamedTuple

from ..errors import IdentificationError
from ..vehicle.parameters import Vehicle
from .channels import SensorSetup
from .clock_checks import late_twist
from .cornering import ProcessedRun, motion_of
from .data import Run
from .limits import SteadyLimits
from .sensor_checks import check, correct
from .sensor_findings import SensorFinding
from .usable_runs import reason_to_refuse, reason_unsteady

__all__ = ["Survey", "survey"]


class Survey(NamedTuple):
    """Drives of one car with one setup of its sensors.

    Parameters
    ----------
    setup : SensorSetup
        The setup used, after corrections.
    corrections, findings : list of SensorFinding
        Corrections made, and findings of the checks after them.
    steady : list of ProcessedRun
        Runs with steady cornering.
    ordinary : list of Run
        Other runs in which the car drives and its sensors agree.
    refused : list of (str, str)
        All runs without steady cornering, with the reason.
    """

    setup: SensorSetup
    corrections: list[SensorFinding]
    findings: list[SensorFinding]
    steady: list[ProcessedRun]
    ordinary: list[Run]
    refused: list[tuple[str, str]]


def survey(
    runs: Iterable[Run],
    vehicle: Vehicle,
    fix: bool = False,
    limits: SteadyLimits | None = None,
    acceleration: str = "imu",
) -> Survey:
    """Survey drives; parameters as for `map_racing.identification.identify.identify`.

    Raises
    ------
    IdentificationError
        If there are no runs, or if sensors contradict each other (the message names the repair).
    """
    runs = list(runs)
    if not runs:
        raise IdentificationError("expected at least one run")
    setup, corrections = runs[0].setup, []

    def motions_with(setup):
        return _motions(runs, setup, vehicle, limits, acceleration)[:2]

    if fix:
        setup, corrections = correct(motions_with, setup, vehicle)
    motions, refused, ordinary = _motions(runs, setup, vehicle, limits, acceleration)
    findings = check([motion for motion, _ in motions], setup, vehicle)
    critical = [finding for finding in findings if finding.critical]
    if critical:
        raise IdentificationError(
            "; ".join(finding.text for finding in critical)
            + (" (--fix applies that)" if not fix and critical[0].fix else "")
        )
    steady = [motion for motion, good in motions if good]
    return Survey(setup, corrections, findings, steady, ordinary, refused)


def _motions(runs, setup, vehicle, limits, acceleration):
    """Motions of the runs and whether each is steady; refused runs; ordinary runs."""
    motions, refused, ordinary = [], [], []
    for run in runs:
        changed = dataclasses.replace(run, setup=setup)
        try:
            motion = motion_of(changed, vehicle, limits, acceleration)
        except IdentificationError as error:
            why = str(error)
            if f"a_{setup.lateral_axis}" not in run.signals and acceleration == "imu":
                # Ordinary driving identifies tires without an IMU, too.
                _, also, found = _motions([run], setup, vehicle, limits, "yaw_rate")
                ordinary += found
                others = [reason for _, reason in also if not found and reason != why]
                why = "; ".join([why, *others])
            refused.append((run.label, why))
            continue
        broken = reason_to_refuse(motion)
        broken = broken and (late_twist(changed) or broken)
        reason = broken or reason_unsteady(motion)
        if reason:
            refused.append((run.label, reason))
        if reason and not broken:
            ordinary.append(changed)
        motions.append((motion, not reason))
    return motions, refused, ordinary
