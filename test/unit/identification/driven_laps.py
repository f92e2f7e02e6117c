"""Laps of the simulated car as runs, without a bag."""

import dataclasses

import numpy as np

from map_racing.control.controller import build_controller
from map_racing.control.parameters import load_controller_parameters
from map_racing.identification.data import Run, Signal
from map_racing.simulation.plants import build_plant, load_plant
from map_racing.simulation.race import race
from map_racing.track.files.load import load_raceline
from map_racing.vehicle.parameters import load_vehicle

RACELINE = load_raceline("reference")
QUIET = {name: 0.0 for name in ("position_noise_m", "heading_noise_rad", "velocity_noise_mps")}
QUIET.update(yaw_rate_noise_radps=0.0, acceleration_noise_mps2=0.0)


def laps_of(scale, seed=1, raceline=RACELINE, plant="nuc4", **changes):
    """Twenty seconds of laps of the simulated car, as a run, and its true vehicle."""
    parameters = dataclasses.replace(load_plant(plant), **changes)
    plant, localization = build_plant(parameters, seed=seed)
    settings = load_controller_parameters("map").with_(speed_scale=scale)
    controller = build_controller(settings, load_vehicle("nuc4"), raceline)
    samples = race(plant, controller, raceline, localization, laps=1).samples
    samples = [sample for sample in samples if sample.measured.t < 20.0]
    t = np.array([sample.measured.t for sample in samples])
    issued = np.array([sample.arrival for sample in samples])

    def signal(of, t=t):
        return Signal(t, np.array([of(sample) for sample in samples]))

    signals = {
        "x": signal(lambda s: s.measured.x),
        "y": signal(lambda s: s.measured.y),
        "psi": signal(lambda s: s.measured.psi),
        "v_x": signal(lambda s: s.measured.v_x),
        "v_y": signal(lambda s: s.measured.v_y),
        "yaw_rate": signal(lambda s: s.measured.r),
        "a_y": signal(lambda s: s.acceleration[1]),
        "steering": signal(lambda s: s.result.steering_angle, issued),
        "speed_command": signal(lambda s: s.result.speed, issued),
    }
    return Run("laps.bag", signals, pose_lag=(0.02, 0.02, 0.02)), plant.vehicle
