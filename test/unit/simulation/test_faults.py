"""Faults by name: their effects on measurements and commands, and refusals."""

import dataclasses
import math
import re
from pathlib import Path

import pytest

from map_racing.control.controller import build_controller
from map_racing.control.parameters import load_controller_parameters
from map_racing.control.safety_limits import SafetyLimits
from map_racing.control.state import CarState
from map_racing.errors import FileFormatError, ParameterError
from map_racing.simulation.car import DrivenCar, Observation, SimulatedCar
from map_racing.simulation.faults import KINDS, Fault, Faults, load_faults
from map_racing.simulation.plant import Localization, Plant
from map_racing.simulation.plants import build_plant, load_plant
from map_racing.simulation.race import Outcome, race
from map_racing.simulation.rehearsal import rehearsal_track
from map_racing.track.files.load import load_raceline

REPO = Path(__file__).resolve().parents[3]
STATE = (0.5, 3.0, 4.0, 0.0, 2.0, 0.1, 0.3)


@pytest.fixture(scope="module")
def parameters():
    return load_plant("nuc4")


def faulty(parameters, *schedule, where="simulator"):
    """A plant at 2 m/s, with faults at 0.5 s."""
    plant = Plant(parameters)
    plant.reset(3.0, 4.0, 0.0, 2.0)
    faults = Faults(schedule, plant, where)
    faults.update(0.5, 0.0)
    return plant, faults


def seen(t=0.5, **changes):
    state = CarState(*STATE)._replace(t=t, **changes)
    return Observation(state, state, t + 0.02, (0.0, 0.0))


MEASURED = [
    ("pose_jump", 1.5, {"y": 5.5}),
    ("pose_turn", 0.7, {"psi": 0.7}),
    ("pose_drift", 0.5, {"y": 4.0}),  # begins at 0.5 s
    ("pose_future", 0.3, {"t": 0.8}),
    ("velocity_missing", None, {"v_x": 0.0, "v_y": 0.0}),
    ("velocity_absurd", 1e9, {"v_x": 1e9}),
    ("velocity_reversed", None, {"v_x": -2.0}),
    ("wheel_slip", 1.25, {"v_x": 2.5}),
    ("yaw_rate_missing", None, {"r": 0.0}),
]


@pytest.mark.parametrize(("name", "size", "changes"), MEASURED, ids=lambda value: str(value)[:20])
def test_what_is_measured(parameters, name, size, changes):
    _, faults = faulty(parameters, Fault(name, size=size))
    taken = seen()
    (got,) = faults.measured(taken)
    assert got.true == taken.true
    assert got.measured == pytest.approx(taken.measured._replace(**changes))


def test_other_measurements(parameters):
    _, faults = faulty(parameters, Fault("pose_dropout"))
    assert faults.measured(seen()) == []
    _, faults = faulty(parameters, Fault("pose_delay", size=0.25))
    assert faults.measured(seen())[0].arrival == pytest.approx(0.77)
    _, faults = faulty(parameters, Fault("pose_frame"))
    assert faults.measured(seen())[0].frame == "odom"
    _, faults = faulty(parameters, Fault("pose_nan"))
    assert math.isnan(faults.measured(seen())[0].measured.x)
    _, faults = faulty(parameters, Fault("quaternion_length", size=2.0))
    assert faults.measured(seen())[0].quaternion == 2.0
    _, faults = faulty(parameters, Fault("pose_noise", size=0.1))
    errors = [faults.measured(seen())[0].measured.x - 3.0 for _ in range(2000)]
    assert math.sqrt(sum(e * e for e in errors) / 2000) == pytest.approx(0.1, rel=0.06)
    _, faults = faulty(parameters, Fault("pose_drift", size=0.5))
    assert faults.measured(seen(1.5))[0].measured.y == pytest.approx(4.5)


def test_frozen_stuck_and_jittering_poses(parameters):
    first = seen(0.4)
    for name in ("pose_frozen", "pose_stuck", "pose_jitter"):
        _, faults = faulty(parameters, Fault(name, at_s=1.0))
        faults.measured(first)
        faults.update(1.0, 0.0)
        (got,) = faults.measured(seen(1.0, x=9.0, v_x=3.0))
        assert got.measured.x == pytest.approx(3.0, abs=0.01)
        assert got.measured.t == (0.4 if name == "pose_frozen" else 1.0)
        assert got.measured.v_x == {"pose_frozen": 2.0, "pose_stuck": 3.0, "pose_jitter": 0.0}[name]


def test_what_becomes_of_commands(parameters):
    commanded = {
        ("servo_offset", 0.05): (0.15, 3.0),
        ("servo_stuck", None): (0.0, 3.0),
        ("motor_runaway", 7.0): (0.1, 7.0),
        ("motor_dead", None): (0.1, 0.0),
        ("battery_sag", 2.5): (0.1, 2.5),
        ("drive_loss", None): (0.1, 0.0),
    }
    for (name, size), expected in commanded.items():
        _, faults = faulty(parameters, Fault(name, size=size))
        assert faults.commanded(0.1, 3.0) == pytest.approx(expected), name


def test_a_slow_servo_and_a_late_drive(parameters):
    plant, faults = faulty(parameters, Fault("servo_slow", size=0.5))
    for _ in range(100):
        angle, _ = faults.commanded(0.4, 3.0)
    assert angle == pytest.approx(100 * plant.time_step * 0.5)
    _, faults = faulty(parameters, Fault("drive_delay", size=0.1))
    sent = [faults.commanded(0.0, 0.01 * k)[1] for k in range(200)]
    assert sent[150] == pytest.approx(0.01 * 100)


@pytest.mark.parametrize("name", ["nuc4", "public_simulator"])
def test_both_plants_do_all_of_it(name):
    """Braking, driving off, friction, and a blocked car."""
    for fault, size in (("motor_weak", 0.2), ("brakes_weak", 0.2), ("motor_dead", None)):
        told = 0.0 if fault == "brakes_weak" else 6.0
        speeds = []
        for schedule in ((), (Fault(fault, size=size),)):
            plant, _ = build_plant(load_plant(name), 1)
            plant.reset(0.0, 0.0, 0.0, 3.0)
            car = SimulatedCar(plant, faults=Faults(schedule, plant, "race"))
            car.faults.update(0.0, 0.0)
            for _ in range(round(0.3 / plant.time_step)):
                car.advance(0.0, told)
            speeds.append(plant.reference_state().v_x)
        healthy, weak = (abs(speed - 3.0) for speed in speeds)
        assert weak < 0.35 * healthy, fault
    plant.reset(1.0, 2.0, 0.5, 3.0)
    car = SimulatedCar(plant, faults=Faults([Fault("blocked", for_s=0.5)], plant, "race"))
    car.faults.update(0.0, 0.0)
    for _ in range(round(0.3 / plant.time_step)):
        car.advance(0.1, 3.0)
    assert plant.reference_state()[1:5] == pytest.approx((1.0, 2.0, 0.5, 0.0))
    car.faults.update(0.6, 0.0)
    for _ in range(round(0.3 / plant.time_step)):
        car.advance(0.0, 3.0)
    assert plant.reference_state().v_x > 0.2


def test_time_and_place(parameters):
    plant, faults = faulty(parameters)
    faults.add(Fault("pose_nan", at_s=1.0, for_s=2.0, from_m=9.0, to_m=1.0))
    for t, s, there in ((0.9, 9.5, False), (1.0, 9.5, True), (2.0, 0.5, True), (2.0, 5.0, False)):
        faults.update(t, s)
        assert ("pose_nan" in faults.active) is there
    begun, ended = faults.update(2.5, 0.0)
    assert [fault.fault for fault in begun] == ["pose_nan"] and not ended
    begun, ended = faults.update(3.0, 0.0)
    assert not begun and [fault.fault for fault in ended] == ["pose_nan"]


def test_what_a_fault_did_ends_with_it(parameters):
    plant, faults = faulty(
        parameters, *(Fault(name, for_s=1.0) for name in ("grip_lost", "motor_dead", "servo_stuck"))
    )
    before = Plant(parameters)
    faults.update(2.0, 0.0)
    for car in (plant, before):
        car.reset(0.0, 0.0, 0.0, 3.0)
        for _ in range(200):
            car.advance(*faults.commanded(0.2, 4.0))
    assert plant.state == before.state


def test_grip_is_lost_also_where_it_changes(parameters):
    changes = [{"factor": 0.8, "from_m": 5.0, "to_m": 9.0}]
    parameters = dataclasses.replace(parameters, grip_changes=changes)
    plant, faults = faulty(parameters, Fault("grip_lost", 1.0, 1.0, size=0.5))
    car = DrivenCar(SimulatedCar(plant, faults=faults), rehearsal_track())
    car.put(7.0, 0.0, 0.0)
    factors = []
    plant.set_grip = factors.append
    plant.measured_state = plant.reference_state
    for _ in car.advance_to(round(3.0 / plant.time_step)):
        pass
    assert factors[::40] == pytest.approx([0.8, 0.4, 0.8])


def test_poses_arrive_in_order_when_a_delay_ends(parameters):
    plant, faults = faulty(parameters, Fault("pose_delay", 0.2, 0.5, size=1.0))
    car = SimulatedCar(plant, Localization(parameters, 1), faults=faults)
    arrivals, stamps = [], []
    while car.now < 3.0:
        faults.update(car.now, 0.0)
        for seen in car.observe()[1]:
            assert seen.arrival == pytest.approx(car.now, abs=plant.time_step)
            arrivals.append(seen.arrival)
            stamps.append(seen.measured.t)
        car.advance(0.0, 1.0)
    assert arrivals == sorted(arrivals) and stamps == sorted(stamps)
    assert arrivals[-1] - stamps[-1] == pytest.approx(parameters.localization_latency_s)


# -- refusals ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [name for name, kind in KINDS.items() if kind.default is not None])
def test_the_range_that_is_told_is_valid(name):
    kind = KINDS[name]
    for size in (kind.low, kind.high):
        assert Fault(name, size=size).size == size
        beyond = size + (0.01 if size == kind.high else -0.01) * max(abs(size), 1.0)
        with pytest.raises(ParameterError, match="size: expected"):
            Fault(name, size=beyond)


def test_the_race_says_what_it_cannot_do(parameters):
    for name, kind in KINDS.items():
        for where in ("race", "simulator"):
            if where not in kind.where:
                with pytest.raises(ParameterError, match=f"{name}: only .*, not .*{where}"):
                    faulty(parameters, Fault(name), where=where)


def test_a_plant_without_the_method_says_so(parameters):
    class Bare:
        steering_angle = 0.0

    with pytest.raises(ParameterError, match="grip_lost: this plant cannot"):
        Faults([Fault("grip_lost")], Bare(), "race")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("- {fault: pose_nan}", "expected a schedule of faults .YAML., got a list"),
        ("faults: pose_nan", "faults: expected a list, got str"),
        ("faults:", "faults: expected a list, got NoneType"),
        ("faults: [pose_nan]", "entry 1: expected fault: NAME, got 'pose_nan'"),
        ("faults: [{fault: pose_nan}, {fault: magic}]", r"entry 2: fault: .*, got 'magic'$"),
        ("faults: [{fault: pose_jmp}]", r"--list names, got 'pose_jmp' \(like pose_jump"),
        ("faults: [{fault: [pose_jump]}]", r"fault: .*, got \['pose_jump'\]"),
        ("faults: [{fault: }]", "entry 1: fault: .*, got None"),
        ("faults: [{fault: pose_nan, after: 3}]", r"entry 1: unknown after \(known: fault, at_s"),
        ("faults: [{fault: pose_nan, size: 3}]", "entry 1: size: pose_nan has none, got 3"),
        ("faults: [{fault: pose_jump, size: far}]", "entry 1: size: expected a finite number"),
        ("faults: [{fault: grip_lost, size: 7}]", "size: expected 0.1 to 2 for grip_lost, got 7"),
        ("faults: [{fault: pose_nan, at_s: -1}]", "entry 1: at_s: expected 0 or more, got -1"),
        ("faults: [{fault: pose_nan}]\nseed: 3", "expected one list, faults, got faults, seed"),
    ],
)
def test_schedules_that_are_refused(tmp_path, text, words):
    path = tmp_path / "faults.yaml"
    path.write_text(text)
    with pytest.raises((ParameterError, FileFormatError), match=words):
        load_faults(path)


@pytest.mark.parametrize(
    ("place", "good"), [("36.4, to_m: 36.5", 1), ("36.5, to_m: 3", 0), ("3, to_m: 37", 0)]
)
def test_places_are_on_the_lap(tmp_path, place, good):
    path = tmp_path / "faults.yaml"
    path.write_text(f"faults: [{{fault: grip_lost, from_m: {place}}}]")
    if good:
        assert load_faults(path, 36.5)[0].from_m == 36.4
        return
    with pytest.raises(ParameterError, match="entry 1: from_m, to_m: expected a place on the lap"):
        load_faults(path, 36.5)


def test_the_schedule_of_the_page_stops_the_car_as_it_says_and_is_completed(parameters, tmp_path):
    page = (REPO / "doc" / "safety.md").read_text(encoding="utf-8")
    (tmp_path / "faults.yaml").write_text(re.search(r"```yaml\n(.*?)```", page, re.S).group(1))
    line = load_raceline("reference")
    controller = build_controller(load_controller_parameters("map"), parameters.vehicle, line)
    plant, localization = build_plant(parameters, 1)
    schedule = load_faults(tmp_path / "faults.yaml")
    log = race(plant, controller, line, localization, laps=2, faults=schedule)
    assert log.outcome is Outcome.COMPLETED
    twice = ["pose too old", "pose jumped"] * 2
    assert [why.value for _, why, _ in log.stops()] == [*twice, "no motion although commanded"]
    assert all(math.isfinite(again) for *_, again in log.stops())
    # A simulator node can inject each of them, too.
    assert all(KINDS[fault.fault].where == ("race", "simulator") for fault in schedule)


# -- in a race -----------------------------------------------------------------------------------


@pytest.mark.once
def test_without_faults_supervision_changes_nothing(parameters):
    """Laps at the shipped speeds have identical commands and no stop."""
    line = load_raceline("reference")
    controller = build_controller(load_controller_parameters("map"), parameters.vehicle, line)
    logs = []
    for limits in (None, SafetyLimits()):
        plant, localization = build_plant(parameters, 1)
        logs.append(race(plant, controller, line, localization, laps=1, limits=limits))
    assert [log.outcome for log in logs] == [Outcome.COMPLETED] * 2
    assert logs[0].duration == logs[1].duration
    for alone, supervised in zip(*(log.samples for log in logs)):
        # Except for rounding, the lock is also the table's last angle.
        assert alone.result[:2] == pytest.approx(supervised.result[:2], abs=1e-12)
    assert logs[1].stops() == [] and len(logs[1].commands) == len(logs[1].samples)


def test_the_same_faults_give_the_same_race(parameters):
    track = rehearsal_track()
    controller = build_controller(load_controller_parameters("map"), parameters.vehicle, track)
    schedule = [Fault("pose_noise", 1.0, 1.0), Fault("pose_dropout", 2.0, 0.5)]
    first, second = (
        race(
            *build_plant(parameters, 3)[:1],
            controller,
            track,
            build_plant(parameters, 3)[1],
            time_limit=5.0,
            faults=schedule,
        )
        for _ in range(2)
    )
    assert first.commands == second.commands and first.truth == second.truth
