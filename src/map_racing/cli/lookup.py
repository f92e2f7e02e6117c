"""``map-racing lookup``: make, check and draw steady-state lookup tables."""

from __future__ import annotations

import math

import numpy as np

from ..control.parameters import load_controller_parameters
from ..control.speed_plan import SpeedPlan
from ..errors import FileFormatError, ParameterError
from ..identification.data import load_run
from ..identification.replay import actuators_of, replay, replay_lines
from ..track.corners import corners
from ..track.files.load import load_raceline
from ..track.findings import raceline_warnings
from ..vehicle.comparison import LARGEST_COMPARED, LARGEST_DIFFERENCE, compare_tables
from ..vehicle.grids import default_grid, published_grid
from ..vehicle.lookup import load_table
from ..vehicle.parameters import linearized, parameter_hash
from ..vehicle.plausibility import doubts_of_cells, doubts_of_peak, doubts_of_provenance
from ..vehicle.steady_state import steady_state_table
from .figures import draw_table
from .inputs import channel_map, read_vehicle
from .options.lookup import CONTROLLER
from .outputs import check_outputs


def run_generate(arguments):
    """Make a table and write it."""
    check_outputs([arguments.output], [arguments.vehicle])
    vehicle = _vehicle(arguments)
    if arguments.published_grid:
        if arguments.v_max is not None:
            raise ParameterError("expected --published-grid (7 m/s) or --v-max, got both")
        speeds, angles = published_grid()
    else:
        if arguments.v_max is not None and not 0.5 <= arguments.v_max <= 100.0:
            raise ParameterError(f"--v-max: expected 0.5 to 100 m/s, got {arguments.v_max}")
        speeds, angles = default_grid(vehicle, v_max=arguments.v_max)
    table = steady_state_table(vehicle, speeds, angles)
    table.save(arguments.output)
    _describe(arguments.output, table)
    _draw(arguments.plots, table)


def run_check(arguments):
    """Report on a table; compare it with a vehicle."""
    _check_options(arguments)
    table = load_table(arguments.table)
    vehicle = _vehicle(arguments) if arguments.vehicle else None
    _describe(arguments.table, table)
    if arguments.raceline:
        raceline = load_raceline(arguments.raceline)
        for doubt in raceline_warnings(raceline, arguments.raceline):
            print(f"  warning: {doubt}")
        _describe_corners(raceline, table)
        _describe_speeds(raceline, table, arguments.controller, vehicle)
    _draw(arguments.plots, table)
    if vehicle is None:
        return
    if table.provenance and table.provenance.parameter_hash != parameter_hash(vehicle):
        print(
            f"  made from other parameters ({table.provenance.vehicle} "
            f"{table.provenance.parameter_hash}, not {vehicle.name} {parameter_hash(vehicle)})"
        )
    found = compare_tables(table, steady_state_table(vehicle, table.speeds, table.angles))
    if not found.compared:
        raise FileFormatError(f"{arguments.table}: no cell in common with {vehicle.name}'s table")
    where = f"at {found.speed:.2f} m/s, {found.angle:.3f} rad"
    print(
        f"  against {vehicle.name}: {found.compared} cells compared, largest difference "
        f"{found.largest:.2e} m/s^2 {where}; {found.one_sided} cells stable in only one of them"
    )
    if found.beyond:
        print(f"  {found.beyond} cells beyond {LARGEST_COMPARED:g} m/s^2 not compared")
    if found.largest > LARGEST_DIFFERENCE:
        raise FileFormatError(
            f"{arguments.table}: not a table of {vehicle.name}: off by "
            f"{found.largest:.2f} m/s^2 {where}"
        )
    if arguments.bag:
        _replay(arguments, vehicle)


def _check_options(arguments):
    """Refuse options that would be ignored."""
    if arguments.bag and not arguments.vehicle:
        raise ParameterError("--bag: expected --vehicle, the car to drive by its commands")
    if arguments.linear and not arguments.vehicle:
        raise ParameterError("--linear: expected --vehicle, the car to compare with")
    if arguments.controller != CONTROLLER and not arguments.raceline:
        raise ParameterError("--controller: expected --raceline, the line that it would drive")
    for name in ("channels", "pose_topic", "servo_topic", "steering_delay"):
        if getattr(arguments, name) is not None and not arguments.bag:
            raise ParameterError(f"--{name.replace('_', '-')}: expected --bag, what it is for")


def _replay(arguments, vehicle):
    """Drive the vehicle with the commands of recordings."""
    channels = channel_map(arguments)
    runs = [load_run(path, channels) for path in arguments.bag]
    actuators = actuators_of(runs, vehicle)
    found = replay(vehicle, runs, actuators, arguments.window)
    why = (
        f"fitted with {vehicle.name}'s tires held"
        if actuators.fitted
        else "default values, as they turn too little to fit them"
    )
    print(f"  steering of these recordings: {actuators.delay:.3f} s of dead time and lag, {why}")
    for line in replay_lines(found):
        print(f"  {line}")


def _draw(folder, table):
    if folder is not None:
        draw_table(folder, table)
        print(f"  figures are in {folder}")


def _vehicle(arguments):
    vehicle = read_vehicle(arguments.vehicle)
    return linearized(vehicle) if arguments.linear else vehicle


def _describe(path, table):
    speeds, angles = table.speeds, table.angles
    print(f"{path}: {angles.size} angles x {speeds.size} speeds")
    print(
        f"  {angles[0]:.3f} to {angles[-1]:.3f} rad, {speeds[0]:.2f} to {speeds[-1]:.2f} m/s, "
        f"wheelbase {table.l_wb:.4f} m"
    )
    if table.provenance:
        origin = table.provenance
        print(f"  {origin.vehicle}, {origin.tire_model} tires, parameters {origin.parameter_hash}")
    else:
        print("  no provenance beside it")
    unstable = np.isnan(table.a_lat)
    with np.errstate(invalid="ignore"):
        falling = np.any(np.diff(table.a_lat, axis=0) < 0.0, axis=0)
    print(
        f"  {unstable.sum()} cells without a stable steady state; {falling.sum()} speeds at which "
        "more angle gives less acceleration beyond a peak"
    )
    picked = np.unique(np.linspace(0, speeds.size - 1, 6).astype(int))
    limits = ", ".join(
        f"{table.max_lateral_acceleration(float(speeds[i])):.2f} at {speeds[i]:.1f} m/s"
        for i in picked
    )
    print(f"  largest lateral acceleration [m/s^2]: {limits}")
    for doubt in doubts_of_provenance(table) + doubts_of_peak(table) + doubts_of_cells(table):
        print(f"  warning: {doubt}")


def _describe_corners(raceline, table):
    """Print the speed at which each corner reaches the table's limit."""
    found = corners(raceline, table)
    print(f"  corners of {raceline.name or 'the raceline'}, where their margin is smallest:")
    for corner in found:
        side = "left" if corner.curvature > 0.0 else "right"
        if corner.limit_speed == 0.0:
            limit = "tighter than the table can steer at any speed"
        elif math.isfinite(corner.limit_speed):
            limit = f"exceeds the table's limit at {corner.limit_speed:.2f} m/s"
        else:
            limit = "does not reach the table's limit below 30 m/s"
        own = ""
        if math.isfinite(corner.speed) and 0.0 < corner.limit_speed < math.inf:
            own = f"; the raceline has {corner.speed:.2f} m/s, {corner.share:.0%} of that"
        print(
            f"    s = {corner.s:.1f} m, {side}, radius {1.0 / abs(corner.curvature):.2f} m: "
            f"{limit}{own}"
        )
    shares = [corner.share for corner in found if math.isfinite(corner.share)]
    if shares and max(shares) > 0.0:
        print(
            f"  the raceline can be driven at up to {1.0 / max(shares):.0%} of its speeds before a "
            "corner exceeds the limit"
        )


def _describe_speeds(raceline, table, controller, vehicle):
    """Print where a controller with this table would drive slower than the raceline."""
    parameters = load_controller_parameters(controller, vehicle).with_(speed_scale=1.0)
    said = f"  {controller}, speed_scale 1, grip_use {parameters.grip_use:g}: "
    if parameters.grip_use:
        top_speed = math.inf if vehicle is None else vehicle.v_max
        said += str(SpeedPlan(raceline, parameters, table, top_speed=top_speed))
    else:
        said += "drives the raceline's speeds, whatever the grip"
    print(said)
