"""Estimate of an unmeasured lateral velocity."""

import dataclasses
import math

import numpy as np
import pytest

from map_racing.control.sideslip import SideslipEstimate
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.tires import LinearTire, PacejkaTire


def test_it_is_that_of_the_steady_state():
    """At the rear axle, ``v_y = -v tan(s_r)`` with the slip for ``a = v r``."""
    car = load_vehicle("nuc4")
    for v, a in ((3.0, 2.0), (5.0, -6.0)):
        slip = float(car.rear.slip(abs(a) / (9.81 * car.mu)))
        expected = -v * math.copysign(math.tan(slip), a)
        assert SideslipEstimate(car, 0.0)(v, a / v) == pytest.approx(expected, rel=1e-3)
        center = SideslipEstimate(car, car.l_r)(v, a / v)
        assert center == pytest.approx(expected + car.l_r * a / v, rel=1e-3)


@pytest.mark.parametrize(
    "tire", [PacejkaTire(8.0, 1.0, 1.0, 0.0), LinearTire(2.0), PacejkaTire(1.5, 1.0, 3.3, -3.0)]
)
def test_it_rises_with_the_acceleration_on_tires_without_a_peak_too(tire):
    """Their slip is unbounded, and its tangent would change sign at 90 degrees."""
    car = dataclasses.replace(load_vehicle("nuc4"), front=tire, rear=tire)
    estimate = SideslipEstimate(car, 0.0)
    v_y = [estimate(5.0, a / 5.0) for a in np.linspace(0.0, 60.0, 500)]
    assert np.all(np.diff(v_y) <= 1e-9)
    assert -10.0 < v_y[-1] < -1.0
