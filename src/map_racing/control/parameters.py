"""Controller parameters and their files."""

from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property

import yaml

from ..errors import ParameterError
from ..files import read_yaml_mapping, replacing
from ..resources import find_config
from ..validation import finite, read_parameters
from .guidance import LookaheadLaw
from .safety import SafetyLimits

__all__ = [
    "ControllerParameters",
    "load_controller_parameters",
    "load_safety_limits",
    "save_controller_parameters",
]

STEERING_MAPS = ("ackermann", "linear_table", "table")
SPEED_SOURCES = ("measured", "command")
ETA_FROM = ("velocity", "heading")
LOOKAHEAD_FROM = ("car", "path")
REFERENCE_POINTS = ("rear_axle", "center_of_gravity")


@dataclass(frozen=True)
class ControllerParameters:
    """All that tunes a controller; a file in ``config/controllers`` holds the same names.

    Parameters
    ----------
    steering_map : {"ackermann", "linear_table", "table"}
        Pure pursuit; MAP with the vehicle's tires linearized; MAP with its tires as they are.
    m_m, q_s : float
        ``L_d = m + q v``: offset [m] and gain [s] (the paper's letters).
    lookahead_min_m, lookahead_max_m : float
        Bounds of the lookahead distance [m].
    eta_from : {"velocity", "heading"}
        Direction from which the angle to the lookahead point counts: that of the velocity, as L1
        guidance has it, or, as in the authors' code, that of the car's nose.
    lookahead_from : {"car", "path"}
        Where the lookahead distance to the point begins: at the car, or, as in the authors' code,
        at the point of the path beside it.
    table_v_max_mps : float
        Beyond this speed a table is read as at it [m/s]; the authors' tables end at 7 m/s.
    curvature_feedforward : float
        Share, 0 to 1, of the curvature that the law lacks on the path itself which is added to it
        (see `map_racing.control.guidance.missing_curvature`). 0 as in the paper.
    yaw_rate_gain_s : float
        Steering angle added for each rad/s by which the car turns slower than the demand,
        ``a_lat / v - r`` [s]. 0 as in the paper.
    delay_s : float
        Delay compensation: from the time at which the pose holds to the time at which the steering
        acts on the car [s]. 0 as in the paper: no compensation.
    speed_source : {"measured", "command"}
        Speed in guidance law and steering map: the measured one, or, as in the paper, the one that
        the controller commands.
    speed_lookahead_s : float
        The raceline's speed is read where the car will be after this time [s].
    speed_scale : float
        Scale of the raceline's speeds.
    v_max_mps : float
        Largest speed commanded, whatever the raceline asks [m/s].
    grip_use : float
        Share of the lateral acceleration that the tires reach, as the lookup table knows it, that
        the speeds may use; slower than the raceline where it needs more. 0: speeds are the
        raceline's, whatever the grip.
    a_drive_max_mps2, a_brake_max_mps2 : float
        Driving and braking that such speeds may ask for on a straight, and in a bend what the
        friction ellipse leaves of it [m/s^2].
    reference_point : {"rear_axle", "center_of_gravity"}
        Point of the car whose pose the localization gives, and which follows the raceline. The
        rear axle is ``base_link``.

    Raises
    ------
    ParameterError
        For an impossible value, naming it.
    """

    steering_map: str
    m_m: float
    q_s: float
    lookahead_min_m: float = 0.3
    lookahead_max_m: float = 5.0
    eta_from: str = "velocity"
    lookahead_from: str = "car"
    table_v_max_mps: float = 100.0
    curvature_feedforward: float = 0.0
    yaw_rate_gain_s: float = 0.0
    delay_s: float = 0.0
    speed_source: str = "measured"
    speed_lookahead_s: float = 0.0
    speed_scale: float = 1.0
    v_max_mps: float = 12.0
    grip_use: float = 0.0
    a_drive_max_mps2: float = 7.0
    a_brake_max_mps2: float = 6.0
    reference_point: str = "rear_axle"

    def __post_init__(self):
        for field in fields(self):
            if field.type in ("float", float):
                finite(field.name, getattr(self, field.name))
        for name, allowed in (
            ("steering_map", STEERING_MAPS),
            ("speed_source", SPEED_SOURCES),
            ("eta_from", ETA_FROM),
            ("lookahead_from", LOOKAHEAD_FROM),
            ("reference_point", REFERENCE_POINTS),
        ):
            if getattr(self, name) not in allowed:
                raise ParameterError(
                    f"{name} must be one of {', '.join(allowed)}, not {getattr(self, name)!r}"
                )
        if not 0 <= self.speed_scale <= 2:
            raise ParameterError(
                f"speed_scale must be 0 to 2 (0.7 is 70 %), but is {self.speed_scale:g}"
            )
        for name in ("delay_s", "speed_lookahead_s"):  # a larger one is meant in milliseconds
            if not 0 <= getattr(self, name) <= 1:
                raise ParameterError(f"{name} must be 0 to 1 s, but is {getattr(self, name)}")
        if self.grip_use != 0 and not 0.1 <= self.grip_use <= 1.2:  # 90 is meant in percent
            raise ParameterError(
                f"grip_use must be 0 (off) or 0.1 to 1.2 (0.9 is 90 %), but is {self.grip_use:g}"
            )
        for name in ("v_max_mps", "table_v_max_mps", "a_drive_max_mps2", "a_brake_max_mps2"):
            if getattr(self, name) <= 0:
                raise ParameterError(f"{name} must be positive, but is {getattr(self, name)}")
        if not 0 <= self.curvature_feedforward <= 1:
            raise ParameterError(
                f"curvature_feedforward must be 0 to 1, but is {self.curvature_feedforward:g}"
            )
        if not 0 <= self.yaw_rate_gain_s <= 0.5:
            raise ParameterError(
                f"yaw_rate_gain_s must be 0 to 0.5 s, but is {self.yaw_rate_gain_s:g}"
            )
        if not 0 < self.lookahead_min_m <= self.lookahead_max_m:
            raise ParameterError(
                "expected 0 < lookahead_min_m <= lookahead_max_m, but they are "
                f"{self.lookahead_min_m} and {self.lookahead_max_m}"
            )

    @cached_property
    def lookahead(self):
        """The :class:`LookaheadLaw` of these parameters."""
        return LookaheadLaw(self.m_m, self.q_s, self.lookahead_min_m, self.lookahead_max_m)

    def with_(self, **changes):
        """A checked copy with some values changed."""
        return replace(self, **changes)


def load_controller_parameters(source):
    """Read controller parameters from YAML.

    Parameters
    ----------
    source : str or pathlib.Path
        Shipped name (``"map"``, ``"pure_pursuit"``, ...) or path of a YAML file.

    Returns
    -------
    ControllerParameters

    Raises
    ------
    ParameterError
        If a parameter is missing, unknown or impossible; the message names file and parameter.
    """
    path = find_config("controllers", source, (".yaml",))
    values = read_yaml_mapping(path)
    values.pop("safety", None)
    return read_parameters(path, ControllerParameters, values)


def load_safety_limits(source):
    """Read the safety limits of a controller's file, which are those of its mapping ``safety``.

    Parameters
    ----------
    source : str or pathlib.Path
        As of `load_controller_parameters`.

    Returns
    -------
    SafetyLimits
        The default of each limit that the file does not have.

    Raises
    ------
    ParameterError
        If a limit is unknown or impossible; the message names file and limit.
    """
    path = find_config("controllers", source, (".yaml",))
    values = read_yaml_mapping(path).get("safety", {})
    if not isinstance(values, dict):
        raise ParameterError(f"{path}: safety: expected names and values, not {values!r}")
    return read_parameters(f"{path}: safety", SafetyLimits, values)


def save_controller_parameters(parameters, path, limits=None):
    """Write controller parameters to YAML, such that `load_controller_parameters` reads the same.

    Parameters
    ----------
    parameters : ControllerParameters
    path : str or pathlib.Path
        A file there is replaced when the new one is complete.
    limits : SafetyLimits, optional
        Written, too, for `load_safety_limits`; but for the largest speed, which is ``v_max_mps``.

    Raises
    ------
    MapRacingError
        If it cannot be written.
    """
    with replacing(path) as file:
        file.write("# config/controllers/map.yaml of map_racing says what each name means.\n\n")
        yaml.safe_dump(asdict(parameters), file, sort_keys=False)
        if limits is not None:
            values = asdict(limits)
            del values["max_speed_mps"]
            yaml.safe_dump({"safety": values}, file, sort_keys=False)
