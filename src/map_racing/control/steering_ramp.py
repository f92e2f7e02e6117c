"""The maneuver for tire identification: slowly tightening circles at constant speed.

The car settles at a constant speed, then the steering angle rises slowly enough to be quasi-steady,
from near-straight rolling to the limit of grip, once to either side (Becker et al., ICRA 2023,
section on the identification of the tires).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum
from typing import NamedTuple, Sequence

import numpy as np

from ..errors import ParameterError
from ..validation import POSITIVE, check, documented, parameter
from ..vehicle.parameters import Vehicle
from ..vehicle.size import ONE_TENTH, size_of
from ..vehicle.steady_state import steady_state_table

__all__ = [
    "Box",
    "Circle",
    "Phase",
    "RampCommand",
    "RampParameters",
    "SteeringRamp",
    "circle_widths",
    "told_room",
]

STANDSTILL = 0.1  # m/s
# The rear breaks away when the ratio of yaw rate to speed and steering angle exceeds its settled
# value by this factor; the average is over AVERAGED_S [s]. For an understeering car it falls.
BREAKS_AWAY, AVERAGED_S = 1.3, 0.3
# Ramps of larger cars: first and last kinematic lateral acceleration [m/s^2], its rate [m/s^3], and
# extra steering for the slip angle of the front [rad].
FIRST, LAST, FASTEST_RISE, PLOWING = 1.3, 10.0, 0.2, 0.1
SIDES = {"both": (1.0, -1.0), "left": (1.0,), "right": (-1.0,)}


@documented
@dataclass(frozen=True)
class RampParameters:
    """The maneuver: speed, ramp of the steering angle, and sides.

    The circle of the first steering angle, of radius wheelbase / angle, must fit into the area.
    """

    speed_mps: float = parameter("Constant speed", "m/s", low=POSITIVE, default=2.0)
    rate_radps: float = parameter("Rate of the steering angle", "rad/s", low=POSITIVE, default=0.02)
    start_rad: float = parameter("First steering angle", "rad", low=0.0, default=0.1)
    limit_rad: float = parameter("Last steering angle", "rad", low=POSITIVE, default=0.4)
    settle_s: float = parameter(
        "Time at constant speed and first angle before the ramp. With less than 0.3 s it is not "
        "noticed if the rear breaks away",
        "s",
        low=0.0,
        default=1.0,
    )
    acceleration_mps2: float = parameter(
        "Acceleration to that speed",
        "m/s^2",
        low=POSITIVE,
        default=2.0,
    )
    sides: str = parameter(
        "Sides to which the car turns. With both, left comes first and the car stops in between",
        choices=tuple(SIDES),
        default="both",
    )

    @classmethod
    def of(cls, vehicle: Vehicle, **given: object) -> RampParameters:
        """The maneuver for a car, with defaults that suit its size.

        The default angles are for 1:10 cars at a few m/s. A larger car reaches the same lateral
        accelerations at higher speeds, with smaller angles.
        """
        size = size_of(vehicle)
        if size == ONE_TENTH:
            return cls(**given)
        speed = given.get("speed_mps", cls.speed_mps * size.time)
        per_acceleration = vehicle.l_wb / speed**2  # [rad per m/s^2]
        scaled = dict(
            speed_mps=speed,
            rate_radps=min(cls.rate_radps / size.time, FASTEST_RISE * per_acceleration),
            start_rad=min(cls.start_rad, FIRST * per_acceleration),
            limit_rad=min(cls.limit_rad, LAST * per_acceleration + PLOWING),
            settle_s=cls.settle_s * size.time,
        )
        return cls(**{**scaled, **given})

    def __post_init__(self):
        check(self)
        if self.start_rad >= self.limit_rad:
            raise ParameterError(
                f"start_rad: expected less than limit_rad, {self.limit_rad:g}, "
                f"got {self.start_rad:g}"
            )

    def check_vehicle(self, vehicle: Vehicle) -> None:
        """Refuse a maneuver that the car cannot drive.

        Raises
        ------
        ParameterError
            For a speed or steering angle beyond the car's.
        """
        for name, most in (("speed_mps", vehicle.v_max), ("limit_rad", vehicle.delta_max)):
            value = getattr(self, name)
            if value > most:
                raise ParameterError(
                    f"{name}: expected at most what {vehicle.name} can, {most:g}, got {value:g}"
                )


def circle_widths(
    parameters: RampParameters, vehicle: Vehicle, angles: Sequence[float]
) -> np.ndarray:
    """Widths [m] of the circles that a car drives at the speed of the maneuver.

    Parameters
    ----------
    parameters : RampParameters
    vehicle : Vehicle
    angles : sequence of float
        Steering angles [rad], ascending.

    Returns
    -------
    ndarray, shape (n_angles,)
        Infinite for an angle of 0, NaN where the car slides.
    """
    a_lat = steady_state_table(vehicle, [parameters.speed_mps], angles).a_lat[:, 0]
    with np.errstate(divide="ignore"):
        return 2.0 * parameters.speed_mps**2 / a_lat


def told_room(parameters: RampParameters, vehicle: Vehicle, room: float) -> tuple[str, bool]:
    """Room that the maneuver takes, in words, and whether the area is large enough.

    Parameters
    ----------
    parameters : RampParameters
    vehicle : Vehicle
    room : float
        Extent of the area from where the car starts [m].

    Returns
    -------
    text : str
        If there is too little room, with suggestions that fit.
    fits : bool
    """
    angles = np.append(parameters.start_rad, np.arange(0.01, parameters.limit_rad, 0.01))
    order = np.argsort(angles, kind="mergesort")
    widths = np.empty(angles.size)
    widths[order] = circle_widths(parameters, vehicle, angles[order])
    text = (
        f"the first circle, at {parameters.start_rad:g} rad and {parameters.speed_mps:g} m/s, is "
        f"{widths[0]:.1f} m wide with the tires of {vehicle.name}"
    )
    both = len(SIDES[parameters.sides])
    if both > 1:
        text += "; the second side begins where the first ends"
    if both * widths[0] <= room:
        return text, True
    advice = [f"start at {angle:.2f} rad" for angle in _first(angles, widths, room / both)]
    if both > 1:
        fitting = "".join(f", start at {angle:.2f} rad" for angle in _first(angles, widths, room))
        advice.append(f"drive each side by itself from the middle of the area{fitting}")
    advice.append(f"widen the area to {both * widths[0]:.1f} m")
    text += f". The area reaches {room:g} m, and stops the car at its edge: "
    return text + ", or ".join(advice), False


def _first(angles, widths, room):
    """The smallest first angle [rad] whose circle fits, in a list; empty if none or unchanged."""
    fitting = angles[(widths <= room)]
    return [] if not fitting.size or fitting.min() <= angles[0] else [float(fitting.min())]


@dataclass(frozen=True)
class Circle:
    """Area within a radius [m] around a center [m]."""

    x: float
    y: float
    radius: float

    def __post_init__(self):
        if not (math.isfinite(self.x + self.y) and 0.0 < self.radius < math.inf):
            raise ParameterError(f"area: expected a circle, got {self}")

    @property
    def room(self) -> float:
        """Distance from its center, where the car starts, to its edge [m]."""
        return self.radius

    def contains(self, x: float, y: float) -> bool:
        """Whether a position [m] is inside; False if it is not finite."""
        return math.hypot(x - self.x, y - self.y) <= self.radius


@dataclass(frozen=True)
class Box:
    """Area between limits of x and y [m]."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float

    def __post_init__(self):
        if not (self.x_min < self.x_max and self.y_min < self.y_max):
            raise ParameterError(f"area: expected a box, got {self}")

    @property
    def room(self) -> float:
        """Largest distance to its edge from the best starting place [m]."""
        return min(self.x_max - self.x_min, self.y_max - self.y_min)

    def contains(self, x: float, y: float) -> bool:
        """Whether a position [m] is inside; False if it is not finite."""
        return self.x_min <= x <= self.x_max and self.y_min <= y <= self.y_max


class Phase(Enum):
    """Phase of the maneuver."""

    WAITING = "waiting for the dead-man button"
    OUTSIDE = "outside of the area"
    STARTING = "reaching its speed"
    RAMPING = "ramping"
    STOPPING = "stopping"
    DONE = "done"


class RampCommand(NamedTuple):
    """Steering angle [rad], speed [m/s], and phase of the maneuver."""

    steering_angle: float
    speed: float
    phase: Phase


class SteeringRamp:
    """Steering ramps to either side within an area, while somebody holds the dead-man button.

    Releasing the button, or leaving the area, stops the car. Once the button is held again, inside
    the area and at standstill, the interrupted ramp starts over. A ramp ends early where the rear
    breaks away: the limit is reached, and steering more would spin the car.

    Parameters
    ----------
    parameters : RampParameters
    area : Circle or Box

    Attributes
    ----------
    completed : int
        Number of completed ramps.
    """

    def __init__(self, parameters: RampParameters, area: Circle | Box):
        self.parameters = parameters
        self.area = area
        self.completed = 0
        self._sides = SIDES[parameters.sides]
        self._phase = Phase.WAITING
        self._angle = 0.0
        self._speed = 0.0
        self._since = None
        self._last_t = None
        self._turned = self._steered = self._settled_gain = 0.0

    def update(
        self, t: float, x: float, y: float, v: float, enabled: bool, r: float = math.nan
    ) -> RampCommand:
        """Command for one pose.

        Parameters
        ----------
        t : float
            Time of the pose [s].
        x, y : float
            Position [m].
        v : float
            Measured speed [m/s].
        enabled : bool
            Whether the dead-man button is held.
        r : float, optional
            Measured yaw rate [rad/s]; without it, a rear that breaks away goes unnoticed.

        Returns
        -------
        RampCommand
        """
        elapsed = 0.0 if self._last_t is None else min(max(t - self._last_t, 0.0), 0.1)
        self._last_t = t
        if self._phase is Phase.DONE:
            return self._command()
        inside = self.area.contains(x, y)
        if not (enabled and inside and math.isfinite(v)):
            self.interrupt()
            if not inside:
                self._phase = Phase.OUTSIDE
        elif self._phase in (Phase.WAITING, Phase.OUTSIDE, Phase.STOPPING):
            self._rest(v)
        elif self._phase is Phase.STARTING:
            self._start(t, elapsed)
            self._settled_gain = self._average_gain(v, r, elapsed)
        else:
            self._ramp(elapsed, self._average_gain(v, r, elapsed))
        return self._command()

    def interrupt(self) -> None:
        """Stop; the interrupted ramp will start over from standstill."""
        if self._phase is not Phase.DONE:
            self._phase, self._speed = Phase.WAITING, 0.0

    def _command(self):
        return RampCommand(self._angle, self._speed, self._phase)

    def _rest(self, v):
        """Wait for standstill, then start the next ramp or finish."""
        self._speed = 0.0
        if abs(v) > STANDSTILL:
            return
        if self.completed == len(self._sides):
            self._phase, self._angle = Phase.DONE, 0.0
            return
        self._phase, self._since = Phase.STARTING, None
        self._angle = self._sides[self.completed] * self.parameters.start_rad

    def _start(self, t, elapsed):
        parameters = self.parameters
        self._speed = min(
            self._speed + parameters.acceleration_mps2 * elapsed, parameters.speed_mps
        )
        if self._speed < parameters.speed_mps:
            return
        if self._since is None:
            self._since = t
            self._turned = self._steered = 0.0  # until now the wheels may still have been turning
        if t - self._since >= parameters.settle_s:
            self._phase = Phase.RAMPING

    def _average_gain(self, v, r, elapsed):
        """Curvature of the path by steering angle [1/(m rad)], averaged over a short time."""
        if math.isfinite(r):
            share = elapsed / AVERAGED_S
            self._turned += share * (r - self._turned)
            self._steered += share * (v * self._angle - self._steered)
        return self._turned / self._steered if self._steered else 0.0

    def _ramp(self, elapsed, gain):
        side = self._sides[self.completed]
        angle = abs(self._angle) + self.parameters.rate_radps * elapsed
        settled = self.parameters.settle_s >= AVERAGED_S
        if settled and 0.0 < BREAKS_AWAY * self._settled_gain < gain:
            angle = 0.0  # straighten the wheels to catch the car
        elif angle < self.parameters.limit_rad:
            self._angle = side * angle
            return
        else:
            angle = self.parameters.limit_rad
        self._angle = side * angle
        self.completed += 1
        self._phase, self._speed = Phase.STOPPING, 0.0
