"""Adaptation in the node: switching, publishing, showing, saving and forgetting."""

from pathlib import Path

import pytest
from dynamic_reconfigure.client import Client
from harness import wait_for
from map_racing.msg import Belief

from map_racing.control.adaptation import PRIOR
from map_racing.control.parameters import load_controller_parameters
from map_racing.vehicle.grids import default_grid
from map_racing.vehicle.parameters import load_vehicle
from map_racing.vehicle.steady_state import steady_state_table


def test_it_is_switched_on_and_off_while_driving(rig, listen):
    rig = rig({"controller": "map"})
    beliefs = listen("/map_racing/belief", Belief)
    rig.driving()
    assert rig.status()["adaptation"] == "off"
    client = Client("/controller/tuning", timeout=10.0)
    assert client.get_configuration(timeout=10.0)["adaptation"] is False

    assert client.update_configuration({"adaptation": True})["adaptation"] is True
    beliefs.wait()
    status = wait_for(lambda: "believed friction" in rig.status() and rig.status())
    assert status["adaptation"] == "learning" or status["adaptation"].startswith("frozen: ")
    for name in ("friction", "front stiffness", "rear stiffness", "delay [s]"):
        value, interval = status[f"believed {name}"].split(" ", 1)
        low, high = interval.strip("()").split(" to ")
        assert float(low) <= float(value) <= float(high)
    assert 0.5 < float(status["grip in use"]) < 1.5

    assert client.update_configuration({"adaptation": False})["adaptation"] is False
    wait_for(lambda: rig.status()["adaptation"] == "off")
    assert "believed friction" not in rig.status()
    rig.driving()


def test_a_lookup_table_cannot_be_adapted(rig, tmp_path):
    vehicle = load_vehicle("nuc4")
    steady_state_table(vehicle, *default_grid(vehicle)).save(tmp_path / "table.csv")
    rig = rig({"controller": "map", "lookup_table": str(tmp_path / "table.csv")})
    client = Client("/controller/tuning", timeout=10.0)
    assert client.update_configuration({"adaptation": True})["adaptation"] is False
    wait_for(lambda: "adaptation: expected false with the lookup table" in rig.node.output)


def test_what_is_learned_is_saved_started_from_and_forgotten(rig, ros, start, listen, tmp_path):
    files = {
        "save_to": str(tmp_path / "{steering_map}.yaml"),
        "save_vehicle_to": str(tmp_path / "day" / "{vehicle}.yaml"),
    }
    rig = rig({"controller": "map_adaptive", "speed_scale": 0.6, **files})
    beliefs = listen("/map_racing/belief", Belief)
    rig.driving()
    prior = PRIOR[0] * 3.92  # width of the 95 % interval

    def width(belief):
        return (belief.friction_high - belief.friction_low) / belief.friction

    beliefs.wait(lambda belief: width(belief) < 0.8 * prior, 60.0)
    saved = rig.call(ros, "save")
    controller, vehicle = saved.message.split(", ")
    assert saved.success
    assert (controller, vehicle) == (str(tmp_path / "table.yaml"), str(tmp_path / "day/NUC4.yaml"))
    rig.more(20)  # the estimate of that moment has been published by now
    believed, shipped = load_vehicle(vehicle), load_vehicle("nuc4")
    factors = [b.friction for b in list(beliefs)]
    assert min(factors) <= believed.mu / shipped.mu <= max(factors)
    parameters = load_controller_parameters(controller)
    delays = [b.delay for b in list(beliefs)]
    assert min(delays) - 1e-4 <= parameters.delay_s <= max(delays) + 1e-4
    head = Path(vehicle).read_text()
    assert "# Tires learned by map_racing" in head and "the vehicle was nuc4." in head

    # An existing file is kept, even if the node was started from it.
    again = rig.call(ros, "save")
    assert not again.success and f"{vehicle} exists, so nothing is saved" in again.message
    assert Path(vehicle).read_text() == head

    mark = len(beliefs)
    assert rig.call(ros, "reset").success
    wait_for(lambda: [b for b in beliefs[mark:] if width(b) > 0.95 * prior], what="the prior")
    rig.driving()

    rig.node.stop()
    start(
        "controller",
        {"controller": controller, "vehicle": vehicle, "raceline": "reference"},
        name="again",
    )
    held = Client("/again/tuning", timeout=10.0).get_configuration(timeout=10.0)
    assert held["delay_s"] == parameters.delay_s and held["adaptation"] is True


@pytest.mark.parametrize("adaptation", [False, True])
def test_without_anything_learned_there_is_no_vehicle_to_save(rig, ros, tmp_path, adaptation):
    files = {"save_to": str(tmp_path / "c.yaml"), "save_vehicle_to": str(tmp_path / "v.yaml")}
    rig = rig({"controller": "map", "adaptation": adaptation, **files}, speed=1.0)
    assert rig.call(ros, "reset").success == adaptation
    saved = rig.call(ros, "save")
    assert (saved.success, saved.message) == (True, str(tmp_path / "c.yaml"))
    assert not (tmp_path / "v.yaml").exists()
