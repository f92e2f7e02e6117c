"""Delays of cars with known delays."""

import dataclasses
import json
import math
import random
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.rosbag1 import Writer

from map_racing.bags.opening import open_bag
from map_racing.bags.writer import BagWriter
from map_racing.cli import main
from map_racing.control.controller import build_controller
from map_racing.control.parameters import load_controller_parameters
from map_racing.errors import ParameterError
from map_racing.identification import delay
from map_racing.identification.data import Run, Signal, load_run
from map_racing.identification.delay import Part, delay_data, delay_text, estimate_delays
from map_racing.resources import find_config
from map_racing.simulation.plants import build_plant, load_plant
from map_racing.simulation.race import race
from map_racing.simulation.recorded import write_race_bag
from map_racing.track.files.load import load_raceline
from map_racing.vehicle.parameters import load_vehicle

NUC4, SIM = load_vehicle("nuc4"), load_vehicle("sim")


def driven(plant_name, steering, rate=40.0, seconds=14.0, age=0.02, **changes):
    """A drive with open-loop commands at the rate of the poses, as a run."""
    parameters = dataclasses.replace(load_plant(plant_name), localization_rate_hz=rate, **changes)
    plant, localization = build_plant(parameters, seed=3)
    plant.reset(0.0, 0.0, 0.0, 2.5)
    rows = {name: [] for name in ("t", "v_x", "v_y", "r", "steering", "speed")}
    angle, speed, samples = 0.0, 2.5, 0
    for tick in range(round(seconds / plant.time_step)):
        t = tick * plant.time_step
        if t >= samples / rate - 1e-9:
            samples += 1
            angle = steering(t)
            speed = 3.0 + math.copysign(0.8, math.sin(1.9 * t))
            exact = localization is None
            seen = (
                plant.measured_state() if exact else localization.measure(plant.reference_state())
            )
            values = (t, seen.v_x, seen.v_y, seen.r, angle, speed)
            for name, value in zip(rows, values):
                rows[name].append(value)
        plant.advance(angle, speed)
    columns = {name: np.array(values) for name, values in rows.items()}
    t = columns["t"]
    signals = {
        "v_x": Signal(t, columns["v_x"]),
        "yaw_rate": Signal(t, columns["r"]),
        "steering": Signal(t, columns["steering"]),
        "speed_command": Signal(t, columns["speed"]),
    }
    if np.all(np.isfinite(columns["v_y"])):
        signals["v_y"] = Signal(t, columns["v_y"])
    return Run("a.bag", signals, pose_lag=(age, age, age))


def weaving(t):
    return 0.05 * math.sin(12.0 * t) + 0.08 * math.sin(5.0 * t) + 0.08 * math.sin(1.3 * t + 1.0)


def straight(t):
    return random.Random(round(1e4 * t)).gauss(0.0, 0.01)


@pytest.fixture(scope="module")
def shipped():
    return driven("nuc4", weaving, seconds=18.0)


@pytest.mark.once
def test_of_the_shipped_car(shipped):
    delays = estimate_delays([shipped], NUC4)
    for part, true in (
        (delays.pose_age, 0.02),
        (delays.steering, 0.05),
        (delays.delay, 0.07),
        (delays.drive_dead_time, 0.02),
        (delays.drive_lag, 0.1),
    ):
        assert part.status == "estimated"
        assert part.value == pytest.approx(true, abs=0.005)
        assert part.low <= part.value <= part.high
    # The shares of the sum are less certain.
    assert delays.steering_dead_time.low <= 0.02 <= delays.steering_dead_time.high
    assert delays.steering_lag.low <= 0.03 <= delays.steering_lag.high
    assert delays.speed_lookahead.value == pytest.approx(0.07, abs=0.01)


@pytest.mark.once
@pytest.mark.parametrize(("total", "rate", "scale"), [(0.02, 40.0, 0.9), (0.08, 100.0, 0.6)])
def test_from_laps_as_they_are_raced(tmp_path, total, rate, scale):
    """The extremes of what scripts/delays_of_laps measures."""
    share = total / 0.07
    changes = {
        "localization_latency_s": 0.02 * share,
        "steering_delay_s": 0.02 * share,
        "steering_time_constant_s": 0.03 * share,
    }
    plant = dataclasses.replace(load_plant("nuc4"), localization_rate_hz=rate, **changes)
    parameters = load_controller_parameters("map").with_(speed_scale=scale)
    raceline = load_raceline("reference")
    car, localization = build_plant(plant, 1)
    controller = build_controller(parameters, NUC4, raceline)
    log = race(car, controller, raceline, localization, laps=2)
    write_race_bag(tmp_path / "laps.bag", log, raceline)
    delays = estimate_delays([load_run(tmp_path / "laps.bag")], NUC4)
    assert delays.delay.value == pytest.approx(total, abs=0.005)
    assert delays.delay.low <= total <= delays.delay.high


@pytest.mark.once
def test_commands_that_are_stamped_with_the_pose_they_answer(tmp_path):
    """As from the controller node: they are sent when the pose has arrived."""
    raceline, parameters = load_raceline("reference"), load_controller_parameters("map")
    controller = build_controller(parameters, NUC4, raceline)
    car, localization = build_plant(load_plant("nuc4"), 1)
    log = race(car, controller, raceline, localization, laps=2)
    told = []
    for stamped in (False, True):
        path = tmp_path / f"{stamped}.bag"
        with BagWriter(path) as bag:
            for sample in log.samples:
                stamp, received = 1.6e9 + sample.measured.t, 1.6e9 + sample.arrival
                bag.odometry(stamp, *sample.measured[1:], received=received)
                command = sample.result.steering_angle, sample.result.speed
                bag.drive(stamp if stamped else received, *command, received=received)
        told.append(estimate_delays([load_run(path)], NUC4))
    apart = [abs(a.value - b.value) for a, b in zip(*([d.delay, d.steering] for d in told))]
    assert max(apart) < 1e-4
    assert told[1].delay.value == pytest.approx(0.07, abs=0.005)
    assert any("stamped with the poses, sent 0.020 s later" in note for note in told[1].notes)


@pytest.mark.once
def test_without_a_file_of_the_car(shipped):
    delays = estimate_delays([shipped], others=(NUC4, SIM))
    assert delays.delay.value == pytest.approx(0.07, abs=0.005)


def test_a_car_to_begin_from_is_needed(shipped):
    with pytest.raises(ParameterError, match="expected the car's vehicle"):
        estimate_delays([shipped])


@pytest.mark.once
def test_short_delays_at_another_rate():
    changes = {"steering_delay_s": 0.01, "steering_time_constant_s": 0.01}
    run = driven("nuc4", weaving, 100.0, 12.0, age=0.0, **changes)
    delays = estimate_delays([run], NUC4)
    assert delays.delay.value == pytest.approx(0.02, abs=0.004)
    assert "stamped when they are received" in delays.pose_age.reason


@pytest.mark.parametrize("real_time", [False, pytest.param(True, marks=pytest.mark.once)])
def test_the_line_of_the_public_simulator(real_time):
    """Its servo moves in steps, which shows in noise-free poses: the delay line is known exactly.

    In real time, poses are stamped slightly late, and commands arrive between two samples.
    """
    parameters = dataclasses.replace(load_plant("public_simulator"), steering_delay_s=0.03)
    plant, _ = build_plant(parameters, seed=1)
    raceline = load_raceline("reference")
    controller = build_controller(
        load_controller_parameters("map").with_(reference_point="center_of_gravity"), SIM, raceline
    )
    samples = race(plant, controller, raceline, laps=1).samples
    t = np.array([sample.measured.t for sample in samples])
    signals = {
        "v_x": Signal(t, np.array([sample.measured.v_x for sample in samples])),
        "yaw_rate": Signal(t, np.array([sample.measured.r for sample in samples])),
        "steering": Signal(t, np.array([sample.result.steering_angle for sample in samples])),
    }
    if real_time:
        rng = np.random.default_rng(1)
        for name, (at, value) in signals.items():
            late = np.minimum(rng.exponential(1e-4, at.size), 4e-3)
            late += 3e-3 if name == "steering" else 0.0
            signals[name] = Signal(at + late, value)
    delays = estimate_delays([Run("a.bag", signals)], SIM)
    assert delays.delay.value == pytest.approx(0.03, abs=1e-9)
    assert delays.steering_lag.value == 0.0
    said = "the servo moves in steps of 0.01 s, with a dead time of 3 steps"
    assert delay_text(delays).count(said) == 1


def test_a_line_is_found_beyond_a_lesser_dip(monkeypatch):
    """Residuals for each number of samples, from three laps at 40 Hz with 8: 10 is a dip, too."""
    left = {6: 0.08, 7: 0.069, 8: 0.008, 9: 0.097, 10: 0.061, 11: 0.153}

    class Found(dict):
        noise = {"r": 0.0796}

    def fitted(_, samples, __):
        found = Found()
        found.noise = {"r": left[samples]}
        return found

    for name, stand_in in (
        ("on_raster", lambda t: True),
        ("behind_stepping_servo", lambda drive, rate, lock, samples: samples),
        ("_windows", lambda drives: drives[0]),
        ("fit_car", fitted),
    ):
        monkeypatch.setattr(delay, name, stand_in)
    drive = SimpleNamespace(measured={"r": SimpleNamespace(t=())})
    assert delay._stepping([drive], SIM, {}, Found(delay=0.0978)) == 8


@pytest.mark.once
def test_the_line_in_a_recording_of_the_public_simulator(shared_data):
    run = load_run(shared_data / "recordings" / "hangar_map_12laps.bag")
    delays = estimate_delays([run], SIM)
    assert delays.steering.value == pytest.approx(0.05, abs=1e-9)
    assert delays.delay.value == pytest.approx(0.05, abs=0.003)


def throttled(run, count):
    """Every `count`-th command of a run alone is recorded."""
    names = ("steering", "speed_command")
    kept = {name: Signal(*(column[::count] for column in run.signals[name])) for name in names}
    return dataclasses.replace(run, signals={**run.signals, **kept})


def test_missing_commands_are_told_from_rare_ones(tmp_path):
    """Of 40 commands a second the recorder keeps ten, or there are only ten."""
    line, laps = load_raceline("reference"), []
    for every in (1, 4):
        plant, localization = build_plant(load_plant("nuc4"), seed=2)
        parameters = load_controller_parameters("map").with_(speed_scale=0.7)
        controller = build_controller(parameters, NUC4, line)
        held, steps = [], controller.step

        def step(*arguments, every=every, held=held, steps=steps, **options):
            held.append(steps(*arguments, **options))
            return held[len(held) - 1 - (len(held) - 1) % every]

        controller.step = step
        log = race(plant, controller, line, localization, laps=2)
        write_race_bag(tmp_path / "a.bag", log, line)
        laps.append(load_run(tmp_path / "a.bag"))
    dense, rare = laps
    whole = estimate_delays([dense], NUC4).delay
    lacking = estimate_delays([throttled(dense, 4)], NUC4).delay
    assert whole.reason == "" and lacking.low < whole.value < lacking.high
    assert lacking.value < whole.value - 0.01
    assert "commands are missing in the recording: up to 0.050 s too short" in lacking.reason
    truly = estimate_delays([throttled(rare, 4)], NUC4).delay
    assert truly.reason == "" and truly.value == pytest.approx(whole.value, abs=0.006)


@pytest.mark.once
@pytest.mark.parametrize(
    "steering",
    [straight, lambda t: 0.2, lambda t: 0.3 * weaving(t), lambda t: 0.2 if t > 7.0 else 0.0],
    ids=["straight", "circle", "weak", "one bend"],
)
def test_no_answer_without_turning(steering):
    delays = estimate_delays([driven("nuc4", steering)], NUC4)
    data = delay_data(delays)
    assert data["status"] == "not determined" and data["delay_s"] is None
    assert data["delay_interval_s"] is None and "straight or steady" in data["reason"]
    assert data["steering_lag"]["status"] == "not determined"
    assert data["speed_lookahead_s"] is None
    text = delay_text(dataclasses.replace(delays, notes=["where the pose is from"]))
    assert text.startswith("where the pose is from\n") and "delay_s: not determined" in text


@pytest.mark.parametrize("noise", [0.5, pytest.param(2.0, marks=pytest.mark.once)])
def test_noise_is_no_turning(noise):
    run = driven("nuc4", straight, yaw_rate_noise_radps=noise)
    assert estimate_delays([run], NUC4).delay.status == "not determined"


def test_a_car_that_stands_shows_nothing(shipped):
    """The wheels are turned; the sensors see only noise."""
    signals = dict(shipped.signals)
    for name in ("v_x", "v_y", "yaw_rate"):
        signals[name] = Signal(signals[name].t, 0.001 * signals[name].value)
    delays = estimate_delays([dataclasses.replace(shipped, signals=signals)], NUC4)
    assert delays.delay.status == delays.drive_lag.status == "not determined"


@pytest.mark.once
def test_speed_commands_in_another_unit_for_a_part_tell_nothing(shipped):
    t, told = shipped.signals["speed_command"]
    told = np.where((t > 6.0) & (t < 11.0), 3.6 * told, told)
    run = dataclasses.replace(
        shipped, signals={**shipped.signals, "speed_command": Signal(t, told)}
    )
    delays = estimate_delays([run], NUC4)
    assert delays.drive_lag == delays.drive_dead_time == Part(reason="no speed commands")
    said = "the commanded speed is 3.6 times the measured one: in km/h?"
    assert any(said in note for note in delays.notes)
    assert delays.steering.value == pytest.approx(0.05, abs=0.005)


def test_commands_of_another_car_explain_nothing(shipped):
    other = driven("nuc4", lambda t: 0.2 * math.sin(2.3 * t * t / 4.0))
    mixed = {**shipped.signals, "steering": other.signals["steering"]}
    delays = estimate_delays([dataclasses.replace(shipped, signals=mixed)], NUC4)
    assert delays.delay.status == "not determined"


def test_the_age_is_within_where_clocks_differ(shipped):
    """Commands brought to the poses' clock by times of receipt are early by the age."""
    early = Signal(shipped.signals["steering"].t - 0.02, shipped.signals["steering"].value)
    signals = {**shipped.signals, "steering": early}
    run = dataclasses.replace(
        shipped, signals=signals, pose_lag=(-0.98,) * 3, commands_shifted=True
    )
    delays = estimate_delays([run], NUC4)
    assert delays.delay.value == pytest.approx(0.07, abs=0.005)
    assert delays.pose_age.status == "not determined"


@pytest.mark.parametrize(("offset", "age"), [(0.0, 0.02), (-0.4, 0.02), (1e6, 0.02)])
def test_the_age_where_the_recorder_has_another_clock(tmp_path, offset, age):
    """Poses and commands are on one computer's clock, times of receipt on another's."""
    path = tmp_path / "a.bag"
    with BagWriter(path) as bag:
        for i in range(200):
            t = 1.6e9 + 0.025 * i
            received = t + age + offset
            bag.odometry(t, 0.05 * i, 0.0, 0.0, 2.0, 0.0, 0.0, received=received)
            bag.drive(t + age, 0.001 * i, 2.0, received=received)
    delays = estimate_delays([load_run(path)], NUC4)
    assert delays.pose_age.value == pytest.approx(age, abs=1e-6)
    assert ("another clock" in delays.pose_age.reason) == (offset != 0.0)


@pytest.mark.once
def test_an_age_that_nothing_tells_is_not_said_to_be_within(shipped):
    run = dataclasses.replace(shipped, pose_lag=(-0.98,) * 3)
    delays = estimate_delays([run], NUC4)
    assert delays.delay.value == delays.steering.value
    assert "without the age of the pose: the timestamps" in delays.delay.reason


@pytest.mark.once
def test_a_servo_later_than_what_is_looked_for():
    run = driven("nuc4", weaving, steering_delay_s=0.32)
    reason = estimate_delays([run], NUC4).steering.reason
    assert "s after their commands, expected less than 0.3 s" in reason


@pytest.mark.once
@pytest.mark.parametrize(
    "changes",
    [
        {"yaw_rate_noise_radps": 0.09},
        {"steering_delay_s": 0.0, "steering_time_constant_s": 0.05},
        {"steering_delay_s": 0.05, "steering_time_constant_s": 0.0},
    ],
    ids=["three times the noise", "all of it lag", "all of it dead time"],
)
def test_of_other_servos_and_sensors(changes):
    delays = estimate_delays([driven("nuc4", weaving, seconds=18.0, **changes)], NUC4)
    assert delays.delay.value == pytest.approx(0.07, abs=0.005)


@pytest.mark.once
def test_poses_whose_stamps_are_not_even(shipped):
    rng = np.random.default_rng(0)
    t = np.sort(shipped.signals["v_x"].t + rng.normal(0.0, 0.006, shipped.signals["v_x"].t.size))
    signals = dict(shipped.signals)
    for name in ("v_x", "v_y", "yaw_rate"):
        signals[name] = Signal(t, signals[name].value)
    delays = estimate_delays([dataclasses.replace(shipped, signals=signals)], NUC4)
    assert delays.delay.value == pytest.approx(0.07, abs=0.005)


def test_the_command(tmp_path, capsys):
    path = tmp_path / "delays.json"
    assert main(["delay", "nuc4_ramps", "--vehicle", "nuc4", "--json", str(path)]) == 0
    data = json.loads(path.read_text())
    assert data["status"] == "not determined" and data["pose_age"]["value_s"] == 0.02
    assert "delay_s: not determined" in capsys.readouterr().out


@pytest.mark.once
def test_split_bags_are_joined(tmp_path):
    whole = find_config("recordings", "nuc4_ramps", (".bag",))
    halves = [tmp_path / f"ramps_{part}.bag" for part in (0, 1)]
    with open_bag(whole) as bag:
        middle = (bag.start_ns + bag.end_ns) // 2
        for half, path in enumerate(halves):
            with Writer(path) as writer:
                known = {
                    number: writer.add_connection(
                        *(c.topic, c.type.replace("/", "/msg/")),
                        **{"msgdef": c.definition, "md5sum": c.md5sum},
                    )
                    for number, c in bag.connections.items()
                }
                for connection, t, data in bag.messages():
                    if (t >= middle) == half:
                        writer.write(known[connection], t, data)
    told = []
    for number, given in enumerate(([whole], [*halves, "--join"])):
        path = tmp_path / f"{number}.json"
        assert main(["delay", *map(str, given), "--vehicle", "nuc4", "--json", str(path)]) == 0
        told.append({k: v for k, v in json.loads(path.read_text()).items() if k != "notes"})
    assert told[0] == told[1]
