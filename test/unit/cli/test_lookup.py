"""``map-racing lookup``: tables generated, checked and drawn."""

import re

import numpy as np
import pytest

from map_racing.cli import main
from map_racing.resources import find_config
from map_racing.vehicle.grids import published_grid
from map_racing.vehicle.lookup import load_table


def test_generated_table_checks_against_its_vehicle(tmp_path, refused, capsys):
    path = tmp_path / "t.csv"
    arguments = ["--vehicle", "nuc4", "--output", str(path), "--published-grid"]
    assert main(["lookup", "generate", *arguments]) == 0
    speeds, angles = published_grid()
    table = load_table(path)
    assert np.array_equal(table.speeds, speeds) and np.array_equal(table.angles, angles)
    assert main(["lookup", "check", str(path), "--vehicle", "nuc4"]) == 0
    assert "largest difference 0.00e+00" in capsys.readouterr().out
    assert "not a table of SIM" in refused("lookup", "check", path, "--vehicle", "sim")


@pytest.mark.once
def test_a_table_may_differ_from_its_vehicle_as_much_as_tires_do(tmp_path, refused, capsys):
    text = find_config("vehicles", "nuc4", (".yaml",)).read_text(encoding="utf-8")
    for mu in ("0.995", "0.98"):
        car, path = tmp_path / f"{mu}.yaml", tmp_path / f"{mu}.csv"
        car.write_text(re.sub(r"(?m)^mu: \S+", f"mu: {mu}", text), encoding="utf-8")
        assert main(["lookup", "generate", "--vehicle", str(car), "--output", str(path)]) == 0
        check = ["lookup", "check", str(path), "--vehicle", "nuc4"]
        if mu == "0.995":
            assert main(check) == 0
            assert "made from other parameters" in capsys.readouterr().out
        else:
            assert "not a table of NUC4: off by 0.1" in refused(*check)


def test_a_published_table_checks_against_its_model_file_as_it_comes(tmp_path, capsys):
    """The program that made the table ignores the file's mu, and leaves the corner cell
    uninitialized."""
    model = (
        "{C_0d: 0.5, C_R: 3.7, C_Pf: [4.8, 2.16, 0.65, 0.37], C_Pr: [20.0, 1.5, 0.62, 0.0], "
        "I_z: 0.058, h_cg: 0.014, l_f: 0.162, l_r: 0.145, m: 3.54, MODEL, mu: MU}"
    )
    table = tmp_path / "NUC7_pacejka_lookup_table.csv"
    for name, mu in (("name: own", "1"), ("model_name: NUC7", "0.95")):
        path = tmp_path / "NUC7_pacejka.txt"
        path.write_text(model.replace("MODEL", name).replace("MU", mu))
        arguments = ["--vehicle", str(path), "--output", str(table), "--published-grid"]
        if mu == "1":
            assert main(["lookup", "generate", *arguments]) == 0
            (tmp_path / "NUC7_pacejka_lookup_table.meta.yaml").unlink()
            table.write_text(table.read_text().replace("0.0", "6.9e-310", 1))
    capsys.readouterr()
    assert main(["lookup", "check", str(table), "--vehicle", str(path)]) == 0
    out = capsys.readouterr().out
    assert "largest difference 0.00e+00" in out
    assert f"{path}: mu: 0.95 ignored, 1 used" in out
    assert f"{path}: keys not used: C_0d, C_R" in out


def test_table_is_drawn(tmp_path):
    arguments = ["--vehicle", "sim", "--output", str(tmp_path / "t.csv"), "--v-max", "8"]
    plots = tmp_path / "plots"
    assert main(["lookup", "generate", *arguments, "--linear", "--plots", str(plots)]) == 0
    names = ["lookup_curves.png", "lookup_surface.png"]
    assert sorted(path.name for path in plots.iterdir()) == names


def test_published_tables_follow_from_the_shipped_vehicles(shared_data):
    for vehicle, file in (("nuc4", "NUC4_pacejka"), ("sim", "SIM_linear")):
        path = shared_data / "vehicles" / f"{file}_lookup_table.csv"
        assert main(["lookup", "check", str(path), "--vehicle", vehicle]) == 0


def test_lookup_refuses(tmp_path, refused):
    output = ["--output", tmp_path / "t.csv"]
    assert "nowhere" in refused("lookup", "generate", "--vehicle", "nowhere", *output)
    line = refused("lookup", "generate", "--vehicle", "nuc4", "--v-max", "0", *output)
    assert "--v-max" in line
    (tmp_path / "bad.csv").write_text("0,1,2\n0,0,x\n")
    assert "bad.csv:2" in refused("lookup", "check", tmp_path / "bad.csv")


def test_doubts_about_the_raceline_stand_above_its_corners(tmp_path, capsys):
    angle = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
    rows = np.column_stack((9.0 * np.cos(angle), 5.0 * np.sin(angle), 3.0 + 0.0 * angle, angle))
    np.savetxt(str(tmp_path / "line.csv"), rows, delimiter=",")
    table = str(tmp_path / "t.csv")
    assert main(["lookup", "generate", "--vehicle", "nuc4", "--output", table]) == 0
    assert main(["lookup", "check", table, "--raceline", str(tmp_path / "line.csv")]) == 0
    printed = capsys.readouterr().out
    assert printed.index("line.csv: 4 unnamed columns") < printed.index("corners of line")
    assert "  map, speed_scale 1, grip_use 0.88: " in printed


@pytest.mark.parametrize(
    "option, expected",
    [
        (["--linear"], "--linear: expected --vehicle"),
        (["--controller", "map_paper"], "--controller: expected --raceline"),
        (["--channels", "circles_log"], "--channels: expected --bag"),
        (["--steering-delay", "0.02"], "--steering-delay: expected --bag"),
    ],
)
def test_check_refuses_options_that_it_would_ignore(refused, option, expected):
    assert expected in refused("lookup", "check", "t.csv", *option)
