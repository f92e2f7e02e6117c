"""``map-racing evaluate``: laps of recorded driving."""

import math
import os
import re
import sys
from dataclasses import replace
from pathlib import Path

from tqdm import tqdm

from ..errors import EvaluationError, MapRacingError, ParameterError
from ..evaluation.laps import LapLimits, evaluate
from ..evaluation.recordings import load_recording, recorded_raceline
from ..evaluation.report import lap_table, summary_table, write_csv, write_json
from ..files import make_folder
from ..track.files.load import load_raceline
from ..track.files.readers import split_source
from .outputs import check_outputs


def add_parser(commands):
    """Add the command to the parser."""
    parser = commands.add_parser(
        "evaluate",
        help="lap times and lateral errors from bags or CSV files",
        description="Lap times and lateral errors of recorded driving. Pose and raceline are found "
        "in the bag; a CSV file needs --raceline.",
    )
    parser.add_argument("recordings", nargs="+", metavar="BAG", help="ROS 1 bag or CSV file")
    parser.add_argument(
        "--raceline",
        metavar="FILE",
        help="shipped track, raceline file (CSV, race_stack JSON, also .gz) or bag[#topic]; by "
        "default that of the bag",
    )
    parser.add_argument(
        "--reverse", action="store_true", help="the raceline was driven the other way round"
    )
    parser.add_argument(
        "--pose-topic", metavar="TOPIC", help="topic of the pose instead of the one chosen"
    )
    parser.add_argument(
        "--columns",
        metavar="MAP",
        help="columns of CSV files where they are not found, as t=time,x=pose_x,y=pose_y; also "
        "psi v_x v_y yaw_rate steering speed_command",
    )
    parser.add_argument(
        "--start-line",
        type=float,
        default=0.0,
        metavar="S",
        help="arc length of the start line on the raceline [m] (default: its first point)",
    )
    parser.add_argument(
        "--car-width",
        type=float,
        default=0.3,
        metavar="M",
        help="for the clearance between the car's side and the wall [m] (default: %(default)s)",
    )
    parser.add_argument(
        "--sectors",
        type=int,
        default=3,
        metavar="N",
        help="number of sectors to time, in CSV and JSON (default: %(default)s)",
    )
    parser.add_argument(
        "--max-deviation",
        type=float,
        metavar="M",
        help="off track is the car's center beyond this lateral error [m] (default: the walls or, "
        "where none are known, 2 m)",
    )
    parser.add_argument("--csv", metavar="FILE", help="write the laps of all runs")
    parser.add_argument("--json", metavar="FILE", help="write the laps and summaries of all runs")
    parser.add_argument("--plots", metavar="DIR", help="write figures")
    parser.set_defaults(run=run)


def run(arguments):
    """Evaluate, print, write; a recording that cannot be read does not hold up the others."""
    if arguments.max_deviation is not None and not arguments.max_deviation > 0.0:
        raise ParameterError(f"--max-deviation must be positive, not {arguments.max_deviation}")
    given = split_source(arguments.raceline or "")[0]
    check_outputs([arguments.csv, arguments.json], [*arguments.recordings, given])
    track = None if arguments.raceline is None else load_raceline(arguments.raceline)
    names, results, failed = [], [], 0
    bar = tqdm(arguments.recordings, desc="evaluate", disable=None, leave=False)
    for source, name in zip(bar, run_names(arguments.recordings)):
        try:
            results.append(evaluate_one(source, track, arguments))
        except MapRacingError as error:
            tqdm.write(f"map-racing: {error}", file=sys.stderr)
            failed = 1
            continue
        names.append(name)

    for result in results:
        print(f"{result.source}")
        for note in result.notes:
            print(f"  {note}")
        print(lap_table(result), end="\n\n")
    if len(results) > 1:
        print(summary_table(zip(names, results)), end="\n\n")
    if not results:
        return failed
    if arguments.csv:
        write_csv(arguments.csv, results)
        print(f"laps written to {arguments.csv}")
    if arguments.json:
        write_json(arguments.json, results)
        print(f"laps and summaries written to {arguments.json}")
    if arguments.plots:
        draw(arguments.plots, names, results)
        print(f"figures are in {arguments.plots}")
    return failed


def evaluate_one(source, track, arguments):
    """Laps of one recording on the track given or, without one, on its own."""
    recording = load_recording(source, arguments.pose_topic, arguments.columns)
    notes = recording.notes
    raceline, origin = track, arguments.raceline
    if track is None:
        raceline, origin = recorded_raceline(recording), recording.waypoints.topic
    notes = [*notes, "; ".join([f"raceline: {origin}", *map(str, raceline.findings)])]
    if arguments.reverse:
        raceline = raceline.reversed()
        notes = [*notes, "raceline reversed"]
    return evaluate(
        replace(recording, notes=list(notes)),
        raceline,
        start_s=arguments.start_line,
        car_width=arguments.car_width,
        sectors=arguments.sectors,
        limits=LapLimits(max_deviation=arguments.max_deviation),
    )


def run_names(sources):
    """Short names of runs: the files' stems or, where these repeat, their paths as they differ."""
    stems = [re.sub(r"\.(bag(\.active)?|csv(\.gz)?)$", "", Path(source).name) for source in sources]
    names = stems
    if len(set(stems)) < len(stems):
        folders = [os.path.dirname(os.path.abspath(str(source))) for source in sources]
        names = [os.path.relpath(str(source), os.path.commonpath(folders)) for source in sources]
    # Figures can only show text.
    return [os.fsencode(str(name)).decode("utf-8", "replace") for name in names]


def draw(folder, names, results):
    """All figures of all runs."""
    # matplotlib takes a second, and most calls draw nothing
    from ..plots import runs
    from ..plots.style import save

    folder = make_folder(folder)
    figures = []
    for name, result in zip(names, results):
        stem, name = name.replace("/", "_"), _title(name)
        if any(math.isfinite(lap.lap_time_s) for lap in result.laps):
            figures.append((f"{stem}_laps.png", runs.plot_laps, (result, name)))
        figures.append((f"{stem}_speed.png", runs.plot_path, (result, "speed", name)))
        figures.append((f"{stem}_error.png", runs.plot_path, (result, "error", name)))
    named = list(zip(map(_title, names), results))
    figures.append(("boxes.png", runs.plot_boxes, (named,)))
    for file_name, plot, values in tqdm(figures, desc="figures", disable=None, leave=False):
        save(plot(*values), folder / file_name)
    if len([result for result in results if result.summary.laps_completed]) > 1:
        try:
            save(runs.plot_differences(named), folder / "difference.png")
        except EvaluationError as error:  # on different tracks there is nothing to compare
            print(f"no difference.png: {error}")


def _title(name):
    """The name as text for figures, which take what is between two dollars for a formula."""
    short = name if len(name) <= 40 else f"{name[:18]}...{name[-19:]}"
    return short.replace("$", r"\$")
