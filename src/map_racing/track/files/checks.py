"""What is right and wrong in a track as it was given: recomputed and compared, never believed.

`examine` makes the curve through the points and holds against it all that the table says: closure,
order, spacing, heading, curvature, arc length, walls, speeds. What it finds has a severity: a
`NOTE` tells a convention, a `WARNING` what is wrong or doubtful, an `ERROR` what cannot be driven.
"""

import math
from typing import NamedTuple, Optional, Tuple

import numpy as np

from ...angles import wrap
from ...errors import RacelineError
from ...validation import FARTHEST
from ..crossings import crossings
from ..findings import ERROR, NOTE, WARNING, Finding, Place, points
from ..raceline import Raceline, distinct_points
from ..speed_profile import accelerations

__all__ = [
    "Examination",
    "examine",
    "first_loop",
    "overlap",
    "raceline_of",
    "turns",
    "turns_back",
]

LARGEST_GAP = 3.0  # between last and first point, in usual distances
LARGEST_SPACING = 5.0  # between points, in usual distances
COARSE = 0.8  # turn from one chord to the next [rad] that no spline can be trusted with
BACK = 2.1  # turn that no track makes at one point [rad]
# Steered by 0.42 rad, as far as a 1:10 car's servo goes, 0.33 m of wheelbase turn on 0.74 m.
TIGHTEST = 1.4  # [1/m]
SHORTEST, LONGEST = 3.0, 2000.0  # [m] of tracks for 1:10 cars; others may be in another unit
GRIP = 20.0  # [m/s^2], beyond any 1:10 car on any floor, lateral or longitudinal
_FOLD = math.pi  # a wall folds over at most half a turn around a bend, in widths
KMH = 3.6  # [km/h] are 1 m/s
MOST_PLACES = 200  # of one finding that are listed


class Examination(NamedTuple):
    """What `examine` found.

    ``raceline`` is None where the points make no curve at all.
    """

    raceline: Optional[Raceline]
    findings: Tuple[Finding, ...]

    def worst(self, severity):
        """Findings of one severity."""
        return [finding for finding in self.findings if finding.severity == severity]


def raceline_of(table):
    """Raceline of a table that can be driven.

    Parameters
    ----------
    table : RacelineTable

    Returns
    -------
    Raceline
        With all `findings`.

    Raises
    ------
    RacelineError
        If anything is wrong beyond use.
    """
    examination = examine(table)
    errors = examination.worst(ERROR)
    if errors:
        more = f" (and {len(errors) - 1} more errors)" if len(errors) > 1 else ""
        raise RacelineError(f"{table.source or table.name or 'raceline'}: {errors[0]}{more}")
    examination.raceline.findings = examination.findings
    return examination.raceline


def examine(table):
    """Make the curve of a table and compare with it what the table says.

    Parameters
    ----------
    table : RacelineTable

    Returns
    -------
    Examination

    Notes
    -----
    Takes about 20 ms for a track of 340 m with points 0.2 m apart, half of that for the curve.
    """
    track = _Examined(table)
    for check in (_finite, _speeds_possible, _enough_points):
        check(track)
    if track.fatal:
        return Examination(None, tuple(track.findings))
    for check in (_not_given, _repeated, _loops, _order, _spacing):
        check(track)
    _build(track)
    if track.raceline is not None:
        for check in (_size, _arc_length, _heading_and_curvature, _wall_distances, _zero_speeds):
            check(track)
        # Where the order of the points is wrong, so are bends and walls: nothing to learn there.
        if not track.fatal:
            for check in (_bends, _self_crossing, _walls, _speeds):
                check(track)
    return Examination(track.raceline, tuple(track.findings))


class _Examined:
    """A table while it is examined: `columns` hold the points kept, `rows` their places in it."""

    def __init__(self, table):
        self.table = table
        self.columns = {key: np.asarray(c, dtype=float) for key, c in table.columns.items()}
        self.rows = np.arange(self.columns["x"].size)
        self.findings = list(table.findings)
        self.raceline = self.at = None
        self.s = None  # of every given point, where there is a curve

    @property
    def fatal(self):
        return any(finding.severity == ERROR for finding in self.findings)

    @property
    def xy(self):
        return np.stack((self.columns["x"], self.columns["y"]), axis=1)

    def keep(self, mask):
        self.columns = {key: column[mask] for key, column in self.columns.items()}
        self.rows = self.rows[mask]

    def add(self, code, severity, text, at=()):
        """A finding at points, given by their numbers among those kept."""
        rows = [int(self.rows[point]) for point in at[:MOST_PLACES]]
        self.add_rows(code, severity, text, rows)

    def add_rows(self, code, severity, text, rows=()):
        given, lines = self.table.columns, self.table.lines
        places = tuple(
            Place(
                row,
                None if lines is None else int(lines[row]),
                None if self.s is None else float(self.s[row]),
                float(given["x"][row]),
                float(given["y"][row]),
            )
            for row in rows
        )
        self.findings.append(Finding(code, severity, text, places))

    def located(self):
        """Arc lengths for the findings that were made before there was a curve."""
        for k, finding in enumerate(self.findings):
            places = tuple(p._replace(s=float(self.s[p.index])) for p in finding.places)
            self.findings[k] = finding._replace(places=places)


# -- what must be so before there is a curve -----------------------------------------------------


def _finite(track):
    """Numbers where numbers are needed; elsewhere what is not finite is not compared."""
    for key, column in list(track.columns.items()):
        finite = np.isfinite(column)
        far = np.abs(np.where(finite, column, 0.0)) > FARTHEST
        if key not in ("x", "y", "speed", "d_left", "d_right", "width"):
            bad = np.flatnonzero(~finite | far)
            if bad.size:
                text = f"{key} is no possible number at {points(bad.size)}: not compared"
                track.add("not-finite-unused", WARNING, text, bad)
                del track.columns[key]
            continue
        bad, far = np.flatnonzero(~finite), np.flatnonzero(far)
        if bad.size:
            more = f" and {bad.size - 1} more" if bad.size > 1 else ""
            text = f"expected a finite {key}, got {column[bad[0]]}{more}"
            track.add("not-finite", ERROR, text, bad)
        if far.size:
            text = f"expected {key} in meters and seconds, got {column[far[0]]:g}"
            track.add("impossible", ERROR, text, far)


def _speeds_possible(track):
    speed = track.columns.get("speed")
    if speed is not None:
        with np.errstate(invalid="ignore"):
            bad = np.flatnonzero(speed < 0.0)
        if bad.size:
            text = f"expected a speed >= 0 m/s, got {speed[bad[0]]:g}"
            track.add("negative-speed", ERROR, text, bad)


def _enough_points(track):
    if track.fatal:
        return
    count = int(np.count_nonzero(distinct_points(track.columns["x"], track.columns["y"])))
    if count < 4:
        track.add("few-points", ERROR, f"expected at least 4 distinct points, got {count}")


def _not_given(track):
    """A track without speeds or walls is often written with zeros there."""
    columns = track.columns
    if "width" in columns:
        columns["d_left"] = columns["d_right"] = 0.5 * columns.pop("width")
        track.add("total-width", NOTE, "one column of width: taken as the total, half to each side")
    for what, keys in (
        *(("arc length", ("s",)), ("speed", ("speed",))),
        ("wall distance", ("d_left", "d_right")),
    ):
        if all(key in columns for key in keys) and not any(np.any(columns[k]) for k in keys):
            for key in keys:
                del columns[key]
            track.add("all-zero", NOTE, f"every {what} is 0: taken as not given")
    for side, other in (("left", "right"), ("right", "left")):
        if f"d_{side}" in columns and f"d_{other}" not in columns:
            del columns[f"d_{side}"]
            track.add(
                "one-wall", WARNING, f"no distance to the {other} wall: that to the {side} not used"
            )


def _repeated(track):
    keep = distinct_points(track.columns["x"], track.columns["y"])
    kept = np.flatnonzero(keep)
    if kept[-1] + 1 < keep.size:
        track.add("closing-point", NOTE, "the last point repeats the first: dropped")
    repeated = np.flatnonzero(~keep[: kept[-1]])
    if repeated.size:
        text = f"{points(repeated.size, 'repeated')} dropped"
        track.add("repeated-points", WARNING, text, repeated)
    track.keep(keep)


def _loops(track):
    found = first_loop(track.xy)
    if found is not None:
        end, laps = found
        text = f"expected one loop, but the points make {laps}; the second begins"
        track.add("two-loops", ERROR, text, [end])


def first_loop(xy):
    """Where the second of several loops begins.

    Parameters
    ----------
    xy : ndarray, shape (n_points, 2)
        Distinct points of a closed track.

    Returns
    -------
    end, loops : int or None
        First point of the second loop, and how many loops there are, rounded, at least 2. None if
        there is but one: several are stretches apart from each other that close each on itself,
        or a track that comes along the same way again, in the same direction.
    """
    n = len(xy)
    if n < 8:
        return None
    ways = np.roll(xy, -1, axis=0) - xy
    chords = np.hypot(ways[:, 0], ways[:, 1])
    usual = float(np.median(chords))
    ends = np.flatnonzero(chords[:-1] > 10.0 * usual) + 1
    if ends.size:
        bounds = [0, *ends.tolist(), n]
        pieces = [xy[a:b] for a, b in zip(bounds, bounds[1:])]
        closed = (
            len(piece) >= 4 and np.hypot(*(piece[-1] - piece[0])) <= LARGEST_GAP * usual
            for piece in pieces
        )
        if all(closed):
            return bounds[1], len(pieces)
    # Driven more than once: many points have another one beside them, some way along the track,
    # that goes the same way. (So have start and end of a single lap, each other; and points in a
    # wrong order, which is another matter.)
    back = turns_back(xy)
    if np.any((back > 0) & (back < n - 1)):
        return None
    pick = np.unique(np.linspace(0, n - 1, min(n, 1000)).astype(int))
    test = np.linspace(0, pick.size - 1, min(pick.size, 60)).astype(int)
    s = np.cumsum(chords) - chords
    length, picked = float(chords.sum()), xy[pick]
    units = ways[pick] / chords[pick][:, None]
    wide = min(0.5, 0.05 * float(np.hypot(*np.ptp(xy, axis=0))))
    near = min(max(wide, 2.0 * length / pick.size), 0.04 * length)
    lag = np.abs(s[pick] - s[pick][test][:, None])
    beside = (
        (np.abs(picked[:, 0] - picked[test][:, :1]) < near)
        & (np.abs(picked[:, 1] - picked[test][:, 1:]) < near)
        & (units[test].dot(units.T) > 0.8)
        & (lag > 0.06 * length)
        & (length - lag > 2.0 * near)
    )
    again = beside.any(axis=1)
    if np.mean(again) < 0.15:
        return None
    lap = float(np.median(np.where(beside, lag, np.inf).min(axis=1)[again]))
    # The lap ends where the track is closest to its start again.
    off = np.abs(s - lap)
    around = np.flatnonzero(off <= max(0.25 * lap, off.min()))
    distance = np.hypot(*(xy[around] - xy[0]).T)
    return int(around[np.argmin(distance)]), max(2, int(round(length / lap)))


def _order(track):
    """Points that turn back, and an end that overlaps the start."""
    xy = track.xy
    count = overlap(xy)
    if count:
        last = len(xy) - count
        length = float(np.hypot(*(xy[-1] - xy[0])))
        text = f"the end overlaps the start by {length:.2f} m, {points(count)}"
        track.add("overlap", ERROR, text, range(last, len(xy)))
        return
    back = turns_back(xy)
    if back.size:
        track.add("turns-back", ERROR, f"the track turns back at {points(back.size)}", back)


def overlap(xy):
    """How many last points lie beyond the first, where the track begins again."""
    if len(xy) < 8:
        return 0
    ways = np.roll(xy, -1, axis=0) - xy
    closing, first, last = ways[-1], ways[0], ways[-2]
    size = math.hypot(*closing)
    if closing.dot(first) > -0.5 * size * math.hypot(*first) or closing.dot(last) > -0.5 * (
        size * math.hypot(*last)
    ):
        return 0
    usual = float(np.median(np.hypot(ways[:, 0], ways[:, 1])))
    before = (xy[0] - xy[::-1]).dot(-closing / size) > 0.5 * usual
    count = int(np.argmax(before))
    return count if count < len(xy) // 4 else 0


def turns_back(xy):
    """Points at which the way turns by more than `BACK`."""
    return np.flatnonzero(np.abs(turns(xy)) > BACK)


def turns(xy):
    """Turn at each point from the chord before to the chord after [rad]."""
    ways = np.roll(xy, -1, axis=0) - xy
    return wrap(np.diff(np.arctan2(ways[:, 1], ways[:, 0]), prepend=math.atan2(*ways[-1, ::-1])))


def _spacing(track):
    xy = track.xy
    chords = np.hypot(*(np.roll(xy, -1, axis=0) - xy).T)
    usual = float(np.median(chords))
    if chords[-1] > LARGEST_GAP * usual and not track.fatal:
        track.add(
            "gap",
            WARNING,
            f"the track is closed over a gap of {chords[-1]:.2f} m, "
            f"{chords[-1] / usual:.0f} times the usual spacing",
            [len(xy) - 1],
        )
    far = np.flatnonzero(chords[:-1] > LARGEST_SPACING * usual)
    if far.size:
        worst = far[np.argmax(chords[far])]
        track.add(
            "spacing",
            WARNING,
            f"{points(far.size)} more than {LARGEST_SPACING:g} times the usual {usual:.3f} m "
            f"before the next one, up to {chords[worst]:.2f} m",
            [worst],
        )
    turn = np.abs(turns(xy))
    coarse = np.flatnonzero((turn > COARSE) & (turn <= BACK))
    if coarse.size:
        worst = coarse[np.argmax(turn[coarse])]
        track.add(
            "coarse",
            WARNING,
            f"too few points for the bend at {points(coarse.size)}, so that the curve is a guess: "
            f"{turn[worst]:.2f} rad from one chord to the next",
            [worst],
        )


def _build(track):
    columns, table = track.columns, track.table
    try:
        raceline = Raceline(
            columns["x"],
            columns["y"],
            vx_mps=columns.get("speed"),
            d_left_m=columns.get("d_left"),
            d_right_m=columns.get("d_right"),
            name=table.name,
            source=table.source,
        )
    except RacelineError as error:
        text = str(error)[len(f"{table.source or table.name or 'raceline'}: ") :]
        rising = [key for key in ("x", "y") if np.all(np.diff(columns[key]) > 0.0)]
        if rising:
            text += f"; {rising[0]} only rises: is it the column of {rising[0]}?"
        track.add("open", ERROR, text)
        return
    track.raceline = raceline
    track.at = raceline.sample(raceline.s_points)
    given = np.full(len(table.columns["x"]), np.nan)
    given[track.rows] = raceline.s_points
    # Dropped points have the place of the one kept before them.
    last = np.maximum.accumulate(np.where(np.isfinite(given), np.arange(given.size), 0))
    track.s = given[last]
    track.located()


# -- what the table says, against the curve ------------------------------------------------------


def _arc_length(track):
    if "s" not in track.columns:
        return
    s = track.columns["s"]
    steps = np.diff(s)
    if np.mean(steps < 0.0) > 0.9:
        track.add(
            "reversed-arc-length",
            WARNING,
            "arc length falls from point to point: driven the other way round?",
        )
        return
    back = np.flatnonzero(steps <= 0.0) + 1
    if back.size:
        text = f"arc length does not rise at {points(back.size)}: recomputed"
        track.add("arc-length-order", WARNING, text, back)
    error = np.abs(s - s[0] - track.raceline.s_points)
    worst = int(np.argmax(error))
    if error[worst] > 0.01 * track.raceline.length:
        text = f"arc length is up to {error[worst]:.2f} m off the points': recomputed"
        track.add("arc-length", WARNING, text, [worst])


# Headings as files state them: code, severity, meaning, and the true one [rad] made of that.
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


def _heading_and_curvature(track):
    """Which direction the table calls zero, and which side positive."""
    columns, at = track.columns, track.at
    sign = _curvature(track) if "kappa" in columns else 0
    if "psi" not in columns:
        return
    fits = (
        (code, severity, meaning, np.abs(wrap(true(columns["psi"]) - at.psi)))
        for code, severity, meaning, true in _HEADINGS
    )
    code, severity, meaning, off = next(
        (fit for fit in fits if np.median(fit[3]) < 0.1), (None,) * 4
    )
    if code is None:
        off = np.abs(wrap(columns["psi"] - at.psi))
        track.add(
            "heading",
            WARNING,
            "heading does not fit the points: recomputed "
            f"(median difference {np.median(off):.2f} rad)",
        )
        return
    if code in ("heading-compass", "heading-clockwise") and sign < 0:
        how = "" if code == "heading-compass" else ", or one of them is mirrored"
        track.add(
            "swapped-xy" if code == "heading-compass" else "mirrored",
            WARNING,
            f"heading and curvature are those of the mirror image: x and y swapped{how}?",
        )
        return
    worst = np.percentile(off, 95)
    text = f"heading is {meaning}; fits the points within {worst:.3f} rad (95 %)"
    track.add(code, severity, text)
    wrong = int(np.argmax(off))
    if off[wrong] > max(0.3, 5.0 * worst) and not track.fatal:
        text = f"heading is {off[wrong]:.2f} rad off the points': recomputed"
        track.add("heading-point", WARNING, text, [wrong])


def _curvature(track):
    """Compare curvature; -1 if it is positive to the right, 1 if to the left, 0 if neither."""
    kappa, own = track.columns["kappa"], track.at.kappa
    scale = math.sqrt(np.mean(own**2))
    if math.sqrt(np.mean((kappa + own) ** 2)) < 0.5 * scale:
        track.add(
            "curvature-sign",
            WARNING,
            "curvature is positive to the right: recomputed, positive to the left",
        )
        return -1
    off = np.abs(kappa - own)
    if math.sqrt(np.mean(off**2)) > 0.5 * scale:
        if track.fatal:
            return 0
        worst = int(np.argmax(off))
        text = (
            "curvature does not fit the points: recomputed, largest difference "
            f"{off[worst]:.2f} 1/m"
        )
        track.add("curvature", WARNING, text, [worst])
        return 0
    return 1


def _size(track):
    length = track.raceline.length
    if not SHORTEST <= length <= LONGEST:
        text = (
            f"the track is {length:.3g} m long, those of 1:10 cars {SHORTEST:g} to {LONGEST:g} m: "
            "is it in meters?"
        )
        track.add("size", WARNING, text)


def _bends(track):
    kappa = np.abs(track.raceline.kappa)
    cell = int(np.argmax(kappa))
    if kappa[cell] > TIGHTEST:
        # A centerline need not be driven.
        severity = NOTE if track.raceline.speed is None else WARNING
        text = f"a bend of {1.0 / kappa[cell]:.2f} m radius: 1:10 cars need {1.0 / TIGHTEST:.1f} m"
        track.add("tight-bend", severity, text, [_point_near(track, cell)])


def _point_near(track, cell):
    """Number of the point closest to a cell, along the curve."""
    line = track.raceline
    away = np.abs(line.s_points - line.s[cell])
    return int(np.argmin(np.minimum(away, line.length - away)))


def _self_crossing(track):
    line = track.raceline
    pairs = crossings(np.stack((line.x, line.y), axis=1))
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
            at = [_point_near(track, cell) for cell in pairs[chosen, 0]]
            track.add(code, severity, text.format(float(loops[chosen].min())), at)


def _wall_distances(track):
    columns = track.columns
    if "d_left" not in columns:
        return
    for side in ("left", "right"):
        beyond = np.flatnonzero(columns[f"d_{side}"] < 0.0)
        if beyond.size:
            text = f"{points(beyond.size)} beyond the {side} wall"
            track.add("beyond-wall", WARNING, text, beyond)
    closed = np.flatnonzero(columns["d_left"] + columns["d_right"] <= 0.0)
    if closed.size:
        text = f"the walls leave no width at {points(closed.size)}"
        track.add("no-width", WARNING, text, closed)


def _walls(track):
    line = track.raceline
    if line.d_left is None:
        return
    if _swapped(line):
        track.add(
            "swapped-walls",
            WARNING,
            "the walls are smoother with left and right exchanged: swapped?",
        )
        return
    left, right = _wall(line, line.d_left), _wall(line, -line.d_right)
    widest = float(max(line.d_left.max(), line.d_right.max()))
    own = np.stack((line.x, line.y), axis=1)
    # A bend inside which the wall lies beyond the center of curvature.
    for side, d in (("left", line.d_left), ("right", -line.d_right)):
        folded = np.flatnonzero(line.kappa * d >= 1.0)
        if folded.size:
            worst = folded[np.argmax((line.kappa * d)[folded])]
            track.add(
                "wall-folds",
                NOTE,
                f"the {side} wall lies beyond the center of a bend over "
                f"{folded.size * line.ds:.2f} m, so it cannot be told there, farthest",
                [_point_near(track, worst)],
            )
    for name, a, b in (
        ("left wall crosses the track", own, left),
        ("right wall crosses the track", own, right),
        ("walls cross each other", left, right),
        ("left wall crosses itself", left, None),
        ("right wall crosses itself", right, None),
    ):
        pairs = crossings(a, b)
        # A wall meets the track at its own place where the distance is 0, and itself where it
        # folds inside of a bend: both are told above.
        apart = np.mod(pairs[:, 0] - pairs[:, 1], line.n)
        local = 2.0 if b is not None else _FOLD * max(widest, 0.0) / line.ds
        pairs = pairs[np.minimum(apart, line.n - apart) > local]
        if len(pairs):
            at = [_point_near(track, cell) for cell in pairs[:MOST_PLACES, 0]]
            track.add("walls-cross", WARNING, f"the {name} {_times(len(pairs))}", at)


def _times(count):
    return "once" if count == 1 else f"{count} times"


def _wall(line, d):
    return np.stack(line.to_cartesian(line.s, d), axis=1)


def _swapped(line):
    """Whether the distances to the walls are those of the other side.

    Real walls are smooth. On seven real racelines, two shipped ones and four centerlines they turn,
    all turns added up, 0.33 to 1.05 times as much as with the sides exchanged; racing lines also
    touch the inner wall in bends, so that left minus right correlates with the curvature by -0.99
    to 0.35. Constant distances tell nothing.
    """

    def turning(left, right):
        walls = _wall(line, left), _wall(line, -right)
        return sum(float(np.abs(turns(wall)).sum()) for wall in walls)

    ratio = turning(line.d_left, line.d_right) / turning(line.d_right, line.d_left)
    if ratio <= 1.1:
        return False
    difference = line.d_left - line.d_right
    if min(np.std(difference), np.std(line.kappa)) < 1e-9:
        return ratio > 1.25
    hugging = np.corrcoef(line.kappa, difference)[0, 1]
    return ratio > 1.25 or hugging > 0.5


def _zero_speeds(track):
    if "speed" in track.columns:
        zeros = np.flatnonzero(track.columns["speed"] == 0.0)
        if zeros.size:
            text = f"the speed is 0 at {points(zeros.size)}: the car stops there"
            track.add("zero-speed", WARNING, text, zeros)


def _speeds(track):
    line, columns = track.raceline, track.columns
    if line.speed is None:
        return
    v, kappa = columns["speed"], track.at.kappa
    a_x = accelerations(v, np.diff(np.append(line.s_points, line.length)))
    stated = columns.get("ax")
    if stated is not None and _in_kmh(track, stated, a_x):
        return
    a_y = v**2 * np.abs(kappa)
    worst = int(np.argmax(a_y))
    if a_y[worst] > GRIP:
        kmh = " (in km/h?)" if 3.0 * GRIP < a_y[worst] < KMH**2 * GRIP else ""
        text = f"the speeds ask for {a_y[worst]:.1f} m/s^2 of lateral acceleration{kmh}"
        track.add("too-fast", WARNING, text, [worst])
    worst = int(np.argmax(np.abs(a_x)))
    if abs(a_x[worst]) > GRIP:
        text = f"the speeds ask for {a_x[worst]:.1f} m/s^2 along the track"
        track.add("speed-jump", WARNING, text, [worst])


def _in_kmh(track, stated, a_x):
    """Compare accelerations with speeds; whether only km/h explains them."""
    weight = float(np.sum(stated**2))
    scale = math.sqrt(weight / stated.size)
    if scale < 0.05:
        if math.sqrt(np.mean(a_x**2)) > 0.5 and np.any(stated):
            track.add("acceleration", WARNING, "accelerations do not fit the speeds: recomputed")
        return False
    factor = float(np.sum(stated * a_x)) / weight
    if 0.85 < factor / KMH**2 < 1.15:
        track.add("kmh", WARNING, "the speeds fit the accelerations in km/h, not in m/s")
        return True
    off = np.abs(stated - a_x)
    if math.sqrt(np.mean(off**2)) > 0.5 * scale + 0.1:
        worst = int(np.argmax(off))
        track.add(
            "acceleration",
            WARNING,
            "accelerations do not fit the speeds: recomputed, largest difference "
            f"{off[worst]:.1f} m/s^2",
            [worst],
        )
    return False
