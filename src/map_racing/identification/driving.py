"""Cuts recorded driving into windows in which a model is driven by the recorded commands.

Commands hold until the next one. Everything that a window needs is prepared once: speed and
acceleration at the integration steps, the integral of the steering command, which gives its mean
over any step for any dead time, and the measurements with their places between the steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.ndimage import median_filter

from ..errors import IdentificationError
from .channels import SensorSetup
from .clock_checks import late_twist
from .data import Run, Signal
from .filters import LONGEST_GAP_S, LONGEST_HOLD_S, low_passed, near

__all__ = ["Driving", "Held", "Windows", "driving_of", "windows_of", "without_outliers"]

# Rate at which speed and yaw rate are smoothed [Hz], and cutoff of the low-pass; a drive is no
# faster.
GRID_HZ, SMOOTH_HZ = 100.0, 6.0
# Below this speed slip angles and delays cannot be identified [m/s].
SLOWEST_MPS = 1.0
# Longest sum of dead time and lag that is searched for [s].
LONGEST_DELAY_S = 0.3
# A larger estimate is at that bound, and other parameters compensate for the rest [s].
AT_LONGEST_S = 0.285
# An IMU's acceleration is lateral if its slope over speed times yaw rate is within these.
SLOPES = (0.7, 1.4)
# Window of the median [samples]; an outlier is farther from it than OUTLIER median distances and
# than LEAST_OUTLIER [m/s, rad/s].
NEIGHBORS, OUTLIER, LEAST_OUTLIER = 7, 6.0, 0.5
# Shorter drives [s] are not used. Fewer windows determine nothing.
SHORTEST_S, FEWEST_WINDOWS = 3.0, 5
# A car faster than UNDERWAY_MPS does not stay below its command by a factor of OBEYS for OBEYING_S.
OBEYING_S, OBEYS, UNDERWAY_MPS = 3.0, 2.5, 2.0


class Held(NamedTuple):
    """A command that holds until the next one.

    Parameters
    ----------
    t : ndarray, shape (k,)
        When it was given [s].
    value : ndarray, shape (k,)
        Steering angle [rad] or speed [m/s].
    """

    t: np.ndarray
    value: np.ndarray

    def integral(self) -> np.ndarray:
        """Integral of the command up to each `t`, from 0.

        Returns
        -------
        ndarray, shape (k,)
            [rad s] or [m].
        """
        return np.append(0.0, np.cumsum(np.diff(self.t) * self.value[:-1]))

    def means(self, t: np.ndarray, step: float, integral: np.ndarray) -> np.ndarray:
        """Mean over the step that begins at each of `t`; it depends smoothly on `t`.

        Parameters
        ----------
        t : ndarray, shape (n, ...)
            Start of the steps [s].
        step : float
            Duration of the steps [s].
        integral : ndarray, shape (k,)
            Result of `integral`.

        Returns
        -------
        ndarray, shape (n, ...)
            [rad] or [m/s].
        """
        both = np.concatenate((t, t[-1:] + step)) if t.ndim == 1 else np.vstack((t, t[-1:] + step))
        at = np.searchsorted(self.t, both, side="right") - 1
        at = np.clip(at, 0, self.t.size - 1)
        total = integral[at] + (both - self.t[at]) * self.value[at]
        return np.diff(total, axis=0) / step


@dataclass(frozen=True)
class Driving:
    """One drive on true time, in SI units, with the setup of its sensors applied.

    Parameters
    ----------
    label : str
    steering : Held
        Commanded angle of the front wheels [rad].
    speed_command : Held or None
        [m/s]
    t, v_x, a_long, r : ndarray, shape (n,)
        Even times [s], and speed, its rate and yaw rate there, smoothed without delay.
    measured : dict of str to Signal
        ``r`` [rad/s] and, where measured, ``a_y`` of the IMU [m/s^2], and ``v_y`` of the localized
        point [m/s]; ``v_x`` [m/s].
    setup : SensorSetup
        Already applied, except for the positions of the sensors.
    usable : ndarray of bool, shape (n,)
        Where the car drives and all signals exist.
    notes : list of str
    """

    label: str
    steering: Held
    speed_command: Held | None
    t: np.ndarray
    v_x: np.ndarray
    a_long: np.ndarray
    r: np.ndarray
    measured: dict[str, Signal]
    setup: SensorSetup
    usable: np.ndarray
    notes: list[str]


def driving_of(run: Run) -> Driving:
    """Prepare a run.

    Parameters
    ----------
    run : Run
        Its setup is applied. Unmeasured speed or yaw rate is derived from the poses.

    Raises
    ------
    IdentificationError
        If there are no steering commands, or the other signals do not suffice.
    """
    signals, setup, notes = run.signals, run.setup, []
    if "steering" not in signals:
        raise IdentificationError("steering: expected drive commands, got none")
    late = late_twist(run)
    if late:
        raise IdentificationError(late)
    scaled = {name: (setup.time_scale * s.t, s.value) for name, s in signals.items()}
    r, v = _yaw_rate_and_speed(setup, scaled, notes)
    begin, end = max(r[0][0], v[0][0]), min(r[0][-1], v[0][-1])
    commands_t, angle = scaled["steering"]
    begin = max(begin, float(commands_t[0]))
    if end - begin < SHORTEST_S:
        raise IdentificationError(
            f"expected {SHORTEST_S:g} s with commands, speed and yaw rate, "
            f"got {max(end - begin, 0.0):.1f} s"
        )
    t = np.arange(begin, end, 1.0 / GRID_HZ)
    smooth = low_passed(
        np.stack([np.interp(t, *without_outliers(*signal)) for signal in (v, r)]),
        GRID_HZ,
        SMOOTH_HZ,
    )
    measured = {"r": Signal(*r), "v_x": Signal(*v)}
    a_y = _lateral_acceleration(setup, scaled, t, smooth, notes)
    if a_y is not None:
        measured["a_y"] = a_y
    if "v_y" in scaled:
        t_y, v_y = scaled["v_y"]
        measured["v_y"] = Signal(t_y, setup.speed_scale * v_y)
    usable = (smooth[0] > SLOWEST_MPS) & near(t, commands_t, LONGEST_HOLD_S)
    for name in measured:
        usable &= near(t, measured[name].t, LONGEST_GAP_S)
    speed = _speed_commands(scaled.get("speed_command"), t[usable], smooth[0, usable], notes)
    delay = setup.steering_delay_s
    return Driving(
        run.label,
        Held(commands_t + delay, setup.steering_gain * angle + setup.steering_offset_rad),
        speed,
        t,
        smooth[0],
        np.gradient(smooth[0], 1.0 / GRID_HZ),
        smooth[1],
        measured,
        setup,
        usable,
        notes,
    )


def _speed_commands(command, t, v, notes):
    """The speed commands; None if there are none or part of them is in another unit."""
    if command is None or not t.size:
        return None
    command = Held(*command)
    commanded = command.value[np.clip(np.searchsorted(command.t, t, "right") - 1, 0, None)]
    size = round(OBEYING_S * GRID_HZ)
    for k in range(0, t.size - size + 1, size // 2):
        part = slice(k, k + size)
        if t[part][-1] - t[k] > 1.5 * OBEYING_S or np.median(v[part]) < UNDERWAY_MPS:
            continue
        ratio = float(np.median(commanded[part] / v[part]))
        if ratio > OBEYS:
            notes.append(
                f"from {t[k]:.1f} to {t[part][-1]:.1f} s the commanded speed is {ratio:.1f} times "
                "the measured one: in km/h? No speed commands are used"
            )
            return None
    return command


def _yaw_rate_and_speed(setup, scaled, notes):
    """Yaw rate and speed, each with its times: measured or otherwise derived from the poses."""
    r, v = scaled.get("yaw_rate"), scaled.get("v_x")
    if r is None:
        r = _rate_of_heading(scaled)
        notes.append("yaw rate from the heading of the poses")
    else:
        r = r[0], setup.yaw_rate_scale * r[1]
    if v is None:
        v = _speed_of_path(scaled)
        notes.append("speed from the path of the poses")
    else:
        v = v[0], setup.speed_scale * v[1]
    return r, v


@dataclass(frozen=True)
class Windows:
    """Windows of equal length from one or more drives, n in all, of K steps each.

    Parameters
    ----------
    step : float
        [s]
    burn_in : int
        Number of steps in which the initial state decays, before measurements count.
    begin : ndarray, shape (n,)
        Start of each window [s].
    drive : ndarray of int, shape (n,)
        Index of each window's drive.
    drives : list of Driving
    v_x, a_long : ndarray, shape (K + 1, n)
        [m/s], [m/s^2]
    r_0 : ndarray, shape (n,)
        Yaw rate at the beginning [rad/s].
    observed : dict of str to tuple
        By quantity: window, step before, share of the step after it, and value of each measurement.
    """

    step: float
    burn_in: int
    begin: np.ndarray
    drive: np.ndarray
    drives: list[Driving]
    v_x: np.ndarray
    a_long: np.ndarray
    r_0: np.ndarray
    observed: dict[str, tuple]

    @property
    def count(self) -> int:
        """Number of windows."""
        return self.begin.size

    @property
    def steps(self) -> int:
        """Steps of each."""
        return self.v_x.shape[0] - 1

    def at(self, name: str, simulated: np.ndarray) -> np.ndarray:
        """Simulated values at the times of the measurements.

        Parameters
        ----------
        name : str
            Name of the quantity.
        simulated : ndarray, shape (K + 1, p, n)
            Values of p simulations of all n windows, at each step.

        Returns
        -------
        ndarray, shape (p, k)
            At the k measurements.
        """
        window, before, share, _ = self.observed[name]
        low, high = simulated[before, :, window], simulated[before + 1, :, window]
        return (low + share[:, None] * (high - low)).T

    def commands(self, kind: str, delay: np.ndarray) -> np.ndarray:
        """Mean command over each step.

        Parameters
        ----------
        kind : {"steering", "speed_command"}
        delay : ndarray, shape (p,)
            Dead times [s].

        Returns
        -------
        ndarray, shape (K, p, n)
        """
        out = np.empty((self.steps, delay.size, self.count))
        t = self.step * np.arange(self.steps)
        for index, drive in enumerate(self.drives):
            own = np.flatnonzero(self.drive == index)
            if own.size:
                held = getattr(drive, kind)
                at = t[:, None] + (self.begin[own][None, :] - delay[:, None]).ravel()[None, :]
                means = held.means(at, self.step, held.integral())
                out[:, :, own] = means.reshape(self.steps, delay.size, own.size)
        return out


def windows_of(
    drives: list[Driving],
    *,
    length: float = 1.0,
    burn_in: float = 0.3,
    step: float = 0.005,
    most: int = 120,
    channels: tuple[str, ...] = ("r", "a_y", "v_y"),
    excited: str = "r",
    least: float = 0.0,
) -> Windows:
    """Cut drives into windows.

    Parameters
    ----------
    drives : list of Driving
    length, burn_in, step : float
        Duration that counts, duration before it, and step [s].
    most : int
        If there are more windows, those in which `excited` varies most are used.
    channels : tuple of str
        Quantities to observe.
    excited : {"r", "v_x"}
        Signal that must vary in a window.
    least : float
        Least standard deviation of that signal, smoothed.

    Returns
    -------
    Windows
        Possibly none.
    """
    need, skip = round((length + burn_in) * GRID_HZ), round(length * GRID_HZ)
    begin, drive = _most_excited(drives, need, skip, excited, least, most)
    steps = round((length + burn_in) / step)
    t = step * np.arange(steps + 1)
    v_x, a_long = np.empty((2, steps + 1, begin.size))
    r_0 = np.empty(begin.size)
    parts = {name: [] for name in channels}
    for i, (start, owner) in enumerate(zip(begin, drive)):
        own = drives[owner]
        v_x[:, i] = np.interp(start + t, own.t, own.v_x)
        a_long[:, i] = np.interp(start + t, own.t, own.a_long)
        r_0[i] = np.interp(start, own.t, own.r)
        for name in channels:
            if name not in own.measured:
                continue
            at, value = own.measured[name]
            low, high = np.searchsorted(at, (start + burn_in, start + burn_in + length))
            place = (at[low:high] - start) / step
            before = np.minimum(place.astype(int), steps - 1)
            parts[name].append((np.full(high - low, i), before, place - before, value[low:high]))
    observed = {
        name: tuple(np.concatenate(columns) for columns in zip(*rows))
        for name, rows in parts.items()
        if rows
    }
    return Windows(step, round(burn_in / step), begin, drive, drives, v_x, a_long, r_0, observed)


def _most_excited(drives, need, skip, excited, least, most):
    """Start times and drives of windows of `need` samples, `skip` samples apart."""
    begins, owners, excitement = [], [], []
    for index, drive in enumerate(drives):
        # A window also needs the commands within the longest delay before it.
        known = drive.usable & (drive.t > drive.steering.t[0] + LONGEST_DELAY_S)
        signal = getattr(drive, excited)
        good = np.append(0, np.cumsum(known))
        at = 0
        while at + need < drive.t.size:
            if good[at + need + 1] - good[at] == need + 1:
                varies = float(np.std(signal[at : at + need]))
                if varies >= least:
                    begins.append(drive.t[at])
                    owners.append(index)
                    excitement.append(varies)
                at += skip
            else:
                at += 10
    kept = slice(None)
    if len(begins) > most:
        kept = np.sort(np.argsort(excitement)[-most:])
    return np.array(begins, dtype=float)[kept], np.array(owners, dtype=int)[kept]


def _lateral_acceleration(setup, scaled, t, smooth, notes):
    """Lateral acceleration of the IMU; None if its axis does not measure it."""
    name = f"a_{setup.lateral_axis}"
    if name not in scaled:
        return None
    at, raw = scaled[name]
    value = setup.lateral_scale * raw + setup.lateral_offset_mps2
    expected = smooth[0] * smooth[1]
    seen = low_passed(np.interp(t, at, value), GRID_HZ, 1.0)
    power = float(expected @ expected)
    slope = float(seen @ expected) / power if power > 0.1 * t.size else 0.0
    if not SLOPES[0] < slope < SLOPES[1]:
        notes.append(f"lateral acceleration left out: {slope:.2f} times speed times yaw rate")
        return None
    return Signal(at, value)


def _rate_of_heading(scaled):
    if "psi" not in scaled:
        raise IdentificationError("expected a yaw rate or a heading, got neither")
    t, psi = scaled["psi"]
    return 0.5 * (t[1:] + t[:-1]), np.diff(np.unwrap(psi)) / np.diff(t)


def _speed_of_path(scaled):
    if not {"x", "y"} <= set(scaled):
        raise IdentificationError("expected a speed or poses, got neither")
    t, x = scaled["x"]
    y = np.interp(t, *scaled["y"])
    return 0.5 * (t[1:] + t[:-1]), np.hypot(np.diff(x), np.diff(y)) / np.diff(t)


def without_outliers(t, value):
    """Leave out samples far from the median of their neighbors (Hampel filter).

    Parameters
    ----------
    t, value : ndarray, shape (n,)
        Times [s] and values [m/s, rad/s].

    Returns
    -------
    t, value : ndarray, shape (k,)
    """
    if value.size < 2 * NEIGHBORS:
        return t, value
    distance = np.abs(value - median_filter(value, NEIGHBORS, mode="nearest"))
    usual = median_filter(distance, 5 * NEIGHBORS, mode="nearest")
    good = distance <= np.maximum(OUTLIER * usual, LEAST_OUTLIER)
    return t[good], value[good]
