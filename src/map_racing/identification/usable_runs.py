"""Decides which runs can identify tires, and which contain steady cornering."""

from __future__ import annotations

import numpy as np

from .cornering import RATE_HZ, STANDSTILL_MPS, ProcessedRun
from .sensor_findings import turning_rate

__all__ = ["is_localized", "reason_to_refuse", "reason_unsteady"]

LEAST_USABLE_S = 2.0
# Least share of a drive that must be steady; with less it is ordinary driving.
LEAST_STEADY_SHARE = 0.2
LARGEST_ANGLE = 1.0  # largest plausible road-wheel angle [rad]
# Largest spread of the ratio of localization to sensors in a run that a wrong scale can explain.
LARGEST_SPREAD = 0.35


def reason_to_refuse(motion: ProcessedRun) -> str:
    """Why a run cannot identify tires; empty if it is usable."""
    if not motion.moving.any():
        return f"the car never drove (fastest {np.max(np.abs(motion.v_x)):.2f} m/s)"
    if _diverged(motion):
        return "localization diverged: its speed or yaw rate has no constant ratio to the car's"
    if _misaligned(motion):
        return (
            "the poses do not move along their heading, nor at a constant angle to it: "
            "is an axis of the position inverted, or are the axes swapped?"
        )
    usable, driven, text = _steady_driving(motion)
    if usable >= LEAST_USABLE_S:
        return ""
    lost = np.count_nonzero(motion.moving & ~motion.coherent) / RATE_HZ
    if lost > 0.5 * driven:
        return (
            f"localization and the car's sensors disagree in {lost:.1f} of {driven:.1f} s of "
            f"driving, which leaves {usable:.1f} s of steady driving"
        )
    angle = float(np.median(np.abs(motion.delta[motion.moving])))
    if angle > LARGEST_ANGLE:
        return f"{text}; steering of {angle:.1f} rad: is it in degrees, or a servo's position?"
    return ""


def reason_unsteady(motion: ProcessedRun) -> str:
    """Why a usable run does not count as steady cornering; empty if it does."""
    usable, driven, text = _steady_driving(motion)
    return "" if usable >= max(LEAST_USABLE_S, LEAST_STEADY_SHARE * driven) else text


def is_localized(motion: ProcessedRun) -> bool:
    """Whether the car drove, and its poses can be compared with its sensors."""
    return bool(motion.moving.any()) and not _diverged(motion) and not _misaligned(motion)


def _steady_driving(motion):
    """Seconds of usable steady driving and of driving, and both in words."""
    driven = np.count_nonzero(motion.moving) / RATE_HZ
    steady = np.count_nonzero(motion.steady) / RATE_HZ
    usable = sum(cut.stop - cut.start for cut in motion.segments()) / RATE_HZ
    text = f"only {usable:.1f} s of steady driving ({steady:.1f} s in {driven:.1f} s of driving)"
    return usable, driven, text


def _diverged(motion):
    """Whether localization and the car's sensors differ by more than a constant factor."""
    moving = motion.moving & (motion.path_speed > STANDSTILL_MPS)
    if np.count_nonzero(moving) < RATE_HZ:
        return False
    if np.mean(motion.coherent[moving]) > 0.5:
        return False
    # A wrong scale or sign gives ratios that agree with each other.
    ratio = motion.path_speed[moving] / np.maximum(np.abs(motion.v_x[moving]), STANDSTILL_MPS)
    turning = moving & (np.abs(motion.r) > turning_rate(motion.size))
    turns = motion.heading_rate[turning] / motion.r[turning]
    return bool(
        _spread(ratio) > LARGEST_SPREAD
        or (turns.size > RATE_HZ and _spread(turns) > LARGEST_SPREAD)
        or _misaligned(motion)
    )


def _misaligned(motion):
    """Whether the poses move in all directions relative to their own heading."""
    beta = motion.beta[motion.moving & (motion.path_speed > STANDSTILL_MPS)]
    if beta.size < RATE_HZ:
        return False
    return bool(np.hypot(np.mean(np.cos(beta)), np.mean(np.sin(beta))) < 0.8)


def _spread(values):
    """Interquartile range as a share of the median."""
    low, middle, high = np.percentile(values, (25.0, 50.0, 75.0))
    return (high - low) / max(abs(middle), 1e-9)
