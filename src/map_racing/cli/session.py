"""Start the session of a command that runs many races."""

from dataclasses import replace

from ..experiments.conditions import load_conditions
from ..experiments.session import Session

__all__ = ["open_session"]


def open_session(arguments, kind):
    """Session with the conditions that the options of `add_shared_options` name."""
    names = ("track", "plant", "seeds", "practice_seeds", "tuning_scale")
    given = {name: getattr(arguments, name, None) for name in names}
    conditions = replace(
        load_conditions(arguments.conditions),
        **{name: value for name, value in given.items() if value is not None},
    )
    session = Session(
        kind,
        arguments.output,
        conditions,
        vehicle=arguments.vehicle,
        tuning=not getattr(arguments, "no_tuning", False),
        jobs=arguments.jobs,
        scheduler=arguments.scheduler,
        reuse=arguments.reuse,
    )
    for note in session.notes:
        print(note)
    return session
