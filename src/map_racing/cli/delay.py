"""``map-racing delay``: delays of a car from recorded driving."""

from __future__ import annotations

import argparse

from tqdm import tqdm

from ..files import write_json
from ..identification.data import load_run
from ..identification.delay import delay_data, delay_text, estimate_delays
from ..resources import list_config
from ..vehicle.parameters import load_vehicle
from .inputs import channel_map, joined, read_vehicle
from .outputs import check_outputs


def run(arguments: argparse.Namespace) -> None:
    """Estimate and report."""
    check_outputs([arguments.json], [*arguments.data, arguments.vehicle, arguments.channels])
    vehicle = read_vehicle(arguments.vehicle) if arguments.vehicle else None
    others = [] if vehicle else [load_vehicle(name) for name in list_config("vehicles")]
    channels = channel_map(arguments)
    sources = joined(arguments.data, arguments.join)
    runs = [load_run(path, channels) for path in tqdm(sources, "read", disable=None, leave=False)]
    delays = estimate_delays(runs, vehicle, others)
    print(delay_text(delays))
    if arguments.json:
        write_json(arguments.json, delay_data(delays))
        print(f"delays written to {arguments.json}")
