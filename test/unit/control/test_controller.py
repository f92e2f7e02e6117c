"""The controller: exact on circles, symmetric, within its limits, safe with any input."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from map_racing.control.controller import Controller, Status, build_controller
from map_racing.control.guidance import missing_curvature
from map_racing.control.parameters import ControllerParameters, load_controller_parameters
from map_racing.control.speed_sectors import LARGEST_SCALE, SpeedSectors
from map_racing.control.state import CarState, moved, predicted
from map_racing.control.steering import build_steering_map
from map_racing.errors import ParameterError
from map_racing.simulation.plant import Plant, PlantParameters
from map_racing.track.files.load import load_raceline
from map_racing.track.raceline import Raceline
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.single_track import single_track_derivatives

NUC4 = load_vehicle("nuc4")
TABLE = build_steering_map("table", NUC4, 12.0)
# The law alone: no compensation, measured speed.
PLAIN = ControllerParameters("table", m_m=0.2, q_s=0.17)
REFERENCE = load_raceline("reference")


def circle(radius=3.0, speed=4.0, clockwise=False, points=120):
    angle = 2.0 * np.pi * np.arange(points) / points
    y = radius * np.sin(angle)
    return Raceline(radius * np.cos(angle), -y if clockwise else y, vx_mps=np.full(points, speed))


def controller(parameters=PLAIN, raceline=REFERENCE, sectors=None, **changes):
    return Controller(parameters.with_(**changes), TABLE, NUC4, raceline, sectors)


def on_track(raceline, s, d=0.0, turn=0.0, v_x=4.0, v_y=0.0, r=0.0, t=0.0):
    """State at a place of the track, rotated by an angle relative to it."""
    x, y = raceline.to_cartesian(s, d)
    return CarState(t, float(x), float(y), raceline.pose(s).psi + turn, v_x, v_y, r)


# -- the law ---------------------------------------------------------------------------------


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("m_m", [0.3, 1.0, 2.5, 4.0])
def test_on_its_circle_it_commands_the_tables_angle(m_m, clockwise):
    """L1 commands v^2 / R from any lookahead distance; the table turns it into an angle."""
    raceline = circle(3.0, clockwise=clockwise)
    result = controller(raceline=raceline, m_m=m_m, q_s=0.0).step(on_track(raceline, 2.0))
    side = -1.0 if clockwise else 1.0
    assert result.lookahead_distance == m_m
    assert result.a_lat == pytest.approx(side * 4.0**2 / 3.0, rel=2e-5)
    assert result.steering_angle == pytest.approx(side * TABLE.steering(4.0, 16.0 / 3.0)[0], 5e-5)
    assert (result.s, result.d) == pytest.approx((2.0, 0.0), abs=1e-6)
    assert result.status is Status.OK


def test_a_drifting_car_is_guided_along_its_velocity():
    """The body may point anywhere: only the direction of motion matters."""
    raceline = circle(3.0)
    straight = on_track(raceline, 2.0)
    for drift in (-0.6, 0.3, 0.9):
        drifting = straight._replace(
            psi=straight.psi - drift, v_x=4.0 * math.cos(drift), v_y=4.0 * math.sin(drift)
        )
        result = controller(raceline=raceline, speed_source="command").step(drifting)
        assert result.a_lat == pytest.approx(16.0 / 3.0, rel=2e-5)


def test_the_result_is_what_was_computed_and_from_what():
    state = on_track(REFERENCE, 7.0, d=0.1, turn=0.2)
    result = controller().step(state)
    assert result.state == state
    assert result.d == pytest.approx(0.1, abs=1e-4)
    assert result.lookahead_distance == pytest.approx(0.2 + 0.17 * 4.0)
    dx, dy = result.lookahead_x - state.x, result.lookahead_y - state.y
    assert math.hypot(dx, dy) == pytest.approx(result.lookahead_distance, abs=1e-6)
    assert math.remainder(math.atan2(dy, dx) - state.psi, math.tau) == pytest.approx(result.eta)
    assert result.a_lat == pytest.approx(
        2.0 * 16.0 / result.lookahead_distance * math.sin(result.eta)
    )
    assert result.steering_angle == TABLE.steering(4.0, result.a_lat)[0]


@pytest.mark.parametrize("turn", [1.7, 2.5, 3.0, -1.7, -2.5, -3.0])
def test_a_car_that_points_backwards_turns_round_the_shorter_way(turn):
    result = controller().step(on_track(REFERENCE, 2.0, turn=turn))
    assert math.copysign(1.0, result.steering_angle) == -math.copysign(1.0, turn)
    assert result.status is Status.OFF_COURSE
    assert result.speed == 1.0
    assert abs(result.steering_angle) == TABLE.steering(4.0, 100.0)[0]


@pytest.mark.parametrize("v_x", [-0.02, -0.3, -0.36, -0.6, -3.0])
def test_a_car_that_rolls_backwards_steers_for_where_its_nose_points(v_x):
    """Noise at standstill or a push back must not throw the steering to a lock."""
    backwards = controller().step(on_track(REFERENCE, 2.0, v_x=v_x))
    forwards = controller().step(on_track(REFERENCE, 2.0, v_x=-v_x))
    assert backwards.eta == pytest.approx(forwards.eta, abs=1e-9)
    assert backwards.steering_angle == pytest.approx(forwards.steering_angle, abs=1e-9)
    assert backwards.status is Status.OK


def test_beside_the_path_it_steers_back():
    straight = max(
        np.arange(0.0, REFERENCE.length, 0.1), key=lambda s: -abs(REFERENCE.pose(s + 0.4).kappa)
    )
    for d in (0.05, 0.3, 0.8):
        left, right = (
            controller().step(on_track(REFERENCE, straight, d=side * d)).steering_angle
            for side in (1.0, -1.0)
        )
        assert left < 0.0 < right


@pytest.mark.parametrize("name", ["map", "map_linear", "pure_pursuit", "map_paper"])
def test_the_mirrored_car_on_the_mirrored_track_does_the_mirrored_thing(name):
    """Over a drive along the whole track, off the line, drifting, with the rate limit."""
    parameters = load_controller_parameters(name)
    mirrored_track = Raceline(REFERENCE.x, -REFERENCE.y, vx_mps=REFERENCE.speed)
    track = Raceline(REFERENCE.x, REFERENCE.y, vx_mps=REFERENCE.speed)
    left = build_controller(parameters, NUC4, track)
    right = build_controller(parameters, NUC4, mirrored_track)
    random = np.random.default_rng(4)
    angles = []
    for k in range(300):
        d, turn, v_y, r = (random.normal(0.0, 0.2, 4) * (1.0, 1.0, 1.0, 5.0)).tolist()
        v_y = math.nan if k % 3 == 0 else v_y
        state = on_track(track, 0.13 * k, d, turn, 5.0, v_y, r, 0.025 * k)
        mirror = state._replace(y=-state.y, psi=-state.psi, v_y=-state.v_y, r=-state.r)
        one, other = left.step(state), right.step(mirror)
        assert other.steering_angle == pytest.approx(-one.steering_angle, abs=1e-7)
        assert other.speed == pytest.approx(one.speed, abs=1e-7)
        assert (other.d, other.eta) == pytest.approx((-one.d, -one.eta), abs=1e-6)
        angles.append(one.steering_angle)
    assert min(angles) < -0.1 and max(angles) > 0.1


@pytest.mark.parametrize("kind", ["table", "linear_table", "ackermann"])
@pytest.mark.parametrize("clockwise", [False, True])
def test_map_drives_a_circle_without_error_where_its_table_is_right(kind, clockwise):
    """4.5 m/s at 3.5 m radius is 5.8 m/s^2, four fifths of this car's limit."""
    raceline = circle(3.5, 4.5, clockwise)
    plant = Plant(PlantParameters(vehicle="nuc4"))
    steer = Controller(PLAIN, build_steering_map(kind, NUC4, 12.0), NUC4, raceline)
    start = raceline.pose(0.0)
    plant.reset(start.x, start.y, start.psi, 4.5)
    deviations = []
    for tick in range(4000):
        if tick % 10 == 0:
            result = steer.step(plant.reference_state())
            deviations.append(abs(result.d))
        plant.advance(result.steering_angle, 4.5)
    error = max(deviations[-50:])
    if kind == "table":
        assert error < 2e-3
    else:
        assert error > 0.02


# -- speed -----------------------------------------------------------------------------------


def test_speed_is_the_racelines_scaled():
    state = on_track(REFERENCE, 9.0, v_x=5.0)
    here = REFERENCE.speed_at(9.0)
    assert controller().step(state).speed == pytest.approx(here, abs=1e-4)
    assert controller(speed_scale=0.7).step(state).speed == pytest.approx(0.7 * here, abs=1e-4)
    ahead = controller(speed_lookahead_s=0.2).step(state).speed
    assert ahead == pytest.approx(REFERENCE.speed_at(10.0), abs=1e-3)


def test_far_beside_the_path_it_comes_at_45_degrees():
    raceline = circle(1000.0, 4.0, points=2000)
    for d in (2.0, -2.0):
        result = controller(raceline=raceline).step(on_track(raceline, 50.0, d))
        assert result.lookahead_distance == pytest.approx(math.sqrt(2.0) * 2.0, rel=1e-9)
        assert result.eta == pytest.approx(-math.copysign(math.pi / 4.0, d), abs=0.01)


def test_a_slow_sector_is_met_at_its_speed():
    """The scaled speed is read as far ahead as the unscaled one."""
    sectors = SpeedSectors([(5.0, 10.0, 0.5)], REFERENCE.length)
    subject = controller(sectors=sectors, speed_lookahead_s=0.25)
    for s, scale in ((3.99, 1.0), (4.01, 0.5), (8.99, 0.5), (9.01, 1.0)):
        result = subject.step(on_track(REFERENCE, s, v_x=4.0))
        assert result.speed == pytest.approx(scale * REFERENCE.speed_at(s + 1.0), rel=1e-6)


def test_speed_scales_of_sectors_hold_where_the_car_is():
    sectors = SpeedSectors([(5.0, 10.0, 0.5)], REFERENCE.length)
    for s, scale in [(4.5, 1.0), (5.5, 0.5), (9.5, 0.5), (10.5, 1.0)]:
        result = controller(sectors=sectors, speed_scale=0.9).step(on_track(REFERENCE, s))
        assert result.speed == pytest.approx(0.9 * scale * REFERENCE.speed_at(s), abs=1e-3)


@pytest.mark.once
@settings(deadline=None)
@given(
    s=st.floats(0.0, 40.0),
    v_x=st.floats(-5.0, 30.0),
    scale=st.floats(0.0, 2.0),
    sector=st.floats(0.0, LARGEST_SCALE),
    v_max=st.floats(0.01, 20.0),
)
def test_no_speed_above_the_limit_whatever_is_asked(s, v_x, scale, sector, v_max):
    sectors = SpeedSectors([(0.0, 20.0, sector)], REFERENCE.length)
    subject = controller(sectors=sectors, speed_scale=scale, v_max_mps=v_max, speed_lookahead_s=0.3)
    assert 0.0 <= subject.step(on_track(REFERENCE, s, v_x=v_x)).speed <= v_max


# -- feedforward, yaw rate, and what the authors' code does --------------------------------------


def test_feedforward_makes_the_path_a_solution_of_the_law():
    """With full feedforward, the demand on the path is the path's own acceleration, in any bend."""
    full = controller(curvature_feedforward=1.0)
    bare = controller()
    missed = []
    for s in np.arange(0.0, REFERENCE.length, 0.5):
        own = 16.0 * REFERENCE.pose(s).kappa
        assert full.step(on_track(REFERENCE, s)).a_lat == pytest.approx(own, abs=1e-3)
        missed.append(bare.step(on_track(REFERENCE, s)).a_lat - own)
    assert np.max(np.abs(missed)) > 2.0


def test_half_of_the_feedforward_is_half_way():
    state = on_track(REFERENCE, 7.0, d=0.2, turn=0.1)
    none, half, full = (
        controller(curvature_feedforward=share).step(state).a_lat for share in (0.0, 0.5, 1.0)
    )
    assert half == pytest.approx(0.5 * (none + full)) and none != full


def test_on_a_circle_nothing_is_missing():
    raceline = circle(3.0)
    for d in (0.0, 0.2, -0.2):
        state = on_track(raceline, 2.0, d=d)
        with_it, without = (
            controller(raceline=raceline, curvature_feedforward=share).step(state).a_lat
            for share in (1.0, 0.0)
        )
        assert with_it == pytest.approx(without, abs=1e-3)


@pytest.mark.parametrize("missing", [-0.5, 0.3])
def test_a_yaw_rate_that_is_missing_is_steered_for(missing):
    raceline = circle(3.0)
    turning = on_track(raceline, 2.0, r=4.0 / 3.0)
    plain = controller(raceline=raceline).step(turning)
    fed = controller(raceline=raceline, yaw_rate_gain_s=0.05)
    assert fed.step(turning).steering_angle == pytest.approx(plain.steering_angle, abs=1e-5)
    fed.reset()
    slower = fed.step(turning._replace(r=turning.r - missing))
    assert slower.steering_angle == pytest.approx(plain.steering_angle + 0.05 * missing, abs=1e-5)
    assert slower.a_lat == plain.a_lat


def test_from_the_heading_sideslip_does_not_count():
    state = on_track(REFERENCE, 7.0, d=0.1, turn=0.1, v_y=-0.3)
    nose = controller(eta_from="heading").step(state)
    assert nose.eta == controller().step(state._replace(v_y=0.0)).eta
    assert nose.eta != controller().step(state).eta
    assert nose.state == state


def test_the_lookahead_distance_may_begin_on_the_path():
    state = on_track(REFERENCE, 7.0, d=0.3)
    result = controller(lookahead_from="path").step(state)
    x, y = REFERENCE.position(result.s)
    beside = math.hypot(result.lookahead_x - x, result.lookahead_y - y)
    assert beside == pytest.approx(PLAIN.lookahead(NUC4).distance(4.0), abs=1e-6)
    apart = math.hypot(result.lookahead_x - state.x, result.lookahead_y - state.y)
    assert result.lookahead_distance == apart != beside


def test_beyond_its_end_the_table_is_read_as_at_it():
    """The demand uses the actual speed; only the table is read in its last column."""
    fast = on_track(REFERENCE, 7.0, v_x=9.0)
    open_end, ended = controller(), controller(table_v_max_mps=7.0)
    result = ended.step(fast)
    assert result.a_lat == open_end.step(fast).a_lat
    assert result.steering_angle == TABLE.steering(7.0, result.a_lat)[0]
    slow = on_track(REFERENCE, 7.0, v_x=6.9)
    open_end.reset(), ended.reset()
    assert ended.step(slow) == open_end.step(slow)


# -- compensation and paper mode -----------------------------------------------------------------


def test_paper_mode_uses_the_commanded_speed_and_the_pose_as_it_is():
    state = on_track(REFERENCE, 9.0, d=0.1, v_x=2.0, r=1.0)
    for name in ("map_paper", "map_linear_paper", "pure_pursuit_paper"):
        parameters = load_controller_parameters(name)
        result = build_controller(parameters, NUC4, REFERENCE).step(state)
        assert result.state == state
        assert result.speed == pytest.approx(0.7 * REFERENCE.speed_at(result.s), abs=1e-9)
        begin = state if parameters.lookahead_from == "car" else REFERENCE.pose(result.s)
        assert math.hypot(
            result.lookahead_x - begin.x, result.lookahead_y - begin.y
        ) == pytest.approx(parameters.lookahead(NUC4).distance(result.speed), abs=1e-6)
        expected = 2.0 * result.speed**2 / result.lookahead_distance * math.sin(result.eta)
        assert result.a_lat == pytest.approx(expected, rel=1e-12)


def test_by_default_it_uses_the_measured_speed_and_the_pose_of_the_moment_it_acts():
    state = on_track(REFERENCE, 9.0, d=0.1, v_x=2.0, v_y=-0.1, r=1.0)
    for name in ("map", "map_linear", "pure_pursuit"):
        parameters = load_controller_parameters(name)
        result = build_controller(parameters, NUC4, REFERENCE).step(state)
        assert result.state == predicted(state, parameters.delay_s)
        assert result.lookahead_distance == pytest.approx(parameters.lookahead(NUC4).distance(2.0))
        expected = 2.0 * 2.0**2 / result.lookahead_distance * math.sin(result.eta)
        moment = result.state
        path = REFERENCE.project(moment.x, moment.y)
        lacking = missing_curvature(
            *(moment.x, moment.y, path.d, path.psi, path.kappa),
            *(result.lookahead_x, result.lookahead_y),
        )
        expected += parameters.curvature_feedforward * 2.0**2 * lacking
        assert result.a_lat == pytest.approx(expected, rel=1e-9)
    with_delay, without = (
        controller(delay_s=delay).step(state).steering_angle for delay in (0.05, 0.0)
    )
    assert with_delay != without
    moved_on = controller().step(predicted(state, 0.05))
    assert moved_on.steering_angle == with_delay


@pytest.mark.parametrize("delay", [0.0, 0.03, 0.2])
def test_compensation_changes_nothing_on_a_steady_circle(delay):
    """The predicted arc is the one driven."""
    raceline = circle(3.0)
    result = controller(raceline=raceline, delay_s=delay).step(on_track(raceline, 2.0, r=4.0 / 3.0))
    assert result.a_lat == pytest.approx(16.0 / 3.0, rel=2e-5)
    assert result.s == pytest.approx(2.0 + 4.0 * delay, abs=1e-6)


# -- lateral velocity that nothing measures --------------------------------------------------------


@pytest.mark.parametrize("car", ["nuc4", "sim"])
@pytest.mark.parametrize("v_x, delta", [(2.0, 0.2), (4.0, 0.1), (4.0, -0.12), (6.0, 0.05)])
def test_missing_lateral_velocity_is_that_of_the_steady_circle(car, v_x, delta):
    """From the equations of motion, integrated until v_y' = r' = 0."""
    vehicle = load_vehicle(car)
    derivatives = single_track_derivatives(vehicle)
    v_y, r = (
        solve_ivp(
            lambda _, z: derivatives(v_x, z[0], z[1], delta, 0.0),
            (0.0, 5.0),
            [0.0, 0.0],
            method="LSODA",
            rtol=1e-11,
            atol=1e-12,
        )
        .y[:, -1]
        .tolist()
    )
    assert max(map(abs, derivatives(v_x, v_y, r, delta, 0.0))) < 1e-8
    center = on_track(REFERENCE, 3.0, v_x=v_x, v_y=v_y, r=r)
    axle = moved(center, -vehicle.l_r)
    for point, state in (("center_of_gravity", center), ("rear_axle", axle)):
        subject = Controller(PLAIN.with_(reference_point=point), TABLE, vehicle, REFERENCE)
        found = subject.step(state._replace(v_y=math.nan)).state
        assert found.v_y == pytest.approx(state.v_y, abs=1e-4)
        assert found._replace(v_y=0.0) == state._replace(v_y=0.0)


@pytest.mark.once
@settings(deadline=None)
@given(v_x=st.floats(-5.0, 15.0), r=st.floats(-30.0, 30.0))
def test_the_estimate_is_odd_and_finite_beyond_what_tires_can_do(v_x, r):
    estimate = [
        controller().step(on_track(REFERENCE, 3.0, v_x=v_x, v_y=math.nan, r=rate)).state.v_y
        for rate in (r, -r)
    ]
    assert math.isfinite(estimate[0])
    assert estimate[0] == pytest.approx(-estimate[1], abs=1e-12)


# -- limits ----------------------------------------------------------------------------------

anywhere = st.floats(-60.0, 60.0)
walk = st.lists(
    st.tuples(
        st.floats(-0.05, 0.3),  # time since the last state
        st.builds(
            CarState,
            t=st.just(0.0),
            x=st.one_of(anywhere, st.just(math.nan)),
            y=anywhere,
            psi=st.floats(-10.0, 10.0),
            v_x=st.floats(-3.0, 15.0),
            v_y=st.one_of(st.floats(-5.0, 5.0), st.just(math.nan)),
            r=st.floats(-10.0, 10.0),
        ),
    ),
    min_size=2,
    max_size=12,
)


@pytest.mark.once
@pytest.mark.parametrize("name", ["map", "pure_pursuit_paper"])
@settings(deadline=None, max_examples=60)
@given(states=walk)
def test_lock_rate_and_speed_limits_hold_on_any_walk(name, states):
    parameters = load_controller_parameters(name).with_(v_max_mps=6.0)
    steering_map = TABLE if name == "map" else build_steering_map("ackermann", NUC4, 12.0)
    subject = Controller(parameters, steering_map, NUC4, REFERENCE)
    t = latest = 0.0
    last = None
    for elapsed, state in states:
        t += elapsed
        result = subject.step(state._replace(t=t))
        assert abs(result.steering_angle) <= NUC4.delta_max
        assert 0.0 <= result.speed <= 6.0
        if result.status is Status.INVALID_STATE:
            assert result.speed == 0.0
            assert last is None or result.steering_angle == last
            continue
        if last is not None:
            # after a pause, or if time jumps back, at most a tenth of a second's change
            slew = NUC4.delta_rate_max * min(max(t - latest, 0.0), 0.1)
            assert abs(result.steering_angle - last) <= slew + 1e-12
        last, latest = result.steering_angle, t


def test_the_rate_limit_is_reached_and_ends_at_the_wanted_angle():
    subject = controller()
    subject.step(on_track(REFERENCE, 2.0, turn=-1.5))
    found = [
        subject.step(on_track(REFERENCE, 2.0, turn=1.5, t=0.025 * k)).steering_angle
        for k in range(1, 15)
    ]
    assert -np.diff(found[:5]) == pytest.approx(0.025 * NUC4.delta_rate_max)
    assert found[-1] == -TABLE.steering(4.0, 100.0)[0]


def test_another_raceline_does_not_let_the_wheels_jump():
    """Racelines are published repeatedly while the car drives."""
    subject = controller()
    before = subject.step(on_track(REFERENCE, 2.0, turn=-1.5)).steering_angle
    assert before > 0.2
    subject.change(raceline=circle(3.0))
    after = subject.step(on_track(REFERENCE, 2.0, turn=1.5, t=0.025)).steering_angle
    assert after >= before - 0.025 * NUC4.delta_rate_max - 1e-12
    subject.change(raceline=None)
    stop = subject.step(on_track(REFERENCE, 2.0, t=0.05))
    assert (stop.status, stop.speed, stop.steering_angle) == (Status.NO_RACELINE, 0.0, after)


def test_reset_forgets_the_wheels_and_the_place():
    subject = controller()
    subject.step(on_track(REFERENCE, 2.0, turn=-1.5))
    subject.reset()
    state = on_track(REFERENCE, 20.0, turn=1.0)
    assert subject.step(state) == controller().step(state)


# -- input that cannot be right ------------------------------------------------------------------


@pytest.mark.parametrize("field", CarState._fields)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_state_that_is_not_finite_stops_the_car_and_leaves_no_trace(field, value):
    subject, untouched = controller(), controller()
    for each in (subject, untouched):
        first = each.step(on_track(REFERENCE, 5.0, turn=0.1))
    state = on_track(REFERENCE, 5.1, t=0.025)
    result = subject.step(state._replace(**{field: value}))
    if field == "v_y" and math.isnan(value):  # it just was not measured
        assert result.status is Status.OK
        return
    assert result.status is Status.INVALID_STATE
    assert result.speed == 0.0
    assert result.steering_angle == first.steering_angle
    assert math.isnan(result.d) and math.isnan(result.lookahead_x)
    assert subject.step(state) == untouched.step(state)


def test_two_infinities_do_not_cancel():
    state = on_track(REFERENCE, 5.0)._replace(x=math.inf, y=-math.inf)
    assert controller().step(state).status is Status.INVALID_STATE


@pytest.mark.once
@settings(deadline=None, max_examples=100)
@given(state=st.tuples(*[st.floats()] * 7), name=st.sampled_from(["table", "ackermann"]))
def test_no_numbers_at_all_make_it_fail(state, name):
    """As decoded from a corrupt message: any bits."""
    parameters = load_controller_parameters("map")
    steering_map = TABLE if name == "table" else build_steering_map("ackermann", NUC4, 12.0)
    subject = Controller(parameters, steering_map, NUC4, REFERENCE)
    result = subject.step(CarState(*state))
    assert abs(result.steering_angle) <= NUC4.delta_max
    assert 0.0 <= result.speed <= parameters.v_max_mps
    again = subject.step(on_track(REFERENCE, 5.0, t=1.0))
    assert again.status is Status.OK and again.s == pytest.approx(5.0, abs=0.5)


@pytest.mark.parametrize("value", [1e12, -1e200, 1.7e308])
@pytest.mark.parametrize("field", ["x", "y", "psi", "v_x", "v_y", "r"])
def test_absurd_numbers_count_as_not_finite(field, value):
    state = on_track(REFERENCE, 5.0)._replace(**{field: value})
    assert controller().step(state).status is Status.INVALID_STATE


def test_without_raceline_it_stops_and_then_drives_when_there_is_one():
    subject = controller(raceline=None)
    state = on_track(REFERENCE, 5.0)
    result = subject.step(state)
    assert (result.status, result.speed, result.steering_angle) == (Status.NO_RACELINE, 0.0, 0.0)
    subject.change(raceline=REFERENCE)
    assert subject.step(state) == controller().step(state)


def test_a_raceline_without_speeds_is_refused_by_name():
    silent = Raceline(REFERENCE.x, REFERENCE.y, source="hall.csv")
    with pytest.raises(ParameterError, match=r"hall\.csv: expected speeds, got none"):
        controller(raceline=silent)
    subject = controller()
    with pytest.raises(ParameterError, match="expected speeds"):
        subject.change(raceline=silent)
    assert subject.raceline is REFERENCE


@pytest.mark.parametrize("lookahead", [7.0, 50.0])
def test_a_lookahead_longer_than_the_track_finds_its_farthest_point(lookahead):
    """The public code's search never ends there."""
    raceline = circle(3.0)
    parameters = PLAIN.with_(lookahead_min_m=lookahead, lookahead_max_m=2.0 * lookahead)
    result = controller(parameters, raceline).step(on_track(raceline, 0.0))
    assert result.lookahead_distance == pytest.approx(6.0, abs=1e-3)
    assert (result.lookahead_x, result.lookahead_y) == pytest.approx((-3.0, 0.0), abs=0.2)
    assert result.a_lat == pytest.approx(16.0 / 3.0, rel=1e-3)


@pytest.mark.once
@pytest.mark.parametrize("direction", np.linspace(0.0, 6.0, 7))
def test_from_far_outside_it_comes_back_at_walking_pace(direction):
    center = float(np.mean(REFERENCE.x)), float(np.mean(REFERENCE.y))
    x, y = center[0] + 20.0 * math.cos(direction), center[1] + 20.0 * math.sin(direction)
    subject = controller(speed_scale=0.6)
    plant = Plant(PlantParameters(vehicle="nuc4"))
    plant.reset(x, y, direction + 2.0)
    for tick in range(60 * 500):
        if tick % 12 == 0:
            result = subject.step(plant.reference_state())
            if abs(result.d) > 2.0:
                assert (result.status, result.speed) == (Status.OFF_COURSE, 1.0)
            if abs(result.d) < 0.1 and abs(result.eta) < 0.5:
                break
        plant.advance(result.steering_angle, result.speed)
    assert abs(result.d) < 0.1


def test_noise_does_not_shake_the_wheels_of_a_standing_car():
    random = np.random.default_rng(2)
    subject = controller()
    quiet = subject.step(on_track(REFERENCE, 2.0, v_x=0.0)).steering_angle
    for k in range(200):
        v_x, v_y, r = random.normal(0.0, 0.03, 3).tolist()
        result = subject.step(on_track(REFERENCE, 2.0, v_x=v_x, v_y=v_y, r=r, t=0.025 * k))
        assert result.steering_angle == pytest.approx(quiet, abs=0.15)


def test_steering_maps_are_built_as_the_parameters_name_them():
    subject = build_controller(load_controller_parameters("map_linear"), NUC4, REFERENCE)
    assert subject.steering_map.provenance.tire_model == "linear"
    assert build_controller(PLAIN, NUC4).steering_map.provenance.tire_model == "pacejka"
    # the demand from standstill, 2 (0.5 m/s)^2 / L, is finite, and so is its angle
    stiff = dataclasses.replace(NUC4, delta_max=0.3)
    result = build_controller(PLAIN, stiff, REFERENCE).step(
        on_track(REFERENCE, 2.0, turn=-1.5, v_x=0.0)
    )
    assert result.steering_angle == pytest.approx(0.3)
