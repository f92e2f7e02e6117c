"""Figures of identified tires."""

from types import SimpleNamespace

import numpy as np
import pytest

from map_racing.identification.axles import AxlePoints
from map_racing.identification.identify import Prediction
from map_racing.plots.identification import (
    plot_coverage,
    plot_drive,
    plot_prediction,
    plot_tires,
)
from map_racing.plots.style import save
from map_racing.vehicle.tires import LinearTire, PacejkaTire


def is_png(path):
    return path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def axle(rejected):
    slip = np.linspace(-0.2, 0.2, 100)
    force = 15.0 * np.tanh(8.0 * slip)
    inlier = np.ones(100, dtype=bool)
    inlier[:rejected] = False
    fit = SimpleNamespace(inlier=inlier, covered_slip=0.19, tire=PacejkaTire(6.0, 1.3, 0.95, 0.0))
    linear = SimpleNamespace(tire=LinearTire(5.6))
    return AxlePoints(-slip, force, 16.0), fit, linear


def test_tires(tmp_path):
    figure = plot_tires({"front": axle(7), "rear": axle(0)})
    front, rear = figure.axes
    assert front.get_title() == "front axle, static load 16.0 N"
    labels = [text.get_text() for text in front.get_legend().get_texts()]
    assert "93 points" in labels and "7 rejected" in labels and "Pacejka" in labels
    assert not any("rejected" in text.get_text() for text in rear.get_legend().get_texts())
    # Solid where there are data, dotted beyond.
    (solid,) = [line for line in front.lines if line.get_label() == "Pacejka"]
    known = solid.get_xdata()[np.isfinite(solid.get_ydata())]
    assert np.abs(known).max() <= 0.19
    save(figure, tmp_path / "tires.png")
    assert is_png(tmp_path / "tires.png")


def test_coverage():
    v, delta = np.full(50, 2.0), np.linspace(-0.3, 0.3, 50)
    left, bar, right = plot_coverage(v, delta, 12.0 * delta, 3.5).axes[:3]
    titles = {axes.get_title() for axes in (left, bar, right)}
    assert {"steady cornering", "how near the limit"} <= titles


@pytest.mark.parametrize("runs", [1, 9])
def test_prediction(runs):
    predictions = []
    for i, (r, a_y) in enumerate(np.linspace((-2.0, -5.0), (2.0, 5.0), 36)):
        off = np.nan if i == 3 else 1.03
        values = 0.0, 2.0, 0.1, a_y, r, off * a_y, off * r
        predictions.append(Prediction(f"run {i % runs}", *values, at_limit=False))
    figure = plot_prediction(predictions, "predicted")
    yaw, lateral = figure.axes
    assert "yaw rate" in yaw.get_xlabel() and "m/s²" in lateral.get_ylabel()
    (legend,) = figure.legends  # one for both, below them
    labels = [text.get_text() for text in legend.get_texts()]
    assert {"±5 %", "±10 %"} < set(labels) and len(labels) == runs + 2
    styles = {
        (line.get_marker(), line.get_color()) for line in yaw.lines if line.get_ls() == "None"
    }
    assert len(styles) == runs


def test_drive(tmp_path):
    t = np.linspace(0.0, 10.0, 500)
    drive = {"run": SimpleNamespace(label="a"), "t": t, "v_x": 2.0 + 0.0 * t, "delta": 0.02 * t}
    drive.update(r=0.1 * t, a_y=0.2 * t, segments=lambda: [slice(50, 200)])
    figure = plot_drive(SimpleNamespace(**drive))
    assert len(figure.axes) == 4 and figure.axes[-1].get_xlabel() == "time [s]"
    save(figure, tmp_path / "drive.png")
    assert is_png(tmp_path / "drive.png")
