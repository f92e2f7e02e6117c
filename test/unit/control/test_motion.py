import math

import pytest

from map_racing.control.motion import MotionEstimate


def circle(t, radius, rate):
    angle = rate * t
    return (
        radius * math.cos(angle),
        radius * math.sin(angle),
        math.remainder(angle + math.copysign(0.5 * math.pi, rate), math.tau),
    )


@pytest.mark.parametrize("rate", [2.0, -2.0])
def test_circle(rate):
    estimate = MotionEstimate()
    for k in range(200):
        t = 1000.0 + 0.025 * k
        motion = estimate.update(t, *circle(t, 2.0, rate))
        if k > 1:
            # The chords within a window of 0.2 rad are 0.3 % shorter than the arc.
            assert motion.v_x == pytest.approx(4.0, rel=5e-3)
            assert motion.r == pytest.approx(rate, rel=1e-6)
            assert math.isnan(motion.v_y)


def test_backwards_is_negative():
    estimate = MotionEstimate()
    estimate.update(0.0, 0.0, 0.0, 0.3)
    motion = estimate.update(0.1, -0.1 * math.cos(0.3), -0.1 * math.sin(0.3), 0.3)
    assert motion.v_x == pytest.approx(-1.0)


def test_one_pose_the_same_stamp_and_time_set_back():
    estimate = MotionEstimate()
    assert estimate.update(5.0, 1.0, 0.0, 0.0)[::2] == (0.0, 0.0)
    assert estimate.update(5.0, 2.0, 0.0, 0.0)[::2] == (0.0, 0.0)
    assert estimate.update(5.5, 2.0, 0.0, 0.0).v_x == pytest.approx(2.0)
    assert estimate.update(1.0, 9.0, 0.0, 0.0)[::2] == (0.0, 0.0)


def test_a_pose_that_is_not_finite_is_left_out():
    estimate = MotionEstimate()
    estimate.update(0.0, 0.0, 0.0, 0.0)
    before = estimate.update(0.1, 0.2, 0.0, 0.0)
    assert estimate.update(0.15, math.nan, 0.0, 0.0)[::2] == before[::2]
    assert estimate.update(0.2, 0.4, 0.0, 0.0).v_x == pytest.approx(2.0)


def test_a_slow_localization_still_gives_a_velocity():
    estimate = MotionEstimate()
    for k in range(5):
        motion = estimate.update(0.5 * k, 0.5 * k, 0.0, 0.0)
    assert motion.v_x == pytest.approx(1.0)


def test_what_is_older_than_the_window_is_forgotten():
    estimate = MotionEstimate()
    x, motions = 0.0, {}
    for k in range(40):
        x += 0.025 * (1.0 if k <= 20 else 3.0)
        motions[k] = estimate.update(0.025 * k, x, 0.0, 0.0)
    assert motions[20].v_x == pytest.approx(1.0)
    assert 1.1 < motions[23].v_x < 2.9
    assert motions[24].v_x == pytest.approx(3.0)
