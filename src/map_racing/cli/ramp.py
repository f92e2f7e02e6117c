"""``map-racing ramp``: drive the steering ramps of a simulated car and record a bag."""

from pathlib import Path

from tqdm import tqdm

from ..control.steering_ramp import RampParameters
from ..errors import ParameterError
from ..resources import list_config
from ..simulation.plant import load_plant_parameters
from ..simulation.ramps import drive_ramps
from ..simulation.recorded import write_ramp_bag
from .outputs import check_outputs


def add_parser(commands):
    """Add the command to the parser."""
    parser = commands.add_parser(
        "ramp",
        help="drive steering ramps with a simulated car, write a ROS 1 bag",
        description="Drive at constant speed with slowly rising steering angle, left and right, as "
        "identify.launch does on the car: the data from which tires are identified.",
    )
    defaults = RampParameters()
    parser.add_argument(
        "--plant",
        default="nuc4",
        help=f"the car as it is: YAML file, or shipped: {', '.join(list_config('plants'))} "
        "(default: %(default)s)",
    )
    parser.add_argument(
        "--speed",
        type=float,
        nargs="+",
        default=[defaults.speed_mps],
        metavar="V",
        help="speeds [m/s], one ramp after the other (default: 2)",
    )
    for option, name, what in (
        ("--rate", "rate_radps", "rise of the steering angle [rad/s]"),
        ("--start", "start_rad", "steering angle at the beginning [rad]"),
        ("--limit", "limit_rad", "steering angle at the end [rad]"),
    ):
        parser.add_argument(
            option,
            dest=name,
            type=float,
            default=getattr(defaults, name),
            metavar="X",
            help=f"{what} (default: %(default)s)",
        )
    parser.add_argument("--sides", default="both", help="both, left or right (default: both)")
    parser.add_argument("--seed", type=int, default=1, help="of the noise (default: %(default)s)")
    parser.add_argument(
        "--compression",
        choices=("lz4", "bz2", "none"),
        default="lz4",
        help="of the bag; bz2 is smaller (default: %(default)s)",
    )
    parser.add_argument("--output", required=True, metavar="BAG", help="bag to write")
    parser.set_defaults(run=run)


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
    plant = load_plant_parameters(arguments.plant)
    steers = plant.build_vehicle().delta_max
    if arguments.limit_rad > steers:
        raise ParameterError(
            f"--limit must be at most {steers:g} rad, as far as the car steers, "
            f"not {arguments.limit_rad:g}"
        )
    rising = (arguments.limit_rad - arguments.start_rad) / arguments.rate_radps
    expected = len(ramps) * (1 if arguments.sides != "both" else 2) * (rising + 3.0)
    if expected > 3600.0:
        raise ParameterError(f"--rate: the drive would take {expected / 60.0:.0f} minutes")
    bar_format = "{desc}: {percentage:3.0f}%|{bar}| {n:.0f}/{total:.0f} s [{elapsed}]"
    with tqdm(
        total=expected, desc=output.name, disable=None, bar_format=bar_format, leave=False
    ) as bar:

        def show(t):
            bar.update(min(t, bar.total) - bar.n)

        samples = drive_ramps(plant, ramps, arguments.seed, progress=show)
    write_ramp_bag(
        output, samples, None if arguments.compression == "none" else arguments.compression
    )
    speeds = ", ".join(f"{speed:g}" for speed in arguments.speed)
    print(
        f"{output}: {arguments.plant} at {speeds} m/s, {arguments.start_rad:g} to "
        f"{arguments.limit_rad:g} rad, {samples[-1].measured.t:.1f} s"
    )
