"""Driving with known answers."""

import numpy as np
import pytest

from map_racing.bags.samples import Commands, Recording
from map_racing.track.files.load import load_raceline


@pytest.fixture(scope="session")
def reference():
    return load_raceline("reference")


@pytest.fixture(scope="session")
def driving():
    """Make a recording of driving along a raceline.

    ``driving(line, speed, deviation)`` with functions of the arc length: rate of progress along the
    raceline [m/s], deviation [m]. It begins 2 m before the start line and ends 1 m after it.
    """

    def make(line, speed, deviation=lambda s: 0.0 * s, laps=2, rate=100.0, commands=None):
        s = np.arange(-2.0, laps * line.length + 1.0, 0.005)
        v = speed(s) + 0.0 * s
        at = np.append(0.0, np.cumsum(0.005 * 0.5 * (1.0 / v[1:] + 1.0 / v[:-1])))
        t = np.arange(0.0, at[-1], 1.0 / rate)
        s = np.interp(t, at, s)
        d, here = deviation(s) + 0.0 * s, line.sample(s)
        x, y = line.to_cartesian(s, d)
        v = (speed(s) + 0.0 * s) * (1.0 - here.kappa * d)
        nan = np.full(t.size, np.nan)
        command = None if commands is None else Commands(t, *commands(s, v, here.kappa), "/drive")
        return Recording(
            *(t, x, y, here.psi, v, nan, (speed(s) + 0.0 * s) * here.kappa),
            source="run.bag",
            topic="/odom",
            commands=command,
        )

    return make
