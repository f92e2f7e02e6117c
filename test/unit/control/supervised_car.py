"""A car and its supervisor, for the safety tests."""

from map_racing.control.controller import ControlResult, Status
from map_racing.control.safety import Supervisor
from map_racing.control.safety_limits import SafetyLimits
from map_racing.control.state import CarState

PERIOD = 1 / 32  # sums of it are exact


class Car:
    """Drives along x at a constant speed and feeds a supervisor as the node does."""

    def __init__(self, speed=4.0, max_speed=12.0, **limits):
        self.supervisor = Supervisor(SafetyLimits(**limits), max_speed)
        self.now, self.x, self.speed = 100.0, 0.0, speed

    def pose(self, age=0.0, **changes):
        state = CarState(self.now - age, self.x, 0.0, 0.0, self.speed, 0.0, 0.0)
        return state._replace(**changes)

    def result(self, **changes):
        state = self.pose()
        result = ControlResult(0.1, self.speed, Status.OK, state, 0.0, 0.0, 1.0, 0.0, 1.0, 0.0, 2.0)
        return result._replace(**changes)

    def step(self, state=None, **changes):
        """One pose and its command; the clock then moves on."""
        state = self.pose() if state is None else state
        trusted = self.supervisor.observe(self.now, state)
        decision = self.supervisor.decide(self.now, self.result(**changes) if trusted else None)
        self.now += PERIOD
        self.x += self.speed * PERIOD
        return decision

    def drive(self, seconds=1.0, **changes):
        return [self.step(**changes) for _ in range(round(seconds / PERIOD))]
