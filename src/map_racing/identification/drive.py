"""Model of the drive from speed command to speed: dead time and first-order lag within limits."""

from __future__ import annotations

import numpy as np

from .driving import Driving, Windows, windows_of
from .robust_fit import Believed, Fitted, fit

__all__ = ["driven_speed", "drive_windows", "fit_drive"]

# Standard deviation of the speed that a window needs to identify the drive; most windows used.
LEAST_CHANGE_MPS, MOST_WINDOWS = 0.15, 30
BELIEVED = {
    "delay": Believed(0.03, 0.1, 0.0, 0.29, 1e-3),
    "lag": Believed(0.1, 0.3, 0.005, 2.0, 1e-3),
    "a_max": Believed(7.0, 20.0, 0.5, 30.0, 1e-2),
    "a_brake_max": Believed(8.0, 20.0, 0.5, 30.0, 1e-2),
    "gain": Believed(1.0, 0.05, 0.7, 1.4, 1e-3),
}


def drive_windows(drives: list[Driving]) -> Windows:
    """Windows in which the speed changes."""
    return windows_of(
        drives,
        length=1.5,
        burn_in=0.0,
        step=0.01,
        channels=("v_x",),
        excited="v_x",
        least=LEAST_CHANGE_MPS,
        most=MOST_WINDOWS,
    )


def driven_speed(windows: Windows, lanes: np.ndarray, begin: int = 0) -> np.ndarray:
    """Drive through windows by the speed commands.

    Parameters
    ----------
    windows : Windows
    lanes : ndarray, shape (p, 5)
        Sets of dead time [s], lag [s], largest acceleration and deceleration [m/s^2], and speed per
        commanded speed.
    begin : int
        Step from which the commands apply; before it the speed is the measured one.

    Returns
    -------
    ndarray, shape (K + 1, p, n)
        Speed at each step [m/s].
    """
    lag, most, least, gain = lanes.T[1:, :, None]
    command = gain * windows.commands("speed_command", lanes[:, 0])
    v = np.empty((windows.steps + 1, *command.shape[1:]))
    v[: begin + 1] = windows.v_x[: begin + 1, None, :]
    # The exact response over a step, within the limits.
    follow = -np.expm1(-windows.step / lag)
    up, down = most * windows.step, -least * windows.step
    for k in range(begin, windows.steps):
        v[k + 1] = v[k] + np.clip((command[k] - v[k]) * follow, down, up)
    return v


def fit_drive(windows: Windows) -> Fitted:
    """Fit dead time, lag, limits and gain of the drive to the speeds in windows."""

    def predict(lanes):
        return {"v_x": windows.at("v_x", driven_speed(windows, lanes))}

    starts = [{"delay": 0.02}, {"lag": 0.4}]
    return fit(predict, windows.observed, BELIEVED, starts, {"v_x": 0.1})
