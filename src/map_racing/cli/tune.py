"""``map-racing tune``: the lookahead with which a controller follows a track closest."""

from pathlib import Path

import pandas as pd

from ..control.parameters import load_controller_parameters
from ..errors import ParameterError
from .session import open_session

DEFAULTS = ("pure_pursuit_paper", "map_linear_paper", "map_paper")


def run(arguments):
    """Tune."""
    names = list(dict.fromkeys(arguments.controller))
    stems = [Path(name).stem for name in names]
    if len(set(stems)) < len(stems):
        raise ParameterError("--controller: expected files of different names, got one name twice")
    controllers = {
        stem: (stem, load_controller_parameters(name)) for stem, name in zip(stems, names)
    }
    session = open_session(arguments, "tune")
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
