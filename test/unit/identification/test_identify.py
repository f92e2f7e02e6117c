"""From driving data to a car with a working table."""

import dataclasses
import json
import math

import numpy as np
import pytest

from map_racing.control.controller import Controller
from map_racing.control.parameters import load_controller_parameters
from map_racing.control.steering import build_steering_map
from map_racing.control.steering_ramp import RampParameters
from map_racing.errors import IdentificationError
from map_racing.identification.car import identify_car
from map_racing.identification.car_report import car_data, car_text, provenance
from map_racing.identification.channels import load_channel_map
from map_racing.identification.data import Signal, load_run
from map_racing.identification.identify import identify, leave_one_out, predict, steady_acceleration
from map_racing.identification.limits import SteadyLimits
from map_racing.identification.report import (
    prediction_errors,
    report_data,
    report_text,
    worst_prediction,
)
from map_racing.simulation.plant import Localization, Plant
from map_racing.simulation.race import Outcome, race
from map_racing.simulation.ramps import drive_ramps
from map_racing.simulation.recorded import write_ramp_bag
from map_racing.track.files.load import load_raceline
from map_racing.vehicle.grids import default_grid
from map_racing.vehicle.parameters import Vehicle, load_vehicle
from map_racing.vehicle.steady_state import steady_state_table
from map_racing.vehicle.tires import LinearTire, PacejkaTire


@pytest.fixture(scope="module")
def found(ramps):
    return identify([ramps.run], ramps.base)


@pytest.mark.parametrize("axle", ["front", "rear"])
def test_curves_of_the_plant_are_recovered_from_its_bag(found, ramps, curve_error, axle):
    assert curve_error(found, ramps.true, axle) < 0.03
    assert found.axles[axle].pacejka.covered_slip > {"front": 0.2, "rear": 0.01}[axle]


@pytest.mark.once
@pytest.mark.parametrize("seed", [11, 12, 13])
def test_they_are_with_any_noise(ramps, curve_error, tmp_path, seed):
    ramps_driven = [RampParameters(speed_mps=v) for v in (2.0, 3.0, 4.0)]
    write_ramp_bag(tmp_path / "a.bag", drive_ramps(ramps.parameters, ramps_driven, seed=seed))
    found = identify([load_run(tmp_path / "a.bag")], ramps.base)
    for axle in ("front", "rear"):
        assert curve_error(found, ramps.true, axle) < 0.03


@pytest.mark.once
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_quarter_of_gross_outliers_in_the_bag(ramps, curve_error, tmp_path, seed):
    """Wrong poses, speeds, yaw rates and accelerations, each in a quarter of the messages."""
    rng = np.random.default_rng(seed)
    samples = []
    for sample in ramps.samples:
        seen, (along, across) = sample.measured, sample.acceleration
        if rng.random() < 0.25:
            across += rng.choice((-1.0, 1.0)) * rng.uniform(5.0, 20.0)
        if rng.random() < 0.25:
            dx, dy, turned = rng.uniform(-2.0, 2.0), rng.uniform(-2.0, 2.0), rng.uniform(-1.0, 1.0)
            seen = seen._replace(x=seen.x + dx, y=seen.y + dy, psi=seen.psi + turned)
        if rng.random() < 0.25:
            dv, dr = rng.uniform(-3.0, 3.0), rng.uniform(-3.0, 3.0)
            seen = seen._replace(v_x=seen.v_x + dv, r=seen.r + dr)
        samples.append(sample._replace(measured=seen, acceleration=(along, across)))
    write_ramp_bag(tmp_path / "a.bag", samples)
    found = identify([load_run(tmp_path / "a.bag")], ramps.base)
    for axle in ("front", "rear"):
        assert curve_error(found, ramps.true, axle) < 0.05
    assert any("spikes" in finding.text for finding in found.findings)


@pytest.mark.once
@pytest.mark.parametrize("scale", [0.5, 2.0, 4.0], ids="{:g} times as long".format)
def test_a_similar_car_of_another_size_is_identified_alike(ramps, found, scale):
    """All lengths times `scale` at the same accelerations (Froude): the tires are the same.

    Twice the length is a 1:5 car, with eight times the noise [N] of a 1:10 car.
    """
    time, base = math.sqrt(scale), ramps.base
    factors = {"x": scale, "y": scale, "v_x": time, "yaw_rate": 1.0 / time, "speed_command": time}
    signals = {
        name: Signal(time * s.t, factors.get(name, 1.0) * s.value)
        for name, s in ramps.run.signals.items()
    }
    car = dataclasses.replace(
        base,
        **{name: scale * getattr(base, name) for name in ("l_f", "l_r", "h_cg")},
        m=scale**3 * base.m,
        I_z=scale**5 * base.I_z,
    )
    limits = SteadyLimits(cutoff_hz=1.0 / time, dr_radps2=0.35 / scale, ddelta_radps=0.1 / time)
    same = identify([dataclasses.replace(ramps.run, signals=signals)], car, limits=limits)
    for name, axle in same.axles.items():
        one = found.axles[name].pacejka
        slip = np.linspace(0.0, one.covered_slip, 100)
        expected = one.tire.normalized_force(slip)
        assert axle.pacejka.tire.normalized_force(slip) == pytest.approx(expected, rel=0.02)
        assert axle.pacejka.rejected_share == pytest.approx(one.rejected_share, abs=0.02)


@pytest.mark.once
def test_the_papers_front_force_overrates_this_model(ramps, found):
    paper = identify([ramps.run], ramps.base, front_force="paper")
    slip = found.axles["front"].pacejka.covered_slip
    ratio = np.divide(
        *(each.axles["front"].pacejka.tire.normalized_force(slip) for each in (paper, found))
    )
    widest = max(
        np.abs(motion.delta[c]).max() for motion in found.motions for c in motion.segments()
    )
    assert ratio == pytest.approx(1.0 / math.cos(widest), rel=0.02)
    assert f"gives up to {1.0 / math.cos(widest) - 1.0:.1%} more" in report_text(paper)


def test_what_is_returned(found, ramps):
    assert isinstance(found.vehicle, Vehicle) and found.vehicle.mu == 1.0
    assert isinstance(found.vehicle.front, PacejkaTire)
    assert isinstance(found.linear_vehicle.rear, LinearTire)
    assert found.vehicle.name == "base_identified"
    kept = ("m", "I_z", "l_f", "l_r", "h_cg", "delta_max", "v_max")
    assert all(getattr(found.vehicle, key) == getattr(ramps.base, key) for key in kept)
    # Linear tires are regressions on all data: softer than the slope at zero.
    assert 0.9 * found.vehicle.front.stiffness > found.linear_vehicle.front.C_S
    largest = ramps.true.mu * ramps.true.front.peak * 9.81
    assert 0.93 * largest < found.largest_a_y < 1.01 * largest
    assert found.friction == found.largest_a_y / 9.81
    assert found.vehicle.a_lat_max == ramps.base.a_lat_max


@pytest.mark.once
def test_a_limit_of_the_vehicle_file_is_no_lower_than_what_was_held(found, ramps):
    limited = identify([ramps.run], dataclasses.replace(ramps.base, a_lat_max=3.0))
    for car in (limited.vehicle, limited.linear_vehicle):
        assert car.a_lat_max == pytest.approx(found.largest_a_y)


def test_understeer_gradient_is_the_slope_of_the_table(found):
    """Steering beyond Ackermann at small accelerations, from the table itself."""
    v, a_y = 4.0, 0.3
    table = steady_state_table(found.vehicle, [v], np.linspace(0.0, 0.1, 400))
    beyond = table.steering(v, a_y)[0] - math.atan(found.vehicle.l_wb * a_y / v**2)
    assert found.understeer_gradient.value == pytest.approx(beyond / a_y, rel=0.03)


def test_understeer_gradient_has_the_doubt_about_the_stiffness_of_both_axles(found, ramps):
    value, low, high, determined = found.understeer_gradient
    car = ramps.true
    # With normalized slopes, m g cancels: K = (1 / C_f - 1 / C_r) / (mu g).
    true = (1.0 / car.front.stiffness - 1.0 / car.rear.stiffness) / (9.81 * car.mu)
    assert determined and value == pytest.approx(true, rel=0.05)
    each = [axle.pacejka.parameters["stiffness_n_per_rad"] for axle in found.axles.values()]
    shares = (car.m * arm / (car.l_wb * k.value) for k, arm in zip(each, (car.l_r, car.l_f)))
    parts = [share * (k.high / k.value - 1.0) for k, share in zip(each, shares)]
    assert (high - low) / 2.0 == pytest.approx(math.hypot(*parts))
    assert f"understeer gradient: {value:+.5f} rad per m/s^2 (95 %: " in report_text(found)
    # With an undetermined rear axle, not even the sign is known.
    fit = found.axles["rear"].pacejka
    known = fit.parameters["stiffness_n_per_rad"]
    vague = known._replace(high=20.0 * known.value, low=0.0, determined=False)
    fit = dataclasses.replace(fit, parameters={**fit.parameters, "stiffness_n_per_rad": vague})
    axles = {**found.axles, "rear": found.axles["rear"]._replace(pacejka=fit)}
    unsure = dataclasses.replace(found, axles=axles)
    assert not unsure.understeer_gradient.determined
    assert "understeer gradient: not determined by these data" in report_text(unsure)
    data = report_data(unsure)
    low, high = data["understeer_gradient_interval_rad_s2_per_m"]
    assert low < 0.0 < high and not data["understeer_gradient_determined"]


@pytest.mark.once
def test_table_of_the_result_drives_as_well_as_the_true_one(found, ramps):
    """In closed loop, on the plant on which the tires were identified."""
    raceline = load_raceline("reference")
    parameters = load_controller_parameters("map").with_(speed_scale=0.75)
    errors = {}
    for name, vehicle in (
        ("true", ramps.true),
        ("identified", found.vehicle),
        ("base", ramps.base),
    ):
        steering = build_steering_map(parameters.steering_map, vehicle, parameters.v_max_mps)
        # Only the table differs.
        controller = Controller(parameters, steering, load_vehicle("nuc4"), raceline)
        plant, localization = Plant(ramps.parameters), Localization(ramps.parameters, 2)
        log = race(plant, controller, raceline, localization, laps=2)
        assert log.outcome is Outcome.COMPLETED
        d = [raceline.project(x, y).d for x, y in log.true_path()[:, 1:3].tolist()]
        errors[name] = math.sqrt(np.mean(np.square(d)))
    assert errors["identified"] < 1.2 * errors["true"]
    assert errors["base"] > 2.0 * errors["true"]  # so the tires do matter here


@pytest.mark.once
def test_runs_left_out_are_predicted_by_the_others(ramps, tmp_path):
    runs = []
    for number, v in enumerate((2.0, 3.0, 3.5)):
        path = tmp_path / f"{number}.bag"
        drive = drive_ramps(ramps.parameters, [RampParameters(speed_mps=v)], seed=20 + number)
        write_ramp_bag(path, drive)
        runs.append(load_run(path))
    holds = leave_one_out(runs, ramps.base)
    assert len({hold.run for hold in holds}) == 3
    errors = prediction_errors(holds)
    assert errors["below_limit"]["holds"] > 30 and errors["at_limit"]["holds"] > 3
    assert errors["below_limit"]["yaw_rate"] < 0.03
    assert errors["at_limit"]["lateral_acceleration"] < 0.05
    with pytest.raises(IdentificationError, match="at least two usable runs"):
        leave_one_out(runs[:1], ramps.base)


@pytest.mark.once
def test_prediction_is_that_of_the_model(ramps, found):
    for hold in predict(ramps.true, found.motions, found.largest_a_y):
        expected = steady_acceleration(ramps.true, hold.v, abs(hold.delta))
        assert abs(hold.a_y_predicted) == expected
        assert hold.a_y == pytest.approx(hold.a_y_predicted, rel=0.12)
        assert hold.r_predicted * hold.v == pytest.approx(hold.a_y_predicted)


def test_steady_acceleration_where_there_is_no_steady_state():
    car = load_vehicle("nuc4")
    table = steady_state_table(car, *default_grid(car, v_max=8.0))
    j, i = 40, 100
    v, delta = float(table.speeds[j]), float(table.angles[i])
    assert steady_acceleration(car, v, delta) == pytest.approx(table.a_lat[i, j], abs=1e-9)
    # An oversteering car: it spins if turned too far, and above its critical speed at once.
    loose = dataclasses.replace(car, front=car.rear, rear=dataclasses.replace(car.rear, B=10.0))
    assert math.isnan(steady_acceleration(loose, 15.0, 0.2))
    most = steady_acceleration(loose, 3.0, 0.4)
    assert most > steady_acceleration(loose, 3.0, 0.01) > 0.0


@pytest.mark.once
def test_a_fast_part_of_the_data_says_nothing_of_the_peak(ramps):
    slow = {
        name: Signal(s.t[s.t < 35.0], s.value[s.t < 35.0]) for name, s in ramps.run.signals.items()
    }
    found = identify([dataclasses.replace(ramps.run, signals=slow)], ramps.base)
    front = found.axles["front"].pacejka
    assert not front.saturated and not front.parameters["peak_n"].determined
    text = report_text(found)
    assert "not determined by these data" in text and "extrapolated" in text


def test_straight_driving_and_nothing_are_refused(ramps):
    run = ramps.run
    t = np.arange(0.0, 10.0, 0.025)
    rest = {name: Signal(t, np.zeros(t.size)) for name in ("y", "psi", "yaw_rate", "a_y")}
    straight = {**rest, "x": Signal(t, 2.0 * t), "v_x": Signal(t, np.full(t.size, 2.0))}
    straight["steering"] = Signal(t, np.zeros(t.size))
    with pytest.raises(IdentificationError, match="straight driving"):
        identify([dataclasses.replace(run, signals=straight)], ramps.base)
    still = {**straight, "x": rest["y"], "v_x": rest["y"]}
    with pytest.raises(IdentificationError, match="the car never drove"):
        identify([dataclasses.replace(run, signals=still)], ramps.base)
    with pytest.raises(IdentificationError, match="at least one run"):
        identify([], ramps.base)


@pytest.mark.once
def test_one_bad_run_does_not_spoil_the_others(ramps, found):
    bad = dataclasses.replace(ramps.run, name="x/bad.bag", signals={})
    both = identify([ramps.run, bad], ramps.base)
    assert both.vehicle == found.vehicle
    assert both.refused == [("x/bad.bag", "x: expected poses, got none")]
    assert "x/bad.bag: left out: x: expected poses, got none" in report_text(both)


def test_report_is_plain_json(found):
    data = report_data(found, found.predictions())
    again = json.loads(json.dumps(data, allow_nan=False))
    assert again["axles"]["front"]["parameters"]["B"]["value"] == found.vehicle.front.B
    assert again["leave_one_out"] == again["fit_errors"]
    assert again["runs_refused"] == [] and again["setup"] == {}
    row = again["tables"][3]
    table = steady_state_table(found.vehicle, [4.0], np.linspace(0.0, 0.4189, 257))
    assert row["limit_after_mps2"] == pytest.approx(table.max_lateral_acceleration(4.0))
    assert row["limit_before_mps2"] > row["limit_after_mps2"]


# -- real cars -----------------------------------------------------------------------------------

CIRCLES = Vehicle(
    *("circles", 3.548, 0.06, 0.16, 0.16, 0.05, 1.0),
    PacejkaTire(6.0, 1.3, 1.0, 0.0),
    PacejkaTire(8.0, 1.3, 1.0, 0.0),
)
SECOND = dataclasses.replace(CIRCLES, name="second", m=4.0, l_f=0.162, l_r=0.145, h_cg=0.074)


@pytest.fixture(scope="module")
def circles(shared_data):
    channels = load_channel_map("circles_log")
    folders = sorted((shared_data / "tyre_id").glob("circles_*"))
    return [load_run(folder / "cmd.csv", channels) for folder in folders]


@pytest.mark.once
def test_a_real_car_predicts_the_runs_it_was_not_fitted_to(circles):
    found = identify(circles, CIRCLES, fix=True)
    assert len(found.motions) == 5
    reasons = dict(found.refused)
    assert set(reasons) == {"circles_025140/cmd.csv", "circles_060034/cmd.csv"}
    assert "localization diverged" in reasons["circles_025140/cmd.csv"]
    assert "never drove" in reasons["circles_060034/cmd.csv"]
    assert 5.0 < found.largest_a_y < 5.7
    left_out = leave_one_out(circles, CIRCLES, fix=True)
    errors = prediction_errors(left_out)
    assert errors["below_limit"]["holds"] >= 40 and errors["at_limit"]["holds"] >= 6
    for quantity in ("yaw_rate", "lateral_acceleration"):
        assert errors["below_limit"][quantity] < 0.05
        assert errors["at_limit"][quantity] < 0.10
    # The localization error differs in each run, and shows at the rear axle.
    worst = worst_prediction(left_out)
    assert worst["within_5_percent"] >= 0.9 * worst["holds"] and worst["error"] < 0.1


def test_each_bad_real_run_alone_is_refused(circles):
    for label, reason in (("025140", "localization diverged"), ("060034", "never drove")):
        (run,) = [run for run in circles if label in run.name]
        with pytest.raises(IdentificationError, match=reason):
            identify([run], CIRCLES, fix=True)


def test_the_sign_of_the_real_imu_is_found(circles):
    turned = []
    for run in circles:
        signals = dict(run.signals)
        signals["a_y"] = Signal(signals["a_y"].t, -signals["a_y"].value)  # the sign in the file
        turned.append(dataclasses.replace(run, signals=signals))
    with pytest.raises(IdentificationError, match="a_y is -1.0.* its sign is wrong"):
        identify(turned, CIRCLES)
    found = identify(turned, CIRCLES, fix=True)
    assert found.setup.lateral_scale == pytest.approx(-0.95, abs=0.02)


@pytest.mark.once
def test_second_real_car(shared_data):
    channels = load_channel_map("sysid_log")
    paths = sorted((shared_data / "tyre_id" / "second_car").glob("*.csv.gz"))
    runs = [load_run(path, channels) for path in paths]
    with pytest.raises(IdentificationError, match="time: .* a second of the recording lasts 0.86"):
        identify(runs, SECOND)
    # Its speed oscillates, so a lower cutoff is needed to find steady segments.
    limits = SteadyLimits(cutoff_hz=0.4)
    # Its wheels turn more than the signal says, by an unknown factor: all of it is hard cornering.
    with pytest.raises(IdentificationError, match="how much more is unknown without cornering"):
        identify(runs, SECOND, fix=True, limits=limits)
    runs = [
        dataclasses.replace(run, setup=dataclasses.replace(run.setup, steering_gain=1.2))
        for run in runs
    ]
    found = identify(runs, SECOND, fix=True, limits=limits)
    assert found.setup.steering_gain == 1.2
    assert found.setup.time_scale == pytest.approx(0.863, abs=0.01)
    # One steering angle to one side does not determine a tire's peak.
    assert not found.axles["front"].pacejka.saturated and not found.axles["rear"].pacejka.saturated
    assert not found.axles["front"].pacejka.parameters["peak_n"].determined
    assert any("steady cornering to the left only" in finding.text for finding in found.findings)


@pytest.mark.once
@pytest.mark.parametrize("friction, mixed", [(1.0, False), (0.88, True), (0.7, True)])
def test_ramps_on_two_floors_are_no_silent_mixture(ramps, tmp_path, friction, mixed):
    """The same car at another speed is no contradiction; on another floor it is."""
    floor = dataclasses.replace(ramps.parameters, mu_scale=friction * ramps.parameters.mu_scale)
    write_ramp_bag(tmp_path / "b.bag", drive_ramps(floor, [RampParameters(speed_mps=2.5)], seed=3))
    found = identify_car([ramps.run, load_run(tmp_path / "b.bag")], ramps.base)
    doubts = [finding.text for finding in found.findings if finding.critical]
    assert bool(doubts) == mixed and all("not of one car on one floor" in d for d in doubts)
    assert ("check: runs: " in provenance(found)) == mixed == ("check: runs: " in car_text(found))
    assert found.doubts == []


@pytest.mark.once
def test_real_circles_are_of_one_floor(shared_data):
    channels = load_channel_map("circles_log")
    folders = sorted((shared_data / "tyre_id").glob("circles_*"))
    runs = [load_run(folder / "cmd.csv", channels) for folder in folders]
    found = identify(runs, load_vehicle("nuc4"), fix=True)
    assert len(found.motions) == 5
    assert not [finding for finding in found.findings if finding.check == "runs"]


def test_a_friction_that_no_floor_has_is_doubted(ramps):
    """Speed and yaw rate in wrong units; here because of a slow-motion clock."""
    factors = {"a_y": 0.49, "v_x": 0.7, "v_y": 0.7, "yaw_rate": 0.7}
    signals = {
        name: Signal(0.7 * s.t, s.value / factors.get(name, 1.0))
        for name, s in ramps.run.signals.items()
    }
    found = identify_car([dataclasses.replace(ramps.run, signals=signals)], ramps.base)
    assert found.largest_a_y > 1.3 * 9.81
    assert "expected at most 1.3 for rubber" in car_text(found)
    held = f"warning: a friction (mu times D) of {found.largest_a_y / 9.80665:.2f}, needed for the "
    held += f"sustained {found.largest_a_y:.2f} m/s^2, expected"
    assert held in provenance(found)
    assert any(held in note for note in car_data(found)["notes"])
