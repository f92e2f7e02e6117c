"""Races, experiments and errors shared by the tests of several commands."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from map_racing.cli import main
from map_racing.experiments import tuning
from map_racing.track.files.load import save_raceline
from map_racing.track.raceline import Raceline


# Module scope, not session: the tests of the plots come later.
@pytest.fixture(scope="module", autouse=True)
def coarse():
    """Small figures without layout: the tests of the plots check their looks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("map_racing.plots.style.DPI", 30)
        patch.setattr("matplotlib.figure.Figure.tight_layout", lambda figure, **_: None)
        yield


@pytest.fixture
def refused(capsys):
    """``refused("race", "--laps", 0)`` runs a command that must fail; its one line on stderr."""

    def run(*arguments):
        assert main([str(argument) for argument in arguments]) == 1
        lines = capsys.readouterr().err.splitlines()
        assert len(lines) == 1 and lines[0].startswith("map-racing: ")
        return lines[0]

    return run


@pytest.fixture(scope="session")
def bags(tmp_path_factory):
    """Bags of two short races, by name of the controller."""
    folder = tmp_path_factory.mktemp("races")
    paths = {}
    for controller in ("map", "pure_pursuit"):
        paths[controller] = folder / f"{controller}_0.7.bag"
        arguments = ["--laps", "2", "--speed-scale", "0.7", "--output", str(paths[controller])]
        assert main(["race", "--controller", controller, *arguments]) == 0
    return paths


@pytest.fixture(scope="session")
def place(tmp_path_factory):
    """A folder with a small circle and conditions of an experiment."""
    folder = tmp_path_factory.mktemp("experiments")
    angle = 2.0 * np.pi * np.arange(50) / 50
    half = np.full(50, 0.4)
    x, y = 1.2 * np.cos(angle), 1.2 * np.sin(angle)
    ring = Raceline(x, y, vx_mps=np.full(50, 3.5), d_left_m=half, d_right_m=half)
    save_raceline(ring, folder / "ring.csv")
    (folder / "conditions.yaml").write_text(
        f"track: {folder / 'ring.csv'}\nplant: nuc4\nmu_deviation: 0.05\n"
        "front_stiffness_deviation: 0.1\nrear_stiffness_deviation: 0.1\n"
        "seeds: [1, 2]\npractice_seeds: [11]\ntuning_scale: 0.6\ntuning_laps: 1\n"
    )
    return folder


@pytest.fixture(scope="session")
def run(place):
    """``run("tune", ...)`` runs a command under these conditions, in this process; its exit code.

    Tuning tries a grid of four pairs and no others: its own tests cover the search. Figures are
    composed, but not rendered: the tests of the plots do that.
    """

    def command(*arguments):
        conditions = ["--conditions", place / "conditions.yaml", "--jobs", 1]
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(tuning, "GRID", (8, 16))
            patch.setattr(tuning, "COARSE", 1)
            patch.setattr(Figure, "tight_layout", lambda figure, **_: None)
            patch.setattr(Figure, "savefig", lambda figure, file, **_: None)
            return main([str(argument) for argument in (*arguments, *conditions)])

    return command


@pytest.fixture(scope="session")
def tires(place, run):
    """Result directory of tire-models, with bags."""
    output = place / "tires"
    assert run("experiment", "tire-models", "--laps", 2, "--bags", "--output", output) == 0
    return output


@pytest.fixture(scope="session")
def shipped(place, run):
    """Result directory of tire-models on one day, with the shipped parameters."""
    output = place / "shipped"
    options = ["--no-tuning", "--vehicle", "nuc4", "--laps", 1, "--seeds", 1, "--output", output]
    assert run("experiment", "tire-models", *options) == 0
    return output


@pytest.fixture(scope="session")
def scaling(place, tires, run):
    """Result directory of velocity-scaling, which reuses the races of the tuning."""
    output = place / "scaling"
    options = ["--laps", 1, "--to", 0.65, "--seeds", 1, "--vehicle", tires / "identified.yaml"]
    options += ["--reuse", tires, "--output", output]
    assert run("experiment", "velocity-scaling", *options) == 0
    return output
