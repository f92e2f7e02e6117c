"""``map-racing raceline optimize``: the fastest line between the walls of a track or a map."""

from __future__ import annotations

import math
import time
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ..control.speed_sectors import corners_and_straights, save_speed_sectors
from ..errors import ParameterError
from ..files import together
from ..printing import printable
from ..track.centerline import track_from_map, widest_place
from ..track.files.formats import choose_format
from ..track.files.load import load_raceline, save_raceline
from ..track.findings import NOTE, raceline_warnings
from ..track.map_image import read_map_image
from ..track.optimization import (
    fastest_line,
    minimum_curvature,
    squared_curvature,
    with_fastest_speeds,
)
from ..track.speed_profile import raceline_speeds
from ..track.walls import clearance_of
from ..vehicle.limits import speed_limits
from ..vehicle.lookup import load_table
from ..vehicle.plausibility import doubts_of_table
from ..vehicle.size import size_of
from .figures import draw
from .inputs import read_vehicle
from .outputs import check_outputs

# Findings that make the walls unusable, though the line itself can be driven.
WRONG_WALLS = ("swapped-walls", "no-width", "beyond-wall")
MAPS = (".yaml", ".yml")
# Defaults for a 1:10 car.
MARGIN_M, STEP_M = 0.1, 0.1
# Larger values mean positions in mm or placeholder wall distances, and the search takes all day.
MOST_POINTS, WIDEST_M = 20000, 100.0


def run_optimize(arguments):
    """Optimize, compare, write."""
    outputs = [arguments.output, arguments.middle, arguments.sectors]
    inputs = [arguments.source, *arguments.compare, arguments.vehicle, arguments.lookup_table]
    check_outputs(outputs, inputs)
    forms = [form_of(path, arguments.format) for path in outputs[:2]]
    check_numbers(arguments)
    vehicle = read_vehicle(arguments.vehicle)
    size = size_of(vehicle)
    if arguments.margin is None:
        arguments.margin = MARGIN_M * size.length
    if arguments.step is None:
        arguments.step = STEP_M * size.length
    limits = limits_of(arguments, vehicle)
    track, image = load(arguments, vehicle)
    lines = [(label(track.name, "input", ()), track)]
    clearance = 0.5 * vehicle.width + arguments.margin
    for source in arguments.compare:
        other = load_raceline(source)
        for doubt in raceline_warnings(other, source):
            print(f"  warning: {doubt}")
        lines.append((label(other.name, "compared", [name for name, _ in lines]), other))
    theirs = [clearance_of(other, track) for _, other in lines[1:]]
    clearance = compared_clearance(arguments.compare, theirs, clearance)
    found, optimized = search(arguments, track, clearance, limits)
    lines += [("middle", found.reference), ("optimized", optimized)]
    print(f"  lap times: at the highest speeds of {vehicle.name}, whatever speeds a file has")
    times = print_table(lines, track, limits, arguments.speed_scale)
    tell_slower(lines, times, track, clearance, vehicle)

    try:
        middle = with_fastest_speeds(found.reference, limits, arguments.speed_scale)
    except ParameterError:
        middle = found.reference
    write(arguments, forms, optimized, middle)
    if arguments.plots is not None:
        name = f"{optimized.name or 'track'}_optimized.png"
        drawn = optimized, middle, found.walls, image
        path = draw(arguments.plots, name, "optimization.plot_optimized", *drawn)
        print(f"  figure: {path}")


def limits_of(arguments, vehicle):
    """Limits on the speeds, from the car or a given table."""
    table = load_table(arguments.lookup_table) if arguments.lookup_table else None
    for doubt in [] if table is None else doubts_of_table(table, vehicle):
        print(f"warning: {doubt}")
    return speed_limits(
        vehicle,
        table,
        lateral_scale=arguments.lateral_scale,
        longitudinal_scale=arguments.longitudinal_scale,
        v_max=arguments.v_max,
        power=arguments.power,
    )


def search(arguments, track, clearance, limits):
    """Find the line, and its fastest speeds; return both."""
    began = time.perf_counter()
    with tqdm(desc="optimizing", unit=" lines", disable=None, leave=False) as bar:
        options = {"step": arguments.step, "progress": lambda count: bar.update(count - bar.n)}
        if arguments.curvature_only:
            found = minimum_curvature(track, clearance, **options)
        else:
            found = fastest_line(track, clearance, limits, **options)
    for finding in found.findings:
        print(f"  {finding}")
    optimized = with_fastest_speeds(found.raceline, limits, arguments.speed_scale)
    count = int(round(found.raceline.length / arguments.step))
    print(f"  {count} points optimized in {time.perf_counter() - began:.1f} s")
    return found, optimized


def write(arguments, forms, optimized, middle):
    """Write the lines in their formats, and the sectors."""
    said = []
    with together():
        lines = zip((arguments.output, arguments.middle), forms, (optimized, middle))
        for path, form, line in lines:
            if path:
                save_raceline(line, path, form)
                without = "" if line.speed is not None else ", without speeds"
                said.append(f"{path}: format {form}, {line.n} points{without}")
        if arguments.sectors:
            sectors = corners_and_straights(optimized)
            save_speed_sectors(arguments.sectors, optimized, sectors)
            said.append(f"{arguments.sectors}: {len(sectors)} sectors")
    for text in said:
        print(text)


def label(name, other, taken):
    """Unused name for a row of the table; if it is taken, `other`, with a number if needed."""
    taken, name = ("middle", "optimized", *taken), name[:24]
    others = (other, *(f"{other} {number}" for number in range(2, len(taken))))
    return next(text for text in (name, *others) if text and text not in taken)


def compared_clearance(sources, theirs, ours):
    """Clearance of the search: the smallest possible one among the lines to compare with."""
    for source, clearance in zip(sources, theirs):
        if clearance < 0.01:
            where = f"{-clearance:.2f} m beyond" if clearance < 0.0 else "at"
            print(f"  {source} is {where} a wall")
    possible = [clearance for clearance in theirs if clearance >= 0.01]
    if theirs and not possible:
        print(f"  the optimized line keeps {ours:.3f} m from the walls")
    # A millimeter more, so that rounding does not favor the optimized line.
    return min(possible) + 1e-3 if possible else ours


def tell_slower(lines, times, track, clearance, vehicle):
    """Report given lines that are faster than the optimized one, and why."""
    for name, line in lines[:-2]:
        if not times[name] < times["optimized"]:
            continue
        theirs = clearance_of(line, track)
        text = f"  warning: the optimized line is slower than {name} by "
        text += f"{times['optimized'] - times[name]:.3f} s"
        if theirs < clearance - 1e-3:
            text += f", which comes within {theirs:.3f} m of the walls; this one keeps "
            text += (
                f"{clearance:.3f} m: --margin {theirs - 0.5 * vehicle.width:.3f} allows the same"
            )
        print(text)


def form_of(path, wanted):
    """Format of an output, None without one; plain CSV means map_racing."""
    if path is None:
        return None
    if wanted is None and Path(path).suffix.lower() == ".csv":
        wanted = "map_racing"
    return choose_format(path, wanted)


def check_numbers(arguments):
    """Reject implausible numbers."""
    for key, least, most in (
        ("margin", -0.5, 10.0),
        ("step", 0.01, 100.0),
        ("lateral_scale", 0.01, 2.0),
        ("longitudinal_scale", 0.01, 2.0),
        ("speed_scale", 0.01, 2.0),
        ("v_max", 0.1, 1000.0),
        ("power", 1e-3, 1e7),
        ("passage", 1e-3, 100.0),
        ("speckle", 0.0, 100.0),
    ):
        value = getattr(arguments, key)
        if value is not None and not least <= value <= most:
            option = "--" + key.replace("_", "-")
            raise ParameterError(f"{option}: expected {least:g} to {most:g}, got {value:g}")


def load(arguments, vehicle):
    """Track of a file or a map, with usable walls, and the map or None."""
    source, image = arguments.source, None
    if Path(source).suffix.lower() in MAPS:
        track, image = load_map(arguments, vehicle)
        findings = track.findings
    else:
        for option in ("start", "passage", "speckle"):
            if getattr(arguments, option) is not None:
                raise ParameterError(f"--{option}: expected the YAML file of a map, got {source}")
        track = load_raceline(source)
        findings = [finding for finding in track.findings if finding.severity != NOTE]
        for finding in findings:
            if finding.code in WRONG_WALLS:
                raise ParameterError(
                    f"{source}: {finding} Repair it with map-racing raceline convert --repair"
                )
    print(f"{printable(source)}: {track.length:.2f} m")
    if track.length / arguments.step > MOST_POINTS:
        raise ParameterError(
            f"{source}: expected at most {MOST_POINTS} points {arguments.step:g} m apart, "
            f"got a track of {track.length:.0f} m: is it in mm? Else take a larger --step"
        )
    if track.d_left is not None:
        widest = max(float(track.d_left.max()), float(track.d_right.max()))
        if widest > WIDEST_M:
            raise ParameterError(
                f"{source}: expected walls at most {WIDEST_M:g} m away, got {widest:.0f} m"
            )
    for finding in findings:
        print(f"  {finding}")
    return track, image


def load_map(arguments, vehicle):
    """Centerline of a map from the given start, and the map."""
    passage = arguments.passage
    if passage is None:
        passage = max(vehicle.width + 2.0 * arguments.margin, 0.05)
    image = read_map_image(arguments.source)
    if arguments.start is None:
        place = widest_place(image, arguments.speckle)
        such = f", such as --start {place[0]:.2f},{place[1]:.2f}, the widest place" if place else ""
        raise ParameterError(f"{arguments.source}: expected --start X,Y[,PSI] for a map{such}")
    start, psi = start_of(arguments.start)
    track = track_from_map(image, start, psi, passage=passage, speckle=arguments.speckle)
    return track, image


def start_of(words):
    """Position and direction of ``--start``."""
    try:
        numbers = [float(word) for word in ",".join(words).split(",") if word.strip()]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3):
        raise ParameterError(f"--start: expected X,Y or X,Y,PSI, got {' '.join(words)}")
    return tuple(numbers[:2]), (numbers[2] if len(numbers) == 3 else None)


def print_table(lines, track, limits, scale):
    """Print key figures of each line; return lap times by name, inf for none."""
    print(
        f"  {'':24s} {'length':>9s} {'curvature^2':>12s} {'radius':>8s} {'to a wall':>10s} "
        f"{'lap time':>9s}\n"
        f"  {'':24s} {'[m]':>9s} {'[rad^2/m]':>12s} {'[m]':>8s} {'[m]':>10s} {'[s]':>9s}"
    )
    undrivable, times = [], {}
    for name, line in lines:
        times[name] = math.inf
        try:
            times[name] = raceline_speeds(line, **limits)[1] / scale
            lap = f"{times[name]:.3f}"
        except ParameterError as error:
            lap = "-"
            undrivable.append(f"  {name}: no lap time: {error}")
        print(
            f"  {name:24s} {line.length:9.2f} {squared_curvature(line):12.4f} "
            f"{1.0 / np.abs(line.kappa).max():8.2f} {clearance_of(line, track):10.3f} {lap:>9s}"
        )
    for text in undrivable:
        print(text)
    return times
