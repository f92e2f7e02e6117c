"""Figures of experiments show their data."""

import math

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_rgba

from map_racing.bags.samples import Recording
from map_racing.errors import EvaluationError
from map_racing.evaluation.runs import evaluate
from map_racing.plots.experiments import (
    plot_comparison,
    plot_scaling,
    plot_trajectories,
    plot_tuning,
)
from map_racing.plots.runs import plot_differences
from map_racing.plots.style import COLORS, save


def is_png(path):
    return path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def recording(track, d, laps=3, v=6.0):
    t = np.arange(int(laps * 40 * track.length / v)) / 40.0
    s = v * t - 1.0
    x, y, psi = track.place(s, d(s))
    nan = np.full(t.size, math.nan)
    return Recording(t, x, y, psi, np.full(t.size, v), nan, nan, source="run.bag")


# -- tuning ----------------------------------------------------------------------------------------


def test_tuning(tmp_path):
    m, q = (axis.ravel() for axis in np.meshgrid([0.0, 0.2, 0.4], [0.0, 0.1, 0.2]))
    error = 0.01 + (m - 0.2) ** 2 + (q - 0.1) ** 2
    error[0] = math.inf
    figure = plot_tuning(m, q, error, (0.2, 0.1), "tuning")
    axes, bar = figure.axes
    crosses, star = axes.get_lines()
    assert (crosses.get_xdata(), crosses.get_ydata()) == ([0.0], [0.0])
    assert (star.get_xdata(), star.get_ydata()) == ([0.2], [0.1])
    texts = [text.get_text() for text in axes.get_legend().get_texts()]
    assert "m = 0.2 m, q = 0.1 s: 0.0100 m" in texts and "not completed" in texts
    assert axes.get_xlim()[0] < 0.0 < 0.4 < axes.get_xlim()[1]
    assert "[m]" in bar.get_ylabel()
    save(figure, tmp_path / "tuning.png")
    assert is_png(tmp_path / "tuning.png")


@pytest.mark.parametrize("count", [1, 2, 3])
def test_tuning_with_few_pairs(count):
    figure = plot_tuning(np.arange(count), np.zeros(count), np.full(count, 0.1), (0, 0), "few")
    assert len(figure.axes) == 2


# -- velocity scaling ------------------------------------------------------------------------------


def test_scaling_boxes(tmp_path):
    labels = ["pure pursuit", "MAP"]
    rows = [
        (scale, label, error * scale, 8.0 + error)
        for scale in (0.6, 0.7)
        for label in labels
        for error in (0.1, 0.2, 0.4)
        if (scale, label) != (0.7, "pure pursuit")
    ]
    columns = ["speed_scale", "controller", "rms_lateral_error_m", "lap_time_s"]
    laps = pd.DataFrame(rows, columns=columns)
    figure = plot_scaling(laps, {(0.7, "pure pursuit"): 3, (0.7, "MAP"): 0}, labels, "title")
    top, bottom = figure.axes
    assert [text.get_text() for text in bottom.get_xticklabels()] == ["60", "70"]
    assert top.get_yscale() == "log" and bottom.get_ylabel() == "lap time [s]"
    # In old versions of matplotlib, boxes are artists.
    boxes = [*top.patches, *getattr(top, "artists", [])]
    assert len(boxes) == 3
    assert [text.get_text() for text in top.texts] == ["3"]
    # Whiskers go to the extremes.
    ends = np.concatenate([np.ravel(line.get_ydata()) for line in top.get_lines()])
    assert {0.06, 0.24, 0.07, 0.28} <= set(np.round(ends.astype(float), 9))
    save(figure, tmp_path / "scaling.png")
    assert is_png(tmp_path / "scaling.png")


def test_a_box_of_one_lap_shows_whose_it_is():
    labels = ["pure pursuit", "MAP"]
    columns = ["speed_scale", "controller", "rms_lateral_error_m", "lap_time_s"]
    laps = pd.DataFrame([(0.6, label, 0.1, 8.0) for label in labels], columns=columns)
    for axes in plot_scaling(laps, {}, labels, "title").axes:
        lines = [line for line in axes.get_lines() if np.size(line.get_xdata()) == 2]
        medians = [line for line in lines if line.get_zorder() == 2.5]
        assert [line.get_color() for line in medians] == list(COLORS[:2])


# -- trajectories ----------------------------------------------------------------------------------


def test_trajectories_end_where_they_crash(tmp_path, track):
    line = track.raceline(speed=6.0, walls=1.0)
    path = np.stack((line.x, line.y), axis=1)
    rows = [
        [("pure pursuit, 70%", path, False), ("MAP, 70%", path, False)],
        [("pure pursuit, 80%", path[:40], True), ("MAP, 80%", path, False)],
    ]
    figure = plot_trajectories(line, rows, "trajectories")
    assert [axes.get_title() for axes in figure.axes] == [name for row in rows for name, *_ in row]
    crashes = [[ln for ln in axes.get_lines() if ln.get_marker() == "x"] for axes in figure.axes]
    assert [len(found) for found in crashes] == [0, 0, 1, 0]
    (end,) = crashes[2]
    assert (end.get_xdata()[0], end.get_ydata()[0]) == pytest.approx(tuple(path[39]))
    for axes in figure.axes:
        dashed = [ln for ln in axes.get_lines() if ln.get_label() == "raceline"]
        assert [ln.get_linestyle() for ln in dashed] == ["--"]
        assert {"0 m", "10 m"} <= {text.get_text() for text in axes.texts}
        (driven,) = [ln for ln in axes.get_lines() if ln.get_label() == "driven"]
        assert driven.get_zorder() > dashed[0].get_zorder()
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"driven", "crash", "raceline", "walls"} <= set(names)
    save(figure, tmp_path / "trajectories.png")
    assert is_png(tmp_path / "trajectories.png")


def test_trajectories_without_walls(track):
    line = track.raceline()
    figure = plot_trajectories(line, [[("MAP", np.stack((line.x, line.y), axis=1), False)]], "t")
    assert "walls" not in [text.get_text() for text in figure.legends[0].get_texts()]


# -- comparisons -----------------------------------------------------------------------------------


def test_comparison(tmp_path):
    table = pd.DataFrame(
        {
            "speed_scale": [0.7, 0.6, 0.6],
            "controller": ["MAP", "MAP", "pure pursuit"],
            "mean_lap_time_s_a": [8.0, 9.0, 9.5],
            "mean_lap_time_s_b": [8.1, 9.1, math.nan],
        }
    )
    figure = plot_comparison(table, ["mean_lap_time_s"], ("first", "second"), "title")
    (axes,) = figure.axes
    lines = axes.get_lines()
    assert lines[0].get_xdata() == pytest.approx([60.0, 70.0])
    assert list(lines[0].get_ydata()) == [9.0, 8.0] and list(lines[1].get_ydata()) == [9.1, 8.1]
    assert axes.get_ylabel() == "mean lap time [s]"
    names = {text.get_text() for text in figure.legends[0].get_texts()}
    assert names == {"MAP", "pure pursuit", "first", "second"}
    save(figure, tmp_path / "comparison.png")
    assert is_png(tmp_path / "comparison.png")


def test_days_are_whole(tmp_path):
    """If all days but one were completed, the axis has no fractional ticks."""
    table = pd.DataFrame({"speed_scale": [0.7, 0.8], "controller": ["MAP"] * 2})
    table["days_completed_a"], table["days_completed_b"] = [1, 1], [1, 2]
    figure = plot_comparison(table, ["days_completed"], ("first", "second"), "title")
    figure.canvas.draw()
    ticks = figure.axes[0].get_yticks()
    assert all(float(tick).is_integer() for tick in ticks)


def test_difference_of_known_errors(tmp_path, track):
    """One car 0.1 m to the left, the other 0.3 m to the right in half of the track."""
    line = track.raceline(speed=6.0, walls=1.0)
    half = 0.5 * track.length
    offsets = (
        lambda s: np.full_like(s, 0.1),
        lambda s: np.where((s % track.length) < half, -0.3, 0.1),
    )
    a, b = (evaluate(recording(track, d), line) for d in offsets)
    figure = plot_differences([("a", a), ("b", b)])
    top, bottom, _ = figure.axes
    s, difference = bottom.get_lines()[0].get_data()
    inner = (s > 1.0) & (s < half - 1.0)
    outer = (s > half + 1.0) & (s < track.length - 1.0)
    np.testing.assert_allclose(difference[inner], 0.2, atol=2e-3)
    np.testing.assert_allclose(difference[outer], 0.0, atol=2e-3)
    np.testing.assert_allclose(top.get_lines()[1].get_ydata()[inner], -0.3, atol=2e-3)
    assert to_rgba(bottom.get_lines()[0].get_color()) == to_rgba(COLORS[1])
    labels = [text.get_text() for text in top.get_legend().get_texts()]
    assert labels[0] == "a: 2 laps, RMS over distance 0.100 m"
    save(figure, tmp_path / "difference.png")
    assert is_png(tmp_path / "difference.png")


def test_the_difference_of_time_grows_where_a_car_is_slower(track):
    """5 m/s everywhere, against 4 m/s in the first half and 5 m/s in the second."""
    line = track.raceline(speed=6.0)
    half = 0.5 * track.length
    runs = []
    for slow in (5.0, 4.0):
        lap = half / slow + half / 5.0
        t = np.arange(0.0, 2.5 * lap, 0.02)
        laps, within = np.divmod(t, lap)
        s = np.interp(within, [0.0, half / slow, lap], [0.0, half, track.length])
        x, y, psi = track.place(s)
        nan = np.full(t.size, math.nan)
        runs.append(evaluate(Recording(t - 0.5, x, y, psi, nan, nan, nan), line))
    figure = plot_differences([("fast", runs[0]), ("slow", runs[1])])
    *_, bottom = figure.axes
    s, difference = bottom.get_lines()[0].get_data()
    expected = np.minimum(s, half) * (1.0 / 4.0 - 1.0 / 5.0)
    np.testing.assert_allclose(difference, expected, atol=5e-3)
    (label,) = [text.get_text() for text in bottom.get_legend().get_texts()]
    assert label.startswith("slow − fast: +") and label.endswith(" s per lap")
    assert float(label.split()[-4]) == pytest.approx(half / 20.0, abs=2e-3)


def test_differences_need_one_track_and_laps(track):
    line = track.raceline(speed=6.0)
    good = evaluate(recording(track, np.zeros_like), line)
    out_lap = evaluate(recording(track, np.zeros_like, laps=0.6), line)
    with pytest.raises(EvaluationError, match="at least two runs with valid laps"):
        plot_differences([("good", good), ("out-lap", out_lap)])
    moved = evaluate(recording(track, np.zeros_like), line, start_s=2.0)
    expected = "moved: expected the raceline and start line of good"
    with pytest.raises(EvaluationError, match=expected):
        plot_differences([("good", good), ("moved", moved)])
