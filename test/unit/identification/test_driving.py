"""Usable parts of a drive: after the last command, the car's behavior is unknown."""

import numpy as np
import pytest

from map_racing.errors import IdentificationError
from map_racing.identification.cornering import motion_of
from map_racing.identification.data import Run, Signal
from map_racing.identification.driving import driving_of, windows_of
from map_racing.identification.filters import LONGEST_HOLD_S, near
from map_racing.vehicle.parameters import load_vehicle

LAST = 6.0


@pytest.fixture(scope="module")
def rolling():
    """A car on a circle whose commands end at `LAST`; then it coasts down."""
    t = np.arange(0.0, 12.0, 0.02)
    v = np.where(t < LAST, 3.0, 3.0 - 0.3 * (t - LAST))
    psi = 0.02 * np.cumsum(v) / 4.0
    steps = 0.02 * v[:, None] * np.stack((np.cos(psi), np.sin(psi)), axis=1)
    x, y = np.cumsum(steps, axis=0).T
    signals = {"x": x, "y": y, "psi": psi, "v_x": v, "yaw_rate": v / 4.0}
    signals = {name: Signal(t, value) for name, value in signals.items()}
    commands = t[t <= LAST]
    for name, value in (("steering", 0.08), ("speed_command", 3.0)):
        signals[name] = Signal(commands, np.full(commands.size, value))
    return Run("rolling", signals)


def test_a_car_that_rolls_on_is_not_fitted_as_if_it_held_its_last_command(rolling):
    drive = driving_of(rolling)
    assert drive.usable[drive.t < LAST].all()
    assert not drive.usable[drive.t > LAST + LONGEST_HOLD_S + 0.02].any()
    windows = windows_of([drive], channels=("r", "v_x"))
    assert windows.count and np.max(windows.begin) + 1.3 < LAST + LONGEST_HOLD_S + 0.02


def test_nor_is_its_rolling_steady_cornering(rolling):
    motion = motion_of(rolling, load_vehicle("nuc4"), acceleration="yaw_rate")
    assert motion.steady[(motion.t > 1.0) & (motion.t < LAST - 1.0)].all()
    assert not motion.steady[motion.t > LAST + LONGEST_HOLD_S + 0.02].any()


def test_a_run_that_tells_no_speed_is_refused(rolling):
    """An empty column y, which gives no signal, causes no traceback either."""
    signals = {name: rolling.signals[name] for name in ("x", "yaw_rate", "steering")}
    with pytest.raises(IdentificationError, match="expected a speed or poses, got neither"):
        driving_of(Run("no y", signals))


def test_gaps_and_ends():
    samples = np.array([1.0, 1.2, 2.0, 2.2])
    t = np.array([0.5, 0.99, 1.0, 1.1, 1.2, 1.5, 2.0, 2.1, 2.2, 2.4, 2.5])
    known = np.array([0, 0, 1, 1, 0, 0, 1, 1, 1, 1, 0], dtype=bool)
    assert near(t, samples, 0.25).tolist() == known.tolist()
