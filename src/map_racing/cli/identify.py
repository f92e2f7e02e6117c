"""``map-racing identify``: from recorded driving to a vehicle file and its lookup table."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

from tqdm import tqdm

from ..control.parameters import (
    load_controller_parameters,
    load_safety_limits,
    save_controller_parameters,
)
from ..errors import ParameterError
from ..files import make_folder, together, write_json
from ..identification.car import identify_car
from ..identification.car_report import car_data, car_text, provenance
from ..identification.data import load_run
from ..identification.identify import leave_one_out
from ..identification.limits import SteadyLimits
from ..identification.replay import actuators_of, replay
from ..vehicle.grids import default_grid
from ..vehicle.parameters import parameter_hash, save_vehicle
from ..vehicle.steady_state import steady_state_table
from .figures import draw_identification
from .inputs import channel_map, joined, read_vehicle
from .outputs import check_outputs

CONTROLLER = "map"


def run(arguments: argparse.Namespace) -> None:
    """Identify, report, write."""
    output = Path(arguments.output)
    if output.suffix not in (".yaml", ".yml"):
        raise ParameterError(f"--output: expected a vehicle file (.yaml), got {output}")
    outputs = [arguments.output, str(_table_path(output)), arguments.linear_output]
    outputs += [arguments.json, arguments.controller_output]
    recordings = [*arguments.data, *arguments.validate]
    check_outputs(outputs, [*recordings, arguments.vehicle, arguments.channels])
    _check_held_out(arguments)
    base = read_vehicle(arguments.vehicle)
    channels = channel_map(arguments)
    sources = joined(arguments.data, arguments.join)
    runs = [load_run(path, channels) for path in tqdm(sources, "read", disable=None, leave=False)]
    names = [field.name for field in dataclasses.fields(SteadyLimits)]
    options = {
        "fix": arguments.fix,
        "limits": SteadyLimits(**{name: getattr(arguments, name) for name in names}),
        "front_force": arguments.front_force,
        "acceleration": arguments.acceleration,
        "name": arguments.name or output.stem,
    }
    found = identify_car(runs, base, **options)
    left_out = None
    if arguments.leave_one_out:
        if found.steady is None:
            raise ParameterError("--leave-one-out: expected steady cornering, got ordinary driving")
        left_out = leave_one_out(runs, base, **options)
    validated = _validated(arguments, found, channels)
    for recorded in runs:
        for note in recorded.notes:
            print(f"{recorded.label}: {note}")
    print(car_text(found, left_out, validated))
    print()
    _write(arguments, found, left_out, validated)


def _write(arguments, found, left_out, validated):
    """Write vehicle, table and further outputs."""
    if arguments.plots is not None:
        # First, so that no other output is left behind if the folder cannot be made.
        make_folder(arguments.plots)
    table = steady_state_table(found.vehicle, *default_grid(found.vehicle))
    output = Path(arguments.output)
    digest = parameter_hash(found.vehicle)
    said = [f"vehicle written to {output} ({digest}), table to {_table_path(output)}"]
    with together():
        save_vehicle(found.vehicle, output, provenance(found, validated))
        table.save(_table_path(output))
        if arguments.linear_output:
            linear = arguments.linear_output
            save_vehicle(found.linear_vehicle, linear, provenance(found, validated))
            said.append(f"vehicle with linear tires written to {linear}")
        if arguments.controller_output:
            said.append(_write_controller(arguments.controller_output, found))
        if arguments.json:
            write_json(arguments.json, car_data(found, left_out, validated))
            said.append(f"report written to {arguments.json}")
    print("\n".join(said))
    if arguments.plots is not None:
        draw_identification(arguments.plots, found.steady, left_out, table)
        print(f"figures are in {arguments.plots}")


def _table_path(output):
    """The lookup table, beside the vehicle file."""
    return output.with_suffix(".csv")


def _check_held_out(arguments):
    """Refuse to validate with recordings that the car is fitted to."""
    fitted = {Path(path).resolve() for path in arguments.data}
    for path in arguments.validate:
        if Path(path).resolve() in fitted:
            raise ParameterError(
                f"--validate: expected recordings that the car is not fitted to, got {path}"
            )


def _validated(arguments, found, channels):
    """Replays of the recordings for validation, if there are any."""
    if not arguments.validate:
        return None
    actuators = actuators_of(found.runs, found.vehicle)
    runs = [
        dataclasses.replace(load_run(path, channels), setup=found.setup)
        for path in joined(arguments.validate, arguments.join)
    ]
    return replay(found.vehicle, runs, actuators, arguments.window, found.largest_a_y)


def _write_controller(path, found):
    """Write the shipped controller with the delay that was found; return what to print."""
    parameters = load_controller_parameters(CONTROLLER, found.vehicle)
    delay = found.laps.delays.delay if found.laps else None
    if delay is None or delay.value is None:
        reason = delay.reason if delay else "it takes ordinary driving"
        text = f"with its own delay_s of {parameters.delay_s:g} s (none was determined: {reason})"
    else:
        parameters = parameters.with_(delay_s=round(delay.value, 4))
        text = f"with delay_s of {parameters.delay_s:g} s"
        text += f" ({delay.reason})" if delay.reason else ""
    save_controller_parameters(parameters, path, load_safety_limits(CONTROLLER, found.vehicle))
    return f"controller {CONTROLLER} written to {path}, {text}"
