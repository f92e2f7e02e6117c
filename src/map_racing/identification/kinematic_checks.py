"""Checks of pose and steering against the kinematics of slow cornering."""

from __future__ import annotations

import math

import numpy as np

from ..vehicle.parameters import Vehicle
from ..vehicle.size import size_of
from .channels import SensorSetup
from .cornering import ProcessedRun
from .limits import RATE_HZ
from .sensor_findings import SensorFinding, turning_rate

__all__ = [
    "both_sides",
    "check_front_slip",
    "check_lock",
    "check_pose_point",
    "check_steering_gain",
]

# Share of the largest acceleration below which understeer is nearly proportional to it.
LOW_SHARE = 0.45
# Angles beyond this factor times the lock are refused; the margin is for offset and play.
LOCK_MARGIN = 1.05
# Samples per point, and number of independent points per second after the low-pass.
PICK, INDEPENDENT_HZ = 5, 2.0


def check_pose_point(
    motions: list[ProcessedRun], setup: SensorSetup, vehicle: Vehicle
) -> list[SensorFinding]:
    """Check which point of the car the pose tracks, and whether its heading is the car's axis.

    In slow cornering ``beta = d r / v - c a_y + heading offset`` at a point `d` ahead of the rear
    axle, because the rear slip angle is proportional to the acceleration.
    """
    cornering = _low(motions, vehicle)
    if cornering is None:
        return []
    v, r, beta, a_y, sigma = (cornering[key] for key in ("v", "r", "beta", "a_y", "beta_noise"))
    matrix = np.column_stack((r / v, -a_y, np.ones(v.size)))
    both = both_sides(r, vehicle)
    columns = [0, 1, 2] if both else [0, 1]
    solution, error = _regression(matrix[:, columns], beta, sigma)
    findings = []
    d, d_error = solution[0], error[0]
    length = size_of(vehicle).length
    if d_error < length * 0.04 and not _one_speed(v):
        text = f"pose: its point is {d:.3f} +- {d_error:.3f} m ahead of the rear axle"
        fix = {}
        if abs(d - setup.pose_x_m) > max(length * 0.06, 3.0 * d_error):
            guesses = (0.0, vehicle.l_r, vehicle.l_wb)
            near = min(guesses, key=lambda guess: abs(guess - d))
            fix = {"pose_x_m": round(near if abs(near - d) < length * 0.05 else d, 4)}
            text += f", not {setup.pose_x_m:.3f} m"
        findings.append(SensorFinding("pose", text, fix, critical=bool(fix)))
    else:
        text = (
            f"pose: driven at one speed only, its position ({setup.pose_x_m:.3f} m ahead of the "
            "rear axle) cannot be separated from the slip of the rear axle"
        )
        findings.append(SensorFinding("pose", text))
    if both and error[-1] < 0.01:
        offset = solution[-1]
        fix = {}
        if abs(offset) > max(0.003, 3.0 * error[-1]):
            fix = {"heading_offset_rad": round(setup.heading_offset_rad + offset, 4)}
        text = (
            f"heading: {offset:+.4f} +- {error[-1]:.4f} rad off the car's axis, left against right"
        )
        findings.append(SensorFinding("heading", text, fix))
    return findings


def check_steering_gain(
    motions: list[ProcessedRun], setup: SensorSetup, vehicle: Vehicle
) -> list[SensorFinding]:
    """Check gain and offset of the steering against kinematics at low acceleration.

    The road-wheel angle ``gain * signal + offset`` must equal ``atan(l_wb r / v) + K a_y`` with the
    understeer gradient K.
    """
    cornering = _low(motions, vehicle)
    if cornering is None:
        return []
    if not both_sides(cornering["r"], vehicle):
        text = (
            "steering: gain and offset cannot be separated: no slow cornering (below "
            f"{LOW_SHARE:.0%} of the largest acceleration) to both sides"
        )
        return [SensorFinding("steering", text)]
    if _one_speed(cornering["v"]):
        text = "steering: driven at one speed only, its gain cannot be separated from understeer"
        return [SensorFinding("steering", text)]
    gain, gain_error, offset, offset_error = _steering(cornering, vehicle, with_offset=True)
    if math.isinf(gain_error):
        text = "steering: slow cornering does not follow the signal: its gain is unknown"
        return [SensorFinding("steering", text)]
    text = (
        f"steering: wheels turn {gain:.3f} +- {gain_error:.3f} times the signal "
        f"{offset:+.4f} +- {offset_error:.4f} rad"
    )
    fix = {}
    if abs(gain - 1.0) > max(0.05, 3.0 * gain_error) and gain_error < 0.1:
        fix["steering_gain"] = round(setup.steering_gain * gain, 4)
        text += f", or {vehicle.l_wb:.3f} m is not the car's wheelbase"
    if abs(offset) > max(0.003, 3.0 * offset_error):
        scale = gain if "steering_gain" in fix else 1.0
        fix["steering_offset_rad"] = round(setup.steering_offset_rad * scale + offset, 4)
    elif "steering_gain" in fix:
        fix["steering_offset_rad"] = round(setup.steering_offset_rad * gain, 4)
    critical = abs(gain - 1.0) > 0.3 and gain_error < 0.1
    if "steering_gain" in fix:
        beyond = _beyond_lock(motions, vehicle, gain, offset)
        if beyond:
            return [SensorFinding("steering", text + beyond, critical=True)]
    return [SensorFinding("steering", text, fix, critical=critical)]


def _steering(columns, vehicle, with_offset):
    """Gain and offset of the steering with their errors.

    The signal is regressed on the motion. The other way round, the acceleration would explain the
    yaw rate, because the two are nearly proportional.
    """
    geometric = np.arctan(vehicle.l_wb * columns["r"] / columns["v"])
    matrix = [geometric, columns["a_y"]] + [np.ones(geometric.size)] * with_offset
    solution, error = _regression(np.column_stack(matrix), columns["delta"], 0.0)
    inverse = solution[0]
    if abs(inverse) < 0.05:
        return math.inf, math.inf, 0.0, math.inf
    gain, gain_error = 1.0 / inverse, error[0] / inverse**2
    if not with_offset:
        return gain, gain_error, 0.0, 0.0
    return gain, gain_error, -solution[2] / inverse, error[2] / abs(inverse)


def check_front_slip(
    motions: list[ProcessedRun], setup: SensorSetup, vehicle: Vehicle
) -> list[SensorFinding]:
    """Check that the front force opposes the front slip.

    It does not if the front axle moves farther into the bend than its wheels point.
    """
    columns = _cornering(motions)
    if columns is None:
        return []
    v, r, delta, beta, a_y = (columns[key] for key in ("v", "r", "delta", "beta", "a_y"))
    side, hard = np.sign(r), np.abs(a_y) > 0.5 * np.percentile(np.abs(a_y), 98.0)
    if np.count_nonzero(hard) < 10:
        return []
    # Direction of motion by the poses, and without rear slip in case their heading is off.
    moves = np.arctan(np.tan(beta) + (vehicle.l_wb - setup.pose_x_m) * r / v)
    rolls = np.arctan(vehicle.l_wb * r / v)
    missing = min(
        float(np.percentile(((angle - delta) * side)[hard], 75.0)) for angle in (moves, rolls)
    )
    if missing < 0.01:
        return []
    wrong = hard & ((moves - delta) * side > 0.0)
    angle, signal = (float(np.median((values * side)[wrong])) for values in (moves, delta))
    text = (
        f"steering: the signal is {signal:.3f} rad where the front axle moves {angle:.3f} rad "
        "into the bend: the wheels turn more than the signal"
    )
    low = _low(motions, vehicle)
    if both_sides(r, vehicle):
        return _contradiction(low, vehicle, text)
    if low is None or _one_speed(low["v"]):
        text += (
            f"; how much more is unknown without cornering below {LOW_SHARE:.0%} of the largest "
            "acceleration at several speeds, where understeer is proportional"
        )
        return [SensorFinding("front slip", text, critical=True)]
    gain, error, _, _ = _steering(low, vehicle, with_offset=False)
    if not 0.0 < 10.0 * error < gain:
        text += "; these data do not show how much more"
        return [SensorFinding("front slip", text, critical=True)]
    text += f"; if they have no offset, {gain:.3f} +- {error:.3f} times as much"
    fix = {"steering_gain": round(setup.steering_gain * gain, 4)}
    beyond = _beyond_lock(motions, vehicle, gain)
    return [SensorFinding("front slip", text + beyond, {} if beyond else fix, critical=True)]


def _contradiction(low, vehicle, text):
    """Finding on front slip of the wrong sign, if slow cornering to both sides gives the gain."""
    if low is None or not both_sides(low["r"], vehicle) or _one_speed(low["v"]):
        return [SensorFinding("front slip", text, critical=True)]
    gain, error, _, _ = _steering(low, vehicle, with_offset=True)
    if abs(gain - 1.0) > max(0.05, 3.0 * error):
        return []  # check_steering_gain repairs this first
    if math.isinf(error):
        return [SensorFinding("front slip", text, critical=True)]
    text += (
        f", but slow cornering gives {gain:.3f} +- {error:.3f} times the signal: no gain and "
        "offset satisfy both"
    )
    return [SensorFinding("front slip", text, critical=True)]


def check_lock(
    motions: list[ProcessedRun], setup: SensorSetup, vehicle: Vehicle
) -> list[SensorFinding]:
    """Check that the wheels stay within their lock."""
    beyond = _beyond_lock(motions, vehicle, 1.0)
    if not beyond:
        return []
    stated = abs(setup.steering_gain) != 1.0
    text = f"steering: gain {setup.steering_gain:.3f} of the signal{beyond}"
    return [SensorFinding("lock", text, critical=stated)]


def _beyond_lock(motions, vehicle, gain, offset=0.0):
    """Text if a steering gain turns the wheels beyond their lock; empty if not."""
    widest = max(
        (
            float(np.max(np.abs(gain * motion.delta[cut] + offset)))
            for motion in motions
            for cut in motion.segments()
        ),
        default=0.0,
    )
    if widest <= LOCK_MARGIN * vehicle.delta_max:
        return ""
    return (
        f": it turns the wheels to {widest:.3f} rad, beyond their lock of {vehicle.delta_max:.3f} "
        "rad (delta_max of the vehicle), so there must be another cause"
    )


def both_sides(r: np.ndarray, vehicle: Vehicle) -> bool:
    """Whether a substantial share of the yaw rates is to either side.

    Parameters
    ----------
    r : ndarray, shape (n,)
        Yaw rates [rad/s].
    vehicle : Vehicle
        Its size sets the yaw rate that counts as turning.
    """
    turning = turning_rate(size_of(vehicle))
    left = np.count_nonzero(r > 0.5 * turning)
    right = np.count_nonzero(r < -0.5 * turning)
    return min(left, right) > 0.1 * max(left, right, 1)


def _one_speed(v):
    """Whether the speeds vary too little to separate curvature from lateral acceleration."""
    low, middle, high = np.percentile(v, (5.0, 50.0, 95.0))
    return high - low < 0.15 * middle


def _cornering(motions):
    """Points of steady cornering as columns, or None if there are none."""
    columns = {key: [] for key in ("v", "r", "delta", "beta", "a_y")}
    for motion in motions:
        for cut in motion.segments():
            pick = slice(cut.start, cut.stop, PICK)
            for key, values in (
                ("v", motion.v_x),
                ("r", motion.r),
                ("delta", motion.delta),
                ("beta", motion.beta),
                ("a_y", motion.v_x * motion.r),
            ):
                columns[key].append(values[pick])
    if not columns["v"]:
        return None
    return {key: np.concatenate(parts) for key, parts in columns.items()}


def _low(motions, vehicle):
    """Points of steady cornering at low acceleration, or None if there are too few."""
    columns = _cornering(motions)
    if columns is None:
        return None
    largest = np.percentile(np.abs(columns["a_y"]), 98.0)
    slow = 0.2 / size_of(vehicle).time
    low = (np.abs(columns["a_y"]) < LOW_SHARE * largest) & (np.abs(columns["r"]) > slow)
    if np.count_nonzero(low) < 10:
        return None
    columns = {key: values[low] for key, values in columns.items()}
    columns["beta_noise"] = float(np.median([motion.beta_noise for motion in motions]))
    return columns


def _regression(matrix, values, noise):
    """Least squares with standard errors, for two independent points per second."""
    scale = np.maximum(np.abs(matrix).max(axis=0), 1e-9)
    solution = np.linalg.lstsq(matrix / scale, values, rcond=None)[0]
    residual = values - matrix / scale @ solution
    variance = max(float(residual @ residual) / max(values.size - matrix.shape[1], 1), noise**2)
    normal = (matrix / scale).T @ (matrix / scale)
    covariance = np.linalg.pinv(normal) * variance * (RATE_HZ / PICK / INDEPENDENT_HZ)
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if np.linalg.cond(normal) > 1e10:
        error[:] = np.inf
    return solution / scale, error / scale
