"""``map-racing race``: drive a simulated car around a track and record a bag."""

import math
import sys
from pathlib import Path

from ..control.controller import Controller
from ..control.laws import build_law
from ..control.parameters import MpcParameters, load_law, load_safety_limits
from ..control.settings import settings_text
from ..control.speed_sectors import load_speed_sectors
from ..control.steering import build_steering_maps
from ..errors import ParameterError
from ..printing import amount
from ..simulation.faults import load_faults
from ..simulation.plants import build_plant
from ..simulation.race import Outcome, race
from ..simulation.recorded import write_race_bag
from ..track.files.load import load_raceline
from ..vehicle.lookup import load_table
from ..vehicle.parameters import parameter_hash
from ..vehicle.plausibility import doubts_of_table
from ..vehicle.size import ONE_TENTH, size_of
from .inputs import read_plant, read_vehicle
from .outputs import check_outputs
from .progress import progress_bar

# Exit code of a race that was recorded but not completed; 1 is for errors, 2 for usage.
NOT_COMPLETED = 3
# A race is kept in memory until its bag is written.
MOST_LAPS = 1000
LONGEST_LAP = 5000.0  # of a 1:10 car [m]


def run(arguments):
    """Race and record; exit code."""
    if not 1 <= arguments.laps <= MOST_LAPS:
        raise ParameterError(f"--laps: expected 1 to {MOST_LAPS}, got {arguments.laps}")
    inputs = [arguments.track, arguments.controller, arguments.plant, arguments.vehicle]
    inputs += [arguments.lookup_table, arguments.speed_sectors, arguments.faults]
    check_outputs([arguments.output], inputs)
    parameters = load_law(arguments.controller)
    if arguments.faults and isinstance(parameters, MpcParameters):
        raise ParameterError(
            f"--faults: expected a controller that the node drives, got {arguments.controller}"
        )
    plant_parameters = read_plant(arguments.plant)
    size = size_of(plant_parameters.vehicle)
    raceline = load_track(arguments.track, LONGEST_LAP * size.length)
    parameters = law_for(arguments, plant_parameters, size)
    plant, localization = build_plant(plant_parameters, arguments.seed)
    controller = controller_of(arguments, parameters, plant_parameters.vehicle, raceline)
    faults, limits = (), None
    if arguments.faults:
        faults = load_faults(arguments.faults, raceline.length)
        limits = load_safety_limits(arguments.controller, plant_parameters.vehicle)
    with progress_bar(Path(arguments.output).name, arguments.laps + 1, "laps") as show:
        log = race(
            plant,
            controller,
            raceline,
            localization,
            laps=arguments.laps,
            progress=show,
            limits=limits,
            faults=faults,
        )
    print_stops(log, faults)
    settings = settings_text(
        controller,
        name=arguments.controller,
        table=arguments.lookup_table or "",
        sectors=arguments.speed_sectors or "",
    )
    write_race_bag(arguments.output, log, raceline, settings=settings)
    print_end(arguments, log, raceline, parameters.speed_scale)
    if not arguments.output.endswith(".bag"):
        print(f"{arguments.output}: not named .bag: season does not find it in its folder")
    if log.outcome is Outcome.COMPLETED:
        return 0
    print(f"map-racing: not completed (N.C.), {log.outcome.value}", file=sys.stderr)
    return NOT_COMPLETED


def print_stops(log, faults):
    """Print each stop, and the faults that came too late."""
    for t, reason, again in log.stops():
        until = "does not drive again" if math.isnan(again) else f"drives again at {again:.2f} s"
        print(f"stop at {t:.2f} s: {reason.value}; {until}")
    for fault in faults:
        if fault.at_s > log.duration:
            print(f"{fault.fault} at {fault.at_s:g} s: the race ended before")


def print_end(arguments, log, raceline, scale):
    """Print how the race ended and, if it was not completed, where."""
    if raceline.d_left is None:
        print(f"{arguments.track}: no walls are known, so crashes are not detected")
    where = ""
    if log.outcome is not Outcome.COMPLETED and log.samples:
        place = raceline.project(*log.samples[-1].true[1:3])
        side = "left" if place.d > 0.0 else "right"
        where = f" at s = {place.s:.1f} m, {abs(place.d):.2f} m {side} of the raceline"
    print(
        f"{Path(arguments.output)}: {arguments.controller} on {raceline.name or arguments.track} "
        f"at {scale:.0%} speed: {log.outcome.value} after {amount(log.laps, 'timed lap')}, "
        f"{log.duration:.1f} s{where}"
    )


def load_track(source, longest):
    """The raceline to drive; its findings are printed."""
    raceline = load_raceline(source)
    if raceline.length > longest:
        raise ParameterError(
            f"{source}: expected a lap of at most {longest:.0f} m, got "
            f"{raceline.length:.0f} m: is it in meters?"
        )
    for finding in raceline.findings:
        print(f"{source}: {finding}")
    return raceline


def law_for(arguments, plant_parameters, size):
    """The controller's parameters for a race on a plant, scaled to the car's size."""
    parameters = load_law(arguments.controller, plant_parameters.vehicle)
    if size != ONE_TENTH and parameters != load_law(arguments.controller):
        print(f"{arguments.controller}: for 1:10 cars; {size}")
    if arguments.speed_scale is not None:
        parameters = parameters.with_(speed_scale=arguments.speed_scale)
    if plant_parameters.reference_point != "rear_axle":
        parameters = parameters.with_(reference_point=plant_parameters.reference_point)
    return parameters


def controller_of(arguments, parameters, plant_vehicle, raceline):
    """The controller, with a note if its model of the car is not the plant's."""
    vehicle = read_vehicle(arguments.vehicle) if arguments.vehicle else plant_vehicle
    if parameter_hash(vehicle) != parameter_hash(plant_vehicle):
        print(
            f"the controller knows {vehicle.name} of {arguments.vehicle}, but the plant "
            f"{arguments.plant} is {plant_vehicle.name} with other values"
        )
    sectors = None
    if arguments.speed_sectors:
        sectors = load_speed_sectors(arguments.speed_sectors, raceline)
        for doubt in sectors.doubts:
            print(f"warning: {doubt}")
        print(sectors.told(parameters.speed_scale))
    if isinstance(parameters, MpcParameters):
        if arguments.lookup_table:
            raise ParameterError(f"{arguments.lookup_table}: {arguments.controller} uses no table")
        return build_law(parameters, vehicle, raceline, sectors)
    steering_map, grip = build_steering_maps(parameters, vehicle)
    if arguments.lookup_table:
        steering_map = given_table(arguments.lookup_table, parameters, vehicle, steering_map)
        if parameters.steering_map == "table":
            grip = steering_map
    controller = Controller(parameters, steering_map, vehicle, raceline, sectors, grip)
    if controller.plan is not None:
        print(f"grip_use {parameters.grip_use:g}: {controller.plan}")
    return controller


def given_table(path, parameters, vehicle, own):
    """The table of a file; prints a comparison with the vehicle's own."""
    if parameters.steering_map == "ackermann":
        raise ParameterError(f"{path}: pure pursuit uses no lookup table")
    if parameters.adaptation:
        raise ParameterError(f"{path}: a controller that adapts its tires uses no lookup table")
    table = load_table(path)
    made_for = f" for {table.provenance.vehicle}" if table.provenance else ""
    v, a_lat = 3.0, 0.5 * own.max_lateral_acceleration(3.0)
    angles = [steering_map.steering(v, a_lat)[0] for steering_map in (table, own)]
    print(
        f"{path}: table{made_for}: {angles[0]:.4f} rad for {a_lat:.1f} m/s^2 at {v:g} m/s, where "
        f"the table of {vehicle.name} has {angles[1]:.4f} rad"
    )
    for doubt in doubts_of_table(table, vehicle, parameters.steering_map == "linear_table"):
        print(f"warning: {doubt}")
    return table
