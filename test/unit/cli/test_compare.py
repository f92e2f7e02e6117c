"""``map-racing compare``: two results of an experiment side by side."""

import re

from map_racing.cli import main


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
