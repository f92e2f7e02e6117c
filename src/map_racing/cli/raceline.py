"""``map-racing raceline``: check and convert racelines."""

from __future__ import annotations

import json

from ..errors import MapRacingError, ParameterError
from ..files import write_json
from ..printing import printable
from ..track.files.checks import examine, raceline_of
from ..track.files.formats import choose_format
from ..track.files.load import read_raceline, save_raceline
from ..track.files.readers import split_source
from ..track.files.repair import driven_columns, repaired, resampled, reversed_table
from ..track.files.report import facts_text, findings_count, findings_rows, raceline_facts
from ..track.findings import ERROR, NOTE, Finding, worst_first
from .figures import draw_check
from .outputs import check_outputs

# Quantities that some formats cannot store, with the attribute of the raceline.
WITHOUT = {
    "tum": ("walls", "d_left"),
    "racetracks": ("walls", "d_left"),
    "centerline": ("speeds", "speed"),
}


def run_check(arguments):
    """Report on a raceline."""
    alone = arguments.json == "-"
    check_outputs([None if alone else arguments.json], [arguments.source])
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
        print(printable(arguments.source))
        for line in ([table.layout] if table else []) + (facts_text(facts) if facts else []):
            print(f"  {line}")
        print_findings(findings)
        print(f"  {findings_count(findings)}")
        if arguments.json:
            write_json(arguments.json, report, indent=2)
            print(f"  report written to {arguments.json}")
    if arguments.plots is not None and table is not None:
        _, key = split_source(arguments.source)
        path = draw_check(arguments.plots, key, table, raceline, findings)
        if not alone:
            print(f"  figure: {path}")
    return int(wrong)


def run_convert(arguments):
    """Read, repair, write."""
    form = choose_format(arguments.output, arguments.format)
    check_outputs([arguments.output], [arguments.source])
    if arguments.spacing is not None and not 0.001 <= arguments.spacing <= 100.0:
        raise ParameterError(f"--spacing: expected 0.001 to 100 m, got {arguments.spacing:g}")
    table = read_raceline(arguments.source)
    print(f"{printable(arguments.source)}\n  {table.layout}")
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
                print(f"  not repaired: {finding}")
    if form in WITHOUT:
        lost, column = WITHOUT[form]
        if getattr(raceline, column) is not None:
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
    """One line each, errors first."""
    for finding in worst_first(findings):
        print(f"  {finding.severity}: {finding}")
