"""``map-racing experiment``: the experiments of the paper, one command each."""

from __future__ import annotations

import argparse
import functools
import math
import re
from pathlib import Path

import numpy as np
import pandas as pd

from ..control.mpc import solver_library
from ..control.parameters import load_law
from ..errors import ParameterError
from ..evaluation.report import aligned
from ..experiments.jobs import RaceResult
from ..experiments.paper import (
    CONTENDERS,
    Race,
    highest_scales,
    lap_frame,
    on_common_days,
    race_frame,
    scaling_plan,
    scaling_table,
    tire_table,
)
from ..experiments.rivals import RIVALS, sensitivity_frame, sensitivity_plan, work_frame
from ..experiments.robustness_tables import grid_table
from ..printing import amount
from .figures import draw, remove_stale
from .session import open_grid, open_session, rival_sessions

TIRE_SCALES = (0.7, 0.8)
RIVAL_SCALES = (0.6, 0.7, 0.8, 0.9, 1.0)
# Pairs of controllers to compare on the days that both completed.
PAIRS = (
    ("MAP Pacejka", "pure pursuit"),
    ("MAP Pacejka", "MAP linear"),
    ("MAP default", "MAP Pacejka"),
    ("MAP adaptive", "MAP default"),
)


def run_scaling(arguments: argparse.Namespace) -> None:
    """Run the experiment on velocity scaling."""
    check_laps(arguments.laps)
    first = arguments.first
    if not 0.1 <= first <= 2.0:
        raise ParameterError(f"--from: expected 0.1 to 2, got {first}")
    if not first <= arguments.to <= 2.0:
        raise ParameterError(f"--to: expected {first:g} to 2, got {arguments.to}")
    if not 0.001 <= arguments.step <= 1.0:
        raise ParameterError(f"--step: expected 0.001 to 1, got {arguments.step}")
    count = 1 + math.floor((arguments.to - first) / arguments.step + 1e-9)
    scales = [round(first + arguments.step * k, 6) for k in range(count)]
    session = open_session(arguments, "velocity-scaling")
    races = session.race(scaling_plan, arguments.laps, scales, bags=arguments.bags)
    per_race, laps = race_frame(races), lap_frame(races)
    against = pairs_frame(per_race)
    table = _write_scaling(session, arguments, per_race, laps, pairs=against)
    print("\n".join(pairs_lines(against)))
    _draw(session, arguments, table, laps, "Velocity scaling", CONTENDERS)
    session.report()


def run_tires(arguments: argparse.Namespace) -> None:
    """Run the experiment on tire models."""
    check_laps(arguments.laps)
    session = open_session(arguments, "tire-models")
    plan = functools.partial(scaling_plan, until_failure=False)
    races = session.race(plan, arguments.laps, TIRE_SCALES, path=True, bags=arguments.bags)
    per_race = race_frame(races)
    table = tire_table(per_race)
    against = pairs_frame(per_race)
    frames = {"races": per_race, "laps": lap_frame(races), "pairs": against}
    session.write(table, arguments.laps, **frames)
    print("\n".join(tire_lines(table)), end="\n\n")
    print("\n".join(pairs_lines(against)))

    drawn = []
    for seed in session.setting.conditions.seeds:
        rows = [
            [
                (panel_title(race), timed_path(race.result), not race.result.completed)
                for race in races
                if race.scale == scale and race.seed == seed
            ]
            for scale in TIRE_SCALES
        ]
        title = f"Tire models: {session.where}, race day {seed}, {amount(arguments.laps, 'lap')}"
        raceline = session.setting.raceline
        drawn.append(f"trajectories_seed{seed}.png")
        plot = "experiments.plot_trajectories"
        draw(session.figures, drawn[-1], plot, raceline, rows, title)
    remove_stale(session.figures, r"trajectories_seed\d+\.png", drawn)
    session.report()


def run_robustness(arguments):
    """Robustness."""
    if arguments.laps is not None:
        check_laps(arguments.laps)
    named_controllers(arguments.controller)  # fail before a folder is made
    session = open_grid(arguments, "robustness")
    controllers = named_controllers(arguments.controller, session.grid.vehicle)
    races = session.race(controllers)
    scale = session.grid.conditions.speed_scale
    table = grid_table(races, scale)
    session.write(table, controllers, races=races)
    print("\n".join(robustness_lines(races)), end="\n\n")
    print("\n".join(not_completed_lines(races)))
    print("\n".join(grid_lines(table)))
    laps = amount(session.grid.conditions.laps, "timed lap")
    title = f"Robustness: {scale:.0%} speed, {laps}"
    drawn = []
    for label in controllers:
        own = races[races.controller == label]
        drawn.append(f"robustness_{label}.png")
        plot = "experiments.plot_robustness"
        draw(session.figures, drawn[-1], plot, own, f"{title}, {label}")
    for label in session.earlier.provenance.get("controllers", ()) if session.earlier else ():
        remove_stale(session.figures, re.escape(f"robustness_{label}.png"), drawn)
    session.report()


def run_mpc(arguments):
    """MAP against model predictive control, on several plants."""
    check_laps(arguments.laps)
    solver_library()  # fail before MAP is tuned
    for plant, session in rival_sessions(arguments, RIVALS):
        print(f"\n== plant {plant}")
        races = session.race(scaling_plan, arguments.laps, RIVAL_SCALES)
        per_race, laps = race_frame(races), lap_frame(races)
        beliefs = sensitivity_frame(
            session.race(sensitivity_plan, arguments.laps, (RIVAL_SCALES[-2],))
        )
        memory = session.memory(arguments.laps, RIVAL_SCALES[0])
        work = work_frame(races, session.controllers, session.tuned, memory)
        table = _write_scaling(session, arguments, per_race, laps, beliefs=beliefs, work=work)
        print("\n".join(aligned(frame_rows(beliefs), left=2)), end="\n\n")
        print("\n".join(aligned(frame_rows(work), left=1)))
        _draw(session, arguments, table, laps, "MAP and MPC", RIVALS)
        session.report()


def _write_scaling(session, arguments, races, laps, **frames):
    """Write all tables of races at rising scales, and print the main ones."""
    table, highest = scaling_table(races, laps), highest_scales(races)
    common = {"races": races, "laps": laps, "highest_scales": highest}
    session.write(table, arguments.laps, **common, **frames)
    print("\n".join(scaling_lines(table)), end="\n\n")
    print("\n".join(highest_lines(highest)), end="\n\n")
    return table


def _draw(session, arguments, table, laps, what, contenders):
    """Draw errors and laps over the scale, and the days not completed."""
    counted = laps[(laps.outcome == "completed") & laps.valid]
    ended = {
        (row.speed_scale, row.controller): row.days - row.days_completed
        for row in table.itertuples()
    }
    title = f"{what}: {session.where}, {amount(arguments.laps, 'lap')} on each of {session.days}"
    labels = [contender.label for contender in contenders]
    plot = "experiments.plot_scaling"
    draw(session.figures, "velocity_scaling.png", plot, counted, ended, labels, title)


def frame_rows(frame):
    """A frame as rows of text with its column names; unknown values are dashes."""
    rows = [list(frame.columns)]
    for values in frame.itertuples(index=False):
        texts = (f"{v:.4g}" if isinstance(v, float) else str(v) for v in values)
        rows.append(["-" if text == "nan" else text for text in texts])
    return rows


def named_controllers(names, vehicle=None):
    """Controllers by their stems, from files or shipped names; the latter are scaled to the car."""
    names = list(dict.fromkeys(names))
    stems = [Path(name).stem for name in names]
    if len(set(stems)) < len(stems):
        raise ParameterError("--controller: two files of one name would give one result")
    return {stem: load_law(name, vehicle) for stem, name in zip(stems, names)}


def check_laps(laps: int) -> None:
    """Refuse impossible numbers of laps."""
    if not 1 <= laps <= 1000:
        raise ParameterError(f"--laps: expected 1 to 1000, got {laps}")


# -- text ------------------------------------------------------------------------------------------


def scaling_lines(table: pd.DataFrame) -> list[str]:
    """Table of velocity scaling for the terminal."""
    titles = ["scale", "controller", "days completed", "median RMS error [m]"]
    titles += ["max error [m]", "median lap [s]", "mean lap [s]", "top speed [m/s]"]
    rows = [[*titles, "lateral [m/s^2]"]]
    for row in table.itertuples():
        rows.append([f"{row.speed_scale:.3f}", row.controller, completion(row)])
        if row.days_completed:
            rows[-1] += [
                f"{row.median_rms_lateral_error_m:.3f}",
                f"{row.max_abs_lateral_error_m:.3f}",
                f"{row.median_lap_time_s:.3f}",
                f"{row.mean_lap_time_s:.3f}",
                f"{row.max_speed_mps:.2f}",
                f"{row.lateral_acceleration_mps2:.2f}",
            ]
        else:
            rows[-1] += [not_completed(row), *[""] * 5]
    return [*aligned(rows, left=1), *saturation_lines(table)]


def saturation_lines(table: pd.DataFrame) -> list[str]:
    """From which scale on each controller drives the same speeds, where it does."""
    lines = []
    for label, own in table.groupby("controller", sort=False):
        changing = own[~own.same_speeds]
        if own.same_speeds.iloc[-1]:
            lines.append(
                f"{label}: the speeds of scale {changing.speed_scale.iloc[-1]:.3f} at all higher "
                "ones, too: the grip limits them, not the scale"
            )
    return lines


def tire_lines(table: pd.DataFrame) -> list[str]:
    """Table of tire models for the terminal; values of races not completed in parentheses."""
    titles = ["scale", "controller", "days completed", "mean lap [s]"]
    rows = [[*titles, "mean error [m]", "max error [m]"]]
    for row in table.itertuples():
        values = [
            f"{row.mean_lap_time_s:.3f}" if row.mean_lap_time_s == row.mean_lap_time_s else "-",
            f"{row.mean_abs_lateral_error_m:.3f}",
            f"{row.max_abs_lateral_error_m:.3f}",
        ]
        if not row.days_completed:
            values = [f"({value})" for value in values]
            values[0] = f"{not_completed(row)} {values[0]}"
        rows.append([f"{row.speed_scale:.3f}", row.controller, completion(row), *values])
    return aligned(rows, left=1)


def completion(row: tuple) -> str:
    """Days completed, as in "3 of 10", and after how many laps the others ended."""
    ended = row.laps_until_end if row.days_completed else ""
    return f"{row.days_completed} of {row.days}" + (f" (N.C. after {ended} laps)" if ended else "")


def not_completed(row: tuple) -> str:
    """The outcome N.C. with the laps driven."""
    return f"N.C. after {row.laps_until_end.replace(' ', ', ')} laps"


def robustness_lines(races: pd.DataFrame) -> list[str]:
    """A row for each controller and track: number of cars that completed it, and error."""
    titles = ["controller", "track", "completed", "median lap [s]", "mean RMS error [m]"]
    rows = [[*titles, "worst RMS error [m]", "max error [m]"]]
    for (label, track), group in races.groupby(["controller", "track"], sort=False):
        done = group[group.outcome == "completed"]
        rows.append([label, track, f"{len(done)} of {len(group)}"])
        if len(done):
            rows[-1] += [
                f"{done.lap_time_s.median():.3f}",
                f"{done.rms_lateral_error_m.mean():.3f}",
                f"{done.rms_lateral_error_m.max():.3f}",
                f"{done.max_abs_lateral_error_m.max():.3f}",
            ]
        else:
            rows[-1] += ["", "", "", ""]
    return aligned(rows, left=2)


def not_completed_lines(races: pd.DataFrame) -> list[str]:
    """Each race that was not completed, with place and cause."""
    rows = [
        [
            f"N.C. {row.controller} on {row.track}, {row.car}:",
            row.cause
            if math.isnan(row.end_s_m)
            else f"after {row.laps_completed} laps at s = {row.end_s_m:.1f} m: {row.cause}",
        ]
        for row in races[races.outcome != "completed"].itertuples()
    ]
    return [*aligned(rows, left=2), ""] if rows else []


def grid_lines(table: pd.DataFrame) -> list[str]:
    """Number of races that each controller completed, and error."""
    lines = []
    for row in table.itertuples():
        lines.append(f"{row.controller}: {row.races_completed} of {row.races} completed")
        if row.races_completed:
            lines[-1] += f", RMS error {row.mean_rms_lateral_error_m:.4f} m, "
            lines[-1] += f"worst race {row.worst_rms_lateral_error_m:.4f} m"
    return lines


def highest_lines(highest: pd.DataFrame) -> list[str]:
    """Table of the highest scale completed on each day."""
    labels = list(highest.columns[1:])
    rows = [["highest scale completed", *(f"day {seed}" for seed in highest.seed), "median"]]
    for label in labels:
        values = highest[label].values.astype(float)
        cells = [f"{value:.3f}" if math.isfinite(value) else "none" for value in values]
        # A day without a completed scale counts as the lowest.
        middle = float(np.median(np.where(np.isfinite(values), values, 0.0)))
        rows.append([label, *cells, f"{middle:.4g}" if middle else "none"])
    return aligned(rows)


def pairs_frame(races: pd.DataFrame) -> pd.DataFrame:
    """All pairs of controllers on the days that both completed."""
    frames = []
    for first, second in PAIRS:
        frame = on_common_days(races, first, second)
        frame.insert(1, "first", first)
        frame.insert(2, "second", second)
        frames.append(frame)
    return pd.concat(frames, ignore_index=True)


def pairs_lines(pairs: pd.DataFrame) -> list[str]:
    """Table of how much more closely and faster one of a pair followed the raceline."""
    rows = [["on days both completed", "scale", "days", "closer on", "RMS errors", "gain per lap"]]
    for row in pairs.itertuples():
        rows.append(
            [
                f"{row.first} to {row.second}",
                f"{row.speed_scale:.3f}",
                str(row.days),
                str(row.days_closer),
                f"x {row.error_ratio:.2f}",
                f"{row.gain_s:+.3f} s",
            ]
        )
    return aligned(rows)


def panel_title(race: Race) -> str:
    """Controller, scale and outcome of a race."""
    went = "completed" if race.result.completed else f"N.C. after {len(race.result.laps)} laps"
    return f"{race.label}, {race.scale:.0%}: {went}"


def timed_path(result: RaceResult) -> np.ndarray:
    """Positions after the out-lap or, if the race ended in it, during the out-lap.

    Parameters
    ----------
    result : RaceResult

    Returns
    -------
    ndarray, shape (n, 2)
        [m]
    """
    path = np.array(result.path, dtype=float).reshape(-1, 3)
    begin = [stretch.start_time_s for stretch in result.stretches if stretch.lap == 1]
    if begin:
        path = path[path[:, 0] >= begin[0]]
    return path[:, 1:]
