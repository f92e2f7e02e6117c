"""The page of a season: trends of each track, and the table of all heats."""

from __future__ import annotations

import math
import os
from typing import Sequence
from urllib.parse import quote

from .. import __version__
from .html import Markup, document, escape, table

__all__ = ["season_page"]

# Okabe and Ito: distinguishable by the color-blind; repeated if there are more.
_COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00", "#000000")
_WIDTH, _HEIGHT, _LEFT, _BOTTOM, _TOP = 640, 200, 70, 28, 28
_MANY = 150  # more points are drawn smaller
_TRENDS = (
    ("best_lap_time_s", "best lap [s]"),
    ("mean_lap_time_s", "mean lap [s]"),
    ("rms_lateral_error_m", "lateral error, RMS [m]"),
)
_TABLE = (
    ("date", "date (UTC)", "{}"),
    ("bag", "bag", "{}"),
    ("track", "track", "{}"),
    ("vehicle", "vehicle", "{}"),
    ("controller", "controller", "{}"),
    ("speed_scale", "scale", "{:.3g}"),
    ("settings", "settings", "{}"),
    ("laps", "laps", "{:.0f}"),
    ("best_lap_time_s", "best [s]", "{:.3f}"),
    ("mean_lap_time_s", "mean [s]", "{:.3f}"),
    ("rms_lateral_error_m", "RMS error [m]", "{:.3f}"),
    ("stops", "stops", "{:.0f}"),
    ("warnings", "remarks", "{}"),
)


def season_page(heats: Sequence[dict]) -> str:
    """Page of the heats of a season.

    Parameters
    ----------
    heats : sequence of dict
        Rows by `map_racing.experiments.season.COLUMNS`, in the order of time; ``report`` is the
        path of a report relative to the page, empty without one.

    Returns
    -------
    str
        Self-contained HTML.
    """
    heats = [dict(heat, bag=name) for heat, name in zip(heats, _short(heats))]
    read = [heat for heat in heats if not heat["reason"]]
    laps = sum(int(heat["laps"]) for heat in read)
    tracks = list(dict.fromkeys(heat["track"] for heat in read))
    controllers = list(dict.fromkeys(_driver(heat) for heat in read))
    colors = {name: _COLORS[i % len(_COLORS)] for i, name in enumerate(controllers)}
    text = f"Heats: {len(read)}; laps that count: {laps}; tracks: {len(tracks)}"
    if len(read) < len(heats):
        text += f"; bags that cannot be evaluated: {len(heats) - len(read)}"
    parts = [f"<header><h1>Season</h1><p>{escape(text)}</p></header>\n"]
    for track in tracks:
        driven = [heat for heat in read if heat["track"] == track]
        parts.append(_section(track, driven, colors))
    parts.append("<section><h2>All heats</h2>\n")
    head = [name for _, name, _ in _TABLE]
    parts.append(table(head, ([_cell(heat, *column) for column in _TABLE] for heat in read)))
    parts.append("</section>\n")
    if len(read) < len(heats):
        parts.append("<section><h2>Bags that cannot be evaluated</h2>\n")
        rows = [
            [_cell(heat, "bag", "bag", "{}"), heat["reason"]] for heat in heats if heat["reason"]
        ]
        parts += [table(["bag", "reason"], rows), "</section>\n"]
    parts.append(f"<footer>map_racing {escape(__version__)}. Times are UTC.</footer>\n")
    return document("Season", "".join(parts))


def _short(heats):
    """Paths of the bags relative to their common folder."""
    paths = [os.path.abspath(heat["bag"]) for heat in heats]
    base = os.path.commonpath([os.path.dirname(path) for path in paths])
    return [os.path.relpath(path, base) for path in paths]


def _driver(heat):
    return heat["controller"] or "unknown controller"


def _section(track, heats, colors):
    lengths = [heat["track_length_m"] for heat in heats if not math.isnan(heat["track_length_m"])]
    length = f", {lengths[0]:.1f} m" if lengths else ""
    parts = [f"<section><h2>{escape(track)}{length}</h2>\n<p>"]
    for name in dict.fromkeys(_driver(heat) for heat in heats):
        parts.append(
            f'<span class="swatch" style="border-top-color:{colors[name]}"></span> '
            f"{escape(name)} &ensp;"
        )
    parts.append("</p>\n")
    for key, name in _TRENDS:
        points = [
            (number, heat[key], heat) for number, heat in enumerate(heats) if heat[key] == heat[key]
        ]
        if points:
            parts.append(_trend(name, len(heats), points, colors))
    parts.append("</section>\n")
    return "".join(parts)


def _trend(name, count, points, colors):
    """One quantity over the heats of a track, as SVG; each point names its heat."""
    values = [value for _, value, _ in points]
    low, high = min(values), max(values)
    margin = 0.08 * (high - low) or 0.05 * abs(high) or 1.0
    low, high = low - margin, high + margin
    right, bottom = _WIDTH - 12, _HEIGHT - _BOTTOM

    def place(number, value):
        x = _LEFT + (right - _LEFT) * (number + 0.5) / count
        return x, _TOP + (bottom - _TOP) * (high - value) / (high - low)

    parts = [
        f'<svg viewBox="0 0 {_WIDTH} {_HEIGHT}" width="100%" class="trend" '
        f'role="img" aria-label="{escape(name)} over the heats">\n'
    ]
    for tick in _ticks(low, high):
        _, y = place(0, tick)
        parts.append(
            f'<line x1="{_LEFT}" x2="{right}" y1="{y:.1f}" y2="{y:.1f}" stroke="#d5d5d5"/>'
            f'<text x="{_LEFT - 6}" y="{y + 4:.1f}" text-anchor="end">{tick:g}</text>\n'
        )
    parts.append(f'<text x="{_LEFT}" y="{_TOP - 10}" font-weight="600">{escape(name)}</text>\n')
    for number, heat in ((points[0][0], points[0][2]), (points[-1][0], points[-1][2])):
        x, _ = place(number, low)
        anchor = "start" if number == points[0][0] else "end"
        parts.append(
            f'<text x="{x:.1f}" y="{_HEIGHT - 8}" text-anchor="{anchor}">'
            f"{escape(heat['date'][:16])}</text>\n"
        )
        if number == points[-1][0] == points[0][0]:
            break
    for driver in dict.fromkeys(_driver(heat) for _, _, heat in points):
        own = [place(number, value) for number, value, heat in points if _driver(heat) == driver]
        line = " ".join(f"{x:.1f},{y:.1f}" for x, y in own)
        parts.append(f'<polyline points="{line}" fill="none" stroke="{colors[driver]}"/>\n')
    radius = 4 if len(points) <= _MANY else 2
    for number, value, heat in points:
        x, y = place(number, value)
        what = f"{heat['date']} {heat['bag']}: {value:.3f}, {_driver(heat)}"
        dot = (
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius}" fill="{colors[_driver(heat)]}">'
            f"<title>{escape(what)}</title></circle>"
        )
        parts.append(_linked(heat, dot) + "\n")
    parts.append("</svg>\n")
    return "".join(parts)


def _ticks(low, high):
    """Round numbers between two values."""
    step = 10.0 ** math.floor(math.log10(high - low))
    step = next(
        part * step for part in (0.1, 0.2, 0.5, 1.0, 2.0) if (high - low) / (part * step) <= 6
    )
    first = math.ceil(low / step)
    return [round(k * step, 10) for k in range(first, math.floor(high / step) + 1)]


def _linked(heat, content):
    if not heat["report"]:
        return content
    return f'<a href="{escape(quote(heat["report"]))}">{content}</a>'


def _cell(heat, key, _, form):
    value = heat[key]
    if key == "bag":
        return Markup(_linked(heat, escape(value)))
    if isinstance(value, float) and math.isnan(value):
        return value
    return form.format(value)
