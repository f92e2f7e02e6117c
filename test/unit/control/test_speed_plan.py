"""Grip-limited speeds: within the requested speeds and the car's limits, on any raceline."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from map_racing.control.controller import Controller, build_controller
from map_racing.control.parameters import ControllerParameters, load_controller_parameters
from map_racing.control.speed_plan import WALKING_PACE, SpeedPlan, lateral_limit, scaled_speed
from map_racing.control.speed_sectors import SpeedSectors
from map_racing.control.state import CarState
from map_racing.control.steering import build_steering_map
from map_racing.errors import ParameterError
from map_racing.track.files.load import load_raceline
from map_racing.track.raceline import Raceline
from map_racing.track.speed_profile import lap_time
from map_racing.vehicle.lookup import LookupTable
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.steady_state import steady_state_table

NUC4, SIM = load_vehicle("nuc4"), load_vehicle("sim")
TABLE, LINEAR = (build_steering_map("table", vehicle, 12.0) for vehicle in (NUC4, SIM))
LIMITED = ControllerParameters("table", m_m=0.2, q_s=0.17, grip_use=0.8)
REFERENCE = load_raceline("reference")


def oval(straight=10.0, radius=2.0, speed=6.0, step=0.1):
    """Two straights and two half circles; s = 0 is the beginning of a straight."""
    half, bend = np.arange(0.0, straight, step), np.arange(0.0, math.pi, step / radius)
    x = np.concatenate((half, straight + radius * np.sin(bend)))
    y = np.concatenate((0.0 * half, radius - radius * np.cos(bend)))
    x, y = np.append(x, straight - x), np.append(y, 2.0 * radius - y)
    return Raceline(x, y, vx_mps=None if speed is None else np.full(x.size, speed))


def circle(radius, speed=9.0):
    angle = 2.0 * np.pi * np.arange(200) / 200
    return Raceline(radius * np.cos(angle), radius * np.sin(angle), vx_mps=np.full(200, speed))


def at_start(v_x=3.0):
    point = REFERENCE.pose(0.0)
    return CarState(0.0, point.x, point.y, point.psi, v_x, 0.0, 0.0)


@pytest.mark.parametrize("use", [0.6, 0.8, 1.0])
@pytest.mark.parametrize("radius", [1.5, 4.0])
def test_a_circle_takes_the_share_of_the_tables_limit(radius, use):
    plan = SpeedPlan(circle(radius), LIMITED.with_(grip_use=use), TABLE)
    v = plan.speed_at(1.0)
    assert v < 9.0
    assert v**2 / radius == pytest.approx(use * TABLE.max_lateral_acceleration(v), rel=2e-3)


def test_brakes_before_the_bend_and_within_its_limits():
    line = oval(straight=20.0, speed=9.0)
    plan = SpeedPlan(line, LIMITED.with_(a_drive_max_mps2=5.0, a_brake_max_mps2=4.0), TABLE)
    bend = plan.speed_at(20.0 + math.pi)
    begin = 20.0 - 2.0
    # v_2^2 = v_1^2 - 2 a ds with full braking on the straight
    fall = plan.speed_at(begin - 2.0) ** 2 - plan.speed_at(begin) ** 2
    assert fall == pytest.approx(2.0 * 4.0 * 2.0, rel=1e-3)
    assert plan.speed_at(begin) ** 2 == pytest.approx(bend**2 + 2.0 * 4.0 * 2.0, rel=0.1)
    rise = plan.speed_at(4.0) ** 2 - plan.speed_at(2.0) ** 2
    assert rise == pytest.approx(2.0 * 5.0 * 2.0, rel=1e-3)
    a_long = (np.roll(plan.speed, -1) ** 2 - plan.speed**2) / (2.0 * plan.ds)
    a_lat = plan.speed**2 * np.abs(line.sample(plan.s).kappa)
    lateral = a_lat / (0.8 * TABLE.max_lateral_acceleration(plan.speed))
    along = np.where(a_long > 0.0, a_long / 5.0, -a_long / 4.0)
    assert np.max(np.hypot(lateral, along)) < 1.01


@pytest.mark.once
@settings(deadline=None, max_examples=25)
@given(
    st.floats(0.1, 1.2),
    st.floats(0.0, 2.0),
    st.lists(st.floats(0.0, 20.0), min_size=12, max_size=12),
    st.floats(0.0, 1.5),
)
@example(use=1.0, scale=1.0, speeds=[0.0] * 11 + [5e-324], sector=0.0)
@example(use=0.5, scale=1.0, speeds=[0.0] * 11 + [11.0], sector=0.0)
def test_never_faster_than_asked_and_less_grip_is_never_faster(use, scale, speeds, sector):
    """For any speeds, including stops."""
    angle = 2.0 * np.pi * np.arange(12) / 12
    line = Raceline(8.0 * np.cos(angle), 3.0 * np.sin(angle), vx_mps=speeds)
    sectors = SpeedSectors([(1.0, 5.0, sector)], line.length)
    parameters = LIMITED.with_(grip_use=use, speed_scale=scale)
    plan = SpeedPlan(line, parameters, TABLE, sectors)
    assert np.all(plan.speed <= plan.requested)
    assert np.all(plan.requested <= parameters.v_max_mps)
    for s in (0.5, 3.0, 20.0):
        asked = line.speed_at(s) * scale * sectors.scale_at(s)
        assert plan.speed_at(s) <= min(asked, 12.0) + 20.0 * plan.ds * 40.0
    less = SpeedPlan(line, parameters.with_(grip_use=max(0.1, 0.9 * use)), TABLE, sectors)
    assert np.all(less.speed <= plan.speed * (1.0 + 1e-8) + 1e-12)


@pytest.mark.once
@settings(deadline=None, max_examples=50)
@given(st.sampled_from([TABLE, LINEAR]), st.floats(0.1, 1.2), st.floats(0.5, 1.0))
def test_the_lateral_limit_is_a_share_or_the_lock(table, share, part):
    v = np.linspace(0.1, 12.0, 300)
    reached, limit = table.max_lateral_acceleration(v), lateral_limit(table, share, 12.0)(v)
    assert np.all(limit >= share * reached)
    assert np.all(limit <= np.maximum(share, 1.0) * reached)
    # Where no share is taken, the car uses at most 0.3 of its tires' usable grip.
    more = limit > share * reached * (1.0 + 1e-12)
    assert np.all(
        limit[more] <= 0.3 * share * reached.max() * 1.001
    )  # the peak is between two speeds
    assert np.all(lateral_limit(table, part * share, 12.0)(v) <= limit)


@pytest.mark.parametrize("kappa, speed", [(1.05, 3.4), (1.07, 3.36), (1.10, 3.0)])
def test_a_bend_within_the_lock_that_the_tires_hardly_feel_is_not_slowed(kappa, speed):
    """With only a share of the lock, the car could not drive as tight a bend at any speed."""
    wanted = kappa * speed**2
    assert wanted < LINEAR.max_lateral_acceleration(speed)
    assert wanted < 0.25 * LINEAR.max_lateral_acceleration(10.0)
    plan = SpeedPlan(circle(1.0 / kappa, speed), LIMITED, LINEAR)
    np.testing.assert_allclose(plan.speed, speed, rtol=1e-3)


def test_hardly_more_than_the_top_speed_is_asked_for():
    line = oval(straight=20.0, speed=11.0)
    plan = SpeedPlan(line, LIMITED, TABLE, top_speed=7.0)
    assert (plan.speed.max(), plan.requested.max()) == pytest.approx((7.7, 11.0))
    # Every slower place is reported.
    s, planned, requested = plan.slowest_place
    assert plan.speed_at(10.0) < requested and plan.share_slowed > 0.99
    slower = SpeedPlan(oval(straight=20.0, speed=7.7), LIMITED, TABLE)
    np.testing.assert_allclose(plan.speed, slower.speed, rtol=1e-2)
    bare = SpeedPlan(oval(straight=20.0, speed=None), LIMITED, TABLE, top_speed=7.0)
    assert bare.speed.max() == pytest.approx(7.7)
    parameters = load_controller_parameters("map").with_(speed_scale=1.0)
    assert build_controller(parameters, SIM, line).plan.speed.max() == pytest.approx(7.7)
    assert build_controller(parameters, NUC4, line).plan.speed.max() > 8.0


def test_where_the_grip_suffices_speeds_are_those_of_the_raceline():
    line = oval(speed=2.0)
    plan = SpeedPlan(line, LIMITED, TABLE)
    np.testing.assert_allclose(plan.speed, 2.0, rtol=1e-12)
    assert plan.share_slowed == 0.0
    assert str(plan) == "the grip suffices for the raceline's speeds"


def test_says_how_much_is_slowed_and_where_most():
    line = oval(straight=20.0, speed=6.0)
    plan = SpeedPlan(line, LIMITED, TABLE)
    s, planned, requested = plan.slowest_place
    # The bends, and about 1.6 m each for braking before and accelerating after them.
    way = (6.0**2 - planned**2) * (1.0 / 12.0 + 1.0 / 14.0)
    expected = (2.0 * math.pi * 2.0 + 2.0 * way) / line.length
    assert plan.share_slowed == pytest.approx(expected, rel=0.1)
    assert (planned, requested) == (plan.speed_at(s), pytest.approx(6.0))
    assert planned == plan.speed.min()
    assert 20.0 <= s % (0.5 * line.length) <= 20.0 + 2.0 * math.pi
    assert str(plan) == (
        f"slower than the raceline on {plan.share_slowed:.0%} of the lap, ".replace("%", " %")
        + f"most at s = {s:.1f} m: {planned:.1f} instead of 6.0 m/s"
    )
    assert plan.lap_time == lap_time(plan.speed, plan.ds)


@pytest.mark.parametrize("use", [0.1, 0.85])
def test_bends_tighter_than_the_lock_are_driven_at_walking_pace(use):
    """The car runs wide there, but that is no reason to refuse a race."""
    tight = oval(radius=0.4, speed=5.0, step=0.05)
    plan = SpeedPlan(tight, LIMITED.with_(grip_use=use), TABLE)
    assert plan.speed_at(10.0 + 0.2 * math.pi) == pytest.approx(WALKING_PACE, rel=0.02)
    assert plan.speed.min() > 0.95 * WALKING_PACE
    slow = SpeedPlan(oval(radius=0.4, speed=0.5, step=0.05), LIMITED, TABLE)
    np.testing.assert_allclose(slow.speed, 0.5, rtol=1e-9)


def test_a_lock_that_knows_no_tires_bounds_bends_as_well():
    lock = build_steering_map("ackermann", NUC4, 12.0)
    plan = SpeedPlan(oval(radius=0.4, speed=5.0, step=0.05), LIMITED, lock)
    assert plan.speed_at(10.0 + 0.2 * math.pi) == pytest.approx(WALKING_PACE)
    wide = SpeedPlan(oval(radius=3.0, speed=5.0), LIMITED, lock)
    np.testing.assert_allclose(wide.speed, 5.0)


def test_a_raceline_without_speeds_is_driven_as_fast_as_the_grip_allows():
    bare, fast = oval(straight=15.0, speed=None), oval(straight=15.0, speed=12.0)
    plan = SpeedPlan(bare, LIMITED, TABLE)
    np.testing.assert_allclose(plan.speed, SpeedPlan(fast, LIMITED, TABLE).speed, rtol=2e-4)
    low, high = plan.speed.min(), plan.speed.max()
    assert str(plan) == (
        "the raceline has no speeds: driven as fast as the grip allows, "
        f"{low:.1f} to {high:.1f} m/s"
    )
    half = SpeedPlan(bare, LIMITED.with_(speed_scale=0.5), TABLE)
    np.testing.assert_allclose(half.speed, 0.5 * plan.speed, rtol=2e-4)


def test_tables_that_end_early_or_have_no_stable_state_are_used_as_steering_uses_them():
    slow = steady_state_table(NUC4, np.linspace(0.5, 2.5, 9), np.linspace(0.0, 0.4, 30))
    a_lat = TABLE.a_lat.copy()
    a_lat[:, TABLE.speeds > 4.0] = math.nan
    a_lat[100:, TABLE.speeds > 3.0] = math.nan
    for table in (slow, LookupTable(TABLE.speeds, TABLE.angles, a_lat, TABLE.provenance)):
        plan = SpeedPlan(circle(4.0), LIMITED, table)
        v = plan.speed_at(1.0)
        assert v**2 / 4.0 == pytest.approx(0.8 * table.max_lateral_acceleration(v), rel=2e-3)
        assert not table.steering(v, v**2 / 4.0)[1]


def test_between_cells_speeds_are_interpolated_also_across_the_start():
    plan = SpeedPlan(oval(straight=20.0, speed=9.0), LIMITED, TABLE)
    middles = [plan.speed_at(s) for s in (plan.s + 0.5 * plan.ds).tolist()]
    np.testing.assert_allclose(middles, 0.5 * (plan.speed + np.roll(plan.speed, -1)), rtol=1e-9)


def test_sectors_and_top_speed_hold_for_a_raceline_without_speeds():
    bare = oval(straight=15.0, speed=None)
    sectors = SpeedSectors([(2.0, 8.0, 0.5)], bare.length)
    plan, full = (SpeedPlan(bare, LIMITED, TABLE, sectors=which) for which in (sectors, None))
    inside = (plan.s > 2.1) & (plan.s < 7.9)
    np.testing.assert_allclose(plan.requested[inside], 0.5 * full.requested[inside], rtol=1e-9)
    np.testing.assert_allclose(
        plan.requested[~inside & (plan.s > 8.1)], full.requested[plan.s > 8.1]
    )
    faster = SpeedPlan(bare, LIMITED.with_(speed_scale=1.5, v_max_mps=6.0), TABLE)
    assert faster.requested.max() == faster.speed.max() == 6.0


def test_a_place_where_the_car_shall_stand_is_not_the_slowest():
    line = oval(straight=20.0, speed=6.0)
    stands = SpeedSectors([(5.0, 10.0, 0.0)], line.length)
    s, planned, requested = SpeedPlan(line, LIMITED, TABLE, sectors=stands).slowest_place
    assert 0.0 < planned < requested and not 5.0 <= s <= 10.0


@pytest.mark.parametrize("share, told", [(0.05, "5 %"), (0.005, "less than 1 %")])
def test_small_shares_of_the_lap_are_told(share, told):
    plan = SpeedPlan(oval(speed=2.0), LIMITED, TABLE)
    plan.speed[: round(share * plan.speed.size)] = 1.0
    assert str(plan).startswith(f"slower than the raceline on {told} of the lap")


@pytest.mark.parametrize("scale", [-0.1, 2.1, math.nan])
def test_speeds_are_not_scaled_by_what_is_no_scale(scale):
    with pytest.raises(ParameterError, match="speed_scale"):
        scaled_speed(REFERENCE, scale)


def test_a_speed_of_zero_everywhere_is_a_plan_that_stands():
    plan = SpeedPlan(REFERENCE, LIMITED.with_(speed_scale=0.0), TABLE)
    assert np.all(plan.speed == 0.0)
    assert plan.share_slowed == 0.0


# -- in the controller -----------------------------------------------------------------------------


def test_the_controller_commands_the_plan():
    subject = Controller(LIMITED, TABLE, NUC4, REFERENCE)
    plan = SpeedPlan(REFERENCE, LIMITED, TABLE)
    for s in (0.0, 9.0, 20.0):
        point = REFERENCE.pose(s)
        state = CarState(0.0, point.x, point.y, point.psi, plan.speed_at(s), 0.0, 0.0)
        assert subject.step(state).speed == pytest.approx(plan.speed_at(s), abs=1e-6)
    s = np.array([0.0, 9.0])
    np.testing.assert_array_equal(subject.planned_speed(s), [plan.speed_at(at) for at in s])


def test_any_change_that_matters_makes_another_plan_and_no_other():
    subject = Controller(LIMITED, TABLE, NUC4, REFERENCE)
    plans = [subject.plan]

    def changed():
        plans.append(subject.plan)
        return plans[-1] is not plans[-2]

    for change in (
        {"grip_use": 0.7},
        {"a_drive_max_mps2": 3.0},
        {"a_brake_max_mps2": 3.0},
        {"speed_scale": 0.9},
        {"v_max_mps": 5.0},
    ):
        subject.change(parameters=subject.parameters.with_(**change))
        assert changed(), change
    subject.change(sectors=SpeedSectors([(0.0, 3.0, 0.5)], REFERENCE.length))
    assert changed()
    subject.change(raceline=REFERENCE.reversed())
    assert changed()
    subject.change(steering_map=steady_state_table(NUC4, TABLE.speeds, TABLE.angles))
    assert changed()
    subject.change(parameters=subject.parameters.with_(m_m=0.3, delay_s=0.02))
    assert not changed()
    subject.change(parameters=subject.parameters.with_(grip_use=0.0))
    assert subject.plan is None
    subject.change(parameters=subject.parameters.with_(grip_use=0.7))
    assert subject.plan is not None


def test_what_is_prepared_has_no_effect_until_it_is_applied(monkeypatch):
    """Applying it, between two control steps, does no more planning."""
    subject = Controller(LIMITED, TABLE, NUC4, REFERENCE)
    before = subject.step(at_start())
    setup = subject.prepare(parameters=LIMITED.with_(speed_scale=0.1, grip_use=0.5))
    monkeypatch.setattr("map_racing.control.setup.SpeedPlan", None)
    assert subject.step(at_start())[:2] == before[:2]
    subject.apply(setup)
    assert subject.step(at_start()).speed < 0.2 * before.speed


def test_a_raceline_without_speeds_needs_grip_use():
    bare = Raceline(REFERENCE.x, REFERENCE.y, source="hall.csv")
    subject = Controller(LIMITED, TABLE, NUC4, bare)
    assert subject.step(at_start()).speed == pytest.approx(subject.plan.speed_at(0.0), abs=1e-6)
    with pytest.raises(ParameterError, match=r"hall\.csv: expected speeds, got none"):
        subject.change(parameters=LIMITED.with_(grip_use=0.0))
    assert subject.parameters == LIMITED
    with pytest.raises(ParameterError, match=r"hall\.csv: expected speeds, got none"):
        Controller(LIMITED.with_(grip_use=0.0), TABLE, NUC4, bare)


@pytest.mark.parametrize("kind", ["ackermann", "linear_table"])
def test_the_grip_is_that_of_the_tires_whatever_the_steering_map(kind):
    subject = build_controller(LIMITED.with_(steering_map=kind), NUC4, REFERENCE)
    expected = build_controller(LIMITED, NUC4, REFERENCE)
    np.testing.assert_array_equal(subject.plan.speed, expected.plan.speed)
