"""Checks the sensors of a recording against physics, and proposes repairs.

Steady cornering is overdetermined: lateral acceleration is speed times yaw rate, yaw rate is the
rate of the heading, speed is path per time, a slow car follows Ackermann geometry, and left turns
mirror right turns. Each contradiction is reported with the change of the `SensorSetup` that would
repair it; `kinematic_checks` has the checks of pose and steering.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Callable

import numpy as np

from ..vehicle.parameters import Vehicle
from ..vehicle.single_track import GRAVITY
from ..vehicle.size import size_of
from .channels import SensorSetup
from .clock_checks import check_clocks
from .cornering import RATE_HZ, STANDSTILL_MPS, ProcessedRun
from .kinematic_checks import (
    both_sides,
    check_front_slip,
    check_lock,
    check_pose_point,
    check_steering_gain,
)
from .sensor_findings import SensorFinding, turning_rate
from .usable_runs import is_localized, reason_unsteady

__all__ = ["check", "correct"]

LEAST_STANDING_S = 0.4
# An IMU axis measures lateral acceleration if it follows speed times yaw rate with at least this
# slope (its unit may be g) and this share of its variance explained.
LEAST_SLOPE, LEAST_SHARE = 0.03, 0.6
# A scale or offset of the accelerometer is wrong if it is off by this many standard errors; samples
# per independent one after the low-pass.
SURE, INDEPENDENT = 3.0, RATE_HZ / 2.0
# A lateral velocity is inverted if it differs from the poses by this factor less with the other
# sign; driving that tells it must last this long. Of the right sign the factor is at most 1.1.
INVERTED, LEAST_MOVING_S = 1.3, 10.0
# Corrections after which repair is given up.
MOST_CORRECTIONS = 16


def check(motions: list[ProcessedRun], setup: SensorSetup, vehicle: Vehicle) -> list[SensorFinding]:
    """Check the sensors of all runs of a car together.

    Parameters
    ----------
    motions : list of ProcessedRun
    setup : SensorSetup
        Setup with which the motions were processed.
    vehicle : Vehicle
        Provides the geometry.

    Returns
    -------
    list of SensorFinding
        In the order in which repairs must be made.
    """
    motions = [motion for motion in motions if is_localized(motion)]
    if not motions:
        return []
    findings = []
    for checker in (check_clocks, _heading, _rates):
        findings += checker(motions, setup, vehicle)
        if any(finding.critical for finding in findings):
            # All further checks rely on speed, yaw rate and heading.
            return findings
    for checker in (
        _steering_sign,
        _lateral_axis,
        _lateral_scale,
        check_pose_point,
        check_steering_gain,
        check_front_slip,
        check_lock,
        _lateral_velocity,
        _sides,
        _localization,
    ):
        findings += checker(motions, setup, vehicle)
    return findings


def correct(
    motions_with: Callable, setup: SensorSetup, vehicle: Vehicle
) -> tuple[SensorSetup, list[SensorFinding]]:
    """Repair the setup one contradiction at a time, because each repair affects later checks.

    Parameters
    ----------
    motions_with : callable
        ``motions_with(setup) -> ([(motion, usable), ...], refused)``.
    setup : SensorSetup
    vehicle : Vehicle

    Returns
    -------
    setup : SensorSetup
    corrections : list of SensorFinding
    """
    corrections = []
    while len(corrections) < MOST_CORRECTIONS:
        motions = [motion for motion, _ in motions_with(setup)[0]]
        findings = check(motions, setup, vehicle)
        todo = next((finding for finding in findings if finding.fix), None)
        if todo is None:
            break
        corrections.append(todo)
        setup = dataclasses.replace(setup, **todo.fix)
    return setup, corrections


def _heading(motions, setup, vehicle):
    """Check that the heading points forwards."""
    beta = np.abs(_pooled(motions, "beta", "moving"))
    if np.median(beta) < 0.5 * math.pi:
        return []
    turned = math.remainder(setup.heading_offset_rad + math.pi, 2.0 * math.pi)
    return [
        SensorFinding(
            "heading",
            f"heading: the pose moves {np.median(beta):.2f} rad off its heading, which points "
            "backwards",
            {"heading_offset_rad": turned},
            critical=True,
        )
    ]


def _rates(motions, setup, vehicle):
    """Check yaw rate against the rate of the heading, and speed against path per time."""
    r, turning = _pooled(motions, "r", "moving"), _pooled(motions, "heading_rate", "moving")
    turns = np.abs(turning) > turning_rate(size_of(vehicle))
    v, path = _pooled(motions, "v_x", "moving"), _pooled(motions, "path_speed", "moving")
    drives = path > STANDSTILL_MPS
    if np.count_nonzero(turns) < RATE_HZ or np.count_nonzero(drives) < RATE_HZ:
        return []
    yaw, speed = np.median(r[turns] / turning[turns]), np.median(v[drives] / path[drives])
    findings = []
    if min(abs(yaw), abs(speed)) < 0.1:
        what = "yaw rate" if abs(yaw) < 0.1 else "speed"
        text = (
            f"{what}: {min(abs(yaw), abs(speed)):.2f} times that of the poses: it measures "
            "something else, and can be left out of the channel map, unless a unit is wrong"
        )
        return [SensorFinding(what, text, critical=True)]
    if yaw < 0.0:
        text = "yaw rate: its sign is opposite to the rate of the heading"
        fix = {"yaw_rate_scale": -setup.yaw_rate_scale}
        return [SensorFinding("yaw rate", text, fix, critical=True)]
    if speed < 0.0:
        text = "speed: negative where the car drives forwards"
        return [SensorFinding("speed", text, {"speed_scale": -setup.speed_scale}, critical=True)]
    yaw_off, speed_off = abs(yaw - 1.0), abs(speed - 1.0)
    if min(yaw_off, speed_off) > 0.05 and abs(yaw - speed) < 0.5 * min(yaw_off, speed_off):
        text = (
            f"time: yaw rate is {yaw:.3f} times the heading's rate and speed {speed:.3f} times "
            f"the path per time: a second of the recording lasts {1.0 / yaw:.3f} s"
        )
        fix = {"time_scale": round(setup.time_scale / yaw, 4)}
        return [SensorFinding("time", text, fix, critical=True)]
    text = f"yaw rate: {yaw:.3f} times the rate of the heading"
    fix = {"yaw_rate_scale": round(setup.yaw_rate_scale / yaw, 4)} if yaw_off > 0.05 else {}
    findings.append(SensorFinding("yaw rate", text, fix, critical=yaw_off > 0.2))
    text = f"speed: {speed:.3f} times the path per time"
    fix = {"speed_scale": round(setup.speed_scale / speed, 4)} if speed_off > 0.05 else {}
    findings.append(SensorFinding("speed", text, fix, critical=speed_off > 0.2))
    return findings


def _steering_sign(motions, setup, vehicle):
    delta, r = _pooled(motions, "delta", "moving"), _pooled(motions, "r", "moving")
    turns = np.abs(r) > turning_rate(size_of(vehicle))
    if np.count_nonzero(turns) < RATE_HZ or np.median(delta[turns] * r[turns]) >= 0.0:
        return []
    fix = {
        "steering_gain": -setup.steering_gain,
        "steering_offset_rad": -setup.steering_offset_rad,
    }
    return [
        SensorFinding(
            "steering", "steering: its sign is opposite to the yaw rate", fix, critical=True
        )
    ]


def _lateral_axis(motions, setup, vehicle):
    """Check which axis of the IMU measures the lateral acceleration, and its sign."""
    motions = [motion for motion in motions if motion.axes and motion.acceleration == "imu"]
    if not motions:
        return []
    expected = _expected(motions, "steady")
    if expected.size < RATE_HZ or np.percentile(np.abs(expected), 90) < 1.0:
        return []
    fits = {}
    for axis in sorted(set.intersection(*(set(motion.axes) for motion in motions))):
        values = np.concatenate([motion.axes[axis][motion.steady] for motion in motions])
        fits[axis] = _line(expected, values)

    def follows(axis):
        slope, _, share = fits.get(axis, (0.0, 0.0, 0.0))
        return abs(slope) > LEAST_SLOPE and share > LEAST_SHARE

    own = setup.lateral_axis
    low, middle, high = np.percentile(expected, (5.0, 50.0, 95.0))
    if high - low < abs(middle) and own in fits and not follows(own):
        # Bends to one side at about one acceleration show no slope; compare the level instead.
        there = np.median(np.concatenate([motion.axes[own][motion.steady] for motion in motions]))
        if 0.5 < setup.lateral_scale * there / middle < 2.0:
            return []
    if not follows(own):
        best = max((axis for axis in fits if follows(axis)), key=lambda a: fits[a][2], default=None)
        there = np.concatenate([m.axes[own] for m in motions if own in m.axes] or [np.zeros(1)])
        heavy = abs(abs(np.median(there)) - GRAVITY) < 2.0
        why = f" (gravity is on its {own} axis)" if heavy else ""
        text = f"lateral acceleration: a_{own} does not follow speed times yaw rate{why}, "
        if best is None:
            text += "nor does another axis: use speed times yaw rate (--acceleration yaw_rate)"
            return [SensorFinding("lateral acceleration", text, critical=True)]
        slope = fits[best][0]
        fix = {
            "lateral_axis": best,
            "lateral_scale": math.copysign(1.0, slope),
            "lateral_offset_mps2": 0.0,
        }
        text += f"a_{best} does, {slope:.2f} times"
        return [SensorFinding("lateral acceleration", text, fix, critical=True)]
    slope = fits[own][0] * setup.lateral_scale
    if slope > 0.0:
        return []
    text = f"lateral acceleration: a_{own} is {slope:.2f} times speed times yaw rate: its sign is "
    text += "wrong"
    fix = {
        "lateral_scale": -setup.lateral_scale,
        "lateral_offset_mps2": -setup.lateral_offset_mps2,
    }
    return [SensorFinding("lateral acceleration", text, fix, critical=True)]


def _lateral_scale(motions, setup, vehicle):
    """Check scale and offset of the accelerometer; body roll appears as a scale."""
    motions = [motion for motion in motions if motion.axes and motion.acceleration == "imu"]
    if not motions:
        return []
    expected = _expected(motions, "usable")
    if expected.size < RATE_HZ or np.ptp(expected) < 1.0:
        return []
    a_y = np.concatenate([motion.a_y[motion.usable] for motion in motions])
    standing = [motion.a_y[_standing(motion)] for motion in motions]
    standing = np.concatenate([values for values in standing if values.size] or [np.zeros(0)])
    if standing.size <= LEAST_STANDING_S * RATE_HZ:
        standing = None
    slope, offset, slope_error, offset_error = _scale_and_offset(expected, a_y, standing)
    scaled = slope > 0.0 and abs(slope - 1.0) > max(0.03, SURE * slope_error)
    shifted = abs(offset) > max(0.05, SURE * offset_error)
    text = f"lateral acceleration: {slope:.3f} times speed times yaw rate {offset:+.3f} m/s^2"
    if not (scaled or shifted) and max(slope_error, 0.1 * offset_error) > 0.03:
        text += f" (+- {slope_error:.3f} and {offset_error:.3f}: too little cornering to tell)"
    fix = {}
    if scaled or shifted:
        scale = slope if scaled else 1.0
        fix = {
            "lateral_scale": round(setup.lateral_scale / scale, 4),
            "lateral_offset_mps2": round((setup.lateral_offset_mps2 - offset) / scale, 4),
        }
        if scaled and 0.0 < slope - 1.0 < 0.2:
            roll = (slope - 1.0) / GRAVITY
            text += f": the body rolls {math.degrees(roll):.2f} degrees per m/s^2"
    critical = (scaled and abs(slope - 1.0) > 0.25) or (shifted and abs(offset) > 0.75)
    return [SensorFinding("lateral acceleration", text, fix, critical)]


def _scale_and_offset(expected, measured, standing):
    """Slope and offset of a line, and their standard errors.

    The offset is taken at standstill if known. The low-pass leaves about two independent samples
    per second.
    """
    count = max(expected.size / INDEPENDENT, 1.0)
    if standing is not None:
        offset = float(np.median(standing))
        slope = float((measured - offset) @ expected / (expected @ expected))
        left = float(np.std(measured - offset - slope * expected))
        slope_error = left / math.sqrt(count * float(np.mean(expected**2)))
        return slope, offset, slope_error, float(np.std(standing))
    slope, offset, _ = _line(expected, measured)
    left = float(np.std(measured - offset - slope * expected))
    left *= math.sqrt(count / max(count - 2.0, 0.1))
    slope_error = left / (math.sqrt(count) * max(float(np.std(expected)), 1e-9))
    mean = float(np.mean(expected))
    return slope, offset, slope_error, math.hypot(left / math.sqrt(count), mean * slope_error)


def _lateral_velocity(motions, setup, vehicle):
    """Compare the lateral velocity of the odometry with the poses."""
    motions = [motion for motion in motions if motion.v_y_odometry is not None]
    if not motions:
        return []
    inverted = _inverted_lateral_velocity(motions)
    if inverted:
        return inverted
    own = np.concatenate([motion.v_y_odometry[motion.usable] for motion in motions])
    if own.size < RATE_HZ:
        return []
    poses = np.concatenate([(m.v_x * np.tan(m.beta))[m.usable] for m in motions])
    text = (
        f"lateral velocity: odometry differs from the poses, which are used, by "
        f"{np.sqrt(np.mean((own - poses) ** 2)):.3f} m/s RMS"
    )
    return [SensorFinding("lateral velocity", text)]


def _inverted_lateral_velocity(motions):
    """Whether the lateral velocity follows the poses better with the other sign.

    What both may differ by beside the sign, a velocity of another point of the car, is proportional
    to the yaw rate. Only ordinary driving uses the lateral velocity of the odometry.
    """
    used = [
        motion.moving & motion.coherent & np.isfinite(motion.beta + motion.v_y_odometry)
        for motion in motions
    ]
    if sum(map(np.count_nonzero, used)) < LEAST_MOVING_S * RATE_HZ:
        return []
    own, poses, r = (
        np.concatenate([values[k] for values, k in zip(columns, used)])
        for columns in (
            [motion.v_y_odometry for motion in motions],
            [motion.v_x * np.tan(motion.beta) for motion in motions],
            [motion.r for motion in motions],
        )
    )
    rest = np.column_stack((r, np.ones(r.size)))
    left = {}
    for sign in (1.0, -1.0):
        off = own - sign * poses
        left[sign] = float(np.std(off - rest @ np.linalg.lstsq(rest, off, rcond=None)[0]))
    if left[1.0] < INVERTED * left[-1.0]:
        return []
    text = (
        "lateral velocity: that of the odometry is opposite to that of the poses, from which it "
        f"differs by {left[-1.0]:.3f} m/s RMS with the other sign, and by {left[1.0]:.3f} m/s as "
        "it is"
    )
    critical = any(map(reason_unsteady, motions))
    return [SensorFinding("lateral velocity", text, critical=critical)]


def _sides(motions, setup, vehicle):
    r = _pooled(motions, "r", "usable")
    if r.size < RATE_HZ or both_sides(r, vehicle):
        return []
    side = "left" if np.median(r) > 0.0 else "right"
    text = f"sides: steady cornering to the {side} only, which hides offsets of the sensors"
    return [SensorFinding("sides", text)]


def _localization(motions, setup, vehicle):
    findings = []
    for motion in motions:
        lost = np.count_nonzero(motion.moving & ~motion.coherent) / RATE_HZ
        driven = np.count_nonzero(motion.moving) / RATE_HZ
        if lost > 0.1 * driven:
            text = (
                f"localization: {motion.run.label}: speed or yaw rate disagree with the car's "
                f"sensors in {lost:.1f} of {driven:.1f} s, which are left out"
            )
            findings.append(SensorFinding("localization", text))
        spikes = {name: share for name, share in motion.spikes.items() if share > 0.02}
        if spikes:
            shares = ", ".join(f"{share:.0%} of {name}" for name, share in spikes.items())
            findings.append(
                SensorFinding("spikes", f"spikes: {motion.run.label}: {shares} left out")
            )
        if abs(motion.clock_offset_s) > 0.03 and motion.segments():
            text = (
                f"clock: {motion.run.label}: the clock of the poses was shifted by "
                f"{motion.clock_offset_s:+.2f} s to match the yaw rates"
            )
            findings.append(SensorFinding("clock", text))
    return findings


def _pooled(motions, name, mask):
    return np.concatenate([getattr(motion, name)[getattr(motion, mask)] for motion in motions])


def _expected(motions, mask):
    """Lateral acceleration in steady state."""
    return np.concatenate([(m.v_x * m.r)[getattr(m, mask)] for m in motions])


def _standing(motion):
    """Where the car stands, except just after stopping, when the body still moves."""
    still = (np.abs(motion.v_x) < STANDSTILL_MPS) & (np.abs(motion.r) < 0.05)
    still &= np.any([axis != 0.0 for axis in motion.axes.values()], axis=0)
    margin = np.ones(round(RATE_HZ) + 1)
    if still.size < margin.size:
        return np.zeros_like(still)
    return np.convolve(~still, margin, mode="same") < 0.5


def _line(x, y):
    """Slope and intercept of y over x, and the share of the variance that they explain."""
    centered = x - x.mean()
    variance = float(centered @ centered)
    if variance < 1e-9 or np.ptp(y) < 1e-9:
        return 0.0, float(y.mean()), 0.0
    slope = float(centered @ y) / variance
    residual = y - y.mean() - slope * centered
    share = 1.0 - float(residual @ residual) / float((y - y.mean()) @ (y - y.mean()))
    return slope, float(y.mean() - slope * x.mean()), share
