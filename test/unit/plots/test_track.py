"""Every map shows the start of the lap, its direction and distances."""

import math

import numpy as np
import pytest

from map_racing.plots.style import DEVIATION, new_figure
from map_racing.plots.track import draw_map, draw_track
from map_racing.track.map_image import MapImage
from map_racing.track.raceline import Raceline


def circle(radius=6.0, clockwise=False, **columns):
    phi = 2.0 * np.pi * np.arange(120) / 120
    phi = -phi if clockwise else phi
    return Raceline(radius * np.cos(phi), radius * np.sin(phi), **columns)


def drawn(line, *arguments):
    axes = new_figure(6.0, 6.0).add_subplot(1, 1, 1)
    draw_track(axes, line, *arguments)
    return axes


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("walls", [None, 0.8])
def test_marks_and_arrows_are_outside_and_in_order(clockwise, walls):
    columns = {} if walls is None else {"d_left_m": [walls] * 120, "d_right_m": [walls] * 120}
    axes = drawn(circle(clockwise=clockwise, **columns), 3.0)
    texts = [text for text in axes.texts if text.get_text()]
    assert [text.get_text() for text in texts] == [f"{5 * i} m" for i in range(8)]
    outside = 6.0 + (walls or 0.0)
    turn = -1.0 if clockwise else 1.0
    for text, distance in zip(texts, range(0, 40, 5)):
        x, y = text.get_position()
        assert outside < math.hypot(x, y) < outside + 1.0
        at = turn * (3.0 + distance) / 6.0
        assert (x, y) == pytest.approx(
            (math.hypot(x, y) * math.cos(at), math.hypot(x, y) * math.sin(at)), abs=0.01
        )
    arrows = [text for text in axes.texts if not text.get_text()]
    assert len(arrows) >= 3
    for arrow in arrows:
        (x0, y0), (x1, y1) = arrow.xyann, arrow.xy
        assert turn * (x0 * y1 - y0 * x1) > 0.0
        assert min(math.hypot(x0, y0), math.hypot(x1, y1)) > outside


@pytest.mark.parametrize("radius, step", [(0.4, 0.5), (1.0, 1.0), (80.0, 50.0), (3000.0, 2000.0)])
def test_marks_are_round_and_few_at_any_size(radius, step):
    axes = drawn(circle(radius))
    marks = [float(text.get_text()[:-2]) for text in axes.texts if text.get_text()]
    assert marks == pytest.approx([step * i for i in range(len(marks))])
    assert 4 <= len(marks) <= 13


def test_the_start_line_has_no_color_of_an_error_and_the_raceline_lies_beneath():
    axes = drawn(circle())
    by_label = {line.get_label(): line for line in axes.lines}
    assert by_label["start line"].get_color() == "k"
    assert all(max(DEVIATION(x)[:3]) > 0.5 for x in np.linspace(0.0, 1.0, 11))
    assert by_label["raceline"].get_zorder() < 3


@pytest.mark.parametrize("yaw", [0.0, 0.7])
def test_a_map_lies_where_its_cells_are(yaw):
    """A wall of 0.5 m in an otherwise free map is gray at its place, also on a turned map."""
    free = np.ones((200, 240), dtype=bool)
    image = MapImage(free, 0.05, (-4.0, -5.0, yaw), "hall.yaml", ())
    cells = np.array([[c, r] for c in range(150, 160) for r in range(100, 110)])
    free[cells[:, 1], cells[:, 0]] = False
    figure = new_figure(6.0, 6.0)
    axes = figure.add_subplot(1, 1, 1)
    (x, y), (far_x, far_y) = image.to_world([[154.5, 104.5], [100.0, 60.0]])
    axes.set_xlim(min(x, far_x) - 1.0, max(x, far_x) + 1.0)
    axes.set_ylim(min(y, far_y) - 1.0, max(y, far_y) + 1.0)
    limits = axes.get_xlim(), axes.get_ylim()
    draw_map(axes, image)
    assert (axes.get_xlim(), axes.get_ylim()) == limits
    axes.axis("off")
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[::-1]
    assert shade(axes, pixels, x, y) < 0.9 < shade(axes, pixels, far_x, far_y)
    dx, dy = image.to_world([[162.0, 104.5]])[0] - (x, y)
    assert shade(axes, pixels, x + dx, y + dy) > 0.9


def shade(axes, pixels, x, y):
    column, row = axes.transData.transform((x, y))
    return pixels[int(row), int(column), 0] / 255.0
