"""Every faulty sensor is detected, with its repair."""

import dataclasses

import numpy as np
import pytest
from driven_laps import laps_of

from map_racing.control.steering_ramp import RampParameters
from map_racing.errors import IdentificationError
from map_racing.identification.channels import SensorSetup
from map_racing.identification.cornering import motion_of
from map_racing.identification.data import Signal, load_run
from map_racing.identification.identify import identify
from map_racing.identification.kinematic_checks import check_steering_gain
from map_racing.identification.sensor_checks import check
from map_racing.identification.usable_runs import reason_to_refuse
from map_racing.simulation.plants import load_plant
from map_racing.simulation.ramps import drive_ramps
from map_racing.simulation.recorded import write_ramp_bag
from map_racing.track.files.load import load_raceline
from map_racing.track.raceline import Raceline
from map_racing.vehicle.parameters import load_vehicle

# Change to the recording, the check that must notice it, and the setup that repairs it.
FAULTS = {
    "yaw rate turned around": ({"yaw_rate": (-1.0, 0.0)}, "yaw_rate_scale", -1.0),
    "yaw rate in other units": ({"yaw_rate": (57.3, 0.0)}, "yaw_rate_scale", 1.0 / 57.3),
    "speed in km/h": ({"v_x": (3.6, 0.0)}, "speed_scale", 1.0 / 3.6),
    "speed backwards": ({"v_x": (-1.0, 0.0)}, "speed_scale", -1.0),
    "acceleration turned around": ({"a_y": (-1.0, 0.0)}, "lateral_scale", -1.0),
    "acceleration in g": ({"a_y": (1.0 / 9.80665, 0.0)}, "lateral_scale", 9.80665),
    "acceleration with an offset": ({"a_y": (1.0, 0.4)}, "lateral_offset_mps2", -0.4),
    "acceleration of a rolling body": ({"a_y": (1.08, 0.0)}, "lateral_scale", 1.0 / 1.08),
    "steering turned around": ({"steering": (-1.0, 0.0)}, "steering_gain", -1.0),
    "steering off center": ({"steering": (1.0, 0.02)}, "steering_offset_rad", -0.02),
    "steering too weak": ({"steering": (0.8, 0.0)}, "steering_gain", 1.25),
    "heading off the axis": ({"psi": (1.0, 0.03)}, "heading_offset_rad", -0.03),
    "heading backwards": ({"psi": (1.0, np.pi)}, "heading_offset_rad", np.pi),
}


def spoiled(run, faults):
    signals = dict(run.signals)
    for name, (scale, offset) in faults.items():
        t, value = signals[name]
        signals[name] = Signal(t, scale * value + offset)
    return dataclasses.replace(run, signals=signals)


def findings_of(run, vehicle):
    return check([motion_of(run, vehicle)], run.setup, vehicle)


def test_a_run_in_order_has_nothing_to_repair(ramps):
    findings = findings_of(ramps.run, ramps.base)
    assert not any(finding.contradiction for finding in findings)
    assert {"yaw rate", "speed", "lateral acceleration", "pose", "heading", "steering"} <= {
        finding.check for finding in findings
    }


@pytest.mark.once
@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_found_and_repaired(ramps, curve_error, fault):
    faults, name, expected = FAULTS[fault]
    run = spoiled(ramps.run, faults)
    findings = findings_of(run, ramps.base)
    assert any(name in finding.fix for finding in findings), [f.text for f in findings]
    found = identify([run], ramps.base, fix=True)
    wrong = abs(getattr(found.setup, name)) - abs(expected)
    scale = name.endswith(("scale", "gain"))
    assert abs(wrong) < (0.02 * abs(expected) if scale else 0.02 if "lateral" in name else 0.003)
    assert np.sign(getattr(found.setup, name)) == np.sign(expected) or fault == "heading backwards"
    assert any(name in correction.fix for correction in found.corrections)
    for axle in ("front", "rear"):
        assert curve_error(found, ramps.true, axle) < 0.05
    assert not any(finding.contradiction for finding in found.findings)


@pytest.mark.parametrize("fault", [name for name in FAULTS if "turned" in name or "wards" in name])
def test_a_wrong_sign_is_an_error_without_fix(ramps, fault):
    with pytest.raises(IdentificationError, match="--fix applies that") as error:
        identify([spoiled(ramps.run, FAULTS[fault][0])], ramps.base)
    assert "\n" not in str(error.value)


def test_axes_that_are_swapped(ramps, curve_error):
    signals = dict(ramps.run.signals)
    signals["a_x"], signals["a_y"] = signals["a_y"], signals["a_x"]
    t, value = signals["a_x"]
    signals["a_x"] = Signal(t, -value)
    run = dataclasses.replace(ramps.run, signals=signals)
    found = identify([run], ramps.base, fix=True)
    assert found.setup.lateral_axis == "x" and found.setup.lateral_scale == -1.0
    assert curve_error(found, ramps.true, "front") < 0.03


@pytest.mark.once
def test_gravity_on_the_lateral_axis(ramps):
    signals = dict(ramps.run.signals)
    signals["a_z"], signals["a_y"] = signals["a_y"], signals["a_z"]
    run = dataclasses.replace(ramps.run, signals=signals)
    texts = [f.text for f in findings_of(run, ramps.base) if f.critical]
    assert any("gravity is on its y axis" in text for text in texts), texts
    assert identify([run], ramps.base, fix=True).setup.lateral_axis == "z"


def test_an_imu_that_measures_nothing_can_be_done_without(ramps, curve_error):
    signals = dict(ramps.run.signals)
    rng = np.random.default_rng(1)
    for name in ("a_x", "a_y", "a_z"):
        t, value = signals[name]
        signals[name] = Signal(t, rng.normal(0.0, 0.1, value.size))
    run = dataclasses.replace(ramps.run, signals=signals)
    with pytest.raises(IdentificationError, match="--acceleration yaw_rate"):
        identify([run], ramps.base)
    found = identify([run], ramps.base, acceleration="yaw_rate")
    assert curve_error(found, ramps.true, "front") < 0.03


@pytest.mark.once
def test_an_imu_that_is_not_used_is_not_judged(ramps):
    run = spoiled(ramps.run, {"a_y": (-3.0, 1.0)})
    found = identify([run], ramps.base, acceleration="yaw_rate")
    assert not any(finding.check == "lateral acceleration" for finding in found.findings)


def test_a_clock_that_runs_at_another_rate(ramps, curve_error):
    slow = {name: Signal(1.15 * s.t, s.value) for name, s in ramps.run.signals.items()}
    run = dataclasses.replace(ramps.run, signals=slow)
    with pytest.raises(IdentificationError, match="time: .* a second of the recording lasts 0.87"):
        identify([run], ramps.base)
    found = identify([run], ramps.base, fix=True)
    assert found.setup.time_scale == pytest.approx(1.0 / 1.15, rel=0.01)
    assert curve_error(found, ramps.true, "front") < 0.03


def test_the_point_of_the_pose(ramps):
    """Poses of the center of gravity, declared as those of the rear axle."""
    signals, l_r = dict(ramps.run.signals), ramps.base.l_r
    psi = signals["psi"].value
    signals["x"] = Signal(signals["x"].t, signals["x"].value + l_r * np.cos(psi))
    signals["y"] = Signal(signals["y"].t, signals["y"].value + l_r * np.sin(psi))
    run = dataclasses.replace(ramps.run, signals=signals)
    with pytest.raises(IdentificationError, match=r"pose: its point is 0.14.* m ahead"):
        identify([run], ramps.base)
    assert identify([run], ramps.base, fix=True).setup.pose_x_m == pytest.approx(l_r, abs=1e-3)
    stated = dataclasses.replace(run, setup=SensorSetup(pose_x_m=l_r))
    assert not any(f.contradiction for f in findings_of(stated, ramps.base))


@pytest.mark.once
def test_several_faults_at_once(ramps, curve_error):
    faults = {"yaw_rate": (-1.0, 0.0), "a_y": (-1.05, 0.3), "steering": (-0.9, 0.01)}
    found = identify([spoiled(ramps.run, faults)], ramps.base, fix=True)
    assert len(found.corrections) >= 4
    for axle in ("front", "rear"):
        assert curve_error(found, ramps.true, axle) < 0.05


def test_one_side_says_what_it_cannot_say(ramps):
    half = {
        name: Signal(s.t[s.t < 17.0], s.value[s.t < 17.0]) for name, s in ramps.run.signals.items()
    }
    findings = findings_of(dataclasses.replace(ramps.run, signals=half), ramps.base)
    texts = " ".join(finding.text for finding in findings)
    assert "steady cornering to the left only" in texts and "cannot be separated" in texts
    assert not any(finding.fix for finding in findings)


def test_wheels_that_turn_more_than_the_signal_on_one_side(ramps):
    t_end = 17.0
    half = {
        name: Signal(s.t[s.t < t_end], s.value[s.t < t_end])
        for name, s in ramps.run.signals.items()
    }
    t, value = half["steering"]
    half["steering"] = Signal(t, 0.6 * value)
    run = dataclasses.replace(ramps.run, signals=half)
    with pytest.raises(IdentificationError, match="the wheels turn more than the signal"):
        identify([run], ramps.base)


def test_a_gain_beyond_the_lock_is_refused(ramps):
    """A car with a wheelbase other than the file's: no steering gain can compensate for that."""
    long = dataclasses.replace(ramps.base, l_f=1.5 * ramps.base.l_f, l_r=1.5 * ramps.base.l_r)
    for fix in (False, True):
        with pytest.raises(IdentificationError, match="beyond their lock of 0.419 rad") as error:
            identify([ramps.run], long, fix=fix)
        assert "--fix applies" not in str(error.value)
    # Also a stated gain; without one, the servo clips commands beyond the lock.
    stated = dataclasses.replace(ramps.run, setup=SensorSetup(steering_gain=1.5))
    with pytest.raises(IdentificationError, match="gain 1.500 .* beyond their lock"):
        identify([stated], ramps.base)
    short = dataclasses.replace(ramps.base, delta_max=0.3)
    texts = [finding.text for finding in identify([ramps.run], short).findings]
    assert any("beyond their lock of 0.300 rad" in text for text in texts)


@pytest.mark.once
def test_saturated_cornering_to_one_side_tells_no_gain(ramps):
    """Above 45 % of the largest acceleration, understeer is not proportional to acceleration."""
    run = spoiled(ramps.run, {"steering": (0.35, 0.0)})
    motion = motion_of(run, ramps.base)
    t, value = run.signals["steering"]
    a_y = np.interp(t, motion.t, motion.v_x * motion.r)
    hard = a_y > 0.5 * np.percentile(a_y, 98.0)
    end = t[hard][-1]  # beyond this, the last command would count as held
    signals = {name: Signal(s.t[s.t < end], s.value[s.t < end]) for name, s in run.signals.items()}
    signals["steering"] = Signal(t[hard], value[hard])
    with pytest.raises(IdentificationError, match="how much more is unknown") as error:
        identify([dataclasses.replace(run, signals=signals)], ramps.base, fix=True)
    assert "\n" not in str(error.value)


def test_findings_that_contradict_each_other_are_reported_as_that(ramps):
    """Hard and slow cornering with different gains of the signal."""
    motion = motion_of(ramps.run, ramps.base)
    t, value = ramps.run.signals["steering"]
    a_y = np.interp(t, motion.t, np.abs(motion.v_x * motion.r))
    weak = np.where(a_y > 0.48 * np.percentile(a_y, 98.0), 0.5, 1.0) * value
    with pytest.raises(IdentificationError, match="no gain and offset satisfy both") as error:
        identify([_with(ramps.run, steering=weak)], ramps.base, fix=True)
    assert "--fix" not in str(error.value)


def test_an_oversteering_car_is_not_taken_for_one_with_another_gain(tmp_path):
    """Its wheels steer less than the bend's geometry; the front axle even moves less."""
    scales = {"front_stiffness_scale": 3.0, "rear_stiffness_scale": 0.1}
    plant = dataclasses.replace(load_plant("nuc4"), **scales)
    samples = drive_ramps(plant, [RampParameters(speed_mps=2.5, sides="left")], seed=5)
    write_ramp_bag(tmp_path / "a.bag", samples)
    run, vehicle = load_run(tmp_path / "a.bag"), plant.build_vehicle()
    motion = motion_of(run, vehicle)
    hard = motion.usable & (motion.a_y > 0.5 * np.max(motion.a_y))
    rolls = np.arctan(vehicle.l_wb * motion.r[hard] / motion.v_x[hard])
    assert np.median(rolls - motion.delta[hard]) > 0.01
    assert not any(finding.critical for finding in check([motion], run.setup, vehicle))


def test_why_a_run_is_refused(ramps):
    standing = {name: Signal(s.t[:80], 0.0 * s.value[:80]) for name, s in ramps.run.signals.items()}
    motion = motion_of(dataclasses.replace(ramps.run, signals=standing), ramps.base)
    assert "never drove" in reason_to_refuse(motion)

    rng = np.random.default_rng(3)
    signals = dict(ramps.run.signals)
    for name in ("x", "y"):
        t, value = signals[name]
        wander = np.cumsum(np.cumsum(rng.normal(0.0, 0.02, t.size)) * 0.02)
        signals[name] = Signal(t, value + 3.0 * wander)
    motion = motion_of(dataclasses.replace(ramps.run, signals=signals), ramps.base)
    assert "localization diverged" in reason_to_refuse(motion)
    assert not findings_of(dataclasses.replace(ramps.run, signals=signals), ramps.base)


def _with(run, **values):
    signals = dict(run.signals)
    signals.update((name, Signal(signals[name].t, value)) for name, value in values.items())
    return dataclasses.replace(run, signals=signals)


def test_a_mirrored_path_is_refused(ramps):
    x, y = (ramps.run.signals[name].value for name in ("x", "y"))
    for mirrored in (_with(ramps.run, y=-y), _with(ramps.run, x=y, y=x)):
        with pytest.raises(IdentificationError, match="an axis of the position inverted"):
            identify([mirrored], ramps.base)


def test_milliseconds_and_a_clock_that_jumps_are_told(ramps):
    signals = ramps.run.signals
    slow = {name: Signal(1e3 * (s.t - s.t[0]), s.value) for name, s in signals.items()}
    far = {
        name: Signal(np.append(s.t[0] - 1.7e9, s.t), np.append(s.value[0], s.value))
        for name, s in signals.items()
    }
    for changed in (slow, far):
        with pytest.raises(IdentificationError, match="is the time in ms, or does it jump"):
            identify([dataclasses.replace(ramps.run, signals=changed)], ramps.base)


def test_degrees_of_steering_are_told(ramps):
    steering = np.rad2deg(ramps.run.signals["steering"].value)
    with pytest.raises(IdentificationError, match="is it in degrees"):
        identify([_with(ramps.run, steering=steering)], ramps.base)


def test_fix_is_only_offered_where_there_is_one(ramps):
    x, y = (1e3 * ramps.run.signals[name].value for name in ("x", "y"))
    with pytest.raises(IdentificationError, match="unless a unit is wrong$"):
        identify([_with(ramps.run, x=x, y=y)], ramps.base)


def lobes():
    """A course that bends to one side only."""
    angle = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)
    radius = 6.0 + 0.8 * np.cos(3.0 * angle)
    return Raceline(radius * np.cos(angle), radius * np.sin(angle))


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.once)])
@pytest.mark.parametrize("line", [load_raceline("reference"), lobes()], ids=["reference", "lobes"])
@pytest.mark.parametrize("plant, scale", [("nuc4", 0.7), ("public_simulator", 0.7)])
def test_few_moments_of_steady_cornering_in_laps_are_no_reason_to_repair(plant, scale, line, seed):
    """Mostly to one side, so that scale and offset cannot be separated."""
    vehicle = load_vehicle("nuc4" if plant == "nuc4" else "sim")
    run, _ = laps_of(scale, seed, line, plant)
    findings = check([motion_of(run, vehicle)], run.setup, vehicle)
    assert not [finding.text for finding in findings if finding.contradiction]


def test_runs_whose_imus_have_other_axes(ramps):
    """An axis that is always 0, as from a simulated IMU, counts as not recorded."""
    signals = {name: signal for name, signal in ramps.run.signals.items() if name != "a_x"}
    without = dataclasses.replace(ramps.run, signals=signals)
    motions = [motion_of(run, ramps.base) for run in (ramps.run, without)]
    for order in (motions, motions[::-1]):
        findings = check(order, ramps.run.setup, ramps.base)
        assert not any(finding.contradiction for finding in findings)


def test_steering_that_the_turns_do_not_follow_tells_no_gain(ramps):
    """The same angle whichever way the car turns: an infinite gain is no answer."""
    t, value = ramps.run.signals["steering"]
    run = _with(ramps.run, steering=np.full(value.size, 0.1))
    (finding,) = check_steering_gain([motion_of(run, ramps.base)], run.setup, ramps.base)
    assert "does not follow" in finding.text and "inf" not in finding.text
