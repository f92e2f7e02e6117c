"""``map-racing tune``: the parameters with which a controller follows its tracks most closely."""

from functools import partial

import numpy as np
import pandas as pd

from ..control.parameters import ControllerParameters, save_controller_parameters
from ..errors import ParameterError
from ..experiments.campaign import Plan
from ..experiments.robustness_tables import grid_table
from ..experiments.tuning import ROBUST_STEPS, tune_robust
from ..files import make_folder
from ..vehicle.size import size_of
from .experiment import grid_lines, named_controllers
from .session import open_grid, open_session


def run(arguments):
    """Tune."""
    given = named_controllers(arguments.controller)
    check_options(arguments)
    if arguments.robust:
        return run_robust(arguments, given)
    stems = list(given)
    session = open_session(arguments, "tune")
    given = named_controllers(arguments.controller, session.setting.vehicle)
    controllers = {stem: (stem, parameters) for stem, parameters in given.items()}
    tuned = session.tune(controllers)
    session.controllers = {label: found.controller for label, found in tuned.items()}
    conditions = session.setting.conditions
    rows = [
        {
            "speed_scale": conditions.tuning_scale,
            "controller": label,
            **{name: getattr(found.controller, name) for name in found.controller.TUNED},
            "rms_lateral_error_m": found.error,
        }
        for label, found in tuned.items()
    ]
    session.write(pd.DataFrame(rows), conditions.tuning_laps)
    session.report()
    for stem in stems:
        print(f"  map-racing race --controller {session.folder / 'controllers' / stem}.yaml ...")


def check_options(arguments):
    """Refuse options that the chosen kind of tuning would ignore."""
    of_grid = {"grid": "robustness", "tracks": None, "generated": None, "grip_use": None}
    of_days = {"conditions": "paper", "track": None, "plant": None, "vehicle": None}
    of_days.update(practice_seeds=None, tuning_scale=None)
    names = {"practice_seeds": "seeds", "tuning_scale": "speed_scale"}
    for name, default in (of_days if arguments.robust else of_grid).items():
        if getattr(arguments, name) != default:
            option = "--" + names.get(name, name).replace("_", "-")
            if arguments.robust:
                raise ParameterError(f"{option}: not with --robust, which races on a --grid")
            raise ParameterError(f"{option} belongs to --robust")


def run_robust(arguments, controllers):
    """Tune over a grid of tracks and cars."""
    for label, controller in controllers.items():
        if not isinstance(controller, ControllerParameters):
            raise ParameterError(f"--robust: expected controllers with a lookahead, got {label}")
        for share in arguments.grip_use or ():
            controller.with_(grip_use=share)  # fail before the tuning
    session = open_grid(arguments, "tune-robust")
    grid = session.grid
    controllers = named_controllers(arguments.controller, grid.vehicle)
    size, races = size_of(grid.vehicle), 6 * len(grid.names)
    plans = [
        Plan(tune_robust(partial(grid.jobs, label), controller, size), races)
        for label, controller in controllers.items()
    ]
    found = dict(zip(controllers, session.carry_out(plans, "tuning")))
    tried, rows = [], []
    folder = make_folder(session.folder / "controllers")
    for label, candidates in found.items():
        best = candidates[0]
        shares = dict.fromkeys(arguments.grip_use or ())
        with_shares = {
            f"{label}, grip_use {share:g}": best.controller.with_(grip_use=share)
            for share in shares
        }
        table = grid_table(session.race(with_shares), grid.conditions.speed_scale) if shares else ()
        save_controller_parameters(best.controller, folder / f"{label}.yaml")
        for candidate in candidates:
            tried.append({"controller": label, **_values(candidate.controller)})
            tried[-1].update(
                typical_rms_lateral_error_m=candidate.error,
                worst_rms_lateral_error_m=candidate.worst,
                races=candidate.races,
            )
        rows.append({"speed_scale": grid.conditions.speed_scale, **tried[-len(candidates)]})
        print(_tuned(label, candidates))
        if shares:
            print("\n".join(grid_lines(table)))
    frame = pd.DataFrame(tried)
    for name in ("typical_rms_lateral_error_m", "worst_rms_lateral_error_m"):
        frame[name] = frame[name].where(np.isfinite(frame[name]))
    controllers = {label: candidates[0].controller for label, candidates in found.items()}
    session.write(pd.DataFrame(rows), controllers, candidates=frame)
    session.report()


def _tuned(label, candidates):
    """The best of the candidates in words."""
    best = candidates[0]
    values = best.controller
    return (
        f"tuned {label}: L_d = {values.m_m:g} m + {values.q_s:g} s v, slip lookahead "
        f"{values.slip_lookahead:g}, delay {values.delay_s:g} s, curvature feedforward "
        f"{values.curvature_feedforward:g}, yaw rate gain {values.yaw_rate_gain_s:g} s, speed "
        f"lookahead {values.speed_lookahead_s:g} s; all {best.races} races completed, typical "
        f"RMS error {best.error:.4f} m, worst race {best.worst:.4f} m; "
        f"{len(candidates)} candidates"
    )


def _values(controller):
    return {name: getattr(controller, name) for name in (*ROBUST_STEPS, "grip_use")}
