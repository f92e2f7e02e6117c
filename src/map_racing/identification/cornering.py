"""Resamples the signals of a run to one clock and finds steady cornering.

All signals pass the same zero-phase low-pass, so that none is delayed against another. The velocity
of the localized point comes from differences of poses, rotated into the car's axes before
filtering, because in these axes it is constant on a circle. Tires are identified from segments of
steady speed, yaw rate and steering: constant steering angles or slow ramps.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import maximum_filter1d
from scipy.signal import savgol_filter

from ..angles import wrap
from ..errors import IdentificationError, ParameterError
from ..vehicle.parameters import Vehicle
from ..vehicle.size import ONE_TENTH, Size, size_of
from .channels import POSE
from .data import Run, Signal
from .filters import (
    LONGEST_GAP_S,
    LONGEST_HOLD_S,
    briefly_far,
    low_passed,
    near,
    running_median,
    spike_thresholds,
    spikes_in,
    stretches,
)
from .limits import RATE_HZ, SteadyLimits

__all__ = ["ProcessedRun", "motion_of"]

# Speeds and yaw rates are for 1:10 cars; `motion_of` scales them for larger ones.
# Localization counts as lost if its speed or yaw rate differs from the car's sensors by more than
# this: share of the sensor's value, plus a constant [m/s, rad/s].
COHERENT_SPEED, COHERENT_YAW_RATE = (0.2, 0.15), (0.15, 0.25)
POSE_SPIKE_WINDOW_S = 2.0
CLOCK_SEARCH_S = 1.5
# A clock offset is certain if the shift leaves less than this share of the squared differences.
PLAIN = 0.3
# A longer drive [s] has its time in ms, or a jump.
LONGEST_DRIVE_S = 36000.0
# The low-pass smears a step over this many periods of its cutoff frequency.
SMEARED = 0.4
SLOWEST_MPS = 0.5
STANDSTILL_MPS = 0.05


@dataclass(frozen=True)
class ProcessedRun:
    """One drive on one clock, low-passed; all arrays have shape (n,).

    Parameters
    ----------
    run : Run
    t : ndarray
        Time [s].
    v_x, r : ndarray
        Forward speed [m/s] and yaw rate [rad/s] from the car's own sensors.
    beta : ndarray
        Sideslip at the localized point [rad], from poses alone.
    delta : ndarray
        Steering angle [rad].
    a_y : ndarray
        Lateral acceleration of the center of gravity [m/s^2].
    acceleration : {"imu", "yaw_rate"}
        Its source.
    axes : dict of str to ndarray
        Accelerations of the IMU, by axis.
    path_speed, heading_rate : ndarray
        Speed along the path [m/s] and rate of the heading [rad/s], from poses alone.
    v_y_odometry : ndarray or None
        Lateral velocity of the odometry at the localized point [m/s].
    moving, coherent, steady : ndarray of bool
        Whether the car moves; whether localization and sensors agree; whether it is steady.
    beta_noise, a_y_noise, turning_noise : float
        Standard deviations of the noise after the low-pass; `turning_noise` is for the yaw rate
        over the speed [1/m].
    clock_offset_s : float
        Shift applied to the clock of the poses.
    clocks_apart_s : float
        Delay of the yaw rate behind the rate of the heading although both should be on one clock; 0
        if that is not certain.
    spikes : dict of str to float
        Share of each signal rejected as spikes.
    limits : SteadyLimits
    size : Size
        Size of the car.
    """

    run: Run
    t: np.ndarray
    v_x: np.ndarray
    r: np.ndarray
    beta: np.ndarray
    delta: np.ndarray
    a_y: np.ndarray
    acceleration: str
    axes: dict[str, np.ndarray]
    path_speed: np.ndarray
    heading_rate: np.ndarray
    v_y_odometry: np.ndarray | None
    moving: np.ndarray
    coherent: np.ndarray
    steady: np.ndarray
    beta_noise: float
    a_y_noise: float
    turning_noise: float
    clock_offset_s: float
    clocks_apart_s: float
    spikes: dict[str, float]
    limits: SteadyLimits
    size: Size = ONE_TENTH

    @property
    def usable(self) -> np.ndarray:
        """Steady driving with valid localization."""
        return self.steady & self.coherent

    def v_y(self, l_r: float) -> np.ndarray:
        """Lateral velocity of the center of gravity.

        Parameters
        ----------
        l_r : float
            Distance from the center of gravity to the rear axle [m].

        Returns
        -------
        ndarray, shape (n,)
            [m/s]
        """
        return self.v_x * np.tan(self.beta) + self.r * (l_r - self.run.setup.pose_x_m)

    def segments(self) -> list[slice]:
        """Slices of usable driving, without the edges that the low-pass smears."""
        margin = round(SMEARED / self.limits.cutoff_hz * RATE_HZ)
        shortest = round(self.limits.shortest_s * RATE_HZ)
        return [
            slice(cut.start + margin, cut.stop - margin)
            for cut in stretches(self.usable)
            if cut.stop - cut.start >= shortest + 2 * margin
        ]


def motion_of(
    run: Run,
    vehicle: Vehicle,
    limits: SteadyLimits | None = None,
    acceleration: str = "imu",
) -> ProcessedRun:
    """Resample a run to one clock and find its steady driving.

    Parameters
    ----------
    run : Run
        Its setup is applied.
    vehicle : Vehicle
        Its geometry locates the center of gravity.
    limits : SteadyLimits, optional
    acceleration : {"imu", "yaw_rate"}
        Source of the lateral acceleration: the IMU, or speed times yaw rate (steady-state value).

    Raises
    ------
    IdentificationError
        If signals are missing, or do not overlap for a second.
    """
    limits, size = limits or SteadyLimits(), size_of(vehicle)
    setup = run.setup
    least = spike_thresholds(size)
    signals, spikes = _without_spikes(run, least)
    pose_t, *poses = _poses(run, signals, spikes, least)
    middle, *velocities = _velocities(*poses, setup.heading_offset_rad)
    offset, apart = _clocks(run, signals, middle, velocities[2])
    middle, pose_t = middle + offset, pose_t + offset
    t, known = _common_clock(signals, pose_t)
    columns = dict(
        zip(("along", "sideways", "heading_rate"), (np.interp(t, middle, v) for v in velocities))
    )
    columns.update(_sampled(signals, setup, t))
    columns.setdefault("v_x", columns["along"])
    columns.setdefault("r", columns["heading_rate"])
    smooth, known = _filtered(columns, known, limits.cutoff_hz)
    if not known.any():
        raise IdentificationError("expected signals without gaps for a second")

    axes = {name[-1]: smooth[name] for name in ("a_x", "a_y", "a_z") if name in smooth}
    v_x, r, turning = smooth["v_x"], smooth["r"], smooth["heading_rate"]
    path_speed = np.hypot(smooth["along"], smooth["sideways"])
    beta = np.where(path_speed > 0.3, np.arctan2(smooth["sideways"], smooth["along"]), 0.0)
    motion = ProcessedRun(
        run=run,
        t=t,
        v_x=v_x,
        r=r,
        beta=beta,
        delta=smooth["delta"],
        a_y=_lateral_acceleration(setup, vehicle, smooth, axes, acceleration),
        acceleration=acceleration,
        axes=axes,
        path_speed=path_speed,
        heading_rate=turning,
        v_y_odometry=smooth.get("v_y"),
        moving=known & (np.abs(v_x) > size.time * SLOWEST_MPS),
        coherent=known & ~_lost(known, path_speed, v_x, turning, r, size),
        steady=known & (v_x > size.time * SLOWEST_MPS) & _steady(v_x, r, smooth["delta"], limits),
        beta_noise=0.0,
        a_y_noise=0.0,
        turning_noise=0.0,
        clock_offset_s=offset,
        clocks_apart_s=apart,
        spikes={name: share for name, share in spikes.items() if share > 0.0},
        limits=limits,
        size=size,
    )
    cuts = motion.segments()
    turning = motion.r / np.where(motion.moving, motion.v_x, np.inf)
    signals = {"beta_noise": motion.beta, "a_y_noise": motion.a_y, "turning_noise": turning}
    return replace(motion, **{name: _noise(values, cuts) for name, values in signals.items()})


def _without_spikes(run, least):
    """Signals without spikes, on true time, and the share of spikes in each."""
    for name in (*POSE, "steering"):
        if name not in run.signals:
            what = "a drive command or a servo position" if name == "steering" else "poses"
            raise IdentificationError(f"{name}: expected {what}, got none")
    own = run.setup.time_scale * run.signals["x"].t
    apart = float(np.median(np.diff(own)))
    if apart > LONGEST_GAP_S or own[-1] - own[0] > LONGEST_DRIVE_S:
        raise IdentificationError(
            f"expected poses at most {LONGEST_GAP_S:g} s apart over at most "
            f"{LONGEST_DRIVE_S / 3600.0:g} h, got {apart:.3g} s and {own[-1] - own[0]:.3g} s: is "
            "the time in ms, or does it jump?"
        )
    signals, spikes = {}, {}
    for name, (t, value) in run.signals.items():
        if name == "speed_command":
            continue
        if name not in (*POSE, "steering"):
            good = ~spikes_in(t, value, least[name])
            t, value, spikes[name] = t[good], value[good], 1.0 - float(np.mean(good))
        signals[name] = Signal(run.setup.time_scale * t, value)
    return signals, spikes


def _clocks(run, signals, middle, turning):
    """Correction of the pose times, and unexpected offset between the clocks [s].

    Poses with a clock of their own are shifted to match the yaw rates. If both should be on one
    clock, an offset is only reported.
    """
    if "yaw_rate" not in signals:
        return 0.0, 0.0
    rate_t, rate = signals["yaw_rate"]
    found, sure = _clock_offset(middle, turning, rate_t, run.setup.yaw_rate_scale * rate)
    if run.pose_clock:
        return found, 0.0
    return 0.0, found if sure else 0.0


def _common_clock(signals, pose_t):
    """Even times at which all signals exist, and whether each is free of gaps."""
    others = [pose_t, *(s.t for name, s in signals.items() if name not in (*POSE, "steering"))]
    commands = signals["steering"].t
    begin = max(commands[0], *(own[0] for own in others))
    end = min(own[-1] for own in others)
    if end - begin < 1.0:
        raise IdentificationError(
            f"expected at least 1 s with all signals, got {max(end - begin, 0.0):.1f} s"
        )
    t = np.arange(begin, end, 1.0 / RATE_HZ)
    known = near(t, commands, LONGEST_HOLD_S)
    for own in others:
        known &= near(t, own, LONGEST_GAP_S)
    return t, known


def _sampled(signals, setup, t):
    """All signals but the pose on the common clock, with the setup applied except to the IMU."""
    columns = {}
    for name, key, scale in (
        *((name, name, setup.speed_scale) for name in ("v_x", "v_y")),
        ("yaw_rate", "r", setup.yaw_rate_scale),
        *((name, name, 1.0) for name in ("a_x", "a_y", "a_z")),
    ):
        if name in signals:
            columns[key] = scale * np.interp(t, *signals[name])
    commands = signals["steering"]
    last = np.searchsorted(commands.t + setup.steering_delay_s, t, side="right") - 1
    held = commands.value[np.maximum(last, 0)]
    columns["delta"] = setup.steering_gain * held + setup.steering_offset_rad
    return columns


def _filtered(columns, known, cutoff_hz):
    """Low-passed columns, 0 in gaps, and a mask of where they are known."""
    raw = np.stack(list(columns.values()))
    passed, filtered = np.zeros(raw.shape), np.zeros(known.size, dtype=bool)
    for cut in stretches(known):
        if cut.stop - cut.start > RATE_HZ:
            passed[:, cut] = low_passed(raw[:, cut], RATE_HZ, cutoff_hz)
            filtered[cut] = True
    return dict(zip(columns, passed)), filtered


def _lost(known, path_speed, v_x, turning, r, size):
    """Where localization contradicts the car's own sensors, with a margin."""
    share, least = COHERENT_SPEED
    lost = np.abs(path_speed - np.abs(v_x)) > share * np.abs(v_x) + size.time * least
    share, least = COHERENT_YAW_RATE
    lost |= np.abs(turning - r) > share * np.abs(r) + least / size.time
    margin = 2 * round(0.3 * RATE_HZ) + 1
    return maximum_filter1d((lost & known).astype(np.int8), margin).astype(bool)


def _steady(v_x, r, delta, limits):
    """Where speed, yaw rate and steering angle change slowly."""
    steady = np.ones(v_x.size, dtype=bool)
    for column, limit in (
        (v_x, limits.dv_mps2),
        (r, limits.dr_radps2),
        (delta, limits.ddelta_radps),
    ):
        steady &= np.abs(np.gradient(column, 1.0 / RATE_HZ)) < limit
    return steady


def _poses(run, signals, spikes, least):
    """Times of the valid poses; evenly spaced times and the poses there, without spikes.

    Spikes are detected, and poses interpolated, on the difference between the poses and dead
    reckoning with the car's own sensors, which changes slowly even while the car moves fast.
    """
    own, x = signals["x"]
    y = np.interp(own, *signals["y"])
    t = np.arange(own[0], own[-1], 1.0 / RATE_HZ)
    psi_t, psi = signals["psi"]
    turned, turned_even = np.zeros(psi.size), np.zeros(t.size)
    if "yaw_rate" in signals:
        rate_t, rate = signals["yaw_rate"]
        rate = run.setup.yaw_rate_scale * rate
        integral = _integrated(rate_t, rate)
        turned, turned_even = np.interp(psi_t, rate_t, integral), np.interp(t, rate_t, integral)
    drift = psi - turned
    # Without yaw rate the drift is the heading itself, so the window must be shorter.
    window = POSE_SPIKE_WINDOW_S if "yaw_rate" in signals else 0.25 * POSE_SPIKE_WINDOW_S
    middle = np.arctan2(*(running_median(psi_t, part(drift), window) for part in (np.sin, np.cos)))
    distance = np.abs(wrap(drift - middle))
    good = ~briefly_far(psi_t, distance, least["psi"], window)
    spikes["psi"] = 1.0 - float(np.mean(good))
    psi = turned_even + np.interp(t, psi_t[good], np.unwrap(drift[good]))

    good = np.ones(own.size, dtype=bool)
    reckoned = [np.zeros(t.size)] * 2
    if "v_x" in signals:
        v = run.setup.speed_scale * np.interp(t, *signals["v_x"])
        reckoned = [_integrated(t, v * np.cos(psi)), _integrated(t, v * np.sin(psi))]
    drifts = [p - np.interp(own, t, path) for p, path in zip((x, y), reckoned)]
    if "v_x" in signals:
        for drift in drifts:
            good &= ~spikes_in(own, drift, least["x"], POSE_SPIKE_WINDOW_S)
    spikes["position"] = 1.0 - float(np.mean(good))
    x, y = (path + np.interp(t, own[good], drift[good]) for path, drift in zip(reckoned, drifts))
    return own[good], t, x, y, psi


def _integrated(t, values):
    return np.append(0.0, np.cumsum(0.5 * np.diff(t) * (values[1:] + values[:-1])))


def _velocities(t, x, y, psi, heading_offset):
    """Times between poses, velocities along the car's axes, and yaw rate there."""
    dt = np.diff(t)
    heading = 0.5 * (psi[1:] + psi[:-1]) + heading_offset
    dx, dy = np.diff(x) / dt, np.diff(y) / dt
    cos, sin = np.cos(heading), np.sin(heading)
    return 0.5 * (t[1:] + t[:-1]), cos * dx + sin * dy, cos * dy - sin * dx, np.diff(psi) / dt


def _clock_offset(middle, turning, t, rate):
    """Shift of the pose clock that aligns both yaw rates [s], and whether it is certain.

    It is certain if the shifted rates differ little, and by far less than without the shift.
    """
    step = 1.0 / RATE_HZ
    grid = np.arange(max(middle[0], t[0]), min(middle[-1], t[-1]), step)
    if grid.size < 4 * RATE_HZ:
        return 0.0, False
    own = low_passed(np.interp(grid, t, rate), RATE_HZ, 2.0)
    if np.std(own) < 0.1:
        return 0.0, False
    other = low_passed(np.interp(grid, middle, turning), RATE_HZ, 2.0)
    most = min(round(CLOCK_SEARCH_S * RATE_HZ), grid.size // 4)
    inner = slice(most, grid.size - most)
    # Squared differences at each shift, up to a common constant. The absolute value tolerates a
    # wrong sign of the yaw rate, which is checked later.
    squares = np.append(0.0, np.cumsum(other**2))
    size = grid.size - 2 * most
    alike = np.abs(np.correlate(other, own[inner], "valid"))
    errors = squares[size:] - squares[:-size] - 2.0 * alike + float(own[inner] @ own[inner])
    best = int(np.argmin(errors))
    plain = errors[best] < PLAIN * min(errors[most], size * float(np.var(own)))
    return float(step * (most - best)), bool(plain)


def _lateral_acceleration(setup, vehicle, smooth, axes, acceleration):
    """Lateral acceleration of the center of gravity."""
    if acceleration == "yaw_rate":
        return smooth["v_x"] * smooth["r"]
    if acceleration != "imu":
        raise ParameterError(f"acceleration: expected imu or yaw_rate, got {acceleration!r}")
    if setup.lateral_axis not in axes:
        raise IdentificationError(
            f"a_{setup.lateral_axis}: expected a lateral acceleration, got none: "
            "without an IMU use speed times yaw rate (--acceleration yaw_rate)"
        )
    a_y = setup.lateral_scale * axes[setup.lateral_axis] + setup.lateral_offset_mps2
    ahead = 0.0 if setup.imu_x_m is None else setup.imu_x_m - vehicle.l_r
    r = smooth["r"]
    return a_y - np.gradient(r, 1.0 / RATE_HZ) * ahead + r * r * setup.imu_y_m


def _noise(values, cuts, window_s=2.0):
    """Standard deviation from a local parabola, over the segments that are long enough."""
    half = int(0.5 * window_s * RATE_HZ)
    parts = []
    for cut in cuts:
        if cut.stop - cut.start > 3 * half:
            parabola = savgol_filter(values[cut], 2 * half + 1, 2, mode="constant")
            parts.append((values[cut] - parabola)[half:-half])
    if not parts:
        return 0.0
    # The parabola absorbs part of the noise.
    return 1.2 * float(np.std(np.concatenate(parts)))
