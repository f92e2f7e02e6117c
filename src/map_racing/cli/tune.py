"""``map-racing tune``: the lookahead with which a controller follows a track closest."""

from pathlib import Path

import pandas as pd

from ..control.parameters import load_controller_parameters
from ..errors import ParameterError
from ..experiments.session import Session
from ..resources import list_config
from .options import add_options

DEFAULTS = ("pure_pursuit_paper", "map_linear_paper", "map_paper")


def add_parser(commands):
    """Add the command to the parser."""
    parser = commands.add_parser(
        "tune",
        help="find the lookahead with which a controller follows a track closest",
        description="Find m and q of the lookahead distance L_d = m + q v with the smallest RMS "
        "lateral error of the true path, as mean over the laps of races on practice days; each "
        "controller by itself. Writes a controller file for --controller, a map of the error and "
        "all pairs as CSV.",
    )
    parser.add_argument(
        "--controller",
        nargs="+",
        default=list(DEFAULTS),
        metavar="NAME",
        help=f"YAML files, or shipped: {', '.join(list_config('controllers'))} (default: the three "
        "as published)",
    )
    parser.add_argument(
        "--speed-scale",
        dest="tuning_scale",
        type=float,
        help="scale of the raceline's speeds (default: that of the conditions, 0.6)",
    )
    add_options(parser, "practice_seeds")
    parser.set_defaults(run=run)


def run(arguments):
    """Tune."""
    names = list(dict.fromkeys(arguments.controller))
    stems = [Path(name).stem for name in names]
    if len(set(stems)) < len(stems):
        raise ParameterError("--controller: two files of one name would give one result")
    controllers = {
        stem: (stem, load_controller_parameters(name)) for stem, name in zip(stems, names)
    }
    session = Session(arguments, "tune")
    tuned = session.tune(controllers)
    session.controllers = {label: found.controller for label, found in tuned.items()}
    conditions = session.setting.conditions
    rows = [
        {
            "speed_scale": conditions.tuning_scale,
            "controller": label,
            "m_m": found.controller.m_m,
            "q_s": found.controller.q_s,
            "rms_lateral_error_m": found.error,
        }
        for label, found in tuned.items()
    ]
    session.write(pd.DataFrame(rows), conditions.tuning_laps)
    session.report()
    for stem in stems:
        print(f"  map-racing race --controller {session.folder / 'controllers' / stem}.yaml ...")
