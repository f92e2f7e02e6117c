"""The closed loop: a controller drives a plant around a raceline, lap after lap."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from time import thread_time
from typing import NamedTuple

import numpy as np

from ..control.decision import Mode
from ..errors import ParameterError
from ..track.tracker import RacelineTracker
from ..vehicle.size import size_of
from .car import Sample, SimulatedCar, hits_wall
from .driver import DirectDriver, SupervisedDriver
from .faults import Faults
from .grip import Grip

__all__ = ["Outcome", "RaceLog", "Work", "race"]


# The race begins and ends this far past the start line [m], so that noise does not take a 1:10 car
# back over it. Without faults it ends only after a pose from beyond the line has been answered, so
# that the last lap is recorded completely however fast the car and late its poses.
START_S = 0.3

# A car that does not advance by HEADWAY [m] along the track within PATIENCE [s] has stalled.
HEADWAY, PATIENCE = 0.5, 10.0

# Longest interval between checks of the time limits [s].
CHECK_S = 0.1


class Outcome(Enum):
    """How a race ended."""

    COMPLETED = "completed"
    CRASHED = "crashed"  # touched a wall
    STALLED = "stalled"  # made no headway, or ran out of time


class Work(NamedTuple):
    """Processor time of a controller's steps.

    Parameters
    ----------
    steps : int
    median_s, p99_s : float
        Median and 99th percentile of the time per step [s].
    failed : int
        Steps that followed an earlier solution because none was found.
    late : int
        Steps during which another pose arrived.
    """

    steps: int
    median_s: float
    p99_s: float
    failed: int
    late: int


@dataclass
class RaceLog:
    """Log of a race.

    Parameters
    ----------
    outcome : Outcome
    laps : int
        Laps completed after the out-lap.
    duration : float
        Simulated time [s].
    samples : list of Sample
    commands : list of Command
        With a supervisor, all commands with their reasons; otherwise empty.
    truth : list of CarState
        With a supervisor, the true states at the times of measurement, including poses that did not
        arrive; otherwise empty.
    work : Work or None
        Processor time of the controller's steps, if it was measured.
    """

    outcome: Outcome
    laps: int
    duration: float
    samples: list = field(repr=False)
    commands: list = field(repr=False, default_factory=list)
    truth: list = field(repr=False, default_factory=list)

    work: Work | None = None

    def stops(self):
        """Stops of a supervised race.

        Returns
        -------
        list of (float, Reason, float)
            Time of the first command of the stop, its reason, and time of the first command to
            drive again, NaN if there is none [s].
        """
        found = []
        for t, decision in self.commands:
            stops = decision.mode in (Mode.STOPPING, Mode.STOPPED)
            if stops and not (found and math.isnan(found[-1][2])):
                found.append((t, decision.reason, math.nan))
            elif decision.mode is Mode.DRIVING and found and math.isnan(found[-1][2]):
                found[-1] = (*found[-1][:2], t)
        return found

    def true_path(self):
        """True states of all control steps.

        Returns
        -------
        ndarray, shape (n, 7)
            Columns as in CarState [SI].
        """
        return np.array([sample.true for sample in self.samples])


def race(
    plant,
    controller,
    raceline,
    localization=None,
    *,
    rate=None,
    laps=5,
    time_limit=None,
    progress=None,
    limits=None,
    faults=(),
    slowdown=None,
):
    """Race from a standing start just past the start line: an out-lap, then `laps` timed laps.

    Parameters
    ----------
    plant : Plant or PublicSimulator
        Placed on the raceline.
    controller : Controller
        Answers each pose as it arrives.
    raceline : Raceline
        Gives the start and, if it has widths, the walls: a reference point closer to a wall than
        half the car's width ends the race as a crash.
    localization : Localization, optional
        Latency and noise of the poses. Without it the poses are the plant's own
        ``measured_state()``, without latency.
    rate : float, optional
        Poses per second; by default the plant's ``localization_rate_hz``.
    laps : int
        Number of timed laps.
    time_limit : float, optional
        Simulated time after which the race counts as stalled [s]. Without it, only a car that makes
        no headway for 10 s has stalled, however slow the race.
    progress : callable, optional
        Called now and then with the laps driven so far, as a float.
    limits : SafetyLimits, optional
        Race under a supervisor with these limits, as the node does. If there are faults, there is
        always a supervisor, by default with the default limits.
    faults : iterable of Fault, optional
        Faults to inject.
    slowdown : float, optional
        Delay each command by the processor time of its step, times this factor; of the poses that
        arrive meanwhile only the last is used. The result then depends on the computer. Without it
        a step takes no time.

    Returns
    -------
    RaceLog
    """
    if laps < 1:
        raise ParameterError(f"laps: expected at least 1, got {laps}")
    if slowdown is not None and not 0.0 <= slowdown < math.inf:
        raise ParameterError(f"slowdown: expected 0 or more, got {slowdown}")

    start_s = START_S * size_of(plant.vehicle).length
    start = raceline.pose(start_s)
    faults = Faults(faults, plant, "race") if faults else None
    car = SimulatedCar(plant, localization, rate, faults)
    car.put(start.x, start.y, start.psi)
    controller.reset()
    supervised = faults is not None or limits is not None
    driver = SupervisedDriver(controller, limits) if supervised else DirectDriver(controller)
    tracker, grip = RacelineTracker(raceline), Grip(plant)
    learning = getattr(controller, "adaptation", None)
    steering, speed = 0.0, 0.0
    samples, truth = [], []
    processor = _Processor(driver.step, slowdown, plant.time_step)
    referee = _Referee(raceline, start_s, laps, plant.vehicle.width, time_limit)
    poses, outcome = 0, None
    while True:
        taken, arrived = car.observe()
        if taken is not None:
            poses += 1
            _, x, y, psi, _, _, _ = taken.true
            s, d = tracker.update(x, y, psi)[:2]
            if supervised:
                truth.append(taken.true)
            if faults is not None:
                _apply_faults(driver, *faults.update(car.now, s))
            grip.update(car.now, s, 1.0 if faults is None else faults.grip)
            answered = math.inf if faults is not None else samples[-1].true[0] if samples else 0.0
            outcome = referee.see(car.now, s, d, answered)
            if progress is not None and poses % 40 == 0:
                progress(referee.driven / raceline.length)
        outcome = outcome or referee.check_clock(car.now)
        if outcome is not None:
            break
        for seen, result in processor.take(car.now, arrived):
            steering, speed = result.steering_angle, result.speed
            if learning is not None:
                controller.learn()
            belief = None if learning is None else learning.belief
            samples.append(Sample.of(seen, plant.steering_angle, result, belief))
        if driver.deadline is not None and car.now >= driver.deadline - 1e-9:
            decision = driver.watch(car.now)
            if decision is not None:
                steering, speed = decision.steering_angle, decision.speed
        car.advance(steering, speed, _stride(car, driver, processor))
    laps_driven = max(int(referee.driven / raceline.length) - 1, 0)
    work = None if slowdown is None else processor.work(controller)
    commands = list(driver.commands)
    return RaceLog(outcome, laps_driven, car.now, samples, commands, truth, work)


def _stride(car, driver, processor):
    """Ticks until the next event, or the next check of the time limits."""
    step = car.plant.time_step
    stop = min(car.next_event, car.tick + round(CHECK_S / step))
    if driver.deadline is not None:
        stop = min(stop, math.ceil(driver.deadline / step - 1e-6))
    if processor.due is not None:
        stop = min(stop, math.ceil(processor.due / step - 1e-9))
    return max(stop - car.tick, 1)


def _apply_faults(driver, begun, ended):
    for fault in begun:
        driver.begin(fault)
    for fault in ended:
        driver.end(fault)


class _Referee:
    """Tracks the distance driven along the track [m], and decides how the race ends."""

    def __init__(self, raceline, start_s, laps, width, time_limit):
        self._raceline, self._start_s, self._width = raceline, start_s, width
        self._finish = (laps + 1) * raceline.length
        self._time_limit = math.inf if time_limit is None else time_limit
        self.driven, self._last_s, self._crossed = start_s, None, None
        self._headway, self._headway_at = start_s, 0.0

    def see(self, now, s, d, answered):
        """Outcome if the race ends with the car at `s`, `d`; otherwise None.

        A race is completed only once a pose from beyond the line has been answered; `answered` is
        the time of the last answered pose.
        """
        if self._last_s is not None:
            self.driven += math.remainder(s - self._last_s, self._raceline.length)
        self._last_s = s
        if self.driven > self._headway + HEADWAY:
            self._headway, self._headway_at = self.driven, now
        if hits_wall(self._raceline, s, d, self._width):
            return Outcome.CRASHED
        if self._crossed is None and self.driven > self._finish + self._start_s / 3.0:
            self._crossed = now
        if self.driven > self._finish + self._start_s and answered >= self._crossed:
            return Outcome.COMPLETED
        return None

    def check_clock(self, now):
        """Outcome if the race has taken too long; otherwise None."""
        late = now > self._time_limit or now > self._headway_at + PATIENCE
        return Outcome.STALLED if late else None


class _Processor:
    """Runs the steps of a controller, instantly or with their processor time as a delay."""

    def __init__(self, step, slowdown, tick):
        self._step, self._slowdown, self._tick = step, slowdown, tick
        self._times, self._late = [], 0
        self._done = self._waiting = self.due = None

    def take(self, now, arrived):
        """Observations and results whose commands take effect now."""
        if self._slowdown is None:
            return [(seen, self._step(seen)) for seen in arrived]
        finished = []
        if self.due is not None and now >= self.due - 1e-9:
            finished.append(self._done)
            self.due = None
        for seen in arrived:
            if self.due is not None and self._waiting is None:
                self._late += 1
            self._waiting = seen
        if self.due is None and self._waiting is not None:
            seen, self._waiting = self._waiting, None
            began = thread_time()
            self._done = seen, self._step(seen)
            self._times.append(thread_time() - began)
            # Round to the nearest tick; rounding up would delay every command by one.
            ticks = round(self._slowdown * self._times[-1] / self._tick)
            if ticks:
                self.due = now + ticks * self._tick
            else:
                finished.append(self._done)
        return finished

    def work(self, controller):
        """Summary as a `Work`."""
        times = self._times or [0.0]
        return Work(
            len(self._times),
            float(np.median(times)),
            float(np.percentile(times, 99.0)),
            getattr(controller, "failures", 0),
            self._late,
        )
