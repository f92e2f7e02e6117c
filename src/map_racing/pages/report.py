"""The report of one run or several side by side."""

from __future__ import annotations

import math
import re

import numpy as np

from .. import __version__
from ..evaluation.analysis import RunAnalysis, corner_rows, references, same_track
from ..evaluation.places import costliest
from .driven_with import driven_with
from .html import Markup, document, escape, heading_of, plotly_script, table
from .next_heat import advice_of, car_section, speeds_section
from .report_data import chart_data, charted_laps

__all__ = ["report_page"]

# Largest size of a page [bytes], and least size of the charts' data, which gets what plotly.js and
# the tables leave.
_PAGE, _LEAST = 5_800_000, 200_000
# Most rows of states and notes, laps in tables, laps as buttons, and other runs that each is
# compared with.
_MOST_ROWS, _MOST_LAPS, _MOST_BUTTONS, _MOST_OTHERS = 60, 1000, 200, 5


def report_page(runs: list[RunAnalysis]) -> str:
    """Page of runs.

    Parameters
    ----------
    runs : list of RunAnalysis
        At least one.

    Returns
    -------
    str
        HTML.

    Raises
    ------
    MapRacingError
        If plotly is not installed.
    """
    title = " and ".join(run.name for run in runs[:3]) + (", ..." if runs[3:] else "")
    compared = [_comparisons(run, runs) for run in runs]
    advices = [advice_of(run) for run in runs]
    first = [_head(title, runs), '<main>\n<div id="left">\n', _first_screen(runs, compared)]
    rest = [
        "</div>\n",
        _map(),
        "</main>\n",
        speeds_section(runs, advices),
        _corners(runs),
        _grip(runs),
        car_section(runs, advices),
        _laps(runs),
        _poses(runs),
        driven_with(runs),
        f"<footer>map_racing {escape(__version__)}. Distances are along the raceline from the "
        "start line; left is positive.</footer>\n",
    ]
    size = sum(len(part.encode()) for part in (plotly_script(), *first, *rest))
    shown = charted_laps(runs, max(_PAGE - size, _LEAST))
    body = "".join([*first, _charts(runs, shown), *rest])
    return document(title, body, chart_data(runs, compared, shown), ("report.js",), plotly=True)


def _comparisons(run, runs):
    """References, each with the places that cost most against it."""
    if not run.profile.counted:
        return []
    others = [o for o in runs if o is not run and o.profile.counted and same_track(run, o)]
    if len(others) > _MOST_OTHERS:
        others.sort(key=lambda other: other.result.summary.mean_lap_time_s)
        del others[_MOST_OTHERS:]
    return [
        (reference, costliest(run.profile, reference, run.corners))
        for reference in references(run, others)
    ]


def _selected_laps(laps, most, best=None):
    """All laps or, of many, the best, those that do not count and others at equal steps."""
    if len(laps) <= most:
        return laps
    kept = [i for i, lap in enumerate(laps) if not lap.valid][: most // 2]
    steps = np.linspace(0, len(laps) - 1, most - len(kept)).round().astype(int).tolist()
    return [lap for i, lap in enumerate(laps) if i in {*kept, *steps} or lap is best]


# -- first screen ----------------------------------------------------------------------------------


def _head(title, runs):
    tracks = list(dict.fromkeys(_track_name(run) for run in runs))
    facts = ["; ".join(tracks[:3]) + ("; ..." if tracks[3:] else "")]
    dates = sorted({run.recording.date for run in runs} - {""})
    if dates:
        facts.append(f"{dates[0][:16]} UTC" if dates[0][0].isdigit() else dates[0])
    if len(runs) == 1 and _driver(runs[0]):
        facts.append(_driver(runs[0]))
    return f"<header><h1>{escape(title)}</h1><p>{escape(' · '.join(facts))}</p></header>\n"


def _track_name(run):
    line = run.result.raceline
    recorded = run.settings.values.get("raceline") if run.settings is not None else None
    name = recorded.get("name") if isinstance(recorded, dict) else None
    waypoints = run.recording.waypoints
    if waypoints is not None and name == waypoints.topic.rpartition("/")[2]:
        name = f"raceline of {waypoints.topic}"  # the node knows only its topic
    name = name or (line.name if line.name != run.name else "")
    return f"{name or 'raceline'}, {line.length:.1f} m"


def _driver(run):
    if run.settings is None or run.settings.controller is None:
        return ""
    name = run.settings.values["controller"].get("name") or "controller"
    return f"{name} at {run.settings.controller.speed_scale:.0%} speed".replace("%", " %")


def _first_screen(runs, compared):
    rows = []
    for run in runs:
        summary, best = run.result.summary, run.profile.best
        rows.append(
            [
                *([_breakable(run.name)] if len(runs) > 1 else []),
                f"{summary.laps_completed} of {len(run.result.laps)}",
                f"{best.lap.lap_time_s:.3f} s (lap {best.lap.lap})" if best else "none",
                f"{run.ideal.time_s:.3f} s" if run.ideal else "–",
                _spread(summary.mean_lap_time_s, summary.std_lap_time_s, "{:.3f}", " s"),
                _number(summary.mean_rms_lateral_error_m, "{:.3f} m"),
                _number(summary.min_clearance_m, "{:.2f} m"),
                _share([lap.saturated for lap in run.profile.counted]),
            ]
        )
    head = ["run"] if len(runs) > 1 else []
    head += ["laps counted", "best lap", "ideal lap", "mean lap", "RMS error"]
    head += ["clearance", "saturated"]
    parts = ['<section id="first">\n', table(head, rows, "summary"), _doubts(runs)]
    parts.append(_lap_strip(runs))
    parts.append('<div class="bar"><h2>Where the time goes</h2>')
    if len(runs) > 1:
        options = "".join(
            f'<option value="{i}">{escape(run.name)}</option>' for i, run in enumerate(runs)
        )
        parts.append(f'<label>run <select id="place-run">{options}</select></label>')
    parts.append('<label>against <select id="place-reference"></select></label></div>\n')
    for i, comparisons in enumerate(compared):
        if not comparisons:
            reason = runs[i].result.none_counts or "there is nothing to compare with"
            why = escape(reason[0].upper() + reason[1:])
            parts.append(f'<p class="places" data-run="{i}">{why}.</p>\n')
        for j, (reference, places) in enumerate(comparisons):
            parts.append(_place_list(i, j, reference, places, runs[i]))
    parts.append("</section>\n")
    return "".join(parts)


def _doubts(runs):
    """Warnings about the runs, one line each."""
    parts = []
    for run in runs:
        mark = "warning: "
        said = [note for note in (*run.result.notes, *run.notes) if note.startswith(mark)]
        said = list(dict.fromkeys(said))
        if said:
            name = f"{run.name}: " if len(runs) > 1 else ""
            more = f" ({len(said) - 1} more below)" if said[1:] else ""
            text = f"Doubtful: {name}{said[0][len(mark) :]}{more}"
            parts.append(f'<p class="doubt">{escape(text)}</p>\n')
    return "".join(parts)


def _breakable(name):
    """A name that may break into another line after its parts."""
    return Markup(re.sub("[_./-]", r"\g<0><wbr>", escape(name)))


def _place_list(i, j, reference, places, run):
    hidden = "" if (i, j) == (0, 0) else " hidden"
    name = escape(reference.name)
    if not places:
        return (
            f'<p class="places" data-run="{i}" data-reference="{j}" data-name="{name}"{hidden}>'
            f"No place costs time against {name}.</p>\n"
        )
    length = run.profile.track.length
    items = "".join(
        f'<li><button type="button" class="zoom" data-begin="{place.begin:.2f}" '
        f'data-end="{place.end if place.end > place.begin else place.end + length:.2f}">'
        f"s = {_stretch(place)} m"
        f"{', ' + escape(place.corner.name) if place.corner.name else ''}</button>: "
        f"<strong>{escape(place.loss)}</strong>; {escape(place.why)}</li>\n"
        for place in places
    )
    return (
        f'<ol class="places" data-run="{i}" data-reference="{j}" data-name="{name}"{hidden}>\n'
        f"{items}</ol>\n"
    )


def _stretch(place):
    """Begin and end, with decimals only if needed to tell them apart."""
    digits = 0 if abs(place.end - place.begin) >= 1.5 else 1
    return f"{place.begin:.{digits}f} to {place.end:.{digits}f}"


def _lap_strip(runs):
    """Buttons for all stretches, with validity, that select them for the charts."""
    parts = []
    for i, run in enumerate(runs):
        charted = {id(profile.lap): k for k, profile in enumerate(run.profile.laps)}
        best = run.profile.best
        chips = []
        most = max(_MOST_BUTTONS // len(runs), 20)
        for lap in _selected_laps(run.result.laps, most, best.lap if best else None):
            time = "" if math.isnan(lap.lap_time_s) else f" {lap.lap_time_s:.3f}"
            mark = "✓" if lap.valid else f"✗ {lap.reason}"
            kind = "valid" if lap.valid else "invalid"
            if best is not None and lap is best.lap:
                mark, kind = "✓ best", "valid best"
            index = charted.get(id(lap))
            where = "disabled" if index is None else f'data-run="{i}" data-lap="{index}"'
            chips.append(
                f'<button type="button" class="lap {kind}" {where} title="{escape(mark)}">'
                f"{lap.lap}{time} <small>{escape(mark)}</small></button>"
            )
        name = f"<span>{escape(run.name)}</span>" if len(runs) > 1 else ""
        parts.append(f'<div class="laps">{name}{"".join(chips)}</div>\n')
    return "".join(parts)


# -- charts ----------------------------------------------------------------------------------------


def _charts(runs, shown):
    left_out = sum(len(run.profile.laps) - len(laps) for run, laps in zip(runs, shown))
    said = ""
    if left_out:
        total = sum(len(laps) for laps in shown)
        said = (
            f" The charts show {total} laps, the best among them; {left_out} others are only in "
            "the tables."
        )
    return f"""<section id="over-distance">
<div class="bar"><h2>Over distance</h2>
<label><span class="swatch a"></span> A <select id="lap-a"></select></label>
<label><span class="swatch b"></span> B <select id="lap-b"></select></label>
<label><input type="checkbox" id="all-laps"> all laps</label>
<button type="button" id="whole">whole lap</button></div>
<div id="charts" class="plot"></div>
<p class="hint">Drag to zoom, double-click for the whole lap. The cursor is the same
everywhere.{said}</p>
</section>
"""


def _map():
    return """<aside id="right">
<label>color <select id="color"></select></label>
<div id="map" class="plot"></div>
<div id="scale"></div>
<input type="range" id="slider" min="0" max="1000" value="0" aria-label="place on the track">
<table id="readout"><tbody></tbody></table>
</aside>
"""


def _grip(runs):
    known = any(run.limits is not None for run in runs)
    text = (
        "The lines are the limits: laterally of the vehicle file's tires, longitudinally the "
        "acceleration and braking that the controller plans with or, if unknown, the vehicle "
        "file's."
        if known
        else "The car is not known, because the recording has no settings: give --vehicle for the "
        "limits of its tires and the steering of its table."
    )
    return (
        '<section id="grip"><h2>Grip</h2>\n<div id="gg" class="plot"></div>\n'
        f'<p class="hint">{escape(text)}</p></section>\n'
    )


# -- tables ----------------------------------------------------------------------------------------


def _corners(runs):
    parts = ['<section id="corners"><h2>Corners, lap by lap</h2>\n']
    head = ["corner", "from", "to", "time", "best", "speed at the entry", "slowest in the bend"]
    head += ["off the line at the apex", "grip used"]
    for run in runs:
        rows = [
            [
                row.corner.name or "whole lap",
                f"{row.corner.begin:.1f} m",
                f"{row.corner.end:.1f} m",
                _spread(row.time_s, row.time_std_s, "{:.3f}", " s"),
                f"{row.best_s:.3f} s",
                _spread(row.entry_mps, row.entry_std_mps, "{:.2f}", " m/s"),
                _spread(row.slowest_mps, row.slowest_std_mps, "{:.2f}", " m/s"),
                _spread(row.apex_d_m, row.apex_std_m, "{:+.3f}", " m"),
                _share([row.grip_used]),
            ]
            for row in corner_rows(run)
        ]
        parts += [heading_of(run.name, runs), table(head, rows)]
    parts.append('<p class="hint">Mean and standard deviation of the laps that count.</p>')
    return "".join([*parts, "</section>\n"])


def _laps(runs):
    parts = ['<section id="laps"><h2>Laps</h2>\n']
    most, left_out = max(_MOST_LAPS // len(runs), 20), 0
    for run in runs:
        best = run.profile.best
        laps = _selected_laps(run.result.laps, most, best.lap if best else None)
        left_out += len(run.result.laps) - len(laps)
        sectors = len(laps[0].sector_times_s) if laps else 0
        head = ["lap", "time", *(f"sector {i}" for i in range(1, sectors + 1))]
        head += ["error RMS", "mean", "95 %", "largest", "clearance", "mean speed", "top speed"]
        head += ["speed error", "saturated", "counts"]
        saturated = {id(profile.lap): profile.saturated for profile in run.profile.laps}
        rows = [
            [
                *_lap_cells(lap, run.result.commands_followed),
                _share([saturated.get(id(lap), math.nan)]),
            ]
            for lap in laps
        ]
        rows = [[*row, "yes" if lap.valid else lap.reason] for row, lap in zip(rows, laps)]
        parts += [heading_of(run.name, runs), table(head, rows)]
    said = "Saturated: share of the time in which the steering was at its largest useful angle."
    if left_out:
        said += f" {left_out} laps are not listed; map-racing evaluate --csv has all."
    return "".join([*parts, f'<p class="hint">{said}</p></section>\n'])


def _lap_cells(lap, followed):
    return [
        lap.lap,
        _number(lap.lap_time_s, "{:.3f} s"),
        *(_number(time, "{:.3f} s") for time in lap.sector_times_s),
        _number(lap.rms_lateral_error_m, "{:.3f} m"),
        _number(lap.mean_lateral_error_m, "{:+.3f} m"),
        _number(lap.p95_abs_lateral_error_m, "{:.3f} m"),
        _number(lap.max_abs_lateral_error_m, "{:.3f} m"),
        _number(lap.min_clearance_m, "{:.2f} m"),
        _number(lap.mean_speed_mps, "{:.2f} m/s"),
        _number(lap.max_speed_mps, "{:.2f} m/s"),
        _number(lap.rms_speed_error_mps if followed else math.nan, "{:.2f} m/s"),
    ]


def _poses(runs):
    parts = ['<section id="poses"><h2>Drive, poses and stops</h2>\n']
    head = ["run", "speed lags by", "above the command", "below it", "poses per second"]
    head += ["longest gap", "gaps", "jumps", "age of a pose", "oldest"]
    rows = []
    for run in runs:
        timing, tracking = run.timing, run.tracking
        drive = ["–"] * 3
        if tracking is not None:
            drive = [
                _number(tracking.lag_s, "{:.2f} s"),
                f"{tracking.overshoot_mps:.2f} m/s",
                f"{tracking.undershoot_mps:.2f} m/s",
            ]
        rows.append(
            [
                run.name,
                *drive,
                f"{timing.rate_hz:.1f}",
                f"{1e3 * timing.longest_gap_s:.0f} ms",
                timing.gaps,
                f"{timing.jumps} (up to {timing.largest_jump_m:.2f} m)" if timing.jumps else "0",
                _number(1e3 * timing.age_s, "{:.0f} ms"),
                _number(1e3 * timing.oldest_s, "{:.0f} ms"),
            ]
        )
    parts.append(table(head, rows))
    parts.append(
        '<p class="hint">Above and below: exceeded 1 % of the time, relative to the command '
        "delayed by the lag. Age: from stamp to receipt; the oldest is exceeded by 1 %.</p>\n"
    )
    for run in runs:
        if run.remarks.states:
            rows = [[f"{t:.1f} s", text] for t, text in run.remarks.states[:_MOST_ROWS]]
            parts += [heading_of(run.name, runs), table(["time", "state and reason"], rows)]
        stopped = [lap for lap in run.result.laps if "sto" in lap.reason]
        if stopped:
            rows = [[lap.lap, lap.reason] for lap in stopped[:_MOST_ROWS]]
            parts += [heading_of(run.name, runs), table(["lap", "stop"], rows)]
    return "".join([*parts, "</section>\n"])


def _number(value, form):
    return "–" if math.isnan(value) else form.format(value)


def _spread(mean, deviation, form, unit):
    if math.isnan(mean):
        return "–"
    text = form.format(mean)
    if not math.isnan(deviation):
        text += " ± " + form.replace("+", "").format(deviation)
    return text + unit


def _share(values):
    known = [value for value in values if not math.isnan(value)]
    return f"{100 * sum(known) / len(known):.1f} %" if known else "–"
