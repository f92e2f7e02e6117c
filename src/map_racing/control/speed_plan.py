"""The speeds of a lap: those of the raceline, as far as the grip allows."""

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

# Driven where a bend is tighter than the car can steer, and commanded where the car is off the
# course [m/s]: any tires hold at it.
WALKING_PACE = 1.0

# Length of the plan's cells [m]. Half as long ones change the lap times of the shipped tracks by
# 0.2 %; long courses get longer ones, so that a plan takes about 10 ms on any of them.
CELL, LONGEST_CELL, CELLS = 0.025, 0.1, 4000

# Largest speed planned, as a share of the car's top speed. Commanded its top speed alone, a car
# whose speed controller is proportional would reach it late; what is beyond cannot be driven, but
# the public simulator's car goes on shifting its load at its top speed, and runs wide.
_BEYOND_TOP = 1.1

# Share of the tires' usable grip below which no more margin is left at the steering lock. With 0.5
# lines with bumps are followed less closely (0.047 instead of 0.043 m); with 0, too (0.047 m), and
# the public simulator's car takes 4 % longer for laps with hairpins close to its lock.
_OF_TIRES = 0.3

# Rounds in which the level of a speed and the speed of that level are found.
ROUNDS = 3

# A place is slowed where the plan is below this share of what is asked: not by rounding.
SLOWED = 0.99


def scaled_speed(
    raceline: Raceline, scale: float = 1.0, sectors=None
) -> Callable[[np.ndarray], np.ndarray]:
    """Speed along a raceline, scaled as a whole and by sectors.

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
    """Speed that is asked for along a raceline, whatever the grip.

    It is `scaled_speed` by the scale of the `ControllerParameters`, up to their largest speed.

    Parameters
    ----------
    raceline : Raceline
    parameters : ControllerParameters
    sectors : SpeedSectors, optional

    Returns
    -------
    callable
        From arc lengths [m], ndarray of shape (n,), to speeds [m/s] of the same shape.

    Raises
    ------
    ParameterError
        If the raceline has no speeds.
    """
    speed = scaled_speed(raceline, parameters.speed_scale, sectors)
    return lambda s: np.minimum(speed(s), parameters.v_max_mps)


def lateral_limit(grip, share, v_max):
    """Lateral acceleration that may be used at a speed.

    It is a share of what the car reaches, for the tires may hold less than is believed. Where the
    steering lock limits it to less than 0.3 of what may be used of the tires, which hold at a low
    speed what they hold at higher ones, that margin is there without a share: and slower the car
    would not turn tighter.

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
        From speeds [m/s], ndarray of shape (n,), to accelerations [m/s^2] of the same shape.
    """
    speeds = np.linspace(0.0, v_max, 400)
    tires = np.maximum.accumulate(grip.max_lateral_acceleration(speeds)[::-1])[::-1]

    def limit(v):
        reached = grip.max_lateral_acceleration(v)
        without = np.minimum(reached, _OF_TIRES * share * np.interp(v, speeds, tires))
        return np.maximum(share * reached, without)

    return limit


class _Profile:
    """What can be said of planned speeds: `s`, `ds`, `speed`, `requested`, `has_own_speeds`."""

    @property
    def lap_time(self):
        """Time of a lap that keeps to the plan [s]."""
        return lap_time(self.speed, self.ds)

    @property
    def share_slowed(self):
        """Share of the lap's length on which the plan is slower than what is asked for."""
        return float(np.mean(self.speed < SLOWED * self.requested))

    @property
    def slowest_place(self):
        """Where the plan takes most from what is asked for: ``(s, planned, requested)``.

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
    """Highest speeds around a lap within what is asked for and what the car can do.

    The raceline's speeds, scaled and bounded, are lowered to a profile within the friction ellipse,
    so that the car brakes before a bend and not in it; see `map_racing.track.speed_profile`. Where
    a bend is tighter than the car can steer, the plan has walking pace.

    A raceline without speeds gets the fastest profile as its speeds, and those are scaled.

    Parameters
    ----------
    raceline : Raceline
    parameters : ControllerParameters
        Of these it depends on the fields in `DEPENDS_ON` alone.
    grip : LookupTable or other steering map
        Its ``max_lateral_acceleration`` and ``grip_use`` make the lateral limit, see
        `lateral_limit`.
    sectors : SpeedSectors, optional
    top_speed : float, optional
        The car's [m/s]; not much more is asked of it.

    Attributes
    ----------
    s : ndarray, shape (n,)
        Arc length of the plan's cells [m].
    speed : ndarray, shape (n,)
        Planned speed there [m/s].
    requested : ndarray, shape (n,)
        What is asked for there [m/s].
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
            # Between the smallest of numbers, interpolation rounds to below 0.
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
    """Speed plans of a car for any grip, of which it drives the one of the present.

    The plans of some levels of the friction are made beforehand; in between the speed is
    interpolated: within 0.1 % of the plan made for that level on average, and 1 % where it ends to
    accelerate and brakes. So no plan has to be made while the car drives.

    The level is that of the speed, as tires of another stiffness turn slow bends worse or better
    than fast ones. Where the plan brakes from one level to another, it brakes 5 % harder.

    Parameters
    ----------
    raceline, parameters, sectors, top_speed
        As of `SpeedPlan`.
    grip : TireSteering
        Of the vehicle file.

    Attributes
    ----------
    slowest : float
        Least speed of the lap on a slippery day [m/s].
    grips : list of float
        Grip that there is at each speed, relative to the vehicle file's, for `TireSteering.at`.
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
        # The level hardly changes with the speed, so that each round comes 20 times closer.
        for _ in range(ROUNDS):
            slow, fast, part = self._between(level)
            v = slow.speed_at(s)
            v += part * (fast.speed_at(s) - v)
            level = self._grip.at(v, grips)
        return v

    def _between(self, level):
        """Plans of the levels around one, and how far that is from the first to the second."""
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
        """What is asked for there [m/s], shape (n,)."""
        return self._driven()[1]

    def _driven(self):
        """`speed` and `requested`, as `speed_at`."""
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
