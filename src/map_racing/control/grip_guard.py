"""Slows below the plan where the steering would need more grip than there is."""

import math

import numpy as np

from .speed_plan import WALKING_PACE

__all__ = ["GripGuard"]

# Low-pass of the demanded share of the grip [s]: two poses at 40 Hz, so that a single noisy one has
# no effect.
TIME_CONSTANT = 0.05
# The speed starts to give way at a share of 1, and gives way completely at this one.
COMPLETE = 1.3
# Larger shares are clipped to this one, so that a car that points the wrong way brakes at once but
# drives on as soon as it can.
MOST = 2.0

_PER_MPS = 50  # Entries of the table of radii per m/s.
_LONG_AGO = -1e12


class GripGuard:
    """Lowers the speed while guidance demands more lateral acceleration than the tires have.

    The plan assumes a car on its line. A car that arrives too fast, slides, oscillates or is off
    the line needs a tighter circle. Where guidance demands the lateral acceleration ``a_lat`` at
    speed ``v``, its circle can be driven at ``v sqrt(a_max / a_lat)``. While the demand, after a
    short low-pass, exceeds the grip, the command drops towards that speed, whatever the plan.

    Parameters
    ----------
    grip : object with ``max_lateral_acceleration(v)``
    v_max : float
        Largest speed of the plan [m/s].

    Attributes
    ----------
    use : float
        Low-passed share of the grip that guidance demands, at most 2.
    levels : list of float or None
        Present grip at each speed, relative to `grip`, then a `TireSteering`; None for `grip`
        itself.
    """

    def __init__(self, grip, v_max):
        # A sliding car may be faster than its plan.
        count = int(math.ceil(1.5 * v_max * _PER_MPS)) + 1
        v = np.maximum(np.arange(count), 0.5) / _PER_MPS
        self._radius = (v * v / np.asarray(grip.max_lateral_acceleration(v))).tolist()
        self._last = len(self._radius) - 1
        self._grip, self.levels = grip, None
        self.reset()

    def reset(self):
        """Forget the past."""
        self._t, self.use = _LONG_AGO, 0.0

    def resume(self, other):
        """Take over the state of another guard."""
        self._t, self.use = other._t, other.use

    def limited(self, t, v, kappa, planned):
        """Speed to command.

        Parameters
        ----------
        t : float
            Time [s].
        v : float
            Measured speed [m/s].
        kappa : float
            Curvature of the circle that guidance asks the car to follow [1/m].
        planned : float
            Speed of the plan [m/s].

        Returns
        -------
        float
            Speed [m/s], at most `planned`; the guard does not go below walking pace.
        """
        # Comparisons, and the nearest entry: interpolation would double the time.
        per_mps = _PER_MPS
        if self.levels is not None and v > 0.0:
            # A circle at v with friction scaled by `level` has the slip of one at v / sqrt(level).
            per_mps /= math.sqrt(self._grip.at(v, self.levels))
        i = int(v * per_mps + 0.5)
        if i < 0:
            i = 0
        elif i > self._last:
            i = self._last
        needed = kappa * self._radius[i]
        if needed < 0.0:
            needed = -needed
        if needed > MOST:
            needed = MOST
        elapsed = t - self._t
        self._t = t
        use = self.use
        if elapsed > 0.0:
            use += (needed - use) * elapsed / (TIME_CONSTANT + elapsed)
            self.use = use
        if use <= 1.0:
            return planned
        held = v / math.sqrt(use)
        if held < WALKING_PACE:
            held = WALKING_PACE
        if held >= planned:
            return planned
        part = (use - 1.0) / (COMPLETE - 1.0)
        return held if part >= 1.0 else planned + part * (held - planned)
