"""Speeds of a lap: the raceline's, as far as the grip allows."""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import TYPE_CHECKING, Callable

import numpy as np

from ..errors import ParameterError
from ..track.speed_profile import lap_time, speed_profile
from .speed_sectors import check_scale

if TYPE_CHECKING:
    from ..track.raceline import Raceline

__all__ = [
    "WALKING_PACE",
    "AdaptiveSpeedPlan",
    "SpeedPlan",
    "lateral_limit",
    "requested_speed",
    "scaled_speed",
]

# Speed in bends tighter than the car can steer, and of a car that is off course [m/s]: any tires
# hold at it.
WALKING_PACE = 1.0

# Length of the plan's cells [m]. Halving it changes the lap times of the shipped tracks by 0.2 %.
# Long tracks get longer cells, so that any plan takes about 10 ms.
CELL, LONGEST_CELL, CELLS = 0.025, 0.1, 4000

# Largest planned speed, relative to the car's top speed. A car with a proportional speed controller
# reaches its top speed late if commanded no more than that. Beyond this factor the car is no
# faster, but the public simulator's keeps shifting its load at top speed, and runs wide.
_BEYOND_TOP = 1.1

# Share of the tires' usable grip up to which a limit set by the steering lock is used without
# margin. With 0.5, lines with bumps are followed less closely (0.047 instead of 0.043 m). With 0
# they are, too (0.047 m), and the public simulator's car takes 4 % longer for laps with hairpins
# close to its lock.
_OF_TIRES = 0.3

# Fixed-point iterations between the grip level at a speed and the speed at that level.
ROUNDS = 3

# A place counts as slowed if the plan is below this share of the requested speed, so that rounding
# does not count.
SLOWED = 0.99


def scaled_speed(
    raceline: Raceline, scale: float = 1.0, sectors=None
) -> Callable[[np.ndarray], np.ndarray]:
    """Speed along a raceline, scaled globally and by sector.

    Parameters
    ----------
    raceline : Raceline
    scale : float
        0 to `LARGEST_SCALE`.
    sectors : SpeedSectors, optional
        Anything with ``scale_at(s)``.

    Returns
    -------
    callable
        Speeds [m/s] at an array of arc lengths [m].

    Raises
    ------
    ParameterError
        If the raceline has no speeds, or the scale is out of its range.
    """
    if raceline.speed is None:
        raise ParameterError(f"{raceline.source or raceline.name}: expected speeds, got none")
    check_scale("speed_scale", scale)

    def speed(s):
        v = scale * raceline.sample(s).speed
        return v if sectors is None else v * np.array([sectors.scale_at(at) for at in s.tolist()])

    return speed


def requested_speed(raceline, parameters, sectors=None):
    """Speed requested along a raceline, whatever the grip.

    It is `scaled_speed` with the scale of the `ControllerParameters`, up to their largest speed.

    Parameters
    ----------
    raceline : Raceline
    parameters : ControllerParameters
    sectors : SpeedSectors, optional

    Returns
    -------
    callable
        Maps arc lengths [m], an ndarray of shape (n,), to speeds [m/s] of the same shape.

    Raises
    ------
    ParameterError
        If the raceline has no speeds.
    """
    speed = scaled_speed(raceline, parameters.speed_scale, sectors)
    return lambda s: np.minimum(speed(s), parameters.v_max_mps)


def lateral_limit(grip, share, v_max):
    """Lateral acceleration that the plan may use at a speed.

    It is a share of what the car can reach, because the tires may have less grip than assumed. At
    low speeds the steering lock, not the tires, limits the car. Where that limit is below 0.3 of
    the usable grip of the tires, no further margin is taken: the tires have plenty, and driving
    slower would not let the car turn tighter.

    Parameters
    ----------
    grip : LookupTable or other steering map
    share : float
        ``grip_use``.
    v_max : float
        Largest speed [m/s].

    Returns
    -------
    callable
        Maps speeds [m/s], an ndarray of shape (n,), to accelerations [m/s^2] of the same shape.
    """
    speeds = np.linspace(0.0, v_max, 400)
    tires = np.maximum.accumulate(grip.max_lateral_acceleration(speeds)[::-1])[::-1]

    def limit(v):
        reached = grip.max_lateral_acceleration(v)
        without = np.minimum(reached, _OF_TIRES * share * np.interp(v, speeds, tires))
        return np.maximum(share * reached, without)

    return limit


class _Profile:
    """Summary of planned speeds, from `s`, `ds`, `speed`, `requested` and `has_own_speeds`."""

    @property
    def lap_time(self):
        """Lap time at the planned speeds [s]."""
        return lap_time(self.speed, self.ds)

    @property
    def share_slowed(self):
        """Share of the lap's length on which the plan is slower than requested."""
        return float(np.mean(self.speed < SLOWED * self.requested))

    @property
    def slowest_place(self):
        """Place where the plan is slowest relative to the request: ``(s, planned, requested)``.

        Arc length [m] and speeds [m/s].
        """
        asked = np.maximum(self.requested, 1e-9)
        i = int(np.argmin(np.where(self.requested > 0.0, self.speed / asked, 1.0)))
        return float(self.s[i]), float(self.speed[i]), float(self.requested[i])

    def __str__(self):
        if not self.has_own_speeds:
            return (
                "the raceline has no speeds: driven as fast as the grip allows, "
                f"{self.speed.min():.1f} to {self.speed.max():.1f} m/s"
            )
        share = self.share_slowed
        if not share:
            return "the grip suffices for the raceline's speeds"
        s, planned, requested = self.slowest_place
        percent = f"{share:.0%}" if share >= 0.01 else "less than 1%"
        return (
            f"slower than the raceline on {percent.replace('%', ' %')} of the lap, "
            f"most at s = {s:.1f} m: {planned:.1f} instead of {requested:.1f} m/s"
        )


class SpeedPlan(_Profile):
    """Highest speeds around a lap that neither the request nor the grip forbids.

    The raceline's speeds, scaled and bounded, are lowered to a profile within the friction ellipse,
    so that the car brakes before a bend and not in it; see `map_racing.track.speed_profile`. In a
    bend tighter than the car can steer, the plan is walking pace.

    A raceline without speeds gets the fastest profile as its speeds, which are then scaled.

    Parameters
    ----------
    raceline : Raceline
    parameters : ControllerParameters
        Only the fields in `DEPENDS_ON` matter.
    grip : LookupTable or other steering map
        Its ``max_lateral_acceleration`` gives the `lateral_limit`.
    sectors : SpeedSectors, optional
    top_speed : float, optional
        Top speed of the car [m/s]; the plan exceeds it by 10 % at most.

    Attributes
    ----------
    s : ndarray, shape (n,)
        Arc length of the plan's cells [m].
    speed : ndarray, shape (n,)
        Planned speed there [m/s].
    requested : ndarray, shape (n,)
        Requested speed there [m/s].
    """

    DEPENDS_ON = (
        *("grip_use", "a_drive_max_mps2", "a_brake_max_mps2"),
        *("speed_scale", "v_max_mps"),
    )

    def __init__(self, raceline, parameters, grip, sectors=None, top_speed=math.inf):
        cell = min(max(raceline.length / CELLS, CELL), LONGEST_CELL)
        count = max(int(math.ceil(raceline.length / cell)), 4)
        self.length, self.ds = raceline.length, raceline.length / count
        self.s = np.arange(count) * self.ds
        self.has_own_speeds = raceline.speed is not None
        kappa = raceline.sample(self.s).kappa
        use = parameters.grip_use
        if not use > 0.0:
            raise ParameterError("grip_use is 0: no speeds are planned")
        fastest = min(parameters.v_max_mps, _BEYOND_TOP * top_speed)
        lateral = lateral_limit(grip, use, fastest)

        def limited(v_max):
            if np.max(v_max) <= 0.0:
                return np.zeros(count)
            return speed_profile(
                kappa,
                self.ds,
                a_lat_max=lateral,
                a_drive_max=parameters.a_drive_max_mps2,
                a_brake_max=parameters.a_brake_max_mps2,
                v_max=v_max,
                v_min=WALKING_PACE,
            )

        if self.has_own_speeds:
            # Interpolating denormal speeds may round to below 0.
            self.requested = np.maximum(requested_speed(raceline, parameters, sectors)(self.s), 0.0)
        else:
            self.requested = parameters.speed_scale * limited(fastest)
            if sectors is not None:
                self.requested *= [sectors.scale_at(s) for s in self.s.tolist()]
            self.requested = np.minimum(self.requested, parameters.v_max_mps)
        self.speed = limited(np.minimum(self.requested, fastest))
        self._speed = self.speed.tolist() + self.speed[:2].tolist()
        self._per_ds = count / self.length

    def speed_at(self, s):
        """Planned speed [m/s] at arc length `s` [m], taken modulo the length."""
        cell = s % self.length * self._per_ds
        i = int(cell)
        v = self._speed[i]
        return v + (self._speed[i + 1] - v) * (cell - i)


class AdaptiveSpeedPlan(_Profile):
    """Speed plan whose grip may change while the car drives.

    Plans for a few friction levels are made beforehand and interpolated, so that none has to be
    made while driving. The interpolated speed is within 0.1 % of a plan made for that level on
    average, and within 1 % where the plan changes from driving to braking.

    The friction level depends on the speed, because a change of tire stiffness affects slow and
    fast bends differently. Where the plan brakes from one level to another, it brakes 5 % harder.

    Parameters
    ----------
    raceline, parameters, sectors, top_speed
        As for `SpeedPlan`.
    grip : TireSteering
        Steering map of the vehicle file's tires.

    Attributes
    ----------
    slowest : float
        Lowest speed of the lap with 0.8 of the friction [m/s].
    grips : list of float
        Present grip at each speed, relative to the vehicle file's, for `TireSteering.at`.
    """

    LEVELS = (0.3, 0.45, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4)

    def __init__(self, raceline, parameters, grip, sectors=None, top_speed=math.inf):
        self._plans = [
            SpeedPlan(raceline, parameters, grip.scaled(level, 1.0, 1.0), sectors, top_speed)
            for level in self.LEVELS
        ]
        one = self._plans[0]
        self.s, self.ds, self.has_own_speeds = one.s, one.ds, one.has_own_speeds
        self.length, self._per_ds = one.length, one._per_ds
        self.slowest = float(self._plans[self.LEVELS.index(0.8)].speed.min())
        self._grip, self.grips = grip, [1.0] * len(grip.levels)
        self._speeds = np.array([plan.speed for plan in self._plans])
        self._requested = np.array([plan.requested for plan in self._plans])

    def speed_at(self, s):
        """Planned speed [m/s] at arc length `s` [m], taken modulo the length."""
        grips = self.grips
        level = grips[0]
        # The level hardly depends on the speed, so each round reduces the error 20-fold.
        for _ in range(ROUNDS):
            slow, fast, part = self._between(level)
            v = slow.speed_at(s)
            v += part * (fast.speed_at(s) - v)
            level = self._grip.at(v, grips)
        return v

    def _between(self, level):
        """The two plans whose levels enclose this one, and the interpolation weight."""
        levels = self.LEVELS
        k = min(max(bisect_right(levels, level), 1), len(levels) - 1)
        part = (level - levels[k - 1]) / (levels[k] - levels[k - 1])
        return self._plans[k - 1], self._plans[k], min(max(part, 0.0), 1.0)

    @property
    def speed(self):
        """Planned speed at the cells [m/s], shape (n,)."""
        return self._driven()[0]

    @property
    def requested(self):
        """Requested speed at the cells [m/s], shape (n,)."""
        return self._driven()[1]

    def _driven(self):
        """`speed` and `requested`, found as in `speed_at`."""
        grips, levels, cells = self.grips, np.array(self.LEVELS), np.arange(self.s.size)
        level = np.full(self.s.size, grips[0])
        for _ in range(ROUNDS):
            k = np.clip(np.searchsorted(levels, level, "right"), 1, levels.size - 1)
            part = np.clip((level - levels[k - 1]) / (levels[k] - levels[k - 1]), 0.0, 1.0)
            speed, requested = (
                plans[k - 1, cells] + part * (plans[k, cells] - plans[k - 1, cells])
                for plans in (self._speeds, self._requested)
            )
            level = np.interp(speed, self._grip.speeds, grips)
        return speed, requested
