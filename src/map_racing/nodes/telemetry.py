"""Guidance and figures of the control steps, for plots, RViz and records."""

import rospy
from std_msgs.msg import Float64

from map_racing.msg import Belief, Guidance, Tracking

from ..bags.topics import BELIEF_TOPIC
from ..control.controller import Status

__all__ = ["Telemetry"]

_UNGUIDED = (Status.INVALID_STATE, Status.NO_RACELINE)


def _publisher(topic, kind):
    return rospy.Publisher(topic, kind, queue_size=10)


class Telemetry:
    """Publishes guidance, figures and learned tires on the topics that have subscribers.

    Parameters
    ----------
    controller : Controller
    supervisor : Supervisor
    """

    def __init__(self, controller, supervisor):
        self._controller, self._supervisor = controller, supervisor
        self._guidance = _publisher("guidance", Guidance)
        self._tracking = _publisher("tracking", Tracking)
        self._belief = _publisher(BELIEF_TOPIC, Belief)
        self._numbers = {
            name: _publisher(name, Float64)
            for name in ("lateral_error", "speed_error", "latency", "pose_age")
        }

    def publish(self, header, state, result, decision, latency):
        """Publish what concerns one control step.

        Parameters
        ----------
        header : std_msgs.msg.Header
            Of the pose.
        state : CarState
        result : ControlResult
        decision : Decision
        latency : float
            Time that the step took [s].
        """
        numbers = {
            "lateral_error": lambda: self._controller.lateral_error(state, result),
            "speed_error": lambda: state.v_x - decision.speed,
            "latency": lambda: latency,
            "pose_age": lambda: self._supervisor.pose_age,
        }
        for name, value in numbers.items():
            if self._numbers[name].get_num_connections():
                self._numbers[name].publish(value())
        if self._tracking.get_num_connections():
            self._tracking.publish(
                header=header,
                **{name: value() for name, value in numbers.items()},
                speed=state.v_x,
                speed_command=decision.speed,
                steering_angle=decision.steering_angle,
                lateral_acceleration=state.v_x * state.r,
                lateral_acceleration_limit=self._controller.max_lateral_acceleration(state.v_x),
            )
        learned = self._controller.adaptation
        if learned is not None and self._belief.get_num_connections():
            self._belief.publish(header=header, **learned.belief._asdict())
        if self._guidance.get_num_connections() and result.status not in _UNGUIDED:
            self._publish_guidance(header, result, decision)

    def _publish_guidance(self, header, result, decision):
        guided = result.state
        self._guidance.publish(
            header=header,
            mode=decision.mode.value,
            reason=decision.reason.value,
            status=result.status.value,
            saturated=result.status is Status.SATURATED,
            x=guided.x,
            y=guided.y,
            psi=guided.psi,
            v_x=guided.v_x,
            v_y=guided.v_y,
            s=result.s,
            d=result.d,
            lookahead_x=result.lookahead_x,
            lookahead_y=result.lookahead_y,
            lookahead_distance=result.lookahead_distance,
            eta=result.eta,
            a_lat=result.a_lat,
            a_lat_max=self._controller.max_lateral_acceleration(guided.v_x),
            steering_angle=decision.steering_angle,
            speed=decision.speed,
        )
