import math

import numpy as np

from map_racing.plots.lookup import plot_lookup_curves, plot_lookup_surface
from map_racing.plots.style import save
from map_racing.vehicle.lookup import LookupTable


def test_lookup_table(tmp_path):
    speeds, angles = np.linspace(0.5, 7.0, 20), np.linspace(0.0, 0.4, 15)
    a_lat = np.minimum(7.0, speeds**2 * np.tan(angles)[:, None] / 0.33)
    a_lat[12:, 15:] = math.nan
    table = LookupTable(speeds, angles, a_lat)
    for name, plot in (
        ("surface", plot_lookup_surface),
        ("curves", plot_lookup_curves),
    ):
        save(plot(table), tmp_path / f"{name}.png")
        assert (tmp_path / f"{name}.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
