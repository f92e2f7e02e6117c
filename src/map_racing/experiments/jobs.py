"""A race as a job: a description that can be sent anywhere, and its result.

`execute` depends on nothing but its arguments, so the same description gives the same result on any
process of any computer with the same libraries. The fingerprint of a description is that of its
content and of the code that drives it: under it a result can be kept and found again.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import tempfile
from dataclasses import dataclass, field, fields, is_dataclass
from functools import lru_cache
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np

from .. import __version__
from ..control.controller import build_controller
from ..control.parameters import ControllerParameters
from ..errors import MapRacingError
from ..evaluation.laps import LapEvaluator
from ..evaluation.results import Lap
from ..simulation.plant import PlantParameters
from ..simulation.plants import build_plant
from ..simulation.public_simulator import PublicSimulatorParameters
from ..simulation.race import Outcome, race
from ..simulation.recorded import write_race_bag
from ..track.raceline import Raceline
from ..vehicle.parameters import Vehicle

__all__ = [
    "LAP_COLUMNS",
    "End",
    "RaceJob",
    "RaceResult",
    "code_fingerprint",
    "execute",
    "lap_row",
]

# The rooms, and modules of other rooms, that decide how a race goes and what is measured of it.
_DECISIVE = (
    *("vehicle", "track", "control", "simulation"),
    *("evaluation/laps.py", "experiments/conditions.py", "experiments/jobs.py"),
)


@dataclass(frozen=True)
class RaceJob:
    """One race, described completely.

    Parameters
    ----------
    name : str
        Of the controller, for tables and files; not part of the fingerprint.
    controller : ControllerParameters
        With the scale of the speeds.
    vehicle : Vehicle
        The car as the controller knows it.
    plant : PlantParameters or PublicSimulatorParameters
        The car as it is.
    raceline : Raceline
    laps : int
        Timed laps after an out-lap.
    seed : int
        Of the noise.
    """

    name: str = field(compare=False)
    controller: ControllerParameters
    vehicle: Vehicle
    plant: PlantParameters | PublicSimulatorParameters
    raceline: Raceline
    laps: int
    seed: int

    @property
    def scale(self):
        """Scale of the raceline's speeds."""
        return self.controller.speed_scale

    @property
    def fingerprint(self):
        """Sixteen hexadecimal digits of all that decides the result, the code included."""
        return fingerprint([code_fingerprint(), self])

    @property
    def file_stem(self):
        """A name for files of this race, for people."""
        name = "".join(c if c.isalnum() or c in "_-" else "_" for c in self.name)
        return f"{name}_{100 * self.scale:05.1f}_seed{self.seed}_{self.fingerprint[:6]}"


# What is kept of each `Lap` of a race.
LAP_COLUMNS = (
    "lap",
    "lap_time_s",
    "rms_lateral_error_m",
    "mean_abs_lateral_error_m",
    "max_abs_lateral_error_m",
    "min_clearance_m",
    "mean_speed_mps",
    "max_speed_mps",
    "start_time_s",
    "end_time_s",
    "valid",
    "reason",
)


def lap_row(lap: Lap) -> dict:
    """The `LAP_COLUMNS` of a lap."""
    return {name: getattr(lap, name) for name in LAP_COLUMNS}


class End(NamedTuple):
    """Where and how a race ended, at its last control step.

    Arc length [m], lateral deviation [m], curvature of the raceline there [1/m], speed [m/s], and
    angle from heading to velocity [rad].
    """

    s: float
    d: float
    kappa: float
    speed: float
    sideslip: float


class RaceResult(NamedTuple):
    """What a race gave.

    Parameters
    ----------
    outcome : str
        "completed", "crashed" or "stalled".
    stretches : tuple of Lap
        The whole true path: out-lap, laps, and what was begun when it ended. Its reference point is
        the one whose pose localization gives.
    duration_s : float
        Simulated time [s].
    path : tuple of (float, float, float)
        Time [s] and true position [m] at each control step; empty if it was not asked for.
    end : End or None
        None if it was over before the first control step.
    """

    outcome: str
    stretches: tuple
    duration_s: float
    path: tuple = ()
    end: End | None = None

    @property
    def completed(self):
        """Whether all laps were driven."""
        return self.outcome == Outcome.COMPLETED.value

    @property
    def laps(self):
        """Complete laps that count, in order."""
        return [stretch for stretch in self.stretches if stretch.valid]


class Executed(NamedTuple):
    """A result and what belongs to its making: bag as bytes or None, processor time [s], code."""

    result: RaceResult
    bag: object
    cpu_s: float
    code: str


def execute(job, path=False, bag=False):
    """Drive a race.

    Parameters
    ----------
    job : RaceJob
    path, bag : bool
        Whether to return the true path, and the bag of the race.

    Returns
    -------
    Executed
    """
    begin = process_time()
    plant, localization = build_plant(job.plant, job.seed)
    controller = build_controller(job.controller, job.vehicle, job.raceline)
    rate = getattr(job.plant, "localization_rate_hz", 40.0)
    log = race(plant, controller, job.raceline, localization, rate=rate, laps=job.laps)
    states = log.true_path() if log.samples else np.empty((0, 7))
    evaluator = LapEvaluator(job.raceline, car_width=plant.vehicle.width)
    t, x, y, _, v_x, v_y, _ = states.T
    evaluator.update(t, x, y, np.hypot(v_x, v_y))
    stretches = tuple(Lap(**lap_row(lap)) for lap in evaluator.finish().laps)
    driven = tuple(zip(t.tolist(), x.tolist(), y.tolist())) if path else ()
    end = _end_of(log, job.raceline)
    result = RaceResult(log.outcome.value, stretches, log.duration, driven, end)
    recorded = _bag_of(log, job.raceline) if bag else None
    return Executed(result, recorded, process_time() - begin, code_fingerprint())


def _end_of(log, raceline):
    if not log.samples:
        return None
    _, x, y, _, v_x, v_y, _ = log.samples[-1].true
    s, d, _, kappa = raceline.project(x, y)
    return End(s, d, kappa, math.hypot(v_x, v_y), math.atan2(v_y, v_x))


def _bag_of(log, raceline):
    """The race's bag as bytes, which travel from wherever this runs."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "race.bag"
        write_race_bag(path, log, raceline)
        return path.read_bytes()


# -- fingerprints ----------------------------------------------------------------------------------


def fingerprint(value):
    """Sixteen hexadecimal digits of the content of parameters, racelines and plain values."""
    text = json.dumps(plain(value), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def plain(value):
    """Parameters as dictionaries, lists, texts and numbers; a raceline as the hash of its curve.

    Fields that do not count in comparisons are left out.
    """
    if isinstance(value, Raceline):
        columns = (value.x, value.y, value.speed, value.d_left, value.d_right)
        digest = hashlib.sha256()
        for column in columns:
            digest.update(b"-" if column is None else column.astype("<f8").tobytes())
        return {"name": value.name, "length_m": value.length, "sha256": digest.hexdigest()[:16]}
    if is_dataclass(value):
        content = {f.name: plain(getattr(value, f.name)) for f in fields(value) if f.compare}
        return {"kind": type(value).__name__, **content}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, float):
        return value if math.isfinite(value) else repr(value)
    if value is None or isinstance(value, (str, int)):
        return value
    raise MapRacingError(f"no fingerprint of {type(value).__name__}")


@lru_cache(maxsize=None)
def code_fingerprint():
    """Sixteen hexadecimal digits of the version and the sources that decide a race."""
    package = Path(__file__).resolve().parents[1]
    digest = hashlib.sha256(__version__.encode())
    for part in _DECISIVE:
        place = package / part
        for source in sorted(place.glob("*.py")) if place.is_dir() else [place]:
            digest.update(os.path.relpath(source, package).encode() + source.read_bytes())
    return digest.hexdigest()[:16]
