"""``map-racing ramp``: drive the steering ramps of a simulated car and record a bag."""

from pathlib import Path

from ..control.steering_ramp import RampParameters
from ..errors import ParameterError
from ..simulation.plants import load_plant
from ..simulation.ramps import drive_ramps
from ..simulation.recorded import write_ramp_bag
from .outputs import check_outputs
from .progress import progress_bar


def run(arguments):
    """Drive and record."""
    output = Path(arguments.output)
    check_outputs([arguments.output], [arguments.plant])
    ramps = [
        RampParameters(
            speed_mps=speed,
            rate_radps=arguments.rate_radps,
            start_rad=arguments.start_rad,
            limit_rad=arguments.limit_rad,
            sides=arguments.sides,
        )
        for speed in arguments.speed
    ]
    plant = load_plant(arguments.plant)
    steers = plant.build_vehicle().delta_max
    if arguments.limit_rad > steers:
        raise ParameterError(
            f"--limit: expected at most {steers:g} rad, as far as the car steers, got "
            f"{arguments.limit_rad:g}"
        )
    rising = (arguments.limit_rad - arguments.start_rad) / arguments.rate_radps
    expected = len(ramps) * (1 if arguments.sides != "both" else 2) * (rising + 3.0)
    if expected > 3600.0:
        raise ParameterError(
            f"--rate: expected a drive of at most an hour, got {expected / 60.0:.0f} minutes"
        )
    with progress_bar(output.name, expected, "s") as show:
        samples = drive_ramps(plant, ramps, arguments.seed, progress=show)
    compression = None if arguments.compression == "none" else arguments.compression
    write_ramp_bag(output, samples, compression)
    speeds = ", ".join(f"{speed:g}" for speed in arguments.speed)
    print(
        f"{output}: {arguments.plant} at {speeds} m/s, {arguments.start_rad:g} to "
        f"{arguments.limit_rad:g} rad, {samples[-1].measured.t:.1f} s"
    )
