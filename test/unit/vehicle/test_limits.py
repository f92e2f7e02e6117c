"""Limits of a vehicle for speed profiles."""

from dataclasses import replace

import numpy as np
import pytest

from map_racing.vehicle.grids import default_grid
from map_racing.vehicle.limits import speed_limits
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.steady_state import steady_state_table

NUC4 = load_vehicle("nuc4")
V = np.linspace(0.5, 8.0, 20)


def test_scales_and_the_lower_top_speed():
    table = steady_state_table(NUC4, *default_grid(NUC4, NUC4.v_max))
    limits = speed_limits(NUC4, lateral_scale=0.5, longitudinal_scale=0.8, v_max=1000.0)
    np.testing.assert_array_equal(limits["a_lat_max"](V), 0.5 * table.max_lateral_acceleration(V))
    assert limits["a_drive_max"] == 0.8 * NUC4.a_max
    assert limits["a_brake_max"] == 0.8 * NUC4.a_brake_max
    assert limits["v_max"] == NUC4.v_max
    for v_max in (3.0, 0.0):
        assert speed_limits(NUC4, table, v_max=v_max)["v_max"] == v_max


@pytest.mark.once
def test_a_car_faster_than_any_table():
    limits, ordinary = speed_limits(replace(NUC4, v_max=120.0)), speed_limits(NUC4)
    assert limits["v_max"] == 120.0
    assert limits["a_lat_max"](110.0) == pytest.approx(ordinary["a_lat_max"](15.0), rel=1e-3)


def test_power_limits_driving_at_high_speed_only():
    power = NUC4.m * NUC4.a_max * 4.0
    drive = speed_limits(NUC4, power=power)["a_drive_max"]
    np.testing.assert_array_equal(drive(np.array([0.0, 2.0, 4.0])), NUC4.a_max)
    assert drive(8.0) == pytest.approx(power / (NUC4.m * 8.0))
