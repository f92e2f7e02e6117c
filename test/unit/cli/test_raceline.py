"""``map-racing raceline``: reports, exit codes, conversions and repairs."""

import json
import math
import shutil

import numpy as np
import pytest

from map_racing.cli import main
from map_racing.track.files.load import load_raceline, save_raceline
from map_racing.track.raceline import Raceline

T = np.arange(300) * 2.0 * math.pi / 300
R = 6.0 + 1.5 * np.cos(2.0 * T)
LINE = Raceline(R * np.cos(T), R * np.sin(T), vx_mps=4.0 + np.cos(T), name="oval")


@pytest.fixture
def good(tmp_path):
    save_raceline(LINE, tmp_path / "good.csv")
    return tmp_path / "good.csv"


@pytest.fixture
def bad(tmp_path):
    """Points that are repeated, turn back, are no numbers or are missing at the end."""
    x, y = LINE.x[:-8].copy(), LINE.y[:-8].copy()
    x[[100, 102]], y[[100, 102]] = x[[102, 100]], y[[102, 100]]
    rows = [f"{a:.6f},{b:.6f},5.0" for a, b in zip(x, y)]
    rows[50:50] = [rows[50]]
    rows[200] = "nan,0.0,5.0"
    path = tmp_path / "bad.csv"
    path.write_text("\n".join(["x_m,y_m,vx_mps", *rows]) + "\n")
    return path


def run(capsys, *arguments):
    code = main(["raceline", *map(str, arguments)])
    out, err = capsys.readouterr()
    assert "Traceback" not in err and len(err.splitlines()) <= 1
    return code, out, err


def test_a_good_raceline(good, capsys):
    code, out, err = run(capsys, "check", good)
    assert (code, err) == (0, "")
    assert f"{LINE.length:.3f} m, counter-clockwise, {LINE.n} points 0.100 to 0.100 m apart" in out
    assert "speeds 3.00 to 5.00 m/s, a lap takes" in out and "no walls" in out
    assert out.splitlines()[-1] == "  nothing wrong"


def test_shipped_tracks_have_nothing_wrong(capsys):
    for name in ("reference", "club"):
        assert run(capsys, "check", name)[0] == 0


def test_what_is_wrong_stands_with_its_line(bad, capsys):
    code, out, err = run(capsys, "check", bad)
    assert (code, err) == (1, "")
    assert "error: expected a finite x, got nan, at point 200 (line 202): x = nan m" in out
    assert out.splitlines()[-1] == "  1 error"


def test_report_as_json(good, bad, tmp_path, capsys):
    code, out, _ = run(capsys, "check", bad, "--json", "-")
    report = json.loads(out)
    assert code == 1 and report["ok"] is report["usable"] is False and report["course"] is None
    (finding,) = report["findings"]
    assert (finding["code"], finding["severity"]) == ("not-finite", "error")
    place = {"index": 200, "line": 202, "s_m": None, "x_m": None, "y_m": 0.0}
    assert finding["places"] == [place]
    code, out, _ = run(capsys, "check", good, "--json", tmp_path / "report.json")
    assert code == 0 and "report written to" in out
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["ok"] and report["course"]["length_m"] == pytest.approx(LINE.length, abs=1e-4)
    assert report["layout"].startswith("CSV with columns s x y psi kappa speed ax")
    assert [finding["code"] for finding in report["findings"]] == ["heading-x"]


def test_files_that_cannot_be_read(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("x_m,y_m\n1,2\n3\n")
    code, out, err = run(capsys, "check", tmp_path / "a.csv")
    assert (code, out) == (1, "") and ":3: expected 2 columns, got 1" in err
    code, out, err = run(capsys, "check", tmp_path / "a.csv", "--json", "-")
    assert (code, err) == (1, "") and json.loads(out)["findings"][0]["code"] == "unreadable"
    code, _, err = run(capsys, "check", tmp_path / "none.csv")
    assert code == 1 and "no such file, nor one of the shipped tracks" in err


def test_figures(good, bad, tmp_path, capsys):
    for source in (good, bad):
        _, out, _ = run(capsys, "check", source, "--plots", tmp_path / "plots")
        path = tmp_path / "plots" / f"{source.stem}_check.png"
        assert f"figure: {path}" in out and path.read_bytes()[:4] == b"\x89PNG"


def test_conversion_there_and_back(good, tmp_path, capsys):
    steps = [("a.csv", "tum"), ("b.json", None), ("c.bag", None), ("d.csv", "racetracks")]
    source = good
    for name, form in steps:
        options = ["--format", form] if form else []
        code, out, err = run(capsys, "convert", source, tmp_path / name, *options)
        assert (code, err) == (0, "")
        source = tmp_path / name
    assert f"{source}: format racetracks, {LINE.n} points, {LINE.length:.3f} m" in out
    line = load_raceline(source)
    np.testing.assert_allclose(line.x, LINE.x, atol=1e-6)
    np.testing.assert_allclose(line.speed, LINE.speed, atol=1e-6)


def test_what_a_format_cannot_hold_is_said(tmp_path, capsys):
    out = run(capsys, "convert", "reference", tmp_path / "a.csv", "--format", "tum")[1]
    assert "walls left out: format tum has none" in out
    out = run(capsys, "convert", "reference", tmp_path / "b.csv", "--format", "centerline")[1]
    assert "speeds left out: format centerline has none" in out
    out = run(capsys, "convert", tmp_path / "a.csv", tmp_path / "a.json")[1]
    assert "no walls are known: written as 0" in out


def test_repair(bad, tmp_path, capsys):
    output = tmp_path / "mended.csv"
    code, out, err = run(capsys, "convert", bad, output, "--format", "tum")
    assert code == 1 and "bad.csv: expected a finite x, got nan" in err
    assert not output.exists()
    code, out, err = run(capsys, "convert", bad, output, "--format", "tum", "--repair")
    assert (code, err) == (0, "")
    assert [line for line in out.splitlines() if "repaired" in line] == [
        "  repaired: 1 point without position dropped",
        "  repaired: 1 repeated point dropped",
        "  repaired: 2 points dropped at which the track turned back",
        "  repaired: 8 points added along the curve where they were far apart",
    ]
    line = load_raceline(output)
    assert max(abs(LINE.project(x, y).d) for x, y in zip(line.x, line.y)) < 0.01
    assert run(capsys, "check", output)[0] == 0


def test_reverse_and_spacing(tmp_path, capsys):
    options = ["--format", "map_racing", "--reverse", "--spacing", "0.2"]
    code, out, _ = run(capsys, "convert", "reference", tmp_path / "a.csv", *options)
    assert code == 0 and "reversed" in out and "resampled to 183 points" in out
    line, other = load_raceline(tmp_path / "a.csv"), load_raceline("reference")
    assert line.s_points.size == 183
    assert line.pose(0.0).psi == pytest.approx(
        math.remainder(other.pose(0.0).psi + math.pi, 2.0 * math.pi), abs=1e-3
    )
    assert line.widths_at(3.0) == pytest.approx(other.widths_at(-3.0)[::-1], abs=1e-3)


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["reference", "a.csv"], "expected --format for a .csv file: map_racing, tum, race"),
        (["reference", "a.gpx"], "expected a file named .csv, .json or .bag, or --format"),
        (["reference", "a.json", "--format", "tum"], "expected a file named .csv for format tum"),
        (["reference", "no/a.json"], "the folder no does not exist"),
        (["reference", "a.json", "--spacing", "0"], "--spacing: expected 0.001 to 100 m, got "),
        (["reference", "a.json", "--spacing", "nan"], "--spacing: expected 0.001 to 100 m, got "),
        (["good.csv", "good.csv", "--format", "tum"], "good.csv: is also an input"),
        (["good.csv#x,y", "a.json"], "expected 7 names of columns, got 2"),
    ],
)
def test_refused(good, monkeypatch, capsys, arguments, message):
    monkeypatch.chdir(good.parent)
    code, out, err = run(capsys, "convert", *arguments)
    assert code == 1 and message in err
    assert [entry.name for entry in good.parent.iterdir()] == ["good.csv"]


def test_a_bag_is_not_lost_to_another_format(good, tmp_path, capsys):
    run(capsys, "convert", good, tmp_path / "a.bag")
    shutil.copy(str(tmp_path / "a.bag"), str(tmp_path / "a.csv"))
    code, _, err = run(capsys, "convert", good, tmp_path / "a.csv", "--format", "tum")
    assert code == 1 and "is a bag, which would be overwritten" in err


def test_a_name_with_a_number_sign_is_a_file(good, capsys):
    """It would be overwritten if the part before the sign were taken for the input."""
    odd = good.rename(good.with_name("lap#2.csv"))
    before = odd.read_bytes()
    for arguments in (("convert", odd, odd, "--format", "tum"), ("optimize", odd, "--output", odd)):
        code, _, err = run(capsys, *arguments)
        assert code == 1 and err.endswith("lap#2.csv: is also an input\n")
    assert odd.read_bytes() == before
    assert run(capsys, "check", odd)[0] == 0
