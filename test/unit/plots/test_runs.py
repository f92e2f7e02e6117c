import dataclasses
import math

import numpy as np
import pytest
from matplotlib import pyplot

from map_racing.bags.samples import Commands, Recording
from map_racing.errors import EvaluationError, MapRacingError, ParameterError
from map_racing.evaluation.laps import LapEvaluator
from map_racing.evaluation.runs import evaluate
from map_racing.plots.runs import plot_boxes, plot_differences, plot_laps, plot_path
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


def test_the_path_is_drawn_over_the_raceline(result):
    axes = plot_path(result, "error").axes[0]
    (raceline,) = [ln for ln in axes.get_lines() if ln.get_label() == "raceline"]
    assert axes.collections[0].get_zorder() > raceline.get_zorder()


@pytest.mark.parametrize("plot", [plot_laps, plot_path])
def test_legends_are_off_the_data(result, plot):
    figure = plot(result)
    figure.canvas.draw()
    for axes in figure.axes:
        legend = axes.get_legend()
        if legend:
            inside = axes.get_window_extent()
            assert not inside.overlaps(legend.get_window_extent())


def test_the_speed_stands_beside_its_command(driven, track):
    """Not the raceline's 6 m/s: the controller commanded 4 m/s; and the axis shows 3 to 6 m/s."""
    count = driven.t.size
    commands = Commands(driven.t, np.zeros(count), np.full(count, 4.0))
    slow = dataclasses.replace(driven, v_x=4.0 + np.sin(driven.t), commands=commands)
    bottom = plot_laps(evaluate(slow, track.raceline(speed=6.0))).axes[1]
    labels = [text.get_text() for text in bottom.get_legend().get_texts()]
    assert labels[-1] == "commanded in it" and "best lap" in labels[-2]
    np.testing.assert_allclose(bottom.get_lines()[-1].get_ydata(), 4.0)
    low, high = bottom.get_ylim()
    assert 2.7 < low < 3.1 and 4.9 < high < 5.3


def test_a_command_that_is_no_speed_is_not_drawn_as_one(driven, track):
    throttle = Commands(driven.t, 0.0 * driven.t, 2.0 + np.sin(7.0 * driven.t))
    slow = dataclasses.replace(driven, v_x=4.0 + np.sin(driven.t), commands=throttle)
    result = evaluate(slow, track.raceline(speed=6.0))
    labels = [line.get_label() for line in plot_laps(result).axes[1].get_lines()]
    assert "raceline, unscaled (the car does not follow the commands)" in labels


def test_long_names_leave_room_for_the_data(result):
    named = [(f"map_racing_2026-11-29-2{k}-03-56_second_heat", result) for k in range(3)]
    figure = plot_differences(named)
    figure.canvas.draw()
    for axes in figure.axes:
        assert axes.get_position().width > 0.8
        legend = axes.get_legend().get_window_extent()
        assert legend.x0 >= 0.0 and legend.x1 <= figure.bbox.x1


def test_without_commands_the_raceline_is_named_as_that(result):
    labels = [text.get_text() for text in plot_laps(result).axes[1].get_legend().get_texts()]
    assert labels[-1] == "raceline, unscaled (no commands recorded)"


def test_laps(tmp_path, result):
    figure = plot_laps(result)
    top, bottom = figure.axes
    # One line per valid lap, the best one on top, and the axis or the raceline.
    assert len(top.get_lines()) == 2 + 1
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
