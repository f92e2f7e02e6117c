"""Writes simulated driving to a bag like that of a real car."""

from __future__ import annotations

from pathlib import Path
from typing import Iterable

from ..bags.samples import SIMULATED_NS
from ..bags.writer import BagWriter
from ..control.decision import state_level, state_text
from ..track.files.waypoints import waypoint_rows
from ..track.raceline import Raceline
from .car import Sample
from .race import RaceLog

__all__ = ["GROUND_TRUTH_TOPIC", "write_race_bag", "write_ramp_bag"]

GROUND_TRUTH_TOPIC = "/ground_truth/odom"


def write_race_bag(
    path: str | Path,
    log: RaceLog,
    raceline: Raceline,
    compression: str | None = "lz4",
    settings: str = "",
) -> None:
    """Write a race to a ROS 1 bag.

    Localization is on ``/car_state/odom``, ``/car_state/pose`` and ``/tf``, with the time of
    measurement as timestamp and the arrival as receipt time. Commands are on the drive topic, the
    IMU on ``/vesc/sensors/imu/raw``, the raceline on ``/global_waypoints``, the true motion on
    ``/ground_truth/odom``, the settings on ``/map_racing/settings``, the belief of an adaptive
    controller on ``/map_racing/belief``, and states of the supervisor on ``/diagnostics``.

    Parameters
    ----------
    path : str or pathlib.Path
        An existing file is replaced once the bag is complete.
    log : RaceLog
    raceline : Raceline
    compression : {"lz4", "bz2", None}, optional
    settings : str, optional
        Settings of the controller, see `map_racing.control.settings`.

    Raises
    ------
    BagError
        If the file cannot be written.
    """
    with BagWriter(path, compression=compression) as bag:
        bag.waypoints(SIMULATED_NS, waypoint_rows(raceline))
        if settings:
            bag.text(SIMULATED_NS, settings)
        for sample in log.samples:
            stamp, arrival = _measured(bag, sample, pose=True)
            bag.odometry(stamp, *sample.true[1:], topic=GROUND_TRUTH_TOPIC, received=arrival)
            if sample.belief is not None:
                bag.belief(stamp, sample.belief, received=arrival)
            if not log.commands:
                _command(bag, sample.arrival, sample.result)
        said = ""
        for t, decision in log.commands:
            _command(bag, t, decision)
            now = decision.mode, decision.reason
            state = state_text(*now)
            if state != said:
                bag.state(_time(t), state, state_level(*now))
            said = state


def write_ramp_bag(
    path: str | Path, samples: Iterable[Sample], compression: str | None = "lz4"
) -> None:
    """Write steering ramps to a ROS 1 bag: odometry, IMU and commands as in `write_race_bag`."""
    with BagWriter(path, compression=compression) as bag:
        for sample in samples:
            _measured(bag, sample, pose=False)
            _command(bag, sample.arrival, sample.result)


def _measured(bag, sample, pose):
    """Write the measurements of a sample; return their timestamp and receipt time [ns]."""
    seen = sample.measured
    stamp, arrival = _time(seen.t), _time(sample.arrival)
    bag.odometry(stamp, *seen[1:], received=arrival)
    if pose:
        bag.pose(stamp, seen.x, seen.y, seen.psi, received=arrival)
        bag.transform(stamp, seen.x, seen.y, seen.psi, received=arrival)
    bag.imu(stamp, *sample.acceleration, seen.r, received=arrival)
    return stamp, arrival


def _command(bag, t, command):
    bag.drive(_time(t), command.steering_angle, command.speed)


def _time(t):
    return SIMULATED_NS + round(t * 1e9)
