"""Steady-state cornering: which lateral acceleration a held steering angle settles at.

In steady state at constant speed (v_y' = r' = 0, a_long = 0) the moment balance makes both axles
use the same share of their friction, and the equations of `single_track` reduce to::

    a = v r = mu g P_f(s_f) = mu g P_r(s_r)                      s_f = -alpha_f, s_r = -alpha_r
    delta = s_f + atan(l_wb a / v^2 - tan(s_r))

So the front slip s_f parametrizes all steady states of one speed, and delta(s_f) is explicit. Those
reachable by turning the wheel slowly from straight ahead form the branch from s_f = 0 on which the
Jacobian of (v_y', r') has both eigenvalues in the left half plane, with the rear tire on the rising
side of its curve. On it delta(s_f) rises strictly (its derivative has the sign of the Jacobian's
determinant), so each cell of the table is one monotone scalar equation. A front tire beyond its peak
belongs to the branch: the car plows, stably.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

from .. import __version__
from ..errors import ParameterError
from .lookup import LookupTable, Provenance
from .parameters import parameter_hash
from .single_track import GRAVITY, single_track_derivatives

__all__ = ["simulate_to_steady_state", "steady_state_table"]

# front slip angles [rad] between which each branch is followed, dense where tires are stiff
_SLIP = 1.5 * np.linspace(0.0, 1.0, 257) ** 2


def steady_state_table(vehicle, speeds, angles):
    """Steady-state lateral acceleration on a grid of speed and steering angle.

    Parameters
    ----------
    vehicle : Vehicle
    speeds : array_like, shape (n_speeds,)
        Speeds [m/s], positive, ascending.
    angles : array_like, shape (n_angles,)
        Steering angles [rad], not negative, ascending.

    Returns
    -------
    LookupTable
        ``a_lat[i, j]`` [m/s^2] at ``angles[i]`` and ``speeds[j]``; NaN where the car has no stable
        steady state.

    Raises
    ------
    ParameterError
        If an axis is not as said.
    """
    speeds, angles = np.asarray(speeds, dtype=float), np.asarray(angles, dtype=float)
    if speeds.ndim != 1 or not np.all((speeds > 0.0) & np.isfinite(speeds)):
        raise ParameterError(f"speeds: expected positive finite ones, got {speeds}")
    if angles.ndim != 1 or not np.all((angles >= 0.0) & (angles < 0.5 * np.pi)):
        raise ParameterError(f"angles: expected them in [0, pi/2), got {angles}")
    provenance = Provenance(
        vehicle=vehicle.name,
        tire_model=vehicle.front.model,
        parameter_hash=parameter_hash(vehicle),
        l_wb=vehicle.l_wb,
        generator=f"map_racing {__version__}",
    )
    return LookupTable(speeds, angles, _solve(vehicle, speeds, angles), provenance)


def simulate_to_steady_state(vehicle, v, delta, duration=20.0):
    """Integrate the single-track model from straight running until it settles: the reference.

    Parameters
    ----------
    vehicle : Vehicle
    v : float
        Speed [m/s], positive.
    delta : float
        Steering angle [rad], held from the start.
    duration : float
        Time to integrate [s].

    Returns
    -------
    float
        Lateral acceleration ``v r`` at the end [m/s^2]; NaN if it still changes by more than
        1e-6 m/s^2 per second.
    """
    derivatives = single_track_derivatives(vehicle, v_eps=1e-9)

    def right_hand_side(_, state):
        return derivatives(v, state[0], state[1], delta, 0.0)

    solution = solve_ivp(
        right_hand_side, (0.0, duration), (0.0, 0.0), method="LSODA", rtol=1e-10, atol=1e-12
    )
    v_y, r = solution.y[:, -1]
    v_y_dot, r_dot = derivatives(v, v_y, r, delta, 0.0)
    settled = solution.success and max(abs(v_y_dot), abs(v * r_dot)) < 1e-6
    return v * r if settled else float("nan")


def _solve(vehicle, speeds, angles):
    """Cells of the table, shape (n_angles, n_speeds)."""
    slip, delta, last = _branches(vehicle, speeds)
    # bracket each cell between two front slips of its branch, and start on the chord
    low = np.empty((angles.size, speeds.size))
    high, start = np.empty_like(low), np.empty_like(low)
    for j in range(speeds.size):
        s, d = slip[: last[j] + 1, j], delta[: last[j] + 1, j]
        above = np.clip(np.searchsorted(d, angles), 1, last[j]) if last[j] else np.zeros(1, int)
        low[:, j], high[:, j] = s[np.maximum(above - 1, 0)], s[above]
        start[:, j] = np.interp(angles, d, s)
    reachable = angles[:, None] <= delta[last, np.arange(speeds.size)]
    gain = vehicle.mu * GRAVITY * vehicle.l_wb / speeds**2

    i, j = np.nonzero(reachable)
    s_f = _newton(vehicle, gain[j], angles[i], low[i, j], high[i, j], start[i, j])
    a_lat = np.full(reachable.shape, np.nan)
    a_lat[i, j] = vehicle.mu * GRAVITY * vehicle.front.normalized_force(s_f)
    return a_lat


def _branches(vehicle, speeds):
    """Front slip and steering angle along the stable branch of each speed.

    Returns
    -------
    slip, delta : ndarray, shape (n, n_speeds)
        Up to row ``last[j]``, which is the end of the branch, column j is valid and rising.
    last : ndarray of int, shape (n_speeds,)
    """
    columns = np.arange(speeds.size)
    slip = np.repeat(_SLIP[:, None], speeds.size, axis=1)
    delta, stable = _equilibria(vehicle, speeds, _SLIP[:, None])
    end = np.where(stable.all(axis=0), _SLIP.size, np.argmin(stable, axis=0))
    last = np.maximum(end - 1, 0)
    # sharpen the end of those that end: twice, to 1/128 of the interval
    low, high = slip[last, columns], slip[np.minimum(end, _SLIP.size - 1), columns]
    for _ in range(2):
        fine = low + (high - low) * np.linspace(0.0, 1.0, 129)[:, None]
        fine_delta, fine_stable = _equilibria(vehicle, speeds, fine)
        first = np.where(fine_stable.all(axis=0), 128, np.maximum(np.argmin(fine_stable, axis=0), 1))
        low, high = fine[first - 1, columns], fine[first, columns]
    ends = (end > 0) & (end < _SLIP.size)
    slip[end[ends], columns[ends]] = low[ends]
    delta[end[ends], columns[ends]] = fine_delta[first[ends] - 1, columns[ends]]
    return slip, delta, np.where(ends, end, last)


def _equilibria(vehicle, speeds, s_f):
    """Steering angle [rad] and stability of the steady states with front slip `s_f`.

    `s_f` has shape (n, 1) or (n, n_speeds), the results (n, n_speeds).
    """
    front, rear = vehicle.front, vehicle.rear
    force = front.normalized_force(s_f)
    s_r = rear.slip(force)
    slope_f, slope_r = front.slope(s_f), rear.slope(s_r) * np.cos(s_r) ** 2
    gain = vehicle.mu * GRAVITY * vehicle.l_wb / speeds**2
    with np.errstate(invalid="ignore"):
        tangent = gain * force - np.tan(s_r)
        slope_f = slope_f / (1.0 + tangent**2)
        # signs of determinant and negative trace of the Jacobian of (v_y', r')
        determinant = slope_r * (1.0 + gain * slope_f) - slope_f
        damping = vehicle.l_r * slope_f * (1.0 / vehicle.m + vehicle.l_f**2 / vehicle.I_z)
        damping = damping + vehicle.l_f * slope_r * (1.0 / vehicle.m + vehicle.l_r**2 / vehicle.I_z)
        stable = (determinant > 0.0) & (damping > 0.0)
    return s_f + np.arctan(tangent), stable


def _newton(vehicle, gain, delta, low, high, s_f):
    """Front slip of each cell: Newton kept within its bracket by bisection."""
    front, rear = vehicle.front, vehicle.rear
    result = s_f.copy()
    active = np.arange(s_f.size)
    for _ in range(60):
        force = front.normalized_force(s_f)
        s_r = rear.slip(force)
        tangent = gain * force - np.tan(s_r)
        residual = s_f + np.arctan(tangent) - delta
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = front.slope(s_f) * (gain - 1.0 / (rear.slope(s_r) * np.cos(s_r) ** 2))
            step = residual / (1.0 + slope / (1.0 + tangent**2))
        low = np.where(residual < 0.0, s_f, low)
        high = np.where(residual > 0.0, s_f, high)
        following = s_f - step
        inside = (following >= low) & (following <= high)
        following = np.where(inside, following, 0.5 * (low + high))
        result[active] = following
        going = np.abs(following - s_f) > 1e-12
        if not going.any():
            break
        active, gain, delta = active[going], gain[going], delta[going]
        low, high, s_f = low[going], high[going], following[going]
    return result
