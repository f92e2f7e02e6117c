"""Damaged inputs of every reader: a result or one clear error, never a traceback.

``PYTHONPATH=test/unit/bags python test/unit/test_mutated.py COUNT`` tries that many, and prints
some that gave a result.
"""

import gzip
import json
import math
import shutil
import struct
import sys
import tempfile
import warnings
from contextlib import suppress
from pathlib import Path
from typing import Callable, NamedTuple

import numpy as np
import pytest
from PIL import Image
from ros2_bags import messages_of, write_mcap, write_sqlite

from map_racing.bags.reader import read_signals
from map_racing.bags.remarks import read_remarks
from map_racing.bags.writer import BagWriter
from map_racing.control.parameters import load_controller_parameters, load_law, load_safety_limits
from map_racing.control.speed_sectors import load_speed_sectors
from map_racing.errors import MapRacingError
from map_racing.evaluation.recordings import load_recording, recorded_runs
from map_racing.evaluation.runs import evaluate
from map_racing.experiments.conditions import load_conditions
from map_racing.experiments.robustness import Robustness
from map_racing.identification.channels import load_channel_map
from map_racing.identification.data import load_run
from map_racing.resources import config_directory
from map_racing.simulation.faults import load_faults
from map_racing.simulation.plants import load_plant
from map_racing.track.centerline import track_from_map
from map_racing.track.files.checks import examine
from map_racing.track.files.load import read_raceline
from map_racing.track.files.repair import repaired
from map_racing.track.files.waypoints import waypoint_rows
from map_racing.track.map_image import read_map_image
from map_racing.track.raceline import Raceline
from map_racing.validation import read_parameters
from map_racing.vehicle.lookup import load_table
from map_racing.vehicle.parameters import load_vehicle

# -- intact inputs ---------------------------------------------------------------------------------

T0 = 1600000000.0
T = np.arange(40) * 2.0 * math.pi / 40
X, Y = 6.0 * np.cos(T), 4.0 * np.sin(T)
PSI, V, W = np.arctan2(4.0 * np.cos(T), -6.0 * np.sin(T)), 4.0 + np.sin(T), 1.0 + 0.1 * np.cos(T)
LINE = Raceline(X, Y, vx_mps=V, d_left_m=W, d_right_m=W)
# 60 poses at 10 Hz and 6 m/s, a little left of the line: a lap and more.
DRIVEN = [
    (
        0.1 * i,
        *(float(v) for v in LINE.to_cartesian(0.6 * i - 3.0, 0.1)),
        LINE.pose(0.6 * i - 3.0).psi,
    )
    for i in range(60)
]


def table(*columns, header="", separator=","):
    rows = [separator.join(f"{value:.4f}" for value in row) for row in zip(*columns)]
    return "\n".join([header] * bool(header) + rows) + "\n"


def waypoints():
    rows = zip(X.tolist(), Y.tolist(), V.tolist(), W.tolist())
    names = ("x_m", "y_m", "vx_mps", "d_left")
    points = [dict(zip(names, row), d_right=1.0, id=k) for k, row in enumerate(rows)]
    return json.dumps({"global_traj_wpnts_iqp": {"wpnts": points}})


RACELINES = (
    table(X, Y),
    table(X, Y, V),
    table(X, Y, PSI, V),
    table(X, Y, W, W, header="# x_m, y_m, w_tr_right_m, w_tr_left_m"),
    table(X, Y, V, PSI, header="X [m];Y [m];Speed [km/h];yaw [deg]", separator=";"),
    table(T, X, Y, PSI, W, V, W, separator="; "),
    table(X, Y, PSI, V, W, W, separator="\t"),
    table(X, Y, W, W, np.cos(PSI), np.sin(PSI), 0 * X, T, PSI, W, V, W),
    table(X, Y, V, header="x_m y_m speed\nm m m/s", separator=" "),
    table(X, Y, V, separator=";").replace(".", ","),
    waypoints(),
)
VEHICLES = (
    "name: car\nm: 3.3\nI_z: 0.05\nl_f: 0.16\nl_r: 0.15\nh_cg: 0.02\nmu: 0.9\ntire_model: linear\n"
    "C_Sf: 4.7\nC_Sr: 5.5\nv_max: 8\n",
    "C_0d: 0.4\nC_Pf:\n- 4.8\n- 2.2\n- 0.65\n- 0.37\nC_Pr: [20.0, 1.5, 0.6, 0.0]\nI_z: 0.06\n"
    "a_max: 3\na_min: -3\nh_cg: 0.014\nl_f: 0.162\nl_r: 0.145\nl_wb: 0.307\nm: 3.54\n"
    "model_name: NUC2\nmu: 1\n",
)
MAP = (
    "image: map.png\nresolution: 0.1\norigin: [-5.0, -4.0, 0.2]\nnegate: 0\noccupied_thresh: 0.65\n"
    "free_thresh: 0.25\nmode: trinary\n"
)
TABLE = table(
    [6.9e-310, 0.0, 0.1, 0.2, 0.3],
    *([v, 0.0, 0.3 * v * v, 0.5 * v * v, math.nan] for v in (1.0, 2.0, 4.0)),
)
FAULTS = (
    "faults:\n- {fault: pose_jump, at_s: 5.0, for_s: 1.0, size: 0.8}\n"
    "- fault: pose_nan\n  at_s: 9\n"
)
SECTORS = (
    "global_limit: 0.9\nn_sectors: 2\nSector0: {start: 0, end: 19, scaling: 0.8}\n"
    "Sector1:\n  start: 20\n  end: 40\n  scaling: 1.0\n  only_FTG: false\n"
)


def write_bag(path, kind):
    with BagWriter(path) as bag:
        bag.waypoints(T0, waypoint_rows(LINE))
        bag.text(T0, "controller: map\n")
        bag.transform(T0, 0.3, 0.0, 0.0, parent="base_link", child="laser", static=True)
        for i, (t, x, y, psi) in enumerate(DRIVEN):
            t = T0 + t
            if kind == "odometry":
                bag.odometry(t, x, y, psi, 6.0, 0.0, 0.1, received=t + 0.001)
            elif kind == "composed":
                own = t, x, y, psi, 6.0, 0.0, 0.1
                bag.odometry(*own, topic="/odom", frame="odom", received=t)
                bag.transform(t, 0.0, 0.0, 0.0, child="odom", received=t)
            else:
                bag.transform(t, x, y, psi, parent="odom", child="base_link", received=t)
                bag.transform(t, 0.0, 0.0, 0.0, child="odom", received=t)
            bag.drive(t, 0.1, 6.0, received=t)
            bag.imu(t, 0.1, 2.0, 0.3, received=t)
            if i == len(DRIVEN) // 2:
                bag.waypoints(t, waypoint_rows(LINE.reversed()))
    return path


def recordings():
    """Text of CSV recordings: names, ``rostopic echo -p``, units, a TUM trajectory."""
    quaternion = [(math.sin(0.5 * psi), math.cos(0.5 * psi)) for *_, psi in DRIVEN]
    lines = [f'{t:.3f},{x:.6f},{y:.6f},{psi:.6f},6.0,0.1,"a, b"' for t, x, y, psi in DRIVEN]
    yield "\n".join(["t,x,y,psi,v,steering,note", *lines])
    lines = [
        f"{int(1e9 * (T0 + t))},{x:.6f},{y:.6f},{z}"
        for (t, x, y, _), (z, _) in zip(DRIVEN, quaternion)
    ]
    names = "%time,field.pose.pose.position.x,field.pose.pose.position.y,field.x"
    yield "\n".join([names, *lines])
    lines = [f"{1e3 * t:.1f};{x:.6f};{y:.6f};21.6" for t, x, y, _ in DRIVEN]
    yield "\n".join(["time [ms];x [m];y [m];v [km/h]", *lines]).replace(".", ",")
    yield "\n".join(
        f"{T0 + t:.3f} {x:.6f} {y:.6f} 0 0 0 {z:.6f} {w:.6f}"
        for (t, x, y, _), (z, w) in zip(DRIVEN, quaternion)
    )


# -- readers, as users call them -------------------------------------------------------------------


def read_driving(path):
    """Read laps, further topics, and identification data; return the reasons of the laps."""
    recording = load_recording(path)
    assert np.isfinite(recording.t).all() and np.all(np.diff(recording.t) > 0.0)
    if path.suffix not in (".csv", ".txt"):
        with suppress(MapRacingError):
            read_remarks(path, recording)
        with suppress(MapRacingError):
            read_signals(path, recording, {"imu": ""})
        with suppress(MapRacingError):
            load_run(path)
    runs = [(recording, LINE)]
    if recording.waypoints is not None:
        with suppress(MapRacingError):
            runs += recorded_runs(recording)
    said = []
    for part, raceline in runs:
        with suppress(MapRacingError):
            result = evaluate(part, raceline)
            counted = [lap.lap_time_s for lap in result.laps if lap.valid]
            assert all(0.0 < time < 1e6 for time in counted)
            said.append([counted, [lap.reason for lap in result.laps], list(result.notes)])
    return f"{recording.t.size} poses; {said}"


def read_line(path):
    read = read_raceline(path)
    found = examine(read)
    assert found.raceline is not None or found.findings
    repaired(read)
    return f"{found.raceline and found.raceline.length}; {[str(f) for f in found.findings]}"


def read_map(path):
    track = track_from_map(read_map_image(path), (2.77, 0.18), passage=0.3)
    return f"{track.length:.3f} m; {[str(finding) for finding in track.findings]}"


def read_table(path):
    steering = load_table(path)
    delta, _ = steering.steering(2.5, 1.0)
    assert math.isfinite(delta) and math.isfinite(steering.max_lateral_acceleration(2.5))
    return f"{delta} rad for 1 m/s^2 at 2.5 m/s"


def read_law(path):
    return load_law(path), load_safety_limits(path)


class Input(NamedTuple):
    """An intact file: its name, its bytes, its reader, and whether it is text."""

    name: str
    data: bytes
    read: Callable
    text: bool = True


def inputs(folder):
    """Intact files for every reader."""
    config = config_directory()
    texts = [("line.csv", text, read_line) for text in RACELINES]
    texts += [("car.yaml", text, load_vehicle) for text in VEHICLES]
    texts += [("map.yaml", MAP, read_map), ("table.csv", TABLE, read_table)]
    texts += [("run.csv", text, read_driving) for text in recordings()]
    texts += [("faults.yaml", FAULTS, load_faults)]
    texts += [("sectors.yaml", SECTORS, lambda path: load_speed_sectors(path, LINE).stretches())]
    for kind, names, read in (
        ("controllers", ("map.yaml", "pure_pursuit.yaml", "mpc_kinematic.yaml"), read_law),
        ("controllers", ("map_adaptive.yaml",), load_controller_parameters),
        ("plants", ("nuc4.yaml", "public_simulator.yaml"), load_plant),
        ("channels", ("circles_log.yaml", "sysid_log.yaml"), load_channel_map),
        ("experiments", ("paper.yaml",), load_conditions),
        ("experiments", ("robustness.yaml",), lambda path: read_parameters(path, Robustness)),
    ):
        for name in names:
            # Damage to comments has no effect.
            lines = (config / kind / name).read_text(encoding="utf-8").splitlines()
            text = "\n".join(line for line in lines if line.strip() and line.strip()[0] != "#")
            texts.append((f"{kind}.yaml", text, read))
    found = [Input(name, text.encode(), read) for name, text, read in texts]
    for kind in ("odometry", "composed", "tf"):
        path = write_bag(folder / "intact.bag", kind)
        found.append(Input("run.bag", path.read_bytes(), read_driving, False))
        mcap = write_mcap(folder / "intact.mcap", messages_of(path), per_chunk=20)
        found.append(Input("run.mcap", mcap.read_bytes(), read_driving, False))
        (database,) = write_sqlite(folder / f"{kind}_ros2", messages_of(path)).glob("*.db3")
        found.append(Input("run.db3", database.read_bytes(), read_driving, False))
    return found


# -- damage ----------------------------------------------------------------------------------------

TOKENS = (
    *("nan", "inf", "-inf", "1e400", "-1e-320", "1e9", "0x10", "", '"', '"1,2"', ";", ",", "\t"),
    *(" ", "#", "# x;y", "\n", "\r", "\0", "\ufeff", "²", "x_m", "y [km/h]", "v (°)", "[m]", "~"),
    *("{", "[", "]", ": ", "- ", "&a *a", "!!python/object:os.system", "true", "2020-13-45", "1_0"),
    *("-1", "0", "1700000000000000000", "x 0.9", "'"),
)
DOUBLES = (np.nan, np.inf, -1e308, 5e-324, 0.0, 1e12)
COUNTS = (0, 1, 255, 2**31, 2**32 - 1)


def damaged(data, generator, text):
    """Bytes changed in one or a few places: bits, tokens, numbers, lines, ends."""
    for _ in range(generator.choice((1, 1, 2, 4))):
        at = int(generator.integers(0, len(data) + 1))
        data = _as_text(data, at, generator) if text else _as_binary(bytearray(data), at, generator)
    return data


def _as_text(data, at, generator):
    lines = data.split(b"\n")
    k, j = generator.integers(0, len(lines), 2).tolist()
    token = TOKENS[generator.integers(0, len(TOKENS))].encode()
    kind = generator.integers(0, 8)
    if kind == 0:
        return data[:at] + bytes([int(generator.integers(0, 256))]) + data[at + 1 :]
    if kind == 1:
        return data[:at] + token + data[at:]
    if kind == 2:
        return data[:at] + data[at + int(generator.integers(1, 20)) :]
    if kind == 3:
        return data[: max(at, 1)]
    if kind == 4:
        lines[k], lines[j] = lines[j], lines[k]
    elif kind == 5:
        lines.insert(k, lines[j])
    else:
        # One cell or value.
        cells = lines[k].replace(b":", b",").replace(b";", b",").split(b",")
        old = cells[j % len(cells)]
        lines[k] = lines[k].replace(old, token, 1) if old else lines[k]
    return b"\n".join(lines)


def _as_binary(data, at, generator):
    kind = generator.integers(0, 6)
    if kind == 0:
        data[at : at + 1] = bytes([int(generator.integers(0, 256))])
    elif kind == 1:
        del data[at : at + int(generator.choice((1, 4, 40, 400)))]
    elif kind == 2:
        data[at:at] = data[max(at - int(generator.choice((1, 8, 200))), 0) : at]
    elif kind == 3:
        data[at : at + 8] = struct.pack("<d", DOUBLES[generator.integers(0, len(DOUBLES))])
    elif kind == 4:
        data[at : at + 4] = struct.pack("<I", COUNTS[generator.integers(0, len(COUNTS))])
    else:
        del data[max(at, 1) :]
    return bytes(data)


class Damage:
    """Damaged inputs by number; each depends only on its number."""

    def __init__(self, folder, intact=None):
        self.folder, self.inputs = folder, intact or inputs(folder)
        rows, columns = np.mgrid[:80, :100]
        radius = np.hypot((columns - 50) / 40.0, (rows - 40) / 32.0)
        gray = np.where((radius > 0.55) & (radius < 1.0), 254, 205).astype(np.uint8)
        Image.fromarray(gray).save(str(folder / "map.png"))
        self._picture = (folder / "map.png").read_bytes()

    def try_number(self, number):
        """Result for a numbered input (None if it was refused), its reader, and the bytes."""
        given = self.inputs[number % len(self.inputs)]
        generator = np.random.default_rng(number)
        data, picture = damaged(given.data, generator, given.text), self._picture
        if given.read in (read_line, read_driving) and given.text and generator.integers(0, 7) == 0:
            data = damaged(gzip.compress(data), generator, False)
        if given.read is read_map and generator.integers(0, 2):
            data, picture = given.data, damaged(picture, generator, False)
        (self.folder / "map.png").write_bytes(picture)
        path = self.folder / given.name
        path.write_bytes(data)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error")
                return given.read(path), given, data
        except MapRacingError as error:
            # The damage may be in the name of the image.
            where = str(self.folder) if given.read is read_map else given.name
            assert where in str(error), (number, str(error))
            assert "\n" not in str(error), (number, str(error))
            return None, given, data
        except Exception as error:
            kept = self.folder / f"failed_{number}_{given.name}"
            kept.write_bytes(data)
            raise AssertionError(f"input {number}, {kept}: {error!r}") from error


COUNT = 400


@pytest.fixture(scope="module")
def intact(tmp_path_factory):
    return inputs(tmp_path_factory.mktemp("intact"))


def test_intact_inputs_give_results(tmp_path, intact):
    damage = Damage(tmp_path, intact)
    for name, data, read, _ in damage.inputs:
        (tmp_path / name).write_bytes(data)
        assert read(tmp_path / name)


@pytest.mark.parametrize("part", [pytest.param(0, marks=pytest.mark.once), 1])
def test_damaged_inputs_give_a_result_or_one_clear_error(tmp_path, part, intact):
    damage = Damage(tmp_path, intact)
    numbers = range(part, COUNT, 2)
    results = [damage.try_number(number)[0] for number in numbers]
    # Not all damage is fatal, and not all is harmless.
    refused = sum(result is None for result in results)
    assert 0.1 * len(numbers) < refused < 0.9 * len(numbers)


def main(count):
    """Try `count` inputs; print how many gave a result, with one example for each reader."""
    folder = Path(tempfile.mkdtemp())
    damage, given_results, shown = Damage(folder), {}, {}
    for number in range(count):
        result, given, data = damage.try_number(number)
        good, total = given_results.get(given.name, (0, 0))
        given_results[given.name] = good + (result is not None), total + 1
        if result is not None and data != given.data:
            shown[given.name] = number, given, data, result
    for name, (good, total) in sorted(given_results.items()):
        print(f"{name}: {good} of {total} gave a result")
    for number, given, data, result in shown.values():
        same = next((i for i, (a, b) in enumerate(zip(data, given.data)) if a != b), len(data))
        parts = [bytes_[max(same - 40, 0) : same + 60] for bytes_ in (given.data, data)]
        print(f"\n{number} {given.name}, {len(given.data)} to {len(data)} bytes, first at {same}:")
        print(f"  {parts[0]!r}\n  {parts[1]!r}\n  {str(result)[:1500]}")
    shutil.rmtree(folder)


if __name__ == "__main__":
    main(int(sys.argv[1]))
