"""A simulated car on a track: takes commands, returns measured poses."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

from ..track.tracker import RacelineTracker
from .grip import Grip

__all__ = ["COMMAND_TIMEOUT", "Observation", "SimulatedCar", "hits_wall"]

# The command multiplexer of the public stacks drops an input after this long without a message [s].
COMMAND_TIMEOUT = 0.2


class Observation(NamedTuple):
    """Measurements of localization and IMU at one instant.

    Parameters
    ----------
    true, measured : CarState
        States at the time of measurement.
    arrival : float
        Time of arrival [s].
    acceleration : (float, float)
        Longitudinal and lateral acceleration of the IMU [m/s^2].
    frame : str
        Frame of the pose; empty for the raceline's frame.
    quaternion : float
        Norm of the quaternion that gives the heading.
    """

    true: tuple
    measured: tuple
    arrival: float
    acceleration: tuple
    frame: str = ""
    quaternion: float = 1.0


class Sample(NamedTuple):
    """One control step: true state, measurement and command.

    `true`, `measured`, `arrival` and `acceleration` are from the `Observation`. `steering_angle` is
    the true one [rad]. `result` is the command in response, a
    :class:`~map_racing.control.controller.ControlResult` or a
    :class:`~map_racing.control.steering_ramp.RampCommand`. `belief` is what the controller believes
    about the tires after the step, None if it does not learn them.
    """

    true: tuple
    measured: tuple
    arrival: float
    acceleration: tuple
    steering_angle: float
    result: tuple
    belief: tuple | None = None

    @classmethod
    def of(cls, seen: Observation, steering_angle: float, result: tuple, belief=None) -> Sample:
        """The step that responded to an observation."""
        return cls(*seen[:4], steering_angle, result, belief)


class SimulatedCar:
    """A plant, its localization and its clock.

    Each tick: :meth:`observe`, then :meth:`advance`.

    Parameters
    ----------
    plant : Plant or PublicSimulator
    localization : Localization, optional
        Latency and noise of the poses. Without it the poses are the plant's own
        ``measured_state()``, without latency.
    rate : float, optional
        Poses per second; by default the plant's ``localization_rate_hz``.
    faults : Faults, optional
        Faults to inject.

    Attributes
    ----------
    tick : int
        Time in steps of the plant; resetting the car does not change it.
    """

    def __init__(self, plant, localization=None, rate=None, faults=None):
        self.plant, self.faults = plant, faults
        self._localization = localization
        self._rate = rate or plant.parameters.localization_rate_hz
        self._latency = 0.0
        if localization is not None:
            self._latency = localization.parameters.localization_latency_s
        self._pending = deque()
        self._poses = self.tick = self._start = 0
        # A pose is taken at the last tick before it is due.
        self._due = 0.0

    def put(self, x, y, psi):
        """Reset the car's reference point to a pose, at rest; pending measurements are lost."""
        self.plant.reset(x, y, psi)
        self._start = self.tick
        self._pending.clear()

    @property
    def now(self):
        """Time since the beginning [s]."""
        return self.tick * self.plant.time_step

    @property
    def next_event(self):
        """The next tick with a measurement or an arrival for :meth:`observe`."""
        due = self._due
        if self._pending and self._pending[0].arrival < due:
            due = self._pending[0].arrival
        return max(self.tick, math.ceil(due / self.plant.time_step - 1.0 + 1e-9))

    def observe(self):
        """Measure if due, and collect the observations that arrive.

        Returns
        -------
        taken : Observation or None
            Measured at this tick.
        arrived : list of Observation
            Arriving at this tick.
        """
        step = self.plant.time_step
        now, soon = self.tick * step, self.tick * step + step * (1.0 - 1e-9)
        taken = None
        if self._due < soon:
            taken = self._measure(now)
            for seen in [taken] if self.faults is None else self.faults.measured(taken):
                # Poses arrive in order, so a delayed one holds up the next ones.
                last = self._pending[-1].arrival if self._pending else seen.arrival
                self._pending.append(seen._replace(arrival=max(seen.arrival, last)))
            self._poses += 1
            self._due = self._poses / self._rate
        arrived = []
        while self._pending and self._pending[0].arrival < soon:
            arrived.append(self._pending.popleft())
        return taken, arrived

    def _measure(self, now):
        plant, localization = self.plant, self._localization
        true = plant.reference_state()
        if self._start:
            true = true._replace(t=now)
        if localization is None:
            measured, acceleration = plant.measured_state()._replace(t=true.t), plant.acceleration
        else:
            measured = localization.measure(true)
            acceleration = localization.measure_acceleration(plant.acceleration)
        return Observation(true, measured, now + self._latency, acceleration)

    def advance(self, steering_angle, speed, ticks=1):
        """Drive for `ticks` steps under the given commands [rad, m/s]."""
        faults = self.faults
        if faults is None or not faults.active:
            self.plant.advance(steering_angle, speed, ticks)
        else:
            for _ in range(ticks):
                self.plant.advance(*faults.commanded(steering_angle, speed))
                faults.advanced()
        self.tick += ticks


class DrivenCar:
    """A simulated car under asynchronous commands, as a node drives it.

    A command applies until the next one, but at most for `COMMAND_TIMEOUT`; then the car stops
    without moving the steering. A car that touches a wall stays there until it is reset.

    Parameters
    ----------
    car : SimulatedCar
    raceline : Raceline
        Its widths give the walls.
    on_faults : callable, optional
        Called with the lists of faults that have begun and ended, if any has.

    Attributes
    ----------
    car : SimulatedCar
    crashed : bool
    """

    def __init__(self, car, raceline, on_faults=None):
        self.car, self._on_faults = car, on_faults
        self.crashed = False
        self._raceline = raceline
        self._tracker, self._grip = RacelineTracker(raceline), Grip(car.plant)
        self._timeout = round(COMMAND_TIMEOUT / car.plant.time_step)
        self._steering_angle, self._speed, self._commanded = 0.0, 0.0, 0

    def put(self, x, y, psi):
        """Place the rear axle, at rest and without a command."""
        self.car.put(x, y, psi)
        self._tracker.reset()
        self.crashed = False
        self._steering_angle, self._speed = 0.0, 0.0

    def command(self, steering_angle, speed):
        """Take a command [rad, m/s] at the present tick; ignore it if it is not finite."""
        if math.isfinite(steering_angle) and math.isfinite(speed):
            self._steering_angle, self._speed = steering_angle, speed
            self._commanded = self.car.tick

    def advance_to(self, tick):
        """Drive until just before the given tick.

        Parameters
        ----------
        tick : int

        Yields
        ------
        Observation
            At the tick of its arrival; a command given in response acts from this tick on.
        """
        car = self.car
        while car.tick < tick:
            taken, arrived = car.observe()
            if taken is not None:
                x, y, psi = taken.true[1:4]
                s, d = self._tracker.update(x, y, psi)[:2]
                self._update_faults(s)
                self._grip.update(car.now, s, 1.0 if car.faults is None else car.faults.grip)
            if taken is not None and not self.crashed:
                self.crashed = hits_wall(self._raceline, s, d, car.plant.vehicle.width)
                if self.crashed:
                    car.put(x, y, psi)
            yield from arrived
            fresh = car.tick - self._commanded < self._timeout
            car.advance(self._steering_angle, self._speed if fresh and not self.crashed else 0.0)

    def _update_faults(self, s):
        faults = self.car.faults
        if faults is not None:
            begun, ended = faults.update(self.car.now, s)
            if self._on_faults is not None and (begun or ended):
                self._on_faults(begun, ended)


def hits_wall(raceline, s, d, car_width):
    """Whether a car of this width [m] touches a wall at arc length `s` and lateral error `d` [m].

    A raceline without widths has no walls.
    """
    if raceline.d_left is None:
        return False
    left, right = raceline.widths_at(s)
    return d > left - 0.5 * car_width or d < 0.5 * car_width - right
