"""The figure of an optimized line shows what it is made of."""

import numpy as np
import pytest

from map_racing.plots.optimization import plot_optimized
from map_racing.plots.style import save
from map_racing.track.files.load import load_raceline
from map_racing.track.raceline import Raceline
from map_racing.track.walls import Walls


@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("track", ["reference", "club"])
def test_line_walls_curvature_and_speed(tmp_path, track, wide):
    line = load_raceline(track)
    if not wide:  # a track higher than wide has its curves beside it
        line = Raceline(
            *(-line.y, line.x), vx_mps=line.speed, d_left_m=line.d_left, d_right_m=line.d_right
        )
    middle = Raceline(line.x, line.y, d_left_m=line.d_left, d_right_m=line.d_right)
    figure = plot_optimized(line, middle, Walls(line), title="t")
    track, bends, speeds = figure.axes[:3]
    assert track.get_title() == "t"
    path = track.collections[-1]
    np.testing.assert_allclose(path.get_array(), line.speed)
    assert [len(axes.lines) for axes in (bends, speeds)] == [3, 1]
    np.testing.assert_allclose(bends.lines[1].get_ydata(), line.kappa)
    np.testing.assert_allclose(speeds.lines[0].get_ydata(), line.speed)
    save(figure, tmp_path / "figure.png")
    renderer = figure.canvas.get_renderer()
    for axes in figure.axes:  # nothing is cut off
        box = axes.get_tightbbox(renderer)
        assert box.x0 >= 0.0 and box.y0 >= 0.0
        assert box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1
    assert (tmp_path / "figure.png").stat().st_size > 20000
