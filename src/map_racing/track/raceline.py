"""Closed racelines: one internal form for every source, a curve with speeds and walls."""

from __future__ import annotations

from typing import NamedTuple, Sequence, Union

import numpy as np

from ..validation import FARTHEST
from .curve import ClosedCurve
from .spline import distinct_points

__all__ = ["CurveSamples", "Raceline"]


_Array = Union[float, Sequence[float], np.ndarray]


class CurveSamples(NamedTuple):
    """Arrays along the curve; columns that the raceline lacks are None.

    Parameters
    ----------
    s : ndarray, shape (n,)
        Arc lengths [m].
    x, y : ndarray, shape (n,)
        Positions [m].
    psi : ndarray, shape (n,)
        Headings [rad].
    kappa : ndarray, shape (n,)
        Curvatures [1/m], left positive.
    speed : ndarray, shape (n,), or None
        [m/s]
    d_left, d_right : ndarray, shape (n,), or None
        Distances to the walls [m].
    """

    s: np.ndarray
    x: np.ndarray
    y: np.ndarray
    psi: np.ndarray
    kappa: np.ndarray
    speed: np.ndarray | None
    d_left: np.ndarray | None
    d_right: np.ndarray | None


class Raceline(ClosedCurve):
    """Closed curve through points, with speeds and distances to the walls.

    Parameters
    ----------
    x_m, y_m : array_like, shape (n_points,)
        Points in driving order [m]. Consecutive repetitions and a last point that repeats the
        first are dropped; at least four must be left.
    vx_mps : array_like, shape (n_points,), optional
        Speed at the points [m/s], linear in between.
    d_left_m, d_right_m : array_like, shape (n_points,), optional
        Distance from the points to the left and the right wall [m], linear in between. Both or
        neither.
    name : str, optional
        Short name for titles and tables.
    source : str, optional
        Origin of the points; error messages begin with it.

    Attributes
    ----------
    speed, d_left, d_right : ndarray, shape (n,), or None
        Speed [m/s] and distances to the walls [m] at the start of the cells, None if not given.
    findings : tuple of map_racing.track.findings.Finding
        Findings from the file or message; empty for a raceline made from arrays.

    Raises
    ------
    RacelineError
        If the points do not form a closed track, or a value is not finite or impossible.
    """

    def __init__(
        self,
        x_m: _Array,
        y_m: _Array,
        *,
        vx_mps: _Array | None = None,
        d_left_m: _Array | None = None,
        d_right_m: _Array | None = None,
        name: str = "",
        source: str = "",
    ):
        self.name, self.source, self.findings = name, source, ()
        given = {"x": x_m, "y": y_m, "speed": vx_mps, "d_left": d_left_m, "d_right": d_right_m}
        columns = self._columns({key: v for key, v in given.items() if v is not None})
        super().__init__(columns["x"], columns["y"])
        knots = np.append(self.s_points, self.length)
        for key in ("speed", "d_left", "d_right"):
            column = values = columns.get(key)
            if column is not None:
                column = np.interp(self.s, knots, np.append(column, column[0]))
                column.flags.writeable = False
                values = column.tolist() + column[:2].tolist()
            setattr(self, key, column)
            setattr(self, "_" + key, values)

    def _columns(self, given):
        """Columns as arrays, without repeated points; refuses impossible ones."""
        if ("d_left" in given) != ("d_right" in given):
            raise self._error("expected distances to both walls or to neither, got one")
        columns = {key: self._column(key, values) for key, values in given.items()}
        if len({column.size for column in columns.values()}) > 1:
            sizes = ", ".join(f"{column.size} of {key}" for key, column in columns.items())
            raise self._error(f"expected as many values in each column, got {sizes}")
        slow = columns.get("speed", np.zeros(1)) < 0.0
        if np.any(slow):
            index = int(np.argmax(slow))
            value = columns["speed"][index]
            raise self._error(f"point {index}: expected a speed >= 0 m/s, got {value:g}")
        keep = distinct_points(columns["x"], columns["y"])
        if np.count_nonzero(keep) < 4:
            raise self._error(f"expected at least 4 distinct points, got {np.sum(keep)}")
        return {key: column[keep] for key, column in columns.items()}

    def _column(self, key, values):
        try:
            column = np.asarray(values, dtype=float)
        except (TypeError, ValueError, OverflowError):
            raise self._error(f"{key}: expected one number per point") from None
        if column.ndim != 1:
            raise self._error(f"{key}: expected one number per point, got shape {column.shape}")
        bad = ~np.isfinite(column)
        if bad.any():
            index = int(np.argmax(bad))
            raise self._error(f"point {index}: expected a finite {key}, got {column[index]}")
        if np.any(np.abs(column) > FARTHEST):
            index = int(np.argmax(np.abs(column)))
            raise self._error(
                f"point {index}: expected a {key} of at most {FARTHEST:g} m or m/s, "
                f"got {column[index]:g}"
            )
        return column

    def __repr__(self):
        return f"<Raceline {self.name or self.source!r}: {self.length:.2f} m, {self.n} cells>"

    def speed_at(self, s: float) -> float:
        """Speed [m/s] of the raceline at arc length ``s`` [m], taken modulo the length.

        Raises
        ------
        RacelineError
            If the raceline has no speeds.
        """
        speed = self._speed
        if speed is None:
            raise self._error("expected a raceline with speeds, got none")
        cell = s % self.length * self._per_ds
        i = int(cell)
        v = speed[i]
        return v + (speed[i + 1] - v) * (cell - i)

    def widths_at(self, s: float) -> tuple[float, float]:
        """Distances ``(left, right)`` [m] from the curve to the walls at arc length ``s`` [m].

        Raises
        ------
        RacelineError
            If the raceline has no walls.
        """
        left, right = self._d_left, self._d_right
        if left is None:
            raise self._error("expected a raceline with distances to the walls, got none")
        cell = s % self.length * self._per_ds
        i = int(cell)
        part = cell - i
        return (
            left[i] + (left[i + 1] - left[i]) * part,
            right[i] + (right[i + 1] - right[i]) * part,
        )

    def sample(self, s: _Array) -> CurveSamples:
        """Sample all columns at many arc lengths.

        Parameters
        ----------
        s : array_like
            Arc lengths [m], taken modulo the length.

        Returns
        -------
        CurveSamples
            Arrays of the shape of `s`.
        """
        s = np.mod(np.asarray(s, dtype=float), self.length)
        return CurveSamples(s, *self._curve(s), *self.speed_and_walls(s))

    def speed_and_walls(self, s: _Array) -> list[np.ndarray | None]:
        """Those of `sample` alone: speed and distances to the left and the right wall."""
        s = np.mod(np.asarray(s, dtype=float), self.length)
        knots = np.append(self.s, self.length)
        return [
            None if column is None else np.interp(s, knots, np.append(column, column[0]))
            for column in (self.speed, self.d_left, self.d_right)
        ]

    # -- other racelines along the same curve ------------------------------------------------

    def _through(self, s, **columns):
        """Raceline through the curve's points at `s`, with the columns sampled there."""
        at = self.sample(s)
        keys = {"vx_mps": at.speed, "d_left_m": at.d_left, "d_right_m": at.d_right}
        keys.update({key: getattr(at, column) for key, column in columns.items()})
        return Raceline(at.x, at.y, name=self.name, source=self.source, **keys)

    def reversed(self) -> Raceline:
        """The raceline in the opposite direction, from the same start line."""
        return self._through(-self.s, d_left_m="d_right", d_right_m="d_left")

    def rotated(self, s0: float) -> Raceline:
        """The raceline with its start line moved to arc length `s0` [m]."""
        return self._through(self.s + s0)
