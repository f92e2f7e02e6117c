"""Warnings about doubtful laps, with the same wording live and from recordings."""

from __future__ import annotations

import math
from typing import Sequence

import numpy as np

from ..bags.lags import lag_of_effect
from ..bags.samples import Commands, Recording, is_map_frame, is_odometry_frame
from ..bags.series import commands_of_two
from .pose_doubts import rounded, set_aside, to_and_fro
from .results import Lap
from .speed import MOVING_MPS, beyond_for_a_while, chords, speed_of
from .speed_doubts import is_measured, speed_doubts

__all__ = [
    "alternation",
    "bunches",
    "command_clock",
    "command_units",
    "doubts_of",
    "frame_warning",
    "time_jump",
    "uncommanded",
    "unfollowed",
]


# Poses that alternate between two places are compared at an odd and at an even lag. A pose that
# moved by less than the last share of the usual step repeats the one before.
_ODD, _EVEN, _ALIKE, _APART, _REPEATED = 7, 8, 0.4, 0.02, 0.02
# They may alternate for a while only: in a block of this many samples, by at least this much [m].
# Or at least the last number of single poses are this far beside the path [m], and this many times
# as far as usual.
_BLOCK, _APART_IN_BLOCK, _BESIDE, _MANY, _FEW = 200, 0.05, 0.05, 8.0, 4
# Even one such pose counts if it is farther off [m], no car could get there and back (even with the
# acceleration of a hit on a wall [m/s^2]), and it is this many times as far as usual: among tens of
# thousands, noise puts one or two beyond the bound above.
_FAR, _FORCED, _MUCH = 0.1, 300.0, 12.0
# If poses are typically beside the path by this share of a step, noise hides everything.
_NOISY = 0.1
# Steps in time shorter than this share of the mean are within a bunch; poses come in bunches if the
# other steps are at most this share of all.
_SAME, _BUNCHED = 0.05, 0.7
# A time step of this many times the usual one, and longer by this much [s], may mean that a clock
# was set; speeds are taken from this many samples to both sides.
_LONG, _AHEAD, _AROUND = 1.5, 0.05, 10
# Largest plausible steering angle [rad], and largest plausible factor between commanded and driven
# speed.
_FARTHEST_ANGLE, _OBEYS = 1.2, 2.5
# A speed follows its command if they correlate by at least this at one of these lags [s]; usual
# laps have 0.8 and more. Fewest samples, least variation of commands and speeds [m/s], and most
# samples that are used.
_FOLLOWS, _LAGS = 0.6, np.arange(0.0, 0.61, 0.05)
_TELLING, _VARIED, _EVENLY, _ENOUGH = 200, 0.2, 1e-9, 10000
# Over this many chords, a commanded speed may be off by less than the factor above, because the car
# brakes; it is compared above this speed [m/s].
_LONG_WHILE, _BRAKES = 16, 1.5


def doubts_of(recording: Recording, spans: Sequence[tuple[float, float]]) -> list[str]:
    """All warnings about a recording, or about the driving so far.

    Parameters
    ----------
    recording : Recording
    spans : sequence of (float, float)
        Begin and end of complete laps [s]: speeds that are wrong for a while count only within
        them.

    Returns
    -------
    list of str
    """
    topic, t, x, y = recording.topic, recording.t, recording.x, recording.y
    v = recording.speed
    begin = min((begin for begin, _ in spans), default=math.inf)
    end = max((end for _, end in spans), default=-math.inf)
    found = chords(t, x, y, v if is_measured(v) else None)
    of_commands = []
    if recording.commands is not None:
        of_commands = [*command_units(recording.commands, *found[:2]), unfollowed(recording)]
        if not any(of_commands):
            of_commands = [_command_for_a_while(recording.commands, *found[:2], begin, end)]
    doubts = [
        frame_warning(topic, recording.frame),
        alternation(topic, t, x, y)
        or to_and_fro(topic, t, x, y)
        or set_aside(topic, t, x, y, begin, end),
        rounded(topic, x, y),
        bunches(topic, t),
        time_jump(topic, t, x, y),
        *speed_doubts(topic, t, x, y, v, found, begin, end),
        command_clock(recording),
        *of_commands,
    ]
    return [doubt for doubt in doubts if doubt]


def frame_warning(topic: str, frame: str) -> str:
    """Warning about poses in a frame other than the map; otherwise empty."""
    if is_odometry_frame(frame):
        return (
            f"{topic} is in frame {frame}, which drifts relative to the map: the lateral errors "
            "are not those on the track"
        )
    if is_map_frame(frame):
        return ""
    return (
        f"{topic} is in frame {frame}, not map: the lateral errors are right only if both are the "
        "same"
    )


def alternation(topic: str, t: np.ndarray, x: np.ndarray, y: np.ndarray) -> str:
    """Warning about poses that alternate between two places, as from two nodes; otherwise empty.

    Such poses are beside the straight line from the previous to the next, on alternating sides, and
    this persists. Noise is uncorrelated after three samples, and a driving car stays on one side.
    Repeated poses are left out.

    Parameters
    ----------
    topic : str
        Name of the poses.
    t, x, y : ndarray, shape (n,)
        Times [s] and positions [m].
    """
    t, x, y = (values[_new(x, y)] for values in (t, x, y))
    if t.size < 10 * _EVEN + 2:
        return ""
    spent = t[2:] - t[:-2]
    share = (t[1:-1] - t[:-2]) / spent
    bends = np.stack([(v[:-2] - v[1:-1]) + share * (v[2:] - v[:-2]) for v in (x, y)])
    off = np.hypot(*bends)
    apart = _alternates(bends, off, _APART)
    blocks = np.array_split(np.arange(t.size), max(t.size // _BLOCK, 1))
    inner = [slice(b[0], b[-1] - 1) for b in blocks]
    apart = apart or max(_alternates(bends[:, p], off[p], _APART_IN_BLOCK) for p in inner)
    if apart:
        return f"{topic}: poses alternate between two places {apart:.2f} m apart: from two nodes?"
    way, beside = _beside(x, y)
    pieces = [slice(max(b[0] - 2, 0), b[-1] + 1) for b in blocks]
    found = [_off_path_counts(spent[p], way[p], beside[p]) for p in pieces]
    few = sum(count for count, _ in found if count >= _FEW) or sum(far for _, far in found)
    if few:
        lie, why = ("poses lie", "from two nodes?") if few > 1 else ("pose lies", "is it wrong?")
        return f"{topic}: {few} {lie} beside those before and after: {why}"
    return ""


def _alternates(bends, off, least):
    """Distance [m] between the two places if poses alternate; otherwise 0.

    `bends` are the vectors from each pose to the path of its neighbors, `off` their lengths.
    """
    # If most are less, so is the median, which takes longer.
    if 2 * np.count_nonzero(off >= least) < off.size:
        return 0.0
    apart = float(np.median(off))
    if apart < least:
        return 0.0
    size = float(np.median(np.sum(bends**2, axis=0)))
    odd, even = (
        float(np.median(np.sum(bends[:, lag:] * bends[:, :-lag], axis=0))) / size
        for lag in (_ODD, _EVEN)
    )
    return apart if odd < -_ALIKE and even > _ALIKE else 0.0


def _beside(x, y):
    """Distance [m] between the neighbors of each pose, and of the pose from the path between them.

    Only the distance across the path counts: a late stamp shifts a pose along it.
    """
    along = np.stack([x[2:] - x[:-2], y[2:] - y[:-2]])
    off = np.stack([x[1:-1] - x[:-2], y[1:-1] - y[:-2]])
    way = np.hypot(*along)
    with np.errstate(divide="ignore", invalid="ignore"):
        beside = np.abs(along[0] * off[1] - along[1] * off[0]) / way
    return way, np.where(way > 0.0, beside, 0.0)


def _off_path_counts(spent, way, beside):
    """Number of single poses beside the path of their neighbors, and of those no car could reach.

    `spent` is the time between the neighbors [s]. Two poses at each end are left out.
    """
    if not np.any(beside > _BESIDE):
        return 0, 0
    usual = float(np.median(way))
    beside = np.where((way > 0.2 * usual) & (way < 1.5 * usual), beside, 0.0)
    usually = float(np.median(beside))
    if usually > _NOISY * usual:
        return 0, 0
    far = beside > max(_BESIDE, _MANY * usually)
    # The neighbors of such a pose seem to be on the other side, half as far.
    around = np.maximum(np.append(beside[1:], 0.0), np.append(0.0, beside[:-1]))
    far &= beside >= around
    far[[0, -1]] = False
    far_off = far & (beside > max(_FAR, _MUCH * usually))
    impossible = far_off & (8.0 * beside > _FORCED * spent**2)
    return int(np.count_nonzero(far)), int(np.count_nonzero(impossible))


def bunches(topic: str, t: np.ndarray) -> str:
    """Warning about times in bunches, between which the car seems to leap; otherwise empty.

    Parameters
    ----------
    topic : str
        Name of the poses.
    t : ndarray, shape (n,)
        Times [s].
    """
    steps = np.diff(t)
    if steps.size < 10:
        return ""
    apart = steps[steps > _SAME * np.mean(steps)]
    if apart.size > _BUNCHED * steps.size:
        return ""
    return (
        f"{topic}: poses come in bunches, {np.median(apart):.2f} s apart: times and speeds are no "
        "better than that"
    )


def time_jump(topic: str, t: np.ndarray, x: np.ndarray, y: np.ndarray) -> str:
    """Warning about times that jump ahead while the car moves by a usual step; otherwise empty.

    If the car is as fast before as after such a step, it was not slower during it: the clock was
    set. Poses that lag and then catch up are not a jump in time.
    """
    steps, way = np.diff(t), np.hypot(np.diff(x), np.diff(y))
    if steps.size < 4 * _AROUND:
        return ""
    usual = float(np.median(steps))
    long = np.flatnonzero(steps > max(_LONG * usual, usual + _AHEAD))
    if long.size > 0.02 * steps.size:
        return ""
    for k in long[(long >= _AROUND) & (long < steps.size - _AROUND)]:
        before, after = slice(k - _AROUND, k), slice(k + 1, k + 1 + _AROUND)
        speeds = [float(np.sum(way[part]) / np.sum(steps[part])) for part in (before, after)]
        v = 0.5 * sum(speeds)
        near = slice(k - 2, k + 4)
        spent = float(np.sum(way[near])) / v if v > 0.0 else math.inf
        ahead = float(np.sum(steps[near])) - spent
        steady = min(speeds) > 2.0 * MOVING_MPS and max(speeds) < 1.2 * min(speeds)
        if steady and ahead > max(_AHEAD, 0.8 * (steps[k] - usual)):
            return (
                f"{topic}: time jumps ahead by {ahead:.2f} s at {t[k]:.1f} s, while the car "
                f"moves as in {steps[k] - ahead:.2f} s: that lap is too long by the rest"
            )
    return ""


def _new(x, y):
    """Mask of poses that do not repeat the previous one."""
    moved = np.hypot(np.diff(x), np.diff(y))
    return np.append(True, moved > _REPEATED * np.mean(moved))


def command_clock(recording: Recording) -> str:
    """Warning about commands whose times clearly do not match the turning; otherwise empty."""
    commands = recording.commands
    if commands is None or recording.t.size < 10:
        return ""
    t, moved = recording.t, [np.gradient(v, recording.t) for v in (recording.x, recording.y)]
    speed, psi = np.hypot(*moved), recording.psi
    if np.isnan(psi).all():
        psi = np.arctan2(*moved[::-1])
    known = np.isfinite(psi)
    turning = np.gradient(np.unwrap(np.where(known, psi, 0.0)), t)
    with np.errstate(divide="ignore", invalid="ignore"):
        curvature = np.where(speed > MOVING_MPS, turning / speed, math.nan)
    lag = lag_of_effect(commands.t, commands.steering_angle, t[known], curvature[known])
    # With commands of two nodes, about which the reader warns, the lag is meaningless.
    if lag is None or commands_of_two(commands.topic, commands.steering_angle, commands.speed):
        return ""
    when = "after" if lag > 0.0 else "before"
    return (
        f"{commands.topic}: the car turns {abs(lag):.2f} s {when} its steering commands: they come "
        "from another clock, so speed errors compare different moments"
    )


def command_units(commands: Commands, at: np.ndarray, driven: np.ndarray) -> list[str]:
    """Warnings about commands that are not in radians or m/s.

    Parameters
    ----------
    commands : Commands
    at, driven : ndarray, shape (k,)
        Times [s] and speeds of the poses [m/s] of `chords`.
    """
    doubts = []
    angles = np.abs(commands.steering_angle[np.isfinite(commands.steering_angle)])
    if angles.size and np.percentile(angles, 90.0) > _FARTHEST_ANGLE:
        widest = float(np.percentile(angles, 90.0))
        doubts.append(
            f"{commands.topic}: steering angles of {widest:.3g} rad: in degrees? The steering rate "
            "is in the same unit"
        )
    commanded = commands.held(at, commands.speed)
    with np.errstate(invalid="ignore"):
        moving = (driven > MOVING_MPS) & (np.abs(commanded) > MOVING_MPS)
    if np.count_nonzero(moving) < 10:
        return doubts
    ratio = float(np.median(commanded[moving] / driven[moving]))
    if not 1.0 / _OBEYS < ratio < _OBEYS:
        hint = ": in km/h?" if abs(ratio / 3.6 - 1.0) < 0.2 else ""
        doubts.append(
            f"{commands.topic}: the speed commanded is {ratio:.2f} times the motion of the poses"
            f"{hint}"
        )
    return doubts


def _command_for_a_while(commands, at, driven, begin, end):
    """Warning about commands far from the speed for a while, as while another node drives."""
    commanded = commands.held(at, commands.speed)
    within = (at > begin) & (at < end) & (driven > _BRAKES) & np.isfinite(commanded)
    ratio = commanded[within] / driven[within]
    found = beyond_for_a_while(at[within], ratio, _LONG_WHILE, 1.0 / _OBEYS, _OBEYS)
    if not found:
        return ""
    return (
        f"{commands.topic}: from {found[0]:.1f} to {found[1]:.1f} s the speed commanded is "
        f"{found[2]:.2f} times the motion of the poses"
    )


def unfollowed(recording: Recording) -> str:
    """Warning about a commanded speed that the car does not follow at all; otherwise empty.

    The larger of Pearson's and the rank correlation counts; jumps of the pose do not affect the
    latter.
    """
    commands = recording.commands
    if commands is None or not commands.t.size:
        return ""
    t = recording.t
    v = speed_of(t, recording.x, recording.y, recording.speed)
    every = slice(None, None, max(t.size // _ENOUGH, 1))
    t, v = t[every], v[every]
    found = []
    for lag in _LAGS:
        commanded = commands.held(t - lag, commands.speed)
        with np.errstate(invalid="ignore"):
            moving = (commanded > MOVING_MPS) & (v > MOVING_MPS)
        commanded, driven = commanded[moving], v[moving]
        if commanded.size >= _TELLING and np.std(commanded) > _VARIED and np.std(driven) > _EVENLY:
            for pair in ((commanded, driven), (_ranks(commanded), _ranks(driven))):
                found.append(float(np.corrcoef(*pair)[0, 1]))
                if found[-1] >= _FOLLOWS:
                    return ""
    if not found:
        return ""
    return (
        f"{commands.topic}: the car's speed does not follow the speed commanded (correlation at "
        f"most {max(found):.2f}): speed errors are meaningless"
    )


def _ranks(values):
    """Ranks of values; equal values get their mean rank."""
    _, which, counts = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(counts) - 0.5 * counts)[which]


def uncommanded(t: np.ndarray, command: np.ndarray, laps: list[Lap]) -> list[str]:
    """Warnings about complete laps in which commands are missing.

    Parameters
    ----------
    t, command : ndarray, shape (n,)
        Times [s], and commanded speed, NaN without a command.
    laps : list of Lap
    """
    without, partly = [], []
    for lap in laps:
        if math.isnan(lap.lap_time_s):
            continue
        missing = np.isnan(command[(t >= lap.start_time_s) & (t <= lap.end_time_s)])
        if missing.all():
            without.append(str(lap.lap))
        elif missing.mean() > 0.02:
            partly.append(str(lap.lap))
    doubts = []
    if without:
        doubts.append(
            f"no drive commands in laps {', '.join(without)}: their speed error, if any, is "
            "relative to the raceline"
        )
    if partly:
        doubts.append(
            f"drive commands are missing for a part of laps {', '.join(partly)}: their "
            "speed error and steering rate cover only the rest"
        )
    return doubts
