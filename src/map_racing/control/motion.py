"""Velocity of the car from poses alone, for localization that reports none."""

from __future__ import annotations

import math
from collections import deque
from typing import NamedTuple

__all__ = ["Motion", "MotionEstimate"]

WINDOW_S = 0.1  # time span of the poses used


class Motion(NamedTuple):
    """Velocity along the car's axes [m/s, m/s] and yaw rate [rad/s]."""

    v_x: float
    v_y: float
    r: float


class MotionEstimate:
    """Straight-line fit through the latest poses.

    The slope of a fit through n poses has ``sqrt(12 / (n (n^2 - 1)))`` times the noise of one pose,
    divided by the pose interval: at 40 Hz and 0.1 s, 1 cm of noise becomes 0.13 m/s. The estimate
    lags by half the window.
    """

    def __init__(self):
        self.reset()

    def reset(self):
        """Forget all poses."""
        self._poses = deque()

    def update(self, t: float, x: float, y: float, psi: float) -> Motion:
        """Add a pose.

        Parameters
        ----------
        t : float
            Its time [s]; if earlier than the last one, the estimate is reset.
        x, y, psi : float
            Position [m] and heading [rad].

        Returns
        -------
        Motion
            Zero until there are two poses. ``v_y`` is NaN: poses are too noisy for it.
        """
        poses = self._poses
        if not math.isfinite(t + x + y + psi):
            return self._motion()
        if poses:
            if t < poses[-1][0]:
                poses.clear()
            elif t == poses[-1][0]:
                return self._motion()
            else:  # unwrap the heading
                last = poses[-1][3]
                psi = last + math.remainder(psi - last, math.tau)
        poses.append((t, x, y, psi))
        while len(poses) > 2 and t - poses[0][0] > WINDOW_S + 1e-9:
            poses.popleft()
        return self._motion()

    def _motion(self):
        poses = self._poses
        count = len(poses)
        if count < 2:
            return Motion(0.0, math.nan, 0.0)
        origin = poses[0]
        mean_t = sum(pose[0] - origin[0] for pose in poses) / count
        square = slope_x = slope_y = slope_psi = turn = 0.0
        for t, x, y, heading in poses:
            since = t - origin[0] - mean_t
            square += since * since
            slope_x += since * (x - origin[1])
            slope_y += since * (y - origin[2])
            slope_psi += since * (heading - origin[3])
            turn += heading - origin[3]
        # The fitted velocity refers to the middle of the window, and so must the heading.
        heading = origin[3] + turn / count
        v_x = (slope_x * math.cos(heading) + slope_y * math.sin(heading)) / square
        return Motion(v_x, math.nan, slope_psi / square)
