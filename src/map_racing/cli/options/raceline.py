"""Options of ``map-racing raceline``."""

import argparse
import re

from ...track.files.formats import FORMATS
from .shared import add_number, add_recording_options

SOURCE = (
    "shipped track, raceline file (CSV, race_stack JSON, also .gz) or bag; FILE#KEY names the "
    "topic of a bag, the waypoints of a JSON file, or the columns of a CSV file as x,y,speed"
)


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the actions; each adds its own options."""
    parser.description = "Check, convert, optimize and record racelines."
    actions = parser.add_subparsers(dest="action", metavar="ACTION")
    actions.required = True
    for add_action in (add_check, add_convert, add_optimize, add_record):
        add_action(actions)


def add_check(actions):
    """Add ``raceline check``."""
    check = actions.add_parser(
        "check",
        help="key figures of a raceline, and its errors",
        description="Recompute closure, order, spacing, heading, curvature, arc length, walls and "
        "speeds from the points, and compare them with the file. Notes report conventions. "
        "Exit code 0: no warnings or errors; 1: there are some, or the file cannot be "
        "read.",
    )
    check.add_argument("source", metavar="FILE", help=SOURCE)
    check.add_argument(
        "--json", metavar="FILE", help="write the report as JSON; - prints it, and nothing else"
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
        description="Read a raceline and write it with heading, curvature, arc length and "
        "accelerations recomputed; its points stay as they are. Unusable racelines are "
        f"rejected. Formats: {described}.",
    )
    convert.add_argument("source", metavar="IN", help=SOURCE)
    convert.add_argument("output", metavar="OUT", help="file to write")
    convert.add_argument(
        "--format",
        choices=tuple(FORMATS),
        help="format of OUT, needed for .csv (.json is race_stack, .bag is bag)",
    )
    convert.add_argument(
        "--repair",
        action="store_true",
        help="repair what can be repaired and print each repair: drop points that are repeated, "
        "not finite, turn back or belong to a second loop; fill gaps; correct reversed or swapped "
        "columns; clamp negative widths",
    )
    convert.add_argument(
        "--reverse", action="store_true", help="reverse the direction, from the same first point"
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
        description="Find the path of least squared curvature that stays half the car's width "
        "and a margin away from the walls, or a shorter path if it is faster. Then find "
        "the highest speeds on it that the vehicle can drive: lateral acceleration is limited by "
        "its lookup table, and shares the grip with driving and braking in a friction ellipse. "
        "Prints length, squared curvature and estimated lap time before and after.",
    )
    parser.add_argument(
        "source",
        metavar="IN",
        help="track with distances to the walls: shipped track, raceline file or bag; or the YAML "
        "file of a map of map_server, with --start",
    )
    parser.add_argument("--output", metavar="FILE", help="raceline to write (CSV, JSON or bag)")
    add_format(parser)
    parser.add_argument(
        "--middle",
        metavar="FILE",
        help="also write the smooth middle line between the walls, with speeds found in the same "
        "way if the car can follow it",
    )
    parser.add_argument(
        "--sectors",
        metavar="YAML",
        help="also write speed_scaling.yaml of race_stack: a sector for each corner and "
        "straight of the output, with scale 1",
    )
    parser.add_argument("--plots", metavar="DIR", help="draw line, curvature and speed")

    _add_line(parser.add_argument_group("line"))
    _add_speed(parser.add_argument_group("speed"))
    _add_map(parser.add_argument_group("map"))
    # Otherwise argparse mistakes -1.5,2 for an option.
    parser._negative_number_matcher = re.compile(r"^-\.?\d[\d.,e+-]*$")
    parser.set_defaults(run="raceline_optimize.run_optimize")


def _add_line(line):
    add_vehicle(line)
    line.add_argument(
        "--margin",
        type=float,
        metavar="M",
        help="distance from the sides of the car to the walls [m] (default: 0.1 for a 1:10 car, "
        "more for a larger one)",
    )
    line.add_argument(
        "--compare",
        action="append",
        default=[],
        metavar="FILE",
        help="raceline to compare with, may be given several times; the car may come as close to "
        "the walls as on the closest of these lines, whatever --margin says",
    )
    line.add_argument(
        "--curvature-only",
        action="store_true",
        help="keep to the least squared curvature, even where a shorter line is faster",
    )
    line.add_argument(
        "--step",
        type=float,
        metavar="M",
        help="distance between the points that are moved [m] (default: 0.1 for a 1:10 car, more "
        "for a larger one)",
    )


def add_format(parser):
    """Add the option for the format of the output."""
    parser.add_argument(
        "--format",
        choices=tuple(FORMATS),
        help="format of the output (default: map_racing for .csv)",
    )


def add_vehicle(parser):
    """Add the option for the car."""
    parser.add_argument(
        "--vehicle",
        default="nuc4",
        metavar="NAME",
        help="shipped vehicle or YAML file (default: %(default)s)",
    )


def _add_speed(speed):
    speed.add_argument(
        "--lookup-table",
        metavar="CSV",
        help="take the lateral limit from this table instead of the vehicle's own",
    )
    for option, meaning in (
        ("--lateral-scale", "share of the lateral acceleration to use"),
        ("--longitudinal-scale", "share of driving and braking to use"),
        ("--speed-scale", "factor on the resulting speeds"),
    ):
        add_number(speed, option, 1.0, meaning, metavar="SCALE")
    speed.add_argument(
        "--v-max", type=float, metavar="V", help="top speed [m/s], if below the vehicle's"
    )
    speed.add_argument(
        "--power", type=float, metavar="W", help="the drive's power [W], which limits acceleration"
    )


def _add_map(image):
    image.add_argument(
        "--start",
        nargs="+",
        metavar="X,Y,PSI",
        help="start on the map [m] and direction of travel there [rad]; without a direction, "
        "counter-clockwise",
    )
    image.add_argument(
        "--passage",
        type=float,
        metavar="M",
        help="close openings narrower than this, such as gaps in walls [m] (default: the car and "
        "its margins)",
    )
    image.add_argument(
        "--speckle",
        type=float,
        metavar="M2",
        help="remove obstacles smaller than this [m^2] (default: two cells)",
    )


def add_record(actions):
    """Add ``raceline record``."""
    parser = actions.add_parser(
        "record",
        help="a closed raceline from a lap driven by hand or by another controller",
        description="Find the laps of a recording and write the line of one of them: smoothed, "
        "closed, at equal distances, with the speeds driven; and check it like raceline check. "
        "With a raceline the laps are those of evaluate; without one they are found from the path "
        "itself.",
    )
    add_recording_options(parser)
    parser.add_argument("--output", required=True, metavar="FILE", help="raceline to write")
    add_format(parser)
    parser.add_argument(
        "--lap",
        default="best",
        metavar="N",
        help="number of the lap, or best, the fastest that counts (default: %(default)s)",
    )
    parser.add_argument(
        "--speeds",
        choices=("driven", "none"),
        default="driven",
        help="speeds of the output (default: %(default)s)",
    )
    parser.add_argument("--map", metavar="YAML", help="take the walls from this map of map_server")
    add_vehicle(parser)
    parser.add_argument(
        "--spacing",
        type=float,
        metavar="M",
        help="distance between the points [m] (default: 0.1 for a 1:10 car, more for a larger one)",
    )
    parser.add_argument(
        "--smoothing",
        type=float,
        metavar="M",
        help="treat waves of the path shorter than this as noise [m] (default: 1.5 for a 1:10 "
        "car, more for a larger one)",
    )
    parser.set_defaults(run="raceline_record.run_record")
