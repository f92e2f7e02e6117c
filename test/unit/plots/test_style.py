"""Figures look the same whatever matplotlib settings the user has."""

import os
import subprocess
import sys

import pytest

from map_racing.cli import main

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


COMMAND = ["raceline", "check", "club", "--plots"]
# A separate program with a quick drawing.
PROGRAM = """
from map_racing.plots.style import finished, new_figure, own_settings, save
with own_settings():
    figure = new_figure(3.0, 2.0)
    figure.add_subplot(1, 1, 1).plot([0.0, 1.0])
    save(finished(figure), "figures/figure.png")
"""


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Bytes of a figure of a program in a folder; its output if it fails."""
    # Not the user's, and one for all: matplotlib scans the fonts once.
    config = str(tmp_path_factory.mktemp("matplotlib"))

    def run(folder, arguments=("-c", PROGRAM), **environment):
        (folder / "figures").mkdir(parents=True, exist_ok=True)
        done = subprocess.run(
            [sys.executable, *arguments],
            cwd=str(folder),
            env={**os.environ, "MPLCONFIGDIR": config, **environment},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        return picture(folder / "figures"), done.stdout

    return run


def picture(folder):
    pictures = list(folder.glob("*.png"))
    return pictures[0].read_bytes() if pictures else b""


@pytest.fixture
def expected(tmp_path, monkeypatch):
    """The figure as drawn by this process."""
    here = tmp_path / "here"
    (here / "figures").mkdir(parents=True)
    monkeypatch.chdir(here)
    exec(PROGRAM, {})
    return picture(here / "figures")


@pytest.mark.parametrize(
    "backend, settings", [("nonsense", ""), ("module://no_such_module", ""), ("", SETTINGS)]
)
def test_any_backend_and_matplotlibrc(tmp_path, drawn, expected, backend, settings):
    assert expected
    (tmp_path / "elsewhere").write_text(settings)
    environment = {"MPLBACKEND": backend, "MATPLOTLIBRC": str(tmp_path / "elsewhere")}
    assert drawn(tmp_path, **environment)[0] == expected


def test_commands_draw_the_same_whatever_matplotlibrc_there_is(tmp_path, drawn):
    assert main([*COMMAND, str(tmp_path / "plain")]) == 0
    expected = picture(tmp_path / "plain")
    command = ["-m", "map_racing", *COMMAND, "figures"]
    (tmp_path / "matplotlibrc").write_text(SETTINGS)
    assert expected and drawn(tmp_path, command)[0] == expected

    (tmp_path / "matplotlibrc").write_bytes(b"\xff\xfe\x00text.usetex: True")
    found, printed = drawn(tmp_path, command)
    assert found == expected or "matplotlibrc damaged?" in printed
    assert "Traceback" not in printed
