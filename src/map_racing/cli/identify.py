"""``map-racing identify``: from recorded driving to a vehicle file and its lookup table."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

from tqdm import tqdm

from .. import __version__
from ..errors import ParameterError
from ..files import make_folder, write_json
from ..identification.data import load_run
from ..identification.identify import Identification, identify, leave_one_out
from ..identification.limits import SteadyLimits
from ..identification.report import recorded_notes, report_data, report_text
from ..vehicle.lookup import default_grid
from ..vehicle.parameters import parameter_hash, save_vehicle
from ..vehicle.steady_state import steady_state_table
from .figures import draw_identification
from .inputs import channel_map, joined, read_vehicle
from .outputs import check_outputs


def run(arguments: argparse.Namespace) -> None:
    """Identify, report, write."""
    output = Path(arguments.output)
    if output.suffix not in (".yaml", ".yml"):
        raise ParameterError(f"--output: expected a vehicle file (.yaml), got {output}")
    table_path = output.with_suffix(".csv")
    outputs = [arguments.output, str(table_path), arguments.linear_output, arguments.json]
    check_outputs(outputs, [*arguments.data, arguments.vehicle, arguments.channels])
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
    found = identify(runs, base, **options)
    left_out = leave_one_out(runs, base, **options) if arguments.leave_one_out else None
    for recorded in runs:
        for note in recorded.notes:
            print(f"{recorded.label}: {note}")
    print(report_text(found, left_out))

    if arguments.plots:
        # First: if the folder cannot be made, no other output is left behind.
        make_folder(arguments.plots)
    print()
    table = steady_state_table(found.vehicle, *default_grid(found.vehicle))
    save_vehicle(found.vehicle, output, provenance(found))
    table.save(table_path)
    print(f"vehicle written to {output} ({parameter_hash(found.vehicle)}), table to {table_path}")
    if arguments.linear_output:
        save_vehicle(found.linear_vehicle, arguments.linear_output, provenance(found))
        print(f"vehicle with linear tires written to {arguments.linear_output}")
    if arguments.json:
        write_json(arguments.json, report_data(found, left_out))
        print(f"report written to {arguments.json}")
    if arguments.plots:
        draw_identification(arguments.plots, found, left_out, table)
        print(f"figures are in {arguments.plots}")


def provenance(found: Identification) -> str:
    """Comment for the head of the vehicle file."""
    runs = ", ".join(motion.run.label for motion in found.motions)
    doubts = [note for note in recorded_notes(found) if "warning: " in note]
    doubts += [f"check: {finding.text}" for finding in found.findings if finding.critical]
    front, rear = (axle.pacejka for axle in found.axles.values())
    return (
        f"Tires identified by map_racing {__version__} from {runs}; the rest is of "
        f"{found.base.name}.\n"
        f"Reached {found.largest_a_y:.2f} m/s^2; slip angles to {front.covered_slip:.3f} rad in "
        f"front and {rear.covered_slip:.3f} rad behind; peak "
        f"{'reached' if front.saturated else 'not reached'} in front, "
        f"{'reached' if rear.saturated else 'not reached'} behind.\n"
        f"Steering: wheel angle = {found.setup.steering_gain:.4f} * signal "
        f"{found.setup.steering_offset_rad:+.4f} rad."
    ) + "".join(f"\n{doubt}" for doubt in doubts)
