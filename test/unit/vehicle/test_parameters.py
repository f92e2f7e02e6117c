"""Vehicle files: shipped ones, published spelling, round trip, and refusals by name."""

import dataclasses

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from map_racing.errors import FileFormatError, MapRacingError, ParameterError
from map_racing.vehicle.parameters import (
    Vehicle,
    linearized,
    load_vehicle,
    parameter_hash,
    save_vehicle,
)
from map_racing.vehicle.tires import LinearTire, PacejkaTire

MINIMAL = {
    "m": 3.3,
    "I_z": 0.05,
    "l_f": 0.16,
    "l_r": 0.15,
    "h_cg": 0.02,
    "mu": 0.9,
    "tire_model": "linear",
    "C_Sf": 4.7,
    "C_Sr": 5.5,
}
PACEJKA = {
    **{key: MINIMAL[key] for key in ("m", "I_z", "l_f", "l_r", "h_cg", "mu")},
    "tire_model": "pacejka",
    "C_Pf": [3.0, 2.0, 0.7, 0.2],
    "C_Pr": [20.0, 2.0, 1.2, 0.9],
}

share = st.floats(0.5, 2.0)
tires = st.builds(PacejkaTire, st.floats(1.0, 20.0), share, share, st.floats(-10.0, 10.0))
# 1:10 cars, and twice or half their size, mass and grip.
vehicles = st.builds(
    Vehicle,
    name=st.text("abcNUC4_-: #", min_size=1),
    m=st.floats(1.0, 10.0),
    I_z=st.floats(0.02, 0.1),
    l_f=st.floats(0.1, 0.3),
    l_r=st.floats(0.1, 0.3),
    h_cg=st.floats(0.0, 0.1),
    mu=share,
    front=tires,
    rear=tires,
    delta_max=st.floats(0.1, 1.5),
    width=st.floats(0.1, 0.5),
)


@pytest.fixture
def write(tmp_path):
    def write(values, name="car.yaml"):
        path = tmp_path / name
        text = values if isinstance(values, str) else yaml.safe_dump(values)
        path.write_text(text, encoding="utf-8")
        return path

    return write


def without(values, *keys):
    return {key: value for key, value in values.items() if key not in keys}


def test_nuc4_ships_with_the_published_figures():
    car = load_vehicle("nuc4")
    assert (car.name, car.m, car.I_z, car.l_f, car.l_r) == ("NUC4", 3.31, 0.09, 0.162, 0.145)
    assert (car.h_cg, car.mu, car.a_max, car.a_brake_max) == (0.02, 1.0, 3.0, 3.0)
    assert car.front == PacejkaTire(3.12, 2.23, 0.72, 0.23)
    assert car.rear == PacejkaTire(29.91, 2.23, 1.21, 0.92)
    assert car.l_wb == pytest.approx(0.307, abs=1e-15)


def test_sim_ships_with_the_published_figures():
    car = load_vehicle("sim")
    assert (car.name, car.m, car.I_z, car.l_f, car.l_r) == ("SIM", 3.47, 0.04712, 0.15875, 0.17145)
    assert (car.h_cg, car.mu, car.a_max, car.a_brake_max) == (0.02, 1.0, 7.51, 8.26)
    assert (car.front, car.rear) == (LinearTire(4.718), LinearTire(5.4562))
    assert (car.delta_max, car.delta_rate_max, car.v_max) == (0.4189, 3.2, 7.0)


@pytest.mark.parametrize(
    ("name", "published"), [("nuc4", "NUC4_pacejka.txt"), ("sim", "SIM_linear.txt")]
)
def test_published_files_load_as_they_are(shared_data, name, published):
    car, shipped = load_vehicle(shared_data / "vehicles" / published), load_vehicle(name)
    assert parameter_hash(car) == parameter_hash(shipped)
    assert (car.name, car.a_max, car.a_brake_max) == (
        shipped.name,
        shipped.a_max,
        shipped.a_brake_max,
    )


def test_limits_default_to_those_of_the_class(write):
    car = load_vehicle(write(MINIMAL))
    assert car == Vehicle("car", 3.3, 0.05, 0.16, 0.15, 0.02, 0.9, LinearTire(4.7), LinearTire(5.5))


def test_newer_published_spelling(write):
    values = without(PACEJKA, "C_Pf", "C_Pr", "mu")
    values.update(zip(("Bf", "Cf", "Df", "Ef"), PACEJKA["C_Pf"]))
    values.update(zip(("Br", "Cr", "Dr", "Er"), PACEJKA["C_Pr"]))
    values.update(friction_coeff=0.9, model_name="car")
    assert load_vehicle(write(values)) == load_vehicle(write(PACEJKA))


@pytest.mark.parametrize("a_min", [-8.26, 8.26])
def test_published_braking_limit_of_either_sign(write, a_min):
    assert load_vehicle(write({**MINIMAL, "a_min": a_min})).a_brake_max == 8.26


@settings(deadline=None, max_examples=30)
@given(vehicle=vehicles)
def test_saved_vehicle_reads_back_equal(tmp_path_factory, vehicle):
    path = tmp_path_factory.mktemp("vehicle") / "car.yaml"
    save_vehicle(vehicle, path)
    assert load_vehicle(path) == vehicle
    assert [child.name for child in path.parent.iterdir()] == ["car.yaml"]


def test_linear_vehicle_reads_back_equal(tmp_path):
    vehicle = linearized(load_vehicle("nuc4"))
    save_vehicle(vehicle, tmp_path / "car.yaml")
    assert load_vehicle(tmp_path / "car.yaml") == vehicle


def test_failed_save_leaves_the_old_file(write, monkeypatch):
    path = write(MINIMAL)
    before = path.read_text(encoding="utf-8")
    monkeypatch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(MapRacingError, match="disk full"):
        save_vehicle(load_vehicle("nuc4"), path)
    assert path.read_text(encoding="utf-8") == before
    assert [child.name for child in path.parent.iterdir()] == ["car.yaml"]


def test_linearized_keeps_everything_but_the_tires():
    car = load_vehicle("nuc4")
    linear = linearized(car)
    assert linear.front == LinearTire(3.12 * 2.23 * 0.72)
    assert linear.rear == LinearTire(29.91 * 2.23 * 1.21)
    assert linear.name == "NUC4_linear"
    assert dataclasses.replace(linear, name=car.name, front=car.front, rear=car.rear) == car


def test_hash_ignores_formatting_name_and_limits(write):
    plain = load_vehicle(write(MINIMAL))
    shuffled = dict(reversed(list(MINIMAL.items())))
    text = "# another car\n" + yaml.safe_dump(
        {**shuffled, "name": "B", "v_max": 3}, sort_keys=False
    )
    assert parameter_hash(load_vehicle(write(text.replace("3.3", "3.30")))) == parameter_hash(plain)


@pytest.mark.parametrize("key", ["m", "I_z", "l_f", "l_r", "h_cg", "mu", "C_Sf", "C_Sr"])
def test_hash_depends_on_each_model_parameter(write, key):
    changed = load_vehicle(write({**MINIMAL, key: MINIMAL[key] * 1.001}))
    assert parameter_hash(changed) != parameter_hash(load_vehicle(write(MINIMAL)))


@pytest.mark.parametrize("key", ["m", "I_z", "l_f", "l_r", "h_cg", "C_Sr"])
def test_missing_parameter_is_named(write, key):
    path = write(without(MINIMAL, key))
    with pytest.raises(ParameterError) as error:
        load_vehicle(path)
    assert str(error.value).startswith(f"{path}: {key}: missing")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"m": -1}, "m: expected a positive number, got -1"),
        ({"mu": 0}, "mu: expected a positive number, got 0"),
        ({"mu": 1e-300}, "mu: expected a positive number, got 1e-300"),
        ({"l_f": 1e300}, "l_f: expected a number of at most 1e.09 in magnitude"),
        ({"m": 10**400}, "m: expected a number of at most 1e.09 in magnitude"),
        ({"h_cg": -0.1}, "h_cg: expected 0 or more, got -0.1"),
        ({"h_cg": False}, "h_cg: expected a finite number, got False"),
        ({"I_z": float("nan")}, "I_z: expected a finite number, got nan"),
        ({"l_f": "0.16 m"}, "l_f: expected a finite number, got '0.16 m'"),
        ({"l_r": True}, "l_r: expected a finite number, got True"),
        ({"h_cg": None}, "h_cg: expected a finite number, got None"),
        ({"width": [0.3]}, r"width: expected a finite number, got \[0.3\]"),
        ({"delta_max": 24}, "delta_max: expected less than pi/2 rad, got 24"),
        ({"l_wb": 0.32}, r"l_wb: expected l_f \+ l_r = 0.31, got 0.32"),
        ({"mass": 3}, "m: expected once, got it under two names"),
        ({"name": 4}, "name: expected a text, got 4"),
        ({"friction_coeff": 1}, "mu: expected once, got it under two names"),
        ({"a_min": -3, "a_brake_max": 3}, "a_min: expected either a_min or a_brake_max"),
        ({"h_cg": 0.2}, "a_max: expected less than .* which lifts an axle .*, got 7.51"),
        ({"tire_model": "brush"}, "tire_model: expected pacejka or linear, got 'brush'"),
        ({"tire_model": "pacejka"}, r"C_Pf: missing \(tire_model is pacejka\)"),
        ({"C_Sf": 0}, r"front tire \(C_Sf\): C_S: expected a positive number, got 0"),
    ],
)
def test_impossible_values_are_refused_by_name(write, changes, message):
    path = write({**MINIMAL, **changes})
    with pytest.raises(ParameterError, match=f"car.yaml: {message}") as error:
        load_vehicle(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"C_Pr": [1, 2, 3]},
            r"rear tire \(C_Pr\): expected a list \[B, C, D, E\], got \[1, 2, 3\]",
        ),
        ({"C_Pr": 5}, r"rear tire \(C_Pr\): expected a list"),
        ({"C_Pf": [1, "x", 1, 0]}, r"front tire \(C_Pf\): C: expected a finite number, got 'x'"),
    ],
)
def test_impossible_pacejka_coefficients_are_refused(write, changes, message):
    with pytest.raises(ParameterError, match=message):
        load_vehicle(write({**PACEJKA, **changes}))


# Further contents of the newer public stacks' files.
FURTHER = {"C_0d": 0.48, "C_R": 3.7, "C_acc": 7.1, "C_d": -0.9, "C_dec": 0.6, "tau_steer": 0.16}


def test_keys_that_are_not_used_are_noted(write):
    for values in (PACEJKA, MINIMAL):
        car = load_vehicle(write({**values, **FURTHER, "mu": 1.0}))
        assert car == load_vehicle(write({**values, "mu": 1.0}))
        assert car.notes[0] == "keys not used: C_0d, C_R, C_acc, C_d, C_dec"
    assert load_vehicle(write({**MINIMAL, "v_maks": 3})).notes == ("keys not used: v_maks",)
    assert load_vehicle(write({**PACEJKA, "C_Sf": 3})).notes == ("keys not used: C_Sf",)


@pytest.mark.parametrize("key", ["model_name", "C_R", "tau_steer"])
def test_mu_of_published_files_is_not_used_as_their_program_does_not(write, key):
    """Its single-track model has no friction coefficient: D includes it."""
    value = "NUC7" if key == "model_name" else 0.2
    car = load_vehicle(write({**PACEJKA, "mu": 0.95, key: value}))
    assert car.mu == 1.0 and car.notes[0].startswith("mu: 0.95 ignored, 1 used")
    # If it is 1, there is no note; in this package's own files it counts.
    assert not any(
        "mu" in note for note in load_vehicle(write({**PACEJKA, "mu": 1, key: value})).notes
    )
    assert load_vehicle(write({**without(PACEJKA, key), "mu": 0.95, "name": "own"})).mu == 0.95
    assert load_vehicle(write({**PACEJKA, "mu": 0.95}, "NUC7_pacejka.txt")).mu == 1.0


def test_files_without_mu_or_tire_model(write):
    car = load_vehicle(write(without(PACEJKA, "mu", "tire_model")))
    assert car.mu == 1.0 and car.notes == ("no mu: 1 assumed",)
    assert car.front == PacejkaTire(*PACEJKA["C_Pf"])
    assert load_vehicle(write(without(MINIMAL, "tire_model"))).front == LinearTire(4.7)
    both = without({**MINIMAL, **PACEJKA}, "tire_model")
    assert isinstance(load_vehicle(write(both, "NUC2_linear.txt")).front, LinearTire)
    assert isinstance(load_vehicle(write(both, "NUC2_pacejka.yaml")).front, PacejkaTire)
    for values in (both, without(MINIMAL, "tire_model", "C_Sf", "C_Sr")):
        with pytest.raises(ParameterError, match="tire_model: missing, expected pacejka or linear"):
            load_vehicle(write(values))


def test_spellings_of_other_stacks(write):
    """Names of car_model.yaml of the newer stack and of the F1TENTH gym."""
    car = load_vehicle(write(PACEJKA))
    names = {"l_f": "lf", "l_r": "lr", "I_z": "Iz", "h_cg": "h"}
    values = {names.get(key, key): value for key, value in PACEJKA.items()}
    values.update(wheelbase=0.31, max_steering_angle=0.4189, sv_max=3.2, width_m=0.296)
    assert load_vehicle(write(values)) == car


TIRES = {
    **{f"{c}{axle}": value for axle in "fr" for c, value in zip("BCDE", PACEJKA[f"C_P{axle}"])},
    "friction_coeff": 1.0,
    "floor": "hall",
}


@pytest.fixture
def split(tmp_path):
    """A car split into files as by the newer stacks, with tires for one floor."""
    car = without({**PACEJKA, **FURTHER}, "C_Pf", "C_Pr", "tire_model", "mu")
    (tmp_path / "car_model.yaml").write_text(yaml.safe_dump(car))
    (tmp_path / "vesc.yaml").write_text("max_rpm: 20000\n")
    floor = tmp_path / "pacejka" / "hall"
    floor.mkdir(parents=True)
    (floor / "default.yaml").write_text(yaml.safe_dump(TIRES))
    return tmp_path


def test_a_car_split_from_its_tires_is_joined(split, write):
    expected = load_vehicle(write({**PACEJKA, "mu": 1.0}, "whole.txt"))
    tires = split / "pacejka" / "hall" / "default.yaml"
    by_car, by_tires = load_vehicle(split / "car_model.yaml"), load_vehicle(tires)
    assert parameter_hash(by_car) == parameter_hash(by_tires) == parameter_hash(expected)
    assert by_car.notes[0] == f"tires from {tires}"
    assert by_tires.notes[0] == f"mass and geometry from {split / 'car_model.yaml'}"
    # Next to it, under any name.
    tires.rename(split / "pacejka_tire_params.yaml")
    assert load_vehicle(split / "car_model.yaml").front == expected.front


def test_tires_of_two_floors_must_be_chosen(split):
    other = split / "pacejka" / "foyer"
    other.mkdir()
    (other / "default.yaml").write_text(yaml.safe_dump({**TIRES, "Df": 0.5, "Dr": 0.5}))
    with pytest.raises(ParameterError, match=r"give one of .*foyer/default.yaml, .*hall/default"):
        load_vehicle(split / "car_model.yaml")
    assert load_vehicle(other / "default.yaml").front.D == 0.5


def test_half_a_car_says_which_half_is_missing(split, tmp_path):
    tires = split / "pacejka" / "hall" / "default.yaml"
    alone = tmp_path / "a" / "b" / "c" / "d"
    alone.mkdir(parents=True)
    tires.rename(alone / "tires.yaml")
    with pytest.raises(ParameterError, match=r"tires.yaml: m: missing"):
        load_vehicle(alone / "tires.yaml")
    with pytest.raises(ParameterError, match=r"car_model.yaml: tire_model: .* there is no tire"):
        load_vehicle(split / "car_model.yaml")


def test_a_wheelbase_that_the_reader_of_the_file_does_not_use_is_noted(write):
    car = load_vehicle(write({**PACEJKA, "model_name": "NUC9", "mu": 1.0, "l_wb": 0.32}))
    assert car.l_wb == pytest.approx(0.31) and "l_wb: expected" in car.notes[0]


def test_newer_published_files(shared_data):
    for name in ("NUC1_linear.txt", "NUC1_pacejka.txt", "NUC2_pacejka.yaml"):
        car = load_vehicle(shared_data / "vehicles" / name)
        assert (car.name, car.m, car.mu) == (name[:4], 3.54, 1.0)
        assert car.notes[0] == "keys not used: C_0d, C_R, C_acc, C_d, C_dec"


def test_incomplete_newer_spelling_names_the_missing_one(write):
    values = {**without(PACEJKA, "C_Pf"), "Bf": 3.0, "Cf": 2.0, "Ef": 0.2}
    with pytest.raises(ParameterError, match="Df: missing"):
        load_vehicle(write(values))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("m: [1, 2", "car.yaml:1: expected a vehicle file"),
        ("m: 1\n\t- 2", "car.yaml:2: expected a vehicle file"),
        ("- 1\n- 2\n", "expected a vehicle file .YAML., got a list"),
        ("", "expected a vehicle file .YAML., got nothing"),
        ("x_m;y_m\n1;2\n", "expected a vehicle file .YAML., got a text"),
        ("x_m,y_m: 1\n1,2\n3,4\n", "car.yaml:3: expected a vehicle file .YAML.: could not find"),
    ],
)
def test_other_files_are_refused(write, text, message):
    with pytest.raises(FileFormatError, match=message) as error:
        load_vehicle(write(text))
    assert "\n" not in str(error.value)


def test_binary_file_is_refused(tmp_path):
    (tmp_path / "car.yaml").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(FileFormatError, match="not text"):
        load_vehicle(tmp_path / "car.yaml")


def test_unknown_name_lists_the_shipped_ones():
    with pytest.raises(ParameterError, match="nuc4, sim"):
        load_vehicle("nuc5")


def test_tires_of_two_models_are_refused():
    with pytest.raises(ParameterError, match="rear: expected a tire as in front"):
        dataclasses.replace(load_vehicle("sim"), rear=PacejkaTire(10, 2, 1, 0))
