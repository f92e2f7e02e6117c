from types import SimpleNamespace

import numpy as np
import pytest

from map_racing.evaluation.bags import BagWriter
from map_racing.track.raceline import Raceline


def _shape(phi):
    """A bean-shaped course and its derivative: bends from 0.7 to 17 m radius."""
    x = 6.0 * np.cos(phi) + 0.5 * np.cos(2.0 * phi)
    y = 3.5 * np.sin(phi) - 0.4 * np.sin(3.0 * phi)
    dx = -6.0 * np.sin(phi) - 1.0 * np.sin(2.0 * phi)
    dy = 3.5 * np.cos(phi) - 1.2 * np.cos(3.0 * phi)
    return x, y, dx, dy


@pytest.fixture(scope="session")
def course():
    """A course whose arc length is known exactly, independent of `Raceline`.

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
def race_bag(tmp_path_factory, course):
    """Factory of bags of 2.5 laps at 5 m/s and 40 Hz: ``race_bag(compression=None) -> path``."""
    made = {}

    def make(compression=None):
        if compression not in made:
            path = tmp_path_factory.mktemp("bags") / f"race_{compression}.bag"
            line = course.raceline(speed=5.0, walls=1.0)
            with BagWriter(path, compression) as bag:
                bag.waypoints(T0, line)
                for i in range(int(2.5 * course.length / 5.0 * 40.0)):
                    t = T0 + 0.025 * i
                    x, y, psi = (float(value) for value in course.place(5.0 * 0.025 * i - 3.0, 0.1))
                    bag.odometry(t, x, y, psi, 5.0, 0.1, 0.2)
                    bag.pose(t, x, y, psi)
                    bag.drive(t, 0.05, 5.0)
                    bag.imu(t, 0.0, 1.0, 0.2)
                    bag.transform(t, x, y, psi)
            made[compression] = path
        return made[compression]

    return make
