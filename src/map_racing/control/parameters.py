"""Controller parameters and their files."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path

import yaml

from ..errors import ParameterError
from ..files import read_yaml_mapping, replacing
from ..resources import config_directory, find_config
from ..validation import POSITIVE, check, documented, parameter, read_parameters
from ..vehicle.parameters import Vehicle
from ..vehicle.single_track import GRAVITY
from ..vehicle.size import ONE_TENTH, Size, size_of
from .guidance import LookaheadLaw
from .safety_limits import SafetyLimits

__all__ = [
    "ControllerParameters",
    "MpcParameters",
    "growth",
    "load_controller_parameters",
    "load_law",
    "load_safety_limits",
    "parameter_values",
    "parameters_of",
    "save_controller_parameters",
]

# Each with the shipped controller that holds the lookahead usual with it.
STEERING_MAPS = {"table": "map", "linear_table": "map_linear", "ackermann": "pure_pursuit"}
SPEED_SOURCES = ("measured", "command")
ETA_FROM = ("velocity", "heading")
LOOKAHEAD_FROM = ("car", "path")
MPC_MODELS = ("single_track", "kinematic")
REFERENCE_POINTS = ("rear_axle", "center_of_gravity")

# What is given for 1:10 cars and changes with the size of the car: powers of the factors on lengths
# and on times. Delays are those of sensors and actuators, and do not.
_GROWTH = {
    **dict.fromkeys(("m_m", "lookahead_min_m", "lookahead_max_m", "heading_weight_m"), (1, 0)),
    **dict.fromkeys(("speed_lookahead_s", "stage_s"), (0, 1)),
    "steering_rate_weight_ms": (1, 1),
    # Delays bound these. For a larger car's size its delays are shorter, so it may look less far
    # ahead and feed back more of the yaw rate: each by the root of that.
    "q_s": (0, 0.5),
    "yaw_rate_gain_s": (0, 1.5),
}
# Shares of a car's driving and braking that the shipped controllers ask for, as of nuc4's.
_DRIVE_SHARE, _BRAKE_SHARE = 0.93, 0.73
# No car is driven by this faster [m/s].
_FASTEST = 200.0


@documented
@dataclass(frozen=True)
class ControllerParameters:
    """All that tunes a controller; a file in ``config/controllers`` holds the same names.

    The lookahead distance is ``L_d = m + q v``, with the letters of the paper.
    """

    steering_map: str = parameter(
        "What turns a lateral acceleration into a steering angle: MAP's table of the vehicle's "
        "tires, the same with linear tires, or the kinematics of pure pursuit",
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
        "Share of the distance driven while the slip of the rear axle builds up, v^2 / (g mu C_r), "
        "that is added to the lookahead distance. 0 as in the paper",
        low=0.0,
        high=5.0,
        tuning=(0.0, 5.0),
        default=0.0,
    )
    eta_from: str = parameter(
        "Direction from which the angle to the lookahead point counts: the velocity, as in L1 "
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
        "Largest speed at which a table is read; the tables of the authors end at 7 m/s",
        "m/s",
        low=POSITIVE,
        default=100.0,
    )
    curvature_feedforward: float = parameter(
        "Share of the curvature that the law lacks on the path itself which is added to it. 0 as "
        "in the paper",
        low=0.0,
        high=1.0,
        tuning=(0.0, 1.0),
        default=0.0,
    )
    yaw_rate_gain_s: float = parameter(
        "Steering angle added for each rad/s by which the car turns slower than the demand. 0 as "
        "in the paper",
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
        "Time ahead at which the speed of the raceline is read, to make up for lag of the drive",
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
        "Share of the lateral acceleration that the tires can reach which the speeds may use; the "
        "car drives slower than the raceline where that asks for more. 0 for the speeds of the "
        "raceline, whatever the grip",
        low=0.0,
        high=1.2,
        tuning=(0.0, 1.2),
        default=0.0,
    )
    a_drive_max_mps2: float = parameter(
        "Largest driving acceleration of such speeds; in a bend what the friction ellipse leaves",
        "m/s^2",
        low=POSITIVE,
        high=100.0,
        tuning=(0.5, 20.0),
        default=7.0,
    )
    a_brake_max_mps2: float = parameter(
        "Largest braking of such speeds; in a bend what the friction ellipse leaves",
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
        "What is learned of the tires stays within this share of the vehicle file's friction and "
        "stiffness",
        low=0.0,
        high=0.6,
        default=0.4,
    )
    reference_point: str = parameter(
        "Point of the car that localization reports and that follows the raceline. The rear axle "
        "is base_link",
        choices=REFERENCE_POINTS,
        default="rear_axle",
    )

    # What is tuned, see `map_racing.experiments.tuning`.
    TUNED = ("m_m", "q_s")

    def __post_init__(self):
        check(self)
        _check_grip_use(self.grip_use)
        if self.lookahead_min_m > self.lookahead_max_m:
            raise ParameterError(
                f"lookahead_min_m: expected at most lookahead_max_m, {self.lookahead_max_m:g}, "
                f"got {self.lookahead_min_m:g}"
            )

    def lookahead(self, vehicle: Vehicle) -> LookaheadLaw:
        """The `LookaheadLaw` of these parameters with the rear tires of a vehicle.

        The slip of the rear axle builds up within ``v / (g mu C_r)``, with the cornering stiffness
        ``C_r`` normalized by the load [1/rad]: until then the car does not move where it points.
        """
        growth = self.slip_lookahead / (GRAVITY * vehicle.mu * vehicle.rear.stiffness)
        bounds = self.lookahead_min_m, self.lookahead_max_m
        return LookaheadLaw(self.m_m, self.q_s, *bounds, growth)

    def with_(self, **changes) -> ControllerParameters:
        """A checked copy with some values changed."""
        return replace(self, **changes)

    def of_size(self, vehicle: Vehicle) -> ControllerParameters:
        """These values, given for a 1:10 car, for a car of another size, see `size_of`.

        Distances and times grow with it; speeds and accelerations are bounded by the vehicle's
        limits instead. Nothing changes for 1:10 cars.
        """
        return self if size_of(vehicle) == ONE_TENTH else self.with_(**_sized(self, vehicle))


def _check_grip_use(grip_use):
    if 0.0 < grip_use < 0.1:  # a plan would crawl around the lap
        raise ParameterError(f"grip_use: expected 0 (off) or 0.1 to 1.2, got {grip_use:g}")


def growth(name: str, size: Size) -> float:
    """Factor on a parameter for a car of another size; 1 for what does not grow with it."""
    of_length, of_time = _GROWTH.get(name, (0, 0))
    return size.length**of_length * size.time**of_time


def _sized(parameters, vehicle):
    """The values that differ for a car of another size."""
    values, size = vars(parameters), size_of(vehicle)
    changes = {n: round(values[n] * growth(n, size), 6) for n in _GROWTH if n in values}
    if "table_v_max_mps" in values:  # the authors' tables end earlier, not those of this car
        changes["table_v_max_mps"] = max(values["table_v_max_mps"], vehicle.v_max)
    return {
        **changes,
        "v_max_mps": min(vehicle.v_max, _FASTEST),
        "a_drive_max_mps2": min(values["a_drive_max_mps2"], _DRIVE_SHARE * vehicle.a_max),
        "a_brake_max_mps2": min(values["a_brake_max_mps2"], _BRAKE_SHARE * vehicle.a_brake_max),
    }


def _as_in_map(name):
    """The field of `ControllerParameters` of this name: the same meaning, range and default."""
    known = {f.name: f for f in fields(ControllerParameters)}[name]
    return field(default=known.default, metadata=known.metadata)


@documented
@dataclass(frozen=True)
class MpcParameters:
    """Parameters of model predictive control; a controller file with ``law: mpc`` holds them."""

    model: str = parameter(
        "Model of the prediction: tires of the vehicle, or kinematics", choices=MPC_MODELS
    )
    heading_weight_m: float = parameter(
        "Lateral error [m] that costs as much as a direction of motion 1 rad off the raceline's",
        "m",
        low=0.0,
        high=10.0,
    )
    steering_rate_weight_ms: float = parameter(
        "Lateral error [m] that costs as much as a steering rate of 1 rad/s, counted as at least "
        "0.005",
        "m s",
        low=0.0,
        high=10.0,
    )
    stages: int = parameter("Stages of the horizon", low=5, high=100, default=20)
    stage_s: float = parameter("Length of a stage", "s", low=0.01, high=0.2, default=0.05)
    iterations: int = parameter(
        "Most iterations of the solver in a step", low=10, high=10000, default=100
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

    def __post_init__(self):
        check(self)
        _check_grip_use(self.grip_use)

    def with_(self, **changes) -> MpcParameters:
        """A checked copy with some values changed."""
        return replace(self, **changes)

    def of_size(self, vehicle: Vehicle) -> MpcParameters:
        """As `ControllerParameters.of_size`."""
        return self if size_of(vehicle) == ONE_TENTH else self.with_(**_sized(self, vehicle))


LAWS = {"l1": ControllerParameters, "mpc": MpcParameters}


def parameters_of(source: str | Path, values: dict) -> ControllerParameters | MpcParameters:
    """Controller parameters of a mapping, by its ``law``: ``l1``, if it has none, or ``mpc``.

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
    """What `parameters_of` reads."""
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
    """Whether a file is for 1:10 cars, not somebody's own for a car."""
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
        The car. The shipped files are for 1:10 cars and, with it, scaled to its size by
        `ControllerParameters.of_size`; other files are taken as they stand.

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
        raise ParameterError(f"{source}: law: expected l1 here, got 'mpc', which only races know")
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
        With the default of each limit that the file does not have.

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
        A file there is replaced when the new one is complete.
    limits : SafetyLimits, optional
        Written, too, for `load_safety_limits`.

    Raises
    ------
    MapRacingError
        If it cannot be written.
    """
    with replacing(path) as file:
        file.write("# config/controllers/map.yaml of map_racing says what each name means.\n\n")
        yaml.safe_dump(parameter_values(parameters), file, sort_keys=False)
        if limits is not None:
            yaml.safe_dump({"safety": asdict(limits)}, file, sort_keys=False)
