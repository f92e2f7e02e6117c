"""Live tuning of the running controller by dynamic_reconfigure."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TYPE_CHECKING, Callable

import rospy
from dynamic_reconfigure.server import Server

from map_racing.cfg import ControllerConfig

from ..control.parameters import STEERING_MAPS, load_controller_parameters
from ..control.steering import build_steering_map
from ..errors import MapRacingError, ParameterError

if TYPE_CHECKING:
    import threading

    from ..control.supervised import SupervisedController

__all__ = ["TuningServer"]

_REJECTED = "reconfigure rejected: %s; the values in use stay"


class _Server(Server):
    """Rejects values out of range, which the base class would clamp to a limit."""

    def update_configuration(self, changes):
        try:
            _check_ranges(changes)
        except ParameterError as error:
            rospy.logwarn(_REJECTED, error)
            changes = {}
        return super().update_configuration(changes)


def _check_ranges(changes):
    for name, value in changes.items():
        low, high = ControllerConfig.min.get(name), ControllerConfig.max.get(name)
        if isinstance(value, float) and not low <= value <= high:  # NaN is refused, too
            raise ParameterError(f"{name}: expected {low:g} to {high:g}, got {value:g}")


class TuningServer:
    """Changes parameters, steering map and safety limits while the car drives.

    Each steering map keeps its own lookahead. A change with a value that is impossible or out of
    its range is rejected as a whole; the answer holds the values in use.

    Parameters
    ----------
    driver : SupervisedController
        Its steering map is kept for switching back; its largest speed can be lowered, but never
        raised above the one at the start.
    lock : threading.RLock
        Held while a change is applied, so that it happens between two control steps.
    announce : callable
        Called when something has changed.
    table : str, optional
        File of a lookup table that replaces the vehicle's tires; adaptation is then impossible.
    """

    def __init__(
        self,
        driver: SupervisedController,
        lock: threading.RLock,
        announce: Callable[[], None],
        table: str = "",
    ):
        self._driver, self._lock = driver, lock
        self._controller, self._supervisor = driver.controller, driver.supervisor
        self._announce, self._table = announce, table
        parameters = self._controller.parameters
        self._v_max = parameters.v_max_mps
        self._maps = {parameters.steering_map: self._controller.steering_map}
        car = self._controller.vehicle
        shipped = {kind: load_controller_parameters(f, car) for kind, f in STEERING_MAPS.items()}
        shipped[parameters.steering_map] = parameters
        self._lookaheads = {kind: (p.m_m, p.q_s) for kind, p in shipped.items()}
        # Start with the values in use, not with those that an earlier run left on the parameter
        # server. The ranges must include them, because clients send all values with each call.
        values = self._in_use()
        ControllerConfig.defaults.update(values)
        for name, value in values.items():
            if isinstance(value, float):
                ControllerConfig.min[name] = min(ControllerConfig.min[name], value)
                ControllerConfig.max[name] = max(ControllerConfig.max[name], value)
        rospy.set_param("~tuning", values)
        self._server = _Server(ControllerConfig, self._reconfigure, namespace="tuning")

    def _in_use(self):
        """The values in use, by the names of the configuration."""
        values = {**vars(self._controller.parameters), **vars(self._supervisor.limits)}
        for kind, (m_m, q_s) in self._lookaheads.items():
            values[f"{kind}_m_m"], values[f"{kind}_q_s"] = m_m, q_s
        return {name: values[name] for name in ControllerConfig.defaults}

    def _reconfigure(self, config, _):
        """Apply a requested configuration; return the one in use."""
        try:
            self._apply(config)
        except MapRacingError as error:
            rospy.logwarn(_REJECTED, error)
        config.update(self._in_use())
        return config

    def _apply(self, config):
        if config["v_max_mps"] > self._v_max:
            raise ParameterError(
                f"v_max_mps: expected at most {self._v_max:g}, its value at the start, got "
                f"{config['v_max_mps']:g}"
            )
        kind = config["steering_map"]
        lookaheads = {k: (config[f"{k}_m_m"], config[f"{k}_q_s"]) for k in STEERING_MAPS}
        m_m, q_s = lookaheads.get(kind, (0.0, 0.0))
        parameters = _changed(
            self._controller.parameters,
            {**config, "m_m": m_m, "q_s": q_s},
        )
        if parameters.adaptation and self._table:
            raise ParameterError(f"adaptation: expected false with the lookup table {self._table}")
        limits = _changed(self._supervisor.limits, config)
        if kind not in self._maps:
            self._maps[kind] = build_steering_map(kind, self._controller.vehicle, self._v_max)
        with self._driver.changing:
            before = self._controller.parameters, self._supervisor.limits
            setup = self._controller.prepare(parameters=parameters, steering_map=self._maps[kind])
            with self._lock:
                self._lookaheads = lookaheads
                self._driver.tune(setup, limits)
            if (parameters, limits) != before:
                self._announce()


def _changed(values, config):
    """A dataclass with the values of the same names in `config`."""
    names = (field.name for field in fields(values))
    return replace(values, **{name: config[name] for name in names if name in config})
