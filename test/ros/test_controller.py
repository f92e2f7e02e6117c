"""The running controller: its commands, and each case in which it must stop."""

import math
import re
import sys
import time
from dataclasses import fields, replace
from pathlib import Path

import pytest
import yaml
from ackermann_msgs.msg import AckermannDriveStamped
from diagnostic_msgs.msg import DiagnosticArray
from dynamic_reconfigure.client import Client
from geometry_msgs.msg import PoseStamped
from harness import Car, Rig, wait_for, waypoints
from map_racing.msg import Belief, Guidance, Tracking
from nav_msgs.msg import Odometry
from std_msgs.msg import Bool, Float64, String

from map_racing.bags.topics import SETTINGS_TOPIC
from map_racing.control.controller import build_controller
from map_racing.control.parameters import (
    STEERING_MAPS,
    ControllerParameters,
    load_controller_parameters,
    load_safety_limits,
)
from map_racing.control.safety_limits import SafetyLimits
from map_racing.control.settings import parse_settings
from map_racing.nodes.transforms import TransformBroadcaster
from map_racing.nodes.waypoints import waypoint_array_class
from map_racing.track.files.load import load_raceline
from map_racing.validation import meaning
from map_racing.vehicle.grids import default_grid
from map_racing.vehicle.lookup import load_table
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.steady_state import steady_state_table


def test_each_pose_makes_one_command_with_its_header(rig, listen):
    rig = rig({"max_pose_age_s": 5.0})
    guidance = listen("/guidance", Guidance)
    rig.driving()
    rig.car.silent = True
    (publish,) = rig.car.publishers
    # One at a time: the node may skip poses that arrive while it computes.
    sent = []
    for _ in range(20):
        message = rig.car.message()
        publish(message)
        sent.append(message.header.stamp)
        wait_for(lambda stamp=sent[-1]: rig.drive[-1].header.stamp == stamp, what="the command")
    stamps = [m.header.stamp for m in rig.drive]
    assert stamps[stamps.index(sent[0]) :] == sent
    assert {m.header.frame_id for m in guidance} == {"map"}
    last = guidance[-1]
    assert (last.mode, last.reason, last.status) == (last.MODE_DRIVING, "", "ok")
    assert abs(last.d) < 0.05
    assert last.a_lat_max > abs(last.a_lat)
    assert math.hypot(last.lookahead_x - last.x, last.lookahead_y - last.y) == pytest.approx(
        last.lookahead_distance, abs=1e-6
    )


def test_the_commands_are_those_of_the_core(rig, listen):
    """The controller outside ROS gives the same command for the state in the guidance."""
    from map_racing.control.guidance import bearing, lateral_acceleration
    from map_racing.control.state import CarState

    rig = rig({"controller": "map", "curvature_feedforward": 0.0})
    guidance = listen("/guidance", Guidance)
    rig.driving()
    last = guidance.wait(lambda m: m.mode == "driving" and m.speed > 1.0)
    state = CarState(0.0, last.x, last.y, last.psi, last.v_x, last.v_y, 0.0)
    eta = bearing(state, last.lookahead_x, last.lookahead_y)
    assert last.eta == pytest.approx(eta, abs=1e-9)
    assert last.a_lat == pytest.approx(
        lateral_acceleration(last.v_x, last.lookahead_distance, eta), abs=1e-9
    )


def test_settings_wait_for_whoever_comes_late(rig, listen):
    rig = rig({"speed_scale": 0.5})
    rig.driving()
    message = listen(SETTINGS_TOPIC, String).wait()
    assert message._connection_header["latching"] == "1"
    settings = parse_settings(message.data)
    assert settings.notes == () and settings.controller.speed_scale == 0.5
    assert settings.vehicle == load_vehicle(settings.values["vehicle"]["name"].lower())
    assert settings.values["safety"] and settings.values["raceline"]["length_m"] > 1.0


def test_numbers_for_plots(rig, listen):
    rig = rig({"delay_s": 0.0, "speed_scale": 0.5})
    rig.car.d = 0.1
    inboxes = {
        name: listen(f"/{name}", Float64)
        for name in ("lateral_error", "speed_error", "latency", "pose_age")
    }
    tracking = listen("/tracking", Tracking)
    rig.driving()
    # Poses from before the car was moved aside may come first.
    beside = inboxes["lateral_error"].wait(lambda m: m.data > 0.05)
    assert beside.data == pytest.approx(0.1, abs=1e-6)
    last = tracking.wait(lambda m: m.speed_command > 1.0 and m.lateral_error > 0.05)
    assert last.header.stamp.to_sec() > 0.0 and last.header.frame_id == "map"
    assert last.lateral_error == pytest.approx(0.1, abs=1e-6)
    assert last.speed_error == pytest.approx(last.speed - last.speed_command)
    assert 0.0 < last.lateral_acceleration_limit < 20.0
    assert abs(last.lateral_acceleration) < 20.0 and 0.0 < last.pose_age < 5.0
    wait_for(lambda: len(inboxes["latency"]) > 50)
    assert inboxes["speed_error"]
    # Only the unit (seconds): scripts/latency measures the value.
    assert all(0.0 < m.data < 5.0 for m in [*inboxes["latency"], inboxes["pose_age"].wait()])


def test_what_is_learned_while_driving_is_published(rig, listen):
    rig = rig({"controller": "map_adaptive", "adaptation_share": 0.3, "speed_scale": 0.8})
    beliefs = listen("/map_racing/belief", Belief)
    rig.driving()
    wait_for(lambda: len(beliefs) >= 40, what="forty beliefs")
    published = list(beliefs)

    def answered():
        return {message.header.stamp for message in list(rig.drive)}

    wait_for(lambda: published[-1].header.stamp in answered(), what="the last one's command")
    stamps = answered()
    # The connection for commands may be established later than the one for estimates.
    for belief in (b for b in published if b.header.stamp >= min(stamps)):
        assert belief.header.stamp in stamps and belief.header.frame_id == "map"
        for name in ("friction", "front_stiffness", "rear_stiffness"):
            low, high = (getattr(belief, f"{name}_{end}") for end in ("low", "high"))
            assert low <= getattr(belief, name) <= high
            assert 0.7 - 1e-9 <= getattr(belief, name) <= 1.3 + 1e-9
        assert 0.0 < belief.delay < 0.5 and 0.0 < belief.grip <= 1.3


def test_what_is_not_learned_is_not_published(rig, listen):
    rig = rig()
    beliefs = listen("/map_racing/belief", Belief)
    rig.driving()
    rig.more(10)
    assert not beliefs


def test_diagnostics_at_rest(rig):
    rig = rig()
    rig.driving()
    wait_for(lambda: float(rig.status()["pose rate [Hz]"]) > 30.0, what="the rate")
    status = rig.status()
    assert float(status["saturated share"]) <= 1.0
    assert status["raceline"].startswith("reference (")
    assert status["steering map"] == "table"


@pytest.mark.parametrize("source", ["pose", "tf"])
def test_other_sources_of_the_pose(ros, start, advertise, listen, source):
    start("controller", {"raceline": "reference", "pose_source": source})
    if source == "pose":
        publisher = advertise("/pose", PoseStamped)

        def publish(message):
            publisher.publish(PoseStamped(message.header, message.pose.pose))
    else:
        static, moving = TransformBroadcaster(static=True), TransformBroadcaster()
        static.send("map", "odom", 0, 1.0, 2.0, 0.0)

        def publish(message):
            at, q = message.pose.pose.position, message.pose.pose.orientation
            psi = 2.0 * math.atan2(q.z, q.w)
            stamp = message.header.stamp.to_nsec()
            moving.send("odom", "base_link", stamp, at.x - 1.0, at.y - 2.0, psi)

    errors = listen("/lateral_error", Float64)
    drive = listen("/drive", AckermannDriveStamped)
    car = Car(ros, [publish])
    try:
        drive.wait(lambda m: m.drive.speed > 1.0)
        wait_for(lambda: len(errors) > 10)
        assert abs(errors[-1].data) < 1e-3
    finally:
        car.stop()


@pytest.mark.parametrize("point", ["rear_axle", "center_of_gravity"])
def test_reference_point_of_the_pose(rig, listen, point):
    """The rear axle is on the line, whatever point the pose refers to."""
    rig = rig({"reference_point": point, "delay_s": 0.0, "speed_scale": 0.5})
    errors = listen("/lateral_error", Float64)
    # Poses of the center of gravity, as such simulators send them.
    distance = load_vehicle("nuc4").l_r if point == "center_of_gravity" else 0.0

    def shift(message):
        at, q = message.pose.pose.position, message.pose.pose.orientation
        psi = 2.0 * math.atan2(q.z, q.w)
        at.x += distance * math.cos(psi)
        at.y += distance * math.sin(psi)
        message.twist.twist.linear.y = distance * message.twist.twist.angular.z
        return message

    rig.car.change = shift
    rig.driving()
    wait_for(lambda: len(errors) > 60, what="figures")
    assert max(abs(m.data) for m in list(errors)[10:]) < 2e-3


def test_lookup_table_from_a_file(rig, listen, tmp_path):
    """The table from the file, which has less grip, steers."""
    path = tmp_path / "weak.csv"
    vehicle = load_vehicle("nuc4")
    table = steady_state_table(replace(vehicle, mu=0.5 * vehicle.mu), *default_grid(vehicle))
    table.save(path)
    rig = rig({"lookup_table": str(path)})
    guidance = listen("/guidance", Guidance)
    rig.driving()
    last = guidance.wait(lambda m: m.mode == "driving" and m.v_x > 2.0)
    weak = load_table(path).max_lateral_acceleration(last.v_x)
    assert last.a_lat_max == pytest.approx(weak, rel=1e-6)


# The raceline's speeds at the car.
AS_ASKED = {"speed_scale": 1.0, "speed_lookahead_s": 0.0, "delay_s": 0.0}


def test_speed_sectors(rig, listen, tmp_path):
    raceline = load_raceline("reference")
    half = len(raceline.s_points) // 2
    path = tmp_path / "speed_scaling.yaml"
    path.write_text(
        "global_limit: 1.0\nn_sectors: 2\n"
        f"Sector0: {{start: 0, end: {half - 1}, scaling: 0.25}}\n"
        f"Sector1: {{start: {half}, end: {len(raceline.s_points)}, scaling: 1.0}}\n"
    )
    # The car of this test drives faster than commanded, but by less than 2 m/s: beyond that, the
    # command ramps down from the measured speed, which shows after a late pose.
    rig = rig({**AS_ASKED, "sectors": str(path), "grip_use": 0.0, "max_overspeed_mps": 10.0})
    rig.car.speed = 2.5
    told(rig, "speed sectors: 25 to 100 % of the raceline's speed")
    guidance = listen("/guidance", Guidance)
    rig.driving()
    wait_for(lambda: guidance and guidance[-1].s > raceline.s_points[half] + 2.0, what="half a lap")
    driven = [m for m in guidance if m.mode == "driving" and 3.0 < m.s < 0.9 * raceline.length]
    for message in driven:
        scale = 0.25 if message.s < raceline.s_points[half] else 1.0
        expected = scale * raceline.speed_at(message.s)
        assert message.speed == pytest.approx(expected, rel=1e-3), message.s
    assert {m.s < raceline.s_points[half] for m in driven} == {True, False}


def test_sectors_of_another_raceline_are_doubted(rig, tmp_path):
    path = tmp_path / "speed_scaling.yaml"
    path.write_text("n_sectors: 1\nSector0: {start: 0, end: 226, scaling: 0.5}\n")
    rig = rig({"sectors": str(path)})
    rig.driving()
    doubt = "the last sector ends at point 226, the raceline has 366"
    told(rig, doubt)
    assert doubt in rig.status()["doubts"]


def planned(raceline, **changes):
    """Planned speeds of the shipped `map` on a raceline."""
    parameters = load_controller_parameters("map").with_(speed_scale=1.0, **changes)
    return build_controller(parameters, load_vehicle("nuc4"), raceline).plan


def told(rig, text):
    wait_for(lambda: text in rig.node.output, what=lambda: f"{text}: {rig.node.output}")


def assert_published(message, plan):
    speeds = [waypoint.vx_mps for waypoint in message.wpnts]
    expected = [plan.speed_at(waypoint.s_m) for waypoint in message.wpnts]
    assert speeds == pytest.approx(expected, abs=1e-9)


def test_speeds_within_the_grip_are_told_published_driven_and_changed(rig, listen):
    raceline = load_raceline("reference")
    rig = rig({**AS_ASKED, "grip_use": 0.8}, speed=2.0)
    driven = listen("/driven_waypoints", waypoint_array_class()[0])
    guidance = listen("/guidance", Guidance)
    rig.driving()
    plan = planned(raceline, grip_use=0.8)
    assert f"grip_use 0.8: {plan}" in rig.node.output
    assert str(plan).startswith("slower than the raceline on")
    assert driven.wait().header.frame_id == "map"
    assert_published(driven[-1], plan)
    wait_for(lambda: len([m for m in guidance if m.mode == "driving"]) > 50, what="guidance")
    for message in [m for m in guidance if m.mode == "driving"][-40:]:
        assert message.speed == pytest.approx(plan.speed_at(message.s), abs=1e-6)

    client = Client("/controller/tuning", timeout=10.0)
    assert client.update_configuration({"grip_use": 0.5})["grip_use"] == 0.5
    less = planned(raceline, grip_use=0.5)
    wait_for(lambda: len(driven) == 2, what="the new speeds")
    assert_published(driven[-1], less)
    assert f"grip_use 0.5: {less}" in rig.node.output
    mark = len(guidance)
    wait_for(lambda: len(guidance) > mark + 20, what="guidance")
    # A pose that a busy computer delivers late stops the car.
    for message in [m for m in guidance[mark + 5 :] if m.mode == "driving"]:
        assert message.speed == pytest.approx(less.speed_at(message.s), abs=1e-6)
    # A change that does not affect the speeds is not logged again.
    client.update_configuration({"table_m_m": 0.25})
    client.update_configuration({"grip_use": 0.05})
    told(rig, "reconfigure rejected: grip_use: expected 0 (off) or 0.1 to 1.2")
    assert rig.node.output.count("grip_use 0.5: ") == 1 and len(driven) == 2
    client.update_configuration({"grip_use": 0.0})
    told(rig, "grip_use 0: the speeds are the raceline's, whatever the grip")
    wait_for(lambda: len(driven) == 3, what="the raceline's speeds")
    assert driven[-1].wpnts[50].vx_mps == pytest.approx(raceline.speed_at(driven[-1].wpnts[50].s_m))


def test_a_raceline_without_speeds_is_driven_by_the_grip_alone(rig, refusal, tmp_path):
    raceline = load_raceline("reference")
    path = tmp_path / "bare.csv"
    path.write_text(
        "# x_m,y_m\n" + "".join(f"{x:.6f},{y:.6f}\n" for x, y in zip(raceline.x, raceline.y))
    )
    rig = rig({"raceline": str(path), "speed_scale": 1.0})
    rig.driving()
    told(rig, "the raceline has no speeds: driven as fast as the grip allows, ")
    said = refusal("controller", {"raceline": str(path), "grip_use": 0.0})
    assert "bare.csv: expected speeds, got none" in said


def test_stamps_of_zero_are_the_time_of_arrival(rig):
    def unstamped(message):
        message.header.stamp = type(message.header.stamp)()
        message.header.frame_id = "/map"
        return message

    rig = rig()
    rig.car.change = unstamped
    rig.driving()
    after = rig.more(25)
    assert rig.status()["mode"] == "driving"
    assert after[-1].header.frame_id == "map"


# -- each reason to stop -------------------------------------------------------------------------


def test_frozen_localization_that_keeps_publishing(rig):
    rig = rig({"stop_deceleration_mps2": 3.0, "max_pose_age_s": None})
    rig.driving()
    frozen = rig.car.message()
    rig.car.change = lambda message: frozen
    rig.wait_mode("stopped", "pose too old")
    rig.car.change = lambda message: message
    rig.driving()


def test_frozen_localization_without_stamps(rig):
    rig = rig()
    rig.driving()
    frozen = rig.car.message()
    frozen.header.stamp = type(frozen.header.stamp)()
    rig.car.change = lambda message: frozen
    rig.wait_mode("stopped", "pose frozen while moving")
    rig.car.change = lambda message: message
    rig.driving()


def test_poses_that_stop_coming(rig):
    rig = rig({"stop_deceleration_mps2": 3.0, "max_pose_age_s": None, "hold_s": 0.5})
    rig.driving()
    rig.car.silent = True
    ramp, deceleration = rig.stops("pose too old")
    assert deceleration == pytest.approx(3.0, rel=0.02)
    assert len({m.drive.steering_angle for m in ramp}) == 1
    # Finally nothing more is sent.

    def silence():
        sent = len(rig.drive)
        time.sleep(0.5)
        return len(rig.drive) == sent

    wait_for(silence, what="silence")
    rig.car.silent = False
    rig.driving()


def test_nan_in_a_pose(rig):
    rig = rig()
    rig.driving()

    def broken(message):
        message.pose.pose.position.x = math.nan
        return message

    rig.car.change = broken
    rig.wait_mode("stopped", "pose not finite or absurd")
    assert all(math.isfinite(m.drive.steering_angle + m.drive.speed) for m in rig.drive)
    rig.car.change = lambda message: message
    rig.driving()


def test_jump_of_the_pose(rig):
    rig = rig({"recovery_s": 1.5})
    rig.driving()
    rig.car.s += 10.0
    rig.stops("pose jumped")
    rig.driving()


def test_far_from_the_raceline(rig):
    rig = rig({"max_jump_m": 5.0})
    rig.driving()
    rig.car.d = 1.7
    rig.stops("too far from the raceline")
    rig.car.d = 0.0
    rig.driving()


@pytest.mark.parametrize("how", ["topic", "service"])
def test_stop_requested(rig, ros, advertise, how):
    rig = rig({"stop_deceleration_mps2": 3.0})
    rig.driving()
    if how == "topic":
        stop = advertise("/stop_driving", Bool)
        stop.publish(True)
    else:
        assert rig.call(ros, "stop").success
    ramp, deceleration = rig.stops("stop requested")
    assert deceleration == pytest.approx(3.0, rel=0.02)
    # Steering continues, and the car stands until it is resumed.
    assert len({m.drive.steering_angle for m in ramp}) > 1
    assert {m.drive.speed for m in rig.more(50)} == {0.0}
    assert "stopping: stop requested" in rig.node.output
    assert rig.node.output.count("stop requested") == 1
    if how == "topic":
        stop.publish(False)
    else:
        assert rig.call(ros, "resume").success
    rig.driving()


def test_grip_exceeded_for_long(rig, ros):
    # A car that points across the line demands more grip than it has.
    rig = rig({"max_saturated_s": 0.5, "max_turn_rad": 1.5}, speed=3.0)
    rig.driving()

    def skew(message):
        q = message.pose.pose.orientation
        psi = 2.0 * math.atan2(q.z, q.w) + 0.9
        q.z, q.w = math.sin(0.5 * psi), math.cos(0.5 * psi)
        return message

    rig.car.change = skew
    rig.stops("grip exceeded for long")
    rig.car.change = lambda message: message
    rig.more(50)
    rig.wait_mode("stopped", "grip exceeded for long")
    assert rig.call(ros, "resume").success
    rig.driving()


def test_no_speed_above_the_limit(rig):
    rig = rig({"v_max_mps": 1.5, "speed_scale": 1.9})
    client = Client("/controller/tuning", timeout=10.0)
    client.update_configuration({"v_max_mps": 9.0})
    rig.driving()
    rig.more(100)
    assert max(m.drive.speed for m in rig.drive) == pytest.approx(1.5)


# -- racelines -----------------------------------------------------------------------------------


def test_raceline_by_topic_missing_nonsense_changed_and_repeated(rig, advertise):
    rig = rig({"raceline": None})
    raceline = load_raceline("reference")
    publisher = advertise("/global_waypoints", waypoint_array_class()[0])
    wait_for(lambda: rig.drive, what="commands")
    rig.wait_mode("waiting", "no raceline")
    assert rig.drive[-1].drive.speed == 0.0

    message = waypoints(raceline)
    publisher.publish(message)
    rig.driving()
    # Repeating the same raceline changes nothing, not even the log.
    mark = len(rig.drive)
    for _ in range(5):
        publisher.publish(message)
        time.sleep(0.1)
    assert rig.node.output.count("raceline of /global_waypoints") == 1
    # The same line with other points changes nothing either, except for 0.1 mm.
    publisher.publish(waypoints(raceline, points=211))
    wait_for(lambda: rig.node.output.count("raceline of /global_waypoints") == 2)
    rig.more(15)
    during = [m.drive for m in rig.drive[mark:]]
    assert min(d.speed for d in during) > 1.0
    steps = [abs(b.steering_angle - a.steering_angle) for a, b in zip(during, during[1:])]
    assert max(steps) < 0.12
    rig.wait_mode("driving")

    message.wpnts[7].x_m = math.nan
    publisher.publish(message)
    rig.stops("raceline not drivable")
    assert "expected a finite x, got nan, at point 7:" in rig.node.output
    publisher.publish(waypoint_array_class()[0]())
    rig.more(15)
    rig.wait_mode("stopped", "raceline not drivable")
    publisher.publish(waypoints(raceline))
    rig.driving()


def test_two_nodes_with_different_racelines(rig, start):
    """The car follows one of them, and the log names both; when that node is gone, it switches."""
    rig = rig({"raceline": None})
    first = start("raceline_publisher", {"raceline": "reference", "period": 0.2}, name="first")
    rig.driving()
    second = start("raceline_publisher", {"raceline": "club", "period": 0.2}, name="second")
    text = "/global_waypoints: /second publishes another raceline than /first, which is kept"
    wait_for(lambda: text in rig.node.output, what="the error")
    assert rig.node.output.count("raceline of /global_waypoints") == 1
    rig.wait_mode("driving")
    first.stop()
    wait_for(lambda: rig.node.output.count("raceline of /global_waypoints") == 2)
    second.stop()


def test_the_node_whose_racelines_count_can_be_named(rig, start):
    rig = rig({"raceline": None, "waypoints_from": "second"})
    start("raceline_publisher", {"raceline": "club", "period": 0.2}, name="first")
    wait_for(lambda: "publishes another raceline than /second" in rig.node.output)
    rig.wait_mode("waiting", "no raceline")
    assert rig.status()["waiting for"] == "no raceline yet on /global_waypoints"
    start("raceline_publisher", {"raceline": "reference", "period": 0.2}, name="second")
    rig.driving()


def test_it_says_what_it_waits_for(start, listen):
    node = start("controller", remaps={"odom": "/elsewhere"})
    diagnostics = listen("/diagnostics", DiagnosticArray)
    text = "no pose yet on /elsewhere, no raceline yet on /global_waypoints"
    diagnostics.wait(lambda m: text in [pair.value for pair in m.status[0].values])
    nobody = " (nobody publishes it)"
    text = f"waiting: {text.replace(',', nobody + ',')}{nobody}"
    wait_for(lambda: text in node.output, what="the line in the log")


# -- the end -------------------------------------------------------------------------------------


def test_shutdown_tells_the_car_to_stop(rig):
    rig = rig()
    rig.driving()
    assert rig.node.stop() == 0
    last = [m.drive.speed for m in rig.drive[-3:]]
    assert last == [0.0, 0.0, 0.0]


def test_the_car_stops_when_the_controller_is_killed(start, listen):
    """It sends nothing more: the missing commands stop the car."""
    start("simulator")
    node = start("controller", {"raceline": "reference"})
    truth = listen("/ground_truth/odom", Odometry)
    truth.wait(lambda m: m.twist.twist.linear.x > 3.0, 20.0)
    node.kill()
    killed = truth[-1].header.stamp
    stood = truth.wait(
        lambda m: m.header.stamp > killed and abs(m.twist.twist.linear.x) < 0.05, 10.0
    )
    # 0.2 s without commands, and a second to brake from at most 6 m/s.
    assert (stood.header.stamp - killed).to_sec() < 2.0


def test_a_failure_in_a_callback_stops_the_car(ros, processes, advertise, listen):
    code = """
from map_racing.control.controller import Controller
from map_racing.nodes import controller
step, count = Controller.step, [0]
def failing(self, state):
    count[0] += 1
    if count[0] == 100:
        raise ZeroDivisionError("a fault")
    return step(self, state)
Controller.step = failing
controller.main()
"""
    ros.set_param("/controller/raceline", "reference")
    node = processes([sys.executable, "-c", code, "__name:=controller"])
    publisher = advertise("/odom", Odometry)
    car = Car(ros, [publisher.publish])
    rig = Rig(car, node, listen)
    try:
        rig.stops("controller failed")
        assert "ZeroDivisionError: a fault" in node.output
        rig.more(50)
        rig.wait_mode("stopped", "controller failed")
        assert rig.call(ros, "resume").success
        rig.driving()
    finally:
        car.stop()


@pytest.mark.parametrize(
    "params, text",
    [
        ({"controller": "nonsense"}, "nonsense: no such file"),
        ({"pose_source": "gps"}, "~pose_source: expected odom, pose or tf"),
        ({"v_max_mps": "fast"}, "~v_max_mps: expected float"),
        ({"v_max_mps": -1.0}, "v_max_mps: expected more than 0 to 200 m/s, got -1"),
        ({"raceline": "nowhere.csv"}, "nowhere.csv: no such file"),
        ({"sectors": "nowhere.yaml"}, "nowhere.yaml: cannot read"),
    ],
)
def test_impossible_parameters_end_with_one_line(refused, params, text):
    assert text in refused("controller", params)


# -- tuning --------------------------------------------------------------------------------------


def test_a_saved_file_is_what_the_node_starts_with(rig, ros, start, tmp_path):
    target = str(tmp_path / "tuned.yaml")
    first = rig({"save_to": target, "speed_scale": 0.6, "max_pose_age_s": None})
    wanted = {"table_m_m": 0.33, "delay_s": 0.08, "max_jump_m": 0.7, "stop_deceleration_mps2": 2.5}
    Client("/controller/tuning", timeout=10.0).update_configuration(wanted)
    assert first.call(ros, "save").success
    first.node.stop()
    start("controller", {"controller": target, "raceline": "reference"}, name="again")
    held = Client("/again/tuning", timeout=10.0).get_configuration(timeout=10.0)
    for name, value in {**wanted, "speed_scale": 0.6}.items():
        assert held[name] == value, name


def test_tuning_and_saving(rig, ros, listen, tmp_path):
    target = tmp_path / "tuned" / "{steering_map}.yaml"
    rig = rig({"controller": "map", "save_to": str(target), "speed_scale": 0.6})
    client = Client("/controller/tuning", timeout=10.0)
    first = client.get_configuration(timeout=10.0)
    shipped = {name: load_controller_parameters(name) for name in ("map", "pure_pursuit")}
    assert first["table_q_s"] == shipped["map"].q_s
    assert first["ackermann_q_s"] == shipped["pure_pursuit"].q_s
    assert first["speed_scale"] == 0.6
    rig.driving()
    client.update_configuration(
        {"table_q_s": 0.21, "speed_scale": 0.5, "ackermann_m_m": 0.4, "max_deviation_m": 0.9}
    )
    heard = listen(SETTINGS_TOPIC, String)
    heard.wait()
    # Also for a value that does not affect the speeds.
    client.update_configuration({"table_q_s": 0.22})
    client.update_configuration({"table_q_s": 0.21})
    wait_for(lambda: len(heard) >= 3)
    told_q = [parse_settings(message.data).controller.q_s for message in heard]
    assert told_q[-2:] == [0.22, 0.21]
    saved = rig.call(ros, "save")
    assert saved.success
    assert saved.message == str(tmp_path / "tuned" / "table.yaml")
    wanted = shipped["map"].with_(q_s=0.21, speed_scale=0.5)
    assert load_controller_parameters(saved.message) == wanted
    limits = SafetyLimits(max_deviation_m=0.9, max_pose_age_s=0.8)
    assert load_safety_limits(saved.message) == limits

    client.update_configuration({"steering_map": "ackermann"})
    wait_for(lambda: rig.status()["steering map"] == "ackermann")
    saved = yaml.safe_load(Path(rig.call(ros, "save").message).read_text())
    assert (saved["steering_map"], saved["m_m"]) == ("ackermann", 0.4)
    assert saved["q_s"] == shipped["pure_pursuit"].q_s
    rig.driving()

    # An impossible change is rejected; the answer has the values in use.
    answer = client.update_configuration({"lookahead_min_m": 4.0, "lookahead_max_m": 1.0})
    assert answer["lookahead_min_m"] == shipped["map"].lookahead_min_m
    assert "reconfigure rejected" in rig.node.output
    client.update_configuration({"v_max_mps": 5.0})
    assert client.update_configuration({"v_max_mps": 14.0})["v_max_mps"] == 5.0
    told(rig, "reconfigure rejected: v_max_mps: expected at most 12, its value at the start, got")


def test_values_beyond_their_sliders_are_rejected_and_those_in_use_stay(rig):
    """9.5 instead of 0.95 must not be clamped to the end of the slider, beyond the grip."""
    rig = rig({"controller": "map"})
    client = Client("/controller/tuning", timeout=10.0)
    held = client.get_configuration(timeout=10.0)
    offered = client.get_parameter_descriptions(timeout=10.0)
    names = [one["name"] for one in offered]
    for one in offered:
        if one["type"] == "double":
            for value in (10.0 * one["max"] + 0.1, one["min"] - 0.1):
                # Other changes of the same request are rejected, too.
                answer = client.update_configuration({"max_jump_m": 0.6, one["name"]: value})
                assert all(answer[name] == held[name] for name in names), one["name"]
                bounds = f"{one['name']}: expected {one['min']:g} to {one['max']:g}, got {value:g}"
                told(rig, f"reconfigure rejected: {bounds}; the values in use stay")
    assert client.update_configuration({"grip_use": 0.95})["grip_use"] == 0.95


def test_tuning_starts_with_the_values_in_use_and_keeps_those_beyond_its_sliders(ros, rig):
    """Leftovers on the parameter server are ignored, and sliders clamp no other values."""
    ros.set_param("/controller/tuning/speed_scale", 1.5)
    rig = rig({"delay_s": 0.7, "speed_scale": 0.6})
    client = Client("/controller/tuning", timeout=10.0)
    assert client.get_configuration(timeout=10.0)["speed_scale"] == 0.6
    answer = client.update_configuration({"speed_scale": 0.5})
    assert (answer["delay_s"], answer["speed_scale"]) == (0.7, 0.5)
    assert "rejected" not in rig.node.output
    assert "~delay_s = 0.7 (Delay compensation" in rig.node.output
    assert "~hold_s = 2.0 (Time for which" in rig.node.output
    assert "sent commands of speed 0 [s], default)" in rig.node.output


def test_sliders_are_those_of_the_parameters(rig):
    rig({})
    client = Client("/controller/tuning", timeout=10.0)
    offered = {d["name"]: d for d in client.get_parameter_descriptions(timeout=10.0)}
    known = {f.name: f for kind in (ControllerParameters, SafetyLimits) for f in fields(kind)}
    expected = {name for name, f in known.items() if f.metadata["tuning"]} - {"m_m", "q_s"}
    expected |= {f"{kind}_{name}" for kind in STEERING_MAPS for name in ("m_m", "q_s")}
    assert set(offered) == expected | {"steering_map"}
    for name in expected:
        field = known[name if name in known else name[-3:]]
        assert (offered[name]["min"], offered[name]["max"]) == field.metadata["tuning"], name
        switch = isinstance(field.default, bool)
        assert offered[name]["type"] == ("bool" if switch else "double"), name
        assert offered[name]["description"] == meaning(field)


def test_the_latency_script(roscore, processes, request):
    """It runs and measures; a busy machine may exceed the limits."""
    script = request.config.rootpath / "scripts" / "latency"
    options = ["--seconds", "1", "--tuning", "--dropouts", "1", "--load", "1"]
    run = processes([sys.executable, script, *options])
    assert run.wait(60.0) in (0, 1)
    assert "100 poses, " in run.output
    for line in ("in the node: ", "both ways by TCP: ", "live tuning, ", "of 1: ", "a core: "):
        assert line in run.output


def test_the_soak_script(roscore, processes, request):
    """It runs and measures; growth would take an hour to show."""
    script = request.config.rootpath / "scripts" / "soak"
    run = processes([sys.executable, script, "--minutes", "0.1", "--samples", "2"])
    assert run.wait(120.0) in (0, 1)
    assert "largest growth: " in run.output
    minutes = re.findall(r"^ +([\d.]+) +\d+ +\d+ ", run.output, re.MULTILINE)
    assert len(minutes) == 2 and float(minutes[-1]) >= 0.1
