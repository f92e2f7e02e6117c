"""The figure of an optimized line shows its components."""

import numpy as np
import pytest

from map_racing.plots.optimization import plot_optimized
from map_racing.plots.style import save
from map_racing.track.files.load import load_raceline
from map_racing.track.map_image import MapImage
from map_racing.track.raceline import Raceline
from map_racing.track.walls import Walls


@pytest.mark.parametrize(
    "track, wide",
    [
        ("reference", False),
        pytest.param("club", True, marks=pytest.mark.once),
        pytest.param("reference", True, marks=pytest.mark.once),
        pytest.param("club", False, marks=pytest.mark.once),
    ],
)
def test_line_walls_curvature_and_speed(tmp_path, track, wide):
    line = load_raceline(track)
    if not wide:  # a tall track has its curves beside it
        line = Raceline(
            *(-line.y, line.x), vx_mps=line.speed, d_left_m=line.d_left, d_right_m=line.d_right
        )
    middle = Raceline(line.x, line.y, d_left_m=line.d_left, d_right_m=line.d_right)
    figure = plot_optimized(line, middle, Walls(line))
    track, bends, speeds = figure.axes[:3]
    assert track.get_title() == (line.name or "optimized line")
    path = track.collections[-1]
    np.testing.assert_allclose(path.get_array(), line.speed)
    assert [len(axes.lines) for axes in (bends, speeds)] == [3, 1]
    for axes, values in ((bends, line.kappa), (speeds, line.speed)):
        drawn = axes.lines[-2 if axes is bends else -1]
        np.testing.assert_allclose(drawn.get_xdata(), line.s)
        np.testing.assert_allclose(drawn.get_ydata(), values)
    assert speeds.get_xlabel() == "distance along the optimized line [m]"
    save(figure, tmp_path / "figure.png")
    renderer = figure.canvas.get_renderer()
    for axes in figure.axes:  # nothing is cut off
        box = axes.get_tightbbox(renderer)
        assert box.x0 >= 0.0 and box.y0 >= 0.0
        assert box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1
    assert (tmp_path / "figure.png").stat().st_size > 20000


def test_the_middle_line_stands_where_it_is_beside_the_line():
    """The middle of a bend is at the same place in both, although the middle line is longer."""
    line = load_raceline("club")
    wide = Raceline(*line.to_cartesian(line.s, np.full(line.n, -1.2)))
    figure = plot_optimized(line, wide, Walls(line))
    middle, optimized = figure.axes[1].lines[:2]
    bend = np.argmax(line.kappa)
    assert optimized.get_xdata()[bend] == line.s[bend]
    at = middle.get_xdata()
    assert np.all(np.diff(at) >= 0.0) and at[0] >= 0.0 and at[-1] <= line.length
    # A curve 1.2 m farther out turns as much over the same stretch of the line.
    expected = line.sample(at).kappa / (1.0 + 1.2 * line.sample(at).kappa)
    np.testing.assert_allclose(middle.get_ydata(), expected, atol=0.01)


def test_the_map_lies_beneath():
    line = load_raceline("reference")
    image = MapImage(np.ones((400, 500), dtype=bool), 0.05, (-8.0, -5.0, 0.1), "hall.yaml", ())
    with_map, without = (plot_optimized(line, line, Walls(line), image=i) for i in (image, None))
    assert len(with_map.axes[0].images) == 1 and not without.axes[0].images
    assert with_map.axes[0].images[0].get_zorder() == 0
    assert with_map.axes[0].get_xlim() == without.axes[0].get_xlim()
