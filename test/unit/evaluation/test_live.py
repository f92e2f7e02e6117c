import csv
import itertools
import math
import resource
from dataclasses import fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.bags.samples import Commands, Recording
from map_racing.errors import FileFormatError, MapRacingError, ParameterError
from map_racing.evaluation import laps as laps_module
from map_racing.evaluation.lap_log import LapLog
from map_racing.evaluation.live import LiveEvaluation
from map_racing.evaluation.live_history import History
from map_racing.evaluation.runs import evaluate
from map_racing.track.findings import NOTE, WARNING, Finding

T0_NS = 1_600_000_000_123_456_789
V = 6.0
RATE = 40.0


class Taken:
    """The reports of a live evaluation."""

    def __init__(self, raceline=None, **options):
        self.laps, self.runs = [], []
        self.evaluation = LiveEvaluation(
            raceline,
            on_lap=self.laps.append,
            on_run=lambda number, result: self.runs.append((number, result)),
            **options,
        )

    def rows(self, run=1):
        return [lap.lap.row() for lap in self.laps if lap.run == run]


@pytest.fixture(scope="module")
def line(track):
    return track.raceline(speed=V, walls=1.0)


@pytest.fixture(scope="module")
def drive(track):
    """2.4 laps: a recording, and the same as messages; commands carry the pose's stamp."""
    n = int(2.4 * track.length / V * RATE)
    stamps = [T0_NS + int(round(i * 1e9 / RATE)) + 137 * (i % 7) for i in range(n)]
    s = V / RATE * np.arange(n) - 3.0
    x, y, psi = track.place(s, 0.1 + 0.05 * np.sin(0.7 * s))
    v_x, v_y = V + 0.3 * np.sin(s), 0.2 * np.cos(s)
    v_y[n // 2 :] = math.nan
    speed, steering = 6.1 + 0.2 * np.cos(s), 0.1 * np.sin(0.5 * s)
    t = (np.array(stamps) - stamps[0]) * 1e-9
    keep = slice(40, None)
    recording = Recording(
        *(t, x, y, psi, v_x, v_y, np.full(n, math.nan)),
        t0_ns=stamps[0],
        source="drive",
        commands=Commands(t[keep], steering[keep], speed[keep], "/drive"),
    )
    poses = list(zip(stamps, x.tolist(), y.tolist(), v_x.tolist(), v_y.tolist()))
    commands = list(zip(stamps, speed.tolist(), steering.tolist()))[keep]
    return recording, poses, commands


def same(rows, others):
    assert len(rows) == len(others)
    for row, other in zip(rows, others):
        assert list(row) == list(other)
        for name in row:
            one, two = row[name], other[name]
            assert one == two or (one != one and two != two), name


def play(taken, poses, commands, lag=0, received=0.0):
    """Messages in order of their stamps, a command `lag` steps after its pose."""
    commands = {command[0]: command for command in commands}
    pending = []
    for pose in poses:
        taken.evaluation.add_pose(*pose, received)
        if pose[0] in commands:
            pending.append(commands[pose[0]])
        if len(pending) > lag:
            taken.evaluation.add_command(*pending.pop(0))
        taken.evaluation.advance(received)
    for command in pending:
        taken.evaluation.add_command(*command)
    taken.evaluation.advance(received)


@pytest.mark.parametrize("lag", [0, 1, 9])
def test_live_laps_are_those_of_the_recording(line, drive, lag):
    recording, poses, commands = drive
    offline = evaluate(recording, line)
    assert [lap.valid for lap in offline.laps] == [False, True, True, False]
    taken = Taken(line)
    play(taken, poses, commands, lag)
    taken.evaluation.finish()
    same(taken.rows(), [lap.row() for lap in offline.laps])
    assert [(number, result.summary) for number, result in taken.runs] == [(1, offline.summary)]
    lap = taken.laps[1]
    assert abs(lap.end_ns - poses[0][0] - 1e9 * lap.lap.end_time_s) <= 1


def test_a_car_that_is_left_parked_fills_no_memory(line, drive, monkeypatch):
    """Its lap is cut, and so is a drive that never reaches the line, as in a recording."""
    monkeypatch.setattr(laps_module, "_MOST_SAMPLES", 500)
    recording, poses, commands = drive
    step = int(1e9 / RATE)
    at, still = len(poses) // 2, 2200

    def later(entry, more):
        return (entry[0] + more, *entry[1:])

    parked = [later(poses[at], step * i) for i in range(still)]
    moved = [later(pose, step * still) for pose in poses[at:]]
    told = [command for command in commands if command[0] < poses[at][0]]
    told += [(pose[0], 0.0, 0.0) for pose in parked]
    told += [later(c, step * still) for c in commands if c[0] >= poses[at][0]]
    driven, taken, most = [*poses[:at], *parked, *moved], Taken(line), 0
    for pose, command in zip(driven, [*[None] * (len(driven) - len(told)), *told]):
        taken.evaluation.add_pose(*pose, 0.0)
        if command:
            taken.evaluation.add_command(*command)
        taken.evaluation.advance(0.0)
        most = max(most, len(taken.evaluation._driven[0]))
    taken.evaluation.finish()
    stamps, x, y, v_x, v_y = map(np.array, zip(*driven))
    at, speed, steering = map(np.array, zip(*told))
    whole = Recording(
        *((stamps - stamps[0]) * 1e-9, x, y, np.full(x.size, math.nan), v_x, v_y),
        np.full(x.size, math.nan),
        t0_ns=int(stamps[0]),
        commands=Commands((at - stamps[0]) * 1e-9, steering, speed, "/drive"),
    )
    result = evaluate(whole, line)
    same(taken.rows(), [lap.row() for lap in result.laps])
    reasons = [lap.reason for lap in result.laps]
    assert sum("cut after 500 samples" in reason for reason in reasons) > 3
    assert reasons[0] == "out-lap" and result.laps[1].valid and most < 600
    assert result.laps[1].end_time_s == result.laps[2].start_time_s


@pytest.mark.once
@settings(deadline=None, max_examples=25)
@given(
    lags=st.lists(st.integers(-40, 40), min_size=5, max_size=5),
    advances=st.lists(st.booleans(), min_size=1, max_size=30),
)
def test_laps_do_not_depend_on_how_two_topics_are_mixed(track, drive, line, lags, advances):
    """Each topic keeps its order; commands come up to a second late or early."""
    recording, poses, commands = drive
    order = [(i, 0, pose) for i, pose in enumerate(poses)]
    due = np.maximum.accumulate([40 + i + lags[i // 50 % 5] for i in range(len(commands))])
    order += [(i, 1, command) for i, command in zip(due.tolist(), commands)]
    taken = Taken(line)
    advance = itertools.cycle(advances)
    for _, kind, message in sorted(order, key=lambda entry: entry[:2]):
        if kind:
            taken.evaluation.add_command(*message)
        else:
            taken.evaluation.add_pose(*message, 0.0)
        if next(advance) or kind:
            taken.evaluation.advance(0.0)
    taken.evaluation.finish()
    same(taken.rows(), [lap.row() for lap in evaluate(recording, line).laps])


def test_poses_wait_for_the_raceline(line, drive):
    recording, poses, commands = drive
    taken = Taken()
    half = len(poses) // 2
    play(taken, poses[:half], commands)
    assert taken.evaluation.deadline is None
    assert taken.laps == []
    taken.evaluation.set_raceline(line)
    play(taken, poses[half:], commands)
    taken.evaluation.finish()
    same(taken.rows(), [lap.row() for lap in evaluate(recording, line).laps])


def test_without_commands_a_pose_waits_no_longer_than_patience(line, drive):
    _, poses, _ = drive
    taken = Taken(line, patience=0.5)
    for pose in poses:
        taken.evaluation.add_pose(*pose, 7.0)
    assert taken.evaluation.deadline == 7.5
    taken.evaluation.advance(7.4)
    assert taken.laps == []
    taken.evaluation.advance(7.5)
    assert [lap.lap.lap for lap in taken.laps] == [0, 1, 2]
    assert taken.laps[1].lap.speed_reference == "raceline"
    assert taken.evaluation.deadline is None


def test_commands_that_come_too_late_are_told(line, drive):
    _, poses, commands = drive
    stalled = slice(len(poses) // 2, len(poses) // 2 + 4)
    taken = Taken(line, patience=0.5)
    play(taken, poses[: stalled.start], commands)
    for pose in poses[stalled]:
        taken.evaluation.add_pose(*pose, 7.0)
    taken.evaluation.advance(7.6)
    late = {pose[0] for pose in poses[stalled]}
    for command in commands:
        if command[0] in late:
            taken.evaluation.add_command(*command)
    play(taken, poses[stalled.stop :], commands)
    taken.evaluation.finish()
    said = [any("more than 0.5 s after" in text for text in lap.warnings) for lap in taken.laps]
    assert said == [False, False, True, False]


@pytest.mark.once
@pytest.mark.parametrize("lap", [1, 2])
def test_late_commands_of_a_lap_that_lasts_are_kept_in_a_few_numbers(track, line, lap):
    """The car stands in it for a while, with every command too late; other laps have no late
    ones."""
    per_lap, stands = int(track.length / V * RATE), 200
    s = V / RATE * np.arange(4 * per_lap) - 1.0
    at = (lap - 1) * per_lap + 40
    s = np.concatenate((s[:at], np.full(stands, s[at]), s[at:]))
    stamps = [T0_NS + int(round(i * 1e9 / RATE)) for i in range(s.size)]
    x, y, _ = track.place(s, np.zeros(s.size))
    poses = list(zip(stamps, x.tolist(), y.tolist(), [V] * s.size, [0.0] * s.size))
    commands = [(stamp, 6.0, 0.1) for stamp in stamps]
    taken = Taken(line)
    play(taken, poses[:at], commands)
    sizes = []
    for pose, command in zip(poses[at : at + stands], commands[at : at + stands]):
        taken.evaluation.add_pose(*pose, 0.0)
        taken.evaluation.advance(2.0)
        taken.evaluation.add_command(*command)
        sizes.append(len(taken.evaluation._late))
    assert max(sizes) == 2
    play(taken, poses[at + stands :], commands)
    taken.evaluation.finish()
    said = [any("after their poses" in text for text in told.warnings) for told in taken.laps]
    assert said == [number == lap for number in range(5)]


def test_a_pose_that_answers_a_stop_is_not_late(line, drive):
    """Commands of a stop without poses have later stamps than the first one that answers a pose."""
    _, poses, commands = drive
    stop, resumed = len(poses) // 2, len(poses) // 2 + 20
    taken = Taken(line)
    play(taken, poses[:stop], commands)
    for stamp, *_ in poses[stop + 4 : resumed + 1]:
        taken.evaluation.add_command(stamp + 10**6, 0.0, 0.1)
    taken.evaluation.add_pose(*poses[resumed], 0.0)
    taken.evaluation.advance(0.0)
    taken.evaluation.add_command(poses[resumed][0], 6.0, 0.1)
    play(taken, poses[resumed + 1 :], commands)
    taken.evaluation.finish()
    assert not any("after their poses" in text for lap in taken.laps for text in lap.warnings)


@pytest.mark.parametrize("early", [0, 5])
def test_a_step_back_in_time_begins_another_run(line, drive, early):
    """A bag is played again; its commands may step back before its poses."""
    recording, poses, commands = drive
    changed = [(stamp, speed + 0.5, steering) for stamp, speed, steering in commands]
    taken = Taken(line)
    play(taken, poses, commands)
    for command in changed[:early]:
        taken.evaluation.add_command(*command)
    play(taken, poses, changed[early:] if early else commands)
    taken.evaluation.finish()
    assert [number for number, _ in taken.runs] == [1, 2]
    offline = evaluate(recording, line)
    same(taken.rows(1), [lap.row() for lap in offline.laps])
    if early:
        recording.commands.speed[:] += 0.5
        offline = evaluate(recording, line)
        recording.commands.speed[:] -= 0.5
    same(taken.rows(2), [lap.row() for lap in offline.laps])


def test_the_last_commands_of_a_run_may_come_after_the_first_poses_of_the_next(line, drive):
    """As on a busy computer that plays a bag in a loop."""
    recording, poses, commands = drive
    taken = Taken(line)
    play(taken, poses, commands[:-20])
    for pose in poses[:60]:
        taken.evaluation.add_pose(*pose, 0.0)
        taken.evaluation.advance(0.0)
    for command in [*commands[-20:], *commands[:20]]:
        taken.evaluation.add_command(*command)
    play(taken, poses[60:], commands[20:])
    taken.evaluation.finish()
    expected = [lap.row() for lap in evaluate(recording, line).laps]
    assert [number for number, _ in taken.runs] == [1, 2]
    for run in (1, 2):
        same(taken.rows(run), expected)


def test_a_stray_command_from_the_past_changes_nothing(line, drive):
    recording, poses, commands = drive
    stray = (commands[0][0] - 10_000_000_000, 99.0, 0.0)
    taken = Taken(line)
    for i, pose in enumerate(poses):
        taken.evaluation.add_pose(*pose, 0.0)
        if i == 200:
            taken.evaluation.add_command(*stray)
        if i >= 40:
            taken.evaluation.add_command(*commands[i - 40])
        taken.evaluation.advance(0.0)
    taken.evaluation.finish()
    same(taken.rows(), [lap.row() for lap in evaluate(recording, line).laps])


def test_another_raceline_begins_another_run_the_same_does_not(track, line, drive):
    _, poses, commands = drive
    taken = Taken(line)
    half = len(poses) // 2
    play(taken, poses[:half], commands)
    taken.evaluation.set_raceline(track.raceline(speed=V, walls=1.0))
    assert taken.runs == []
    other = track.raceline(speed=5.0, walls=1.0)
    taken.evaluation.set_raceline(other)
    assert [number for number, _ in taken.runs] == [1]
    assert taken.evaluation.raceline is other
    play(taken, poses[half:], commands)
    taken.evaluation.finish()
    assert [number for number, _ in taken.runs] == [1, 2]
    assert taken.rows(2)[0]["start_time_s"] == 0.0


@pytest.mark.parametrize("offset", [-3e7, -1.0, 1.0, 3e7])
def test_commands_of_another_clock_are_shifted(line, drive, offset):
    recording, poses, commands = drive
    taken, behind = Taken(line), int(offset * 1e9)
    commands = {command[0]: command for command in commands}
    for pose in poses:
        taken.evaluation.add_pose(*pose, 0.0, 1000)
        if pose[0] in commands:
            stamp, *command = commands[pose[0]]
            taken.evaluation.add_command(stamp - behind, *command, 1000 + behind)
        taken.evaluation.advance(0.0)
    taken.evaluation.finish()
    assert taken.evaluation.command_offset_s == pytest.approx(offset)
    same(taken.rows(), [lap.row() for lap in evaluate(recording, line).laps])


def test_doubts_stand_beside_the_laps(track, drive):
    """Clock, frame and raceline for all laps; missing commands only for the laps concerned."""
    recording, poses, commands = drive
    line = track.raceline(speed=V, walls=1.0)
    line.findings = (Finding("guess", WARNING, "column 4 is a guess"), Finding("a", NOTE, "fine"))
    taken, behind = Taken(line), 3_000_000_000
    first, second = (lap for lap in evaluate(recording, line).laps if lap.valid)
    half = recording.t0_ns + 1e9 * 0.5 * (second.start_time_s + second.end_time_s)
    commands = {command[0]: command for command in commands if command[0] < half}
    for pose in poses:
        taken.evaluation.add_pose(*pose, 0.0, 1000)
        if pose[0] in commands:
            stamp, *command = commands[pose[0]]
            taken.evaluation.add_command(stamp - behind, *command, 1000 + behind)
        elif pose[0] > half and len(taken.laps) == 2:
            taken.evaluation.doubt("/odom: another sends, too")
        taken.evaluation.advance(0.0)
    taken.evaluation.finish()
    common = (
        "raceline bean: column 4 is a guess",
        "drive commands: the stamps are from another clock, 3.000 s earlier than the poses': "
        "shifted",
    )
    assert [lap.lap.valid for lap in taken.laps] == [False, True, True, False]
    missing = (
        "drive commands are missing for a part of laps {}: their speed error and steering rate "
        "cover only the rest"
    )
    assert taken.laps[1].warnings == (*common, missing.format(1))
    assert set(taken.laps[2].warnings) == {
        *common,
        "/odom: another sends, too",
        missing.format(2),
    }
    (_, result) = taken.runs[0]
    assert len(result.warnings) == 3


def a_clock_that_is_set(columns):
    columns["t"] += np.where(np.arange(columns["t"].size) > 700, 0.15, 0.0)


def stamps_in_bunches(columns):
    i = np.arange(columns["t"].size)
    columns["t"] = columns["t"][i // 4 * 4] + 1e-5 * (i % 4)


def poses_of_two_nodes(columns):
    columns["x"][500:900:2] += 0.3


def a_second_sender_now_and_then(columns):
    columns["x"][500:900:9] += 0.3
    columns["y"][500:900:9] += 0.3


def a_speed_in_kmh_for_a_while(columns):
    columns["v"][500:900] *= 3.6


def a_single_speed(columns):
    columns["v"][500] = 50.0


def steering_in_degrees(columns):
    columns["steering"] = np.degrees(columns["steering"])


def commands_of_the_other_direction(columns):
    columns["command"] *= -1.0


def somebody_else_drives_for_a_while(columns):
    columns["command"][500:900] = 0.0


def a_throttle(columns):
    columns["command"] = 4.0 + 2.0 * np.cos(3.1 * columns["t"])


def commands_that_came_later(columns):
    for name in ("steering", "command"):
        columns[name] = np.roll(columns[name], 32)


def nothing(columns):
    pass


@pytest.mark.rest_once
@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (stamps_in_bunches, "poses come in bunches, 0.10 s apart"),
        (nothing, None),
        (a_clock_that_is_set, "time jumps ahead by 0.15 s"),
        (poses_of_two_nodes, "poses alternate between two places 0.3"),
        (a_second_sender_now_and_then, "poses lie beside those before and after"),
        (a_speed_in_kmh_for_a_while, "the measured speed is 3.6"),
        (a_single_speed, "the measured speed reaches 50.0 m/s at 12.5 s"),
        (steering_in_degrees, "in degrees? The steering rate is in the same unit"),
        (commands_of_the_other_direction, "the speed commanded is -1.0"),
        (somebody_else_drives_for_a_while, "s the speed commanded is 0.00 times the motion"),
        (a_throttle, "does not follow the speed commanded"),
        (commands_that_came_later, " before its steering commands: they come from another clock"),
    ],
)
def test_what_driving_tells_is_doubted_live_as_offline(track, line, fault, said):
    """The last lap has all warnings of the recording, in the same words, and no others."""
    t = np.arange(1700) / 40.0
    s = 6.0 * t - 1.2 * np.cos(t) - 3.0
    x, y, psi = track.place(s, 0.1 * np.sin(0.7 * s))
    v = 6.0 + 1.2 * np.sin(t)
    ahead = track.place(s + 0.6, 0.1 * np.sin(0.7 * (s + 0.6)))[2]
    steering = 0.32 * np.arctan(np.sin(ahead - psi) / 0.6)
    columns = dict(t=t.copy(), x=x, y=y, psi=psi, v=v, steering=steering, command=v.copy())
    fault(columns)
    t, x, y, psi, v, steering, command = columns.values()
    stamps = [T0_NS + int(round(1e9 * at)) for at in t.tolist()]
    at, unknown = (np.array(stamps) - T0_NS) * 1e-9, np.full(t.size, math.nan)
    commands = Commands(at, steering, command, "/drive")
    offline = evaluate(
        Recording(*(at, x, y, psi, v, unknown, unknown), topic="/odom", commands=commands), line
    )
    taken = Taken(line, pose_topic="/odom", drive_topic="/drive")
    for stamp, *pose, steer, speed in zip(*(stamps, x, y, v, psi, steering, command)):
        *pose, angle = pose
        taken.evaluation.add_pose(stamp, *pose, math.nan, 0.0, 0, angle)
        taken.evaluation.add_command(stamp, speed, steer)
        taken.evaluation.advance(0.0)
    taken.evaluation.finish()
    same(taken.rows(), [lap.row() for lap in offline.laps])
    ((_, result),) = taken.runs
    assert set(result.warnings) == set(offline.warnings)
    assert len(offline.warnings) == (said is not None)
    assert all(said in warning for warning in offline.warnings)
    assert set(taken.laps[-1].warnings) == set(offline.warnings)


def test_a_clock_that_is_set_back_by_little_is_told(line, drive):
    _, poses, commands = drive
    taken = Taken(line)
    late = [(stamp - 110_000_000 * (i > 150), *rest) for i, (stamp, *rest) in enumerate(poses)]
    play(taken, late, commands)
    taken.evaluation.finish()
    assert any("poses: time falls back by 0.11 s" in said for said in taken.laps[1].warnings)


def test_what_is_kept_of_a_long_run_is_bounded(line, monkeypatch):
    monkeypatch.setattr("map_racing.evaluation.live_history._KEPT", 500)
    history = History("/odom", "/drive")
    for i in range(5000):
        history.add_pose(0.025 * i, 0.1 * i, 0.5 * (i == 500), 0.0, 4.0)
        history.add_command(T0_NS + 25_000_000 * i, 4.0, 0.0)
        if i == 900:
            (doubt,) = history.doubts(T0_NS)
    assert "1 pose lies beside" in doubt
    assert history.doubts(T0_NS) == [doubt]
    assert all(len(column) <= 1000 for column in (*history._poses, *history._commands))
    history.clear()
    assert history.doubts(T0_NS) == []


def busy(poses, commands, behind, rng, rate=10.0, held_up=0.05):
    """Messages of a bag that is played fast, as a busy computer receives them.

    When a topic's thread gets the processor, it reads all messages so far: at random times,
    `held_up` seconds apart on average. The stamps of commands are ``behind`` [ns] behind.
    """
    order = []
    for kind, messages in enumerate((poses, commands)):
        sent = (np.array([message[0] for message in messages]) - T0_NS) / rate
        at = np.cumsum(rng.exponential(1e9 * held_up, 1000))
        received = at[np.searchsorted(at, sent)]
        for message, time in zip(messages, received.tolist()):
            lag = T0_NS + int(rate * time) - message[0]
            stamp, rest = message[0] - behind * kind, message[1:]
            order.append((time, kind, stamp, rest, lag + behind * kind))
    return sorted(order, key=lambda entry: entry[0])


def play_busy(taken, entries):
    for time, kind, stamp, values, lag in entries:
        if kind:
            taken.evaluation.add_command(stamp, *values, lag)
        else:
            taken.evaluation.add_pose(stamp, *values, 1e-9 * time, lag)
        taken.evaluation.advance(1e-9 * time)
    taken.evaluation.finish()


@pytest.mark.parametrize("first", ["poses", "commands"])
@pytest.mark.parametrize("seed", range(10))
def test_a_busy_computer_is_no_other_clock(line, drive, seed, first):
    """Messages are late by half a second of bag time, one topic repeatedly by more."""
    recording, poses, commands = drive
    entries = busy(poses, commands, 0, np.random.default_rng(seed))
    # If both topics were delayed, one is always read before the other.
    one = first == "commands"
    entries.sort(key=lambda entry: (entry[0] // 1e8, (entry[1] == 1) != one))
    taken = Taken(line)
    play_busy(taken, entries)
    assert taken.evaluation.command_offset_s == 0.0
    same(taken.rows(), [lap.row() for lap in evaluate(recording, line).laps])


@pytest.mark.parametrize("offset", [-3e7, -1.0, 1.0, 3e7])
def test_another_clock_is_noticed_on_a_busy_computer(line, drive, offset):
    _, poses, commands = drive
    rng = np.random.default_rng(0)
    taken = Taken(line)
    play_busy(taken, busy(poses, commands, int(offset * 1e9), rng, held_up=0.01))
    assert taken.evaluation.command_offset_s == pytest.approx(offset, abs=0.05)


def test_poses_nowhere_are_left_out_even_the_first(line, drive):
    recording, poses, commands = drive
    taken = Taken(line)
    bad = [(poses[0][0] - 50_000_000, math.nan, 0.0, V, 0.0), (poses[0][0] - 1, 0.0, 1e9, V, 0.0)]
    play(taken, bad + poses, commands)
    taken.evaluation.finish()
    same(taken.rows(), [lap.row() for lap in evaluate(recording, line).laps])


def test_nothing_to_finish_is_no_run(line):
    taken = Taken(line)
    taken.evaluation.finish()
    assert taken.runs == []
    with pytest.raises(ParameterError, match="patience"):
        Taken(line, patience=math.nan)
    with pytest.raises(ParameterError, match="car width"):
        Taken(car_width=-1.0)


# -- the file of laps ------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def laps(line, drive):
    _, poses, commands = drive
    taken = Taken(line)
    play(taken, poses, commands)
    taken.evaluation.finish()
    return taken.laps


def test_laps_are_on_the_disk_as_they_come(tmp_path, laps):
    path = tmp_path / "laps.csv"
    log = LapLog(path, 3)
    for count, lap in enumerate(laps, 1):
        log.add(lap)
        rows = list(csv.DictReader(path.open()))
        assert len(rows) == count
        for field in fields(lap.lap)[:-2]:
            value, text = getattr(lap.lap, field.name), rows[-1][field.name]
            if isinstance(value, float):
                assert value == float(text) if text else math.isnan(value)
            else:
                assert str(value) == text
    log.add(laps[0]._replace(warnings=("one, with a comma", "two")))
    assert [row["sector_3_s"] != "" for row in rows] == [False, True, True, False]
    assert [row["warnings"] for row in rows] == ["; ".join(lap.warnings) for lap in laps]
    assert list(csv.DictReader(path.open()))[-1]["warnings"] == "one, with a comma; two"


def test_a_file_is_continued_without_the_line_that_was_cut_off(tmp_path, laps):
    path = tmp_path / "laps.csv"
    log = LapLog(path, 3)
    log.add(laps[0])
    whole = path.read_bytes()
    path.write_bytes(whole + b"1,1,5.0,0.1")
    log = LapLog(path, 3)
    assert path.read_bytes() == whole
    log.add(laps[1])
    assert path.read_bytes().startswith(whole)
    assert len(path.read_text().splitlines()) == 3


def test_a_full_disk_costs_no_other_lap(tmp_path, laps):
    """The partial line that still fits is removed, and not written later."""
    path = tmp_path / "laps.csv"
    log = LapLog(path, 3)
    log.add(laps[0])
    whole = path.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(whole) + 20, limits[1]))
    try:
        with pytest.raises(MapRacingError, match=r"laps\.csv: cannot write: File too large"):
            log.add(laps[1])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert path.read_bytes() == whole
    log.add(laps[2])
    assert [row["lap"] for row in csv.DictReader(path.open())] == ["0", str(laps[2].lap.lap)]


def test_a_file_that_is_taken_away_begins_anew(tmp_path, laps):
    path = tmp_path / "laps.csv"
    log = LapLog(path, 3)
    log.add(laps[0])
    whole = path.read_bytes()
    path.unlink()
    log.add(laps[0])
    assert path.read_bytes() == whole


def test_other_files_are_left_alone(tmp_path, laps):
    path = tmp_path / "laps.csv"
    LapLog(path, 3)
    for sectors, content in ((2, path.read_bytes()), (3, b"a,b\n1,2\n"), (3, b"no end of line")):
        path.write_bytes(content)
        with pytest.raises(FileFormatError, match=r"laps\.csv: expected"):
            LapLog(path, sectors)
        assert path.read_bytes() == content
    with pytest.raises(MapRacingError, match="cannot write"):
        LapLog(tmp_path / "none" / "laps.csv", 3)
    for device in ("/dev/null", "/dev/full", tmp_path):
        with pytest.raises(MapRacingError, match="cannot write: it is not a file"):
            LapLog(device, 3)
