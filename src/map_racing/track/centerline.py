"""Centerline and widths of a track from a map image.

The car's center can go where the nearest wall is at least half a passage away. This closes narrower
passages and gaps in walls, and leaves a ring of free space with one wall outside and one inside.
The centerline is the curve in the ring that is equally far from both walls.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Sequence

import numpy as np
from scipy import ndimage

from ..errors import ParameterError, RacelineError
from .contour import zero_contour
from .corners import runs_around
from .findings import NOTE, WARNING, Finding
from .map_image import MapImage, edge_finding
from .normals import points_and_normals
from .raceline import Raceline
from .walls import march, smooth_between

__all__ = ["track_from_map", "walls_from_map", "widest_place"]

# Islands up to this share of the size of the largest are obstacles on the track.
_OBSTACLE = 1.0 / 3.0
# At a gap the distance to the wall jumps by at least this much, relative to its median.
_JUMP = 1.0
# The centerline is smoothed over this share of the track width.
_SMOOTHED = 0.15
_SPACING = 0.1  # of the centerline's points [m]


def track_from_map(
    image: MapImage,
    start: Sequence[float],
    psi: float | None = None,
    *,
    passage: float,
    speckle: float | None = None,
) -> Raceline:
    """Find the centerline of the free space around a start, with distances to the walls.

    Parameters
    ----------
    image : MapImage
    start : tuple of float
        A position on the track [m]; the lap begins beside it.
    psi : float, optional
        Direction of travel there [rad], to within 75 degrees; by default counter-clockwise.
    passage : float
        Close passages narrower than this [m], at least the car's width. A larger value closes gaps
        in walls; the narrowest place of the track must still be wider.
    speckle : float, optional
        Remove walls of less area than this as lidar noise [m^2]; by default walls of one or two
        cells.

    Returns
    -------
    Raceline

    Raises
    ------
    ParameterError
        If a parameter is impossible or the start is not on free space.
    RacelineError
        If the free space forms no loop, or several.
    """
    if not 0.0 < passage < math.inf:
        raise ParameterError(f"passage: expected more than 0 m, got {passage}")
    if not all(math.isfinite(value) for value in (*start, psi or 0.0)):
        raise ParameterError(f"start: expected finite numbers, got {start}, {psi}")
    name = image.source
    _, distance, findings = _free_space(image, speckle)
    room = distance >= 0.5 * passage
    labels, _ = ndimage.label(room)
    column, row = (int(round(value)) + 1 for value in image.to_cells(start))
    inside = 0 <= row < labels.shape[0] and 0 <= column < labels.shape[1]
    if not inside or not labels[row, column]:
        raise ParameterError(_bad_start(image, start, labels, distance, passage, row, column))
    ring = labels == labels[row, column]

    _check_not_cut(image, ring, distance, (row, column), passage)
    findings += edge_finding(image, ring[1:-1, 1:-1], passage)
    inner, outer, more = _two_sides(image, ring, passage)
    findings += more
    # On the centerline the distances to both sides are equal.
    level = ndimage.distance_transform_edt(~inner) - ndimage.distance_transform_edt(~outer)
    cells = zero_contour(level) - 1.0
    points = image.to_world(cells)

    clear = _clearance(image, distance)
    half = 0.5 * passage
    line, kept = _oriented(_smooth(points, clear, half), start, psi)
    findings += kept
    widths, more = _widths(line, clear, half, 4.0 * float(distance.max()))
    findings += more
    track = Raceline(
        line.x,
        line.y,
        d_left_m=widths[0],
        d_right_m=widths[1],
        name=Path(name).stem,
        source=name,
    )
    track.findings = tuple(findings)
    return track


def widest_place(image: MapImage, speckle: float | None = None) -> tuple[float, float] | None:
    """Place in the largest free space that is farthest from walls, to suggest as a start.

    Parameters
    ----------
    image : MapImage
    speckle : float, optional
        As for `track_from_map`.

    Returns
    -------
    tuple of float or None
        x and y [m]; None for a map without free space.
    """
    free, distance, _ = _free_space(image, speckle)
    labels, count = ndimage.label(free)
    if not count:
        return None
    sizes = np.bincount(labels.ravel())
    sizes[0] = 0
    inside = np.where(labels == np.argmax(sizes), distance[1:-1, 1:-1], -1.0)
    row, column = np.unravel_index(np.argmax(inside), inside.shape)
    x, y = image.to_world([[column, row]])[0]
    return float(x), float(y)


def walls_from_map(image: MapImage, line: Raceline) -> tuple[np.ndarray, np.ndarray, list[Finding]]:
    """Distances from a line to the walls of a map, across the line.

    Parameters
    ----------
    image : MapImage
    line : Raceline

    Returns
    -------
    left, right : ndarray, shape (n,)
        At the cells of the line [m].
    findings : list of Finding

    Raises
    ------
    RacelineError
        If the line leaves the free space.
    """
    _, distance, findings = _free_space(image, None)
    clear = _clearance(image, distance)
    inside = clear(np.stack((line.x, line.y), axis=1))
    if np.min(inside) <= 0.0:
        at = int(np.argmin(inside))
        raise RacelineError(
            f"{image.source}: the line leaves the free space of the map at s = {line.s[at]:.2f} m, "
            f"({line.x[at]:.2f}, {line.y[at]:.2f}): is it the map of that drive?"
        )
    half = min(0.5 * float(np.min(inside)), image.resolution)
    (left, right), more = _widths(line, clear, half, 4.0 * float(distance.max()))
    return left, right, findings + more


def _clearance(image, distance):
    """Function that maps points to their distances to the nearest wall."""

    def clear(at):
        where = image.to_cells(at).T[::-1] + 1.0
        return ndimage.map_coordinates(distance, where, order=1, mode="nearest")

    return clear


def _widths(line, clear, half, farthest):
    """Distances from a line to the walls, with openings closed, and findings."""
    at, normal = points_and_normals(line)
    # March with a clearance of half a passage, so that no post between two normals is missed.
    widths = [march(clear, at, side * normal, half, farthest) + half for side in (1.0, -1.0)]
    widths, openings = _without_openings(widths, line)
    if not openings:
        return widths, []
    x, y, deep = max(openings, key=lambda opening: opening[2])
    text = (
        f"{len(openings)} opening{'s' * (len(openings) != 1)} in the walls, shorter than the track "
        f"width, closed; the deepest, {deep:.1f} m, at ({x:.2f}, {y:.2f})"
    )
    return widths, [Finding("openings", NOTE, text)]


def _free_space(image, speckle):
    """Free cells, with the smallest walls removed; wall distances [m]; findings.

    The distances include a margin of one cell around the map.
    """
    limit = 2.5 * image.resolution**2 if speckle is None else speckle
    labels, count = ndimage.label(~image.free, structure=np.ones((3, 3)))
    sizes = np.bincount(labels.ravel(), minlength=count + 1) * image.resolution**2
    small = sizes < limit
    small[0] = False
    free, findings = image.free | small[labels], list(image.findings)
    if small.any():
        count = int(small.sum())
        text = f"{count} speck{'s' * (count != 1)} removed from the walls as noise"
        findings.append(Finding("speckle", NOTE, text))
    # Outside the image everything is wall. A wall's surface is half a cell before its center.
    apart = np.maximum(ndimage.distance_transform_edt(np.pad(free, 1)) - 0.5, -0.5)
    return free, apart * image.resolution, findings


def _bad_start(image, start, labels, distance, passage, row, column):
    """Message saying why the start is not on the track, and the nearest place that is."""
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
    text = f"{where} {reason}; the nearest place to start from is ({x:.2f}, {y:.2f})"
    if image.origin[2] != 0.0:
        column, row = image._replace(origin=(*image.origin[:2], 0.0)).to_cells(start)
        row, column = int(round(row)) + 1, int(round(column)) + 1
        if 0 <= row < labels.shape[0] and 0 <= column < labels.shape[1] and labels[row, column]:
            text += (
                f". Without the yaw of the map's origin, {image.origin[2]:g} rad, it would be on "
                "the track: was it taken from a program that ignores the yaw?"
            )
    return text


def _check_not_cut(image, ring, distance, start, passage):
    """Refuse a passage so wide that it closes the track itself somewhere."""
    if _encloses(ring):
        return
    # Bisect for the widest passage, to within a cell, that leaves the track open.
    low, high = 0.0, passage
    if not _encloses(_around(distance > 0.0, start)):
        return
    while high - low > 0.5 * image.resolution:
        middle = 0.5 * (low + high)
        opened = _encloses(_around(distance >= 0.5 * middle, start))
        low, high = (middle, high) if opened else (low, middle)
    row, column = _narrowest(_around(distance >= 0.5 * low, start))
    x, y = image.to_world([[column - 1, row - 1]])[0]
    raise RacelineError(
        f"{image.source}: a passage of {passage:.2f} m closes the track itself, which is "
        f"{low:.2f} m wide near ({x:.2f}, {y:.2f}): choose a narrower passage (--passage "
        f"{math.floor(20.0 * low) / 20.0:.2f}; a car must still fit)"
    )


def _around(room, start):
    """The connected part of the room that contains a cell; empty if the cell is outside."""
    labels, _ = ndimage.label(room)
    return (labels == labels[start]) & (labels[start] > 0)


def _narrowest(ring):
    """The cell of a ring where its two sides are closest."""
    labels, _ = ndimage.label(~ring, structure=np.ones((3, 3)))
    outside = labels[0, 0]
    sizes = np.bincount(labels.ravel())
    sizes[[0, outside]] = 0
    apart = sum(
        ndimage.distance_transform_edt(labels != side) for side in (outside, np.argmax(sizes))
    )
    return np.unravel_index(np.argmin(np.where(ring, apart, np.inf)), ring.shape)


def _encloses(ring):
    """Whether a region encloses other cells."""
    return ndimage.label(~ring, structure=np.ones((3, 3)))[1] > 1


def _two_sides(image, ring, passage):
    """Cells inside and outside the ring; obstacles on it belong to the nearer side."""
    labels, count = ndimage.label(~ring, structure=np.ones((3, 3)))
    outside = labels[0, 0]
    islands = [k for k in range(1, count + 1) if k != outside]
    if not islands:
        raise RacelineError(
            f"{image.source}: expected a closed track, but the free space around the start has no "
            "wall inside: is the start outside the walls, or the inner wall not on the map?"
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
            f"{image.source}: expected one loop, got {len(large)} ways around islands at {places}. "
            f"Close wrong ways with a black line in the image, or gaps in walls with a passage "
            f"wider than {passage:.2f} m"
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
        text = f"obstacle at ({x:.2f}, {y:.2f}): joined to the {nearer} wall"
        findings.append(Finding("obstacle", WARNING, text))
        side = inner if nearer == "inner" else outer
        side |= labels == k
    return inner, outer, findings


def _center(image, box):
    rows, columns = box
    middle = [[0.5 * (columns.start + columns.stop - 3), 0.5 * (rows.start + rows.stop - 3)]]
    return image.to_world(middle)[0]


def _smooth(points, clear, half):
    """Smooth a closed curve, removing the steps of the cells and kinks; evenly spaced points."""
    closed = np.concatenate((points, points[:1]))
    s = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(closed, axis=0).T))))
    count = 2 * len(points)
    at = np.arange(count) * (s[-1] / count)
    even = np.stack([np.interp(at, s, column) for column in closed.T], axis=1)
    # The curve has a kink where a different wall becomes the nearest.
    deviation = _SMOOTHED * 2.0 * float(np.median(clear(even)))
    even, _ = smooth_between(even, s[-1], deviation, clear, half)
    line = Raceline(*even.T)
    at = line.sample(np.linspace(0.0, line.length, max(8, round(line.length / _SPACING)), False))
    return Raceline(at.x, at.y)


def _oriented(line, start, psi):
    """The line in the direction of travel, beginning beside the start, and findings."""
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
                f"start: expected a direction within 75 degrees of the track, {place.psi:.2f} rad "
                f"or the opposite, got {psi:.2f} rad"
            )
    line = line.rotated(place.s)
    return (line.reversed() if backwards else line), findings


def _without_openings(widths, line):
    """Close deep, short gaps in the walls; return the widths, and place and depth of each gap.

    In the corner of a room the width changes from point to point by little more than their spacing;
    at a gap it jumps.
    """
    window = max(3, int(round(float(np.median(widths[0] + widths[1])) / line.ds)) | 1)
    window = min(window, line.n // 4 * 2 + 1)
    result, openings = [], []
    for side, width in zip((1.0, -1.0), widths):
        closed = ndimage.grey_opening(width, window, mode="wrap")
        deep = width > closed + 0.5 * float(np.median(width))
        for cells in runs_around(deep):
            i = int(cells[np.argmax(width[cells])])
            around = np.arange(cells[0] - 2, cells[0] + cells.size + 2) % width.size
            if np.max(np.abs(np.diff(width[around]))) < _JUMP * float(np.median(width)):
                deep[cells] = False
                continue
            x, y = line.to_cartesian(line.s[i], side * closed[i])
            openings.append((float(x), float(y), float(width[i] - closed[i])))
        result.append(np.where(deep, closed, width))
    return result, openings
