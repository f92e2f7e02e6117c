"""The simulator keeps its promises: time, commands, walls, and the same race as without ROS."""

import math

import pytest
from ackermann_msgs.msg import AckermannDriveStamped
from geometry_msgs.msg import PoseWithCovarianceStamped
from harness import wait_for
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool
from tf2_msgs.msg import TFMessage

from map_racing.control.controller import build_controller
from map_racing.control.parameters import load_controller_parameters
from map_racing.control.state import CarState
from map_racing.evaluation.laps import LapEvaluator
from map_racing.nodes.conversions import plane_pose, set_plane_pose
from map_racing.simulation.plant import Localization, Plant
from map_racing.simulation.plants import load_plant
from map_racing.simulation.race import START_S, race
from map_racing.track.files.load import load_raceline
from map_racing.vehicle.parameters import load_vehicle

SECOND = 10**9
STEP_NS = 2000000


def quiet_plant(folder):
    """Plant file: nuc4 without noise and latency."""
    path = folder / "quiet.yaml"
    path.write_text("vehicle: nuc4\nlocalization_rate_hz: 50.0\n")
    return str(path)


def command(speed, angle=0.0):
    message = AckermannDriveStamped()
    message.drive.speed, message.drive.steering_angle = speed, angle
    return message


@pytest.fixture
def drive(ros, advertise):
    """Drive under a constant command, sent at the rate of the poses."""
    subscribers = []

    def begin(speed, angle=0.0):
        publisher = advertise("/drive", AckermannDriveStamped)
        subscriber = ros.Subscriber(
            "/odom", Odometry, lambda _: publisher.publish(command(speed, angle))
        )
        subscribers.append(subscriber)
        return subscriber

    yield begin
    for subscriber in subscribers:
        subscriber.unregister()


def test_simulated_time_is_exact(start, listen):
    odometry, clock = listen("/odom", Odometry), listen("/clock", Clock)
    imu, tf = listen("/imu", Imu), listen("/tf", TFMessage)
    start("simulator", {"clock_rate": 5.0})
    odometry.wait(lambda m: m.header.stamp.to_sec() > 6.0, 30.0)
    stamps = [message.header.stamp.to_nsec() for message in odometry]
    assert all((stamp - SECOND) % STEP_NS == 0 for stamp in stamps)
    # 40 Hz is a pose every 12.5 steps.
    gaps = {after - before for before, after in zip(stamps, stamps[1:])}
    assert gaps == {12 * STEP_NS, 13 * STEP_NS}
    times = [message.clock.to_nsec() for message in clock]
    assert times == sorted(times) and all(t % STEP_NS == 0 for t in times)
    assert max(after - before for before, after in zip(times, times[1:])) <= 5 * STEP_NS
    assert imu[3].orientation_covariance[0] == -1.0
    transform = tf[3].transforms[0]
    assert (transform.header.frame_id, transform.child_frame_id) == ("map", "base_link")


def test_real_time_is_the_wall_clock(start, listen):
    import rospy

    ages = []
    subscriber = rospy.Subscriber(
        "/odom", Odometry, lambda m: ages.append((rospy.Time.now() - m.header.stamp).to_sec())
    )
    odometry = listen("/odom", Odometry)
    start("simulator")
    odometry.wait(lambda _: len(odometry) > 40)
    subscriber.unregister()
    # The plant's latency is 20 ms; a pose may be younger by at most a step, and older only if this
    # computer is busy.
    assert 0.0175 < min(ages) < 1.0


def test_the_car_does_as_told_and_stops_when_nobody_does(start, listen, drive, tmp_path):
    odometry = listen("/odom", Odometry)
    start("simulator", {"clock_rate": 2.0, "plant": quiet_plant(tmp_path)})
    told = drive(2.0)
    fast = odometry.wait(lambda m: m.twist.twist.linear.x > 1.9)
    told.unregister()
    stopped = odometry.wait(
        lambda m: m.header.stamp > fast.header.stamp and m.twist.twist.linear.x < 0.05
    )
    # 0.2 s timeout, then a time constant of 0.1 s, of which stopping from 2 m/s takes about four.
    assert 0.2 < (stopped.header.stamp - fast.header.stamp).to_sec() < 1.5


def test_nonsense_is_no_command(start, listen, drive, tmp_path):
    odometry = listen("/odom", Odometry)
    start("simulator", {"clock_rate": 5.0, "plant": quiet_plant(tmp_path)})
    drive(math.nan)
    odometry.wait(lambda m: m.header.stamp.to_sec() > 3.0)
    assert all(m.twist.twist.linear.x == 0.0 for m in odometry)


def test_walls_and_the_way_back(start, listen, drive, advertise):
    odometry, collision = listen("/odom", Odometry), listen("/wall_collision", Bool)
    start("simulator", {"clock_rate": 5.0})
    assert not collision.wait().data
    subscriber = drive(5.0)
    collision.wait(lambda m: m.data, 20.0)
    hit = odometry[-1].header.stamp
    subscriber.unregister()
    still = odometry.wait(lambda m: (m.header.stamp - hit).to_sec() > 0.5)
    assert abs(still.twist.twist.linear.x) < 0.3  # only noise

    start_pose = load_raceline("reference").pose(START_S)
    put = PoseWithCovarianceStamped()
    put.header.frame_id = "map"
    set_plane_pose(put.pose.pose, start_pose.x, start_pose.y, start_pose.psi)
    advertise("/initialpose", PoseWithCovarianceStamped).publish(put)
    back = odometry.wait(
        lambda m: (
            math.hypot(m.pose.pose.position.x - start_pose.x, m.pose.pose.position.y - start_pose.y)
            < 0.05
            and m.header.stamp > still.header.stamp
        )
    )
    assert plane_pose(back.pose.pose)[2] == pytest.approx(start_pose.psi, abs=0.05)
    wait_for(lambda: not collision[-1].data, what="the end of the collision")


@pytest.mark.parametrize("x", [math.nan, 1e300])
def test_an_absurd_initial_pose_moves_nothing(start, listen, advertise, x):
    odometry = listen("/odom", Odometry)
    node = start("simulator", {"clock_rate": 5.0})
    put = PoseWithCovarianceStamped()
    set_plane_pose(put.pose.pose, x, 0.0, 0.0)
    advertise("/initialpose", PoseWithCovarianceStamped).publish(put)
    odometry.wait(lambda _: "initialpose: expected a pose" in node.output)
    last = odometry[-1].header.stamp
    odometry.wait(lambda m: m.header.stamp > last and abs(m.pose.pose.position.x) < 100.0)
    assert node.running and "Traceback" not in node.output


def test_lockstep_is_the_race_of_the_core(start, ros, advertise, listen):
    """The same controller, car and noise give the same laps, except that commands are float32."""
    raceline, vehicle = load_raceline("reference"), load_vehicle("nuc4")
    parameters = load_controller_parameters("map").with_(speed_scale=0.7)
    plant_parameters = load_plant("nuc4")
    log = race(
        Plant(plant_parameters),
        build_controller(parameters, vehicle, raceline),
        raceline,
        Localization(plant_parameters, 1),
        laps=1,
    )

    controller = build_controller(parameters, vehicle, raceline)
    drive = advertise("/drive", AckermannDriveStamped, subscribers=0)
    seen = []

    def control(message):
        twist = message.twist.twist
        t = message.header.stamp.to_sec() - 1.0
        state = CarState(
            *(t, *plane_pose(message.pose.pose)),
            *(twist.linear.x, twist.linear.y, twist.angular.z),
        )
        seen.append(state)
        result = controller.step(state)
        answer = command(result.speed, result.steering_angle)
        answer.header = message.header
        drive.publish(answer)

    subscriber = ros.Subscriber("/odom", Odometry, control, tcp_nodelay=True)
    inbox = listen("/odom", Odometry)
    start("simulator", {"clock_rate": 20.0, "lockstep": True})
    inbox.wait(lambda m: m.header.stamp.to_sec() > 1.0 + log.duration, 60.0)
    subscriber.unregister()

    laps = []
    for path in (seen, [sample.measured for sample in log.samples]):
        evaluator = LapEvaluator(raceline)
        evaluator.update(*zip(*((s.t, s.x, s.y, s.v_x) for s in path)))
        laps.append([lap for lap in evaluator.finish().laps if lap.valid])
    assert len(laps[0]) == len(laps[1]) == 1
    assert laps[0][0].lap_time_s == pytest.approx(laps[1][0].lap_time_s, abs=1e-4)
    assert laps[0][0].rms_lateral_error_m == pytest.approx(laps[1][0].rms_lateral_error_m, abs=1e-5)


@pytest.mark.parametrize(
    ("parameters", "words"),
    [
        ({"raceline": "nowhere"}, "nowhere: no such file"),
        ({"start_s": math.nan}, "~start_s: expected a finite number, got nan"),
        ({"clock_rate": "fast"}, "~clock_rate: expected float, got 'fast'"),
        ({"clock_rate": -1.0}, "~clock_rate: expected 0 or more"),
        ({"lockstep": True}, "~lockstep: expected a ~clock_rate, got 0"),
    ],
)
def test_what_it_refuses_it_says_in_a_line(refused, parameters, words):
    assert words in refused("simulator", parameters)
