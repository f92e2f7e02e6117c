"""Channel maps: where a recording has each quantity, and how the sensors are mounted."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..errors import ParameterError
from ..files import read_yaml_mapping
from ..resources import find_config
from ..units import SI, factor_to_si
from ..validation import finite

__all__ = ["Channel", "ChannelMap", "SensorSetup", "load_channel_map"]

POSE = ("x", "y", "psi")
INERTIAL = ("yaw_rate", "a_x", "a_y", "a_z")
CHANNELS = (*POSE, "v_x", "v_y", *INERTIAL, "steering", "speed_command")
QUANTITIES = {
    **{"x": "length", "y": "length", "psi": "angle", "time": "time", "pose_time": "time"},
    **{"v_x": "speed", "v_y": "speed", "speed_command": "speed", "yaw_rate": "turn rate"},
    **{"a_x": "acceleration", "a_y": "acceleration", "a_z": "acceleration", "steering": "angle"},
}


@dataclass(frozen=True)
class SensorSetup:
    """Signs, scales, axes and places of the sensors; ``setup`` in a channel map.

    Parameters
    ----------
    time_scale : float
        True seconds per second of the recording.
    speed_scale, yaw_rate_scale : float
        True value per signal value; -1 flips the sign. `speed_scale` applies to both velocities of
        the odometry.
    lateral_axis : {"x", "y", "z"}
        Axis of the IMU that points to the car's side.
    lateral_scale, lateral_offset_mps2 : float
        ``a_y = scale * signal + offset``. A sensor that rolls with the body measures part of
        gravity, and needs a scale other than +-1.
    steering_gain, steering_offset_rad : float
        Road-wheel angle ``delta = gain * signal + offset``.
    steering_delay_s : float
        From the signal to the wheels.
    heading_offset_rad : float
        Heading of the car minus heading of the pose.
    pose_x_m : float
        Distance ahead of the rear axle of the localized point, to which the odometry's lateral
        velocity refers, too; ``l_r`` for the center of gravity.
    imu_x_m, imu_y_m : float
        Position of the IMU, ahead of the rear axle and to the left; default: center of gravity.
    """

    time_scale: float = 1.0
    speed_scale: float = 1.0
    yaw_rate_scale: float = 1.0
    lateral_axis: str = "y"
    lateral_scale: float = 1.0
    lateral_offset_mps2: float = 0.0
    steering_gain: float = 1.0
    steering_offset_rad: float = 0.0
    steering_delay_s: float = 0.0
    heading_offset_rad: float = 0.0
    pose_x_m: float = 0.0
    imu_x_m: float | None = None
    imu_y_m: float = 0.0

    def __post_init__(self):
        if self.lateral_axis not in ("x", "y", "z"):
            raise ParameterError(f"lateral_axis: expected x, y or z, got {self.lateral_axis!r}")
        for name, value in vars(self).items():
            if name == "lateral_axis" or (name == "imu_x_m" and value is None):
                continue
            object.__setattr__(self, name, finite(name, value))
            if name.endswith(("scale", "gain")) and getattr(self, name) == 0.0:
                raise ParameterError(f"{name}: expected a number other than 0, got 0")
        for name in ("time_scale", "steering_delay_s"):
            if getattr(self, name) < 0.0:
                raise ParameterError(
                    f"{name}: expected a positive number, got {getattr(self, name):g}"
                )

    def changes(self) -> dict[str, float | str]:
        """Values that differ from the default."""
        return {
            field_.name: getattr(self, field_.name)
            for field_ in dataclasses.fields(self)
            if getattr(self, field_.name) != field_.default
        }


@dataclass(frozen=True)
class Channel:
    """Source of a quantity, and its conversion to SI: ``scale * unit * raw + offset``.

    Parameters
    ----------
    source : str
        Column of a CSV file or topic of a bag.
    field : str
        Field of a topic's messages, if they have several.
    unit : str
        Unit of the recording.
    scale, offset : float
        Both as in the formula; the offset is in SI units.
    """

    source: str
    field: str = ""
    unit: str = ""
    scale: float = 1.0
    offset: float = 0.0

    def __post_init__(self):
        if not isinstance(self.unit, str):
            raise ParameterError(f"unit: expected a text, got {self.unit!r}")
        for name in ("scale", "offset"):
            object.__setattr__(self, name, finite(name, getattr(self, name)))

    def to_si(self, raw: np.ndarray, name: str) -> np.ndarray:
        """The values in SI units.

        Parameters
        ----------
        raw : ndarray, shape (n,)
            As recorded, in `unit`.
        name : str
            Of the channel, a key of `QUANTITIES`.

        Returns
        -------
        ndarray, shape (n,)
        """
        return raw * (self.scale * factor_to_si(QUANTITIES[name], self.unit)) + self.offset


@dataclass(frozen=True)
class ChannelMap:
    """Sources of all quantities of a recording.

    Parameters
    ----------
    channels : dict of str to Channel
        Keys are `CHANNELS`, ``time`` and ``pose_time`` (if x, y and psi have their own clock).
    pose_topic : str, optional
        Topic of the pose in a bag.
    setup : SensorSetup
    """

    channels: dict[str, Channel] = field(default_factory=dict)
    pose_topic: str | None = None
    setup: SensorSetup = SensorSetup()

    def __post_init__(self):
        for name, channel in self.channels.items():
            if factor_to_si(QUANTITIES[name], channel.unit) is None:
                expected = SI[QUANTITIES[name]]
                raise ParameterError(
                    f"{name}: unit: expected one such as {expected}, got {channel.unit!r}"
                )


def load_channel_map(source: str | Path) -> ChannelMap:
    """Read a channel map.

    Parameters
    ----------
    source : str or pathlib.Path
        Shipped map or YAML file; ``config/channels/circles_log.yaml`` explains the keys.

    Raises
    ------
    ParameterError
        If a key is unknown or a value impossible; the message names file and key.
    FileFormatError
        If the file is not a YAML mapping.
    """
    path = find_config("channels", source, (".yaml",))
    values = read_yaml_mapping(path)
    try:
        setup = _dataclass(SensorSetup, "setup", values.pop("setup", {}))
        pose_topic = values.pop("pose_topic", None)
        if not isinstance(pose_topic, (str, type(None))):
            raise ParameterError(f"pose_topic: expected a topic, got {pose_topic!r}")
        known = (*CHANNELS, "time", "pose_time")
        channels = {}
        for name, entry in values.items():
            if name not in known:
                raise ParameterError(
                    f"{name}: unknown; known are {', '.join(known)}, pose_topic, setup"
                )
            channels[name] = _channel(name, entry)
        return ChannelMap(channels, pose_topic, setup)
    except ParameterError as error:
        raise ParameterError(f"{path}: {error}") from None


def _channel(name, entry):
    if isinstance(entry, str):
        return Channel(entry)
    if not isinstance(entry, dict):
        raise ParameterError(f"{name}: expected a column or topic, or a mapping, got {entry!r}")
    entry = dict(entry)
    sources = [entry.pop(key) for key in ("column", "topic") if key in entry]
    if len(sources) != 1 or not isinstance(sources[0], str):
        raise ParameterError(f"{name}: expected column or topic")
    servo = [entry.pop(key, None) for key in ("servo_gain", "servo_offset")]
    if servo != [None, None]:
        gain, offset = (finite(f"{name}: servo_gain, servo_offset", value) for value in servo)
        if gain == 0.0 or "scale" in entry or "offset" in entry:
            raise ParameterError(f"{name}: servo_gain: expected not 0, and no scale or offset")
        # The servo's position is gain * angle + offset, as in the public VESC driver.
        entry.update(scale=1.0 / gain, offset=-offset / gain)
    return _dataclass(Channel, name, {"source": sources[0], **entry})


def _dataclass(kind, name, values):
    if not isinstance(values, dict):
        raise ParameterError(f"{name}: expected keys and values, got {values!r}")
    known = {field_.name for field_ in dataclasses.fields(kind)}
    unknown = [str(key) for key in values if key not in known]
    if unknown:
        keys = ", ".join(sorted(known - {"source"}))
        raise ParameterError(f"{name}: {unknown[0]}: unknown; known are {keys}")
    try:
        return kind(**values)
    except (ParameterError, TypeError) as error:
        raise ParameterError(f"{name}: {error}") from None
