import numpy as np
import pytest

from map_racing.control.speed_plan import scaled_speed
from map_racing.control.speed_sectors import SpeedSectors
from map_racing.errors import ParameterError
from map_racing.track.files.waypoints import waypoint_rows
from map_racing.track.raceline import Raceline

ANGLE = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)


def circle(radius=5.0, speed=3.0):
    return Raceline(
        radius * np.cos(ANGLE),
        radius * np.sin(ANGLE),
        vx_mps=None if speed is None else np.full(ANGLE.size, speed),
        d_left_m=np.full(ANGLE.size, 1.0),
        d_right_m=np.full(ANGLE.size, 2.0),
    )


def test_rows_of_a_circle():
    rows = waypoint_rows(circle(), spacing=0.5)
    s, d, x, y, right, left, psi, kappa, v, a_x = (rows[name] for name in rows.dtype.names)
    # 31.42 m in steps of about half a meter that divide it.
    assert len(rows) == 63 and np.ptp(np.diff(s)) < 1e-12
    assert np.hypot(x, y) == pytest.approx(np.full(63, 5.0), abs=1e-5)
    assert kappa == pytest.approx(np.full(63, 0.2), abs=1e-4)
    # The heading is a quarter turn ahead of the angle.
    assert np.cos(psi - np.arctan2(y, x)) == pytest.approx(np.zeros(63), abs=1e-4)
    assert (set(d), set(right), set(left), set(v), set(a_x)) == ({0.0}, {2.0}, {1.0}, {3.0}, {0.0})


def test_what_is_missing_is_zero():
    rows = waypoint_rows(Raceline(np.cos(ANGLE), np.sin(ANGLE)))
    for name in ("d_m", "d_right", "d_left", "vx_mps", "ax_mps2"):
        assert not rows[name].any()


def test_acceleration_is_constant_between_waypoints():
    raceline = circle()
    length = raceline.length
    rows = waypoint_rows(raceline, speed=lambda s: 3.0 + np.sin(2.0 * np.pi * s / length))
    s, v, a_x = rows["s_m"], rows["vx_mps"], rows["ax_mps2"]
    assert v[:-1] ** 2 + 2.0 * a_x[:-1] * np.diff(s) == pytest.approx(v[1:] ** 2)
    assert np.sum(a_x) == pytest.approx(0.0, abs=1e-9)


def test_scale_and_sectors_multiply():
    raceline = circle()
    sectors = SpeedSectors([(10.0, 20.0, 0.5)], raceline.length)
    speed = scaled_speed(raceline, 0.8, sectors)
    assert speed(np.array([5.0, 15.0])) == pytest.approx([2.4, 1.2])


@pytest.mark.parametrize("scale", [-0.1, np.nan, np.inf])
def test_impossible_scales_are_refused(scale):
    with pytest.raises(ParameterError, match="speed_scale: expected a scale from 0 to 2"):
        scaled_speed(circle(), scale)


def test_a_scale_needs_speeds():
    with pytest.raises(ParameterError, match="expected speeds, got none"):
        scaled_speed(circle(speed=None))
