"""One clock, one low-pass, and steady segments."""

import dataclasses
import math

import numpy as np
import pytest

from map_racing.errors import IdentificationError, ParameterError
from map_racing.identification.channels import SensorSetup
from map_racing.identification.cornering import motion_of
from map_racing.identification.data import Run, Signal
from map_racing.identification.filters import low_passed
from map_racing.identification.limits import SteadyLimits
from map_racing.vehicle.parameters import load_vehicle

CAR = load_vehicle("nuc4")
BETA = -0.06  # of the rear axle


def circle(v=2.0, r=1.0, duration=8.0, rate=40.0, delay=0.0, ahead=0.0, steps=(), **setup):
    """A run at constant speed on a circle; `steps` are (time, speed) of speed changes.

    Poses refer to a point `ahead` of the rear axle, whose slip angle is `BETA`.
    """
    t = np.arange(0.0, duration, 1.0 / rate)
    speed = np.full(t.size, v)
    for at, faster in steps:
        speed[t >= at] = faster
    fine = np.arange(0.0, duration + 1.0, 1e-3)
    fast = np.full(fine.size, v)
    for at, faster in steps:
        fast[fine >= at] = faster
    psi = 0.3 + r * fine
    track = psi + BETA
    scale = fast / math.cos(BETA)
    x = np.append(0.0, np.cumsum(scale * np.cos(track) * 1e-3)[:-1]) + ahead * np.cos(psi)
    y = np.append(0.0, np.cumsum(scale * np.sin(track) * 1e-3)[:-1]) + ahead * np.sin(psi)
    pose = {n: Signal(t + delay, np.interp(t, fine, c)) for n, c in zip("xy", (x, y))}
    pose["psi"] = Signal(t + delay, (np.interp(t, fine, psi) + math.pi) % (2 * math.pi) - math.pi)
    others = {
        "v_x": speed,
        "yaw_rate": np.full(t.size, r),
        "a_y": speed * r,
        "steering": np.full(t.size, 0.17),
    }
    signals = {**pose, **{name: Signal(t, value) for name, value in others.items()}}
    return Run("circle", signals, SensorSetup(**setup), pose_clock=delay != 0.0)


def settled(motion):
    """Indices away from the ends."""
    return slice(75, motion.t.size - 75)


def test_low_pass_lets_half_of_the_power_through_at_its_cutoff():
    t = np.arange(0.0, 40.0, 0.01)
    for frequency, gain in ((0.2, 1.0), (2.0, math.sqrt(0.5)), (20.0, 0.0)):
        passed = low_passed(np.sin(2.0 * math.pi * frequency * t), 100.0, 2.0)[1000:3000]
        assert np.max(passed) == pytest.approx(gain, abs=0.01)
    assert low_passed(np.full(200, 3.0), 100.0, 2.0) == pytest.approx(3.0)


def test_low_pass_delays_nothing():
    t = np.arange(0.0, 20.0, 0.01)
    passed = low_passed(np.sin(2.0 * math.pi * 0.5 * t), 100.0, 2.0)
    assert np.argmax(passed[500:700]) == pytest.approx(
        np.argmax(np.sin(math.pi * t)[500:700]), abs=1
    )


@pytest.mark.parametrize("ahead", [0.0, CAR.l_r])
@pytest.mark.parametrize("r", [1.0, -1.3])
def test_velocity_of_the_center_of_gravity_from_poses_of_any_point(ahead, r):
    motion = motion_of(circle(r=r, ahead=ahead, pose_x_m=ahead), CAR)
    middle = settled(motion)
    expected = 2.0 * math.tan(BETA) + r * CAR.l_r
    assert motion.v_y(CAR.l_r)[middle] == pytest.approx(expected, abs=2e-3)
    assert motion.r[middle] == pytest.approx(r) and motion.delta[middle] == pytest.approx(0.17)
    assert motion.heading_rate[middle] == pytest.approx(r, abs=1e-3)
    assert motion.path_speed[middle] == pytest.approx(
        2.0 / math.cos(math.atan2(expected + (ahead - CAR.l_r) * r, 2.0)), rel=2e-3
    )
    assert motion.a_y[middle] == pytest.approx(2.0 * r)


def test_lateral_acceleration_is_that_of_the_center_of_gravity():
    run = circle(r=1.5, imu_x_m=0.2, imu_y_m=0.05)
    # Left of the middle, the circle is smaller.
    motion = motion_of(run, CAR)
    assert motion.a_y[settled(motion)] == pytest.approx(2.0 * 1.5 + 1.5**2 * 0.05)
    motion = motion_of(circle(r=1.5), CAR, acceleration="yaw_rate")
    assert motion.a_y[settled(motion)] == pytest.approx(3.0)


@pytest.mark.parametrize("delay", [0.4, -0.7])
def test_the_clock_of_the_pose_is_brought_to_that_of_the_yaw_rate(delay):
    """With a varying yaw rate: on a circle all times look alike."""
    t = np.arange(0.0, 20.0, 0.02)
    r = 1.0 + 0.8 * np.sin(0.9 * t) + 0.3 * np.sin(2.3 * t)
    psi = np.append(0.0, np.cumsum(0.5 * 0.02 * (r[1:] + r[:-1])))
    x = np.append(0.0, np.cumsum(0.02 * 2.0 * np.cos(psi))[:-1])
    y = np.append(0.0, np.cumsum(0.02 * 2.0 * np.sin(psi))[:-1])
    signals = {n: Signal(t + delay, c) for n, c in (("x", x), ("y", y), ("psi", psi))}
    for name, value in (("v_x", 2.0), ("yaw_rate", r), ("steering", 0.2), ("a_y", 2.0 * r)):
        signals[name] = Signal(t, np.broadcast_to(value, t.shape).astype(float))
    motion = motion_of(Run("run", signals, pose_clock=True), CAR)
    assert motion.clock_offset_s == pytest.approx(-delay, abs=0.021)
    assert np.abs(motion.heading_rate - motion.r)[75:-75].max() < 0.05


def test_steps_of_speed_are_cut_into_holds():
    motion = motion_of(circle(duration=15.0, steps=((5.0, 2.4), (10.0, 2.8))), CAR)
    cuts = motion.segments()
    assert [round(float(np.mean(motion.v_x[cut])), 2) for cut in cuts] == [2.0, 2.4, 2.8]
    for cut in cuts:
        # No trace of the step remains in a steady segment.
        assert np.ptp(motion.v_x[cut]) < 0.03
        assert cut.stop - cut.start > 2.5 * 50


def test_a_ramp_is_one_stretch(ramps):
    motion = motion_of(ramps.run, ramps.base)
    assert len(motion.segments()) == 6
    assert all(motion.t[cut][-1] - motion.t[cut][0] > 13.0 for cut in motion.segments())


def test_spikes_are_left_out():
    run = circle(duration=20.0)
    rng = np.random.default_rng(1)
    signals = dict(run.signals)
    for name in ("x", "y", "psi", "v_x", "yaw_rate", "a_y"):
        t, value = signals[name]
        if name != "y":  # a pose is wrong as a whole
            gross = rng.random(t.size) < 0.25
        signals[name] = Signal(t, value + gross * rng.choice((-1.0, 1.0), t.size) * 2.0)
    motion = motion_of(dataclasses.replace(run, signals=signals), CAR)
    expected = motion_of(run, CAR)
    assert motion.spikes["a_y"] == pytest.approx(0.25, abs=0.04)
    for name in ("v_x", "r", "a_y", "beta"):
        error = getattr(motion, name) - getattr(expected, name)
        assert np.abs(error[settled(motion)]).max() < 5e-3, name


def test_a_step_is_no_spike():
    motion = motion_of(circle(duration=15.0, steps=((5.0, 3.0),)), CAR)
    assert "v_x" not in motion.spikes


def test_lost_localization_is_left_out():
    run = circle(duration=20.0)
    t, x = run.signals["x"]
    # It slides away at 3 m/s for 5 s.
    slid = x + 3.0 * np.clip(t - 8.0, 0.0, 5.0)
    signals = {**run.signals, "x": Signal(t, slid)}
    motion = motion_of(dataclasses.replace(run, signals=signals), CAR)
    lost = motion.t[~motion.coherent & (motion.t < 19.0)]
    assert lost.min() > 7.0 and lost.max() < 14.0
    assert [round(float(motion.t[cut][0])) for cut in motion.segments()][1] >= 13


def test_gaps_are_not_bridged():
    run = circle(duration=20.0)
    signals = {
        name: Signal(s.t[(s.t < 8.0) | (s.t > 10.0)], s.value[(s.t < 8.0) | (s.t > 10.0)])
        for name, s in run.signals.items()
    }
    cuts = motion_of(dataclasses.replace(run, signals=signals), CAR).segments()
    assert len(cuts) == 2


def test_setup_is_applied():
    run = circle(
        **{"speed_scale": 2.0, "yaw_rate_scale": -1.0, "lateral_scale": 0.5},
        **{"lateral_offset_mps2": 0.2, "steering_gain": -2.0, "steering_offset_rad": 0.01},
    )
    motion = motion_of(run, CAR)
    middle = settled(motion)
    for name, expected in (("v_x", 4.0), ("r", -1.0), ("a_y", 1.2), ("delta", -0.33)):
        assert getattr(motion, name)[middle] == pytest.approx(expected), name
    motion = motion_of(circle(heading_offset_rad=0.1), CAR)
    assert motion.beta[settled(motion)] == pytest.approx(BETA - 0.1, abs=1e-3)
    half = motion_of(circle(time_scale=0.5), CAR)
    assert half.t[-1] == pytest.approx(4.0, abs=0.1)
    assert half.heading_rate[50:-50] == pytest.approx(2.0, abs=0.01)


def test_steering_delay_shifts_the_command():
    run = circle(duration=10.0)
    t = run.signals["steering"].t
    step = Signal(t, np.where(t < 5.0, 0.1, 0.2))
    early = motion_of(dataclasses.replace(run, signals={**run.signals, "steering": step}), CAR)
    setup = SensorSetup(steering_delay_s=0.5)
    late = dataclasses.replace(run, signals={**run.signals, "steering": step}, setup=setup)
    late = motion_of(late, CAR)
    at = [m.t[np.argmax(m.delta > 0.15)] for m in (early, late)]
    assert at[1] - at[0] == pytest.approx(0.5, abs=0.03)


def test_refusals():
    run = circle()
    for missing, expected in (
        ("psi", "psi: expected poses, got none"),
        ("steering", "steering: expected a drive command"),
        ("a_y", "expected a lateral acceleration.*--acceleration yaw_rate"),
    ):
        signals = {name: s for name, s in run.signals.items() if name != missing}
        with pytest.raises(IdentificationError, match=expected):
            motion_of(dataclasses.replace(run, signals=signals), CAR)
    with pytest.raises(IdentificationError, match="expected at least 1 s with all signals"):
        motion_of(circle(duration=0.6), CAR)
    with pytest.raises(ParameterError, match="cutoff_hz"):
        SteadyLimits(cutoff_hz=30.0)
    with pytest.raises(ParameterError, match="shortest_s"):
        SteadyLimits(shortest_s=-1.0)
    with pytest.raises(ParameterError, match="acceleration: expected"):
        motion_of(run, CAR, acceleration="guess")
