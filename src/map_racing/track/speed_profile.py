"""Fastest speeds along a closed curve for given acceleration limits."""

import math

import numpy as np

from ..errors import ParameterError

__all__ = ["accelerations", "lap_time", "raceline_speeds", "speed_profile"]

# Longest cell of a raceline's profile [m]; cells a quarter as long change the lap time of the
# shipped tracks by less than 0.1 %.
_CELL = 0.025


def speed_profile(kappa, ds, *, a_lat_max, a_drive_max, a_brake_max, v_max, v_min=0.0):
    """Highest speeds within the friction ellipse, forwards and backwards around the lap.

    Lateral and longitudinal acceleration share the grip,
    ``(v^2 kappa / a_lat_max)^2 + (a_long / a_long_max)^2 <= 1``, where the longitudinal limit is
    `a_drive_max` or `a_brake_max`. Between two points acceleration is constant and curvature is
    linear; each cell's acceleration is bounded by its higher curvature at its higher speed, so that
    the limits also hold between the points.

    Parameters
    ----------
    kappa : array_like, shape (n,)
        Curvature at equal steps of arc length around the closed curve [1/m].
    ds : float
        The step [m].
    a_lat_max, a_drive_max, a_brake_max : float or callable
        Largest lateral, driving and braking acceleration [m/s^2]: positive numbers, or functions
        of an array of speeds [m/s], whose driving limit may drop to 0.
    v_max : float or array_like, shape (n,)
        Top speed [m/s] of the car, or at each point, where it may be 0.
    v_min : float, optional
        Points too tight for this speed [m/s] are driven at it although it exceeds the lateral
        limit; at lower speeds the lateral share of the grip is at most ``(v / v_min)^2``. With 0, a
        point too tight for any speed is an error.

    Returns
    -------
    ndarray, shape (n,)
        Speed [m/s].

    Raises
    ------
    ParameterError
        If a limit is not positive, the curvature is not finite, or a point is too tight for the
        lateral limit at any speed.

    Notes
    -----
    The speed reached at the end of a cell grows with the speed at its beginning. So one profile is
    the fastest at all points at once: any other that respects the cells' bounds is nowhere faster.

    This requires that the longitudinal limits and the curvature limit ``a_lat_max(v) / v^2`` do not
    grow with speed. If one does, its least value at any lower speed is used. Functions are
    tabulated over v^2 and rounded to the safe side between the entries.
    """
    kappa = np.abs(np.asarray(kappa, dtype=float))
    if kappa.ndim != 1 or not kappa.size or not np.all(np.isfinite(kappa)):
        raise ParameterError("speed profile: expected one finite curvature per point")
    highest = np.max(v_max)
    for key, value in (("ds", ds), ("v_max", highest)):
        if not 0.0 < value < math.inf:
            raise ParameterError(f"speed profile: expected {key} > 0, got {value}")
    if np.shape(v_max) not in ((), kappa.shape) or np.min(v_max) < 0.0:
        raise ParameterError("speed profile: expected one v_max >= 0, or one at each point")
    limits = _Limits(a_lat_max, a_drive_max, a_brake_max, max(float(highest), v_min), v_min)
    most = 1.0 / limits.radius(v_min) if v_min > 0.0 else math.inf
    tight = kappa > most
    cell = np.maximum(kappa, np.roll(kappa, -1))
    point = np.minimum(np.maximum(cell, np.roll(cell, 1)), most)
    if np.any(point * limits.tightest > 1.0 + 1e-12):
        k = int(np.argmax(kappa))
        raise ParameterError(
            f"speed profile: s = {k * ds:.2f} m: the car cannot steer a radius of "
            f"{1.0 / kappa[k]:.3f} m at any speed; {limits.tightest:.3f} m is the least it can"
        )
    square = np.minimum(limits.fastest(point), np.square(v_max))
    tight |= np.roll(tight, 1) | np.roll(tight, -1)
    square[tight] = np.minimum(square[tight], v_min * v_min)
    square[square < 1e-18] = 0.0  # standstill, where the lateral share over v^2 would overflow
    # Nothing lowers the slowest point, because from there speed can only grow in both directions.
    # So one pass each way around the lap, begun there, gives the converged solution.
    start = int(np.argmin(square))
    square = np.roll(square, -start).tolist()
    cell = np.roll(cell, -start).tolist()
    square = limits.accelerate(square, cell, 2.0 * ds, limits.drive)
    # In the mirrored lap, with the slowest point kept first, braking is driving.
    square = limits.accelerate(square[:1] + square[:0:-1], cell[::-1], 2.0 * ds, limits.brake)
    return np.roll(np.sqrt(square[:1] + square[:0:-1]), start)


def raceline_speeds(raceline, **limits):
    """Fastest speeds along a raceline, computed in cells of at most 25 mm.

    Parameters
    ----------
    raceline : Raceline
    **limits
        As for `speed_profile`.

    Returns
    -------
    speed : ndarray, shape (n,)
        Speed at the raceline's cells, `Raceline.s` [m/s].
    time : float
        Lap time [s].

    Raises
    ------
    ParameterError
        As for `speed_profile`.
    """
    parts = max(1, math.ceil(raceline.ds / _CELL - 1e-9))
    count = parts * raceline.n
    ds = raceline.length / count
    speed = speed_profile(raceline.sample(np.arange(count) * ds).kappa, ds, **limits)
    return speed[::parts], lap_time(speed, ds)


class _Limits:
    """Limits of the car as lists over the squared speed, linear in between.

    ``radius`` is the tightest radius the car can hold, ``v^2 / a_lat_max``; for a constant limit it
    is proportional to the squared speed. Functions are tabulated at `_ENTRIES` values; eight times
    as many change lap times of ``nuc4`` by less than 0.1 ms and take ten times longer.
    """

    _ENTRIES, _BETWEEN = 2049, 4

    def __init__(self, a_lat_max, a_drive_max, a_brake_max, v_max, v_min):
        given = {"a_lat_max": a_lat_max, "a_drive_max": a_drive_max, "a_brake_max": a_brake_max}
        constant = not any(callable(limit) for limit in given.values())
        entries = 2 if constant else self._ENTRIES
        self._end, self._slow = v_max**2, v_min * v_min
        fine = np.linspace(0.0, self._end, (entries - 1) * self._BETWEEN + 1)
        # A kinematic lateral limit is 0 at standstill, but its radius is not: avoid 0 / 0.
        speed = np.sqrt(np.maximum(fine, 1e-6 * self._end / fine.size))
        columns = {key: self._values(key, limit, speed) for key, limit in given.items()}
        radius = (fine if constant else speed**2) / columns["a_lat_max"]
        self._radius = self._table(np.maximum.accumulate(radius))
        self.drive, self.brake = (
            self._table(np.minimum.accumulate(columns[key]), -1.0)
            for key in ("a_drive_max", "a_brake_max")
        )
        self.tightest = self._radius[0]

    @staticmethod
    def _values(key, limit, speed):
        if not callable(limit):
            if not 0.0 < limit < math.inf:
                raise ParameterError(f"speed profile: expected {key} > 0, got {limit}")
            return np.full(speed.size, float(limit))
        values = np.asarray(limit(speed), dtype=float)
        if values.shape != speed.shape:
            raise ParameterError(f"speed profile: expected one {key} for each speed")
        least = 0.0 if key == "a_drive_max" else 1e-12
        with np.errstate(invalid="ignore"):
            bad = ~(np.isfinite(values) & (values >= least))
        if bad.any():
            k = int(np.argmax(bad))
            raise ParameterError(
                f"speed profile: expected {key} > 0, got {values[k]} at {speed[k]:.2f} m/s"
            )
        return values

    def _table(self, fine, side=1.0):
        """Thin out `fine` values, shifted to one side so that interpolation bounds all of them."""
        table = side * fine[:: self._BETWEEN]
        cells = side * fine[:-1].reshape(-1, self._BETWEEN)
        part = np.arange(self._BETWEEN) / self._BETWEEN
        straight = table[:-1, None] * (1.0 - part) + table[1:, None] * part
        beyond = np.max(cells - straight, axis=1)
        beyond[beyond < 1e-12 * np.abs(table[1:])] = 0.0  # rounding
        table[:-1] += beyond
        table[1:] = np.maximum(table[1:], table[1:] + beyond)
        table = np.maximum.accumulate(table)
        return (side * table).tolist()

    def radius(self, speed):
        """Tightest radius [m] that can be held at a speed."""
        entries = np.linspace(0.0, self._end, len(self._radius))
        return float(np.interp(speed * speed, entries, self._radius))

    def fastest(self, kappa):
        """Largest squared speeds at curvatures, ``v^2 kappa = a_lat_max(v)``."""
        entries = np.linspace(0.0, self._end, len(self._radius))
        radius = np.array(self._radius)
        wanted = 1.0 / np.maximum(kappa, 1e-12)
        # The last of equal radii; beyond the table the car drives at top speed.
        k = np.clip(np.searchsorted(radius, wanted, side="right") - 1, 0, radius.size - 2)
        rise = radius[k + 1] - radius[k]
        with np.errstate(invalid="ignore", divide="ignore"):
            part = np.where(rise > 0.0, (wanted - radius[k]) / rise, 1.0)
        return np.minimum(entries[k] + np.clip(part, 0.0, None) * entries[1], self._end)

    def accelerate(self, square, kappa, double_ds, a_long):
        """Limit squared speeds to those reached with the grip that cornering leaves."""
        radius = self._radius
        per_entry = (len(radius) - 1) / self._end
        last = len(radius) - 2
        slow = self._slow
        most = 1.0 / slow if slow > 0.0 else math.inf
        reached = square[0]
        limited = [reached]
        for i in range(1, len(square)):
            begin, tight = reached, kappa[i - 1]
            reached = square[i]
            if reached > begin:
                # The limits at the end speed apply to the whole cell. With them fixed, the ellipse
                # gives a quadratic equation; they change little with speed, so a few iterations
                # converge. `use` is the lateral share divided by the squared speed.
                for _ in range(50):
                    entry = reached * per_entry
                    k = int(entry)
                    if k > last:
                        k = last
                    part = entry - k
                    gain = double_ds * (a_long[k] + part * (a_long[k + 1] - a_long[k]))
                    use = tight * (radius[k] + part * (radius[k + 1] - radius[k])) / reached
                    if reached <= slow and use > most:
                        use = most
                    grip = 1.0 + use * use * (gain * gain - begin * begin)
                    end = begin
                    if grip > 0.0:
                        end = (begin + gain * math.sqrt(grip)) / (1.0 + gain * gain * use * use)
                    if end >= square[i]:
                        end = square[i]
                    if end < begin:
                        end = begin
                    if end <= 0.0:  # from rest, with no drive at such a speed
                        end = 0.5 * reached
                    if abs(end - reached) <= 1e-13 * reached:
                        break
                    reached = end
            limited.append(reached)
        return limited


def lap_time(speed, ds):
    """Lap time with constant acceleration from each point to the next.

    Parameters
    ----------
    speed : array_like, shape (n,)
        Speed at points around the lap [m/s].
    ds : float or ndarray, shape (n,)
        Arc length from each of them to the next [m].

    Returns
    -------
    float
        Lap time [s]; infinite if the speed is 0 at two neighboring points.
    """
    speed = np.asarray(speed, dtype=float)
    both = speed + np.roll(speed, -1)
    return float(2.0 * np.sum(ds / both)) if np.all(both > 0.0) else math.inf


def accelerations(speed, ds):
    """Acceleration that is constant from each point to the next, ``v_2^2 = v_1^2 + 2 a ds``.

    Parameters
    ----------
    speed, ds
        As for `lap_time`.

    Returns
    -------
    ndarray, shape (n,)
        [m/s^2]
    """
    return (np.roll(speed, -1) ** 2 - speed**2) / (2.0 * ds)
