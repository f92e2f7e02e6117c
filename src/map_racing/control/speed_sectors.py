"""Speed scales by stretch of the course."""

import math
from bisect import bisect_right

from ..errors import ParameterError
from ..files import read_yaml_mapping

__all__ = ["SpeedSectors", "load_speed_sectors"]


class SpeedSectors:
    """Piecewise constant scale of the raceline's speed.

    Parameters
    ----------
    sectors : iterable of (start_m, end_m, scale)
        Stretches by arc length [m]; outside of all of them the scale is 1. One that ends before
        it starts crosses the start line.
    length : float
        Length of the course [m].

    Raises
    ------
    ParameterError
        For a scale that is negative or not finite, or overlapping sectors.
    """

    def __init__(self, sectors, length):
        stretches = []
        for start, end, scale in sectors:
            if not (math.isfinite(start + end + scale) and scale >= 0.0):
                raise ParameterError(
                    f"speed sector {start:g} to {end:g} m: expected a scale >= 0, not {scale:g}"
                )
            if start < end:
                stretches.append((start, end, scale))
            else:
                stretches += [(start, length, scale), (0.0, end, scale)]
        self._length = length
        self._starts, self._scales = [0.0], [1.0]
        for start, end, scale in sorted(stretches):
            if start < self._starts[-1] - 1e-9:
                raise ParameterError(f"speed sectors overlap at {start:g} m")
            self._starts += [start, end]
            self._scales += [scale, 1.0]

    def scale_at(self, s):
        """Scale of the speed at arc length `s` [m]."""
        return self._scales[bisect_right(self._starts, s % self._length) - 1]


def load_speed_sectors(path, raceline):
    """Read the public stack's ``speed_scaling.yaml``.

    It has ``global_limit``, ``n_sectors`` and ``Sector0: {start, end, scaling}``, ...; `start` and
    `end` are indices of the raceline's own points, and no scale exceeds the global limit.

    Parameters
    ----------
    path : str or pathlib.Path
    raceline : Raceline
        Its points give the indices their places.

    Returns
    -------
    SpeedSectors

    Raises
    ------
    ParameterError
        If the file is missing or malformed; the message names file and field.
    """
    content = read_yaml_mapping(path)
    points = raceline.s_points
    limit = _number(path, content, "global_limit", 1.0)
    sectors = []
    for index in range(int(_number(path, content, "n_sectors"))):
        key = f"Sector{index}"
        sector = content.get(key)
        if not isinstance(sector, dict):
            raise ParameterError(f"{path}: {key}: expected start, end and scaling")
        start, end = (int(_number(path, sector, name, where=key)) for name in ("start", "end"))
        if not 0 <= start <= end:
            raise ParameterError(f"{path}: {key}: expected 0 <= start <= end, not {start}, {end}")
        last = len(points) - 1
        # A sector reaches up to the first point of the next one.
        sectors.append(
            (
                points[min(start, last)],
                points[end + 1] if end < last else raceline.length,
                min(_number(path, sector, "scaling", where=key), limit),
            )
        )
    try:
        return SpeedSectors(
            [sector for sector in sectors if sector[0] < sector[1]], raceline.length
        )
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from error


def _number(path, mapping, key, default=None, where=""):
    value = mapping.get(key, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ParameterError(f"{path}: {where + ': ' if where else ''}{key}: expected a number")
    return value
