"""An identification as text for the terminal and as plain data for JSON."""

from __future__ import annotations

import math
from typing import Any, Iterable

import numpy as np

from ..errors import ParameterError
from ..vehicle.parameters import Vehicle
from ..vehicle.steady_state import steady_state_table
from .identify import Identification, Prediction
from .limits import RATE_HZ
from .sensor_findings import SensorFinding
from .tire_fit import AT_PEAK

__all__ = [
    "check_line",
    "comparison",
    "prediction_errors",
    "recorded_notes",
    "report_data",
    "report_text",
    "survey_data",
    "survey_lines",
    "tables",
    "worst_prediction",
]

SPEEDS_MPS = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
SHARES = (0.3, 0.6, 0.9)


def prediction_errors(predictions: Iterable[Prediction]) -> dict[str, dict[str, Any]]:
    """Mean relative errors of predictions below the limit and at it.

    Returns
    -------
    dict
        ``below_limit`` and ``at_limit``, each with their number (``holds``) and the mean absolute
        relative errors ``yaw_rate`` and ``lateral_acceleration`` (None without predictions).
    """
    finite = [p for p in predictions if math.isfinite(p.a_y_predicted)]
    result = {}
    for name, at_limit in (("below_limit", False), ("at_limit", True)):
        own = [p for p in finite if p.at_limit == at_limit]
        result[name] = {
            "holds": len(own),
            "yaw_rate": _mean(abs(p.r_predicted / p.r - 1.0) for p in own),
            "lateral_acceleration": _mean(abs(p.a_y_predicted / p.a_y - 1.0) for p in own),
        }
    return result


def worst_prediction(predictions: Iterable[Prediction]) -> dict[str, Any] | None:
    """The worst relative error of the yaw rate, and the number of small ones.

    Returns
    -------
    dict or None
        Number of segments ``holds``, number of those ``within_5_percent``, and ``error``, ``run``,
        ``t_s`` and ``v_mps`` of the worst; None without predictions.
    """
    errors = [(abs(p.r_predicted / p.r - 1.0), p) for p in predictions]
    errors = [entry for entry in errors if math.isfinite(entry[0])]
    if not errors:
        return None
    error, worst = max(errors, key=lambda entry: entry[0])
    return {
        "holds": len(errors),
        "within_5_percent": sum(error < 0.05 for error, _ in errors),
        "error": error,
        "run": worst.run,
        "t_s": worst.t,
        "v_mps": worst.v,
    }


def report_data(found: Identification, left_out: list[Prediction] | None = None) -> dict[str, Any]:
    """The identification as plain dictionaries, lists and numbers; None for missing values.

    Parameters
    ----------
    found : Identification
    left_out : list of Prediction, optional
        From `map_racing.identification.identify.leave_one_out`.
    """
    axles, understeer = {}, found.understeer_gradient
    for name, (points, fit, linear) in found.axles.items():
        axles[name] = {
            "points": int(fit.inlier.size),
            "rejected_share": fit.rejected_share,
            "mean_residual_n": fit.mean_residual_n,
            "static_load_n": points.load,
            "covered_slip_rad": fit.covered_slip,
            "rise_at_covered_slip": fit.rise,
            "share_of_peak": fit.reach,
            "peak_reached": bool(fit.saturated),
            "parameters": {key: value._asdict() for key, value in fit.parameters.items()},
            "linear": {
                "C_S": linear.tire.C_S,
                "stiffness_n_per_rad": linear.stiffness_n_per_rad._asdict(),
                "mean_residual_n": linear.mean_residual_n,
            },
        }
    return {
        "vehicle": found.vehicle.name,
        "base": found.base.name,
        "runs_used": [motion.run.name for motion in found.motions],
        "front_force": found.front_force,
        "lateral_acceleration_from": found.acceleration,
        "cutoff_hz": found.motions[0].limits.cutoff_hz,
        **survey_data(found),
        "notes": recorded_notes(found),
        "axles": axles,
        "largest_lateral_acceleration_mps2": found.largest_a_y,
        "friction": found.friction,
        "understeer_gradient_rad_s2_per_m": understeer.value,
        "understeer_gradient_interval_rad_s2_per_m": [understeer.low, understeer.high],
        "understeer_gradient_determined": understeer.determined,
        "fit_errors": prediction_errors(found.predictions()),
        "leave_one_out": prediction_errors(left_out) if left_out is not None else None,
        "leave_one_out_yaw_rate": worst_prediction(left_out) if left_out is not None else None,
        "tables": tables(found.base, found.vehicle),
    }


def recorded_notes(found: Identification) -> list[str]:
    """Notes from reading the runs and the vehicle file, one line each."""
    notes = [f"{motion.run.label}: {note}" for motion in found.motions for note in motion.run.notes]
    return [*(f"{found.base.name}: {note}" for note in found.base.notes), *notes]


def report_text(found: Identification, left_out: list[Prediction] | None = None) -> str:
    """The identification as text, some forty lines; arguments as for `report_data`."""
    lines = []
    for motion in found.motions:
        seconds = sum(cut.stop - cut.start for cut in motion.segments()) / RATE_HZ
        driven = np.count_nonzero(motion.moving) / RATE_HZ
        lines.append(
            f"{motion.run.label}: {seconds:.1f} s of steady driving in {driven:.1f} s, "
            f"{len(motion.segments())} segments"
        )
    lines += [*survey_lines(found), ""]
    for name, axle in found.axles.items():
        lines += _axle(name, axle, found.base.name)
    lines += _summary(found)
    lines += _predictions("the fitted data", found.predictions())
    if left_out is not None:
        lines += _predictions("each run, from the others", left_out)
        for run in dict.fromkeys(p.run for p in left_out):
            own = [p for p in left_out if p.run == run]
            lines += [f"  {line}" for line in _predictions(run, own)]
        worst = worst_prediction(left_out)
        if worst:
            lines.append(
                f"  yaw rate within 5% in {worst['within_5_percent']} of {worst['holds']} "
                f"segments, worst {worst['error']:.1%} at {worst['v_mps']:.1f} m/s "
                f"in {worst['run']}"
            )
    lines += comparison(found.base, found.vehicle, found.largest_a_y)
    return "\n".join(lines)


def survey_lines(found: Any) -> list[str]:
    """Runs left out, corrections, findings and the setup of the sensors.

    Parameters
    ----------
    found : Identification or IdentifiedCar
    """
    lines = [f"{run}: left out: {reason}" for run, reason in found.refused]
    lines += [f"corrected: {finding.text}" for finding in found.corrections]
    lines += [check_line(finding) for finding in found.findings]
    if found.setup.changes():
        lines += ["sensor setup, in the form of a channel map:", "  setup:"]
        lines += [f"    {name}: {value}" for name, value in found.setup.changes().items()]
    return lines


def check_line(finding: SensorFinding) -> str:
    """A finding with its repair."""
    repair = f"; --fix would set {_setup(finding.fix)}" if finding.fix else ""
    return f"check: {finding.text}{repair}"


def survey_data(found: Any) -> dict[str, Any]:
    """The same as plain data."""
    return {
        "runs_refused": [{"run": run, "reason": reason} for run, reason in found.refused],
        "setup": dict(found.setup.changes()),
        "corrections": [_finding(finding) for finding in found.corrections],
        "findings": [_finding(finding) for finding in found.findings],
    }


def _axle(name, axle, base):
    points, fit, linear = axle
    p = fit.parameters
    if fit.saturated:
        reach = "the peak was reached"
    elif fit.reach >= AT_PEAK:
        reach = "whether that is the peak is unclear: the points scatter, or do not rise to it"
    else:
        reach = (
            f"not saturated: the forces end at {fit.reach:.0%} of the curve's peak, where it "
            f"still rises with {fit.rise:.0%} of its first slope"
        )
    lines = [
        f"{name} axle: {fit.inlier.size} points, {fit.rejected_share:.1%} rejected, mean residual "
        f"{fit.mean_residual_n:.2f} N at {points.load:.1f} N of load",
        f"  covered to {fit.covered_slip:.3f} rad of slip; {reach}",
    ]
    for key, label, unit in (
        ("stiffness_n_per_rad", "cornering stiffness", "N/rad"),
        ("peak_n", "peak", "N"),
    ):
        if p[key].determined:
            text = f"{p[key].value:.1f} {unit} (95 %: {p[key].low:.1f} to {p[key].high:.1f})"
        else:
            text = f"not determined by these data ({p[key].value:.1f} {unit} is extrapolated)"
        lines.append(f"  {label}: {text}")
    known = [
        f"{key} = {p[key].value:.3f} ({p[key].low:.3f} to {p[key].high:.3f})"
        for key in "BCDE"
        if p[key].determined
    ]
    unknown = [f"{key} = {p[key].value:.3f}" for key in "BCDE" if not p[key].determined]
    if known:
        lines.append(f"  Pacejka, measured: {', '.join(known)}")
    if unknown:
        lines.append(
            f"  Pacejka, not determined individually (kept near {base}'s, within "
            f"bounds): {', '.join(unknown)}"
        )
    _, low, high, _ = (value / points.load for value in linear.stiffness_n_per_rad)
    lines.append(
        f"  linear tire: C_S = {linear.tire.C_S:.2f} 1/rad (95 %: {low:.2f} to {high:.2f}), mean "
        f"residual {linear.mean_residual_n:.2f} N"
    )
    return lines


def _summary(found):
    delta = np.concatenate([m.delta[cut] for m in found.motions for cut in m.segments()])
    widest = float(np.max(np.abs(delta)))
    share = 1.0 / math.cos(widest) - 1.0
    force = (
        "front force as in the equations of motion; divided by the cosine of the steering angle "
        f"(--front-force paper) it would be up to {share:.1%} larger"
        if found.front_force == "model"
        else "front force divided by the cosine of the steering angle, as in the paper: the table, "
        f"whose model has no such cosine, gives up to {share:.1%} more than was measured"
    )
    return [
        f"largest sustained lateral acceleration: {found.largest_a_y:.2f} m/s^2, friction at least "
        f"{found.friction:.3f}",
        f"understeer gradient: {_understeer(found.understeer_gradient)}",
        f"low-pass at {found.motions[0].limits.cutoff_hz:g} Hz, zero-phase",
        f"steering, as used: wheel angle = {found.setup.steering_gain:.3f} times the signal "
        f"{found.setup.steering_offset_rad:+.4f} rad; up to {widest:.3f} rad in the data",
        force,
    ]


def _understeer(gradient):
    """The understeer gradient with its interval, and the car's tendency."""
    value, low, high, determined = gradient
    interval = f"{value:+.5f} rad per m/s^2 (95 %: {low:+.5f} to {high:+.5f})"
    if not determined:
        return f"not determined by these data, {interval}"
    kind = "understeers" if low > 0.0 else "oversteers" if high < 0.0 else "is about neutral"
    return f"{interval}: the car {kind}"


def _predictions(what, predictions):
    lines = []
    for name, errors in prediction_errors(predictions).items():
        if errors["holds"]:
            lines.append(
                f"{what}, {name.replace('_', ' ')}: yaw rate {errors['yaw_rate']:.1%}, lateral "
                f"acceleration {errors['lateral_acceleration']:.1%} mean error in "
                f"{errors['holds']} steady segment{'s' if errors['holds'] != 1 else ''}"
            )
    return lines


def comparison(base: Vehicle, vehicle: Vehicle, largest_a_y: float) -> list[str]:
    """Comparison of a car's tables before and after; the data reached `largest_a_y` [m/s^2]."""
    lines = [
        "",
        f"table of {base.name} (before) and of {vehicle.name} (after): largest lateral "
        "acceleration, and steering angle at shares of the smaller one",
    ]
    rows = tables(base, vehicle)
    for row in rows:
        before, after = (_number(row[f"limit_{which}_mps2"], "5.2f") for which in _WHICH)
        angles = ", ".join(
            f"{share:.0%}: {_number(a, '.3f')} -> {_number(b, '.3f')}"
            for share, a, b in zip(SHARES, row["steering_before_rad"], row["steering_after_rad"])
        )
        lines.append(f"  {row['speed_mps']:.0f} m/s: {before} -> {after} m/s^2; {angles} rad")
    limits = [row["limit_after_mps2"] for row in rows]
    beyond = max((limit for limit in limits if limit is not None), default=0.0)
    if beyond > 1.05 * largest_a_y:
        lines.append(
            f"  beyond the {largest_a_y:.2f} m/s^2 that the data reached, the new table is "
            "extrapolated: drive faster or steer farther to measure it"
        )
    return lines


_WHICH = ("before", "after")


def tables(base: Vehicle, vehicle: Vehicle) -> list[dict[str, Any]]:
    """Limits of two cars' tables at some speeds, and angles at shares of the smaller limit."""
    made = {}
    for which, car in zip(_WHICH, (base, vehicle)):
        for v in SPEEDS_MPS:
            try:
                angles = np.linspace(0.0, car.delta_max, 257)
                made[which, v] = steady_state_table(car, [v], angles)
            except ParameterError:  # no stable steady state at that speed
                made[which, v] = None
    rows = []
    for v in SPEEDS_MPS:
        own = [made[which, v] for which in _WHICH]
        limits = [table.max_lateral_acceleration(v) if table else None for table in own]
        least = min((limit for limit in limits if limit is not None), default=None)
        row = {"speed_mps": v, "shares": list(SHARES)}
        for which, table, limit in zip(_WHICH, own, limits):
            row[f"limit_{which}_mps2"] = limit
            row[f"steering_{which}_rad"] = [
                table.steering(v, share * least)[0] if table else None for share in SHARES
            ]
        rows.append(row)
    return rows


def _finding(finding):
    return {
        "check": finding.check,
        "text": finding.text,
        "fix": dict(finding.fix),
        "grave": bool(finding.critical),
    }


def _setup(fix):
    return ", ".join(f"{name}: {value}" for name, value in fix.items())


def _mean(values):
    values = list(values)
    return float(np.mean(values)) if values else None


def _number(value, form):
    return "-" if value is None else format(value, form)
