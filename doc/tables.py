"""Write the tables of parameters in these pages: ``python doc/tables.py``.

A table stands between ``<!-- table: KIND -->`` and ``<!-- end -->``; its rows are the fields of
the class KIND.
"""

from __future__ import annotations

import re
from pathlib import Path

from map_racing.control.parameters import ControllerParameters
from map_racing.control.safety_limits import SafetyLimits
from map_racing.control.steering_ramp import RampParameters
from map_racing.experiments.conditions import Conditions
from map_racing.simulation.plant import PlantParameters
from map_racing.simulation.public_simulator import PublicSimulatorParameters
from map_racing.validation import parameter_table

KINDS = {
    "Conditions": parameter_table(Conditions),
    "ControllerParameters": parameter_table(ControllerParameters),
    "PlantParameters": parameter_table(PlantParameters),
    "PublicSimulatorParameters": parameter_table(PublicSimulatorParameters),
    "RampParameters": parameter_table(RampParameters, "~"),
    "SafetyLimits": parameter_table(SafetyLimits, "~"),
}
TABLE = re.compile(r"(<!-- table: (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def with_tables(text: str) -> str:
    """The text of a page with up-to-date tables."""
    return TABLE.sub(lambda found: f"{found[1]}\n{KINDS[found[2]]}\n{found[3]}", text)


def main() -> None:
    """Rewrite the pages beside this file."""
    for page in Path(__file__).parent.glob("*.md"):
        page.write_text(with_tables(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
