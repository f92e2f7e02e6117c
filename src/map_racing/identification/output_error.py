"""The single-track model driven by recorded commands, and its fit to what was measured.

This is the output-error method: the model runs freely through a window, driven by the speed and the
commands alone, and its yaw rate, lateral acceleration and lateral velocity are compared with the
measured ones. The servo between command and wheels has a dead time and a first-order lag within the
vehicle's steering rate. All windows, and the parameter steps for the Jacobian, are integrated side
by side as columns of arrays, by a linearly implicit trapezoidal rule, which is stable however stiff
the tires are (Rosenbrock, 1963).
"""

from __future__ import annotations

import numpy as np

from ..vehicle.parameters import Vehicle
from ..vehicle.single_track import GRAVITY
from ..vehicle.tires import PacejkaTire
from .driving import LONGEST_DELAY_S, Windows
from .robust_fit import Believed, Fitted, fit, own_fits

__all__ = ["NAMES", "at_sensors", "believed", "fit_car", "own_errors", "simulate"]

NAMES = (
    "front",
    "rear",
    "grip",
    "delay",
    "share",
    "gain",
    "offset",
    "inertia",
    "height",
    "shape",
    "bend",
)
"""Names of the parameters.

``front``, ``rear``, ``grip``, ``gain`` and ``inertia`` are logarithms of factors on the cornering
stiffness of each axle, the grip, the steering gain and the moment of inertia. ``delay`` is the sum
of dead time and lag of the steering [s], ``share`` the lag's share of it, ``offset`` the steering
offset [rad], ``height`` the height of the center of gravity above the vehicle file's value [m].
``shape``, the logarithm of a factor on C of both tires, and ``bend``, which is added to their E,
change the curve between its slope at zero slip and its peak."""

# Delays from which the search starts [s]; the better result is used.
START_DELAYS = (0.03, 0.08)
# First guess of the noise, before residuals are known.
NOISE = {"r": 0.05, "a_y": 0.4, "v_y": 0.08}


def believed(**spreads: float) -> dict[str, Believed]:
    """Priors of the parameters.

    Parameters
    ----------
    **spreads : float
        Standard deviations around the vehicle's parameters, instead of the usual ones; 0 holds a
        parameter. The prior of ``share`` is around a half.
    """
    usual = {
        "front": (0.0, 0.4, -2.5, 2.5, 1e-3),
        "rear": (0.0, 0.6, -2.5, 2.5, 1e-3),
        "grip": (0.0, 0.15, -1.2, 0.8, 1e-3),
        "delay": (0.0, 10.0, 0.0, LONGEST_DELAY_S - 0.01, 2e-4),
        "share": (0.5, 0.5, 0.0, 0.99, 1e-2),
        "gain": (0.0, 0.02, -0.7, 0.7, 1e-3),
        "offset": (0.0, 0.02, -0.2, 0.2, 1e-4),
        "inertia": (0.0, 0.25, -1.2, 1.2, 1e-3),
        "height": (0.0, 0.02, -0.05, 0.1, 1e-3),
        "shape": (0.0, 0.0, -0.5, 0.5, 1e-3),
        "bend": (0.0, 0.0, -3.0, 1.0, 1e-3),
    }
    return {
        name: Believed(values[0], spreads.get(name, values[1]), *values[2:])
        for name, values in usual.items()
    }


def simulate(vehicle: Vehicle, windows: Windows, theta: np.ndarray) -> dict[str, np.ndarray]:
    """Drive a car through windows by its recorded commands and speed.

    Parameters
    ----------
    vehicle : Vehicle
    windows : Windows
    theta : ndarray, shape (p, 11)
        Sets of parameters, see `NAMES`.

    Returns
    -------
    dict of str to ndarray, shape (K + 1, p, n)
        Yaw rate ``r`` [rad/s], lateral velocity ``v_y`` [m/s] and lateral acceleration ``a_y``
        [m/s^2] of the center of gravity at each step of each window.
    """
    theta = np.atleast_2d(theta)
    h, steps = windows.step, windows.steps
    delta, ahead = _wheels(vehicle, windows, theta)
    shape = delta.shape[1:]
    m, l_f, l_r = vehicle.m, vehicle.l_f, vehicle.l_r
    I_z = _spread(vehicle.I_z * np.exp(theta[:, 7])[:, None], shape)
    # Both axles side by side in arrays of one shape: this halves the number of NumPy calls and
    # avoids broadcasting, which takes most of the time.
    curve = _curves(vehicle, theta, shape)
    arm = _spread(np.array([l_f, -l_r])[:, None, None], (2, *shape))
    F = _loads(vehicle, windows, theta)
    v = _spread(windows.v_x[:, None, :], delta.shape)
    half = 0.5 * h
    v_next = half * (v[1:] - v[:-1]) / h
    r = np.broadcast_to(windows.r_0, shape).copy()
    v_y = l_r * r
    out_r, out_vy, out_ay = (np.empty((steps + 1, *shape)) for _ in range(3))
    out_r[0], out_vy[0] = r, v_y
    for k in range(steps + 1):
        v_k, F_k, a_y = v[k], F[k], out_ay[k]
        tan = (v_y + arm * r) / v_k
        alpha = np.arctan(tan)
        alpha[0] -= delta[k]
        P, S = curve(alpha)
        # Forces, positive to the right, and their slopes over v_y.
        P = F_k * P
        P_f, P_r = P
        np.divide(P_f + P_r, -m, out=a_y)
        if k == steps:
            break
        steep = v_k * (1.0 + tan * tan)
        S = F_k * S / steep
        T = arm * S
        U = arm * T
        S_f, T_f = S[0], T[0]
        moment = T_f + T[1]
        # The wheels keep turning: change of the front force at their mean angle over the step.
        turned = ahead[k] * S_f * steep[0]
        f_1 = h * (a_y + turned / m - v_k * r - v_next[k] * r)
        f_2 = h * (l_f * (turned - P_f) + l_r * P_r) / I_z
        # I - h/2 J = [[p, s], [u, q]], with the Jacobian J of (v_y', r').
        p, q = 1.0 + half * ((S_f + S[1]) / m), 1.0 + half * ((U[0] + U[1]) / I_z)
        s, u = half * (moment / m + v_k), half * (moment / I_z)
        det = p * q - s * u
        v_y = v_y + (q * f_1 - s * f_2) / det
        r = r + (p * f_2 - u * f_1) / det
        out_r[k + 1], out_vy[k + 1] = r, v_y
    return {"r": out_r, "v_y": out_vy, "a_y": out_ay}


def _spread(values, shape):
    """Values repeated to a shape."""
    return np.ascontiguousarray(np.broadcast_to(values, shape))


def _loads(vehicle, windows, theta):
    """Friction times load of both axles at each step, shape (K + 1, 2, p, n)."""
    a_long = windows.a_long[:, None, :]
    transfer = np.maximum(vehicle.h_cg + theta[:, 8], 0.0)[:, None] * a_long
    loads = np.stack((GRAVITY * vehicle.l_r - transfer, GRAVITY * vehicle.l_f + transfer), axis=1)
    return vehicle.mu * np.exp(theta[:, 2])[:, None] * (vehicle.m / vehicle.l_wb) * loads


def at_sensors(
    vehicle: Vehicle, windows: Windows, simulated: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Transform the result of `simulate` to the positions of the sensors.

    Parameters
    ----------
    vehicle : Vehicle
    windows : Windows
    simulated : dict of str to ndarray, shape (K + 1, p, n)

    Returns
    -------
    dict of str to ndarray, shape (K + 1, p, n)
        ``r``, ``v_y`` of the localized point, and ``a_y`` of the IMU.
    """
    places = []
    for setup in (drive.setup for drive in windows.drives):
        imu_x = vehicle.l_r if setup.imu_x_m is None else setup.imu_x_m
        places.append((setup.pose_x_m - vehicle.l_r, imu_x - vehicle.l_r, setup.imu_y_m))
    ahead, imu_ahead, imu_left = np.array(places).T[:, windows.drive]
    r, a_y = simulated["r"], simulated["a_y"]
    if imu_ahead.any() or imu_left.any():
        a_y = a_y + np.gradient(r, windows.step, axis=0) * imu_ahead - r * r * imu_left
    return {"r": r, "v_y": simulated["v_y"] + r * ahead, "a_y": a_y}


def _wheels(vehicle, windows, theta):
    """Wheel angle at each step, and by how much its mean over the step exceeds it."""
    total, share, gain, offset = theta[:, 3], theta[:, 4], np.exp(theta[:, 5]), theta[:, 6]
    command = windows.commands("steering", total * (1.0 - share))
    # The lock is that of the wheels, which commands that turn them less, or shifted ones, pass only
    # in number.
    lock = (vehicle.delta_max * np.maximum(gain, 1.0) + np.abs(offset))[:, None]
    command = np.clip(gain[:, None] * command + offset[:, None], -lock, lock)
    lag = np.maximum(total * share, 1e-6)[:, None]
    follow = -np.expm1(-windows.step / lag)
    # Mean of an exponential approach; a turn at full rate is halfway on average.
    mean = 1.0 / follow - lag / windows.step
    slew = vehicle.delta_rate_max * windows.step
    follow = _spread(follow, command.shape[1:])
    delta = np.empty((windows.steps + 1, *command.shape[1:]))
    wanted, moves = np.empty_like(command), np.empty_like(command)
    delta[0] = command[0]
    for k in range(windows.steps):
        np.multiply(command[k] - delta[k], follow, out=wanted[k])
        np.minimum(np.maximum(wanted[k], -slew), slew, out=moves[k])
        np.add(delta[k], moves[k], out=delta[k + 1])
    ahead = np.where(moves == wanted, mean, 0.5) * moves
    return delta, ahead


def _curves(vehicle, theta, shape):
    """Function from slip angles, shape (2, p, n), to normalized forces and slopes of both tires.

    Slopes at zero slip and C are scaled by factors, and E is shifted.
    """
    tires = vehicle.front, vehicle.rear
    front, rear, grip, wide = (np.exp(theta[:, i])[:, None] for i in (0, 1, 2, 9))
    factors, added = np.stack((front, rear)) / grip, theta[:, 10][:, None]

    def each(name):
        return np.array([getattr(tire, name) for tire in tires])[:, None, None]

    def full(values):
        return _spread(values, (2, *shape))

    if not isinstance(vehicle.front, PacejkaTire):
        slope = full(each("C_S") * factors)

        def linear(alpha):
            return slope * alpha, slope

        return linear
    B, C, D = (full(each(name)) for name in "BCD")
    B, C = B * factors / wide, C * wide
    E = full(np.minimum(each("E") + added, np.maximum(each("E"), 1.0)))
    stiffness, unbent = B * C * D, 1.0 - E

    def pacejka(alpha):
        x = B * alpha
        atan = np.arctan(x)
        y = x - E * (x - atan)
        phase = C * np.arctan(y)
        bend = (1.0 + unbent * x * x) / (1.0 + x * x)
        return D * np.sin(phase), stiffness * np.cos(phase) * bend / (1.0 + y * y)

    return pacejka


def fit_car(
    vehicle: Vehicle,
    windows: Windows,
    beliefs: dict[str, Believed] | None = None,
    near: Fitted | None = None,
) -> Fitted:
    """Fit tires, steering and delays of a car to what was measured in windows.

    Parameters
    ----------
    vehicle : Vehicle
        The car, whose parameters are the center of the prior.
    windows : Windows
    beliefs : dict of str to Believed, optional
        See `believed`.
    near : Fitted, optional
        Fit to start from.

    Returns
    -------
    Fitted
        Parameters are `NAMES`.
    """
    starts = [{"delay": delay} for delay in START_DELAYS]
    if near is not None:
        starts = [dict(zip(near.names, near.values))]
    observed = windows.observed
    return fit(_predictor(vehicle, windows), observed, beliefs or believed(), starts, NOISE)


def own_errors(
    vehicle: Vehicle,
    windows: Windows,
    beliefs: dict[str, Believed],
    fitted: Fitted,
    parts: list[np.ndarray],
) -> list[tuple[float, float]]:
    """What a fit leaves of the yaw rate in parts of the windows, and what fits of their own would.

    Parameters
    ----------
    vehicle, windows, beliefs
        As of `fit_car`.
    fitted : Fitted
        To all windows.
    parts : list of ndarray of bool, shape (n,)
        Windows of each part.

    Returns
    -------
    list of tuple of float
        Standard deviations without outliers [rad/s].
    """
    predict = _predictor(vehicle, windows)
    return own_fits(predict, windows.observed, beliefs, fitted, "r", parts)


def _predictor(vehicle, windows):
    """What `fit` needs: the measurements that parameters predict."""

    def predict(lanes):
        found = at_sensors(vehicle, windows, simulate(vehicle, windows, lanes))
        return {name: windows.at(name, found[name]) for name in windows.observed}

    return predict
