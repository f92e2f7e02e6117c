"""Checks of the points: what must hold before there is a curve through them."""

from __future__ import annotations

import numpy as np

from ...validation import FARTHEST
from ..findings import ERROR, NOTE, WARNING, points
from ..loops import BACK, LARGEST_GAP, first_loop, overlap, turns, turns_back
from ..spline import distinct_points
from .draft import Draft

__all__ = ["check_order", "check_values"]

LARGEST_SPACING = 5.0  # between points, in median distances
CLOSES = 0.05  # from the last point to the first, which it repeats, in median distances
COARSE = 0.8  # largest turn from one chord to the next [rad] at which a spline can be trusted


def check_values(draft: Draft) -> None:
    """Check that the numbers can be used and that there are enough points."""
    _finite(draft)
    _negative_speeds(draft)
    if draft.fatal:
        return
    count = int(np.count_nonzero(distinct_points(draft.columns["x"], draft.columns["y"])))
    if count < 4:
        draft.add("few-points", ERROR, f"expected at least 4 distinct points, got {count}")


def check_order(draft: Draft) -> None:
    """Drop what is not given and repeated points; check loops, order and spacing."""
    _not_given(draft)
    _repeated(draft)
    _loops(draft)
    _order(draft)
    _spacing(draft)


def _finite(draft):
    """Numbers must be finite where they are used; elsewhere such a column is ignored."""
    for key, column in list(draft.columns.items()):
        finite = np.isfinite(column)
        far = np.abs(np.where(finite, column, 0.0)) > FARTHEST
        if key not in ("x", "y", "speed", "d_left", "d_right", "width"):
            bad = np.flatnonzero(~finite | far)
            if bad.size:
                text = f"{key} is not a valid number at {points(bad.size)}: not compared"
                draft.add("not-finite-unused", WARNING, text, bad)
                del draft.columns[key]
            continue
        bad, far = np.flatnonzero(~finite), np.flatnonzero(far)
        if bad.size:
            more = f" and {bad.size - 1} more" if bad.size > 1 else ""
            text = f"expected a finite {key}, got {column[bad[0]]}{more}"
            draft.add("not-finite", ERROR, text, bad)
        if far.size:
            text = f"expected {key} in meters and seconds, got {column[far[0]]:g}"
            draft.add("impossible", ERROR, text, far)


def _negative_speeds(draft):
    speed = draft.columns.get("speed")
    if speed is not None:
        with np.errstate(invalid="ignore"):
            bad = np.flatnonzero(speed < 0.0)
        if bad.size:
            text = f"expected a speed >= 0 m/s, got {speed[bad[0]]:g}"
            draft.add("negative-speed", ERROR, text, bad)


def _not_given(draft):
    """Unknown speeds and walls are often written as zeros."""
    columns = draft.columns
    if "width" in columns:
        columns["d_left"] = columns["d_right"] = 0.5 * columns.pop("width")
        draft.add("total-width", NOTE, "one width column: taken as the total, half to each side")
    for what, keys in (
        ("arc length", ("s",)),
        ("speed", ("speed",)),
        ("wall distance", ("d_left", "d_right")),
    ):
        if all(key in columns for key in keys) and not any(np.any(columns[k]) for k in keys):
            for key in keys:
                del columns[key]
            draft.add("all-zero", NOTE, f"every {what} is 0: taken as not given")
    for side, other in (("left", "right"), ("right", "left")):
        if f"d_{side}" in columns and f"d_{other}" not in columns:
            del columns[f"d_{side}"]
            text = f"no distance to the {other} wall: the one to the {side} is ignored"
            draft.add("one-wall", WARNING, text)


def _repeated(draft):
    keep = distinct_points(draft.columns["x"], draft.columns["y"])
    kept = np.flatnonzero(keep)
    closing = kept[-1] + 1 < keep.size
    xy = draft.xy[kept]
    chords = np.hypot(*(np.roll(xy, -1, axis=0) - xy).T)
    if not closing and len(xy) > 4 and chords[-1] < CLOSES * np.median(chords):
        closing, keep[kept[-1]] = True, False  # but for rounding
        kept = kept[:-1]
    if closing:
        draft.add("closing-point", NOTE, "the last point repeats the first: dropped")
    repeated = np.flatnonzero(~keep[: kept[-1]])
    if repeated.size:
        text = f"{points(repeated.size, 'repeated')} dropped"
        draft.add("repeated-points", WARNING, text, repeated)
    draft.keep(keep)


def _loops(draft):
    found = first_loop(draft.xy)
    if found is not None:
        end, laps = found
        text = f"expected one loop, but the points make {laps}; the second begins"
        draft.add("two-loops", ERROR, text, [end])


def _order(draft):
    """Points that turn back, and an end that overlaps the start."""
    xy = draft.xy
    count = overlap(xy)
    if count:
        last = len(xy) - count
        length = float(np.hypot(*(xy[-1] - xy[0])))
        text = f"the end overlaps the start by {length:.2f} m, {points(count)}"
        draft.add("overlap", ERROR, text, range(last, len(xy)))
        return
    back = turns_back(xy)
    if back.size:
        draft.add("turns-back", ERROR, f"the track turns back at {points(back.size)}", back)


def _spacing(draft):
    xy = draft.xy
    chords = np.hypot(*(np.roll(xy, -1, axis=0) - xy).T)
    usual = float(np.median(chords))
    if chords[-1] > LARGEST_GAP * usual and not draft.fatal:
        text = (
            f"the track is closed over a gap of {chords[-1]:.2f} m, "
            f"{chords[-1] / usual:.0f} times the usual spacing"
        )
        draft.add("gap", WARNING, text, [len(xy) - 1])
    far = np.flatnonzero(chords[:-1] > LARGEST_SPACING * usual)
    if far.size:
        worst = far[np.argmax(chords[far])]
        text = (
            f"{points(far.size)} more than {LARGEST_SPACING:g} times the usual {usual:.3f} m "
            f"before the next one, up to {chords[worst]:.2f} m"
        )
        draft.add("spacing", WARNING, text, [worst])
    turn = np.abs(turns(xy))
    coarse = np.flatnonzero((turn > COARSE) & (turn <= BACK))
    if coarse.size:
        worst = coarse[np.argmax(turn[coarse])]
        text = (
            f"too few points for the bend at {points(coarse.size)}, so the curve is a guess: "
            f"{turn[worst]:.2f} rad from one chord to the next"
        )
        draft.add("coarse", WARNING, text, [worst])
