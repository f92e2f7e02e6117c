"""The single-track (bicycle) model of the paper: two tires, lateral and yaw dynamics.

State at the center of gravity: lateral velocity ``v_y`` and yaw rate ``r``; the forward velocity
``v_x`` is an input. As printed in the paper, without cosines of the steering angle::

    v_y' = (F_yf + F_yr) / m - v_x r
    r'   = (l_f F_yf - l_r F_yr) / I_z

    alpha_f = atan((v_y + r l_f) / v_x) - delta        F_yf = -mu F_zf P_f(alpha_f)
    alpha_r = atan((v_y - r l_r) / v_x)                F_yr = -mu F_zr P_r(alpha_r)

    F_zf = (m g l_r - m a_long h_cg) / (l_f + l_r)
    F_zr = (m g l_f + m a_long h_cg) / (l_f + l_r)

Signs as in `tires`: the force points against the slip.
"""

from __future__ import annotations

import math

import numpy as np

from .tires import PacejkaTire

__all__ = [
    "GRAVITY",
    "V_EPS",
    "axle_loads",
    "fastest_mode",
    "single_track_derivatives",
    "slip_angles",
]

GRAVITY = 9.81
"""Acceleration of gravity [m/s^2]."""

V_EPS = 0.75
"""Forward wheel speed [m/s] below which slip angles are damped instead of growing with 1/v.

The fastest mode of ``nuc4``, which has a very stiff rear tire, decays with 741 m/s^2 / v. At this
speed that is 988 1/s, which RK4 integrates with steps up to 2.8 ms; with 0.5 m/s, 2 ms would
diverge.
"""


def axle_loads(vehicle, a_long):
    """Vertical loads with longitudinal load transfer.

    Parameters
    ----------
    vehicle : Vehicle
    a_long : float or ndarray
        Longitudinal acceleration [m/s^2], positive forwards.

    Returns
    -------
    F_zf, F_zr : float or ndarray
        Load of the front and of the rear axle [N]; their sum is the weight.
    """
    transfer = a_long * vehicle.h_cg
    scale = vehicle.m / vehicle.l_wb
    return (
        scale * (GRAVITY * vehicle.l_r - transfer),
        scale * (GRAVITY * vehicle.l_f + transfer),
    )


def fastest_mode(vehicle):
    """Decay rate of the faster mode of straight running at low speed, times the speed.

    At higher speeds this product is at most a few percent larger for an oversteering car, and
    smaller for other cars.

    Parameters
    ----------
    vehicle : Vehicle

    Returns
    -------
    float
        The rate [1/s] at a speed v [m/s] is this over v [m/s^2].
    """
    F_zf, F_zr = axle_loads(vehicle, 0.0)
    stiff_f = vehicle.mu * F_zf * vehicle.front.stiffness
    stiff_r = vehicle.mu * F_zr * vehicle.rear.stiffness
    coupling = vehicle.l_f * stiff_f - vehicle.l_r * stiff_r
    damping = vehicle.l_f**2 * stiff_f + vehicle.l_r**2 * stiff_r
    rates = np.linalg.eigvals(
        [
            [(stiff_f + stiff_r) / vehicle.m, coupling / vehicle.m],
            [coupling / vehicle.I_z, damping / vehicle.I_z],
        ]
    )
    return float(np.max(np.abs(rates)))


def slip_angles(vehicle, v_x, v_y, r, delta, v_eps=V_EPS):
    """Slip angles of both axles, defined at every speed.

    The velocity of each axle is expressed in the frame of its wheel, with the forward component
    bounded away from zero: ``alpha = atan2(v_lateral, max(v_forward, v_eps))``. If the wheel rolls
    forwards faster than `v_eps`, these are exactly the paper's angles. They are 0 at rest, even
    with the wheels turned. A reversing car stays on the circle of its wheels: its tires act stiffer
    than real ones, with which it would swap ends above a few m/s.

    Parameters
    ----------
    vehicle : Vehicle
    v_x, v_y : float or ndarray
        Velocity of the center of gravity [m/s] in the body frame.
    r : float or ndarray
        Yaw rate [rad/s].
    delta : float or ndarray
        Steering angle [rad].
    v_eps : float
        Smallest forward wheel speed [m/s] to divide by.

    Returns
    -------
    alpha_f, alpha_r : float or ndarray
        Slip angle of the front and of the rear axle [rad], negative in a left turn.
    """
    v_yf = v_y + r * vehicle.l_f
    v_yr = v_y - r * vehicle.l_r
    cosine, sine = np.cos(delta), np.sin(delta)
    return (
        np.arctan2(v_yf * cosine - v_x * sine, np.maximum(v_x * cosine + v_yf * sine, v_eps)),
        np.arctan2(v_yr, np.maximum(v_x, v_eps)),
    )


def single_track_derivatives(vehicle, v_eps=V_EPS):
    """The right-hand side as a fast function of plain floats, for integration in a loop.

    It equals the equations of the module's docstring with the slip angles of `slip_angles`; one
    call takes 0.8 us on CPython 3.11.

    Parameters
    ----------
    vehicle : Vehicle
    v_eps : float
        Smallest forward wheel speed [m/s] to divide by, see `slip_angles`.

    Returns
    -------
    callable
        ``derivatives(v_x, v_y, r, delta, a_long) -> (v_y_dot, r_dot)`` with [m/s], [m/s], [rad/s],
        [rad], [m/s^2] and [m/s^2], [rad/s^2].
    """
    front, rear = vehicle.front.scalar(), vehicle.rear.scalar()
    m, I_z, l_f, l_r = vehicle.m, vehicle.I_z, vehicle.l_f, vehicle.l_r
    # -mu F_z of both axles is affine in a_long
    front_0 = -vehicle.mu * axle_loads(vehicle, 0.0)[0]
    rear_0 = -vehicle.mu * axle_loads(vehicle, 0.0)[1]
    transfer = vehicle.mu * m * vehicle.h_cg / vehicle.l_wb
    atan2, cos, sin, atan = math.atan2, math.cos, math.sin, math.atan

    if isinstance(vehicle.front, PacejkaTire) and isinstance(vehicle.rear, PacejkaTire):
        # The same with both tires inlined: function calls take a quarter of a race's time.
        B_f, C_f, D_f, E_f = (getattr(vehicle.front, name) for name in "BCDE")
        B_r, C_r, D_r, E_r = (getattr(vehicle.rear, name) for name in "BCDE")

        def pacejka_derivatives(v_x, v_y, r, delta, a_long):
            v_yf = v_y + r * l_f
            cosine = cos(delta)
            sine = sin(delta)
            forward = v_x * cosine + v_yf * sine
            x_f = B_f * atan2(v_yf * cosine - v_x * sine, forward if forward > v_eps else v_eps)
            x_r = B_r * atan2(v_y - r * l_r, v_x if v_x > v_eps else v_eps)
            F_yf = (front_0 + transfer * a_long) * (
                D_f * sin(C_f * atan(x_f - E_f * (x_f - atan(x_f))))
            )
            F_yr = (rear_0 - transfer * a_long) * (
                D_r * sin(C_r * atan(x_r - E_r * (x_r - atan(x_r))))
            )
            return (F_yf + F_yr) / m - v_x * r, (l_f * F_yf - l_r * F_yr) / I_z

        return pacejka_derivatives

    def derivatives(v_x, v_y, r, delta, a_long):
        v_yf = v_y + r * l_f
        cosine = cos(delta)
        sine = sin(delta)
        forward = v_x * cosine + v_yf * sine
        alpha_f = atan2(v_yf * cosine - v_x * sine, forward if forward > v_eps else v_eps)
        alpha_r = atan2(v_y - r * l_r, v_x if v_x > v_eps else v_eps)
        F_yf = (front_0 + transfer * a_long) * front(alpha_f)
        F_yr = (rear_0 - transfer * a_long) * rear(alpha_r)
        return (F_yf + F_yr) / m - v_x * r, (l_f * F_yf - l_r * F_yr) / I_z

    return derivatives
