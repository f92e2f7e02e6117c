"""Controller settings as text: published by the node, stored in bags, read by the report."""

from __future__ import annotations

import platform
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Callable

import numpy as np
import scipy
import yaml

from .. import __version__
from ..errors import ParameterError
from ..printing import printable
from ..track.findings import raceline_warnings
from ..track.raceline import Raceline
from ..validation import finite
from ..vehicle.lookup import LookupTable
from ..vehicle.parameters import Vehicle, parameter_hash, vehicle_of, vehicle_values
from ..vehicle.plausibility import doubts_of_table
from .controller import Controller
from .laws import build_law
from .parameters import ControllerParameters, MpcParameters, parameter_values, parameters_of
from .safety_limits import SafetyLimits
from .speed_sectors import SpeedSectors

__all__ = ["Settings", "doubts_of", "parse_settings", "settings_text"]

_MILLIMETER = 1e-3


@dataclass(frozen=True)
class Settings:
    """Settings that a car was driven with.

    Attributes
    ----------
    values : dict
        The whole text, by section.
    controller : ControllerParameters, MpcParameters or None
        None if the text has none that this version can read.
    vehicle : Vehicle or None
        Likewise.
    sectors : tuple of (float, float, float)
        Speed sectors: start and end [m], scale; empty without any.
    notes : tuple of str
        What could not be read, and the controller's warnings, marked ``warning:``.
    """

    values: dict
    controller: ControllerParameters | MpcParameters | None
    vehicle: Vehicle | None
    sectors: tuple = ()
    notes: tuple = ()

    def speed_sectors(self, raceline: Raceline) -> SpeedSectors | None:
        """Speed sectors on a raceline.

        Raises
        ------
        ParameterError
            If they belong to another raceline.
        """
        if not self.sectors:
            return None
        # The text is rounded to millimeters, so the last end may exceed the length by one.
        length = raceline.length
        fitted = [
            (start, length if 0.0 < end - length < _MILLIMETER else end, scale)
            for start, end, scale in self.sectors
        ]
        return SpeedSectors(fitted, length)

    def planned_speed(self, raceline: Raceline) -> Callable[[np.ndarray], np.ndarray] | None:
        """Planned speed of the controller on a raceline.

        Parameters
        ----------
        raceline : Raceline

        Returns
        -------
        callable or None
            Speeds [m/s] at an array of arc lengths [m]; None if the settings lack it or belong to
            another raceline.
        """
        if self.controller is None or self.vehicle is None:
            return None
        try:
            sectors = self.speed_sectors(raceline)
            controller = build_law(self.controller, self.vehicle, raceline, sectors)
        except ParameterError:
            return None
        return controller.planned_speed


def doubts_of(controller: Controller) -> list[str]:
    """Warnings about a controller's vehicle file, lookup table, raceline and speed sectors."""
    vehicle, raceline, sectors = controller.vehicle, controller.raceline, controller.sectors
    mark = "warning: "
    doubts = [note[len(mark) :] for note in vehicle.notes if note.startswith(mark)]
    doubts = [f"vehicle {vehicle.name}: {doubt}" for doubt in doubts]
    table = getattr(controller, "steering_map", None)
    if isinstance(table, LookupTable):
        linear = controller.parameters.steering_map == "linear_table"
        doubts += doubts_of_table(table, vehicle, linear)
    if raceline is not None:
        doubts += raceline_warnings(raceline)
    return doubts + list(sectors.doubts if sectors is not None else ())


def settings_text(
    controller: Controller,
    *,
    name: str = "",
    table: str = "",
    sectors: str = "",
    limits: SafetyLimits | None = None,
) -> str:
    """Settings of a controller as YAML that `parse_settings` reads.

    Parameters
    ----------
    controller : Controller or ModelPredictiveController
    name : str, optional
        Name or file of its parameters.
    table : str, optional
        File of its lookup table; empty if it is computed from the vehicle's tires.
    sectors : str, optional
        File of its speed sectors.
    limits : SafetyLimits, optional

    Returns
    -------
    str
    """
    vehicle, raceline = controller.vehicle, controller.raceline
    values = {
        "controller": {"name": Path(name).stem, **parameter_values(controller.parameters)},
        "vehicle": {**vehicle_values(vehicle), "fingerprint": parameter_hash(vehicle)},
        "steering_table": table or "of the vehicle's tires",
    }
    if raceline is not None:
        values["raceline"] = {
            "name": raceline.name or Path(raceline.source).stem,
            "length_m": round(raceline.length, 3),
            "points": len(raceline.s_points),
        }
    if controller.plan is not None:
        values["speeds"] = str(controller.plan)
    if controller.sectors is not None:
        values["speed_sectors"] = {
            "file": Path(sectors).name,
            "sectors": [
                dict(zip(("start_m", "end_m", "scale"), (round(float(v), 3) for v in stretch)))
                for stretch in controller.sectors.stretches()
            ],
        }
    doubts = doubts_of(controller)
    if doubts:
        values["doubts"] = doubts
    if limits is not None:
        values["safety"] = asdict(limits)
    values["versions"] = {
        "map_racing": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }
    return yaml.safe_dump(values, sort_keys=False, default_flow_style=None)


def parse_settings(text: str) -> Settings:
    """Read the text of `settings_text`, as far as this version understands it.

    Parameters
    ----------
    text : str
        From a bag, so it may be anything.

    Returns
    -------
    Settings
        Without controller or vehicle if the text comes from another program or version.
    """
    try:
        values = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        values = None
    if not isinstance(values, dict):
        return Settings({}, None, None, notes=("the recorded settings are no YAML mapping",))
    notes = []

    def part(key, read):
        section = values.get(key)
        if not isinstance(section, dict):
            notes.append(f"the recorded settings have no {key}")
            return None
        try:
            return read({k: v for k, v in section.items() if k != "fingerprint"})
        except (ParameterError, TypeError) as error:
            notes.append(f"the recorded settings: {key}: {error}")
            return None

    doubts = values.get("doubts")
    if isinstance(doubts, list):
        notes += [f"warning: {printable(doubt)}" for doubt in doubts if isinstance(doubt, str)]
    return Settings(
        values,
        part("controller", _controller),
        part("vehicle", vehicle_of),
        part("speed_sectors", _sectors) or () if "speed_sectors" in values else (),
        tuple(notes),
    )


def _sectors(section):
    keys = ("start_m", "end_m", "scale")
    try:
        return tuple(
            tuple(finite(key, sector[key]) for key in keys) for sector in section["sectors"]
        )
    except KeyError as error:
        raise ParameterError(f"{error.args[0]}: missing") from None


def _controller(section):
    section.pop("name", None)
    return parameters_of("controller", section)
