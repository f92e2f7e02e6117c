"""A copy for replay has the times that the evaluation uses, whatever stamps the bag has."""

import numpy as np
import pytest

from map_racing.bags.reader import read_recording
from map_racing.bags.records import BagFile
from map_racing.bags.restamped import write_restamped
from map_racing.bags.writer import BagWriter, copy_bag
from map_racing.errors import BagError
from map_racing.evaluation.runs import evaluate
from map_racing.track.files.waypoints import waypoint_rows

T0 = 1600000000 * 10**9

# Stamps of pose and command [ns] by their time, and the delay of their receipt.
STAMPS = {
    "whole seconds": (lambda t: t - t % 10**9, lambda t: t - t % 10**9),
    "both 0": (lambda t: 0, lambda t: 0),
    "pose 0": (lambda t: 0, lambda t: t),
    "command 0": (lambda t: t, lambda t: 0),
    "every tenth pose 0": (lambda t: 0 if t // 25000000 % 10 == 3 else t, lambda t: t),
    "command a year early": (lambda t: t, lambda t: t - 3 * 10**16),
    "command a second late": (lambda t: t, lambda t: t + 10**9),
    "whole seconds at the start": (lambda t: t - (t < T0 + 3 * 10**9) * (t % 10**9), lambda t: t),
    "pose set ahead": (lambda t: t + (t > T0 + 3 * 10**9) * 5 * 10**9, lambda t: t),
    "pose set back": (lambda t: t - (t > T0 + 3 * 10**9) * 5 * 10**9, lambda t: t),
}


def bag_of(path, track, pose_stamp, command_stamp):
    line = track.raceline(speed=5.0, walls=1.0)
    with BagWriter(path, "lz4") as bag:
        bag.waypoints(T0, waypoint_rows(line), received=T0)
        for i in range(int(2.2 * track.length / 5.0 * 40.0)):
            t = T0 + i * 25000000
            x, y, psi = (float(value) for value in track.place(5.0 * 0.025 * i - 3.0, 0.1))
            bag.odometry(pose_stamp(t), x, y, psi, 5.0, 0.1, 0.2, received=t + 3000001)
            bag.drive(command_stamp(t), 0.05, 4.0 + 0.01 * (i % 7), received=t + 7000003)
    return path


@pytest.mark.rest_once
@pytest.mark.parametrize("stamps", STAMPS)
def test_the_copy_evaluates_as_the_bag(tmp_path, track, stamps):
    bag = bag_of(tmp_path / "run.bag", track, *STAMPS[stamps])
    copy = tmp_path / "copy.bag"
    assert write_restamped(bag, copy)
    before, after = read_recording(bag), read_recording(copy)
    assert before.t0_ns == after.t0_ns
    np.testing.assert_array_equal(before.t, after.t)
    np.testing.assert_array_equal(before.commands.t, after.commands.t)
    line = track.raceline(speed=5.0, walls=1.0)
    one, other = (evaluate(recording, line) for recording in (before, after))
    assert [lap.row() for lap in one.laps if lap.valid] == [
        lap.row() for lap in other.laps if lap.valid
    ]
    assert one.summary.laps_completed == 2
    # Everything else is unchanged, and there are no more notes about stamps.
    with BagFile(bag) as a, BagFile(copy) as b:
        assert sorted(a.connections.values()) == sorted(b.connections.values())
        assert [m.data[12:] for m in a.messages()] == [m.data[12:] for m in b.messages()]
    assert not any("stamp" in note for note in after.notes)
    assert not write_restamped(copy, tmp_path / "again.bag")


def test_transforms_are_copied_as_they_are(tmp_path):
    """Their stamps are at another place in the message."""
    with BagWriter(tmp_path / "run.bag") as bag:
        for i in range(400):
            t = T0 + i * 25000000
            bag.transform(t - t % 10**9, 0.1 * i, 0.0, 0.0, received=t)
            bag.drive(0, 0.05, 4.0, received=t)
    assert write_restamped(tmp_path / "run.bag", tmp_path / "copy.bag")
    with BagFile(tmp_path / "run.bag") as a, BagFile(tmp_path / "copy.bag") as b:
        transforms = [{m.data for m in bag.messages({0})} for bag in (a, b)]
    assert transforms[0] == transforms[1] and len(transforms[0]) == 400


def test_a_node_that_connected_twice_and_messages_of_a_lost_connection(tmp_path, track):
    bag = bag_of(tmp_path / "run.bag", track, *STAMPS["pose 0"])

    class Twice(BagFile):
        """Every other pose comes from a second connection of the same node, waypoints from an
        unknown one."""

        def messages(self, wanted=None):
            self.connections[7] = self.connections[1]
            for i, message in enumerate(super().messages()):
                number = {0: 9, 1: (1, 7)[i % 2], 2: 2}[message.connection]
                yield message._replace(connection=number)

    with Twice(bag) as twice:
        copy_bag(twice, tmp_path / "copy.bag", lambda place, message: message.data)
    with BagFile(bag) as a, BagFile(tmp_path / "copy.bag") as b:
        assert [m.data for m in a.messages({1, 2})] == [m.data for m in b.messages()]
        assert len(b.connections) == 2


def test_good_stamps_are_left_alone(tmp_path, race_bag):
    assert not write_restamped(race_bag(), tmp_path / "copy.bag")
    assert not (tmp_path / "copy.bag").exists()


def test_another_file_is_refused(tmp_path):
    (tmp_path / "text.bag").write_text("no bag")
    with pytest.raises(BagError, match=r"text\.bag: expected a ROS 1 bag"):
        write_restamped(tmp_path / "text.bag", tmp_path / "copy.bag")
