"""Controller parameters and their files."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path
from typing import TypeVar

from ..errors import ParameterError
from ..files import read_yaml_mapping, replacing, yaml_text
from ..resources import config_directory, find_config
from ..validation import POSITIVE, check, documented, parameter, read_parameters
from ..vehicle.parameters import Vehicle
from ..vehicle.single_track import GRAVITY
from ..vehicle.size import ONE_TENTH, Size, size_of
from .guidance import LookaheadLaw
from .safety_limits import SafetyLimits

__all__ = [
    "ControllerParameters",
    "LawParameters",
    "MpcParameters",
    "growth",
    "load_controller_parameters",
    "load_law",
    "load_safety_limits",
    "parameter_values",
    "parameters_of",
    "save_controller_parameters",
]

# For each steering map, the shipped controller whose lookahead suits it.
STEERING_MAPS = {"table": "map", "linear_table": "map_linear", "ackermann": "pure_pursuit"}
SPEED_SOURCES = ("measured", "command")
ETA_FROM = ("velocity", "heading")
LOOKAHEAD_FROM = ("car", "path")
MPC_MODELS = ("single_track", "kinematic")
REFERENCE_POINTS = ("rear_axle", "center_of_gravity")

# Parameters that are given for 1:10 cars and scale with the size of the car: powers of the factors
# on lengths and times. Delays belong to sensors and actuators and do not scale.
_GROWTH = {
    **dict.fromkeys(("m_m", "lookahead_min_m", "lookahead_max_m", "heading_weight_m"), (1, 0)),
    **dict.fromkeys(("speed_lookahead_s", "stage_s"), (0, 1)),
    "steering_rate_weight_ms": (1, 1),
    # Delays bound these. Relative to its size a larger car has shorter delays, so it may look less
    # far ahead and feed back more of the yaw rate: each by the square root of that.
    "q_s": (0, 0.5),
    "yaw_rate_gain_s": (0, 1.5),
}
# Shares of the car's largest acceleration and braking that the shipped controllers use at most.
_DRIVE_SHARE, _BRAKE_SHARE = 0.93, 0.73
# Largest speed that any controller may command [m/s].
_FASTEST = 200.0

_Law = TypeVar("_Law", bound="LawParameters")


def growth(name: str, size: Size) -> float:
    """Factor on a parameter for a car of another size; 1 if it does not depend on the size."""
    of_length, of_time = _GROWTH.get(name, (0, 0))
    return size.length**of_length * size.time**of_time


class LawParameters:
    """What the parameters of all laws have in common."""

    def __post_init__(self):
        check(self)
        if 0.0 < self.grip_use < 0.1:  # a plan would crawl around the lap
            raise ParameterError(f"grip_use: expected 0 (off) or 0.1 to 1.2, got {self.grip_use:g}")

    def with_(self: _Law, **changes) -> _Law:
        """A checked copy with some values changed."""
        return replace(self, **changes)

    def of_size(self: _Law, vehicle: Vehicle) -> _Law:
        """Scale these values from a 1:10 car to another size, see `size_of`.

        Distances and times scale with the size; speeds and accelerations are bounded by the
        vehicle's limits instead. Nothing changes for 1:10 cars.
        """
        values, size = vars(self), size_of(vehicle)
        if size == ONE_TENTH:
            return self
        changes = {n: round(values[n] * growth(n, size), 6) for n in _GROWTH if n in values}
        if "table_v_max_mps" in values:  # the limit is for the authors' tables, not this car's
            changes["table_v_max_mps"] = max(values["table_v_max_mps"], vehicle.v_max)
        return self.with_(
            **changes,
            v_max_mps=min(vehicle.v_max, _FASTEST),
            a_drive_max_mps2=min(values["a_drive_max_mps2"], _DRIVE_SHARE * vehicle.a_max),
            a_brake_max_mps2=min(values["a_brake_max_mps2"], _BRAKE_SHARE * vehicle.a_brake_max),
        )


@documented
@dataclass(frozen=True)
class ControllerParameters(LawParameters):
    """Tuning of a controller; files in ``config/controllers`` use the same names.

    The lookahead distance is ``L_d = m + q v``, with the letters of the paper.
    """

    steering_map: str = parameter(
        "What turns a lateral acceleration into a steering angle: MAP's lookup table of the "
        "vehicle's tires, the same with linear tires, or the kinematics of pure pursuit",
        choices=tuple(STEERING_MAPS),
    )
    # Bounds leave room for full-scale cars, and none for centimeters, milliseconds or km/h.
    m_m: float = parameter(
        "Offset m of the lookahead distance", "m", low=-25.0, high=25.0, tuning=(-1.0, 3.0)
    )
    q_s: float = parameter(
        "Gain q of the lookahead distance", "s", low=-10.0, high=10.0, tuning=(0.0, 2.0)
    )
    lookahead_min_m: float = parameter(
        "Shortest lookahead distance",
        "m",
        low=POSITIVE,
        high=50.0,
        tuning=(0.05, 5.0),
        default=0.3,
    )
    lookahead_max_m: float = parameter(
        "Longest lookahead distance",
        "m",
        low=POSITIVE,
        high=500.0,
        tuning=(0.1, 20.0),
        default=5.0,
    )
    slip_lookahead: float = parameter(
        "Share of v^2 / (g mu C_r), the distance driven while the slip of the rear axle builds up, "
        "that is added to the lookahead distance. 0 as in the paper",
        low=0.0,
        high=5.0,
        tuning=(0.0, 5.0),
        default=0.0,
    )
    eta_from: str = parameter(
        "Direction from which the angle to the lookahead point is measured: the velocity, as in L1 "
        "guidance, or, as in the authors' code, the heading",
        choices=ETA_FROM,
        default="velocity",
    )
    lookahead_from: str = parameter(
        "Where the lookahead distance begins: at the car or, as in the authors' code, at the point "
        "of the path beside it",
        choices=LOOKAHEAD_FROM,
        default="car",
    )
    table_v_max_mps: float = parameter(
        "Highest speed at which the lookup table is read, also for a faster car; the authors' "
        "tables end at 7 m/s",
        "m/s",
        low=POSITIVE,
        default=100.0,
    )
    curvature_feedforward: float = parameter(
        "Share of the curvature that the guidance law lacks on the path itself, added as "
        "feedforward. 0 as in the paper",
        low=0.0,
        high=1.0,
        tuning=(0.0, 1.0),
        default=0.0,
    )
    yaw_rate_gain_s: float = parameter(
        "Steering angle added per rad/s by which the yaw rate falls short of the demand. 0 as in "
        "the paper",
        "s",
        low=0.0,
        high=0.5,
        tuning=(0.0, 0.2),
        default=0.0,
    )
    delay_s: float = parameter(
        "Delay compensation: age of a pose when it is used plus dead time of the steering. 0 for "
        "none, as in the paper. Too short and the car oscillates, too long and it cuts corners",
        "s",
        low=0.0,
        high=1.0,
        tuning=(0.0, 0.5),
        default=0.0,
    )
    speed_source: str = parameter(
        "Speed in guidance law and steering map: measured, or commanded as in the paper",
        choices=SPEED_SOURCES,
        default="measured",
    )
    speed_lookahead_s: float = parameter(
        "Time ahead at which the raceline's speed is read, to compensate the lag of the drive",
        "s",
        low=0.0,
        high=1.0,
        tuning=(0.0, 1.0),
        default=0.0,
    )
    speed_scale: float = parameter(
        "Scale of the speeds, 1 for 100 % of the raceline",
        low=0.0,
        high=2.0,
        tuning=(0.0, 2.0),
        default=1.0,
    )
    v_max_mps: float = parameter(
        "Largest speed commanded",
        "m/s",
        low=POSITIVE,
        high=_FASTEST,
        tuning=(0.1, 30.0),
        default=12.0,
    )
    grip_use: float = parameter(
        "Share of the tires' largest lateral acceleration that the speeds may use; where the "
        "raceline asks for more, the car drives slower. 0 for the speeds of the raceline, whatever "
        "the grip",
        low=0.0,
        high=1.2,
        tuning=(0.0, 1.2),
        default=0.0,
    )
    a_drive_max_mps2: float = parameter(
        "Largest driving acceleration with grip_use; in a bend, what the friction ellipse leaves",
        "m/s^2",
        low=POSITIVE,
        high=100.0,
        tuning=(0.5, 20.0),
        default=7.0,
    )
    a_brake_max_mps2: float = parameter(
        "Largest braking with grip_use; in a bend, what the friction ellipse leaves",
        "m/s^2",
        low=POSITIVE,
        high=100.0,
        tuning=(0.5, 20.0),
        default=6.0,
    )
    adaptation: bool = parameter(
        "Learn grip, cornering stiffness and delay while driving: steering map, speeds and delay "
        "compensation follow",
        tuning=(False, True),
        default=False,
    )
    adaptation_share: float = parameter(
        "Learned friction and stiffness stay within this share of the vehicle file's",
        low=0.0,
        high=0.6,
        default=0.4,
    )
    reference_point: str = parameter(
        "Point of the car whose pose localization reports and that follows the raceline. The rear "
        "axle is base_link",
        choices=REFERENCE_POINTS,
        default="rear_axle",
    )

    # What is tuned, see `map_racing.experiments.tuning`.
    TUNED = ("m_m", "q_s")

    def __post_init__(self):
        super().__post_init__()
        if self.lookahead_min_m > self.lookahead_max_m:
            raise ParameterError(
                f"lookahead_min_m: expected at most lookahead_max_m, {self.lookahead_max_m:g}, "
                f"got {self.lookahead_min_m:g}"
            )

    def lookahead(self, vehicle: Vehicle) -> LookaheadLaw:
        """The `LookaheadLaw` of these parameters with the rear tires of a vehicle.

        The slip of the rear axle builds up within the time ``v / (g mu C_r)``, with the cornering
        stiffness ``C_r`` normalized by the load [1/rad]; until then the direction of motion lags
        behind the heading.
        """
        growth = self.slip_lookahead / (GRAVITY * vehicle.mu * vehicle.rear.stiffness)
        bounds = self.lookahead_min_m, self.lookahead_max_m
        return LookaheadLaw(self.m_m, self.q_s, *bounds, growth)


def _as_in_map(name):
    """The field of `ControllerParameters` of this name: the same meaning, range and default."""
    known = {f.name: f for f in fields(ControllerParameters)}[name]
    return field(default=known.default, metadata=known.metadata)


@documented
@dataclass(frozen=True)
class MpcParameters(LawParameters):
    """Parameters of model predictive control; a controller file with ``law: mpc`` holds them."""

    model: str = parameter(
        "Model of the prediction: tires of the vehicle, or kinematics", choices=MPC_MODELS
    )
    heading_weight_m: float = parameter(
        "Lateral error [m] that costs as much as a direction of motion 1 rad off the raceline",
        "m",
        low=0.0,
        high=10.0,
    )
    steering_rate_weight_ms: float = parameter(
        "Lateral error [m] that costs as much as a steering rate 1 rad/s off the reference; at "
        "least 0.005 is used",
        "m s",
        low=0.0,
        high=10.0,
    )
    stages: int = parameter("Stages of the horizon", low=5, high=100, default=20)
    stage_s: float = parameter("Length of a stage", "s", low=0.01, high=0.2, default=0.05)
    iterations: int = parameter(
        "Largest number of solver iterations per step", low=10, high=10000, default=100
    )
    delay_s: float = _as_in_map("delay_s")
    speed_lookahead_s: float = _as_in_map("speed_lookahead_s")
    speed_scale: float = _as_in_map("speed_scale")
    v_max_mps: float = _as_in_map("v_max_mps")
    grip_use: float = _as_in_map("grip_use")
    a_drive_max_mps2: float = _as_in_map("a_drive_max_mps2")
    a_brake_max_mps2: float = _as_in_map("a_brake_max_mps2")
    reference_point: str = _as_in_map("reference_point")

    # What is tuned, see `map_racing.experiments.tuning`.
    TUNED = ("heading_weight_m", "steering_rate_weight_ms")


LAWS = {"l1": ControllerParameters, "mpc": MpcParameters}


def parameters_of(source: str | Path, values: dict) -> ControllerParameters | MpcParameters:
    """Controller parameters from a mapping; its ``law`` is ``l1``, the default, or ``mpc``.

    Raises
    ------
    ParameterError
        If a parameter is missing, unknown or impossible; the message names `source` and parameter.
    """
    values = dict(values)
    law = values.pop("law", "l1")
    if not isinstance(law, str) or law not in LAWS:
        raise ParameterError(f"{source}: law: expected {' or '.join(LAWS)}, got {law!r}")
    return read_parameters(source, LAWS[law], values)


def parameter_values(parameters: ControllerParameters | MpcParameters) -> dict:
    """The mapping that `parameters_of` reads."""
    values = asdict(parameters)
    return {"law": "mpc", **values} if isinstance(parameters, MpcParameters) else values


def load_law(
    source: str | Path, vehicle: Vehicle | None = None
) -> ControllerParameters | MpcParameters:
    """Read a controller file of any law; see `load_controller_parameters` and `parameters_of`."""
    path = find_config("controllers", source, (".yaml",))
    values = read_yaml_mapping(path, "a controller file")
    values.pop("safety", None)
    parameters = parameters_of(path, values)
    return parameters.of_size(vehicle) if _shipped(path) and vehicle is not None else parameters


def _shipped(path):
    """Whether a file ships with this package, and so is for 1:10 cars."""
    return path.parent == config_directory() / "controllers"


def load_controller_parameters(
    source: str | Path, vehicle: Vehicle | None = None
) -> ControllerParameters:
    """Read controller parameters from YAML.

    Parameters
    ----------
    source : str or pathlib.Path
        Shipped name (``"map"``, ``"pure_pursuit"``, ...) or path of a YAML file.
    vehicle : Vehicle, optional
        The car. Shipped files are for 1:10 cars; `ControllerParameters.of_size` scales them to the
        size of this one. Other files are taken as they are.

    Returns
    -------
    ControllerParameters

    Raises
    ------
    ParameterError
        If a parameter is missing, unknown or impossible, or the file is for another law than L1
        guidance; the message names file and parameter.
    """
    parameters = load_law(source, vehicle)
    if not isinstance(parameters, ControllerParameters):
        raise ParameterError(f"{source}: law: expected l1 here, got 'mpc', which is only for races")
    return parameters


def load_safety_limits(source: str | Path, vehicle: Vehicle | None = None) -> SafetyLimits:
    """Read the mapping ``safety`` of a controller's file.

    Parameters
    ----------
    source : str or pathlib.Path
        As for `load_controller_parameters`.
    vehicle : Vehicle, optional
        The car: the limits of shipped files are scaled to its size by `SafetyLimits.of_size`.

    Returns
    -------
    SafetyLimits
        Limits missing from the file have their defaults.

    Raises
    ------
    ParameterError
        If a limit is unknown or impossible; the message names file and limit.
    """
    path = find_config("controllers", source, (".yaml",))
    values = read_yaml_mapping(path).get("safety", {})
    if not isinstance(values, dict):
        raise ParameterError(f"{path}: safety: expected names and values, got {values!r}")
    limits = read_parameters(f"{path}: safety", SafetyLimits, values)
    return limits.of_size(vehicle) if _shipped(path) and vehicle is not None else limits


def save_controller_parameters(
    parameters: ControllerParameters | MpcParameters,
    path: str | Path,
    limits: SafetyLimits | None = None,
) -> None:
    """Write controller parameters to YAML that `load_controller_parameters` reads back.

    Parameters
    ----------
    parameters : ControllerParameters
    path : str or pathlib.Path
        An existing file is replaced once the new one is complete.
    limits : SafetyLimits, optional
        Written as well, for `load_safety_limits`.

    Raises
    ------
    MapRacingError
        If it cannot be written.
    """
    with replacing(path) as file:
        file.write("# config/controllers/map.yaml of map_racing says what each name means.\n\n")
        file.write(yaml_text(parameter_values(parameters)))
        if limits is not None:
            file.write(yaml_text({"safety": asdict(limits)}))
