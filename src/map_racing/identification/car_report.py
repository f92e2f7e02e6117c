"""An identified car as text for the terminal, as plain data, and as the header of its file."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from .. import __version__
from .car import IdentifiedCar
from .delay import delay_data, delay_text
from .identify import Prediction
from .laps import LapTires
from .replay import Replay, replay_data, replay_lines
from .report import (
    check_line,
    comparison,
    report_data,
    report_text,
    survey_data,
    survey_lines,
    tables,
)

__all__ = ["car_data", "car_text", "provenance"]

# Parameters of `LapTires` in words, with unit and format; the delays have lines of their own.
SHOWN = (
    ("front_stiffness_n_per_rad", "cornering stiffness of the front axle", " N/rad", ".1f"),
    ("rear_stiffness_n_per_rad", "cornering stiffness of the rear axle", " N/rad", ".1f"),
    ("understeer_gradient_rad_s2_per_m", "understeer gradient", " rad per m/s^2", "+.5f"),
    ("friction", "friction", "", ".3f"),
    ("shape", "factor on the shape C of both curves", "", ".3f"),
    ("bend", "added to E of both curves", "", "+.3f"),
    ("gain", "wheel angle per commanded angle", "", ".3f"),
    ("offset_rad", "wheel angle at 0", " rad", "+.4f"),
)


def car_text(
    found: IdentifiedCar,
    left_out: list[Prediction] | None = None,
    validated: Replay | None = None,
) -> str:
    """The identification as text; arguments as for `car_data`."""
    parts = []
    if validated:
        parts.append("\n".join(replay_lines(validated)))
    if found.steady:
        parts.append(report_text(found.steady, left_out))
    if found.laps:
        laps = found.laps
        lines = [] if found.steady else [*survey_lines(found), ""]
        lines += laps_lines(laps)
        lines += comparison(laps.base, laps.vehicle, found.largest_a_y)
        parts.append("\n".join(lines))
    parts += [f"warning: {doubt}" for doubt in found.doubts]
    return "\n\n".join(parts)


def laps_lines(laps: LapTires) -> list[str]:
    """Results from ordinary driving, one per line."""
    lines = [
        f"{', '.join(laps.runs)}: ordinary driving, {laps.windows} pieces of 1 s with turning; the "
        f"model explains {laps.explained:.1%} of the yaw rate"
    ]
    for name, label, unit, form in shown(laps):
        lines.append(f"  {label}: {parameter_text(laps, name, unit, form)}")
    lines.append(f"  grip demonstrated: {demonstrated_text(laps)}")
    noise = {"r": "yaw rate {:.3f} rad/s", "a_y": "lateral acceleration {:.2f} m/s^2"}
    noise["v_y"] = "lateral velocity {:.3f} m/s"
    left = ", ".join(noise[name].format(value) for name, value in laps.noise.items())
    lines.append(f"  residuals of the model, noise included: {left}")
    return [*lines, *delay_text(replace(laps.delays, notes=[])).splitlines()]


def shown(laps: LapTires) -> list[tuple]:
    """The rows of `SHOWN`, without shape parameters that were not determined."""
    hidden = ("shape", "bend")
    return [row for row in SHOWN if row[0] not in hidden or laps.parameters[row[0]].determined]


def parameter_text(laps: LapTires, name: str, unit: str, form: str) -> str:
    """Value and interval of a parameter, or that the data do not determine it."""
    if name == "friction" and laps.least_friction is None:
        return "linear tires have no limit that could be determined"
    value, low, high, determined = laps.parameters[name]
    interval = f"(95 %: {low:{form}} to {high:{form}})"
    if determined:
        return f"{value:{form}}{unit} {interval}"
    return f"not determined by these data: stays {value:{form}}{unit} {interval}"


def demonstrated_text(laps: LapTires) -> str:
    """The sustained lateral acceleration, and the friction that it demonstrates."""
    text = f"{laps.largest_a_y:.2f} m/s^2"
    if laps.least_friction is None:
        return text
    return f"{text}, friction at least {laps.least_friction:.3f}"


def car_data(
    found: IdentifiedCar,
    left_out: list[Prediction] | None = None,
    validated: Replay | None = None,
) -> dict[str, Any]:
    """The identification as plain dictionaries, lists and numbers; None for missing values.

    Parameters
    ----------
    found : IdentifiedCar
    left_out : list of Prediction, optional
        From `map_racing.identification.identify.leave_one_out`.
    validated : Replay, optional
        Recordings that the car was not fitted to, replayed.
    """
    if found.steady:
        data = report_data(found.steady, left_out)
    else:
        data = {
            "base": found.base.name,
            "runs_used": [],
            "axles": {},
            "leave_one_out": None,
        }
    data.update(
        survey_data(found),
        vehicle=found.vehicle.name,
        notes=found.notes,
        tables=tables(found.base, found.vehicle),
        largest_lateral_acceleration_mps2=found.largest_a_y,
        laps=None,
        validation=replay_data(validated) if validated else None,
    )
    if found.laps:
        data["laps"] = laps_data(found.laps)
        data["runs_used"] = [*data["runs_used"], *found.laps.runs]
    return data


def laps_data(laps: LapTires) -> dict[str, Any]:
    """Results from ordinary driving as plain data."""
    return {
        "runs": list(laps.runs),
        "windows": laps.windows,
        "yaw_rate_explained": laps.explained,
        "parameters": {name: value._asdict() for name, value in laps.parameters.items()},
        "demonstrated_mps2": laps.largest_a_y,
        "least_friction": laps.least_friction,
        "noise": dict(laps.noise),
        "delays": delay_data(laps.delays),
    }


def provenance(found: IdentifiedCar, validated: Replay | None = None) -> str:
    """Comment at the top of the vehicle file: the data behind its tires."""
    lines = []
    if found.steady:
        steady = found.steady
        runs = ", ".join(motion.run.label for motion in steady.motions)
        front, rear = (axle.pacejka for axle in steady.axles.values())
        lines += [
            f"Tires identified by map_racing {__version__} from {runs}; the rest is of "
            f"{found.base.name}.",
            f"Grip demonstrated: {steady.largest_a_y:.2f} m/s^2, friction at least "
            f"{steady.friction:.3f}; slip angles to {front.covered_slip:.3f} rad "
            f"in front and {rear.covered_slip:.3f} rad behind; peak "
            f"{'reached' if front.saturated else 'not reached'} in front, "
            f"{'reached' if rear.saturated else 'not reached'} behind.",
        ]
    if found.laps:
        laps = found.laps
        lines.append(
            f"Tires identified by map_racing {__version__} from ordinary driving, "
            f"{', '.join(laps.runs)}; the rest is of {laps.base.name}."
        )
        for name, label, unit, form in shown(laps):
            text = parameter_text(laps, name, unit, form)
            lines.append(f"{label[0].upper()}{label[1:]}: {text}.")
        lines.append(f"Grip demonstrated: {demonstrated_text(laps)}.")
        named = (
            ("Steering, dead time and lag", laps.delays.steering),
            ("The controller's delay_s", laps.delays.delay),
        )
        for label, part in named:
            if part.value is not None:
                interval = f"(95 %: {part.low:.3f} to {part.high:.3f})"
                reason = f"; {part.reason}" if part.reason else ""
                lines.append(f"{label}: {part.value:.3f} s {interval}{reason}.")
    lines.append(
        f"Steering: wheel angle = {found.setup.steering_gain:.4f} * signal "
        f"{found.setup.steering_offset_rad:+.4f} rad."
    )
    if validated:
        lines.append(f"Validated by replay: {validated.headline}.")
    lines += [note for note in found.notes if "warning: " in note]
    lines += [check_line(finding) for finding in found.findings if finding.contradiction]
    return "\n".join(lines)
