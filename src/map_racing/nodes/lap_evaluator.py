"""Node ``lap_evaluator``: laps of live or replayed driving, same as from its recording."""

import math
import queue
import threading
import time

import rospy
from ackermann_msgs.msg import AckermannDriveStamped
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
from visualization_msgs.msg import Marker, MarkerArray

from map_racing.msg import Belief, LapResult

from ..bags.messages import BELIEF_FIELDS
from ..bags.samples import child_warning
from ..bags.series import FrameChoice, followed
from ..bags.topics import BELIEF_TOPIC
from ..errors import MapRacingError, ParameterError
from ..evaluation.doubts import frame_warning
from ..evaluation.lap_limits import LapLimits
from ..evaluation.lap_log import LapLog
from ..evaluation.live import LiveEvaluation
from ..evaluation.report import lap_table
from ..track.files.load import load_raceline
from .conversions import frame, heading, stamp_ns, to_time
from .markers import delete_all, lap_text_place, make_marker
from .node import FirstSender, get_parameter, run, why_silent
from .waypoints import RacelineSubscriber

__all__ = ["LapEvaluatorNode", "main"]

_STOP = object()
_SILENCE_S = 5.0  # warn after this time without poses
_SUMMARY_S = 5.0  # longest wait of a shutdown for the final summary
# A shutdown ends after this many polls without a new message, at this interval [s], and after this
# time in any case [s]. Polls are counted, because time also passes while a busy computer keeps this
# process from reading.
_LOOKS, _REST_S, _LAST_MESSAGES_S = 15, 0.02, 6.0
_NAN = math.nan
LAP_TEXT_COLOR = (1.0, 1.0, 1.0)


class LapEvaluatorNode:
    """Queues messages, evaluates them in one thread and publishes the laps.

    Callbacks only enqueue, so that no message is lost however fast a bag is played.
    """

    def __init__(self):
        source = get_parameter("raceline", "", "raceline file; empty: topic global_waypoints")
        pose = get_parameter("pose_source", "odom", "odom or pose")
        start_s = get_parameter("start_line", 0.0, "arc length of the start line [m]")
        car_width = get_parameter("car_width", 0.3, "width of the car [m]")
        sectors = get_parameter("sectors", 3, "number of sectors")
        deviation = get_parameter("max_deviation", 0.0, "off track beyond [m]; 0: walls, or 2 m")
        stop = get_parameter("max_stop", LapLimits().max_stop, "longest stop in a lap [s]")
        braking = get_parameter(
            "max_deceleration", LapLimits().max_deceleration, "more is a collision [m/s^2]"
        )
        patience = get_parameter("patience", 1.0, "longest wait for a drive command [s]")
        csv = get_parameter("csv", "", "file that laps are appended to; empty: none")
        self._text_size = get_parameter(
            "text_size", 0.0, "height of the lap text [m]; 0: as fits the track"
        )
        if pose not in ("odom", "pose"):
            raise ParameterError(f"~pose_source: expected odom or pose, got {pose!r}")
        for name, value in (("max_deviation", deviation), ("text_size", self._text_size)):
            if not 0.0 <= value < math.inf:
                raise ParameterError(f"~{name}: expected 0 m or more, got {value}")
        for name, value in (("max_stop", stop), ("max_deceleration", braking)):
            if not value > 0.0:
                raise ParameterError(f"~{name}: expected more than 0, got {value}")

        self._queue, self._arrived = queue.SimpleQueue(), -math.inf
        self._frames, self._frame = FrameChoice(), "map"
        self._best, self._counted = _NAN, 0
        self._laps = LiveEvaluation(
            load_raceline(source) if source else None,
            patience=patience,
            on_lap=self._publish,
            on_run=self._summarize,
            limits=LapLimits(
                max_deviation=deviation or None, max_stop=stop, max_deceleration=braking
            ),
            start_s=start_s,
            car_width=car_width,
            sectors=sectors,
            pose_topic=rospy.resolve_name(pose),
            drive_topic=rospy.resolve_name("drive"),
        )
        self._log = LapLog(csv, sectors) if csv else None
        self._results = rospy.Publisher("lap_result", LapResult, queue_size=100, latch=True)
        self._markers = rospy.Publisher("lap_markers", MarkerArray, queue_size=10, latch=True)
        self._markers.publish(delete_all())
        self._listen(source, pose)

    def _listen(self, source, pose):
        """Subscribe; from now on callbacks enqueue messages."""
        self._idle = threading.Event()
        self._idle.set()
        rospy.on_shutdown(self._stop)
        if not source:
            self._raceline_topic = RacelineSubscriber(
                lambda raceline: self._put(self._set_raceline, raceline)
            )
        sender = FirstSender(rospy.resolve_name("drive"), self._queue_doubt)
        self._subscribe("drive", AckermannDriveStamped, self._add_command, sender.sent)
        self._subscribe(BELIEF_TOPIC, Belief, self._add_belief)
        kind, add = (
            (Odometry, self._add_odometry) if pose == "odom" else (PoseStamped, self._add_pose)
        )
        self._pose_topic = rospy.resolve_name(pose), kind._type
        self._no_poses = f"no poses on {self._pose_topic[0]}"
        sender = FirstSender(self._pose_topic[0], self._queue_doubt)
        self._subscribe(pose, kind, add, sender.sent)

    def _subscribe(self, topic, kind, handle, counts=lambda _: True):
        # Without a queue size no message is dropped; the buffer holds many of them.
        rospy.Subscriber(
            topic,
            kind,
            lambda message: self._put(handle, message) if counts(message) else None,
            queue_size=None,
            buff_size=1 << 20,
            tcp_nodelay=True,
        )

    def _put(self, handle, message):
        self._arrived = time.monotonic()
        self._queue.put((handle, message, rospy.Time.now().to_nsec(), self._arrived))

    def run(self):
        """Evaluate until the node is shut down, then summarize."""
        self._idle.clear()
        try:
            self._evaluate()
            if self._no_poses:
                rospy.logwarn("%s: nothing was evaluated", self._no_poses)
            self._laps.finish()
        finally:
            self._idle.set()

    def _stop(self):
        """Let the last lap be published before rospy closes the topics.

        When a bag that is played fast ends, a busy computer has not yet read all messages.
        """
        end, looks, arrived = time.monotonic() + _LAST_MESSAGES_S, 0, self._arrived
        while looks < _LOOKS and time.monotonic() < end:
            time.sleep(_REST_S)
            looks = looks + 1 if arrived == self._arrived else 0
            arrived = self._arrived
        self._queue.put((_STOP, None, 0, 0.0))
        self._idle.wait(_SUMMARY_S)

    def _evaluate(self):
        received = 0.0
        while True:
            deadline = self._laps.deadline
            wait = None if deadline is None else max(deadline - time.monotonic(), 0.001)
            if self._no_poses:
                wait = min(wait or _SILENCE_S, _SILENCE_S)
            try:
                handle, message, received_ns, received = self._queue.get(timeout=wait)
                if handle is _STOP:
                    return
                handle(message, received_ns, received)
            except queue.Empty:
                if self._no_poses:
                    why = why_silent(*self._pose_topic)
                    rospy.logwarn_throttle(30.0, f"{self._no_poses} yet ({why})")
            if self._queue.empty():
                self._laps.advance(time.monotonic())
            elif self._queue.qsize() % 256 == 0:
                # Use receipt times: a late command within the patience may still be in the queue.
                self._laps.advance(received)

    # -- input ---------------------------------------------------------------------------------

    def _set_raceline(self, raceline, _received_ns, _received):
        first = self._laps.raceline is None
        try:
            self._laps.set_raceline(raceline)
        except MapRacingError as error:
            rospy.logerr_throttle(30.0, str(error))
            return
        name = raceline.name or raceline.source
        rospy.loginfo("%s %s, %.2f m", "raceline" if first else "now on", name, raceline.length)

    def _queue_doubt(self, text):
        self._put(lambda *_: self._laps.doubt(text), None)

    def _add_odometry(self, message, received_ns, received):
        velocity, topic = message.twist.twist.linear, self._pose_topic[0]
        doubt = child_warning(topic, frame(message.child_frame_id))
        if doubt:
            self._laps.doubt(doubt)
        self._add(message, message.pose.pose, (velocity.x, velocity.y), received_ns, received)

    def _add_pose(self, message, received_ns, received):
        self._add(message, message.pose, (_NAN, _NAN), received_ns, received)

    def _add_belief(self, message, received_ns, _received):
        values = [getattr(message, name) for name in BELIEF_FIELDS]
        self._laps.add_belief(stamp_ns(message.header, received_ns), values)

    def _add(self, message, pose, velocity, received_ns, received):
        self._no_poses = ""
        header, at = message.header, pose.position
        stamp = stamp_ns(header, received_ns)
        if not stamp:  # no timestamp, and nothing on /clock yet
            return
        if not self._in_frame(frame(header.frame_id) or "map", stamp):
            return
        if self._laps.raceline is None:
            rospy.logwarn_throttle(10.0, "poses received, but no raceline yet")
        psi = heading(pose.orientation)
        self._laps.add_pose(stamp, at.x, at.y, *velocity, received, received_ns - stamp, psi)

    def _in_frame(self, name, stamp):
        """Whether a pose is in the frame that is used; if that frame changes, a new run begins."""
        topic, before = self._pose_topic[0], self._frames.frame
        doubt = frame_warning(topic, name)
        counts, only = self._frames.counts(name, stamp), self._frames.frame
        if not counts:
            doubt = f"{topic}: messages in another frame, {name}, left out: only {only} counts"
        elif before not in (None, only):
            self._laps.finish()
            doubt = f"{topic}: {followed('messages', before, only)}"
        self._frame = only
        if doubt:
            rospy.logwarn_throttle(30.0, doubt)
            self._laps.doubt(doubt)
        return counts

    def _add_command(self, message, received_ns, _received):
        drive, stamp = message.drive, stamp_ns(message.header, received_ns)
        self._laps.add_command(stamp, drive.speed, drive.steering_angle, received_ns - stamp)
        offset = self._laps.command_offset_s
        if offset:
            rospy.logwarn_throttle(
                30.0, f"drive commands are from another clock, {offset:.3f} s behind: shifted"
            )

    # -- output --------------------------------------------------------------------------------

    def _publish(self, live_lap):
        lap = live_lap.lap
        if lap.valid:
            self._counted += 1
            self._best = min(lap.lap_time_s, self._best) if self._counted > 1 else lap.lap_time_s
        if self._log is not None:
            try:
                self._log.add(live_lap)
            except MapRacingError as error:
                rospy.logerr("%s", error)
        result = LapResult(**{n: v for n, v in lap.row().items() if not n.startswith("sector_")})
        result.sector_times_s = lap.sector_times_s
        result.warnings = "; ".join(live_lap.warnings)
        result.run = live_lap.run
        result.laps_completed, result.best_lap_time_s = self._counted, self._best
        result.header.stamp = to_time(live_lap.end_ns)
        result.header.frame_id = self._frame
        self._results.publish(result)
        text = _text(lap, self._best)
        if live_lap.warnings:
            rospy.logwarn("lap %d: %s", lap.lap, result.warnings)
            text += "\ndoubtful, see the log"
        self._markers.publish(MarkerArray([self._marker(text)]))
        rospy.loginfo("%s", text.replace("\n", ", "))

    def _marker(self, text):
        x, y, size = lap_text_place(self._laps.raceline, self._text_size)
        scale = (0.0, 0.0, size)
        marker = make_marker(
            Marker.TEXT_VIEW_FACING, "lap", self._frame, LAP_TEXT_COLOR, scale=scale
        )
        marker.text = text
        at = marker.pose.position
        at.x, at.y, at.z = x, y, size
        return marker

    def _summarize(self, run, result):
        self._best, self._counted = _NAN, 0
        rospy.loginfo("run %d\n%s", run, "\n".join([*result.notes, lap_table(result)]))


def _text(lap, best):
    if not lap.valid:
        return f"lap {lap.lap}: {lap.reason}"
    return (
        f"lap {lap.lap}: {lap.lap_time_s:.3f} s\nbest {best:.3f} s\n"
        f"RMS error {100.0 * lap.rms_lateral_error_m:.1f} cm"
    )


def main():
    """Run the node."""
    run("lap_evaluator", LapEvaluatorNode)
