"""Map images: the occupancy grid and YAML file of map_server."""

from __future__ import annotations

import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from ..errors import FileFormatError
from ..files import read_yaml_mapping
from ..validation import FARTHEST
from .findings import NOTE, WARNING, Finding

__all__ = ["MapImage", "edge_finding", "read_map_image"]

# Gray value and free_thresh that map_saver writes for unknown cells.
_UNSEEN, _SAVERS_FREE = 205, 0.196
# Larger images are refused, because Pillow would use up all memory.
_MOST_PIXELS = 100_000_000


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
        The YAML file, for error messages.
    findings : tuple of Finding
        Findings made while reading.
    """

    free: np.ndarray
    resolution: float
    origin: tuple[float, float, float]
    source: str
    findings: tuple[Finding, ...]

    def to_world(self, cells: np.ndarray) -> np.ndarray:
        """Positions of cells in the world.

        Parameters
        ----------
        cells : array_like, shape (n, 2)
            Column and row; centers of cells are at whole numbers.

        Returns
        -------
        ndarray, shape (n, 2)
            x and y [m].
        """
        x0, y0, yaw = self.origin
        x, y = self.resolution * (np.asarray(cells, dtype=float).T + 0.5)
        cos, sin = math.cos(yaw), math.sin(yaw)
        return np.stack((x0 + cos * x - sin * y, y0 + sin * x + cos * y), axis=-1)

    def to_cells(self, points: np.ndarray) -> np.ndarray:
        """The inverse of `to_world`.

        Parameters
        ----------
        points : array_like, shape (n, 2)
            x and y [m].

        Returns
        -------
        ndarray, shape (n, 2)
            Column and row, with fractions.
        """
        x0, y0, yaw = self.origin
        x, y = np.asarray(points, dtype=float).T
        cos, sin = math.cos(yaw), math.sin(yaw)
        x, y = cos * (x - x0) + sin * (y - y0), cos * (y - y0) - sin * (x - x0)
        return np.stack((x, y), axis=-1) / self.resolution - 0.5


def read_map_image(path: str | Path) -> MapImage:
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
    header = _read_header(path)
    gray, clear = _pixels(path.parent / header.image)
    free, findings = _free_cells(gray, header)
    if clear is not None and np.any(free & clear):
        text = f"{np.count_nonzero(free & clear)} transparent pixels: taken as unknown"
        findings.append(Finding("transparent", WARNING, text))
        free &= ~clear
        if not free.any():
            raise FileFormatError(f"{path}: expected free cells, all of them are transparent")
    if header.origin[2] != 0.0:
        text = (
            f"the map is rotated by the yaw of its origin, {header.origin[2]:g} rad, as in "
            "map_server; lines from programs that ignore the yaw will not fit"
        )
        findings.append(Finding("origin-yaw", NOTE, text))
    return MapImage(free[::-1], header.resolution, header.origin, str(path), tuple(findings))


def edge_finding(image: MapImage, ring: np.ndarray, passage: float) -> list[Finding]:
    """Doubt about a track that reaches the edge of its map; empty if it does not.

    Parameters
    ----------
    image : MapImage
    ring : ndarray of bool, shape (rows, columns)
        Cells at least half a passage away from walls and from the edge.
    passage : float
        Width of a passage [m].

    Returns
    -------
    list of Finding
    """
    edge = image.free.copy()
    edge[1:-1, 1:-1] = False
    away = ndimage.distance_transform_edt(~ring) * image.resolution
    reached = np.argwhere(edge & (away < 0.5 * passage + 0.6 * image.resolution))
    if not len(reached):
        return []
    x, y = image.to_world(reached[:1, ::-1])[0]
    text = f"the track reaches the edge of the map, at ({x:.2f}, {y:.2f}): taken as a wall"
    return [Finding("edge", WARNING, text)]


class _Header(NamedTuple):
    """Contents of the YAML file; `missing` lists the thresholds that it lacks."""

    image: str
    resolution: float
    origin: tuple
    negate: int
    free_below: float
    occupied_above: float
    missing: list


def _read_header(path):
    content = read_yaml_mapping(path)
    resolution = _number(path, content, "resolution")
    if not 1e-4 < resolution < 100.0:
        raise FileFormatError(f"{path}: resolution: expected meters per cell, got {resolution:g}")
    origin = content.get("origin")
    if not isinstance(origin, list) or len(origin) != 3:
        raise FileFormatError(f"{path}: origin: expected [x, y, yaw], got {origin!r}")
    origin = tuple(_number(path, {"origin": value}, "origin") for value in origin)
    if abs(origin[2]) > 2.0 * math.pi:
        raise FileFormatError(f"{path}: origin: expected a yaw in rad, got {origin[2]:g}: in deg?")
    thresholds = {
        key: _number(path, content, key, usual)
        for key, usual in (("free_thresh", _SAVERS_FREE), ("occupied_thresh", 0.65))
    }
    for key, value in thresholds.items():
        if not 0.0 <= value <= 1.0:
            raise FileFormatError(f"{path}: {key}: expected 0 to 1, got {value:g}")
    negate = content.get("negate", 0)
    if negate not in (0, 1):
        raise FileFormatError(f"{path}: negate: expected 0 or 1, got {negate!r}")
    mode = content.get("mode", "trinary")
    if mode not in ("trinary", "scale"):
        raise FileFormatError(f"{path}: mode: expected trinary or scale, got {mode!r}")
    name = content.get("image")
    if not isinstance(name, str) or not name:
        raise FileFormatError(f"{path}: image: expected the name of a file, got {name!r}")
    missing = [key for key in thresholds if key not in content]
    return _Header(name, resolution, origin, negate, *thresholds.values(), missing)


def _free_cells(gray, header):
    """Mask of the free cells of an image, and findings."""
    _, _, _, negate, free_below, occupied_above, missing = header
    # As in map_server: the darker a cell, the more likely it is occupied.
    occupied = gray / 255.0 if negate else (255.0 - gray) / 255.0
    free = (occupied < free_below) & (occupied <= occupied_above)
    taken = {"free_thresh": free_below, "occupied_thresh": occupied_above}
    findings = [
        Finding("thresholds", WARNING, f"{key} is missing: {taken[key]:g} assumed")
        for key in missing
    ]
    if occupied_above < free_below:
        text = (
            f"occupied_thresh {occupied_above:g} is below free_thresh {free_below:g}: cells up to "
            f"{occupied_above:g} are free and all others occupied, as in map_server"
        )
        findings.append(Finding("thresholds", NOTE, text))
    # Was the map written by map_saver? It may have been inverted, and some cells painted.
    saved = 255 - gray if negate else gray
    unseen = int(np.sum(free & (saved == _UNSEEN)))
    painted = int(np.sum((saved > 0) & (saved < 254) & (saved != _UNSEEN)))
    if unseen > painted:
        free &= saved != _UNSEEN
        free &= occupied < _SAVERS_FREE
        text = (
            f"free_thresh {free_below:g} would make {unseen} cells free that map_saver wrote as "
            f"unknown (gray {_UNSEEN}): taken as unknown"
        )
        findings.append(Finding("unknown-cells", WARNING, text))
    return free, findings


def _number(path, content, key, default=None):
    value = content.get(key, default)
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not number or not -FARTHEST <= value <= FARTHEST:
        raise FileFormatError(f"{path}: {key}: expected a number, got {value!r}")
    return float(value)


def _pixels(path):
    """Gray values of an image, color channels averaged, and where it is transparent, if it can be.

    What an editor erases is transparent, whatever its color.
    """
    # Imported here, because commands and nodes that read no map do not need Pillow.
    from PIL import Image

    try:
        with Image.open(str(path)) as file:
            if file.size[0] * file.size[1] > _MOST_PIXELS:
                raise FileFormatError(
                    f"{path}: expected at most {_MOST_PIXELS} pixels, got {file.size[0]} x "
                    f"{file.size[1]}"
                )
            file.load()  # np.asarray may hide the error of a damaged image
            # Pillow clips more than 8 bits, so that nearly all would be white, that is, free.
            if file.mode in ("F", "I") or file.mode.startswith("I;"):
                return _of_16_bits(path, np.asarray(file)), None
            clear = None
            if file.mode[-1] in "Aa" or "transparency" in file.info:
                clear = np.asarray(file.convert("RGBA"))[:, :, 3] < 128
            if file.mode not in ("L", "RGB"):
                file = file.convert("RGB")
            gray = np.asarray(file)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else error
        raise FileFormatError(f"{path}: expected an image: {reason}") from None
    return (gray if gray.ndim == 2 else gray.mean(axis=2)), clear


def _of_16_bits(path, gray):
    """16-bit gray values as 8-bit ones, as in map_server."""
    if gray.dtype.kind == "f" or gray.min() < 0 or gray.max() > 65535:
        raise FileFormatError(f"{path}: expected gray values or colors of 8 or 16 bits")
    return np.asarray(gray // 256, dtype=np.uint8)
