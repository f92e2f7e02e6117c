"""A season of bags: each evaluated once, in any number of processes, and stored on disk.

The stored rows of a bag are valid as long as sizes and modification times of its files and of the
given tracks, the options, and the evaluating code stay the same.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections import Counter
from concurrent.futures import Executor
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, Sequence

import numpy as np
from scipy.spatial import cKDTree
from tqdm import tqdm

from ..bags.opening import Source, source_name
from ..bags.remarks import read_remarks
from ..bags.ros2 import METADATA, SUFFIXES
from ..bags.samples import SIMULATED, date_of
from ..control.settings import parse_settings
from ..errors import EvaluationError, MapRacingError
from ..evaluation.lap_limits import LapLimits
from ..evaluation.recordings import load_recording
from ..evaluation.runs import evaluate_runs
from ..files import make_folder, read_json, write_json
from ..resources import fingerprint_of_code, list_config
from ..track.files.load import load_raceline
from ..track.files.readers import split_source
from ..track.raceline import Raceline
from .executors import carried_out
from .season_bags import first_part, parts_of

__all__ = ["COLUMNS", "BagOptions", "Season", "evaluate_season"]

COLUMNS = (
    "date",
    "bag",
    "run",
    "track",
    "track_length_m",
    "vehicle",
    "controller",
    "speed_scale",
    "settings",
    "laps",
    "laps_not_counted",
    "best_lap_time_s",
    "mean_lap_time_s",
    "std_lap_time_s",
    "rms_lateral_error_m",
    "max_lateral_error_m",
    "min_clearance_m",
    "max_speed_mps",
    "stops",
    "warnings",
    "reason",
    "report",
)
"""Columns of the table of heats."""

# Packages and modules that affect the stored rows of a bag.
_DECISIVE = (
    *("", "bags", "vehicle", "track", "track/files", "control", "evaluation"),
    "experiments/season.py",
)
# Two lines belong to the same track, as different racelines between the same walls, if their
# lengths differ by at most this share, and their distance is at most the second number on average
# and the third anywhere [m].
_SAME_LENGTH, _SAME_MEAN, _SAME_PLACE = 0.1, 0.5, 2.0
_PLACES = 150
# Bags per job, if there are many; an interruption loses that many.
_MOST_AT_ONCE = 8
_SUMMARY = {
    "laps": "laps_completed",
    "laps_not_counted": "laps_not_counted",
    "best_lap_time_s": "best_lap_time_s",
    "mean_lap_time_s": "mean_lap_time_s",
    "std_lap_time_s": "std_lap_time_s",
    "rms_lateral_error_m": "mean_rms_lateral_error_m",
    "max_lateral_error_m": "max_abs_lateral_error_m",
    "min_clearance_m": "min_clearance_m",
    "max_speed_mps": "max_speed_mps",
}


class BagOptions(NamedTuple):
    """How bags are evaluated.

    Attributes
    ----------
    tracks : tuple of str
        Racelines for bags without one, see `map_racing.track.files.load`.
    car_width : float
        See `map_racing.evaluation.laps.LapEvaluator`.
    max_deviation : float or None
        See `map_racing.evaluation.lap_limits.LapLimits`.
    """

    tracks: tuple = ()
    car_width: float = 0.3
    max_deviation: float | None = None


class Season(NamedTuple):
    """Heats by date, as rows with `COLUMNS`; numbers of bags read and of known ones."""

    heats: list
    read: int
    kept: int


def evaluate_season(
    bags: Sequence[Source],
    output: str | Path,
    options: BagOptions,
    executor: Executor,
    capacity: int,
) -> Season:
    """Evaluate bags that are not yet known, and combine all heats.

    Parameters
    ----------
    bags : sequence of pathlib.Path or tuple of pathlib.Path
        As from `map_racing.experiments.season_bags.find_bags`.
    output : str or pathlib.Path
        Folder where each result is stored at once, so that an interrupted season continues.
    options : BagOptions
    executor : concurrent.futures.Executor
        See `map_racing.experiments.executors.open_executor`.
    capacity : int
        Largest number of submitted jobs.

    Returns
    -------
    Season
        With a row for each run of each bag; one that cannot be read has a ``reason``. Beside
        `COLUMNS` a row has ``given``, the track of `options` on which it was evaluated; empty for
        the raceline in the bag.

    Raises
    ------
    MapRacingError
        If a process died, a worker of a cluster has another version, or nothing can be written.
    """
    folder = make_folder(Path(output) / "heats")
    heats, waiting = {}, []
    asked = [*options, [_stamp_of_track(source) for source in options.tracks]]
    for path in bags:
        rows = _kept(folder, path, asked)
        if rows is None:
            waiting.append(path)
        else:
            heats[path] = rows
    kept, waiting = len(heats), waiting[::-1]
    bar = tqdm(total=len(bags), initial=kept, desc="season", unit="bag", disable=None, leave=False)

    def draw():
        if not waiting:
            return None
        size = max(1, min(_MOST_AT_ONCE, len(waiting) // (4 * capacity)))
        batch = [waiting.pop() for _ in range(size) if waiting]
        known = [(path, _stamp(path)) for path in batch]
        return known, _evaluate_bags, [_absolute(path) for path in batch], options

    with bar:
        for batch, (code, results) in carried_out(executor, capacity, draw):
            if code != fingerprint_of_code(_DECISIVE):
                raise MapRacingError("a worker of the cluster has another version of map_racing")
            for (path, stamp), (rows, lasting) in zip(batch, results):
                if lasting:
                    _keep(folder, path, stamp, asked, rows)
                heats[path] = rows
                bar.update()
    rows = []
    for path in bags:
        for row in heats[path]:
            reason = _without_name(row["reason"], path)
            row = dict(row, bag=source_name(path), reason=reason)
            # Simulated races have no date: order them by the time of writing.
            written = _written(path) if row["date"] == SIMULATED else 0
            rows.append((row["date"], written, row["bag"], row["run"], row))
    rows = [row for *_, row in sorted(rows, key=lambda entry: entry[:-1])]
    _name_tracks(rows, options.tracks)
    return Season(rows, len(bags) - kept, kept)


def _absolute(source):
    """File names as absolute paths, valid in any process."""
    if isinstance(source, tuple):
        return tuple(os.path.abspath(str(part)) for part in source)
    return os.path.abspath(str(source))


def _without_name(reason, path):
    """A reason without the name or folder of its bag, which is in the row anyway."""
    name = f"{source_name(_absolute(path))}: "
    if reason.startswith(name):
        return reason[len(name) :]
    return reason.replace(os.path.dirname(_absolute(first_part(path))) + os.sep, "")


# -- one bag -------------------------------------------------------------------------------------


def _evaluate_bags(paths, options):
    """Fingerprint of the code, and each bag's rows and whether to store them; for any process."""
    return fingerprint_of_code(_DECISIVE), [_evaluate_bag(path, options) for path in paths]


def _evaluate_bag(path, options):
    try:
        return _rows(path, options), True
    except MapRacingError as error:
        return [_row(path, reason=str(error))], True
    except Exception as error:  # one bag must not end a season; it is tried again next time
        return [_row(path, reason=f"{type(error).__name__}: {error}")], False


def _rows(path, options):
    recording = load_recording(path)
    date = recording.date
    try:
        given, runs = _runs(recording, options)
    except MapRacingError as error:
        return [_row(path, date=date, reason=str(error))]
    remarks = read_remarks(path, recording)
    driven_with = _settings(remarks.settings[-1][1]) if remarks.settings else {}
    rows = []
    for number, (part, result) in enumerate(runs, 1):
        begin, end = float(part.t[0]), float(part.t[-1])
        stops = sum(begin <= t <= end for t in remarks.stops)
        if not remarks.states:
            reasons = [lap.reason for lap in result.laps]
            stops = sum("stood" in reason or "stopped" in reason for reason in reasons)
        summary = {name: getattr(result.summary, key) for name, key in _SUMMARY.items()}
        rows.append(
            _row(
                path,
                date=date if date == SIMULATED else date_of(recording.t0_ns + int(begin * 1e9)),
                run=number,
                track_length_m=round(result.raceline.length, 3),
                stops=stops,
                warnings="; ".join(result.warnings),
                line=_places(result.raceline),
                given=given,
                **driven_with,
                **summary,
            )
        )
    return rows


def _runs(recording, options):
    """The track used (empty for racelines in the recording), and the runs."""
    more = {
        "car_width": options.car_width,
        "limits": LapLimits(max_deviation=options.max_deviation),
    }
    if recording.waypoints is not None:
        return "", evaluate_runs(recording, **more)
    if not options.tracks:
        raise EvaluationError(
            f"{recording.source}: no raceline in it; give its track with --tracks"
        )
    for source in options.tracks:
        try:
            return source, evaluate_runs(recording, _track(source), source, **more)
        except EvaluationError:
            continue
    raise EvaluationError(
        f"{recording.source}: no raceline in it, and it was driven on none of the given tracks"
    )


def _track(source):
    # A worker of a cluster may outlive the present version of a file.
    return _loaded(source, json.dumps(_stamp_of_track(source)))


@lru_cache(maxsize=16)
def _loaded(source, _):
    return load_raceline(source)


@lru_cache(maxsize=64)
def _settings(text):
    """Columns of the settings; heats with the same settings have the same text."""
    values = parse_settings(text).values
    controller, vehicle = (
        values[key] if isinstance(values.get(key), dict) else {}
        for key in ("controller", "vehicle")
    )
    scale = controller.get("speed_scale")
    return {
        "controller": str(controller.get("name", "")),
        "vehicle": str(vehicle.get("name", "")),
        "speed_scale": scale if isinstance(scale, (int, float)) else math.nan,
        "settings": hashlib.sha256(text.encode()).hexdigest()[:8],
    }


def _row(path, **values):
    texts = ("date", "track", "vehicle", "controller", "settings", "warnings", "reason", "report")
    row = {name: "" if name in texts else math.nan for name in COLUMNS}
    row.update(bag=path, run=1, laps=0, line=None, given="")
    row.update(values)
    return row


def _places(raceline: Raceline):
    """Positions along a raceline [m], to recognize its track."""
    at = raceline.sample(np.arange(_PLACES) * (raceline.length / _PLACES))
    return [at.x.round(2).tolist(), at.y.round(2).tolist()]


# -- what is kept --------------------------------------------------------------------------------


def _stamp(path):
    """Names, sizes and modification times of the files of a bag; empty if it was removed."""
    files, stamps = parts_of(path), []
    try:
        if not isinstance(path, tuple) and path.is_dir():
            files = sorted(file for file in path.iterdir() if file.is_file() and _of_bag(file))
        for file in files:
            status = os.stat(str(file))
            stamps.append([file.name, status.st_size, status.st_mtime_ns])
    except FileNotFoundError:
        return []
    return stamps


def _stamp_of_track(source):
    return _stamp(Path(split_source(source)[0]))


def _written(path):
    """Modification time of the newest file of a bag [ns]."""
    return max((changed for *_, changed in _stamp(path)), default=0)


def _of_bag(file):
    return file.name == METADATA or file.name.endswith(SUFFIXES)


def _record(folder, path):
    name = hashlib.sha256(os.fsencode(os.path.realpath(str(first_part(path))))).hexdigest()[:24]
    return folder / f"{name}.json"


def _state(stamp, asked):
    """State that must be unchanged for stored rows to be valid."""
    return json.loads(json.dumps([fingerprint_of_code(_DECISIVE), COLUMNS, stamp, asked]))


def _kept(folder, path, asked):
    """Stored rows of a bag that has not changed; otherwise None."""
    try:
        record = read_json(_record(folder, path))
        if record["state"] != _state(_stamp(path), asked):
            return None
        return [
            {
                key: math.nan if value is None and key != "line" else value
                for key, value in row.items()
            }
            for row in record["rows"]
        ]
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None


def _keep(folder, path, stamp, asked, rows):
    content = {"bag": source_name(path), "state": _state(stamp, asked), "rows": rows}
    write_json(_record(folder, path), content, indent=None)


# -- tracks --------------------------------------------------------------------------------------


def _name_tracks(rows, tracks):
    """Name the track of each row: shipped, given, or numbered by date."""
    known = []
    for source, name in _names([*dict.fromkeys(tracks), *list_config("tracks")]).items():
        line = _track(source)
        known.append((name, line.length, _Shape(_places(line))))
    unknown, found = 0, {}
    for row in rows:
        line = row.pop("line")
        if line is None:
            continue
        key = json.dumps(line)
        if key not in found:
            shape, length = _Shape(line), row["track_length_m"]
            found[key] = next((n for n, other, s in known if shape.fits(length, s, other)), None)
            if found[key] is None:
                unknown += 1
                found[key] = f"track {unknown}"
                known.append((found[key], length, shape))
        row["track"] = found[key]


def _names(sources):
    """Names of tracks by source; equal names are distinguished by folders."""
    short = {source: _track(source).name for source in sources}
    folders = {source: Path(split_source(source)[0]).parent.parts for source in sources}
    names = dict(short)
    for depth in range(1, max(map(len, folders.values())) + 1):
        count = Counter(names.values())
        for source in [source for source, name in names.items() if count[name] > 1]:
            names[source] = "/".join([*folders[source][-depth:], short[source]])
    count = Counter(names.values())  # such as two topics of one bag
    return {source: name if count[name] == 1 else source for source, name in names.items()}


class _Shape:
    """Places along a track."""

    def __init__(self, places):
        self._xy = np.transpose(places)
        self._tree = cKDTree(self._xy)

    def fits(self, length, other, other_length):
        """Whether two lines belong to the same track, in the same frame."""
        if abs(length - other_length) > _SAME_LENGTH * other_length:
            return False
        # The nearest place of the other line may be half a spacing off along the line.
        step = 0.5 * max(length, other_length) / _PLACES
        for one, two in ((self, other), (other, self)):
            apart = two._tree.query(one._xy)[0]
            if np.mean(apart) > _SAME_MEAN + step or np.max(apart) > _SAME_PLACE + step:
                return False
        return True
