"""Sections of the report with advice: speeds of the next heat, and the car as it drove."""

from __future__ import annotations

import math

from ..errors import EvaluationError
from ..evaluation.advice import Advice, advice_notes, advice_table, advise
from ..evaluation.analysis import RunAnalysis
from ..evaluation.table_check import table_check
from .html import escape, heading_of, table

__all__ = ["advice_of", "car_section", "speeds_section"]

# Smaller differences from the values in use do not matter [s], [rad], shares.
_SAME_DELAY, _SAME_ANGLE = 0.01, math.radians(1.0)
_SAME_GRIP, _SAME_STIFFNESS = 0.1, 0.25
_BOUNDED = "not determined: at the end of the search range; is it the file of another car?"


def advice_of(run: RunAnalysis) -> Advice | str:
    """Advice from a run, or the reason why there is none."""
    try:
        return advise(run)
    except EvaluationError as error:
        return str(error).rpartition("no advice")[2].lstrip(": ")


def speeds_section(runs: list[RunAnalysis], advices: list) -> str:
    """Scales of the speeds for the next heat after each run."""
    parts = ['<section id="next-heat"><h2>For the next heat</h2>\n']
    for run, advice in zip(runs, advices):
        parts.append(heading_of(run.name, runs))
        if isinstance(advice, str):
            parts.append(f'<p class="hint">No advice: {escape(advice)}.</p>\n')
            continue
        head, *rows = advice_table(advice)
        parts.append(table(head, rows))
        parts.append(f"<p>{'<br>'.join(map(escape, advice_notes(advice)))}</p>\n")
    if not all(isinstance(advice, str) for advice in advices):
        parts.append(
            '<p class="hint">Scales of the raceline&#x27;s speed. <code>map-racing advise RUN '
            "--speed-sectors speed_scaling.yaml</code> writes them; drive them at speed_scale 1. "
            "Sure grip: share of the grip that the tires surely have that day, used by the mean "
            "lap.</p>\n"
        )
    return "".join([*parts, "</section>\n"])


def car_section(runs: list[RunAnalysis], advices: list) -> str:
    """Delay, grip and steering table, as each run shows them."""
    parts = ['<section id="car"><h2>The car, as it drove</h2>\n']
    for run, advice in zip(runs, advices):
        rows = [*_delay_rows(run), *_grip_rows(advice), *_table_rows(run)]
        parts.append(heading_of(run.name, runs))
        if rows:
            parts.append(table(["what", "found", "95 %", "driven with", "advice"], rows, "car"))
        else:
            text = "The recording does not say which car it is: give --vehicle."
            if run.limits is not None:
                text = (
                    "The recording has no commands, which are needed for delay, grip and steering."
                )
            parts.append(f'<p class="hint">{text}</p>\n')
    return "".join([*parts, "</section>\n"])


def _delay_rows(run):
    delays = run.delays
    if delays is None:
        return []
    controller = run.settings.controller if run.settings is not None else None
    rows = []
    for key, what, entry in (
        ("delay_s", "delay of the steering, age of the pose included", delays),
        ("speed_lookahead_s", "delay of the drive beyond that", delays["speed_lookahead"]),
    ):
        value = delays[key]
        if key == "speed_lookahead_s" and not run.result.commands_followed:
            value, entry = None, {"reason": "the speed does not follow its command"}
        if value is None:
            rows.append([what, "not determined", "", "", entry["reason"]])
            continue
        low, high = entry["delay_interval_s" if key == "delay_s" else "interval_s"]
        driven = getattr(controller, key, math.nan)
        advice = "" if math.isnan(driven) else "keep"
        if not low - _SAME_DELAY <= driven <= high + _SAME_DELAY and not math.isnan(driven):
            advice = f"{key}: {value:.3f}"
        advice = "; ".join(filter(None, (advice, entry["reason"])))
        rows.append(
            [what, f"{value:.3f} s", f"{low:.3f} to {high:.3f} s", _seconds(driven), advice]
        )
    return rows


def _seconds(value):
    return "" if math.isnan(value) else f"{value:.3f} s"


def _grip_rows(advice):
    if isinstance(advice, str) or advice.grip.belief is None:
        return []
    belief, grip = advice.grip.belief, advice.grip
    rows = [_share("lateral limit", _SAME_GRIP, grip.level, grip.low, grip.high)]
    for name, what, same in (
        ("friction", "friction", _SAME_GRIP),
        ("front_stiffness", "cornering stiffness, front", _SAME_STIFFNESS),
        ("rear_stiffness", "cornering stiffness, rear", _SAME_STIFFNESS),
    ):
        values = (getattr(belief, name + end) for end in ("", "_low", "_high"))
        rows.append(_share(what, same, *values))
        if grip.bounded(getattr(belief, name)):
            rows[-1][-1] = _BOUNDED
    return rows


def _share(what, same, value, low, high):
    advice = "identify the tires from this run"
    if low <= 1.0 <= high:
        advice = "keep"
    elif abs(value - 1.0) < same:
        advice = f"keep: off by less than {100 * same:.0f} %"
    return [what, f"{value:.2f}", f"{low:.2f} to {high:.2f}", "1 (vehicle file)", advice]


def _table_rows(run):
    rows = []
    for band in table_check(run.profile):
        degrees = math.degrees(band.more_rad)
        kind = "more" if degrees > 0.0 else "less"
        share = 100 * abs(band.per_angle)
        most = math.degrees(_SAME_ANGLE)
        rows.append(
            [
                f"steering at {100 * band.low:.0f} to {100 * band.high:.0f} % of the grip",
                f"{abs(degrees):.1f} degrees ({share:.0f} %) {kind} than the table, "
                f"in {100 * band.share:.0f} % of the laps",
                "",
                "",
                f"keep: off by less than {most:.0f} degree"
                if abs(degrees) < most
                else "identify the tires from this run",
            ]
        )
    return rows
