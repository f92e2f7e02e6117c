"""``map-racing report``: one page on one or several runs."""

import sys
from dataclasses import replace
from functools import lru_cache

from tqdm import tqdm

from ..bags.opening import is_bag, source_name
from ..bags.remarks import read_remarks
from ..control.settings import parse_settings
from ..errors import MapRacingError, ParameterError
from ..evaluation.analysis import analyze
from ..evaluation.profiles import car_limits
from ..evaluation.results import Summary
from ..files import replacing
from ..identification.data import run_of
from ..identification.delay import delay_data, estimate_delays
from ..pages.html import plotly_script
from ..pages.report import report_page
from ..track.files.load import load_raceline
from ..vehicle.parameters import parameter_hash
from .evaluate import check_evaluation, evaluate_one, run_names
from .inputs import joined, read_vehicle
from .outputs import check_outputs

__all__ = ["analyses", "run"]


def run(arguments):
    """Evaluate, analyze, write the page; recordings that cannot be read are skipped."""
    plotly_script()  # without it nothing can be written
    check_evaluation(arguments)
    inputs = [*arguments.recordings, arguments.raceline, arguments.vehicle]
    check_outputs([arguments.output], inputs)
    runs, failed = analyses(arguments, delays=True)
    if not runs:
        return 1
    with replacing(arguments.output) as file:
        file.write(report_page(runs))
    for found in runs:
        print(f"{found.name}: laps counted: {found.result.summary.laps_completed}")
    print(f"report written to {arguments.output}")
    return failed


def analyses(arguments, delays=False):
    """Analyses of all readable recordings, and whether any could not be read.

    With `delays`, also the delays of their cars.
    """
    chosen = parse_laps(arguments.laps) if arguments.laps else None
    vehicle = read_vehicle(arguments.vehicle) if arguments.vehicle else None
    track = None if arguments.raceline is None else load_raceline(arguments.raceline)
    limits_of = lru_cache(None)(car_limits)
    found, failed = [], 0
    sources = joined(arguments.recordings, arguments.join)
    bar = tqdm(sources, desc="report", disable=None, leave=False)
    for source, name in zip(bar, run_names(map(source_name, sources))):
        try:
            runs = evaluate_one(source, track, arguments)
            bag = not isinstance(source, str) or is_bag(source)
            remarks = read_remarks(source, runs[0][0]) if bag else None
        except MapRacingError as error:
            tqdm.write(f"map-racing: {error}", file=sys.stderr)
            failed = 1
            continue
        settings = None
        if remarks is not None and remarks.settings:
            settings = parse_settings(remarks.settings[-1][1])
        car, parameters = vehicle, settings and settings.controller
        if car is None and settings is not None:
            car = settings.vehicle
        for number, (recording, result) in enumerate(runs, 1):
            if chosen is not None:
                result = _with_laps(result, chosen)
            found.append(
                analyze(
                    recording,
                    result,
                    name=name if len(runs) == 1 else f"{name} ({number})",
                    limits=None if car is None else limits_of(car, parameters),
                    settings=settings,
                    remarks=remarks,
                    delays=delays_of(recording, car) if delays and car is not None else None,
                )
            )
            found[-1].notes.extend(_vehicle_warning(vehicle, settings))
    return found, failed


def _vehicle_warning(given, settings):
    """Warning if the controller drove with a vehicle other than the given one."""
    driven = settings and settings.vehicle
    if given is None or not driven or parameter_hash(given) == parameter_hash(driven):
        return []
    other = " with other values" if given.name == driven.name else ""
    return [
        f"warning: --vehicle is {given.name}, but the controller drove with {driven.name}{other}"
    ]


def delays_of(recording, vehicle):
    """Delays of a known car as plain data; None without commands."""
    if recording.commands is None:
        return None
    return delay_data(estimate_delays([run_of(recording)], vehicle))


def _with_laps(result, chosen):
    """A result with only the chosen laps."""
    laps = [lap for lap in result.laps if any(a <= lap.lap <= b for a, b in chosen)]
    if not laps:
        numbers = ", ".join(str(lap.lap) for lap in result.laps[:20])
        raise ParameterError(f"--laps: {result.source} has none of them; it has laps {numbers}")
    return replace(result, laps=laps, summary=Summary.of(laps))


def parse_laps(text):
    """Ranges of lap numbers from text such as ``2-5,8``.

    Raises
    ------
    ParameterError
        If the text is something else.
    """
    ranges = []
    for part in text.split(","):
        begin, dash, end = part.partition("-")
        numbers = [begin, end] if dash else [begin, begin]
        if not all(number.strip().isdecimal() for number in numbers):
            raise ParameterError(f"--laps: expected lap numbers such as 2-5,8, got {text!r}")
        ranges.append(tuple(int(number) for number in numbers))
    return ranges
