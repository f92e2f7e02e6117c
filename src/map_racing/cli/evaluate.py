"""``map-racing evaluate``: laps of recorded driving."""

import os
import re
import sys
from pathlib import Path

from tqdm import tqdm

from ..bags.opening import source_name
from ..errors import MapRacingError, ParameterError
from ..evaluation.lap_limits import LapLimits
from ..evaluation.laps import check_options
from ..evaluation.recordings import load_recording
from ..evaluation.report import lap_data, lap_table, summary_table, write_csv
from ..evaluation.runs import evaluate_runs
from ..files import together, write_json
from ..printing import printable
from ..track.files.load import load_raceline
from .figures import draw_runs
from .inputs import joined
from .outputs import check_outputs


def run(arguments):
    """Evaluate, print, write; recordings that cannot be read are skipped with an error."""
    check_evaluation(arguments)
    check_outputs([arguments.csv, arguments.json], [*arguments.recordings, arguments.raceline])
    track = None if arguments.raceline is None else load_raceline(arguments.raceline)
    names, results, failed = [], [], 0
    sources = joined(arguments.recordings, arguments.join)
    bar = tqdm(sources, desc="evaluate", disable=None, leave=False)
    for source, name in zip(bar, run_names(map(source_name, sources))):
        try:
            runs = [result for _, result in evaluate_one(source, track, arguments)]
        except MapRacingError as error:
            tqdm.write(f"map-racing: {error}", file=sys.stderr)
            failed = 1
            continue
        results += runs
        names += [name] if len(runs) == 1 else [f"{name} ({i})" for i in range(1, len(runs) + 1)]

    for result in results:
        print(printable(result.source))
        for note in result.notes:
            print(f"  {note}")
        print(lap_table(result), end="\n\n")
    if len(results) > 1:
        print(summary_table(zip(names, results)), end="\n\n")
    if not results:
        return failed
    with together():
        if arguments.csv:
            write_csv(arguments.csv, results)
        if arguments.json:
            write_json(arguments.json, lap_data(results))
    if arguments.csv:
        print(f"laps written to {arguments.csv}")
    if arguments.json:
        print(f"laps and summaries written to {arguments.json}")
    if arguments.plots is not None:
        draw_runs(arguments.plots, names, results)
        print(f"figures are in {arguments.plots}")
    return failed


def check_evaluation(arguments):
    """Refuse options of the evaluation that are impossible."""
    if arguments.max_deviation is not None and not arguments.max_deviation > 0.0:
        raise ParameterError(
            f"--max-deviation: expected more than 0, got {arguments.max_deviation}"
        )
    for name in ("max_stop", "max_deceleration"):
        value = getattr(arguments, name, 1.0)
        if not value > 0.0:
            option = "--" + name.replace("_", "-")
            raise ParameterError(f"{option}: expected more than 0, got {value}")
    check_options(
        getattr(arguments, "start_line", 0.0),
        getattr(arguments, "car_width", 0.0),
        getattr(arguments, "sectors", 1),
    )


def evaluate_one(source, track, arguments):
    """Runs of one recording on the track given or, without one, on its own racelines.

    Returns
    -------
    list of (Recording, RunResult)
    """
    recording = load_recording(source, arguments.pose_topic, arguments.columns)
    return evaluate_runs(
        recording,
        track,
        arguments.raceline,
        arguments.reverse,
        start_s=arguments.start_line,
        car_width=arguments.car_width,
        sectors=arguments.sectors,
        limits=LapLimits(
            max_deviation=arguments.max_deviation,
            max_stop=arguments.max_stop,
            max_deceleration=arguments.max_deceleration,
        ),
    )


def run_names(sources):
    """Short names of runs: file stems or, if these repeat, the differing parts of the paths."""
    sources = list(sources)
    suffixes = r"\.(bag(\.active)?|(db3|mcap)(\.zstd)?|csv(\.gz)?)$"
    stems = [re.sub(suffixes, "", Path(source).name) for source in sources]
    names = stems
    if len(set(stems)) < len(stems):
        folders = [os.path.dirname(os.path.abspath(str(source))) for source in sources]
        names = [os.path.relpath(str(source), os.path.commonpath(folders)) for source in sources]
    # Figures need printable text.
    return [printable(os.fsencode(str(name)).decode("utf-8", "replace")) for name in names]
