"""The lookup table between steering angle and steady-state lateral acceleration, both ways."""

from __future__ import annotations

import dataclasses
import math
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import FileFormatError, ParameterError
from ..files import read_yaml_mapping, refuse_special, replacing, together, yaml_text
from ..tables import open_text, parse_rows
from ..validation import positive

__all__ = ["LookupTable", "Provenance", "load_table"]


# Wheelbases of cars [m].
_SHORTEST, _LONGEST = 0.01, 10.0


@dataclass(frozen=True)
class Provenance:
    """Origin of a table, saved next to its CSV as ``<stem>.meta.yaml``.

    Parameters
    ----------
    vehicle, tire_model : str
        Name of the car and of its tire model.
    parameter_hash : str
        Fingerprint of the car's model, see `parameters.parameter_hash`.
    l_wb : float
        Wheelbase [m].
    generator : str
        Program and version.
    """

    vehicle: str
    tire_model: str
    parameter_hash: str
    l_wb: float
    generator: str

    def __post_init__(self):
        for name in ("vehicle", "tire_model", "parameter_hash", "generator"):
            if not isinstance(getattr(self, name), str):
                raise ParameterError(f"{name}: expected a text, got {getattr(self, name)!r}")
        if not _SHORTEST <= positive("l_wb", self.l_wb) <= _LONGEST:
            raise ParameterError(
                f"l_wb: expected {_SHORTEST:g} to {_LONGEST:g} m, got {self.l_wb:g}"
            )


class _Column(NamedTuple):
    """The inverse at one speed: steering angle over the share of the reachable acceleration."""

    limit: float  # largest reachable acceleration [m/s^2]
    shares: list[float]  # a_lat / limit, strictly ascending from 0 to 1
    angles: list[float]  # [rad], strictly ascending from 0
    slopes: list[float]  # [rad] per share, in the interval that begins at each node


# A cell with more than this many times the kinematic acceleration is suspect; in published tables
# and those of the shipped cars the ratio is at most 1.1.
_SPIKE = 3.0


class LookupTable:
    """Steady-state lateral acceleration over speed and steering angle, and its inverse.

    Parameters
    ----------
    speeds : array_like, shape (n_speeds,)
        Speeds [m/s], positive, ascending.
    angles : array_like, shape (n_angles,)
        Steering angles [rad], not negative, ascending, possibly repeated as in published tables.
    a_lat : array_like, shape (n_angles, n_speeds)
        Steady-state lateral acceleration [m/s^2]; NaN where the car has no stable steady state.
    provenance : Provenance, optional
        Origin of the table; published tables have none.

    Attributes
    ----------
    speeds, angles, a_lat : ndarray
        The table, read-only.
    provenance : Provenance or None
    l_wb : float
        Wheelbase [m], from `provenance` or, without one, `l_wb_of_cells`.
    l_wb_of_cells : float
        Wheelbase [m] estimated from the row of the smallest angle.

    Raises
    ------
    ParameterError
        If shapes do not fit, an axis does not ascend, or no cell can be inverted.

    Notes
    -----
    In steady state ``delta = l_wb a / v^2 + K(a)`` up to the curvature of the arctangent. The
    inverse is exact at the nodes and interpolates in variables in which this law is nearly linear:

    - across acceleration, linearly on the rising branch of each column, over the share
      ``a / a_max(v)``, so that neighboring columns begin and end together;
    - across speed, linearly in ``1 / v^2``, and the reciprocal of ``a_max`` likewise.

    Below the slowest column it blends with v^2 into the kinematics of a car that rolls without
    slip, where ``a_max`` is 0 at standstill. Above the fastest column ``a_max`` is constant, and
    the law gives a column for infinite speed, kept rising where an oversteering car has none.

    Between the nodes, from standstill to 15 m/s, steering angles of ``nuc4`` differ from the exact
    solution by at most 0.21 mrad up to 95 % of the limit on the published grid, and by 0.18 mrad up
    to 99 % on the default grid; at the limit, where the angle rises steeply, by 5.2 and 1.7 mrad.
    """

    def __init__(
        self,
        speeds: np.ndarray,
        angles: np.ndarray,
        a_lat: np.ndarray,
        provenance: Provenance | None = None,
    ):
        self.speeds, self.angles = _axis("speeds", speeds, True), _axis("angles", angles, False)
        self.a_lat = _frozen(a_lat)
        self.provenance = provenance
        if self.speeds[0] <= 0.0:
            raise ParameterError(f"speeds: expected positive values, got {self.speeds[0]:g} m/s")
        if self.angles[0] < 0.0 or self.angles[-1] >= 0.5 * math.pi:
            raise ParameterError(
                f"angles: expected values in [0, pi/2) rad, got {self.angles[0]:g} "
                f"to {self.angles[-1]:g}"
            )
        if self.a_lat.shape != (self.angles.size, self.speeds.size):
            raise ParameterError(
                f"a_lat: expected shape {(self.angles.size, self.speeds.size)}, "
                f"got {self.a_lat.shape}"
            )
        if np.any(np.isinf(self.a_lat)):
            raise ParameterError("a_lat: expected finite values or NaN, got inf")
        columns = [_invert(self.angles, column) for column in self.a_lat.T]
        usable = [j for j, column in enumerate(columns) if column is not None]
        if not usable:
            raise ParameterError("a_lat: expected cells that rise from 0 with the angle, got none")
        self._columns = [columns[j] for j in usable]
        self._v = [float(self.speeds[j]) for j in usable]
        self._w = [1.0 / (v * v) for v in self._v]
        self.l_wb_of_cells = self._estimate_wheelbase()
        self.l_wb = self.l_wb_of_cells if provenance is None else provenance.l_wb
        if not _SHORTEST <= self.l_wb <= _LONGEST:
            raise ParameterError(
                f"a_lat: expected cells at small angles that give a wheelbase of {_SHORTEST:g} to "
                f"{_LONGEST:g} m, got {self.l_wb:.3g} m"
            )
        self._refuse_spikes()
        self._at_rest = self._standstill()
        self._columns.append(self._infinite_speed())
        self._w.append(0.0)

    def steering(self, v: float, a_lat: float) -> tuple[float, bool]:
        """Steering angle for a lateral acceleration in steady state.

        Odd and monotone in `a_lat`, continuous in `v`, exact at the nodes of the table. One call
        takes 1.0 us on CPython 3.11.

        Parameters
        ----------
        v : float
            Speed [m/s]; its sign does not matter.
        a_lat : float
            Lateral acceleration [m/s^2], positive to the left.

        Returns
        -------
        delta : float
            Steering angle [rad], positive to the left.
        saturated : bool
            Whether `a_lat` is out of reach; `delta` is then the angle of the largest `a_lat`.

        Raises
        ------
        ParameterError
            If an argument is not finite.
        """
        demand = a_lat if a_lat >= 0.0 else -a_lat
        speed = v if v >= 0.0 else -v
        if not (demand < math.inf and speed < math.inf):
            raise ParameterError(f"steering(v={v}, a_lat={a_lat}): expected finite arguments")

        k = bisect_right(self._v, speed)
        if k == 0:
            rest, slow = self._at_rest, self._columns[0]
            t = speed * speed * self._w[0]
            reach = t * ((1.0 - t) * rest.limit + t * slow.limit)
            saturated = demand > reach * _ROUNDING
            # the reach may be 0, at rest
            share = demand / reach if demand < reach else 1.0
            delta = (1.0 - t) * _angle(rest, share) + t * _angle(slow, share) if demand else 0.0
        else:
            slow, fast = self._columns[k - 1], self._columns[k]
            w = self._w[k - 1]
            t = (w - 1.0 / (speed * speed)) / (w - self._w[k])
            share = demand * ((1.0 - t) / slow.limit + t / fast.limit)
            saturated = share > _ROUNDING
            if share > 1.0:
                share = 1.0
            delta = (1.0 - t) * _angle(slow, share) + t * _angle(fast, share)
        return (delta if a_lat >= 0.0 else -delta), saturated

    def max_lateral_acceleration(self, v: float | np.ndarray) -> float | np.ndarray:
        """Largest lateral acceleration that `steering` reaches.

        Parameters
        ----------
        v : float or ndarray
            Speed [m/s], of any shape; its sign does not matter.

        Returns
        -------
        float or ndarray
            [m/s^2], in the shape of `v`.
        """
        speed = np.abs(np.asarray(v, dtype=float))
        w = 1.0 / np.maximum(speed, self._v[0]) ** 2
        inverse = [1.0 / column.limit for column in self._columns]
        limit = 1.0 / np.interp(-w, -np.asarray(self._w), inverse)
        t = np.minimum(speed / self._v[0], 1.0) ** 2
        limit = t * ((1.0 - t) * self._at_rest.limit + t * limit)
        return limit if np.ndim(v) else float(limit)

    def acceleration(self, v: float | np.ndarray, delta: float | np.ndarray) -> float | np.ndarray:
        """Steady-state lateral acceleration [m/s^2], bilinear between the cells of the table.

        NaN outside the table and next to cells that are NaN.

        Parameters
        ----------
        v : float or ndarray
            Speed [m/s]; its sign does not matter.
        delta : float or ndarray
            Steering angle [rad], positive to the left.

        Returns
        -------
        float or ndarray
            [m/s^2], in the common shape of both.
        """
        v, delta = np.broadcast_arrays(np.asarray(v, dtype=float), np.asarray(delta, dtype=float))
        i, u = _locate(self.angles, np.abs(delta))
        j, t = _locate(self.speeds, np.abs(v))
        i_next = np.minimum(i + 1, self.angles.size - 1)
        j_next = np.minimum(j + 1, self.speeds.size - 1)
        result = np.zeros(v.shape)
        for row, across in ((i, 1.0 - u), (i_next, u)):
            for column, along in ((j, 1.0 - t), (j_next, t)):
                weight = across * along
                # a neighbor without weight may be NaN
                result = result + np.where(weight == 0.0, 0.0, weight * self.a_lat[row, column])
        result = np.copysign(1.0, delta) * result
        return result if result.ndim else float(result)

    def save(self, path: str | Path) -> None:
        """Write the table as CSV in the published layout, the provenance as ``<stem>.meta.yaml``.

        The first row has the speeds, the first column the angles, cell [0, 0] is 0; numbers read
        back exactly. Both files appear, or none.

        Raises
        ------
        MapRacingError
            If a file cannot be written.
        """
        path = Path(path)
        rows = np.column_stack((np.r_[0.0, self.angles], np.vstack((self.speeds, self.a_lat))))
        text = "".join(",".join(map(repr, row)) + "\n" for row in rows.tolist())
        with together():
            if self.provenance is not None:
                with replacing(_sidecar(path)) as file:
                    file.write(yaml_text(dataclasses.asdict(self.provenance)))
            with replacing(path) as file:
                file.write(text)
        if self.provenance is None and _sidecar(path).exists():
            _sidecar(path).unlink()

    def _estimate_wheelbase(self):
        """Wheelbase [m]: at small angles ``delta / a = l_wb / v^2 + K'``, a line over 1/v^2."""
        first = [column.angles[1] / (column.shares[1] * column.limit) for column in self._columns]
        if len(first) == 1:
            return first[0] / self._w[0]
        return float(np.polyfit(self._w, first, 1)[0])

    def _refuse_spikes(self):
        """Refuse a cell far above kinematics and all neighboring cells: it was mistyped.

        The neighbors matter because an oversteering car has whole regions above kinematics.
        """
        rolling = np.tan(self.angles[:, None]) * self.speeds**2 / self.l_wb
        low = 0.5 * self.a_lat
        with np.errstate(invalid="ignore"):
            high = (self.a_lat > _SPIKE * rolling) & (self.a_lat > 1.0)
            high[1:] &= self.a_lat[:-1] < low[1:]
            high[:-1] &= self.a_lat[1:] < low[:-1]
            high[:, 1:] &= self.a_lat[:, :-1] < low[:, 1:]
            high[:, :-1] &= self.a_lat[:, 1:] < low[:, :-1]
        if high.any():
            i, j = np.argwhere(high)[0]
            raise ParameterError(
                f"a_lat: {self.a_lat[i, j]:g} m/s^2 at {self.speeds[j]:g} m/s and "
                f"{self.angles[i]:g} rad: expected a value between the neighboring cells"
            )

    def _standstill(self):
        """Kinematic column, ``tan(delta) = l_wb a / v^2``, at the speed of the first column."""
        column = self._columns[0]
        slope = math.tan(column.angles[-1])
        limit = slope / (self.l_wb * self._w[0])
        shares = np.asarray(column.shares)
        return _column(limit, shares, np.arctan(slope * shares))

    def _infinite_speed(self):
        """The last column without its wheelbase term ``l_wb a / v^2``."""
        column = self._columns[-1]
        rise = np.diff(column.angles)
        geometric = np.diff(column.shares) * column.limit * self.l_wb * self._w[-1]
        # the floor keeps the inverse monotone: an oversteering car cannot go that fast
        angles = _from_zero(np.cumsum(np.maximum(rise - geometric, 0.1 * rise)))
        return _column(column.limit, np.asarray(column.shares), angles)


def load_table(path: str | Path) -> LookupTable:
    """Read a table from CSV in the published layout, with its provenance if there is one.

    Raises
    ------
    FileFormatError
        If a row is ragged or a cell is not a number (the message names the line), an axis does not
        ascend, or the provenance is damaged.

    Notes
    -----
    Cell [0, 0] is ignored; in published tables it is often uninitialized memory.
    """
    refuse_special(path)
    path = Path(path)
    table = _read_rows(path)
    try:
        return LookupTable(table[0, 1:], table[1:, 0], table[1:, 1:], _read_provenance(path))
    except ParameterError as error:
        raise FileFormatError(f"{path}: {error}") from None


# a demand above the limit only by rounding does not count as saturated
_ROUNDING = 1.0 + 1e-9


def _angle(column, share):
    """Steering angle [rad] of one column, `share` in [0, 1]."""
    k = bisect_right(column.shares, share) - 1
    return column.angles[k] + column.slopes[k] * (share - column.shares[k])


def _invert(angles, a_lat):
    """Rising branch of one column as a `_Column`, or None if it has none."""
    valid = np.isfinite(a_lat)
    end = a_lat.size if valid.all() else int(np.argmin(valid))
    a, delta = a_lat[:end], angles[:end]
    # keep cells that exceed all earlier ones, so nothing past the maximum
    before = np.maximum.accumulate(_from_zero(a))[:-1]
    rising = (a > before) & (delta > _from_zero(delta[:-1]))
    if not rising.any():
        return None
    a, delta = _from_zero(a[rising]), _from_zero(delta[rising])
    return _column(float(a[-1]), a / a[-1], delta)


def _column(limit, shares, angles):
    slopes = np.diff(angles) / np.diff(shares)
    return _Column(limit, shares.tolist(), angles.tolist(), slopes.tolist() + [0.0])


def _from_zero(values):
    return np.concatenate(([0.0], values))


def _locate(axis, value):
    """Lower neighbor on an axis and the fraction of the way to the upper one; NaN outside."""
    k = np.clip(np.searchsorted(axis, value, side="right") - 1, 0, max(axis.size - 2, 0))
    width = axis[np.minimum(k + 1, axis.size - 1)] - axis[k]
    way = (value - axis[k]) / np.where(width > 0.0, width, 1.0)
    with np.errstate(invalid="ignore"):
        return k, np.where((value >= axis[0]) & (value <= axis[-1]), way, np.nan)


def _frozen(values):
    values = np.array(values, dtype=float)
    values.flags.writeable = False
    return values


def _axis(name, values, strictly):
    values = _frozen(values)
    if values.ndim != 1 or not values.size or not np.all(np.isfinite(values)):
        raise ParameterError(f"{name}: expected a list of finite numbers")
    if np.any(np.diff(values) < 0.0) or (strictly and np.any(np.diff(values) == 0.0)):
        k = int(np.argmin(np.diff(values)))
        raise ParameterError(
            f"{name}: expected ascending values, got {values[k]:g} before {values[k + 1]:g}"
        )
    return values


def _sidecar(path):
    return path.with_suffix(".meta.yaml")


def _read_rows(path):
    with open_text(path) as file:
        rows = [(n, line.split(",")) for n, line in enumerate(file, 1) if line.strip()]
    columns = range(1, 1 + len(rows[0][1]) if rows else 1)
    other = next((mark for mark in ";\t" if rows and any(mark in cell for cell in rows[0][1])), "")
    if other:
        raise FileFormatError(f"{path}: expected cells separated by commas, got {other!r}")
    if len(rows) < 2 or len(columns) < 2:
        got = f"{len(rows)} row{'s' * (len(rows) != 1)}"
        if rows and len(columns) < 2:
            got = f"no comma in {rows[0][1][0].strip()[:40]!r}"
        raise FileFormatError(
            f"{path}: expected comma-separated speeds, then rows of angles, got {got}"
        )
    rows[0][1][0] = "0"  # ignored, and may be anything
    return parse_rows(path, rows, columns)[0]


def _read_provenance(path):
    sidecar = _sidecar(path)
    if not sidecar.is_file():
        return None
    values = read_yaml_mapping(sidecar)
    names = [field.name for field in dataclasses.fields(Provenance)]
    if set(values) != set(names):
        raise FileFormatError(
            f"{sidecar}: expected the keys {', '.join(names)}, got {', '.join(map(str, values))}"
        )
    try:
        return Provenance(**values)
    except ParameterError as error:
        raise FileFormatError(f"{sidecar}: {error}") from None
