"""A small experiment with model predictive control, from the command line."""

import json

import pandas as pd
import pytest

from map_racing.cli import experiment, main
from map_racing.experiments import rivals, session
from map_racing.track.files.load import save_raceline

# One of each kind: each costs a separate process, to measure its memory.
RIVALS = tuple(c for c in rivals.RIVALS if c.label in ("MAP Pacejka", "MPC single-track"))


@pytest.mark.once
def test_experiment(ring, tmp_path, monkeypatch, capsys):
    pytest.importorskip("osqp")
    monkeypatch.setattr(experiment, "RIVAL_SCALES", (0.5, 0.6))
    monkeypatch.setattr(experiment, "RIVALS", RIVALS)
    monkeypatch.setattr(rivals, "BELIEFS", rivals.BELIEFS[:2])
    command = ["experiment", "mpc", "--output", str(tmp_path), "--plants", "nuc4", "--seeds", "1"]
    save_raceline(ring, tmp_path / "ring.csv")
    options = ["--track", str(tmp_path / "ring.csv")]
    options += ["--no-tuning", "--laps", "1", "--jobs", "1"]
    assert main([*command, *options]) == 0
    folder = tmp_path / "nuc4"
    work = pd.read_csv(folder / "work.csv").set_index("controller")
    assert list(work.index) == ["MAP Pacejka", "MPC single-track"]
    assert (work.failed_share == 0.0).all() and (work.memory_mb > 20.0).all()
    assert work.median_step_ms["MPC single-track"] > work.median_step_ms["MAP Pacejka"] > 0.0
    beliefs = pd.read_csv(folder / "beliefs.csv")
    # MAP as published has no delay compensation, so its delay cannot be wrong.
    assert beliefs.groupby("controller").size().to_dict() == {
        "MAP Pacejka": 1,
        "MPC single-track": 2,
    }
    assert json.loads((folder / "results.json").read_text())["kind"] == "mpc"
    assert "MPC single-track" in capsys.readouterr().out
    # Continued: no races again, except one in a process for each controller, to measure memory.
    monkeypatch.setattr(session.Session, "memory", lambda *_: {})
    assert main([*command, *options]) == 0
    assert "\n0 races driven" in capsys.readouterr().out
