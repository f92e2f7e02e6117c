"""Rehearsals: how the supervised car reacts to each fault at 4 m/s in a bend.

They give the table of the page on safety. Distances, speeds and times are for a 1:10 car and are
scaled for a larger one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..control.controller import build_controller
from ..control.decision import Reason
from ..control.parameters import (
    ControllerParameters,
    load_controller_parameters,
    load_safety_limits,
)
from ..control.safety import FASTEST
from ..control.safety_limits import SafetyLimits
from ..control.supervised import build_slowing
from ..track.raceline import Raceline
from ..vehicle.parameters import Vehicle
from ..vehicle.size import ONE_TENTH, Size, size_of
from .faults import KINDS, Fault
from .plants import build_plant, load_plant
from .race import Outcome, RaceLog, race

__all__ = [
    "SCENARIOS",
    "Bounds",
    "Rehearsal",
    "Scenario",
    "bounds_of",
    "bounds_text",
    "rehearsal_track",
    "rehearse",
    "table",
]

SPEED = 4.0  # m/s
STRAIGHT, RADIUS, HALF_WIDTH = 12.0, 4.0, 2.0  # m
# The fault begins in the middle of the first bend; end of the rehearsal [s].
BEGIN, END = 4.5, 18.0
# The driver calls ~resume this long after the end of the fault [s].
RESUMES_AFTER = 4.0
STANDSTILL = 0.05  # m/s


@dataclass(frozen=True)
class Scenario:
    """One row of the table: a fault, its size, and how long it lasts [s]."""

    fault: str
    size: float | None = None
    for_s: float = 2.0

    def schedule(self, time: float = 1.0) -> list[Fault]:
        """The fault and the driver's ~resume after it; `time` is a factor on times."""
        resumed = Fault("resumed", BEGIN * time + self.for_s + RESUMES_AFTER, 1.0)
        return [Fault(self.fault, BEGIN * time, self.for_s, size=self.size), resumed]

    def of_size(self, size: Size) -> Scenario:
        """The scenario for a car of another size."""
        kind = KINDS[self.fault]
        grows = {"m": size.length, "m/s": size.time, "rad/s": 1.0 / size.time}.get(kind.unit, 1.0)
        value = None if self.size is None else self.size * grows
        # A fault shorter than the largest age of a pose must stay shorter.
        long = self.for_s > SafetyLimits.max_pose_age_s
        return replace(self, size=value, for_s=self.for_s * (size.time if long else 1.0))

    @property
    def text(self) -> str:
        """The fault in words."""
        kind = KINDS[self.fault]
        size = kind.default if self.size is None else self.size
        return kind.text if size is None else f"{kind.text}: {size:.6g} {kind.unit}".rstrip()


# Each ends with the driver's ~resume. Faults that race cannot inject are tested on the nodes.
SCENARIOS = (
    Scenario("pose_dropout", for_s=0.15),
    Scenario("pose_dropout"),
    Scenario("pose_frozen"),
    Scenario("pose_stuck"),
    Scenario("pose_jitter"),
    Scenario("pose_jump", 0.4),
    Scenario("pose_jump", 1.0),
    Scenario("pose_jump", 3.0),
    Scenario("pose_turn", 0.5),
    Scenario("pose_turn", 1.5),
    Scenario("pose_turn", math.pi),
    Scenario("pose_drift", 0.2),
    Scenario("pose_drift", 2.0),
    Scenario("pose_noise", 0.05),
    Scenario("pose_noise", 0.5),
    Scenario("pose_delay", 0.1),
    Scenario("pose_delay", 0.3),
    Scenario("pose_future", 0.3),
    Scenario("pose_frame"),
    Scenario("pose_nan"),
    Scenario("velocity_missing"),
    Scenario("velocity_absurd"),
    Scenario("velocity_reversed"),
    Scenario("wheel_slip", 1.3),
    Scenario("yaw_rate_missing"),
    Scenario("servo_stuck"),
    Scenario("servo_slow", 0.5),
    Scenario("servo_offset", 0.05),
    Scenario("motor_weak"),
    Scenario("motor_dead"),
    Scenario("motor_runaway", 7.0, 1.0),
    Scenario("brakes_weak"),
    Scenario("battery_sag"),
    Scenario("drive_loss", for_s=0.5),
    Scenario("drive_loss"),
    Scenario("drive_delay"),
    Scenario("blocked"),
    Scenario("grip_lost", 0.5),
    Scenario("stop_requested"),
    Scenario("raceline_lost"),
    Scenario("raceline_reversed"),
    Scenario("controller_failed"),
)


class Bounds(NamedTuple):
    """The largest commands of a rehearsal, and their limits.

    Parameters
    ----------
    commands : int
        Number of commands.
    speed, max_speed : float
        Largest speed, and its limit [m/s].
    angle, lock : float
        Largest steering angle, and the lock [rad].
    beyond : float
        Largest excess of an angle over that of the largest lateral acceleration at the measured
        speed [rad]; negative if there is none.
    """

    commands: int
    speed: float
    max_speed: float
    angle: float
    lock: float
    beyond: float


@dataclass(frozen=True)
class Rehearsal:
    """Result of a scenario.

    Parameters
    ----------
    scenario : Scenario
    log : RaceLog
    reason : Reason
        Reason of the first stop; NONE without one.
    begins_s : float
        Time from the fault to the first command of the stop; NaN without a stop.
    stands_s : float
        Time from the fault until the car stands; NaN if it does not.
    aside_m : float
        Largest lateral error from the fault until the car stands, or until the end.
    back_s : float
        Time from the end of the fault until the car drives again; NaN if it does not.
    resumed : bool
        Whether the car needed the service ``~resume`` to drive again.
    bounds : Bounds
        Largest commands, and their limits.
    """

    scenario: Scenario
    log: RaceLog
    reason: Reason
    begins_s: float
    stands_s: float
    aside_m: float
    back_s: float
    resumed: bool
    bounds: Bounds

    def row(self) -> list[str]:
        """Cells of the table."""
        scenario = self.scenario
        stops = self.reason is not Reason.NONE
        crashed = self.log.outcome is Outcome.CRASHED
        back = "drives on"
        if crashed:
            back = "hits a wall"
        elif stops and math.isnan(self.back_s):
            back = "stays"
        elif stops and self.resumed:
            back = "`~resume`"
        elif stops and self.back_s < 0.0:
            back = f"with it, {self.back_s + scenario.for_s:.1f} s after its begin"
        elif stops:
            back = f"{self.back_s:.1f} s after its end"
        return [
            f"`{scenario.fault}`",
            f"{scenario.text}, for {scenario.for_s:.3g} s",
            self.reason.value if stops else "no stop",
            f"{self.begins_s:.2f}" if stops else "",
            "" if math.isnan(self.stands_s) else f"{self.stands_s:.1f}",
            f"{self.aside_m:.2f}",
            back,
        ]


HEADER = (
    *("fault", "what happens", "reason of the stop", "begins after [s]", "stands after [s]"),
    *("off the line [m]", "way back"),
)


def rehearsal_track(size: Size = ONE_TENTH) -> Raceline:
    """Two straights of 12 m and two bends of 4 m radius, 4 m wide, at 4 m/s."""
    steps = np.arange(0.0, STRAIGHT, 0.2)
    turn = np.arange(0.0, math.pi, 0.05)
    x = np.r_[steps, STRAIGHT + RADIUS * np.sin(turn)]
    y = np.r_[0.0 * steps, RADIUS * (1.0 - np.cos(turn))]
    x, y = np.r_[x, STRAIGHT - x], np.r_[y, 2.0 * RADIUS - y]
    x, y = x * size.length, y * size.length
    width, speed = np.full(x.size, HALF_WIDTH * size.length), np.full(x.size, SPEED * size.time)
    return Raceline(x, y, vx_mps=speed, d_left_m=width, d_right_m=width, name="rehearsal")


def rehearse(scenario: Scenario, car: str = "nuc4", seed: int = 1) -> Rehearsal:
    """Drive one scenario with the shipped controller ``map``, supervised.

    Parameters
    ----------
    scenario : Scenario
    car : str, optional
        Shipped plant or plant file.
    seed : int, optional
        Seed of the noise.

    Returns
    -------
    Rehearsal
    """
    plant_parameters = load_plant(car)
    vehicle = plant_parameters.vehicle
    size = size_of(vehicle)
    track, scenario = rehearsal_track(size), scenario.of_size(size)
    parameters = load_controller_parameters("map", vehicle).with_(speed_scale=1.0)
    if plant_parameters.reference_point != "rear_axle":
        parameters = parameters.with_(reference_point=plant_parameters.reference_point)
    controller = build_controller(parameters, vehicle, track)
    plant, localization = build_plant(plant_parameters, seed)
    log = race(
        plant,
        controller,
        track,
        localization,
        time_limit=END * size.time,
        limits=load_safety_limits("map", vehicle),
        faults=scenario.schedule(size.time),
    )
    begin = BEGIN * size.time
    end = begin + scenario.for_s
    stop = next((stop for stop in log.stops() if stop[0] >= begin), None)
    after = [state for state in log.truth if state.t >= begin]
    stands = math.nan
    if stop is not None:
        stands = next((s.t for s in after if abs(s.v_x) < STANDSTILL), math.nan)
    until = math.inf if math.isnan(stands) else stands
    aside = max(abs(track.project(s.x, s.y).d) for s in after if s.t <= until)
    begins, reason, back = (math.nan, Reason.NONE, math.nan) if stop is None else stop
    return Rehearsal(
        scenario,
        log,
        reason,
        begins - begin,
        stands - begin,
        aside,
        back - end,
        resumed=back >= end + RESUMES_AFTER,
        bounds=bounds_of(log, parameters, vehicle),
    )


def bounds_of(log: RaceLog, parameters: ControllerParameters, vehicle: Vehicle) -> Bounds:
    """Largest commands of a supervised race, and their limits."""
    slowing = build_slowing(parameters, vehicle)
    measured = {sample.arrival: sample.measured.v_x for sample in log.samples}
    v_x, beyond = 0.0, -math.inf
    for t, decision in log.commands:
        seen = measured.get(t, math.nan)
        if abs(seen) <= FASTEST:
            v_x = seen
        beyond = max(beyond, abs(decision.steering_angle) - slowing.largest(abs(v_x)))
    return Bounds(
        len(log.commands),
        max(c.decision.speed for c in log.commands),
        parameters.v_max_mps,
        max(abs(c.decision.steering_angle) for c in log.commands),
        vehicle.delta_max,
        beyond,
    )


def bounds_text(rehearsals: list[Rehearsal]) -> str:
    """Sentence on the commands of all rehearsals, and their limits."""
    all_of = [rehearsal.bounds for rehearsal in rehearsals]
    speed, angle = max(b.speed for b in all_of), max(b.angle for b in all_of)
    beyond = max(b.beyond for b in all_of)
    return (
        f"{sum(b.commands for b in all_of)} commands: at most {speed:.2f} m/s, the limit is "
        f"{all_of[0].max_speed:g}; at most {angle:.3f} rad, the lock is {all_of[0].lock:g}; "
        + (
            f"up to {beyond:.4f} rad beyond what the lookup table holds at the measured speed"
            if round(beyond, 4) > 0.0
            else "none beyond what the lookup table holds at the measured speed"
        )
    )


def table(rehearsals: list[Rehearsal]) -> str:
    """Markdown table of rehearsals."""
    rows = [HEADER, ("---",) * len(HEADER), *(rehearsal.row() for rehearsal in rehearsals)]
    return "".join(f"| {' | '.join(row)} |\n" for row in rows)
