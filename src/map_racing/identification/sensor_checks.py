"""Do the sensors of a recording agree with physics, and if not, what would repair it?

Steady cornering is overdetermined: lateral acceleration is speed times yaw rate, yaw rate is the
turning of the heading, speed is path per time, a slowly rolling car follows Ackermann, and a car
that turns left and right is the same car. Whatever contradicts that is reported with the change of
the `SensorSetup` that would repair it.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field

import numpy as np

from ..vehicle.single_track import GRAVITY
from .cornering import RATE_HZ, STANDSTILL_MPS

__all__ = ["SensorFinding", "check", "correct", "reason_to_refuse"]

TURNING_RADPS = 0.3
LEAST_USABLE_S = 2.0
LEAST_STANDING_S = 0.4
# Wheels turn less [rad].
LARGEST_ANGLE = 1.0
# Of the largest acceleration: below it, understeer is nearly proportional.
LOW_SHARE = 0.45
# Of the ratios between localization and sensors in one run, beyond which no constant explains them.
LARGEST_SPREAD = 0.35
# An axis of the IMU follows speed times yaw rate with at least this slope (its unit may be g) and
# this share of its variance explained.
LEAST_SLOPE, LEAST_SHARE = 0.03, 0.6
# A setup that still contradicts itself then is beyond repair, and stays reported.
MOST_CORRECTIONS = 16
PICK = 5  # samples per point: the low-pass leaves neighbors dependent


@dataclass(frozen=True)
class SensorFinding:
    """What one check says.

    Parameters
    ----------
    check : str
        Name of the check.
    text : str
        The measurement, in one line.
    fix : dict
        Changes of the `SensorSetup` that would repair a contradiction; empty if all is well.
    critical : bool
        Whether tires identified without the repair would be wrong from the ground up.
    """

    check: str
    text: str
    fix: dict = field(default_factory=dict)
    critical: bool = False

    def __post_init__(self):
        plain = {k: v if isinstance(v, str) else float(v) for k, v in self.fix.items()}
        object.__setattr__(self, "fix", plain)
        object.__setattr__(self, "critical", bool(self.critical))

    @property
    def contradiction(self):
        """Whether there is something to repair."""
        return bool(self.fix) or self.critical


def reason_to_refuse(motion):
    """Why a run says nothing about tires, or an empty text.

    Parameters
    ----------
    motion : Motion

    Returns
    -------
    str
    """
    if not motion.moving.any():
        return f"the car never drove (fastest {np.max(np.abs(motion.v_x)):.2f} m/s)"
    if diverged(motion):
        return "localization diverged: its speed or heading has no constant relation to the car's"
    if _astray(motion):
        return (
            "the poses do not move where their heading points, nor at a constant angle to it: "
            "is an axis of the position turned around, or exchanged with the other?"
        )
    driven = np.count_nonzero(motion.moving) / RATE_HZ
    steady = np.count_nonzero(motion.steady) / RATE_HZ
    usable = sum(cut.stop - cut.start for cut in motion.segments()) / RATE_HZ
    lost = np.count_nonzero(motion.moving & ~motion.coherent) / RATE_HZ
    if usable >= LEAST_USABLE_S:
        return ""
    if lost > 0.5 * driven:
        return (
            f"localization and the car's sensors disagree in {lost:.1f} of {driven:.1f} s of "
            f"driving; {usable:.1f} s of steady driving are left"
        )
    text = f"only {usable:.1f} s of steady driving ({steady:.1f} s in {driven:.1f} s of driving)"
    angle = float(np.median(np.abs(motion.delta[motion.moving])))
    if angle > LARGEST_ANGLE:
        text += f"; steering of {angle:.1f} rad: is it in degrees, or a servo's position?"
    return text


def diverged(motion):
    """Whether localization and the car's sensors contradict each other, and not by a constant.

    Parameters
    ----------
    motion : Motion

    Returns
    -------
    bool
    """
    moving = motion.moving & (motion.path_speed > STANDSTILL_MPS)
    if np.count_nonzero(moving) < RATE_HZ:
        return False
    if np.mean(motion.coherent[moving]) > 0.5:
        return False
    # A wrong scale or sign gives ratios that agree with each other.
    ratio = motion.path_speed[moving] / np.maximum(np.abs(motion.v_x[moving]), STANDSTILL_MPS)
    turning = moving & (np.abs(motion.r) > TURNING_RADPS)
    turns = motion.heading_rate[turning] / motion.r[turning]
    return bool(
        _spread(ratio) > LARGEST_SPREAD
        or (turns.size > RATE_HZ and _spread(turns) > LARGEST_SPREAD)
        or _astray(motion)
    )


def _astray(motion):
    """Whether the poses move in all directions as seen from their own heading."""
    beta = motion.beta[motion.moving & (motion.path_speed > STANDSTILL_MPS)]
    if beta.size < RATE_HZ:
        return False
    return bool(np.hypot(np.mean(np.cos(beta)), np.mean(np.sin(beta))) < 0.8)


def check(motions, setup, vehicle):
    """Check the sensors of all runs together, as they are of one car.

    Parameters
    ----------
    motions : list of Motion
    setup : SensorSetup
        That of the motions.
    vehicle : Vehicle
        Its geometry.

    Returns
    -------
    list of SensorFinding
        In the order in which repairs must be made.
    """
    motions = [
        motion
        for motion in motions
        if motion.moving.any() and not diverged(motion) and not _astray(motion)
    ]
    if not motions:
        return []
    findings = []
    for checker in (_heading, _rates):
        findings += checker(motions, setup, vehicle)
        if any(finding.critical for finding in findings):
            # All that follows is judged by speed, yaw rate and heading.
            return findings
    for checker in (
        *(_steering_sign, _lateral_axis, _lateral_scale, _pose_point, _steering_gain),
        *(_front_slip, _lateral_velocity, _sides, _localization),
    ):
        findings += checker(motions, setup, vehicle)
    return findings


def correct(motions_with, setup, vehicle):
    """Repair the setup, one contradiction after the other: each changes what the next one sees.

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


# -- checks --------------------------------------------------------------------------------------


def _heading(motions, setup, vehicle):
    """Is the heading that of the motion, and not of its reverse?"""
    beta = np.abs(_pooled(motions, "beta", "moving"))
    if np.median(beta) < 0.5 * math.pi:
        return []
    turned = math.remainder(setup.heading_offset_rad + math.pi, 2.0 * math.pi)
    return [
        SensorFinding(
            "heading",
            f"heading: the pose moves {np.median(beta):.2f} rad off its own heading: it points "
            "backwards",
            {"heading_offset_rad": turned},
            critical=True,
        )
    ]


def _rates(motions, setup, vehicle):
    """Yaw rate against the turning of the heading, speed against path per time."""
    r, turning = _pooled(motions, "r", "moving"), _pooled(motions, "heading_rate", "moving")
    turns = np.abs(turning) > TURNING_RADPS
    v, path = _pooled(motions, "v_x", "moving"), _pooled(motions, "path_speed", "moving")
    drives = path > STANDSTILL_MPS
    if np.count_nonzero(turns) < RATE_HZ or np.count_nonzero(drives) < RATE_HZ:
        return []
    yaw, speed = np.median(r[turns] / turning[turns]), np.median(v[drives] / path[drives])
    findings = []
    if min(abs(yaw), abs(speed)) < 0.1:
        what = "yaw rate" if abs(yaw) < 0.1 else "speed"
        text = (
            f"{what}: {min(abs(yaw), abs(speed)):.2f} times what the poses say: it measures "
            "something else, and can be left out of the channel map, unless a unit is wrong"
        )
        return [SensorFinding(what, text, critical=True)]
    if yaw < 0.0:
        text = "yaw rate: its sign is not that of the heading's turning"
        fix = {"yaw_rate_scale": -setup.yaw_rate_scale}
        return [SensorFinding("yaw rate", text, fix, critical=True)]
    if speed < 0.0:
        text = "speed: negative where the car drives forwards"
        return [SensorFinding("speed", text, {"speed_scale": -setup.speed_scale}, critical=True)]
    yaw_off, speed_off = abs(yaw - 1.0), abs(speed - 1.0)
    if min(yaw_off, speed_off) > 0.05 and abs(yaw - speed) < 0.5 * min(yaw_off, speed_off):
        text = (
            f"time: yaw rate is {yaw:.3f} times the heading's turning and speed {speed:.3f} times "
            f"the path per time: a second of the recording lasts {1.0 / yaw:.3f} s"
        )
        fix = {"time_scale": round(setup.time_scale / yaw, 4)}
        return [SensorFinding("time", text, fix, critical=True)]
    text = f"yaw rate: {yaw:.3f} times the turning of the heading"
    fix = {"yaw_rate_scale": round(setup.yaw_rate_scale / yaw, 4)} if yaw_off > 0.05 else {}
    findings.append(SensorFinding("yaw rate", text, fix, critical=yaw_off > 0.2))
    text = f"speed: {speed:.3f} times the path per time"
    fix = {"speed_scale": round(setup.speed_scale / speed, 4)} if speed_off > 0.05 else {}
    findings.append(SensorFinding("speed", text, fix, critical=speed_off > 0.2))
    return findings


def _steering_sign(motions, setup, vehicle):
    delta, r = _pooled(motions, "delta", "moving"), _pooled(motions, "r", "moving")
    turns = np.abs(r) > TURNING_RADPS
    if np.count_nonzero(turns) < RATE_HZ or np.median(delta[turns] * r[turns]) >= 0.0:
        return []
    fix = {
        "steering_gain": -setup.steering_gain,
        "steering_offset_rad": -setup.steering_offset_rad,
    }
    return [
        SensorFinding(
            "steering", "steering: its sign is not that of the yaw rate", fix, critical=True
        )
    ]


def _lateral_axis(motions, setup, vehicle):
    """Which axis of the IMU, with which sign, has the lateral acceleration?"""
    motions = [motion for motion in motions if motion.axes and motion.acceleration == "imu"]
    if not motions:
        return []
    expected = _expected(motions, "steady")
    if expected.size < RATE_HZ or np.percentile(np.abs(expected), 90) < 1.0:
        return []
    fits = {}
    for axis in motions[0].axes:
        values = np.concatenate([motion.axes[axis][motion.steady] for motion in motions])
        fits[axis] = _line(expected, values)

    def follows(axis):
        slope, _, share = fits.get(axis, (0.0, 0.0, 0.0))
        return abs(slope) > LEAST_SLOPE and share > LEAST_SHARE

    own = setup.lateral_axis
    if not follows(own):
        best = max((axis for axis in fits if follows(axis)), key=lambda a: fits[a][2], default=None)
        there = np.concatenate([m.axes[own] for m in motions if own in m.axes] or [np.zeros(1)])
        heavy = abs(abs(np.median(there)) - GRAVITY) < 2.0
        why = f" (gravity is on its {own} axis)" if heavy else ""
        text = f"lateral acceleration: a_{own} does not follow speed times yaw rate{why}, "
        if best is None:
            text += "nor does another axis: take it from these (--acceleration yaw_rate)"
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
    """Offset of the accelerometer, and body roll, which it takes for acceleration."""
    motions = [motion for motion in motions if motion.axes and motion.acceleration == "imu"]
    if not motions:
        return []
    expected = _expected(motions, "usable")
    if expected.size < RATE_HZ or np.ptp(expected) < 1.0:
        return []
    a_y = np.concatenate([motion.a_y[motion.usable] for motion in motions])
    standing = [motion.a_y[_standing(motion)] for motion in motions]
    standing = np.concatenate([values for values in standing if values.size] or [np.zeros(0)])
    slope, offset, _ = _line(expected, a_y)
    if standing.size > LEAST_STANDING_S * RATE_HZ:
        offset = float(np.median(standing))
        slope = float((a_y - offset) @ expected / (expected @ expected))
    scale = 1.0 if abs(slope - 1.0) < 0.03 or slope <= 0.0 else slope
    text = f"lateral acceleration: {slope:.3f} times speed times yaw rate {offset:+.3f} m/s^2"
    fix = {}
    if scale != 1.0 or abs(offset) > 0.05:
        fix = {
            "lateral_scale": round(setup.lateral_scale / scale, 4),
            "lateral_offset_mps2": round((setup.lateral_offset_mps2 - offset) / scale, 4),
        }
        if 0.0 < slope - 1.0 < 0.2:
            roll = (slope - 1.0) / GRAVITY
            text += f", as of a body that rolls {math.degrees(roll):.2f} degrees per m/s^2"
    critical = abs(slope - 1.0) > 0.25 or abs(offset) > 0.75
    return [SensorFinding("lateral acceleration", text, fix, critical)]


def _pose_point(motions, setup, vehicle):
    """Where on the car the pose's point is, and whether its heading is the car's axis.

    Of a slowly cornering car, ``beta = d r / v - c a_y + heading offset`` at a point `d` ahead of
    the rear axle, whose slip is proportional to the acceleration.
    """
    cornering = _low(motions, vehicle)
    if cornering is None:
        return []
    v, r, beta, a_y, sigma = (cornering[key] for key in ("v", "r", "beta", "a_y", "beta_noise"))
    matrix = np.column_stack((r / v, -a_y, np.ones(v.size)))
    both = _both_sides(r)
    columns = [0, 1, 2] if both else [0, 1]
    solution, error = _regression(matrix[:, columns], beta, sigma)
    findings = []
    d, d_error = solution[0], error[0]
    if d_error < 0.04 and not _one_speed(v):
        text = f"pose: its point is {d:.3f} +- {d_error:.3f} m ahead of the rear axle"
        fix = {}
        if abs(d - setup.pose_x_m) > max(0.06, 3.0 * d_error):
            guesses = (0.0, vehicle.l_r, vehicle.l_wb)
            near = min(guesses, key=lambda guess: abs(guess - d))
            fix = {"pose_x_m": round(near if abs(near - d) < 0.05 else d, 4)}
            text += f", not {setup.pose_x_m:.3f} m"
        findings.append(SensorFinding("pose", text, fix, critical=bool(fix)))
    else:
        text = (
            f"pose: driven at one speed only, its point (here {setup.pose_x_m:.3f} m ahead of the "
            "rear axle) cannot be told from the slip of the rear axle"
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


def _steering_gain(motions, setup, vehicle):
    """Gain and offset of the steering: at low acceleration the car follows Ackermann.

    The wheels' angle is ``atan(l_wb r / v) + K a_y`` with the understeer gradient K, and
    ``gain * signal + offset``.
    """
    cornering = _low(motions, vehicle)
    if cornering is None:
        return []
    if not _both_sides(cornering["r"]):
        text = (
            "steering: gain and offset cannot be told apart: no slow cornering (below "
            f"{LOW_SHARE:.0%} of the largest acceleration) to both sides"
        )
        return [SensorFinding("steering", text)]
    if _one_speed(cornering["v"]):
        text = "steering: driven at one speed only, its gain cannot be told from understeer"
        return [SensorFinding("steering", text)]
    gain, gain_error, offset, offset_error = _steering(cornering, vehicle, with_offset=True)
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
    return [
        SensorFinding("steering", text, fix, critical=abs(gain - 1.0) > 0.3 and gain_error < 0.1)
    ]


def _steering(columns, vehicle, with_offset):
    """Gain and offset of the steering with their errors.

    The signal is regressed on what the car does: the other way round, yaw rate would be explained
    by the acceleration, which is nearly the same thing.
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


def _front_slip(motions, setup, vehicle):
    """Does the front force point against the front slip, as it must?"""
    columns = _cornering(motions)
    if columns is None:
        return []
    v, r, delta, a_y = (columns[key] for key in ("v", "r", "delta", "a_y"))
    # Of the front wheels without the rear's slip, which can only make it worse.
    least = np.arctan(vehicle.l_wb * r / v)
    hard = np.abs(a_y) > 0.5 * np.percentile(np.abs(a_y), 98.0)
    if np.count_nonzero(hard) < 10:
        return []
    missing = float(np.median(((least - delta) * np.sign(r))[hard]))
    if missing < 0.01 or _both_sides(r):
        return []
    angle, signal = (float(np.median(np.abs(values[hard]))) for values in (least, delta))
    gain, error, _, _ = _steering(columns, vehicle, with_offset=False)
    text = (
        f"steering: the car turns as with {angle:.3f} rad and no slip where the signal says "
        f"{signal:.3f} rad, so the wheels turn more than it says"
    )
    fix = {}
    if _one_speed(v) or not 0.0 < 10.0 * error < gain:
        text += "; driven at one speed only, it cannot be told how much more"
    else:
        text += (
            f"; if they have no offset and understeer is proportional, {gain:.3f} +- {error:.3f} "
            "times as much"
        )
        fix = {"steering_gain": round(setup.steering_gain * gain, 4)}
    return [SensorFinding("front slip", text, fix, critical=True)]


def _lateral_velocity(motions, setup, vehicle):
    """Does the odometry's lateral velocity say what the poses say?"""
    motions = [motion for motion in motions if motion.v_y_odometry is not None]
    if not motions:
        return []
    own = np.concatenate([motion.v_y_odometry[motion.usable] for motion in motions])
    if own.size < RATE_HZ:
        return []
    poses = np.concatenate([(m.v_x * np.tan(m.beta))[m.usable] for m in motions])
    text = (
        f"lateral velocity: the odometry's differs from the poses', which is used, by "
        f"{np.sqrt(np.mean((own - poses) ** 2)):.3f} m/s RMS"
    )
    return [SensorFinding("lateral velocity", text)]


def _sides(motions, setup, vehicle):
    r = _pooled(motions, "r", "usable")
    if r.size < RATE_HZ or _both_sides(r):
        return []
    side = "left" if np.median(r) > 0.0 else "right"
    text = f"sides: driven to the {side} only, so that no offset of a sensor can be seen"
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
                f"clock: {motion.run.label}: the pose's clock was shifted by "
                f"{motion.clock_offset_s:+.2f} s to the yaw rate's"
            )
            findings.append(SensorFinding("clock", text))
    return findings


# -- what they share -----------------------------------------------------------------------------


def _spread(values):
    """Interquartile range as a share of the median."""
    low, middle, high = np.percentile(values, (25.0, 50.0, 75.0))
    return (high - low) / max(abs(middle), 1e-9)


def _pooled(motions, name, mask):
    return np.concatenate([getattr(motion, name)[getattr(motion, mask)] for motion in motions])


def _expected(motions, mask):
    """Lateral acceleration in steady state."""
    return np.concatenate([(m.v_x * m.r)[getattr(m, mask)] for m in motions])


def _standing(motion):
    """Where the car stands, away from where it stops: the body still moves there."""
    still = (np.abs(motion.v_x) < STANDSTILL_MPS) & (np.abs(motion.r) < 0.05)
    still &= np.any([axis != 0.0 for axis in motion.axes.values()], axis=0)
    margin = np.ones(round(RATE_HZ) + 1)
    if still.size < margin.size:
        return np.zeros_like(still)
    return np.convolve(~still, margin, mode="same") < 0.5


def _both_sides(r):
    left = np.count_nonzero(r > 0.5 * TURNING_RADPS)
    right = np.count_nonzero(r < -0.5 * TURNING_RADPS)
    return min(left, right) > 0.1 * max(left, right, 1)


def _one_speed(v):
    """Whether curvature and lateral acceleration, which is v^2 times as much, look alike."""
    low, middle, high = np.percentile(v, (5.0, 50.0, 95.0))
    return high - low < 0.15 * middle


def _cornering(motions):
    """Points of steady cornering as columns, or None if there are none."""
    columns = {key: [] for key in ("v", "r", "delta", "beta", "a_y")}
    for motion in motions:
        for cut in motion.segments():
            pick = slice(cut.start, cut.stop, PICK)
            for key, values in (
                *(("v", motion.v_x), ("r", motion.r), ("delta", motion.delta)),
                *(("beta", motion.beta), ("a_y", motion.v_x * motion.r)),
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
    low = (np.abs(columns["a_y"]) < LOW_SHARE * largest) & (np.abs(columns["r"]) > 0.2)
    if np.count_nonzero(low) < 10:
        return None
    columns = {key: values[low] for key, values in columns.items()}
    columns["beta_noise"] = float(np.median([motion.beta_noise for motion in motions]))
    return columns


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


def _regression(matrix, values, noise):
    """Least squares with standard errors; half of the points count as independent."""
    scale = np.maximum(np.abs(matrix).max(axis=0), 1e-9)
    solution = np.linalg.lstsq(matrix / scale, values, rcond=None)[0]
    residual = values - matrix / scale @ solution
    variance = max(float(residual @ residual) / max(values.size - matrix.shape[1], 1), noise**2)
    normal = (matrix / scale).T @ (matrix / scale)
    covariance = np.linalg.pinv(normal) * variance * 10.0 / 2.0
    error = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    if np.linalg.cond(normal) > 1e10:
        error[:] = np.inf
    return solution / scale, error / scale
