"""The day of identification: steering ramps on a plant, and tires from their recording."""

from __future__ import annotations

from pathlib import Path

from ..control.steering_ramp import RampParameters
from ..identification.channels import ChannelMap, SensorSetup
from ..identification.data import load_run
from ..identification.identify import Identification, identify
from ..identification.limits import SteadyLimits
from ..simulation.plant import PlantParameters
from ..simulation.public_simulator import PublicSimulatorParameters
from ..simulation.ramps import drive_ramps
from ..simulation.recorded import write_ramp_bag
from ..vehicle.size import ONE_TENTH, size_of

__all__ = ["SPEEDS_MPS", "STEADY", "identify_on"]

# From rolling to the limit of grip, for a 1:10 car: at 4 m/s and 1 g the circle has a radius of
# 1.6 m.
SPEEDS_MPS = (2.0, 3.0, 4.0)
# A road car hardly understeers; at higher speed, understeer is a larger part of its steering.
# Shares of its top speed.
SPEED_SHARES = (1.0 / 3.0, 1.0 / 2.0, 2.0 / 3.0)
# At 4 m/s the ramp itself changes the yaw rate by 0.26 rad/s^2; the bang-bang servo of the public
# simulator adds at least as much chatter.
STEADY = SteadyLimits(dr_radps2=1.0)


def identify_on(
    plant: PlantParameters | PublicSimulatorParameters, seed: int, bag: Path
) -> Identification:
    """Drive ramps, record them in `bag` and identify the tires from the recording.

    Mass and geometry of the plant are known, the tires are not; `seed` sets the noise.
    """
    vehicle = plant.vehicle
    speeds = SPEEDS_MPS
    if size_of(vehicle) != ONE_TENTH:
        speeds = [share * vehicle.v_max for share in SPEED_SHARES]
    ramps = [RampParameters.of(vehicle, speed_mps=speed) for speed in speeds]
    write_ramp_bag(bag, drive_ramps(plant, ramps, seed))
    ahead = vehicle.l_r if plant.reference_point == "center_of_gravity" else 0.0
    channels = ChannelMap(setup=SensorSetup(pose_x_m=ahead))
    return identify([load_run(bag, channels)], vehicle, limits=STEADY)
