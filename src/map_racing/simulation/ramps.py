"""Steering ramps of a simulated car."""

from __future__ import annotations

from typing import Callable, Sequence

from ..control.steering_ramp import Circle, Phase, RampParameters, SteeringRamp
from ..errors import ParameterError
from ..vehicle.size import ONE_TENTH, size_of
from .car import Sample, SimulatedCar
from .plant import PlantParameters
from .plants import build_plant
from .public_simulator import PublicSimulatorParameters

__all__ = ["drive_ramps"]

AREA_M = 50.0  # for a 1:10 car


def drive_ramps(
    plant_parameters: PlantParameters | PublicSimulatorParameters,
    ramps: Sequence[RampParameters] | None = None,
    seed: int = 1,
    progress: Callable[[float], None] | None = None,
) -> list[Sample]:
    """Drive steering ramps in the closed loop, one after the other.

    Parameters
    ----------
    plant_parameters : PlantParameters or PublicSimulatorParameters
    ramps : sequence of RampParameters, optional
        Default: one at the default speed for a car of this size.
    seed : int
        Seed of the noise.
    progress : callable, optional
        Called with the simulated time [s] about once a second.

    Raises
    ------
    ParameterError
        If the car cannot drive the ramp, does not reach its speed, or leaves the area: 50 m around
        the start for a 1:10 car, room for the first circle for a larger one.
    """
    plant, localization = build_plant(plant_parameters, seed)
    ramps = tuple(ramps) if ramps is not None else (RampParameters.of(plant.vehicle),)
    size = size_of(plant.vehicle)
    patience = 30.0 * size.time
    car = SimulatedCar(plant, localization)
    samples = []
    command = None
    for parameters in ramps:
        parameters.check_vehicle(plant.vehicle)
        area = AREA_M
        if size != ONE_TENTH:
            first = max(parameters.start_rad, 0.01 * parameters.limit_rad)
            area = max(AREA_M * size.length, 3.0 * plant.vehicle.l_wb / first)
        ramp = SteeringRamp(parameters, Circle(0.0, 0.0, area))
        sides = 2 if parameters.sides == "both" else 1
        rising = (parameters.limit_rad - parameters.start_rad) / parameters.rate_radps
        until = car.now + sides * (rising + parameters.settle_s + patience)
        done = False
        while not done:
            for seen in car.observe()[1]:
                t, x, y, _, v_x, _, r = seen.measured
                command = ramp.update(t, x, y, v_x, True, r)
                samples.append(Sample.of(seen, plant.steering_angle, command))
                done = command.phase is Phase.DONE
                if command.phase is Phase.OUTSIDE or car.now > until:
                    raise ParameterError(
                        f"ramp at {parameters.speed_mps:g} m/s: the car is {command.phase.value} "
                        f"after {car.now:.0f} s, {ramp.completed} of {sides} ramps driven"
                    )
                if progress is not None and len(samples) % 40 == 0:
                    progress(car.now)
            ticks = max(car.next_event - car.tick, 1)
            if command is None:
                car.advance(0.0, 0.0, ticks)
            else:
                car.advance(command.steering_angle, command.speed, ticks)
    return samples
