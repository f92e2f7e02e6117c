"""Speed scales for the next heat, sector by sector, from the grip used in the last one.

In each sector the speeds may grow until the lateral acceleration reaches the grip that the tires
surely have that day, but never by more than a step, and not where the car was off the line or close
to a wall. The next lap time is predicted by a model of the drive, corrected by the laps driven.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ..control.speed_sectors import LARGEST_SCALE, SpeedSectors
from ..errors import EvaluationError, ParameterError
from ..vehicle.size import size_of
from .analysis import RunAnalysis
from .day_grip import DayGrip, grip_of_day
from .drive_model import DriveModel

__all__ = ["STEP", "Advice", "SectorAdvice", "advice_notes", "advice_table", "advise"]

STEP = 0.15
"""Largest relative increase of a scale from one heat to the next."""

# Beyond the first distance off the line [m] a car gets no faster there, beyond the second slower;
# the same below the distances from a wall.
_OFF, _CLOSE = (0.2, 0.3), (0.10, 0.05)
_SLOWER = 0.97
# A larger share of the grip cannot come from these tires.
_BEYOND = 1.15
# A corner ends where less than this share of its largest lateral acceleration is left; the rest is
# a sector of its own if it is this long [m].
_BENT, _SHORTEST = 0.5, 1.5
# The raceline driven may have had other points: this many at the edge of a sector may have belonged
# to the next.
_BESIDE = 3
# A speed below this share of the one asked for is held back by the controller's own limit.
_HELD = 0.99
# Braking must reach the speed of a slower sector within this distance [m].
_SLOWING = 1.5


class SectorAdvice(NamedTuple):
    """A sector with its speed scale.

    Attributes
    ----------
    name : str
        Such as ``"second left"``.
    first, last : int
        Its points, indices of `Raceline.s_points`. For a sector that crosses the raceline's first
        point, `last` is less than `first`.
    begin, end : float
        Distances from the start line [m].
    driven, scale : float
        Scale of the heat that was driven, and of the next.
    why : str
        What limits it: ``"step"``, ``"grip"``, ...
    grip_used : float
        Largest lateral acceleration of the mean lap, as a share of the lower end of the day's
        limit.
    off_line_m, clearance_m : float
        Largest distance from the raceline, and least from a wall; NaN without walls.
    """

    name: str
    first: int
    last: int
    begin: float
    end: float
    driven: float
    scale: float
    why: str
    grip_used: float
    off_line_m: float
    clearance_m: float


@dataclass(frozen=True)
class Advice:
    """Advice for the next heat.

    Attributes
    ----------
    sectors : list of SectorAdvice
    grip : DayGrip
    driven_s, predicted_s : float
        Mean lap of the heat, and predicted lap [s].
    step : float
        Largest increase of a scale.
    points : int
        Number of points of the raceline.
    notes : list of str
    """

    sectors: list
    grip: DayGrip
    driven_s: float
    predicted_s: float
    step: float
    points: int
    notes: list

    def scales(self) -> list[tuple[int, int, str, float]]:
        """First and last point, name and scale, as `save_speed_sectors` takes them."""
        rows = []
        for one in self.sectors:
            if one.first <= one.last:
                rows.append((one.first, one.last, one.name, one.scale))
            else:
                parts = (one.first, self.points - 1), (0, one.last)
                rows += [(*part, one.name, one.scale) for part in parts]
        return sorted(rows)


def advise(run: RunAnalysis, step: float = STEP) -> Advice:
    """Advice from a run.

    Parameters
    ----------
    run : RunAnalysis
        With the limits of its car and a lap that counts.
    step : float, optional
        Largest increase of a scale, as a share of it.

    Returns
    -------
    Advice

    Raises
    ------
    EvaluationError
        If something is missing: a lap that counts, the car, speeds in the raceline, the yaw rate.
    ParameterError
        If the step is not between 0 and 1.
    """
    if not 0.0 < step <= 1.0:
        raise ParameterError(f"step: expected more than 0, at most 1, got {step:g}")
    _check(run)
    heat = _Heat(run)
    sectors, notes = [], list(heat.notes)
    cuts = heat.cuts()
    for (first, name), (following, _) in zip(cuts, cuts[1:] + cuts[:1]):
        sectors.append(heat.sector(first, following, name, step))
    most = max(one.grip_used for one in sectors)
    if most > _BEYOND:
        notes.append(
            f"the laps used up to {100 * most:.0f} % of what the tires of {heat.vehicle.name} "
            "surely have: perhaps it is the file of another car"
        )
    sectors = heat.reachable(sectors)
    planned = heat.planned(sectors)
    predicted = heat.predicted(sectors, planned)
    if planned is not None:
        sectors = [heat.held(one, planned) for one in sectors]
        if any(heat.own_limit in one.why for one in sectors):
            notes.append(
                f"bound by {heat.own_limit}: the controller's own limit holds the speed back, in "
                "the whole "
                "sector or, if named beside another limit, at its slowest place"
            )
    points = len(heat.line.s_points)
    return Advice(sectors, heat.grip, heat.time, predicted, step, points, notes)


def _check(run):
    source = run.result.source
    if run.result.none_counts:
        raise EvaluationError(f"{source}: no advice: {run.result.none_counts}")
    if run.limits is None:
        raise EvaluationError(f"{source}: no advice: the car is not known, give --vehicle")
    if run.profile.track.speed is None:
        raise EvaluationError(f"{source}: no advice: the raceline has no speeds to scale")
    if not np.isfinite(run.profile.mean("a_lat")).all():
        why = "; ".join(run.profile.notes) or "neither yaw rate nor heading is known"
        raise EvaluationError(f"{source}: no advice: {why.replace('warning: ', '')}")


class _Heat:
    """The heat, at the places of the profile without the last, which equals the first."""

    def __init__(self, run):
        profile, limits = run.profile, run.limits
        self.run, self.track = run, profile.track
        self.line, self.vehicle = run.result.raceline, limits.vehicle
        self.s = self.track.s[:-1]
        self.ds = self.s[1]
        self.size = size_of(self.vehicle).length
        self.time = float(np.mean([lap.lap.lap_time_s for lap in profile.counted]))
        self.v = self._mean("v")
        # A command that the car does not follow says nothing about the drive.
        self.command = np.full(self.v.size, math.nan)
        if run.result.commands_followed:
            self.command = self._mean("v_command")
        controller = run.settings.controller if run.settings is not None else None
        known = {
            name: getattr(controller, key)
            for name, key in (("delay", "delay_s"), ("share", "adaptation_share"))
            if getattr(controller, key, 0.0)  # a delay of 0 means unknown
        }
        if getattr(controller, "reference_point", "") == "center_of_gravity":
            known["behind"] = 0.0
        self.own_limit = "grip_use" if getattr(controller, "grip_use", 0.0) else "v_max_mps"
        self.ahead = getattr(controller, "speed_lookahead_s", 0.0)
        laps = [lap.lap for lap in profile.counted]
        self.grip = grip_of_day(run.recording, laps, self.vehicle, **known)
        self.use = np.abs(self._mean("a_lat")) / (self.grip.low * limits.lateral(self.v))
        d = np.array([lap.values["d"][:-1] for lap in profile.counted])
        self.off = np.max(np.abs(d), axis=0)
        self.clearance = np.full(self.s.size, math.nan)
        if self.track.d_left is not None:
            left, right = self.track.d_left[:-1], self.track.d_right[:-1]
            self.clearance = np.min(np.minimum(left - d, right + d), axis=0)
            self.clearance -= 0.5 * self.vehicle.width
        self.notes = []
        if self.grip.belief is None:
            self.notes.append(
                "the recording does not show the grip of the day (commands, speed and yaw rate): "
                "a grip that any day has is used"
            )
        self.asked, self.at_points = self._asked(controller)

    def _mean(self, channel):
        return self.run.profile.mean(channel)[:-1]

    def _asked(self, controller):
        """Scale asked for at each place and, if it is known exactly, at each point."""
        arc = (self.s + self.track.start_s) % self.line.length
        if controller is not None:
            try:
                sectors = self.run.settings.speed_sectors(self.line)
                return tuple(
                    controller.speed_scale
                    * np.array([sectors.scale_at(at) if sectors else 1.0 for at in places.tolist()])
                    for places in (arc, self.line.s_points)
                )
            except ParameterError:
                pass
        self.notes.append(
            "the recording does not say which scale was driven: derived from the speeds"
        )
        speed = self.command
        if not np.isfinite(speed).all():
            speed = self.v
        return speed / np.maximum(self.track.speed[:-1], 0.1), None

    # -- sectors -----------------------------------------------------------------------------------

    def cuts(self):
        """First points of the sectors, with their names, in the order of the lap."""
        found = {}
        for corner in self.run.corners:
            begin = int(np.argmin(np.abs(self.s - corner.begin)))
            length = (corner.end - corner.begin) % self.track.length or self.track.length
            cells = (begin + np.arange(max(int(round(length / self.ds)), 1))) % self.s.size
            bent = np.flatnonzero(self.use[cells] >= _BENT * self.use[cells].max())[-1] + 1
            name = corner.name or "whole lap"
            found.setdefault(self._point(corner.begin), name)
            if corner.side and (len(cells) - bent) * self.ds > _SHORTEST * self.size:
                after = self._point(corner.begin + bent * self.ds)
                found.setdefault(after, f"after the {name}")
        return sorted(found.items())

    def _point(self, s):
        """Index of the raceline's point nearest to a distance from the start line."""
        points, length = self.line.s_points, self.line.length
        away = np.abs((points - s - self.track.start_s + 0.5 * length) % length - 0.5 * length)
        return int(np.argmin(away))

    def sector(self, first, following, name, step):
        """Advice for the points from `first` to the one before `following`."""
        inside = self._inside(first, following)
        hot = max(float(np.max(self.use[inside])), 1e-3)
        off, clear = float(np.max(self.off[inside])), float(np.min(self.clearance[inside]))
        if self.at_points is None:
            driven = float(np.median(self.asked[inside]))
        else:
            count = (following - first - 1) % len(self.line.s_points) + 1
            asked = np.sort(np.roll(self.at_points, -first)[:count])
            driven = float(asked[min(_BESIDE, (count - 1) // 2)])
        # The grip used was there: only error or clearance makes a sector slower.
        bounds = [(1.0 + step, "step"), (max(math.sqrt(1.0 / hot), 1.0), "grip")]
        side = "from" if clear >= 0.0 else "beyond"
        for value, (least, most), why in (
            (off, _OFF, f"{off:.2f} m off the line"),
            (-clear, [-close for close in _CLOSE], f"{abs(clear):.2f} m {side} the wall"),
        ):
            if value > most * self.size:
                bounds.append((_SLOWER, why))
            elif value > least * self.size:
                bounds.append((1.0, why))
        factor, why = min(bounds)
        points, length = self.line.s_points, self.line.length
        begin, end = ((points[i] - self.track.start_s) % length for i in (first, following))
        last = (following - 1) % len(points)
        # A scale that is kept is rounded as before; a changed one is rounded down, below its bound.
        scale = round(driven, 3)
        if factor != 1.0:
            scale = math.floor(1000.0 * driven * factor) / 1000.0
        if scale > LARGEST_SCALE:
            scale, why = LARGEST_SCALE, "the largest scale"
        return SectorAdvice(
            name,
            first,
            last,
            float(begin),
            float(end) or length,
            driven,
            scale,
            why,
            hot,
            off,
            clear,
        )

    def _inside(self, first, following):
        """Mask of the places from point `first` to the one before `following`."""
        points, length = self.line.s_points, self.line.length
        begin, end = points[first], points[following]
        inside = (self.s + self.track.start_s - begin) % length < ((end - begin) % length or length)
        nearest = np.argmin(np.abs(self.s - (begin - self.track.start_s) % length))
        return inside if inside.any() else np.arange(self.s.size) == nearest

    def reachable(self, sectors):
        """Limit each sector so that the next one's speed is reached soon after its beginning."""
        brake = min(self.run.limits.a_brake_max, self.vehicle.a_brake_max)
        found = list(sectors)
        for i in reversed(range(2 * len(found))):
            one, following = found[i % len(found)], found[(i + 1) % len(found)]
            v = self.line.speed_at(self.line.s_points[following.first])
            gain = 2.0 * brake * _SLOWING * self.size / max(v, 0.1) ** 2
            most = math.floor(1000.0 * math.sqrt(following.scale**2 + gain)) / 1000.0
            if one.scale > most:
                found[i % len(found)] = one._replace(scale=most, why="the next sector")
        return found

    # -- the lap -----------------------------------------------------------------------------------

    def planned(self, sectors):
        """Speeds that the controller would plan with these scales; None if unknown."""
        if self.run.planned is None:
            return None
        settings = replace(
            self.run.settings,
            controller=self.run.settings.controller.with_(speed_scale=1.0),
            sectors=tuple(_stretches(sectors, self.line)),
        )
        return settings.planned_speed(self.line)((self.s + self.track.start_s) % self.line.length)

    def held(self, one, planned):
        """The sector, with its scale limited by the controller's own limit."""
        inside = np.flatnonzero(self._inside(one.first, (one.last + 1) % len(self.line.s_points)))
        share = planned[inside] / np.maximum(self.track.speed[inside], 0.1)
        most = max(math.ceil(1000.0 * float(np.max(share))) / 1000.0, one.driven)
        if one.scale > one.driven and most < one.scale:
            return one._replace(scale=most, why=self.own_limit)
        if one.scale > one.driven and share[np.argmin(planned[inside])] < _HELD * one.scale:
            return one._replace(why=f"{one.why}, {self.own_limit}")
        return one

    def predicted(self, sectors, planned):
        """Lap time with these scales, given the speeds that the controller would plan."""
        length = self.line.length
        new = SpeedSectors(_stretches(sectors, self.line), length)
        arc = (self.s + self.track.start_s) % length
        scales = np.array([new.scale_at(at) for at in arc.tolist()])
        before, after = self.asked, scales
        if planned is not None:
            before, after = self.run.planned[:-1], planned
        ahead = self.s + self.ahead * self.v
        ratio, other = (np.interp(ahead, self.s, x, period=length) for x in (after, before))
        ratio = ratio / np.maximum(other, 1e-6)
        command, speed = self.command, self.v * ratio
        if np.isfinite(command).all():
            drive = DriveModel.fitted(command, self.v, self.ds)
            speed = self.v * drive.driven(command * ratio) / drive.driven(command)
        time, driven = (float(np.sum(1.0 / np.maximum(v, 0.1))) for v in (speed, self.v))
        return self.time * time / driven


def _stretches(sectors, line):
    """Begin and end as arc lengths [m], and scale."""
    points = line.s_points
    for one in sectors:
        following = (one.last + 1) % len(points)
        begin, end = float(points[one.first]), float(points[following]) or line.length
        if begin == end:
            begin, end = 0.0, line.length
        yield begin, end, one.scale


def advice_table(advice: Advice) -> list[list[str]]:
    """Rows of text, header first, for the terminal and for pages.

    Parameters
    ----------
    advice : Advice

    Returns
    -------
    list of list of str
    """
    rows = [["sector", "from", "to", "driven", "next", "bound by", "sure grip", "off the line"]]
    rows[0].append("clearance")
    for one in advice.sectors:
        clearance = "" if math.isnan(one.clearance_m) else f"{one.clearance_m:.2f} m"
        rows.append(
            [
                *(one.name, f"{one.begin:.1f} m", f"{one.end:.1f} m"),
                *(f"{one.driven:.3f}", f"{one.scale:.3f}", one.why),
                *(f"{100 * one.grip_used:.0f} %", f"{one.off_line_m:.2f} m", clearance),
            ]
        )
    return rows


def advice_notes(advice: Advice) -> list[str]:
    """The advice in sentences: grip, laps, and notes.

    Parameters
    ----------
    advice : Advice

    Returns
    -------
    list of str
    """
    grip = advice.grip
    notes = [
        f"Lap: {advice.driven_s:.3f} s driven, {advice.predicted_s:.3f} s predicted with these "
        "scales of the raceline's speed, at speed_scale 1."
    ]
    if grip.belief is not None:
        notes.append(
            f"Grip of the day: {grip.level:.2f} of the vehicle file's (95 %: {grip.low:.2f} to "
            f"{grip.high:.2f}); the lower end is the limit."
        )
    return notes + [f"{note[0].upper()}{note[1:]}." for note in advice.notes]
