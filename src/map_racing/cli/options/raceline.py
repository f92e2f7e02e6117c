"""Options of ``map-racing raceline``."""

import argparse
import re

from ...track.files.formats import FORMATS

SOURCE = (
    "shipped track, raceline file (CSV, race_stack JSON, also .gz) or bag; FILE#KEY names the "
    "topic of a bag, the waypoints of a JSON file, or the columns of a CSV file as x,y,speed"
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the actions; each adds its own options."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION")
    actions.required = True
    for add_action in (add_check, add_convert, add_optimize):
        add_action(actions)


def add_check(actions):
    """Add ``raceline check``."""
    check = actions.add_parser(
        "check",
        help="check and describe a raceline",
        description="Recompute closure, order, spacing, heading, curvature, arc length, walls and "
        "speeds from the points, and compare them with the file. Notes are about conventions. "
        "Exit code 1 if there are warnings or errors, or the file cannot be read, else 0.",
    )
    check.add_argument("source", metavar="FILE", help=SOURCE)
    check.add_argument(
        "--json", metavar="FILE", help="write the report as JSON; - for standard output, alone"
    )
    check.add_argument(
        "--plots", metavar="DIR", help="draw track, walls and the places of findings"
    )
    check.set_defaults(run="raceline.run_check")


def add_convert(actions):
    """Add ``raceline convert``."""
    described = "; ".join(f"{name}: {text}" for name, text in FORMATS.items())
    convert = actions.add_parser(
        "convert",
        help="write a raceline in another format",
        description="Read a track and write it with heading, curvature, arc length and "
        "accelerations recomputed; its points are unchanged. Unusable racelines are "
        f"refused. Formats: {described}.",
    )
    convert.add_argument("source", metavar="IN", help=SOURCE)
    convert.add_argument("output", metavar="OUT", help="file to write")
    convert.add_argument(
        "--format",
        choices=tuple(FORMATS),
        help="format of OUT; needed for .csv, as .json is race_stack and .bag is bag",
    )
    convert.add_argument(
        "--repair",
        action="store_true",
        help="repair, with a list of repairs: drop points that are repeated, not finite, turn back "
        "or belong to a second loop, fill gaps, swap sides that are swapped, reverse the order if "
        "it is reversed, clamp negative widths",
    )
    convert.add_argument(
        "--reverse",
        action="store_true",
        help="reverse the direction of travel, from the same point",
    )
    convert.add_argument(
        "--spacing", type=float, metavar="M", help="resample to points this far apart [m]"
    )
    convert.set_defaults(run="raceline.run_convert")


def add_optimize(actions):
    """Add ``raceline optimize``."""
    parser = actions.add_parser(
        "optimize",
        help="the fastest line between the walls, from a centerline, a raceline or a map",
        description="Find the path of least squared curvature between the walls, half the car's "
        "width and a margin away from them, shortened where that makes the lap faster; and the "
        "highest speeds on it within the vehicle's limits: the lateral acceleration of its lookup "
        "table, combined with driving and braking in a friction ellipse. Print length, squared "
        "curvature and estimated lap time before and after.",
    )
    parser.add_argument(
        "source",
        metavar="IN",
        help="track with distances to the walls: shipped track, raceline file or bag; or the YAML "
        "file of a map of map_server, with --start",
    )
    parser.add_argument("--output", metavar="FILE", help="raceline to write (CSV, JSON or bag)")
    parser.add_argument(
        "--format",
        choices=tuple(FORMATS),
        help="format of the output (default: map_racing for .csv)",
    )
    parser.add_argument(
        "--middle",
        metavar="FILE",
        help="also write the smooth middle line between the walls, with speeds if the car can "
        "follow it",
    )
    parser.add_argument(
        "--sectors",
        metavar="YAML",
        help="also write speed_scaling.yaml of the public stack: a sector for each corner and "
        "straight of the output, with scale 1",
    )
    parser.add_argument("--plots", metavar="DIR", help="draw line, curvature and speed")

    line = parser.add_argument_group("line")
    line.add_argument(
        "--vehicle", default="nuc4", help="shipped vehicle or vehicle file (default: %(default)s)"
    )
    line.add_argument(
        "--margin",
        type=float,
        default=0.1,
        metavar="M",
        help="margin between the car's side and the walls [m] (default: %(default)s)",
    )
    line.add_argument(
        "--compare",
        metavar="FILE",
        help="raceline to compare with; the car may come as close to the walls as on this line, "
        "instead of --margin",
    )
    line.add_argument(
        "--curvature-only",
        action="store_true",
        help="least squared curvature, even where a shorter line is faster",
    )
    line.add_argument(
        "--step",
        type=float,
        default=0.1,
        metavar="M",
        help="spacing of the optimized points [m] (default: %(default)s)",
    )

    speed = parser.add_argument_group("speed")
    speed.add_argument(
        "--lookup-table", metavar="CSV", help="lateral limit from this table, not the vehicle's"
    )
    speed.add_argument(
        "--lateral-scale",
        type=float,
        default=1.0,
        metavar="S",
        help="share of the lateral acceleration to use (default: %(default)s)",
    )
    speed.add_argument(
        "--longitudinal-scale",
        type=float,
        default=1.0,
        metavar="S",
        help="share of driving and braking to use (default: %(default)s)",
    )
    speed.add_argument(
        "--speed-scale",
        type=float,
        default=1.0,
        metavar="S",
        help="scale of the resulting speeds (default: %(default)s)",
    )
    speed.add_argument("--v-max", type=float, metavar="V", help="top speed [m/s], if lower")
    speed.add_argument(
        "--power", type=float, metavar="W", help="power of the drive [W], limits acceleration"
    )

    image = parser.add_argument_group("map")
    image.add_argument(
        "--start",
        nargs="+",
        metavar="X,Y,PSI",
        help="start on the map [m] and heading there [rad] (default: counter-clockwise)",
    )
    image.add_argument(
        "--passage",
        type=float,
        metavar="M",
        help="close passages narrower than this, such as gaps in walls [m] (default: the car and "
        "its margins)",
    )
    image.add_argument(
        "--speckle",
        type=float,
        metavar="M2",
        help="remove walls of a smaller area [m^2] (default: two cells)",
    )
    # Otherwise argparse takes -1.5,2 for an option.
    parser._negative_number_matcher = re.compile(r"^-\.?\d[\d.,e+-]*$")
    parser.set_defaults(run="raceline_optimize.run_optimize")
