"""Steering ramps of a simulated car, recorded as a real car's would be."""

from typing import NamedTuple

from ..control.steering_ramp import Circle, Phase, RampParameters, SteeringRamp
from ..errors import ParameterError
from .car import SimulatedCar
from .plants import build_plant

__all__ = ["RampSample", "drive_ramps"]

AREA_M = 50.0


class RampSample(NamedTuple):
    """One pose and the command that answered it.

    Parameters
    ----------
    true, measured : CarState
    arrival : float
        When the pose arrived [s].
    acceleration : tuple of float
        Longitudinal and lateral acceleration that the IMU gave [m/s^2].
    command : RampCommand
    """

    true: tuple
    measured: tuple
    arrival: float
    acceleration: tuple
    command: tuple


def drive_ramps(plant_parameters, ramps=None, seed=1, progress=None):
    """Drive steering ramps in the closed loop, one after the other.

    Parameters
    ----------
    plant_parameters : PlantParameters or PublicSimulatorParameters
        The car, its localization and its noise.
    ramps : sequence of RampParameters, optional
        By default one at the default speed.
    seed : int
        Of the noise.
    progress : callable, optional
        Called now and then with the simulated time [s].

    Returns
    -------
    list of RampSample

    Raises
    ------
    ParameterError
        If the car leaves the area of 50 m, or does not get to its speed.
    """
    ramps = tuple(ramps) if ramps is not None else (RampParameters(),)
    car = SimulatedCar(*build_plant(plant_parameters, seed))
    samples = []
    command = None
    for parameters in ramps:
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
            car.advance(
                *((command.steering_angle, command.speed) if command is not None else (0.0, 0.0))
            )
    return samples
