"""Centerline and widths of a track from a map image: occupancy grid and YAML file of map_server.

The car's center can go where the nearest wall is at least half a passage away. What remains of the
free space is a ring: one wall outside, one inside. The centerline is the curve between them that is
as far from one as from the other. Passages narrower than that are closed by this, and so are
gaps in walls.
"""

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from ..errors import FileFormatError, ParameterError, RacelineError
from ..files import read_yaml_mapping
from .findings import NOTE, WARNING, Finding
from .raceline import Raceline
from .walls import march, smooth_between

__all__ = ["MapImage", "track_from_map", "read_map_image"]

# What map_saver writes for a cell that no one has seen.
_UNSEEN = 205
# An image larger than this is none of a hall; Pillow would read it, and take all memory.
_MOST_PIXELS = 100_000_000
# Islands up to this part of the largest one's size are obstacles on the track, not tracks around.
_OBSTACLE = 1.0 / 3.0
# The centerline is smoothed over this part of the track's width.
_SMOOTHED = 0.15


class MapImage(NamedTuple):
    """Occupancy grid.

    Attributes
    ----------
    free : ndarray of bool, shape (rows, columns)
        Cells known to be free; the first row is the lowest.
    resolution : float
        Size of a cell [m].
    origin : tuple of float
        Pose of the lower left corner: x [m], y [m], yaw [rad].
    source : str
        The YAML file, for errors.
    findings : tuple of Finding
        What was found strange while reading.
    """

    free: np.ndarray
    resolution: float
    origin: tuple
    source: str
    findings: tuple

    def to_world(self, cells):
        """Positions [m] of cells, shape (n, 2): column and row, their centers at whole numbers."""
        x0, y0, yaw = self.origin
        x, y = self.resolution * (np.asarray(cells, dtype=float).T + 0.5)
        cos, sin = math.cos(yaw), math.sin(yaw)
        return np.stack((x0 + cos * x - sin * y, y0 + sin * x + cos * y), axis=-1)

    def to_cells(self, points):
        """The inverse of `to_world`."""
        x0, y0, yaw = self.origin
        x, y = np.asarray(points, dtype=float).T
        cos, sin = math.cos(yaw), math.sin(yaw)
        x, y = cos * (x - x0) + sin * (y - y0), cos * (y - y0) - sin * (x - x0)
        return np.stack((x, y), axis=-1) / self.resolution - 0.5


def read_map_image(path):
    """Read the YAML file of a map and its image.

    Parameters
    ----------
    path : str or pathlib.Path
        YAML file as map_saver writes it: ``image``, ``resolution``, ``origin``, ``negate``,
        ``occupied_thresh``, ``free_thresh``.

    Returns
    -------
    MapImage
        Unknown cells count as not free.

    Raises
    ------
    FileFormatError
        If a file cannot be read or a field is missing or impossible; the message names it.
    """
    path = Path(path)
    content = read_yaml_mapping(path)
    resolution = _number(path, content, "resolution")
    if not 1e-4 < resolution < 100.0:
        raise FileFormatError(f"{path}: resolution: expected meters per cell, got {resolution:g}")
    origin = content.get("origin")
    if not isinstance(origin, list) or len(origin) != 3:
        raise FileFormatError(f"{path}: origin: expected [x, y, yaw], got {origin!r}")
    origin = tuple(_number(path, {"origin": value}, "origin") for value in origin)
    free_below = _number(path, content, "free_thresh", 0.196)
    occupied_above = _number(path, content, "occupied_thresh", 0.65)
    if not 0.0 <= free_below <= occupied_above <= 1.0:
        raise FileFormatError(
            f"{path}: expected 0 <= free_thresh <= occupied_thresh <= 1, got {free_below:g} and "
            f"{occupied_above:g}"
        )
    negate = content.get("negate", 0)
    if negate not in (0, 1):
        raise FileFormatError(f"{path}: negate: expected 0 or 1, got {negate!r}")
    mode = content.get("mode", "trinary")
    if mode not in ("trinary", "scale"):
        raise FileFormatError(f"{path}: mode: expected trinary or scale, got {mode!r}")
    name = content.get("image")
    if not isinstance(name, str) or not name:
        raise FileFormatError(f"{path}: image: expected the name of a file, got {name!r}")
    gray = _gray(path.parent / name)

    # map_server's rule: how black a cell is tells how likely it is occupied.
    occupied = gray / 255.0 if negate else (255.0 - gray) / 255.0
    free = occupied < free_below
    findings = ()
    unseen = gray == _UNSEEN
    if not negate and (free & unseen).any() and np.isin(gray, (0, _UNSEEN, 254, 255)).all():
        free &= ~unseen
        text = (
            f"free_thresh {free_below:g} would make the {int(unseen.sum())} cells free that "
            f"map_saver wrote as unknown (gray {_UNSEEN}): taken as unknown"
        )
        findings = (Finding("unknown-cells", WARNING, text),)
    return MapImage(free[::-1], resolution, origin, str(path), findings)


def track_from_map(image, start, psi=None, *, passage, speckle=None, spacing=0.1):
    """Centerline with distances to the walls, from the free space around a start.

    Parameters
    ----------
    image : MapImage
    start : tuple of float
        A position on the track [m]; the lap begins beside it.
    psi : float, optional
        Direction of travel there [rad], to 90 degrees; counter-clockwise around the lap if not
        given.
    passage : float
        What is narrower than this is closed [m]: at least the car's width. More closes gaps in
        walls, and must still pass through the narrowest place of the track.
    speckle : float, optional
        Walls of less area than this are noise of the lidar, and are removed [m^2]; by default
        those of one and two cells.
    spacing : float, optional
        Distance of the points [m].

    Returns
    -------
    Raceline
        With `findings`.

    Raises
    ------
    ParameterError
        If a parameter is impossible or the start is not on free space.
    RacelineError
        If the free space makes no loop, or several.
    """
    for key, value in (("passage", passage), ("spacing", spacing)):
        if not 0.0 < value < math.inf:
            raise ParameterError(f"{key}: expected a positive length, got {value}")
    if not all(math.isfinite(value) for value in (*start, psi or 0.0)):
        raise ParameterError(f"start: expected finite numbers, got {start}, {psi}")
    name, resolution = image.source, image.resolution
    findings = list(image.findings)
    free, removed = _without_speckle(image, speckle)
    if removed:
        text = f"{removed} specks of walls removed as noise"
        findings.append(Finding("speckle", NOTE, text))

    # Beyond the image all is wall. The surface of a wall lies half a cell before its center.
    distance = np.maximum(ndimage.distance_transform_edt(np.pad(free, 1)) - 0.5, -0.5) * resolution
    room = distance >= 0.5 * passage
    labels, _ = ndimage.label(room)
    column, row = (int(round(value)) + 1 for value in image.to_cells(start))
    inside = 0 <= row < labels.shape[0] and 0 <= column < labels.shape[1]
    if not inside or not labels[row, column]:
        raise ParameterError(_bad_start(image, start, labels, distance, passage, row, column))
    ring = labels == labels[row, column]

    inner, outer, more = _two_sides(image, ring, passage)
    findings += more
    # Between the two sides the difference of the distances to them is 0.
    level = ndimage.distance_transform_edt(~inner) - ndimage.distance_transform_edt(~outer)
    cells = _zero_contour(level) - 1.0
    points = image.to_world(cells)

    def clear(at):
        where = image.to_cells(at).T[::-1] + 1.0
        return ndimage.map_coordinates(distance, where, order=1, mode="nearest")

    half = 0.5 * passage
    line, kept = _as_driven(_smooth(points, clear, half, spacing), start, psi)
    findings += kept
    at = np.stack((line.x, line.y), axis=1)
    normal = np.stack((-np.sin(line.psi), np.cos(line.psi)), axis=1)
    # As far as half a passage fits, so that no post between two normals is missed.
    farthest = float(distance.max()) * 4.0
    widths = [march(clear, at, side * normal, half, farthest) + half for side in (1.0, -1.0)]
    widths, openings = _without_openings(widths, line)
    if openings:
        x, y, deep = max(openings, key=lambda opening: opening[2])
        text = (
            f"{len(openings)} openings of the walls shorter than the track is wide closed, the "
            f"deepest, {deep:.1f} m, at ({x:.2f}, {y:.2f})"
        )
        findings.append(Finding("openings", NOTE, text))
    track = Raceline(
        *(line.x, line.y),
        d_left_m=widths[0],
        d_right_m=widths[1],
        name=Path(name).stem,
        source=name,
    )
    track.findings = tuple(findings)
    return track


def _number(path, content, key, default=None):
    value = content.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise FileFormatError(f"{path}: {key}: expected a number, got {value!r}")
    return float(value)


def _gray(path):
    """Gray values of an image, color channels averaged, transparency left out."""
    # Commands and nodes that read no map need no Pillow.
    from PIL import Image

    try:
        with Image.open(str(path)) as file:
            if file.size[0] * file.size[1] > _MOST_PIXELS:
                raise FileFormatError(
                    f"{path}: expected at most {_MOST_PIXELS} pixels, got {file.size[0]} x "
                    f"{file.size[1]}"
                )
            # Pillow clips what has more than 8 bits: nearly all would be white, so free.
            if file.mode in ("F", "I") or file.mode.startswith("I;"):
                return _of_16_bits(path, np.asarray(file))
            if file.mode not in ("L", "RGB"):
                file = file.convert("RGB")
            gray = np.asarray(file)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise FileFormatError(f"{path}: expected an image: {reason}") from None
    return gray if gray.ndim == 2 else gray.mean(axis=2)


def _of_16_bits(path, gray):
    """Gray values of an image of 16 bits in those of 8 bits, as map_server takes them."""
    if gray.dtype.kind == "f" or gray.min() < 0 or gray.max() > 65535:
        raise FileFormatError(f"{path}: expected gray values or colors of 8 or 16 bits")
    return np.asarray(gray // 256, dtype=np.uint8)


def _without_speckle(image, speckle):
    """Free space with the smallest walls removed, and how many those were."""
    limit = 2.5 * image.resolution**2 if speckle is None else speckle
    labels, count = ndimage.label(~image.free, structure=np.ones((3, 3)))
    sizes = np.bincount(labels.ravel(), minlength=count + 1) * image.resolution**2
    small = sizes < limit
    small[0] = False
    return image.free | small[labels], int(small.sum())


def _bad_start(image, start, labels, distance, passage, row, column):
    """Why a start cannot be one, and the nearest place that can."""
    where = f"{image.source}: start ({start[0]:.2f}, {start[1]:.2f})"
    if not labels.any():
        return f"{where}: no place on the map is {passage:.2f} m wide"
    rows, columns = np.nonzero(labels)
    k = int(np.argmin((rows - row) ** 2 + (columns - column) ** 2))
    x, y = image.to_world([[columns[k] - 1, rows[k] - 1]])[0]
    inside = 0 <= row < labels.shape[0] and 0 <= column < labels.shape[1]
    if not inside:
        reason = "is not on the map"
    elif distance[row, column] <= 0.0:
        reason = "is in a wall or on unknown ground"
    else:
        reason = f"is {distance[row, column]:.2f} m from a wall, less than {0.5 * passage:.2f} m"
    return f"{where} {reason}; the nearest place to start from is ({x:.2f}, {y:.2f})"


def _two_sides(image, ring, passage):
    """What lies inside and outside of the ring; obstacles on it belong to the nearer side."""
    labels, count = ndimage.label(~ring, structure=np.ones((3, 3)))
    outside = labels[0, 0]
    islands = [k for k in range(1, count + 1) if k != outside]
    if not islands:
        raise RacelineError(
            f"{image.source}: expected a track that goes round, but the free space around the "
            "start has no wall inside: is the start outside of the walls, or the inner wall not "
            "on the map?"
        )
    boxes = ndimage.find_objects(labels)
    extent = {
        k: math.hypot(*(part.stop - part.start for part in boxes[k - 1]))
        - passage / image.resolution
        for k in islands
    }
    islands.sort(key=lambda k: -extent[k])
    first = islands[0]
    large = [k for k in islands if extent[k] > _OBSTACLE * extent[first]]
    if len(large) > 1:
        places = ", ".join(
            f"({x:.1f}, {y:.1f}) of {extent[k] * image.resolution:.1f} m"
            for k in large[:4]
            for x, y in [_center(image, boxes[k - 1])]
        )
        raise RacelineError(
            f"{image.source}: expected one loop, but there are {len(large)} ways around: islands "
            f"around {places}. Close the way that is none with a black line in the image, or "
            f"gaps in walls with a passage wider than {passage:.2f} m"
        )
    inner, outer, findings = labels == first, labels == outside, []
    obstacles = islands[1:]
    gaps = [
        ndimage.minimum(ndimage.distance_transform_edt(labels != side), labels, obstacles)
        for side in (first, outside)
        if obstacles
    ]
    for k, to_inner, to_outer in zip(obstacles, *gaps):
        nearer = "inner" if to_inner < to_outer else "outer"
        x, y = _center(image, boxes[k - 1])
        text = f"obstacle at ({x:.2f}, {y:.2f}): closed toward the {nearer} wall"
        findings.append(Finding("obstacle", WARNING, text))
        side = inner if nearer == "inner" else outer
        side |= labels == k
    return inner, outer, findings


def _center(image, box):
    rows, columns = box
    middle = [[0.5 * (columns.start + columns.stop - 3), 0.5 * (rows.start + rows.stop - 3)]]
    return image.to_world(middle)[0]


def _zero_contour(level):
    """The closed curve around the negative values, as columns and rows, shape (n, 2).

    Marching squares: the curve crosses each edge between a negative and another value in the place
    that linear interpolation gives, and runs with the negative values to its left.
    """
    negative = level < 0.0
    following, place = {}, {}

    def crossing(row, column, vertical):
        key = (row, column, vertical)
        if key not in place:
            a = level[row, column]
            b = level[row + 1, column] if vertical else level[row, column + 1]
            part = a / (a - b)
            place[key] = (column, row + part) if vertical else (column + part, row)
        return key

    low, high = negative[:-1], negative[1:]
    corners = low[:, :-1] + 2 * low[:, 1:] + 4 * high[:, 1:] + 8 * high[:, :-1]
    for row, column in np.argwhere((corners > 0) & (corners < 15)).tolist():
        # Edges counter-clockwise from the lower one; each with whether its first end is negative.
        case = int(corners[row, column])
        edges = (
            (row, column, False),
            (row, column + 1, True),
            (row + 1, column, False),
            (row, column, True),
        )
        signs = [bool(case >> k & 1) for k in range(4)]
        # Going round the cell, the curve leaves where the sign turns from negative.
        leaves = [k for k in range(4) if signs[k] and not signs[(k + 1) % 4]]
        enters = [k for k in range(4) if not signs[k] and signs[(k + 1) % 4]]
        for k in leaves:
            # Of two pairs each keeps its negative corner apart.
            end = enters[0] if len(enters) == 1 else (k - 1) % 4
            following[crossing(*edges[k])] = crossing(*edges[end])
    longest = []
    left = set(following)
    while left:
        first = left.pop()
        curve, key = [first], following[first]
        while key != first:
            left.discard(key)
            curve.append(key)
            key = following[key]
        longest = max(longest, curve, key=len)
    return np.array([place[key] for key in longest], dtype=float)


def _smooth(points, clear, half, spacing):
    """Even points along a closed curve without its steps and kinks, at most half a cell apart."""
    closed = np.concatenate((points, points[:1]))
    s = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))))
    count = 2 * len(points)
    at = np.arange(count) * (s[-1] / count)
    even = np.stack([np.interp(at, s, column) for column in closed.T], axis=1)
    # Where another wall becomes the nearest the curve has a kink.
    deviation = _SMOOTHED * 2.0 * float(np.median(clear(even)))
    even, _ = smooth_between(even, s[-1], deviation, clear, half)
    line = Raceline(*even.T)
    at = line.sample(np.linspace(0.0, line.length, max(8, round(line.length / spacing)), False))
    return Raceline(at.x, at.y)


def _as_driven(line, start, psi):
    """The line from its point beside the start, in the direction of travel."""
    findings = []
    place = line.project(*start)
    if psi is None:
        area = 0.5 * np.sum(line.x * np.roll(line.y, -1) - line.y * np.roll(line.x, -1))
        backwards = area < 0.0
        text = "no direction given: driven counter-clockwise"
        findings.append(Finding("direction", NOTE, text))
    else:
        backwards = math.cos(place.psi - psi) < 0.0
        if abs(math.cos(place.psi - psi)) < 0.26:
            raise ParameterError(
                f"start: the track there runs at {place.psi:.2f} rad or the other way: expected a "
                f"direction within 75 degrees of it, got {psi:.2f} rad"
            )
    line = line.rotated(place.s)
    return (line.reversed() if backwards else line), findings


def _without_openings(widths, line):
    """Widths without what is deep and short, a gap in a wall, and where that was."""
    window = max(3, int(round(float(np.median(widths[0] + widths[1])) / line.ds)) | 1)
    window = min(window, line.n // 4 * 2 + 1)
    result, openings = [], []
    for side, width in zip((1.0, -1.0), widths):
        closed = ndimage.grey_opening(width, window, mode="wrap")
        deep = width > closed + 0.5 * float(np.median(width))
        labels, _ = ndimage.label(deep)
        for k in range(1, labels.max() + 1):
            i = int(np.flatnonzero(labels == k)[np.argmax(width[labels == k])])
            x, y = line.to_cartesian(line.s[i], side * closed[i])
            openings.append((float(x), float(y), float(width[i] - closed[i])))
        result.append(np.where(deep, closed, width))
    return result, openings
