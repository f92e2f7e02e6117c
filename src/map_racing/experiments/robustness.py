"""The grid of tracks and cars that a controller must cope with."""

from __future__ import annotations

import math
import random
from dataclasses import dataclass, field, fields, replace
from typing import NamedTuple

import numpy as np

from ..errors import ParameterError
from ..resources import find_config
from ..simulation.plants import load_plant
from ..track.files.load import load_raceline
from ..track.findings import WARNING
from ..track.generator import TrackShape, draw_track
from ..track.raceline import Raceline
from ..validation import finite, read_parameters
from ..vehicle.parameters import load_vehicle
from ..vehicle.size import ONE_TENTH, size_of
from .campaign import Plan
from .jobs import RaceJob

__all__ = [
    "Grid",
    "Robustness",
    "any_shape",
    "grid_plan",
    "load_robustness",
]


@dataclass(frozen=True)
class Robustness:
    """Tracks and cars; a file in ``config/experiments`` holds the same names.

    Parameters
    ----------
    plant : str
        Shipped plant or plant file that the cars are made from.
    cars : dict of str to dict
        Maps the name of a car to the parameters in which it differs from the plant: a number, or a
        text ``"x 0.9"`` for a factor. ``plant`` replaces the plant, and ``vehicle`` is the
        controller's model of the car (default: the vehicle of the plant file).
    tracks : tuple of str
        Shipped tracks, raceline files or ``bag[#topic]``.
    generated_seeds : tuple of int
        Seeds of generated tracks, with shapes from `any_shape`.
    bumps : tuple of dict
        Sideways bumps, as in recorded or hand-drawn lines. If there are any, each track is raced
        once with each of them and not without: ``place``, its beginning as a share of the lap,
        ``length_m``, and ``offset_m``, its height, positive to the left.
    speed_scale : float
        Scale of the raceline's speeds.
    laps : int
        Timed laps of a race.
    seed : int
        Of the noise.

    Raises
    ------
    ParameterError
        If a value is impossible; the message names it.
    """

    plant: str
    cars: dict
    tracks: tuple = ()
    generated_seeds: tuple = ()
    bumps: tuple = ()
    speed_scale: float = 1.0
    laps: int = 2
    seed: int = 1

    def __post_init__(self):
        for name in ("tracks", "generated_seeds", "bumps"):
            values = getattr(self, name)
            if not isinstance(values, (list, tuple)):
                raise ParameterError(f"{name}: expected a list, got {values!r}")
            object.__setattr__(self, name, tuple(values))
        for seed in (*self.generated_seeds, self.seed):
            if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
                raise ParameterError(f"seeds: expected whole numbers from 0, got {seed!r}")
        if not self.tracks and not self.generated_seeds:
            raise ParameterError("tracks, generated_seeds: expected at least one track, got none")
        for bump in self.bumps:
            _check_bump(bump)
        if not isinstance(self.cars, dict) or not self.cars:
            raise ParameterError("cars: expected names and what each car differs in")
        if isinstance(self.laps, bool) or not isinstance(self.laps, int) or self.laps < 1:
            raise ParameterError(f"laps: expected at least 1, got {self.laps!r}")
        finite("speed_scale", self.speed_scale)


def _check_bump(bump):
    names = {"place", "length_m", "offset_m"}
    if not isinstance(bump, dict) or set(bump) != names:
        raise ParameterError(f"bumps: expected {', '.join(sorted(names))} of each, got {bump!r}")
    for name, value in bump.items():
        finite(f"bumps: {name}", value)
    if not 0.0 <= bump["place"] < 1.0:
        raise ParameterError(f"bumps: place: expected 0 to 1 of the lap, got {bump['place']:g}")
    if not bump["length_m"] > 0.0:
        raise ParameterError(f"bumps: length_m: expected more than 0, got {bump['length_m']:g}")


def load_robustness(source):
    """Read tracks and cars from a shipped name or a YAML file.

    Raises
    ------
    ParameterError
        If a parameter is missing, unknown or impossible; the message names file and parameter.
    """
    what = "a grid of tracks and cars, such as robustness"
    return read_parameters(find_config("experiments", source, (".yaml",)), Robustness, what=what)


def any_shape(seed):
    """Shape of a generated track, drawn by its seed.

    20 to 60 m long, bend radii from 0.8 to 1.5 m, 0 to 3 straights, left or right, and speeds for 7
    to 12.6 m/s^2 of lateral acceleration (NUC4's tires hold 7).

    Parameters
    ----------
    seed : int

    Returns
    -------
    TrackShape
    """
    draw = random.Random(f"shape of track {seed}").random
    tightest = 0.8 + 0.7 * draw()
    return TrackShape(
        length=20.0 + 40.0 * draw(),
        tightest_radius=tightest,
        straights=int(4.0 * draw()),
        width=min(2.0, 1.8 * tightest),
        left=draw() < 0.5,
        beyond=1.0 + 0.8 * draw(),
    )


def drawn(seed, vehicle):
    """The generated track of a seed, with a shape from `any_shape`, scaled to a vehicle.

    Parameters
    ----------
    seed : int
    vehicle : Vehicle

    Returns
    -------
    Raceline
    """
    track, size = draw_track(seed, any_shape(seed)), size_of(vehicle)
    if size == ONE_TENTH:
        return track
    columns = (track.x, track.y, track.d_left, track.d_right)
    x, y, left, right = (size.length * column for column in columns)
    speed = np.minimum(size.time * track.speed, vehicle.v_max)
    return Raceline(x, y, vx_mps=speed, d_left_m=left, d_right_m=right, name=track.name)


def bumped(raceline, place, length_m, offset_m):
    """A raceline with a sideways bump ``offset sin^2(pi u)``, u from 0 to 1 along its length.

    Speeds and walls stay where they are, but a wall closer than 0.2 m to the bump is moved away.

    Parameters
    ----------
    raceline : Raceline
    place : float
        Where the bump begins, as a share of the lap.
    length_m, offset_m : float
        Length along the raceline, and height, positive to the left [m].

    Returns
    -------
    Raceline
        It may cross itself if the bump is higher than the radius of a bend.

    Raises
    ------
    ParameterError
        If the bump is longer than the lap.
    """
    if length_m >= raceline.length:
        raise ParameterError(
            f"bumps: length_m: expected less than the lap of {raceline.name}, "
            f"{raceline.length:.1f} m, got {length_m:g}"
        )
    s = raceline.s_points
    along = np.mod(s - place * raceline.length, raceline.length) / length_m
    offset = np.where(along < 1.0, offset_m * np.sin(math.pi * along) ** 2, 0.0)
    sample = raceline.sample(s)
    x, y = raceline.to_cartesian(s, offset)
    walls = {}
    if raceline.d_left is not None:
        walls["d_left_m"] = np.maximum(sample.d_left - offset, 0.2)
        walls["d_right_m"] = np.maximum(sample.d_right + offset, 0.2)
    name = f"{raceline.name}, {offset_m:+g} m at {place:.0%}"
    return Raceline(x, y, vx_mps=sample.speed, name=name, **walls)


class Car(NamedTuple):
    """A car of the grid: its name, its plant, and the controller's model of it."""

    name: str
    plant: object
    vehicle: object


@dataclass(frozen=True)
class Grid:
    """Loaded tracks and cars of `conditions`."""

    conditions: Robustness
    loaded: dict = field(init=False, repr=False)
    tracks: tuple = field(init=False)
    cars: tuple = field(init=False)

    def __post_init__(self):
        given = self.conditions
        loaded = {source: load_raceline(source) for source in given.tracks}
        object.__setattr__(self, "loaded", loaded)
        tracks = [loaded[source] for source in given.tracks]
        tracks += [drawn(seed, self.vehicle) for seed in given.generated_seeds]
        if given.bumps:
            tracks = [bumped(track, **bump) for track in tracks for bump in given.bumps]
        object.__setattr__(self, "tracks", tuple(tracks))
        cars = [_car(name, given.plant, changes) for name, changes in given.cars.items()]
        object.__setattr__(self, "cars", tuple(cars))

    @property
    def vehicle(self):
        """Vehicle of the base plant; the generated tracks are scaled to its size."""
        return load_plant(self.conditions.plant).vehicle

    def jobs(self, label, controller):
        """The races of a controller: every car on every track, grouped by track.

        Parameters
        ----------
        label : str
        controller : ControllerParameters

        Returns
        -------
        list of RaceJob
        """
        given = self.conditions
        controller = controller.with_(speed_scale=given.speed_scale)
        return [
            RaceJob(
                label,
                controller.with_(reference_point=car.plant.reference_point),
                car.vehicle,
                car.plant,
                track,
                given.laps,
                given.seed,
            )
            for track in self.tracks
            for car in self.cars
        ]

    @property
    def notes(self):
        """Notes for the user about tracks and cars."""
        notes = [
            f"{source}: {finding}"
            for source, track in self.loaded.items()
            for finding in track.findings
            if finding.severity == WARNING
        ]
        notes += [
            f"{source}: no walls are known, so crashes are not detected"
            for source, track in self.loaded.items()
            if track.d_left is None
        ]
        cars = {(car.name, note) for car in self.cars for note in car.vehicle.notes}
        return notes + [f"car {name}: its vehicle: {note}" for name, note in sorted(cars)]

    @property
    def names(self):
        """Track and car of each job, as in `jobs`."""
        return [(track.name, car.name) for track in self.tracks for car in self.cars]


def _car(name, plant, changes):
    if not isinstance(changes, dict):
        raise ParameterError(f"cars: {name}: expected parameters and values, not {changes!r}")
    changes = dict(changes)
    plant = load_plant(changes.pop("plant", plant))
    vehicle = changes.pop("vehicle", None)
    vehicle = plant.vehicle if vehicle is None else load_vehicle(vehicle)
    known = {f.name for f in fields(plant)} - {"vehicle"}
    values = {}
    for key, value in changes.items():
        if key not in known:
            raise ParameterError(f"cars: {name}: unknown parameter {key}")
        if isinstance(value, str) and value.startswith("x "):
            try:
                value = getattr(plant, key) * float(value[2:])
            except (TypeError, ValueError):
                raise ParameterError(f"cars: {name}: {key}: expected x and a number") from None
        values[key] = value
    try:
        return Car(name, replace(plant, **values), vehicle)
    except ParameterError as error:
        raise ParameterError(f"cars: {name}: {error}") from error


def grid_plan(grid, label, controller):
    """Plan that races a controller over the grid; its result is the list of `RaceResult`.

    Parameters
    ----------
    grid : Grid
    label : str
        Name of the controller in the results.
    controller : ControllerParameters

    Returns
    -------
    Plan
    """

    def steps():
        return (yield grid.jobs(label, controller))

    return Plan(steps(), len(grid.names))
