"""Closed curves, smooth between the points.

The curve is the closed cubic spline through all points over chord length, resampled into cells of
equal arc length ``ds``, each with one cubic for x(s) and one for y(s). One multiplication finds the
cell of an arc length ``s``, so only a search of the whole track depends on the number of points.
Curvature is continuous, the parameter is arc length (``|r'(s)| = 1`` to 1e-5 on the shipped
tracks), and scalar queries are pure-float arithmetic, because the overhead of one numpy call
exceeds a whole query: 0.2 us for a speed, 1 us for a pose, 2 us for a projection from a guess and
3 us for the point ahead (CPython 3.11).

Lateral error ``d`` is positive to the left of the direction of travel, curvature ``kappa`` positive
in left-hand bends.
"""

from __future__ import annotations

import math
from typing import NamedTuple, Sequence, Union

import numpy as np

from ..errors import ParameterError, RacelineError
from ..validation import FARTHEST
from .spline import OVERLAP, closed_spline, resample_by_arc_length
from .tree import point_tree

__all__ = ["ClosedCurve", "CurvePoint", "LookaheadPoint", "Projection"]


_Array = Union[float, Sequence[float], np.ndarray]


_new = tuple.__new__


class CurvePoint(NamedTuple):
    """A point of the curve: position [m], heading [rad] in [-pi, pi], curvature [1/m]."""

    x: float
    y: float
    psi: float
    kappa: float


class Projection(NamedTuple):
    """Foot of the perpendicular from a position onto the curve.

    Arc length ``s`` [m] in [0, length), lateral error ``d`` [m] positive to the left, and the
    curve's heading ``psi`` [rad] and curvature ``kappa`` [1/m] there.
    """

    s: float
    d: float
    psi: float
    kappa: float


class LookaheadPoint(NamedTuple):
    """A point of the curve at arc length ``s`` [m] and its straight-line ``distance`` [m]."""

    s: float
    x: float
    y: float
    distance: float


class ClosedCurve:
    """Closed curve through points.

    Parameters
    ----------
    x_m, y_m : ndarray, shape (n_points,)
        At least four distinct points in driving order [m].

    Attributes
    ----------
    length : float
        Length of one lap [m].
    n : int
        Number of cells of the internal form.
    ds : float
        Length of a cell [m].
    s, x, y, psi, kappa : ndarray, shape (n,)
        Arc length [m], position [m], heading [rad] and curvature [1/m] at the start of the cells.
    s_points : ndarray
        Arc length of the given points [m].
    name, source : str
        Short name for titles and tables, and origin of the points: error messages begin with it.

    Raises
    ------
    RacelineError
        If the points do not form a closed track.

    Notes
    -----
    Points h apart on a bend of radius R leave the curve ``h^4 / (384 R^3)`` off the bend. Measured
    on a circle of 5 m radius with points 0.05, 0.2, 0.5 and 1 m apart: 1e-10, 3e-8, 1.3e-6 and
    2.2e-5 m.
    """

    name = source = ""

    def __init__(self, x_m: np.ndarray, y_m: np.ndarray):
        self._tree = None
        s_points, x, y = resample_by_arc_length(x_m, y_m)
        gap, path = s_points[-1] - s_points[-2], s_points[-2]
        if gap > 0.25 * path and gap > 10.0 * np.median(np.diff(s_points)):
            chord = math.hypot(x_m[0] - x_m[-1], y_m[0] - y_m[-1])
            raise self._error(
                f"expected a closed track, but the last point is {chord:.2f} m from the first"
            )
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            raise self._error("expected a track, but the points run back and forth on one line")
        self.s_points = s_points[:-1]
        self.length = length = float(s_points[-1])
        self.n = n = x.size
        self.ds = length / n
        self._per_ds = n / length

        knots = np.linspace(0.0, length, n + 1)
        spline = closed_spline(knots, x, y)
        self._c = c = spline.c[::-1, OVERLAP : OVERLAP + n].copy()  # ascending: (4, n, 2)
        cells = [tuple(row) for row in np.concatenate((c[:, :, 0], c[:, :, 1])).T.tolist()]
        # s * (n / length) may round up to n: one more cell instead of a check in every query.
        cells.append(cells[0])
        self._cells = cells

        self.s = knots[:-1]
        self.x, self.y, self.psi, self.kappa = self._curve(self.s)
        for column in (self.s, self.x, self.y, self.psi, self.kappa, self.s_points):
            column.flags.writeable = False

    def _error(self, text):
        return RacelineError(f"{self.source or self.name or 'raceline'}: {text}")

    # -- along the curve ---------------------------------------------------------------------

    def _curve(self, s):
        """x, y, psi, kappa at an array of arc lengths."""
        s = np.mod(s, self.length)
        i = np.minimum((s * self._per_ds).astype(int), self.n - 1)
        u = (s - i * self.ds)[..., None]
        a, b, c, d = (coefficients[i] for coefficients in self._c)
        r = a + u * (b + u * (c + u * d))
        t = b + u * (2.0 * c + u * (3.0 * d))
        k = 2.0 * c + u * (6.0 * d)
        tx, ty = t[..., 0], t[..., 1]
        kappa = (tx * k[..., 1] - ty * k[..., 0]) / np.hypot(tx, ty) ** 3
        return r[..., 0], r[..., 1], np.arctan2(ty, tx), kappa

    def pose(self, s: float) -> CurvePoint:
        """Point of the curve, with heading and curvature.

        Parameters
        ----------
        s : float
            Arc length [m], taken modulo the length.

        Returns
        -------
        CurvePoint
        """
        s %= self.length
        i = int(s * self._per_ds)
        u = s - i * self.ds
        ax, bx, cx, dx, ay, by, cy, dy = self._cells[i]
        tx = bx + u * (2.0 * cx + u * 3.0 * dx)
        ty = by + u * (2.0 * cy + u * 3.0 * dy)
        kx = 2.0 * cx + u * 6.0 * dx
        ky = 2.0 * cy + u * 6.0 * dy
        return CurvePoint(
            ax + u * (bx + u * (cx + u * dx)),
            ay + u * (by + u * (cy + u * dy)),
            math.atan2(ty, tx),
            (tx * ky - ty * kx) / (tx * tx + ty * ty) ** 1.5,
        )

    def position(self, s: float) -> tuple[float, float]:
        """Point ``(x, y)`` [m] of the curve at arc length ``s`` [m], taken modulo the length."""
        s %= self.length
        i = int(s * self._per_ds)
        u = s - i * self.ds
        ax, bx, cx, dx, ay, by, cy, dy = self._cells[i]
        return ax + u * (bx + u * (cx + u * dx)), ay + u * (by + u * (cy + u * dy))

    def to_cartesian(self, s: _Array, d: _Array) -> tuple[np.ndarray, np.ndarray]:
        """Positions at arc length `s` and lateral error `d`: the inverse of `project`.

        Parameters
        ----------
        s, d : float or array_like
            Arc length [m], taken modulo the length, and lateral error [m], positive to the left.

        Returns
        -------
        x, y : float or ndarray
            Position [m].
        """
        x, y, psi, _ = self._curve(np.asarray(s, dtype=float))
        return x - d * np.sin(psi), y + d * np.cos(psi)

    # -- from positions to the curve ---------------------------------------------------------

    def project(self, x: float, y: float, psi: float | None = None) -> Projection:
        """Closest point of the whole curve.

        Parameters
        ----------
        x, y : float
            Position [m].
        psi : float, optional
            Heading of the car [rad]; only parts of the curve within 90 degrees of it count. It
            distinguishes branches where the track crosses itself or runs back alongside.

        Returns
        -------
        Projection

        Raises
        ------
        ParameterError
            If the position is not finite.
        """
        if not (abs(x) < FARTHEST and abs(y) < FARTHEST and math.isfinite(psi or 0.0)):
            heading = "" if psi is None else f", heading {psi}"
            raise ParameterError(f"expected a finite position on earth, got ({x}, {y}){heading}")
        if psi is None:
            if self._tree is None:
                self._tree = point_tree(np.stack((self.x, self.y), axis=1))
            distance, i = self._tree.query((x, y))
        else:
            along = np.cos(self.psi - psi) >= 0.0
            square = np.where(along, (self.x - x) ** 2 + (self.y - y) ** 2, math.inf)
            i = int(np.argmin(square))
            distance = math.sqrt(square[i])
        s = float(self.s[i])
        foot = self.project_near(x, y, s, reach=2.0 * self.ds)
        if foot is not None and abs(foot.d) <= distance + 1e-9:
            return foot
        # From a center of curvature all points of the arc are equally close: any will do.
        point = self.pose(s)
        side = math.cos(point.psi) * (y - point.y) - math.sin(point.psi) * (x - point.x)
        return Projection(s, math.copysign(distance, side), point.psi, point.kappa)

    def project_near(
        self, x: float, y: float, s_guess: float, reach: float = math.inf
    ) -> Projection | None:
        """Closest point of the curve around a guess: Newton's method on the squared distance.

        Parameters
        ----------
        x, y : float
            Position [m].
        s_guess : float
            Finite arc length [m] to start from, taken modulo the length.
        reach : float, optional
            Largest distance of the foot from the guess along the curve [m].

        Returns
        -------
        Projection or None
            None if there is no closest point within reach: the iteration did not converge,
            diverged or ended at a farthest point, or the position is not finite.
        """
        length, ds, per_ds, cells = self.length, self.ds, self._per_ds, self._cells
        s = s_guess % length
        moved = 0.0
        for _ in range(12):
            i = int(s * per_ds)
            u = s - i * ds
            ax, bx, cx, dx, ay, by, cy, dy = cells[i]
            u3 = 3.0 * u
            ex = x - ax - u * (bx + u * (cx + u * dx))
            ey = y - ay - u * (by + u * (cy + u * dy))
            tx = bx + u * (cx + cx + u3 * dx)
            ty = by + u * (cy + cy + u3 * dy)
            kx = cx + u3 * dx
            ky = cy + u3 * dy
            # Half the second derivative of the squared distance, 1 - kappa d at the foot. Where it
            # is small or negative (at and beyond the center of curvature), Newton's step would
            # diverge or go to the farthest point; the bounded step still goes downhill.
            curving = tx * tx + ty * ty - 2.0 * (ex * kx + ey * ky)
            step = (ex * tx + ey * ty) / (curving if curving > 0.1 else 0.1)
            moved += step
            if not -reach < moved < reach:
                return None
            s = (s + step) % length
            # Newton converges quadratically: after a step this small the error is 1e-8 m.
            if -1e-4 < step < 1e-4:
                if curving <= 0.0:
                    return None
                norm = math.sqrt(tx * tx + ty * ty)
                values = (
                    s if s < length else 0.0,  # rounding: -1e-17 % length is the length itself
                    (tx * ey - ty * ex) / norm,
                    math.atan2(ty + 2.0 * step * ky, tx + 2.0 * step * kx),
                    2.0 * (tx * ky - ty * kx) / (norm * norm * norm),
                )
                # Same as Projection(...), in half the time.
                return _new(Projection, values)
        return None

    def point_ahead(self, x: float, y: float, s_from: float, distance: float) -> LookaheadPoint:
        """First point ahead at a given straight-line distance from a position.

        Straight-line distance grows no faster than arc length, so advancing by the distance still
        missing never passes the first such point; close to it, Newton's method takes over.

        Parameters
        ----------
        x, y : float
            Position [m], normally of the car.
        s_from : float
            Finite arc length [m] where the search begins, normally of the position's projection.
        distance : float
            Straight-line distance [m].

        Returns
        -------
        LookaheadPoint
            The point at `s_from` if that is already farther than `distance`. If no point is that
            far, the farthest one of the half lap ahead, to within a cell. The `distance` of the
            result is its actual distance.

        Raises
        ------
        ParameterError
            If the position or `distance` is not a number.
        """
        length, ds, per_ds, cells = self.length, self.ds, self._per_ds, self._cells
        near = s_from
        end = far = s_from + 0.5 * length
        # Without a minimum step a curve that grazes the circle would take forever. The price: an
        # excursion beyond `distance` that is shorter than this step is missed.
        least = max(0.01 * distance, 0.001 * length)
        s = s_from
        while True:
            place = s % length
            i = int(place * per_ds)
            u = place - i * ds
            ax, bx, cx, dx, ay, by, cy, dy = cells[i]
            ex = ax + u * (bx + u * (cx + u * dx)) - x
            ey = ay + u * (by + u * (cy + u * dy)) - y
            tx = bx + u * (cx + cx + u * 3.0 * dx)
            ty = by + u * (cy + cy + u * 3.0 * dy)
            now = math.sqrt(ex * ex + ey * ey)
            missing = distance - now
            slope = (ex * tx + ey * ty) / now if now > 0.0 else 1.0
            if s == s_from and not missing > 0.0:
                if missing != missing:
                    raise ParameterError(
                        f"expected finite numbers, got position ({x}, {y}), distance {distance}"
                    )
                return LookaheadPoint(place, x + ex, y + ey, now)
            if missing > 0.0:
                near = s
            else:
                far = s
            if slope > 0.5 and -0.1 < missing < 0.1:
                step = missing / slope
                if -1e-4 < step < 1e-4:
                    values = (s + step) % length, x + ex + step * tx, y + ey + step * ty, distance
                    return _new(LookaheadPoint, values)
                s += step
            elif missing > 0.0:
                s += missing if missing > least else least
            else:
                s = near
            if not near < s < far:
                if far == end:
                    return self._farthest_ahead(x, y, s_from)
                if far - near < 1e-6:
                    return LookaheadPoint(place, x + ex, y + ey, now)
                s = 0.5 * (near + far)

    def _farthest_ahead(self, x, y, s_from):
        """Farthest start of a cell in the half lap ahead: a coarse search, then a fine one."""
        cells = s_from % self.length * self._per_ds
        first, end = math.ceil(cells), math.floor(cells + 0.5 * self.n) + 1
        stride = max(1, self.n // 1024)
        index = np.arange(first, end, stride)
        for _ in range(2):
            cell = index % self.n
            square = (self.x[cell] - x) ** 2 + (self.y[cell] - y) ** 2
            best = int(np.argmax(square))
            i, farthest = int(cell[best]), float(square[best])
            index = np.arange(max(first, index[best] - stride), min(end, index[best] + stride))
        return LookaheadPoint(
            float(self.s[i]), float(self.x[i]), float(self.y[i]), math.sqrt(farthest)
        )
