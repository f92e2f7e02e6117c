"""``map-racing season``: all bags below folders, as a table of heats and a page of trends."""

from __future__ import annotations

import os
import re
import sys
from pathlib import Path

from ..bags.opening import source_name
from ..errors import MapRacingError, ParameterError
from ..evaluation.report import write_rows
from ..experiments.executors import open_executor
from ..experiments.season import COLUMNS, BagOptions, evaluate_season
from ..experiments.season_bags import find_bags, first_part, parts_of
from ..files import make_folder, replacing, together
from ..pages.html import plotly_script
from ..pages.season import season_page
from ..printing import amount, printable
from ..track.files.load import load_raceline
from ..track.files.readers import split_source
from .evaluate import check_evaluation


def run(arguments):
    """Find bags, evaluate new ones, write table and page."""
    check_evaluation(arguments)
    if arguments.reports < 0:
        raise ParameterError(f"--reports: expected 0 or more, got {arguments.reports}")
    if arguments.reports:
        plotly_script()  # without it no report can be written
    output = Path(arguments.output)
    bags = find_bags(arguments.folders, without=output)
    if not bags:
        raise MapRacingError(f"{', '.join(arguments.folders)}: no bags below")
    for source in arguments.tracks:
        load_raceline(source)  # fail early if one cannot be read
    tracks = tuple(_absolute_source(source) for source in arguments.tracks)
    options = BagOptions(tracks, arguments.car_width, arguments.max_deviation)
    with open_executor(arguments.jobs, arguments.scheduler) as (executor, capacity):
        make_folder(arguments.output)
        season = evaluate_season(bags, output, options, executor, capacity)
    heats = season.heats
    reports = report_paths(bags, output)
    parts = {source_name(bag): parts_of(bag) for bag in bags}
    if arguments.reports:
        make_reports(heats, parts, reports, arguments)
    for heat in heats:
        first = parts[heat["bag"]][0]
        heat["report"] = link(first, reports[heat["bag"]], output)
    page = season_page(heats)
    with together():
        write_rows(output / "season.csv", COLUMNS, heats)
        with replacing(output / "season.html") as file:
            file.write(page)
    unread = [heat for heat in heats if heat["reason"]]
    for heat in unread[:20]:
        print(f"not evaluated: {printable(heat['bag'])}: {printable(heat['reason'])}")
    if len(unread) > 20:
        print(f"... and {len(unread) - 20} more, see the table")
    print(
        f"{len(bags)} bags: {season.read} read, {season.kept} known; "
        f"{amount(len(heats) - len(unread), 'heat')}, "
        f"{sum(int(heat['laps']) for heat in heats)} laps count"
    )
    print(f"written to {output / 'season.csv'} and {output / 'season.html'}")


def _absolute_source(source):
    """A source with absolute paths, for processes with another working folder."""
    path, key = split_source(source)
    if not Path(path).exists():
        return source
    return os.path.abspath(path) + (f"#{key}" if key else "")


def report_paths(bags, output):
    """Path of the report for each bag, below ``reports`` in the bag's folder structure."""
    folders = [os.path.dirname(os.path.abspath(str(first_part(bag)))) for bag in bags]
    base = os.path.commonpath(folders)
    paths = {}
    for bag in bags:
        name = os.path.relpath(os.path.abspath(str(first_part(bag))), base)
        name = re.sub(r"\.(bag(\.active)?|(db3|mcap)(\.zstd)?)$", "", name)
        paths[source_name(bag)] = output / "reports" / f"{name}.html"
    return paths


def link(bag, report, output):
    """Path from the page to a bag's report, which may be beside the bag; empty without one."""
    for path in (report, bag.with_suffix(".html")):
        if path.is_file():
            return os.path.relpath(str(path), str(output)).replace(os.sep, "/")
    return ""


def make_reports(heats, parts, reports, arguments):
    """Write missing or outdated reports of the latest readable heats."""
    from . import build_parser, report

    latest = {heat["bag"]: heat["given"] for heat in heats[::-1] if not heat["reason"]}
    for bag, given in list(latest.items())[: arguments.reports]:
        path, files = reports[bag], list(map(str, parts[bag]))
        read = [Path(name) for name in [*files, *([split_source(given)[0]] if given else [])]]
        changed = max((name.stat().st_mtime for name in read if name.exists()), default=0.0)
        if path.is_file() and path.stat().st_mtime >= changed:
            continue
        make_folder(path.parent)
        words = ["report", *files, "--output", str(path), "--car-width", str(arguments.car_width)]
        words += ["--join"] if len(files) > 1 else []
        words += ["--raceline", given] if given else []
        if arguments.max_deviation is not None:
            words += ["--max-deviation", str(arguments.max_deviation)]
        try:
            report.run(build_parser().parse_args(words))
        except MapRacingError as error:  # the other reports and the table do not depend on it
            print(f"map-racing: no report of {printable(bag)}: {error}", file=sys.stderr)
