"""Recorded driving from bags and CSV files, and the racelines in it."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..bags.opening import Source, is_bag
from ..bags.reader import read_recording
from ..bags.samples import Recording
from ..errors import BagError, MapRacingError, ParameterError
from ..files import refuse_special
from ..track.files.checks import raceline_of
from ..track.files.load import table_of_waypoints
from ..track.raceline import Raceline
from .csv_recordings import read_csv_recording

__all__ = [
    "load_recording",
    "recorded_raceline",
    "recorded_runs",
    "same_raceline",
]


def load_recording(
    source: Source, pose_topic: str | None = None, columns: str | dict | None = None
) -> Recording:
    """Read the driving recorded in a bag or a CSV file.

    Parameters
    ----------
    source : str, pathlib.Path or sequence of them
        A bag of ROS 1 or 2, or a CSV file (also ``.gz``); several bags are parts of one run.
    pose_topic : str, optional
        Topic of the pose in a bag, see `map_racing.bags.reader.read_recording`.
    columns : str or dict, optional
        Names of the columns of a CSV file, see
        `map_racing.evaluation.csv_recordings.read_csv_recording`.

    Returns
    -------
    Recording

    Raises
    ------
    BagError, ParameterError
        If the file cannot be read.
    """
    if not isinstance(source, (str, Path)):
        return _load_parts(source, pose_topic, columns)
    refuse_special(source)
    if not _is_csv(source):
        if columns:
            raise ParameterError(f"columns: expected a CSV file, got {source}")
        if Path(source).is_file() and not is_bag(source):
            raise BagError(
                f"{source}: expected a bag of ROS 1 (format 2.0) or ROS 2, or a CSV file, got "
                "another file"
            )
        return read_recording(source, pose_topic)
    if pose_topic is not None:
        raise ParameterError(f"pose topic {pose_topic}: expected a bag, got {source}")
    return read_csv_recording(source, columns)


def _load_parts(sources, pose_topic, columns):
    """The driving recorded in the parts of one run."""
    for source in sources:
        refuse_special(source)
    if len(sources) > 1 and columns or any(map(_is_csv, sources[1:])):
        raise ParameterError("--join: expected bags, got a CSV file")
    return read_recording(sources, pose_topic)


def recorded_raceline(recording: Recording) -> Raceline:
    """Raceline in a recording.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    Raceline

    Raises
    ------
    BagError
        If there is none.
    RacelineError
        If it is unusable.
    """
    if recording.waypoints is None:
        damage = [n for n in recording.notes if n.startswith("warning: damaged bag: ")]
        why = "".join(f" ({note[len('warning: ') :]})" for note in damage)
        raise BagError(
            f"{recording.source}: no raceline in it{why}; give one with --raceline (map-racing "
            "raceline record makes one of a lap)"
        )
    return raceline_of(table_of_waypoints(recording.source, recording.waypoints))


def recorded_runs(recording: Recording) -> list[tuple[Recording, Raceline]]:
    """Runs of a recording: each new raceline begins one, as it does live.

    Parameters
    ----------
    recording : Recording

    Returns
    -------
    list of (Recording, Raceline)
        The driving on each raceline; one, of the whole recording, if the raceline did not change.

    Raises
    ------
    BagError, RacelineError
        As `recorded_raceline`.
    """
    racelines, notes = [(-math.inf, recorded_raceline(recording))], []
    for t, waypoints in recording.later_waypoints:
        try:
            raceline = raceline_of(table_of_waypoints(recording.source, waypoints))
        except MapRacingError as error:
            notes.append(f"warning: the raceline that came at {t:.2f} s is unusable: {error}")
            continue
        if not same_raceline(raceline, racelines[-1][1]):
            racelines.append((t, raceline))
    ends = [t for t, _ in racelines[1:]] + [math.inf]
    parts = [
        (begin, end, raceline)
        for (begin, raceline), end in zip(racelines, ends)
        if np.count_nonzero((recording.t >= begin) & (recording.t < end)) > 1
    ]
    if len(parts) < 2:
        raceline = parts[0][2] if parts else racelines[0][1]
        return [(replace(recording, notes=[*recording.notes, *notes]), raceline)]
    runs = []
    for number, (begin, end, raceline) in enumerate(parts, 1):
        inside = (recording.t >= begin) & (recording.t < end)
        columns = {
            name: getattr(recording, name)[inside]
            for name in ("t", "x", "y", "psi", "v_x", "v_y", "yaw_rate")
        }
        said = f"warning: run {number} of {len(parts)}: another raceline was used"
        said += f" until {begin:.2f} s" if number > 1 else f" from {end:.2f} s on"
        source = f"{recording.source} (run {number})"
        runs.append(
            (
                replace(
                    recording, **columns, source=source, notes=[*recording.notes, *notes, said]
                ),
                raceline,
            )
        )
    return runs


def same_raceline(one: Raceline, other: Raceline) -> bool:
    """Whether two racelines are identical, to the last bit."""
    return all(
        np.array_equal(getattr(one, name), getattr(other, name))
        for name in ("x", "y", "speed", "d_left", "d_right")
    )


def _is_csv(path):
    names = Path(path).name.lower()
    return not is_bag(path) and names.endswith((".csv", ".txt", ".tsv", ".tum", ".gz"))
