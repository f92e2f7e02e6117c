"""Random tracks from a seed: smooth closed racelines with walls.

A track is drawn as a closed polygon with corners rounded by arcs. Smoothing that line with a narrow
Gaussian gives the centerline, with continuous curvature; smoothing it with a wider one gives the
raceline, which cuts the corners by about half the variance times the curvature. Walls follow the
centerline at a constant distance.

Random numbers come from `random.Random`, whose sequence of `random()` is the same in all versions
of Python. A seed therefore gives the same track everywhere up to rounding: less than 1e-9 m with
all versions of numpy tried.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass

import numpy as np

from ..errors import ParameterError
from ..validation import positive
from .crossings import Polyline, crossings
from .raceline import Raceline
from .speed_profile import raceline_speeds

__all__ = ["TrackShape", "draw_track", "rounded_polygon", "smoothed", "wall_distance"]

STEP = 0.02  # of the drawn line [m]
SPACING = 0.1  # of the points of a raceline [m]

# Number of corners in addition to the straights, their largest radius, and the least lap length per
# corner, the latter two relative to the tightest radius.
CORNERS, WIDEST, ROOM = (3, 7), 3.5, 5.0
# Laps longer than this, relative to the tightest radius, bend both ways; shorter ones lack the
# room. Bends to the minor side have at least this share of the tightest curvature.
BOTH_WAYS, SOME_BEND = 25.0, 0.15
# Smoothing of the centerline and of the raceline, as shares of the tightest radius.
CENTERLINE, RACELINE = 0.25, 0.55
# Number of attempts before a shape counts as impossible; only the first ones must bend both ways.
MOST_TRIES, INSISTENT_TRIES = 2000, 400
# Thickness of the wall between two stretches that run side by side [m].
WALL = 0.1


@dataclass(frozen=True)
class TrackShape:
    """Shape of a generated track, and limits for its speeds.

    Parameters
    ----------
    length : float
        Length of the raceline [m], to 2 %.
    tightest_radius : float
        Least radius of curvature of the raceline [m], to 5 %.
    straights : int
        Number of long straights, 0 to 4.
    width : float
        From wall to wall [m].
    left : bool
        Whether the lap runs counter-clockwise; if there is room, it bends both ways in any case.
    a_lat_max_mps2, a_drive_max_mps2, a_brake_max_mps2 : float
        Friction ellipse of the vehicle for which the speeds are made [m/s^2].
    v_max_mps : float
        Largest speed [m/s].
    beyond : float
        Factor on the lateral limit; above 1 the speeds deliberately exceed the grip.

    Raises
    ------
    ParameterError
        For an impossible value, naming it.
    """

    length: float = 40.0
    tightest_radius: float = 1.0
    straights: int = 2
    width: float = 2.0
    left: bool = True
    a_lat_max_mps2: float = 7.0
    a_drive_max_mps2: float = 7.0
    a_brake_max_mps2: float = 7.0
    v_max_mps: float = 10.0
    beyond: float = 1.0

    def __post_init__(self):
        for name in (
            *("length", "tightest_radius", "width", "v_max_mps", "beyond"),
            *("a_lat_max_mps2", "a_drive_max_mps2", "a_brake_max_mps2"),
        ):
            positive(name, getattr(self, name))
        if not isinstance(self.straights, int) or not 0 <= self.straights <= 4:
            raise ParameterError(f"straights: expected 0 to 4, got {self.straights!r}")
        if self.length < 12.0 * self.tightest_radius:
            raise ParameterError(
                f"length: expected at least 12 times tightest_radius, got {self.length:g} m with "
                f"{self.tightest_radius:g} m"
            )
        if self.width > 2.0 * self.tightest_radius:
            raise ParameterError(
                f"width: expected at most twice tightest_radius, got {self.width:g} m with "
                f"{self.tightest_radius:g} m: the walls would cross in the bend"
            )


def draw_track(seed, shape=None, name=""):
    """Draw a track.

    Parameters
    ----------
    seed : int
    shape : TrackShape, optional
    name : str, optional
        Name of the raceline; by default ``track<seed>``.

    Returns
    -------
    Raceline
        With speeds and walls.

    Raises
    ------
    ParameterError
        If no track of this shape is found with this seed.
    """
    shape = shape or TrackShape()
    draw = random.Random(f"track {seed}").random
    for attempt in range(MOST_TRIES):
        corners = _corners(draw, shape)
        raceline = corners and _fitted(corners, shape, attempt < INSISTENT_TRIES)
        if raceline:
            speed, _ = raceline_speeds(
                raceline,
                a_lat_max=shape.beyond * shape.a_lat_max_mps2,
                a_drive_max=shape.a_drive_max_mps2,
                a_brake_max=shape.a_brake_max_mps2,
                v_max=shape.v_max_mps,
            )
            return Raceline(
                raceline.x,
                raceline.y,
                vx_mps=speed,
                d_left_m=raceline.d_left,
                d_right_m=raceline.d_right,
                name=name or f"track{seed}",
            )
    raise ParameterError(f"seed {seed}: no track of this shape was found: {shape}")


def _corners(draw, shape):
    """Corners around a center as angle, distance (at most 1) and radius [m], or None.

    Corners at the ends of straights are farther apart.
    """
    count = shape.straights + CORNERS[0] + int(draw() * (CORNERS[1] - CORNERS[0] + 1))
    count = max(3, min(count, int(shape.length / (ROOM * shape.tightest_radius))))
    wide = 2.2 if count > 4 else 1.3  # with few corners, none can be far from all others
    gaps = [(wide if k < shape.straights else 1.0) * (0.8 + 0.4 * draw()) for k in range(count)]
    for k in range(count - 1, 0, -1):  # shuffle
        other = int(draw() * (k + 1))
        gaps[k], gaps[other] = gaps[other], gaps[k]
    if max(gaps) > 0.42 * sum(gaps):
        return None
    radii = [shape.tightest_radius * (1.0 + (WIDEST - 1.0) * draw()) for _ in range(count)]
    radii[int(draw() * count)] = shape.tightest_radius
    angle, corners = 0.0, []
    for gap, radius in zip(gaps, radii):
        corners.append((angle, 0.35 + 0.65 * draw(), radius))
        angle += gap / sum(gaps) * 2.0 * math.pi
    return corners


def _fitted(corners, shape, insist):
    """Raceline with walls through scaled corners; None if the shape cannot be met."""
    size, shrink = shape.length / 5.0, 0.85
    side = 1.0 if shape.left else -1.0
    for _ in range(12):
        drawn = _with_fitting_radii(
            [
                (size * away * math.cos(angle), side * size * away * math.sin(angle), radius)
                for angle, away, radius in corners
            ]
        )
        if min(radius for _, _, radius in drawn) < 0.8 * shape.tightest_radius:
            return None
        path = rounded_polygon([(x, y, shrink * radius) for x, y, radius in drawn])
        length, kappa = _length_and_curvature(path, RACELINE * shape.tightest_radius)
        off_length = shape.length / length
        off_radius = shape.tightest_radius * np.max(np.abs(kappa))
        if abs(off_length - 1.0) < 0.018 and abs(off_radius - 1.0) < 0.045:
            both_ways = min(-kappa.min(), kappa.max()) * shape.tightest_radius > SOME_BEND
            has_room = shape.length > BOTH_WAYS * shape.tightest_radius
            return _walled(path, shape) if both_ways or not (has_room and insist) else None
        size *= off_length
        shrink = min(max(shrink * off_radius, 0.3), 1.05)
    return None


def _with_fitting_radii(corners):
    """The corners, with radii reduced so that each arc uses at most half of either side."""
    points = np.array([corner[:2] for corner in corners])
    sides = np.roll(points, -1, axis=0) - points
    length = np.hypot(sides[:, 0], sides[:, 1])
    heading = np.arctan2(sides[:, 1], sides[:, 0])
    turn = np.abs(np.mod(heading - np.roll(heading, 1) + math.pi, 2.0 * math.pi) - math.pi)
    room = 0.46 * np.minimum(length, np.roll(length, 1)) / np.tan(0.5 * turn)
    return [(x, y, min(radius, most)) for (x, y, radius), most in zip(corners, room.tolist())]


def _length_and_curvature(path, deviation):
    """Length [m] and curvature [1/m] of the path from `smoothed`, without building it."""
    wave = 1j * np.fft.fftfreq(len(path), STEP) * 2.0 * math.pi
    spectrum = np.fft.fft(path[:, 0] + 1j * path[:, 1])
    spectrum *= np.exp(-0.5 * (wave.imag * deviation) ** 2)
    way, bend = np.fft.ifft(spectrum * wave), np.fft.ifft(spectrum * wave * wave)
    kappa = (way.real * bend.imag - way.imag * bend.real) / np.abs(way) ** 3
    return float(np.sum(np.abs(way)) * STEP), kappa


def _walled(path, shape):
    """The raceline with walls beside the centerline; None if they cross or touch."""
    half = 0.5 * shape.width
    centerline = smoothed(path, CENTERLINE * shape.tightest_radius)
    if np.max(np.abs(centerline.kappa)) * half > 0.98:
        return None
    beside = half, -half, half + 0.5 * WALL, -half - 0.5 * WALL
    walls = [Polyline(np.stack(centerline.to_cartesian(centerline.s, d), axis=1)) for d in beside]
    if any(crossings(wall).size for wall in walls) or crossings(*walls[2:]).size:
        return None
    raceline = smoothed(path, RACELINE * shape.tightest_radius)
    count = round(raceline.length / SPACING)
    at = raceline.sample(np.arange(count) * (raceline.length / count))
    line = Raceline(at.x, at.y)
    left, right = (wall_distance(line, centerline, half, side) for side in (1, -1))
    if min(left.min(), right.min()) < 0.25 * half:
        return None
    return Raceline(line.x, line.y, d_left_m=left, d_right_m=right)


def rounded_polygon(corners, step=STEP):
    """Points of a closed polygon with rounded corners, starting in the middle of its first side.

    Parameters
    ----------
    corners : list of tuple
        x, y and radius of each corner [m].
    step : float, optional
        Spacing of the points [m].

    Returns
    -------
    ndarray, shape (n, 2)
        Points [m].

    Raises
    ------
    ValueError
        If the arc of a corner would begin before the previous one ends.
    """
    vertices = np.array([corner[:2] for corner in corners])
    middle = 0.5 * (vertices[0] + vertices[1])
    path = [middle]
    order = [*range(1, len(corners)), 0]
    for k in order:
        vertex, radius = vertices[k], corners[k][2]
        into = vertex - vertices[k - 1]
        out = vertices[(k + 1) % len(corners)] - vertex
        into, out = into / np.hypot(*into), out / np.hypot(*out)
        turn = math.atan2(into[0] * out[1] - into[1] * out[0], into.dot(out))
        reach = radius * math.tan(0.5 * abs(turn))
        if np.dot(vertex - reach * into - path[-1], into) < 0.0:
            raise ValueError(f"the arc of corner {corners[k]} begins before the last one ends")
        left = math.copysign(1.0, turn) * np.array([-into[1], into[0]])
        center = vertex - reach * into + radius * left
        parts = np.linspace(0.0, 1.0, 1 + math.ceil(abs(turn) * radius / step))[:, None]
        angle = np.abs(parts * turn)
        path.extend(center - radius * (np.cos(angle) * left - np.sin(angle) * into))
    if np.dot(middle - path[-1], vertices[1] - vertices[0]) < 0.0:
        raise ValueError(f"the arc of corner {corners[0]} ends beyond the middle of its side")
    path = np.array([*path, middle])
    s = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))))
    at = np.arange(0.0, s[-1] - 0.5 * step, step)
    return np.stack((np.interp(at, s, path[:, 0]), np.interp(at, s, path[:, 1])), axis=1)


def smoothed(path, deviation, step=STEP):
    """Smooth a closed path by a Gaussian.

    Parameters
    ----------
    path : ndarray, shape (n, 2)
        Points [m].
    deviation : float
        Standard deviation [m].
    step : float, optional
        Spacing of the points [m].

    Returns
    -------
    Raceline
    """
    wave = np.fft.fftfreq(len(path), step) * 2.0 * math.pi
    blur = np.exp(-0.5 * (wave * deviation) ** 2)
    x, y = (np.fft.ifft(np.fft.fft(column) * blur).real for column in path.T)
    return Raceline(x, y)


def wall_distance(raceline, centerline, half_width, side):
    """Distance along the raceline's normals to a wall beside the centerline.

    Parameters
    ----------
    raceline, centerline : Raceline
    half_width : float
        Distance of the wall from the centerline [m].
    side : int
        +1 for the left wall, -1 for the right one.

    Returns
    -------
    ndarray, shape (n,)
        At the raceline's cells [m].
    """
    wall = np.stack(centerline.to_cartesian(centerline.s, side * half_width), axis=1)
    feet = [raceline.project(x, y) for x, y in wall.tolist()]
    s, d = np.array([foot.s for foot in feet]), np.array([foot.d for foot in feet])
    order = np.argsort(s)
    return side * np.interp(raceline.s, s[order], d[order], period=raceline.length)
