"""From a recording to its laps, on a track or on its own racelines."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from ..bags.samples import Recording
from ..errors import EvaluationError
from ..track.findings import WARNING, raceline_warnings
from ..track.raceline import Raceline
from .doubts import alternation, doubts_of, uncommanded, unfollowed
from .lap_limits import NO_WALLS, LapLimits
from .laps import LapEvaluator
from .recordings import recorded_runs
from .results import RunResult

__all__ = ["evaluate", "evaluate_runs"]

# A median this far beyond the walls [m] means another track.
_ELSEWHERE = 0.5
# Shorter steps [m] are the noise of a parked car.
_NOISE = 0.5


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
        Origin of the track, for the notes.
    reverse : bool, optional
        Whether it was driven in reverse direction.
    **options
        Of `evaluate`.

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


def evaluate(
    recording: Recording,
    raceline: Raceline,
    *,
    start_s: float = 0.0,
    car_width: float = 0.3,
    sectors: int = 3,
    limits: LapLimits | None = None,
) -> RunResult:
    """Find and evaluate the laps of a recording.

    Parameters
    ----------
    recording : Recording
        Commands, if it has any, are held until the next one.
    raceline : Raceline
    start_s, car_width, sectors, limits
        See `map_racing.evaluation.laps.LapEvaluator`.

    Returns
    -------
    RunResult
        With traces.

    Raises
    ------
    EvaluationError
        If the car drove on another track: more than half of the samples are far outside of the
        walls, or it made no progress along the raceline.
    """
    evaluator = LapEvaluator(
        raceline,
        start_s=start_s,
        car_width=car_width,
        sectors=sectors,
        limits=limits,
        keep_traces=True,
    )
    speed_command = steering = None
    if recording.commands is not None:
        speed_command = recording.commands.held(recording.t, recording.commands.speed)
        steering = recording.commands.held(recording.t, recording.commands.steering_angle)
    poses = recording.t, recording.x, recording.y
    evaluator.update(*poses, recording.speed, speed_command, steering)
    result = evaluator.finish()
    if not result.laps:
        raise EvaluationError(f"{recording.source}: expected at least two samples")
    if recording.beliefs is not None:
        times, values = recording.beliefs
        laps = [lap.believed(times.tolist(), values) for lap in result.laps]
        result = replace(result, laps=laps)
    progress = sum(float(lap.trace.s[-1]) for lap in result.laps)
    _check_followed(recording, result, progress, limits.max_deviation if limits else None)
    complete = [lap for lap in result.laps if not math.isnan(lap.lap_time_s)]
    doubts = doubts_of(recording, [(lap.start_time_s, lap.end_time_s) for lap in complete])
    if speed_command is not None:
        doubts += uncommanded(recording.t, speed_command, result.laps)
    notes = [*recording.notes, *(f"warning: {doubt}" for doubt in doubts)]
    if progress < -0.5 * raceline.length:
        notes.append(f"the car drove against the direction of the raceline {_name(raceline)}")
    return replace(
        result,
        source=recording.source,
        notes=tuple(notes),
        commands_followed=not unfollowed(recording),
    )


def _check_followed(recording, result, progress, max_deviation):
    """Refuse driving on a track other than the raceline's."""
    raceline = result.raceline
    d = np.concatenate([lap.trace.d for lap in result.laps])
    deviation = np.abs(d)
    allowed = max_deviation
    if allowed is None and raceline.d_left is not None:
        places = np.concatenate([result.places_of(lap) for lap in result.laps])
        _, left, right = raceline.speed_and_walls(places)
        allowed = np.where(d > 0.0, left, right)
    elif allowed is None:
        allowed = NO_WALLS
    if float(np.median(deviation - allowed)) > _ELSEWHERE:
        raise EvaluationError(
            f"{recording.source}: the car drove elsewhere: half of the time more than "
            f"{np.median(deviation):.1f} m off the raceline {_name(raceline)}"
        )
    if result.summary.laps_completed:
        return
    driven = _driven(recording.x.tolist(), recording.y.tolist())
    if driven > 0.5 * raceline.length and not abs(progress) > 0.5 * driven:
        why = alternation(recording.topic, recording.t, recording.x, recording.y)
        raise EvaluationError(
            f"{recording.source}: the car drove elsewhere: {driven:.0f} m, but only "
            f"{abs(progress):.0f} m along the raceline {_name(raceline)}{why and f' ({why})'}"
        )


def _name(raceline):
    return raceline.name or raceline.source or "raceline"


def _driven(x, y):
    """Distance driven [m], in steps too long for the noise of a parked car."""
    driven, x0, y0 = 0.0, x[0], y[0]
    for x1, y1 in zip(x, y):
        step = math.hypot(x1 - x0, y1 - y0)
        if step > _NOISE:
            driven, x0, y0 = driven + step, x1, y1
    return driven
