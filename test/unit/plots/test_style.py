"""Figures look the same whatever matplotlib settings the user has."""

import os
import subprocess
import sys

import pytest

SETTINGS = """
text.usetex: True
font.size: 22
figure.facecolor: black
axes.prop_cycle: cycler("color", ["r", "g"])
axes.grid: True
savefig.bbox: tight
savefig.dpi: 30
lines.linewidth: 9
backend: TkAgg
"""


def drawn(folder, **environment):
    """Bytes of a figure of a command that runs in a folder; its output if it fails."""
    folder.mkdir(exist_ok=True)
    run = subprocess.run(
        [sys.executable, "-m", "map_racing", "raceline", "check", "club", "--plots", "figures"],
        cwd=str(folder),
        env={**os.environ, "MPLCONFIGDIR": str(folder), **environment},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    pictures = list((folder / "figures").glob("*.png"))
    return (pictures[0].read_bytes() if pictures else b""), run.stdout


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    return drawn(tmp_path_factory.mktemp("plain"))[0]


@pytest.mark.parametrize("backend", ["nonsense", "TkAgg", "module://no_such_module", "svg", ""])
def test_any_backend(tmp_path, expected, backend):
    assert expected
    assert drawn(tmp_path, MPLBACKEND=backend)[0] == expected


@pytest.mark.parametrize("where", ["matplotlibrc", "elsewhere"])
def test_any_matplotlibrc(tmp_path, expected, where):
    (tmp_path / where).write_text(SETTINGS)
    environment = {} if where == "matplotlibrc" else {"MATPLOTLIBRC": str(tmp_path / where)}
    assert drawn(tmp_path, **environment)[0] == expected


def test_a_damaged_matplotlibrc_is_named(tmp_path, expected):
    (tmp_path / "matplotlibrc").write_bytes(b"\xff\xfe\x00text.usetex: True")
    picture, printed = drawn(tmp_path)
    assert picture == expected or "matplotlibrc damaged?" in printed
    assert "Traceback" not in printed
