"""The day of identification: results of ramps on a plant."""

import pytest

from map_racing.experiments.identification_day import identify_on
from map_racing.simulation.plants import load_plant
from map_racing.vehicle.parameters import load_vehicle


@pytest.mark.once
def test_the_shipped_identified_simulator_is_what_ramps_on_it_give(tmp_path):
    """Its tires are valid for the slip angles of the ramps; the file says how it was made."""
    shipped = load_vehicle("sim_identified")
    found = identify_on(load_plant("public_simulator"), 0, tmp_path / "ramps.bag").vehicle
    for slip in (0.05, 0.15, 0.3):
        for axle in ("front", "rear"):
            theirs = getattr(found, axle).normalized_force(slip)
            assert getattr(shipped, axle).normalized_force(slip) == pytest.approx(theirs, rel=1e-3)
