"""``map-racing raceline record``: a closed raceline from a driven lap."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import EvaluationError, ParameterError, RacelineError
from ..evaluation.doubts import doubts_of
from ..evaluation.driven_line import driven_laps, line_of_lap
from ..evaluation.recordings import load_recording, recorded_raceline
from ..printing import printable
from ..track.centerline import walls_from_map
from ..track.files.checks import raceline_of
from ..track.files.load import load_raceline, save_raceline
from ..track.files.report import facts_text, findings_count, raceline_facts
from ..track.findings import Finding, raceline_warnings
from ..track.map_image import read_map_image
from ..vehicle.size import size_of
from .inputs import joined, read_vehicle
from .outputs import check_outputs
from .raceline import print_findings
from .raceline_optimize import form_of


def run_record(arguments):
    """Read, choose a lap, write its line and check it."""
    form = form_of(arguments.output, arguments.format)
    inputs = [*arguments.recordings, arguments.raceline, arguments.map, arguments.vehicle]
    check_outputs([arguments.output], inputs)
    sources = joined(arguments.recordings, arguments.join)
    if len(sources) > 1:
        raise ParameterError("expected one recording, or --join for the parts of one")
    vehicle = read_vehicle(arguments.vehicle)
    size = size_of(vehicle)
    recording = load_recording(sources[0], arguments.pose_topic, arguments.columns)
    print(printable(recording.source))
    for note in recording.notes:
        print(f"  {note}")
    raceline = None
    if arguments.raceline:
        raceline = load_raceline(arguments.raceline)
        for doubt in raceline_warnings(raceline, arguments.raceline):
            print(f"  warning: {doubt}")
    elif recording.waypoints is not None:
        raceline = recorded_raceline(recording)
    laps = driven_laps(recording, raceline, size)
    lap = chosen(laps, arguments.lap, recording.source)
    for one in laps:
        time = f"{one.end - one.begin:8.3f} s"
        mark = " <- taken" if one is lap else ""
        print(f"  lap {one.number:2d} {time}  {one.reason}{mark}".rstrip())
    table = line_of_lap(recording, lap, arguments.spacing, arguments.smoothing, size)
    columns = dict(table.columns)
    doubts = doubts_of(replace(recording, commands=None), [(lap.begin, lap.end)])
    if arguments.speeds == "none":
        del columns["speed"]
    table = table._replace(columns=columns)
    close = []
    if arguments.map:
        close = add_walls(table, read_map_image(arguments.map), vehicle)
    line = raceline_of(table)
    for text in facts_text(raceline_facts(line)):
        print(f"  {text}")
    doubtful = [Finding("doubtful", "warning", doubt) for doubt in doubts]
    findings = [*doubtful, *close, *line.findings]
    print_findings(findings)
    print(f"  {findings_count(findings)}")
    save_raceline(line, arguments.output, form, table)
    print(f"{arguments.output}: format {form}, {columns['x'].size} points, {line.length:.3f} m")


def add_walls(table, image, vehicle):
    """Add the walls of a map to a line; return a finding if the car would touch one."""
    line = raceline_of(table)
    try:
        left, right, findings = walls_from_map(image, line)
    except RacelineError as error:
        raise RacelineError(f"{error} Or choose another lap with --lap") from None
    print_findings(findings)
    for key, width in (("d_left", left), ("d_right", right)):
        table.columns[key] = np.interp(line.s_points, line.s, width, period=line.length)
    nearest = np.minimum(left, right)
    at = int(np.argmin(nearest))
    if nearest[at] >= 0.5 * vehicle.width:
        return []
    text = (
        f"a wall {nearest[at]:.2f} m from the line at s = {line.s[at]:.1f} m, which a car "
        f"{vehicle.width:.2f} m wide touches; choose another lap with --lap"
    )
    return [Finding("near_wall", "warning", text)]


def chosen(laps, wanted, source):
    """The lap of ``--lap``."""
    if wanted == "best":
        counted = [lap for lap in laps if not lap.reason]
        if not counted:
            raise EvaluationError(f"{source}: no lap counts; choose one with --lap")
        return min(counted, key=lambda lap: lap.end - lap.begin)
    for lap in laps:
        if str(lap.number) == wanted:
            return lap
    numbers = ", ".join(str(lap.number) for lap in laps)
    raise ParameterError(f"--lap: expected best or one of {numbers}, got {wanted}")
