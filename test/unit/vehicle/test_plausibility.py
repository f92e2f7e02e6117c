"""Values in wrong units are recognized by the size of the car."""

import dataclasses

import numpy as np
import pytest
import yaml

from map_racing.errors import ParameterError
from map_racing.vehicle.grids import published_grid
from map_racing.vehicle.lookup import LookupTable, load_table
from map_racing.vehicle.parameters import linearized, load_vehicle, vehicle_values
from map_racing.vehicle.plausibility import (
    doubts_of_cells,
    doubts_of_peak,
    doubts_of_table,
    friction_doubt,
)
from map_racing.vehicle.steady_state import steady_state_table

SMALL = vehicle_values(load_vehicle("sim"))
LARGE = vehicle_values(load_vehicle("bmw_320i"))
VAN = {**LARGE, "m": 3000.0, "I_z": 7500.0, "l_f": 1.6, "l_r": 1.8, "h_cg": 0.9, "width": 2.0}
VAN.update(length=6.0, a_brake_max=4.0)
FORMULA = {**LARGE, "m": 800.0, "I_z": 1000.0, "l_f": 1.9, "l_r": 1.7, "h_cg": 0.3, "width": 2.0}
KART = {**LARGE, "m": 180.0, "I_z": 22.0, "l_f": 0.6, "l_r": 0.45, "h_cg": 0.2, "width": 1.3}
KART.update(length=1.9, a_brake_max=4.0)
MODEL = {**SMALL, "m": 0.041, "I_z": 2.8e-5, "l_f": 0.029, "l_r": 0.033, "h_cg": 0.01}
MODEL.update(width=0.05, length=0.11)


@pytest.fixture
def load(tmp_path):
    def load(values, **changes):
        path = tmp_path / "car.yaml"
        path.write_text(yaml.safe_dump({**values, **changes}), encoding="utf-8")
        return load_vehicle(path)

    return load


@pytest.mark.parametrize("values", [SMALL, LARGE, VAN, FORMULA, KART, MODEL])
def test_cars_of_any_size_are_plausible(load, values):
    assert load(values).notes == ()


@pytest.mark.parametrize("car", [SMALL, LARGE])
@pytest.mark.parametrize(
    "field, unit, factor",
    [
        ("m", "g", 1e3),
        ("I_z", "g m^2", 1e3),
        ("I_z", "kg cm^2", 1e4),
        ("l_f", "mm", 1e3),
        ("l_r", "cm", 1e2),
        ("width", "mm", 1e3),
        ("length", "cm", 1e2),
    ],
)
def test_another_unit_is_refused_with_file_field_value_and_expectation(
    load, tmp_path, car, field, unit, factor
):
    value = car[field] * factor
    with pytest.raises(ParameterError) as caught:
        load(car, **{field: value})
    text = str(caught.value)
    assert text.startswith(f"{tmp_path / 'car.yaml'}: ") and f"{value:g}" in text
    # An axle distance in wrong units makes the wheelbase, or its share of it, impossible.
    assert field in text and "expected" in text
    assert field in ("l_f", "l_r") or f"in {unit}?" in text


@pytest.mark.parametrize("factor", [1e2, 1e3])
@pytest.mark.parametrize("car", [SMALL, LARGE])
def test_geometry_in_another_unit_throughout(load, car, factor):
    lengths = {key: car[key] * factor for key in ("l_f", "l_r", "h_cg", "width", "length")}
    with pytest.raises(ParameterError, match=r"l_f \+ l_r: expected 0.05 to 7 m, got"):
        load(car, **lengths)


@pytest.mark.parametrize("value", [74.0, 7.4])
def test_the_height_in_another_unit(load, value):
    with pytest.raises(ParameterError, match="h_cg: expected at most the wheelbase, 0.3302 m, got"):
        load(SMALL, h_cg=value)


def test_a_tire_whose_numbers_stand_in_another_order_is_doubted(tmp_path):
    """On one axle only: the other axle keeps the car within plausible grip."""
    lines = {"m": 3.54, "I_z": 0.06, "l_f": 0.162, "l_r": 0.145, "h_cg": 0.014, "mu": 1.0}
    lines.update(C_Pf=[0.65, 2.2, 4.8, 0.37], C_Pr=[20.0, 1.5, 0.6, 0.0])
    path = tmp_path / "car.yaml"
    path.write_text(yaml.safe_dump(lines))
    (note,) = load_vehicle(path).notes
    assert note == "warning: front tire: friction: expected 0.1 to 2.5, got 4.8"


def test_stiffness_and_shape_of_a_tire_exchanged_are_doubted(tmp_path):
    path = tmp_path / "car.yaml"
    lines = {**vehicle_values(load_vehicle("nuc4")), "C_Pf": [2.2, 4.8, 0.65, 0.37]}
    path.write_text(yaml.safe_dump(lines))
    assert load_vehicle(path).notes == ("warning: front tire: C: expected 0.3 to 3, got 4.8",)


def test_the_friction_of_a_tire_with_a_peak_is_a_product():
    nuc4 = load_vehicle("nuc4")
    (doubt,) = friction_doubt(dataclasses.replace(nuc4, mu=2.226))
    assert doubt.startswith("friction (mu times D): expected 0.1 to 1.3 ")
    assert doubt.endswith("got 1.6")


@pytest.mark.parametrize(
    "car, changes, expected",
    [
        (SMALL, {"delta_rate_max": 183.0}, "delta_rate_max: expected 0.1 to 20 rad/s, wheelbase"),
        (LARGE, {"delta_rate_max": 23.0}, "delta_rate_max: expected 0.1 to 7 rad/s"),
        (SMALL, {"v_max": 54.0}, "v_max: expected 0.5 to 40 m/s"),
        (LARGE, {"v_max": 180.0}, "v_max: expected 1.4 to 110 m/s"),
        (SMALL, {"mu": 1.5}, "friction: expected 0.1 to 1.3"),
        (SMALL, {"C_Sf": 270.0}, "front tire: cornering stiffness over load: expected 1 to 100"),
        (
            SMALL,
            {"C_Sf": 80.0, "C_Sr": 90.0},
            "softer axle: cornering stiffness over load: expected",
        ),
        (SMALL, {"C_Sr": 0.1}, "rear tire: cornering stiffness over load: expected 1 to 100"),
        (LARGE, {"width": 0.296}, "width: expected 0.64 to 4.1 m, wheelbase 2.58 m, got 0.296"),
        (SMALL, {"m": 0.3}, "m: expected 0.36 to 18 kg, wheelbase 0.33 m, got 0.3"),
    ],
)
def test_unusual_values_are_doubted(load, car, changes, expected):
    note = load(car, **changes).notes[0]
    assert note.startswith(f"warning: {expected}")


@pytest.mark.parametrize(
    "field, value, expected",
    [
        ("m", 3.47e-3, "in t?"),
        ("mu", 85.0, "in percent?"),
        ("delta_max", 24.0, "delta_max: expected less than pi/2 rad, got 24"),
    ],
)
def test_values_that_are_certainly_wrong(load, field, value, expected):
    with pytest.raises(ParameterError) as caught:
        load(SMALL, **{field: value})
    assert expected in str(caught.value)


@pytest.mark.parametrize(
    "speed, angle, a_lat, said",
    [
        (1.0, 1.0, 1.0, ""),
        (3.6, 1.0, 1.0, "a wheelbase of 4.28 m"),
        (1.0, 2.0, 1.0, "a wheelbase of 0.66"),
        (1.0, 1.0, 1.0 / 9.80665, "a wheelbase of 3.2"),
    ],
    ids=["SI", "km/h", "twice the angle", "g"],
)
def test_tables_in_other_units_are_doubted(speed, angle, a_lat, said):
    car = load_vehicle("sim")
    own = steady_state_table(car, np.linspace(0.5, 7.0, 20), np.linspace(0.0, 0.4, 41))
    other = LookupTable(speed * own.speeds, angle * own.angles, a_lat * own.a_lat)
    doubts = doubts_of_table(other, car)
    assert bool(doubts) == bool(said) and said in "".join(doubts)


def test_the_provenance_of_another_table_is_doubted():
    car = load_vehicle("nuc4")
    table, longer = (
        steady_state_table(one, *published_grid())
        for one in (car, dataclasses.replace(car, l_f=0.3, l_r=0.3))
    )
    assert doubts_of_table(table, car) == []
    swapped = LookupTable(table.speeds, table.angles, table.a_lat, longer.provenance)
    (doubt,) = doubts_of_table(swapped, car)
    assert "fit a wheelbase of 0.307 m, but the .meta.yaml beside it has 0.6 m" in doubt


def test_a_table_that_was_cut_off_is_doubted():
    car = load_vehicle("sim")
    own = steady_state_table(car, np.linspace(0.5, 7.0, 20), np.linspace(0.0, 0.1, 41))
    (doubt,) = doubts_of_table(own, car)
    assert doubt == (
        "lookup table: ends at a steering angle of 0.1 rad, but SIM steers up to 0.419 rad"
    )


def test_published_tables_are_of_their_cars(shared_data):
    for car, table in (("NUC4_pacejka.txt", "NUC4_pacejka"), ("SIM_linear.txt", "SIM_linear")):
        path = shared_data / "vehicles" / f"{table}_lookup_table.csv"
        assert doubts_of_table(load_table(path), load_vehicle(shared_data / "vehicles" / car)) == []


@pytest.mark.parametrize(
    "rows, columns, value, said",
    [
        ((), (), 1.0, ""),
        (5, slice(None), 2.0, "cells at 0.05 rad: 2 times the neighbors"),
        (slice(None), 11, 0.5, "cells at 4.84211 m/s: 0.5 times the neighbors"),
        (10, 11, 1.5, "cell at 4.84211 m/s and 0.1 rad: 1.5 times the neighbors"),
        (3, 11, np.nan, "cell at 4.84211 m/s and 0.03 rad: nan between valid cells"),
        (3, 11, -1.0, "cell at 4.84211 m/s and 0.03 rad: -0.9"),
    ],
)
def test_cells_that_do_not_fit_those_beside_them_are_doubted(rows, columns, value, said):
    speeds, angles = np.linspace(0.5, 8.0, 20), np.linspace(0.0, 0.4, 41)
    car = load_vehicle("nuc4")
    cells = steady_state_table(car, speeds, angles).a_lat.copy()
    cells[rows, columns] *= value
    doubts = doubts_of_table(LookupTable(speeds, angles, cells), car)
    assert len(doubts) == bool(said) and said in "".join(doubts)


@pytest.mark.parametrize("car", ["nuc4", "sim", "bmw_320i"])
@pytest.mark.parametrize("step", [0.1, 2.0])
def test_cells_of_any_grid_fit_those_beside_them(car, step):
    """As in tables computed or measured in few steps, for tires with and without a peak."""
    vehicle = load_vehicle(car)
    for angles in (np.linspace(0.0, 0.4, 5), np.linspace(0.0, 0.4, 60)):
        own = steady_state_table(vehicle, np.arange(1.0, 9.1, step), angles)
        assert doubts_of_cells(own) == []


def test_a_table_of_linear_tires_is_doubted_for_a_car_whose_tires_have_a_peak():
    car = load_vehicle("nuc4")
    speeds, angles = np.linspace(0.5, 7.0, 20), np.linspace(0.0, 0.4, 41)
    table = steady_state_table(linearized(car), speeds, angles)
    (doubt,) = doubts_of_table(table, car)
    assert "but the tires of NUC4 only 7.06 m/s^2: made for other tires, or linear" in doubt
    assert doubts_of_table(table, linearized(car)) == []


@pytest.mark.parametrize("grip, said", [(1.0, False), (2.5, True)])
def test_a_table_whose_peak_no_rubber_has_is_doubted(grip, said):
    """Also without the vehicle; linear tires, which have no peak, give no warning."""
    car = load_vehicle("nuc4")
    speeds, angles = np.linspace(0.5, 9.0, 20), np.linspace(0.0, 0.4, 41)
    own = steady_state_table(car, speeds, angles)
    table = LookupTable(speeds * grip**0.5, angles, grip * own.a_lat)
    assert bool(doubts_of_peak(table)) == said
    assert bool(doubts_of_table(table, car)) == said
    if said:
        assert "its peak takes a friction of 1.8" in doubts_of_peak(table)[0]
    linear = steady_state_table(load_vehicle("sim"), speeds, angles)
    assert np.nanmax(linear.a_lat) > 20.0 and doubts_of_peak(linear) == []
