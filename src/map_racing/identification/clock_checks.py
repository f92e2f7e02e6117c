"""Checks that poses, sensors and commands of a recording share one clock.

If the receipt times do not show it, the driving does: a car turns after its steering commands and
together with its poses, and its speed begins to change shortly after a step of its command.
"""

from __future__ import annotations

import numpy as np

from ..bags.lags import LONGEST_LAG_S, lag_of_effect
from ..bags.twist import lag_of_speed, lag_of_turning, when
from ..vehicle.parameters import Vehicle
from ..vehicle.size import size_of
from .channels import SensorSetup
from .cornering import ProcessedRun
from .data import Run
from .sensor_findings import SensorFinding

__all__ = ["check_clocks", "late_twist", "onsets_of_speed"]

MOST_APART_S = 0.08  # between yaw rates and poses
# The estimate is inaccurate with few steering steps and averaged yaw rates: a real car seemed to
# turn 0.16 s before its commands.
EARLIEST_LAG_S = -0.25
# The speed of real cars begins to change 0.04 to 0.06 s after a step of the command, or 0.12 to
# 0.16 s from standstill.
EARLIEST_ONSET_S, USUAL_ONSET_S, LATEST_ONSET_S = -0.03, 0.06, 0.2
# Number of steps needed, smallest step, and least speed before it, below which the car may stand.
FEWEST_STEPS, LEAST_STEP_MPS, SLOWEST_STEP_MPS = 3, 0.2, 0.5


def check_clocks(
    motions: list[ProcessedRun], setup: SensorSetup, vehicle: Vehicle
) -> list[SensorFinding]:
    """Check that the poses turn with the yaw rate, and the car after its commands."""
    return [
        *_commands_late(motions, vehicle),
        *_speeds_late(motions, setup, vehicle),
        *_poses_late(motions),
    ]


def _commands_late(motions, vehicle):
    findings = []
    for motion in motions:
        v_x = np.where(motion.moving, motion.v_x, np.nan)
        longest = LONGEST_LAG_S * size_of(vehicle).time
        lag = lag_of_effect(
            motion.t, motion.delta, motion.t, motion.r / v_x, longest, EARLIEST_LAG_S
        )
        if lag is not None:
            text = (
                f"clock: {motion.run.label}: the car turns {abs(lag):.2f} s "
                f"{'after' if lag > 0.0 else 'before'} its steering commands: they are on "
                "different clocks (--steering-delay corrects a known delay)"
            )
            findings.append(SensorFinding("clock", text, critical=True))
    return findings


def _speeds_late(motions, setup, vehicle):
    """Check that the speed begins to change shortly after its commands.

    Speed and steering are in the same messages, so this also checks the steering commands.
    """
    findings, time = [], size_of(vehicle).time
    for motion in motions:
        onsets = onsets_of_speed(motion.run, time)
        if len(onsets) < FEWEST_STEPS:
            continue
        late = float(np.median(onsets)) - setup.steering_delay_s
        if EARLIEST_ONSET_S <= late <= LATEST_ONSET_S * time:
            continue
        text = (
            f"clock: {motion.run.label}: the speed begins to change {abs(late):.2f} s "
            f"{'after' if late > 0.0 else 'before'} {len(onsets)} steps of its commands: drive "
            f"commands are on another clock{', or very late' if late > 0.0 else ''}"
        )
        fix = {"steering_delay_s": setup.steering_delay_s + late - USUAL_ONSET_S}
        fix = fix if late > 0.0 else {}
        findings.append(SensorFinding("clock", text, fix, critical=late < 0.0))
    return findings


def onsets_of_speed(run: Run, time: float = 1.0) -> list[float]:
    """Delays from steps of the commanded speed to the response of a moving car [s].

    Parameters
    ----------
    run : Run
    time : float, optional
        Factor on times for a car of this size.

    Returns
    -------
    list of float
        One for each step that has a constant command before and after it and a visible response.
    """
    if not {"speed_command", "v_x"} <= set(run.signals):
        return []
    (at, command), (t, v) = run.signals["speed_command"], run.signals["v_x"]
    onsets = []
    for k in np.flatnonzero(np.abs(np.diff(command)) > LEAST_STEP_MPS * time) + 1:
        begin, step = at[k], command[k] - command[k - 1]
        before = command[(at >= begin - time) & (at < begin)]
        held = command[(at >= begin) & (at < begin + 0.6 * time)]
        if not before.size or max(np.ptp(before), np.ptp(held)) > 0.05 * abs(step):
            continue
        calm = v[(t >= begin - time) & (t < begin - 0.6 * time)]
        if calm.size < 5 or np.median(calm) < SLOWEST_STEP_MPS * time:
            continue
        level = float(np.median(calm))
        noise = 1.5 * float(np.median(np.abs(calm - level)))
        near = (t >= begin - 0.6 * time) & (t < begin + time)
        over = np.sign(step) * (v[near] - level) > max(6.0 * noise, 0.1 * abs(step))
        lasting = over[:-2] & over[1:-1] & over[2:]
        if lasting.any():
            onsets.append(float(t[near][np.argmax(lasting)] - begin))
    return onsets


def late_twist(run: Run) -> str:
    """Text if speed or yaw rate are late or early for the poses in their messages; empty if not."""
    if not {"x", "y", "psi"} <= set(run.signals) or run.pose_clock:
        return ""
    (t, x), y, psi = run.signals["x"], run.signals["y"].value, run.signals["psi"].value
    moved = np.append(True, (np.diff(x) != 0.0) | (np.diff(y) != 0.0))
    for name, words, poses in (
        ("v_x", "speed comes {} the motion of the poses", (x, y)),
        ("yaw_rate", "yaw rate comes {} the poses turn", (psi,)),
    ):
        signal = run.signals.get(name)
        if signal is None or not np.array_equal(signal.t, t):
            continue
        lag_of = lag_of_speed if len(poses) > 1 else lag_of_turning
        lag = lag_of(t, signal.value, t[moved], *(values[moved] for values in poses))
        if lag is not None:
            return f"the {words.format(when(lag))}, in the same messages"
    return ""


def _poses_late(motions):
    return [
        SensorFinding(
            "clock",
            f"clock: {motion.run.label}: the yaw rate comes {abs(motion.clocks_apart_s):.2f} s "
            f"{'later' if motion.clocks_apart_s > 0.0 else 'earlier'} than the poses turn, and "
            "there are no receipt times to show which clock is wrong",
            critical=True,
        )
        for motion in motions
        if abs(motion.clocks_apart_s) > MOST_APART_S
    ]
