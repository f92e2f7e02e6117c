"""Start the session of a command that runs many races."""

from dataclasses import replace
from pathlib import Path

from ..errors import ParameterError
from ..experiments.conditions import load_conditions
from ..experiments.robustness import load_robustness
from ..experiments.session import GridSession, Session

__all__ = ["open_grid", "open_session", "rival_sessions"]


def open_session(arguments, kind):
    """Session with the conditions that the options of `add_shared_options` name."""
    names = ("track", "plant", "seeds", "practice_seeds", "tuning_scale")
    return _with_notes(
        Session(
            kind,
            arguments.output,
            _changed(load_conditions(arguments.conditions), arguments, dict(zip(names, names))),
            vehicle=arguments.vehicle,
            tuning=not getattr(arguments, "no_tuning", False),
            **_where(arguments),
        )
    )


def _with_notes(session):
    """The session, after printing its notes for the user."""
    for note in session.notes:
        print(note)
    return session


def rival_sessions(arguments, contenders):
    """Name and session of each plant, in a folder of its own below the output."""
    names = ("track", "seeds", "tuning_scale")
    base = _changed(load_conditions(arguments.conditions), arguments, dict(zip(names, names)))
    stems = [Path(plant).stem for plant in arguments.plants]
    if len(set(stems)) < len(stems):
        raise ParameterError("--plants: two plants of one name would give one result")
    for plant, stem in zip(arguments.plants, stems):
        session = Session(
            "mpc",
            Path(arguments.output) / stem,
            replace(base, plant=plant),
            tuning=not arguments.no_tuning,
            contenders=contenders,
            slowdown=arguments.slowdown,
            **_where(arguments),
        )
        yield plant, _with_notes(session)


def open_grid(arguments, kind):
    """Session on the grid that the options name."""
    options = {
        "tracks": "tracks",
        "generated_seeds": "generated",
        "speed_scale": "speed_scale",
        "laps": "laps",
    }
    conditions = _changed(load_robustness(arguments.grid), arguments, options)
    return _with_notes(GridSession(kind, arguments.output, conditions, **_where(arguments)))


def _changed(conditions, arguments, options):
    """Conditions with the values of the options that were given, by the names of fields."""
    given = {name: getattr(arguments, option, None) for name, option in options.items()}
    return replace(conditions, **{name: v for name, v in given.items() if v is not None})


def _where(arguments):
    return {name: getattr(arguments, name) for name in ("jobs", "scheduler", "reuse")}
