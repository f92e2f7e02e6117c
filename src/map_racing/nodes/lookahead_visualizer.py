"""Node ``lookahead_visualizer``: lookahead, steering, car and trail as markers.

They are drawn from the messages on ``guidance``. Without these, as in replays of other stacks'
bags, car and trail are drawn from the poses. The raceline comes from ``global_waypoints`` and is
colored by the speeds on ``driven_waypoints``.
"""

import math
import threading
from collections import deque
from operator import attrgetter

import numpy as np
import rospy
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from map_racing.msg import Belief, Guidance

from ..bags.topics import BELIEF_TOPIC
from ..control.guidance import arc_to
from ..errors import ParameterError
from ..track.files.waypoints import waypoint_rows
from ..track.tracker import RacelineTracker
from ..vehicle.parameters import load_vehicle
from .conversions import frame as plain_frame
from .conversions import plane_pose, stamp_ns
from .markers import delete_all, make_marker, points_of, raceline_markers
from .node import get_parameter, run
from .waypoints import RacelineSubscriber, waypoint_array_class

__all__ = ["LookaheadVisualizer", "main"]

# Lifetime of markers [s]: long enough to avoid flicker, short enough not to show stale data.
_LIFETIME = 0.5
_TRAIL_LIFETIME = 5.0
# Distance between points of the trail, and distance that means the car was reset [m].
_TRAIL_STEP, _TRAIL_JUMP = 0.05, 2.0
# Draw the poses after this time without guidance [ns].
_UNGUIDED_NS = 500000000
# Racelines whose lengths differ by less than this share count as the same one.
_SAME_LENGTH = 0.01
_CIRCLE = [2.0 * math.pi * i / 48 for i in range(49)]

LOOKAHEAD_COLOR = (1.0, 0.0, 0.0)
CIRCLE_COLOR = (0.45, 0.45, 0.45)
ARC_COLOR = (1.0, 0.0, 1.0)
STEERING_COLOR = (0.0, 1.0, 1.0)
CAR_COLOR = (0.1, 0.4, 1.0)
LABEL_COLOR = (1.0, 0.5, 0.0)
# Colors of the trail for zero and largest error; distinct from the colors of speeds.
ERROR_COLORS = (0.65, 0.8, 1.0), (1.0, 0.4, 0.0)


def error_color(fraction):
    """Color of a lateral error, as a fraction of the largest; clipped."""
    fraction = min(fraction, 1.0)
    return ColorRGBA(*(a + fraction * (b - a) for a, b in zip(*ERROR_COLORS)), 1.0)


class LookaheadVisualizer:
    """Draws guidance messages at a limited rate."""

    def __init__(self):
        vehicle = load_vehicle(get_parameter("vehicle", "nuc4", "shipped name or file: its size"))
        self._base = plain_frame(get_parameter("base_frame", "base_link", "frame of the rear axle"))
        self._map = plain_frame(get_parameter("map_frame", "map", "frame of the raceline"))
        pose = get_parameter("pose_source", "odom", "odom or pose, drawn without guidance")
        rate = get_parameter("rate", 20.0, "highest rate of markers [Hz]")
        trail = get_parameter("trail_length", 15.0, "length of the driven trail [m]")
        self._error = get_parameter("trail_error", 0.2, "lateral error at full color [m]")
        for name, value in (("rate", rate), ("trail_error", self._error)):
            if not 0.0 < value < math.inf:
                raise ParameterError(f"~{name}: expected a positive number, got {value}")
        if pose not in ("odom", "pose"):
            raise ParameterError(f"~pose_source: expected odom or pose, got {pose!r}")
        if not 0.0 <= trail <= 1000.0:
            raise ParameterError(f"~trail_length: expected 0 to 1000 m, got {trail}")
        self._period_ns = int(1e9 / rate)
        self._size = vehicle.length, vehicle.width, 0.5 * vehicle.width
        self._l_wb = vehicle.l_wb
        self._trail_length = trail
        self._trail = deque()
        # Each topic has its own thread.
        self._coloring, self._drawing = threading.Lock(), threading.Lock()
        self._tracker = self._shown = self._driven = None
        self._guided_ns = -_UNGUIDED_NS
        self._belief = None
        self._restart()
        self._markers = rospy.Publisher("lookahead_markers", MarkerArray, queue_size=2)
        self._point = rospy.Publisher("lookahead_point", Marker, queue_size=2)
        self._course = rospy.Publisher("course_markers", MarkerArray, queue_size=2, latch=True)
        self._raceline = RacelineSubscriber(self._draw_raceline)
        rospy.Subscriber(
            "driven_waypoints", waypoint_array_class()[0], self._receive_driven, queue_size=1
        )
        rospy.Subscriber(BELIEF_TOPIC, Belief, self._receive_belief, queue_size=1)
        rospy.Subscriber("guidance", Guidance, self._receive, queue_size=10, tcp_nodelay=True)
        kind, of = (Odometry, "pose.pose") if pose == "odom" else (PoseStamped, "pose")
        pose_of = attrgetter(of)
        rospy.Subscriber(pose, kind, self._receive_pose, pose_of, queue_size=10, tcp_nodelay=True)

    def _restart(self):
        self._trail.clear()
        self._last_ns = self._drawn_ns = self._trail_ns = 0
        self._clear = True

    def _receive(self, guidance):
        at = guidance.x + guidance.y + guidance.lookahead_x + guidance.lookahead_y
        if not math.isfinite(at + guidance.d + guidance.eta + guidance.steering_angle):
            return
        with self._drawing:
            self._draw_guidance(guidance)

    def _draw_guidance(self, guidance):
        self._guided_ns = stamp = guidance.header.stamp.to_nsec()
        if not self._is_due(stamp, guidance.x, guidance.y, guidance.d):
            return
        frame = guidance.header.frame_id
        point = _lookahead_point(guidance, frame)
        if self._point.get_num_connections():
            self._point.publish(point)
        if self._markers.get_num_connections():
            self._draw([point, *self._drawn(guidance, frame)], stamp, frame)

    def _receive_belief(self, belief):
        self._belief = belief

    def _receive_pose(self, message, pose_of):
        stamp = stamp_ns(message.header, rospy.Time.now().to_nsec())
        if self._tracker is None or abs(stamp - self._guided_ns) < _UNGUIDED_NS:
            return
        x, y, psi = plane_pose(pose_of(message))
        if not math.isfinite(x + y + psi):
            return
        with self._drawing:
            deviation = self._tracker.update(x, y, psi).d
            if self._is_due(stamp, x, y, deviation) and self._markers.get_num_connections():
                frame = plain_frame(message.header.frame_id) or self._map
                self._draw([self._drawn_car()], stamp, frame)

    def _is_due(self, stamp, x, y, deviation):
        """Extend the trail, and return whether markers are due."""
        if stamp < self._last_ns:
            self._restart()
        self._last_ns = stamp
        self._extend_trail(x, y, deviation)
        if stamp < self._drawn_ns + self._period_ns:
            return False
        self._drawn_ns = stamp
        return True

    def _draw(self, markers, stamp, frame):
        if self._clear:
            self._markers.publish(delete_all())
            self._clear = False
        # The trail changes slowly and is by far the largest marker.
        if stamp >= self._trail_ns + 2 * self._period_ns and len(self._trail) > 1:
            self._trail_ns = stamp
            markers.append(self._drawn_trail(frame))
        self._markers.publish(MarkerArray(markers))

    def _draw_raceline(self, raceline):
        self._tracker = RacelineTracker(raceline)
        self._shown = raceline
        self._color_course()

    def _receive_driven(self, message):
        s = np.array([waypoint.s_m for waypoint in message.wpnts])
        v = np.array([waypoint.vx_mps for waypoint in message.wpnts])
        if s.size < 2 or not np.all(np.isfinite(s + v)) or np.any(np.diff(s) <= 0.0):
            return
        self._driven = s, v
        self._color_course()

    def _color_course(self):
        """Draw the raceline, colored by the planned speeds, or by its own if these are unknown."""
        with self._coloring:
            raceline, speed = self._shown, None
            if raceline is None:
                return
            if self._driven is not None:
                s, v = self._driven
                length = s[-1] + s[1] - s[0]
                # The controller may still be following another raceline.
                if abs(length - raceline.length) < _SAME_LENGTH * raceline.length:

                    def speed(at):
                        return np.interp(at, s, v, period=length)

            rows = waypoint_rows(raceline, speed=speed)
            self._course.publish(raceline_markers(raceline, rows, self._map))

    def _extend_trail(self, x, y, deviation):
        driven = 0.0
        if self._trail:
            last_x, last_y, _, driven = self._trail[-1]
            moved = math.hypot(x - last_x, y - last_y)
            if moved < _TRAIL_STEP:
                return
            if moved > _TRAIL_JUMP:
                self._trail.clear()
            driven += moved
        self._trail.append((x, y, abs(deviation), driven))
        while driven - self._trail[0][3] > self._trail_length:
            self._trail.popleft()

    def _drawn(self, guidance, frame):
        """Markers of one guidance message."""
        x, y, distance = guidance.x, guidance.y, guidance.lookahead_distance
        around = ((x + distance * math.cos(a), y + distance * math.sin(a)) for a in _CIRCLE)
        arc = arc_to(x, y, guidance.lookahead_x, guidance.lookahead_y, guidance.eta)
        arc_color = LABEL_COLOR if guidance.saturated else ARC_COLOR
        yield _line("distance", frame, CIRCLE_COLOR, 0.02, points_of(around, 0.02))
        yield _line("arc", frame, arc_color, 0.05, points_of(arc, 0.04))
        yield self._drawn_steering(guidance.steering_angle)
        yield self._drawn_car()
        # Beside the circle the label hides nothing.
        size, text = (0.0, 0.0, 0.3), _label(guidance, self._belief)
        label = _marker(Marker.TEXT_VIEW_FACING, "label", frame, LABEL_COLOR, size)
        _place(label, x, y + distance + 0.3, 0.3)
        label.text = text
        if not text:
            label.action = Marker.DELETE
        yield label

    def _drawn_steering(self, angle):
        arrow = _marker(Marker.ARROW, "steering", self._base, STEERING_COLOR, (0.6, 0.05, 0.05))
        arrow.frame_locked = True
        _place(arrow, self._l_wb, 0.0, self._size[2])
        q = arrow.pose.orientation
        q.z, q.w = math.sin(0.5 * angle), math.cos(0.5 * angle)
        return arrow

    def _drawn_car(self):
        car = _marker(Marker.CUBE, "car", self._base, CAR_COLOR, self._size)
        car.frame_locked = True
        _place(car, 0.5 * self._l_wb, 0.0, 0.5 * self._size[2])
        return car

    def _drawn_trail(self, frame):
        points = points_of((x, y) for x, y, _, _ in self._trail)
        # Wider than the raceline and beneath it, so that both are visible where they coincide.
        trail = _line("trail", frame, CAR_COLOR, 0.14, points, _TRAIL_LIFETIME)
        trail.colors = [error_color(error / self._error) for _, _, error, _ in self._trail]
        return trail


def _marker(kind, namespace, frame, color, scale, lifetime=_LIFETIME):
    return make_marker(kind, namespace, frame, color, scale=scale, lifetime=lifetime)


def _line(namespace, frame, color, width, points, lifetime=_LIFETIME):
    line = _marker(Marker.LINE_STRIP, namespace, frame, color, (width, 0.0, 0.0), lifetime)
    line.points = points
    return line


def _place(marker, x, y, z):
    at = marker.pose.position
    at.x, at.y, at.z = x, y, z


def _lookahead_point(guidance, frame):
    point = _marker(Marker.SPHERE, "lookahead", frame, LOOKAHEAD_COLOR, (0.15, 0.15, 0.15))
    # Above the steering arrow, which often points at it.
    _place(point, guidance.lookahead_x, guidance.lookahead_y, 0.3)
    return point


def _label(guidance, belief):
    """Text saying why the car does not drive or what exceeds the grip, and the believed grip."""
    lines = []
    if guidance.mode != Guidance.MODE_DRIVING:
        lines.append(guidance.mode + (f": {guidance.reason}" if guidance.reason else ""))
    elif guidance.saturated:
        lines.append(f"{abs(guidance.a_lat):.1f} of {guidance.a_lat_max:.1f} m/s2")
    if belief is not None:
        age = (guidance.header.stamp - belief.header.stamp).to_sec()
        if abs(age) < _LIFETIME and all(map(math.isfinite, _grip(belief))):
            lines.append("grip {:.2f}, friction {:.2f} to {:.2f}".format(*_grip(belief)))
    return "\n".join(lines)


def _grip(belief):
    return belief.grip, belief.friction_low, belief.friction_high


def main():
    """Run the node."""
    run("lookahead_visualizer", LookaheadVisualizer)
