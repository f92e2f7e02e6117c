"""``map-racing compare``: two results of an experiment side by side."""

import math
import re

import pandas as pd
import pytest

from map_racing.cli import main
from map_racing.experiments.results import Results, write_results


def test_comparison(tires, shipped, scaling, refused, tmp_path, capsys):
    assert main(["compare", str(tires), str(tires), "--plots", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "No difference in provenance." in printed
    assert (tmp_path / "comparison.png").is_file()
    assert main(["compare", str(tires), str(shipped)]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"conditions\.seeds +1, 2 +1$", printed, re.M)
    assert "cannot compare" in refused("compare", tires, scaling)
    assert "expected a result directory" in refused("compare", tires, tmp_path)


def test_a_parameter_that_a_controller_has_not_is_no_race_that_was_not_completed(tmp_path, capsys):
    rows = [
        {"controller": "map", "m_m": 0.1, "q_s": 0.2, "heading_weight_m": math.nan},
        {"controller": "mpc_kinematic", "m_m": math.nan, "q_s": math.nan, "heading_weight_m": 0.3},
    ]
    for row in rows:
        row.update(speed_scale=0.6, steering_rate_weight_ms=0.02, rms_lateral_error_m=0.01)
    track = {"name": "ring", "sha256": "0"}
    write_results(tmp_path, Results("tune", pd.DataFrame(rows), {"track": track}))
    assert main(["compare", str(tmp_path), str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert re.search(r"mpc_kinematic +- +- +- ", printed) and "N.C." not in printed


@pytest.mark.parametrize("own", [("m_m", "q_s"), ("heading_weight_m", "steering_rate_weight_ms")])
def test_tuning_of_controllers_of_one_law(tmp_path, capsys, refused, own):
    """Their table has no columns of the other's parameters."""
    row = {"controller": "one", "speed_scale": 0.6, own[0]: 0.1, own[1]: 0.2}
    row["rms_lateral_error_m"] = 0.01
    track = {"name": "ring", "sha256": "0"}
    write_results(tmp_path, Results("tune", pd.DataFrame([row]), {"track": track}))
    assert main(["compare", str(tmp_path), str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert f"{own[0]} a" in printed and "rms_lateral_error_m a" in printed and " one " in printed
    del row["rms_lateral_error_m"]
    write_results(tmp_path, Results("tune", pd.DataFrame([row]), {"track": track}))
    assert "expected results of an experiment" in refused("compare", tmp_path, tmp_path)
