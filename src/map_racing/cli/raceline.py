"""``map-racing raceline``: check, convert and make racelines."""

import json
import re

from ..errors import MapRacingError, ParameterError
from ..files import make_folder, replacing
from ..track.files.checks import examine, raceline_of
from ..track.files.load import read_raceline, save_raceline
from ..track.files.readers import split_source
from ..track.files.repair import driven_columns, repaired, resampled, reversed_table
from ..track.files.report import facts_text, findings_count, findings_rows, raceline_facts
from ..track.files.writers import FORMATS, choose_format
from ..track.findings import ERROR, NOTE, Finding, worst_first
from . import raceline_optimize
from .outputs import check_outputs

SOURCE = (
    "shipped track, raceline file (CSV, race_stack JSON, also .gz) or bag; FILE#KEY names the "
    "topic of a bag, the waypoints of a JSON file, or the columns of a CSV file as x,y,speed"
)
# Formats with no place for what a track may have.
WITHOUT = {"tum": "walls", "racetracks": "walls", "centerline": "speeds"}


def add_parser(commands):
    """Add the command to the parser; each action adds its own part."""
    parser = commands.add_parser("raceline", help="check, convert and optimize racelines")
    actions = parser.add_subparsers(dest="action", metavar="ACTION")
    actions.required = True
    for add_action in (add_check, add_convert, raceline_optimize.add_action):
        add_action(actions)


def add_check(actions):
    """Add ``raceline check``."""
    check = actions.add_parser(
        "check",
        help="what a raceline is, and what is wrong with it",
        description="Recompute closure, order, spacing, heading, curvature, arc length, walls and "
        "speeds from the points, and compare them with what the file says. Notes tell conventions. "
        "Exit code 0: nothing is wrong; 1: there are warnings or errors, or the file cannot be "
        "read.",
    )
    check.add_argument("source", metavar="FILE", help=SOURCE)
    check.add_argument(
        "--json", metavar="FILE", help="write the report as JSON; - for standard output, alone"
    )
    check.add_argument(
        "--plots", metavar="DIR", help="draw track, walls and the places of findings"
    )
    check.set_defaults(run=run_check)


def add_convert(actions):
    """Add ``raceline convert``."""
    described = "; ".join(f"{name}: {text}" for name, text in FORMATS.items())
    convert = actions.add_parser(
        "convert",
        help="write a raceline in another format",
        description="Read a track and write it with heading, curvature, arc length and "
        "accelerations recomputed; its points stay as they are. What is wrong beyond use is "
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
        help="mend what can be mended, and say what: drop points that are repeated, not finite, "
        "turn back or belong to a second loop, fill gaps, reverse or exchange what is reversed or "
        "exchanged, clamp negative widths",
    )
    convert.add_argument(
        "--reverse", action="store_true", help="drive it the other way round, from the same point"
    )
    convert.add_argument(
        "--spacing", type=float, metavar="M", help="resample to points this far apart [m]"
    )
    convert.set_defaults(run=run_convert)


def run_check(arguments):
    """Report on a raceline."""
    alone = arguments.json == "-"
    check_outputs([None if alone else arguments.json], [split_source(arguments.source)[0]])
    table = raceline = None
    try:
        table = read_raceline(arguments.source)
        raceline, findings = examine(table)
    except MapRacingError as error:
        if not arguments.json:
            raise
        findings = (Finding("unreadable", ERROR, str(error)),)
    wrong = any(finding.severity != NOTE for finding in findings)
    facts = None if raceline is None else raceline_facts(raceline)
    report = {
        "source": arguments.source,
        "layout": table and table.layout,
        "ok": not wrong,
        "usable": all(finding.severity != ERROR for finding in findings),
        "course": facts,
        "findings": findings_rows(findings),
    }
    if alone:
        print(json.dumps(report, indent=2))
    else:
        print(arguments.source)
        for line in ([table.layout] if table else []) + (facts_text(facts) if facts else []):
            print(f"  {line}")
        print_findings(findings)
        print(f"  {findings_count(findings)}")
        if arguments.json:
            with replacing(arguments.json) as file:
                file.write(json.dumps(report, indent=2) + "\n")
            print(f"  report written to {arguments.json}")
    if arguments.plots and table is not None:
        _, key = split_source(arguments.source)
        path = draw(arguments.plots, key, table, raceline, findings)
        if not alone:
            print(f"  figure: {path}")
    return int(wrong)


def run_convert(arguments):
    """Read, mend, write."""
    form = choose_format(arguments.output, arguments.format)
    check_outputs([arguments.output], [split_source(arguments.source)[0]])
    if arguments.spacing is not None and not 0.001 <= arguments.spacing <= 100.0:
        raise ParameterError(f"--spacing must be from 0.001 to 100 m, not {arguments.spacing:g}")
    table = read_raceline(arguments.source)
    print(f"{arguments.source}\n  {table.layout}")
    if arguments.repair:
        print_findings(examine(table).findings)
        table, repairs = repaired(table)
        for repair in repairs:
            print(f"  repaired: {repair}")
    else:
        print_findings(raceline_of(table).findings)
    table = driven_columns(table)._replace(findings=())
    if arguments.reverse:
        table = reversed_table(table)
        print("  reversed")
    if arguments.spacing is not None:
        table = resampled(table, arguments.spacing)
        print(f"  resampled to {table.columns['x'].size} points")
    raceline = raceline_of(table)
    if arguments.repair:
        for finding in raceline.findings:
            if finding.severity != NOTE:
                print(f"  left as it is: {finding}")
    lost = WITHOUT.get(form)
    if lost and getattr(raceline, {"walls": "d_left", "speeds": "speed"}[lost]) is not None:
        print(f"  {lost} left out: format {form} has none")
    if form in ("race_stack", "bag"):
        for what, column in (("speeds", raceline.speed), ("walls", raceline.d_left)):
            if column is None:
                print(f"  no {what} are known: written as 0")
    save_raceline(raceline, arguments.output, form, table)
    print(
        f"{arguments.output}: format {form}, {table.columns['x'].size} points, "
        f"{raceline.length:.3f} m"
    )


def print_findings(findings):
    """One line each, what is wrong first."""
    for finding in worst_first(findings):
        print(f"  {finding.severity}: {finding}")


def draw(folder, key, table, raceline, findings):
    """The figure of a checked track; its path."""
    # matplotlib takes a second, and most calls draw nothing
    from ..plots.racelines import plot_raceline
    from ..plots.style import save

    name = "_".join(filter(None, (table.name or "track", re.sub(r"\W+", "_", key).strip("_"))))
    path = make_folder(folder) / f"{name}_check.png"
    save(plot_raceline(table, raceline, findings, name), path)
    return path
