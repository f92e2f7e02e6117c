"""Checks of the curve: arc length, heading and curvature as stated; size, bends and crossings."""

from __future__ import annotations

import math

import numpy as np

from ...angles import wrap
from ..crossings import Polyline, crossings
from ..findings import ERROR, NOTE, WARNING, points
from ..speed_profile import lap_time
from .draft import Draft

__all__ = ["check_shape", "check_size", "check_stated"]

# At a steering angle of 0.42 rad, the stop of a 1:10 car's servo, a wheelbase of 0.33 m turns on a
# radius of 0.74 m.
TIGHTEST = 1.4  # [1/m]
# Lengths of tracks for 1:10 cars [m]; others may be in another unit, unless speeds or walls fit
# larger cars.
SHORTEST, LONGEST = 3.0, 2000.0
# The largest lateral acceleration [m/s^2] of a lap in any car, the widest track [m], and the
# narrowest of full-size cars.
ACCELERATIONS, WIDEST, NARROWEST = (2.0, 60.0), 30.0, 4.0
# A track is certainly in another unit if a lap needs less lateral acceleration [m/s^2], takes
# longer [s] and is faster than walking [m/s]; if the track is wider than a field [m]; or if it is
# shorter [m].
CRAWLING, LONGEST_LAP, WALKING, FIELD, TINY = 0.2, 300.0, 2.0, 100.0, 0.5
# Doubtful: speeds that vary by this factor although the bends need so little acceleration [m/s^2].
PACED, EASY = 1.3, 0.6

# Headings as files state them: code, severity, meaning, and the conversion to rad from +x.
_HEADINGS = (
    ("heading-x", NOTE, "measured from +x", lambda psi: psi),
    (
        "heading-north",
        NOTE,
        "measured from +y (north): recomputed from +x",
        lambda psi: psi + 0.5 * math.pi,
    ),
    (
        "heading-against",
        WARNING,
        "against the order of the points: recomputed",
        lambda psi: psi + math.pi,
    ),
    (
        "heading-compass",
        WARNING,
        "measured clockwise from north: recomputed",
        lambda psi: 0.5 * math.pi - psi,
    ),
    ("heading-clockwise", WARNING, "measured clockwise from +x: recomputed", lambda psi: -psi),
    ("heading-degrees", WARNING, "in degrees from +x: recomputed", np.radians),
    (
        "heading-degrees-north",
        WARNING,
        "in degrees from north: recomputed",
        lambda psi: np.radians(psi) + 0.5 * math.pi,
    ),
)


def check_size(draft: Draft) -> None:
    """Check that the length is one of a track in meters."""
    length = draft.raceline.length
    certain = _other_unit(draft.raceline)
    if certain:
        text = (
            f"expected meters, got a lap of {_rounded(length)} m, {certain}: in mm or cm? Name "
            "it, as in x [mm]"
        )
        draft.add("unit", ERROR, text)
        return
    if not SHORTEST <= length <= LONGEST and not (length > LONGEST and _full_size(draft.raceline)):
        text = (
            f"the track is {length:.3g} m long, tracks for 1:10 cars are {SHORTEST:g} to "
            f"{LONGEST:g} m: is it in meters?"
        )
        draft.add("size", WARNING, text)
        return
    wide = 0.0
    if draft.raceline.d_left is not None:
        wide = float(np.median(draft.raceline.d_left + draft.raceline.d_right))
    if wide > WIDEST and not _full_size(draft.raceline):
        text = f"the track is {wide:.3g} m wide, none is wider than {WIDEST:g} m: is it in meters?"
        draft.add("size", WARNING, text)
        return
    needed, speeds = _needed(draft.raceline), draft.raceline.speed
    if not (needed and needed < EASY and np.mean(speeds) > WALKING):
        return
    if np.max(speeds) > PACED * np.min(speeds):
        text = (
            f"at its speeds, {np.min(speeds):.3g} to {np.max(speeds):.3g} m/s, a lap of "
            f"{length:.3g} m needs at most {needed:.2g} m/s^2 in its bends: is it in meters, or "
            "in pixels?"
        )
        draft.add("size", WARNING, text)


def _needed(line):
    """Largest lateral acceleration of a line at its speeds [m/s^2]; 0 without speeds."""
    return 0.0 if line.speed is None else float(np.max(line.speed**2 * np.abs(line.kappa)))


def _other_unit(line):
    """Why a track is certainly not in meters; empty if it may be."""
    if line.length < TINY:
        return "shorter than a car"
    if line.d_left is not None and line.length > LONGEST:
        width = float(np.median(line.d_left + line.d_right))
        if width > FIELD:
            return f"{_rounded(width)} m wide"
    if line.speed is None or not line.speed.any():
        return ""
    needed, speed = _needed(line), float(np.mean(line.speed))
    duration = line.length / speed
    if needed < CRAWLING and duration > LONGEST_LAP and speed > WALKING:
        exact = lap_time(line.speed, line.ds)
        took = exact if math.isfinite(exact) else duration
        return f"which takes {took:.0f} s and needs at most {needed:.2g} m/s^2 in its bends"
    return ""


def _rounded(value):
    """Three digits at least, and no power of ten."""
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"


def _full_size(line):
    """Whether a long track is one of full-size cars: in another unit these would be far off."""
    if line.speed is not None:
        least, most = ACCELERATIONS
        return least <= _needed(line) <= most
    if line.d_left is None:
        return False
    return NARROWEST <= float(np.median(line.d_left + line.d_right)) <= WIDEST


def check_stated(draft: Draft) -> None:
    """Compare the arc length, heading and curvature stated with those of the curve."""
    if "s" in draft.columns:
        _arc_length(draft)
    sign = _curvature(draft) if "kappa" in draft.columns else 0
    if "psi" in draft.columns:
        _heading(draft, sign)


def check_shape(draft: Draft) -> None:
    """Check for bends that no 1:10 car can take and for crossings."""
    _bends(draft)
    _crossings(draft)


def _arc_length(draft):
    s = draft.columns["s"]
    steps = np.diff(s)
    if np.mean(steps < 0.0) > 0.9:
        text = "arc length decreases from point to point: driven the other way round?"
        draft.add("reversed-arc-length", WARNING, text)
        return
    back = np.flatnonzero(steps <= 0.0) + 1
    if back.size:
        text = f"arc length does not increase at {points(back.size)}: recomputed"
        draft.add("arc-length-order", WARNING, text, back)
    error = np.abs(s - s[0] - draft.raceline.s_points)
    worst = int(np.argmax(error))
    if error[worst] > 0.01 * draft.raceline.length:
        text = f"arc length is up to {error[worst]:.2f} m off: recomputed"
        draft.add("arc-length", WARNING, text, [worst])


def _curvature(draft):
    """Compare curvature; 1 if it is positive to the left, -1 if to the right, 0 if neither."""
    kappa, own = draft.columns["kappa"], draft.at.kappa
    scale = math.sqrt(np.mean(own**2))
    if math.sqrt(np.mean((kappa + own) ** 2)) < 0.5 * scale:
        text = "curvature is positive to the right: recomputed, positive to the left"
        draft.add("curvature-sign", WARNING, text)
        return -1
    off = np.abs(kappa - own)
    if math.sqrt(np.mean(off**2)) <= 0.5 * scale:
        return 1
    if not draft.fatal:
        worst = int(np.argmax(off))
        text = (
            "curvature does not fit the points: recomputed, largest difference "
            f"{off[worst]:.2f} 1/m"
        )
        draft.add("curvature", WARNING, text, [worst])
    return 0


def _heading(draft, sign):
    """Which direction the heading is measured from and in which sense it increases."""
    psi, own = draft.columns["psi"], draft.at.psi
    fits = ((*known, np.abs(wrap(converted(psi) - own))) for *known, converted in _HEADINGS)
    fit = next((fit for fit in fits if np.median(fit[3]) < 0.1), None)
    if fit is None:
        off = np.median(np.abs(wrap(psi - own)))
        text = f"heading does not fit the points: recomputed (median difference {off:.2f} rad)"
        draft.add("heading", WARNING, text)
        return
    code, severity, meaning, off = fit
    text = "heading and curvature are those of the mirror image: x and y swapped"
    if code == "heading-compass" and sign < 0:
        draft.add("swapped-xy", WARNING, f"{text}?")
        return
    if code == "heading-clockwise" and sign < 0:
        draft.add("mirrored", WARNING, f"{text}, or one of them is mirrored?")
        return
    worst = np.percentile(off, 95)
    text = f"heading is {meaning}; fits the points within {worst:.3f} rad (95 %)"
    draft.add(code, severity, text)
    wrong = int(np.argmax(off))
    if off[wrong] > max(0.3, 5.0 * worst) and not draft.fatal:
        text = f"heading is {off[wrong]:.2f} rad off: recomputed"
        draft.add("heading-point", WARNING, text, [wrong])


def _bends(draft):
    kappa = np.abs(draft.raceline.kappa)
    cell = int(np.argmax(kappa))
    if kappa[cell] > TIGHTEST:
        # A centerline need not be driven.
        severity = NOTE if draft.raceline.speed is None else WARNING
        text = f"a bend of {1.0 / kappa[cell]:.2f} m radius: 1:10 cars need {1.0 / TIGHTEST:.1f} m"
        draft.add("tight-bend", severity, text, draft.points_near([cell]))


def _crossings(draft):
    line = draft.raceline
    pairs = crossings(Polyline(np.stack((line.x, line.y), axis=1)))
    if not len(pairs):
        return
    apart = (pairs[:, 1] - pairs[:, 0]) * line.ds
    loops = np.minimum(apart, line.length - apart)
    small = loops < min(3.0, 0.1 * line.length)
    for chosen, code, severity, text in (
        (small, "loop", WARNING, "the track makes a loop of {:.2f} m"),
        (~small, "self-crossing", NOTE, "the track crosses itself, {:.2f} m later"),
    ):
        if chosen.any():
            at = draft.points_near(pairs[chosen, 0])
            draft.add(code, severity, text.format(float(loops[chosen].min())), at)
