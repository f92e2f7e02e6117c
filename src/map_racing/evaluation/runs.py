"""From a recording to the laps of its runs."""

from __future__ import annotations

from dataclasses import replace

from ..bags.samples import Recording
from ..errors import EvaluationError
from ..track.findings import WARNING
from ..track.raceline import Raceline
from .doubts import raceline_warnings
from .laps import evaluate
from .recordings import recorded_runs
from .results import RunResult

__all__ = ["evaluate_runs"]


def evaluate_runs(
    recording: Recording,
    track: Raceline | None = None,
    origin: str = "",
    reverse: bool = False,
    **options,
) -> list[tuple[Recording, RunResult]]:
    """Evaluate a recording on a track or, without one, on its own racelines.

    Parameters
    ----------
    recording : Recording
    track : Raceline, optional
    origin : str, optional
        Where the track came from, for the notes.
    reverse : bool, optional
        Whether it was driven in reverse direction.
    **options
        Of `map_racing.evaluation.laps.evaluate`.

    Returns
    -------
    list of (Recording, RunResult)
        A run for each raceline.

    Raises
    ------
    BagError, RacelineError
        If there is no raceline, or it is unusable.
    EvaluationError
        If the car drove on none of them.
    """
    if track is not None:
        parts = [(recording, track)]
    else:
        parts = recorded_runs(recording)
        origin = recording.waypoints.topic
    runs, errors = [], []
    for part, raceline in parts:
        doubts = raceline_warnings(raceline, origin)
        said = [str(finding) for finding in raceline.findings if finding.severity != WARNING]
        notes = [*part.notes, "; ".join([f"raceline: {origin}", *said])]
        notes += [f"warning: {doubt}" for doubt in doubts]
        if reverse:
            raceline = raceline.reversed()
            notes = [*notes, "raceline reversed"]
        try:
            runs.append((part, evaluate(replace(part, notes=notes), raceline, **options)))
        except EvaluationError as error:
            errors.append(error)
    if not runs:
        raise errors[0]
    said = [f"warning: {error}" for error in errors]
    return [(part, replace(result, notes=(*result.notes, *said))) for part, result in runs]
