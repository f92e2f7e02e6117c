"""The day of identification: steering ramps on a plant, and tires from what was recorded."""

from __future__ import annotations

from ..control.steering_ramp import RampParameters
from ..identification.data import ChannelMap, SensorSetup, load_run
from ..identification.identify import identify
from ..identification.limits import SteadyLimits
from ..simulation.ramps import drive_ramps
from ..simulation.recorded import write_ramp_bag

__all__ = ["RAMPS", "STEADY", "identify_on"]

# From rolling to the limit of grip: at 4 m/s a car that corners with 1 g needs a circle of 1.6 m.
RAMPS = tuple(RampParameters(speed_mps=speed) for speed in (2.0, 3.0, 4.0))
# At 4 m/s the ramp itself changes the yaw rate by 0.26 rad/s^2, and the servo of the public
# simulator, which knows only full rate to either side, rattles it by as much again and more.
STEADY = SteadyLimits(dr_radps2=1.0)


def identify_on(plant, seed, bag):
    """Drive ramps, record them and identify the tires from the recording.

    Parameters
    ----------
    plant : PlantParameters or PublicSimulatorParameters
        On the day of identification. Mass and geometry are taken to be known, the tires are not.
    seed : int
        Of the noise.
    bag : pathlib.Path
        Where the recording is kept.

    Returns
    -------
    Identification
    """
    write_ramp_bag(bag, drive_ramps(plant, RAMPS, seed))
    vehicle = plant.vehicle
    ahead = vehicle.l_r if plant.reference_point == "center_of_gravity" else 0.0
    channels = ChannelMap(setup=SensorSetup(pose_x_m=ahead))
    return identify([load_run(bag, channels)], vehicle, limits=STEADY)
