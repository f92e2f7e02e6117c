"""Raceline files as other programs write them: speeds and walls are right, or a warning says why
not."""

import numpy as np
import pytest

from map_racing.track.files.checks import examine
from map_racing.track.files.load import read_raceline
from map_racing.track.findings import WARNING

N = 180
A = np.linspace(0.0, 2.0 * np.pi, N, endpoint=False)
X, Y = 7.0 * np.cos(A), 4.0 * np.sin(A) + 0.6 * np.sin(2.0 * A)
DX, DY = -7.0 * np.sin(A), 4.0 * np.cos(A) + 1.2 * np.cos(2.0 * A)
PSI = np.arctan2(DY, DX)
KAPPA = (DX * (-4.0 * np.sin(A) - 2.4 * np.sin(2.0 * A)) + DY * 7.0 * np.cos(A)) / (
    np.hypot(DX, DY) ** 3
)
V = np.minimum(np.sqrt(5.0 / np.abs(KAPPA)), 6.0)
RIGHT, LEFT = 1.0 + 0.1 * np.sin(A), 1.2 + 0.1 * np.cos(3.0 * A)
S = np.append(0.0, np.cumsum(np.hypot(np.diff(X), np.diff(Y))))
ZERO = 0.0 * A
HALF_SIN, HALF_COS = np.sin(0.5 * PSI), np.cos(0.5 * PSI)


def text(header, *columns, separator=","):
    lines = [separator.join(f"{value:.6f}" for value in row) for row in zip(*columns)]
    return "\n".join([header] * bool(header) + lines) + "\n"


@pytest.mark.parametrize(
    ("content", "speeds", "walls", "said"),
    [
        (text("pos_x;pos_y;velocity", X, Y, V, separator=";"), True, False, ""),
        (text("easting,northing,speed", 465e3 + X, 5e6 + Y, V), True, False, ""),
        (text("x,y,v_kmh", X, Y, 3.6 * V), True, False, ""),
        (text("x,y,speed(mph)", X, Y, V / 0.44704), True, False, ""),
        (text("x,y,v [cm/s]", X, Y, 100.0 * V), True, False, ""),
        (text("x_cm,y_cm,v", 100.0 * X, 100.0 * Y, V), True, False, ""),
        (text("x [m] y [m] v [m/s]", X, Y, V, separator=" "), True, False, ""),
        (text("# made today\n# x\ty\tv", X, Y, V, separator="\t"), True, False, ""),
        (text(",x,y,v", S, X, Y, V), True, False, ""),
        (text("x,y,left_bound,right_bound,v", X, Y, LEFT, RIGHT, V), True, True, ""),
        (text("x,y,track_width_left,track_width_right", X, Y, LEFT, RIGHT), False, True, ""),
        (text("X_m;Y_m;wl;wr;v", X, Y, LEFT, RIGHT, V, separator=";"), True, True, ""),
        (text("x,y,max_speed,speed", X, Y, ZERO + 8.0, V), True, False, "not used: max_speed"),
        (text("x,y,v,gear", X, Y, V, np.round(V / 3.0)), True, False, "not used: gear"),
        (text("x,y,throttle", X, Y, V / 6.0), False, False, "not used: throttle"),
        (text("x_m,y_m,psi_rad,vx_mps", X, Y, np.degrees(PSI), V), True, False, "in degrees"),
        (text("x,y,speed", X, Y, 3.6 * V), None, False, "in km/h?"),
        (text("x [px],y [px],v", 20.0 * X, 20.0 * Y, V), True, False, "such as m, got px"),
        (text("x,y,v", 20.0 * X, 20.0 * Y, V), True, False, "in meters, or in pixels?"),
        (text("", X, Y, V, PSI), True, False, "unnamed columns"),
        (text("", X, Y, ZERO, PSI, V), True, False, "unnamed columns"),
        (text("", X, Y, ZERO, V), True, False, "unnamed columns"),
        (text("", X, Y, ZERO, ZERO, ZERO, HALF_SIN, HALF_COS, V), True, False, "unnamed"),
        (text("", np.arange(N), X, Y, V), True, False, "unnamed columns"),
        (text("", S / 4.0, X, Y, V), True, False, "unnamed columns"),
        (text("", S, X, Y, PSI, KAPPA, V), True, False, "unnamed columns"),
        (text("", X, Y, np.degrees(PSI) % 360.0, V), True, False, "in degrees"),
        (text("", X, Y, V, RIGHT, LEFT), True, True, "unnamed columns"),
        (text("", X, Y, RIGHT, LEFT, V), True, True, "unnamed columns"),
        (text("", X, Y, np.cos(PSI), np.sin(PSI), V), True, False, "unnamed columns"),
    ],
)
def test_lines(tmp_path, content, speeds, walls, said):
    path = tmp_path / "line.csv"
    path.write_text(content)
    found = examine(read_raceline(path))
    line = found.raceline
    assert line is not None
    assert (line.speed is not None) == (speeds is not False)
    if speeds:
        assert [line.speed.min(), line.speed.max()] == pytest.approx([V.min(), V.max()], abs=1e-2)
    assert (line.d_left is not None) == walls
    if walls:
        assert line.d_left.mean() == pytest.approx(LEFT.mean(), abs=0.02)
        assert line.d_right.mean() == pytest.approx(RIGHT.mean(), abs=0.02)
    warnings = [finding.text for finding in found.findings if finding.severity == WARNING]
    assert bool(warnings) == bool(said) and (not said or any(said in w for w in warnings))
