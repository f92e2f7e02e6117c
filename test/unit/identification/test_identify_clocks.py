"""Stamps of two computers in the recording used for identification."""

import struct

import numpy as np
import pytest
from rosbags.rosbag1 import Writer

from map_racing.bags.opening import open_bag
from map_racing.errors import IdentificationError
from map_racing.identification.channels import load_channel_map
from map_racing.identification.clock_checks import onsets_of_speed
from map_racing.identification.data import Run, Signal, load_run
from map_racing.identification.identify import identify

POSE, IMU = "/car_state/odom", "/vesc/sensors/imu/raw"
DRIVE = "/vesc/high_level/ackermann_cmd_mux/input/nav_1"


@pytest.fixture
def shifted(ramps, tmp_path):
    """``shifted(topics, seconds, receipts)``: the ramps with stamps of another computer's clock."""

    def make(topics, seconds, receipts=False):
        shift = int(seconds * 1e9)
        with open_bag(ramps.path) as bag, Writer(tmp_path / "a.bag") as writer:
            known = {
                number: writer.add_connection(
                    *(c.topic, c.type.replace("/", "/msg/")),
                    **{"msgdef": c.definition, "md5sum": c.md5sum},
                )
                for number, c in bag.connections.items()
            }
            messages = []
            for connection, t, data in bag.messages():
                if bag.connections[connection].topic in topics:
                    data = bytearray(data)
                    s, ns = struct.unpack_from("<II", data, 4)
                    struct.pack_into("<II", data, 4, *divmod(s * 10**9 + ns + shift, 10**9))
                    t += shift if receipts else 0
                messages.append((t, connection, bytes(data)))
            for t, connection, data in sorted(messages, key=lambda message: message[0]):
                writer.write(known[connection], t, data)
        return load_run(tmp_path / "a.bag")

    return make


@pytest.fixture(scope="module")
def right(ramps):
    """Stiffnesses from the unchanged recording."""
    return stiffness(identify([ramps.run], ramps.base))


def stiffness(found):
    return [axle.pacejka.parameters["stiffness_n_per_rad"].value for axle in found.axles.values()]


@pytest.mark.once
@pytest.mark.parametrize(
    ("topics", "seconds"),
    [
        ((POSE,), -1.0),
        *(
            pytest.param(*given, marks=pytest.mark.once)
            for given in (((POSE,), 0.3), ((DRIVE,), -0.3), ((IMU,), 1.0), ((IMU,), -0.1))
        ),
    ],
)
def test_they_are_found_said_and_repaired(ramps, right, shifted, topics, seconds):
    expected = right
    run = shifted(topics, seconds)
    assert any("the stamps are from another clock" in note for note in run.notes)
    assert stiffness(identify([run], ramps.base)) == pytest.approx(expected, rel=0.02)


@pytest.mark.rest_once
@pytest.mark.parametrize("seconds", [-0.3, 0.1, 1.0])
def test_where_no_receipt_tells_them_they_are_refused(ramps, shifted, seconds):
    """A bag rewritten with stamps as times of receipt."""
    run = shifted((POSE,), seconds, receipts=True)
    side = "earlier" if seconds > 0.0 else "later"
    with pytest.raises(IdentificationError, match=f"yaw rate comes .* s {side} than the poses"):
        identify([run], ramps.base, fix=True)


@pytest.mark.once
@pytest.mark.parametrize("seconds", [-0.3, pytest.param(-0.2, marks=pytest.mark.once)])
def test_late_commands_of_ramps_are_told_by_the_steps_of_the_speed(ramps, right, shifted, seconds):
    """Steering ramps are so smooth that a shift just looks like different tires."""
    run = shifted((DRIVE,), seconds, receipts=True)
    wrong = identify([run], ramps.base)
    (said,) = [finding.text for finding in wrong.findings if finding.contradiction]
    assert f"the speed begins to change {0.08 - seconds:.2f} s after 3 steps" in said
    assert stiffness(wrong)[0] < 0.95 * right[0]
    mended = identify([run], ramps.base, fix=True)
    assert stiffness(mended) == pytest.approx(right, rel=0.02)


@pytest.mark.once
@pytest.mark.parametrize("seconds", [0.2, 0.3])
def test_a_speed_that_changes_before_its_commands_is_refused(ramps, shifted, seconds):
    run = shifted((DRIVE,), seconds, receipts=True)
    with pytest.raises(IdentificationError, match=f"{seconds - 0.08:.2f} s before 3 steps of its"):
        identify([run], ramps.base, fix=True)


def test_the_speed_of_a_real_car_begins_to_change_soon(shared_data):
    for name in ("circles_055502", "circles_061435", "circles_061548"):
        path = shared_data / "tyre_id" / name / "cmd.csv"
        onsets = onsets_of_speed(load_run(path, load_channel_map("circles_log")))
        assert len(onsets) == 6 and np.median(onsets) == pytest.approx(0.06, abs=0.02)


@pytest.mark.rest_once
@pytest.mark.parametrize("seconds", [-1.0, 1.0, 2.0])
def test_commands_whose_receipts_are_shifted_too_are_refused(ramps, shifted, seconds):
    run = shifted((DRIVE,), seconds, receipts=True)
    side = "before" if seconds > 0.0 else "after"
    with pytest.raises(IdentificationError, match=f"the car turns .* s {side} its steering"):
        identify([run], ramps.base, fix=True)


def test_a_step_after_a_pause_of_the_commands_tells_no_onset():
    """A command that was not repeated may not have been held: a multiplexer stops the car."""
    t = np.arange(0.0, 10.0, 0.02)
    signals = {
        "speed_command": Signal(np.array([0.0, 5.0, 5.5]), np.array([1.0, 2.0, 2.0])),
        "v_x": Signal(t, np.where(t < 5.05, 1.0, 2.0)),
    }
    assert onsets_of_speed(Run("pause", signals)) == []
