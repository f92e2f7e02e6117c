"""Reads recorded driving as signals: from bags, or from CSV files with a channel map.

A run has the signals of one drive, each with its own times, in SI units. Signs, axes and positions
of the sensors are its setup, which a channel map can give and
`map_racing.identification.sensor_checks` can determine.
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..bags.opening import Source, is_bag, source_name
from ..bags.reader import read_recording, read_signals
from ..bags.samples import Recording, in_order, jump_back, usable
from ..errors import FileFormatError, ParameterError
from ..printing import printable
from ..resources import find_config
from ..tables import column_index, read_columns, units_to_si
from .channels import INERTIAL, POSE, QUANTITIES, ChannelMap, SensorSetup

__all__ = ["Run", "Signal", "is_age", "load_run", "run_of"]

# Older poses must be from another clock [s]; synchronized clocks may differ by FUTURE_S.
OLDEST_S, FUTURE_S = 0.15, 0.02


class Signal(NamedTuple):
    """One quantity over time.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times [s], strictly increasing.
    value : ndarray, shape (n,)
        [SI]
    """

    t: np.ndarray
    value: np.ndarray


@dataclass(frozen=True)
class Run:
    """Signals of one drive.

    Parameters
    ----------
    name : str
        Path of the recording.
    signals : dict of str to Signal
        Keys are the `map_racing.identification.channels.CHANNELS` of the recording.
    setup : SensorSetup
    pose_clock : bool
        Whether the poses have a clock of their own, with an unknown offset.
    notes : list of str
        Choices, repairs and omissions made while reading.
    pose_lag : (float, float, float), optional
        Receipt time minus timestamp of the poses [s]: 2.5th percentile, median, 97.5th percentile.
    commands_shifted : bool
        See `map_racing.bags.samples.Commands`.
    command_lag : float, optional
        Median of receipt time minus timestamp of the commands [s].
    """

    name: str
    signals: dict[str, Signal]
    setup: SensorSetup = SensorSetup()
    pose_clock: bool = False
    notes: list[str] = field(default_factory=list)
    pose_lag: tuple[float, float, float] | None = None
    commands_shifted: bool = False
    command_lag: float | None = None

    @property
    def label(self) -> str:
        """Short name: the file with its folder."""
        path = Path(self.name)
        return printable(f"{path.parent.name}/{path.name}" if path.parent.name else path.name)


def load_run(source: Source, channels: ChannelMap | None = None) -> Run:
    """Read a drive.

    Parameters
    ----------
    source : str, pathlib.Path or sequence of them
        A ROS 1 or 2 bag, including shipped ones (``config/recordings``), several bags that are
        parts of one run, or a CSV file (also ``.gz``), which needs a channel map.
    channels : ChannelMap, optional
        For a bag, only exceptions to the usual sources: pose and twist from odometry (see
        `map_racing.bags.reader.read_recording`), acceleration and yaw rate from the Imu, steering
        from AckermannDriveStamped.

    Raises
    ------
    BagError, FileFormatError, ParameterError
        If the file cannot be read.
    """
    channels = channels or ChannelMap()
    parts = not isinstance(source, (str, Path))
    if parts or (Path(source).is_dir() and is_bag(source)):
        return _load_bag(source, channels)
    path = find_config("recordings", source, (".bag",))
    if is_bag(path):
        return _load_bag(path, channels)
    if path.suffix in (".yaml", ".yml"):
        raise ParameterError(
            f"{path}: expected a bag or a CSV file, got a YAML file: vehicles go to --vehicle, "
            "channel maps to --channels"
        )
    if not channels.channels:
        raise ParameterError(
            f"{path}: expected a channel map (--channels) for a CSV file, got none"
        )
    return _load_csv(path, channels)


def _load_bag(source, channel_map):
    """Signals of a bag from the usual topics, then from the channel map."""
    path = source_name(source)
    for name in ("time", "pose_time", *POSE):
        if name in channel_map.channels:
            raise ParameterError(
                f"{path}: {name}: expected in CSV files only; a bag has a pose_topic"
            )
    recording = read_recording(source, channel_map.pose_topic)
    topics = {"imu": ""}
    for name, channel in channel_map.channels.items():
        topics[name] = channel.source
    extra = read_signals(source, recording, topics)
    signals = {}
    if "imu" in extra:
        t, columns = extra.pop("imu")
        signals.update((name, (t, columns[name])) for name in INERTIAL if columns[name].any())
    for name, (t, columns) in extra.items():
        channel = channel_map.channels[name]
        wanted = channel.field or (name if name in columns else next(iter(columns)))
        if wanted not in columns:
            raise ParameterError(
                f"{path}: {name}: expected {', '.join(columns)} of {channel.source}, got {wanted!r}"
            )
        signals[name] = t, channel.to_si(columns[wanted], name)
    return run_of(recording, path, signals, channel_map.setup)


def run_of(
    recording: Recording,
    name: str | Path = "",
    others: dict | None = None,
    setup: SensorSetup | None = None,
) -> Run:
    """Make a run from a recording that has been read: poses, velocities and commands.

    Parameters
    ----------
    recording : Recording
    name : str or pathlib.Path, optional
        Path of the recording.
    others : dict of str to (ndarray, ndarray), optional
        Signals to add, or to replace the recording's: times [s] and values [SI].
    setup : SensorSetup, optional

    Returns
    -------
    Run
    """
    signals = {key: (recording.t, getattr(recording, key)) for key in (*POSE, "v_x", "v_y")}
    signals["yaw_rate"] = recording.t, recording.yaw_rate
    commands, clock, notes = recording.commands, recording.clock, list(recording.notes)
    lag, command_lag, shifted = None, None, False
    if clock is not None and not clock.use_receipt and clock.lag.size:
        lag = tuple(1e-9 * np.percentile(clock.lag, (2.5, 50.0, 97.5)))
    if commands is not None:
        sent, shifted = commands.t, commands.shifted
        if lag is not None and math.isfinite(commands.lag):
            command_lag = commands.lag
            if not shifted and np.isin(commands.t, recording.t).mean() > 0.5:
                # As from the controller node, whose timestamp is that of the answered pose.
                shifted = not is_age(command_lag)
                if not shifted:
                    sent, command_lag = sent + command_lag, 0.0
                    notes.append(
                        f"{commands.topic}: stamped with the poses, sent {commands.lag:.3f} s later"
                    )
        signals["steering"] = sent, commands.steering_angle
        signals["speed_command"] = sent, commands.speed
    signals.update(others or {})
    path = name or recording.source
    run = _run(path, signals, setup or SensorSetup(), notes)
    return dataclasses.replace(run, pose_lag=lag, commands_shifted=shifted, command_lag=command_lag)


def is_age(lag: float) -> bool:
    """Whether a lag [s] from timestamp to receipt is possible on one clock."""
    return -FUTURE_S <= lag <= OLDEST_S


def _load_csv(path, channel_map):
    """Signals of a CSV file."""
    channels = dict(channel_map.channels)
    for name in ("time", *POSE, "steering"):
        if name not in channels:
            raise ParameterError(f"{path}: {name}: missing in the channel map of a CSV file")
    clocks = {"time": channels.pop("time"), "pose_time": channels.pop("pose_time", None)}
    wanted = [channel.source for channel in (*clocks.values(), *channels.values()) if channel]
    command = channels.get("speed_command")

    def locate(names):
        return {
            column: column_index(path, names, column)
            for column in wanted
            # The speed command is optional: only replays and delays of the drive need it.
            if column in names or not command or column != command.source
        }

    columns = read_columns(path, locate)
    table, notes = columns.values, columns.notes
    if command and command.source not in table:
        del channels["speed_command"]
        notes.append(f"speed_command: no column {command.source!r}: left out")
    clocks, channels = (_with_units(some, columns) for some in (clocks, channels))
    t = clocks["time"].to_si(table[clocks["time"].source], "time")
    values = {
        name: channel.to_si(table[channel.source], name) for name, channel in channels.items()
    }
    _blank_before_first(values, table, channels, POSE, "pose", notes)
    _blank_before_first(values, table, channels, INERTIAL, "inertial", notes)
    back = jump_back(t[np.isfinite(t)])
    if back:
        raise FileFormatError(f"{path}: time jumps back by {back[1]:.1f} s: two runs in one file?")
    signals = {name: (t, value) for name, value in values.items()}
    if clocks["pose_time"] is not None:
        pose_t = clocks["pose_time"].to_si(table[clocks["pose_time"].source], "time")
        known = np.isfinite(t + pose_t + values["x"])
        if known.any():
            # A rough alignment; the yaw rates refine it later.
            pose_t = pose_t + float(np.median((t - pose_t)[known]))
        signals.update((name, (pose_t, values[name])) for name in POSE if name in values)
    return _run(path, signals, channel_map.setup, notes, clocks["pose_time"] is not None)


def _with_units(channels, columns):
    """Channels with the units stated in the file, unless the channel map has a unit or scale."""
    plain = {
        name: channel
        for name, channel in channels.items()
        if channel and not channel.unit and abs(channel.scale) == 1.0
    }
    quantities = {channel.source: QUANTITIES[name] for name, channel in plain.items()}
    factors = units_to_si(columns, quantities)
    scaled = {
        name: dataclasses.replace(channel, scale=channel.scale * factors.get(channel.source, 1.0))
        for name, channel in plain.items()
    }
    return {**channels, **scaled}


def _blank_before_first(values, table, channels, names, what, notes):
    """Blank rows in which all channels of a sensor are exactly 0: it had not sent anything yet."""
    columns = [table[channels[name].source] for name in names if name in channels]
    if len(columns) < 2:
        return
    blank = np.all([column == 0.0 for column in columns], axis=0)
    if blank.any():
        count = int(blank.sum())
        rows = "row" if count == 1 else "rows"
        notes.append(f"{count} {rows} without {what} (all of it exactly 0) left out")
        for name in names:
            if name in values:
                values[name] = np.where(blank, math.nan, values[name])


def _run(path, signals, setup, notes, pose_clock=False):
    """A run from raw signals, sorted and without NaN."""
    clean = {}
    for name, (t, value) in signals.items():
        keep = usable(t, [value])
        if np.count_nonzero(keep) < 2:
            continue
        at, (value,) = in_order(t[keep], [value[keep]], [], name)
        if at.size >= 2:
            clean[name] = Signal(at, value)
    _drop_silent(clean, notes)
    return Run(str(path), clean, setup, pose_clock, list(notes))


def _drop_silent(signals, notes):
    """Drop velocities that are 0 throughout, because nothing fills the field."""
    for name in ("v_x", "v_y", "yaw_rate"):
        if name not in signals or signals[name].value.any():
            continue
        # The speed of a car at standstill is truly 0.
        extent = max((np.ptp(signals[p].value) for p in ("x", "y") if p in signals), default=0.0)
        if name != "v_x" or extent > 1.0:
            del signals[name]
            notes.append(f"{name} is 0 throughout: left out")
