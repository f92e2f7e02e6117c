"""``map-racing lookup``: tables generated, checked and drawn."""

import re

import numpy as np

from map_racing.cli import main
from map_racing.resources import find_config
from map_racing.vehicle.lookup import load_table, published_grid


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
