"""What the commands that run many races share: setting, result directory, tuning, racing."""

import math
from dataclasses import replace
from time import monotonic

from ..control.parameters import load_controller_parameters, save_controller_parameters
from ..errors import ParameterError
from ..files import make_folder, replacing, write_json
from ..identification.report import report_data
from ..vehicle.parameters import linearized, load_vehicle, parameter_hash, save_vehicle
from .campaign import Effort, carry_out
from .conditions import load_conditions
from .executors import open_executor
from .identification_day import identify_on
from .paper import CONTENDERS, Setting, tuning_plan
from .results import Results, provenance_of, read_results, write_results
from .store import Store
from .tuning import frame_of

__all__ = ["Session"]


class Session:
    """What the commands share: setting, tuned controllers, races, and where results go.

    Parameters
    ----------
    arguments : argparse.Namespace
    kind : str
        Of the results.
    """

    def __init__(self, arguments, kind):
        self.kind = kind
        given = {
            name: getattr(arguments, name, None)
            for name in ("track", "plant", "seeds", "practice_seeds", "tuning_scale")
        }
        given = {name: value for name, value in given.items() if value is not None}
        conditions = replace(load_conditions(arguments.conditions), **given)
        self.folder = make_folder(arguments.output)
        if (self.folder / "results.json").exists():
            other = read_results(self.folder).kind
            if other != kind:
                raise ParameterError(f"{self.folder}: holds results of {other}; choose another")
        self.figures = make_folder(self.folder / "figures")
        self.store = Store(self.folder, arguments.reuse)
        self.began, self.effort = monotonic(), Effort(0, 0, 0.0)
        self._jobs, self._scheduler = arguments.jobs, arguments.scheduler
        self._tuning = not getattr(arguments, "no_tuning", False)
        self.setting = Setting.load(
            conditions, lambda plant: self._car(plant, arguments.vehicle, conditions)
        )
        for finding in self.setting.raceline.findings:
            print(f"{conditions.track}: {finding}")
        if self.setting.raceline.d_left is None:
            print(f"{conditions.track}: no walls are known, so no crash is seen")
        self.controllers = {}

    @property
    def where(self):
        """Track and plant, for titles."""
        conditions = self.setting.conditions
        return f"{self.setting.raceline.name or conditions.track}, plant {conditions.plant}"

    @property
    def days(self):
        """How many race days, in words."""
        count = len(self.setting.conditions.seeds)
        return f"{count} race day" + ("s" if count != 1 else "")

    def _car(self, plant, given, conditions):
        """The car as controllers know it, with Pacejka and with linear tires."""
        if given:
            vehicle = load_vehicle(given)
            self.identification = {"vehicle": given, "parameters": parameter_hash(vehicle)}
            return vehicle, linearized(vehicle)
        seed = conditions.identification_seed
        found = identify_on(plant, seed, self.folder / "ramps.bag")
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
        print(
            f"identified {found.base.name} from steering ramps (seed {seed}): up to "
            f"{found.largest_a_y:.1f} m/s^2, {self.folder / 'identified.yaml'}"
        )
        return found.vehicle, found.linear_vehicle

    def carry_out(self, plans, title, **needs):
        """Carry out plans on the executor asked for; `needs` as in `carry_out`."""
        with open_executor(self._jobs, self._scheduler) as (executor, capacity):
            results, effort = carry_out(plans, self.store, executor, capacity, title=title, **needs)
        self.effort += effort
        return results

    def tune(self, controllers):
        """Tune controllers; write files, maps and tables.

        Parameters
        ----------
        controllers : dict of str to (str, ControllerParameters)
            Label to the stem of its files and what is tuned.

        Returns
        -------
        dict of str to Tuned
        """
        if not controllers:
            return {}
        from ..plots.experiments import plot_tuning
        from ..plots.style import save

        plans = [tuning_plan(self.setting, label, c) for label, (_, c) in controllers.items()]
        tuned = dict(zip(controllers, self.carry_out(plans, "tuning")))
        folder = make_folder(self.folder / "controllers")
        scale = self.setting.conditions.tuning_scale
        for label, (stem, _) in controllers.items():
            found = tuned[label]
            pair = found.controller.m_m, found.controller.q_s
            save_controller_parameters(found.controller, folder / f"{stem}.yaml")
            frame = frame_of(found)
            with replacing(folder / f"{stem}.csv") as file:
                frame.to_csv(file, index=False)
            title = f"Tuning {label}: {self.where}, {scale:.0%} speed"
            error = [pair.error for pair in found.pairs]
            figure = plot_tuning(frame.m_m, frame.q_s, error, pair, title)
            save(figure, self.figures / f"tuning_{stem}.png")
            infeasible = sum(map(math.isinf, error))
            print(
                f"tuned {label}: L_d = {pair[0]:g} m + {pair[1]:g} s v, RMS error "
                f"{found.error:.4f} m at {scale:.0%} speed; {len(error)} pairs, {infeasible} of "
                "them not completed"
            )
        return tuned

    def race(self, plan, laps, scales, **needs):
        """Tune the contenders that are to be tuned, and race all of them on all days."""
        shipped = {c.label: load_controller_parameters(c.controller) for c in CONTENDERS}
        to_tune = {c.label: c.controller for c in CONTENDERS if c.tuned and self._tuning}
        tuned = self.tune({label: (stem, shipped[label]) for label, stem in to_tune.items()})
        self.controllers = {
            **shipped,
            **{label: found.controller for label, found in tuned.items()},
        }
        plans = [
            plan(self.setting, label, controller, seed, laps, scales)
            for label, controller in self.controllers.items()
            for seed in self.setting.conditions.seeds
        ]
        return [race for races in self.carry_out(plans, "races", **needs) for race in races]

    def write(self, table, timed_laps, **frames):
        """Write tables and provenance.

        Parameters
        ----------
        table : pandas.DataFrame
            The table of the results.
        timed_laps : int
            Laps of each race.
        **frames : pandas.DataFrame
            Further tables.
        """
        provenance = provenance_of(self.setting, self.identification, self.controllers, timed_laps)
        write_results(self.folder, Results(self.kind, table, provenance), **frames)

    def report(self):
        """What it took, and where it is."""
        driven, found, cpu_s = self.effort
        print(
            f"\n{driven} races driven, {found} found on disk; {cpu_s:.0f} s of processor time, "
            f"{monotonic() - self.began:.0f} s in all"
        )
        print(f"tables, figures and provenance are in {self.folder}")
