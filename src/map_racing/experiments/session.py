"""Setting, result directory, tuning and races of a command that runs many races."""

from __future__ import annotations

import math
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from multiprocessing import get_context
from time import monotonic
from typing import Callable, Iterable

import pandas as pd

from ..control.parameters import ControllerParameters, load_law, save_controller_parameters
from ..errors import ParameterError
from ..files import make_folder, replacing, together, write_json
from ..identification.report import report_data
from ..printing import amount
from ..simulation.plants import load_plant
from ..track.files.load import load_raceline
from ..vehicle.parameters import linearized, load_vehicle, parameter_hash, save_vehicle
from .campaign import Effort, carry_out
from .executors import check_workers, open_executor
from .identification_day import identify_on
from .jobs import RaceJob, execute
from .paper import CONTENDERS, Race, Setting, tuning_plan
from .results import Results, provenance_of, read_results, write_results
from .robustness import Grid, grid_plan
from .robustness_tables import grid_provenance, race_rows
from .store import Store, check_reused
from .tuning import Tuned, frame_of

__all__ = ["GridSession", "Session"]


class Races:
    """Result directory and executor of many races.

    Parameters
    ----------
    kind : str
        Kind of the results, such as ``"tune"``.
    folder : str or pathlib.Path
        Result directory; an existing one is continued.
    jobs : int, optional
        Processes.
    scheduler : str, optional
        Address of a Dask scheduler.
    reuse : sequence of str
        Result directories whose races are reused.

    Attributes
    ----------
    earlier : Results or None
        Previous content of the folder.
    """

    def __init__(self, kind, folder, *, jobs=None, scheduler=None, reuse=()):
        check_workers(jobs, scheduler)
        check_reused(reuse)
        self.kind = kind
        self.folder, self.earlier = make_folder(folder), None
        if (self.folder / "results.json").exists():
            self.earlier = read_results(self.folder)
            if self.earlier.kind != kind:
                other = self.earlier.kind
                raise ParameterError(f"{self.folder}: holds results of {other}; choose another")
        self.figures = make_folder(self.folder / "figures")
        self.store = Store(self.folder, reuse)
        self.began, self.effort = monotonic(), Effort(0, 0, 0.0, 0.0)
        self._jobs, self._scheduler = jobs, scheduler

    def carry_out(self, plans, title, **needs):
        """Carry out plans on the chosen executor; `needs` as in `carry_out`."""
        with open_executor(self._jobs, self._scheduler) as (executor, capacity):
            results, effort = carry_out(plans, self.store, executor, capacity, title=title, **needs)
        self.effort += effort
        return results

    def report(self):
        """Print the effort and the place of the results."""
        driven, found, cpu_s, simulated_s = self.effort
        print(
            f"\n{driven} races driven, {found} found on disk; {simulated_s:.0f} s simulated in "
            f"{cpu_s:.0f} s of processor time, {monotonic() - self.began:.0f} s in all"
        )
        print(f"tables, figures and provenance are in {self.folder}")


class GridSession(Races):
    """Races on a grid of tracks and cars.

    Nothing is written if a track or a car cannot be loaded.

    Parameters
    ----------
    kind, folder, **where
        As in `Races`.
    conditions : Robustness
    """

    def __init__(self, kind, folder, conditions, **where):
        self.grid = Grid(conditions)
        self.notes = self.grid.notes
        super().__init__(kind, folder, **where)

    def race(self, controllers):
        """Race controllers over the grid.

        Parameters
        ----------
        controllers : dict of str to ControllerParameters

        Returns
        -------
        pandas.DataFrame
            A row for each race.
        """
        plans = [grid_plan(self.grid, label, given) for label, given in controllers.items()]
        results = self.carry_out(plans, "races")
        frames = [race_rows(self.grid, *each) for each in zip(controllers, results)]
        return pd.concat(frames, ignore_index=True)

    def write(self, table, controllers, **frames):
        """Write tables and provenance.

        Parameters
        ----------
        table : pandas.DataFrame
            The table of the experiment.
        controllers : dict of str to ControllerParameters
            What was raced, by label.
        **frames : pandas.DataFrame
            Further tables, written as ``NAME.csv``.

        Raises
        ------
        OSError
            If a file cannot be written.
        """
        provenance = grid_provenance(self.grid, controllers)
        write_results(self.folder, Results(self.kind, table, provenance), **frames)


class Session(Races):
    """Setting, tuned controllers, races and results of one command, in a result directory.

    Nothing is written if track, plant or vehicle cannot be loaded.

    Parameters
    ----------
    kind, folder, **where
        As in `Races`.
    conditions : Conditions
    vehicle : str, optional
        The controllers' model of the car; by default it is identified from ramps on the plant.
    tuning : bool
        Whether the contenders are tuned.
    contenders : tuple of Contender, optional
        By default those of the paper's experiments.
    slowdown : float, optional
        Factor with which the computing time of the controllers counts.

    Attributes
    ----------
    notes : list of str
        Notes for the user about track and car.
    """

    def __init__(
        self,
        kind,
        folder,
        conditions,
        *,
        vehicle=None,
        tuning=True,
        contenders=CONTENDERS,
        slowdown=None,
        **where,
    ):
        raceline, plant = load_raceline(conditions.track), load_plant(conditions.plant)
        given = None if vehicle is None else load_vehicle(vehicle)
        super().__init__(kind, folder, **where)
        self._tuning, self._contenders = tuning, contenders
        self.notes = [f"{conditions.track}: {finding}" for finding in raceline.findings]
        self.notes += [f"{conditions.plant}: its vehicle: {note}" for note in plant.vehicle.notes]
        if raceline.d_left is None:
            self.notes.append(
                f"{conditions.track}: no walls are known, so crashes are not detected"
            )
        if given is None:
            cars = self._identify(plant, conditions.identification_seed)
        else:
            cars = given, linearized(given)
            self.notes += [f"{vehicle}: {note}" for note in given.notes]
            self.identification = {"vehicle": vehicle, "parameters": parameter_hash(given)}
        self.setting = Setting(conditions, raceline, plant, *cars, slowdown)
        self.controllers, self.tuned = {}, {}

    @property
    def where(self) -> str:
        """Track and plant, for titles."""
        conditions = self.setting.conditions
        return f"{self.setting.raceline.name or conditions.track}, plant {conditions.plant}"

    @property
    def days(self) -> str:
        """Number of race days, in words."""
        return amount(len(self.setting.conditions.seeds), "race day")

    def _identify(self, plant, seed):
        """Identify the car on the plant, with Pacejka and with linear tires."""
        found = identify_on(plant, seed, self.folder / "ramps.bag")
        with together():
            save_vehicle(found.vehicle, self.folder / "identified.yaml")
            save_vehicle(found.linear_vehicle, self.folder / "identified_linear.yaml")
            write_json(self.folder / "identification.json", report_data(found))
        self.identification = {
            "ramps": "ramps.bag",
            "seed": seed,
            "vehicle": "identified.yaml",
            "parameters": parameter_hash(found.vehicle),
            "linear_vehicle": "identified_linear.yaml",
            "linear_parameters": parameter_hash(found.linear_vehicle),
        }
        self.notes.append(
            f"identified {found.base.name} from steering ramps (seed {seed}): up to "
            f"{found.largest_a_y:.1f} m/s^2 (identified.yaml)"
        )
        self.notes += [
            f"warning: identification: {finding.text}"
            for finding in found.findings
            if finding.critical
        ]
        return found.vehicle, found.linear_vehicle

    def tune(self, controllers: dict[str, tuple[str, ControllerParameters]]) -> dict[str, Tuned]:
        """Tune controllers; write files, maps and tables.

        `controllers` has for each label the stem of its files and the parameters to start from.
        """
        if not controllers:
            return {}
        from ..plots.experiments import plot_tuning
        from ..plots.style import own_settings, save

        plans = [tuning_plan(self.setting, label, c) for label, (_, c) in controllers.items()]
        tuned = dict(zip(controllers, self.carry_out(plans, "tuning")))
        folder = make_folder(self.folder / "controllers")
        scale = self.setting.conditions.tuning_scale
        for label, (stem, _) in controllers.items():
            found = tuned[label]
            names = found.controller.TUNED
            pair = tuple(getattr(found.controller, name) for name in names)
            frame = frame_of(found)
            with together():
                save_controller_parameters(found.controller, folder / f"{stem}.yaml")
                with replacing(folder / f"{stem}.csv") as file:
                    frame.to_csv(file, index=False)
            title = f"Tuning {label}: {self.where}, {scale:.0%} speed"
            error = [pair.error for pair in found.pairs]
            with own_settings():
                figure = plot_tuning(*(frame[n] for n in names), error, pair, title, names)
                save(figure, self.figures / f"tuning_{stem}.png")
            infeasible = sum(map(math.isinf, error))
            print(
                f"tuned {label}: {names[0]} {pair[0]:g}, {names[1]} {pair[1]:g}, RMS error "
                f"{found.error:.4f} m at {scale:.0%} speed; {len(error)} pairs, {infeasible} of "
                "them not completed"
            )
        return tuned

    def race(self, plan: Callable, laps: int, scales: Iterable[float], **needs: bool) -> list[Race]:
        """Tune the contenders as configured, and race all of them on all days.

        If called again, it races the same controllers.
        """
        if not self.controllers:
            car = self.setting.vehicle
            shipped = {c.label: load_law(c.controller, car) for c in self._contenders}
            to_tune = {c.label: c.controller for c in self._contenders if c.tuned and self._tuning}
            given = {label: (stem, shipped[label]) for label, stem in to_tune.items()}
            self.tuned = self.tune(given)
            found = {label: tuned.controller for label, tuned in self.tuned.items()}
            self.controllers = {**shipped, **found}
        plans = [
            plan(self.setting, label, controller, seed, laps, scales)
            for label, controller in self.controllers.items()
            for seed in self.setting.conditions.seeds
        ]
        return [race for races in self.carry_out(plans, "races", **needs) for race in races]

    def write(self, table: pd.DataFrame, timed_laps: int, **frames: pd.DataFrame) -> None:
        """Write the table of the results, further tables, and the provenance."""
        provenance = provenance_of(
            self.setting, self.identification, self.controllers, timed_laps, self.notes
        )
        write_results(self.folder, Results(self.kind, table, provenance), **frames)

    def memory(self, laps: int, scale: float) -> dict[str, float]:
        """Peak memory of a fresh process that races with each controller on one day [MB]."""
        day = self.setting.day(self.setting.conditions.seeds[0])
        found = {}
        for label, controller in self.controllers.items():
            job = self.setting.job(label, controller.with_(speed_scale=scale), day, laps)
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                found[label] = pool.submit(largest_memory, job).result()
        return found


def largest_memory(job: RaceJob) -> float:
    """Race, and return the peak resident memory of this process [MB]; NaN except on Linux."""
    execute(job)
    # Not getrusage: a new process inherits its peak from its parent.
    with suppress(OSError), open("/proc/self/status", encoding="ascii") as status:
        for line in status:
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) / 1024.0
    return math.nan
