"""The figure of a checked track."""

import math

import numpy as np

from map_racing.plots.racelines import plot_raceline
from map_racing.plots.style import save
from map_racing.track.files.checks import examine
from map_racing.track.files.table import RacelineTable

T = np.arange(200) * 2.0 * math.pi / 200
X, Y = 5.0 * np.cos(T), 3.0 * np.sin(T)


def drawn(tmp_path, **columns):
    table = RacelineTable({"x": X, "y": Y, **columns}, "oval")
    raceline, findings = examine(table)
    figure = plot_raceline(table, raceline, findings)
    save(figure, tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    return figure, findings


def test_marks_stand_where_findings_do(tmp_path):
    left = np.where(np.arange(200) == 30, -0.2, 0.5)
    figure, findings = drawn(tmp_path, d_left=left, d_right=0.0 * X + 0.5, speed=0.0 * X + 2.0)
    axes = figure.axes[0]
    assert axes.get_title() == "oval"
    place = findings[0].places[0]
    marks = [line.get_xydata() for line in axes.lines if len(line.get_xydata()) == 1]
    assert any(np.allclose(mark, [[place.x, place.y]]) for mark in marks)
    numbers = {text.get_text() for text in axes.texts}
    assert {"1", "0 m", "5 m"} <= numbers
    assert str(findings[0]).split(",")[0] in " ".join(
        text.get_text().replace("\n", " ") for text in figure.texts
    )
    assert figure.axes[1].get_ylabel() == "speed [m/s]"


def test_a_track_that_makes_no_curve(tmp_path):
    figure, findings = drawn(tmp_path, x=np.where(T > 3.0, math.nan, X))
    assert [finding.code for finding in findings] == ["not-finite"]
    assert {text.get_text() for text in figure.axes[0].get_legend().get_texts()} == {
        "points",
        "first point",
    }
    drawn(tmp_path, x=0.0 * X * math.nan)


def test_nothing_noticed(tmp_path):
    figure, findings = drawn(tmp_path)
    assert findings == () and "nothing noticed" in [text.get_text() for text in figure.texts]
