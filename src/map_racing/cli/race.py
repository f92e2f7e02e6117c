"""``map-racing race``: drive a simulated car around a track and record a bag."""

from pathlib import Path

from tqdm import tqdm

from ..control.controller import Controller, build_steering_map
from ..control.parameters import load_controller_parameters
from ..control.speed_sectors import load_speed_sectors
from ..errors import ParameterError
from ..evaluation.recordings import load_course
from ..experiments.race_bag import write_race_bag
from ..simulation.plant import Localization, Plant, load_plant_parameters
from ..simulation.public_simulator import PublicSimulator
from ..simulation.race import race
from ..vehicle.lookup import load_table
from ..vehicle.parameters import load_vehicle

PUBLIC_SIMULATOR = "public_simulator"


def add_parser(commands):
    """Add the command to the parser."""
    parser = commands.add_parser(
        "race",
        help="race a simulated car, write a ROS 1 bag",
        description="Race a simulated car from a standing start: an out-lap, then timed laps. "
        "Names are those of the shipped files; each also takes a path.",
    )
    parser.add_argument("--track", default="reference", help="track, raceline file or bag")
    parser.add_argument("--vehicle", default="nuc4", help="the car as the controller knows it")
    parser.add_argument(
        "--controller",
        default="map",
        help="map, map_linear, pure_pursuit, or one of these with _paper: as published, without "
        "delay compensation",
    )
    parser.add_argument(
        "--plant",
        default="nuc4",
        help=f"the car as it is: a plant file, or {PUBLIC_SIMULATOR} for the plant of the public "
        "ROS 1 simulator",
    )
    parser.add_argument("--lookup-table", metavar="CSV", help="use this table for steering")
    parser.add_argument("--sectors", metavar="YAML", help="speed_scaling.yaml of the public stack")
    parser.add_argument("--laps", type=int, default=5, help="timed laps (default: %(default)s)")
    parser.add_argument(
        "--speed-scale",
        type=float,
        default=0.7,
        help="scale of the raceline's speeds (default: %(default)s; the shipped racelines ask for "
        "more grip than nuc4 has above about 0.85)",
    )
    parser.add_argument("--seed", type=int, default=1, help="of the noise (default: %(default)s)")
    parser.add_argument("--output", required=True, metavar="BAG", help="bag to write")
    parser.set_defaults(run=run)


def run(arguments):
    """Race and record; a crash is a result, not an error."""
    parameters = load_controller_parameters(arguments.controller)
    parameters = parameters.with_(speed_scale=arguments.speed_scale)
    vehicle = load_vehicle(arguments.vehicle)
    raceline = load_course(arguments.track)
    output = Path(arguments.output)
    if not output.parent.is_dir():
        raise ParameterError(f"{output}: the folder {output.parent} does not exist")

    if arguments.plant == PUBLIC_SIMULATOR:
        plant, localization = PublicSimulator(load_vehicle("sim")), None
        # It publishes the pose of the center of gravity under the name of base_link.
        parameters = parameters.with_(reference_point="center_of_gravity")
    else:
        plant_parameters = load_plant_parameters(arguments.plant)
        plant = Plant(plant_parameters)
        localization = Localization(plant_parameters, arguments.seed)

    if arguments.lookup_table:
        if parameters.steering_map == "ackermann":
            raise ParameterError(f"{arguments.controller}: pure pursuit uses no lookup table")
        steering_map = load_table(arguments.lookup_table)
    else:
        steering_map = build_steering_map(parameters.steering_map, vehicle, parameters.v_max_mps)
    sectors = load_speed_sectors(arguments.sectors, raceline) if arguments.sectors else None
    controller = Controller(parameters, steering_map, vehicle, raceline, sectors)

    bar_format = "{desc}: {percentage:3.0f}%|{bar}| {n:.1f}/{total:.0f} laps [{elapsed}]"
    with tqdm(
        total=arguments.laps + 1, desc=output.name, disable=None, bar_format=bar_format, leave=False
    ) as bar:

        def show(laps):
            bar.update(min(laps, bar.total) - bar.n)

        log = race(plant, controller, raceline, localization, laps=arguments.laps, progress=show)
    write_race_bag(output, log, raceline)
    print(
        f"{output}: {arguments.controller} on {raceline.name or arguments.track} at "
        f"{parameters.speed_scale:.0%} speed: {log.outcome.value} after {log.laps} timed laps, "
        f"{log.duration:.1f} s"
    )
