"""Node ``simulator``: the simulated car in real time, or with a simulated clock."""

import math
import os
import subprocess
import sys
import threading
import time

import rospy
from ackermann_msgs.msg import AckermannDriveStamped
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool

from map_racing.srv import InjectFault, InjectFaultResponse

from ..errors import ParameterError
from ..simulation.car import DrivenCar, SimulatedCar
from ..simulation.faults import Fault, Faults, load_faults
from ..simulation.plants import build_plant, load_plant
from ..simulation.race import START_S
from ..track.files.load import load_raceline
from .conversions import frame, plane_pose, set_plane_pose, to_time
from .node import get_parameter, run
from .transforms import TransformBroadcaster

__all__ = ["SimulatorNode", "main"]

SECOND = 1000000000
CLOCK_PERIOD_NS = 10000000  # of /clock, in addition to the arrival of each pose
LONGEST_CATCH_UP = 0.5  # s; if the computer stalls for longer, simulated time is skipped
CONNECTING_S = 0.5  # time until a counted connection actually carries messages
LOCKSTEP_PATIENCE = 2.0  # longest wait for the answer to a pose [s of wall time]


class SimulatorNode:
    """Advances the car to each event and publishes its sensors.

    Without ``~clock_rate`` timestamps are wall time. With it, simulated time begins at 1 s, runs
    that many times as fast as real time, and is published on ``/clock``.
    """

    def __init__(self):
        raceline = load_raceline(
            get_parameter("raceline", "reference", "track, raceline file or bag: start and walls")
        )
        plant_name = get_parameter("plant", "nuc4", "shipped plant or plant file")
        seed = get_parameter("seed", 1, "seed of the noise")
        start_s = get_parameter("start_s", START_S, "arc length at which the car starts [m]")
        self._clock_rate = get_parameter(
            "clock_rate", 0.0, "simulated seconds per second, published on /clock; 0: real time"
        )
        self._lockstep = get_parameter(
            "lockstep", False, "with clock_rate: time waits for the answer to each pose"
        )
        self._map = frame(get_parameter("map_frame", "map", "frame of the poses"))
        self._base = frame(get_parameter("base_frame", "base_link", "frame of the rear axle"))
        if not (math.isfinite(self._clock_rate) and self._clock_rate >= 0.0):
            raise ParameterError(f"~clock_rate: expected 0 or more, got {self._clock_rate}")
        if not math.isfinite(start_s):
            raise ParameterError(f"~start_s: expected a finite number, got {start_s}")
        if self._lockstep and not self._clock_rate:
            raise ParameterError("~lockstep: expected a ~clock_rate, got 0: real time cannot wait")

        parameters = load_plant(plant_name)
        for note in parameters.vehicle.notes:
            rospy.logwarn("~plant: its vehicle %s: %s", parameters.vehicle.name, note)
        plant, localization = build_plant(parameters, seed)
        schedule = get_parameter("faults", "", "schedule of faults, a YAML file; empty: none")
        faults = load_faults(schedule, raceline.length) if schedule else ()
        self._faults = Faults(faults, plant, "simulator", seed)
        car = SimulatedCar(plant, localization, faults=self._faults)
        self._car, self._second = DrivenCar(car, raceline, self._on_faults), None
        start = raceline.pose(start_s)
        self._car.put(start.x, start.y, start.psi)
        self._step_ns = round(plant.time_step * SECOND)
        self._ticks_per_clock = CLOCK_PERIOD_NS // self._step_ns
        # Guards the car; notified by each command.
        self._changed = threading.Condition(threading.RLock())
        self._answered = 0
        self._advertise()

        self._start_clock()
        self._drive = rospy.Subscriber(
            "drive", AckermannDriveStamped, self._on_drive, queue_size=10, tcp_nodelay=True
        )
        rospy.Subscriber("initialpose", PoseWithCovarianceStamped, self._on_initial_pose)
        self._service = rospy.Service("~inject_fault", InjectFault, self._on_inject)
        rospy.on_shutdown(self._end_second)

    def _advertise(self):
        self._odom = rospy.Publisher("odom", Odometry, queue_size=100, tcp_nodelay=True)
        self._pose = rospy.Publisher("pose", PoseStamped, queue_size=100, tcp_nodelay=True)
        self._imu = rospy.Publisher("imu", Imu, queue_size=100, tcp_nodelay=True)
        self._truth = rospy.Publisher("ground_truth/odom", Odometry, queue_size=100)
        self._collision = rospy.Publisher("wall_collision", Bool, queue_size=10, latch=True)
        self._transforms = TransformBroadcaster()
        self._collision.publish(False)
        self._collided = False

    # -- time ----------------------------------------------------------------------------------

    def _start_clock(self):
        # Wall time at simulated time 0, from which real-time timestamps count, too.
        self._rate = self._clock_rate or 1.0
        self._wall_origin = time.monotonic()
        if self._clock_rate:
            self._clock = rospy.Publisher("/clock", Clock, queue_size=100, tcp_nodelay=True)
            self._origin_ns = SECOND
        else:
            self._clock = None
            self._origin_ns = time.time_ns()

    def run(self):
        """Simulate until the node is shut down."""
        car = self._car.car
        if self._lockstep:
            while not (self._has_controller() or rospy.is_shutdown()):
                self._publish_clock()
                time.sleep(0.05)
            time.sleep(CONNECTING_S)
            self._wall_origin = time.monotonic()
        while not rospy.is_shutdown():
            with self._changed:
                self._advance()
                ahead = car.next_event + 1
                if self._clock is not None:
                    ahead = min(ahead, self._next_clock_tick())
            wall = self._wall_origin + ahead * car.plant.time_step / self._rate
            time.sleep(max(wall - time.monotonic(), 0.0))

    def _advance(self):
        """Drive up to the present, and publish the measurements made until then."""
        car = self._car.car
        step = car.plant.time_step
        behind = (time.monotonic() - self._wall_origin) * self._rate - car.now
        if behind > LONGEST_CATCH_UP * self._rate:
            lost = behind - step
            if self._clock is None:
                rospy.logwarn("the simulation fell behind and skips %.2f s", lost)
                self._origin_ns += round(lost * SECOND)
            self._wall_origin += lost / self._rate
            behind = step
        target = car.tick + int(behind / step + 1e-9)
        while car.tick < target:
            for seen in self._car.advance_to(min(target, self._next_clock_tick())):
                self._publish_clock()
                self._publish(seen)
                if self._lockstep:
                    self._wait_for_answer(self._ns_of(seen.measured.t))
            if car.tick % self._ticks_per_clock == 0:
                self._publish_clock()
        if self._car.crashed != self._collided:
            self._collided = self._car.crashed
            self._collision.publish(self._collided)
            if self._collided:
                rospy.logwarn("the car touched a wall; initialpose resets it")

    def _next_clock_tick(self):
        each = self._ticks_per_clock
        return (self._car.car.tick // each + 1) * each

    def _ns(self, tick):
        return self._origin_ns + tick * self._step_ns

    def _ns_of(self, t):
        return self._ns(round(t / self._car.car.plant.time_step))

    def _publish_clock(self):
        if self._clock is not None:
            self._clock.publish(Clock(to_time(self._ns(self._car.car.tick))))

    def _has_controller(self):
        return self._odom.get_num_connections() and self._drive.get_num_connections()

    def _wait_for_answer(self, stamp):
        """Wait for the command computed from the pose with this timestamp."""
        if self._has_controller():
            begin = time.monotonic()
            self._changed.wait_for(
                lambda: self._answered >= stamp or rospy.is_shutdown(), LOCKSTEP_PATIENCE
            )
            # Simulated time stood still meanwhile and must not catch up.
            waited = time.monotonic() - begin
            self._wall_origin += max(0.0, waited - self._car.car.plant.time_step / self._rate)

    # -- input ---------------------------------------------------------------------------------

    def _on_drive(self, message):
        with self._changed:
            if not self._lockstep:
                self._advance()
            self._car.command(message.drive.steering_angle, message.drive.speed)
            self._answered = message.header.stamp.to_nsec() or self._ns(self._car.car.tick)
            self._changed.notify_all()

    def _on_initial_pose(self, message):
        x, y, psi = plane_pose(message.pose.pose)
        if not all(map(math.isfinite, (x, y, psi))):
            rospy.logwarn("initialpose: expected a pose, got x %g, y %g, heading %g", x, y, psi)
            return
        named = frame(message.header.frame_id)
        if named not in ("", self._map):
            rospy.logwarn("initialpose: expected the frame %s, got %s", self._map, named)
            return
        with self._changed:
            if not self._lockstep:
                self._advance()
            self._car.put(x, y, psi)
        rospy.loginfo("the car was reset to x %.2f m, y %.2f m, heading %.2f rad", x, y, psi)

    # -- faults --------------------------------------------------------------------------------

    def _on_inject(self, request):
        with self._changed:
            if not request.fault:
                self._faults.clear()
                return InjectFaultResponse(True, "all faults end")
            begin = self._car.car.now
            try:
                fault = Fault(
                    request.fault,
                    begin,
                    request.for_s or Fault.for_s,
                    size=request.size or None,
                )
                self._faults.add(fault)
            except ParameterError as error:
                return InjectFaultResponse(False, str(error))
        size = "" if fault.size is None else f", {fault.size:g}"
        return InjectFaultResponse(True, f"{fault.fault}{size}")

    def _on_faults(self, begun, ended):
        for fault in begun:
            size = "" if fault.size is None else f", {fault.size:g}"
            rospy.logwarn("fault begins: %s%s", fault.fault, size)
            if fault.fault == "second_publisher":
                self._start_second(fault.size)
        for fault in ended:
            rospy.logwarn("fault ends: %s", fault.fault)
            if fault.fault == "second_publisher":
                self._end_second()

    def _start_second(self, aside):
        folder = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
        path = os.pathsep.join([folder, *filter(None, [os.environ.get("PYTHONPATH")])])
        name = f"{rospy.get_name().rpartition('/')[2]}_second"
        self._second = subprocess.Popen(
            [
                *(sys.executable, "-m", "map_racing.nodes.second_publisher", f"__name:={name}"),
                *(f"odom:={self._odom.resolved_name}", f"_aside:={aside}"),
            ],
            env={**os.environ, "PYTHONPATH": path},
        )

    def _end_second(self):
        if self._second is not None:
            self._second.terminate()
            self._second.wait()
            self._second = None

    # -- output --------------------------------------------------------------------------------

    def _publish(self, seen):
        measured, map_frame = seen.measured, seen.frame or self._map
        stamp_ns = self._ns_of(measured.t)
        stamp = to_time(stamp_ns)
        imu = Imu()
        imu.header.stamp, imu.header.frame_id = stamp, self._base
        imu.orientation_covariance[0] = -1.0  # no orientation
        imu.orientation.w = 1.0
        imu.angular_velocity.z = measured.r
        imu.linear_acceleration.x, imu.linear_acceleration.y = seen.acceleration
        pose = PoseStamped()
        pose.header.stamp, pose.header.frame_id = stamp, map_frame
        _set_pose(pose.pose, measured, seen.quaternion)
        # The odometry comes last, because controllers act on it.
        self._imu.publish(imu)
        self._transforms.send(map_frame, self._base, stamp_ns, *measured[1:4])
        self._truth.publish(self._odometry(seen.true, stamp, self._map))
        self._pose.publish(pose)
        self._odom.publish(self._odometry(measured, stamp, map_frame, seen.quaternion))

    def _odometry(self, state, stamp, map_frame, quaternion=1.0):
        message = Odometry()
        message.header.stamp, message.header.frame_id = stamp, map_frame
        message.child_frame_id = self._base
        _set_pose(message.pose.pose, state, quaternion)
        twist = message.twist.twist
        twist.linear.x, twist.angular.z = state.v_x, state.r
        # As in real odometry that does not measure it.
        twist.linear.y = 0.0 if math.isnan(state.v_y) else state.v_y
        return message


def _set_pose(pose, state, quaternion):
    set_plane_pose(pose, *state[1:4])
    if quaternion != 1.0:
        pose.orientation.z *= quaternion
        pose.orientation.w *= quaternion


def main():
    """Run the node."""
    run("simulator", SimulatorNode)
