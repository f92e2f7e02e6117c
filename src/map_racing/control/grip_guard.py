"""Slower than planned where the steering would need more grip than there is."""

import math

import numpy as np

from .speed_plan import WALKING_PACE

__all__ = ["GripGuard"]

# Low-pass of the grip that is needed [s]: two poses at 40 Hz, so that a single noisy one does
# nothing.
TIME_CONSTANT = 0.05
# The speed gives way from all of the grip on, and completely at this share of it.
COMPLETE = 1.3
# More than this share counts as this: a car that points the wrong way should brake at once, and
# drive on as soon as it can.
MOST = 2.0

_PER_MPS = 50  # Entries of the table of radii.
_LONG_AGO = -1e12


class GripGuard:
    """Lowers the speed while guidance demands more lateral acceleration than the tires have.

    A plan holds for a car on its line. A car that arrives too fast, slides, swings or is off the
    line needs a tighter circle than the line's. With the lateral acceleration ``a_lat`` that
    guidance asks at speed ``v``, the circle can be driven at ``v sqrt(a_max / a_lat)``; while the
    demand exceeds the grip, the command goes down to that, however fast the plan is. It does
    nothing where the demand, after a short low-pass, stays within the grip.

    Parameters
    ----------
    grip : object with ``max_lateral_acceleration(v)``
    v_max : float
        Largest speed of the plan [m/s].

    Attributes
    ----------
    use : float
        Low-passed share of the grip that guidance asks for, at most 2.
    levels : list of float or None
        Grip that there is at each speed, relative to that of `grip`, a `TireSteering`; None for
        that itself.
    """

    def __init__(self, grip, v_max):
        # Cars slide at speeds beyond their plan's.
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
        """Go on from the state of another guard."""
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
            At most `planned`, and no less than walking pace for it [m/s].
        """
        # Comparisons, and the nearest entry: interpolation would take as long as all of the rest.
        per_mps = _PER_MPS
        if self.levels is not None and v > 0.0:
            # With other friction a circle is what it was at v / sqrt(level): of the same slip.
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
