"""Damaged racelines, maps, tables and vehicles: a result or one clear error, never a traceback."""

import gzip
import json
import math

import numpy as np
import pytest
from PIL import Image

from map_racing.errors import MapRacingError
from map_racing.track.centerline import track_from_map
from map_racing.track.files.checks import examine
from map_racing.track.files.load import read_raceline
from map_racing.track.files.repair import repaired
from map_racing.track.map_image import read_map_image
from map_racing.vehicle.lookup import load_table
from map_racing.vehicle.parameters import load_vehicle

T = np.arange(40) * 2.0 * math.pi / 40
X, Y = 6.0 * np.cos(T), 4.0 * np.sin(T)
PSI, V, W = np.arctan2(4.0 * np.cos(T), -6.0 * np.sin(T)), 4.0 + np.sin(T), 1.0 + 0.1 * np.cos(T)
TOKENS = (
    *("nan", "inf", "-inf", "1e400", "-1e-320", "1e9", "0x10", "", '"', '"1,2"', ";", ",", "\t"),
    *(" ", "#", "# x;y", "\n", "\r", "\0", "\ufeff", "²", "x_m", "y [km/h]", "v (°)", "[m]", "~"),
    *("{", "[", "]", ": ", "- ", "&a *a", "!!python/object:os.system", "true", "2020-13-45", "1_0"),
)


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


def mutated(data, generator):
    """Bytes changed at one or two places: bits, tokens, lines, ends."""
    for _ in range(generator.integers(1, 3)):
        at = int(generator.integers(0, len(data) + 1))
        lines = data.split(b"\n")
        k, j = generator.integers(0, len(lines), 2).tolist()
        kind = generator.integers(0, 8)
        if kind == 0:
            data = data[:at] + bytes([int(generator.integers(0, 256))]) + data[at + 1 :]
        elif kind == 1:
            data = data[:at] + TOKENS[generator.integers(0, len(TOKENS))].encode() + data[at:]
        elif kind == 2:
            data = data[:at] + data[at + int(generator.integers(1, 20)) :]
        elif kind == 3:
            data = data[: max(at, 1)]
        elif kind == 4:
            lines[k], lines[j] = lines[j], lines[k]
            data = b"\n".join(lines)
        elif kind == 5:
            data = b"\n".join(lines[:k] + [lines[j]] + lines[k:])
        else:
            # One cell or value.
            cells = lines[k].replace(b":", b",").split(b",")
            old = cells[j % len(cells)]
            new = TOKENS[generator.integers(0, len(TOKENS))].encode()
            lines[k] = lines[k].replace(old, new, 1) if old else lines[k]
            data = b"\n".join(lines)
    return data


def read_line(path):
    read = read_raceline(path)
    found = examine(read)
    assert found.raceline is not None or found.findings
    repaired(read)


def read_map(path):
    track_from_map(read_map_image(path), (3.0, 0.0), passage=0.3)


def read_table(path):
    steering = load_table(path)
    delta, _ = steering.steering(2.5, 1.0)
    assert math.isfinite(delta) and math.isfinite(steering.max_lateral_acceleration(2.5))


def check_all(folder, count, seed):
    """Read mutated inputs; how many were refused."""
    generator = np.random.default_rng(seed)
    rows, columns = np.mgrid[:80, :100]
    radius = np.hypot((columns - 50) / 40.0, (rows - 40) / 32.0)
    gray = np.where((radius > 0.55) & (radius < 1.0), 254, 205).astype(np.uint8)
    Image.fromarray(gray).save(str(folder / "map.png"))
    picture = (folder / "map.png").read_bytes()
    inputs = [("line.csv", text, read_line) for text in RACELINES]
    inputs += [("car.yaml", text, load_vehicle) for text in VEHICLES]
    inputs += [("map.yaml", MAP, read_map), ("table.csv", TABLE, read_table)]
    refused = 0
    for k in range(count):
        name, text, read = inputs[k % len(inputs)]
        data = mutated(text.encode(), generator)
        if read is read_line and k % 7 == 0:
            data = mutated(gzip.compress(data), generator)
        if read is read_map and k % 2:
            (folder / "map.png").write_bytes(mutated(picture, generator))
        (folder / name).write_bytes(data)
        try:
            read(folder / name)
        except MapRacingError as error:
            refused += 1
            # The name of the image may be what was changed.
            assert name in str(error) or (read is read_map and str(folder) in str(error)), error
            assert "\n" not in str(error)
        except Exception as error:
            (folder / f"failed_{name}").write_bytes(data)
            raise AssertionError(f"{folder / f'failed_{name}'}: {error!r}") from error
        (folder / "map.png").write_bytes(picture)
    return refused


@pytest.mark.filterwarnings("error")
def test_damaged_inputs_give_a_result_or_one_clear_error(tmp_path):
    count = 200
    refused = check_all(tmp_path, count, seed=1)
    # Not all damage is fatal.
    assert 0.5 * count < refused < 0.95 * count
