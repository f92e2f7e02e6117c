"""Simulated driving as the bag that a real car would have recorded."""

from ..bags.writer import BagWriter
from ..track.files.waypoints import waypoint_rows

__all__ = ["GROUND_TRUTH_TOPIC", "write_race_bag", "write_ramp_bag"]

GROUND_TRUTH_TOPIC = "/ground_truth/odom"

# Stamps count from here [ns]: a fixed date, so that the same race gives the same file.
EPOCH_NS = 1_700_000_000_000_000_000


def write_race_bag(path, log, raceline, compression="lz4"):
    """Write a race to a ROS 1 bag.

    What localization reported is on ``/car_state/odom``, ``/car_state/pose`` and ``/tf``, with the
    time at which it held as stamp and the time at which it arrived as time of the record; commands
    are on the drive topic, the IMU on ``/vesc/sensors/imu/raw``, the raceline on
    ``/global_waypoints``, and what only a simulator knows, the true motion, on
    ``/ground_truth/odom``.

    Parameters
    ----------
    path : str or pathlib.Path
        Replaced in one step when the bag is complete.
    log : RaceLog
    raceline : Raceline
    compression : {"lz4", "bz2", None}, optional

    Raises
    ------
    BagError
        If the file cannot be written.
    """
    with BagWriter(path, compression=compression) as bag:
        bag.waypoints(EPOCH_NS, waypoint_rows(raceline))
        for sample in log.samples:
            true, seen = sample.true, sample.measured
            stamp = EPOCH_NS + round(seen.t * 1e9)
            arrival = EPOCH_NS + round(sample.arrival * 1e9)
            bag.odometry(stamp, *seen[1:], received=arrival)
            bag.pose(stamp, seen.x, seen.y, seen.psi, received=arrival)
            bag.transform(stamp, seen.x, seen.y, seen.psi, received=arrival)
            bag.imu(stamp, *sample.acceleration, seen.r, received=arrival)
            bag.odometry(stamp, *true[1:], topic=GROUND_TRUTH_TOPIC, received=arrival)
            bag.drive(arrival, sample.result.steering_angle, sample.result.speed)


def write_ramp_bag(path, samples, compression="lz4"):
    """Write a drive as the bag that the car would have recorded.

    Odometry is on ``/car_state/odom``, the IMU on ``/vesc/sensors/imu/raw``, both stamped with the
    time at which they hold; commands are on the drive topic, stamped when they were given.

    Parameters
    ----------
    path : str or pathlib.Path
    samples : iterable of RampSample
    compression : {"lz4", "bz2", None}, optional

    Raises
    ------
    BagError
        If the file cannot be written.
    """
    with BagWriter(path, compression=compression) as bag:
        for sample in samples:
            seen = sample.measured
            stamp = EPOCH_NS + round(seen.t * 1e9)
            arrival = EPOCH_NS + round(sample.arrival * 1e9)
            bag.odometry(stamp, *seen[1:], received=arrival)
            bag.imu(stamp, *sample.acceleration, seen.r, received=arrival)
            bag.drive(arrival, sample.command.steering_angle, sample.command.speed)
