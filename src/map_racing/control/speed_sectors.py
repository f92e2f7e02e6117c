"""Speed scales by stretch of the course."""

import math
from bisect import bisect_right

from ..errors import ParameterError
from ..files import read_yaml_mapping
from ..vehicle.tires import finite

__all__ = ["SpeedSectors", "load_speed_sectors"]


class SpeedSectors:
    """Piecewise constant scale of the raceline's speed.

    Parameters
    ----------
    sectors : iterable of (start_m, end_m, scale)
        Stretches by arc length [m], within 0 to `length`. One that ends before it starts crosses
        the start line.
    length : float
        Length of the course [m].
    elsewhere : float
        Scale outside of all sectors.

    Raises
    ------
    ParameterError
        For a scale that is negative or not finite, a sector off the course or without length, or
        overlapping sectors.
    """

    def __init__(self, sectors, length, elsewhere=1.0):
        if not 0.0 <= elsewhere < math.inf:
            raise ParameterError(f"speed elsewhere: expected a scale >= 0, not {elsewhere:g}")
        stretches = []
        for start, end, scale in sectors:
            where = f"speed sector {start:g} to {end:g} m"
            if not 0.0 <= scale < math.inf:
                raise ParameterError(f"{where}: expected a scale >= 0, not {scale:g}")
            if not (0.0 <= start <= length and 0.0 <= end <= length and start != end):
                raise ParameterError(
                    f"{where}: expected places within 0 to {length:g} m, not equal"
                )
            if start < end:
                stretches.append((start, end, scale))
            else:
                stretches += [(start, length, scale), (0.0, end, scale)]
        self._length = length
        self._starts, self._scales = [0.0], [elsewhere]
        for start, end, scale in sorted(
            stretch for stretch in stretches if stretch[0] < stretch[1]
        ):
            if start < self._starts[-1] - 1e-9:
                raise ParameterError(f"speed sectors overlap at {start:g} m")
            self._starts += [start, end]
            self._scales += [scale, elsewhere]
        if self._starts[-1] >= length:  # the modulo of -1e-17 is the length itself
            del self._starts[-1], self._scales[-1]

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
    for index in range(_index(path, content, "n_sectors")):
        key = f"Sector{index}"
        sector = content.get(key)
        if not isinstance(sector, dict):
            raise ParameterError(f"{path}: {key}: expected start, end and scaling")
        start, end = (_index(path, sector, name, where=key) for name in ("start", "end"))
        if start > end:
            raise ParameterError(f"{path}: {key}: expected start <= end, not {start}, {end}")
        # Files count the closing point, which repeats the first.
        if end > len(points) + 1:  # some count the closing point, some the points
            raise ParameterError(
                f"{path}: {key}: end: {end} is beyond the {len(points)} points of the raceline"
            )
        if start == len(points):
            continue
        # A sector reaches up to the first point of the next one.
        place = points[end + 1] if end + 1 < len(points) else raceline.length
        scale = min(_number(path, sector, "scaling", where=key), limit)
        sectors.append((points[start], place, scale))
    try:
        return SpeedSectors(sectors, raceline.length, elsewhere=min(1.0, limit))
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from error


def _number(path, mapping, key, default=None, where=""):
    return finite(f"{path}: {where + ': ' if where else ''}{key}", mapping.get(key, default))


def _index(path, mapping, key, where=""):
    value = _number(path, mapping, key, where=where)
    if value != int(value) or value < 0:
        raise ParameterError(
            f"{path}: {where + ': ' if where else ''}{key}: expected a whole number >= 0, "
            f"not {value:g}"
        )
    return int(value)
