"""Faults for rehearsals: what goes wrong with localization, actuators, floor and operators.

A schedule is a list of `Fault`; a file holds it as ``faults``, a list of entries such as
``{fault: pose_jump, at_s: 5.0, for_s: 1.0, size: 0.8}``.
"""

from __future__ import annotations

import math
import random
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import NamedTuple

from ..errors import FileFormatError, ParameterError
from ..files import read_yaml_mapping
from ..validation import POSITIVE, check, documented, finite, parameter
from .grip import is_between

__all__ = ["KINDS", "Fault", "Faults", "check_name", "kinds_table", "load_faults"]

# Rolling resistance of a car without motor torque [m/s^2].
COASTING = 0.5


class Kind(NamedTuple):
    """Kind of fault: text, unit, default (None if it has no size) and valid range of its size."""

    text: str
    unit: str = ""
    default: float | None = None
    low: float = -math.inf
    high: float = math.inf
    # Who can inject it: race has no messages, the simulator no controller.
    where: tuple = ("race", "simulator")
    # Method that the plant needs for it.
    method: str = ""


_RACE, _SIMULATOR = ("race",), ("simulator",)

KINDS = {
    # localization
    "pose_dropout": Kind("no poses come"),
    "pose_frozen": Kind("the last pose comes again and again, with its old stamp"),
    "pose_stuck": Kind("the position stays, with new stamps and the true velocity"),
    "pose_jitter": Kind(
        "the position stays but for jitter, and the velocity is 0", "m", 0.001, 0.0, 0.1
    ),
    "pose_jump": Kind("the position is off to the left", "m", 1.0, -100.0, 100.0),
    "pose_turn": Kind("the heading is off", "rad", 1.5, -math.pi, math.pi),
    "pose_drift": Kind("the position drifts to the left", "m/s", 0.5, -10.0, 10.0),
    "pose_noise": Kind("white noise on the position", "m", 0.05, 0.0, 10.0),
    "pose_delay": Kind("poses come later", "s", 0.3, 0.0, 10.0),
    "pose_future": Kind("stamps are in the future", "s", 0.3, 0.0, 1e6),
    "pose_frame": Kind("poses are in the frame odom"),
    "pose_nan": Kind("the position is not a number"),
    "second_publisher": Kind(
        "another node publishes odometry beside the first, off to the left",
        "m",
        2.0,
        -100.0,
        100.0,
        _SIMULATOR,
    ),
    "quaternion_length": Kind(
        "quaternions have another length than 1", "", 1.05, 0.2, 10.0, _SIMULATOR
    ),
    # odometry
    "velocity_missing": Kind("the velocity is 0"),
    "velocity_absurd": Kind("the velocity is absurd", "m/s", 1e9, POSITIVE, 1e9),
    "velocity_reversed": Kind("the velocity has the wrong sign"),
    "wheel_slip": Kind("the velocity is wrong by a factor", "", 1.3, 0.1, 3.0),
    "yaw_rate_missing": Kind("the yaw rate is 0"),
    # actuators
    "servo_stuck": Kind("the steering stays where it is"),
    "servo_slow": Kind("the steering has another rate", "rad/s", 0.5, POSITIVE, 10.0),
    "servo_offset": Kind("the steering is off to the left", "rad", 0.05, -0.5, 0.5),
    "motor_weak": Kind(
        "share of the acceleration that is left", "", 0.2, POSITIVE, 1.0, method="set_drive"
    ),
    "motor_dead": Kind("no torque: the car rolls out", method="set_drive"),
    "motor_runaway": Kind("the car drives at a speed of its own", "m/s", 7.0, POSITIVE, 100.0),
    "brakes_weak": Kind(
        "share of the braking that is left", "", 0.2, POSITIVE, 1.0, method="set_drive"
    ),
    "battery_sag": Kind("largest speed that is left", "m/s", 2.5, POSITIVE, 100.0),
    "drive_loss": Kind("commands do not reach the car, which stops after 0.2 s by itself"),
    "drive_delay": Kind("commands reach the car later", "s", 0.1, 0.0, 1.0),
    "blocked": Kind("something holds the car in its place", method="hold"),
    # floor
    "grip_lost": Kind("factor on the friction", "", 0.5, 0.1, 2.0, method="set_grip"),
    # operators and neighbors
    "stop_requested": Kind("somebody calls ~stop", where=_RACE),
    "resumed": Kind("somebody calls ~resume", where=_RACE),
    "raceline_lost": Kind("a raceline that cannot be driven is published", where=_RACE),
    "raceline_reversed": Kind("the raceline is published the other way round", where=_RACE),
    "controller_failed": Kind("the controller raises an exception", where=_RACE),
}


_INJECTORS = {"race": "map-racing race", "simulator": "the node simulator"}


def kinds_table() -> str:
    """Markdown table of the faults: name, meaning, default and valid sizes, who injects it."""
    rows = ["| fault | what happens | size by default, and valid | by |", "|---|---|---|---|"]
    for name, kind in KINDS.items():
        size = ""
        if kind.default is not None:
            low = "more than 0" if kind.low == POSITIVE else f"{kind.low:g}"
            size = f"{kind.default:g} {kind.unit}".rstrip() + f"; {low} to {kind.high:g}"
        rows.append(f"| `{name}` | {kind.text} | {size} | {' and '.join(kind.where)} |")
    return "\n".join(rows) + "\n"


def check_name(option: str, name: object) -> None:
    """Refuse an unknown name of a fault, suggesting similar ones.

    Raises
    ------
    ParameterError
        ``OPTION: expected a fault that map-racing faults --list names, got 'pose_jmp' (like
        pose_jump)``.
    """
    if isinstance(name, str) and name in KINDS:
        return
    near = get_close_matches(str(name), KINDS)
    like = f" (like {' or '.join(near)})" if near else ""
    raise ParameterError(
        f"{option}: expected a fault that map-racing faults --list names, got {name!r}{like}"
    )


@documented
@dataclass(frozen=True)
class Fault:
    """One fault of a schedule. It is active when both its time and its place apply."""

    fault: str = parameter("Its name", choices=tuple(KINDS))
    at_s: float = parameter("Simulated time at which it begins", "s", low=0.0, default=0.0)
    for_s: float = parameter("Duration; by default until the end", "s", low=POSITIVE, default=1e9)
    from_m: float = parameter("Arc length at which its place begins", "m", low=0.0, default=0.0)
    to_m: float = parameter(
        "Arc length at which its place ends, less than `from_m` if it crosses the start line; if "
        "both are 0, it is everywhere",
        "m",
        low=0.0,
        default=0.0,
    )
    size: float | None = parameter(
        "Size in the unit of its kind; by default the kind's default", default=None
    )

    def __post_init__(self):
        check_name("fault", self.fault)
        check(self)
        kind = KINDS[self.fault]
        if self.size is None:
            object.__setattr__(self, "size", kind.default)
            return
        if kind.default is None:
            raise ParameterError(f"size: {self.fault} has none, got {self.size!r}")
        object.__setattr__(self, "size", finite("size", self.size))
        if not kind.low <= self.size <= kind.high:
            raise ParameterError(
                f"size: expected {kind.low:g} to {kind.high:g} {kind.unit}".rstrip()
                + f" for {self.fault}, got {self.size:g}"
            )

    def holds(self, t: float, s: float) -> bool:
        """Whether it is active at a time [s] and arc length [m]."""
        on_time = self.at_s <= t < self.at_s + self.for_s
        return on_time and is_between(self.from_m, self.to_m, s)


def load_faults(path: str | Path, lap: float = math.inf) -> list[Fault]:
    """Read a schedule: a YAML file with the list ``faults`` of mappings with the names of `Fault`.

    Parameters
    ----------
    path : str or pathlib.Path
    lap : float, optional
        Length of the raceline [m]; all places must be on it.

    Raises
    ------
    FileFormatError
        If it is something else.
    ParameterError
        For an unknown name or an impossible value, naming entry and field.
    """
    values = read_yaml_mapping(path, "a schedule of faults")
    if set(values) != {"faults"}:
        raise FileFormatError(
            f"{path}: expected one list, faults, got {', '.join(map(str, values))}"
        )
    entries = values["faults"]
    if not isinstance(entries, list):
        raise FileFormatError(f"{path}: faults: expected a list, got {type(entries).__name__}")
    faults = []
    for number, entry in enumerate(entries, 1):
        if not isinstance(entry, dict) or "fault" not in entry:
            raise FileFormatError(f"{path}: entry {number}: expected fault: NAME, got {entry!r}")
        unknown = sorted(str(key) for key in entry if key not in Fault.__dataclass_fields__)
        if unknown:
            names = ", ".join(Fault.__dataclass_fields__)
            raise ParameterError(
                f"{path}: entry {number}: unknown {', '.join(unknown)} (known: {names})"
            )
        try:
            faults.append(Fault(**entry))
            if faults[-1].from_m >= lap or faults[-1].to_m > lap:
                raise ParameterError(
                    f"from_m, to_m: expected a place on the lap of {lap:.1f} m, got "
                    f"{faults[-1].from_m:g} to {faults[-1].to_m:g} m"
                )
        except ParameterError as error:
            raise ParameterError(f"{path}: entry {number}: {error}") from None
    return faults


class Faults:
    """Faults of one simulated car, between plant, localization and controller.

    Parameters
    ----------
    schedule : iterable of Fault
    plant : Plant or PublicSimulator
    where : {"race", "simulator"}
        Who injects them.
    seed : int, optional
        Seed of the noise.

    Raises
    ------
    ParameterError
        For a fault that cannot be injected here.

    Attributes
    ----------
    active : dict of str to Fault
        Faults that are active now.
    """

    def __init__(self, schedule, plant, where, seed=1):
        self._plant, self._where = plant, where
        self.active = {}
        self._schedule = []
        self._gauss = random.Random(seed).gauss
        self._last = self._angle = self._place = None
        self._since, self._line, self._slewed = {}, [], 0.0
        for fault in schedule:
            self.add(fault)

    def add(self, fault: Fault) -> None:
        """Add a fault to the schedule."""
        kind = KINDS[fault.fault]
        if self._where not in kind.where:
            others = " and ".join(_INJECTORS[where] for where in kind.where)
            raise ParameterError(
                f"{fault.fault}: only {others} injects it, not {_INJECTORS[self._where]}"
            )
        if kind.method and not hasattr(self._plant, kind.method):
            raise ParameterError(f"{fault.fault}: this plant cannot ({kind.text})")
        self._schedule.append(fault)

    def clear(self) -> None:
        """End all faults."""
        self._schedule = []

    def update(self, t: float, s: float) -> tuple[list[Fault], list[Fault]]:
        """Set `active` for a time [s] and arc length of the raceline [m].

        Returns
        -------
        begun, ended : list of Fault
            Faults that have begun and ended since the last call.
        """
        before = self.active
        self.active = {fault.fault: fault for fault in self._schedule if fault.holds(t, s)}
        begun = [fault for name, fault in self.active.items() if name not in before]
        ended = [fault for name, fault in before.items() if name not in self.active]
        for fault in begun:
            self._since[fault.fault] = t
        if begun or ended:
            self._begin(before)
        return begun, ended

    def _begin(self, before):
        """Set up the faults that have begun, and undo those that have ended."""
        active, plant = self.active, self._plant
        if "servo_stuck" not in active:
            self._angle = None
        elif self._angle is None:
            self._angle = plant.steering_angle
        if "servo_slow" not in before:
            self._slewed = plant.steering_angle
        if "blocked" not in active:
            self._place = None
        elif self._place is None:
            self._place = plant.reference_state()[1:4]
        if "drive_delay" not in active:
            self._line = []
        if {"motor_weak", "motor_dead", "brakes_weak"} & (set(active) | set(before)):
            braking = self._size("brakes_weak", 1.0)
            if "motor_dead" in active:
                braking = min(braking, COASTING / plant.vehicle.a_brake_max)
            plant.set_drive(self._size("motor_weak", 1.0), braking)

    @property
    def grip(self) -> float:
        """Factor on the friction, which `Grip` applies."""
        return self._size("grip_lost", 1.0)

    def _size(self, name, default):
        return self.active[name].size if name in self.active else default

    def measured(self, seen):
        """Apply the faults to one measurement.

        Parameters
        ----------
        seen : Observation

        Returns
        -------
        list of Observation
            One, or none in a dropout.
        """
        active = self.active
        if not active:
            self._last = seen
            return [seen]
        if "pose_dropout" in active:
            return []
        last = seen if self._last is None else self._last
        measured = seen.measured
        t, x, y, psi, v_x, v_y, r = measured
        if "pose_frozen" in active:
            return [seen._replace(measured=last.measured)]
        if "pose_stuck" in active or "pose_jitter" in active:
            x, y, psi = last.measured[1:4]
        else:
            self._last = seen
        if "pose_jitter" in active:
            jitter = active["pose_jitter"].size
            x, y = x + self._gauss(0.0, jitter), y + self._gauss(0.0, jitter)
            v_x, v_y, r = 0.0, 0.0, 0.0
        aside = self._size("pose_jump", 0.0)
        if "pose_drift" in active:
            aside += active["pose_drift"].size * (t - self._since["pose_drift"])
        x, y = x - aside * math.sin(psi), y + aside * math.cos(psi)
        noise = self._size("pose_noise", 0.0)
        if noise:
            x, y = x + self._gauss(0.0, noise), y + self._gauss(0.0, noise)
        psi += self._size("pose_turn", 0.0)
        if "pose_nan" in active:
            x = y = math.nan
        if "velocity_missing" in active:
            v_x = v_y = 0.0
        if "velocity_reversed" in active:
            v_x = -v_x
        v_x *= self._size("wheel_slip", 1.0)
        v_x = self._size("velocity_absurd", v_x)
        if "yaw_rate_missing" in active:
            r = 0.0
        t += self._size("pose_future", 0.0)
        return [
            seen._replace(
                measured=type(measured)(t, x, y, psi, v_x, v_y, r),
                arrival=seen.arrival + self._size("pose_delay", 0.0),
                frame="odom" if "pose_frame" in active else seen.frame,
                quaternion=self._size("quaternion_length", 1.0),
            )
        ]

    def commanded(self, steering_angle: float, speed: float) -> tuple[float, float]:
        """Apply the faults to a command [rad, m/s]; called at each tick."""
        active = self.active
        if not active:
            return steering_angle, speed
        step = self._plant.time_step
        if "drive_delay" in active:
            self._line.append((steering_angle, speed))
            behind = max(len(self._line) - 1 - round(active["drive_delay"].size / step), 0)
            steering_angle, speed = self._line[behind]
            del self._line[:behind]
        if "drive_loss" in active:
            speed = 0.0
        steering_angle += self._size("servo_offset", 0.0)
        if "servo_slow" in active:
            slew = active["servo_slow"].size * step
            move = steering_angle - self._slewed
            self._slewed += min(max(move, -slew), slew)
            steering_angle = self._slewed
        if self._angle is not None:
            steering_angle = self._angle
        speed = min(speed, self._size("battery_sag", math.inf))
        if "motor_dead" in active:
            speed = 0.0
        return steering_angle, self._size("motor_runaway", speed)

    def advanced(self):
        """Hold a blocked car in place; called after each tick."""
        if self._place is not None:
            self._plant.hold(*self._place)
