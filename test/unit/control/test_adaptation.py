"""Adaptation: what it learns, what it ignores, and how the car uses it."""

import dataclasses
import math

import numpy as np
import pytest

from map_racing.control.adaptation import DELAY_RATE, PRIOR, RISE, Adaptation
from map_racing.control.controller import build_controller
from map_racing.control.parameters import load_controller_parameters
from map_racing.control.speed_plan import AdaptiveSpeedPlan, SpeedPlan
from map_racing.control.state import CarState, predicted
from map_racing.simulation.car import SimulatedCar
from map_racing.simulation.plant import Localization, Plant
from map_racing.simulation.plants import build_plant, load_plant
from map_racing.simulation.race import Outcome, race
from map_racing.track.files.load import load_raceline
from map_racing.vehicle.parameters import load_vehicle, save_vehicle, scaled_tires
from map_racing.vehicle.tire_steering import TireSteering

NUC4 = load_vehicle("nuc4")
PLANT = load_plant("nuc4")
REFERENCE = load_raceline("reference")
ADAPTIVE = load_controller_parameters("map_adaptive").with_(speed_scale=1.0)
OFF = ADAPTIVE.with_(adaptation=False)


def slalom(t, amplitude=0.3):
    """Steering angle [rad] for bends to both sides, held and quickly entered."""
    return amplitude * max(-1.0, min(1.0, 2.5 * math.sin(2.6 * t) + 0.3 * math.sin(9.0 * t)))


def driven(changes=None, duration=20.0, steer=slalom, speed=5.0, rate=None, seed=1, grip=None):
    """Poses and commands of a car that is steered by the clock, on an endless floor."""
    plant = dataclasses.replace(PLANT, **(changes or {}))
    car = SimulatedCar(Plant(plant), Localization(plant, seed), rate)
    angle, samples = 0.0, []
    while car.now < duration:
        for seen in car.observe()[1]:
            angle = steer(seen.measured.t)
            samples.append((seen.measured, angle))
        if grip is not None:
            car.plant.set_grip(grip(car.now))
        car.advance(angle, speed)
    return samples


def learned(samples, **options):
    adaptation = Adaptation(NUC4, 12.0, 0.07, **options)
    for state, angle in samples:
        adaptation.update(state, angle)
    return adaptation


@pytest.fixture(scope="module")
def drive():
    return driven()


# -- what it finds -------------------------------------------------------------------------------


@pytest.mark.once
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"mu_scale": 0.85},
        {"front_stiffness_scale": 0.75},
        {"rear_stiffness_scale": 0.65},
        {"steering_delay_s": 0.04},
        {"steering_time_constant_s": 0.06},
    ],
    ids=str,
)
def test_it_finds_tires_and_delay_of_a_car_that_it_does_not_know(changes):
    plant = dataclasses.replace(PLANT, **changes)
    belief = learned(driven(changes)).belief
    assert belief.friction == pytest.approx(plant.mu_scale, rel=0.03)
    assert belief.front_stiffness == pytest.approx(plant.front_stiffness_scale, rel=0.05)
    assert belief.rear_stiffness == pytest.approx(plant.rear_stiffness_scale, rel=0.16)
    delay = plant.localization_latency_s + plant.steering_delay_s + plant.steering_time_constant_s
    assert belief.delay == pytest.approx(delay, abs=0.005)
    # The intervals are honest: the truth is inside, or outside by less than their width.
    for low, true, high in (
        (belief.friction_low, plant.mu_scale, belief.friction_high),
        (belief.front_stiffness_low, plant.front_stiffness_scale, belief.front_stiffness_high),
        (belief.delay_low, delay, belief.delay_high),
    ):
        width = high - low
        assert low - 0.5 * width < true < high + 0.5 * width


@pytest.mark.once
def test_poses_at_another_rate_and_without_lateral_velocity_tell_the_same():
    samples = driven({"mu_scale": 0.85, "measures_v_y": False}, rate=100.0)
    belief = learned(samples).belief
    assert belief.friction == pytest.approx(0.85, rel=0.03)
    assert belief.delay == pytest.approx(0.07, abs=0.006)
    # Only the lateral velocity shows how stiff such a rear axle is; without it, the interval is
    # wide.
    assert belief.rear_stiffness_high / belief.rear_stiffness_low > 1.5


def test_below_the_limit_only_the_product_is_known():
    belief = learned(driven({"mu_scale": 0.85}, steer=lambda t: slalom(t, 0.1), speed=4.0)).belief
    product = belief.friction * belief.front_stiffness
    assert product == pytest.approx(0.85 * PLANT.front_stiffness_scale, rel=0.05)
    assert belief.friction_high / belief.friction_low > 1.25


def test_braking_shifts_load_that_the_vehicle_file_does_not_know_of():
    """The public simulator's car, whose center of gravity is 74 mm high instead of 20."""
    plant, sim = load_plant("public_simulator"), load_vehicle("sim")
    changes = {"speed_scale": 0.8, "reference_point": plant.reference_point}
    controller = build_controller(OFF.with_(**changes), sim, REFERENCE)
    log = race(build_plant(plant, 1)[0], controller, REFERENCE, laps=2)
    adaptation = Adaptation(sim, 12.0, 0.07, behind=0.0)
    for sample in log.samples:
        adaptation.update(sample.measured, sample.result.steering_angle)
    friction, front, rear = adaptation.belief.factors
    # With the wrong load they are 0.64.
    assert (friction * front, friction * rear) == pytest.approx((1.0, 1.0), rel=0.25)


# -- what it leaves alone ------------------------------------------------------------------------


def untouched(samples):
    before = learned([]).belief
    return learned(samples).belief == before


def test_straights_say_nothing():
    assert untouched(driven(steer=lambda t: 0.0))


@pytest.mark.once
def test_it_says_why_a_pose_taught_nothing_and_from_how_much_it_learned(drive):
    adaptation = learned([])
    assert (adaptation.frozen, adaptation.learned_s) == ("no earlier pose", 0.0)
    reasons = set()
    for k, (state, angle) in enumerate(drive):
        adaptation.update(state._replace(r=state.r + 6.0) if k == 600 else state, angle)
        assert k != 600 or adaptation.frozen == "a pose that the belief cannot explain"
        reasons.add(adaptation.frozen)
    assert "" in reasons and "too slow" in reasons
    assert 10.0 < adaptation.learned_s < drive[-1][0].t
    t = drive[-1][0].t + 5.0  # after a pause, the motion is set to the measured one
    for k in range(2):
        adaptation.update(CarState(t + 0.025 * k, 0.0, 0.0, 0.0, 3.0, -4.0, 6.0), 0.1)
    assert adaptation.frozen == "sliding"
    adaptation.forget()
    assert (adaptation.frozen, adaptation.learned_s) == ("no earlier pose", 0.0)
    straight = learned(driven(steer=lambda t: 0.0))
    assert (straight.frozen, straight.learned_s) == ("too little grip in use", 0.0)


def test_walking_pace_and_stops_say_nothing():
    assert untouched(driven(speed=1.0))
    still = CarState(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    assert untouched([(still._replace(t=0.025 * k), 0.3) for k in range(400)])


def test_a_spin_says_nothing(drive):
    adaptation = learned(drive)
    before = adaptation.belief
    t = drive[-1][0].t
    for k in range(1, 80):
        slide = CarState(t + 0.025 * k, 0.0, 0.0, 0.0, 3.0, -4.0, 6.0)
        adaptation.update(slide, 0.1)
    # It takes a few poses to detect the slide.
    assert adaptation.belief.factors == pytest.approx(before.factors, rel=0.03)


def test_a_curb_says_nothing(drive):
    """One pose has a yaw rate that no floor can explain."""
    plain, hit = (Adaptation(NUC4, 12.0, 0.07) for _ in range(2))
    for k, (state, angle) in enumerate(drive):
        plain.update(state, angle)
        hit.update(state._replace(r=state.r + 6.0) if k == 600 else state, angle)
        if k == 600:
            assert hit.belief.factors == pytest.approx(plain.belief.factors, rel=5e-3)


@pytest.mark.once
def test_what_is_believed_stays_within_its_share():
    belief = learned(driven({"mu_scale": 0.7}), share=0.1).belief
    assert belief.friction == pytest.approx(0.9)
    unmoved = learned(driven({"mu_scale": 0.7}), share=0.0).belief
    assert unmoved.factors == (1.0, 1.0, 1.0)


def test_the_delay_in_use_follows_the_believed_one_slowly():
    adaptation = Adaptation(NUC4, 12.0, 0.07)
    before, learned_before = adaptation.delay, 0.0
    for state, angle in driven({"steering_delay_s": 0.06}):
        adaptation.update(state, angle)
        step, learned_s = adaptation.delay - before, adaptation.learned_s - learned_before
        assert abs(step) <= DELAY_RATE * learned_s + 1e-12
        before, learned_before = adaptation.delay, adaptation.learned_s
    assert adaptation.delay == pytest.approx(adaptation.belief.delay, abs=2e-3)
    adaptation.forget()
    assert adaptation.delay == pytest.approx(0.07)


# -- down quickly, up slowly ---------------------------------------------------------------------


@pytest.mark.once
def test_the_grip_follows_down_within_a_bend_and_up_slowly():
    fall, rise = 10.0, 20.0
    samples = driven(duration=45.0, grip=lambda t: 0.8 if fall < t < rise else 1.0)
    adaptation = Adaptation(NUC4, 12.0, 0.07)
    grips = []
    for state, angle in samples:
        adaptation.update(state, angle)
        grips.append((state.t, adaptation.grip))
    t, grip = np.array(grips).T
    true = PLANT.mu_scale
    assert grip[np.searchsorted(t, fall) - 1] > 0.9 * true
    assert grip[np.searchsorted(t, fall + 0.7)] < 0.86 * true
    assert grip[np.searchsorted(t, rise) - 1] == pytest.approx(0.77 * true, rel=0.03)
    assert np.max(np.diff(grip)) <= RISE * 0.0261
    assert grip[-1] > 0.92 * true


def test_the_grip_does_not_rise_without_evidence_near_the_limit():
    adaptation = Adaptation(NUC4, 12.0, 0.07)
    cautious = adaptation.grip
    assert cautious == pytest.approx(math.exp(-PRIOR[0]))
    for state, angle in driven(steer=lambda t: slalom(t, 0.1), speed=4.0, duration=10.0):
        adaptation.update(state, angle)
        assert adaptation.grip <= cautious


# -- live, replayed, forgotten -------------------------------------------------------------------


@pytest.mark.once
def test_a_race_is_replayed_to_the_last_bit():
    plant = Plant(PLANT)
    controller = build_controller(ADAPTIVE, NUC4, REFERENCE)
    log = race(plant, controller, REFERENCE, Localization(PLANT, 3), laps=1)
    again = Adaptation(NUC4, ADAPTIVE.v_max_mps, ADAPTIVE.delay_s)
    again.slowest = controller.plan.slowest
    for sample in log.samples:
        again.update(sample.measured, sample.result.steering_angle)
        assert again.belief == sample.belief
    assert controller.adaptation.belief == again.belief != learned([]).belief


@pytest.mark.parametrize("between", [lambda c: None, lambda c: c.learn(), lambda c: c.reset()])
def test_a_step_teaches_once_whoever_asks(drive, between):
    """At once, in the next step, or before the history is dropped."""
    controller, steps = build_controller(ADAPTIVE, NUC4, REFERENCE), []
    update = controller.adaptation.update
    controller.adaptation.update = lambda *step: steps.append(step) or update(*step)
    states = [state for state, _ in drive[:5]]
    angles = []
    for state in states:
        angles.append(controller.step(state).steering_angle)
        assert len(steps) == len(angles) - 1
        between(controller)
        if len(steps) == len(angles):
            continue
        controller.step(state._replace(x=math.nan))
    assert steps == list(zip(states, angles))


def test_what_was_driven_before_a_switch_is_learned_by_what_drove_it(drive):
    controller = build_controller(ADAPTIVE, NUC4, REFERENCE)
    steps, (state, _) = [], drive[0]
    controller.adaptation.update = lambda *step: steps.append(step)
    angle = controller.step(state).steering_angle
    assert not steps
    controller.change(parameters=OFF)
    assert steps == [(state, angle)]


def test_a_pause_restarts_the_model_and_keeps_the_belief(drive):
    adaptation = learned(drive)
    before = adaptation.belief
    state, angle = drive[-1]
    adaptation.update(state._replace(t=state.t + 5.0, x=9.0), 0.3)
    adaptation.update(state._replace(t=1.0), angle)
    assert adaptation.belief == before
    adaptation.forget()
    assert adaptation.belief == learned([]).belief
    assert adaptation.steering is adaptation.file_steering


def test_the_believed_vehicle_is_the_files_with_other_tires(drive):
    adaptation = learned(drive)
    assert adaptation.believed_vehicle() == scaled_tires(NUC4, *adaptation.belief.factors)
    belief, text = adaptation.belief, adaptation.summary()
    assert f"friction {belief.friction:.3f} ({belief.friction_low:.3f} to" in text
    assert f"from {adaptation.learned_s:.0f} s of driving" in text and "NUC4" in text


@pytest.mark.once
def test_it_starts_from_a_saved_vehicle_as_well(tmp_path):
    """The result of one run is the prior of the next, which then has little to learn."""
    samples = driven({"mu_scale": 0.85})
    first = learned(samples)
    save_vehicle(first.believed_vehicle(), tmp_path / "day.yaml", first.summary())
    saved = load_vehicle(tmp_path / "day.yaml")
    assert saved == first.believed_vehicle()
    again = Adaptation(saved, 12.0, first.delay)
    for state, angle in samples:
        again.update(state, angle)
    assert again.belief.friction == pytest.approx(1.0, abs=0.02)
    assert again.believed_vehicle().mu == pytest.approx(0.85 * NUC4.mu, rel=0.03)


# -- the controller ------------------------------------------------------------------------------


def lap_times(log):
    """Times between crossings of the start line."""
    t, x, y = log.true_path().T[:3]
    s = np.array([REFERENCE.project(*at).s for at in zip(x, y)])
    at = np.flatnonzero(np.diff(s) < -0.5 * REFERENCE.length)
    gap = REFERENCE.length + s[at + 1] - s[at]
    crossing = t[at] + (t[at + 1] - t[at]) * (REFERENCE.length - s[at]) / gap
    return np.diff(crossing)


def raced(plant, parameters, vehicle=NUC4, laps=4, seed=1):
    controller = build_controller(parameters, vehicle, REFERENCE)
    log = race(Plant(plant), controller, REFERENCE, Localization(plant, seed), laps=laps)
    assert log.outcome is Outcome.COMPLETED
    return lap_times(log), log


@pytest.mark.once
@pytest.mark.parametrize("changes", [{"mu_scale": 0.88}, {"mu_scale": 1.08}], ids=str)
def test_a_cold_start_comes_close_to_one_that_was_told(changes):
    plant = dataclasses.replace(PLANT, **changes)
    true = scaled_tires(
        NUC4, plant.mu_scale, plant.front_stiffness_scale, plant.rear_stiffness_scale
    )
    told, _ = raced(plant, OFF, true, laps=2)
    cold, _ = raced(plant, ADAPTIVE)
    assert told[-1] < cold[-1] < 1.03 * told[-1]


@pytest.mark.once
@pytest.mark.parametrize("changes", [{"mu_scale": 1.12}, {"front_stiffness_scale": 1.16}], ids=str)
def test_it_drives_a_plant_that_is_not_its_model(changes):
    """The public simulator's servo moves in steps, and its braking unloads the rear axle more."""
    plant = dataclasses.replace(load_plant("public_simulator"), **changes)
    took = []
    for parameters in (ADAPTIVE, OFF):
        parameters = parameters.with_(slip_lookahead=0.5, reference_point=plant.reference_point)
        controller = build_controller(parameters, load_vehicle("sim"), REFERENCE)
        log = race(build_plant(plant, 1)[0], controller, REFERENCE, laps=3)
        assert log.outcome is Outcome.COMPLETED
        took.append(log.duration)
    assert took[0] < 1.03 * took[1]


@pytest.mark.once
def test_a_sudden_loss_of_grip_ends_on_the_track():
    plant = dataclasses.replace(PLANT, grip_changes=[{"factor": 0.8, "after_s": 21.0}])
    slippery = dataclasses.replace(PLANT, mu_scale=0.8 * PLANT.mu_scale)
    true = scaled_tires(
        NUC4, slippery.mu_scale, PLANT.front_stiffness_scale, PLANT.rear_stiffness_scale
    )
    told, _ = raced(slippery, OFF, true, laps=2)
    laps, log = raced(plant, ADAPTIVE, laps=5)
    assert laps[-1] < 1.02 * told[-1]
    assert max(abs(REFERENCE.project(*sample.true[1:3]).d) for sample in log.samples) < 0.2


def test_switched_off_it_drives_as_without_and_on_again_it_knows_what_it_learned():
    controller = build_controller(ADAPTIVE, NUC4, REFERENCE)
    race(Plant(PLANT), controller, REFERENCE, Localization(PLANT, 1), laps=1)
    learning = controller.adaptation
    believed = learning.belief
    controller.change(parameters=OFF)
    assert controller.adaptation is None
    plain = build_controller(OFF, NUC4, REFERENCE)
    for subject in (controller, plain):
        subject.reset()
    state = CarState(100.0, *REFERENCE.position(5.0), REFERENCE.pose(5.0).psi, 4.0, 0.0, 0.0)
    assert controller.step(state) == plain.step(state)
    controller.change(parameters=ADAPTIVE)
    assert controller.adaptation is learning and learning.belief == believed
    assert controller.plan.grips is learning.grips and min(learning.grips) == believed.grip
    assert controller.max_lateral_acceleration(6.0) == pytest.approx(
        learning.steering.max_lateral_acceleration(6.0)
    )


@pytest.mark.once
def test_another_delay_that_is_given_while_driving_counts_at_once(drive):
    controller = build_controller(ADAPTIVE, NUC4, REFERENCE)
    for state, _ in drive:
        controller.step(state)
    controller.learn()
    learning = controller.adaptation
    believed = learning.belief
    controller.change(parameters=ADAPTIVE.with_(speed_scale=0.5))
    assert learning.belief == believed
    controller.change(parameters=ADAPTIVE.with_(delay_s=0.12))
    given = Adaptation(NUC4, 12.0, 0.12).belief
    assert learning.belief[9:12] == given[9:12] and learning.belief.factors == believed.factors
    (state, _), at = drive[0], 200.0
    result = controller.step(state._replace(t=at))
    assert result.state == predicted(state._replace(t=at), 0.12)
    controller.reset()
    learning.forget()
    assert learning.belief == given
    # Also one set while learning is off.
    controller.change(parameters=OFF.with_(delay_s=0.04))
    controller.change(parameters=ADAPTIVE.with_(delay_s=0.04))
    assert controller.adaptation is learning and learning.delay == pytest.approx(0.04)


def test_from_a_delay_given_while_driving_it_learns_as_before():
    samples = driven(duration=30.0)
    adaptation = learned(samples[:400])
    adaptation.expect_delay(0.15)
    assert adaptation.delay == pytest.approx(0.15)
    for state, angle in samples[400:]:
        adaptation.update(state, angle)
    assert adaptation.belief.delay == pytest.approx(learned(samples).belief.delay, abs=0.005)


def test_the_adaptive_controller_is_the_default_that_learns():
    default = load_controller_parameters("map")
    same = ADAPTIVE.with_(
        adaptation=False, grip_use=default.grip_use, speed_scale=default.speed_scale
    )
    assert same == default and ADAPTIVE.adaptation


# -- speeds for any grip -------------------------------------------------------------------------


@pytest.mark.once
@pytest.mark.parametrize("level", [0.64, 0.855, 1.05])
def test_an_adaptive_plan_is_the_plan_of_its_level(level):
    steering = TireSteering(NUC4, 12.0)
    adaptive = AdaptiveSpeedPlan(REFERENCE, ADAPTIVE, steering)
    adaptive.grips = [level] * len(steering.levels)
    made = SpeedPlan(REFERENCE, ADAPTIVE, steering.scaled(level, 1.0, 1.0))
    assert adaptive.speed == pytest.approx(made.speed, rel=0.012)
    assert np.mean(np.abs(adaptive.speed / made.speed - 1.0)) < 1e-3
    assert adaptive.lap_time == pytest.approx(made.lap_time, rel=1e-3)
    for s in (0.0, 7.3, 19.9):
        assert adaptive.speed_at(s) == pytest.approx(made.speed_at(s), rel=0.012)


def test_beyond_its_levels_an_adaptive_plan_stays_at_the_last():
    steering = TireSteering(NUC4, 12.0)
    adaptive = AdaptiveSpeedPlan(REFERENCE, ADAPTIVE, steering)
    adaptive.grips = [adaptive.LEVELS[0]] * len(steering.levels)
    slowest = adaptive.speed
    adaptive.grips = [0.01] * len(steering.levels)
    assert np.array_equal(adaptive.speed, slowest)


def test_bends_that_stiffness_hardly_matters_in_are_not_driven_as_those_that_it_costs_most_in():
    """Soft front tires take a tenth of the limit at 2.5 m/s, and none of it from 5 m/s on."""
    steering = TireSteering(NUC4, 12.0)
    soft = steering.scaled(1.0, 0.75, 1.0)
    adaptive = AdaptiveSpeedPlan(REFERENCE, ADAPTIVE, steering)
    adaptive.grips = soft.levels
    speed = adaptive.speed
    slow, fast = (
        SpeedPlan(REFERENCE, ADAPTIVE, steering.scaled(level, 1.0, 1.0)).speed
        for level in (soft.level(0.0), 1.0)
    )
    at = int(np.argmin(slow))
    assert soft.level(0.0) < 0.93 and soft.level(5.0) > 0.99
    assert speed[at] == pytest.approx(slow[at], rel=0.01)
    kappa = np.abs(REFERENCE.sample(adaptive.s).kappa)
    bends = (speed > 5.0) & (speed**2 * kappa > 0.9 * ADAPTIVE.grip_use * soft.limit(6.0))
    assert np.count_nonzero(bends) > 20
    assert speed[bends] == pytest.approx(fast[bends], rel=0.01)
    places = adaptive.s[::40].tolist()
    assert [adaptive.speed_at(s) for s in places] == pytest.approx(speed[::40], rel=1e-9)
    # Braking into slow bends hardly exceeds the plan.
    slowing = np.diff(speed**2) / (-2.0 * adaptive.ds)
    assert slowing.max() < 1.06 * ADAPTIVE.a_brake_max_mps2
