"""Angles: one value per direction, and the yaw of a quaternion."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.angles import wrap, yaw_from_quaternion


@settings(deadline=None)
@given(angle=st.floats(-100.0, 100.0))
def test_wrap_keeps_the_direction(angle):
    wrapped = wrap(angle)
    assert -math.pi <= wrapped < math.pi
    assert math.cos(wrapped - angle) == pytest.approx(1.0, abs=1e-12)
    assert math.sin(wrapped - angle) == pytest.approx(0.0, abs=1e-12)


def test_wrap_takes_pi_to_minus_pi():
    assert wrap(math.pi) == -math.pi
    assert wrap(-math.pi) == -math.pi
    assert wrap(3.0 * math.pi) == -math.pi


@pytest.mark.parametrize("angle", [-1e-17, -1e-16, -math.pi - 1e-16, 1e-17])
def test_wrap_leaves_the_open_end_open_under_rounding(angle):
    assert -math.pi <= wrap(angle) < math.pi


def test_wrap_works_on_arrays_of_any_shape():
    angles = np.array([[0.0, 4.0], [-4.0, 2.0 * math.pi]])
    expected = [[0.0, 4.0 - 2.0 * math.pi], [2.0 * math.pi - 4.0, 0.0]]
    np.testing.assert_allclose(wrap(angles), expected, atol=1e-15)


@settings(deadline=None)
@given(yaw=st.floats(-3.14, 3.14))
def test_yaw_of_a_rotation_about_the_vertical(yaw):
    found = yaw_from_quaternion(0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw))
    assert found == pytest.approx(yaw, abs=1e-12)


@settings(deadline=None)
@given(yaw=st.floats(-3.1, 3.1), pitch=st.floats(-1.4, 1.4), roll=st.floats(-3.1, 3.1))
def test_yaw_of_a_car_that_pitches_and_rolls(yaw, pitch, roll):
    """Z-Y-X Euler angles: first roll, then pitch, then yaw."""
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    found = yaw_from_quaternion(
        sr * cp * cy - cr * sp * sy,
        cr * sp * cy + sr * cp * sy,
        cr * cp * sy - sr * sp * cy,
        cr * cp * cy + sr * sp * sy,
    )
    assert math.remainder(found - yaw, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-9)


@settings(deadline=None)
@given(yaw=st.floats(-3.14, 3.14))
def test_a_quaternion_and_its_negative_are_the_same_rotation(yaw):
    z, w = math.sin(0.5 * yaw), math.cos(0.5 * yaw)
    assert yaw_from_quaternion(0.0, 0.0, -z, -w) == yaw_from_quaternion(0.0, 0.0, z, w)


@settings(deadline=None)
@given(yaw=st.floats(-3.14, 3.14), length=st.floats(0.01, 100.0))
def test_the_length_of_a_quaternion_does_not_matter(yaw, length):
    z, w = length * math.sin(0.5 * yaw), length * math.cos(0.5 * yaw)
    assert yaw_from_quaternion(0.0, 0.0, z, w) == pytest.approx(yaw, abs=1e-12)
