"""``map-racing ramp``: drive the steering ramps of a simulated car and record a bag."""

from pathlib import Path

from ..control.steering_ramp import RampParameters
from ..errors import ParameterError
from ..simulation.ramps import drive_ramps
from ..simulation.recorded import write_ramp_bag
from .inputs import read_plant
from .outputs import check_outputs
from .progress import progress_bar


def run(arguments):
    """Drive and record."""
    output = Path(arguments.output)
    check_outputs([arguments.output], [arguments.plant])
    plant = read_plant(arguments.plant)
    vehicle = plant.build_vehicle()
    given = {name: getattr(arguments, name) for name in ("rate_radps", "start_rad", "limit_rad")}
    given = {name: value for name, value in given.items() if value is not None}
    speeds = [{"speed_mps": speed} for speed in arguments.speed or ()] or [{}]
    ramps = [RampParameters.of(vehicle, sides=arguments.sides, **given, **v) for v in speeds]
    first, steers = ramps[0], vehicle.delta_max
    if first.limit_rad > steers:
        raise ParameterError(
            f"--limit: expected at most {steers:g} rad, as far as the car steers, got "
            f"{first.limit_rad:g}"
        )
    rising = (first.limit_rad - first.start_rad) / first.rate_radps
    settling = 3.0 * first.settle_s
    expected = len(ramps) * (1 if arguments.sides != "both" else 2) * (rising + settling)
    if expected > 3600.0:
        raise ParameterError(
            f"--rate: expected a drive of at most an hour, got {expected / 60.0:.0f} minutes"
        )
    with progress_bar(output.name, expected, "s") as show:
        samples = drive_ramps(plant, ramps, arguments.seed, progress=show)
    compression = None if arguments.compression == "none" else arguments.compression
    write_ramp_bag(output, samples, compression)
    driven = ", ".join(f"{ramp.speed_mps:.3g}" for ramp in ramps)
    print(
        f"{output}: {arguments.plant} at {driven} m/s, {first.start_rad:g} to "
        f"{first.limit_rad:g} rad, {samples[-1].measured.t:.1f} s"
    )
