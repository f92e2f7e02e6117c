"""Result directories: tables with their provenance, and two of them compared.

A result directory holds ``results.json`` (kind, table and provenance), the same table as
``table.csv``, further tables, figures, identified vehicles, tuned controllers, and all races (see
`map_racing.experiments.store`).
"""

from __future__ import annotations

import platform
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Sequence

import numpy as np
import pandas as pd
import scipy

from .. import __version__
from ..control.parameters import ControllerParameters, MpcParameters
from ..errors import FileFormatError, ParameterError
from ..files import read_json, replacing, together, write_json
from .jobs import code_fingerprint, plain
from .paper import Setting

__all__ = [
    "Comparison",
    "Results",
    "compare",
    "provenance_of",
    "read_results",
    "software",
    "write_results",
]

FILE = "results.json"
KEYS = ["speed_scale", "controller"]
# Tuned parameters of both laws: a table has those of its controllers.
TUNED = [*ControllerParameters.TUNED, *MpcParameters.TUNED]
# Columns to compare, by kind.
COMPARED = {
    "velocity-scaling": [
        "days_completed",
        "median_rms_lateral_error_m",
        "max_abs_lateral_error_m",
        "median_lap_time_s",
    ],
    "tire-models": [
        "days_completed",
        "mean_abs_lateral_error_m",
        "max_abs_lateral_error_m",
        "mean_lap_time_s",
    ],
    "mpc": ["days_completed", "median_rms_lateral_error_m", "median_lap_time_s"],
    "tune": [*TUNED, "rms_lateral_error_m"],
    "robustness": [
        "races_completed",
        "worst_rms_lateral_error_m",
        "mean_rms_lateral_error_m",
        "mean_lap_time_s",
    ],
    "tune-robust": ["m_m", "q_s", "delay_s", "grip_use", "typical_rms_lateral_error_m"],
}


@dataclass(frozen=True)
class Results:
    """Results of one experiment.

    Parameters
    ----------
    kind : {"velocity-scaling", "tire-models", "robustness", "mpc", "tune", "tune-robust"}
    table : pandas.DataFrame
        One row for each ``speed_scale`` and ``controller``.
    provenance : dict
        Everything it depends on, as plain values.
    """

    kind: str
    table: pd.DataFrame
    provenance: dict[str, Any]


def software() -> dict[str, str]:
    """Versions of the code and of the libraries that affect its numbers."""
    return {
        "map_racing": __version__,
        "code": code_fingerprint(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }


def provenance_of(
    setting: Setting,
    identification: dict[str, Any],
    controllers: dict[str, ControllerParameters],
    laps: int,
    notes: Sequence[str] = (),
) -> dict[str, Any]:
    """Everything a result depends on, as plain values.

    Parameters
    ----------
    setting : Setting
    identification : dict
        Source of the controllers' vehicle model.
    controllers : dict of str to ControllerParameters
        As raced, by label.
    laps : int
    notes : sequence of str, optional
        On track and car, see `map_racing.experiments.session.Session`.
    """
    conditions = setting.conditions
    days = {
        str(seed): {
            "mu_scale": day.mu_scale,
            "front_stiffness_scale": day.front_stiffness_scale,
            "rear_stiffness_scale": day.rear_stiffness_scale,
        }
        for seed in (*conditions.seeds, *conditions.practice_seeds)
        for day in [setting.day(seed)]
    }
    return {
        **software(),
        "notes": list(notes),
        "conditions": plain(conditions),
        "laps": laps,
        "track": plain(setting.raceline),
        "plant": plain(setting.plant),
        "days": days,
        "identification": identification,
        "vehicle": plain(setting.vehicle),
        "linear_vehicle": plain(setting.linear_vehicle),
        "controllers": {label: plain(value) for label, value in controllers.items()},
    }


def write_results(folder: str | Path, results: Results, **frames: pd.DataFrame) -> None:
    """Write results, and further tables as ``NAME.csv``."""
    folder = Path(folder)
    content = {
        "kind": results.kind,
        "rows": results.table.to_dict("records"),
        "provenance": results.provenance,
    }
    with together():
        for name, frame in {"table": results.table, **frames}.items():
            with replacing(folder / f"{name}.csv") as file:
                frame.to_csv(file, index=False)
        write_json(folder / FILE, content)


def read_results(folder: str | Path) -> Results:
    """Read a result directory.

    Raises
    ------
    FileFormatError
        If it is not one.
    """
    if not str(folder):
        raise FileFormatError("'': expected the name of a result directory")
    path = Path(folder) / FILE
    try:
        content = read_json(path)
        kind, rows, provenance = (content[name] for name in ("kind", "rows", "provenance"))
        table = pd.DataFrame(rows)
        for column in [*KEYS, *COMPARED[kind]]:
            if column != "controller" and (column in table or column not in TUNED):
                table[column] = table[column].astype(float)
        if not all(isinstance(name, str) for name in table["controller"]):
            raise ValueError("controller")
        if not np.isfinite(table["speed_scale"]).all():
            raise ValueError("speed_scale")
        provenance["track"]["sha256"]
    except OSError as error:
        raise FileFormatError(
            f"{folder}: expected a result directory with {FILE}: {error.strerror}"
        ) from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise FileFormatError(f"{path}: expected results of an experiment or of tuning") from None
    return Results(kind, table, provenance)


@dataclass(frozen=True)
class Comparison:
    """Two result directories side by side.

    Parameters
    ----------
    kind : str
    values : list of str
        Columns compared.
    table : pandas.DataFrame
        Keys, then for each value ``NAME_a``, ``NAME_b`` and ``NAME_change`` (b - a).
    only_a, only_b : list of (float, str)
        Keys in only one of them.
    differences : list of (str, str, str)
        Names and both values of differing provenance.
    """

    kind: str
    values: list[str]
    table: pd.DataFrame
    only_a: list[tuple[float, str]]
    only_b: list[tuple[float, str]]
    differences: list[tuple[str, str, str]]


def compare(a: Results, b: Results) -> Comparison:
    """Compare two results.

    Raises
    ------
    ParameterError
        If they are of different experiments or tracks, or have no row in common.
    """
    if a.kind != b.kind:
        raise ParameterError(f"cannot compare {a.kind} with {b.kind}: expected one experiment")
    tracks = [results.provenance["track"] for results in (a, b)]
    if tracks[0]["sha256"] != tracks[1]["sha256"]:
        names = [track.get("name") or "a track without name" for track in tracks]
        raise ParameterError(
            f"cannot compare laps on different tracks, {names[0]} and {names[1]}"
            if names[0] != names[1]
            else f"cannot compare laps on different versions of the track {names[0]}"
        )
    rows_a, rows_b = (
        {(row["speed_scale"], row["controller"]): row for row in results.table.to_dict("records")}
        for results in (a, b)
    )
    both = [key for key in rows_a if key in rows_b]
    if not both:
        raise ParameterError("cannot compare: no scale and controller in common")
    # Controllers of different laws have different tuned parameters.
    known = set(a.table.columns) & set(b.table.columns)
    values, rows = [value for value in COMPARED[a.kind] if value in known], []
    for key in both:
        row = dict(zip(KEYS, key))
        for value in values:
            first, second = rows_a[key][value], rows_b[key][value]
            row.update(
                {f"{value}_a": first, f"{value}_b": second, f"{value}_change": second - first}
            )
        rows.append(row)
    flat_a, flat_b = (_flat(results.provenance) for results in (a, b))
    differences = [
        (name, flat_a.get(name, "-"), flat_b.get(name, "-"))
        for name in dict.fromkeys([*flat_a, *flat_b])
        if flat_a.get(name, "-") != flat_b.get(name, "-")
        # The seeds already show which days were raced in only one of them.
        and (name in flat_a and name in flat_b or not name.startswith("days."))
    ]
    return Comparison(
        a.kind,
        values,
        pd.DataFrame(rows),
        [key for key in rows_a if key not in rows_b],
        [key for key in rows_b if key not in rows_a],
        differences,
    )


def _flat(values, prefix=""):
    """Nested values as texts under dotted names."""
    if isinstance(values, dict):
        flat = {}
        for key, value in values.items():
            flat.update(_flat(value, f"{prefix}.{key}" if prefix else str(key)))
        return flat
    if isinstance(values, list):
        return {prefix: ", ".join(map(str, values))}
    return {prefix: f"{values:.6g}" if isinstance(values, float) else str(values)}
