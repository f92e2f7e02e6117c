"""Checks whether a car's parameters are plausible for its size, or in another unit.

Cars of all sizes are built alike: mass grows with the third power of the wheelbase, lengths grow
in proportion to it, and speeds and times with its square root (see `map_racing.vehicle.size`). A
1:43 model, a 1:10 race car, a kart, a formula car and a van are all within the ranges here; values
in grams, millimeters or degrees are not.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Iterator, NamedTuple

import numpy as np

from ..errors import ParameterError
from .single_track import GRAVITY
from .size import size_of

if TYPE_CHECKING:
    from .lookup import LookupTable
    from .parameters import Vehicle

__all__ = [
    "HIGHEST_FRICTION",
    "doubts_of_cells",
    "doubts_of_peak",
    "doubts_of_provenance",
    "doubts_of_table",
    "doubts_of_vehicle",
    "friction_doubt",
]

HIGHEST_FRICTION = 1.3
"""Upper limit of rubber on a clean floor without downforce."""
# A table belongs to another car if its wheelbase differs by more than this share; its angles must
# reach this share of the largest steering angle.
ANOTHER, NARROW = 0.1, 0.5
# Largest deviation (logarithm) of a cell from the interpolation between its neighbors. It is up to
# 13 % even on a grid of 2 m/s and 0.1 rad; more is a typing error. Not checked are cells below
# SMALLEST [m/s^2], which are rounded, and neighbors farther apart than the factor FARTHEST_BESIDE.
APART, SMALLEST, FARTHEST_BESIDE = 0.2, 0.1, 4.001
# A table that exceeds the grip of the car's tires by this factor belongs to other tires.
BEYOND = 1.3
# A value outside its range by this factor is certainly wrong.
CERTAIN = 10.0

# Fields whose range follows from the size of the car.
_SIZED = ("l_f", "l_r", "m", "I_z", "h_cg", "delta_rate_max", "v_max", "width", "length")
_LENGTHS = {"cm": 0.01, "mm": 0.001}
_INERTIAS = {"g m^2": 1e-3, "kg cm^2": 1e-4, "g cm^2": 1e-7, "kg mm^2": 1e-6, "g mm^2": 1e-9}
_DEGREE = math.pi / 180.0


class _Range(NamedTuple):
    """A field, its value, the range for cars of this size, its unit, and units it may be in."""

    field: str
    value: float
    low: float
    high: float
    unit: str
    others: dict = {}
    certain: float = CERTAIN
    got: str = ""

    def text(self, car):
        inside = (name for name, si in self.others.items() if self._holds(self.value * si))
        name = next(inside, None)
        usual = f"{_rounded(self.low)} to {_rounded(self.high)} {self.unit}".rstrip()
        text = f"{self.field}: expected {usual}{car}, got {self.got or f'{self.value:g}'}"
        return f"{text}: in {name}?" if name else text

    def _holds(self, value):
        return self.low <= value <= self.high

    def doubtful(self):
        return not self._holds(self.value)

    def wrong(self):
        return not self.low / self.certain <= self.value <= self.high * self.certain


def _rounded(value):
    """Two significant digits without an exponent, such as 4000."""
    return f"{float(f'{value:.2g}'):.6g}"


def doubts_of_vehicle(vehicle: Vehicle) -> list[str]:
    """Doubts about the values of a car.

    Parameters
    ----------
    vehicle : Vehicle

    Returns
    -------
    list of str
        A line for each unusual value, with the usual range.

    Raises
    ------
    ParameterError
        If a value is certainly in another unit.
    """
    doubts = []
    for found in _ranges(vehicle):
        car = f", wheelbase {vehicle.l_wb:.3g} m" if found.field in _SIZED else ""
        if found.wrong():
            raise ParameterError(found.text(car))
        if found.doubtful():
            doubts.append(found.text(car))
    return doubts + friction_doubt(vehicle)


def friction_doubt(vehicle: Vehicle) -> list[str]:
    """Doubt about the friction of the axle with less grip; empty if plausible."""
    peaks = [vehicle.mu * getattr(tire, "D", 1.0) for tire in (vehicle.front, vehicle.rear)]
    grip = min(peaks)
    if 0.1 <= grip <= HIGHEST_FRICTION:
        return []
    name = "friction (mu times D)" if hasattr(vehicle.front, "D") else "friction"
    return [
        f"{name}: expected 0.1 to {HIGHEST_FRICTION:g} for rubber on a floor without downforce, "
        f"got {grip:.3g}"
    ]


def doubts_of_table(table: LookupTable, vehicle: Vehicle, linear: bool = False) -> list[str]:
    """Doubts that a lookup table belongs to a car, or that its units or its range are right.

    With `linear`, the table is meant for linear tires and may exceed the grip of the car's tires.
    """
    doubts = doubts_of_provenance(table)
    if abs(table.l_wb_of_cells / vehicle.l_wb - 1.0) > ANOTHER:
        doubts.append(
            f"lookup table: its low speeds fit a wheelbase of {table.l_wb_of_cells:.3g} m, but "
            f"{vehicle.name} has {vehicle.l_wb:.3g} m: another car's, or in other units?"
        )
    if table.angles[-1] < NARROW * vehicle.delta_max:
        doubts.append(
            f"lookup table: ends at a steering angle of {table.angles[-1]:.3g} rad, but "
            f"{vehicle.name} steers up to {vehicle.delta_max:.3g} rad"
        )
    most = vehicle.mu * GRAVITY * min(vehicle.front.peak, vehicle.rear.peak)
    reached = float(table.max_lateral_acceleration(table.speeds[-1]))
    peak = [] if friction_doubt(vehicle) else doubts_of_peak(table)
    if reached > BEYOND * min(most, vehicle.a_lat_max) and not (peak or linear):
        doubts.append(
            f"lookup table: reaches {reached:.3g} m/s^2, but the tires of {vehicle.name} only "
            f"{min(most, vehicle.a_lat_max):.3g} m/s^2: made for other tires, or linear ones?"
        )
    return doubts + peak + doubts_of_cells(table)


def doubts_of_provenance(table: LookupTable) -> list[str]:
    """Doubt that the provenance beside a table is its own; empty if it is, or there is none."""
    if table.provenance is None or abs(table.l_wb / table.l_wb_of_cells - 1.0) <= ANOTHER:
        return []
    return [
        f"lookup table: its low speeds fit a wheelbase of {table.l_wb_of_cells:.3g} m, but the "
        f".meta.yaml beside it has {table.l_wb:.3g} m: another table's?"
    ]


def doubts_of_cells(table: LookupTable) -> list[str]:
    """Doubt about cells of a lookup table that do not fit their neighbors; empty if all do.

    It names the speed, the angle or the cell that is farthest off.
    """
    with np.errstate(invalid="ignore"):
        a = np.log(np.where(table.a_lat > SMALLEST, table.a_lat, np.nan))
    by_angle = _off_neighbors(a, table.angles)
    by_speed = _off_neighbors(a.T, table.speeds).T
    for off, axis, where in (
        (_medians(by_speed), table.speeds, "at {:g} m/s"),
        (_medians(by_angle.T), table.angles, "at {:g} rad"),
    ):
        k = int(np.argmax(np.abs(off)))
        if abs(off[k]) > APART:
            return [_cells_text("cells " + where.format(axis[k]), off[k])]
    both = np.where(by_angle * by_speed > 0.0, np.fmin(np.abs(by_angle), np.abs(by_speed)), 0.0)
    i, j = np.unravel_index(np.argmax(both), both.shape)
    if both[i, j] > APART:
        return [_cells_text(f"cell at {_place(table, i, j)}", by_speed[i, j])]
    before, here, after = table.a_lat[:-2], table.a_lat[1:-1], table.a_lat[2:]
    with np.errstate(invalid="ignore"):
        holes = np.argwhere((before > SMALLEST) & (after > 1.1 * before) & ~(here > 0.0))
    if len(holes):
        i, j = holes[0]
        where = _place(table, i + 1, j)
        return [f"lookup table: cell at {where}: {here[i, j]:g} between valid cells"]
    return []


def _off_neighbors(a, axis):
    """Log ratio of each cell to the interpolation of its neighbors; 0 where it is unknown."""
    off = np.zeros(a.shape)
    with np.errstate(all="ignore"):
        x = np.log(axis)
        wide = x[2:] - x[:-2]
        way = ((x[1:-1] - x[:-2]) / wide)[:, None]
        inner = a[1:-1] - (1.0 - way) * a[:-2] - way * a[2:]
        known = np.isfinite(inner) & ((wide > 0.0) & (wide < math.log(FARTHEST_BESIDE)))[:, None]
    off[1:-1] = np.where(known, inner, 0.0)
    return off


def _medians(off):
    """Median of the known cells of each column; 0 if there are fewer than five."""
    known = [column[column != 0.0] for column in off.T]
    return np.array([np.median(column) if column.size >= 5 else 0.0 for column in known])


def _place(table, i, j):
    return f"{table.speeds[j]:g} m/s and {table.angles[i]:g} rad"


def _cells_text(what, off):
    return f"lookup table: {what}: {math.exp(off):.2g} times the neighbors, mistyped?"


def doubts_of_peak(table: LookupTable) -> list[str]:
    """Doubt about the grip at the peak of a lookup table, beyond which more angle gives less.

    A table of linear tires has no peak, so its grip cannot be judged.
    """
    with np.errstate(invalid="ignore"):
        falling = np.any(np.diff(table.a_lat, axis=0) < 0.0, axis=0)
    if not falling.any():
        return []
    grip = float(np.median(np.nanmax(table.a_lat[:, falling], axis=0))) / GRAVITY
    if grip <= HIGHEST_FRICTION:
        return []
    return [
        f"lookup table: its peak takes a friction of {grip:.3g}, expected at most "
        f"{HIGHEST_FRICTION:g} for rubber on a floor without downforce"
    ]


def _ranges(vehicle: Vehicle) -> Iterator[_Range]:
    wheelbase, m = vehicle.l_wb, vehicle.m
    time = size_of(vehicle).time
    levers = f"{vehicle.l_f:g} + {vehicle.l_r:g}"
    yield _Range("l_f + l_r", wheelbase, 0.05, 7.0, "m", _LENGTHS, 1.5, levers)
    for field in ("l_f", "l_r"):
        value = getattr(vehicle, field)
        yield _Range(field, value, 0.15 * wheelbase, 0.85 * wheelbase, "m", _LENGTHS)
    yield _Range("m", m, 10.0 * wheelbase**3, 500.0 * wheelbase**3, "kg", {"g": 1e-3, "t": 1e3})
    low, high = m * (0.2 * wheelbase) ** 2, m * (0.9 * wheelbase) ** 2
    yield _Range("I_z", vehicle.I_z, low, high, "kg m^2", _INERTIAS)
    yield _Range("h_cg", vehicle.h_cg, 0.0, 0.6 * wheelbase, "m", _LENGTHS)
    yield _Range("mu", vehicle.mu, 0.1, 3.0, "", {"percent": 0.01})
    for name, tire in (("front", vehicle.front), ("rear", vehicle.rear)):
        field = f"{name} tire: cornering stiffness over load"
        others = {"1/deg": 1.0 / _DEGREE}
        yield _Range(field, vehicle.mu * tire.stiffness, 1.0, 100.0, "1/rad", others)
        yield _Range(f"{name} tire: C", getattr(tire, "C", 1.0), 0.3, 3.0, "", {}, 1e9)
        yield _Range(f"{name} tire: friction", vehicle.mu * getattr(tire, "D", 1.0), 0.1, 2.5, "")
    softer = vehicle.mu * min(vehicle.front.stiffness, vehicle.rear.stiffness)
    yield _Range("softer axle: cornering stiffness over load", softer, 1.0, 40.0, "1/rad")
    yield _Range("delta_max", vehicle.delta_max, 0.1, 1.2, "rad", {"deg": _DEGREE})
    rate = vehicle.delta_rate_max
    yield _Range("delta_rate_max", rate, 0.1, 20.0 / time, "rad/s", {"deg/s": _DEGREE}, 1e9)
    kmh = {"km/h": 1.0 / 3.6}
    yield _Range("v_max", vehicle.v_max, 0.5 * time, 40.0 * time, "m/s", kmh, 1e9)
    for field in ("a_max", "a_brake_max"):
        yield _Range(field, getattr(vehicle, field), 0.3, 40.0, "m/s^2", {}, 1e9)
    yield _Range("width", vehicle.width, 0.25 * wheelbase, 1.6 * wheelbase, "m", _LENGTHS)
    yield _Range("length", vehicle.length, wheelbase, 3.0 * wheelbase, "m", _LENGTHS)
