"""Steady-state cornering: the lateral acceleration at which a constant steering angle settles.

In steady state at constant speed (v_y' = r' = 0, a_long = 0) the moment balance makes both axles
use the same share of their friction, and the equations of `single_track` reduce to::

    a = v r = mu g P_f(s_f) = mu g P_r(s_r)                      s_f = -alpha_f, s_r = -alpha_r
    delta = s_f + atan(l_wb a / v^2 - tan(s_r))

So the front slip s_f parametrizes all steady states at one speed, and delta(s_f) is explicit. The
states reachable by steering slowly away from straight ahead form the branch from s_f = 0 on which
both eigenvalues of the Jacobian of (v_y', r') are in the left half plane and the rear tire is on
the rising side of its curve. On this branch delta(s_f) rises strictly (its derivative has the sign
of the Jacobian's determinant), so each cell of the table is one monotone scalar equation. States
with the front tire past its peak belong to the branch: the car plows, stably. States that a car can
only jump to are left out.
"""

from __future__ import annotations

import numpy as np

from .. import __version__
from ..errors import ParameterError
from .lookup import LookupTable, Provenance
from .parameters import Vehicle, parameter_hash
from .single_track import GRAVITY

__all__ = ["steady_state_table"]

# front slip angles [rad] at which each branch is sampled, dense where tires are stiff ...
_SLIP = 1.5 * np.linspace(0.0, 1.0, 257) ** 2
# ... and around the front tire's peak, as multiples of its slip: if both tires have nearly the same
# peak, the branch may end within a very narrow interval
_AROUND_PEAK = 1.0 + np.outer((-1.0, 1.0), np.logspace(-6.0, -1.0, 41)).ravel()


def steady_state_table(vehicle: Vehicle, speeds: np.ndarray, angles: np.ndarray) -> LookupTable:
    """Steady-state lateral acceleration on a grid of speed and steering angle.

    The published 60 x 65 grid of ``nuc4`` takes 6 ms, 0.1 % of integrating each cell for 2 s.

    Parameters
    ----------
    vehicle : Vehicle
    speeds : array_like, shape (n_speeds,)
        Speeds [m/s], ascending, at least 1 mm/s.
    angles : array_like, shape (n_angles,)
        Steering angles [rad], ascending, at least 0.

    Returns
    -------
    LookupTable
        ``a_lat[i, j]`` [m/s^2] at ``angles[i]`` and ``speeds[j]``; NaN where the car has no stable
        steady state.

    Raises
    ------
    ParameterError
        If an axis is invalid, or the car has no stable steady state at all.
    """
    speeds, angles = np.asarray(speeds, dtype=float), np.asarray(angles, dtype=float)
    for name, axis, least in (("speeds", speeds, 1e-3), ("angles", angles, 0.0)):
        if axis.ndim != 1 or not axis.size or not np.all(np.isfinite(axis)):
            raise ParameterError(f"{name}: expected a list of finite numbers")
        if axis[0] < least or np.any(np.diff(axis) < 0.0):
            raise ParameterError(f"{name}: expected ascending values from {least:g} on")
    if angles[-1] >= 0.5 * np.pi:
        raise ParameterError(f"angles: expected less than pi/2 rad, got {angles[-1]:g}")
    provenance = Provenance(
        vehicle=vehicle.name,
        tire_model=vehicle.front.model,
        parameter_hash=parameter_hash(vehicle),
        l_wb=vehicle.l_wb,
        generator=f"map_racing {__version__}",
    )
    try:
        return LookupTable(speeds, angles, _solve(vehicle, speeds, angles), provenance)
    except ParameterError as error:
        raise ParameterError(f"{vehicle.name}: no table of steady states: {error}") from None


def _solve(vehicle, speeds, angles):
    """Cells of the table, shape (n_angles, n_speeds)."""
    a_lat = np.full((angles.size, speeds.size), np.nan)
    rows, columns, brackets = [], [], []
    for j, (slip, delta) in enumerate(_branches(vehicle, speeds)):
        reachable = np.arange(np.searchsorted(angles, delta[-1:], side="right").sum())
        above = np.clip(np.searchsorted(delta, angles[reachable]), 1, None)
        rows.append(reachable)
        columns.append(np.full_like(reachable, j))
        brackets.append((slip[above - 1], slip[above], delta[above - 1], delta[above]))
    i, j = np.concatenate(rows), np.concatenate(columns)
    s_f = _front_slip(vehicle, speeds[j], angles[i], *np.concatenate(brackets, axis=1))
    a_lat[i, j] = vehicle.mu * GRAVITY * vehicle.front.normalized_force(s_f)
    with np.errstate(invalid="ignore"):
        return np.minimum(a_lat, vehicle.a_lat_max)


def _branches(vehicle, speeds):
    """Front slip and steering angle at points along the stable branch of each speed.

    Returns
    -------
    list of (ndarray, ndarray)
        Both rising from 0 to the end of the branch; empty where straight running is unstable.
    """
    peak = vehicle.front.peak_slip
    followed = np.union1d(_SLIP, peak * _AROUND_PEAK) if peak < _SLIP[-1] else _SLIP
    delta, stable = _equilibria(vehicle, speeds, followed[:, None])
    count = np.logical_and.accumulate(stable).sum(axis=0)
    # refine the end of the branch twice by a factor of 128, which leaves 1e-14 rad of delta
    low = followed[np.maximum(count - 1, 0)]
    high = followed[np.minimum(count, followed.size - 1)]
    columns = np.arange(speeds.size)
    for _ in range(2):
        slip = low + (high - low) * np.linspace(0.0, 1.0, 129)[:, None]
        delta_end, stable = _equilibria(vehicle, speeds, slip)
        last = np.maximum(np.logical_and.accumulate(stable).sum(axis=0) - 1, 0)
        low, high = slip[last, columns], slip[np.minimum(last + 1, 128), columns]
    delta_end = delta_end[last, columns]
    return [
        (np.append(followed[:n], low[j]), np.append(delta[:n, j], delta_end[j]))
        if n
        else (followed[:0],) * 2
        for j, n in enumerate(count)
    ]


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


def _front_slip(vehicle, speed, delta, low, high, delta_low, delta_high):
    """Front slip of each cell, by Newton's method from the chord, safeguarded by bisection."""
    front, rear = vehicle.front, vehicle.rear
    gain = vehicle.mu * GRAVITY * vehicle.l_wb / speed**2
    width = np.where(delta_high > delta_low, delta_high - delta_low, 1.0)
    s_f = low + (high - low) * (delta - delta_low) / width
    result = s_f.copy()
    active = np.arange(s_f.size)
    for _ in range(100):
        force = front.normalized_force(s_f)
        s_r = rear.slip(force)
        tangent = gain * force - np.tan(s_r)
        residual = s_f + np.arctan(tangent) - delta
        low, high = np.where(residual < 0.0, s_f, low), np.where(residual > 0.0, s_f, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = front.slope(s_f) * (gain - 1.0 / (rear.slope(s_r) * np.cos(s_r) ** 2))
            following = s_f - residual / (1.0 + slope / (1.0 + tangent**2))
            inside = (following >= low) & (following <= high)
        following = np.where(inside, following, 0.5 * (low + high))
        result[active] = following
        going = np.abs(following - s_f) > 1e-12
        if not going.any():
            break
        active, s_f = active[going], following[going]
        gain, delta, low, high = gain[going], delta[going], low[going], high[going]
    return result
