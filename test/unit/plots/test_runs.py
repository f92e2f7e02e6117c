import math

import numpy as np
import pytest
from matplotlib import pyplot

from map_racing.bags.samples import Recording
from map_racing.errors import EvaluationError, MapRacingError, ParameterError
from map_racing.evaluation.laps import LapEvaluator, evaluate
from map_racing.plots.runs import plot_boxes, plot_laps, plot_path
from map_racing.plots.style import save


@pytest.fixture(scope="module")
def driven(track):
    t = np.arange(480) / 40.0
    x, y, psi = track.place(6.0 * t - 3.0, 0.1 * np.sin(t))
    nan = np.full(t.size, math.nan)
    return Recording(t, x, y, psi, 6.0 + np.sin(t), nan, nan, source="race.bag")


@pytest.fixture(scope="module")
def result(driven, track):
    return evaluate(driven, track.raceline(speed=6.0, walls=1.0))


def is_png(path):
    return path.read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.parametrize("color_by", ["speed", "error"])
@pytest.mark.parametrize("bare", [False, True])
def test_path(tmp_path, result, driven, track, color_by, bare):
    figure = plot_path(evaluate(driven, track.raceline()) if bare else result, color_by)
    axes, bar = figure.axes
    assert axes.get_xlabel() == "x [m]"
    assert axes.get_title() == "race.bag"
    assert "[m" in bar.get_ylabel()
    labels = {text.get_text() for text in axes.get_legend().get_texts()}
    assert labels == {"raceline", "start line"} | (set() if bare else {"walls"})
    # The whole track is in view, to scale.
    low, high = axes.get_xlim()
    assert low < result.raceline.x.min() < result.raceline.x.max() < high
    assert axes.get_aspect() in ("equal", 1.0)
    save(figure, tmp_path / "path.png")
    assert is_png(tmp_path / "path.png")


def test_path_begins_at_the_moved_start_line(driven, track):
    line = track.raceline(walls=1.0)
    figure = plot_path(evaluate(driven, line, start_s=7.0))
    (start,) = [ln for ln in figure.axes[0].get_lines() if ln.get_label() == "start line"]
    middle = np.mean(start.get_xdata()), np.mean(start.get_ydata())
    assert middle == pytest.approx(line.position(7.0), abs=1e-6)


def test_laps(tmp_path, result):
    figure = plot_laps(result)
    top, bottom = figure.axes
    # One line per valid lap, the best one again on top, and the axis or the raceline.
    assert len(top.get_lines()) == 2 + 1 + 1
    assert bottom.get_xlabel() == "distance from the start line [m]"
    save(figure, tmp_path / "laps.png")
    assert is_png(tmp_path / "laps.png")


def test_laps_of_a_run_without_any(track):
    t = np.arange(100) / 40.0
    x, y, psi = track.place(6.0 * t + 1.0)
    nan = np.full(t.size, math.nan)
    outlap = evaluate(Recording(t, x, y, psi, nan, nan, nan), track.raceline())
    assert len(plot_laps(outlap).axes[1].get_lines()) == 1
    assert plot_boxes([("none", outlap)]).axes[0].texts[0].get_text() == "N.C."


def test_boxes(tmp_path, result):
    figure = plot_boxes([("pure pursuit", result), ("MAP", result)], title="both")
    assert [axes.get_ylabel() for axes in figure.axes] == ["lap time [s]", "RMS lateral error [m]"]
    names = [text.get_text() for text in figure.axes[0].get_xticklabels()]
    assert names == ["pure pursuit", "MAP"]
    save(figure, tmp_path / "boxes.png")
    assert is_png(tmp_path / "boxes.png")


def test_errors(tmp_path, result, driven, track):
    evaluator = LapEvaluator(track.raceline())
    evaluator.update(driven.t, driven.x, driven.y)
    bare = evaluator.finish()
    for plot in (plot_path, plot_laps):
        with pytest.raises(EvaluationError, match="traces"):
            plot(bare)
    with pytest.raises(ParameterError, match="color_by"):
        plot_path(result, "time")
    figure = plot_laps(result)
    with pytest.raises(MapRacingError, match="cannot write"):
        save(figure, tmp_path / "missing" / "laps.png")
    with pytest.raises(MapRacingError, match="cannot write"):
        save(figure, tmp_path / "laps.unknown")


def test_no_global_state_is_touched(result):
    before = pyplot.get_fignums()
    plot_laps(result)
    plot_path(result)
    assert pyplot.get_fignums() == before
