"""A track of known length and its bags, races that take a few hundredths of a second, ramps."""

import dataclasses
import errno
import gc
import os
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import settings

from map_racing import files
from map_racing.bags.writer import BagWriter
from map_racing.control.parameters import load_controller_parameters
from map_racing.control.steering_ramp import RampParameters
from map_racing.experiments.jobs import RaceJob
from map_racing.identification.data import load_run
from map_racing.simulation.plants import load_plant
from map_racing.simulation.ramps import drive_ramps
from map_racing.simulation.recorded import write_ramp_bag
from map_racing.track.files.waypoints import waypoint_rows
from map_racing.track.raceline import Raceline
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.tires import PacejkaTire

# With default settings, the garbage collector takes a twelfth of the time.
gc.set_threshold(50000, 20, 20)


# Hypothesis: with the car's libraries, a few examples are enough to show that the code runs.
settings.register_profile("car", max_examples=20)
if sys.version_info < (3, 9):
    settings.load_profile("car")


def pytest_configure(config):
    config.addinivalue_line("markers", "rest_once: all cases but the first are marked `once`")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark cases before those to run are chosen by their marks."""
    begun = set()
    for item in items:
        if item.get_closest_marker("rest_once") and not item.get_closest_marker("once"):
            if item.function in begun:
                item.add_marker(pytest.mark.once)
            begun.add(item.function)


def pytest_collection_finish():
    """Exclude imported objects from garbage collection: they stay anyway."""
    gc.collect()
    gc.freeze()


def _shape(phi):
    """A bean-shaped track and its derivative: bends from 0.7 to 17 m radius."""
    x = 6.0 * np.cos(phi) + 0.5 * np.cos(2.0 * phi)
    y = 3.5 * np.sin(phi) - 0.4 * np.sin(3.0 * phi)
    dx = -6.0 * np.sin(phi) - 1.0 * np.sin(2.0 * phi)
    dy = 3.5 * np.cos(phi) - 1.2 * np.cos(3.0 * phi)
    return x, y, dx, dy


@pytest.fixture(scope="session")
def track():
    """A track whose arc length is known exactly, independent of `Raceline`.

    ``length``, ``place(s, d) -> x, y, psi`` and ``raceline(spacing, **columns)``.
    """
    phi = np.linspace(0.0, 2.0 * np.pi, 200001)
    _, _, dx, dy = _shape(phi)
    speed = np.hypot(dx, dy)
    s_of_phi = np.append(0.0, np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(phi)))
    length = s_of_phi[-1]

    def place(s, d=0.0):
        x, y, dx, dy = _shape(np.interp(np.mod(s, length), s_of_phi, phi))
        norm = np.hypot(dx, dy)
        return x - d * dy / norm, y + d * dx / norm, np.arctan2(dy, dx)

    def raceline(spacing=0.1, speed=None, walls=None):
        count = int(round(length / spacing))
        x, y, _ = place(np.arange(count) * length / count)
        columns = {} if speed is None else {"vx_mps": np.full(count, speed)}
        if walls is not None:
            columns["d_left_m"] = np.full(count, walls)
            columns["d_right_m"] = np.full(count, walls)
        return Raceline(x, y, name="bean", **columns)

    return SimpleNamespace(length=length, place=place, raceline=raceline)


T0 = 1600000000.0


@pytest.fixture(scope="session")
def race_bag(tmp_path_factory, track):
    """Factory of bags of 2.5 laps at 5 m/s and 40 Hz: ``race_bag(compression=None) -> path``."""
    made = {}

    def make(compression=None):
        if compression not in made:
            path = tmp_path_factory.mktemp("bags") / f"race_{compression}.bag"
            line = track.raceline(speed=5.0, walls=1.0)
            with BagWriter(path, compression) as bag:
                bag.waypoints(T0, waypoint_rows(line))
                for i in range(int(2.5 * track.length / 5.0 * 40.0)):
                    t = T0 + 0.025 * i
                    x, y, psi = (float(value) for value in track.place(5.0 * 0.025 * i - 3.0, 0.1))
                    bag.odometry(t, x, y, psi, 5.0, 0.1, 0.2)
                    bag.pose(t, x, y, psi)
                    bag.drive(t, 0.05, 5.0)
                    bag.imu(t, 0.0, 1.0, 0.2)
                    bag.transform(t, x, y, psi)
            made[compression] = path
        return made[compression]

    return make


@pytest.fixture(scope="session", autouse=True)
def ramps_once():
    """Cache the identification ramps of experiments for each car and seed."""
    driven = {}

    def drive(*arguments):
        key = repr(arguments)
        if key not in driven:
            driven[key] = drive_ramps(*arguments)
        return list(driven[key])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("map_racing.experiments.identification_day.drive_ramps", drive)
        yield


SPEEDS = (2.0, 3.0, 4.0)


@pytest.fixture
def full_disk(monkeypatch):
    """Function that lets no file whose name contains a text be written: the disk is full."""

    def fill(text):
        def opened(path, mode="r", **options):
            if text in Path(path).name and "w" in mode:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
            return open(path, mode, **options)

        monkeypatch.setattr(files, "open", opened, raising=False)

    return fill


@pytest.fixture(scope="session")
def ring():
    """A circle of 1.5 m radius between walls, at 3.2 m/s."""
    angle = 2.0 * np.pi * np.arange(60) / 60
    half = np.full(60, 0.4)
    return Raceline(
        *(1.5 * np.cos(angle), 1.5 * np.sin(angle)),
        vx_mps=np.full(60, 3.2),
        d_left_m=half,
        d_right_m=half,
        name="ring",
    )


@pytest.fixture(scope="session")
def job_of(ring):
    """Make a job; defaults are those of a race that is completed."""
    plant, vehicle = load_plant("nuc4"), load_vehicle("nuc4")
    controller = load_controller_parameters("map_paper").with_(m_m=0.3, q_s=0.1)

    def make(scale=0.7, seed=1, laps=1, **changes):
        values = {
            "name": "MAP",
            "controller": controller.with_(speed_scale=scale),
            "vehicle": vehicle,
            "plant": plant,
            "raceline": ring,
            "laps": laps,
            "seed": seed,
        }
        values.update(changes)
        return RaceJob(**values)

    return make


def moderate(vehicle):
    """The car with tires that are neither its own nor the plant's."""
    return dataclasses.replace(
        vehicle,
        name="base",
        front=PacejkaTire(6.0, 1.3, 1.0, 0.0),
        rear=PacejkaTire(8.0, 1.3, 1.0, 0.0),
    )


@pytest.fixture(scope="session")
def ramps(tmp_path_factory):
    """Ramps of the shipped plant, with its noise and delays, as samples, bag and run."""
    parameters = load_plant("nuc4")
    samples = drive_ramps(parameters, [RampParameters(speed_mps=v) for v in SPEEDS], seed=5)
    path = tmp_path_factory.mktemp("ramps") / "ramps.bag"
    write_ramp_bag(path, samples)
    return SimpleNamespace(
        parameters=parameters,
        samples=samples,
        path=path,
        run=load_run(path),
        true=parameters.build_vehicle(),
        base=moderate(load_vehicle("nuc4")),
    )


@pytest.fixture(scope="session")
def curve_error():
    """Largest error of an identified axle over the covered slip, as a share of the true peak."""

    def error(found, true, axle):
        fit, tire = found.axles[axle].pacejka, getattr(true, axle)
        slip = np.linspace(0.0, fit.covered_slip, 300)
        expected = true.mu * tire.normalized_force(slip)
        return float(
            np.max(np.abs(fit.tire.normalized_force(slip) - expected)) / (true.mu * tire.peak)
        )

    return error
