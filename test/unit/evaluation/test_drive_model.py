import numpy as np
import pytest

from map_racing.evaluation.drive_model import DriveModel


def sweep(count=600, ds=0.06):
    s = ds * np.arange(count)
    return 4.0 + 1.5 * np.sin(2.0 * np.pi * s / (count * ds)), ds


def test_the_lag_of_a_drive_is_found():
    command, ds = sweep()
    for lag in (0.06, 0.2):
        v = DriveModel(lag, np.inf, np.inf, ds).driven(command)
        assert DriveModel.fitted(command, v, ds) == DriveModel(lag, np.inf, np.inf, ds)


def test_a_drive_follows_as_the_differential_equation_says():
    """After a step of the command, the speed approaches it with the time constant."""
    ds, lag = 0.01, 0.15
    command = np.full(4000, 3.0)
    command[2000:] = 4.0
    v = DriveModel(lag, np.inf, np.inf, ds).driven(command)[2000:]
    t = np.cumsum(ds / v) - ds / v[0]
    assert v == pytest.approx(4.0 - np.exp(-t / lag), abs=0.01)


def test_a_drive_at_its_limit_gets_no_faster():
    command, ds = sweep()
    command = command + 3.0 * (np.arange(command.size) > 300)
    v = DriveModel(0.06, 2.0, np.inf, ds).driven(command)
    found = DriveModel.fitted(command, v, ds)
    assert found.drive == pytest.approx(2.0, rel=0.1)
