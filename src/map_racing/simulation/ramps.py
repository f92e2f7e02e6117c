"""Steering ramps of a simulated car."""

from __future__ import annotations

from typing import Callable, NamedTuple, Sequence

from ..control.state import CarState
from ..control.steering_ramp import Circle, Phase, RampCommand, RampParameters, SteeringRamp
from ..errors import ParameterError
from .car import SimulatedCar
from .plant import PlantParameters
from .plants import build_plant
from .public_simulator import PublicSimulatorParameters

__all__ = ["RampSample", "drive_ramps"]

AREA_M = 50.0


class RampSample(NamedTuple):
    """An `Observation` and the command that answered it."""

    true: CarState
    measured: CarState
    arrival: float
    acceleration: tuple[float, float]
    command: RampCommand


def drive_ramps(
    plant_parameters: PlantParameters | PublicSimulatorParameters,
    ramps: Sequence[RampParameters] | None = None,
    seed: int = 1,
    progress: Callable[[float], None] | None = None,
) -> list[RampSample]:
    """Drive steering ramps in the closed loop, one after the other.

    Parameters
    ----------
    plant_parameters : PlantParameters or PublicSimulatorParameters
    ramps : sequence of RampParameters, optional
        Default: one at the default speed.
    seed : int
        Of the noise.
    progress : callable, optional
        Called with the simulated time [s] about once a second.

    Raises
    ------
    ParameterError
        If the car cannot do what is asked, leaves the area of 50 m, or does not reach its speed.
    """
    ramps = tuple(ramps) if ramps is not None else (RampParameters(),)
    car = SimulatedCar(*build_plant(plant_parameters, seed))
    samples = []
    command = None
    for parameters in ramps:
        parameters.check_vehicle(car.plant.vehicle)
        ramp = SteeringRamp(parameters, Circle(0.0, 0.0, AREA_M))
        sides = 2 if parameters.sides == "both" else 1
        rising = (parameters.limit_rad - parameters.start_rad) / parameters.rate_radps
        until = car.now + sides * (rising + parameters.settle_s + 30.0)
        done = False
        while not done:
            for seen in car.observe()[1]:
                t, x, y, _, v_x = seen.measured[:5]
                command = ramp.update(t, x, y, v_x, True)
                samples.append(
                    RampSample(seen.true, seen.measured, seen.arrival, seen.acceleration, command)
                )
                done = command.phase is Phase.DONE
                if command.phase is Phase.OUTSIDE or car.now > until:
                    raise ParameterError(
                        f"ramp at {parameters.speed_mps:g} m/s: the car is {command.phase.value} "
                        f"after {car.now:.0f} s, {ramp.completed} of {sides} ramps driven"
                    )
                if progress is not None and len(samples) % 40 == 0:
                    progress(car.now)
            if command is None:
                car.advance(0.0, 0.0)
            else:
                car.advance(command.steering_angle, command.speed)
    return samples
