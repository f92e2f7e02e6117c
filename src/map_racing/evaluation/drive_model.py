"""A model of the drive, to predict the speeds for other commands."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

__all__ = ["DriveModel"]

# Models of a drive that are tried: these lags [s], with the largest accelerations seen as limits,
# or without limits.
_LAGS = (0.01, 0.03, 0.06, 0.1, 0.15, 0.2, 0.3, 0.45)
_LIMITED = 0.9  # limits must reduce the error to less than this share


class DriveModel(NamedTuple):
    """A drive that follows its command with a lag [s], within limits [m/s^2], over a closed lap."""

    lag: float
    drive: float
    brake: float
    ds: float

    @classmethod
    def fitted(cls, command: np.ndarray, v: np.ndarray, ds: float) -> DriveModel:
        """The model that explains a lap best.

        Parameters
        ----------
        command, v : ndarray, shape (n,)
            Speeds commanded and driven at places that are `ds` apart [m/s].
        ds : float
            [m]
        """
        a = v * np.gradient(v, ds)
        most, least = float(np.percentile(a, 99)), float(-np.percentile(a, 1))
        best, error = None, math.inf
        limits = [(drive, brake) for drive in (math.inf, most) for brake in (math.inf, least)]
        for drive, brake in limits:
            free = math.isinf(drive) and math.isinf(brake)
            for lag in _LAGS:
                one = cls(lag, drive, brake, ds)
                rms = float(np.sqrt(np.mean((one.driven(command) - v) ** 2)))
                if rms < (error if free else _LIMITED * error):
                    best, error = one, rms
        return best

    def driven(self, command: np.ndarray) -> np.ndarray:
        """Speeds for a command at the places of a lap [m/s]."""
        speeds = [0.0] * len(command)
        commands = np.maximum(command, 0.1).tolist()
        v, ds, lag, drive, brake = commands[0], self.ds, self.lag, self.drive, -self.brake
        exp = math.exp
        for _ in range(2):  # after the first lap, the initial state no longer matters
            for i, wanted in enumerate(commands):
                speeds[i] = v
                step = ds / v
                a = (wanted - v) * (1.0 - exp(-step / lag)) / step
                v += (drive if a > drive else brake if a < brake else a) * step
                if v < 0.1:
                    v = 0.1
        return np.array(speeds)
