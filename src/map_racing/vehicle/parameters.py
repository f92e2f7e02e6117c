"""The car: validated parameters, read from and written to YAML."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Union

from ..errors import FileFormatError, ParameterError
from ..files import read_yaml_mapping, replacing, yaml_text
from ..resources import find_config
from ..validation import POSITIVE, check, documented, finite, parameter, positive
from .plausibility import doubts_of_vehicle
from .single_track import GRAVITY
from .tires import LinearTire, PacejkaTire

__all__ = [
    "Tire",
    "Vehicle",
    "holding",
    "linearized",
    "load_vehicle",
    "parameter_hash",
    "save_vehicle",
    "scaled_tires",
    "vehicle_of",
    "vehicle_values",
]

Tire = Union[PacejkaTire, LinearTire]
NO_LIMIT = 1000.0  # of the lateral acceleration [m/s^2]


def _positive(text, unit="", default=dataclasses.MISSING):
    return parameter(text, unit, low=POSITIVE, default=default)


@documented
@dataclass(frozen=True)
class Vehicle:
    """Parameters of one car; the names are those of its YAML file.

    The single-track model does not depend on the limits from `delta_max` on. Their defaults are
    the values of the public F1TENTH simulator.
    """

    name: str = parameter("Name of the car")
    m: float = _positive("Mass", "kg")
    I_z: float = _positive("Moment of inertia about the vertical axis", "kg m^2")
    l_f: float = _positive("Distance from the center of gravity to the front axle", "m")
    l_r: float = _positive("Distance from the center of gravity to the rear axle", "m")
    h_cg: float = parameter("Height of the center of gravity; 0 for no load transfer", "m", low=0.0)
    mu: float = _positive("Friction coefficient between tires and floor")
    front: Tire = parameter("Lateral force curve of the front axle, normalized by mu F_z")
    rear: Tire = parameter("Lateral force curve of the rear axle, of the same model")
    delta_max: float = _positive("Largest steering angle", "rad", 0.4189)
    delta_rate_max: float = _positive("Largest rate of the steering angle", "rad/s", 3.2)
    v_max: float = _positive("Largest speed", "m/s", 15.0)
    a_max: float = _positive("Largest acceleration", "m/s^2", 7.51)
    a_brake_max: float = _positive("Largest deceleration, positive", "m/s^2", 8.26)
    width: float = _positive("Outer width", "m", 0.296)
    length: float = _positive("Outer length", "m", 0.568)
    a_lat_max: float = _positive(
        "Largest lateral acceleration of the lookup table. If the data did not reach the peak of "
        "the tires, the largest value that they reached; the default is no limit",
        "m/s^2",
        NO_LIMIT,
    )
    notes: tuple[str, ...] = dataclasses.field(
        default=(),
        compare=False,
        repr=False,
        metadata=parameter("What was assumed or ignored when the file was read").metadata,
    )

    def __post_init__(self):
        check(self)
        if not isinstance(self.front, (PacejkaTire, LinearTire)):
            raise ParameterError(f"front: expected a tire, got {self.front!r}")
        if type(self.rear) is not type(self.front):
            raise ParameterError(f"rear: expected a tire as in front, got {self.rear!r}")
        if self.delta_max >= 0.5 * math.pi:
            raise ParameterError(f"delta_max: expected less than pi/2 rad, got {self.delta_max:g}")
        if self.h_cg > self.l_wb:
            raise ParameterError(
                f"h_cg: expected at most the wheelbase, {self.l_wb:g} m, got {self.h_cg:g}"
            )
        for key, lever in (("a_max", self.l_r), ("a_brake_max", self.l_f)):
            value, most = getattr(self, key), GRAVITY * lever
            if value * self.h_cg >= most:
                raise ParameterError(
                    f"{key}: expected less than {most / self.h_cg:g} m/s^2, which lifts an axle "
                    f"with the center of gravity {self.h_cg:g} m high (h_cg), got {value:g}"
                )

    @property
    def l_wb(self) -> float:
        """Wheelbase ``l_f + l_r`` [m]."""
        return self.l_f + self.l_r


_LIMITS = ("delta_max", "delta_rate_max", "v_max", "a_max", "a_brake_max", "width", "length")
_LIMITS += ("a_lat_max",)
_REQUIRED = ("m", "I_z", "l_f", "l_r", "h_cg", "mu")

# other spellings of the published model files
_SYNONYMS = {
    "model_name": "name",
    "racecar_version": "name",
    "friction_coeff": "mu",
    "mass": "m",
    "Iz": "I_z",
    "I": "I_z",
    "lf": "l_f",
    "lr": "l_r",
    "wheelbase": "l_wb",
    "width_m": "width",
    "max_steering_angle": "delta_max",
    "s_max": "delta_max",
    "max_steering_velocity": "delta_rate_max",
    "sv_max": "delta_rate_max",
}
# keys of drive and servo in files that the identification of the MAP controller's authors writes
_DRIVE_KEYS = frozenset(("C_0d", "C_d", "C_acc", "C_dec", "C_R", "C_0v", "C_v", "tau_steer"))

# tire coefficients of one axle ("f" or "r"), in each spelling of the published model files
_TIRE_KEYS = {
    "pacejka": lambda axle: (("C_P" + axle,), tuple(c + axle for c in "BCDE")),
    "linear": lambda axle: (("C_S" + axle,),),
}


def load_vehicle(source: str | Path) -> Vehicle:
    """Read a car from a YAML file, including published model files.

    Newer public stacks split a car: mass and geometry are in ``car_model.yaml``, the tires of each
    floor in a file next to it or in ``pacejka/FLOOR/``. Given either of the two, both are read.

    `Vehicle.notes` lists unused keys, assumptions, and values that are unusual for cars of this
    size; values that are certainly in another unit are refused.

    Parameters
    ----------
    source : str or pathlib.Path
        Shipped vehicle or path of a file; ``config/vehicles/nuc4.yaml`` explains each key.

    Raises
    ------
    ParameterError
        If there is no such file; if a parameter is missing or impossible; if there are tires of
        several floors.
    FileFormatError
        If the file is not a YAML mapping.
    """
    path = find_config("vehicles", source, (".yaml",))
    values = read_yaml_mapping(path, "a vehicle file")
    try:
        values, notes = _joined(path, values)
        vehicle = vehicle_of(values, path.stem)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from None
    return dataclasses.replace(vehicle, notes=(*notes, *vehicle.notes))


def _joined(path, values):
    """Values of a file and of the file with the other half of the car, and notes."""
    body, tires = "m" in values or "mass" in values, _has_tires(values)
    if tires and not body:
        for folder in list(path.resolve().parents)[:3]:
            other = folder / "car_model.yaml"
            if other.is_file() and other != path.resolve():
                return {**read_yaml_mapping(other), **values}, [f"mass and geometry from {other}"]
    if body and not tires:
        found = [
            other
            for pattern in ("*.yaml", "pacejka/*/default.yaml")
            for other in sorted(path.resolve().parent.glob(pattern))
            if other != path.resolve() and _holds_only_tires(other)
        ]
        if len(found) > 1:
            several = ", ".join(map(str, found))
            raise ParameterError(f"no tires, but several tire files: give one of {several}")
        if found:
            return {**values, **read_yaml_mapping(found[0])}, [f"tires from {found[0]}"]
    return values, []


def _has_tires(values):
    return any(
        key in values
        for spellings in _TIRE_KEYS.values()
        for axle in "fr"
        for keys in spellings(axle)
        for key in keys
    )


def _holds_only_tires(path):
    try:
        values = read_yaml_mapping(path)
    except FileFormatError:
        return False
    return _has_tires(values) and not {"m", "mass"} & set(values)


def save_vehicle(vehicle: Vehicle, path: str | Path, comment: str = "") -> None:
    """Write a car to a YAML file that `load_vehicle` reads back unchanged.

    Parameters
    ----------
    vehicle : Vehicle
    path : str or pathlib.Path
        File to write or replace; unchanged if writing fails.
    comment : str, optional
        Source of the values, written as a comment at the top.

    Raises
    ------
    MapRacingError
        If the file cannot be written.
    """
    lines = yaml_text(vehicle_values(vehicle), default_flow_style=None)
    with replacing(path) as file:
        file.write("# Vehicle of map_racing: SI units and radians\n")
        file.writelines(f"# {line}".rstrip() + "\n" for line in comment.splitlines())
        file.write(lines)


def vehicle_values(vehicle: Vehicle) -> dict:
    """The keys and values of the YAML file of a car."""
    values = {"name": vehicle.name, **{key: getattr(vehicle, key) for key in _REQUIRED}}
    values["tire_model"] = vehicle.front.model
    for axle, tire in (("f", vehicle.front), ("r", vehicle.rear)):
        coefficients = list(dataclasses.astuple(tire))
        if isinstance(tire, PacejkaTire):
            values["C_P" + axle] = coefficients
        else:
            values["C_S" + axle] = coefficients[0]
    values.update((key, getattr(vehicle, key)) for key in _LIMITS)
    if vehicle.a_lat_max == NO_LIMIT:
        del values["a_lat_max"]
    return values


def parameter_hash(vehicle: Vehicle) -> str:
    """Fingerprint of the single-track model, to tell which car a lookup table belongs to.

    Twelve hexadecimal digits from mass, inertia, geometry, friction and tires, but not from the
    name, the limits or the layout of the file.
    """
    model = {key: getattr(vehicle, key) for key in _REQUIRED}
    for key in ("front", "rear"):
        tire = getattr(vehicle, key)
        model[key] = [tire.model, *dataclasses.astuple(tire)]
    return hashlib.sha256(json.dumps(model, sort_keys=True).encode()).hexdigest()[:12]


def linearized(vehicle: Vehicle) -> Vehicle:
    """The same car on linear tires with the slope at zero slip, named with ``_linear`` appended."""
    return dataclasses.replace(
        vehicle,
        name=vehicle.name + "_linear",
        front=LinearTire(vehicle.front.stiffness),
        rear=LinearTire(vehicle.rear.stiffness),
    )


def scaled_tires(vehicle, mu, front_stiffness, rear_stiffness):
    """The car with other tires.

    Parameters
    ----------
    vehicle : Vehicle
    mu : float
        Factor on the friction and on ``a_lat_max``.
    front_stiffness, rear_stiffness : float
        Factors on the cornering stiffness of each axle; the peak force is kept.

    Returns
    -------
    Vehicle
    """
    limit = vehicle.a_lat_max
    return dataclasses.replace(
        vehicle,
        mu=vehicle.mu * mu,
        a_lat_max=limit if limit == NO_LIMIT else limit * mu,
        front=_scaled(vehicle.front, front_stiffness),
        rear=_scaled(vehicle.rear, rear_stiffness),
    )


def holding(vehicle: Vehicle, a_lat: float) -> Vehicle:
    """The car with `a_lat_max` raised to a lateral acceleration [m/s^2] that it sustained."""
    return dataclasses.replace(vehicle, a_lat_max=max(vehicle.a_lat_max, a_lat))


def _scaled(tire, factor):
    """The tire with its cornering stiffness scaled and its peak kept."""
    if isinstance(tire, PacejkaTire):
        return dataclasses.replace(tire, B=tire.B * factor)
    return dataclasses.replace(tire, C_S=tire.C_S * factor)


def vehicle_of(values: dict, default_name: str = "vehicle") -> Vehicle:
    """Make a car from the keys and values of a file, see `load_vehicle`.

    Raises
    ------
    ParameterError
        If a parameter is missing or impossible.
    """
    rest, notes = {}, []
    for key, value in values.items():
        key = _SYNONYMS.get(key, key)
        if key in rest:
            raise ParameterError(f"{key}: expected once, got it under two names")
        rest[key] = value
    if "h_cg" not in rest and "h" in rest:
        rest["h_cg"] = rest.pop("h")

    model = _tire_model(rest, default_name)
    published = "name" not in values and (
        "model_name" in values
        or default_name.endswith(("_pacejka", "_linear"))
        or _DRIVE_KEYS & set(values)
    )
    rest["mu"] = _friction(rest.get("mu"), published and "mu" in values, notes)
    arguments = {
        "name": rest.pop("name", default_name),
        "front": _tire(model, "f", rest),
        "rear": _tire(model, "r", rest),
    }
    for key in _REQUIRED:
        if key not in rest:
            raise ParameterError(f"{key}: missing")
        arguments[key] = rest.pop(key)
    for key in _LIMITS:
        if key in rest:
            arguments[key] = rest.pop(key)
    if "a_min" in rest:
        if "a_brake_max" in arguments:
            raise ParameterError("a_min: expected either a_min or a_brake_max, got both")
        # published with either sign
        arguments["a_brake_max"] = abs(finite("a_min", rest.pop("a_min")))
    wheelbase = rest.pop("l_wb", None)
    # The servo's time constant belongs to the plant, not to the model.
    unknown = [str(key) for key in rest if key != "tau_steer"]
    if unknown:
        notes.append(f"keys not used: {', '.join(unknown)}")

    vehicle = Vehicle(**arguments)
    if wheelbase is not None and abs(finite("l_wb", wheelbase) - vehicle.l_wb) > 1e-6:
        text = f"l_wb: expected l_f + l_r = {vehicle.l_wb:g}, got {wheelbase:g}"
        if not published:
            raise ParameterError(text)
        notes.append(f"{text}: not used")  # the programs for these files ignore it, too
    notes += [f"warning: {doubt}" for doubt in doubts_of_vehicle(vehicle)]
    return dataclasses.replace(vehicle, notes=tuple(notes))


def _tire_model(rest, file_name):
    """Take the tire model from a file, its coefficients, or its name."""
    given = [
        model
        for model in _TIRE_KEYS
        if any(key in rest for keys in _TIRE_KEYS[model]("f") for key in keys)
    ]
    model = rest.pop("tire_model", None)
    if model is None:
        named = [model for model in given if file_name.lower().endswith(model)]
        if len(given) != 1 and len(named) != 1:
            raise ParameterError(
                f"tire_model: missing, expected {' or '.join(_TIRE_KEYS)}"
                + ("" if given else ", and there is no tire (C_Pf and C_Pr, or C_Sf and C_Sr)")
            )
        return (named or given)[0]
    if not isinstance(model, str) or model.lower() not in _TIRE_KEYS:
        raise ParameterError(f"tire_model: expected {' or '.join(_TIRE_KEYS)}, got {model!r}")
    return model.lower()


def _friction(mu, ignored, notes):
    """Friction coefficient as the program that a file was made for uses it.

    The single-track model with which the authors of the MAP controller fit tires and make tables
    has no friction coefficient, because ``D`` of the tires includes it. A ``mu`` in these files has
    no effect.
    """
    if mu is None:
        notes.append("no mu: 1 assumed")
        return 1.0
    if ignored and positive("mu", mu) != 1.0:
        notes.append(
            f"mu: {mu:g} ignored, 1 used, as in the program that wrote this file (to use mu, "
            "rename model_name to name)"
        )
        return 1.0
    return mu


def _tire(model, axle, values):
    """Take the coefficients of one axle's tire out of `values`."""
    spellings = _TIRE_KEYS[model](axle)
    for keys in spellings:
        if not any(key in values for key in keys):
            continue
        missing = [key for key in keys if key not in values]
        if missing:
            raise ParameterError(f"{missing[0]}: missing")
        coefficients = [values.pop(key) for key in keys]
        break
    else:
        raise ParameterError(f"{spellings[0][0]}: missing (tire_model is {model})")
    try:
        if model == "linear":
            return LinearTire(*coefficients)
        if len(keys) == 1:
            (coefficients,) = coefficients
            if not isinstance(coefficients, list) or len(coefficients) != 4:
                raise ParameterError(f"expected a list [B, C, D, E], got {coefficients!r}")
        return PacejkaTire(*coefficients)
    except ParameterError as error:
        where = "front tire" if axle == "f" else "rear tire"
        raise ParameterError(f"{where} ({', '.join(keys)}): {error}") from None
