"""Recordings in the style of other programs: a car on a circle with known laps and errors.

It circles at 6 m with d = 0.1 sin(3 theta): a lap takes 2 pi / 0.8 s, at 4.8 m/s, with an error of
0.0707 m RMS.
"""

import math

import numpy as np
import pytest

from map_racing.bags.writer import BagWriter
from map_racing.evaluation.recordings import load_recording
from map_racing.evaluation.runs import evaluate
from map_racing.track.raceline import Raceline

T0 = 1600000000.0
TIMES = [0.02 * i for i in range(900)]  # two laps and a bit
LAP, RMS, SPEED = math.tau / 0.8, 0.1 / math.sqrt(2.0), 4.8
ANGLE = np.linspace(0.0, math.tau, 200, endpoint=False)
LINE = Raceline(6.0 * np.cos(ANGLE), 6.0 * np.sin(ANGLE), vx_mps=np.full(200, SPEED))


def place(t):
    """Position [m] and heading [rad] of the car."""
    theta = 0.8 * t - 0.3
    r, slope = 6.0 - 0.1 * math.sin(3.0 * theta), -0.3 * math.cos(3.0 * theta)
    along, across = r, slope
    psi = theta + math.atan2(along, across)
    return r * math.cos(theta), r * math.sin(theta), psi


def steering(t):
    (*_, before), (*_, after) = place(t + 0.05), place(t + 0.07)
    return math.atan(0.32 * math.remainder(after - before, math.tau) / (0.02 * SPEED))


def joined(one, other):
    """Pose of a frame, given in another whose pose is `one`."""
    (x, y, psi), (u, v, turn) = one, other
    cos, sin = math.cos(psi), math.sin(psi)
    return x + cos * u - sin * v, y + sin * u + cos * v, psi + turn


def inverse(pose):
    x, y, psi = pose
    cos, sin = math.cos(psi), math.sin(psi)
    return -cos * x - sin * y, sin * x - cos * y, -psi


def odometry(bag, t, pose, stamp=None, **options):
    options.setdefault("received", T0 + t + 0.002)
    bag.odometry(T0 + t if stamp is None else stamp, *pose, SPEED, 0.0, 0.8, **options)


def link(bag, t, pose, parent, child, stamp=None):
    stamp = T0 + t if stamp is None else stamp
    bag.transform(stamp, *pose, parent=parent, child=child, received=T0 + t + 0.001)


# -- bags: what is written at each moment, and the expected result ---------------------------------


def unstamped_commands_beside_poses_of_another_clock(bag, i, t):
    odometry(bag, t, place(t), T0 + t - 1.0)
    bag.drive(0.0, steering(t), SPEED, received=T0 + t + 0.003)


def simulated_time_beside_commands_of_today(bag, i, t):
    odometry(bag, t, place(t), 1.0 + t)
    bag.drive(T0 + t, steering(t), SPEED, received=T0 + t + 0.003)


def poses_repeated_but_for_rounding(bag, i, t):
    x, y, psi = place(TIMES[i - i % 4])
    bag.pose(0.0, x + 1e-9 * (i % 4), y, psi, received=T0 + t)


def each_message_twice(bag, i, t):
    odometry(bag, t, place(t))
    odometry(bag, t, place(t), received=T0 + t + 0.0025)


def pairs_at_uneven_times(bag, i, t):
    t -= 0.012 * (i % 2)
    odometry(bag, t, place(t))


def receipts_in_bunches(bag, i, t):
    late = TIMES[min(i - i % 5 + 4, len(TIMES) - 1)] + 1e-4 * (i % 5)
    odometry(bag, t, place(t), received=T0 + late)


def whole_seconds(bag, i, t):
    odometry(bag, t, place(t), math.floor(T0 + t))


def localization_slower_than_odometry(bag, i, t):
    drift = 0.3 * math.sin(0.1 * t), 0.2, 0.1 * math.sin(0.05 * t)
    link(bag, t, joined(inverse(drift), place(t)), "odom", "base_link")
    if i % 5 == 0:
        link(bag, t, drift, "map", "odom")


def static_publisher_stamps_ahead(bag, i, t):
    x, y, psi = place(t)
    link(bag, t, (x - 1.0, y, psi), "odom", "base_link")
    if i % 5 == 0:
        link(bag, t, (1.0, 0.0, 0.0), "map", "odom", T0 + t + 0.1)


def names_with_slashes(bag, i, t):
    link(bag, t, place(t), "/map", "/base_link")


def a_prefix_and_another_car(bag, i, t):
    link(bag, t, place(t), "map", "ego_racecar/base_link")
    x, y, psi = place(t - 1.5)
    link(bag, t, (1.05 * x, 1.05 * y, psi), "map", "opp_racecar/base_link")


def upside_down_tree(bag, i, t):
    link(bag, t, inverse(place(t)), "base_link", "map")


def laser_on_a_mount(bag, i, t):
    if i == 0:
        bag.transform(T0, 0.27, 0.0, 0.0, parent="base_link", child="laser", static=True)
    link(bag, t, joined(place(t), (0.27, 0.0, 0.0)), "map", "laser")


def odometry_of_another_name(bag, i, t):
    own = joined(inverse((1.0, 2.0, 0.5)), place(t))
    odometry(bag, t, own, topic="/odom", frame="odom_combined")
    if i % 5 == 0:
        link(bag, t, (1.0, 2.0, 0.5), "map", "odom_combined")


def motion_capture(bag, i, t):
    bag.pose(T0 + t, *place(t), topic="/vrpn/car/pose", frame="world", received=T0 + t)


def a_lookahead_point_beside(bag, i, t):
    bag.pose(T0 + t, *place(t + 0.4), topic="/a_lookahead_point", received=T0 + t)
    bag.pose(T0 + t, *place(t), topic="/pose", received=T0 + t)


def a_few_poses_without_numbers(bag, i, t):
    x, y, psi = place(t)
    odometry(bag, t, (math.nan if 500 <= i < 508 else x, y, psi))


def headings_only_later(bag, i, t):
    x, y, psi = place(t)
    odometry(bag, t, (x, y, psi if i > 50 else math.nan))


def odometry_of_the_laser(bag, i, t):
    mount = 0.27, 0.02, 0.1
    if i == 0:
        bag.transform(T0, *mount, parent="base_link", child="laser", static=True)
    odometry(bag, t, joined(place(t), mount), topic="/pf/pose/odom", child_frame="laser")


def odometry_of_the_laser_in_its_own_frame(bag, i, t):
    origin, mount = (1.0, 2.0, 0.5), (0.27, 0.0, 0.0)
    if i == 0:
        bag.transform(T0, *mount, parent="base_link", child="laser", static=True)
    own = joined(inverse(origin), joined(place(t), mount))
    odometry(bag, t, own, topic="/odom", frame="odom", child_frame="laser")
    if i % 5 == 0:
        link(bag, t, origin, "map", "odom")


def another_static_publisher(bag, i, t):
    """The first one was wrong, and stopped."""
    if i in (0, 10):
        bag.transform(T0 + t, 0.01 * i, 0.0, 0.0, parent="map", child="odom", static=True)
    link(bag, t, joined(inverse((0.1, 0.0, 0.0)), place(t)), "odom", "base_link")


def localization_that_repeats_itself(bag, i, t):
    drift = 0.002 * min(t, 9.0), 0.0, 0.0
    link(bag, t, joined(inverse(drift), place(t)), "odom", "base_link")
    if i % 5 == 0:
        link(bag, t, drift, "map", "odom")


def stamps_set_back_by_little(bag, i, t):
    set_back = 0.06 if t > 9.0 else 0.0
    odometry(bag, t, place(t), T0 + t - set_back, received=T0 + t + 0.002)
    bag.drive(T0 + t - set_back, steering(t), SPEED, received=T0 + t + 0.003)


def commands_of_another_clock_in_the_last_lap(bag, i, t):
    odometry(bag, t, place(t))
    late = 0.9 if 15.0 < t < 16.0 else 0.0
    bag.drive(T0 + t + late, steering(t), SPEED, received=T0 + t + 0.003)


def each_transform_twice(bag, i, t):
    for late in (0.001, 0.003):
        link = {"parent": "map", "child": "base_link", "received": T0 + t + late}
        bag.transform(T0 + t, *place(t), **link)


def a_velocity_of_the_map(bag, i, t):
    x, y, psi = place(t)
    moving = SPEED * math.cos(psi), SPEED * math.sin(psi)
    bag.odometry(T0 + t, x, y, psi, *moving, 0.8, received=T0 + t)


def whole_seconds_until_the_clock_is_set(bag, i, t):
    odometry(bag, t, place(t), float(math.floor(T0 + t)) if t < 5.0 else None)
    bag.drive(T0 + t, steering(t), SPEED, received=T0 + t + 0.003)


def transforms_of_whole_seconds_until_the_clock_is_set(bag, i, t):
    link(bag, t, place(t), "map", "base_link", float(math.floor(T0 + t)) if t < 5.0 else None)


def whole_seconds_for_a_while_received_late(bag, i, t):
    late = T0 + t + 0.1 + 0.008 * (i * 7 % 5) / 5
    odometry(bag, t, place(t), float(math.floor(T0 + t)) if 7.0 < t < 12.0 else None, received=late)


def some_stamps_missing_of_late_poses(bag, i, t):
    odometry(bag, t, place(t), 0.0 if i % 10 == 3 else None, received=T0 + t + 0.1)


def a_slower_localization_sent_again_with_its_stamp(bag, i, t):
    at = TIMES[i - i % 3]
    odometry(bag, at, place(at), received=T0 + t + 0.002)


@pytest.mark.parametrize(
    ("fill", "said"),
    [
        (whole_seconds_until_the_clock_is_set, "250 of 900 stamps are too coarse"),
        (transforms_of_whole_seconds_until_the_clock_is_set, "250 of 900 stamps are too coarse"),
        (
            whole_seconds_for_a_while_received_late,
            "times of receipt used instead, accurate to 0.006 s",
        ),
        (some_stamps_missing_of_late_poses, ""),
        (a_slower_localization_sent_again_with_its_stamp, ""),
        (unstamped_commands_beside_poses_of_another_clock, "1.00"),
        (simulated_time_beside_commands_of_today, "days later than the poses'"),
        (poses_repeated_but_for_rounding, ""),
        (each_message_twice, ""),
        (pairs_at_uneven_times, ""),
        (receipts_in_bunches, ""),
        (whole_seconds, ""),
        (localization_slower_than_odometry, ""),
        (static_publisher_stamps_ahead, ""),
        (names_with_slashes, ""),
        (a_prefix_and_another_car, ""),
        (upside_down_tree, ""),
        (laser_on_a_mount, ""),
        (odometry_of_another_name, ""),
        (motion_capture, ""),
        (a_lookahead_point_beside, ""),
        (a_few_poses_without_numbers, ""),
        (headings_only_later, ""),
        (a_velocity_of_the_map, ""),
        (odometry_of_the_laser, ""),
        (odometry_of_the_laser_in_its_own_frame, ""),
        (another_static_publisher, "static, and sent with other values"),
        (localization_that_repeats_itself, "stays the same from 9.0 to 1"),
        (stamps_set_back_by_little, ""),
        (commands_of_another_clock_in_the_last_lap, "for a part of the time"),
        (each_transform_twice, ""),
    ],
)
def test_bags(tmp_path, fill, said):
    with BagWriter(tmp_path / "run.bag") as bag:
        for i, t in enumerate(TIMES):
            fill(bag, i, t)
    found = evaluate(load_recording(tmp_path / "run.bag"), LINE)
    laps = [lap for lap in found.laps if lap.valid]
    assert len(laps) == 2
    for lap in laps:
        assert lap.lap_time_s == pytest.approx(LAP, abs=2e-3)
        assert lap.rms_lateral_error_m == pytest.approx(RMS, abs=3e-4)
        assert lap.mean_speed_mps == pytest.approx(SPEED, abs=0.02)
        assert not lap.rms_speed_error_mps > 0.08
    warnings = found.warnings
    assert len(warnings) == bool(said) and all(said in warning for warning in warnings)


def test_odometry_of_a_laser_without_a_mount_is_named(tmp_path):
    with BagWriter(tmp_path / "run.bag") as bag:
        for t in TIMES:
            odometry(bag, t, joined(place(t), (0.27, 0.0, 0.0)), child_frame="car/laser_frame")
    (doubt,) = evaluate(load_recording(tmp_path / "run.bag"), LINE).warnings
    assert "has the pose of car/laser_frame, not of base_link" in doubt


# -- text ------------------------------------------------------------------------------------------

T = np.array(TIMES)
X, Y, PSI = (np.array(column) for column in zip(*map(place, TIMES)))


def rows(header, form, *columns):
    return "\n".join([header, *(form.format(*row) for row in zip(*columns))])


def bagpy():
    names = "Time,header.seq,header.stamp.secs,header.frame_id,pose.pose.position.x"
    names += ",pose.pose.position.y,pose.pose.orientation.x,pose.pose.orientation.y"
    names += ",pose.pose.orientation.z,pose.pose.orientation.w"
    columns = T0 + T, T, T0 + T, X, Y, np.sin(0.5 * PSI), np.cos(0.5 * PSI)
    return rows(names, "{:.9f},{},{:.0f},map,{},{},0,0,{},{}", *columns)


def two_topics_in_one_table():
    """Rows of poses and rows of speeds, at their own times."""
    lines = (f"{t},{x},{y},\n{t + 0.01},,,{SPEED}" for t, x, y in zip(T, X, Y))
    return "\n".join(["time,x,y,v", *lines])


def decimal_commas_in_quotes():
    lines = (f'"{t:.3f}";"{x:.6f}";"{y:.6f}"' for t, x, y in zip(T, X, Y))
    return "\n".join(["time;x;y", *lines]).replace(".", ",")


@pytest.mark.parametrize(
    "text",
    [
        bagpy(),
        two_topics_in_one_table(),
        decimal_commas_in_quotes(),
        "\ufeff" + rows("time,x,y", "{:.3f},{},{}", T, X, Y),
        rows(",time,x,y", "{:.0f},{:.3f},{},{}", T, T, X, Y),
        rows("Time (s),X (m),Y (m)", "{:.3f},{},{}", T, X, Y),
        rows("t [ms]\tx [mm]\ty [mm]", "{:.1f}\t{}\t{}", 1e3 * T, 1e3 * X, 1e3 * Y),
        rows("time,y,x", "{:.3f},{},{}", T, Y, X),
        rows("t,x,y,x_ref,y_ref", "{:.3f},{},{},{},{}", T, X, Y, X + 1.0, Y),
        rows("t,x,y,yaw", "{:.3f},{},{},{}", T, X, Y, np.degrees(PSI)),
        rows("timestamp,tx,ty,note", "{:.3f},{},{},a b", T0 + T, X, Y),
    ],
)
def test_tables(tmp_path, text):
    path = tmp_path / "run.csv"
    path.write_text(text, encoding="utf-8")
    laps = [lap for lap in evaluate(load_recording(path), LINE).laps if lap.valid]
    assert len(laps) == 2
    for lap in laps:
        assert lap.lap_time_s == pytest.approx(LAP, abs=2e-3)
        assert lap.rms_lateral_error_m == pytest.approx(RMS, abs=3e-4)
