"""Service ``~save`` of the controller node: saves its settings as files to start from."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

from ..control.parameters import save_controller_parameters
from ..errors import MapRacingError
from ..files import together
from ..vehicle.parameters import save_vehicle

if TYPE_CHECKING:
    import threading

    from ..control.controller import Controller
    from ..control.safety import Supervisor

__all__ = ["Saver"]


class Saver:
    """Writes the controller file and, if something was learned, a vehicle file.

    Parameters
    ----------
    controller : Controller
    supervisor : Supervisor
    lock : threading.RLock
        Held while the values to save are read.
    controller_file : str
        ``{steering_map}`` is replaced by the steering map's name; an existing file is overwritten.
    vehicle_file : str
        ``{vehicle}`` is replaced by the car's name, ``{time}`` by date and time. If the file
        exists, nothing is saved.
    vehicle : str
        The vehicle that the node started with, for the file's header.
    """

    def __init__(
        self,
        controller: Controller,
        supervisor: Supervisor,
        lock: threading.RLock,
        controller_file: str,
        vehicle_file: str,
        vehicle: str,
    ):
        self._controller, self._supervisor, self._lock = controller, supervisor, lock
        self._controller_file, self._vehicle_file = controller_file, vehicle_file
        self._vehicle = vehicle

    def save(self) -> list[str]:
        """Write the files, and return their names.

        With adaptation the saved delay is the learned one.

        Raises
        ------
        MapRacingError
            If a file cannot be written, or the vehicle file exists.
        OSError
            If a folder cannot be made.
        """
        with self._lock:
            parameters, limits = self._controller.parameters, self._supervisor.limits
            learned = self._controller.learned
            if learned is not None and parameters.adaptation:
                parameters = parameters.with_(delay_s=round(learned.delay, 4))
            if learned is not None and learned.learned_s > 0.0:
                vehicle, summary = learned.believed_vehicle(), learned.summary()
            else:
                vehicle = None
        controller_path = _path(self._controller_file, steering_map=parameters.steering_map)
        if vehicle is None:
            save_controller_parameters(parameters, controller_path, limits)
            return [str(controller_path)]
        now = time.gmtime()
        name = "".join(c if c.isalnum() or c in "-_." else "_" for c in vehicle.name)
        stamp = time.strftime("%Y%m%d_%H%M%S", now)
        vehicle_path = _path(self._vehicle_file, vehicle=name, time=stamp)
        if vehicle_path.exists():
            raise MapRacingError(
                f"{vehicle_path} exists, so nothing is saved: set ~save_vehicle_to to another "
                "file, such as one with {time}"
            )
        when = time.strftime("%Y-%m-%d %H:%M UTC", now)
        comment = f"{summary}\n{when}; the vehicle was {self._vehicle}."
        with together():
            save_vehicle(vehicle, vehicle_path, comment)
            save_controller_parameters(parameters, controller_path, limits)
        return [str(controller_path), str(vehicle_path)]


def _path(pattern, **values):
    for name, value in values.items():
        pattern = pattern.replace("{" + name + "}", value)
    path = Path(pattern).expanduser()
    path.parent.mkdir(parents=True, exist_ok=True)
    return path
