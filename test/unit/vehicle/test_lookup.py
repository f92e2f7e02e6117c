"""Table lookup: exact at nodes, monotone, odd, defined everywhere; and its files."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.errors import FileFormatError, MapRacingError, ParameterError
from map_racing.vehicle.grids import default_grid, published_grid
from map_racing.vehicle.lookup import LookupTable, Provenance, load_table
from map_racing.vehicle.parameters import linearized, load_vehicle
from map_racing.vehicle.steady_state import steady_state_table

NUC4 = load_vehicle("nuc4")
OVERSTEER = dataclasses.replace(NUC4, name="oversteer", front=NUC4.rear, rear=NUC4.front)
SPEEDS = np.linspace(0.5, 7.0, 65)
# the published angles, of which one repeats
ANGLES = np.r_[np.linspace(0.0, 0.1, 30), np.linspace(0.1, 0.4, 30)]
TABLES = {
    car.name: steady_state_table(car, SPEEDS, ANGLES) for car in (NUC4, linearized(NUC4), OVERSTEER)
}
TABLE = TABLES["NUC4"]

META = "vehicle: NUC4\ntire_model: linear\nparameter_hash: abc\nl_wb: 0.32\ngenerator: a program\n"

any_table = pytest.mark.parametrize("table", TABLES.values(), ids=TABLES)
speeds = st.one_of(st.floats(-20.0, 20.0), st.floats(0.0, 1e300), st.sampled_from(SPEEDS.tolist()))
accelerations = st.floats(-15.0, 15.0)


def rising_cells(table):
    """Row, column, up to the largest acceleration of each column."""
    for j in np.flatnonzero(np.isfinite(table.a_lat[0])):
        column = table.a_lat[:, j]
        for i in range(1, int(np.nanargmax(column)) + 1):
            if column[i] > np.nanmax(column[:i]):
                yield i, j


@any_table
def test_nodes_are_exact(table):
    for i, j in rising_cells(table):
        v, a_lat, delta = table.speeds[j], table.a_lat[i, j], table.angles[i]
        assert table.steering(v, a_lat) == (pytest.approx(delta, abs=1e-12), False)
        assert table.steering(v, -a_lat)[0] == -table.steering(v, a_lat)[0]


@any_table
@settings(deadline=None)
@given(v=speeds, a_lat=accelerations)
def test_odd_in_acceleration_and_even_in_speed(table, v, a_lat):
    delta, saturated = table.steering(v, a_lat)
    assert table.steering(v, -a_lat) == (-delta, saturated)
    assert table.steering(-v, a_lat) == (delta, saturated)


@any_table
@settings(deadline=None)
@given(v=speeds, first=accelerations, second=accelerations)
def test_monotone_in_acceleration(table, v, first, second):
    low, high = sorted((first, second))
    assert table.steering(v, low)[0] <= table.steering(v, high)[0] + 1e-15


@any_table
@settings(deadline=None)
@given(v=st.one_of(st.floats(1e-3, 12.0), st.sampled_from(SPEEDS.tolist())), a_lat=accelerations)
def test_continuous_in_speed(table, v, a_lat):
    here = table.steering(v, a_lat)[0]
    for toward in (0.0, math.inf):
        neighbor = float(np.nextafter(v, toward))
        assert table.steering(neighbor, a_lat)[0] == pytest.approx(here, abs=1e-9)


@any_table
@settings(deadline=None)
@given(v=st.floats(1e-3, 20.0), excess=st.floats(1.001, 10.0))
def test_beyond_the_limit_it_saturates_at_the_angle_of_the_limit(table, v, excess):
    limit = table.max_lateral_acceleration(v)
    at_limit, within = table.steering(v, limit)
    assert not within
    delta, saturated = table.steering(v, limit * excess)
    assert saturated
    assert delta == pytest.approx(at_limit, abs=1e-9)


@any_table
@pytest.mark.parametrize("v", [0.0, 1e-9, 0.1, 0.5, 3.3, 7.0, 30.0])
def test_no_dead_band_and_nothing_at_zero(table, v):
    assert table.steering(v, 0.0) == (0.0, False)
    assert table.steering(v, 1e-9)[0] > 0.0


def test_at_rest_every_acceleration_is_too_much():
    assert TABLE.steering(0.0, 1e-6) == (0.4, True)
    assert TABLE.steering(0.0, -3.0) == (-0.4, True)
    assert TABLE.max_lateral_acceleration(0.0) == 0.0


def test_the_largest_demands_saturate_like_any():
    assert one_column(9.5).steering(2.0, 1.7e308) == (0.2, True)


def test_the_limit_is_the_largest_cell_of_a_column():
    np.testing.assert_allclose(
        TABLE.max_lateral_acceleration(SPEEDS), TABLE.a_lat.max(axis=0), rtol=1e-12
    )
    v = 0.5 * (SPEEDS[3] + SPEEDS[4])
    assert TABLE.a_lat[:, 3].max() < TABLE.max_lateral_acceleration(v) < TABLE.a_lat[:, 4].max()


@pytest.mark.parametrize("v", [math.nan, math.inf, -math.inf])
def test_arguments_that_are_not_finite_are_refused(v):
    for arguments in ((v, 1.0), (1.0, v)):
        with pytest.raises(ParameterError, match="expected finite arguments"):
            TABLE.steering(*arguments)


def worst_error(table, v, share=0.95):
    """Largest error [rad] of the inverse at one speed against the exact solution."""
    angles = np.linspace(0.0, table.angles[-1], 400)
    exact = steady_state_table(NUC4, [v], angles).a_lat[:, 0]
    peak = int(np.argmax(exact))
    return max(
        abs(table.steering(v, a_lat)[0] - delta)
        for a_lat, delta in zip(exact[:peak].tolist(), angles.tolist())
        if a_lat < share * exact[peak]
    )


@pytest.mark.parametrize("v", [0.55, 0.8, 1.51, 2.59, 3.6, 4.52, 6.95])
def test_between_the_nodes_of_the_published_grid(v):
    assert worst_error(TABLE, v) < 0.25e-3


@pytest.mark.parametrize("v", [0.02, 0.2, 0.4, 7.5, 9.0, 15.0])
def test_beyond_the_speeds_of_the_table_the_law_goes_on(v):
    assert worst_error(TABLE, v) < 0.25e-3


@pytest.mark.parametrize("v", [0.05, 0.37, 1.24, 2.55, 3.66, 4.15, 7.77, 11.94])
def test_default_grid_is_fine_enough(v):
    table = steady_state_table(NUC4, *default_grid(NUC4, 12.0))
    assert worst_error(table, v, share=0.99) < 0.25e-3


def test_the_published_grid():
    for found, expected in zip(published_grid(), (SPEEDS, ANGLES)):
        np.testing.assert_array_equal(found, expected)


def test_angles_of_a_large_car_are_denser_the_smaller_they_are():
    """At full speed it steers by hundredths of a radian; its speed columns are farther apart."""
    car = load_vehicle("bmw_320i")
    speed_axis, angle_axis = default_grid(car)
    steps = np.diff(angle_axis)
    assert angle_axis[0] == 0.0 and angle_axis[-1] == pytest.approx(car.delta_max)
    assert np.all(np.diff(steps) > 0.0) and steps[0] < 0.01 * steps[-1]
    assert angle_axis[128] == pytest.approx(0.25 * car.delta_max)
    assert (speed_axis[0], speed_axis[-1]) == (0.1, car.v_max)
    assert 0.15 < np.diff(speed_axis).max() < 1.0


def test_default_grid_ends_at_the_limits_of_the_car():
    car = dataclasses.replace(NUC4, v_max=9.7, delta_max=0.35)
    speed_axis, angle_axis = default_grid(car)
    assert (speed_axis[-1], angle_axis[0], angle_axis[-1]) == (9.7, 0.0, 0.35)
    assert np.diff(speed_axis).max() < 0.1 + 1e-12
    np.testing.assert_allclose(angle_axis, 0.35 * np.arange(257) / 256, rtol=1e-12)


@pytest.mark.parametrize("v_max", [0.2, 8.0, 100.0])
def test_default_grid_has_a_column_every_tenth(v_max):
    np.testing.assert_allclose(default_grid(NUC4, v_max)[0], 0.1 * np.arange(1, 10 * v_max + 1))


@pytest.mark.parametrize("v_max", [0.0, 0.19, -3.0, 100.5, 1e9, math.inf, math.nan])
def test_default_grid_refuses_impossible_speeds(v_max):
    with pytest.raises(ParameterError, match="^v_max: expected"):
        default_grid(NUC4, v_max)


@pytest.mark.parametrize(("v_max", "last"), [(120.0, 100.0), (0.1, 0.2)])
def test_default_grid_of_a_car_faster_or_slower_than_any_table(v_max, last):
    assert default_grid(dataclasses.replace(NUC4, v_max=v_max))[0][-1] == last


def test_wheelbase_is_recovered_from_a_table_without_provenance():
    bare = LookupTable(SPEEDS, ANGLES, TABLE.a_lat)
    assert bare.l_wb == pytest.approx(NUC4.l_wb, abs=1e-5)
    assert bare.steering(12.0, 5.0)[0] == pytest.approx(TABLE.steering(12.0, 5.0)[0], abs=1e-6)


def test_wheelbase_is_that_of_the_provenance():
    provenance = dataclasses.replace(TABLE.provenance, l_wb=0.4)
    assert LookupTable(SPEEDS, ANGLES, TABLE.a_lat, provenance).l_wb == 0.4
    for extreme in (0.01, 10.0):
        provenance = dataclasses.replace(TABLE.provenance, l_wb=extreme)
        assert LookupTable(SPEEDS, ANGLES, TABLE.a_lat, provenance).l_wb == extreme


def one_column(l_wb, v=2.0):
    """Table for one speed, of a car without slip."""
    return LookupTable([v], [0.0, 0.1, 0.2], np.array([[0.0, 0.1, 0.2]]).T * v**2 / l_wb)


def test_a_table_of_one_speed():
    table = one_column(0.4)
    assert table.l_wb == pytest.approx(0.4)
    assert table.acceleration(2.0, 0.1) == pytest.approx(1.0)
    assert table.acceleration(2.0, -0.15) == pytest.approx(-1.5)
    assert table.steering(2.0, 1.5) == (pytest.approx(0.15), False)


@any_table
def test_lookup_there_and_back(table):
    for v, share in itertools.product(SPEEDS[:-1:7].tolist(), (0.1, 0.5, 0.9)):
        a_lat = share * table.max_lateral_acceleration(v)
        delta, _ = table.steering(v, a_lat)
        if math.isfinite(table.acceleration(v, delta)):
            assert table.acceleration(v, delta) == pytest.approx(a_lat, rel=1e-12)


def test_acceleration_is_bilinear():
    v, delta = 0.25 * SPEEDS[8] + 0.75 * SPEEDS[9], 0.5 * (ANGLES[40] + ANGLES[41])
    cells = TABLE.a_lat[40:42, 8:10]
    expected = float(cells.mean(axis=0) @ [0.25, 0.75])
    assert TABLE.acceleration(v, delta) == pytest.approx(expected, rel=1e-12)
    np.testing.assert_allclose(
        TABLE.acceleration([[v], [-v]], [delta, -delta]), expected * np.array([[1, -1], [1, -1]])
    )


def test_acceleration_at_nodes_is_that_of_the_cells():
    for i, j in itertools.product((0, 1, 30, 59), (0, 1, 63, 64)):
        expected = pytest.approx(TABLE.a_lat[i, j], rel=1e-12)
        assert TABLE.acceleration(SPEEDS[j], ANGLES[i]) == expected
    within = TABLE.acceleration(0.5 * (SPEEDS[0] + SPEEDS[1]), ANGLES[30])
    assert within == pytest.approx(TABLE.a_lat[30, :2].mean(), rel=1e-12)


def test_a_table_of_one_angle():
    table = LookupTable([1.0, 2.0], [0.1], [[0.25, 1.0]])
    assert table.l_wb == pytest.approx(0.4)
    assert table.acceleration(2.0, 0.1) == 1.0
    assert math.isnan(table.acceleration(2.0, 0.05))


def test_numbers_give_numbers():
    assert type(TABLE.acceleration(2.0, 0.1)) is float
    assert type(TABLE.max_lateral_acceleration(2.0)) is float


def test_acceleration_beyond_the_table_is_not_a_number():
    result = TABLE.acceleration([0.4, 7.1, 2.0, np.nan, 7.0], [0.1, 0.1, 0.41, 0.1, 0.4])
    assert np.isnan(result).tolist() == [True, True, True, True, False]


def test_cells_beside_missing_ones_are_usable_themselves():
    table = LookupTable([1.0, 2.0], [0.0, 0.1, 0.2], [[0, 0], [1, 3], [2, np.nan]])
    assert table.acceleration(2.0, 0.1) == 3.0
    assert math.isnan(table.acceleration(1.5, 0.15))
    assert table.steering(2.0, 5.0) == (0.1, True)


def test_only_the_rising_branch_is_inverted():
    column = [0.0, 1.0, 0.9, 2.0, 3.0, 2.5]
    table = LookupTable([1.0], np.arange(6) / 10.0, np.array([column]).T)
    assert table.steering(1.0, 0.95) == (pytest.approx(0.095), False)
    # between the records 1.0 at 0.1 rad and 2.0 at 0.3 rad
    assert table.steering(1.0, 1.5) == (pytest.approx(0.2), False)
    assert table.steering(1.0, 2.9) == (pytest.approx(0.39), False)
    assert table.steering(1.0, 9.0) == (pytest.approx(0.4), True)
    # nor where it stays constant
    table = LookupTable([1.0], np.arange(4) / 10.0, np.array([[0.0, 1.0, 1.0, 2.0]]).T)
    assert table.steering(1.0, 1.5) == (pytest.approx(0.2), False)
    # nor is there a branch at angle 0
    table = LookupTable([1.0], [0.0, 0.1], [[0.2], [1.0]])
    assert table.steering(1.0, 0.5) == (pytest.approx(0.05), False)


def test_a_speed_without_stable_cell_is_as_the_one_before():
    table = LookupTable([1.0, 2.0], [0.0, 0.1], [[0.0, np.nan], [1.0, np.nan]])
    assert table.max_lateral_acceleration(2.0) == 1.0
    assert table.steering(2.0, 2.0)[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([1.0, 1.0], [0.1], [[1, 1]]), "speeds: expected ascending values, got 1 before 1"),
        (([0.0, 1.0], [0.1], [[1, 1]]), "^speeds: expected positive values, got 0 m/s"),
        (
            ([1.0], [0.1, 0.3, 0.2, 0.4], np.ones((4, 1))),
            "^angles: expected ascending values, got 0.3 before 0.2",
        ),
        (
            ([1.0], [-0.1, 0.0, 0.1], [[1], [2], [3]]),
            r"angles: expected values in \[0, pi/2\) rad, got -0.1 to 0.1",
        ),
        (([1.0], [0.1, 2.0], [[1], [2]]), r"angles: expected values in .* got 0.1 to 2"),
        (([1.0], [0.1, 0.5 * math.pi], [[1], [2]]), r"angles: expected values in"),
        (([1.0], [0.1], [[1, 2]]), r"a_lat: expected shape \(1, 1\), got \(1, 2\)"),
        (([1.0], [0.1], [[np.inf]]), "^a_lat: expected finite values or NaN, got inf$"),
        (([1.0, 2.0], [0.1], [[1.0, np.inf]]), "^a_lat: expected finite values or NaN, got inf$"),
        (([1.0], [0.1], [[np.nan]]), "^a_lat: expected cells that rise .* got none$"),
        (([np.nan], [0.1], [[1]]), "speeds: expected a list of finite numbers"),
        (([1.0], [0.1, np.nan], [[1], [2]]), "angles: expected a list of finite numbers"),
        (([], [0.1], [[]]), "speeds: expected a list of finite numbers"),
        (([[1.0]], [0.1], [[1]]), "speeds: expected a list of finite numbers"),
    ],
)
def test_impossible_tables_are_refused(arguments, message):
    with pytest.raises(ParameterError, match=message):
        LookupTable(*arguments)


def test_the_table_cannot_be_changed_under_its_inverse():
    table = one_column(0.4)
    for values in (table.a_lat, table.speeds, table.angles):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 3.0


@any_table
def test_saved_table_reads_back_equal(tmp_path, table):
    table.save(tmp_path / "table.csv")
    back = load_table(tmp_path / "table.csv")
    np.testing.assert_array_equal(back.speeds, table.speeds)
    np.testing.assert_array_equal(back.angles, table.angles)
    np.testing.assert_array_equal(back.a_lat, table.a_lat)
    assert back.provenance == table.provenance
    assert sorted(path.name for path in tmp_path.iterdir()) == ["table.csv", "table.meta.yaml"]


@pytest.mark.parametrize("part", ["table.csv", "table.meta.yaml"])
def test_table_and_provenance_are_written_both_or_not_at_all(tmp_path, full_disk, part):
    table = steady_state_table(load_vehicle("nuc4"), *published_grid())
    full_disk(part)
    with pytest.raises(MapRacingError, match=f"{part}: cannot write: No space left on device"):
        table.save(tmp_path / "table.csv")
    assert list(tmp_path.iterdir()) == []


def test_saved_layout_is_the_published_one(tmp_path):
    table = LookupTable([0.5, 1.0], [0.0, 0.25], [[0.0, 0.0], [0.125, np.nan]])
    table.save(tmp_path / "table.csv")
    text = (tmp_path / "table.csv").read_text(encoding="utf-8")
    assert text == "0.0,0.5,1.0\n0.0,0.0,0.0\n0.25,0.125,nan\n"


def test_a_table_without_provenance_does_not_inherit_an_old_one(tmp_path):
    TABLE.save(tmp_path / "table.csv")
    LookupTable(SPEEDS, ANGLES, TABLE.a_lat).save(tmp_path / "table.csv")
    assert load_table(tmp_path / "table.csv").provenance is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,1,2\n0.1,1\n", "table.csv:2: expected 3 columns, got 2"),
        ("0,1,2\n0.1,1,2\n\n0.2,x,4\n", "table.csv:4: column 2: expected a number, got 'x'"),
        ("0;1;2\n0.1;1;2\n", "expected cells separated by commas, got ';'"),
        ("0,2,1\n0.1,1,2\n", "speeds: expected ascending values, got 2 before 1"),
        ("0,1\n0.2,1\n0.1,2\n", "angles: expected ascending values, got 0.2 before 0.1"),
        ("0,1\n0.1,inf\n", "a_lat: expected finite values or NaN"),
        ("0,1,2\n", "then rows of angles, got 1 row"),
        ("", "then rows of angles, got 0 rows"),
    ],
)
def test_malformed_files_are_refused(tmp_path, text, message):
    path = tmp_path / "table.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FileFormatError, match=message) as error:
        load_table(path)
    assert "\n" not in str(error.value)


def test_missing_and_binary_files_are_refused(tmp_path):
    with pytest.raises(FileFormatError, match="cannot read: No such file"):
        load_table(tmp_path / "table.csv")
    (tmp_path / "table.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(FileFormatError, match="expected UTF-8 text"):
        load_table(tmp_path / "table.csv")
    with pytest.raises(FileFormatError, match="cannot read: Is a directory"):
        load_table(tmp_path)


@pytest.mark.parametrize("mark", [";", "\t"])
def test_cells_with_another_delimiter_are_refused(tmp_path, mark):
    (tmp_path / "table.csv").write_text(f"0{mark}1,5{mark}2\n0,1{mark}1{mark}2\n")
    with pytest.raises(FileFormatError, match="table.csv: expected cells separated by commas, got"):
        load_table(tmp_path / "table.csv")
    with pytest.raises(FileFormatError, match="'': expected the name of a file"):
        load_table("")


@pytest.mark.parametrize(
    "text, said",
    [
        ("vehicle: X\n", "expected the keys vehicle, tire_model, .*, got vehicle$"),
        ("- 1\n", "expected keys and values, got a list"),
        ("a: b: c\n", "expected YAML"),
        ("1: 2\n", "expected the keys .* got 1$"),
        (META + "note: mine\n", "expected the keys .*, note$"),
        (META.replace("0.32", "-1"), "l_wb: expected a positive number, got -1"),
        (META.replace("0.32", "0.32 m"), "l_wb: expected a finite number, got '0.32 m'"),
        (META.replace("0.32", "320"), "l_wb: expected 0.01 to 10 m, got 320"),
        (META.replace("NUC4", "[NUC4]"), r"vehicle: expected a text, got \['NUC4'\]"),
        (META.replace("abc", "12"), "parameter_hash: expected a text, got 12"),
    ],
)
def test_damaged_sidecars_are_refused(tmp_path, text, said):
    TABLE.save(tmp_path / "table.csv")
    (tmp_path / "table.meta.yaml").write_text(META, encoding="utf-8")
    load_table(tmp_path / "table.csv")
    (tmp_path / "table.meta.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(FileFormatError, match=f"table.meta.yaml(:1)?: {said}"):
        load_table(tmp_path / "table.csv")


def test_a_fingerprint_that_looks_like_a_number_comes_back(tmp_path):
    provenance = Provenance("1e3", "linear", "123456e78901", 0.32, "map_racing")
    LookupTable(TABLE.speeds, TABLE.angles, TABLE.a_lat, provenance).save(tmp_path / "table.csv")
    assert load_table(tmp_path / "table.csv").provenance == provenance


def test_provenance_refuses_an_impossible_wheelbase():
    with pytest.raises(ParameterError, match="l_wb"):
        Provenance("X", "linear", "0", 0.0, "test")


@pytest.mark.parametrize("name", ["NUC4_pacejka", "SIM_linear"])
def test_published_tables_load_and_invert(shared_data, name):
    table = load_table(shared_data / "vehicles" / f"{name}_lookup_table.csv")
    assert table.a_lat.shape == (60, 65)
    assert table.provenance is None
    assert table.l_wb == pytest.approx(
        {"NUC4_pacejka": 0.307, "SIM_linear": 0.3302}[name], abs=1e-5
    )
    for i, j in rising_cells(table):
        v, a_lat = table.speeds[j], table.a_lat[i, j]
        # cells may differ by rounding where the table repeats an angle
        assert table.steering(v, a_lat)[0] == pytest.approx(table.angles[i], abs=1e-9)


def test_cells_that_give_no_wheelbase_are_no_table():
    angles = np.linspace(0.0, 0.4, 20)
    cells = np.outer(angles, [10.0, 9.0, 8.0, 7.0, 6.0])
    with pytest.raises(ParameterError, match="wheelbase"):
        LookupTable([1.0, 2.0, 3.0, 4.0, 5.0], angles, cells)
    for impossible in (0.009, 10.5):
        with pytest.raises(ParameterError, match="^a_lat: expected cells .*wheelb"):
            one_column(impossible)
    assert one_column(9.5).l_wb == pytest.approx(9.5)


@pytest.mark.parametrize(
    "cell", ["6.934876035770011697e-310", "nan", "-inf", "1e300", "", "3", "v"]
)
def test_the_corner_cell_means_nothing(tmp_path, cell):
    """In published tables, it is uninitialized memory."""
    (tmp_path / "t.csv").write_text(f"{cell},1,2\n0,0,0\n0.1,1,3\n0.2,2,nan\n")
    table = load_table(tmp_path / "t.csv")
    assert table.speeds.tolist() == [1.0, 2.0] and table.angles.tolist() == [0.0, 0.1, 0.2]
    assert table.steering(1.0, 1.0)[0] == pytest.approx(0.1)


def test_a_published_table_with_a_junk_corner(shared_data):
    table = load_table(shared_data / "vehicles" / "NUC5_glc_pacejka_lookup_table.csv")
    assert table.a_lat.shape == (60, 65) and table.l_wb == pytest.approx(0.32, abs=1e-4)


def test_a_cell_that_was_mistyped_is_refused():
    """1.0 instead of 0.1 in one cell of a published grid."""
    table = TABLES[NUC4.name]
    cells = table.a_lat.copy()
    i, j = np.argwhere((cells > 0.5) & (cells < 1.0))[10]
    cells[i, j] *= 10.0
    where = f"at {table.speeds[j]:g} m/s and .* the neighboring cells"
    with pytest.raises(ParameterError, match=where):
        LookupTable(table.speeds, table.angles, cells)


GEOMETRIC_V, GEOMETRIC_DELTA = np.array([1.0, 2.0, 3.0, 4.0]), np.linspace(0.0, 0.4, 5)


def geometric(cells, l_wb=0.4):
    """Table of a car without slip, with some cells multiplied by a factor."""
    rolling = np.tan(GEOMETRIC_DELTA)[:, None] * GEOMETRIC_V**2 / l_wb
    a_lat = rolling.copy()
    for (i, j), multiple in cells.items():
        a_lat[i, j] = multiple * rolling[i, j]
    return LookupTable(
        GEOMETRIC_V, GEOMETRIC_DELTA, a_lat, Provenance("X", "linear", "0", l_wb, "test")
    )


@pytest.mark.parametrize("i", [1, 2, 4])
@pytest.mark.parametrize("j", [0, 1, 3])
def test_a_cell_far_above_geometry_and_all_beside_it_is_refused(i, j):
    place = f"at {GEOMETRIC_V[j]:g} m/s and {GEOMETRIC_DELTA[i]:g} rad: "
    with pytest.raises(ParameterError, match=place):
        geometric({(i, j): 40.0})


@pytest.mark.parametrize("beside", [(3, 1), (2, 2)])
@pytest.mark.parametrize("swapped", [False, True])
def test_it_is_not_where_a_cell_beside_it_has_half_of_it(beside, swapped):
    """Cells of an oversteering car may differ as much."""
    rolling = np.tan(GEOMETRIC_DELTA)[:, None] * GEOMETRIC_V**2
    one, other = ((2, 1), beside) if not swapped else (beside, (2, 1))
    ratio = rolling[one] / rolling[other]
    geometric({one: 40.0, other: 0.55 * 40.0 * ratio})
    with pytest.raises(ParameterError, match="the neighboring cells"):
        geometric({one: 40.0, other: 0.45 * 40.0 * ratio})


def test_far_above_geometry_is_three_times_and_more_than_1():
    geometric({(4, 3): 2.9})
    with pytest.raises(ParameterError, match="the neighboring cells"):
        geometric({(4, 3): 3.1})
    once = math.tan(0.1) / 4.0
    geometric({(1, 0): 0.9 / once}, l_wb=4.0)
    with pytest.raises(ParameterError, match="the neighboring cells"):
        geometric({(1, 0): 1.1 / once}, l_wb=4.0)
