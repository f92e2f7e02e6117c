"""Node ``second_publisher``: a second odometry on the same topic, shifted to the left.

The simulator starts it for the fault of that name, because a second publisher must be another node.
"""

import math

import rospy
from nav_msgs.msg import Odometry

from .conversions import heading
from .node import get_parameter, run

__all__ = ["SecondPublisher", "main"]


class SecondPublisher:
    """Repeats each odometry message of another node, shifted ``~aside`` meters to the left."""

    def __init__(self):
        self._aside = get_parameter("aside", 2.0, "distance to the left [m]")
        self._publisher = rospy.Publisher("odom", Odometry, queue_size=10)
        rospy.Subscriber("odom", Odometry, self._on_odometry, queue_size=10)

    def _on_odometry(self, message):
        if message._connection_header["callerid"] == rospy.get_name():
            return
        psi, position = heading(message.pose.pose.orientation), message.pose.pose.position
        position.x -= self._aside * math.sin(psi)
        position.y += self._aside * math.cos(psi)
        self._publisher.publish(message)


def main():
    """Run the node."""
    run("second_publisher", SecondPublisher)


if __name__ == "__main__":
    main()
