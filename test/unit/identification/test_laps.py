"""Known tires identified from laps; what laps do not determine stays unchanged."""

import dataclasses

import numpy as np
import pytest
from driven_laps import QUIET, laps_of

from map_racing.errors import IdentificationError
from map_racing.identification.car import identify_car
from map_racing.identification.car_report import car_text, provenance
from map_racing.identification.channels import SensorSetup
from map_racing.identification.data import Signal
from map_racing.identification.delay import estimate_delays
from map_racing.identification.laps import tires_from_laps
from map_racing.identification.replay import actuators_of, replay
from map_racing.identification.survey import survey
from map_racing.vehicle.parameters import linearized, load_vehicle
from map_racing.vehicle.single_track import GRAVITY
from map_racing.vehicle.tires import PacejkaTire

NUC4 = load_vehicle("nuc4")


def stiffness(vehicle, axle):
    """Normalized by the load [1/rad]."""
    return vehicle.mu * getattr(vehicle, axle).stiffness


@pytest.fixture(scope="module")
def low():
    """Laps of a car with less friction than its file says."""
    return laps_of(0.7, mu_scale=0.88)


@pytest.fixture(scope="module")
def found(low):
    return tires_from_laps([low[0]], NUC4)


def test_combinations_and_friction_are_the_cars(low, found):
    true = low[1]
    for axle, within in (("front", 0.04), ("rear", 0.2)):
        assert stiffness(found.vehicle, axle) == pytest.approx(stiffness(true, axle), rel=within)
        value, least, most, determined = found.parameters[f"{axle}_stiffness_n_per_rad"]
        assert least < value < most and determined
    per_rad = true.m * GRAVITY / true.l_wb
    fronts, rears = (
        stiffness(true, axle) * arm * per_rad
        for axle, arm in (("front", true.l_r), ("rear", true.l_f))
    )
    gradient = true.m / true.l_wb * (true.l_r / fronts - true.l_f / rears)
    assert found.parameters["understeer_gradient_rad_s2_per_m"].value == pytest.approx(
        gradient, rel=0.04
    )
    friction = found.parameters["friction"]
    assert friction.determined and friction.value == pytest.approx(true.mu, rel=0.05)
    assert friction.low < true.mu < friction.high
    assert found.least_friction < true.mu
    assert found.parameters["fit_delay_s"].value == pytest.approx(0.05, abs=0.006)
    # Nothing else has changed.
    assert found.vehicle.I_z == NUC4.I_z and found.vehicle.h_cg == NUC4.h_cg
    assert found.vehicle.front.C == NUC4.front.C


@pytest.mark.once
def test_the_steering_has_one_delay(low):
    """Report and file have the one that `delay_s` is based on."""
    found = identify_car([low[0]], NUC4)
    told, head = car_text(found), provenance(found)
    steering = found.laps.delays.steering
    line = f"steering, dead time and lag: {steering.value:.3f} s"
    assert told.count("teering, dead time and lag") == told.count(line) == 1
    assert head.count("teering, dead time and lag") == head.count(line[1:]) == 1


@pytest.mark.parametrize(
    "scale, mu_scale, mixed",
    [(0.7, 0.7, True), pytest.param(0.5, 0.88, False, marks=pytest.mark.once)],
)
def test_runs_on_different_floors_are_no_silent_mixture(low, scale, mu_scale, mixed):
    """The same car at another speed is no contradiction, on another floor it is."""
    other = dataclasses.replace(laps_of(scale, seed=2, mu_scale=mu_scale)[0], name="other.bag")
    found = identify_car([low[0], other], NUC4)
    doubts = [f.text for f in found.findings if f.critical]
    assert bool(doubts) == mixed and all("not of one car on one floor" in d for d in doubts)
    assert ("check: runs: " in provenance(found)) == mixed == ("check: runs: " in car_text(found))


@pytest.mark.parametrize(
    "scale, mu_scale, change, half",
    [
        (0.6, 0.88, {"factor": 0.7, "after_s": 10.0}, "second half"),
        pytest.param(
            *(0.7, 1.0, {"factor": 0.6, "from_m": 0.0, "to_m": 18.0}, "half with smaller y"),
            marks=pytest.mark.once,
        ),
    ],
)
def test_floors_of_one_drive_are_no_silent_mixture(scale, mu_scale, change, half):
    """A spill, or the other carpet behind the second bend, made soft tires and late steering."""
    run, _ = laps_of(scale, mu_scale=mu_scale, grip_changes=[change])
    doubt = tires_from_laps([run], NUC4).runs_finding
    assert doubt.critical
    text = f"runs: laps.bag is not of one car on one floor: of its {half} the common fit leaves"
    assert doubt.text.startswith(text)
    found = estimate_delays([run], NUC4)
    for part in (found.steering, found.delay, found.speed_lookahead):
        assert part.value is None


def test_one_floor_is_one(low, found):
    assert found.runs_finding is None
    assert found.delays.delay.value == pytest.approx(0.07, abs=0.01)


@pytest.mark.once
def test_far_from_the_limit_friction_stays_as_it_was():
    run, true = laps_of(0.45, mu_scale=0.88)
    found = tires_from_laps([run], NUC4)
    friction = found.parameters["friction"]
    assert found.largest_a_y < 0.5 * true.mu * GRAVITY * true.front.D
    assert not friction.determined and friction.value == found.vehicle.mu == NUC4.mu
    assert friction.low < true.mu
    assert stiffness(found.vehicle, "front") == pytest.approx(stiffness(true, "front"), rel=0.08)


@pytest.mark.once
def test_perfect_measurements_do_not_tell_it_there_either():
    """At small slip, a wrong shape of the curve looks like a different friction."""
    run, _ = laps_of(0.45, mu_scale=0.88, **QUIET)
    assert not tires_from_laps([run], NUC4).parameters["friction"].determined


@pytest.mark.once
def test_a_quarter_of_gross_outliers(low):
    """Friction is right whenever it is called determined, which is usually the case."""
    run, true = low
    sizes = {"v_x": 3.0, "v_y": 2.0, "yaw_rate": 4.0, "a_y": 15.0}
    determined = 0
    for seed in (1, 2, 3, 4):
        rng = np.random.default_rng(seed)
        signals = dict(run.signals)
        for name, size in sizes.items():
            t, value = signals[name]
            wrong = rng.random(t.size) < 0.25
            away = rng.choice((-1.0, 1.0), t.size) * rng.uniform(0.3 * size, size, t.size)
            signals[name] = Signal(t, np.where(wrong, value + away, value))
        found = tires_from_laps([dataclasses.replace(run, signals=signals)], NUC4)
        front = stiffness(true, "front")
        assert stiffness(found.vehicle, "front") == pytest.approx(front, rel=0.08)
        friction = found.parameters["friction"]
        determined += friction.determined
        if friction.determined:
            assert friction.value == pytest.approx(true.mu, rel=0.1)
        else:
            assert friction.value == found.vehicle.mu == NUC4.mu
    assert determined >= 3


def test_without_lateral_velocity_or_imu(low):
    run, true = low
    signals = {k: v for k, v in run.signals.items() if k not in ("v_y", "a_y")}
    found = identify_car([dataclasses.replace(run, signals=signals)], NUC4)
    assert found.steady is None and not found.refused
    assert stiffness(found.vehicle, "front") == pytest.approx(stiffness(true, "front"), rel=0.06)


@pytest.mark.once
def test_an_imu_away_from_the_center_of_gravity():
    """The setup gives its position; it also measures parts of yaw acceleration and yaw rate."""
    run, true = laps_of(0.7, mu_scale=0.88, **QUIET)
    t, r = run.signals["yaw_rate"]
    ahead, left = 0.2, -0.1
    a_y = run.signals["a_y"].value + np.gradient(r, t) * ahead - r**2 * left
    setup = SensorSetup(imu_x_m=NUC4.l_r + ahead, imu_y_m=left)
    moved = dataclasses.replace(run, signals={**run.signals, "a_y": Signal(t, a_y)}, setup=setup)
    there, center = (tires_from_laps([one], NUC4) for one in (moved, run))
    for axle, within in (("front", 0.02), ("rear", 0.1)):
        expected = stiffness(center.vehicle, axle)
        assert stiffness(there.vehicle, axle) == pytest.approx(expected, rel=within)
    assert there.noise["a_y"] < 0.2
    # The replay of its tires takes this into account, too.
    for one in (moved, run):
        (replayed,) = replay(true, [one], actuators_of([one], true)).runs
        assert replayed.channels["lateral acceleration"].share < 0.06


@pytest.mark.once
@pytest.mark.parametrize("factor", [3.6, -1.0])
def test_an_odometry_in_other_units_or_turned_around(low, found, factor):
    """Both velocities are in the same message: a repair applies to both."""
    spoiled = {
        name: Signal(t, factor * v) for name, (t, v) in low[0].signals.items() if "v_" in name
    }
    run = dataclasses.replace(low[0], signals={**low[0].signals, **spoiled})
    repaired = identify_car([run], NUC4, fix=True)
    assert repaired.setup.speed_scale == pytest.approx(1.0 / factor, rel=2e-3)
    for axle in ("front", "rear"):
        expected = stiffness(found.vehicle, axle)
        assert stiffness(repaired.vehicle, axle) == pytest.approx(expected, rel=0.02)
    text = car_text(repaired)
    assert "differs from the poses, which are used, by 0.01" in text


@pytest.mark.once
@pytest.mark.parametrize("point", [0.0, 0.145])
def test_an_inverted_lateral_velocity_is_named(low, point):
    """Also one of another point of the car, as far ahead of the rear axle."""
    run, _ = low
    v_y, r = run.signals["v_y"], run.signals["yaw_rate"]

    def surveyed(sign):
        signal = Signal(v_y.t, sign * (v_y.value + point * r.value))
        return survey([dataclasses.replace(run, signals={**run.signals, "v_y": signal})], NUC4)

    assert not any("opposite" in finding.text for finding in surveyed(1.0).findings)
    with pytest.raises(IdentificationError, match="lateral velocity: .* opposite to .* poses"):
        surveyed(-1.0)


def test_no_less_grip_than_was_demonstrated(low):
    """A file with less grip than the car has shown is wrong, determined or not."""
    run, true = low
    slippery = dataclasses.replace(NUC4, mu=0.4)
    slippery = dataclasses.replace(slippery, a_lat_max=2.0)
    found = tires_from_laps([run], slippery, spreads={"grip": 0.01})
    assert found.vehicle.a_lat_max == found.largest_a_y > 4.0
    limit = found.vehicle.mu * GRAVITY * found.vehicle.front.peak
    assert limit >= found.largest_a_y * (1.0 - 1e-9)
    assert 0.4 < found.least_friction <= found.vehicle.mu * (1.0 + 1e-9) < 1.05 * true.mu


@pytest.mark.once
def test_wheels_that_turn_otherwise_than_commanded(low):
    (run, true), gain = low, 1.12
    t, angle = run.signals["steering"]
    wrong = Signal(t, (angle - 0.015) / gain)
    run = dataclasses.replace(run, signals={**run.signals, "steering": wrong})
    fixed = identify_car([run], dataclasses.replace(NUC4, delta_max=0.6), fix=True)
    (finding,) = [f for f in fixed.corrections if f.text.startswith("steering: in ordinary")]
    assert finding.fix["steering_offset_rad"] == pytest.approx(0.015, abs=0.003)
    assert fixed.setup.steering_gain == pytest.approx(gain, rel=0.03)
    assert fixed.laps.parameters["gain"].value == pytest.approx(1.0, abs=0.01)
    assert stiffness(fixed.vehicle, "front") == pytest.approx(stiffness(true, "front"), rel=0.06)


@pytest.mark.once
def test_not_beyond_their_lock(low):
    run, _ = low
    t, angle = run.signals["steering"]
    wrong = Signal(t, angle / 1.3)
    run = dataclasses.replace(run, signals={**run.signals, "steering": wrong})
    widest = float(np.percentile(np.abs(angle), 99.0))
    car = dataclasses.replace(NUC4, delta_max=0.9 * widest)
    found = identify_car([run], car, fix=True)
    assert found.setup.steering_gain == 1.0
    assert any("beyond their lock" in finding.text for finding in found.findings)


@pytest.mark.once
@pytest.mark.parametrize("gain, offset", [(0.7, 0.0), (1.0, -0.15)])
def test_commands_whose_numbers_alone_are_beyond_the_lock(low, found, gain, offset):
    """The same tires come out as of commands in the angle of the wheels."""
    run, _ = low
    t, angle = run.signals["steering"]
    wrong = Signal(t, (angle - offset) / gain)
    run = dataclasses.replace(run, signals={**run.signals, "steering": wrong})
    other = identify_car([run], NUC4)
    (finding,) = [f for f in other.findings if f.text.startswith("steering: in ordinary")]
    assert ("is not the car's wheelbase" in finding.text) == (gain != 1.0)
    right = found.parameters["gain"].value
    assert finding.fix["steering_gain"] == pytest.approx(gain * right, rel=0.005)
    added = right * offset + found.parameters["offset_rad"].value
    assert finding.fix["steering_offset_rad"] == pytest.approx(added, abs=0.001)
    for axle in ("front", "rear"):
        name = f"{axle}_stiffness_n_per_rad"
        value = other.laps.parameters[name].value
        assert value == pytest.approx(found.parameters[name].value, rel=0.02)


@pytest.mark.once
def test_the_wrong_shape_of_a_curve_does_not_pass_for_friction(low):
    run, true = low
    C, E = 1.5, 0.9  # saturates late, and then sharply
    other = {
        axle: PacejkaTire(tire.stiffness / (C * tire.D), C, tire.D, E)
        for axle, tire in (("front", NUC4.front), ("rear", NUC4.rear))
    }
    found = tires_from_laps([run], dataclasses.replace(NUC4, **other))
    friction = found.parameters["friction"]
    limit = found.vehicle.mu * found.vehicle.front.peak
    if friction.determined:
        assert limit == pytest.approx(true.mu * true.front.peak, rel=0.12)
    else:
        assert found.vehicle.mu == NUC4.mu


def test_linear_tires_have_no_friction_to_tell(low):
    found = tires_from_laps([low[0]], linearized(NUC4))
    assert found.vehicle.front.model == "linear"
    assert not found.parameters["friction"].determined and found.vehicle.mu == NUC4.mu
    assert found.least_friction is None


@pytest.mark.once
def test_commands_too_early_to_be_the_delay(low):
    """With the delay at its bound, the tires would absorb the rest."""
    run = low[0]
    steering = run.signals["steering"]
    early = {**run.signals, "steering": Signal(steering.t - 0.28, steering.value)}
    with pytest.raises(IdentificationError, match="on one clock"):
        tires_from_laps([dataclasses.replace(run, signals=early)], NUC4)


@pytest.mark.once
def test_refusals(low):
    run, _ = low
    t = np.arange(0.0, 20.0, 0.025)
    straight = {
        "x": Signal(t, 3.0 * t),
        **{name: Signal(t, 0.0 * t) for name in ("y", "psi", "yaw_rate", "a_y", "steering")},
        "v_x": Signal(t, np.full(t.size, 3.0)),
    }
    with pytest.raises(IdentificationError, match="straight driving"):
        tires_from_laps([dataclasses.replace(run, signals=straight)], NUC4)
    steering = run.signals["steering"]
    other = Signal(steering.t, 0.2 * np.sin(1.1 * (steering.t - steering.t[0]) ** 1.2))
    with pytest.raises(IdentificationError, match="the steering commands explain"):
        tires_from_laps(
            [dataclasses.replace(run, signals={**run.signals, "steering": other})], NUC4
        )
    without = {k: v for k, v in run.signals.items() if k != "steering"}
    with pytest.raises(IdentificationError, match="steering: expected"):
        tires_from_laps([dataclasses.replace(run, signals=without)], NUC4)


@pytest.mark.parametrize("lag", [0.12, 0.3])
@pytest.mark.parametrize("names", [("v_x",), ("yaw_rate", "v_y"), ("v_x", "v_y", "yaw_rate")])
def test_a_twist_of_another_moment_than_its_poses_is_refused(low, names, lag):
    """Its lag would look like a steering delay, or like stiff tires."""
    run, _ = low
    late = {
        name: Signal(signal.t, np.interp(signal.t - lag, *signal))
        for name, signal in run.signals.items()
        if name in names
    }
    run = dataclasses.replace(run, signals={**run.signals, **late})
    with pytest.raises(IdentificationError, match=rf"comes {lag:.2f} s (after|later)"):
        identify_car([run], NUC4)
    delays = estimate_delays([run], NUC4)
    assert any(
        f"left out: the {'speed' if 'v_x' in names else 'yaw rate'}" in n for n in delays.notes
    )
