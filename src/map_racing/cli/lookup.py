"""``map-racing lookup``: make, check and draw steady-state lookup tables."""

import math

import numpy as np

from ..errors import FileFormatError, ParameterError
from ..files import make_folder
from ..track.corners import corners
from ..track.files.load import load_raceline
from ..vehicle.lookup import default_grid, load_table
from ..vehicle.parameters import linearized, load_vehicle, parameter_hash
from ..vehicle.steady_state import steady_state_table
from .outputs import check_outputs

# Lateral accelerations beyond this [m/s^2] are reached only by linear tires, which never slide, and
# tables made by integration for a fixed time had not settled there.
LARGEST_COMPARED = 25.0
LARGEST_DIFFERENCE = 0.05  # [m/s^2], well below what tires change from one day to the next


def add_parser(commands):
    """Add the command to the parser."""
    parser = commands.add_parser("lookup", help="make or check a steering lookup table")
    actions = parser.add_subparsers(dest="action", metavar="ACTION")
    actions.required = True

    generate = actions.add_parser(
        "generate",
        help="table of a vehicle",
        description="Steady-state lateral acceleration over speed and steering angle, as CSV in "
        "the published layout, with its provenance in a .meta.yaml beside it.",
    )
    generate.add_argument("--vehicle", required=True, help="shipped vehicle or vehicle file")
    generate.add_argument("--output", required=True, metavar="CSV", help="table to write")
    generate.add_argument("--linear", action="store_true", help="linearize the tires")
    generate.add_argument(
        "--v-max", type=float, metavar="V", help="largest speed [m/s] (default: the vehicle's)"
    )
    generate.add_argument(
        "--published-grid",
        action="store_true",
        help="the grid of the published tables: 60 angles to 0.4 rad, 65 speeds to 7 m/s",
    )
    generate.add_argument("--plots", metavar="DIR", help="draw the table as surface and curves")
    generate.set_defaults(run=run_generate)

    check = actions.add_parser(
        "check",
        help="what a table holds, and whether it fits a vehicle",
        description="Report the grid, the largest lateral acceleration and defects of a table. "
        "With --vehicle, compare it with the table of that vehicle; more than "
        f"{LARGEST_DIFFERENCE:g} m/s^2 apart is an error.",
    )
    check.add_argument("table", metavar="CSV", help="lookup table")
    check.add_argument("--vehicle", help="shipped vehicle or vehicle file to compare with")
    check.add_argument("--linear", action="store_true", help="linearize the vehicle's tires")
    check.add_argument(
        "--raceline",
        metavar="LINE",
        help="list the speed at which each corner exceeds the table's limit: shipped track, "
        "raceline file or bag[#topic]",
    )
    check.add_argument("--plots", metavar="DIR", help="draw the table as surface and curves")
    check.set_defaults(run=run_check)


def run_generate(arguments):
    """Make a table and write it."""
    check_outputs([arguments.output], [arguments.vehicle])
    vehicle = _vehicle(arguments)
    if arguments.published_grid:
        if arguments.v_max is not None:
            raise ParameterError("--published-grid goes to 7 m/s: give it or --v-max, not both")
        speeds, angles = published_grid()
    else:
        if arguments.v_max is not None and not 0.5 <= arguments.v_max <= 100.0:
            raise ParameterError(f"--v-max must be from 0.5 to 100 m/s, not {arguments.v_max}")
        speeds, angles = default_grid(vehicle, v_max=arguments.v_max)
    table = steady_state_table(vehicle, speeds, angles)
    table.save(arguments.output)
    _describe(arguments.output, table)
    _draw(arguments, table)


def run_check(arguments):
    """Report on a table; compare it with a vehicle."""
    table = load_table(arguments.table)
    _describe(arguments.table, table)
    if arguments.raceline:
        _describe_corners(load_raceline(arguments.raceline), table)
    _draw(arguments, table)
    if not arguments.vehicle:
        return
    vehicle = _vehicle(arguments)
    if table.provenance and table.provenance.parameter_hash != parameter_hash(vehicle):
        print(
            f"  made from other parameters ({table.provenance.vehicle} "
            f"{table.provenance.parameter_hash}, not {vehicle.name} {parameter_hash(vehicle)})"
        )
    expected = steady_state_table(vehicle, table.speeds, table.angles).a_lat
    both = np.isfinite(expected) & np.isfinite(table.a_lat)
    with np.errstate(invalid="ignore"):
        beyond = both & (expected > LARGEST_COMPARED)
    both &= ~beyond
    one = np.isfinite(expected) ^ np.isfinite(table.a_lat)
    if not both.any():
        raise FileFormatError(f"{arguments.table}: no cell in common with {vehicle.name}'s table")
    difference = np.where(both, np.abs(expected - table.a_lat), 0.0)
    row, column = np.unravel_index(np.argmax(difference), difference.shape)
    where = f"at {table.speeds[column]:.2f} m/s, {table.angles[row]:.3f} rad"
    print(
        f"  against {vehicle.name}: {both.sum()} cells compared, largest difference "
        f"{difference.max():.2e} m/s^2 {where}; {one.sum()} cells stable in only one of them"
    )
    if beyond.any():
        print(f"  {beyond.sum()} cells beyond {LARGEST_COMPARED:g} m/s^2 not compared")
    if difference.max() > LARGEST_DIFFERENCE:
        raise FileFormatError(
            f"{arguments.table}: not a table of {vehicle.name}: off by "
            f"{difference.max():.2f} m/s^2 {where}"
        )


def published_grid():
    """Speeds and angles of the published tables, which contain 0.1 rad twice."""
    angles = np.concatenate((np.linspace(0.0, 0.1, 30), np.linspace(0.1, 0.4, 30)))
    return np.linspace(0.5, 7.0, 65), angles


def _vehicle(arguments):
    vehicle = load_vehicle(arguments.vehicle)
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


def _describe_corners(raceline, table):
    """The speed at which each corner takes all that the table has."""
    found = corners(raceline, table)
    print(f"  corners of {raceline.name or 'the raceline'}, where they have the least to spare:")
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


def _draw(arguments, table):
    if not arguments.plots:
        return
    # matplotlib takes a second, and most calls draw nothing
    from ..plots import lookup
    from ..plots.style import save

    folder = make_folder(arguments.plots)
    grid = table.speeds, table.angles, table.a_lat
    save(lookup.plot_lookup_surface(*grid), folder / "lookup_surface.png")
    save(lookup.plot_lookup_curves(*grid), folder / "lookup_curves.png")
    print(f"  figures are in {folder}")
