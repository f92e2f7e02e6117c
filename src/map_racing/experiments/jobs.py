"""A race as a job: a description that can be sent anywhere, and its result.

`execute` depends only on its arguments, so a job has the same result in any process on any computer
with the same libraries. The fingerprint of a job covers its content and the code that drives it;
results are stored under it.
"""

from __future__ import annotations

import hashlib
import json
import math
import tempfile
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from time import process_time
from typing import Any, NamedTuple

import numpy as np

from ..control.laws import build_law
from ..control.parameters import ControllerParameters, MpcParameters
from ..errors import MapRacingError
from ..evaluation.laps import LapEvaluator
from ..evaluation.results import Lap
from ..resources import fingerprint_of_code
from ..simulation.plant import PlantParameters
from ..simulation.plants import build_plant
from ..simulation.public_simulator import PublicSimulatorParameters
from ..simulation.race import Outcome, Work, race
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

# Packages and modules that determine a race and its measurements.
_DECISIVE = (
    *("vehicle", "track", "control", "simulation"),
    *(f"evaluation/{name}.py" for name in ("lap_limits", "laps", "results", "speed")),
    *(f"evaluation/{name}.py" for name in ("statistics", "stops")),
    *("experiments/conditions.py", "experiments/jobs.py"),
)


@dataclass(frozen=True)
class RaceJob:
    """One race, described completely.

    Parameters
    ----------
    name : str
        Name of the controller, for tables and files; not part of the fingerprint.
    controller : ControllerParameters or MpcParameters
        With the scale of the speeds.
    vehicle : Vehicle
        The controller's model of the car.
    plant : PlantParameters or PublicSimulatorParameters
        The true car.
    raceline : Raceline
    laps : int
        Timed laps after an out-lap.
    seed : int
        Of the noise.
    slowdown : float, optional
        Factor on the computing time of a step, as in `race`.
    """

    name: str = field(compare=False)
    controller: ControllerParameters | MpcParameters
    vehicle: Vehicle
    plant: PlantParameters | PublicSimulatorParameters
    raceline: Raceline
    laps: int
    seed: int
    slowdown: float | None = None

    @property
    def scale(self) -> float:
        """Scale of the raceline's speeds."""
        return self.controller.speed_scale

    @property
    def fingerprint(self) -> str:
        """Sixteen hexadecimal digits of everything that decides the result, including the code."""
        return fingerprint([code_fingerprint(), self])

    @property
    def file_stem(self) -> str:
        """A readable name for files of this race."""
        name = "".join(c if c.isalnum() or c in "_-" else "_" for c in self.name)
        return f"{name}_{100 * self.scale:05.1f}_seed{self.seed}_{self.fingerprint[:6]}"


# Fields of each `Lap` to keep.
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
    """Result of a race.

    Parameters
    ----------
    outcome : str
        "completed", "crashed" or "stalled".
    stretches : tuple of Lap
        The whole true path of the localized point: out-lap, laps, and the unfinished rest.
    duration_s : float
        Simulated time [s].
    path : tuple of (float, float, float)
        Time [s] and true position [m] at each control step; empty unless requested.
    end : End or None
        None if the race ended before the first control step.
    work : Work or None
        Computing time of the steps, if the race had a ``slowdown``.
    lateral_mps2 : float
        Lateral acceleration, speed times yaw rate, that is exceeded 1 % of the time [m/s^2].
    """

    outcome: str
    stretches: tuple
    duration_s: float
    path: tuple = ()
    end: End | None = None
    work: Work | None = None
    lateral_mps2: float = math.nan

    @property
    def completed(self):
        """Whether all laps were driven."""
        return self.outcome == Outcome.COMPLETED.value

    @property
    def laps(self):
        """Complete laps that count, in order."""
        return [stretch for stretch in self.stretches if stretch.valid]


class Executed(NamedTuple):
    """A result, its bag as bytes or None, processor time [s], and fingerprint of the code."""

    result: RaceResult
    bag: bytes | None
    cpu_s: float
    code: str


def execute(job: RaceJob, path: bool = False, bag: bool = False) -> Executed:
    """Drive a race; return its true path and its bag if requested."""
    begin = process_time()
    plant, localization = build_plant(job.plant, job.seed)
    controller = build_law(job.controller, job.vehicle, job.raceline)
    rate = getattr(job.plant, "localization_rate_hz", 40.0)
    given = dict(rate=rate, laps=job.laps, slowdown=job.slowdown)
    log = race(plant, controller, job.raceline, localization, **given)
    states = log.true_path() if log.samples else np.empty((0, 7))
    evaluator = LapEvaluator(job.raceline, car_width=plant.vehicle.width)
    t, x, y, _, v_x, v_y, r = states.T
    evaluator.update(t, x, y, np.hypot(v_x, v_y))
    stretches = tuple(Lap(**lap_row(lap)) for lap in evaluator.finish().laps)
    driven = tuple(zip(t.tolist(), x.tolist(), y.tolist())) if path else ()
    end = _end_of(log, job.raceline)
    lateral = float(np.percentile(np.abs(v_x * r), 99.0)) if t.size else math.nan
    result = RaceResult(log.outcome.value, stretches, log.duration, driven, end, log.work, lateral)
    recorded = _bag_of(log, job.raceline) if bag else None
    return Executed(result, recorded, process_time() - begin, code_fingerprint())


def _end_of(log, raceline):
    if not log.samples:
        return None
    _, x, y, _, v_x, v_y, _ = log.samples[-1].true
    s, d, _, kappa = raceline.project(x, y)
    return End(s, d, kappa, math.hypot(v_x, v_y), math.atan2(v_y, v_x))


def _bag_of(log, raceline):
    """The bag of a race as bytes, which can be sent from any process or computer."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "race.bag"
        write_race_bag(path, log, raceline)
        return path.read_bytes()


# -- fingerprints ----------------------------------------------------------------------------------


def fingerprint(value: Any) -> str:
    """Sixteen hexadecimal digits of the content of parameters, racelines and plain values."""
    text = json.dumps(plain(value), sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def plain(value: Any) -> Any:
    """Parameters as dictionaries, lists, texts and numbers; a raceline as the hash of its curve.

    Fields excluded from comparison are left out.
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


def code_fingerprint() -> str:
    """Sixteen hexadecimal digits for the version and the sources that determine a race."""
    return fingerprint_of_code(_DECISIVE)
