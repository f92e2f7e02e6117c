"""Are poses, sensors and commands of a recording of one clock?

Where the times of receipt do not say, the driving does: a car turns after its steering commands and
together with its poses, and its speed begins to change shortly after a step of its command.
"""

from __future__ import annotations

import numpy as np

from ..bags.clocks import LONGEST_LAG_S, lag_of_effect
from ..bags.twist import lag_of_speed, lag_of_turning, when
from ..vehicle.parameters import Vehicle
from ..vehicle.size import size_of
from .channels import SensorSetup
from .cornering import ProcessedRun
from .data import Run
from .sensor_findings import SensorFinding

__all__ = ["check_clocks", "late_twist", "onsets_of_speed"]

MOST_APART_S = 0.08  # between yaw rates and poses
# Few steps of the steering and averaged yaw rates leave an error: a real car seemed to turn 0.16 s
# before its commands.
EARLIEST_LAG_S = -0.25
# The speed of real cars begins to change 0.04 to 0.06 s after a step of its command, from
# standstill 0.12 to 0.16 s.
EARLIEST_ONSET_S, USUAL_ONSET_S, LATEST_ONSET_S = -0.03, 0.06, 0.2
# Steps needed, and the least of them; slower than the last a car counts as standing.
FEWEST_STEPS, LEAST_STEP_MPS, SLOWEST_STEP_MPS = 3, 0.2, 0.5


def check_clocks(
    motions: list[ProcessedRun], setup: SensorSetup, vehicle: Vehicle
) -> list[SensorFinding]:
    """Do the poses turn when the yaw rate says so, and the car after its commands?"""
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
                f"{'after' if lag > 0.0 else 'before'} its steering commands: they are not of the "
                "same clock (--steering-delay takes a known delay)"
            )
            findings.append(SensorFinding("clock", text, critical=True))
    return findings


def _speeds_late(motions, setup, vehicle):
    """Does the speed begin to change shortly after its commands, which came with the steering's?"""
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
            f"{'after' if late > 0.0 else 'before'} {len(onsets)} steps of its commands: they, and "
            f"those of the steering, are of another clock{', or very late' if late > 0.0 else ''}"
        )
        fix = {"steering_delay_s": setup.steering_delay_s + late - USUAL_ONSET_S}
        fix = fix if late > 0.0 else {}
        findings.append(SensorFinding("clock", text, fix, critical=late < 0.0))
    return findings


def onsets_of_speed(run: Run, time: float = 1.0) -> list[float]:
    """How long after a step of the commanded speed the speed of a moving car begins to change [s].

    Parameters
    ----------
    run : Run
    time : float, optional
        Times of a car of this size relative to a 1:10 car's.

    Returns
    -------
    list of float
        One for each step before and after which the command is held, and that the speed shows.
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
    """What is wrong with speed or yaw rate of the messages of the poses; empty if nothing is.

    They come with the poses, and are of other moments all the same.
    """
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
            f"{'later' if motion.clocks_apart_s > 0.0 else 'earlier'} than the poses turn, and no "
            "times of receipt tell which of their clocks is wrong",
            critical=True,
        )
        for motion in motions
        if abs(motion.clocks_apart_s) > MOST_APART_S
    ]
