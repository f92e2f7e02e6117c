"""Recordings with any damage: laps or one clear error, never a traceback."""

import random
import struct
from contextlib import suppress

import numpy as np
import pytest

from map_racing.bags.reader import read_signals
from map_racing.bags.writer import BagWriter
from map_racing.errors import MapRacingError
from map_racing.evaluation.recordings import load_recording, recorded_runs
from map_racing.evaluation.runs import evaluate
from map_racing.track.files.waypoints import waypoint_rows

T0 = 1600000000.0
COUNT = 60
# Values that mutated fields get.
NUMBERS = [
    b"nan",
    b"-inf",
    b"1e308",
    b"",
    b"0",
    b"-1",
    b"1700000000000000000",
    b'"',
    b"x",
    b"1e-320",
]
DOUBLES = [np.nan, np.inf, -1e308, 5e-324, 0.0, 1e12]


def write_bag(path, line, place, kind):
    with BagWriter(path) as bag:
        bag.waypoints(T0, waypoint_rows(line))
        bag.transform(T0, 0.3, 0.0, 0.0, parent="base_link", child="laser", static=True)
        for i in range(COUNT):
            t = T0 + 0.1 * i
            x, y, psi = (float(value) for value in place(0.6 * i - 3.0, 0.1))
            if kind == "odometry":
                bag.odometry(t, x, y, psi, 6.0, 0.0, 0.1, received=t + 0.001)
            elif kind == "composed":
                bag.odometry(
                    *(t, x, y, psi, 6.0, 0.0, 0.1), topic="/odom", frame="odom", received=t
                )
                bag.transform(t, 0.0, 0.0, 0.0, child="odom", received=t)
            else:
                bag.transform(t, x, y, psi, parent="odom", child="base_link", received=t)
                bag.transform(t, 0.0, 0.0, 0.0, child="odom", received=t)
            bag.drive(t, 0.1, 6.0, received=t)
            if i == COUNT // 2:
                bag.waypoints(t, waypoint_rows(line.reversed()))
    return path.read_bytes()


def csv_text(place):
    rows = ["t,x,y,psi,v,steering,note"]
    for i in range(COUNT):
        x, y, psi = place(0.6 * i - 3.0, 0.1)
        rows.append(f'{0.1 * i:.3f},{x:.6f},{y:.6f},{psi:.6f},6.0,0.1,"a, b"')
    return "\n".join(rows).encode()


def mutate(data, random, text):
    data = bytearray(data)
    for _ in range(random.choice((1, 1, 2, 5))):
        at = random.randrange(len(data))
        how = random.randrange(6)
        if how == 0:
            data[at] = random.randrange(256)
        elif how == 1:
            del data[at : at + random.choice((1, 4, 40, 400))]
        elif how == 2:
            data[at:at] = data[max(at - random.choice((1, 8, 200)), 0) : at]
        elif how == 3 and text:
            end = data.find(b",", at)
            data[at : end if end > 0 else at + 1] = random.choice(NUMBERS)
        elif how == 3:
            data[at : at + 8] = struct.pack("<d", random.choice(DOUBLES))
        elif how == 4:
            data[at : at + 4] = struct.pack("<I", random.choice((0, 1, 2**31, 2**32 - 1, 255)))
        else:
            del data[at:]
        if len(data) < 2:
            break
    return bytes(data)


def read(path, line):
    """What a user does with a recording: its laps, and a further topic."""
    recording = load_recording(path)
    assert np.isfinite(recording.t).all() and np.all(np.diff(recording.t) > 0.0)
    if path.suffix == ".bag":
        try:
            read_signals(path, recording, {"imu": "", "drive": recording.commands.topic})
        except (MapRacingError, AttributeError) as error:
            assert isinstance(error, MapRacingError) or recording.commands is None
    runs = [(recording, line)]
    if recording.waypoints is not None:
        with suppress(MapRacingError):
            runs += recorded_runs(recording)
    for part, raceline in runs:
        try:
            evaluate(part, raceline)
        except MapRacingError as error:
            assert "\n" not in str(error)


@pytest.mark.parametrize("kind", ["odometry", "composed", "tf", "csv"])
def test_mutated_recordings(tmp_path, track, kind, count=20):
    line = track.raceline(spacing=1.0, speed=6.0, walls=1.0)
    text = kind == "csv"
    path = tmp_path / ("a.csv" if text else "a.bag")
    data = csv_text(track.place) if text else write_bag(path, line, track.place, kind)
    chosen, results = random.Random(13), 0
    for _ in range(count):
        path.write_bytes(mutate(data, chosen, text))
        try:
            read(path, line)
            results += 1
        except MapRacingError as error:
            assert str(path) in str(error)
    assert results > 0
